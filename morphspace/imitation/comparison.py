"""The similarity of an imitation and its stimulus: two sequences of loadings compared (Nagle section 5.1).

Both are loadings in one expression space, one row per frame. Each measure has k + 1 values: one per component, and
last one of all components together. Shape (correlation), extent (distance, gain) and time (lag, alignment) are
measured separately. Chance is estimated from surrogates as smooth as the imitation but unrelated to the stimulus
(`chance`), because smoothness alone correlates unrelated motions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.imitation.alignment import Alignment, cheapest_path, distances
from morphspace.imitation.chance import (
    Baseline,
    baseline_of,
    familywise,
    in_pieces,
    of_random_phases,
    p_values,
    turned,
)
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
from morphspace.steps import Step, Steps

# Tested measures. Cosine needs no test: shifts keep mean and size, so it ranks as correlation does.
BY_SHIFTS = "correlation", "distance_sd", "mutual_information_nats"
SEARCHED = "correlation_at_lag", "correlation_aligned", "alignment_cost"
SMALLER_IS_CLOSER = ("distance_sd", "alignment_cost")


@dataclass(frozen=True, eq=False)
class Comparison:
    """The result of `compare`.

    Attributes
    ----------
    measures : mapping of name to array (k + 1,)
        All components together last; NaN where undefined.
    lags : array (L,) int, frames
    curve : array (L,)
        The correlation of all components together at each lag.
    alignment : Alignment
    baseline : Baseline
    """

    measures: Mapping[str, AnyArray]
    lags: AnyArray
    curve: AnyArray
    alignment: Alignment
    baseline: Baseline


def compare(
    stimulus_sd: LoadingTable, imitation_sd: LoadingTable, sd: AnyArray, *, permutations: int, seed: int
) -> Steps[Comparison]:
    """Compare two sequences of loadings, and estimate p from surrogates of the imitation.

    Measures of paired frames use the frames that both sequences have; lag and alignment use both sequences
    completely. The measures of all components together are weighted by their effect on the face, in plain loadings. p
    is one-sided: the rate of surrogates at least as close. Measures of paired frames use circular shifts; lag and
    alignment use random phases and reordered pieces, searched in the same way.

    Parameters
    ----------
    stimulus_sd : array (n, k), SD
    imitation_sd : array (m, k), SD
    sd : array (k,)
        The model's SD, which converts SD to plain loadings.
    permutations : int
        The number of surrogates of each kind.
    seed : int

    Yields
    ------
    Step
        The generator returns a `Comparison`.

    Raises
    ------
    BadInput
        As `_check_sequences` raises it.

    References
    ----------
    Nagle et al., section 5.1 (distances and information measures); the tests are ours.
    """
    _check_sequences(stimulus_sd, imitation_sd)
    baseline = baseline_of(len(imitation_sd), permutations, seed)
    stimulus, imitation = stimulus_sd * sd, imitation_sd * sd
    lags, curves = lag_curves(stimulus, imitation[None])
    lag_frames, at_lag = peak(curves[0], lags)
    shape = standardised(stimulus)
    best = cheapest_path(distances(shape, standardised(imitation)))
    measures = {name: values[0] for name, values in _in_pairs(stimulus_sd, imitation_sd[None], sd).items()}
    measures |= {"correlation_at_lag": at_lag, **_aligned(stimulus, imitation, best)}
    measures["mutual_information_nats"] = _shared(stimulus_sd, imitation_sd)
    total = len(baseline.shifts) + len(baseline.costly) + 2 * (baseline.copies + baseline.costly_copies)
    done = 0
    by_shifts: dict[str, list[AnyArray]] = {name: [] for name in BY_SHIFTS}
    for some in turned(imitation_sd, baseline.shifts):
        found = _in_pairs(stimulus_sd, some, sd)
        for name in ("correlation", "distance_sd"):
            by_shifts[name].extend(found[name])
        done += len(some)
        yield Step("chance", done, total)
    for shift in baseline.costly:
        by_shifts["mutual_information_nats"].append(
            _shared(stimulus_sd, np.roll(imitation_sd, shift, axis=0))
        )
        done += 1
        yield Step("chance", done, total)
    kinds = [by_shifts]
    for copies_of in (of_random_phases, in_pieces):
        of_kind: dict[str, list[AnyArray]] = {name: [] for name in SEARCHED}
        for some in copies_of(imitation, baseline.copies, seed):
            of_kind["correlation_at_lag"] += [peak(curve, lags)[1] for curve in lag_curves(stimulus, some)[1]]
            done += len(some)
            yield Step("chance", done, total)
            for copy in some[: baseline.costly_copies - len(of_kind["alignment_cost"])]:
                path = cheapest_path(distances(shape, standardised(copy)))
                for name, value in _aligned(stimulus, copy, path).items():
                    of_kind[name].append(value)
                done += 1
                yield Step("chance", done, total)
        kinds.append(of_kind)
    tests: dict[str, AnyArray] = {}
    for chance in kinds:
        for name, values in chance.items():
            null = np.array(values).reshape(-1, len(sd) + 1)
            p = p_values(measures[name], null, name in SMALLER_IS_CLOSER)
            tests[f"{name}_p"] = np.maximum(tests.get(f"{name}_p", p), p)
    turned_correlation = np.array(by_shifts["correlation"]).reshape(-1, len(sd) + 1)
    tests["correlation_p_familywise"] = familywise(measures["correlation"], turned_correlation)
    n = min(len(stimulus_sd), len(imitation_sd))
    also = {"lag_frames": lag_frames}
    for name, sequence in (("stimulus", stimulus_sd[:n]), ("imitation", imitation_sd[:n])):
        each = np.array([entropy(column) for column in sequence.T])
        also[f"entropy_{name}_nats"] = np.append(each, _sum_of_defined(each))
    return Comparison({**measures, **tests, **also}, lags, curves[0, :, -1], best, baseline)


def _check_sequences(stimulus: LoadingTable, imitation: LoadingTable) -> None:
    """Raise `BadInput` if sequences (n, k), (m, k) differ in k, have too few frames or values that are not finite."""
    for name, sequence in (("stimulus", stimulus), ("imitation", imitation)):
        if sequence.ndim != 2 or sequence.shape[1] < 1:
            raise BadInput(
                f"the {name} has the shape {sequence.shape}; expected (n, k) with k at least 1. Encode it again"
            )
        if len(sequence) < LEAST_FRAMES:
            raise BadInput(
                f"the {name} has {len(sequence)} frame(s); expected at least {LEAST_FRAMES} to compare motions. "
                "Use a longer motion"
            )
        if not np.isfinite(sequence).all():
            row, column = np.argwhere(~np.isfinite(sequence))[0]
            raise BadInput(
                f"the {name} is {sequence[row, column]} in frame {row}, component {column + 1}; expected a finite "
                "number. Correct it"
            )
    if stimulus.shape[1] != imitation.shape[1]:
        raise BadInput(
            f"the stimulus has {stimulus.shape[1]} components, the imitation {imitation.shape[1]}; expected equal "
            "numbers. Use one model"
        )


def _in_pairs(stimulus_sd: LoadingTable, imitations_sd: AnyArray, sd: AnyArray) -> dict[str, AnyArray]:
    """Return the measures of paired frames of imitations (copies, m, k), name to (copies, k + 1)."""
    n = min(len(stimulus_sd), imitations_sd.shape[1])
    a_sd, b_sd = stimulus_sd[:n], imitations_sd[:, :n]
    a, b = a_sd * sd, b_sd * sd
    along = with_total((a * b).sum(axis=-2))
    sizes = with_total((a * a).sum(axis=-2)) * with_total((b * b).sum(axis=-2))
    shape_a, shape_b = centred(a), centred(b)
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
    }


def _rms(difference: AnyArray) -> AnyArray:
    return np.sqrt(with_total((difference * difference).mean(axis=-2)))


def _shared(stimulus_sd: LoadingTable, imitation_sd: LoadingTable) -> AnyArray:
    """Return the mutual information (k + 1,) of paired frames."""
    n = min(len(stimulus_sd), len(imitation_sd))
    each = np.array(
        [mutual_information(x, y) for x, y in zip(stimulus_sd[:n].T, imitation_sd[:n].T, strict=True)]
    )
    return np.append(each, _sum_of_defined(each))


def _aligned(stimulus: LoadingTable, imitation: LoadingTable, best: Alignment) -> dict[str, AnyArray]:
    """Return the measures (k + 1,) of plain loadings after alignment."""
    moving = varies(stimulus).any() and varies(imitation).any()
    cost = best.cost / len(best.path) if moving else np.nan
    return {
        "correlation_aligned": similarity(stimulus[best.path[:, 0]], imitation[best.path[:, 1]]),
        "alignment_cost": np.append(np.full(stimulus.shape[1], np.nan), cost),
    }


def _sum_of_defined(each: AnyArray) -> float:
    return float(np.nansum(each)) if np.isfinite(each).any() else float("nan")
