"""Landmark files: points marked in a picture, and the three of them that place a face.

`.tem` (WebMorph, PsychoMorph): a first line with the count, so many lines with x and y, then the lines that connect the
points, which are passed over. `.tps` (tpsDig, geomorph, webmorphR): `LM=` and the count, then x and y in each line.
`.csv` and `.txt`: x and y in each line, apart by a comma, a semicolon or blanks; a heading (x, y) is allowed. All are
in px of the picture, pixel centres at integers, y down unless a `.tps` says otherwise.

`read_landmarks` gives all points. `read_marked_points` gives eyes and lip, from these files or from our own faceframe
(.json): how many points a file holds tells which template it is, and TEMPLATES says which of its points surround the
eyes and the lip.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from morphspace.arrays import Points
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.sidecars import eyes_in_order, read_faceframe

Lip: TypeAlias = Literal["philtrum", "upper-lip"]
"""What the third point marks: the centre of the philtrum (Nagle), or the bottom of the upper lip (WebMorph)."""
YAxis: TypeAlias = Literal["auto", "up"]
"""Which way y counts in a file: `auto` goes by the file, `up` turns it round."""

LANDMARK_HEADING = re.compile(r"LM\s*=\s*(\d{1,9})", re.IGNORECASE)
SOLID_HEADING = re.compile(r"LM3\s*=.*", re.IGNORECASE)
CURVE_HEADING = re.compile(r"POINTS\s*=\s*(\d{1,9})", re.IGNORECASE)
OTHER_HEADING = re.compile(r"[A-Za-z_]\w*\s*=.*")

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


@dataclass(frozen=True)
class Template:
    """Which points of a landmark template to average for each eye, the philtrum and the bottom of the upper lip."""

    name: str
    eyes: tuple[tuple[int, ...], tuple[int, ...]]
    philtrum: tuple[int, ...]
    upper_lip: tuple[int, ...]


TEMPLATES = {
    # Pupils; the ends of the two ridges beside the philtrum; the middle of the upper lip's lower edge.
    189: Template(
        "the 189-point face template (WebMorph, PsychoMorph)", ((0,), (1,)), (170, 171, 172, 173), (96,)
    ),
    # Rings of the lids; base of the nose and bow of the upper lip; inner edge of the upper lip.
    68: Template(
        "the 68-point template (iBUG 300-W)", ((*range(36, 42),), (*range(42, 48),)), (33, 51), (62,)
    ),
}
"""By the number of points, counted from 0."""


@dataclass(frozen=True, eq=False)
class MarkedPoints:
    """Two eyes and a lip as a file gives them: `points` (3, 2) px, y down, the subject's right eye first.

    `lip` says what the third marks, `scheme` how the file was understood, `notes` what a person should know of it.
    """

    points: Points
    lip: Lip
    scheme: str
    notes: tuple[str, ...] = ()


def read_landmarks(path: str | Path) -> Points:
    """Read landmarks (m, 2) px, m >= 1, in the order of the file.

    Raises `BadInput` (another suffix, or a line that is not what was expected, with its number) and `UnreadableFile`
    (missing, empty, not text).
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(f"{path} is no landmark file by its name: it ends in one of {', '.join(SUFFIXES)}")
    lines = _numbered_lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty: landmarks were expected, x and y in each line")
    rows = _rows_of_tem(path, lines) if path.suffix.lower() == ".tem" else _rows_of_table(lines)
    if not rows:
        raise BadInput(f"{path} holds no landmark: x and y were expected in each line")
    return np.array([_point_of(path, number, text) for number, text in rows], np.float64)


def read_landmark_pair(reference: str | Path, frame: str | Path) -> tuple[Points, Points]:
    """Read the landmarks of two pictures, (m, 2) px each. Raises `BadInput` where their counts differ."""
    one, other = read_landmarks(reference), read_landmarks(frame)
    if len(one) != len(other):
        raise BadInput(
            f"{reference} has {len(one)} landmarks, {frame} has {len(other)}: mark the same points in both, "
            "in one order"
        )
    return one, other


