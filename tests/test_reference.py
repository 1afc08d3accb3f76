"""Laws of choosing a reference: who explains the others least is not chosen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace import warp
from morphspace.flow.baselines import dis_medium
from morphspace.reference import (
    CANDIDATES,
    SMALL_SIDE_PX,
    WARPED_SHARE,
    candidate_indices,
    score_candidates,
    shrunk,
)


@pytest.mark.parametrize("count", [1, 2, 3, CANDIDATES, CANDIDATES + 1, 57, 5000])
def test_candidates_are_spread_evenly_from_the_first_to_the_last_frame(count):
    indices = candidate_indices(count)
    assert indices == sorted(set(indices))
    assert len(indices) == min(count, CANDIDATES)
    assert indices[0] == 0
    assert indices[-1] == count - 1
    if count > 1:
        steps = np.diff(indices)
        assert steps.max() - steps.min() <= 1


def test_shrinking_keeps_the_shape_and_the_mean(picture):
    image, mask = picture(240, 200), np.zeros((240, 200), np.float32)
    mask[60:180, 50:150] = 1
    small, small_mask = shrunk(image, mask)
    assert small.shape == (120, SMALL_SIDE_PX, 3)
    assert small_mask.shape == (120, SMALL_SIDE_PX)
    assert_allclose(small.mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=1e-5)
    assert small_mask.mean() == pytest.approx(0.25)


def test_small_frames_are_not_enlarged(picture):
    image, mask = picture(48, 40), np.ones((48, 40), np.float32)
    small, _ = shrunk(image, mask)
    assert_allclose(small, image, atol=1e-6)


def test_equal_frames_have_no_error(picture):
    image, mask = picture(60, 50), np.ones((60, 50), np.float32)
    assert_allclose(list(score_candidates([image, image.copy(), image.copy()], mask)), 0, atol=1e-4)
    assert list(score_candidates([image], mask)) == [0.0]


def test_a_score_is_what_the_reference_lacks_and_what_the_warp_destroys(clip):
    mask = np.random.default_rng(0).uniform(0, 1, clip.pictures[0].shape[:2]).astype(np.float32)
    reference, frame = clip.pictures[0], clip.pictures[3]
    field = dis_medium(reference, frame)
    texture = warp.sample(frame, field)
    lacks, destroyed = (
        np.sqrt(np.average(np.square(difference).mean(axis=2), weights=mask))
        for difference in (texture - reference, warp.render(texture, field) - frame)
    )
    score = next(score_candidates([reference, frame], mask))
    assert score == pytest.approx(destroyed + WARPED_SHARE * lacks, rel=1e-3)


def test_the_frame_that_shows_something_else_scores_worst(picture, clip):
    mask = np.ones(clip.pictures[0].shape[:2], np.float32)
    images = [*clip.pictures[:4], picture(*mask.shape, seed=70)]
    scores = list(score_candidates(images, mask))
    assert np.argmax(scores) == 4
    assert scores[4] > 2 * max(scores[:4])


def test_what_lies_outside_the_mask_does_not_count(picture, clip):
    height, width = clip.pictures[0].shape[:2]
    mask = np.zeros((height, width), np.float32)
    mask[: height // 2] = 1
    base = picture(height, width)
    below = base.copy()
    below[-10:] = 1 - below[-10:]
    above = base.copy()
    above[10:20] = 1 - above[10:20]
    (hidden, _), (seen, _) = (list(score_candidates([base, other], mask)) for other in (below, above))
    assert hidden < 0.05 * seen


def test_the_middle_of_a_movement_explains_its_ends_better_than_they_each_other(clip, picture):
    base = picture(80, 64, seed=4, sd_px=1.5)
    y, x = np.mgrid[:80, :64]
    bump = np.exp(-(((x - 32) / 12) ** 2) - ((y - 45) / 12) ** 2)
    images = [
        warp.render(base, np.stack([0 * bump, amount * bump], axis=-1).astype(np.float32))
        for amount in (-5.0, -2.5, 0.0, 2.5, 5.0)
    ]
    scores = list(score_candidates(images, np.ones((80, 64), np.float32)))
    assert np.argmin(scores) == 2
