"""From the numbers of MediaPipe's short-range face network to boxes in the image: anchors, decoding, suppression.

Bazarevsky et al. 2019 (BlazeFace): each of 896 anchors on two grids gets a score, a box and six points relative to it;
boxes that overlap are not dropped but averaged by their scores, which takes out most of the jitter (section 3.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Points

SIDE = 128  # px of the network's square input
GRIDS = ((16, 2), (8, 6))  # cells a side, anchors a cell
RIGHT_EYE, LEFT_EYE = 0, 1  # of the six points; then nose tip, mouth, and the two ears
CANDIDATE_SCORE = 0.5  # boxes below take no part in the average
OVERLAP = 0.3  # intersection over union from which two boxes are of one face
SCORE_LIMIT = 80.0  # of the raw score: the exponential of more overflows float32


@dataclass(frozen=True, eq=False)
class FaceBox:
    """A face that was found: `corners` (2, 2) upper left and lower right | `marks` (6, 2) | `score` in [0, 1].

    Coordinates are those of whatever the box is told in: the network's px, or the image's.
    """

    corners: Points
    marks: Points
    score: float

    @property
    def area(self) -> float:
        """Width times height, 0 for a box turned inside out."""
        return float(np.prod(np.maximum(self.corners[1] - self.corners[0], 0)))


def anchors() -> Points:
    """Give the centres (896, 2) of the network's anchors, px of its input measured from the edge, row by row."""
    found = []
    for cells, repeats in GRIDS:
        y, x = np.mgrid[:cells, :cells].reshape(2, -1)
        found.append(np.repeat((np.column_stack([x, y]) + 0.5) * (SIDE / cells), repeats, axis=0))
    return np.concatenate(found)


def decode(scores: AnyArray, regressors: AnyArray) -> list[FaceBox]:
    """Give the candidate boxes, px of the network's input, pixel centres at integers, best first.

    `scores` (896,) raw, `regressors` (896, 16): box centre and size, then six points, all relative to the anchor. Boxes
    without extent or with numbers that are not finite are left out.
    """
    raw = np.clip(scores.astype(np.float64).reshape(-1), -SCORE_LIMIT, SCORE_LIMIT)
    share = 1 / (1 + np.exp(-raw))
    pairs = regressors.astype(np.float64).reshape(len(raw), 8, 2)
    found = []
    for index in np.flatnonzero(share >= CANDIDATE_SCORE):  # a score that is not a number is left out as well
        anchor = _ANCHORS[index] - 0.5
        centre, size, marks = pairs[index, 0] + anchor, pairs[index, 1], pairs[index, 2:] + anchor
        if np.isfinite(pairs[index]).all() and (size > 0).all():
            box = FaceBox(np.array([centre - size / 2, centre + size / 2]), marks, float(share[index]))
            found.append(box)
    return sorted(found, key=lambda box: -box.score)


_ANCHORS = anchors()


def overlap(a: FaceBox, b: FaceBox) -> float:
    """Give the intersection of two boxes over their union, in [0, 1]."""
    low, high = np.maximum(a.corners[0], b.corners[0]), np.minimum(a.corners[1], b.corners[1])
    shared = float(np.prod(np.maximum(high - low, 0)))
    union = a.area + b.area - shared
    return shared / union if union > 0 else 0.0


def suppress(candidates: list[FaceBox]) -> list[FaceBox]:
    """Give one box a face, best first: the mean, weighted by score, of all that overlap the best one left."""
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


def main_face(faces: list[FaceBox], least_score: float) -> FaceBox | None:
    """Give the face that matters: the largest, weighed by its score, of those that reach `least_score`; or None."""
    sure = [face for face in faces if face.score >= least_score]
    return max(sure, key=lambda face: face.area * face.score, default=None)
