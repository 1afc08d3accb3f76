"""Paint the neutral face of an identity: skin, brows, lips, neck, clothes and what is around them. Ours.

Everything is painted in linear light on the neutral canvas, twice as fine as the picture; expression moves
the paint afterwards and never repaints it.
"""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.synthetic.fields import bump, smooth
from morphspace.synthetic.geometry import Aperture, FaceGeometry
from morphspace.synthetic.hair import Hair, brow_hairs, paint_hair
from morphspace.synthetic.parameters import Identity
from morphspace.synthetic.relief import (
    depth_inside,
    face_outline,
    filled,
    light_on,
    mirrored,
    outline,
    relief_of,
)
from morphspace.synthetic.texture import coded_of, grain, linear_of, octaves

LABELS = ("background", "skin", "hair", "clothes", "eye", "mouth")
"""What a neutral pixel shows; its place in this tuple is its number in a label map."""

FINE = 2  # texture pixels per picture pixel, along each axis


def over(under: AnyArray, colour: AnyArray, cover: AnyArray) -> AnyArray:
    """Lay a colour over a picture with a coverage (h, w)."""
    return np.asarray(under + (colour - under) * cover[..., None], np.float32)


def paint_neutral(
    identity: Identity, face: FaceGeometry, width: int, height: int
) -> tuple[AnyArray, AnyArray]:
    """Paint the skin sheet of the neutral face.

    Gives the sRGB-coded picture (height * FINE, width * FINE, 3) float32, in which skin runs on under the
    lids and lips, and the labels (the same grid, uint8).
    """
    rng = np.random.default_rng(identity.seed)
    x, y = face.grid(width, height, FINE)
    unit = face.unit_px * FINE
    labels = np.zeros(x.shape, np.uint8)

    picture = np.broadcast_to(linear_of(np.asarray(identity.background)), (*x.shape, 3)).astype(np.float32)
    vignette = 1.06 - 0.10 * (x**2 + y**2) / 4 - 0.05 * identity.light_side * x
    picture = picture * (vignette * (1 + 0.006 * octaves(rng, x.shape, (60.0, 20.0, 6.0), 0.7)))[..., None]

    hair = Hair(identity, face, x, y, rng)
    picture = over(picture, hair.behind_colour(rng), hair.behind)
    labels[hair.behind > 0.5] = LABELS.index("hair")
    picture = _paint_neck(picture, labels, identity, x, y, unit, rng)
    picture = _paint_clothes(picture, labels, identity, x, y, unit, rng)
    picture = _paint_ears(picture, labels, identity, x, y, unit, rng)

    cover = filled(face_outline(identity), x, y, 0.7)
    labels[cover > 0.5] = LABELS.index("skin")
    picture = over(picture, _face_colour(identity, face, x, y, unit, cover, rng), cover)
    picture = brow_hairs(picture, identity, face, x, y, rng)
    picture = paint_hair(picture, hair, cover)
    labels[hair.front > 0.5] = LABELS.index("hair")
    return coded_of(_rolled_off(picture)).astype(np.float32), labels


def _rolled_off(light: AnyArray) -> AnyArray:
    """Compress the brightest light softly towards 1, as a camera does."""
    knee = 0.60
    excess = np.clip(light - knee, 0, None)
    return np.minimum(light, knee) + (1 - knee) * (1 - np.exp(-excess / (1 - knee)))


