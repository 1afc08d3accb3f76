"""The weight of a px of warp against a unit of colour, chosen by cross-validation on held-out frames (ours).

Texture and warp have different units, so one inner product of both needs a weight s (colour per px). With a small s
the components follow the light, with a large s the noise of the flow. The Gram matrix for any s is
K_texture + s^2 K_warp, so several values cost little more than one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.linear.pca import combine_rows, gram_matrix, principal_axes
from morphspace.linear.quality import psnr_db
from morphspace.linear.rows import ColumnBlocks, RowSubset
from morphspace.model.morph import Morph, texture_columns
from morphspace.steps import in_order

FACTORS = (1.0, 2.0, 4.0)  # times the weight at which texture and warp have equal variance
HELD_OUT = 8  # frames at most, evenly spread
LARGEST_SHARE = 0.5  # components per kept frame; near full rank every weight gives the same PSNR
TRIED_FRAMES = 192  # frames at most; the Gram matrices then do not grow with the clip
MIN_FRAMES = 4  # frames, of which one is held out
STILL_PX2 = 1e-8  # px^2, mean square warp; below it nothing moves and every weight is equal
STILL_COLOUR2 = 1e-12  # colour^2, the same for texture


@dataclass(frozen=True)
class WeightTrial:
    """A warp weight (colour per px) and the mean PSNR (dB) of held-out frames with it."""

    weight: float
    psnr_db: float


def best_trial(trials: tuple[WeightTrial, ...]) -> float:
    """Return the weight with the highest PSNR, or 1 if there are no trials because nothing moved."""
    return max(trials, key=lambda trial: trial.psnr_db).weight if trials else 1.0


def trial_weights(
    rows: ColumnBlocks,
    mean: AnyArray,
    mask: Mask,
    components: int,
    frames: list[Path],
    load: Callable[[Path], Image],
    weights: Sequence[float] = (),
) -> tuple[WeightTrial, ...]:
    """Cross-validate warp weights: those of `FACTORS`, or the given ones.

    Held-out frames are projected on components of the others, rendered, and compared with their pictures inside the
    mask. At most `TRIED_FRAMES` rows, evenly spread, take part.

    Parameters
    ----------
    rows : ColumnBlocks (n, 5 h w)
        Morph vectors.
    mean : array (5 h w,)
        Their mean.
    mask : array (h, w)
    components : int
        The largest number of components.
    frames, load
        The file of each row, and the function that reads its aligned picture (h, w, 3).
    weights : sequence of float, colour per px
        The weights to try; empty for the balanced one times `FACTORS`.

    Returns
    -------
    tuple of WeightTrial
        Empty if there are fewer than `MIN_FRAMES` frames, or texture or warp does not vary.

    References
    ----------
    Ours; Nagle et al., section 2, have no weight.
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
    tried = tuple(weights) or tuple(factor * balanced for factor in FACTORS)
    held = np.arange(n // (2 * min(HELD_OUT, n // 3)), n, max(3, n // HELD_OUT))[:HELD_OUT]
    kept = np.setdiff1d(np.arange(n), held)
    k = max(1, min(components, int(LARGEST_SHARE * len(kept))))
    mixes = [_mixes(texture_gram + weight**2 * warp_gram, held, kept, k) for weight in tried]
    vectors = np.empty((len(tried) * len(held), rows.shape[1]), np.float32)
    nothing = np.zeros(rows.shape[1], np.float32)
    combine_rows(RowSubset(rows, chosen[kept]), np.concatenate(mixes), nothing, vectors)
    images = [load(frames[chosen[index]]) for index in held]

    def score(number: int) -> float:
        face = Morph(vectors[number], mask.shape, "held out")
        return psnr_db(face.render(), images[number % len(held)], mask)

    scores = np.reshape(list(in_order(score, range(len(vectors)))), (len(tried), len(held)))
    return tuple(WeightTrial(weight, float(row.mean())) for weight, row in zip(tried, scores, strict=True))


def _mixes(gram: AnyArray, held: AnyArray, kept: AnyArray, components: int) -> AnyArray:
    """Compute the reconstruction of each held-out face as weights on the kept rows, (held, kept), with rows of sum 1.

    The inner products are centred on the mean of the kept rows first.
    """
    to_mean = gram[:, kept].mean(axis=1)
    about_kept = gram - to_mean[:, None] - to_mean[None, :] + to_mean[kept].mean()
    inner = about_kept[np.ix_(kept, kept)]
    coefficients, _ = principal_axes(inner, components, float(np.trace(inner)))
    loadings = about_kept[np.ix_(held, kept)] @ coefficients.T
    weights = loadings @ coefficients
    out: AnyArray = weights + (1 - weights.sum(axis=1, keepdims=True)) / len(kept)
    return out
