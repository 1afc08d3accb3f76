"""Where the three points of a face stand in the landmark files that other programs write.

`.tem` (WebMorph, PsychoMorph), `.tps` (tpsDig, geomorph, webmorphR), `.csv` and `.txt`, and our own faceframe (.json).
How many points a file holds tells which template it is; TEMPLATES says which of its points surround the eyes and the
lip. Which eye is the subject's right is not decided here, since programs number them either way.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from morphspace.arrays import Points
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.points import SUFFIXES, Lines, numbered_lines, point_of, quoted, read_landmarks
from morphspace.io.sidecars import read_faceframe

LipName: TypeAlias = Literal["philtrum", "upper-lip"]
YAxis: TypeAlias = Literal["auto", "up"]
"""Which way y counts in a file: `auto` goes by the file, `up` turns it round."""

LANDMARK_HEADING = re.compile(r"LM\s*=\s*(\d{1,9})", re.IGNORECASE)
SOLID_HEADING = re.compile(r"LM3\s*=.*", re.IGNORECASE)
CURVE_HEADING = re.compile(r"POINTS\s*=\s*(\d{1,9})", re.IGNORECASE)
OTHER_HEADING = re.compile(r"[A-Za-z_]\w*\s*=.*")


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
    """Two eyes and a lip as a file gives them: `points` (3, 2) px, y down, eyes in the file's order.

    `lip` says what the third marks, `scheme` how the file was understood, `notes` what a person should know of it.
    """

    points: Points
    lip: LipName
    scheme: str
    notes: tuple[str, ...] = ()


def read_marked_points(
    path: str | Path, height: int, *, lip: LipName | None = None, y_axis: YAxis = "auto"
) -> MarkedPoints:
    """Read the eyes and the lip from a landmark file of a picture that is `height` px high.

    `lip` chooses the third point where a template holds both, and says what it is where a file holds three points;
    None takes the philtrum, but the bottom of the upper lip for a `.tem` of three points, WebMorph's own convention.
    A `.tps` whose y are negative, or whose lip is above its eyes, counts y up: it is turned round, which is noted.
    Raises `BadInput` (unknown template, not one specimen) and `UnreadableFile`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".json":
        points = np.array(read_faceframe(path).points)
    elif suffix == ".tps":
        points = _one_specimen(path, read_tps(path))
    elif suffix in SUFFIXES:
        points = read_landmarks(path)
    else:
        raise BadInput(f"{path} is no points file by its name: it ends in .tem, .tps, .csv, .txt or .json")
    three, kind, scheme, notes = _three_of(path, points, lip)
    turned, note = _y_down(path, three, height, y_axis)
    return MarkedPoints(turned, kind, scheme, notes + note)


def _three_of(
    path: Path, points: Points, lip: LipName | None
) -> tuple[Points, LipName, str, tuple[str, ...]]:
    template = TEMPLATES.get(len(points))
    if template is not None:
        kind: LipName = lip or "philtrum"
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
    lines = numbered_lines(path)
    if not lines:
        raise UnreadableFile(f"{path} is empty: LM= and the landmarks were expected")
    specimens: list[tuple[str, Points]] = []
    at = 0
    while at < len(lines):
        number, text = lines[at]
        heading = LANDMARK_HEADING.fullmatch(text)
        if SOLID_HEADING.fullmatch(text):
            raise BadInput(
                f"{path}, line {number}: {quoted(text)}, landmarks of a picture (LM=) were expected"
            )
        if heading is None:
            raise BadInput(f"{path}, line {number}: {quoted(text)}, LM= and a count were expected")
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
                f"{path}, line {number}: {quoted(text)} follows the landmarks that were announced: export it again"
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
    return np.array([point_of(path, line, row) for line, row in rows], np.float64).reshape(count, 2)


def _one_specimen(path: Path, specimens: Sequence[tuple[str, Points]]) -> Points:
    if len(specimens) != 1:
        names = ", ".join(name for name, _ in specimens[:3])
        raise BadInput(
            f"{path} holds {len(specimens)} specimens ({names}...), one was expected: write the one of this face alone"
        )
    return specimens[0][1]
