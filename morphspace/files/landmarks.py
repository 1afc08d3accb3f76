"""Landmark files: the same points marked in every picture, as WebMorph and Psychomorph keep them or as plain lines.

`.tem`: a first line with the count, so many lines with x and y, then the lines that connect the points, which say
nothing about where they lie and are passed over. `.csv` and `.txt`: x and y in each line, apart by a comma, a semicolon
or blanks; a heading (x, y) is allowed. Either way in px of the picture, pixel centres at integers, y down.
"""

from __future__ import annotations

import math
import re
from itertools import islice
from pathlib import Path
from typing import TypeAlias

import numpy as np

from morphspace.arrays import Points
from morphspace.errors import BadInput, UnreadableFile

SUFFIXES = (".tem", ".csv", ".txt")
HEADING = re.compile(r"\W*x(_px)?\W+y(_px)?\W*", re.IGNORECASE)
COUNT = re.compile(r"\d{1,9}")
APART = re.compile(r"\s*[,;]\s*|\s+")
SHOWN = 40  # characters of a line in an error

_Lines: TypeAlias = list[tuple[int, str]]
"""What is written in a file, each with the number of its line; empty lines and remarks (#) are left out."""


def read_landmarks(path: str | Path) -> Points:
    """Read landmarks (m, 2) px, m >= 1, in the order of the file.

    Raises `BadInput` (another suffix, or a line that is not what was expected, with its number) and `UnreadableFile`
    (missing, empty, not text).
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(f"{path} is no landmark file by its name: it ends in one of {', '.join(SUFFIXES)}")
    lines = _lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty: landmarks were expected, x and y in each line")
    rows = _rows_of_tem(path, lines) if path.suffix.lower() == ".tem" else _rows_of_table(lines)
    if not rows:
        raise BadInput(f"{path} holds no landmark: x and y were expected in each line")
    return np.array([_point(path, number, text) for number, text in rows], np.float64)


def read_landmark_pair(reference: str | Path, frame: str | Path) -> tuple[Points, Points]:
    """Read the landmarks of two pictures, (m, 2) px each. Raises `BadInput` where their counts differ."""
    one, other = read_landmarks(reference), read_landmarks(frame)
    if len(one) != len(other):
        raise BadInput(
            f"{reference} has {len(one)} landmarks, {frame} has {len(other)}: mark the same points in both, "
            "in one order"
        )
    return one, other


def _lines(path: Path) -> _Lines:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    except UnicodeDecodeError as error:
        raise UnreadableFile(f"{path} is not a text in UTF-8: export the landmarks again") from error
    lines = ((number, line.strip()) for number, line in enumerate(text.split("\n"), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def _rows_of_tem(path: Path, lines: _Lines) -> _Lines:
    """Give the lines of the points of a `.tem`; what follows them must be its list of lines, or nothing."""
    number, first = lines[0]
    if not COUNT.fullmatch(first):
        raise BadInput(f"{path}, line {number}: {_shown(first)}, the count of the landmarks was expected")
    count = int(first)
    rows = list(islice(lines, 1, 1 + count))
    if len(rows) < count:
        raise BadInput(
            f"{path} announces {count} landmarks and holds {len(rows)}: it is cut short, export it again"
        )
    if len(lines) > 1 + count and not COUNT.fullmatch(lines[1 + count][1]):
        number, text = lines[1 + count]
        raise BadInput(
            f"{path}, line {number}: {_shown(text)} follows the {count} landmarks that were announced, where the count "
            "of its lines was expected; export it again"
        )
    return rows


def _rows_of_table(lines: _Lines) -> _Lines:
    return lines[1:] if HEADING.fullmatch(lines[0][1]) else lines


def _point(path: Path, number: int, text: str) -> tuple[float, float]:
    words = APART.split(text)
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        raise BadInput(f"{path}, line {number}: {_shown(text)}, the numbers x and y were expected") from None
    if len(values) != 2:
        raise BadInput(f"{path}, line {number}: {len(values)} numbers, 2 were expected, x and y")
    if not all(map(math.isfinite, values)):
        raise BadInput(f"{path}, line {number}: {_shown(text)} is not finite: mark this landmark again")
    return values[0], values[1]


def _shown(text: str) -> str:
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")
