"""Every measure of an imitation against its definition, worked out one number at a time."""

import math

import numpy as np
import pytest
from scipy import ndimage
from scipy.special import digamma

from morphspace.imitation import compare
from morphspace.imitation.chance import in_pieces, of_random_phases
from morphspace.imitation.comparison import SEARCHED
from morphspace.steps import result_of

SD = [3.0, 1.0, 0.5]


def motions(n, m):
    rng = np.random.default_rng(11)
    one = ndimage.gaussian_filter1d(rng.standard_normal((n, 3)), 1.0, axis=0) + 0.3
    other = ndimage.gaussian_filter1d(rng.standard_normal((m, 3)), 1.0, axis=0) - 0.2
    k = min(n, m)
    other[:k] += 0.6 * one[:k]
    return one, other


def mean(values):
    return math.fsum(values) / len(values)


def about_mean(values):
    middle = mean(values)
    return [value - middle for value in values]


def dot(one, other):
    return math.fsum(x * y for x, y in zip(one, other, strict=True))


def columns(sequence, sd=(1, 1, 1)):
    return [[row[c] * sd[c] for row in sequence.tolist()] for c in range(3)]


def together(pairs):
    """Sum the products and the squares of several pairs of traces, then make one cosine of them."""
    along = math.fsum(dot(a, b) for a, b in pairs)
    return along / math.sqrt(math.fsum(dot(a, a) for a, _ in pairs) * math.fsum(dot(b, b) for _, b in pairs))


def each_and_all(measure, pairs):
    return [*(measure([pair]) for pair in pairs), measure(pairs)]


def correlation(pairs):
    return together([(about_mean(a), about_mean(b)) for a, b in pairs])


def gain(pairs):
    pairs = [(about_mean(a), about_mean(b)) for a, b in pairs]
    return math.fsum(dot(a, b) for a, b in pairs) / math.fsum(dot(a, a) for a, _ in pairs)


def distance(pairs):
    return math.sqrt(
        mean([math.fsum((x - y) ** 2 for x, y in zip(*row, strict=True)) for row in rows_of(pairs)])
    )


def rows_of(pairs):
    for frame in range(len(pairs[0][0])):
        yield [a[frame] for a, _ in pairs], [b[frame] for _, b in pairs]


def best_lag(pairs):
    """Try each lag at which at least half of the shorter motion overlaps; of equals the least."""
    n, m = len(pairs[0][0]), len(pairs[0][1])
    overlap = max(3, math.ceil(0.5 * min(n, m)))
    found = []
    for lag in range(overlap - n, m - overlap + 1):
        frames = [t for t in range(n) if 0 <= t + lag < m]
        found.append(
            (
                round(
                    correlation([([a[t] for t in frames], [b[t + lag] for t in frames]) for a, b in pairs]), 9
                ),
                lag,
            )
        )
    return max(found, key=lambda entry: (entry[0], -abs(entry[1])))


def ebrahimi(values):
    """Entropy from m-spacings, the ends weighed as Ebrahimi, Pflughoeft and Soofi (1994) do."""
    x, n = sorted(values), len(values)
    m = math.floor(math.sqrt(n) + 0.5)
    total = 0.0
    for i in range(1, n + 1):
        weight = 1 + (i - 1) / m if i <= m else 1 + (n - i) / m if i > n - m else 2.0
        gap = x[min(i + m, n) - 1] - x[max(i - m, 1) - 1]
        total += math.log(n * gap / (weight * m))
    return total / n


def kraskov(x, y, neighbours=3):
    """Estimator 1: count by hand who lies nearer than the third neighbour in the joint space."""
    x, y = ([value / np.std(values) for value in values] for values in (x, y))
    n, total = len(x), 0.0
    for i in range(n):
        radius = sorted(max(abs(x[i] - x[j]), abs(y[i] - y[j])) for j in range(n) if j != i)[neighbours - 1]
        for values in (x, y):
            near = sum(abs(values[i] - values[j]) < radius * (1 - 1e-10) for j in range(n) if j != i)
            total += digamma(near + 1)
    return max(0.0, digamma(neighbours) + digamma(n) - total / n)


def aligned(one, other):
    """Dynamic time warping by its recursion: the cheapest path and its cost, of standardised plain loadings."""
    a, b = (standardised(sequence) for sequence in (one, other))
    n, m = len(a), len(b)
    slope = (m - 1) / (n - 1)
    reach = max(0.25 * max(n, m), 1 + slope)
    totals = {(-1, -1): (0.0, None)}
    for i in range(n):
        for j in range(m):
            if abs(j - i * slope) > reach:
                continue
            before = [cell for cell in ((i - 1, j - 1), (i - 1, j), (i, j - 1)) if cell in totals]
            if before:
                cell = min(before, key=lambda c: totals[c][0])
                totals[i, j] = totals[cell][0] + math.dist(a[i], b[j]), cell
    path = [(n - 1, m - 1)]
    while totals[path[-1]][1] != (-1, -1):
        path.append(totals[path[-1]][1])
    return path[::-1], totals[n - 1, m - 1][0] / len(path)


