"""Measures of expression from face points: mouth and lid opening, and distance from neutral (ours).

Lengths are divided by the distance between the eye centres. `mouth_opening` and `lid_opening` are lengths at the
middle of a ring, where expressions change it most. `mean_gap` is the signed mean over a whole ring. It is linear in
the points, so it applies to the weights of a regression as well.

Nagle et al. (section 2) ask for a neutral reference with a slightly open mouth. Models whose references agree in this
express the same expression by the same warp, and can drive each other. `distance_from_neutral` finds such frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.face.anchor import HELD, rigid_movement
from morphspace.face.mesh import INNER_LIPS, LEFT_LIDS, MOUTH_CORNERS, RIGHT_LIDS, FacePoints
from morphspace.grid import warp

LID_PAIRS = 3  # pairs in the middle of a lid ring; a single pair moves with the gaze
# Eye distances between the lips' inner edges. With .1 a clip of mostly closed lips takes a closed reference, whose warp
# cannot open; with .3 the inner lips are left over (six people).
PARTED = 0.15
CLOSED_STEP, OPEN_STEP = 0.04, 0.08  # eye distances of one step below and above it
SHAPE_STEP = 0.06  # eye distances of one step from the clip's median face
# Eye distances of one step, lids closer than the clip's median; a blink closes them by 0.06 to 0.15.
LID_STEP = 0.03


@dataclass(frozen=True)
class Expression:
    """Measures of one face in eye distances.

    Attributes
    ----------
    mouth_opening : float
    mouth_width : float
    lid_opening : float
        Mean of both eyes.
    """

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
    """Measure the distance between the lips' inner edges in the middle, px, on the ring of inner lips (20, 2) px.

    Examples
    --------
    >>> import numpy as np
    >>> turn = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    >>> round(mouth_opening(np.column_stack([-10 * np.cos(turn), 4 * np.sin(turn)])), 2)
    8.0
    """
    return _middle_gap(inner_lips, 1)


def lid_opening(lids: Points) -> float:
    """Measure the distance between the lids of one eye in the middle, px, on its ring of lids (16, 2) px.

    Examples
    --------
    >>> import numpy as np
    >>> y = np.array([0, *[-2] * 7, 0, *[2] * 7])
    >>> lid_opening(np.column_stack([np.zeros(16), y]))
    4.0
    """
    return _middle_gap(lids, LID_PAIRS)


def mean_gap(rings: AnyArray) -> AnyArray:
    """Average the gaps over each ring (k, n, 2), signed as in `ring_gaps`: (k, 2)."""
    return ring_gaps(rings).mean(axis=1)


def ring_gaps(rings: AnyArray) -> AnyArray:
    """Subtract the first side of each ring from the opposite side, point by point.

    Parameters
    ----------
    rings : array (k, n, 2)
        Lids or lips, from corner to corner and back.

    Returns
    -------
    array (k, n / 2 - 1, 2)
        Without the corners. For inner lips it is lower minus upper.

    Examples
    --------
    >>> import numpy as np
    >>> ring = np.array([[0, 0], [1, -1], [2, -2], [3, 0], [2, 2], [1, 1]])
    >>> ring_gaps(ring[None]).tolist()
    [[[0, 2], [0, 4]]]
    """
    half = rings.shape[1] // 2
    return rings[:, :half:-1] - rings[:, 1:half]


def _middle_gap(ring: Points, pairs: int) -> float:
    gaps = ring_gaps(ring[None])[0]
    first = (len(gaps) - pairs) // 2
    return float(np.hypot(*gaps[first : first + pairs].T).mean())


def distance_from_neutral(found: Sequence[FacePoints | None]) -> AnyArray:
    """Measure the distance (n,) in steps of each face from neutral with parted lips; inf without a face.

    The distance is the root of three summed squares, each in its own step: the mouth opening against `PARTED`,
    lids closer than in the median face, and the points against the median face, rms without head movement.
    """
    far = np.full(len(found), np.inf)
    with_face = [index for index, face in enumerate(found) if face is not None]
    if not with_face:
        return far
    faces = [face for face in found if face is not None]
    shapes = np.array([_unmoved(face, faces[0]) for face in faces])
    off = np.sqrt(((shapes - np.median(shapes, axis=0)) ** 2).sum(axis=2).mean(axis=1))
    measures = [expression_of(face) for face in faces]
    gaps = np.array([one.mouth_opening for one in measures])
    lids = np.array([one.lid_opening for one in measures])
    shut = np.maximum(np.median(lids) - lids, 0)
    apart = (gaps - PARTED) / np.where(gaps < PARTED, CLOSED_STEP, OPEN_STEP)
    steps = (apart, off / SHAPE_STEP, shut / LID_STEP)
    far[with_face] = np.sqrt(sum(step * step for step in steps))
    return far


def _unmoved(face: FacePoints, first: FacePoints) -> Points:
    points = warp.apply_affine(rigid_movement(face, first), face.points[list(HELD)])
    out: Points = points / first.interocular_px
    return out
