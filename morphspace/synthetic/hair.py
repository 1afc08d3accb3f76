"""Hair on the head and the brows of a painted face: strands drawn out along the way the hair lies. Ours."""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.synthetic.fields import bump, smooth
from morphspace.synthetic.geometry import FaceGeometry
from morphspace.synthetic.parameters import Identity
from morphspace.synthetic.relief import depth_inside, filled, mirrored, outline
from morphspace.synthetic.texture import blurred, linear_of, octaves, strands

BROW_HAIRS = 230  # on each brow
BROW_SCALE = 4  # the hairs are drawn this much finer and reduced


class Hair:
    """One head of hair: where it covers, how it lies, and its colour."""

    front: AnyArray
    behind: AnyArray
    colour: AnyArray

    def __init__(
        self, identity: Identity, face: FaceGeometry, x: AnyArray, y: AnyArray, rng: np.random.Generator
    ) -> None:
        unit = 1.0 / float(x[0, 1] - x[0, 0])
        style = identity.hair_style
        part = 0.32 * float(np.sign(identity.light_side))
        if style == "long":
            fall, rise, side = 1.55, -1.66, 0.20
        elif style == "parted":
            fall, rise, side = 0.75, -1.66, 0.17
        elif style == "short":
            fall, rise, side = -0.02, -1.62, 0.06
        else:
            fall, rise, side = -0.10, -1.50, 0.012
        wide = identity.face_width
        crown = outline(mirrored(_outer_shape(wide, rise, side, fall)))
        plain = filled(crown, x, y)
        edge = depth_inside(plain, unit) - depth_inside(1 - plain, unit)
        if style in ("short", "cropped"):
            angle = np.arctan2(y + 0.15, 1.15 * (x - 0.2 * part)) + 0.20 * np.sin(2.6 * x + 1.5 * y)
        else:
            angle = np.arctan2(
                1.05 + 0.9 * (y + 1.6), np.where(x > part, 1, -1) * (1.5 - 0.95 * smooth((y + 1.5) / 1.1))
            )
        angle = (angle + 0.13 * octaves(rng, x.shape, (26.0, 11.0), 0.7)).astype(np.float32)
        lie = strands(rng, angle, 16 if style != "cropped" else 5, 0.9)
        coarse = strands(rng, angle, 30, 2.4)

        ragged = 0.5 if style in ("short", "cropped") else 1.0
        whole = smooth((edge + ragged * (0.010 * coarse + 0.010 * lie)) / 0.04 * 0.5 + 0.5)
        line = _hairline(identity, x, part, style)
        steep = np.hypot(1.0, np.gradient(line, axis=1) * unit)  # the curtain's edge is nearly upright
        softness = (0.045 if style != "cropped" else 0.07) * np.clip(0.6 * steep, 1.0, 4.0)
        on_head = smooth((line - y + 0.030 * lie + 0.025 * coarse) / softness * 0.5 + 0.5)
        self.front = (whole * on_head).astype(np.float32)
        self.behind = whole * np.float32(style in ("long", "parted"))

        inside = depth_inside(whole, unit)
        dome = np.sqrt(np.clip(1 - (1 - np.clip(inside / 0.45, 0, 1)) ** 2, 0, 1))
        light = np.clip(0.80 + 0.35 * identity.light_side * x / wide - 0.12 * (y + 1.0), 0.3, 1.3)
        band = np.exp(
            -0.5 * ((np.hypot(x - 0.35 * identity.light_side, (y + 0.45) * 1.1) - 0.85) / 0.13) ** 2
        )
        band = band * smooth((-0.35 - y) / 0.5) * np.clip(0.55 + 0.5 * coarse, 0, 2)
        base = linear_of(np.asarray(identity.hair))
        body = np.clip(0.80 + 0.20 * lie + 0.22 * coarse, 0.18, 2.0) * (0.35 + 0.75 * dome) * light
        if style in ("parted", "long"):
            parting = bump(x, y, (part, 0.0), 0.018, 9.0) * smooth((-identity.hairline - y) / 0.1)
            body = body * (1 - 0.45 * parting)
        shine = (0.10 + 0.55 * base) * (0.55 * band * np.clip(0.7 + 0.5 * lie, 0, 2))[..., None]
        self.colour = (base * body[..., None] + shine).astype(np.float32)
        self._base = base
        self._lie = lie

    def behind_colour(self, rng: np.random.Generator) -> AnyArray:
        """Return the colour of the hair behind the neck, in shadow."""
        return np.asarray(self._base * np.clip(0.34 + 0.12 * self._lie, 0.08, 1)[..., None], np.float32)


