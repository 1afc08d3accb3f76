"""What two motions tell of each other, and how rich each is: mutual information and entropy (Nagle section 5.1)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import digamma

from morphspace.arrays import AnyArray
from morphspace.imitation.shape import varies

NEIGHBOURS = 3  # of the estimate of mutual information; Kraskov et al. advise 2 to 4
STRICTLY = 1e-10  # relative; the last neighbour lies at the very distance and is not to be counted
LEAST_FRAMES_INFORMATION = 8  # below it the estimates are of little but their own bias


def mutual_information(x: AnyArray, y: AnyArray, neighbours: int = NEIGHBOURS) -> float:
    """Give the mutual information (nats, >= 0) of paired values x, y (n,); NaN where one is constant or n too small.

    The first estimator of Kraskov, Stögbauer and Grassberger (Estimating mutual information, Physical Review E 69,
    2004, equation 8): psi(neighbours) + psi(n) - mean(psi(n_x + 1) + psi(n_y + 1)), each variable scaled to SD 1.
    Frames of a motion follow one another and are not independent draws, which biases it upwards: compare with chance.
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
    """Give the differential Shannon entropy (nats) of values x (n,) by Ebrahimi's estimator, as SciPy computes it.

    Ebrahimi, Pflughoeft and Soofi (Statistics and Probability Letters 20, 1994), from the gaps between sorted values;
    unlike a histogram's it needs no bins. NaN where x is constant, has long runs of equal values, or is too short.
    """
    from scipy.stats import differential_entropy  # here, because it is slow to import

    if len(x) < LEAST_FRAMES_INFORMATION or not varies(x[:, None]).all():
        return float("nan")
    with np.errstate(divide="ignore"):
        found = float(differential_entropy(x, method="ebrahimi"))
    return found if np.isfinite(found) else float("nan")
