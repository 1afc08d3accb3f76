"""Choose the reference: the frame from which the other frames are reached best.

Nagle et al. (section 2) ask for a neutral face with open eyes and a slightly open mouth, so that the flow finds in
the reference what every other frame needs. If the face points are known, the frame nearest to that is taken
(`face.expression.distance_from_neutral`): a warp cannot open what the reference has closed. Otherwise two measurements
replace that judgement (ours). The first is how well a frame reaches the frames that are hardest to reach. The second
decides among frames that are nearly as good: the mouth half way between the most closed and the most open of the clip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.errors import BadInput
from morphspace.face.expression import distance_from_neutral, expression_of
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import FacePoints
from morphspace.face.regions import face_mask, mouth_surroundings
from morphspace.flow.baselines import LUMA, dis_medium, smoothed
from morphspace.flow.starts import photometric_error
from morphspace.steps import Step, Steps, in_order, spread

POOL = 120  # frames that are compared, spread evenly over the clip
TARGETS = 14  # frames of the pool, spread evenly, that a candidate must reach
CANDIDATES = 20  # frames of the pool, spread evenly, that are tried first
HALF_OPEN = 10  # further frames, whose mouth is nearest to half open
SMALL_SIDE_PX = 100  # px, width of the compared frames
HARDEST = 0.25  # share of the targets, the hardest to reach, whose mean error is the score
EXTREMES = (5, 95)  # percentiles of the contrast; one frame with a hand before the mouth must not decide
ABOUT_EQUAL = 1.05  # times the best score; below it the mouth decides


@dataclass(frozen=True, eq=False)
class ReferenceChoice:
    """The frame that became the reference, by index and name, and the reason for it in words."""

    index: int
    name: str
    reason: str


@dataclass(frozen=True, eq=False)
class SmallFrame:
    """A reduced frame for the search.

    Attributes
    ----------
    image : array (h, w, 3)
    mask : array (h, w)
        The face in it.
    contrast : float
        `_mouth_contrast` at full size.
    """

    image: Image
    mask: Mask
    contrast: float


def shrunk(image: Image, faceframe: FaceFrame | None) -> SmallFrame:
    """Reduce a frame (h, w, 3) to a width of about `SMALL_SIDE_PX`, enough to compare frames.

    `faceframe` places the face; None assumes the middle of the frame.
    """
    height, width = image.shape[:2]
    scale = min(1.0, SMALL_SIDE_PX / width)
    size = max(16, round(width * scale)), max(16, round(height * scale))
    return SmallFrame(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA),
        cv2.resize(face_mask(height, width, faceframe), size, interpolation=cv2.INTER_AREA),
        _mouth_contrast(image, mouth_surroundings(height, width, faceframe)),
    )


def nearest_to_neutral(faces: Sequence[FacePoints | None]) -> tuple[int, str]:
    """Choose the reference among frames by their face points, None without a face.

    Returns
    -------
    place : int
        Of the face nearest to neutral with parted lips; the first of equals.
    reason : str
        For the choice, in words.

    Raises
    ------
    BadInput
        If no frame has a face.
    """
    place = int(np.argmin(distance_from_neutral(faces)))
    face = faces[place]
    if face is None:
        raise BadInput("no frame shows a face; expected one at least. Search by `search`")
    return place, (
        f"chosen from {len(faces)} frames: its face is nearest to neutral with parted lips (they are "
        f"{expression_of(face).mouth_opening:.2f} eye distances apart)"
    )


def search(frames: Sequence[SmallFrame]) -> Steps[tuple[int, dict[int, float]]]:
    """Search the reference among small frames without face points; a generator of steps.

    Parameters
    ----------
    frames : sequence of n SmallFrame

    Returns
    -------
    place : int
        The index of the reference.
    errors : dict of int to float
        The score of each candidate: the mean photometric error over the `HARDEST` share of the target frames. The
        error of a pair is the rms colour difference, inside the mask, of the warped frame and the candidate.
    """
    images, mask = [frame.image for frame in frames], frames[-1].mask
    contrasts = np.array([frame.contrast for frame in frames])
    first = spread(len(images), CANDIDATES)
    middle = _half_open(contrasts)
    off = np.abs(contrasts - middle)
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
    limit = ABOUT_EQUAL * min(errors.values())
    good = np.array([place for place, found in errors.items() if found <= limit])
    return int(good[off[good].argmin()]), errors


def reason_of(place: int, errors: Mapping[int, float]) -> str:
    """Describe in words why the candidate `place` of `search` became the reference, from its `errors`."""
    best, worst = min(errors.values()), max(errors.values())
    return (
        f"chosen from {len(errors)} candidates. Warped to it, the frames that fit worst differ from it by "
        f"{errors[place]:.4f} (rms colour, 0 to 1); the best candidate has {best:.4f}, the worst {worst:.4f}. "
        f"Of the candidates within {ABOUT_EQUAL - 1:.0%} of the best, its mouth is nearest to half open"
    )


def _half_open(contrasts: AnyArray) -> float:
    return float(np.percentile(contrasts, EXTREMES).mean())


def _missing(reference: Image, frame: Image, mask: Mask) -> float:
    """Compute the photometric error of a pair, the mean over the pair and its mirror image.

    The flow of a mirrored pair is not the mirror of the flow; a mirrored clip must choose the mirrored reference.
    """
    both = (
        (reference, frame, mask),
        tuple(np.ascontiguousarray(one[:, ::-1]) for one in (reference, frame, mask)),
    )
    missed = sorted(
        photometric_error(one, other, smoothed(dis_medium(one, other)), inside) for one, other, inside in both
    )
    return sum(missed) / 2


def _mouth_contrast(image: Image, region: Mask) -> float:
    """Compute the SD of luma in the mouth region (h, w): small for closed lips, large for a visible mouth cavity."""
    inside = (image @ LUMA)[region > 0.5]
    return float(inside.std()) if inside.size else 0.0
