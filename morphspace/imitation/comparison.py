"""How close an imitation comes to what was imitated: two sequences of loadings compared (Nagle section 5.1).

Both are rows of loadings in one expression space, one row a frame. Each measure is given for every component and once
for all together, (k + 1,), the last entry. What the two do (shape), how far they go (distance, gain) and when (lag,
alignment) are kept apart. Chance is what the same imitation gives when it is turned in time: circular shifts keep the
smoothness of a motion, which makes two unrelated ones correlate, and break only its tie to the stimulus.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.imitation.alignment import Alignment, cheapest_path, distances
from morphspace.imitation.information import entropy, mutual_information
from morphspace.imitation.shape import (
    LEAST_FRAMES,
    centred,
    lag_curves,
    peak,
    ratio,
    similarity,
    standardised,
    varies,
    with_total,
)
from morphspace.progress import Step, Steps

COSTLY_SHIFTS = 199  # at most, for mutual information and alignment; then p is at least 0.005
TIE_TOL = 1e-9  # of the value: equal scores of two shifts differ by rounding
CHUNK_NUMBERS = 1_000_000  # of shifted sequences held at a time
TESTED = (  # the others go along: a turned imitation keeps its mean and size, so cosine ranks as correlation does
    "correlation",
    "distance_sd",
    "correlation_at_lag",
    "mutual_information_nats",
    "correlation_aligned",
    "alignment_cost",
)
SMALLER_IS_CLOSER = ("distance_sd", "alignment_cost")


@dataclass(frozen=True, eq=False)
class Baseline:
    """Which circular shifts of the imitation (frames) stand for chance; `costly` are those of the slow measures.

    `is_exhaustive` tells whether `shifts` are all there are.
    """

    shifts: AnyArray
    costly: AnyArray
    is_exhaustive: bool


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` found: `measures`, name to (k + 1,) with all components together last, NaN where undefined.

    `curve` is the correlation of all together at each of `lags` (frames); `chance` the correlation (shifts,) of all
    together at each shift of the baseline.
    """

    measures: Mapping[str, AnyArray]
    lags: AnyArray
    curve: AnyArray
    alignment: Alignment
    baseline: Baseline
    chance: AnyArray


def compare(
    stimulus_sd: LoadingTable, imitation_sd: LoadingTable, sd: AnyArray, *, permutations: int, seed: int
) -> Steps[Comparison]:
    """Compare two sequences of loadings in SD, (n, k) and (m, k); `sd` (k,) makes them plain loadings.

    What needs frames in pairs is taken over the frames both have; lag and alignment see both whole. All together are
    weighed as they show in the face: in plain loadings. p is one-sided: how often chance is as close or closer. The p
    of a lag and of an alignment allow for the search, as each shift is searched in the same way. Raises `BadInput`.
    """
    check_sequences(stimulus_sd, imitation_sd)
    baseline = circular_shifts(len(imitation_sd), permutations, seed)
    total = len(baseline.shifts) + len(baseline.costly)
    lags, curves = lag_curves(stimulus_sd * sd, imitation_sd[None] * sd)
    lag_frames, _ = peak(curves[0], lags)
    measures = {name: values[0] for name, values in _quick(stimulus_sd, imitation_sd[None], sd).items()}
    costs = distances(standardised(stimulus_sd * sd), standardised(imitation_sd * sd))
    best = cheapest_path(costs)
    measures |= _slow(stimulus_sd, imitation_sd, sd, best)
    chance: dict[str, list[AnyArray]] = {name: [] for name in measures}
    done = 0
    for turned in _turned(imitation_sd, baseline.shifts):
        for name, values in _quick(stimulus_sd, turned, sd).items():
            chance[name].extend(values)
        done += len(turned)
        yield Step("chance", done, total)
    for shift in baseline.costly:
        turned = np.roll(imitation_sd, shift, axis=0)
        path = cheapest_path(np.roll(costs, shift, axis=1))
        for name, value in _slow(stimulus_sd, turned, sd, path).items():
            chance[name].append(value)
        done += 1
        yield Step("chance", done, total)
    nulls = {name: np.array(values).reshape(-1, len(sd) + 1) for name, values in chance.items()}
    tests = {
        f"{name}_p": p_values(measures[name], null, name in SMALLER_IS_CLOSER)
        for name, null in nulls.items()
        if name in TESTED
    }
    tests["correlation_p_familywise"] = familywise(measures["correlation"], nulls["correlation"])
    n = min(len(stimulus_sd), len(imitation_sd))
    told = {"lag_frames": lag_frames}
    for name, sequence in (("stimulus", stimulus_sd[:n]), ("imitation", imitation_sd[:n])):
        each = np.array([entropy(column) for column in sequence.T])
        told[f"entropy_{name}_nats"] = np.append(each, _sum_of_defined(each))
    together = nulls["correlation"][:, -1]
    return Comparison({**measures, **tests, **told}, lags, curves[0, :, -1], best, baseline, together)


def check_sequences(stimulus: LoadingTable, imitation: LoadingTable) -> None:
    """Raise `BadInput` where two sequences (n, k), (m, k) cannot be compared: shapes, too few frames, not finite."""
    for name, sequence in (("stimulus", stimulus), ("imitation", imitation)):
        if sequence.ndim != 2 or sequence.shape[1] < 1:
            raise BadInput(
                f"the {name} has shape {sequence.shape}: rows of one loading or more were expected"
            )
        if len(sequence) < LEAST_FRAMES:
            raise BadInput(
                f"the {name} has {len(sequence)} frame(s), at least {LEAST_FRAMES} are needed to compare motions: "
                "give more frames"
            )
        if not np.isfinite(sequence).all():
            row, column = np.argwhere(~np.isfinite(sequence))[0]
            raise BadInput(
                f"the {name} is {sequence[row, column]} in frame {row}, component {column + 1}: mend it"
            )
    if stimulus.shape[1] != imitation.shape[1]:
        raise BadInput(
            f"the stimulus has {stimulus.shape[1]} components, the imitation {imitation.shape[1]}: use the same model"
        )


