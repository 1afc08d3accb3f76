"""Faces at random, as loadings in SD: the normal distribution of the training faces, whole or cut off (ours)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import LoadingTable
from morphspace.errors import BadInput

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
