"""How expression moves the skin: a smooth displacement field for each action, on either side of the slits.

Skin is one rubber sheet with three slits (two eyes, the mouth). Each field exists twice: as the skin above
the slits moves (`upper`) and as the skin below them moves (`lower`); away from a slit and beyond its corners
the two are equal. A frame's field is a weighted sum of these, evaluated at the pixels of the neutral canvas
and taken as bilinear in between: that is the definition of the motion, so the stored truth is exact, not an
estimate. Ours.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from morphspace.arrays import AnyArray, Displacement, Points
from morphspace.synthetic.geometry import Aperture, FaceGeometry
from morphspace.synthetic.inverse import box_of
from morphspace.synthetic.parameters import Expression

SEAM = (0.385, 0.405)  # face units: between the eyes' slits and the mouth's, both sheets are one skin here
JAW_DROP = 0.35  # face units, at jaw_open 1
GAZE_X, GAZE_Y = 0.075, 0.045  # face units the iris moves at gaze 1
LEAST_PX = 1e-3  # a field's far tails end here, so that it is exactly zero over most of the picture
LID_SHARE = 0.86  # of the closing gap which the upper lid travels; the lower lid does the rest

Box = tuple[slice, slice] | None


def smooth(t: ArrayLike) -> AnyArray:
    """Return the cubic step: 0 below 0, 1 above 1, level at both ends."""
    share = np.clip(np.asarray(t), 0.0, 1.0)
    return np.asarray(share * share * (3 - 2 * share))


def bump(x: ArrayLike, y: ArrayLike, at: tuple[ArrayLike, ArrayLike], wide: float, high: float) -> AnyArray:
    """Return a Gaussian bump with the two standard deviations, 1 at its middle."""
    across, down = np.subtract(x, at[0]) / wide, np.subtract(y, at[1]) / high
    return np.asarray(np.exp(-0.5 * (across**2 + down**2)))


class Sheet:
    """The two displacement sheets of one action."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.upper = np.zeros((*shape, 2), np.float32)
        self.lower = np.zeros((*shape, 2), np.float32)

    def add(self, dx: AnyArray | float, dy: AnyArray | float) -> None:
        """Move both sides of the slits alike."""
        for side in (self.upper, self.lower):
            side[..., 0] += dx
            side[..., 1] += dy


def _corner_profile(t: AnyArray) -> AnyArray:
    """Return a profile that is 0 at the middle of the mouth, 1 at its corners and fades beyond."""
    return np.asarray(t * t * np.exp(1 - t * t))


def _sideways_profile(t: AnyArray) -> AnyArray:
    """Return an odd profile that is 1 at the right corner, -1 at the left one and fades beyond."""
    return np.asarray(t * np.exp((1 - t * t) / 2))