def _skin_albedo(identity: Identity, x: AnyArray, y: AnyArray, rng: np.random.Generator) -> AnyArray:
    """Return the colour of plain skin, linear: blotches of blood and pigment, pores, freckles."""
    shape = x.shape
    base = np.broadcast_to(linear_of(np.asarray(identity.skin)), (*shape, 3)).astype(np.float32)
    pale = float(np.mean(identity.skin))
    pigment = 0.052 * octaves(rng, shape, (24.0, 11.0, 5.0, 2.4, 1.2), 0.80)
    blood = 0.050 * octaves(rng, shape, (30.0, 12.0, 5.0, 2.0), 0.75)
    pores = 0.036 * grain(rng, shape, 0.8)
    colour: AnyArray = base * np.exp(
        -pigment[..., None] * (0.8, 1.1, 1.4) - blood[..., None] * (0.1, 1.0, 0.8)
    )
    colour = colour * (1 + pores[..., None])
    spots = grain(rng, shape, 1.5)
    field = bump(x, y, (0.0, 0.35), 0.55, 0.30) + 0.35 * bump(x, y, (0.0, -0.6), 0.7, 0.3)
    freckles = (
        np.clip(spots - 1.9 + 0.3 * octaves(rng, shape, (14.0,), 1.0), 0, 0.8) * field * identity.freckles
    )
    colour = colour * np.exp(-1.1 * freckles[..., None] * (0.55, 1.0, 1.35))
    moles = grain(rng, shape, 2.2)
    dark = np.clip((moles - 4.15) * 4, 0, 1)
    return np.asarray(colour * (1 - 0.5 * pale * dark[..., None]), np.float32)


def _face_colour(
    identity: Identity,
    face: FaceGeometry,
    x: AnyArray,
    y: AnyArray,
    unit: float,
    cover: AnyArray,
    rng: np.random.Generator,
) -> AnyArray:
    albedo = _skin_albedo(identity, x, y, rng)
    rosy = np.zeros(x.shape, np.float32)
    for sign in (-1.0, 1.0):
        rosy += 0.22 * bump(x, y, (0.55 * sign, 0.42), 0.22, 0.20)
        rosy += 0.22 * bump(
            x, y, (0.75 * identity.nose_width * sign, identity.nose_length - 0.08), 0.08, 0.09
        )
        rosy += 0.16 * bump(x, y, (identity.eye_spacing * sign, 0.13), 0.18, 0.06)
    rosy += 0.26 * bump(x, y, (0.0, identity.nose_length - 0.10), 0.12, 0.11)
    rosy += 0.10 * bump(x, y, (0.0, identity.chin_drop - 0.2), 0.25, 0.15)
    strength = 0.45 + 0.75 * float(np.mean(identity.skin))
    albedo = albedo * np.exp(-strength * rosy[..., None] * (0.05, 0.62, 0.50))
    for eye in (face.right_eye, face.left_eye):
        socket = bump(x, y, (eye.centre[0], eye.centre[1] + 0.02), 0.26, 0.13)
        albedo = albedo * np.exp(-0.24 * socket[..., None] * (0.8, 1.05, 1.0))
    if identity.stubble > 0:
        albedo = _beard_shadow(albedo, identity, face, x, y, rng)
    lips = _lip_cover(face, x, y, unit)
    wrinkles = octaves(rng, (x.shape[0], x.shape[1]), (1.1, 2.2), 0.9)
    wrinkles = cv2.GaussianBlur(wrinkles, (0, 0), sigmaX=0.5, sigmaY=3.2)
    lip_colour = linear_of(np.asarray(identity.lips)) * (1 + 0.16 * wrinkles[..., None])
    albedo = over(albedo, lip_colour.astype(np.float32), 0.85 * lips)

    relief = relief_of(identity, face, x, y, depth_inside(cover, unit))
    relief = relief + 0.0016 * octaves(rng, x.shape, (1.4, 3.0, 7.0), 1.15)
    diffuse, gloss, _ = light_on(relief, unit, identity.light_side)
    oil = 0.6 + 0.7 * bump(x, y, (0.0, 0.3), 0.18, 0.5) + 0.4 * bump(x, y, (0.0, -0.6), 0.5, 0.3)
    oil = np.clip(oil * (1 + 0.25 * grain(rng, x.shape, 1.0)), 0, None) * (1 - 0.3 * lips)
    colour = albedo * diffuse + (0.085 * gloss * oil)[..., None]
    wet = np.clip(grain(rng, x.shape, 1.3) * 0.4 + 0.75, 0, None) * lips * np.clip(gloss * 2.2, 0, 1)
    lower_shine = bump(x, y, (0.06 * np.sign(identity.light_side), face.mouth.lower(x) + 0.05), 0.15, 0.022)
    colour = (
        colour + (0.09 * wet + 0.055 * lips * lower_shine * np.clip(wrinkles * 0.4 + 0.8, 0, None))[..., None]
    )
    return _draw_lines(colour, identity, face, x, y)


