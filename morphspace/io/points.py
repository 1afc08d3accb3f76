"""Landmark files: points marked in an image, and the three of them that register a face.

`.tem` (WebMorph, PsychoMorph): the number of points, one line x y for each, then the lines that connect them, which
are ignored. `.tps` (tpsDig, geomorph, webmorphR): `LM=` and the number, then one line x y for each. `.csv` and
`.txt`: one line x y for each, separated by a comma, a semicolon or blanks; a heading (x, y) is allowed. All are in px
of the image: pixel centres are integers, and y points down except in some `.tps`.

`read_landmarks` returns all points. `read_marked_points` returns the eyes and the lip, from these files or from a
faceframe file (.json). The number of points identifies the template; TEMPLATES lists which of its points surround the
eyes and the lip.

Programs mark a missing landmark by -1,-1, by 0,0, or by NaN or NA. All readers refuse it with its number, counted from
1: an eye centre must not be the mean of lids and a corner of the picture.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.limits import POINTS_BYTES
from morphspace.io.sidecars import MISSING_MARKS, eyes_in_order, read_faceframe
from morphspace.io.texts import check_not_separator_line, read_text

Lip: TypeAlias = Literal["philtrum", "upper-lip"]
"""The third point: the centre of the philtrum (Nagle), or the lower edge of the upper lip (WebMorph)."""
YAxis: TypeAlias = Literal["auto", "up"]
"""The direction of y in a file: `auto` derives it from the file, `up` flips it."""

LANDMARK_HEADING = re.compile(r"LM\s*=\s*(\d{1,9})", re.IGNORECASE)
SOLID_HEADING = re.compile(r"LM3\s*=.*", re.IGNORECASE)
CURVE_HEADING = re.compile(r"POINTS\s*=\s*(\d{1,9})", re.IGNORECASE)
OTHER_HEADING = re.compile(r"[A-Za-z_]\w*\s*=.*")

SUFFIXES = (".tem", ".csv", ".txt")
HEADING = re.compile(r"\W*x(_px)?\W+y(_px)?\W*", re.IGNORECASE)
COUNT = re.compile(r"\d{1,9}", re.ASCII)
APART = re.compile(r"\s*[,;]\s*|\s+")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE | re.ASCII)
MISSING_WORD = re.compile(r"[+-]?(nan|inf(inity)?)|n/?a|none|null", re.IGNORECASE | re.ASCII)
NO_TEXT = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f-\x9f]")  # without 1a, which ends a DOS text
EMPTY_CELLS = " \t,;"
EYES_ALONE = "Mark it again, or give both eyes and the philtrum in a .csv, x,y in each line"
LISTED = 5  # landmarks; a message lists no more
BLANKS = " \t\v\f\x1a"
LINE_END = re.compile(r"\r\n|\r|\n")
QUOTED = 40  # characters of a line in a message

Lines: TypeAlias = list[tuple[int, str]]
"""The lines of a file and their numbers, without empty lines and remarks (#)."""


@dataclass(frozen=True)
class Template:
    """The points of a landmark template to average for each eye, the philtrum and the lower edge of the upper lip."""

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
"""The key is the number of points; points count from 0."""


@dataclass(frozen=True, eq=False)
class MarkedPoints:
    """Two eyes and a lip, read from a landmark file.

    Attributes
    ----------
    points : array (3, 2) px
        The subject's right eye, left eye, lip; y points down.
    lip : "philtrum" or "upper-lip"
    scheme : str
        How the file was interpreted.
    notes : tuple of str
        Assumptions and changes that the user should check.
    """

    points: Points
    lip: Lip
    scheme: str
    notes: tuple[str, ...] = ()


def read_landmarks(path: str | Path, remedy: str = EYES_ALONE) -> Points:
    """Read landmarks (m, 2) px, m >= 1, in the order of the file; `remedy` says what to do about a missing one.

    Raises
    ------
    BadInput
        If the suffix is another, a landmark is missing, or a line is not as expected; the message quotes the line
        and its number.
    UnreadableFile
        If the file is missing, empty or not a text.

    Examples
    --------
    >>> _ = Path("two.tem").write_text("2\\n10 20\\n30 20.5\\n0\\n")
    >>> read_landmarks("two.tem").tolist()
    [[10.0, 20.0], [30.0, 20.5]]
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(
            f"{path} is not a landmark file by its name; expected {', '.join(SUFFIXES)}. Rename it"
        )
    lines = _numbered_lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty; expected landmarks, x and y in each line. Export it again")
    rows = _rows_of_tem(path, lines) if path.suffix.lower() == ".tem" else _rows_of_table(path, lines)
    if not rows:
        raise BadInput(f"{path} holds no landmark; expected x and y in each line. Export it again")
    return _points_of(path, rows, remedy)


def read_landmark_pair(reference: str | Path, frame: str | Path) -> tuple[Points, Points]:
    """Read the landmarks of two images, (m, 2) px each. Raises `BadInput` if their numbers differ.

    Examples
    --------
    >>> _ = Path("a.csv").write_text("x,y\\n1,2\\n3,4\\n")
    >>> _ = Path("b.csv").write_text("x,y\\n1,3\\n3,5\\n")
    >>> first, second = read_landmark_pair("a.csv", "b.csv")
    >>> (second - first).tolist()
    [[0.0, 1.0], [0.0, 1.0]]
    """
    one, other = read_landmarks(reference), read_landmarks(frame)
    if len(one) != len(other):
        raise BadInput(
            f"{reference} has {len(one)} landmarks, {frame} has {len(other)}; expected equal numbers. Mark the same "
            "points in both, in one order"
        )
    return one, other


def read_marked_points(
    path: str | Path, size: tuple[int, int], *, lip: Lip | None = None, y_axis: YAxis = "auto"
) -> MarkedPoints:
    """Read the eyes and the lip from a landmark file of an image of `size`.

    Parameters
    ----------
    path : str or Path
    size : (width, height) px
    lip : "philtrum", "upper-lip" or None
        Which third point to take from a template that has both, or the meaning of the third of three points. None is
        the philtrum, but in a `.tem` of three points, by WebMorph's convention, the lower edge of the upper lip.
    y_axis : "auto" or "up"
        "auto" flips y of a `.tps` if y is negative or the lip lies above the eyes; a note says so. "up" always flips.

    Returns
    -------
    MarkedPoints

    Raises
    ------
    BadInput
        If the template is unknown, a `.tps` does not hold exactly one specimen, or a landmark is missing or lies
        outside the image.
    UnreadableFile
        If the file is missing, empty or not a text.

    Examples
    --------
    >>> _ = Path("eyes.csv").write_text("x,y\\n20,30\\n40,30\\n30,46\\n")
    >>> read_marked_points("eyes.csv", (60, 72)).points.tolist()
    [[20.0, 30.0], [40.0, 30.0], [30.0, 46.0]]
    """
    path = Path(path)
    suffix = path.suffix.lower()
    notes: tuple[str, ...] = ()
    if suffix == ".json":
        faceframe = read_faceframe(path)
        points, notes = faceframe.points, faceframe.notes
    elif suffix == ".tps":
        points = _one_specimen(path, _read_tps(path))
    elif suffix in SUFFIXES:
        points = read_landmarks(path)
    else:
        raise BadInput(
            f"{path} is not a points file by its name; expected .tem, .tps, .csv, .txt or .json. Rename it"
        )
    three, kind, scheme, on_points = _three_of(path, points, lip)
    turn, on_y = _turn_of_y(path, three, size[1], y_axis)
    down, outside = turn(three), _outside(turn(points), size)
    is_missing = len(points) > 3 and 2 * outside.sum() < len(
        points
    )  # -999 draws an eye's centre out of the image
    if (
        is_missing or not _outside(down, size).any()
    ):  # else the line about the eye says how to turn the points
        check_inside(path, turn(points), size, "the image", EYES_ALONE)
    ordered, on_eyes = eyes_in_order(down, str(path))
    return MarkedPoints(ordered, kind, scheme, (*notes, *on_points, *on_y, *on_eyes))


def _three_of(path: Path, points: Points, lip: Lip | None) -> tuple[Points, Lip, str, tuple[str, ...]]:
    """Return eyes and lip (3, 2), the meaning of the lip, the name of the template and notes."""

    template = TEMPLATES.get(len(points))
    if template is not None:
        kind: Lip = lip or "philtrum"
        chosen = template.philtrum if kind == "philtrum" else template.upper_lip
        rows = [points[list(places)].mean(axis=0) for places in (*template.eyes, chosen)]
        return np.array(rows), kind, template.name, ()
    is_webmorph = path.suffix.lower() == ".tem"
    if len(points) == 3:
        kind = lip or ("upper-lip" if is_webmorph else "philtrum")
        taken = "the third point is taken as the lower edge of the upper lip, WebMorph's convention for three points"
        notes = (
            (f"{path}: {taken}. If it is the philtrum, add --lip philtrum",)
            if is_webmorph and not lip
            else ()
        )
        return points, kind, "three points", notes
    if len(points) < 3 or is_webmorph or path.suffix.lower() == ".tps":
        known = ", ".join(map(str, sorted(TEMPLATES)))
        raise BadInput(
            f"{path} holds {len(points)} points; expected a template of 3, {known}. Write both eyes and the philtrum "
            "to a .csv, x,y in each line"
        )
    note = f"{path} holds {len(points)} points: the first three are taken as both eyes and the {lip or 'philtrum'}"
    return points[:3], lip or "philtrum", "the first three points", (note,)


def _turn_of_y(
    path: Path, points: Points, height: int, y_axis: YAxis
) -> tuple[Callable[[Points], Points], tuple[str, ...]]:
    """Return a function that makes y of points count down, and notes.

    It flips y that points up: about 0 if y is negative in all points, else within the image.
    """
    is_negative = bool((points[:, 1] < 0).all())
    is_upside_down = points[2, 1] < points[:2, 1].mean() and not is_negative
    if y_axis == "auto" and (path.suffix.lower() != ".tps" or not (is_negative or is_upside_down)):
        return lambda given: given, ()
    if is_negative:
        return lambda given: given * (1, -1), (f"{path}: y is negative and was flipped about 0",)
    note = f"{path}: y points up and was flipped within the image height of {height} px"
    return lambda given: np.column_stack([given[:, 0], height - 1 - given[:, 1]]), (note,)


def _outside(points: Points, size: tuple[int, int]) -> AnyArray:
    beyond: AnyArray = (points < -0.5) | (points > np.array(size) - 0.5)
    return np.asarray(beyond.any(axis=1))


def check_inside(path: Path, points: Points, size: tuple[int, int], picture: str, remedy: str) -> None:
    """Check that landmarks (m, 2) px lie inside the picture of `size` (w, h) px on which they were marked.

    Raises `BadInput`, which numbers those outside from 1: programs also write such places for missing ones.
    """
    places = (np.flatnonzero(_outside(points, size)) + 1).tolist()
    if not places:
        return
    x, y = points[places[0] - 1].tolist()
    some = ", ".join(map(str, places[:LISTED]))
    more = f" and {len(places) - LISTED} more" if len(places) > LISTED else ""
    which = f"landmark {some} of {len(points)} lies"
    if len(places) > 1:
        which = f"landmarks {some}{more} of {len(points)} lie"
    raise BadInput(
        f"{path}: {which} outside {picture}, the first at {x:g},{y:g}; expected places inside its "
        f"{size[0]}x{size[1]} px. {remedy}"
    )


def _read_tps(path: str | Path) -> tuple[tuple[str, Points], ...]:
    """Read a `.tps`: for each specimen its name and landmarks (m, 2) px, y as written.

    The name is IMAGE=, else ID=, else the number of the specimen. Curves and SCALE= are ignored: points are in px.
    Raises `BadInput`, with the line at fault, and `UnreadableFile`.
    """
    path = Path(path)
    lines = _numbered_lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty; expected LM= and the landmarks. Export it again")
    specimens: list[tuple[str, Points]] = []
    at = 0
    while at < len(lines):
        number, text = lines[at]
        heading = LANDMARK_HEADING.fullmatch(text)
        if SOLID_HEADING.fullmatch(text):
            raise BadInput(
                f"{path}, line {number} is {_quoted(text)}; expected landmarks of an image (LM=). Export them in 2D"
            )
        if heading is None:
            raise BadInput(
                f"{path}, line {number} is {_quoted(text)}; expected LM= and a number. Export it again"
            )
        count = int(heading[1])
        points = _points_after(path, number, "landmarks", lines[at + 1 : at + 1 + count], count)
        at, words = _headings(path, lines, at + 1 + count)
        name = words.get("IMAGE") or words.get("ID") or str(len(specimens) + 1)
        specimens.append((name, points))
    return tuple(specimens)


def _headings(path: Path, lines: Lines, at: int) -> tuple[int, dict[str, str]]:
    """Read KEY=value lines up to the next LM=, without the points of curves; return the next index and them."""
    words: dict[str, str] = {}
    while at < len(lines):
        number, text = lines[at]
        if LANDMARK_HEADING.fullmatch(text) or SOLID_HEADING.fullmatch(text):
            break
        if not OTHER_HEADING.fullmatch(text):
            raise BadInput(
                f"{path}, line {number} is {_quoted(text)}; expected no more landmarks than LM= declares. Export "
                "it again"
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
    """Read the `count` points (count, 2) that line `number` declares; `rows` are the lines after it."""
    if len(rows) < count or any(OTHER_HEADING.fullmatch(row) for _, row in rows):
        raise BadInput(
            f"{path}, line {number} declares {count} {what}; expected as many, found fewer. Export it again"
        )
    return _points_of(path, rows)


def _one_specimen(path: Path, specimens: Sequence[tuple[str, Points]]) -> Points:
    if len(specimens) != 1:
        names = ", ".join(name for name, _ in specimens[:3])
        raise BadInput(
            f"{path} holds {len(specimens)} specimens ({names}...); expected one. Export this face alone"
        )
    return specimens[0][1]


def _numbered_lines(path: Path) -> Lines:
    """Read the lines of a landmark file that are neither empty nor remarks. Raise `UnreadableFile` if it is not a text.

    Older programs write the name of an image in Latin-1: a file that is not UTF-8 is read as Latin-1.
    """
    text = read_text(path, POINTS_BYTES, otherwise="latin-1")
    if NO_TEXT.search(text):
        raise UnreadableFile(f"{path} is not a text in UTF-8 or Latin-1. Export the landmarks as plain text")
    lines = ((number, line.strip(BLANKS)) for number, line in enumerate(LINE_END.split(text), start=1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def _rows_of_tem(path: Path, lines: Lines) -> Lines:
    """Return the lines of the points of a `.tem`. Check that only its list of connecting lines follows them."""
    number, first = lines[0]
    if not COUNT.fullmatch(first):
        raise BadInput(
            f"{path}, line {number} is {_quoted(first)}; expected the number of landmarks. Export it again"
        )
    count = int(first)
    rows = list(islice(lines, 1, 1 + count))
    if len(rows) < count:
        raise BadInput(
            f"{path} is cut short: it holds {len(rows)} landmarks; expected {count}. Export it again"
        )
    if len(lines) > 1 + count and not COUNT.fullmatch(lines[1 + count][1]):
        number, text = lines[1 + count]
        raise BadInput(
            f"{path}, line {number} is {_quoted(text)}; expected the number of lines after the {count} landmarks. "
            "Export it again"
        )
    return rows


def _rows_of_table(path: Path, lines: Lines) -> Lines:
    """Return the lines of the points of a table, without its heading, empty columns, and empty rows around them.

    A row of empty cells between landmarks stays: it is one that is missing.
    """
    check_not_separator_line(path, lines[0][1])
    bare = [(number, line.strip(EMPTY_CELLS)) for number, line in lines]
    filled = [place for place, (_, line) in enumerate(bare) if line]
    rows = bare[filled[0] : filled[-1] + 1] if filled else []
    return rows[1:] if rows and HEADING.fullmatch(rows[0][1]) else rows


def _points_of(path: Path, rows: Lines, remedy: str = EYES_ALONE) -> Points:
    """Read one landmark (m, 2) px from each line. Raise `BadInput`, which gives its number, if one is missing."""
    points = [_point_of(path, line, text, place, remedy) for place, (line, text) in enumerate(rows, start=1)]
    return np.array(points, np.float64).reshape(len(points), 2)


def _point_of(path: Path, number: int, text: str, place: int, missing: str) -> tuple[float, float]:
    """Read x and y from line `number`. Raise `BadInput`, which quotes it, if it is not a place."""
    words = APART.split(text)
    if text and not all(NUMBER.fullmatch(word) or MISSING_WORD.fullmatch(word) for word in words):
        raise BadInput(f"{path}, line {number} is {_quoted(text)}; expected the numbers x and y. Correct it")
    if text and len(words) != 2:
        remedy = "Write decimals with a point: commas separate numbers" if "," in text else "Correct it"
        raise BadInput(f"{path}, line {number} has {len(words)} numbers; expected 2, x and y. {remedy}")
    is_missing = not text or any(map(MISSING_WORD.fullmatch, words))
    values = (0.0, 0.0) if is_missing else (float(words[0]), float(words[1]))
    if values in MISSING_MARKS or not all(map(math.isfinite, values)):
        raise BadInput(
            f"{path}, line {number}: landmark {place} is {_quoted(text)}, which marks it as missing; expected a "
            f"place in the image. {missing}"
        )
    return values


def _quoted(text: str) -> str:
    """Quote a line for a message, shortened if it is long."""
    return repr(text if len(text) <= QUOTED else text[:QUOTED] + "...")
