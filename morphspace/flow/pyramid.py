"""Pictures at every scale, as the registration flow needs them: planes in codes, a pyramid, and one global shift.

All backends use OpenCV here. Smoothers round their guides to whole codes, so a small difference between two libraries
would change some codes.
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

CODES = 255.0  # the estimator's values are 8-bit codes
LEAST_CONTRAST_CODES = 0.5  # codes, range of a plane; below it no motion can be found
FINEST_PX = 72  # px, shorter side of the smallest last scale
LEAST_SIDE_PX = 16  # px, shorter side of the coarsest scale
LEAST_BLUR_PX = 0.3  # px, SD before shrinking
SHIFT_MISFIT = 0.3  # squared difference over sum of squares at the coarsest scale that prompts a search
SHIFT_GAIN = 0.5  # largest ratio of 1 - correlation with the shift to that without it


def colour_planes(image: Image, preset: Preset) -> AnyArray:
    """Return the planes (c, h, w) that the preset compares of an image (h, w, 3), in codes."""
    mixing = LUMA[None] if preset.colours == "grey" else np.eye(3, dtype=np.float32)
    mixed = cv2.transform(image, mixing * np.float32(CODES))
    return np.ascontiguousarray(mixed[None] if mixed.ndim == 2 else mixed.transpose(2, 0, 1))


def is_flat(planes: AnyArray) -> bool:
    """Return whether every plane varies by less than half a code, so that no motion can be found."""
    return all(float(plane.max() - plane.min()) < LEAST_CONTRAST_CODES for plane in planes)


def pyramid(planes: AnyArray, preset: Preset) -> tuple[list[AnyArray], AnyArray]:
    """Return the picture at every scale, finest first, minus a centre of each plane, and the centres (c, 1, 1).

    The centre is the median of every fourth pixel each way. No channel needs it, and smaller numbers lose less to
    rounding.
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
    """Find a global shift between two small pictures (c, h, w), if they are similar only after it.

    The flow finds motions of a few pixels of its coarsest scale. If the camera moved further, the pictures differ
    everywhere. The centre of the reference is then searched in the whole frame by normalised correlation.

    Returns
    -------
    array (2, h, w) float32 or None
        The constant field in px; None if the pictures are similar without it or no shift helps.
    """
    unlike = float(((reference - frame) ** 2).sum())
    if unlike < SHIFT_MISFIT * float((reference**2).sum() + (frame**2).sum()):
        return None
    _, height, width = reference.shape
    top, left = height // 4, width // 4
    middle = reference[:, top : height - top, left : width - left]
    likeness = cv2.matchTemplate(
        cv2.merge(tuple(frame)), cv2.merge(tuple(np.ascontiguousarray(middle))), cv2.TM_CCOEFF_NORMED
    )
    _, most, _, (across, down) = cv2.minMaxLoc(likeness)
    if 1 - most > SHIFT_GAIN * (1 - float(likeness[top, left])):
        return None
    out = np.empty((2, height, width), np.float32)
    out[0], out[1] = across - left, down - top
    return out
