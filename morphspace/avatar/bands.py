"""Mix the textures of several people band by band, so that fine detail is not averaged (ours).

A mean of faces loses all detail that does not coincide to a pixel: pores, lashes, the rim of glasses. Only what is
coarser than `COARSE` is averaged. In the band below, a person who cannot show an expression does not count where the
expression changes the face. In the finest band, each pixel takes most from the person with the strongest detail
there. Suwajanakorn, Seitz and Kemelmacher-Shlizerman (ICCV 2015) weigh the levels of a Laplacian pyramid by their
strength in the same way.

Strength decides whose detail a pixel shows; the weights decide how much of it. With one product of both, glasses
would appear almost whole at a weight of .05, since the skin of the others has little detail to compete.
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
# Luma, 0 to 1: what an expression adds to the texture, from nothing to wholly another look
CHANGED = (0.02, 0.08)
LEAST_STRENGTH = 1e-6  # of a band's variance, luma 0 to 1: where nobody has detail all count alike
LEAST_SHARE = 1e-3  # of a face at a pixel; where nobody has more, no sum of shares is 0


@dataclass(frozen=True, eq=False)
class Shown:
    """One identity on the common grid.

    Attributes
    ----------
    texture : array (h, w, 3)
    share : array (h, w), 0 to 1
        How far the identity counts at each pixel.
    weight : float, 0 or more
    """

    texture: Image
    share: Mask
    weight: float = 1.0


def banded(mean: Image, shown: Sequence[Shown], usual: Sequence[float]) -> Image:
    """Mix textures by bands, (h, w, 3): the coarse part of `mean`, and the finer parts of the identities.

    Parameters
    ----------
    mean : array (h, w, 3)
    shown : sequence of Shown
        The identities; one of the weights must be above 0.
    usual : sequence of float
        The usual strength of each identity's finest detail, by which it is divided: a sharper camera does not count
        more.

    References
    ----------
    Suwajanakorn, Seitz and Kemelmacher-Shlizerman, ICCV 2015, section 5 (weighted bands); the weights are ours.
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
    """Return the share of each identity's finest detail, (h, w) each, with sum 1 at every pixel.

    Any weights are a sum of equal ones: of all people, of all but the lightest, down to the heaviest alone. Among
    equals, strength, `strong` (h, w) each, decides each pixel; the mixes of equals are added by their parts of the
    weights, as in a Choquet integral. With equal weights strength alone decides, and a weight near 0 has no effect.
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
    """Return the finest band of a texture (h, w, 3)."""
    return texture - _blurred(texture, FINE * texture.shape[1])


def strength(detail: Image) -> Mask:
    """Compute the local variance of a band's luma, (h, w)."""
    square: Mask = _blurred((detail @ LUMA) ** 2, AROUND * detail.shape[1])
    return np.maximum(square, 0)


def changed(added: Image) -> Mask:
    """Compute how strongly an expression's offset (h, w, 3) changes the texture, (h, w), 0 to 1."""
    low, high = CHANGED
    apart = _blurred(np.abs(added).max(axis=2), AROUND * added.shape[1])
    out: Mask = np.clip((apart - low) / (high - low), 0, 1).astype(np.float32)
    return out


def _blurred(image: AnyArray, sd_px: float) -> AnyArray:
    return cv2.GaussianBlur(image, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)
