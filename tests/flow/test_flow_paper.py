"""Laws of the reconstructed flow of Nagle et al.: zero, direction and gain, and only finite numbers."""

import warnings

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow import paper
from morphspace.grid import warp

HEIGHT, WIDTH = 96, 80


def moved(picture, seed, right=3, down=-2):
    """Draw a texture and its copy moved `right` and `down` px."""
    canvas = picture(HEIGHT + 10, WIDTH + 10, seed=seed, sd_px=2.0)
    rows, columns = slice(5 - down, HEIGHT + 5 - down), slice(5 - right, WIDTH + 5 - right)
    return np.ascontiguousarray(canvas[5:-5, 5:-5]), np.ascontiguousarray(canvas[rows, columns])


def distance(field, truth):
    return np.hypot(*np.moveaxis(field - truth, -1, 0))


def test_flow_of_a_picture_with_itself_is_zero_with_confidence(picture):
    image = picture(HEIGHT, WIDTH)
    flow = paper.method(image)(image, None)
    assert flow.displacement.shape == (HEIGHT, WIDTH, 2)
    assert flow.displacement.dtype == flow.confidence.dtype == np.float32
    assert_array_equal(flow.displacement, 0)
    assert flow.confidence.min() > 0.99


@pytest.mark.parametrize(("right", "down"), [(3, -2), (-1, 0), (0, 5)])
def test_a_translation_of_a_texture_is_found(picture, right, down):
    for seed in (0, 1):
        reference, frame = moved(picture, seed, right, down)
        flow = paper.method(reference)(frame, None)
        miss = distance(flow.displacement, (right, down))[15:-15, 15:-15]
        assert np.median(miss) < 0.2  # px; measured: up to 0.13
        assert np.percentile(miss, 95) < 0.5
        assert flow.confidence[15:-15, 15:-15].mean() > 0.95


def test_a_known_warp_is_found(picture, wavy_field):
    reference, truth = picture(HEIGHT, WIDTH, 3), wavy_field(HEIGHT, WIDTH, 2.5, seed=1, sd_px=12)
    flow = paper.method(reference)(warp.render(reference, truth), None)
    assert np.median(distance(flow.displacement, truth)[10:-10, 10:-10]) < 0.25  # px


def test_gain_and_offset_of_both_pictures_change_nothing(picture):
    reference, frame = moved(picture, 1)
    before = paper.method(reference)(frame, None)
    for gain, offset in ((0.1, 0.0), (2.0, 0.3), (300.0, -100.0)):
        lit = [np.float32(gain) * image + np.float32(offset) for image in (reference, frame)]
        after = paper.method(lit[0])(lit[1], None)
        assert_allclose(after.displacement, before.displacement, atol=1e-3)  # px; float32
        assert_allclose(after.confidence, before.confidence, atol=1e-4)


def test_texture_fills_flat_regions_and_is_not_diluted(picture):
    image = picture(HEIGHT, WIDTH)[..., 1] - np.float32(0.5)
    half = WIDTH // 2
    image[:, half:] = 0  # flat, without measurable motion
    step = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    step[:, :half] = 2
    carried = paper._filled(step, image)[..., 0].mean(axis=0)
    assert carried[half - 1] > 1.5  # px; with equal weights 1.07
    assert carried[half:].sum() > 10  # with equal weights 4.6


def test_filling_a_flat_picture_keeps_a_constant_field():
    step = np.full((HEIGHT, WIDTH, 2), 1.5, np.float32)
    assert_allclose(paper._filled(step, np.zeros((HEIGHT, WIDTH), np.float32)), 1.5, rtol=1e-4)


def test_a_start_is_ignored(picture):
    reference, frame = moved(picture, 2)
    to_frame = paper.method(reference)
    start = np.full((HEIGHT, WIDTH, 2), 7, np.float32)
    assert_array_equal(to_frame(frame, start).displacement, to_frame(frame, None).displacement)
    assert_array_equal(start, 7)


KINDS = ("noise", "dark", "white", "black", "dot", "step", "stripes", "isoluminant", "ramp", "huge")


def drawn(kind, height, width, rng):
    noise = rng.random((height, width, 3)).astype(np.float32)
    image = np.zeros_like(noise)
    match kind:
        case "noise":
            return noise
        case "dark":
            return noise * np.float32(0.004)
        case "huge":
            return (noise - np.float32(0.5)) * 2000
        case "white":
            return image + 1
        case "dot":
            image[height // 2, width // 2] = 1
        case "step":
            image[:, width // 2 :] = 1
        case "stripes":
            image[:, ::2] = 1
        case "isoluminant":
            image[:, : width // 2, 0] = 1
            image[:, width // 2 :, 1] = 0.299 / 0.587
        case "ramp":
            image += np.linspace(0, 1, width, dtype=np.float32)[:, None]
    return image


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    st.integers(16, 70),
    st.integers(16, 70),
    st.sampled_from(KINDS),
    st.sampled_from(KINDS),
    st.integers(0, 99),
)
@example(16, 16, "noise", "noise", 0)
@example(16, 400, "noise", "step", 0)
@example(400, 16, "dot", "noise", 0)
@example(33, 47, "huge", "dark", 0)
def test_any_two_pictures_give_finite_numbers(height, width, one, other, seed):
    rng = np.random.default_rng(seed)
    with np.errstate(divide="raise", invalid="raise", over="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        flow = paper.method(drawn(one, height, width, rng))(drawn(other, height, width, rng), None)
    assert flow.displacement.shape == (height, width, 2)
    assert np.isfinite(flow.displacement).all()
    assert flow.confidence.shape == (height, width)
    assert 0 <= flow.confidence.min() <= flow.confidence.max() <= 1  # and not NaN


@pytest.mark.parametrize("nothing", ["white", "black", "isoluminant"])
def test_flow_and_confidence_of_flat_pictures_are_zero(picture, nothing):
    flat = drawn(nothing, HEIGHT, WIDTH, np.random.default_rng(0))
    for one, other in ((flat, picture(HEIGHT, WIDTH)), (picture(HEIGHT, WIDTH), flat)):
        flow = paper.method(one)(other, None)
        assert_array_equal(flow.displacement, 0)
        assert_array_equal(flow.confidence, 0)


def test_pictures_that_cannot_be_used_are_refused(picture):
    image, small = picture(HEIGHT, WIDTH), picture(15, 40)
    with pytest.raises(BadInput, match=r"the reference has 40x15 px"):
        paper.method(small)
    with pytest.raises(SizeMismatch):
        paper.method(image)(picture(WIDTH, HEIGHT), None)
    broken = image.copy()
    broken[3, 4, 1] = np.nan
    with pytest.raises(BadInput, match="not finite"):
        paper.method(image)(broken, None)
