"""Where things are on a face: the landmarks, lid and lip lines that all of the drawing is tied to.

The same record describes a painted face and a portrait photograph, so that both are moved by the same
expression fields. Everything is in face units with the origin between the eyes, x to the picture's right, y
down. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from morphspace.arrays import AnyArray, Points
from morphspace.synthetic.parameters import Identity


@dataclass(frozen=True, eq=False)
class Aperture:
    """An opening in the skin between two corners: the lids of an eye, or the lips.

    The upper margin is the chord between the corners minus `up` times an arch, the lower margin the chord
    plus `low` times an arch; `bow` bends both. A skew moves the top of an arch towards the picture's right.
    Ours.
    """

    left: tuple[float, float]  # the corner on the picture's left
    right: tuple[float, float]
    up: float
    low: float
    bow: float = 0.0
    skew_up: float = 0.0
    skew_low: float = 0.0

    @property
    def centre(self) -> tuple[float, float]:
        """The middle between the two corners."""
        return ((self.left[0] + self.right[0]) / 2, (self.left[1] + self.right[1]) / 2)

    @property
    def half_width(self) -> float:
        """Half the distance between the corners along x."""
        return (self.right[0] - self.left[0]) / 2

    def along(self, x: ArrayLike) -> AnyArray:
        """Return the position along the chord: -1 at the left corner, 1 at the right one."""
        return (np.asarray(x) - self.centre[0]) / self.half_width

    def arch(self, x: ArrayLike, skew: float = 0.0) -> AnyArray:
        """Return the arch: 0 at and beyond the corners, 1 near the middle."""
        t = np.clip(self.along(x), -1.0, 1.0)
        return np.asarray((1 - np.abs(t) ** 2.2) * (1 + skew * t))

    def line(self, x: ArrayLike) -> AnyArray:
        """Return the height of the chord with its bow; it goes on beyond the corners with the chord's slope."""
        slope = (self.right[1] - self.left[1]) / (2 * self.half_width)
        t = self.along(x)
        bend = np.where(np.abs(t) < 1, 1 - t**2, 0.0)
        return np.asarray(self.centre[1] + slope * (np.asarray(x) - self.centre[0]) + self.bow * bend)

    def upper(self, x: ArrayLike) -> AnyArray:
        """Return the height of the upper margin."""
        return np.asarray(self.line(x) - self.up * self.arch(x, self.skew_up))

    def lower(self, x: ArrayLike) -> AnyArray:
        """Return the height of the lower margin."""
        return np.asarray(self.line(x) + self.low * self.arch(x, self.skew_low))

    def point(self, t: float, margin: str) -> tuple[float, float]:
        """Return the point at position `t` of the `upper` or `lower` margin."""
        x = self.centre[0] + t * self.half_width
        height = self.upper if margin == "upper" else self.lower
        return (x, float(height(np.float64(x))))


