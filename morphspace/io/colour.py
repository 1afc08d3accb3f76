"""Between stored codes, sRGB-coded values and linear light (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput

CODE_LIMIT = 0.04045  # below it the sRGB curve is a straight line
LINEAR_LIMIT = 0.0031308  # the same place in linear light


def srgb_of_linear(linear: AnyArray) -> AnyArray:
    """Code linear light as sRGB, continued beyond 1 and mirrored below 0 so that it inverts."""
    size = np.abs(linear)
    coded = np.where(size <= LINEAR_LIMIT, 12.92 * size, 1.055 * size ** (1 / 2.4) - 0.055)
    return np.copysign(coded, linear).astype(linear.dtype)


def linear_of_srgb(coded: AnyArray) -> AnyArray:
    """Give the linear light of sRGB-coded values: the inverse of `srgb_of_linear`."""
    size = np.abs(coded)
    linear = np.where(size <= CODE_LIMIT, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.copysign(linear, coded).astype(coded.dtype)


def codes_of(image: Image, bits: int) -> tuple[AnyArray, int]:
    """Give the nearest codes of 8 or 16 bits, and how many values had to be clipped.

    A value counts where clipping to [0, 1] moves it by more than half a code, so that rounding noise at white
    and black does not.
    """
    top = 2**bits - 1
    scaled = np.asarray(image, np.float32) * np.float32(top)
    clipped = int(np.count_nonzero((scaled < -0.5) | (scaled > top + 0.5)))
    return np.rint(np.clip(scaled, 0, top)).astype(np.uint8 if bits == 8 else np.uint16), clipped


def check_image(image: Image, what: str) -> None:
    """Refuse what cannot be written as a picture: raises `BadInput`, naming `what`."""
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise BadInput(f"cannot write {what}: its shape is {image.shape}, (height, width, 3) was expected")
    if not np.isfinite(image).all():
        count = int(np.count_nonzero(~np.isfinite(image)))
        raise BadInput(f"cannot write {what}: {count} of its values are not finite")
