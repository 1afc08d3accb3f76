"""Decode the output of MediaPipe's face networks into boxes in the image.

Each of 896 anchors on two grids has a score, a box and six points relative to it. Overlapping boxes are averaged by
their scores instead of dropped, which removes most of the jitter (Bazarevsky et al. 2019, BlazeFace, section 3.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.errors import BadInput

SIDE, FAR_SIDE = 128, 256  # px, of the square inputs of both networks
GRIDS = ((16, 2), (8, 6))  # cells a side, anchors a cell
RIGHT_EYE, LEFT_EYE = 0, 1  # of the six points; then nose tip, mouth, and the two ears
CANDIDATE_SCORE = 0.5  # score; boxes below are left out of the average
OVERLAP = 0.3  # intersection over union above which two boxes show one face
SCORE_LIMIT = 80.0  # raw score; the exponential of more overflows float32


Person = Literal["largest", "left", "right"] | tuple[float, float]
"""Which of several faces is used: the largest, that on the left or right of the image, or the nearest to x, y px."""


@dataclass(frozen=True, eq=False)
class FaceBox:
    """A detected face, in px of the network's input or of the image.

    Attributes
    ----------
    corners : array (2, 2) px
        Upper left and lower right.
    marks : array (6, 2) px
        Eyes, nose tip, mouth, ears.
    score : float
        In [0, 1].
    """

    corners: Points
    marks: Points
    score: float

    @property
    def middle(self) -> Points:
        """Return the middle of the box (2,)."""
        return np.asarray(self.corners.mean(axis=0))

    @property
    def area(self) -> float:
        """Width times height, 0 for a box with exchanged corners."""
        return float(np.prod(np.maximum(self.corners[1] - self.corners[0], 0)))


@cache
def _anchors(side: int = SIDE) -> Points:
    """Return the centres (896, 2) of a network's anchors, px from the edge of its input of `side` px, row by row."""
    found = []
    for cells, repeats in GRIDS:
        y, x = np.mgrid[:cells, :cells].reshape(2, -1)
        found.append(np.repeat((np.column_stack([x, y]) + 0.5) * (side / cells), repeats, axis=0))
    return np.concatenate(found)


def decode(scores: AnyArray, regressors: AnyArray, side: int = SIDE) -> list[FaceBox]:
    """Decode the candidate boxes, px of the network's input with pixel centres at integers, best first.

    Boxes without extent, or with numbers that are not finite, are left out.

    Parameters
    ----------
    scores : array (896,)
        Raw scores.
    regressors : array (896, 16)
        Box centre and size, then six points, all relative to the anchor.
    side : int
        Of the network's input, px.
    """
    raw = np.clip(scores.astype(np.float64).reshape(-1), -SCORE_LIMIT, SCORE_LIMIT)
    share = 1 / (1 + np.exp(-raw))
    pairs = regressors.astype(np.float64).reshape(len(raw), 8, 2)
    found = []
    centres = _anchors(side) - 0.5
    for index in np.flatnonzero(share >= CANDIDATE_SCORE):  # NaN scores are left out as well
        anchor = centres[index]
        centre, size, marks = pairs[index, 0] + anchor, pairs[index, 1], pairs[index, 2:] + anchor
        if np.isfinite(pairs[index]).all() and (size > 0).all():
            box = FaceBox(np.array([centre - size / 2, centre + size / 2]), marks, float(share[index]))
            found.append(box)
    return sorted(found, key=lambda box: -box.score)


def overlap(a: FaceBox, b: FaceBox) -> float:
    """Compute the intersection of two boxes over their union, in [0, 1].

    Examples
    --------
    >>> import numpy as np
    >>> one = FaceBox(np.array([[0.0, 0.0], [2.0, 2.0]]), np.zeros((6, 2)), 1.0)
    >>> other = FaceBox(np.array([[1.0, 0.0], [3.0, 2.0]]), np.zeros((6, 2)), 1.0)
    >>> round(overlap(one, other), 3)
    0.333
    """
    low, high = np.maximum(a.corners[0], b.corners[0]), np.minimum(a.corners[1], b.corners[1])
    shared = float(np.prod(np.maximum(high - low, 0)))
    union = a.area + b.area - shared
    return shared / union if union > 0 else 0.0


def suppress(candidates: list[FaceBox]) -> list[FaceBox]:
    """Return one box for each face, best first: the score-weighted mean of all boxes that overlap the best one.

    References
    ----------
    Bazarevsky et al., BlazeFace, 2019, section 3.4.
    """
    left = sorted(candidates, key=lambda box: -box.score)
    faces = []
    while left:
        best = left[0]
        alike = [box for box in left if box is best or overlap(best, box) > OVERLAP]
        left = [box for box in left if all(box is not other for other in alike)]
        weights = np.array([box.score for box in alike])
        corners = np.average([box.corners for box in alike], axis=0, weights=weights)
        marks = np.average([box.marks for box in alike], axis=0, weights=weights)
        faces.append(FaceBox(corners, marks, best.score))
    return faces


def person_of(entry: object) -> Person:
    """Return the person that a detector's identity names; None stands for the largest. Raises `BadInput`."""
    match entry:
        case None | "largest":
            return "largest"
        case "left" | "right":
            return entry
        case [int() | float() as x, int() | float() as y]:
            return float(x), float(y)
    raise BadInput(f"the person is {entry!r}; expected largest, left, right or two numbers x, y. Build again")


def in_order_of(person: Person, faces: list[FaceBox]) -> list[FaceBox]:
    """Sort faces so that the wanted person is first: by the product of area and score, from a side, or from a place."""
    if person == "largest":
        return sorted(faces, key=lambda face: -face.area * face.score)
    if isinstance(person, str):
        sign = 1 if person == "left" else -1
        return sorted(faces, key=lambda face: sign * float(face.middle[0]))
    return sorted(faces, key=lambda face: float(np.hypot(*(face.middle - person))))