def _outer_shape(wide: float, rise: float, side: float, fall: float) -> list[tuple[float, float]]:
    top = [
        (0.0, rise),
        (0.38, rise + 0.065),
        (0.69 + 0.5 * side, rise + 0.29),
        (0.88 * wide + 0.8 * side, rise + 0.66),
        (0.975 * wide + side, rise + 1.10),
    ]
    if fall < 0.2:
        return [
            *top,
            (wide + 0.6 * side, -0.20),
            (wide + 0.1 * side, fall + 0.12),
            (0.86 * wide, fall + 0.20),
            (0.0, fall - 0.2),
        ]
    return [
        *top,
        (wide + 1.25 * side, 0.0),
        (wide + 1.25 * side, 0.5 * fall + 0.15),
        (wide + 0.7 * side, fall),
        (0.72 * wide, fall + 0.12),
        (0.0, fall - 0.1),
    ]


def _hairline(identity: Identity, x: AnyArray, part: float, style: str) -> AnyArray:
    """Return the height below which there is no hair, at each x."""
    wide = identity.face_width
    across = np.abs(x) / wide
    temples = 0.10 * np.exp(-(((across - 0.52) / 0.16) ** 2))
    line = -identity.hairline - temples + 0.10 * across**2 + 0.62 * smooth((across - 0.70) / 0.24)
    sideburn = smooth((across - 0.905) / 0.06)
    if style in ("short", "cropped"):
        return np.asarray(line + (0.42 if style == "short" else 0.30) * sideburn)
    sweep = 0.30 * np.clip(np.abs(x - part), 0, 1.3) ** 1.3 - 0.16
    inner = 0.86 - 0.10 * smooth((across - 0.6) / 0.5)
    cover = np.clip((across - inner) / 0.20, 0, None) ** 1.25 * (2.6 if style == "long" else 2.0)
    return np.asarray(np.maximum(line, -identity.hairline + sweep - 0.05) + cover)


def paint_hair(picture: AnyArray, hair: Hair, face_cover: AnyArray) -> AnyArray:
    """Lay the front hair over the face, with the soft shadow it throws on the skin."""
    shadow = blurred(np.roll(hair.front, 5, axis=0), 5.0) * (1 - hair.front)
    picture = picture * (1 - 0.42 * shadow * face_cover)[..., None]
    return np.asarray(picture + (hair.colour - picture) * hair.front[..., None], np.float32)


def brow_hairs(
    picture: AnyArray,
    identity: Identity,
    face: FaceGeometry,
    x: AnyArray,
    y: AnyArray,
    rng: np.random.Generator,
) -> AnyArray:
    """Draw the brows, hair by hair, over a faint shadow of their shape."""
    step = float(x[0, 1] - x[0, 0])
    height, width = x.shape
    cover = np.zeros((height, width), np.float32)
    for brow in (face.right_brow, face.left_brow):
        outward = float(np.sign(brow[-1, 0] - brow[0, 0]))
        ink = np.zeros((height * BROW_SCALE // 2, width * BROW_SCALE // 2), np.uint8)
        for _ in range(BROW_HAIRS):
            t = float(rng.uniform(0.0, 1.0)) ** 0.9
            along = t * (len(brow) - 1)
            k = min(int(along), len(brow) - 2)
            point = brow[k] + (along - k) * (brow[k + 1] - brow[k])
            half = 0.5 * identity.brow_thickness * (1 - 0.72 * t**1.6) * min(1.0, 0.45 + 2.2 * t)
            offset = float(rng.normal()) * 0.48 * half
            root = point + np.array((0.0, offset))
            lean = np.deg2rad(
                70 * (1 - t) ** 1.6 + 8 - 60 * offset / (half + 1e-6) * 0.25 + float(rng.normal()) * 9
            )
            length = (0.045 + 0.030 * float(rng.random())) * (1 - 0.35 * t)
            tip = root + length * np.array([outward * np.cos(lean), -np.sin(lean) * 0.75])
            ends = np.stack([root, tip])
            px = (ends - (float(x[0, 0]), float(y[0, 0]))) / step * (BROW_SCALE / 2)
            a, b = np.round(px * 16).astype(int)
            cv2.line(
                ink,
                (int(a[0]), int(a[1])),
                (int(b[0]), int(b[1])),
                int(rng.integers(110, 220)),
                2,
                cv2.LINE_AA,
                4,
            )
        cover = np.maximum(
            cover, cv2.resize(ink, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32) / 255
        )
    shade = blurred(cover, 0.020 / step)
    strength = np.clip(identity.brow_darkness * (1.05 * cover + 0.75 * shade), 0, 0.95)
    colour = (linear_of(np.asarray(identity.hair)) * 0.55 + 0.004).astype(np.float32)
    return np.asarray(picture + (colour - picture) * strength[..., None], np.float32)
