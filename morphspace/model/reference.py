"""Choose the reference: the frame from which all the others are best reached.

The paper asks for a neutral face, eyes open, mouth slightly open with a little of the teeth and of the dark between
them, so that the flow finds everything it needs to make the other frames (Nagle section 2). Two measurements stand for
that wish. What counts about a frame is how well it reaches the frames that are hardest to reach, not the many easy
ones: extreme frames lose, those in the middle win. Among frames that do about equally well, the one is taken whose
mouth is half way between the most closed and the most open of the clip: from a closed mouth no warp makes an open one,
and the mean face then shows the ghost of it. Where the points of the face are known, the one is taken that is nearest
to rest with the lips slightly apart: with the flow held to the points (`anchoring`) models then share their zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.face.faceframe import FaceFrame
from morphspace.face.regions import face_mask, mouth_surroundings
from morphspace.flow.baselines import LUMA, dis_medium, smoothed
from morphspace.flow.starts import photometric_error
from morphspace.steps import Step, Steps, in_order, spread

POOL = 120  # frames looked at, spread evenly over the clip
TARGETS = 14  # of them, spread evenly: the frames to be reached
CANDIDATES = 20  # of them, spread evenly: tried as the reference first
HALF_OPEN = 10  # then those whose mouth is nearest to half open
SMALL_SIDE_PX = 100  # of the frames compared
HARDEST = 0.25  # share of the frames, the hardest to reach, whose mean error is the score
EXTREMES = (5, 95)  # percentiles; a hand before the mouth in one frame must not decide what half open is
ABOUT_EQUAL = 1.05  # times the best score; within it the mouth decides
NEARLY_EQUAL = 1.15  # times the best score; within it rest decides, where the points of the face tell it


@dataclass(frozen=True, eq=False)
class ReferenceChoice:
    """Which frame became the reference (`index`, `name`), and why, in one sentence for the report."""

    index: int
    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class SmallFrame:
    """A small picture (h, w, 3) of a frame, the mask (h, w) of its face, and the contrast of its mouth."""

    image: Image
    mask: Mask
    contrast: float


def shrunk(image: Image, faceframe: FaceFrame | None) -> SmallFrame:
    """Give a frame (h, w, 3) at about `SMALL_SIDE_PX` wide, which is enough to compare frames.

    `faceframe` says where the face stands, None where faces usually do.
    """
    height, width = image.shape[:2]
    scale = min(1.0, SMALL_SIDE_PX / width)
    size = max(16, round(width * scale)), max(16, round(height * scale))
    return SmallFrame(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA),
        cv2.resize(face_mask(height, width, faceframe), size, interpolation=cv2.INTER_AREA),
        mouth_contrast(image, mouth_surroundings(height, width, faceframe)),
    )


def search(frames: Sequence[SmallFrame], far: AnyArray | None = None) -> Steps[tuple[int, dict[int, float]]]:
    """Search the reference among small frames; a generator of steps.

    Where `far` (n,) tells how far each face is from rest (`facerest`), it decides instead of the contrasts; inf means
    that no face is known there.

    Returns its place, and the error of each place that was tried. The error of a pair is what the reference does not
    show: how far the frame, warped to the reference, misses it, rms colour inside the mask; the error of a candidate is
    the mean over the `HARDEST` share of the frames to be reached.
    """
    images, mask = [frame.image for frame in frames], frames[-1].mask
    contrasts = np.array([frame.contrast for frame in frames])
    first = spread(len(images), CANDIDATES)
    middle = _half_open(contrasts)
    off = np.abs(contrasts - middle) if far is None else far
    rest = np.setdiff1d(np.arange(len(images)), first)
    second = rest[off[rest].argsort(kind="stable")][:HALF_OPEN]
    tried = np.concatenate([first, second]).astype(np.intp)
    targets = [images[i] for i in spread(len(images), TARGETS)]

    def error(place: int) -> float:
        reference = images[place]
        errors = sorted(_missing(reference, frame, mask) for frame in targets if frame is not reference)
        hardest = errors[-max(1, round(HARDEST * len(errors))) :]
        return float(np.mean(hardest)) if hardest else 0.0

    errors: dict[int, float] = {}
    for place, found in zip(tried, in_order(error, tried), strict=True):
        errors[int(place)] = found
        yield Step("reference", len(errors), len(tried))
    limit = (ABOUT_EQUAL if far is None else NEARLY_EQUAL) * min(errors.values())
    good = np.array([place for place, found in errors.items() if found <= limit])
    return int(good[off[good].argmin()]), errors


def _half_open(contrasts: AnyArray) -> float:
    return float(np.percentile(contrasts, EXTREMES).mean())


def _missing(reference: Image, frame: Image, mask: Mask) -> float:
    """Give what the reference does not show of a frame, the mean of both as they are and mirrored.

    The flow is not the mirror of its mirror; a mirrored clip must choose the mirrored reference.
    """
    both = (
        (reference, frame, mask),
        tuple(np.ascontiguousarray(one[:, ::-1]) for one in (reference, frame, mask)),
    )
    missed = sorted(
        photometric_error(one, other, smoothed(dis_medium(one, other)), seen) for one, other, seen in both
    )
    return sum(missed) / 2


def mouth_contrast(image: Image, region: Mask) -> float:
    """Give the sd of luma in the mouth region (h, w): small for closed lips, large where dark and teeth show."""
    inside = (image @ LUMA)[region > 0.5]
    return float(inside.std()) if inside.size else 0.0
