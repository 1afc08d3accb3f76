"""Which two pictures a flow can be asked for: one set of rules for every estimator and for the command line.

A picture that cannot be used is refused in one line. A picture in which nothing can be found (one colour all over) is
no error: its flow is zero with zero confidence.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow import Flow

MIN_SIDE_PX = 16  # two patches of 8 px: below it nothing is left to compare, and no coarser level
MAX_SIDE_PX = 32766  # the largest that OpenCV's remap takes
LARGEST_VALUE = (
    1000.0  # far above any light of an HDR picture after sRGB coding; squares stay far inside float32
)
LEAST_CONTRAST = 0.5 / 255  # half an 8-bit code between the darkest and the brightest value of a channel


def checked_picture(picture: Image, name: str) -> Image:
    """Give a picture as (h, w, 3) float32, grey (h, w) or (h, w, 1) repeated.

    Raises `BadInput`, calling it `name`, where its shape or type is another, where it is smaller than `MIN_SIDE_PX`,
    and where a value is not finite or beyond `LARGEST_VALUE`.
    """
    values = np.asarray(picture)
    if values.ndim == 2:
        values = values[..., None]
    if values.ndim != 3 or values.shape[2] not in (1, 3):
        raise BadInput(f"{name} has the shape {values.shape}: a flow needs (h, w), (h, w, 1) or (h, w, 3)")
    if values.dtype.kind != "f":
        raise BadInput(
            f"{name} holds {values.dtype}: a flow needs floats in [0, 1]; divide codes by the largest"
        )
    height, width = values.shape[:2]
    if min(height, width) < MIN_SIDE_PX:
        raise BadInput(
            f"{name} has {width}x{height} px: a flow needs at least {MIN_SIDE_PX} on each side; use a larger picture"
        )
    if max(height, width) > MAX_SIDE_PX:
        raise BadInput(
            f"{name} has {width}x{height} px: a flow has at most {MAX_SIDE_PX} on a side; use a smaller picture"
        )
    largest = max(abs(float(values.max())), abs(float(values.min())))  # NaN and infinity come through both
    if not np.isfinite(largest):
        bad = int(np.count_nonzero(~np.isfinite(values)))
        raise BadInput(f"{name} holds {bad} values that are not finite: mend it and save it again")
    if largest > LARGEST_VALUE:
        raise BadInput(
            f"{name} holds values up to {largest:.3g}: an image's values lie near [0, 1]; scale them first"
        )
    return np.ascontiguousarray(np.broadcast_to(values, (height, width, 3)), np.float32)


def checked_pair(
    reference: Image, frame: Image, names: tuple[str, str] = ("the reference", "the frame")
) -> tuple[Image, Image]:
    """Give two pictures that a flow can be found between, each (h, w, 3) float32; see `checked_picture`.

    Raises `SizeMismatch`, a `BadInput`, where their sizes differ.
    """
    one = checked_picture(reference, names[0])
    return one, checked_frame(one, frame, names)


def checked_frame(
    reference: Image, frame: Image, names: tuple[str, str] = ("the reference", "the frame")
) -> Image:
    """Give a frame (h, w, 3) of the size of a reference that was checked before; see `checked_pair`."""
    one, other = reference, checked_picture(frame, names[1])
    if one.shape != other.shape:
        raise SizeMismatch(
            f"{names[0]} has {one.shape[1]}x{one.shape[0]} px, {names[1]} has {other.shape[1]}x{other.shape[0]}: "
            "scale or crop them to one size"
        )
    return other


def checked_start(start: Displacement, height: int, width: int) -> Displacement:
    """Give a start as float32 (h, w, 2) px.

    Raises `SizeMismatch` where it is no field on a grid of this size, and `BadInput` where a value is not finite.
    """
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite, and is refused
        field = np.asarray(start, np.float32)
    if field.shape != (height, width, 2):
        raise SizeMismatch(
            f"the start is a field of shape {field.shape}, the reference has {width}x{height} px: "
            "give a field (h, w, 2) on the reference's grid"
        )
    if not np.isfinite(field).all():
        raise BadInput("the start holds values that are not finite: mend it or leave it out")
    return field


def is_featureless(image: Image) -> bool:
    """Tell whether an image (h, w, 3) is one colour all over, to half an 8-bit code: no flow can be found from it."""
    return float((image.max(axis=(0, 1)) - image.min(axis=(0, 1))).max()) < LEAST_CONTRAST


def is_grey(image: Image) -> bool:
    """Tell whether the three channels of an image (h, w, 3) are the same everywhere, to half an 8-bit code."""
    return float((image.max(axis=2) - image.min(axis=2)).max()) < LEAST_CONTRAST


def unknown_flow(height: int, width: int) -> Flow:
    """Give the flow of pictures in which nothing can be found: zero everywhere, confidence zero."""
    return Flow(np.zeros((height, width, 2), np.float32), np.zeros((height, width), np.float32))
