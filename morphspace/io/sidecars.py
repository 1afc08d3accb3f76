"""Files beside a clip: `clip.json` (identity, frame rate, consent, licence, faceframe) and the faceframe file.

`data_spec/clip-folder.md` describes `clip.json`, `data_spec/faceframe.md` the faceframe file. Unknown keys are kept,
so that a lab can add its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import numpy as np

from morphspace.arrays import Points
from morphspace.documents import Document, FrameRate, Line, Open, OrNull, Point, Size, entries_of
from morphspace.errors import BadInput
from morphspace.io.names import composed
from morphspace.settings import Help
from morphspace.storage import json_text, write_text

WRITE_POINTS = (
    "Select a faceframe file (data_spec/faceframe.md), or write both eyes and the philtrum to a .csv, x,y in each "
    "line"
)
POINT_NAMES = ("right_eye", "left_eye", "philtrum")
MISSING_MARKS = ((-1.0, -1.0), (0.0, 0.0))  # px; programs write these for a landmark that was not marked
RightEye = Annotated[Point, Help("Centre of the subject's right eye, px.")]
LeftEye = Annotated[Point, Help("Centre of the subject's left eye, px.")]
Philtrum = Annotated[Point, Help("Centre of the philtrum, px.")]


class FaceframeEntry(TypedDict):
    """The faceframe in a `clip.json`."""

    frame: Annotated[Line, Help("Name of the frame in which the points lie.")]
    right_eye: RightEye
    left_eye: LeftEye
    philtrum: Philtrum


class ClipDocument(TypedDict, total=False):
    """The entries of a `clip.json` (data_spec/clip-folder.md)."""

    identity: Annotated[OrNull[Line], Help("The person shown.")]
    frame_rate_hz: OrNull[FrameRate]
    deinterlace: OrNull[bool]
    consent: Annotated[OrNull[str], Help("What the person agreed to.")]
    licence: Annotated[OrNull[str], Help("Terms of use of the pictures.")]
    faceframe: Annotated[OrNull[FaceframeEntry], Open()]


class FaceframeDocument(TypedDict):
    """The entries of a faceframe file (data_spec/faceframe.md)."""

    format: Literal["morphspace-faceframe"]
    version: Literal[1]
    image: Annotated[Line, Help("Name of the picture in which the points were marked.")]
    size: NotRequired[Annotated[OrNull[Size], Help("[width, height] of the picture, px.")]]
    right_eye: RightEye
    left_eye: LeftEye
    philtrum: Philtrum


CLIP = Document("clip-folder", "clip.json of a clip folder", ClipDocument, "Correct it", marks=(Open(),))
FACEFRAME = Document(
    "faceframe", "morphspace faceframe, version 1", FaceframeDocument, "Correct it", WRITE_POINTS, (Open(),)
)


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
        If the points are not three finite pairs, one is marked as missing, or the eyes have the same x.

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
    for name, (x, y) in zip(POINT_NAMES, points.tolist(), strict=True):
        if (x, y) in MISSING_MARKS:
            raise BadInput(
                f"{origin}: the {name} is {x:g},{y:g}, which marks it as missing; expected a place in the image. "
                "Mark it again"
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
    deinterlace: bool | None = None


def read_sidecar(path: str | Path) -> Sidecar:
    """Read a `clip.json`; its names become NFC.

    Raises `UnreadableFile` for a wrong entry, and `BadInput` as `MarkedFaceframe` does.
    """
    document: dict[str, Any] = dict(CLIP.read(Path(path)))
    given = {key: document.pop(key, None) for key in entries_of(ClipDocument)}
    faceframe = given.pop("faceframe")
    marked = None if faceframe is None else _marked(faceframe, "frame")
    if given["identity"] is not None:
        given["identity"] = composed(given["identity"])
    return Sidecar(**given, faceframe=marked, extra=document)


def write_sidecar(path: str | Path, sidecar: Sidecar) -> None:
    """Write a `clip.json`, completely or not at all, without entries that are None. Raises `UnwritableFile`.

    Examples
    --------
    >>> write_sidecar("clip.json", Sidecar(identity="anna", frame_rate_hz=25.0))
    >>> read_sidecar("clip.json").identity
    'anna'
    """
    given = {key: getattr(sidecar, key) for key in entries_of(ClipDocument)}
    if sidecar.faceframe is not None:
        given["faceframe"] = {"frame": sidecar.faceframe.image, **_point_entries(sidecar.faceframe)}
    document = {**sidecar.extra, **{key: value for key, value in given.items() if value is not None}}
    write_text(Path(path), json_text(document))


def read_faceframe(path: str | Path) -> MarkedFaceframe:
    """Read a faceframe file. Raises `UnreadableFile` for a wrong entry, and `BadInput` as `MarkedFaceframe` does."""
    return _marked(FACEFRAME.read(Path(path)), "image")


def _marked(entry: Mapping[str, Any], image_key: str) -> MarkedFaceframe:
    points = np.array([entry[name] for name in POINT_NAMES], np.float64)
    size = entry.get("size")
    return MarkedFaceframe(composed(entry[image_key]), points, None if size is None else (size[0], size[1]))


def _point_entries(faceframe: MarkedFaceframe) -> dict[str, list[float]]:
    return dict(zip(POINT_NAMES, faceframe.points.tolist(), strict=True))
