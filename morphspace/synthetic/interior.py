"""What is seen where skin parts: eyeballs; teeth, tongue and the dark of the mouth.

Each layer is a picture on the neutral canvas with its coverage as a fourth channel (colour already multiplied
by it). Sclera, cavity and upper teeth keep their place on the skull, the irises move with gaze, lower teeth
and tongue with the jaw. Ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.synthetic.fields import GAZE_X, GAZE_Y, JAW_DROP, bump, smooth
from morphspace.synthetic.geometry import Aperture, FaceGeometry
from morphspace.synthetic.parameters import Expression, Identity
from morphspace.synthetic.texture import grain, octaves

TEETH_FOLLOW = 0.80  # of the jaw's drop at the chin: the incisors are nearer to the hinge
TONGUE_FOLLOW = 0.56  # of the jaw's drop, likewise

BACK_TO_FRONT = ("right_iris", "left_iris", "tongue", "lower_teeth", "upper_teeth")
"""The layers over sclera and cavity in the order they are laid: two in the eyes, three in the mouth."""


@dataclass(frozen=True, eq=False)
class Interior:
    """The layers behind the skin, (h, w, 3) or (h, w, 4) float32 sRGB-coded on the fine canvas. Ours."""

    sclera: AnyArray
    right_iris: AnyArray
    left_iris: AnyArray
    cavity: AnyArray
    upper_teeth: AnyArray
    lower_teeth: AnyArray
    tongue: AnyArray
    lid_shadow: float = 0.45  # how much the upper lid darkens the ball below it
    lip_shadow: float = 0.30

    def layer(self, name: str) -> AnyArray:
        """Return a layer by name."""
        return np.asarray(getattr(self, name))


def layer_shifts(expression: Expression, unit_px: float) -> Mapping[str, tuple[float, float]]:
    """Compute how far each moving layer is shifted by an expression, (right, down) px."""
    gaze = (GAZE_X * unit_px * expression.gaze_x, GAZE_Y * unit_px * expression.gaze_y)
    drop = JAW_DROP * unit_px * expression.jaw_open + 0.02 * unit_px * expression.lower_lip_drop
    side = 0.10 * unit_px * expression.jaw_sideways
    return {
        "right_iris": gaze,
        "left_iris": gaze,
        "upper_teeth": (0.0, 0.0),
        "lower_teeth": (TEETH_FOLLOW * side, TEETH_FOLLOW * drop),
        "tongue": (TONGUE_FOLLOW * side, TONGUE_FOLLOW * drop),
    }


def layered(colour: AnyArray, cover: AnyArray) -> AnyArray:
    """Join a colour (h, w, 3) and a coverage (h, w) to one layer, the colour multiplied by the coverage."""
    return np.concatenate([colour * cover[..., None], cover[..., None]], axis=2).astype(np.float32)


def paint_interior(identity: Identity, face: FaceGeometry, x: AnyArray, y: AnyArray) -> Interior:
    """Paint eyeballs and mouth of a drawn identity on a grid of face units."""
    rng = np.random.default_rng([identity.seed, 1])
    fine = float(x[0, 1] - x[0, 0])
    sclera = np.zeros((*x.shape, 3), np.float32)
    for eye in (face.right_eye, face.left_eye):
        near = (np.abs(x - eye.centre[0]) < 2 * eye.half_width) & (np.abs(y - eye.centre[1]) < 0.4)
        sclera = np.where(near[..., None], paint_sclera(eye, x, y, rng), sclera)
    irises = [
        paint_iris(at, face.iris_radius, identity.eyes, identity.light_side, x, y, fine, rng)
        for at in (face.right_iris, face.left_iris)
    ]
    return Interior(
        sclera=sclera,
        right_iris=irises[0],
        left_iris=irises[1],
        cavity=paint_cavity(face, x, y),
        upper_teeth=paint_teeth(face, x, y, fine, rng, "upper"),
        lower_teeth=paint_teeth(face, x, y, fine, rng, "lower"),
        tongue=paint_tongue(face, x, y, rng),
    )


def paint_sclera(eye: Aperture, x: AnyArray, y: AnyArray, rng: np.random.Generator) -> AnyArray:
    """Paint the white of an eye: a shaded ball, faint veins, the pink inner corner."""
    t = eye.along(x)
    outward = float(np.sign(eye.centre[0]))
    shade = 0.80 - 0.30 * np.abs(t) ** 2.0 - 0.12 * np.clip(-(y - eye.centre[1]) / 0.1, -0.5, 1)
    colour = np.stack([shade, 0.965 * shade, 0.945 * shade], axis=2)
    veins = np.clip(octaves(rng, (x.shape[0], x.shape[1]), (1.0, 2.5), 1.0) - 0.8, 0, 2) * np.clip(
        np.abs(t) - 0.35, 0, 1
    )
    colour = colour * np.exp(-0.10 * veins[..., None] * (0.2, 1.0, 0.9))
    inner = np.clip((-outward * t - 0.80) / 0.16, 0, 1)
    pink = np.array([0.74, 0.47, 0.43])
    return np.asarray(colour + (pink - colour) * (0.85 * smooth(inner))[..., None], np.float32)


def paint_iris(
    at: tuple[float, float],
    radius: float,
    colour: tuple[float, float, float],
    light_side: float,
    x: AnyArray,
    y: AnyArray,
    fine: float,
    rng: np.random.Generator,
) -> AnyArray:
    """Paint an iris as a layer: fibres, dark ring, pupil and the light's reflection."""
    dx, dy = x - at[0], y - at[1]
    r = np.hypot(dx, dy) / radius
    angle = np.arctan2(dy, dx)
    fibres = np.zeros_like(r)
    for k in (11, 17, 29):
        fibres = fibres + np.sin(k * angle + rng.uniform(0, 2 * np.pi) + 2.0 * r)
    tint = np.asarray(colour) * (1 + 0.10 * fibres * np.clip(r, 0, 1))[..., None]
    tint = tint * (1.0 + 0.35 * np.clip(dy / radius, -0.6, 1))[..., None]
    tint = (
        tint + (np.array([0.55, 0.40, 0.20]) - tint) * (0.30 * np.exp(-(((r - 0.48) / 0.12) ** 2)))[..., None]
    )
    tint = tint * (1 - 0.62 * smooth((r - 0.70) / 0.28))[..., None]
    pupil = 1 - smooth((r - 0.36) / 0.12)
    tint = tint * (1 - 0.95 * pupil)[..., None]
    light = bump(dx, dy, (0.34 * radius * np.sign(light_side), -0.36 * radius), 0.13 * radius, 0.13 * radius)
    faint = bump(dx, dy, (-0.3 * radius * np.sign(light_side), 0.45 * radius), 0.22 * radius, 0.14 * radius)
    shine = np.clip(1.35 * light, 0, 1)[..., None]
    tint = tint + (0.97 - tint) * shine + 0.10 * faint[..., None]
    cover = np.clip((radius - np.hypot(dx, dy)) / fine * 0.6 + 0.5, 0, 1)
    return layered(np.clip(tint, 0, 1), cover)


