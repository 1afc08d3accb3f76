"""Creases and shading that deepen with expression, painted into the neutral skin. Ours.

Each map is a log brightness change per unit of amount on the fine neutral canvas: a dark valley with a
brighter bulge beside it. The amounts follow from the expression.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.synthetic.fields import Box, bump, smooth
from morphspace.synthetic.geometry import FaceGeometry
from morphspace.synthetic.inverse import box_of
from morphspace.synthetic.parameters import Expression

LEAST_SHADE = 1e-3  # log brightness which nobody sees

CREASE_NAMES = (
    "nasolabial",
    "forehead",
    "glabella",
    "crow_feet",
    "nose",
    "corner_pit",
    "corner_droop",
    "chin_dimples",
    "pucker",
    "lid_fold_right",
    "lid_fold_left",
    "cheek_ball",
    "under_lip",
)
"""The crease maps, in the order of `crease_maps`."""


def _along(points: Points, x: AnyArray, y: AnyArray, width: float, bulge: tuple[float, float]) -> AnyArray:
    """Return a valley along a polyline, tapering at both ends, with a bright bulge shifted to one side."""
    dark = np.zeros(x.shape, np.float32)
    light = np.zeros(x.shape, np.float32)
    near = (
        (x > points[:, 0].min() - 0.2)
        & (x < points[:, 0].max() + 0.2)
        & (y > points[:, 1].min() - 0.2)
        & (y < points[:, 1].max() + 0.2)
    )
    px, py = x[near], y[near]
    steps = np.diff(points, axis=0)
    starts = np.arange(len(steps)) / len(steps)
    for target, shift, wide in ((dark, (0.0, 0.0), width), (light, bulge, 1.8 * width)):
        best = np.zeros(px.shape, np.float32)
        for (ax, ay), (bx, by), start in zip(points[:-1], steps, starts, strict=True):
            qx, qy = px - np.float32(ax + shift[0]), py - np.float32(ay + shift[1])
            t = np.clip((qx * np.float32(bx) + qy * np.float32(by)) / np.float32(bx**2 + by**2), 0, 1)
            square = (qx - t * np.float32(bx)) ** 2 + (qy - t * np.float32(by)) ** 2
            taper = np.sin(np.pi * np.clip(start + t / len(steps), 0.01, 0.99)) ** 0.6
            best = np.maximum(best, taper * np.exp(-0.5 * square / np.float32(wide**2)))
        target[near] = best
    return -dark + 0.35 * light


def crease_maps(face: FaceGeometry, x: AnyArray, y: AnyArray) -> AnyArray:
    """Return (k, h, w) float32: log brightness change per unit of each crease of `CREASE_NAMES`, on a grid."""
    maps = {name: np.zeros(x.shape, np.float32) for name in CREASE_NAMES}
    mouth, base, wide = face.mouth, face.nose_base, face.nose_width
    middle = face.nose_tip[0]
    for sign, eye, brow in ((-1.0, face.right_eye, face.right_brow), (1.0, face.left_eye, face.left_brow)):
        side = "right" if sign < 0 else "left"
        corner = mouth.left if sign < 0 else mouth.right
        fold = np.array(
            [
                (middle + sign * (wide + 0.03), base - 0.13),
                (middle + sign * (wide + 0.12), base - 0.01),
                (corner[0] + sign * 0.085, corner[1] - 0.15),
                (corner[0] + sign * 0.115, corner[1] + 0.02),
            ]
        )
        maps["nasolabial"] += _along(fold, x, y, 0.024, (sign * 0.05, -0.03))
        outer = eye.left if sign < 0 else eye.right
        for lift, length in ((-0.10, 0.13), (-0.02, 0.16), (0.06, 0.14)):
            start = np.array([outer[0] + sign * 0.075, outer[1] + 0.4 * lift + 0.01])
            foot = np.stack([start, start + np.array((sign * length, lift))])
            maps["crow_feet"] += _along(foot, x, y, 0.012, (0.0, 0.022))
        under = np.array(
            [
                (
                    eye.centre[0] + t * eye.half_width,
                    eye.lower(np.float64(eye.centre[0] + t * eye.half_width)) + 0.055 + 0.02 * (1 - t * t),
                )
                for t in (-0.9, -0.4, 0.1, 0.6, 1.0)
            ]
        )
        maps["crow_feet"] += 0.7 * _along(under, x, y, 0.012, (0.0, -0.022))
        inner = brow[0]
        frown = np.array(
            [
                (0.55 * inner[0] + sign * 0.01, inner[1] + 0.05),
                (0.50 * inner[0], inner[1] - 0.05),
                (0.52 * inner[0], inner[1] - 0.14),
            ]
        )
        maps["glabella"] += _along(frown, x, y, 0.014, (sign * 0.035, 0.0))
        for k in range(3):
            start = np.array([middle + sign * 0.045, 0.08 + 0.055 * k])
            maps["nose"] += _along(
                np.stack([start, start + np.array((sign * 0.075, -0.04 + 0.03 * k))]),
                x,
                y,
                0.014,
                (0.0, 0.026),
            )
        maps["corner_pit"] -= bump(x, y, (corner[0] + sign * 0.055, corner[1] - 0.015), 0.022, 0.040)
        maps["corner_pit"] += 0.3 * bump(x, y, (corner[0] + sign * 0.12, corner[1] - 0.04), 0.045, 0.07)
        droop = np.array(
            [
                (corner[0] + sign * 0.02, corner[1] + 0.02),
                (corner[0] + sign * 0.055, corner[1] + 0.10),
                (corner[0] + sign * 0.05, corner[1] + 0.18),
            ]
        )
        maps["corner_droop"] += _along(droop, x, y, 0.018, (sign * 0.045, 0.0))
        t = eye.along(x)
        fold_y = eye.upper(x) - 0.040 - 0.020 * np.clip(1 - t**2, 0, 1)
        reach = np.clip((1.28 - np.abs(t + 0.06 * sign)) / 0.35, 0, 1)
        maps[f"lid_fold_{side}"] += reach * (
            0.30 * np.exp(-0.5 * ((y - fold_y) / 0.012) ** 2)
            + 0.10 * bump(0.0, y - fold_y - 0.03, (0.0, 0.0), 1.0, 0.03)
        )
        maps["cheek_ball"] += 0.10 * bump(x, y, (eye.centre[0] + sign * 0.12, 0.40), 0.17, 0.11)
        maps["cheek_ball"] -= 0.07 * bump(x, y, (eye.centre[0] + sign * 0.10, 0.66), 0.20, 0.09)
    for k, height in enumerate((-0.52, -0.63, -0.74)):
        wave = np.array(
            [
                (middle + t * 0.56, height + 0.03 * np.cos(2.6 * t + k) + 0.05 * t * t)
                for t in np.linspace(-1, 1, 9)
            ]
        )
        maps["forehead"] += _along(wave, x, y, 0.013, (0.0, 0.030))
    chin = (mouth.centre[0], face.chin - 0.20)
    pits = sum(
        np.sin(61 * x * c + 53 * y * s + p)
        for c, s, p in ((1.0, 0.2, 0.0), (-0.4, 1.0, 1.3), (0.7, -0.8, 2.1))
    )
    maps["chin_dimples"] += bump(x, y, chin, 0.16, 0.10) * np.clip(
        -0.05 + 0.035 * np.asarray(pits), -0.2, 0.1
    )
    shelf = bump(
        x, y, (mouth.centre[0], float(face.lip_lower_edge(np.float64(mouth.centre[0]))) + 0.06), 0.18, 0.03
    )
    maps["under_lip"] -= shelf
    fan = np.cos(2 * np.pi * np.clip(mouth.along(x), -1.1, 1.1) * 4.5)
    around = bump(0.0, y - mouth.line(x), (0.0, 0.0), 1.0, 0.11) * np.clip(1 - mouth.along(x) ** 2, 0, 1)
    maps["pucker"] += 0.16 * fan * around - 0.10 * around
    edge = smooth((face.face_width - np.abs(x)) / 0.15)
    return np.stack([maps[name] * edge for name in CREASE_NAMES]).astype(np.float32)


def crease_amounts(expression: Expression) -> Mapping[str, float]:
    """Compute how deep each crease is for an expression."""
    e = expression
    raised = max(e.brow_inner_raise, e.brow_outer_raise) * 0.6 + 0.4 * min(
        e.brow_inner_raise, e.brow_outer_raise
    )
    return {
        "nasolabial": min(
            0.26 * e.lip_corner_up + 0.24 * e.nose_wrinkle + 0.22 * e.upper_lip_raise + 0.08 * e.cheek_raise,
            0.38,
        ),
        "forehead": 0.30 * raised,
        "glabella": 0.42 * e.brow_lower + 0.10 * e.nose_wrinkle,
        "crow_feet": 0.20 * e.cheek_raise
        + 0.05 * e.lip_corner_up
        + 0.08 * max(e.lid_close_left, e.lid_close_right),
        "nose": 0.20 * e.nose_wrinkle,
        "corner_pit": 0.45 * e.lip_corner_up + 0.30 * e.lip_stretch + 0.12 * e.lip_press,
        "corner_droop": 0.26 * e.lip_corner_down + 0.10 * e.lip_stretch,
        "chin_dimples": 0.9 * e.chin_raise,
        "pucker": 0.9 * e.lip_pucker,
        "lid_fold_right": e.lid_close_right,
        "lid_fold_left": e.lid_close_left,
        "cheek_ball": 0.9 * e.lip_corner_up + 0.5 * e.cheek_raise,
        "under_lip": 0.25 * e.chin_raise + 0.15 * e.jaw_open + 0.15 * e.lip_press,
    }


def crease_boxes(maps: AnyArray) -> tuple[Box, ...]:
    """Return the rows and columns in which each crease can be seen."""
    return tuple(box_of(np.abs(one) > LEAST_SHADE, 0) for one in maps)


def creased(
    skin: AnyArray, maps: AnyArray, boxes: tuple[Box, ...], expression: Expression, gain: float
) -> AnyArray:
    """Return the sRGB-coded skin (h, w, 3) with the creases of an expression, `gain` times as deep."""
    amounts = crease_amounts(expression)
    total = np.zeros(skin.shape[:2], np.float32)
    for name, one, box in zip(CREASE_NAMES, maps, boxes, strict=True):
        if gain * amounts[name] and box is not None:
            total[box] += np.float32(gain * amounts[name]) * one[box]
    touched = box_of(total != 0, 0)
    if touched is None:
        return skin
    skin = skin.copy()
    skin[touched] *= np.exp(total[touched])[..., None]
    return skin
