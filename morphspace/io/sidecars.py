"""Files beside a clip: `clip.json` (identity, frame rate, consent, licence, faceframe) and the faceframe file.

`data_spec/clip-folder.md` describes `clip.json`, `data_spec/faceframe.md` the faceframe file. Unknown keys are kept,
so that a lab can add its own.
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
    "Select a faceframe file (data_spec/faceframe.md), or write both eyes and the philtrum to a .csv, x,y in each "
    "line"
)
POINT_NAMES = ("right_eye", "left_eye", "philtrum")
TEXT_KEYS = ("identity", "consent", "licence")


def eyes_in_order(points: Points, origin: str) -> tuple[Points, tuple[str, ...]]:
    """Order the two eyes of three marked points: the subject's right eye first.

    In an upright face the subject's right eye is on the image's left, and programs number the eyes either way. All
    readers therefore order them by x, whatever the order or the names in the file.

    Parameters
    ----------
    points : array (3, 2) px
        Two eyes and the philtrum or lip.
    origin : str
        The name of the points in messages.

    Returns
    -------
    array (3, 2) float64 px, a new array
    tuple of str
        A note if the eyes were exchanged.

    Raises
    ------
    BadInput
        If the points are not three finite pairs, or the eyes have the same x.

    Examples
    --------
    >>> import numpy as np
    >>> points, notes = eyes_in_order(np.array([[60.0, 50], [40, 50], [50, 70]]), "a.csv")
    >>> points.tolist(), len(notes)
    ([[40.0, 50.0], [60.0, 50.0], [50.0, 70.0]], 1)
    """
    points = np.array(points, np.float64)
    if points.shape != (3, 2) or not np.isfinite(points).all():
        raise BadInput(
            f"{origin}: the points are not finite or not three; expected three pairs x,y. Mark them again"
        )
    if (points[0] == points[1]).all():
        raise BadInput(
            f"{origin}: both eyes are at {points[0, 0]:g},{points[0, 1]:g}; expected two places. Mark them again"
        )
    if points[0, 0] == points[1, 0]:
        raise BadInput(
            f"{origin}: both eyes are at x {points[0, 0]:g}, one above the other; expected two values of x. Mark them "
            "again, or turn the picture upright"
        )
    if points[0, 0] < points[1, 0]:
        return points, ()
    note = f"{origin}: the eyes were exchanged: the subject's right eye is on the left of the image"
    return points[[1, 0, 2]], (note,)


@dataclass(frozen=True, eq=False)
class MarkedFaceframe:
    """Three points marked in one image; the constructor orders the eyes by `eyes_in_order`.

    Attributes
    ----------
    image : str
        The name of the image.
    points : array (3, 2) px
        Right eye, left eye, philtrum.
    size : (width, height) px of the image, or None if unknown
    notes : tuple of str
        Says if the eyes were exchanged.

    Raises
    ------
    BadInput
        As `eyes_in_order` raises it, or if a point lies outside the image.
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
                    f"the {POINT_NAMES[first]} of the faceframe of {self.image} is {x:g},{y:g}; expected a point "
                    "in its "
                    f"image of {self.size[0]} x {self.size[1]} px. Mark it again"
                )
        points.setflags(write=False)
        object.__setattr__(self, "points", points)


@dataclass(frozen=True, eq=False)
class Sidecar:
    """The content of `clip.json`. An entry is None if it is missing; `extra` holds all other keys."""

    identity: str | None = None
    frame_rate_hz: float | None = None
    consent: str | None = None
    licence: str | None = None
    faceframe: MarkedFaceframe | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


def read_sidecar(path: str | Path) -> Sidecar:
    """Read a `clip.json`. Raises `UnreadableFile` if it is not JSON, and `BadInput` if an entry has the wrong type."""
    path = Path(path)
    document = dict(read_json_object(path))
    texts = {key: document.pop(key, None) for key in TEXT_KEYS}
    for key, text in texts.items():
        if not (text is None or isinstance(text, str)):
            raise BadInput(f"{path}: {key} is {text!r}; expected a text. Correct it")
    rate_hz = document.pop("frame_rate_hz", None)
    if rate_hz is not None and not (_is_number(rate_hz) and rate_hz > 0):
        raise BadInput(f"{path}: frame_rate_hz is {rate_hz!r}; expected a number above 0. Correct it")
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
    """Write a `clip.json`, completely or not at all, without entries that are None. Raises `UnwritableFile`."""
    document = dict(sidecar.extra)
    for key in (*TEXT_KEYS, "frame_rate_hz"):
        if getattr(sidecar, key) is not None:
            document[key] = getattr(sidecar, key)
    if sidecar.faceframe is not None:
        document["faceframe"] = {"frame": sidecar.faceframe.image, **_point_entries(sidecar.faceframe)}
    write_text(Path(path), json_text(document))


def read_faceframe(path: str | Path) -> MarkedFaceframe:
    """Read a faceframe file. Raises `UnreadableFile`, and `BadInput` if its format, version or points are wrong."""
    path = Path(path)
    document = read_json_object(path)
    check_format(path, document, FACEFRAME_FORMAT, FACEFRAME_VERSION, WRITE_POINTS)
    return _faceframe_of(path, document, "image")


def read_json_object(path: Path) -> dict[str, Any]:
    """Read a JSON object. Raises `UnreadableFile` if the file is missing or holds something else."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    except (ValueError, RecursionError) as error:
        raise UnreadableFile(f"{path} is not JSON: {error}. Correct it or write it again") from error
    if not isinstance(document, dict):
        raise UnreadableFile(
            f"{path} holds a JSON {type(document).__name__}; expected an object in braces. Write it again"
        )
    return document


def check_format(
    path: Path,
    document: Mapping[str, Any],
    name: str,
    version: int,
    instead: str = "Select a file of that format",
) -> None:
    """Raise `BadInput` if the format or version is another; `instead` says what to do about the format."""
    if document.get("format") != name:
        raise BadInput(f"{path} has the format {document.get('format')!r}; expected {name!r}. {instead}")
    found = document.get("version")
    if found != version:
        raise BadInput(
            f"{path} has version {found!r} of {name}; expected {version}. Use a matching morphspace"
        )


def _faceframe_of(path: Path, entry: Any, image_key: str) -> MarkedFaceframe:
    if not isinstance(entry, Mapping):
        raise BadInput(
            f"{path}: the faceframe is {entry!r}; expected an object with {', '.join(POINT_NAMES)}. Correct it"
        )
    points = []
    for name in POINT_NAMES:
        point = entry.get(name)
        if not (isinstance(point, list) and len(point) == 2 and all(map(_is_number, point))):
            raise BadInput(f"{path}: {name} is {point!r}; expected [x, y] in px. Correct it")
        points.append(point)
    image = entry.get(image_key)
    if not isinstance(image, str):
        raise BadInput(f"{path}: {image_key} is {image!r}; expected the name of the image. Correct it")
    size = entry.get("size")
    if size is not None and not (
        isinstance(size, list) and len(size) == 2 and all(type(side) is int and side > 0 for side in size)
    ):
        raise BadInput(f"{path}: size is {size!r}; expected [width, height] in px. Correct it")
    return MarkedFaceframe(image, np.array(points, np.float64), None if size is None else (size[0], size[1]))


def _point_entries(faceframe: MarkedFaceframe) -> dict[str, list[float]]:
    return dict(zip(POINT_NAMES, faceframe.points.tolist(), strict=True))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
