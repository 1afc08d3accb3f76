"""Dynamic time warping: which frame of an imitation goes with which of the stimulus, and what is left between them.

Sakoe and Chiba (Dynamic programming algorithm optimization for spoken word recognition, IEEE ASSP 26, 1978), with
steps of one frame in either sequence or in both, each counted once, and their band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from morphspace.arrays import AnyArray, LoadingTable

BAND = 0.25  # of the longer sequence: how far alignment may move a frame
BOTH, FIRST, SECOND = (
    0,
    1,
    2,
)  # which sequence a step of the path goes on in; equal costs take the first named


@dataclass(frozen=True, eq=False)
class Alignment:
    """A path through two sequences: frame `path[s, 0]` of the first goes with `path[s, 1]` of the second, (steps, 2).

    `cost` is the sum of the distances between them along the path.
    """

    path: AnyArray
    cost: float

    @property
    def straight(self) -> AnyArray:
        """Where the second sequence would be at each step if both ran evenly, (steps,) frames."""
        last = self.path[-1]
        return np.asarray(self.path[:, 0] * (last[1] / max(int(last[0]), 1)))

    @property
    def timing_rms_frames(self) -> float:
        """How far the path lies from the straight one, root mean square, frames of the second sequence."""
        return float(np.sqrt(np.mean((self.path[:, 1] - self.straight) ** 2)))

    @property
    def delay_frames(self) -> float:
        """How much later than the straight path the second sequence is on average, frames."""
        return float(np.mean(self.path[:, 1] - self.straight))


def align(one: LoadingTable, other: LoadingTable, *, band: float = BAND) -> Alignment:
    """Find the cheapest path through two sequences (n, k), (m, k), from both first frames to both last.

    The cost of a pair of frames is their Euclidean distance. `band` is the farthest a frame may be moved, as a share
    of the longer sequence. To compare shapes give sequences that are `standardised`.
    """
    return cheapest_path(distances(one, other), band=band)


def cheapest_path(costs: AnyArray, *, band: float = BAND) -> Alignment:
    """Find the path from the first to the last pair of frames whose costs (n, m) sum to the least, within the band."""
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
    """Give the distance of each row of one from each of the other, (n, m); equal rows give exactly 0."""
    return np.asarray(cdist(one, other))
