"""One crop for a whole clip, from where the face was found in some of its frames (ours).

A single box leaves the head's movement to registration, which measures it to a fraction of a pixel; a box that followed
the face would put its own jitter in. The proportions are those of frames that were cropped to the head by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.errors import BadInput
from morphspace.face.detector import Detector
from morphspace.face.mesh import FacePoints
from morphspace.io.clips import Clip
from morphspace.steps import Step, Steps, in_order, spread

CROP_FRAMES = 24  # of a clip, evenly spread, in which the face is looked for to crop it
# From the middle between the eyes, in eye distances. The crown lies 1.5 to 1.8 above, the chin 1.8 to 1.9 below.
ABOVE, BELOW, BESIDE = 1.95, 2.35, 1.75
MOST_OF_PATH = (5, 95)  # percentiles of where the head was; a frame that found something else must not decide


@dataclass(frozen=True, eq=False)
class FoundCrop:
    """A crop: `box` (x, y, w, h) px | `eyes_px` the median eye distance | `frames` looked at, `found` with a face."""

    box: tuple[int, int, int, int]
    eyes_px: float
    frames: int
    found: int

    @property
    def document(self) -> dict[str, Any]:
        """What a model's provenance says of how the crop was found."""
        return {"frames": self.frames, "found": self.found, "eyes_px": round(self.eyes_px, 2)}


def crop_steps(clip: Clip, detector: Detector, aspect: float) -> Steps[FoundCrop]:
    """Find the face in a spread of frames and give one crop for all of them; a generator of steps.

    `aspect` is width over height. Raises `BadInput` where a face was found in less than half of them.
    """
    looked = spread(len(clip), CROP_FRAMES)
    faces = []
    for done, face in enumerate(in_order(detector, clip.images(looked)), 1):
        faces.append(face)
        yield Step("crop", done, len(looked))
    found = [face for face in faces if face is not None]
    if 2 * len(found) < len(looked):
        raise BadInput(
            f"a face was found in {len(found)} of {len(looked)} frames of {clip.name}, too few to crop the clip: give "
            "--crop x,y,w,h, or leave it out"
        )
    return FoundCrop(head_crop(found, clip.size, aspect), median_eyes_px(found), len(looked), len(found))


def head_crop(
    faces: Sequence[FacePoints], picture: tuple[int, int], aspect: float
) -> tuple[int, int, int, int]:
    """Give the box (x, y, w, h) px that holds the head in all faces, inside a picture of (w, h) px.

    `aspect` is width over height. A box that would leave the picture is moved inside it, and made smaller where it is
    larger than the picture.
    """
    eyes = median_eyes_px(faces)
    middles = np.array([face.faceframe().points[:2].mean(axis=0) for face in faces])
    first, last = np.percentile(middles, MOST_OF_PATH, axis=0)
    low = first - np.array([BESIDE, ABOVE]) * eyes
    high = last + np.array([BESIDE, BELOW]) * eyes
    width, height = high - low
    width, height = max(width, height * aspect), max(height, width / aspect)
    share = min(1.0, picture[0] / width, picture[1] / height)
    size = np.array([width, height]) * share
    # Rounded down: a box must not be larger than the picture it lies in.
    w, h = (max(1, int(min(side, most))) for side, most in zip(np.round(size), picture, strict=True))
    middle = (low + high) / 2
    x, y = (
        int(np.clip(round(float(centre) - side / 2 + 0.5), 0, most - side))
        for centre, side, most in zip(middle, (w, h), picture, strict=True)
    )
    return x, y, w, h


def median_eyes_px(faces: Sequence[FacePoints]) -> float:
    """Give the median distance between the eyes, px; a head that turns shows it too short."""
    return float(np.median([face.interocular_px for face in faces]))
