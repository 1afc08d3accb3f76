"""Rotated square crops of an image, the input of the networks, and the map back from their pixels to the image.

These are MediaPipe's rectangles with a consistent pixel grid: pixel centres lie at integers in image and crop.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import Affine, Image, Points
from morphspace.grid import warp


@dataclass(frozen=True, eq=False)
class Crop:
    """A square of an image.

    Attributes
    ----------
    centre : (x, y) px
    extent_px : float
        Side length in the image.
    turn_rad : float
        Rotation of the crop's x axis, clockwise in the picture.
    side : int
        Side length of the crop, px.
    mirrored : bool
        Whether left and right are exchanged.
    """

    centre: tuple[float, float]
    extent_px: float
    turn_rad: float
    side: int
    mirrored: bool = False

    @property
    def scale(self) -> float:
        """Image px per crop px."""
        return self.extent_px / self.side

    @property
    def to_image(self) -> Affine:
        """The affine (2, 3) from a point of the crop to the image."""
        cosine, sine = np.cos(self.turn_rad), np.sin(self.turn_rad)
        across = -1.0 if self.mirrored else 1.0
        linear = self.scale * np.array([[cosine * across, -sine], [sine * across, cosine]])
        middle = np.full(2, (self.side - 1) / 2)
        return np.column_stack([linear, np.array(self.centre) - linear @ middle])

    def cut(self, image: Image) -> Image:
        """Sample the crop (side, side, 3) from an image (h, w, 3); black outside.

        If the scale is two or more, whole blocks of pixels are averaged first, against aliasing.
        """
        matrix = self.to_image
        if (block := int(self.scale)) >= 2:
            image, matrix = _averaged(image, matrix, self.side, block)
        return cv2.warpAffine(
            image,
            matrix,
            (self.side, self.side),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
        )

    def in_image(self, points: Points) -> Points:
        """Map points (n, 2) of the crop to px of the image."""
        return warp.apply_affine(self.to_image, points)


def _averaged(image: Image, matrix: Affine, side: int, block: int) -> tuple[Image, Affine]:
    """Average blocks of the part inside the crop; return it with the affine from the crop to its pixels."""
    height, width = image.shape[:2]
    corners = warp.apply_affine(matrix, np.array([[0, 0], [side, 0], [0, side], [side, side]], np.float64))
    low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 2 * block, 0, (width, height))
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 2 * block, 0, (width, height))
    # Blocks start at the image's corner, so that a slightly moved crop averages the same blocks.
    low -= low % block
    region = image[low[1] : high[1], low[0] : high[0]]
    rows, columns = -(-region.shape[0] // block), -(-region.shape[1] // block)
    if rows == 0 or columns == 0:  # the crop is outside the image
        return np.zeros((1, 1, 3), np.float32), matrix
    missing = (rows * block - region.shape[0], columns * block - region.shape[1])
    if any(missing):
        region = cv2.copyMakeBorder(region, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE)
    small = cv2.resize(region, (columns, rows), interpolation=cv2.INTER_AREA)
    moved = matrix.copy()
    moved[:, 2] -= low + (block - 1) / 2
    return small, moved / block


def whole_image(width: int, height: int, side: int, margin: float) -> Crop:
    """Return the centred crop of an image (width, height) px, `margin` times its longer side across."""
    return Crop(((width - 1) / 2, (height - 1) / 2), margin * max(width, height), 0.0, side)


def along(points: Points, first: Points, last: Points, enlarged: float, side: int) -> Crop:
    """Return the crop of points (n, 2) whose x axis runs from `first` to `last` (2,).

    Its extent is the longer side of the points' bounding box in the rotated axes, times `enlarged`. MediaPipe's box
    is upright in the image; a rotated one gives a rotated face the same crop.
    """
    step = last - first
    turn = float(np.arctan2(step[1], step[0]))
    cosine, sine = np.cos(turn), np.sin(turn)
    axes = np.array([[cosine, sine], [-sine, cosine]])
    turned = points @ axes.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    x, y = axes.T @ ((low + high) / 2)
    return Crop((float(x), float(y)), enlarged * float((high - low).max()), turn, side)