def read_marked_points(
    path: str | Path, height: int, *, lip: Lip | None = None, y_axis: YAxis = "auto"
) -> MarkedPoints:
    """Read the eyes and the lip from a landmark file of a picture that is `height` px high.

    `lip` chooses the third point where a template holds both, and says what it is where a file holds three points;
    None takes the philtrum, but the bottom of the upper lip for a `.tem` of three points, WebMorph's own convention.
    A `.tps` whose y are negative, or whose lip is above its eyes, counts y up: it is turned round, which is noted.
    Raises `BadInput` (unknown template, not one specimen) and `UnreadableFile`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    notes: tuple[str, ...] = ()
    if suffix == ".json":
        faceframe = read_faceframe(path)
        points, notes = faceframe.points, faceframe.notes
    elif suffix == ".tps":
        points = _one_specimen(path, read_tps(path))
    elif suffix in SUFFIXES:
        points = read_landmarks(path)
    else:
        raise BadInput(f"{path} is no points file by its name: it ends in .tem, .tps, .csv, .txt or .json")
    three, kind, scheme, on_points = _three_of(path, points, lip)
    down, on_y = _y_down(path, three, height, y_axis)
    ordered, on_eyes = eyes_in_order(down, str(path))
    return MarkedPoints(ordered, kind, scheme, (*notes, *on_points, *on_y, *on_eyes))


def _three_of(path: Path, points: Points, lip: Lip | None) -> tuple[Points, Lip, str, tuple[str, ...]]:
    template = TEMPLATES.get(len(points))
    if template is not None:
        kind: Lip = lip or "philtrum"
        chosen = template.philtrum if kind == "philtrum" else template.upper_lip
        rows = [points[list(places)].mean(axis=0) for places in (*template.eyes, chosen)]
        return np.array(rows), kind, template.name, ()
    is_webmorph = path.suffix.lower() == ".tem"
    if len(points) == 3:
        kind = lip or ("upper-lip" if is_webmorph else "philtrum")
        taken = (
            "the third point is taken for the bottom of the upper lip, as WebMorph has it in a .tem of three"
        )
        notes = (
            (f"{path}: {taken}; if it is the philtrum, give --lip philtrum",)
            if is_webmorph and not lip
            else ()
        )
        return points, kind, "three points", notes
    if len(points) < 3 or is_webmorph or path.suffix.lower() == ".tps":
        known = ", ".join(map(str, sorted(TEMPLATES)))
        raise BadInput(
            f"{path} holds {len(points)} points, templates of 3, {known} are known: write both eyes and the philtrum "
            "into a .csv, x,y in each line"
        )
    note = f"{path} holds {len(points)} points: the first three are taken for both eyes and the {lip or 'philtrum'}"
    return points[:3], lip or "philtrum", "the first three points", (note,)


def _y_down(path: Path, points: Points, height: int, y_axis: YAxis) -> tuple[Points, tuple[str, ...]]:
    """Turn y round where it counts up: about 0 where it is negative, else within the picture."""
    is_negative = bool((points[:, 1] < 0).all())
    is_upside_down = points[2, 1] < points[:2, 1].mean() and not is_negative
    if y_axis == "auto" and (path.suffix.lower() != ".tps" or not (is_negative or is_upside_down)):
        return points, ()
    x, y = points.T
    if is_negative:
        return np.column_stack([x, -y]), (f"{path}: its y are negative and were turned round about 0",)
    said = f"{path}: its y count up and were turned round in the picture's height of {height} px"
    return np.column_stack([x, height - 1 - y]), (said,)


def read_tps(path: str | Path) -> tuple[tuple[str, Points], ...]:
    """Read a `.tps`: for each specimen its name (IMAGE=, else ID=, else its number) and landmarks (m, 2), as written.

    Curves are passed over, SCALE= is left alone: the points are in px. Raises `BadInput` with the line that is wrong.
    """
    path = Path(path)
    lines = _numbered_lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty: LM= and the landmarks were expected")
    specimens: list[tuple[str, Points]] = []
    at = 0
    while at < len(lines):
        number, text = lines[at]
        heading = LANDMARK_HEADING.fullmatch(text)
        if SOLID_HEADING.fullmatch(text):
            raise BadInput(
                f"{path}, line {number}: {_quoted(text)}, landmarks of a picture (LM=) were expected"
            )
        if heading is None:
            raise BadInput(f"{path}, line {number}: {_quoted(text)}, LM= and a count were expected")
        count = int(heading[1])
        points = _points_after(path, number, "landmarks", lines[at + 1 : at + 1 + count], count)
        at, words = _headings(path, lines, at + 1 + count)
        name = words.get("IMAGE") or words.get("ID") or str(len(specimens) + 1)
        specimens.append((name, points))
    return tuple(specimens)


def _headings(path: Path, lines: Lines, at: int) -> tuple[int, dict[str, str]]:
    """Read KEY=value lines up to the next LM=, passing over the points of curves; give the next line's place."""
    words: dict[str, str] = {}
    while at < len(lines):
        number, text = lines[at]
        if LANDMARK_HEADING.fullmatch(text) or SOLID_HEADING.fullmatch(text):
            break
        if not OTHER_HEADING.fullmatch(text):
            raise BadInput(
                f"{path}, line {number}: {_quoted(text)} follows the landmarks that were announced: export it again"
            )
        key, value = text.split("=", 1)
        words[key.strip().upper()] = value.strip()
        at += 1
        if curve := CURVE_HEADING.fullmatch(text):
            _ = _points_after(
                path, number, "points of a curve", lines[at : at + int(curve[1])], int(curve[1])
            )
            at += int(curve[1])
    return at, words