def paint_cavity(face: FaceGeometry, x: AnyArray, y: AnyArray) -> AnyArray:
    """Paint the inside of the mouth: dark red at the sides, nearly black in the middle."""
    t = np.clip(np.abs(face.mouth.along(x)), 0, 1.2)
    deep = 0.052 + 0.075 * t**2
    return np.stack([1.55 * deep, 0.72 * deep, 0.70 * deep], axis=2).astype(np.float32)


def paint_teeth(
    face: FaceGeometry, x: AnyArray, y: AnyArray, fine: float, rng: np.random.Generator, row: str
) -> AnyArray:
    """Paint one row of teeth as a layer, with gum towards the lip that hides it."""
    mouth = face.mouth
    t = mouth.along(x)
    middle = mouth.centre[0]
    if row == "upper":
        widths = (0.118, 0.092, 0.098, 0.088, 0.080)
        edge = mouth.line(np.float64(middle)) + 0.014 - 0.020 * t**2
        depth, tone = 0.15, 0.90
    else:
        widths = (0.074, 0.078, 0.084, 0.080, 0.075)
        edge = mouth.line(np.float64(middle)) + 0.052 - 0.012 * t**2
        depth, tone = 0.12, 0.74
    limits = np.cumsum(widths) * mouth.half_width / 0.42
    across = np.abs(x - middle)
    number = np.searchsorted(limits, across)
    starts = np.concatenate([[0.0], limits])
    ends = np.concatenate([limits, [limits[-1] + 0.1]])
    within = (across - starts[number]) / (ends[number] - starts[number])
    gap = np.minimum(within * (ends[number] - starts[number]), (1 - within) * (ends[number] - starts[number]))
    rounding = 0.009 * (2 * within - 1) ** 4
    shade = tone * (1 - 0.42 * np.clip(t, -1.2, 1.2) ** 2)
    shade = (
        shade
        * (1 - 0.20 * np.exp(-0.5 * (gap / 0.006) ** 2))
        * (1 + 0.012 * grain(rng, (x.shape[0], x.shape[1]), 1.5))
    )
    colour = np.stack([shade, 0.955 * shade, 0.875 * shade], axis=2)
    last = np.clip((limits[-1] - across) / 0.03, 0, 1)
    soft = 1.3 * fine
    if row == "upper":
        end = np.clip((edge - rounding - y) / soft + 0.5, 0, 1)
        gum = smooth((edge - depth - y + 0.02 * np.cos(2 * np.pi * within)) / 0.02)
        colour = colour * (0.80 + 0.20 * np.clip((y - edge + depth) / depth, 0, 1))[..., None]
    else:
        end = np.clip((y - edge - rounding) / soft + 0.5, 0, 1)
        gum = smooth((y - edge - depth + 0.02 * np.cos(2 * np.pi * within)) / 0.02)
        colour = colour * (1 - 0.25 * np.clip((y - edge) / depth, 0, 1))[..., None]
    flesh = np.array([0.62, 0.33, 0.32]) * (tone / 0.86)
    colour = colour + (flesh - colour) * gum[..., None]
    return layered(colour, end * last)


def paint_tongue(face: FaceGeometry, x: AnyArray, y: AnyArray, rng: np.random.Generator) -> AnyArray:
    """Paint the tongue as a layer lying behind the lower teeth."""
    mouth = face.mouth
    top = mouth.centre[1] + 0.018 + 0.10 * np.clip(np.abs(x - mouth.centre[0]) / 0.25, 0, 2) ** 2.5
    depth = y - top
    shade = (
        0.56
        * (0.45 + 0.55 * smooth(depth / 0.09))
        * (1 - 0.22 * np.exp(-0.5 * ((x - mouth.centre[0]) / 0.025) ** 2))
    )
    shade = shade * (1 + 0.05 * octaves(rng, (x.shape[0], x.shape[1]), (1.2, 3.0), 1.0))
    colour = np.stack([1.12 * shade, 0.60 * shade, 0.58 * shade], axis=2)
    return layered(np.clip(colour, 0, 1), smooth(depth / 0.03))
