"""Chance: surrogates of an imitation that keep its dynamics but not its relation to the stimulus, and the p values.

Circular shifts suit measures of paired frames: they keep everything except the time of events. They do not suit
searches over lags or alignments, because the search reverses the shift and each shift of a late copy matches
perfectly. Searches are compared with two other kinds of surrogates, and the larger p counts, because each is too
lenient where the other is not. Random phases (Theiler et al., Testing for nonlinearity in time series, Physica D 58,
1992), equal in all components to keep their covariance (Prichard and Theiler, Physical Review Letters 73, 1994), keep
the spectra and suit continuous motion; a few single events become noise, which is easily exceeded. Pieces in random
order keep events and suit them; they interrupt smooth motion at the joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.imitation.shape import centred

COSTLY = 199  # surrogates, at most, for mutual information and alignment; the smallest p is then 0.005
PIECES = 5  # pieces of a motion that are put into another order
TIE_TOL = 1e-9  # relative; rounding of equal scores
CHUNK_NUMBERS = 1_000_000  # numbers in memory at a time


@dataclass(frozen=True, eq=False)
class Baseline:
    """The surrogates of the imitation that estimate chance.

    Attributes
    ----------
    shifts : array (s,) int, frames
        Circular shifts.
    costly : array (c,) int, frames
        The shifts used for mutual information.
    is_exhaustive : bool
        Whether `shifts` are all possible shifts.
    copies : int
        Surrogates of each other kind for the best lag.
    costly_copies : int
        The first of them, used for alignment.
    seed : int
    """

    shifts: AnyArray
    costly: AnyArray
    is_exhaustive: bool
    copies: int
    costly_copies: int
    seed: int

    @property
    def least(self) -> dict[str, float]:
        """The smallest possible p: of measures of paired frames, of information, of lag and of alignment."""
        counts = {
            "frame_by_frame": len(self.shifts),
            "information": len(self.costly),
            "lag": self.copies,
            "alignment": self.costly_copies,
        }
        return {name: 1 / (1 + count) for name, count in counts.items()}


def baseline_of(frames: int, permutations: int, seed: int) -> Baseline:
    """Choose the surrogates of an imitation of `frames` frames: at most `permutations` of each kind, by the seed.

    All circular shifts, 1 to frames - 1, are used if there are no more.

    Examples
    --------
    >>> chosen = baseline_of(5, 100, seed=1)
    >>> chosen.shifts.tolist(), chosen.copies
    ([1, 2, 3, 4], 100)
    """
    every = np.arange(1, frames)
    rng = np.random.default_rng(seed)
    shifts = every
    if len(every) > permutations:
        shifts = np.sort(rng.choice(every, permutations, replace=False))
    costly = shifts
    if len(shifts) > COSTLY:
        costly = np.sort(rng.choice(shifts, COSTLY, replace=False))
    return Baseline(shifts, costly, len(shifts) == len(every), permutations, min(permutations, COSTLY), seed)


def turned(sequence: LoadingTable, shifts: AnyArray) -> Iterator[AnyArray]:
    """Yield the sequence (m, k) shifted circularly by each shift, in chunks (c, m, k).

    Examples
    --------
    >>> import numpy as np
    >>> next(turned(np.array([[1.0], [2.0], [3.0]]), np.array([1])))[0].tolist()
    [[3.0], [1.0], [2.0]]
    """
    some = _at_a_time(sequence)
    places = np.arange(len(sequence))
    for start in range(0, len(shifts), some):
        yield sequence[(places - shifts[start : start + some, None]) % len(sequence)]


def of_random_phases(sequence: LoadingTable, count: int, seed: int) -> Iterator[AnyArray]:
    """Yield surrogates of the sequence (m, k) with random phases, in chunks (c, m, k).

    The sequence is extended by its reverse before the Fourier transform, and a surrogate is the first half of the
    inverse transform. Otherwise the jump from the last to the first frame adds high frequencies to the surrogates,
    and smooth motions appear significant: 26 % of p below .05 for independent motions of 24 frames smoothed by 4,
    against 10 % with the extension; for 60 frames 12 and 6 %. A constant column is unchanged.

    References
    ----------
    Theiler et al., Physica D 58, 1992; Prichard and Theiler, Physical Review Letters 73, 1994 (equal phases in all
    components); the extension is ours.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.sin(np.arange(20.0))[:, None]
    >>> (copies,) = of_random_phases(motion, 3, seed=1)
    >>> copies.shape
    (3, 20, 1)
    """
    rng = np.random.default_rng([seed, 1])  # independent of the shifts
    moving = centred(sequence)
    spectrum = np.fft.rfft(np.concatenate([moving, moving[::-1]]), axis=0)
    means = sequence - moving
    some = _at_a_time(spectrum)
    for start in range(0, count, some):
        angles = rng.uniform(0, 2 * np.pi, (min(some, count - start), len(spectrum), 1))
        mixed = np.fft.irfft(spectrum * np.exp(1j * angles), 2 * len(sequence), axis=1)
        yield mixed[:, : len(sequence)] + means


def in_pieces(sequence: LoadingTable, count: int, seed: int) -> Iterator[AnyArray]:
    """Yield surrogates of the sequence (m, k) that is cut into `PIECES` at random places, in chunks (c, m, k).

    Each surrogate is first shifted circularly. Its pieces are joined in random order, each forwards or backwards.

    Examples
    --------
    >>> import numpy as np
    >>> (copies,) = in_pieces(np.arange(10.0)[:, None], 1, seed=1)
    >>> sorted(copies[0, :, 0].tolist()) == list(range(10))
    True
    """
    rng = np.random.default_rng([seed, 2])
    frames = len(sequence)
    pieces = min(PIECES, 1 + (frames - 3) // 2)
    some = _at_a_time(sequence)
    for start in range(0, count, some):
        orders = []
        for _ in range(min(some, count - start)):
            order = np.roll(np.arange(frames), rng.integers(frames))
            cuts = np.sort(rng.choice(np.arange(2, frames - 1), pieces - 1, replace=False))
            parts = np.split(order, cuts)
            steps = rng.choice([-1, 1], pieces)
            orders.append(
                np.concatenate([parts[place][:: steps[place]] for place in rng.permutation(pieces)])
            )
        yield sequence[np.array(orders)]


def _at_a_time(values: AnyArray) -> int:
    """Return the number of surrogates per chunk."""

    return max(1, CHUNK_NUMBERS // max(values.size, 1))


def p_values(observed: AnyArray, null: AnyArray, smaller_is_closer: bool | np.bool_ = False) -> AnyArray:
    """Return (1 + count) / (1 + copies), where count surrogates (copies, ...) are at least as close as observed (...).

    p is never 0. NaN if there is nothing to compare.

    References
    ----------
    Phipson and Smyth, Permutation p-values should never be zero, 2010.

    Examples
    --------
    >>> import numpy as np
    >>> p_values(np.array([0.9]), np.array([[0.1], [0.95], [0.2]])).tolist()
    [0.5]
    """
    sign = -1.0 if smaller_is_closer else 1.0
    known = np.isfinite(null)
    slack = TIE_TOL * (1 + np.abs(observed))
    with np.errstate(invalid="ignore"):
        reached = (sign * null >= sign * observed - slack) & known
    p = (1 + reached.sum(axis=0)) / (1 + known.sum(axis=0))
    return np.where(np.isfinite(observed) & known.any(axis=0), p, np.nan)


def familywise(observed: AnyArray, null: AnyArray) -> AnyArray:
    """Return p (k + 1,) corrected for testing all components: compared with the best component of each surrogate.

    The last entry, of all components together, is a single test and NaN here.

    References
    ----------
    Westfall and Young, Resampling-based multiple testing, 1993: single step.

    Examples
    --------
    >>> import numpy as np
    >>> familywise(np.array([0.9, 0.2, 0.9]), np.array([[0.1, 0.5, 0.4], [0.3, 0.1, 0.2]])).round(2).tolist()
    [0.33, 1.0, nan]
    """
    known = np.isfinite(null[:, :-1])
    best = np.where(known, null[:, :-1], -np.inf).max(axis=1, initial=-np.inf)
    best = np.where(np.isfinite(best), best, np.nan)
    return np.append(p_values(observed[:-1], np.repeat(best[:, None], len(observed) - 1, axis=1)), np.nan)
