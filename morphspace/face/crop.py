"""One crop for a whole clip, from the face's position in some of its frames (ours).

A single box leaves head movement to registration, which measures it to a fraction of a pixel. A box that followed the
face would add its own jitter. The proportions are those of frames that were cropped to the head by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector
from morphspace.face.mesh import FacePoints
from morphspace.io.clips import Clip
from morphspace.steps import Step, Steps, in_order, spread

CROP_FRAMES = 24  # frames of a clip, evenly spread, in which the face is detected
# Eye distances from the middle of the eyes. The crown is 1.5 to 1.8 above, the chin 1.8 to 1.9 below.
ABOVE, BELOW, BESIDE = 1.95, 2.35, 1.75
FACE_WIDTH = 2.2  # eye distances, of the widest part of a face
NAMED_PLACES = 3  # further faces whose places are listed
MOST_OF_PATH = (5, 95)  # percentiles of the head's position; one false detection must not decide


@dataclass(frozen=True, eq=False)
class FoundCrop:
    """A crop around the head.

    Attributes
    ----------
    box : (x, y, w, h) px
    eyes_px : float
        Median eye distance, px.
    frames, found : int
        Frames that were searched, and those with a face.
    notes : tuple of str
        That some frames show several faces.
    """

    box: tuple[int, int, int, int]
    eyes_px: float
    frames: int
    found: int
    notes: tuple[str, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """The entry of a model's provenance for the crop."""
        return {"frames": self.frames, "found": self.found, "eyes_px": round(self.eyes_px, 2)}


def crop_steps(clip: Clip, detector: Detector, aspect: float) -> Steps[FoundCrop]:
    """Detect the face in frames spread over a clip, and compute one crop for all; a generator of steps.

    Parameters
    ----------
    clip : Clip
    detector : Detector
    aspect : float
        Width over height of the crop.

    Returns
    -------
    FoundCrop

    Raises
    ------
    BadInput
        If a face was found in fewer than half of the frames, or the face changes place among several.
    """
    searched = spread(len(clip), CROP_FRAMES)
    names = [clip.frame_names[place] for place in searched]
    faces = []
    for done, face in enumerate(in_order(detector, clip.images(searched)), 1):
        faces.append(face)
        yield Step("crop", done, len(searched))
    found = [face for face in faces if face is not None]
    if 2 * len(found) < len(searched):
        raise BadInput(
            f"a face was found in {len(found)} of {len(searched)} frames of {clip.name}; expected at least half. Give "
            "--crop x,y,w,h, or omit --crop"
        )
    check_one_person(names, faces)
    notes = several_notes(names, faces)
    return FoundCrop(
        _head_crop(found, clip.size, aspect), _median_eyes_px(found), len(searched), len(found), notes
    )


def several_notes(names: Sequence[str], faces: Sequence[FacePoints | None]) -> tuple[str, ...]:
    """Note how many frames show several faces, and where these are in the frame that shows most."""
    several = [place for place, face in enumerate(faces) if face is not None and len(face.others)]
    if not several:
        return ()
    place = max(several, key=lambda place: len(_others(faces[place])))
    others = _others(faces[place])
    where = " and ".join(f"{x:.0f},{y:.0f}" for x, y in others[:NAMED_PLACES].tolist())
    return (
        f"{len(several)} of {len(names)} frames show several faces: in {names[place]} the one at "
        f"{_words(faces[place])} px is used, of {len(others)} more at {where}. Give --person or --crop for another",
    )


def check_one_person(
    names: Sequence[str], faces: Sequence[FacePoints | None], *, is_video: bool = False
) -> None:
    """Check that the face does not jump to another person from one frame to the next.

    A jump is a movement by more than the width of the face, where one of the two frames shows several faces, or in a
    video. Stills of one face each may show it anywhere.

    Raises
    ------
    BadInput
        With both frames and places.
    """
    last: int | None = None
    for place, face in enumerate(faces):
        if face is None:
            continue
        before = None if last is None else faces[last]
        if last is not None and before is not None and (is_video or len(face.others) or len(before.others)):
            moved_px = float(np.hypot(*(_middle(face) - _middle(before))))
            width_px = FACE_WIDTH * max(face.interocular_px, before.interocular_px)
            if moved_px > width_px:
                raise BadInput(
                    f"the face jumps from {_words(before)} px in {names[last]} to {_words(face)} px in {names[place]}; "
                    f"expected one person, who moves by less than the width of the face ({width_px:.0f} px). Give "
                    "--person left, right or x,y, or --crop x,y,w,h"
                )
        last = place


def _others(face: FacePoints | None) -> Points:
    return np.zeros((0, 2)) if face is None else face.others


def _middle(face: FacePoints) -> Points:
    """Return the middle of the eyes (2,) px."""
    return np.asarray(face.faceframe().points[:2].mean(axis=0))


def _words(face: FacePoints | None) -> str:
    return "" if face is None else "{:.0f},{:.0f}".format(*_middle(face))


def _head_crop(
    faces: Sequence[FacePoints], picture: tuple[int, int], aspect: float
) -> tuple[int, int, int, int]:
    """Compute the box (x, y, w, h) px that contains the head in all faces, inside a picture of (w, h) px.

    `aspect` is width over height. A box beyond the picture's edge is moved inside, and reduced if it is too large.
    """
    eyes = _median_eyes_px(faces)
    middles = np.array([_middle(face) for face in faces])
    first, last = np.percentile(middles, MOST_OF_PATH, axis=0)
    low = first - np.array([BESIDE, ABOVE]) * eyes
    high = last + np.array([BESIDE, BELOW]) * eyes
    width, height = high - low
    width, height = max(width, height * aspect), max(height, width / aspect)
    share = min(1.0, picture[0] / width, picture[1] / height)
    size = np.array([width, height]) * share
    # At most the picture's side, since rounding may exceed it.
    w, h = (max(1, int(min(side, most))) for side, most in zip(np.round(size), picture, strict=True))
    middle = (low + high) / 2
    x, y = (
        int(np.clip(round(float(centre) - side / 2 + 0.5), 0, most - side))
        for centre, side, most in zip(middle, (w, h), picture, strict=True)
    )
    return x, y, w, h


def _median_eyes_px(faces: Sequence[FacePoints]) -> float:
    """Compute the median distance between the eyes, px; a turned head shortens it."""
    return float(np.median([face.interocular_px for face in faces]))
