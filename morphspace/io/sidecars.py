"""What travels beside pictures: who is shown, how fast, with what consent, and where the faceframe lies.

`data_spec/clip-folder.md` describes `clip.json`, `data_spec/faceframe.md` the faceframe file. Keys that are
not ours are kept as they are, so that a lab can add its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Points
from morphspace.errors import BadInput, UnreadableFile
from morphspace.storage import json_text, write_text

FACEFRAME_FORMAT = "morphspace-faceframe"
FACEFRAME_VERSION = 1
WRITE_POINTS = (
    "give a faceframe file (data_spec/faceframe.md), or write both eyes and the philtrum into a .csv, x,y in each "
    "line"
)
POINT_NAMES = ("right_eye", "left_eye", "philtrum")
TEXT_KEYS = ("identity", "consent", "licence")


def eyes_in_order(points: Points, origin: str) -> tuple[Points, tuple[str, ...]]:
    """Put the two eyes of three marked points in order: the subject's right eye first.

    In an upright face the subject's right eye is on the picture's left, and programs number the eyes either way. So x
    decides for every reader, whatever the order or the names in a file.

    Parameters
    ----------
    points
        (3, 2) px: two eyes and the philtrum or lip.
    origin
        Names the points in messages.

    Returns
    -------
    The points (3, 2) float64, a new array; and a note where the eyes were exchanged.

    Raises
    ------
    BadInput
        The points are not three finite pairs, or the eyes have the same x.
    """
    points = np.array(points, np.float64)
    if points.shape != (3, 2) or not np.isfinite(points).all():
        raise BadInput(f"{origin}: the three points are not three finite pairs x,y: mark them again")
    if (points[0] == points[1]).all():
        raise BadInput(f"{origin}: both eyes are at {points[0, 0]:g},{points[0, 1]:g}: mark them again")
    if points[0, 0] == points[1, 0]:
        raise BadInput(
            f"{origin}: both eyes are at x {points[0, 0]:g}, one above the other: mark them again, or turn the picture "
            "upright"
        )
    if points[0, 0] < points[1, 0]:
        return points, ()
    note = f"{origin}: the eyes were exchanged, since the subject's right eye is on the picture's left"
    return points[[1, 0, 2]], (note,)


@dataclass(frozen=True, eq=False)
class MarkedFaceframe:
    """Three points marked in one image: `points` (3, 2) px, the rows right eye, left eye, philtrum.

    `image` names the picture they were marked in, `size` is its (width, height) px, or None where it is not
    recorded. The eyes are put in order by `eyes_in_order`; `notes` say so. Raises `BadInput` as that does, and for
    points outside the picture.
    """

    image: str
    points: Points
    size: tuple[int, int] | None = None
    notes: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        points, notes = eyes_in_order(self.points, f"the faceframe of {self.image}")
        object.__setattr__(self, "notes", notes)
        if self.size is not None:
            outside = ((points < -0.5) | (points > np.array(self.size) - 0.5)).any(axis=1)
            if outside.any():
                first = int(outside.argmax())
                x, y = points[first].tolist()
                raise BadInput(
                    f"the {POINT_NAMES[first]} of the faceframe of {self.image}, {x:g},{y:g}, lies outside its picture "
                    f"of {self.size[0]} x {self.size[1]} pixels: mark it again on this picture"
                )
        points.setflags(write=False)
        object.__setattr__(self, "points", points)


@dataclass(frozen=True, eq=False)
class Sidecar:
    """What `clip.json` tells about a clip; each entry is None where it is not told, `extra` holds the other
    keys.
    """

    identity: str | None = None
    frame_rate_hz: float | None = None
    consent: str | None = None
    licence: str | None = None
    faceframe: MarkedFaceframe | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


def read_sidecar(path: str | Path) -> Sidecar:
    """Read a `clip.json`. Raises `UnreadableFile` (not JSON) and `BadInput` (an entry of the wrong kind)."""
    path = Path(path)
    document = dict(read_json_object(path))
    texts = {key: document.pop(key, None) for key in TEXT_KEYS}
    for key, text in texts.items():
        if not (text is None or isinstance(text, str)):
            raise BadInput(f"{path}: {key} is {text!r}, a text was expected")
    rate_hz = document.pop("frame_rate_hz", None)
    if rate_hz is not None and not (_is_number(rate_hz) and rate_hz > 0):
        raise BadInput(f"{path}: frame_rate_hz is {rate_hz!r}, a number above 0 was expected")
    faceframe = document.pop("faceframe", None)
    return Sidecar(
        identity=texts["identity"],
        frame_rate_hz=None if rate_hz is None else float(rate_hz),
        consent=texts["consent"],
        licence=texts["licence"],
        faceframe=None if faceframe is None else _faceframe_of(path, faceframe, "frame"),
        extra=document,
    )


def write_sidecar(path: str | Path, sidecar: Sidecar) -> None:
    """Write a `clip.json`, whole or not at all; what is None is left out. Raises `UnwritableFile`."""
    document = dict(sidecar.extra)
    for key in (*TEXT_KEYS, "frame_rate_hz"):
        if getattr(sidecar, key) is not None:
            document[key] = getattr(sidecar, key)
    if sidecar.faceframe is not None:
        document["faceframe"] = {"frame": sidecar.faceframe.image, **_point_entries(sidecar.faceframe)}
    write_text(Path(path), json_text(document))


def read_faceframe(path: str | Path) -> MarkedFaceframe:
    """Read a faceframe file. Raises `UnreadableFile` and `BadInput` (format, version, points)."""
    path = Path(path)
    document = read_json_object(path)
    check_format(path, document, FACEFRAME_FORMAT, FACEFRAME_VERSION, WRITE_POINTS)
    return _faceframe_of(path, document, "image")


def write_faceframe(path: str | Path, faceframe: MarkedFaceframe) -> None:
    """Write a faceframe file, whole or not at all. Raises `UnwritableFile`."""
    document: dict[str, Any] = {
        "format": FACEFRAME_FORMAT,
        "version": FACEFRAME_VERSION,
        "image": faceframe.image,
        **_point_entries(faceframe),
    }
    if faceframe.size is not None:
        document["size"] = [int(side) for side in faceframe.size]
    write_text(Path(path), json_text(document))


def read_json_object(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises `UnreadableFile` where the file is missing or is not one."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    except (ValueError, RecursionError) as error:
        raise UnreadableFile(f"{path} is not JSON: {error}; mend it or write it again") from error
    if not isinstance(document, dict):
        raise UnreadableFile(
            f"{path} holds a JSON {type(document).__name__}, an object in braces was expected"
        )
    return document


def check_format(
    path: Path,
    document: Mapping[str, Any],
    name: str,
    version: int,
    instead: str = "give a file of that format",
) -> None:
    """Refuse another format, for which `instead` says what to do, and a version newer than this program knows.

    Raises `BadInput`.
    """
    if document.get("format") != name:
        raise BadInput(f"{path} has the format {document.get('format')!r}, {name!r} was expected: {instead}")
    found = document.get("version")
    if found != version:
        raise BadInput(
            f"{path} has version {found!r} of {name}, this program reads {version}: use a matching morphspace"
        )


def _faceframe_of(path: Path, entry: Any, image_key: str) -> MarkedFaceframe:
    if not isinstance(entry, Mapping):
        raise BadInput(
            f"{path}: the faceframe is {entry!r}, an object with {', '.join(POINT_NAMES)} was expected"
        )
    points = []
    for name in POINT_NAMES:
        point = entry.get(name)
        if not (isinstance(point, list) and len(point) == 2 and all(map(_is_number, point))):
            raise BadInput(f"{path}: {name} is {point!r}, [x, y] in pixels was expected")
        points.append(point)
    image = entry.get(image_key)
    if not isinstance(image, str):
        raise BadInput(
            f"{path}: {image_key} is {image!r}, the name of the picture the points lie in was expected"
        )
    size = entry.get("size")
    if size is not None and not (
        isinstance(size, list) and len(size) == 2 and all(type(side) is int and side > 0 for side in size)
    ):
        raise BadInput(f"{path}: size is {size!r}, [width, height] in pixels was expected")
    return MarkedFaceframe(image, np.array(points, np.float64), None if size is None else (size[0], size[1]))


def _point_entries(faceframe: MarkedFaceframe) -> dict[str, list[float]]:
    return dict(zip(POINT_NAMES, faceframe.points.tolist(), strict=True))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
