"""Measure the sharpness of a face, and restore by an unsharp mask what averaging took (Nagle section 4, step 6).

Sharpness is the variance of the Laplacian of luma inside the mask. An unsharp mask adds `a` times the difference from
a Gaussian blur, so the variance is a quadratic in the amount `a`, and the amount for a wanted sharpness is its root.
The mask is linear, as is the mean of versions: it is applied once, to the blend.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.flow.baselines import LUMA

RADIUS = 0.006  # sd of the Gaussian, of the picture's width: 1.2 px at 200
WELL_INSIDE = 0.5  # of the mask


@dataclass(frozen=True, eq=False)
class Curve:
    """The variance of the Laplacian for an amount `a` of sharpening: v0 + 2 c a + v1 a^2."""

    plain: float
    shared: float
    added: float

    def at(self, amount: float) -> float:
        """Return the sharpness for an amount."""
        return self.plain + 2 * self.shared * amount + self.added * amount**2

    def amount_for(self, wanted: float) -> float:
        """Return the least amount, 0 or more, that reaches a wanted sharpness; 0 where nothing can be added.

        Examples
        --------
        >>> Curve(4.0, 1.0, 1.0).amount_for(7.0)
        1.0
        """
        if self.plain >= wanted or self.added <= 0:
            return 0.0
        root = np.sqrt(max(self.shared**2 - self.added * (self.plain - wanted), 0.0))
        return float(max((root - self.shared) / self.added, 0.0))


def _detail(image: Image) -> Image:
    """Return the difference of an image (h, w, 3) from its Gaussian blur."""
    sd_px = RADIUS * image.shape[1]
    return image - cv2.GaussianBlur(image, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)


def sharpened(image: Image, mask: Mask, amount: float) -> Image:
    """Add `amount` times an image's detail inside the mask (h, w); the same array for 0.

    References
    ----------
    Nagle et al., section 4, step 6.
    """
    if amount == 0:
        return image
    return image + np.float32(amount) * mask[..., None] * _detail(image)


def sharpness(image: Image, mask: Mask) -> float:
    """Compute the variance of the Laplacian of luma well inside the mask (h, w), in squared 8-bit codes."""
    return float(np.var(_laplacian(image)[mask > WELL_INSIDE]))


def curve(image: Image, mask: Mask) -> Curve:
    """Compute how the sharpness of an image (h, w, 3) grows with the amount."""
    inside = mask > WELL_INSIDE
    plain, added = _laplacian(image)[inside], _laplacian(_detail(image))[inside]
    together: AnyArray = np.cov(np.stack([plain, added]), bias=True)
    return Curve(float(together[0, 0]), float(together[0, 1]), float(together[1, 1]))


def mean_curve(curves: list[Curve]) -> Curve:
    """Return the mean of several curves."""
    parts = np.mean([(one.plain, one.shared, one.added) for one in curves], axis=0)
    return Curve(*map(float, parts))


def _laplacian(image: Image) -> AnyArray:
    luma = (255.0 * (image @ LUMA)).astype(np.float32)
    return cv2.Laplacian(luma, cv2.CV_32F, borderType=cv2.BORDER_REFLECT_101).astype(np.float64)
