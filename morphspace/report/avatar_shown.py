"""What the page of a blend is given, and the plain figures that follow from it. Ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.model.model import MorphModel
from morphspace.report.avatar_distances import MeanDistances
from morphspace.steps import spread

SHEET_ROWS = 24  # at most; the work folder has all
LEAST_SHARE_OF_SHEET = 0.25  # of its rows are kept for expressions that leave most out
FULL_PART = 0.75  # of the part its weight gives it: with less, a version counts as given less weight


@dataclass(frozen=True, eq=False)
class ExpressionRow:
    """One row of the contact sheet: pictures (h, w, 3) of expression number `index`.

    `versions` one for each identity, aligned, as they were blended | `blend` | `pixel_average` of the same versions
    with the same weights, without any warp.
    """

    index: int
    versions: Sequence[Image]
    blend: Image
    pixel_average: Image


@dataclass(frozen=True, eq=False)
class AvatarShown:
    """What the page shows, of a blend of k identities and n expressions.

    `model` the avatar | `identities` k names | `asked` (k,) weights asked for, sum 1 | `sources` (n,) whose each
    expression is, and `frames` (n,) the name of the training frame there, in the order of the model's training rows |
    `used` (n, k) weights of the versions' expressions, 0 where a version was left out | `plausibility` (n, k) 0 to 1
    | `rows` of the contact sheet | `sharpness` variance of the Laplacian inside the mask, of "sources" (k,), "blend",
    "pixel average" and, where known, "pictures" and "unsharpened" | `sharpen` the amount used | `surround` whose hair,
    neck and background it has | `distances` between the mean faces, None where unknown | `notes` to read first |
    `settings` name to value.
    """

    model: MorphModel
    identities: tuple[str, ...]
    asked: AnyArray
    sources: Sequence[int]
    frames: Sequence[str]
    used: AnyArray
    plausibility: AnyArray
    rows: Sequence[ExpressionRow]
    sharpness: Mapping[str, Any]
    sharpen: float
    surround: str
    distances: MeanDistances | None
    notes: Sequence[str]
    settings: Mapping[str, str]


def rows_shown(used: AnyArray, asked: AnyArray, at_most: int = SHEET_ROWS) -> list[int]:
    """Give which of n expressions the contact sheet shows, in order: spread evenly, and those that leave most out.

    `used` (n, k) and `asked` (k,) weights, as in `AvatarShown`. Ours.
    """
    count = len(used)
    if count <= at_most:
        return list(range(count))
    missing = (1 - parts_taken(used, asked)).sum(axis=1)
    kept = max(1, round(at_most * LEAST_SHARE_OF_SHEET))
    worst = [int(index) for index in np.argsort(-missing, kind="stable")[:kept] if missing[index] > 0]
    others = [index for index in range(count) if index not in worst]
    evenly = [others[place] for place in spread(len(others), at_most - len(worst))]
    return sorted({*worst, *evenly})


def parts_taken(used: AnyArray, asked: AnyArray) -> AnyArray:
    """Give which part of its weight each version kept, (n, k) from 0, left out, to 1; weights asked 0 count as kept.

    Weights are shares of one, so where a version is left out the others' grow. The one that kept most counts as 1.
    """
    takes_part = asked > 0
    kept = np.where(takes_part, used / np.where(takes_part, asked, 1), 0.0)
    most = np.maximum(kept.max(axis=1, keepdims=True), np.finfo(float).tiny)
    return np.where(takes_part, kept / most, 1.0)


def source_sharpness(shown: AvatarShown) -> float:
    """Give the mean sharpness of the sources, by the weights asked for."""
    return float(np.asarray(shown.sharpness["sources"], np.float64) @ np.asarray(shown.asked, np.float64))


def sharp_shares(shown: AvatarShown) -> dict[str, float]:
    """Give the sharpness of what was made as a share of the sources' weighted mean, NaN where that is 0."""
    mean = source_sharpness(shown)
    return {
        name: float(value) / mean if mean > 0 else float("nan")
        for name, value in shown.sharpness.items()
        if name != "sources" and value is not None
    }


def told_apart(loadings: AnyArray, sources: Sequence[int]) -> AnyArray:
    """Give which share of each component's variance (k,) lies between the sources: the correlation ratio, 0 to 1.

    `loadings` (n, k), `sources` (n,) whose each row is. It is the between-groups sum of squares over the total
    (Pearson's eta squared): near 0 a component shows expression alone, near 1 it tells whose expression it was.
    """
    owners = np.asarray(sources)
    centred = loadings - loadings.mean(axis=0)
    total = (centred**2).sum(axis=0)
    between = np.zeros(loadings.shape[1])
    for source in np.unique(owners):
        rows = centred[owners == source]
        between += len(rows) * rows.mean(axis=0) ** 2
    return np.where(total > 0, between / np.maximum(total, np.finfo(float).tiny), 0.0)