def _beard_shadow(
    albedo: AnyArray,
    identity: Identity,
    face: FaceGeometry,
    x: AnyArray,
    y: AnyArray,
    rng: np.random.Generator,
) -> AnyArray:
    chin_zone = smooth((y - 0.72 - 0.25 * np.exp(-((x / 0.35) ** 2)) + 0.15 * np.abs(x)) / 0.22)
    moustache = bump(x, y, (0.0, identity.nose_length + 0.15), 0.26, 0.075)
    sides = smooth((np.abs(x) - 0.66) / 0.2) * smooth((y - 0.15) / 0.4)
    zone = np.clip(np.maximum(np.maximum(chin_zone, moustache), 0.8 * sides), 0, 1)
    zone = zone * (1 - 0.7 * bump(x, y, (0.0, face.mouth.centre[1] + 0.22), 0.2, 0.05))
    dots = np.clip(grain(rng, x.shape, 0.7) * 0.5 + 0.55, 0, 1.6)
    amount = identity.stubble * zone * (0.25 + 0.45 * dots)
    hair = linear_of(np.asarray(identity.hair)) * 0.9
    return over(
        albedo, hair.astype(np.float32) * np.float32(0.6) + albedo * np.float32(0.32), np.clip(amount, 0, 0.8)
    )


def _lip_cover(face: FaceGeometry, x: AnyArray, y: AnyArray, unit: float) -> AnyArray:
    """Compute how much a pixel is lip, soft at the outer edge; it runs on under the opening."""
    soft = 0.016
    above = smooth((y - face.lip_upper_edge(x)) / soft * 0.5 + 0.5)
    below = smooth((face.lip_lower_edge(x) - y) / (1.6 * soft) * 0.5 + 0.5)
    across = np.clip((1.02 - np.abs(face.mouth.along(x))) / 0.06, 0, 1)
    return np.asarray(above * below * across, np.float32)


def _line(colour: AnyArray, distance: AnyArray, width: float, depth: AnyArray | float) -> AnyArray:
    """Darken along a line: `distance` from it and its `width` in face units; shadow on skin is warm."""
    amount = np.asarray(depth * np.exp(-0.5 * (distance / width) ** 2))[..., None]
    return np.asarray(colour * np.exp(-amount * (0.85, 1.1, 1.15)), np.float32)


def _draw_lines(
    colour: AnyArray, identity: Identity, face: FaceGeometry, x: AnyArray, y: AnyArray
) -> AnyArray:
    """Add the lines every face has: lid folds, lashes, nostrils, wings of the nose, lip line."""
    for eye in (face.right_eye, face.left_eye):
        colour = _eye_lines(colour, identity, eye, x, y)
    base, wide = identity.nose_length, identity.nose_width
    for sign in (-1.0, 1.0):
        hole = bump(x, y, (0.46 * wide * sign, base - 0.040 - 0.25 * (sign * x - 0.46 * wide)), 0.044, 0.020)
        colour = colour * np.exp(-2.5 * hole[..., None] * (0.9, 1.1, 1.1))
        wing = np.hypot((sign * x - 0.70 * wide) / 1.0, (y - base + 0.085) / 1.05)
        angle = np.arctan2(y - base + 0.085, sign * x - 0.70 * wide)
        around = bump(angle, 0.0, (0.25, 0.0), 0.75, 1.0)
        colour = _line(colour, wing - 0.39 * wide - 0.02, 0.018, 0.40 * around)
        fold_x = wide * 1.02 + 0.55 * (y - base + 0.12) * (face.mouth.half_width + 0.10 - wide)
        reach = smooth((y - base + 0.12) / 0.1) * (1 - smooth((y - base - 0.18) / 0.22))
        colour = _line(colour, sign * x - fold_x, 0.028, (0.10 + 0.22 * identity.age) * reach)
        bag_y = 0.135 + 0.03 * ((sign * x - identity.eye_spacing) / 0.2) ** 2 * -1.0
        bag = bump(x, 0.0, (sign * (identity.eye_spacing - 0.05), 0.0), 0.13, 1.0)
        colour = _line(colour, y - bag_y, 0.022, (0.10 + 0.20 * identity.age) * bag)
    under = bump(x, y, (0.0, base + 0.012), 0.16, 0.020)
    colour = colour * np.exp(-0.22 * under[..., None] * (0.9, 1.0, 1.0))
    mouth = face.mouth
    t = mouth.along(x)
    taper = np.clip(1.12 - t**2, 0, 1)
    colour = _line(colour, y - mouth.upper(x) + 0.004, 0.014, 0.60 * taper * (np.abs(t) < 1.1))
    colour = _line(colour, np.minimum(y - mouth.lower(x) - 0.002, 0.05), 0.010, 0.18 * taper)
    for sign in (-1.0, 1.0):
        spot = bump(x, y, (mouth.centre[0] + sign * mouth.half_width, mouth.centre[1] - 0.002), 0.032, 0.018)
        colour = colour * np.exp(-0.75 * spot[..., None] * (0.9, 1.1, 1.1))
    return np.asarray(colour, np.float32)


