"""How far a face is from rest, by its points: what makes a reference that different people can share (ours).

The paper asks for a neutral reference with the mouth slightly open (Nagle section 2). Models whose references agree in
this say the same expression with the same warp, and can drive each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.face.anchor import HELD, rigid_movement
from morphspace.face.mesh import LOWER_LIP_TOP, UPPER_LIP_BOTTOM, FacePoints
from morphspace.grid import warp

# In eye distances. A mouth this open shows a little of the teeth and of the dark between them.
SLIGHTLY_OPEN = 0.07  # between the lips' inner edges, in the middle
OPEN_STEP, SHAPE_STEP = 0.04, 0.06  # that count as one step away from it, and from the clip's median face
LID_STEP = (
    0.03  # by which the lids are nearer than is usual in the clip: a blink brings them 0.06 to 0.15 nearer
)
UPPER_LIDS, LOWER_LIDS = (160, 159, 158, 385, 386, 387), (144, 145, 153, 380, 374, 373)  # facing each other


def mouth_gap(face: FacePoints) -> float:
    """Give how far the lips' inner edges are apart in the middle, in eye distances."""
    upper, lower = face.points[UPPER_LIP_BOTTOM], face.points[LOWER_LIP_TOP]
    return float(np.hypot(*(lower - upper))) / face.interocular_px


def lid_gap(face: FacePoints) -> float:
    """Give how far the lids are apart in the middle, mean of both eyes, in eye distances."""
    apart = face.points[list(UPPER_LIDS)] - face.points[list(LOWER_LIDS)]
    return float(np.hypot(*apart.T).mean()) / face.interocular_px


def far_from_rest(found: Sequence[FacePoints | None]) -> AnyArray:
    """Give for each face (n,) how far it is from a calm one with the lips slightly apart, in steps; inf without face.

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
    gaps = np.array([mouth_gap(face) for face in faces])
    lids = np.array([lid_gap(face) for face in faces])
    shut = np.maximum(np.median(lids) - lids, 0)
    steps = ((gaps - SLIGHTLY_OPEN) / OPEN_STEP, off / SHAPE_STEP, shut / LID_STEP)
    far[seen] = np.sqrt(sum(step * step for step in steps))
    return far


def _unmoved(face: FacePoints, first: FacePoints) -> Points:
    points = warp.apply_affine(rigid_movement(face, first), face.points[list(HELD)])
    out: Points = points / first.interocular_px
    return out
