"""A flow as colours: hue for the direction, saturation for the length.

The colour wheel is the one of the Middlebury benchmark (Baker et al., IJCV 92, 2011): six stretches between red,
yellow, green, cyan, blue and magenta, wide where the eye tells many shades apart and narrow where it tells few. Right
is red, down yellow, left cyan, up violet.
"""

from __future__ import annotations

import math

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image

STRETCHES = (15, 6, 4, 11, 13, 6)  # hues from red to yellow, to green, to cyan, to blue, to magenta, to red
CORNERS = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1], [1, 0, 0]], np.float64)
BEYOND = 0.75  # brightness of a displacement longer than the rim
RIM_QUANTILE = 0.998  # a few outliers do not make the rest pale
NICE = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)  # what a rim may be, times a power of ten
LEAST_RIM_PX = 0.1  # a field at rest stays white, noise or not


def colours_of(displacement: Displacement, rim_px: float) -> Image:
    """Give a field (h, w, 2) as colours (h, w, 3): white at rest, full colour at `rim_px`, darker beyond it."""
    u, v = displacement[..., 0].astype(np.float64), displacement[..., 1].astype(np.float64)
    places = np.cumsum((0, *STRETCHES))
    turn = np.mod(np.arctan2(v, u) / (2 * np.pi), 1.0) * places[-1]
    hue = np.stack([np.interp(turn, places, channel) for channel in CORNERS.T], axis=-1)
    share = (np.hypot(u, v) / rim_px)[..., None]
    colours: AnyArray = np.where(share <= 1, 1 - share * (1 - hue), BEYOND * hue)
    return colours.astype(np.float32)


def rim_of(displacement: Displacement) -> float:
    """Give a round length (px) that nearly all displacements stay within: the rim of the wheel for this field."""
    length = float(np.quantile(np.hypot(displacement[..., 0], displacement[..., 1]), RIM_QUANTILE))
    length = max(length, LEAST_RIM_PX)
    power = 10.0 ** math.floor(math.log10(length))
    return next(power * nice for nice in NICE if power * nice >= length * (1 - 1e-6))


def wheel(diameter: int) -> tuple[Image, AnyArray]:
    """Give the wheel as a picture (d, d, 3), the rim at its edge, and how much of each pixel is inside, (d, d)."""
    radius = diameter / 2
    step = np.arange(diameter) + 0.5 - radius
    field = np.stack(np.meshgrid(step, step), axis=-1).astype(np.float32)
    length = np.hypot(field[..., 0], field[..., 1])
    field *= np.minimum(1, radius / np.maximum(length, 1e-6))[..., None]
    return colours_of(field, radius * (1 + 1e-6)), np.clip(radius - length + 0.5, 0, 1)
