"""Caricature: loadings times a gain (Nagle section 5; Benson and Perrett 1991 for the idea).

1 is veridical, above 1 a caricature, between 0 and 1 an anti-caricature, 0 the mean face, below 0 an anti-face.
"""

from __future__ import annotations

import re

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput

SPAN = re.compile(r"([0-9]{1,5})(?:-([0-9]{1,5}))?")


def components_named(words: str, rank: int) -> tuple[int, ...]:
    """Give the places (from 0) of components written as `1-5,8`. Raises `BadInput` where one is not in the model."""
    places: set[int] = set()
    for part in words.split(","):
        found = SPAN.fullmatch(part.strip())
        if found is None:
            raise BadInput(f"components {words!r} cannot be read: write numbers and spans, such as 1-5,8")
        first = int(found.group(1))
        last = int(found.group(2) or first)
        if not 1 <= first <= last <= rank:
            raise BadInput(f"components {part.strip()!r} do not fit a model with components 1 to {rank}")
        places.update(range(first - 1, last))
    return tuple(sorted(places))


def caricatured(
    loadings_sd: LoadingTable, gain: float, components: tuple[int, ...] | None = None
) -> LoadingTable:
    """Give loadings (n, k) times the gain; only in these components (from 0) where some are named."""
    if not np.isfinite(gain):
        raise BadInput(f"a gain of {gain} cannot be used: give a number, 1 for the faces as they are")
    factors: AnyArray = np.ones(loadings_sd.shape[1])
    factors[slice(None) if components is None else list(components)] = gain
    return np.asarray(loadings_sd * factors, np.float64)
