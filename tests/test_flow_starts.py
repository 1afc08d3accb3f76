"""Laws of the choice among starts: never a larger error, never beyond the fold limit, the first when in doubt."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from morphspace import warp
from morphspace.errors import BadInput
from morphspace.flow import Flow, starts
from morphspace.flow.starts import CLEARLY, FOLD_LIMIT, HARD, better, photometric_error

HEIGHT, WIDTH = 80, 64
MASK = np.ones((HEIGHT, WIDTH), np.float32)


@pytest.fixture
def moved(picture, wavy_field):
    """A reference, a frame, and the field between them."""
    reference = picture(HEIGHT, WIDTH, seed=4, sd_px=2.5)
    truth = wavy_field(HEIGHT, WIDTH, 4.0, seed=3, sd_px=10.0)
    return reference, warp.render(reference, truth), truth


def flow_of(field):
    return Flow(np.asarray(field, np.float32), np.ones(field.shape[:2], np.float32))


def folded(field, cells):
    """The field with so many cells of one row turned over, where neighbours stand far apart."""
    broken = field.copy()
    broken[20, 4 : 4 + 3 * cells : 3, 0] += 3.0
    return broken


def test_the_error_is_what_the_warped_frame_misses_inside_the_mask(moved):
    reference, frame, truth = moved
    weight = np.random.default_rng(0).uniform(0, 1, MASK.shape).astype(np.float32)
    square = np.square(warp.sample(frame, truth) - reference).mean(axis=2)
    expected = np.sqrt(np.average(square, weights=weight))
    assert photometric_error(reference, frame, truth, weight) == pytest.approx(expected, rel=1e-4)
    assert photometric_error(reference, reference, 0 * truth, MASK) < 1e-6
    assert photometric_error(reference, frame, 0 * truth, 0 * MASK) == 0


def test_the_field_that_explains_the_frame_is_taken_wherever_it_stands(moved):
    reference, frame, truth = moved
    flows = [flow_of(share * truth) for share in (0.0, 0.5, 1.0, 0.8)]
    assert better(reference, frame, flows, MASK) is flows[2]
    assert better(reference, frame, flows[::-1], MASK) is flows[2]


def test_the_first_stands_where_another_is_not_clearly_better(moved):
    reference, frame, truth = moved
    error = {share: photometric_error(reference, frame, share * truth, MASK) for share in (0.8, 0.801, 0.85)}
    assert CLEARLY * error[0.8] < error[0.801] < error[0.8]
    assert error[0.85] < CLEARLY * error[0.8]
    first, little, clear = (flow_of(share * truth) for share in error)
    assert better(reference, frame, [first, little], MASK) is first
    assert better(reference, frame, [first, little, clear], MASK) is clear
    assert better(reference, frame, [first], MASK) is first


def test_a_smaller_error_is_not_bought_by_folding(moved):
    reference, frame, truth = moved
    first, over = flow_of(0 * truth), folded(truth, 16)
    assert warp.fold_fraction(over, MASK) > FOLD_LIMIT
    assert photometric_error(reference, frame, over, MASK) < 0.5 * photometric_error(
        reference, frame, 0 * truth, MASK
    )
    assert better(reference, frame, [first, flow_of(over)], MASK) is first
    within = folded(truth, 2)
    assert 0 < warp.fold_fraction(within, MASK) <= FOLD_LIMIT
    within = flow_of(within)
    assert better(reference, frame, [first, within], MASK) is within


def test_a_field_that_folds_gives_way_to_one_that_does_not_at_an_equal_error(moved):
    reference, frame, truth = moved
    first = folded(truth, 16)
    error = photometric_error(reference, frame, first, MASK)
    shares = np.linspace(0.5, 1, 501)  # the less of the truth, the larger the error
    errors = np.array([photometric_error(reference, frame, share * truth, MASK) for share in shares]) / error
    equal, worse = (shares[np.abs(errors - ratio).argmin()] * truth for ratio in (0.99, 1.02))
    first, equal, worse = flow_of(first), flow_of(equal), flow_of(worse)
    assert better(reference, frame, [first, equal], MASK) is equal
    assert better(reference, frame, [first, worse], MASK) is first


@pytest.mark.parametrize("seed", range(12))
def test_the_choice_never_raises_the_error_nor_passes_the_fold_limit(moved, wavy_field, seed):
    reference, frame, truth = moved
    rng = np.random.default_rng(seed)
    flows = []
    for number in range(5):
        field = rng.uniform(0, 1.2) * truth + wavy_field(
            HEIGHT, WIDTH, rng.uniform(0, 2), 10 * seed + number, 6.0
        )
        flows.append(flow_of(folded(field, int(rng.integers(0, 18)))))
    chosen = better(reference, frame, flows, MASK).displacement
    first = flows[0].displacement
    assert photometric_error(reference, frame, chosen, MASK) <= photometric_error(
        reference, frame, first, MASK
    )
    assert warp.fold_fraction(chosen, MASK) <= max(FOLD_LIMIT, warp.fold_fraction(first, MASK))


def test_what_lies_outside_the_mask_decides_nothing(moved):
    reference, frame, truth = moved
    upper = MASK.copy()
    upper[HEIGHT // 2 :] = 0
    half = truth.copy()
    half[HEIGHT // 2 + 4 :] = 0
    first, other = flow_of(half), flow_of(truth)
    assert better(reference, frame, [first, other], upper) is first
    assert better(reference, frame, [first, other], MASK) is other


def test_hard_frames_lie_far_above_the_median_or_fold():
    errors = np.array([1.0, 1.0, HARD * 1.01, HARD * 0.99, 0.9, 1.0, 2.0])
    folds = np.zeros(7)
    folds[4], folds[5] = 1.01 * FOLD_LIMIT, 0.99 * FOLD_LIMIT
    assert_array_equal(starts.hard_frames(errors, folds), [2, 4, 6])


def test_the_easier_neighbour_is_beside_the_frame_and_has_the_smaller_error():
    errors = np.array([0.5, 0.1, 0.9, 0.4, 0.2])
    assert [starts.easier_neighbour(errors, index) for index in range(5)] == [1, 0, 1, 4, 3]


def test_an_unknown_start_is_refused_and_the_others_listed():
    with pytest.raises(BadInput, match=r"no start called 'previous'.*auto, none"):
        starts.check_start("previous")
    starts.check_start("auto")
    starts.check_start("none")