def _eye_lines(colour: AnyArray, identity: Identity, eye: Aperture, x: AnyArray, y: AnyArray) -> AnyArray:
    outward = float(np.sign(eye.centre[0]))
    t = eye.along(x)
    out = outward * t  # -1 at the inner corner, 1 at the outer one
    within = np.clip((1.12 - np.abs(t)) / 0.2, 0, 1)
    upper, lower = eye.upper(x), eye.lower(x)
    fold = upper - 0.040 - 0.020 * np.clip(1 - t**2, 0, 1)
    reach = np.clip((1.28 - np.abs(t + 0.06 * outward)) / 0.35, 0, 1)
    colour = _line(colour, y - fold, 0.012, 0.70 * reach)
    colour = _line(colour, y - fold + 0.028, 0.030, 0.16 * reach)
    lid = bump(0.0, y - 0.5 * (fold + upper), (0.0, 0.0), 1.0, 0.014) * np.clip(1 - t**2, 0, 1)
    colour = colour * (1 + 0.10 * lid[..., None])
    above = np.clip(upper - y, -0.05, None)
    thick = 0.015 + 0.009 * np.clip(out + 0.6, 0, 1.6)
    lashes = np.exp(-0.5 * (np.clip(above - 0.002, 0, None) / thick) ** 2) * (above > -0.04)
    tail = np.clip((1.10 - np.abs(t)) / 0.10, 0, 1)
    depth = (2.0 + 0.6 * np.clip(out, -1, 1)) * tail
    colour = np.asarray(colour * np.exp(-(lashes * depth)[..., None] * (1.0, 1.05, 1.05)), np.float32)
    rim = np.exp(-0.5 * ((y - lower - 0.006) / 0.010) ** 2) * within
    colour = over(colour, colour * np.array([1.12, 0.92, 0.90], np.float32), 0.8 * rim)
    colour = _line(colour, y - lower - 0.024, 0.009, (0.30 + 0.20 * np.clip(out, -1, 1)) * within)
    return colour


