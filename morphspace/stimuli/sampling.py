"""Sample faces as loadings in SD: from the normal distribution of the training faces, or along one component (ours)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.model.model import MorphModel

LEAST_SHARE = 0.01  # of the spread; a lower limit would resample most values hundreds of times


def drawn_sd(
    rng: np.random.Generator, count: int, rank: int, *, spread: float, max_sd: float | None
) -> tuple[LoadingTable, int]:
    """Sample loadings from a normal distribution, truncated at `max_sd`.

    The components are independent. Resampling one loading is therefore equivalent to rejecting the whole face.

    Parameters
    ----------
    rng : numpy.random.Generator
    count, rank : int
    spread : float, SD
        The standard deviation.
    max_sd : float, SD, or None
        The largest absolute value.

    Returns
    -------
    array (count, rank), SD
    int
        The number of values that were sampled again.

    Raises
    ------
    BadInput
        If `max_sd` is so small that nearly all values would be sampled again.

    References
    ----------
    Nagle et al., section 2 (faces of a realistic distribution); the bound is ours.

    Examples
    --------
    >>> import numpy as np
    >>> loadings, resampled = drawn_sd(np.random.default_rng(1), 4, 2, spread=1.0, max_sd=2.5)
    >>> loadings.shape, bool(np.abs(loadings).max() <= 2.5), resampled
    ((4, 2), True, 0)
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
    """Return loadings (n, k) SD with these amounts along one component (from 0) and 0 in all others.

    Examples
    --------
    >>> import numpy as np
    >>> import morphspace as ms
    >>> along(ms.load("anna.morph"), 1, np.array([-2.0, 2.0])).tolist()
    [[0.0, -2.0, 0.0], [0.0, 2.0, 0.0]]
    """
    table = np.zeros((len(amounts_sd), model.rank))
    table[:, component] = amounts_sd
    return table
