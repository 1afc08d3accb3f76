"""Convert between stored integer codes, sRGB-coded values and linear light (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput

CODE_LIMIT = 0.04045  # sRGB-coded; the curve is a straight line below (IEC 61966-2-1)
LINEAR_LIMIT = 0.0031308  # linear light; the same point


def srgb_of_linear(linear: AnyArray) -> AnyArray:
    """Code linear light as sRGB. The curve continues beyond 1 and is mirrored below 0, so that it can be inverted.

    References
    ----------
    IEC 61966-2-1.

    Examples
    --------
    >>> import numpy as np
    >>> srgb_of_linear(np.array([0.0, 0.214, 1.0])).round(2).tolist()
    [0.0, 0.5, 1.0]
    """
    size = np.abs(linear)
    coded = np.where(size <= LINEAR_LIMIT, 12.92 * size, 1.055 * size ** (1 / 2.4) - 0.055)
    return np.copysign(coded, linear).astype(linear.dtype)


def linear_of_srgb(coded: AnyArray) -> AnyArray:
    """Decode sRGB-coded values to linear light: the inverse of `srgb_of_linear`.

    References
    ----------
    IEC 61966-2-1.

    Examples
    --------
    >>> import numpy as np
    >>> linear_of_srgb(np.array([0.0, 0.5, 1.0])).round(3).tolist()
    [0.0, 0.214, 1.0]
    """
    size = np.abs(coded)
    linear = np.where(size <= CODE_LIMIT, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.copysign(linear, coded).astype(coded.dtype)


def codes_of(image: Image, bits: int) -> tuple[AnyArray, int]:
    """Round an image to integer codes, and count the values that were clipped to [0, 1].

    Parameters
    ----------
    image : array (h, w, c), sRGB-coded, 1.0 = white
    bits : 8 or 16

    Returns
    -------
    array (h, w, c) uint8 or uint16
    int
        The number of values that clipping moved by more than half a code: rounding errors at black and white do not
        count.

    Examples
    --------
    >>> import numpy as np
    >>> codes, clipped = codes_of(np.array([[[0.0, 0.5, 1.2]]]), 8)
    >>> codes.tolist(), clipped
    ([[[0, 128, 255]]], 1)
    """
    top = 2**bits - 1
    scaled = np.asarray(image, np.float32) * np.float32(top)
    clipped = int(np.count_nonzero((scaled < -0.5) | (scaled > top + 0.5)))
    return np.rint(np.clip(scaled, 0, top)).astype(np.uint8 if bits == 8 else np.uint16), clipped


def check_image(image: Image, what: str) -> None:
    """Raise `BadInput`, which names the file or image as `what`, if an image is not (h, w, 3) or not finite."""
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise BadInput(
            f"cannot write {what}: its shape is {image.shape}; expected (height, width, 3). Convert it"
        )
    if not np.isfinite(image).all():
        count = int(np.count_nonzero(~np.isfinite(image)))
        raise BadInput(
            f"cannot write {what}: {count} of its values are not finite; expected none. Repair the image"
        )
