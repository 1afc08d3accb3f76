"""Dynamic time warping: align the frames of an imitation with those of the stimulus.

Sakoe and Chiba (Dynamic programming algorithm optimization for spoken word recognition, IEEE ASSP 26, 1978), with
their band; a step advances one sequence or both by one frame, and all steps have weight 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from morphspace.arrays import AnyArray, LoadingTable

BAND = 0.25  # of the longer sequence; the largest shift of a frame
# The sequence that a step advances; ties take the first of these
BOTH, FIRST, SECOND = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Alignment:
    """A path through two sequences.

    Attributes
    ----------
    path : array (steps, 2) int
        Frame `path[s, 0]` of the first sequence is aligned with frame `path[s, 1]` of the second.
    cost : float
        The sum of their distances along the path.
    """

    path: AnyArray
    cost: float

    @property
    def straight(self) -> AnyArray:
        """The frame of the second sequence at each step if both ran evenly, (steps,)."""
        last = self.path[-1]
        return np.asarray(self.path[:, 0] * (last[1] / max(int(last[0]), 1)))

    @property
    def timing_rms_frames(self) -> float:
        """The rms deviation of the path from the straight one, in frames of the second sequence."""
        return float(np.sqrt(np.mean((self.path[:, 1] - self.straight) ** 2)))

    @property
    def delay_frames(self) -> float:
        """The mean delay of the second sequence relative to the straight path, frames."""
        return float(np.mean(self.path[:, 1] - self.straight))


def align(one: LoadingTable, other: LoadingTable, *, band: float = BAND) -> Alignment:
    """Find the path of least cost through two sequences (n, k), (m, k), from the first frames to the last.

    The cost of a pair of frames is their Euclidean distance. `band` is the largest shift of a frame, as a share of
    the longer sequence. Apply `standardised` first to compare shapes only.

    References
    ----------
    Sakoe and Chiba, IEEE ASSP 26, 1978.

    Examples
    --------
    >>> import numpy as np
    >>> found = align(np.array([[0.0], [1], [2]]), np.array([[0.0], [0], [1], [2]]))
    >>> found.path.tolist(), found.cost
    ([[0, 0], [0, 1], [1, 2], [2, 3]], 0.0)
    """
    return cheapest_path(distances(one, other), band=band)


def cheapest_path(costs: AnyArray, *, band: float = BAND) -> Alignment:
    """Find the path from the first to the last pair of frames with the least sum of costs (n, m), within the band.

    References
    ----------
    Sakoe and Chiba, IEEE ASSP 26, 1978.

    Examples
    --------
    >>> import numpy as np
    >>> found = cheapest_path(np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]))
    >>> found.path.tolist(), found.cost
    ([[0, 0], [0, 1], [1, 2]], 0.0)
    """
    n, m = costs.shape
    slope = (m - 1) / max(n - 1, 1)
    reach = max(band * max(n, m), 1.0 + slope)
    far = np.abs(np.arange(m) - np.arange(n)[:, None] * slope) > reach
    flat = np.where(far, np.inf, costs).reshape(-1)
    moves: list[tuple[int, AnyArray]] = []
    before = np.full(n + 1, np.inf)  # totals of the diagonal before, by row + 1; row 0 lies outside
    earlier = np.full(n + 1, np.inf)
    earlier[0] = 0.0  # where the path comes from
    for diagonal in range(n + m - 1):
        low, high = max(0, diagonal - m + 1), min(n - 1, diagonal)
        both, first, second = earlier[low : high + 1], before[low : high + 1], before[low + 1 : high + 2]
        least = np.minimum(np.minimum(both, first), second)
        moves.append((low, np.where(both <= least, BOTH, np.where(first <= least, FIRST, SECOND))))
        rows = np.arange(low, high + 1)
        earlier, before = before, np.full(n + 1, np.inf)
        before[low + 1 : high + 2] = flat[rows * (m - 1) + diagonal] + least
    path = [(n - 1, m - 1)]
    while path[-1] != (0, 0):
        row, column = path[-1]
        low, move = moves[row + column]
        step = int(move[row - low])
        path.append((row - (step != SECOND), column - (step != FIRST)))
    return Alignment(np.array(path[::-1]), float(before[n]))


def distances(one: LoadingTable, other: LoadingTable) -> AnyArray:
    """Return the distance of each row of one from each of the other, (n, m); exactly 0 for equal rows.

    Examples
    --------
    >>> import numpy as np
    >>> distances(np.array([[0.0, 0.0]]), np.array([[3.0, 4.0], [0.0, 0.0]])).tolist()
    [[5.0, 0.0]]
    """
    return np.asarray(cdist(one, other))
