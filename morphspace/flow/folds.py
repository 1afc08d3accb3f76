"""Take the folds out of a field: where a morph would turn skin over, the field is smoothed until it does not (ours).

Where a point of the reference is hidden in the frame (teeth behind closed lips) its neighbours' motions cross. No
picture can tell where such points went; what a morph needs of them is that they keep their order.
"""

from __future__ import annotations

import cv2
import numpy as np

from morphspace import warp
from morphspace.arrays import Displacement

LEAST_DETERMINANT = (
    0.05  # a cell pressed to less of its area counts as folded: rounding must not turn it over
)
FIRST_SD_PX = 1.0
GROWTH = 1.3  # of the smoothing from round to round
ROUNDS = 14  # the last smooths over 30 px: nothing an estimator makes outlasts it
REACH_SD = 2.0  # of the smoothed neighbourhood around a folded cell


def unfolded(field: Displacement) -> Displacement:
    """Give the field (h, w, 2) px with its folds smoothed away, unchanged elsewhere.

    Each round smooths the field by a wider Gaussian around the cells whose determinant is below
    `LEAST_DETERMINANT`. A field without folds comes back as it is.
    """
    sd_px = FIRST_SD_PX
    for _ in range(ROUNDS):
        folded = warp.determinants(field) < LEAST_DETERMINANT
        if not folded.any():
            return field
        corners = cv2.copyMakeBorder(folded.astype(np.float32), 0, 1, 0, 1, cv2.BORDER_CONSTANT, value=0)
        touched = cv2.dilate(corners, np.ones((2, 2), np.uint8))  # all four of a cell
        reach = 2 * round(REACH_SD * sd_px) + 1
        near = cv2.dilate(touched, np.ones((reach, reach), np.uint8))
        near = cv2.GaussianBlur(near, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)[..., None]
        smooth = cv2.GaussianBlur(field, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)
        field = field + near * (smooth - field)
        sd_px *= GROWTH
    return field
