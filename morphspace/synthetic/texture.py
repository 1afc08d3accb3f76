"""Grain for skin, cloth and hair: band-limited noise, and noise drawn out along a direction field. Ours."""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.synthetic.inverse import grid_px, padded, sample_linear


def blurred(field: AnyArray, sigma: float) -> AnyArray:
    """Blur with a Gaussian of `sigma` px, mirrored at the border."""
    if sigma > 6:
        height, width = field.shape[:2]
        small = cv2.resize(field, (width // 3, height // 3), interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), sigma / 3, borderType=cv2.BORDER_REFLECT)
        return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR))
    return np.asarray(cv2.GaussianBlur(field, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))


def grain(rng: np.random.Generator, shape: tuple[int, int], sigma: float) -> AnyArray:
    """Return noise with features of `sigma` px, mean 0 and standard deviation 1, (h, w) float32."""
    coarse = max(1, int(sigma // 2))  # a broad grain is drawn on a coarser grid, at no loss
    small = (shape[0] // coarse + 3, shape[1] // coarse + 3)
    noise = rng.standard_normal(small, dtype=np.float32)
    if sigma > 0:
        noise = blurred(noise, sigma / coarse)
    if coarse > 1:
        noise = cv2.resize(noise, (small[1] * coarse, small[0] * coarse), interpolation=cv2.INTER_CUBIC)
    noise = noise[: shape[0], : shape[1]]
    return np.asarray((noise - noise.mean()) / noise.std(), np.float32)


def octaves(
    rng: np.random.Generator, shape: tuple[int, int], sigmas: tuple[float, ...], fall: float
) -> AnyArray:
    """Return a sum of grains, each finer one `fall` times weaker, with standard deviation 1."""
    total = np.zeros(shape, np.float32)
    for k, sigma in enumerate(sigmas):
        total += np.float32(fall**k) * grain(rng, shape, sigma)
    return np.asarray(total / total.std(), np.float32)


def strands(rng: np.random.Generator, angle: AnyArray, length: int, sigma: float) -> AnyArray:
    """Draw noise out along a direction field (line integral convolution), standard deviation 1.

    `angle` (h, w) radians, `length` px each way, `sigma` px the thickness of a strand.
    """
    height, width = angle.shape
    noise = grain(rng, (height, width), sigma)
    dx, dy = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    direction = padded(np.dstack([dx, dy]))
    total = noise.copy()
    for sign in (1.0, -1.0):
        x, y = grid_px(width, height)
        for _ in range(length):
            step_x, step_y, _ = cv2.split(sample_linear(direction, x, y))
            x, y = x + np.float32(sign) * step_x, y + np.float32(sign) * step_y
            total += sample_linear(noise, x, y)
    total -= blurred(total, 12.0)
    return np.asarray(total / total.std(), np.float32)


def linear_of(colour: AnyArray) -> AnyArray:
    """Decode sRGB-coded colour to linear light."""
    colour = np.clip(colour, 0.0, None)
    return np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def coded_of(light: AnyArray) -> AnyArray:
    """Code linear light as sRGB."""
    light = np.clip(light, 0.0, None)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
