"""Checks of the pictures of a flow, the same for every estimator and the command line.

A picture that cannot be used is an error. A picture of one colour is not: its flow is zero with zero confidence.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow import Flow

MIN_SIDE_PX = 16  # px; two patches of 8 px, the least that a coarse level needs
MAX_SIDE_PX = 32766  # px; the limit of OpenCV's remap
LARGEST_VALUE = 1000.0  # sRGB-coded; far above any HDR picture, and its squares stay far inside float32
LEAST_CONTRAST = 0.5 / 255  # half an 8-bit code between the darkest and the brightest value of a channel


def checked_picture(picture: Image, name: str) -> Image:
    """Check a picture and return it as (h, w, 3) float32, with grey repeated.

    Parameters
    ----------
    picture : array (h, w), (h, w, 1) or (h, w, 3), float
    name : str
        What messages call it.

    Returns
    -------
    array (h, w, 3) float32

    Raises
    ------
    BadInput
        If its shape or type is another, a side is outside `MIN_SIDE_PX` to `MAX_SIDE_PX`, or a value is not finite or
        beyond `LARGEST_VALUE`.

    Examples
    --------
    >>> import numpy as np
    >>> checked_picture(np.zeros((20, 30)), "the reference").shape
    (20, 30, 3)
    """
    values = np.asarray(picture)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or values.shape[2] not in (1, 3):
        raise BadInput(
            f"{name} has the shape {values.shape}; expected (h, w), (h, w, 1) or (h, w, 3). Convert it"
        )
    if values.dtype.kind != "f":
        raise BadInput(
            f"{name} holds {values.dtype}; expected floats in [0, 1]. Divide codes by the largest code"
        )
    height, width = values.shape[:2]
    if min(height, width) < MIN_SIDE_PX:
        raise BadInput(
            f"{name} has {width}x{height} px; expected at least {MIN_SIDE_PX} px a side. Use a larger picture"
        )
    if max(height, width) > MAX_SIDE_PX:
        raise BadInput(
            f"{name} has {width}x{height} px; expected at most {MAX_SIDE_PX} px a side. Use a smaller picture"
        )
    largest = max(abs(float(values.max())), abs(float(values.min())))  # NaN and infinity pass both
    if not np.isfinite(largest):
        bad = int(np.count_nonzero(~np.isfinite(values)))
        raise BadInput(f"{name} holds {bad} values that are not finite; expected none. Repair the picture")
    if largest > LARGEST_VALUE:
        raise BadInput(f"{name} holds values up to {largest:.3g}; expected values near [0, 1]. Scale them")
    return np.ascontiguousarray(np.broadcast_to(values, (height, width, 3)), np.float32)


def checked_pair(
    reference: Image, frame: Image, names: tuple[str, str] = ("the reference", "the frame")
) -> tuple[Image, Image]:
    """Check two pictures and return them as (h, w, 3) float32; see `checked_picture`.

    Raises `SizeMismatch`, a `BadInput`, if their sizes differ.
    """
    one = checked_picture(reference, names[0])
    return one, checked_frame(one, frame, names)


def checked_frame(
    reference: Image, frame: Image, names: tuple[str, str] = ("the reference", "the frame")
) -> Image:
    """Check a frame against a checked reference (h, w, 3), as `checked_pair` does.

    Raises `SizeMismatch` if their sizes differ, and `BadInput` if the frame is no picture.
    """
    one, other = reference, checked_picture(frame, names[1])
    if one.shape != other.shape:
        raise SizeMismatch(
            f"{names[1]} has {other.shape[1]}x{other.shape[0]} px; expected {one.shape[1]}x{one.shape[0]} px, as "
            f"{names[0]}. Scale or crop them to one size"
        )
    return other


def checked_start(start: Displacement, height: int, width: int) -> Displacement:
    """Check a start and return it as (h, w, 2) float32 px.

    Raises `SizeMismatch` if its grid is not (height, width), and `BadInput` if a value is not finite.
    """
    with np.errstate(over="ignore"):  # a value beyond float32 becomes infinite and is an error below
        field = np.asarray(start, np.float32)
    if field.shape != (height, width, 2):
        raise SizeMismatch(
            f"the start has the shape {field.shape}; expected ({height}, {width}, 2), the reference's grid of "
            f"{width}x{height} px. Use a field on that grid"
        )
    if not np.isfinite(field).all():
        raise BadInput("the start holds values that are not finite; expected none. Repair it or leave it out")
    return field


def is_featureless(image: Image) -> bool:
    """Return whether an image (h, w, 3) has one colour, to half an 8-bit code, so that no flow can be found.

    Examples
    --------
    >>> import numpy as np
    >>> is_featureless(np.full((4, 4, 3), 0.5)), is_featureless(np.eye(4)[..., None] * np.ones(3))
    (True, False)
    """
    return float((image.max(axis=(0, 1)) - image.min(axis=(0, 1))).max()) < LEAST_CONTRAST


def is_grey(image: Image) -> bool:
    """Return whether the three channels of an image (h, w, 3) are equal, to half an 8-bit code.

    Examples
    --------
    >>> import numpy as np
    >>> is_grey(np.full((2, 2, 3), 0.5)), is_grey(np.full((2, 2, 3), [0.5, 0.4, 0.3]))
    (True, False)
    """
    return float((image.max(axis=2) - image.min(axis=2)).max()) < LEAST_CONTRAST


def unknown_flow(height: int, width: int) -> Flow:
    """Return a flow of zero displacement and zero confidence."""
    return Flow(np.zeros((height, width, 2), np.float32), np.zeros((height, width), np.float32))
