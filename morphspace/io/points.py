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
COUNT = re.compile(r"\d{1,9}", re.ASCII)
APART = re.compile(r"\s*[,;]\s*|\s+")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE | re.ASCII)
NO_TEXT = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f-\x9f]")  # 1a ends a text of DOS
BLANKS = " \t\v\f\x1a"
LINE_END = re.compile(r"\r\n|\r|\n")
SHOWN = 40  # characters of a line in an error

Lines: TypeAlias = list[tuple[int, str]]
"""What is written in a file, each with the number of its line; empty lines and remarks (#) are left out."""


def read_landmarks(path: str | Path) -> Points:
    """Read landmarks (m, 2) px, m >= 1, in the order of the file.

    Raises `BadInput` (another suffix, or a line that is not what was expected, with its number) and `UnreadableFile`
    (missing, empty, not text).
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(f"{path} is no landmark file by its name: it ends in one of {', '.join(SUFFIXES)}")
    lines = numbered_lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty: landmarks were expected, x and y in each line")
    rows = _rows_of_tem(path, lines) if path.suffix.lower() == ".tem" else _rows_of_table(lines)
    if not rows:
        raise BadInput(f"{path} holds no landmark: x and y were expected in each line")
    return np.array([point_of(path, number, text) for number, text in rows], np.float64)


def read_landmark_pair(reference: str | Path, frame: str | Path) -> tuple[Points, Points]:
    """Read the landmarks of two pictures, (m, 2) px each. Raises `BadInput` where their counts differ."""
    one, other = read_landmarks(reference), read_landmarks(frame)
    if len(one) != len(other):
        raise BadInput(
            f"{reference} has {len(one)} landmarks, {frame} has {len(other)}: mark the same points in both, "
            "in one order"
        )
    return one, other


def numbered_lines(path: Path) -> Lines:
    """Read the lines of a landmark file that say something.

    Programs of other decades write the name of a picture in Latin-1: what is not UTF-8 is read so, where it is a text
    at all. Raises `UnreadableFile`.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if NO_TEXT.search(text):
        raise UnreadableFile(
            f"{path} is not a text in UTF-8 or Latin-1: export the landmarks again as plain text"
        )
    lines = ((number, line.strip(BLANKS)) for number, line in enumerate(LINE_END.split(text), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def _rows_of_tem(path: Path, lines: Lines) -> Lines:
    """Give the lines of the points of a `.tem`; what follows them must be its list of lines, or nothing."""
    number, first = lines[0]
    if not COUNT.fullmatch(first):
        raise BadInput(f"{path}, line {number}: {quoted(first)}, the count of the landmarks was expected")
    count = int(first)
    rows = list(islice(lines, 1, 1 + count))
    if len(rows) < count:
        raise BadInput(
            f"{path} announces {count} landmarks and holds {len(rows)}: it is cut short, export it again"
        )
    if len(lines) > 1 + count and not COUNT.fullmatch(lines[1 + count][1]):
        number, text = lines[1 + count]
        raise BadInput(
            f"{path}, line {number}: {quoted(text)} follows the {count} landmarks that were announced, where the count "
            "of its lines was expected; export it again"
        )
    return rows


def _rows_of_table(lines: Lines) -> Lines:
    return lines[1:] if HEADING.fullmatch(lines[0][1]) else lines


def point_of(path: Path, number: int, text: str) -> tuple[float, float]:
    """Read x and y from line `number` of a file. Raises `BadInput` with the line where it is anything else."""
    words = APART.split(text)
    if not all(map(NUMBER.fullmatch, words)):
        raise BadInput(f"{path}, line {number}: {quoted(text)}, the numbers x and y were expected")
    values = tuple(map(float, words))
    if len(values) != 2:
        commas = "; a comma stands between numbers here, write decimals with a point" if "," in text else ""
        raise BadInput(f"{path}, line {number}: {len(values)} numbers, 2 were expected, x and y{commas}")
    if not all(map(math.isfinite, values)):
        raise BadInput(f"{path}, line {number}: {quoted(text)} is not finite: mark this landmark again")
    return values[0], values[1]


def quoted(text: str) -> str:
    """Give a line for an error, cut where it is long."""
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")
