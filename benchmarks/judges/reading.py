"""Run the judges, each in an interpreter of its own, and read what they wrote."""

from __future__ import annotations

import csv
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from judges import measures

from morphspace.arrays import Points
from morphspace.errors import BadInput
from morphspace.storage import digest_of_file, digest_of_json

FACE = Path(__file__).with_name("face.py")
MESH = Path(__file__).with_name("mesh.py")


def read_faces(python: str, folder: Path, views: int) -> measures.Readings:
    """Read landmarks and identity from the pictures of a folder with face.py, run by the interpreter `python`.

    The readings are kept beside the folder under the digest of the pictures and of the judge: equal pictures are read
    once. Raises `BadInput` where the judge does not start or fails.
    """
    files = sorted(folder.iterdir())
    made_of = {file.name: digest_of_file(file) for file in (FACE, *files)}
    output = folder.with_name(f"{folder.name}-{digest_of_json([made_of, views])[:16]}.npz")
    if not output.exists():
        run(python, FACE, [str(folder), "-o", str(output), "--views", str(views)])
    return measures.read_readings(output)


def read_mesh(python: str, inputs: Sequence[Path], table: Path) -> dict[str, Points]:
    """Read the 478 points of each picture with mesh.py; return them (478, 2) px by the file's stem, (nan) where lost.

    `inputs` are files or folders; the tables of mesh.py are written to `table` and beside it.
    """
    table.parent.mkdir(parents=True, exist_ok=True)
    points = table.with_name(f"{table.stem}_points.csv")
    run(python, MESH, [*map(str, inputs), "-o", str(table), "--points", str(points)])
    with points.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))[1:]
    return {
        Path(row[0]).stem: np.array([float(cell or "nan") for cell in row[1:]]).reshape(-1, 2) for row in rows
    }


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
