"""Run benchmarks/face_judge.py, which lives in an interpreter of its own, and read what it wrote."""

from __future__ import annotations

import subprocess
from pathlib import Path

import judge_measures

from morphspace.errors import BadInput

JUDGE = Path(__file__).with_name("face_judge.py")


def read(judge: str, folder: Path, views: int) -> judge_measures.Readings:
    """Judge the pictures of a folder with the interpreter `judge`. Raises `BadInput` where it cannot."""
    output = folder.with_suffix(".npz")
    words = [judge, str(JUDGE), str(folder), "-o", str(output), "--views", str(views)]
    try:
        ended = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BadInput(f"the judge {judge} does not start ({error.strerror}): see {JUDGE.name}") from error
    if ended.returncode != 0:
        raise BadInput(f"the judge ended with {ended.returncode}: {ended.stderr.strip()[-300:]}")
    return judge_measures.read_readings(output)
