"""Run the judges, each in an interpreter of its own, and read what they wrote."""

from __future__ import annotations

import subprocess
from pathlib import Path

from judges import measures

from morphspace.errors import BadInput

FACE = Path(__file__).with_name("face.py")
MESH = Path(__file__).with_name("mesh.py")


def read_faces(python: str, folder: Path, views: int) -> measures.Readings:
    """Read landmarks and identity from the pictures of a folder with face.py, run by the interpreter `python`.

    Raises `BadInput` where the judge does not start or fails.
    """
    output = folder.with_suffix(".npz")
    run(python, FACE, [str(folder), "-o", str(output), "--views", str(views)])
    return measures.read_readings(output)


def run(python: str, script: Path, words: list[str]) -> str:
    """Run a judge's script with the interpreter `python`; return what it prints. Raises `BadInput` where it fails."""
    try:
        ended = subprocess.run([python, str(script), *words], capture_output=True, text=True, check=False)
    except OSError as error:
        raise BadInput(
            f"the interpreter {python} does not start: {error.strerror}. Make it as {script.name} says"
        ) from error
    if ended.returncode:
        raise BadInput(
            f"{script.name} ended with {ended.returncode}: {ended.stderr.strip()[-300:]}. Run it by itself"
        )
    return ended.stdout
