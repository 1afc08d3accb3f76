"""Face points in the frames of a clip: a table that people look at and correct, or one template a frame (ours).

`data_spec/points-table.md` describes both. A lab corrects points in a spreadsheet, or opens the templates (`.tem`) in
WebMorph beside the pictures. All places are px of the clip's own pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import numpy as np
from annotated_types import Ge

from morphspace.arrays import AnyArray, Points
from morphspace.documents import Digest, Digests, Document, FrameRate, Open, OrNull, Size
from morphspace.errors import BadInput
from morphspace.io.clips import Clip
from morphspace.io.images import picture_names
from morphspace.io.names import composed
from morphspace.io.points import read_landmarks
from morphspace.io.sidecars import MISSING_MARKS
from morphspace.io.tables import FRAME_COLUMN, finite_number, metrics_text
from morphspace.io.texts import Table, read_table
from morphspace.storage import digest_of_bytes, digest_of_file, digest_of_json, json_text, write_texts

TEMPLATE_SUFFIX = ".tem"
PLACE = ("x_px", "y_px")
POSE = ("yaw_deg", "pitch_deg", "roll_deg")
NEEDED = (FRAME_COLUMN, "point", *PLACE)
OPTIONAL = ("z_px", "confidence")
PLACE_DIGITS = 3  # decimals of px; the detector repeats its points to a tenth of a px
CONFIDENCE_DIGITS, POSE_DIGITS = 3, 1
# Of the picture's longer side: points of a face that the picture cuts off lie outside it, by a third of the face.
MOST_OUTSIDE = 0.25


class PointsDocument(TypedDict):
    """The entries of the JSON beside a table of points (data_spec/points-table.md)."""

    format: Literal["morphspace-points"]
    version: Literal[1]
    scheme: str
    point_count: Annotated[int, Ge(1)]
    size: Size
    table_sha256: NotRequired[Digest]
    inputs: NotRequired[Digests]
    identity: NotRequired[OrNull[str]]
    frame_rate_hz: NotRequired[OrNull[FrameRate]]


POINTS = Document(
    "points-table",
    "morphspace points, version 1: the JSON beside the CSV",
    PointsDocument,
    "Write the table again with `morphspace track`",
    marks=(Open(),),
)


@dataclass(frozen=True, eq=False)
class FramePoints:
    """The face points of one frame.

    Attributes
    ----------
    points : array (m, 2) px
    depth : array (m,) px, or None
    confidence : array (m,) in [0, 1], or None
    pose_deg : (yaw, pitch, roll), NaN if unknown
    """

    points: Points
    depth: AnyArray | None = None
    confidence: AnyArray | None = None
    pose_deg: tuple[float, float, float] = (np.nan, np.nan, np.nan)


def write_points_table(
    path: Path, frames: Mapping[str, FramePoints | None], count: int, document: Mapping[str, Any]
) -> None:
    """Write a table of one row for each point of each frame, and its description as JSON beside it.

    Parameters
    ----------
    path : Path
        Ends in `.csv`.
    frames : mapping of names to FramePoints
        None for a frame without a face; its cells are empty.
    count : int
        The number m of points.
    document : mapping
        `scheme`, `size` and more; `format`, `version`, `point_count` and the digest of the table are added.

    Raises
    ------
    BadInput
        If the suffix is another.
    UnwritableFile
        If the folder or disk refuses a file.

    Examples
    --------
    >>> import numpy as np
    >>> two = FramePoints(np.array([[10.0, 20.5], [30.0, 20.25]]))
    >>> write_points_table(Path("p.csv"), {"a": two}, 2, {"scheme": "eyes", "size": [60, 72]})
    >>> Path("p.csv").read_text().splitlines()[:2]
    ['frame,point,x_px,y_px,z_px,confidence,yaw_deg,pitch_deg,roll_deg', 'a,0,10.0,20.5,,,,,']
    """
    unknown = np.full(count, np.nan)
    columns: dict[str, list[Any]] = {name: [] for name in (*NEEDED, *OPTIONAL, *POSE)}
    for name, frame in frames.items():
        found = frame or FramePoints(np.full((count, 2), np.nan))
        columns[FRAME_COLUMN] += [name] * count
        columns["point"] += range(count)
        for heading, values, digits in (
            ("x_px", found.points[:, 0], PLACE_DIGITS),
            ("y_px", found.points[:, 1], PLACE_DIGITS),
            ("z_px", unknown if found.depth is None else found.depth, PLACE_DIGITS),
            ("confidence", unknown if found.confidence is None else found.confidence, CONFIDENCE_DIGITS),
        ):
            columns[heading] += np.round(values, digits).tolist()
        for heading, angle_deg in zip(POSE, found.pose_deg, strict=True):
            columns[heading] += [round(float(angle_deg), POSE_DIGITS)] * count
    text = metrics_text(path, columns)
    ours = {
        "format": POINTS.format,
        "version": 1,
        "point_count": count,
        "table_sha256": digest_of_bytes(text.encode()),
    }
    write_texts({path: text, path.with_suffix(".json"): json_text({**document, **ours})})


def template_files(folder: Path, names: Sequence[str]) -> dict[str, Path]:
    """Return the template file of each frame in a folder, by the frame's name. Raises `BadInput` as `picture_names`.

    Examples
    --------
    >>> template_files(Path("marked"), ["smile/0001"])["smile/0001"].name
    'smile_0001.tem'
    """
    files = picture_names(names)
    return {
        name: folder / f"{file.removesuffix('.png')}{TEMPLATE_SUFFIX}"
        for name, file in zip(names, files, strict=True)
    }


def template_text(points: Points) -> str:
    """Return points (m, 2) px as a template of WebMorph without connecting lines.

    Examples
    --------
    >>> import numpy as np
    >>> template_text(np.array([[1.0, 2.5]]))
    '1\\n1.0\\t2.5\\n0\\n'
    """
    rows = [f"{x}\t{y}" for x, y in np.round(points, PLACE_DIGITS).tolist()]
    return "\n".join([str(len(rows)), *rows, "0", ""])


def read_points(path: Path, clip: Clip, scheme: str, count: int) -> tuple[dict[str, FramePoints], str]:
    """Read the points of some frames of a clip from a table (.csv) or a folder of templates (.tem).

    Parameters
    ----------
    path : Path
    clip : Clip
    scheme : str
        The meaning of the points.
    count : int
        The number m of points.

    Returns
    -------
    frames : dict of names to FramePoints
        The frames with points, in the order of the clip.
    digest : str
        SHA-256 of the file; of a folder, of the names and digests of its templates.

    Raises
    ------
    UnreadableFile
        If a file cannot be read.
    BadInput
        If the points are not those of this clip: frames or pictures of another, other numbers of points, places
        outside the pictures, or cells that are not numbers; the message names the row or the point.

    Examples
    --------
    >>> from morphspace.io.clips import open_clip
    >>> _ = Path("p.csv").write_text("frame,point,x_px,y_px\\nframe_001,0,20,30.5\\n")
    >>> frames, _ = read_points(Path("p.csv"), open_clip(["anna"]), "one", 1)
    >>> frames["frame_001"].points.tolist()
    [[20.0, 30.5]]
    """
    if path.is_dir():
        found, digest = _read_templates(path, clip, count)
    else:
        if path.suffix.lower() != ".csv":
            raise BadInput(
                f"{path} is no table by its name; expected .csv, or a folder of {TEMPLATE_SUFFIX} files"
            )
        beside = path.with_suffix(".json")
        inputs = _checked_inputs(beside, clip, scheme) if beside.exists() else {}
        found, digest = _read_rows(read_table(path), clip, count), digest_of_file(path)
        _check_pictures(beside, clip, {name: inputs[name] for name in found if name in inputs})
    if not found:
        raise BadInput(f"{path} holds no points; expected those of one frame at least. Mark a frame")
    return {name: found[name] for name in map(composed, clip.frame_names) if name in found}, digest


def _read_templates(folder: Path, clip: Clip, count: int) -> tuple[dict[str, FramePoints], str]:
    files = sorted(
        file
        for file in folder.iterdir()
        if file.suffix.lower() == TEMPLATE_SUFFIX and not file.name.startswith(".")
    )
    if not files:
        raise BadInput(
            f"{folder} holds no {TEMPLATE_SUFFIX} file; expected one for each frame. Check the name"
        )
    known = {composed(file.stem): name for name, file in template_files(folder, clip.frame_names).items()}
    found = {}
    for file in files:
        name = known.get(composed(file.stem))
        if name is None:
            raise BadInput(f"{file} {_of_no_frame(file.stem, clip)}")
        points = read_landmarks(file, "Mark it, or remove the file")
        if len(points) != count:
            raise BadInput(f"{file} has {len(points)} points; expected {count}. Mark all, or remove the file")
        outside = np.flatnonzero(_far_outside(points, clip))
        if len(outside):
            raise BadInput(f"{file}: point {outside[0]} {_outside_words(points[outside[0]], clip)}")
        found[composed(name)] = FramePoints(points)
    return found, digest_of_json({file.name: digest_of_file(file) for file in files})


def _read_rows(table: Table, clip: Clip, count: int) -> dict[str, FramePoints]:
    path, columns = table.path, {heading: place for place, heading in enumerate(table.headings)}
    for heading in NEEDED:
        if heading not in columns:
            raise BadInput(f"{path} has no column {heading}; expected {', '.join(NEEDED)}. Rename or add it")
    names = set(map(composed, clip.frame_names))
    read = [heading for heading in (*PLACE, *OPTIONAL) if heading in columns]
    values: dict[str, AnyArray] = {}
    rows: dict[tuple[str, int], int] = {}
    for line, row in zip(table.lines, table.rows, strict=True):
        name = composed(row[columns[FRAME_COLUMN]].strip())
        if name not in names:
            raise BadInput(f"{path} line {line} {_of_no_frame(name, clip)}")
        cell = row[columns["point"]].strip()
        if not (cell.isascii() and cell.isdigit() and int(cell) < count):
            raise BadInput(f"{path} line {line}: point is {cell!r}; expected 0 to {count - 1}. Correct it")
        point = int(cell)
        if (name, point) in rows:
            raise BadInput(
                f"{path} line {line}: point {point} of frame {name} is also in line {rows[name, point]}; expected one "
                "row for each. Remove one"
            )
        rows[name, point] = line
        for heading in read:
            cell = row[columns[heading]].strip()
            if cell:
                number = finite_number(path, line, heading, cell)
                values.setdefault(name, np.full((count, 4), np.nan))[
                    point, (*PLACE, *OPTIONAL).index(heading)
                ] = number
    return {
        name: frame
        for name, found in values.items()
        if (frame := _frame_of(path, name, found, rows, clip)) is not None
    }


def _frame_of(
    path: Path, name: str, values: AnyArray, rows: Mapping[tuple[str, int], int], clip: Clip
) -> FramePoints | None:
    """Check the values (m, 4) of a frame: x, y, depth and confidence. Return None if no point has a place."""
    points, count = values[:, :2], len(values)
    is_known = np.isfinite(points)
    if not is_known.any():
        return None
    lost = np.flatnonzero(~is_known.all(axis=1))
    if len(lost):
        place = f"line {rows[name, lost[0]]}" if (name, lost[0]) in rows else "no row"
        raise BadInput(
            f"{path}: frame {name} has {count - len(lost)} points; expected {count}, or none to have the face "
            f"searched. Point {lost[0]} is missing ({place}). Mark it, or empty the cells of the frame"
        )
    outside = np.flatnonzero(_far_outside(points, clip))
    if len(outside):
        point = outside[0]
        raise BadInput(
            f"{path} line {rows[name, point]}: point {point} of frame {name} {_outside_words(points[point], clip)}"
        )
    depth, confidence = (one if np.isfinite(one).all() else None for one in values[:, 2:].T)
    wrong = np.flatnonzero((values[:, 3] < 0) | (values[:, 3] > 1))
    if len(wrong):
        line, found = rows[name, wrong[0]], values[wrong[0], 3]
        raise BadInput(f"{path} line {line}: confidence is {found:g}; expected 0 to 1. Correct it")
    return FramePoints(points, depth, confidence)


def _far_outside(points: Points, clip: Clip) -> AnyArray:
    """Return which points (m, 2) px lie far outside the pictures, or where programs put missing ones: (m,) bool."""
    width, height = clip.size
    most_px = MOST_OUTSIDE * max(width, height)
    outside = (points < -most_px) | (points > np.array([width, height]) - 1 + most_px)
    missing = [(points == mark).all(axis=1) for mark in MISSING_MARKS]
    out: AnyArray = np.any([outside.any(axis=1), *missing], axis=0)
    return out


def _outside_words(point: Points, clip: Clip) -> str:
    width, height = clip.size
    return (
        f"is at {point[0]:g},{point[1]:g}; expected a place in its picture of {width}x{height} px. Mark it, or leave "
        "the points of this frame out"
    )


def _of_no_frame(name: str, clip: Clip) -> str:
    names = clip.frame_names
    return f"is of frame {name!r}; expected one of {clip.name}, {names[0]} to {names[-1]}. Give points of this clip"


def _checked_inputs(beside: Path, clip: Clip, scheme: str) -> dict[str, str]:
    """Read the JSON beside a table; check scheme and size. Return the digest of each picture by its frame's name."""
    document, table = POINTS.read(beside), beside.with_suffix(".csv").name
    if document["scheme"] != scheme:
        raise BadInput(
            f"{beside}: the points of {table} are {document['scheme']}; expected {scheme}, whose points lie elsewhere. "
            "Find them again with `morphspace track`"
        )
    if tuple(document["size"]) != clip.size:
        shown, expected = ("x".join(map(str, size)) for size in (document["size"], clip.size))
        raise BadInput(
            f"{beside}: the points of {table} were found in pictures of {shown} px; expected {expected}, the size of "
            f"{clip.name}. Give points of this clip"
        )
    return {composed(name): digest for name, digest in document.get("inputs", {}).items()}


def _check_pictures(beside: Path, clip: Clip, inputs: Mapping[str, str]) -> None:
    """Check that the pictures of frames with points are still those whose digests are known."""
    for name, digest in zip(map(composed, clip.frame_names), clip.digests() if inputs else (), strict=False):
        if inputs.get(name, digest) != digest:
            raise BadInput(
                f"{beside}: frame {name} of {beside.with_suffix('.csv').name} was another picture; expected that of "
                f"{clip.name}. Give points of this clip, or remove {beside.name} if the face has not moved"
            )
