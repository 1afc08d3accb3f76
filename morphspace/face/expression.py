"""Measures of expression from points of a face: how open mouth and lids are, how far a face is from rest (ours).

Every measure of this package is here. Distances are of points in one picture; a face's own unit, the eye distance, is
that between its eye centres. `mouth_opening` and `lid_opening` are lengths at the middle of a ring, where expression is
read. `mean_gap` is the signed mean over a whole ring: it is linear in the points, so it can be taken of the weights of
a regression.

The paper asks for a neutral reference with the mouth slightly open (Nagle section 2). Models whose references agree in
this say the same expression with the same warp, and can drive each other: `far_from_rest` finds such frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.face.anchor import HELD, rigid_movement
from morphspace.face.mesh import INNER_LIPS, LEFT_LIDS, MOUTH_CORNERS, RIGHT_LIDS, FacePoints
from morphspace.grid import warp

LID_PAIRS = 3  # in the middle of a lid ring; a single pair moves with the gaze
# In eye distances. A mouth this open shows a little of the teeth and of the dark between them.
SLIGHTLY_OPEN = 0.07  # between the lips' inner edges, in the middle
OPEN_STEP, SHAPE_STEP = 0.04, 0.06  # that count as one step away from it, and from the clip's median face
LID_STEP = (
    0.03  # by which the lids are nearer than is usual in the clip: a blink brings them 0.06 to 0.15 nearer
)


@dataclass(frozen=True)
class Expression:
    """Measures of one face in eye distances: `mouth_opening`, `mouth_width`, `lid_opening` (mean of both eyes)."""

    mouth_opening: float
    mouth_width: float
    lid_opening: float


def expression_of(face: FacePoints) -> Expression:
    """Measure the expression of a face, in its eye distances."""
    corners = face.points[list(MOUTH_CORNERS)]
    lids = [lid_opening(face.points[list(ring)]) for ring in (RIGHT_LIDS, LEFT_LIDS)]
    unit_px = face.interocular_px
    return Expression(
        mouth_opening(face.points[list(INNER_LIPS)]) / unit_px,
        float(np.hypot(*(corners[1] - corners[0]))) / unit_px,
        sum(lids) / 2 / unit_px,
    )


def mouth_opening(inner_lips: Points) -> float:
    """Measure how far the lips' inner edges are apart in the middle, px, on the ring of inner lips (20, 2) px."""
    return _middle_gap(inner_lips, 1)


def lid_opening(lids: Points) -> float:
    """Measure how far the lids of one eye are apart in the middle, px, on its ring of lids (16, 2) px."""
    return _middle_gap(lids, LID_PAIRS)


def mean_gap(rings: AnyArray) -> AnyArray:
    """Average the gaps over each ring (k, n, 2), signed as in `ring_gaps`: (k, 2)."""
    return ring_gaps(rings).mean(axis=1)


def ring_gaps(rings: AnyArray) -> AnyArray:
    """Subtract the points of the side of a ring that comes first from those that face them on the other side.

    Parameters
    ----------
    rings
        (k, n, 2), rings of lids or lips from corner to corner and back.

    Returns
    -------
    (k, n / 2 - 1, 2) without the corners. Of inner lips it is lower minus upper.
    """
    half = rings.shape[1] // 2
    return rings[:, :half:-1] - rings[:, 1:half]


def _middle_gap(ring: Points, pairs: int) -> float:
    gaps = ring_gaps(ring[None])[0]
    first = (len(gaps) - pairs) // 2
    return float(np.hypot(*gaps[first : first + pairs].T).mean())


def far_from_rest(found: Sequence[FacePoints | None]) -> AnyArray:
    """Measure how far each face is from a calm one with the lips slightly apart, (n,) in steps; inf without a face.

    Three things count: the mouth's gap against `SLIGHTLY_OPEN`, lids nearer to each other than in the median face, and
    the points against the median face of all, root mean square after the head's movement is taken out.
    """
    far = np.full(len(found), np.inf)
    seen = [index for index, face in enumerate(found) if face is not None]
    if not seen:
        return far
    faces = [face for face in found if face is not None]
    shapes = np.array([_unmoved(face, faces[0]) for face in faces])
    off = np.sqrt(((shapes - np.median(shapes, axis=0)) ** 2).sum(axis=2).mean(axis=1))
    measures = [expression_of(face) for face in faces]
    gaps = np.array([one.mouth_opening for one in measures])
    lids = np.array([one.lid_opening for one in measures])
    shut = np.maximum(np.median(lids) - lids, 0)
    steps = ((gaps - SLIGHTLY_OPEN) / OPEN_STEP, off / SHAPE_STEP, shut / LID_STEP)
    far[seen] = np.sqrt(sum(step * step for step in steps))
    return far


def _unmoved(face: FacePoints, first: FacePoints) -> Points:
    points = warp.apply_affine(rigid_movement(face, first), face.points[list(HELD)])
    out: Points = points / first.interocular_px
    return out