def _brow_gap(eye: Aperture, brow: Points) -> float:
    """Return the height between the upper lid and the middle of the brow, which lid and brow share."""
    middle = brow[len(brow) // 2]
    return float(eye.upper(np.float64(eye.centre[0])) - middle[1])


def _lid(
    sheet: AnyArray, eye: Aperture, x: AnyArray, y: AnyArray, travel: AnyArray, margin: str, brow_gap: float
) -> None:
    """Move one lid by `travel` (face units, down) at its margin, fading to both sides."""
    if margin == "upper":
        into_skin, hidden = eye.upper(x) - y, y - eye.upper(x)
        reach = min(0.17, 0.85 * brow_gap)
    else:
        into_skin, hidden = y - eye.lower(x), eye.lower(x) - y
        reach = 0.26
    plate = 0.018  # face units of lid margin that move as one piece, so that lashes keep their thickness
    inside = 1 - smooth((into_skin - plate) / reach)
    outside = 1 - smooth(hidden / 0.27)
    sheet[..., 1] += travel * np.where(into_skin > 0, inside, outside)


def _eye_actions(face: FaceGeometry, x: AnyArray, y: AnyArray, out: dict[str, Sheet]) -> None:
    for side, eye, brow in (
        ("right", face.right_eye, face.right_brow),
        ("left", face.left_eye, face.left_brow),
    ):
        gap = eye.lower(x) - eye.upper(x)
        brow_gap = _brow_gap(eye, brow)
        close = out[f"upper_lid_{side}"]
        _lid(close.upper, eye, x, y, gap, "upper", brow_gap)
        raise_low = out[f"lower_lid_{side}"]
        _lid(raise_low.lower, eye, x, y, -gap, "lower", brow_gap)


def _brow_actions(face: FaceGeometry, x: AnyArray, y: AnyArray, out: dict[str, Sheet]) -> None:
    for eye, brow in ((face.right_eye, face.right_brow), (face.left_eye, face.left_brow)):
        inner, outer = brow[len(brow) // 12], brow[-1 - len(brow) // 5]
        lift = smooth((eye.upper(x) - 0.03 - y) / max(0.9 * _brow_gap(eye, brow), 0.10))
        out["brow_inner_raise"].add(0, -0.150 * lift * bump(x, y, (inner[0], inner[1] - 0.05), 0.21, 0.36))
        out["brow_outer_raise"].add(0, -0.135 * lift * bump(x, y, (outer[0], outer[1] - 0.05), 0.25, 0.34))
        middle = brow[len(brow) // 3]
        down = lift * bump(x, y, (middle[0], middle[1] - 0.05), 0.24, 0.30)
        squeeze = lift * bump(x, y, (inner[0], inner[1]), 0.15, 0.22)
        out["brow_lower"].add(-0.060 * np.sign(inner[0]) * squeeze, 0.078 * down)
        cheek = (0.56 * np.sign(inner[0]), 0.40)
        under = smooth((y - eye.lower(x) - 0.015) / 0.20)
        out["cheek_raise"].add(0.0, -0.085 * under * bump(x, y, cheek, 0.26, 0.22))


def _nose_actions(face: FaceGeometry, x: AnyArray, y: AnyArray, out: dict[str, Sheet]) -> None:
    base, middle = face.nose_base, face.nose_tip[0]
    for sign in (-1.0, 1.0):
        ala = (middle + sign * (face.nose_width - 0.02), base - 0.10)
        out["nose_wrinkle"].add(-0.012 * sign, -0.060 * bump(x, y, ala, 0.13, 0.20))
        brow = (middle + sign * 0.16, -face.right_eye.up - 0.16)
        out["nose_wrinkle"].add(0.0, 0.040 * bump(x, y, brow, 0.16, 0.10))
        out["upper_lip_raise"].add(0.0, -0.035 * bump(x, y, ala, 0.16, 0.16))
        out["lip_corner_up"].add(0.010 * sign, -0.014 * bump(x, y, ala, 0.10, 0.12))


def _mouth_actions(face: FaceGeometry, x: AnyArray, y: AnyArray, out: dict[str, Sheet]) -> None:
    mouth = face.mouth
    t = mouth.along(x)
    v = y - mouth.line(x)
    within = np.clip(t, -1, 1) ** 2
    arch = (1 - within) * (1 + 0.55 * within)  # rounder than a parabola, with a finite slope at the corners
    above, below = mouth.upper(x) - y, y - mouth.lower(x)
    room = face.mouth.centre[1] - face.nose_base  # face units between nose and lips
    into_upper = 1 - smooth((above - 0.02) / (1.05 * room))
    into_lower = 1 - smooth((below - 0.03) / 0.34)
    slit = smooth((y - SEAM[1]) / 0.30)  # nothing of the mouth's slit reaches the eyes' one

    corner, side = _corner_profile(t), _sideways_profile(t)
    around = bump(0.0, v + 0.02, (0.0, 0.0), 1.0, 0.20)
    wide = bump(0.0, v + 0.10, (0.0, 0.0), 1.0, 0.26)
    out["lip_corner_up"].add(0.090 * side * around, -0.125 * corner * wide + 0.012 * arch * around)
    out["lip_corner_up"].upper[..., 1] -= 0.035 * arch * np.where(above > 0, into_upper, 1.0)
    out["lip_corner_up"].lower[..., 1] += 0.010 * arch * np.where(below > 0, into_lower, 1.0) * slit
    for sign in (-1.0, 1.0):
        cheek = (mouth.centre[0] + sign * 0.58, 0.50)
        low_lid = smooth((y - 0.13) / 0.25)
        out["lip_corner_up"].add(
            0.020 * sign * bump(x, y, cheek, 0.2, 0.2), -0.045 * low_lid * bump(x, y, cheek, 0.24, 0.22)
        )
    low = bump(0.0, v - 0.06, (0.0, 0.0), 1.0, 0.20)
    out["lip_corner_down"].add(0.020 * side * around, 0.085 * corner * low - 0.012 * arch * around)

    out["lip_pucker"].add(
        -0.125 * side * bump(0.0, v, (0.0, 0.0), 1.0, 0.20),
        0.30 * v * arch * bump(0.0, v, (0.0, 0.0), 1.0, 0.16),
    )
    out["lip_stretch"].add(0.105 * side * around, 0.030 * corner * low)
    out["lip_stretch"].lower[..., 1] += 0.020 * arch * into_lower * slit

    gap = mouth.lower(x) - mouth.upper(x)
    press = out["lip_press"]
    press.upper[..., 1] += 0.40 * gap * np.where(above > 0, into_upper, 1 - smooth(-above / 0.5))
    press.lower[..., 1] -= 0.60 * gap * np.where(below > 0, into_lower, 1 - smooth(-below / 0.5)) * slit

    lift = out["upper_lip_raise"]
    lift.upper[..., 1] -= 0.085 * arch * np.where(above > 0, into_upper, 1.0)
    drop = out["lower_lip_drop"]
    drop.lower[..., 1] += 0.085 * arch * np.where(below > 0, into_lower, 1.0) * slit

    ball = bump(x, y, (mouth.centre[0], face.chin - 0.20), 0.26, 0.17)
    out["chin_raise"].add(0.0, -0.060 * ball)
    out["chin_raise"].lower[..., 1] -= 0.025 * arch * np.where(below > 0, into_lower, 1.0) * slit

    hinge = 0.30 + 0.45 * smooth(np.abs(x) / 0.9)  # skin far from the middle stretches from further up
    swing = smooth((v + hinge) / (hinge + 0.46))
    across = 1 - smooth((np.abs(x) - 0.45) / 0.85)
    neck = 1 - 0.85 * smooth((y - face.chin - 0.02) / 0.95)
    jaw_upper = swing * (1 - 0.97 * arch)
    jaw_lower = swing + (1 - swing) * arch * slit
    for name, axis, size in (("jaw_open", 1, JAW_DROP), ("jaw_sideways", 0, 0.11)):
        out[name].upper[..., axis] += size * across * neck * jaw_upper
        out[name].lower[..., axis] += size * across * neck * jaw_lower
    out["jaw_open"].add(-0.050 * side * bump(0.0, v, (0.0, 0.0), 1.0, 0.25), 0.0)


BASIS_NAMES = (
    "brow_inner_raise",
    "brow_outer_raise",
    "brow_lower",
    "cheek_raise",
    "nose_wrinkle",
    "upper_lip_raise",
    "lip_corner_up",
    "lip_corner_down",
    "lower_lip_drop",
    "chin_raise",
    "lip_pucker",
    "lip_stretch",
    "lip_press",
    "jaw_open",
    "jaw_sideways",
    "upper_lid_right",
    "upper_lid_left",
    "lower_lid_right",
    "lower_lid_left",
)


def basis_fields(face: FaceGeometry, width: int, height: int) -> AnyArray:
    """Return each field at amount 1, on each side of the slits: (2, k, height, width, 2) float32 px."""
    x, y = face.grid(width, height)
    out = {name: Sheet(x.shape) for name in BASIS_NAMES}
    _eye_actions(face, x, y, out)
    _brow_actions(face, x, y, out)
    _nose_actions(face, x, y, out)
    _mouth_actions(face, x, y, out)
    upper = np.stack([out[name].upper for name in BASIS_NAMES])
    lower = np.stack([out[name].lower for name in BASIS_NAMES])
    basis = np.stack([upper, lower]) * np.float32(face.unit_px)
    basis[np.abs(basis) < LEAST_PX] = 0.0
    return basis


def basis_amounts(expression: Expression) -> dict[str, float]:
    """Turn actions into amounts of the basis fields.

    Only the lids are not one to one: gaze down lowers the upper lid, cheek raising and wrinkling lift the
    lower one, and together they never travel further than the gap between them. A squeeze also calls a little
    of its neighbours.
    """
    given: Mapping[str, float] = expression.as_dict()
    amounts = {name: given.get(name, 0.0) for name in BASIS_NAMES}
    lift = 0.20 * given["cheek_raise"] + 0.14 * given["nose_wrinkle"] + 0.08 * given["lip_corner_up"]
    gaze = 0.26 * max(given["gaze_y"], 0.0) + 0.12 * min(given["gaze_y"], 0.0)
    widen = given["lid_widen"] * (1 - 0.55 * given["brow_lower"])  # the lowered brow stands in its way
    for side in ("right", "left"):
        close = given[f"lid_close_{side}"]
        low = lift * (1 - 0.5 * close) + (1 - LID_SHARE) * close
        up = LID_SHARE * close + (1 - close) * (gaze + 0.10 * given["brow_lower"] - 0.34 * widen)
        low -= (1 - close) * (0.10 * widen + 0.08 * max(given["gaze_y"], 0.0))
        amounts[f"lower_lid_{side}"] = low
        amounts[f"upper_lid_{side}"] = min(up, 1.0 - low)
    amounts["lower_lip_drop"] += 0.12 * given["nose_wrinkle"] * given["upper_lip_raise"]
    return amounts


def basis_boxes(basis: AnyArray) -> tuple[Box, ...]:
    """Return the rows and columns in which each field of a basis is not zero."""
    return tuple(box_of(np.any(basis[:, k] != 0, axis=(0, 3)), 0) for k in range(basis.shape[1]))


def combine(
    basis: AnyArray, boxes: tuple[Box, ...], amounts: Mapping[str, float]
) -> tuple[Displacement, Displacement]:
    """Add the basis fields up: the upper and the lower sheet, each (height, width, 2) float32 px."""
    total = np.zeros((2, *basis.shape[2:]), np.float32)
    for k, name in enumerate(BASIS_NAMES):
        box = boxes[k]
        if amounts[name] and box is not None:
            total[:, *box] += np.float32(amounts[name]) * basis[:, k, *box]
    return total[0], total[1]
