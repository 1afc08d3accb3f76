"""Take the folds out of a field: where a morph would turn skin over, the field is smoothed until it does not (ours).

Where a point of the reference is hidden in the frame (teeth behind closed lips) its neighbours' motions cross. No
picture can tell where such points went; what a morph needs of them is that they keep their order.
"""

from __future__ import annotations

from math import ceil

import cv2
import numpy as np

from morphspace import warp
from morphspace.arrays import AnyArray, Displacement

LEAST_DETERMINANT = (
    0.05  # a cell pressed to less of its area counts as folded: rounding must not turn it over
)
GENTLE = 0.47  # px from one pixel to the next; 1 - 2 x this is above `LEAST_DETERMINANT`
BAND_PX = 16  # rows that are looked at together for steps that are not
FIRST_SD_PX = 1.0
GROWTH = 1.3  # of the smoothing from round to round
ROUNDS = 14  # the last smooths over 30 px: nothing an estimator makes outlasts it
REACH_SD = 2.0  # of the smoothed neighbourhood around a folded cell
BLURS_SD = 8.0  # two of OpenCV's Gaussians, one after the other, end there


def _steep_rows(field: Displacement) -> slice:
    """Give the rows outside which no cell can fold: its determinant is 1 - 2 m or more where no step exceeds m px."""
    rows = len(field)
    steep = [
        top
        for top in range(0, rows - 1, BAND_PX)
        if max(_largest_step(field[top : top + BAND_PX + 1])) >= GENTLE  # the row below is the cells' too
    ]
    return slice(steep[0], min(steep[-1] + BAND_PX + 1, rows)) if steep else slice(0, 0)


def _largest_step(field: Displacement) -> tuple[float, float]:
    """Give the largest difference of a component between neighbours, across and down, px."""
    return (
        cv2.norm(field[:, 1:], field[:, :-1], cv2.NORM_INF),
        cv2.norm(field[1:], field[:-1], cv2.NORM_INF),
    )


def unfolded(field: Displacement) -> Displacement:
    """Give the field (h, w, 2) px with its folds smoothed away, unchanged elsewhere.

    Each round smooths the field by a wider Gaussian around the cells whose determinant is below
    `LEAST_DETERMINANT`. A field without folds comes back as it is, the same array. After `ROUNDS` rounds what still
    folds is left: a tear of some 400 px would be.
    """
    rows = _steep_rows(field)
    steep = warp.determinants(field[rows]) < LEAST_DETERMINANT if rows.stop else np.zeros((0, 0), bool)
    if not steep.any():
        return field
    folded = np.zeros((field.shape[0] - 1, field.shape[1] - 1), bool)
    folded[rows.start : rows.stop - 1] = steep
    out = field.copy()
    sd_px = FIRST_SD_PX
    for _ in range(ROUNDS):
        if not folded.any():
            break
        reach = 2 * round(REACH_SD * sd_px) + 1
        top, bottom, left, right = _box(folded, reach + ceil(BLURS_SD * sd_px))
        part = out[top:bottom, left:right]
        cells = folded[top : bottom - 1, left : right - 1]
        corners = cv2.copyMakeBorder(cells.astype(np.float32), 0, 1, 0, 1, cv2.BORDER_CONSTANT, value=0)
        touched = cv2.dilate(corners, np.ones((2, 2), np.uint8))  # all four of a cell
        near = cv2.dilate(touched, np.ones((reach, reach), np.uint8))
        near = cv2.GaussianBlur(near, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)[..., None]
        smooth = cv2.GaussianBlur(part, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)
        part += near * (smooth - part)
        cells[...] = warp.determinants(part) < LEAST_DETERMINANT
        sd_px *= GROWTH
    return out


def _box(cells: AnyArray, margin: int) -> tuple[int, int, int, int]:
    """Give the pixels around the true cells (h - 1, w - 1), `margin` more on each side: top, bottom, left, right."""
    left, top, width, height = cv2.boundingRect(cells.astype(np.uint8))
    last_row, last_column = cells.shape[0] + 1, cells.shape[1] + 1
    return (
        max(top - margin, 0),
        min(top + height + 1 + margin, last_row),
        max(left - margin, 0),
        min(left + width + 1 + margin, last_column),
    )