def _paint_neck(
    picture: AnyArray,
    labels: AnyArray,
    identity: Identity,
    x: AnyArray,
    y: AnyArray,
    unit: float,
    rng: np.random.Generator,
) -> AnyArray:
    wide = 0.55 * identity.jaw_width + 0.13
    half = [
        (0.0, 0.5),
        (wide + 0.05, 0.6),
        (wide, 1.2),
        (wide + 0.005, 1.65),
        (wide + 0.16, 1.84),
        (1.25, 2.05),
        (1.4, 2.8),
        (0.0, 2.8),
    ]
    cover = filled(outline(mirrored(half)), x, y, 0.8)
    labels[cover > 0.5] = LABELS.index("skin")
    round_off = np.sqrt(np.clip(1 - (x / (wide + 0.22 + 0.7 * smooth((y - 1.75) / 0.4))) ** 2, 0.05, 1))
    shade = 0.52 + 0.45 * round_off * (1 + 0.25 * np.sign(identity.light_side) * np.clip(x / wide, -1.2, 1.2))
    chin_shadow = smooth((identity.chin_drop + 0.40 - 0.32 * (x / wide) ** 2 - y) / 0.34)
    shade = shade * (1 - 0.52 * chin_shadow)
    for sign in (-1.0, 1.0):
        tendon = sign * x - 0.40 + 0.42 * (y - 1.5)
        shade = shade * (
            1
            + 0.07 * np.exp(-0.5 * (tendon / 0.05) ** 2)
            - 0.07 * np.exp(-0.5 * ((tendon - 0.10) / 0.06) ** 2)
        )
    colour = _skin_albedo(identity, x, y, rng) * shade[..., None] * np.array([1.0, 0.95, 0.92], np.float32)
    return over(picture, colour.astype(np.float32), cover)


def _paint_clothes(
    picture: AnyArray,
    labels: AnyArray,
    identity: Identity,
    x: AnyArray,
    y: AnyArray,
    unit: float,
    rng: np.random.Generator,
) -> AnyArray:
    half = [
        (0.0, 1.99),
        (0.28, 1.97),
        (0.50, 1.90),
        (0.66, 1.82),
        (0.80, 1.80),
        (1.15, 1.88),
        (1.6, 2.05),
        (2.1, 2.5),
        (2.1, 3.2),
        (0.0, 3.2),
    ]
    cover = filled(outline(mirrored(half)), x, y, 0.8)
    labels[cover > 0.5] = LABELS.index("clothes")
    inside = depth_inside(cover, unit)
    weave = 0.05 * np.sin(x * unit * 1.3) * np.sin(y * unit * 1.3) + 0.05 * grain(rng, x.shape, 0.9)
    folds = 0.10 * octaves(rng, x.shape, (22.0, 9.0), 0.6)
    shade = 0.75 + 0.25 * identity.light_side * x + folds + weave
    hem = 0.25 * np.exp(-0.5 * ((inside - 0.075) / 0.012) ** 2) - 0.18 * np.exp(
        -0.5 * ((inside - 0.03) / 0.02) ** 2
    )
    colour = linear_of(np.asarray(identity.cloth)) * np.clip(shade - hem, 0.1, 1.6)[..., None]
    return over(picture, colour.astype(np.float32), cover)


def _paint_ears(
    picture: AnyArray,
    labels: AnyArray,
    identity: Identity,
    x: AnyArray,
    y: AnyArray,
    unit: float,
    rng: np.random.Generator,
) -> AnyArray:
    wide = identity.face_width
    albedo = _skin_albedo(identity, x, y, rng)
    for sign in (-1.0, 1.0):
        shape = [
            (wide - 0.06, -0.22),
            (wide + 0.06, -0.20),
            (wide + 0.12, -0.08),
            (wide + 0.095, 0.14),
            (wide + 0.055, 0.36),
            (wide - 0.01, 0.46),
            (wide - 0.10, 0.40),
        ]
        cover = filled(outline([(sign * a, b) for a, b in shape]), x, y, 0.7)
        labels[cover > 0.5] = LABELS.index("skin")
        inside = depth_inside(cover, unit)
        rim = np.exp(-0.5 * ((inside - 0.022) / 0.014) ** 2)
        groove = np.exp(-0.5 * ((inside - 0.055) / 0.018) ** 2)
        shell = bump(sign * x, y, (wide + 0.015, 0.13), 0.035, 0.10)
        lit = 0.66 + 0.22 * np.clip(sign * identity.light_side * 2, -1, 1)
        shade = lit * (1 + 0.18 * rim - 0.28 * groove - 0.55 * shell)
        colour = albedo * shade[..., None] * np.array([1.04, 0.86, 0.82], np.float32)
        picture = over(picture, colour.astype(np.float32), cover)
    return picture