def circular_shifts(frames: int, permutations: int, seed: int) -> Baseline:
    """Choose circular shifts of a sequence, 1 to frames - 1: all of them, or so many drawn by the seed."""
    every = np.arange(1, frames)
    rng = np.random.default_rng(seed)
    shifts = every
    if len(every) > permutations:
        shifts = np.sort(rng.choice(every, permutations, replace=False))
    costly = shifts
    if len(shifts) > COSTLY_SHIFTS:
        costly = np.sort(rng.choice(shifts, COSTLY_SHIFTS, replace=False))
    return Baseline(shifts, costly, len(shifts) == len(every))


def p_values(observed: AnyArray, null: AnyArray, smaller_is_closer: bool | np.bool_ = False) -> AnyArray:
    """Give how often chance (shifts, ...) is as close as observed (...) or closer, itself counted in.

    (1 + count) / (1 + shifts): never 0 (Phipson and Smyth 2010). NaN where there is nothing to compare.
    """
    sign = -1.0 if smaller_is_closer else 1.0
    known = np.isfinite(null)
    slack = TIE_TOL * (1 + np.abs(observed))
    with np.errstate(invalid="ignore"):
        reached = (sign * null >= sign * observed - slack) & known
    p = (1 + reached.sum(axis=0)) / (1 + known.sum(axis=0))
    return np.where(np.isfinite(observed) & known.any(axis=0), p, np.nan)


def familywise(observed: AnyArray, null: AnyArray) -> AnyArray:
    """Give p (k + 1,) with all components tested at once: against the best component of each shift.

    Westfall and Young (1993), single step. The last entry, all together, is one test and NaN here.
    """
    known = np.isfinite(null[:, :-1])
    best = np.where(known, null[:, :-1], -np.inf).max(axis=1, initial=-np.inf)
    best = np.where(np.isfinite(best), best, np.nan)
    return np.append(p_values(observed[:-1], np.repeat(best[:, None], len(observed) - 1, axis=1)), np.nan)


def _quick(stimulus_sd: LoadingTable, imitations_sd: AnyArray, sd: AnyArray) -> dict[str, AnyArray]:
    """Give the measures of frames in pairs for imitations (shifts, m, k), name to (shifts, k + 1)."""
    n = min(len(stimulus_sd), imitations_sd.shape[1])
    a_sd, b_sd = stimulus_sd[:n], imitations_sd[:, :n]
    a, b = a_sd * sd, b_sd * sd
    along = with_total((a * b).sum(axis=-2))
    sizes = with_total((a * a).sum(axis=-2)) * with_total((b * b).sum(axis=-2))
    shape_a, shape_b = centred(a), centred(b)
    lags, curves = lag_curves(stimulus_sd * sd, imitations_sd * sd)
    return {
        "correlation": similarity(a, b),
        "cosine": np.clip(ratio(along, np.sqrt(sizes)), -1, 1),
        "distance_sd": _rms(a_sd - b_sd),
        "distance": _rms(a - b),
        "distance_centred_sd": _rms(centred(a_sd) - centred(b_sd)),
        "gain": ratio(
            with_total((shape_a * shape_b).sum(axis=-2)),
            np.broadcast_to(with_total((shape_a * shape_a).sum(axis=-2)), along.shape),
        ),
        "correlation_at_lag": np.array([peak(curve, lags)[1] for curve in curves]),
    }


def _rms(difference: AnyArray) -> AnyArray:
    return np.sqrt(with_total((difference * difference).mean(axis=-2)))


def _slow(
    stimulus_sd: LoadingTable, imitation_sd: LoadingTable, sd: AnyArray, best: Alignment
) -> dict[str, AnyArray]:
    """Give mutual information and what alignment leaves, name to (k + 1,)."""
    n = min(len(stimulus_sd), len(imitation_sd))
    each = np.array(
        [mutual_information(x, y) for x, y in zip(stimulus_sd[:n].T, imitation_sd[:n].T, strict=True)]
    )
    a, b = stimulus_sd * sd, imitation_sd * sd
    moving = varies(a).any() and varies(b).any()
    cost = best.cost / len(best.path) if moving else np.nan
    nothing = np.full(len(each), np.nan)
    return {
        "mutual_information_nats": np.append(each, _sum_of_defined(each)),
        "correlation_aligned": similarity(a[best.path[:, 0]], b[best.path[:, 1]]),
        "alignment_cost": np.append(nothing, cost),
    }


def _sum_of_defined(each: AnyArray) -> float:
    return float(np.nansum(each)) if np.isfinite(each).any() else float("nan")


def _turned(sequence: LoadingTable, shifts: AnyArray) -> Iterator[AnyArray]:
    """Give the sequence (m, k) turned by each shift, some at a time, (some, m, k)."""
    some = max(1, CHUNK_NUMBERS // max(sequence.size, 1))
    places = np.arange(len(sequence))
    for start in range(0, len(shifts), some):
        yield sequence[(places - shifts[start : start + some, None]) % len(sequence)]
