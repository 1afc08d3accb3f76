"""Frames of a face: how they are cut out of pictures, moved to the reference, and where the face lies in them.

Rigid head movement must not end up in the warp fields (Nagle section 2), so each frame is first moved by a similarity
that was fitted on the rigid part of the face. The movement is kept with the frame, so that a rendered face can be put
back where it came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from morphspace.arrays import Affine, Image, Mask, Points
from morphspace.grid import warp

RegistrationKind = Literal["none", "similarity", "affine"]
REGISTRATION_KINDS: tuple[RegistrationKind, ...] = ("none", "similarity", "affine")

# Where a face stands in a frame cropped to it, as shares of the frame's width and height: centre x, y, half axes x, y.
FACE_ELLIPSE = (0.50, 0.52, 0.37, 0.42)
RIGID_ELLIPSE = (0.50, 0.48, 0.27, 0.19)  # brow to nose
# The same two, measured from a faceframe: in eye-to-eye distances (x) and eye-to-philtrum distances (y).
FACE_FROM_FACEFRAME = (0.0, 0.55, 1.25, 2.0)
RIGID_FROM_FACEFRAME = (0.0, 0.15, 1.0, 0.75)
MOUTH_ELLIPSE = (0.50, 0.77, 0.19, 0.11)  # below the nostrils, which are dark too
MOUTH_FROM_FACEFRAME = (0.0, 1.4, 0.6, 0.5)
SOFT_EDGE = 0.15  # of the radius, over which a mask falls from 1 to 0


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """Nagle's faceframe: three points (x, y) px that place a face (sections 3 and 4, step 4).

    `right_eye` is the subject's right, on the image's left.
    """

    right_eye: tuple[float, float]
    left_eye: tuple[float, float]
    philtrum: tuple[float, float]

    @property
    def points(self) -> Points:
        """The three points in order, (3, 2) float64 px."""
        return np.array([self.right_eye, self.left_eye, self.philtrum], np.float64)

    def moved(self, points: Points) -> FaceFrame:
        """Give a faceframe with these three points (3, 2)."""
        right, left, lip = (tuple(map(float, point)) for point in points)
        return FaceFrame(right, left, lip)  # type: ignore[arg-type]


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


def face_mask(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Give a soft ellipse over the face, (h, w) in [0, 1]: by the faceframe, else where a cropped face stands."""
    return _soft_ellipse(height, width, FACE_ELLIPSE, FACE_FROM_FACEFRAME, faceframe)


def rigid_region(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Give a soft ellipse over the part of the face that moves with the skull, brow to nose, (h, w) in [0, 1]."""
    return _soft_ellipse(height, width, RIGID_ELLIPSE, RIGID_FROM_FACEFRAME, faceframe)


def mouth_region(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Give a soft ellipse over where the mouth is to be expected, (h, w) in [0, 1]."""
    return _soft_ellipse(height, width, MOUTH_ELLIPSE, MOUTH_FROM_FACEFRAME, faceframe)


def _soft_ellipse(
    height: int,
    width: int,
    of_frame: tuple[float, float, float, float],
    of_faceframe: tuple[float, float, float, float],
    faceframe: FaceFrame | None,
) -> Mask:
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if faceframe is None:
        centre_x, centre_y, half_x, half_y = np.array(of_frame) * (width, height, width, height)
        across, down = x - centre_x, y - centre_y
    else:
        right, left, lip = faceframe.points
        eyes = (right + left) / 2
        axis_x, axis_y = left - right, lip - eyes
        unit_x, unit_y = axis_x / np.hypot(*axis_x), axis_y / np.hypot(*axis_y)
        half_x, half_y = of_faceframe[2] * np.hypot(*axis_x), of_faceframe[3] * np.hypot(*axis_y)
        centre = eyes + of_faceframe[0] * axis_x + of_faceframe[1] * axis_y
        across = (x - centre[0]) * unit_x[0] + (y - centre[1]) * unit_x[1]
        down = (x - centre[0]) * unit_y[0] + (y - centre[1]) * unit_y[1]
    radius = np.sqrt((across / half_x) ** 2 + (down / half_y) ** 2)
    return np.clip((1 - radius) / SOFT_EDGE + 0.5, 0, 1).astype(np.float32)
