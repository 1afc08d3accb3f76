"""Textures of several people mixed band by band, so that no detail is the average of details (ours).

A mean of faces loses what does not lie on itself to a pixel: pores, lashes, the rim of a pair of glasses. So only what
is coarser than `COARSE` is averaged. In the band below, a person who cannot show an expression has no say where it
changes the face. In the finest, each place is shown mostly by whoever has most to show there, after Suwajanakorn, Seitz
and Kemelmacher-Shlizerman (ICCV 2015), who weigh the levels of a Laplacian pyramid by their own strength.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.flow.baselines import LUMA

FINE = 0.010  # sd of the Gaussian that parts the finest band, of the width: 2 px at 200
COARSE = 0.040  # and the one below which all is averaged
AROUND = 0.020  # sd of the window in which strength is measured
CHANGED = (
    0.02,
    0.08,
)  # luma, 0 to 1: what an expression adds to the texture, from nothing to wholly another look
LEAST_STRENGTH = 1e-6  # of a band's variance, luma 0 to 1: where nobody has detail all count alike
LEAST_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class Shown:
    """What one identity shows on the common grid: a texture (h, w, 3), and how much it counts, (h, w) 0 to 1."""

    texture: Image
    share: Mask


def banded(mean: Image, shown: Sequence[Shown], usual: Sequence[float]) -> Image:
    """Give the mix (h, w, 3): the coarse part of `mean` (h, w, 3), and the finer ones of what is `shown`.

    `usual`, one an identity, is the strength of its finest detail as a rule: the sharper camera has no more to say.
    """
    fine_px, coarse_px = (part * mean.shape[1] for part in (FINE, COARSE))
    shares = [np.maximum(one.share, np.float32(LEAST_SHARE)) for one in shown]
    whole = np.sum(shares, axis=0)
    stronger = np.zeros_like(whole)
    middle, fine = np.zeros_like(mean), np.zeros_like(mean)
    for one, share, rule in zip(shown, shares, usual, strict=True):
        blurred = _blurred(one.texture, fine_px)
        middle += share[..., None] * (blurred - _blurred(one.texture, coarse_px))
        detail = one.texture - blurred
        strong = share * (strength(detail) + np.float32(LEAST_STRENGTH)) / np.float32(rule + LEAST_STRENGTH)
        stronger += strong
        fine += strong[..., None] * detail
    return _blurred(mean, coarse_px) + middle / whole[..., None] + fine / stronger[..., None]


def detail_of(texture: Image) -> Image:
    """Give the finest band of a texture (h, w, 3)."""
    return texture - _blurred(texture, FINE * texture.shape[1])


def strength(detail: Image) -> Mask:
    """Give the variance of a band's luma around each place, (h, w)."""
    square: Mask = _blurred((detail @ LUMA) ** 2, AROUND * detail.shape[1])
    return np.maximum(square, 0)


def changed(added: Image) -> Mask:
    """Give how far what an expression adds to the texture (h, w, 3) makes it another: (h, w), 0 to 1."""
    low, high = CHANGED
    apart = _blurred(np.abs(added).max(axis=2), AROUND * added.shape[1])
    out: Mask = np.clip((apart - low) / (high - low), 0, 1).astype(np.float32)
    return out


def _blurred(image: AnyArray, sd_px: float) -> AnyArray:
    return cv2.GaussianBlur(image, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)
