"""Invert a skin sheet: find the point of the neutral canvas that is visible at a pixel.

The sheets stretch four-fold where lids close and the jaw opens, which plain fixed-point iteration does not
survive. The field is therefore blown up from zero in a few steps, following the solution with Newton's
method. Ours.
"""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Points

STEPS = (0.4, 0.8, 1.0, 1.0, 1.0, 1.0)  # of the whole field; the repeats polish the last one to 1e-3 px
ROWS = 32_000  # rows of a look-up at once; OpenCV refuses 32,767
LEAST_STRETCH = 0.12  # the area factor below which a Newton step is held back: the sheet is about to fold


def grid_px(width: int, height: int) -> tuple[AnyArray, AnyArray]:
    """Return the x and the y of every pixel, (height, width) float32."""
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return x, y


def sample_linear(field: AnyArray, x: AnyArray, y: AnyArray) -> AnyArray:
    """Look a field up at points, bilinear between pixels, the border value beyond.

    OpenCV rounds the coordinates of two-channel images to 1/32 px, and only theirs: such a field gets a third
    channel.
    """
    if field.ndim == 3 and field.shape[2] == 2:
        return sample_linear(padded(field), x, y)[..., :2]
    blocks = [
        cv2.remap(
            field, x[at : at + ROWS], y[at : at + ROWS], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        for at in range(0, max(1, len(x)), ROWS)
    ]
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks)


def padded(field: Displacement) -> AnyArray:
    """Add a third, empty channel to a field, so that looking it up is exact (see `sample_linear`)."""
    return np.dstack([field, np.zeros_like(field[..., 0])])


def inverse_of(field: Displacement) -> Displacement:
    """Return v with v(q) = -u(q + v(q)): the skin seen at q comes from q + v(q). (h, w, 2) float32 px.

    Zero gives exactly zero.
    """
    return inverse_like(field, np.zeros_like(field), np.zeros_like(field))


def inverse_like(field: Displacement, other: Displacement, inverse: Displacement) -> Displacement:
    """Return the inverse of a field that differs from `other` only in part; elsewhere its `inverse` holds."""
    v = inverse.copy()
    reach = int(np.ceil(np.abs(field).max())) + 2
    box = box_of(np.any(field != other, axis=2), reach)
    if box is not None:
        v[box] = _inverse_within(np.ascontiguousarray(field[box]))
    return v


def box_of(marked: AnyArray, reach: int) -> tuple[slice, slice] | None:
    """Return the rows and columns that hold every marked pixel, and `reach` px more; None for none."""
    rows, columns = np.flatnonzero(marked.any(axis=1)), np.flatnonzero(marked.any(axis=0))
    if rows.size == 0:
        return None
    return (
        slice(max(int(rows[0]) - reach, 0), int(rows[-1]) + reach + 1),
        slice(max(int(columns[0]) - reach, 0), int(columns[-1]) + reach + 1),
    )


def _inverse_within(field: Displacement) -> Displacement:
    height, width = field.shape[:2]
    qx, qy = grid_px(width, height)
    slope = np.array([[-0.5, 0.0, 0.5]], np.float32)
    by_x = cv2.filter2D(field, -1, slope, borderType=cv2.BORDER_REPLICATE)
    by_y = cv2.filter2D(field, -1, slope.T, borderType=cv2.BORDER_REPLICATE)
    jacobian = cv2.merge([by_x, by_y])
    three = padded(field)
    vx, vy = np.zeros_like(qx), np.zeros_like(qy)
    for step in STEPS:
        share = np.float32(step)
        px, py = qx + vx, qy + vy
        ux, uy, _ = cv2.split(sample_linear(three, px, py))
        xx, yx, xy, yy = cv2.split(sample_linear(jacobian, px, py))
        rx, ry = vx + share * ux, vy + share * uy
        for part in (xx, yx, xy, yy):
            part *= share
        xx += 1
        yy += 1
        area = np.maximum(xx * yy - xy * yx, LEAST_STRETCH)
        vx -= (yy * rx - xy * ry) / area
        vy -= (xx * ry - yx * rx) / area
    return np.dstack([vx, vy])


def at_points(field: Displacement, points: Points) -> Points:
    """Look a field up at points, bilinear, in float64; the points lie inside the field."""
    height, width = field.shape[:2]
    x0 = np.clip(np.floor(points[:, 0]), 0, width - 2).astype(int)
    y0 = np.clip(np.floor(points[:, 1]), 0, height - 2).astype(int)
    fx, fy = (points[:, 0] - x0)[:, None], (points[:, 1] - y0)[:, None]
    wide = field.astype(np.float64)
    top = wide[y0, x0] * (1 - fx) + wide[y0, x0 + 1] * fx
    bottom = wide[y0 + 1, x0] * (1 - fx) + wide[y0 + 1, x0 + 1] * fx
    return np.asarray(top * (1 - fy) + bottom * fy)
