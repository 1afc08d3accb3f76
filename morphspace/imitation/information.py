"""Mutual information of two motions, and the entropy of each (Nagle section 5.1)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import digamma

from morphspace.arrays import AnyArray
from morphspace.imitation.shape import varies

NEIGHBOURS = 3  # of the estimate of mutual information; Kraskov et al. advise 2 to 4
STRICTLY = 1e-10  # relative; excludes the last neighbour, which lies exactly at the distance
LEAST_FRAMES_INFORMATION = 8  # frames; with fewer, bias dominates the estimates


def mutual_information(x: AnyArray, y: AnyArray, neighbours: int = NEIGHBOURS) -> float:
    """Estimate the mutual information (nats, >= 0) of paired values x, y (n,); NaN if it is undefined.

    It is undefined if a variable is constant or n is too small. Each variable is scaled to SD 1. The estimate is
    psi(neighbours) + psi(n) - mean(psi(n_x + 1) + psi(n_y + 1)). Successive frames of a motion are not independent
    samples, which biases it upwards: compare it with chance.

    References
    ----------
    Kraskov, Stögbauer and Grassberger, Estimating mutual information, Physical Review E 69, 2004, equation 8.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 1, 50)
    >>> mutual_information(x, x) > 1
    True
    """
    n = len(x)
    if n < max(LEAST_FRAMES_INFORMATION, neighbours + 2) or not varies(np.column_stack([x, y])).all():
        return float("nan")
    pairs = np.column_stack([x, y])
    pairs = (pairs - pairs.mean(axis=0)) / pairs.std(axis=0)
    distances, _ = cKDTree(pairs).query(pairs, k=neighbours + 1, p=np.inf)
    inside = (1 - STRICTLY) * distances[:, -1]
    total = float(digamma(neighbours) + digamma(n))
    for values in pairs.T:
        ordered = np.sort(values)
        count = np.searchsorted(ordered, values + inside, "right")
        count -= np.searchsorted(ordered, values - inside, "left")
        total -= float(digamma(np.maximum(count, 1)).mean())  # the frame itself is counted: n_x + 1
    return max(0.0, total)


def entropy(x: AnyArray) -> float:
    """Estimate the differential Shannon entropy (nats) of values x (n,) with SciPy's Ebrahimi estimator.

    It uses the gaps between sorted values and needs no bins. NaN if x is constant, has many equal values or is too
    short.

    References
    ----------
    Ebrahimi, Pflughoeft and Soofi, Two measures of sample entropy, Statistics and Probability Letters 20, 1994.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(1).normal(size=200)
    >>> bool(abs(entropy(2 * x) - entropy(x) - np.log(2)) < 1e-9)
    True
    """
    from scipy.stats import differential_entropy  # here, because it is slow to import

    if len(x) < LEAST_FRAMES_INFORMATION or not varies(x[:, None]).all():
        return float("nan")
    with np.errstate(divide="ignore"):
        found = float(differential_entropy(x, method="ebrahimi"))
    return found if np.isfinite(found) else float("nan")