def _points_after(path: Path, number: int, what: str, rows: Lines, count: int) -> Points:
    """Read the `count` points that line `number` announces, (count, 2); `rows` are the lines after it."""
    if len(rows) < count or any(OTHER_HEADING.fullmatch(row) for _, row in rows):
        raise BadInput(f"{path}, line {number}: {count} {what} are announced, fewer follow: export it again")
    return np.array([_point_of(path, line, row) for line, row in rows], np.float64).reshape(count, 2)


def _one_specimen(path: Path, specimens: Sequence[tuple[str, Points]]) -> Points:
    if len(specimens) != 1:
        names = ", ".join(name for name, _ in specimens[:3])
        raise BadInput(
            f"{path} holds {len(specimens)} specimens ({names}...), one was expected: write the one of this face alone"
        )
    return specimens[0][1]


def _numbered_lines(path: Path) -> Lines:
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
        raise BadInput(f"{path}, line {number}: {_quoted(first)}, the count of the landmarks was expected")
    count = int(first)
    rows = list(islice(lines, 1, 1 + count))
    if len(rows) < count:
        raise BadInput(
            f"{path} announces {count} landmarks and holds {len(rows)}: it is cut short, export it again"
        )
    if len(lines) > 1 + count and not COUNT.fullmatch(lines[1 + count][1]):
        number, text = lines[1 + count]
        raise BadInput(
            f"{path}, line {number}: {_quoted(text)} follows the {count} landmarks that were announced, where the "
            "count of its lines was expected; export it again"
        )
    return rows


def _rows_of_table(lines: Lines) -> Lines:
    return lines[1:] if HEADING.fullmatch(lines[0][1]) else lines


def _point_of(path: Path, number: int, text: str) -> tuple[float, float]:
    """Read x and y from line `number` of a file. Raises `BadInput` with the line where it is anything else."""
    words = APART.split(text)
    if not all(map(NUMBER.fullmatch, words)):
        raise BadInput(f"{path}, line {number}: {_quoted(text)}, the numbers x and y were expected")
    values = tuple(map(float, words))
    if len(values) != 2:
        commas = "; a comma stands between numbers here, write decimals with a point" if "," in text else ""
        raise BadInput(f"{path}, line {number}: {len(values)} numbers, 2 were expected, x and y{commas}")
    if not all(map(math.isfinite, values)):
        raise BadInput(f"{path}, line {number}: {_quoted(text)} is not finite: mark this landmark again")
    return values[0], values[1]


def _quoted(text: str) -> str:
    """Give a line for an error, cut where it is long."""
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")
