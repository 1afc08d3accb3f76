"""Faces as loadings in SD: at random, from the training faces' normal distribution, or along one component (ours)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.model.model import MorphModel

LEAST_SHARE = 0.01  # of the spread: a cut-off below it would have most numbers drawn hundreds of times


def drawn_sd(
    rng: np.random.Generator, count: int, rank: int, *, spread: float, max_sd: float | None
) -> tuple[LoadingTable, int]:
    """Draw loadings (count, rank) in SD, and tell how many numbers were drawn again because they lay beyond `max_sd`.

    The components are independent: to draw one loading again is the same as to reject the face for it and draw faces
    until one passes. Raises `BadInput` for a `max_sd` that next to nothing would pass.
    """
    values = rng.standard_normal((count, rank)) * spread
    if max_sd is None:
        return values, 0
    if not max_sd > LEAST_SHARE * spread:
        raise BadInput(
            f"next to no face lies within {max_sd:g} SD where the spread is {spread:g}: raise --max-sd above "
            f"{LEAST_SHARE * spread:g}, or lower the spread"
        )
    again = 0
    while True:
        beyond = np.abs(values) > max_sd
        found = int(beyond.sum())
        if not found:
            return values, again
        again += found
        values[beyond] = rng.standard_normal(found) * spread


def along(model: MorphModel, component: int, amounts_sd: AnyArray) -> LoadingTable:
    """Give the loadings (n, k) SD at these amounts along one component, all others at 0."""
    table = np.zeros((len(amounts_sd), model.rank))
    table[:, component] = amounts_sd
    return table
