"""The three points that locate a face, and frames aligned to the reference.

Rigid head movement must not enter the warp fields (Nagle et al., section 2). Each frame is first moved by a
similarity that was fitted on the rigid part of the face. The frame keeps the movement, so that a rendered face can be
placed back into the original picture.
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
    """Nagle's faceframe: three points (x, y) px that locate a face.

    A head may be turned or tilted. Readers put the eyes in order (`io.sidecars.eyes_in_order`) and check that the
    face is upright (`model.keypoints`).

    Attributes
    ----------
    right_eye, left_eye : (x, y) px
        Eye centres; right is the subject's right, the image's left.
    philtrum : (x, y) px

    Raises
    ------
    BadInput
        If a point is not finite, or both eyes coincide.

    References
    ----------
    Nagle et al., section 3 and section 4, step 4.

    Examples
    --------
    >>> FaceFrame((20.0, 30.0), (40.0, 30.0), (30.0, 46.0)).points.tolist()
    [[20.0, 30.0], [40.0, 30.0], [30.0, 46.0]]
    """

    right_eye: tuple[float, float]
    left_eye: tuple[float, float]
    philtrum: tuple[float, float]

    def __post_init__(self) -> None:
        points = self.points
        if points.shape != (3, 2) or not np.isfinite(points).all():
            raise BadInput(
                "a faceframe has points that are not finite; expected three points x,y. Mark it again"
            )
        if (points[0] == points[1]).all():
            raise BadInput(
                f"a faceframe has both eyes at {points[0, 0]:g},{points[0, 1]:g}; expected two places. Mark it again"
            )

    @classmethod
    def at(cls, points: Points) -> FaceFrame:
        """Make the faceframe of three points (3, 2) px: right eye, left eye, philtrum."""
        (ax, ay), (bx, by), (cx, cy) = np.asarray(points, np.float64).tolist()
        return cls((ax, ay), (bx, by), (cx, cy))

    @property
    def points(self) -> Points:
        """The three points in this order, (3, 2) float64 px."""
        return np.array([self.right_eye, self.left_eye, self.philtrum], np.float64)


@dataclass(frozen=True, eq=False)
class Frame:
    """An aligned picture of a face.

    Attributes
    ----------
    image : array (h, w, 3)
        On the reference's grid.
    name : str
    registration : array (2, 3)
        Affine from a point of the aligned image to the frame before alignment.
    points : array (478, 2) px, or None
        The face points on the aligned image, (0, 2) without a face; None if the face was not searched.
    """

    image: Image
    name: str
    registration: Affine
    points: Points | None = None


def aligned(image: Image, name: str, registration: Affine, points: Points | None = None) -> Frame:
    """Align a frame with the reference: aligned(p) = image(registration p). Its `points` move with it.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.random.default_rng(1).random((4, 5, 3)).astype(np.float32)
    >>> np.allclose(aligned(picture, "one", identity_affine()).image, picture, atol=1e-6)
    True
    """
    if np.array_equal(registration, identity_affine()):
        return Frame(image, name, registration, points)
    height, width = image.shape[:2]
    moved = warp.sample(image, warp.affine_displacement(registration, height, width))
    if points is not None:
        points = warp.apply_affine(warp.inverse_affine(registration), points)
    return Frame(moved, name, registration, points)


def identity_affine() -> Affine:
    """Return the identity as an affine (2, 3).

    Examples
    --------
    >>> identity_affine().tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    return np.eye(2, 3)
