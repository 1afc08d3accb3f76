"""The shape of a painted face as a height over the picture plane, and the light that falls on it. Ours."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from morphspace.arrays import AnyArray, Points
from morphspace.synthetic.fields import bump, smooth
from morphspace.synthetic.geometry import FaceGeometry
from morphspace.synthetic.parameters import Identity
from morphspace.synthetic.texture import blurred


def outline(points: list[tuple[float, float]], count: int = 24) -> Points:
    """Return a smooth closed curve (Catmull-Rom) through points, `count` steps between two of them."""
    knots = np.asarray(points, np.float64)
    before, after, next_one = np.roll(knots, 1, 0), np.roll(knots, -1, 0), np.roll(knots, -2, 0)
    t = (np.arange(count) / count)[:, None, None]
    curve = 0.5 * (
        2 * knots
        + (after - before) * t
        + (2 * before - 5 * knots + 4 * after - next_one) * t**2
        + (3 * knots - before - 3 * after + next_one) * t**3
    )
    return curve.transpose(1, 0, 2).reshape(-1, 2)


def mirrored(right_half: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Complete a half outline, given from top to bottom, with its mirror image."""
    return right_half + [(-x, y) for x, y in reversed(right_half) if x != 0.0]


def filled(curve: Points, x: AnyArray, y: AnyArray, softness: float = 0.0) -> AnyArray:
    """Return the coverage in [0, 1] of a closed curve (face units) on a grid, blurred by `softness` px."""
    step_x, step_y = float(x[0, 1] - x[0, 0]), float(y[1, 0] - y[0, 0])
    px = (curve - (float(x[0, 0]), float(y[0, 0]))) / (step_x, step_y)
    canvas = np.zeros(x.shape, np.uint8)
    cv2.fillPoly(canvas, [np.round(px * 256).astype(np.int32)], 255, cv2.LINE_AA, shift=8)
    cover = canvas.astype(np.float32) / 255
    return blurred(cover, softness) if softness > 0 else cover


def depth_inside(cover: AnyArray, unit_px: float) -> AnyArray:
    """Compute how far inside a shape each pixel is, in face units, smoothed."""
    # OpenCV's exact transform differs in the last bits from call to call.
    inside = ndimage.distance_transform_edt(cover > 0.5)
    return blurred(inside.astype(np.float32), 0.03 * unit_px) / np.float32(unit_px)


def face_outline(identity: Identity) -> Points:
    """Return the outline of skull, cheeks, jaw and chin."""
    wide, jaw, chin = identity.face_width, identity.jaw_width, identity.chin_drop
    half = [
        (0.0, -1.42),
        (0.40, -1.36),
        (0.72, -1.12),
        (0.88 * wide / 0.97, -0.80),
        (0.955 * wide, -0.40),
        (wide, 0.02),
        (0.965 * wide, 0.40),
        (0.55 * wide + 0.45 * jaw, 0.76),
        (0.985 * jaw, 0.66 * chin),
        (0.52 * jaw + 0.5 * identity.chin_width, 0.83 * chin),
        (1.02 * identity.chin_width, 0.955 * chin),
        (0.45 * identity.chin_width, 0.997 * chin),
        (0.0, chin + 0.004),
    ]
    return outline(mirrored(half))