@dataclass(frozen=True, eq=False)
class FaceGeometry:
    """The landmarks of a face in face units, and its place on the canvas (px). Ours."""

    unit_px: float
    origin_px: tuple[float, float]  # of the point between the eyes
    right_eye: Aperture  # the subject's right, on the picture's left
    left_eye: Aperture
    mouth: Aperture
    right_brow: Points  # (m, 2) from the inner end to the outer end
    left_brow: Points
    nose_tip: tuple[float, float]
    nose_base: float
    nose_width: float
    chin: float
    face_width: float
    jaw_width: float
    lip_upper: float
    lip_lower: float
    iris_radius: float
    right_iris: tuple[float, float]
    left_iris: tuple[float, float]

    def grid(self, width: int, height: int, scale: int = 1) -> tuple[AnyArray, AnyArray]:
        """Return x and y in face units at the pixels of a canvas (`height`, `width`) refined `scale` times."""
        x = (np.arange(width * scale) + 0.5) / scale - 0.5
        y = (np.arange(height * scale) + 0.5) / scale - 0.5
        grid = np.meshgrid((x - self.origin_px[0]) / self.unit_px, (y - self.origin_px[1]) / self.unit_px)
        return grid[0].astype(np.float32), grid[1].astype(np.float32)

    def to_px(self, points: AnyArray) -> Points:
        """Carry points from face units to canvas pixels."""
        return np.asarray(np.asarray(points, np.float64) * self.unit_px + np.asarray(self.origin_px))

    def keypoints(self) -> dict[str, tuple[tuple[float, float], str]]:
        """Return each keypoint of the neutral face: its place in face units and the layer it is on.

        The layer is `upper` (skin above a cut), `lower` (skin below it), `right_iris`, `left_iris`.
        """
        named: dict[str, tuple[tuple[float, float], str]] = {}
        for side, eye, brow, iris in (
            ("right", self.right_eye, self.right_brow, self.right_iris),
            ("left", self.left_eye, self.left_brow, self.left_iris),
        ):
            corners = (eye.right, eye.left) if side == "right" else (eye.left, eye.right)
            named[f"{side}_eye_inner"] = (corners[0], "upper")
            named[f"{side}_eye_outer"] = (corners[1], "upper")
            for place, t in (("left", -0.5), ("middle", 0.0), ("right", 0.5)):
                named[f"{side}_lid_upper_{place}"] = (eye.point(t, "upper"), "upper")
                named[f"{side}_lid_lower_{place}"] = (eye.point(t, "lower"), "lower")
            named[f"{side}_iris"] = (iris, f"{side}_iris")
            for place, (x, y) in zip(
                ("inner", "middle", "outer"), brow[[0, len(brow) // 2, -1]], strict=True
            ):
                named[f"{side}_brow_{place}"] = ((float(x), float(y)), "upper")
            cheek = (-0.62 if side == "right" else 0.62) * self.face_width / 0.97
            named[f"{side}_cheek"] = ((cheek, 0.45), "upper")
        x_nose = self.nose_tip[0]
        named["nose_bridge"] = ((x_nose, 0.02), "upper")
        named["nose_tip"] = (self.nose_tip, "upper")
        named["right_nostril"] = ((x_nose - 0.8 * self.nose_width, self.nose_base - 0.04), "upper")
        named["left_nostril"] = ((x_nose + 0.8 * self.nose_width, self.nose_base - 0.04), "upper")
        named["philtrum"] = (self.philtrum, "upper")
        named["mouth_right"] = (self.mouth.left, "upper")
        named["mouth_left"] = (self.mouth.right, "upper")
        for place, t in (("right", -0.5), ("middle", 0.0), ("left", 0.5)):
            named[f"lip_upper_{place}"] = (self.mouth.point(t, "upper"), "upper")
            named[f"lip_lower_{place}"] = (self.mouth.point(t, "lower"), "lower")
        named["lip_upper_edge"] = (self.lip_edge(0.0, "upper"), "upper")
        named["lip_lower_edge"] = (self.lip_edge(0.0, "lower"), "lower")
        named["chin"] = ((self.mouth.centre[0], self.chin), "lower")
        named["glabella"] = ((x_nose, -0.28), "upper")
        named["forehead"] = ((x_nose, -0.65), "upper")
        return named

    @property
    def philtrum(self) -> tuple[float, float]:
        """The middle of the philtrum, between the nose and the upper lip's edge."""
        return (self.nose_tip[0], (self.nose_base + self.lip_edge(0.0, "upper")[1]) / 2)

    def lip_edge(self, t: float, side: str) -> tuple[float, float]:
        """Return the point at position `t` of the vermilion's outer edge (`upper` or `lower`)."""
        x = np.float64(self.mouth.centre[0] + t * self.mouth.half_width)
        edge = self.lip_upper_edge(x) if side == "upper" else self.lip_lower_edge(x)
        return (float(x), float(edge))

    def lip_upper_edge(self, x: ArrayLike) -> AnyArray:
        """Return the height of the upper lip's outer edge, with its bow."""
        t = np.clip(self.mouth.along(x), -1.0, 1.0)
        bow = 0.82 + 0.26 * np.exp(-(((np.abs(t) - 0.24) / 0.16) ** 2)) - 0.05 * np.exp(-((t / 0.1) ** 2))
        return np.asarray(self.mouth.upper(x) - self.lip_upper * bow * (1 - np.abs(t) ** 1.7))

    def lip_lower_edge(self, x: ArrayLike) -> AnyArray:
        """Return the height of the lower lip's outer edge."""
        t = np.clip(self.mouth.along(x), -1.0, 1.0)
        return np.asarray(self.mouth.lower(x) + self.lip_lower * (1 - np.abs(t) ** 2.3))


UNITS_IN_HEIGHT = 3.70  # face units from the top border to the bottom one: the head fills the picture
EYE_LEVEL = 0.455  # of the picture's height


def geometry_of(identity: Identity, size: tuple[int, int], margin: int) -> FaceGeometry:
    """Lay an identity's landmarks out on a picture of `size` (width, height) and `margin` px around."""
    width, height = size
    unit = min(height / UNITS_IN_HEIGHT, width / 2.75)
    origin = (margin + (width - 1) / 2, margin + EYE_LEVEL * height)
    eye_y, half, tilt = 0.0, identity.eye_width, identity.eye_tilt
    up, low = identity.eye_opening * 0.60, identity.eye_opening * 0.40
    x = identity.eye_spacing

    right_eye = Aperture((-x - half, eye_y - tilt), (-x + half, eye_y + tilt), up, low, 0.0, 0.16, -0.22)
    left_eye = Aperture((x - half, eye_y + tilt), (x + half, eye_y - tilt), up, low, 0.0, -0.16, 0.22)
    y = identity.mouth_drop
    apart = identity.lips_apart
    wide = identity.mouth_width
    mouth = Aperture((-wide, y - 0.005), (wide, y - 0.005), apart * 0.45, apart * 0.55, 0.012)
    t = np.linspace(0.0, 1.0, 13)
    brow_x = 0.17 + t * (x + half + 0.07 - 0.17)
    arch = identity.brow_arch * (np.sin(np.pi * np.clip(t * 0.86, 0, 1) ** 1.5) * 1.5 - 0.35)
    brow_y = -identity.brow_height + 0.03 - arch + 0.10 * np.clip(t - 0.66, 0, None)
    left_brow = np.stack([brow_x, brow_y], axis=1)
    iris_y = -0.022
    return FaceGeometry(
        unit_px=unit,
        origin_px=origin,
        right_eye=right_eye,
        left_eye=left_eye,
        mouth=mouth,
        right_brow=left_brow * (-1, 1),
        left_brow=left_brow,
        nose_tip=(0.0, identity.nose_length - 0.11),
        nose_base=identity.nose_length,
        nose_width=identity.nose_width,
        chin=identity.chin_drop,
        face_width=identity.face_width,
        jaw_width=identity.jaw_width,
        lip_upper=identity.lip_upper,
        lip_lower=identity.lip_lower,
        iris_radius=0.088,
        right_iris=(-x, iris_y),
        left_iris=(x, iris_y),
    )
