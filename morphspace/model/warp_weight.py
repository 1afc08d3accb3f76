"""How much a pixel of warp counts against a unit of colour: chosen by how well held-out frames come back (ours).

Texture and warp have different units, so their sum in one inner product needs a weight s (colour per px). Too small,
and the components follow the light; too large, and they follow the noise of the flow. The Gram matrix for any s is
G_texture + s^2 G_warp, so trying several costs little.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.linear.pca import combine_rows, gram_matrix, principal_axes
from morphspace.linear.quality import psnr_db
from morphspace.linear.rows import ColumnBlocks, RowSubset
from morphspace.model.morph import Morph, texture_columns
from morphspace.steps import in_order

FACTORS = (1.0, 2.0, 4.0)  # times the weight that gives texture and warp equal variance
HELD_OUT = 8  # frames at most
LARGEST_SHARE = 0.5  # of the training frames, as components: near full rank every weight gives the same
TRIED_FRAMES = 192  # so that their Gram matrices do not grow with the clip
MIN_FRAMES = 4  # to leave one out
STILL_PX2 = 1e-8  # mean square warp below which nothing moves, and any weight is as good
STILL_COLOUR2 = 1e-12  # the same for texture


@dataclass(frozen=True)
class WeightTrial:
    """A warp weight (colour per px) and the mean PSNR (dB) of held-out frames with it."""

    weight: float
    psnr_db: float


def best_trial(trials: tuple[WeightTrial, ...]) -> float:
    """Give the weight with the highest PSNR; 1 where nothing moved and nothing was tried."""
    return max(trials, key=lambda trial: trial.psnr_db).weight if trials else 1.0


def trial_weights(
    rows: ColumnBlocks,
    mean: AnyArray,
    mask: Mask,
    components: int,
    frames: list[Path],
    load: Callable[[Path], Image],
) -> tuple[WeightTrial, ...]:
    """Try `FACTORS`: project held-out frames on components of the others, render, compare inside the mask.

    Parameters: rows (n, 5 h w) morph vectors and their mean (5 h w,); mask (h, w); components asked for; frames and
    `load` give the aligned image of each row. At most `TRIED_FRAMES` rows, evenly spread, take part.
    """
    chosen = np.unique(np.linspace(0, rows.shape[0] - 1, min(rows.shape[0], TRIED_FRAMES)).round()).astype(
        np.intp
    )
    n, colours = len(chosen), texture_columns(mask.shape).stop
    if n < MIN_FRAMES:
        return ()
    some = RowSubset(rows, chosen)
    unit = np.concatenate([np.repeat(mask.reshape(-1), 3), np.repeat(mask.reshape(-1), 2)])
    texture_gram = gram_matrix(some, mean, unit, 0, colours)
    warp_gram = gram_matrix(some, mean, unit, colours, rows.shape[1])
    if min(np.trace(texture_gram) / STILL_COLOUR2, np.trace(warp_gram) / STILL_PX2) <= n * float(mask.sum()):
        return ()
    balanced = float(np.sqrt(np.trace(texture_gram) / np.trace(warp_gram)))
    held = np.arange(n // (2 * min(HELD_OUT, n // 3)), n, max(3, n // HELD_OUT))[:HELD_OUT]
    kept = np.setdiff1d(np.arange(n), held)
    k = max(1, min(components, int(LARGEST_SHARE * len(kept))))
    mixes = [_mixes(texture_gram + (factor * balanced) ** 2 * warp_gram, held, kept, k) for factor in FACTORS]
    vectors = np.empty((len(FACTORS) * len(held), rows.shape[1]), np.float32)
    nothing = np.zeros(rows.shape[1], np.float32)
    combine_rows(RowSubset(rows, chosen[kept]), np.concatenate(mixes), nothing, vectors)
    images = [load(frames[chosen[index]]) for index in held]

    def score(number: int) -> float:
        face = Morph(vectors[number], mask.shape, "held out")
        return psnr_db(face.render(), images[number % len(held)], mask)

    scores = np.reshape(list(in_order(score, range(len(vectors)))), (len(FACTORS), len(held)))
    trials = [
        WeightTrial(factor * balanced, float(row.mean())) for factor, row in zip(FACTORS, scores, strict=True)
    ]
    return tuple(trials)


def _mixes(gram: AnyArray, held: AnyArray, kept: AnyArray, components: int) -> AnyArray:
    """Give each held-out face's reconstruction as weights on the kept rows, (held, kept), rows adding up to 1.

    All inner products are moved from the mean of all rows to the mean of the kept ones first.
    """
    to_mean = gram[:, kept].mean(axis=1)
    about_kept = gram - to_mean[:, None] - to_mean[None, :] + to_mean[kept].mean()
    inner = about_kept[np.ix_(kept, kept)]
    coefficients, _ = principal_axes(inner, components, float(np.trace(inner)))
    loadings = about_kept[np.ix_(held, kept)] @ coefficients.T
    weights = loadings @ coefficients
    out: AnyArray = weights + (1 - weights.sum(axis=1, keepdims=True)) / len(kept)
    return out
