"""What chance gives: copies of an imitation that keep how it moves and break its tie to the stimulus, and p from them.

Circular shifts suit what is measured frame by frame: they keep everything of a motion but when it happens. They cannot
stand for chance where lags or alignments are searched: the search undoes a shift, so that each shift of a late copy is
a perfect hit. There two other kinds are taken, and the larger p of the two counts, since each errs where the other does
not. Random phases (Theiler et al., Testing for nonlinearity in time series, Physica D 58, 1992), the same in all
components, so that they go on moving with each other as they did (Prichard and Theiler, Physical Review Letters 73,
1994), keep the spectra and are right for motion that goes on and on; a few single events they turn into noise, which is
easily outdone. Pieces in another order keep events and are right for them; smooth motion they break at the joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.imitation.shape import centred

COSTLY = 199  # copies at most for mutual information and for alignment; then p is at least 0.005
PIECES = 5
TIE_TOL = 1e-9  # of the value: equal scores of two copies differ by rounding
CHUNK_NUMBERS = 1_000_000  # of copies held at a time


@dataclass(frozen=True, eq=False)
class Baseline:
    """Which copies of the imitation stand for chance.

    `shifts` (frames) are the circular shifts, `costly` those of them for mutual information; `copies` is the number of
    copies of either kind for the best lag, `costly_copies` of those, the first, for alignment. `is_exhaustive` tells
    whether `shifts` are all there are.
    """

    shifts: AnyArray
    costly: AnyArray
    is_exhaustive: bool
    copies: int
    costly_copies: int
    seed: int

    @property
    def least(self) -> dict[str, float]:
        """The smallest p that can be: of what is measured frame by frame, of information, of lag and of alignment."""
        counts = {
            "frame_by_frame": len(self.shifts),
            "information": len(self.costly),
            "lag": self.copies,
            "alignment": self.costly_copies,
        }
        return {name: 1 / (1 + count) for name, count in counts.items()}


def baseline_of(frames: int, permutations: int, seed: int) -> Baseline:
    """Choose the copies of an imitation of so many frames: at most `permutations` of each kind, by the seed.

    Of circular shifts, 1 to frames - 1, all are taken where there are no more.
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
    """Give the sequence (m, k) turned by each shift, some at a time, (some, m, k)."""
    some = _at_a_time(sequence)
    places = np.arange(len(sequence))
    for start in range(0, len(shifts), some):
        yield sequence[(places - shifts[start : start + some, None]) % len(sequence)]


def of_random_phases(sequence: LoadingTable, count: int, seed: int) -> Iterator[AnyArray]:
    """Give copies of the sequence (m, k) of random phases, some at a time, (some, m, k).

    The sequence is followed by itself backwards before it is taken apart, and a copy is the first half of what is put
    together again. Otherwise the jump from its last frame to its first would be spread over the copies as roughness,
    and any smooth motion would seem to do better than chance (24 frames smoothed by 4: 26 % of p below .05 for
    independent motions, and 10 % with it; 60 frames 12 and 6 %). A column that does not move stays as it is.
    """
    rng = np.random.default_rng([seed, 1])  # other draws than the shifts'
    moving = centred(sequence)
    spectrum = np.fft.rfft(np.concatenate([moving, moving[::-1]]), axis=0)
    rest = sequence - moving
    some = _at_a_time(spectrum)
    for start in range(0, count, some):
        angles = rng.uniform(0, 2 * np.pi, (min(some, count - start), len(spectrum), 1))
        mixed = np.fft.irfft(spectrum * np.exp(1j * angles), 2 * len(sequence), axis=1)
        yield mixed[:, : len(sequence)] + rest


def in_pieces(sequence: LoadingTable, count: int, seed: int) -> Iterator[AnyArray]:
    """Give copies of the sequence (m, k) cut in `PIECES` at random places, some at a time, (some, m, k).

    Each copy is turned first; its pieces are put together in random order, each forwards or backwards.
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
    return max(1, CHUNK_NUMBERS // max(values.size, 1))


def p_values(observed: AnyArray, null: AnyArray, smaller_is_closer: bool | np.bool_ = False) -> AnyArray:
    """Give how often chance (copies, ...) is as close as observed (...) or closer, itself counted in.

    (1 + count) / (1 + copies): never 0 (Phipson and Smyth 2010). NaN where there is nothing to compare.
    """
    sign = -1.0 if smaller_is_closer else 1.0
    known = np.isfinite(null)
    slack = TIE_TOL * (1 + np.abs(observed))
    with np.errstate(invalid="ignore"):
        reached = (sign * null >= sign * observed - slack) & known
    p = (1 + reached.sum(axis=0)) / (1 + known.sum(axis=0))
    return np.where(np.isfinite(observed) & known.any(axis=0), p, np.nan)


def familywise(observed: AnyArray, null: AnyArray) -> AnyArray:
    """Give p (k + 1,) with all components tested at once: against the best component of each copy.

    Westfall and Young (1993), single step. The last entry, all together, is one test and NaN here.
    """
    known = np.isfinite(null[:, :-1])
    best = np.where(known, null[:, :-1], -np.inf).max(axis=1, initial=-np.inf)
    best = np.where(np.isfinite(best), best, np.nan)
    return np.append(p_values(observed[:-1], np.repeat(best[:, None], len(observed) - 1, axis=1)), np.nan)
