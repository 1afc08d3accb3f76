"""Laws of choosing a reference: who shows what the hardest frames show, and among those, whose mouth is half open."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.expression import distance_from_neutral, expression_of
from morphspace.face.regions import face_mask
from morphspace.flow.baselines import LUMA, dis_medium, smoothed
from morphspace.grid import warp
from morphspace.model.reference import (
    SmallFrame,
    _mouth_contrast,
    nearest_to_neutral,
    reason_of,
    search,
    shrunk,
    spread,
)
from morphspace.steps import Step, result_of

# What the module documents, written out: a constant of it that changes fails a test here.
POOL, TARGETS, CANDIDATES, HALF_OPEN = 120, 14, 20, 10
HARDEST, SMALL_SIDE_PX, ABOUT_EQUAL = 0.25, 100, 1.05

HEIGHT = 24
STRIP_PX = 5
TINT = (
    np.array([0.114, 0.0, -0.299]) / 0.299
)  # a colour without luma: the flow, which sees grey, leaves it alone


def tinted(amounts):
    """Grey pictures (h, w, 3) with k vertical strips, brightened by each row of amounts (n, k) in [-0.45, 0.45]."""
    pictures = []
    for row in np.atleast_2d(amounts):
        strips = np.repeat(row, STRIP_PX)
        flat = 0.45 + strips[None, :, None] * TINT
        pictures.append(np.repeat(flat, HEIGHT, axis=0).astype(np.float32))
    return pictures


def distances(amounts):
    """The photometric error (n, n) between pictures of `tinted`: the colour difference, as nothing moves."""
    square = np.square(amounts[:, None] - amounts[None]).mean(axis=2)
    return np.sqrt(square * np.square(TINT).mean())


def everywhere(images):
    return np.ones(images[0].shape[:2], np.float32)


def found_in(images, contrasts, mask=None, on_step=None):
    return result_of(search(small_frames(images, contrasts, mask)), on_step)


def small_frames(images, contrasts, mask=None):
    mask = everywhere(images) if mask is None else mask
    return [SmallFrame(image, mask, float(one)) for image, one in zip(images, contrasts, strict=True)]


def errors_in(images, mask=None):
    """The error of each image by its place; all are candidates."""
    assert len(images) <= TARGETS
    _, errors = found_in(images, np.linspace(0, 1, len(images)), mask)
    return np.array([errors[place] for place in range(len(images))])


# which frames are looked at


@pytest.mark.parametrize("most", [TARGETS, CANDIDATES, POOL])
@pytest.mark.parametrize("count", [1, 2, 3, 14, 15, 20, 21, 57, 120, 121, 5000])
def test_places_are_spread_evenly_from_the_first_to_the_last_frame(count, most):
    places = spread(count, most)
    assert places == sorted(set(places))
    assert len(places) == min(count, most)
    assert places[0] == 0
    assert places[-1] == count - 1
    if count > 1:
        steps = np.diff(places)
        assert steps.max() - steps.min() <= 1


def test_evenly_spread_frames_are_tried_and_then_those_nearest_to_half_open():
    count = 60
    contrasts = np.random.default_rng(2).permutation(np.linspace(3.0, 7.0, count))
    steps = []
    _, errors = found_in(tinted(np.zeros((count, 4))), contrasts, on_step=steps.append)
    first = spread(count, CANDIDATES)
    rest = sorted(set(range(count)) - set(first), key=lambda place: abs(contrasts[place] - 5.0))
    assert list(errors) == first + rest[:HALF_OPEN]
    total = CANDIDATES + HALF_OPEN
    assert steps == [Step("reference", done + 1, total) for done in range(total)]


def test_a_half_open_mouth_between_the_evenly_spread_frames_is_found():
    count, between = 60, 38
    assert between not in spread(count, CANDIDATES)
    contrasts = np.where(np.arange(count) % 2, 0.9, 0.1)
    contrasts[between] = 0.48
    place, _ = found_in(tinted(np.zeros((count, 4))), contrasts)
    assert place == between


def test_shrinking_keeps_the_shape_and_the_mean(picture):
    image = picture(240, 200)
    small = shrunk(image, None)
    assert small.image.shape == (120, SMALL_SIDE_PX, 3)
    assert small.mask.shape == (120, SMALL_SIDE_PX)
    assert_allclose(small.image.mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=1e-5)
    assert small.mask.mean() == pytest.approx(face_mask(240, 200).mean(), abs=1e-5)


def test_small_frames_are_not_enlarged(picture):
    image = picture(48, 40)
    small = shrunk(image, None)
    assert_allclose(small.image, image, atol=1e-6)
    assert small.mask.shape == (48, 40)


# the error


def test_the_error_of_a_pair_is_what_the_warped_frame_misses(clip):
    mask = np.random.default_rng(0).uniform(0, 1, clip.pictures[0].shape[:2]).astype(np.float32)
    reference, frame = clip.pictures[0], clip.pictures[3]

    def missed(*pictures):
        one, other, weights = map(np.ascontiguousarray, pictures)
        difference = warp.sample(other, smoothed(dis_medium(one, other))) - one
        return np.sqrt(np.average(np.square(difference).mean(axis=2), weights=weights))

    missing = []
    for pair in ((reference, frame, mask), (frame, reference, mask)):
        missing.append((missed(*pair) + missed(*(one[:, ::-1] for one in pair))) / 2)
    assert_allclose(errors_in([reference, frame], mask), missing, rtol=1e-4)


def test_what_only_moves_is_reached(picture, wavy_field):
    still = picture(80, 64, seed=4, sd_px=3.0)
    for seed in range(3):
        moved = warp.render(still, wavy_field(80, 64, 3.0, seed, sd_px=12.0))
        unwarped = np.sqrt(np.square(moved - still).mean())
        assert errors_in([still, moved]).max() < 0.3 * unwarped


@pytest.mark.parametrize("count", [2, 3, 6, 14, 40])
def test_the_error_of_a_candidate_is_the_mean_over_the_hardest_quarter(count):
    amounts = np.random.default_rng(count).uniform(-0.4, 0.4, (count, 6))
    pairs = distances(amounts)
    _, errors = found_in(tinted(amounts), np.linspace(0, 1, count))
    for place, error in errors.items():
        missing = sorted(pairs[place, other] for other in spread(count, TARGETS) if other != place)
        hardest = missing[-max(1, round(HARDEST * len(missing))) :]
        assert error == pytest.approx(np.mean(hardest), rel=1e-4)


def test_a_frame_that_is_fine_for_most_but_bad_for_the_hard_ones_loses():
    amounts = np.zeros((TARGETS, 4))
    amounts[[3, 7, 11]] = 0.4  # the hard ones; ten others are all alike
    between = 5
    amounts[between] = 0.2
    pairs = distances(amounts)
    assert pairs.mean(axis=1).argmin() != between  # for most frames, and on average, another would do better
    contrasts = np.linspace(0.2, 0.8, TARGETS)
    contrasts[between] = 0.0  # nor does its mouth speak for it
    place, errors = found_in(tinted(amounts), contrasts)
    assert place == between
    assert errors[between] == pytest.approx(0.5 * errors[0], rel=1e-4)


def test_the_frame_that_lacks_what_others_show_has_the_largest_error(picture, wavy_field):
    face = picture(72, 60, seed=1, sd_px=3.0)
    eyed = face.copy()
    for column in (18, 40):
        eyed[24:32, column - 6 : column + 6] = 0.02
        eyed[26:30, column - 2 : column + 2] = 0.95
    lacking = 4
    images = [
        warp.render(face if index == lacking else eyed, wavy_field(72, 60, 2.0, seed=index))
        for index in range(10)
    ]
    errors = errors_in(images)
    others = np.delete(errors, lacking)
    assert errors[lacking] > 1.3 * others.max()


def test_the_frame_that_shows_something_else_has_the_largest_error(picture, clip):
    images = [*clip.pictures, picture(*clip.pictures[0].shape[:2], seed=70)]
    errors = errors_in(images)
    assert errors[-1] > 1.3 * errors[:-1].max()


def test_what_lies_outside_the_mask_does_not_count():
    amounts = np.random.default_rng(5).uniform(-0.4, 0.4, (8, 6))
    images = tinted(amounts)
    mask = everywhere(images)
    mask[:, 2 * STRIP_PX :] = 0
    other = amounts.copy()
    other[:, 2:] = np.random.default_rng(6).uniform(-0.4, 0.4, (8, 4))
    assert_allclose(errors_in(tinted(other), mask), errors_in(images, mask), atol=1e-6)
    assert_allclose(errors_in(images, mask), errors_in(tinted(amounts[:, :2].repeat(3, 1))), atol=1e-6)
    assert np.abs(errors_in(tinted(other)) - errors_in(images)).max() > 0.01


def test_half_a_mask_counts_half():
    amounts = np.array([[0.0, 0.0, 0.0, 0.0], [0.4, 0.4, 0.0, 0.0]])
    images = tinted(amounts)
    mask = everywhere(images)
    mask[:, : 2 * STRIP_PX] = 0.5
    full = distances(amounts)[0, 1]  # half of the picture differs; of the mask's weight a third
    assert_allclose(errors_in(images, mask), full * np.sqrt(2 / 3), rtol=1e-4)


def test_the_middle_of_a_movement_reaches_its_ends_better_than_they_each_other(picture):
    base = picture(80, 64, seed=4, sd_px=1.5)
    y, x = np.mgrid[:80, :64]
    bump = np.exp(-(((x - 32) / 12) ** 2) - ((y - 45) / 12) ** 2)
    images = [
        warp.render(base, np.stack([0 * bump, amount * bump], axis=-1).astype(np.float32))
        for amount in (-5.0, -2.5, 0.0, 2.5, 5.0)
    ]
    errors = errors_in(images)
    assert errors.argmin() == 2
    assert errors[2] < 0.9 * min(errors[0], errors[4])


# the choice


def equally_far(longer=1.0):
    """Amounts (TARGETS, TARGETS): each picture has its own strip, so all distances are equal, but for place 6."""
    amounts = 0.2 * np.eye(TARGETS)
    amounts[6] *= longer
    return amounts


@pytest.mark.parametrize("seed", range(5))
def test_among_equal_frames_the_mouth_nearest_to_half_of_the_range_wins(seed):
    contrasts = np.random.default_rng(seed).gamma(
        1.0, 0.1, TARGETS
    )  # skewed: the mean and median lie elsewhere
    place, _ = found_in(tinted(equally_far()), contrasts)
    middle = np.percentile(contrasts, [5, 95]).mean()  # robust ends of the range
    assert place == np.abs(contrasts - middle).argmin()


@pytest.mark.parametrize("longer", [1.08, 2.0])
def test_half_open_wins_where_it_is_about_equal_and_never_where_it_is_clearly_worse(longer):
    contrasts = np.linspace(0, 1, TARGETS)
    contrasts[6], second = 0.5, 7
    place, errors = found_in(tinted(equally_far(longer)), contrasts)
    ratio = errors[6] / min(errors.values())
    assert 1.01 < ratio < ABOUT_EQUAL or ratio > 1.2
    assert place == (6 if ratio < ABOUT_EQUAL else second)


def test_of_frames_with_faces_the_one_nearest_to_neutral_with_parted_lips_is_taken(drawn_anna):
    faces = [None, *(drawn_anna.points(jaw_open=amount) for amount in (0.0, 0.15, 0.9))]
    place, reason = nearest_to_neutral(faces)
    assert place == int(np.argmin(distance_from_neutral(faces))) == 2
    opening = expression_of(faces[2]).mouth_opening
    assert reason == (
        f"chosen from 4 frames: its face is nearest to neutral with parted lips (they are {opening:.2f} eye distances "
        "apart)"
    )
    with pytest.raises(BadInput, match="no frame shows a face"):
        nearest_to_neutral([None, None])


def test_the_chosen_frame_is_about_as_good_as_the_best(clip):
    for seed in range(6):
        contrasts = np.random.default_rng(seed).uniform(0, 1, len(clip.pictures))
        place, errors = found_in(list(clip.pictures), contrasts)
        assert errors[place] <= ABOUT_EQUAL * min(errors.values())


def test_mirrored_frames_give_the_same_choice_and_the_same_errors(clip):
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in clip.pictures]
    contrasts = np.arange(len(clip.pictures), dtype=np.float64)
    assert found_in(mirrored, contrasts) == found_in(list(clip.pictures), contrasts)


def test_the_same_frames_give_the_same_choice_and_the_same_bits(clip):
    contrasts = np.random.default_rng(1).uniform(0, 1, len(clip.pictures))
    one, other = (found_in(list(clip.pictures), contrasts) for _ in range(2))
    assert one[0] == other[0]
    assert list(one[1].items()) == list(other[1].items())


def test_one_frame_is_its_own_reference(clip):
    assert found_in([clip.pictures[0]], [0.3]) == (0, {0: 0.0})


def test_of_two_frames_one_is_the_reference(clip):
    place, errors = found_in(list(clip.pictures[:2]), [0.1, 0.3])
    assert place in (0, 1)
    assert set(errors) == {0, 1}
    assert min(errors.values()) > 0


def test_of_a_clip_that_does_not_change_the_first_frame_is_the_reference(clip):
    images = [clip.pictures[0].copy() for _ in range(40)]
    place, errors = found_in(images, np.full(40, 0.2))
    assert place == 0
    assert len(errors) == CANDIDATES + HALF_OPEN
    assert max(errors.values()) < 1e-4


# the mouth


def test_mouth_contrast_is_the_sd_of_luma_in_the_region(picture):
    image, region = picture(40, 50), np.zeros((40, 50), np.float32)
    region[10:20, 5:30] = 1
    luma = image.astype(np.float64) @ LUMA.astype(np.float64)
    assert _mouth_contrast(image, region) == pytest.approx(luma[10:20, 5:30].std(), rel=1e-4)


def test_mouth_contrast_is_zero_for_closed_lips_and_half_for_half_dark_half_white():
    region = np.ones((20, 30), np.float32)
    image = np.full((20, 30, 3), 0.6, np.float32)
    assert _mouth_contrast(image, region) == pytest.approx(0, abs=1e-6)
    image[:10], image[10:] = 0, 1
    assert _mouth_contrast(image, region) == pytest.approx(0.5, rel=1e-5)
    assert _mouth_contrast(image, 0 * region) == 0.0


def test_colour_alone_and_what_lies_outside_the_region_are_no_mouth_contrast(picture):
    (image,) = tinted(np.array([0.4, -0.4, 0.2, 0.0]))
    assert _mouth_contrast(image, everywhere([image])) == pytest.approx(0, abs=1e-6)
    outside, region = picture(40, 50), np.zeros((40, 50), np.float32)
    region[10:20, 5:30] = 1
    changed = np.where(region[..., None] > 0.5, outside, 1 - outside)
    assert_array_equal(_mouth_contrast(changed, region), _mouth_contrast(outside, region))


def test_the_reason_has_the_figures_of_the_choice_and_its_limit():
    words = reason_of(7, {3: 0.02, 7: 0.0205, 9: 0.5})
    for figure in (
        "3 candidates",
        "by 0.0205",
        "best candidate has 0.0200",
        "worst 0.5000",
        "within 5% of",
        "half open",
    ):
        assert figure in words
