"""Removal of folds: a field is smoothed where a morph would turn skin over (ours).

Where a point of the reference is hidden in the frame (teeth behind closed lips), the motions of its neighbours cross.
The picture does not show where such points went; a morph needs only that they keep their order.
"""

from __future__ import annotations

from math import ceil, floor
from typing import NamedTuple

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement
from morphspace.grid import warp

LEAST_DETERMINANT = 0.05  # area of a cell, of 1; a smaller one counts as folded: rounding could flip it
GENTLE_STEP_PX = 0.47  # px; smaller steps cannot fold, as 1 - 2 x this exceeds `LEAST_DETERMINANT`
BAND_PX = 16  # rows that are searched together for larger steps
FIRST_SD_PX = 1.0  # px, SD of the first smoothing of a folded neighbourhood
GROWTH = 1.3  # ratio of the smoothing in one round to that before
NEIGHBOURS = np.ones((3, 3), np.uint8)  # a cell and those to the right of it and below
ROUNDS = 14  # the last smooths over 30 px, which removes any fold of an estimator
REACH_SD = 2.0  # SD; radius of the smoothed neighbourhood around a folded cell
BLURS_SD = 8.0  # SD; two of OpenCV's Gaussians in sequence are 0 beyond it


class Box(NamedTuple):
    """Pixels from `top` to before `bottom`, and from `left` to before `right`."""

    top: int
    bottom: int
    left: int
    right: int

    def of(self, grid: AnyArray) -> AnyArray:
        """Return a view of this part of a grid (h, w, ...)."""
        return grid[self.top : self.bottom, self.left : self.right]

    def cells(self) -> Box:
        """Return the box of the cells between these pixels, each indexed by its upper left pixel."""
        return Box(self.top, self.bottom - 1, self.left, self.right - 1)


def suspects_when_enlarged(field: AnyArray, height: int, width: int) -> Box | None:
    """Find where a field may fold once it is enlarged bilinearly.

    A step of the enlarged grid is a mean of the steps of at most 2 x 3 cells of the field. Its determinant is at
    least that of the worst combination of these steps.

    Parameters
    ----------
    field : array (2, h, w), px
    height, width : int
        Size of the enlarged field, px.

    Returns
    -------
    Box or None
        Pixels of the enlarged field outside which it cannot fold; None if it cannot fold at all.
    """
    old_height, old_width = field.shape[1:]
    x, y = (
        cv2.copyMakeBorder(plane, 1, 1, 1, 1, cv2.BORDER_REPLICATE) for plane in field
    )  # no step at the edge
    across = _least(x[:, 1:] - x[:, :-1]) + 1, _most(y[:, 1:] - y[:, :-1])
    down = _least(y[1:] - y[:-1]) + 1, _most(x[1:] - x[:-1])
    kept = np.maximum(across[0][:-1], 0)
    kept *= np.maximum(down[0][:, :-1], 0)
    kept -= across[1][:-1] * down[1][:, :-1]
    left, top, columns, rows = cv2.boundingRect((kept < LEAST_DETERMINANT).astype(np.uint8))
    if not rows:
        return None
    tall, wide = height / old_height, width / old_width
    return Box(
        max(floor((top - 0.5) * tall - 0.5) - 1, 0),
        min(ceil((top + rows + 0.5) * tall - 0.5) + 2, height),
        max(floor((left - 0.5) * wide - 0.5) - 1, 0),
        min(ceil((left + columns + 0.5) * wide - 0.5) + 2, width),
    )


def _least(steps: AnyArray) -> AnyArray:
    return cv2.erode(steps, NEIGHBOURS, anchor=(0, 0))


def _most(steps: AnyArray) -> AnyArray:
    return cv2.dilate(np.abs(steps), NEIGHBOURS, anchor=(0, 0))


def _steep(field: Displacement) -> Box:
    """Return the rows outside which no cell can fold: if no step exceeds m px, its determinant is at least 1 - 2 m."""
    rows = len(field)
    steep = [
        top
        for top in range(0, rows - 1, BAND_PX)
        if max(_largest_step(field[top : top + BAND_PX + 1])) >= GENTLE_STEP_PX  # cells include the row below
    ]
    return Box(steep[0], min(steep[-1] + BAND_PX + 1, rows), 0, field.shape[1]) if steep else Box(0, 0, 0, 0)


def _largest_step(field: Displacement) -> tuple[float, float]:
    """Return the largest difference of a component between neighbours, across and down, px."""
    return (
        cv2.norm(field[:, 1:], field[:, :-1], cv2.NORM_INF),
        cv2.norm(field[1:], field[:-1], cv2.NORM_INF),
    )


def unfolded(field: Displacement, suspects: Box | None = None) -> Displacement:
    """Smooth a field where it folds.

    Each round smooths the field by a wider Gaussian around the cells whose determinant is below `LEAST_DETERMINANT`.
    After `ROUNDS` rounds any remaining fold stays: a tear of some 400 px would remain.

    Parameters
    ----------
    field : array (h, w, 2) float32, px
    suspects : Box, optional
        The pixels that are searched for folds (`suspects_when_enlarged`); all by default.

    Returns
    -------
    array (h, w, 2) float32, px
        The same array if the field has no fold; otherwise a copy that differs around the folds only.

    Examples
    --------
    >>> import numpy as np
    >>> field = np.zeros((40, 40, 2), np.float32)
    >>> field[:, 20, 0] = -3
    >>> mask = np.ones((40, 40), np.float32)
    >>> warp.fold_fraction(field, mask) > 0, warp.fold_fraction(unfolded(field), mask)
    (True, 0.0)
    """
    box = suspects or _steep(field)
    pressed = warp.determinants(box.of(field)) < LEAST_DETERMINANT if box.bottom else np.zeros((0, 0), bool)
    if not pressed.any():
        return field
    folded = np.zeros((field.shape[0] - 1, field.shape[1] - 1), bool)
    box.cells().of(folded)[...] = pressed
    out = field.copy()
    sd_px = FIRST_SD_PX
    for _ in range(ROUNDS):
        if not folded.any():
            break
        reach = 2 * round(REACH_SD * sd_px) + 1
        near_folds = _box(folded, reach + ceil(BLURS_SD * sd_px))
        part = near_folds.of(out)
        cells = near_folds.cells().of(folded)
        corners = cv2.copyMakeBorder(cells.astype(np.float32), 0, 1, 0, 1, cv2.BORDER_CONSTANT, value=0)
        touched = cv2.dilate(corners, np.ones((2, 2), np.uint8))  # all four corners of a cell
        near = cv2.dilate(touched, np.ones((reach, reach), np.uint8))
        near = cv2.GaussianBlur(near, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)[..., None]
        smooth = cv2.GaussianBlur(part, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)
        part += near * (smooth - part)
        cells[...] = warp.determinants(part) < LEAST_DETERMINANT
        sd_px *= GROWTH
    return out


def _box(cells: AnyArray, margin: int) -> Box:
    """Return the box of the true cells (h - 1, w - 1), `margin` px larger on each side."""
    left, top, width, height = cv2.boundingRect(cells.astype(np.uint8))
    last_row, last_column = cells.shape[0] + 1, cells.shape[1] + 1
    return Box(
        max(top - margin, 0),
        min(top + height + 1 + margin, last_row),
        max(left - margin, 0),
        min(left + width + 1 + margin, last_column),
    )
