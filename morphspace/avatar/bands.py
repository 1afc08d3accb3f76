"""Textures of several people mixed band by band, so that no detail is the average of details (ours).

A mean of faces loses what does not lie on itself to a pixel: pores, lashes, the rim of a pair of glasses. So only what
is coarser than `COARSE` is averaged. In the band below, a person who cannot show an expression has no say where it
changes the face. In the finest, each place is shown mostly by whoever has most to show there, after Suwajanakorn, Seitz
and Kemelmacher-Shlizerman (ICCV 2015), who weigh the levels of a Laplacian pyramid by their own strength.

Strength decides whose detail a place shows, weights how much of it. Were both one product, a pair of glasses would be
there almost whole at a weight of a twentieth: the skin of the others has next to nothing to set against it.
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
    """What one identity shows on the common grid.

    `texture` (h, w, 3) | `share` (h, w) 0 to 1, how far it is to be seen there | `weight` of the identity, 0 or more.
    """

    texture: Image
    share: Mask
    weight: float = 1.0


def banded(mean: Image, shown: Sequence[Shown], usual: Sequence[float]) -> Image:
    """Give the mix (h, w, 3): the coarse part of `mean` (h, w, 3), and the finer ones of what is `shown`.

    `usual`, one an identity, is the strength of its finest detail as a rule: the sharper camera has no more to say. One
    of the weights must be above 0.
    """
    fine_px, coarse_px = (part * mean.shape[1] for part in (FINE, COARSE))
    whole = np.zeros(mean.shape[:2], np.float32)
    middle, details, strong = np.zeros_like(mean), [], []
    for one, rule in zip(shown, usual, strict=True):
        share = np.maximum(one.share, np.float32(LEAST_SHARE))
        part = np.float32(one.weight) * share
        blurred = _blurred(one.texture, fine_px)
        whole += part
        middle += part[..., None] * (blurred - _blurred(one.texture, coarse_px))
        detail = one.texture - blurred
        details.append(detail)
        strong.append(
            share * (strength(detail) + np.float32(LEAST_STRENGTH)) / np.float32(rule + LEAST_STRENGTH)
        )
    fine = np.zeros_like(mean)
    for taken, detail in zip(_taken(strong, [one.weight for one in shown]), details, strict=True):
        fine += taken[..., None] * detail
    return _blurred(mean, coarse_px) + middle / whole[..., None] + fine


def _taken(strong: Sequence[Mask], weights: Sequence[float]) -> list[Mask]:
    """Give how much of each one's finest detail is taken, (h, w) each, sum 1 everywhere.

    Any weights are a sum of equal ones: of all people, of all but the lightest, down to the heaviest alone. Among
    equals each place is dealt out by strength, `strong` (h, w) each, and the mixes of equals are added up by their
    parts of the weights, as in a Choquet integral. So equal weights are dealt out by strength alone, a weight near 0
    is as none, and detail that one alone of n has is there by n times that one's weight while nobody weighs less.
    """
    order = np.argsort(-np.asarray(weights, np.float64), kind="stable")
    falling = np.append(np.asarray(weights, np.float64)[order], 0.0)
    parts = np.arange(1, len(order) + 1) * (falling[:-1] - falling[1:]) / falling.sum()
    taken = [np.zeros_like(one) for one in strong]
    total = np.zeros_like(strong[0])
    for count, part in enumerate(parts, 1):
        total += strong[order[count - 1]]
        if part > 0:
            for place in order[:count]:
                taken[place] += np.float32(part) * strong[place] / total
    return taken


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
