"""Pictures at every scale, as the registration form takes them apart: planes in codes, a pyramid, and one shift.

They are OpenCV's with every backend: smoothers round their guides to whole codes, and what two backends give a little
differently would now and then be rounded to different ones.
"""

from __future__ import annotations

from math import sqrt

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.flow.backends import OpenCVBackend
from morphspace.flow.baselines import LUMA
from morphspace.flow.filters import bell
from morphspace.flow.presets import Preset

CODES = 255.0  # the estimator thinks in 8-bit codes
LEAST_CONTRAST_CODES = (
    0.5  # between the darkest and the brightest value of a plane; below it there is nothing to find
)
FINEST_PX = 72  # the shorter side below which the last scale is not scaled down
LEAST_SIDE_PX = 16  # of the coarsest scale
LEAST_BLUR_PX = 0.3  # before scaling down
SHIFTED = (
    0.3  # squared difference over the sum of squares, at the coarsest scale, from which a shift is sought
)
CLOSER = 0.5  # and the share of one less the correlation that it has to leave


def colour_planes(image: Image, preset: Preset) -> AnyArray:
    """Give the planes the preset compares, in codes."""
    mixing = LUMA[None] if preset.colours == "grey" else np.eye(3, dtype=np.float32)
    mixed = cv2.transform(image, mixing * np.float32(CODES))
    return np.ascontiguousarray(mixed[None] if mixed.ndim == 2 else mixed.transpose(2, 0, 1))


def is_flat(planes: AnyArray) -> bool:
    """Tell whether no plane varies by half a code: nothing can be found in such a picture."""
    return all(float(plane.max() - plane.min()) < LEAST_CONTRAST_CODES for plane in planes)


def pyramid(planes: AnyArray, preset: Preset) -> tuple[list[AnyArray], AnyArray]:
    """Give the picture at every scale, finest first, less a middle value of each plane; and that, (c, 1, 1).

    No channel needs it, and derivatives of smaller numbers are rounded less. It is the median of every fourth pixel
    each way.
    """
    backend = OpenCVBackend()
    height, width = planes.shape[1:]
    share = min(1.0, max(preset.finest, FINEST_PX / min(height, width)))
    if share < 1:
        planes = _shrunk(planes, share, round(height * share), round(width * share), backend)
    centre = np.stack([backend.middle(plane[::4, ::4]) for plane in planes])[:, None, None]
    scales = [planes - centre]
    while min(height, width) * share * preset.factor >= LEAST_SIDE_PX:
        share *= preset.factor
        scales.append(
            _shrunk(scales[-1], preset.factor, round(height * share), round(width * share), backend)
        )
    return scales, centre


def _shrunk(planes: AnyArray, factor: float, height: int, width: int, backend: OpenCVBackend) -> AnyArray:
    blur = bell(max(0.5 * sqrt(1 / factor**2 - 1), LEAST_BLUR_PX))
    return backend.shrunk(backend.filtered(planes, blur, blur), height, width)


def shift_between(reference: AnyArray, frame: AnyArray) -> AnyArray | None:
    """Give the field (2, h, w) of one shift between two small pictures (c, h, w), where only that makes them alike.

    The flow finds motions of a few pixels of its coarsest scale. Where a camera moved further, nothing is alike as the
    pictures lie; the middle of the reference is then looked up in the whole frame by normalised correlation.
    """
    unlike = float(((reference - frame) ** 2).sum())
    if unlike < SHIFTED * float((reference**2).sum() + (frame**2).sum()):
        return None
    _, height, width = reference.shape
    top, left = height // 4, width // 4
    middle = reference[:, top : height - top, left : width - left]
    likeness = cv2.matchTemplate(
        cv2.merge(tuple(frame)), cv2.merge(tuple(np.ascontiguousarray(middle))), cv2.TM_CCOEFF_NORMED
    )
    _, most, _, (across, down) = cv2.minMaxLoc(likeness)
    if 1 - most > CLOSER * (1 - float(likeness[top, left])):
        return None
    out = np.empty((2, height, width), np.float32)
    out[0], out[1] = across - left, down - top
    return out