def standardised(sequence):
    rows = list(zip(*(about_mean(column) for column in columns(sequence, SD)), strict=True))
    size = math.sqrt(mean([dot(row, row) for row in rows]))
    return [[value / size for value in row] for row in rows]


def worked_out(one, other):
    """All measures by name, each component's and that of all together, from their definitions."""
    k = min(len(one), len(other))
    in_sd = list(zip(columns(one[:k]), columns(other[:k]), strict=True))
    plain = list(zip(columns(one[:k], SD), columns(other[:k], SD), strict=True))
    whole = list(zip(columns(one, SD), columns(other, SD), strict=True))
    lags = each_and_all(best_lag, whole)
    path, cost = aligned(one, other)
    warped = [([a[i] for i, _ in path], [b[j] for _, j in path]) for a, b in whole]
    shared = [kraskov(a, b) for a, b in in_sd]
    return {
        "correlation": each_and_all(correlation, plain),
        "cosine": each_and_all(together, plain),
        "gain": each_and_all(gain, plain),
        "distance_sd": each_and_all(distance, in_sd),
        "distance": each_and_all(distance, plain),
        "distance_centred_sd": each_and_all(distance, [(about_mean(a), about_mean(b)) for a, b in in_sd]),
        "lag_frames": [lag for _, lag in lags],
        "correlation_at_lag": [r for r, _ in lags],
        "mutual_information_nats": [*shared, sum(shared)],
        "correlation_aligned": each_and_all(correlation, warped),
        "alignment_cost": [np.nan, np.nan, np.nan, cost],
        **{
            f"entropy_{role}_nats": [*values, sum(values)]
            for role, values in (
                ("stimulus", [ebrahimi(a) for a, _ in in_sd]),
                ("imitation", [ebrahimi(b) for _, b in in_sd]),
            )
        },
    }


@pytest.mark.parametrize(("n", "m"), [(20, 20), (17, 26), (26, 17), (9, 24)])
def test_every_measure_is_what_its_definition_gives(n, m):
    one, other = motions(n, m)
    found = result_of(compare(one, other, np.array(SD), permutations=0, seed=0)).measures
    for name, values in worked_out(one, other).items():
        np.testing.assert_allclose(found[name], values, rtol=1e-7, atol=1e-8, err_msg=name)


@pytest.mark.parametrize(("n", "m"), [(14, 14), (12, 16)])
def test_every_p_is_the_share_of_copies_that_come_as_close(n, m):
    """Of turned imitations frame by frame; of the worse of two other kinds where there is a search."""
    one, other = motions(n, m)
    found = result_of(compare(one, other, np.array(SD), permutations=m - 1, seed=0)).measures
    true = worked_out(one, other)
    turned = [worked_out(one, np.roll(other, shift, axis=0)) for shift in range(1, m)]
    copies = [
        [worked_out(one, copy / SD) for some in kind(other * SD, m - 1, 0) for copy in some]
        for kind in (of_random_phases, in_pieces)
    ]
    for name in (
        "correlation",
        "distance_sd",
        "correlation_at_lag",
        "mutual_information_nats",
        "correlation_aligned",
        "alignment_cost",
    ):
        sign = -1 if name in ("distance_sd", "alignment_cost") else 1
        for place in range(4):
            if np.isnan(true[name][place]):
                continue
            kinds = copies if name in SEARCHED else [turned]
            reached = max(
                sum(sign * (copy[name][place] - true[name][place]) >= -1e-8 for copy in kind)
                for kind in kinds
            )
            assert found[f"{name}_p"][place] == pytest.approx((1 + reached) / m), (name, place)
    best = [max(one["correlation"][:3]) for one in turned]
    expected = [(1 + sum(b >= r - 1e-9 for b in best)) / m for r in true["correlation"][:3]]
    np.testing.assert_allclose(found["correlation_p_familywise"][:3], expected)


def test_a_lag_beyond_half_of_the_clip_is_not_searched():
    """At more than half, what is left in common is too short to tell; the farthest lag is half of the shorter one."""
    pulse = np.zeros((40, 1))
    pulse[4] = 1.0
    late = np.roll(pulse, 30, axis=0)
    found = result_of(compare(pulse, late, np.ones(1), permutations=0, seed=0))
    assert (found.lags[0], found.lags[-1]) == (-20, 20)
    assert found.measures["correlation_at_lag"][-1] < 0.5
    longer = result_of(compare(pulse[:20], np.concatenate([late, late]), np.ones(1), permutations=0, seed=0))
    assert (longer.lags[0], longer.lags[-1]) == (-10, 70)  # in a longer imitation every place of it is tried
    assert longer.measures["lag_frames"][-1] == 30
