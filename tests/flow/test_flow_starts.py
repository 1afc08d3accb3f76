"""Laws of the choice among starts: never a larger error or more folds than the limit; the first in doubt."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.flow import Flow, multiscale, presets, starts
from morphspace.flow.starts import _approximate_inverse, better, photometric_error
from morphspace.grid import warp

HEIGHT, WIDTH = 80, 64
MASK = np.ones((HEIGHT, WIDTH), np.float32)
FOLD_LIMIT, CLEARLY, HARD = 0.003, 0.98, 1.25  # as the module documents them


@pytest.fixture
def moved(picture, wavy_field):
    """Draw a reference, a frame, and the field between them."""
    reference = picture(HEIGHT, WIDTH, seed=4, sd_px=2.5)
    truth = wavy_field(HEIGHT, WIDTH, 4.0, seed=3, sd_px=10.0)
    return reference, warp.render(reference, truth), truth


def flow_of(field):
    return Flow(np.asarray(field, np.float32), np.ones(field.shape[:2], np.float32))


def folded(field, cells):
    """Flip some cells in one row of a field, far from each other."""
    broken = field.copy()
    broken[20, 4 : 4 + 3 * cells : 3, 0] += 3.0
    return broken


def test_the_error_is_the_rms_difference_of_the_warped_frame_inside_the_mask(moved):
    reference, frame, truth = moved
    weight = np.random.default_rng(0).uniform(0, 1, MASK.shape).astype(np.float32)
    square = np.square(warp.sample(frame, truth) - reference).mean(axis=2)
    expected = np.sqrt(np.average(square, weights=weight))
    assert photometric_error(reference, frame, truth, weight) == pytest.approx(expected, rel=1e-4)
    assert photometric_error(reference, reference, 0 * truth, MASK) < 1e-6
    assert photometric_error(reference, frame, 0 * truth, 0 * MASK) == 0


def test_the_field_of_least_error_is_chosen_in_any_order(moved):
    reference, frame, truth = moved
    flows = [flow_of(share * truth) for share in (0.0, 0.5, 1.0, 0.8)]
    assert better(reference, frame, flows, MASK) is flows[2]
    assert better(reference, frame, flows[::-1], MASK) is flows[2]


def test_the_first_field_is_kept_unless_another_is_clearly_better(moved):
    reference, frame, truth = moved
    error = {share: photometric_error(reference, frame, share * truth, MASK) for share in (0.8, 0.801, 0.85)}
    assert CLEARLY * error[0.8] < error[0.801] < error[0.8]
    assert error[0.85] < CLEARLY * error[0.8]
    first, little, clear = (flow_of(share * truth) for share in error)
    assert better(reference, frame, [first, little], MASK) is first
    assert better(reference, frame, [first, little, clear], MASK) is clear
    assert better(reference, frame, [first], MASK) is first


def test_a_smaller_error_with_more_folds_is_not_chosen(moved):
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


def test_at_equal_error_the_field_without_folds_is_chosen(moved):
    reference, frame, truth = moved
    first = folded(truth, 16)
    error = photometric_error(reference, frame, first, MASK)
    shares = np.linspace(0.5, 1, 501)  # a smaller share of the truth has a larger error
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


def test_pixels_outside_the_mask_do_not_influence_the_choice(moved):
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
    with pytest.raises(BadInput, match=r"start is 'previous'.*auto, none"):
        starts.check_start("previous")
    starts.check_start("auto")
    starts.check_start("none")


def test_the_best_start_is_the_one_whose_flow_explains_the_frame(moved):
    reference, frame, truth = moved
    asked = []

    def to_frame(given, start=None):
        assert given is frame
        asked.append(start)
        return flow_of(0.3 * truth if start is None else start)

    name, flow = starts._best_start(
        to_frame, reference, frame, {"none": None, "half": 0.5 * truth, "all": truth}
    )
    assert name == "all" and len(asked) == 3
    assert_array_equal(flow.displacement, truth)
    broken = folded(truth, 16)
    assert starts._best_start(to_frame, reference, frame, {"none": None, "folds": broken})[0] == "none"
    lower = MASK.copy()
    lower[: HEIGHT // 2] = 0
    choice = {"none": None, "lower": truth * lower[..., None]}
    assert starts._best_start(to_frame, reference, frame, choice, lower)[0] == "lower"
    assert starts._best_start(to_frame, reference, frame, choice, 1 - lower)[0] == "none"


# the spline through landmarks


def landmarks(seed, count=40, margin=-4, height=HEIGHT, width=WIDTH):
    """Draw points in the picture and slightly outside, at least 4 px from each other."""
    rng = np.random.default_rng(seed)
    points = []
    while len(points) < count:
        point = rng.uniform([margin, margin], [width - margin, height - margin])
        if all(np.hypot(*(point - other)) >= 4 for other in points):
            points.append(point)
    return np.array(points)


def exact_spline(places, moves, points):
    """Compute the spline by its definition: r^2 log r at every place and an affine map, with the side conditions."""

    def bends(points):
        square = ((points[:, None] - places) ** 2).sum(axis=2)
        return 0.5 * square * np.log(np.where(square > 0, square, 1))

    def flat(points):
        return np.hstack([np.ones((len(points), 1)), points])

    system = np.block([[bends(places), flat(places)], [flat(places).T, np.zeros((3, 3))]])
    weights = np.linalg.solve(system, np.vstack([moves, np.zeros((3, 2))]))
    return np.hstack([bends(points), flat(points)]) @ weights


@pytest.mark.parametrize("seed", range(3))
def test_the_spline_goes_through_its_landmarks(seed):
    places = landmarks(seed, margin=2)
    fellows = places + np.random.default_rng(seed).normal(0, 2, places.shape)
    field = starts.landmark_spline(places, fellows, HEIGHT, WIDTH)
    assert field.shape == (HEIGHT, WIDTH, 2) and field.dtype == np.float32
    off = np.hypot(*(warp.move_points(field, places) - fellows).T)
    assert off.max() < 0.3 and np.median(off) < 0.05  # px: the field is read linearly between pixels
    on_pixels = np.unique(np.round(places), axis=0)
    fellows = on_pixels + np.random.default_rng(seed).normal(0, 2, on_pixels.shape)
    field = starts.landmark_spline(on_pixels, fellows, HEIGHT, WIDTH)
    assert_allclose(warp.move_points(field, on_pixels), fellows, atol=1e-3)  # px


@pytest.mark.parametrize("count", [3, 5, 40])
@pytest.mark.parametrize(("height", "width"), [(HEIGHT, WIDTH), (61, 163)])
def test_the_fast_evaluation_equals_the_spline(count, height, width):
    places = landmarks(count, count, height=height, width=width)
    moves = np.random.default_rng(count).normal(0, 3, places.shape)
    y, x = np.mgrid[:height, :width]
    truth = exact_spline(places, moves, np.stack([x.ravel(), y.ravel()], axis=1)).reshape(height, width, 2)
    field = starts.landmark_spline(places, places + moves, height, width)
    assert np.hypot(*(field - truth).transpose(2, 0, 1)).max() < 0.05  # px


def test_landmarks_moved_by_an_affine_give_that_affine_everywhere():
    affine = np.array([[1.1, -0.2, 5.0], [0.15, 0.9, -3.0]])
    for places in (landmarks(1, 12), np.array([[10.0, 10.0], [50.0, 12.0], [30.0, 60.0]])):
        field = starts.landmark_spline(places, warp.apply_affine(affine, places), HEIGHT, WIDTH)
        assert_allclose(field, warp.affine_displacement(affine, HEIGHT, WIDTH), atol=1e-3)  # px


def test_landmarks_at_rest_give_a_zero_field():
    places = landmarks(2)
    assert not starts.landmark_spline(places, places, HEIGHT, WIDTH).any()


def test_landmarks_at_one_place_go_to_the_mean_of_their_counterparts():
    places = np.round(landmarks(3, 12, margin=4))
    twice = np.vstack([places, places[:1]])
    apart = np.vstack([places + 1, places[:1] + 3])
    field = starts.landmark_spline(twice, apart, HEIGHT, WIDTH)
    assert_allclose(warp.move_points(field, places[:1]), places[:1] + 2, atol=1e-3)
    assert_allclose(warp.move_points(field, places[1:]), places[1:] + 1, atol=1e-3)


@pytest.mark.parametrize(
    ("places", "fellows", "mentioned"),
    [
        ([[1, 2], [30, 4], [9, 50]], [[1, 2], [30, 4]], "frame has 2 landmarks; expected 3"),
        ([[1, 2], [30, 4]], [[1, 2], [30, 4]], "reference are at 2 places.* at least 3"),
        ([[1, 2], [30, 4], [1, 2.2]], [[1, 2], [30, 4], [9, 50]], "reference are at 2 places"),
        ([[1, 2], [30, 4], [9, 50]], [[1, 2], [30, 4], [1, 2]], "frame are at 2 places"),
        (
            [[0, 0], [10, 10.1], [30, 30], [50, 50]],
            [[1, 2], [30, 4], [9, 50], [4, 4]],
            "4 .*reference .*line",
        ),
        ([[1, 2], [30, 4], [9, 50]], [[0, 0], [10, 10], [30, 30]], "frame lie on one line"),
        ([[1, 2], [30, np.nan], [9, 50]], [[1, 2], [30, 4], [9, 50]], "reference .*not finite"),
        ([[1, 2], [30, 4], [9, 50]], [[1, 2], [30, 4], [9, np.inf]], "frame .*not finite"),
        ([[1, 2, 3]], [[1, 2, 3]], r"\(1, 3\)"),
        ([1, 2], [1, 2], r"\(2,\)"),
        (np.zeros((0, 2)), np.zeros((0, 2)), "at 0 places"),
    ],
)
def test_landmarks_without_a_spline_are_refused(places, fellows, mentioned):
    with pytest.raises(BadInput, match=mentioned):
        starts.landmark_spline(np.array(places), np.array(fellows), HEIGHT, WIDTH)


def test_a_movement_larger_than_the_search_is_found_from_landmarks(picture):
    """A patch moves too far for the coarse-to-fine search."""
    height, width, side_px, far_px = 160, 160, 32, 34  # more than its own width
    still = picture(height, width, seed=2, sd_px=12.0)
    patch = 0.2 * picture(side_px, side_px, seed=5, sd_px=1.5) + np.array([0.75, 0.05, 0.05], np.float32)
    reference, frame = still.copy(), still.copy()
    reference[60 : 60 + side_px, 30 : 30 + side_px] = patch
    frame[60 : 60 + side_px, 30 + far_px : 30 + side_px + far_px] = patch
    corners = np.array([[0, 0], [159, 0], [0, 159], [159, 159]], float)
    inner = np.array([[x, y] for x in (31, 45, 60) for y in (61, 75, 90)], float)
    moved = inner + np.array([far_px, 0])
    spline = starts.landmark_spline(np.vstack([corners, inner]), np.vstack([corners, moved]), height, width)
    to_frame = multiscale.method(presets.BALANCED)(reference)
    mask = np.zeros((height, width), np.float32)
    mask[62:90, 32:60] = 1
    name, flow = starts._best_start(to_frame, reference, frame, {"none": None, "landmarks": spline}, mask)
    assert name == "landmarks"
    found_px, alone_px = (
        np.median(each.displacement[62:90, 32:60, 0]) for each in (flow, to_frame(frame, None))
    )
    assert found_px == pytest.approx(far_px, abs=4) and alone_px < far_px / 2


def test_an_approximate_inverse_stays_finite_where_the_field_folds():
    wild = np.random.default_rng(0).uniform(-90, 90, (48, 64, 2)).astype(np.float32)
    assert np.isfinite(_approximate_inverse(wild)).all()
    there = np.broadcast_to(np.float32([3, -2]), (48, 64, 2)).copy()
    assert_allclose(_approximate_inverse(there), -there, atol=1e-5)
