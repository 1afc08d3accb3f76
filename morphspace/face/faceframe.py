"""The three points that place a face, and frames of it that are moved to the reference.

Rigid head movement must not end up in the warp fields (Nagle section 2), so each frame is first moved by a similarity
that was fitted on the rigid part of the face. The movement is kept with the frame, so that a rendered face can be put
back where it came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from morphspace.arrays import Affine, Image, Points
from morphspace.errors import BadInput
from morphspace.grid import warp

RegistrationKind = Literal["none", "similarity", "affine"]
REGISTRATION_KINDS: tuple[RegistrationKind, ...] = ("none", "similarity", "affine")


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """Nagle's faceframe: three points (x, y) px that place a face (sections 3 and 4, step 4).

    `right_eye` is the subject's right, on the image's left. Raises `BadInput` for points that are not finite, and for
    both eyes in one place. A head may be turned or tilted, so nothing else is asked of the points here; readers put the
    eyes in order (`io.sidecars.eyes_in_order`) and check that the face stands upright (`model.keypoints`).
    """

    right_eye: tuple[float, float]
    left_eye: tuple[float, float]
    philtrum: tuple[float, float]

    def __post_init__(self) -> None:
        points = self.points
        if points.shape != (3, 2) or not np.isfinite(points).all():
            raise BadInput("a faceframe is not three finite points x,y: mark it again")
        if (points[0] == points[1]).all():
            raise BadInput(f"a faceframe has both eyes at {points[0, 0]:g},{points[0, 1]:g}: mark it again")

    @classmethod
    def at(cls, points: Points) -> FaceFrame:
        """Make the faceframe of three points (3, 2) px: right eye, left eye, philtrum."""
        (ax, ay), (bx, by), (cx, cy) = np.asarray(points, np.float64).tolist()
        return cls((ax, ay), (bx, by), (cx, cy))

    @property
    def points(self) -> Points:
        """The three points in order, (3, 2) float64 px."""
        return np.array([self.right_eye, self.left_eye, self.philtrum], np.float64)


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a face on the reference's grid: image (h, w, 3) | name | registration.

    `registration` (2, 3) maps a point of the aligned image to the model frame as it was before alignment.
    """

    image: Image
    name: str
    registration: Affine


def aligned(image: Image, name: str, registration: Affine) -> Frame:
    """Bring a model frame to the reference: aligned(p) = image(registration p)."""
    if np.array_equal(registration, identity_affine()):
        return Frame(image, name, registration)
    height, width = image.shape[:2]
    return Frame(
        warp.sample(image, warp.affine_displacement(registration, height, width)), name, registration
    )


def identity_affine() -> Affine:
    """Give the affine (2, 3) that moves nothing."""
    return np.eye(2, 3)