def relief_of(identity: Identity, face: FaceGeometry, x: AnyArray, y: AnyArray, inside: AnyArray) -> AnyArray:
    """Return the height of the face towards the viewer, in face units, on a grid."""
    rounding = np.sqrt(np.clip(1 - (1 - np.clip(inside / 0.62, 0, 1)) ** 2, 0, 1))
    skull = np.sqrt(np.clip(1 - (x / 1.18) ** 2 - ((y - 0.05) / 1.85) ** 2, 0.02, 1))
    z = 0.42 * rounding + 0.95 * skull
    for eye in (face.right_eye, face.left_eye):
        cx, cy = eye.centre
        sign = np.sign(cx)
        z -= 0.150 * bump(x, y, (cx - 0.03 * sign, cy - 0.05), 0.27, 0.15)
        z -= 0.070 * bump(x, y, (cx - 0.25 * sign, cy - 0.04), 0.09, 0.13)
        z += 0.085 * bump(x, y, (cx, cy + 0.01), 0.16, 0.115)
        z += 0.055 * bump(x, y, (cx + 0.02 * sign, -identity.brow_height + 0.02), 0.28, 0.085)
        z += 0.085 * bump(x, y, (0.60 * sign, 0.36), 0.22, 0.17)
        z -= 0.030 * bump(x, y, (0.62 * sign, 0.86), 0.20, 0.22)
        z += 0.040 * bump(x, y, (0.34 * sign, 0.72), 0.16, 0.18)
        z -= 0.040 * bump(x, y, (0.90 * sign, -0.30), 0.16, 0.28)
    base, wide, rise = identity.nose_length, identity.nose_width, identity.nose_relief
    end = base - 0.125 - 1.3 * x**2  # the tip hangs a little below the wings
    along = smooth((y + 0.22) / (base + 0.10)) * (1 - smooth((y - end) / 0.21))
    ridge_width = 0.075 + 0.050 * smooth((y - 0.05) / base)
    z += rise * 0.195 * along * np.exp(-0.5 * (x / ridge_width) ** 2)
    z += rise * 0.12 * along * np.exp(-0.5 * (x / (0.5 * wide + 0.10)) ** 2)
    z += rise * 0.085 * bump(x, y, (0.0, base - 0.120), 0.090, 0.080)
    for sign in (-1.0, 1.0):
        z += 0.090 * bump(x, y, (0.80 * wide * sign, base - 0.095), 0.058, 0.066)
        z += 0.018 * bump(x, y, (0.062 * sign, base + 0.10), 0.022, 0.10)
    mouth = face.mouth
    t = np.clip(mouth.along(x), -1.4, 1.4)
    muzzle = bump(x, y, (0.0, mouth.centre[1] - 0.02), 0.34, 0.24)
    z += 0.085 * muzzle
    upper_middle = mouth.upper(x) - 0.50 * identity.lip_upper * (1 - np.clip(t, -1, 1) ** 2)
    lower_middle = mouth.lower(x) + 0.50 * identity.lip_lower * (1 - np.clip(t, -1, 1) ** 2)
    taper = np.clip(1 - t**2, 0, 1)
    z += 0.050 * taper * np.exp(-0.5 * ((y - upper_middle) / (0.42 * identity.lip_upper)) ** 2)
    z += 0.070 * taper * np.exp(-0.5 * ((y - lower_middle) / (0.44 * identity.lip_lower)) ** 2)
    z -= 0.030 * np.exp(-0.5 * ((y - mouth.line(x)) / 0.03) ** 2) * bump(x, 0.0, (0.0, 0.0), 0.33, 1.0)
    for sign in (-1.0, 1.0):
        z -= 0.035 * bump(x, y, (sign * mouth.half_width * 1.06, mouth.centre[1] + 0.01), 0.06, 0.06)
    below = mouth.centre[1] + identity.lips_apart * 0.5 + identity.lip_lower
    z -= 0.055 * bump(x, y, (0.0, below + 0.07), 0.19, 0.055)
    z += 0.090 * bump(x, y, (0.0, 0.5 * (below + face.chin) + 0.06), 0.17, 0.13)
    return np.asarray(z, np.float32)


def light_on(height: AnyArray, unit_px: float, side: float) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Light a height field softly from one side.

    Gives the diffuse light in each colour (h, w, 3), red reaching a little into the shadow as in skin; the
    gloss (h, w); and the share of the sky each point sees (h, w), low in hollows.
    """
    smoothed = blurred(height, 0.012 * unit_px)
    slope_x = cv2.Sobel(smoothed, cv2.CV_32F, 1, 0, ksize=3, scale=unit_px / 8)
    slope_y = cv2.Sobel(smoothed, cv2.CV_32F, 0, 1, ksize=3, scale=unit_px / 8)
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    normal = (-slope_x / length, -slope_y / length, 1 / length)

    def towards(direction: tuple[float, float, float]) -> AnyArray:
        unit = np.asarray(direction) / np.linalg.norm(direction)
        return np.asarray(sum(n * c for n, c in zip(normal, unit, strict=True)))

    bounce = np.clip(0.3 + towards((0.2 * side, 0.85, 0.5)), 0, None)
    key, fill, sky = (
        towards((side, -0.62, 0.78)),
        towards((-1.4 * side, -0.05, 0.9)),
        towards((0.0, -1.0, 0.35)),
    )
    hollow = blurred(height, 0.05 * unit_px) - height
    hollow += 0.8 * (blurred(height, 0.14 * unit_px) - height)
    open_sky = np.clip(1 - 3.4 * np.clip(hollow, 0, None), 0.40, 1.0) * np.clip(
        1 + 0.8 * np.clip(-hollow, 0, 0.1), 1, 1.08
    )
    wrap = np.array([0.36, 0.24, 0.20], np.float32)
    lit = np.clip((key[..., None] + wrap) / (1 + wrap), 0, None)
    filled_in = np.clip((fill[..., None] + 0.3) / 1.3, 0, None)
    above = np.clip(0.5 + 0.5 * sky, 0, 1)[..., None]
    warm, cool = np.array([1.03, 1.0, 0.95], np.float32), np.array([0.95, 1.0, 1.07], np.float32)
    diffuse = 0.98 * warm * lit + 0.34 * cool * filled_in + 0.22 * cool * above * open_sky[..., None]
    diffuse += (0.20 * bounce)[..., None] * np.array([1.12, 0.98, 0.90], np.float32)
    diffuse *= (0.45 + 0.55 * open_sky)[..., None]
    half = np.asarray((side, -0.62, 0.78)) / np.linalg.norm((side, -0.62, 0.78)) + (0.0, 0.0, 1.0)
    gloss = np.clip(towards((float(half[0]), float(half[1]), float(half[2]))), 0, 1) ** 26 * open_sky
    return diffuse.astype(np.float32), gloss.astype(np.float32), open_sky.astype(np.float32)
