"""Laws of the constraints: distances in px without contrast, and raw values only under constant light."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.flow.backends import OpenCVBackend
from morphspace.flow.constraints import (
    MOST_MISMATCH_PX,
    Channels,
    appearance,
    half_derivatives,
    mismatch,
    of_order,
    outside,
    tensor,
)
from morphspace.flow.filters import gaussian_derivative, up_to

CV = OpenCVBackend()
HEIGHT, WIDTH = 64, 72
CODES = 255.0
ORDER_0 = Channels(weights=(1.0,), sd_px=0.7, noise_codes=2.0, light_codes=3.0)
ORDERS_12 = Channels(weights=(0.0, 1.0, 1.0), sd_px=0.7, noise_codes=1e-3, light_codes=3.0)
ALL = Channels(weights=(0.3, 1.0, 1.0), sd_px=0.7, noise_codes=2.0, light_codes=3.0)
PARTS = ("xx", "yy", "xy", "xt", "yt", "tt")
INNER = np.s_[8:-8, 8:-8]  # beyond the reach of the filters from the edge


def codes_of(image):
    """Return the planes (c, h, w) of a picture (h, w, c)."""
    return np.ascontiguousarray(image.transpose(2, 0, 1) * np.float32(CODES))


def between(one, other, channels):
    """Compute the tensor of two pictures (c, h, w)."""
    halves = (half_derivatives(CV, np.float32(planes), channels) for planes in (one, other))
    return tensor(CV, *halves, channels, one.shape)


def waves(right=0.0, down=0.0, seed=0):
    """Draw three colours of five waves (3, h, w) of at least 14 px, with their content moved right and down."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    planes = np.full((3, HEIGHT, WIDTH), 128.0)
    for plane in planes:
        for turn, length, phase in rng.uniform((0, 14, 0), (2 * np.pi, 30, 2 * np.pi), (5, 3)):
            along = (x - right) * np.cos(turn) + (y - down) * np.sin(turn)
            plane += 15 * np.sin(2 * np.pi * along / length + phase)
    return planes


# the quadratic


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.integers(16, 40),
    st.integers(16, 40),
    st.sampled_from([1, 3]),
    st.floats(-3, 3),
    st.integers(0, 99),
    st.sampled_from([ORDER_0, ORDERS_12, ALL]),
)
def test_residuals_are_not_negative(height, width, colours, contrast, seed, channels):
    rng = np.random.default_rng(seed)
    one, other = CODES * 10.0**contrast * rng.standard_normal((2, colours, height, width))
    found = between(one, other, channels)
    du, dv = (10.0 * rng.standard_normal((2, height, width))).astype(np.float32)
    scale = found.sums[0] * du**2 + found.sums[1] * dv**2 + found.sums[5] + 1
    assert (found.residual(du, dv) >= -1e-5 * scale).all()  # float32 rounding of differences
    assert (
        found.sums[0] * found.sums[1] - found.sums[2] ** 2 >= -1e-5 * (found.sums[0] + found.sums[1]) ** 2
    ).all()


@pytest.mark.parametrize("motion", [(0.5, 0.0), (0.0, -0.5), (0.3, 0.4), (-0.6, 0.2)])
def test_the_residual_of_the_true_motion_is_zero(motion):
    # the mean slope over a step s is right to (k s)^2 / 12 of it: 0.6 % for the shortest wave
    found = between(waves(), waves(*motion), ORDERS_12)
    at_zero = found.residual(np.float32(0), np.float32(0))[INNER]
    at_truth = found.residual(*np.float32(motion))[INNER]
    assert at_zero.mean() > 0.5 * np.hypot(*motion) ** 2  # px^2
    assert at_truth.mean() < 1e-4 * at_zero.mean()
    assert found.residual(*-np.float32(motion))[INNER].mean() > 3 * at_zero.mean()


def test_the_quadratic_is_least_at_the_true_motion():
    motion = np.array([0.4, -0.3])
    found = between(waves(), waves(*motion), ALL)
    xx, yy, xy, xt, yt = (part[INNER].sum(dtype=float) for part in found.sums[:5])
    solved = np.linalg.solve([[xx, xy], [xy, yy]], [-xt, -yt])
    assert_allclose(solved, motion, atol=0.01)  # px; order 0 lacks the median of its change


def test_the_residual_of_equal_pictures_is_the_motion_squared():
    found = between(waves(), waves(), ORDERS_12)
    for part in ("xt", "yt", "tt"):
        assert_array_equal(found.sums[PARTS.index(part)], 0)
    # five channels, each a distance along its own slope: half of it on average over directions
    length = found.residual(np.float32(1), np.float32(0)) + found.residual(np.float32(0), np.float32(1))
    assert_allclose(length[INNER], 5, rtol=1e-3)


def test_channels_add_up():
    one, other = waves(), waves(0.4, 0.2)
    both = between(one, other, ALL)
    zero = between(one, other, replace(ALL, weights=(0.3, 0.0, 0.0)))
    rest = between(one, other, replace(ALL, weights=(0.0, 1.0, 1.0)))
    for part in PARTS:
        sum_ = zero.sums[PARTS.index(part)] + rest.sums[PARTS.index(part)]
        assert_allclose(both.sums[PARTS.index(part)], sum_, atol=1e-5)
        assert np.abs(rest.sums[PARTS.index(part)] - sum_).max() > 0.01


def test_an_order_of_weight_zero_has_no_effect():
    one, other = waves(), waves(0.4, 0.2)
    short, long = (
        between(one, other, replace(ALL, weights=weights)) for weights in ((0.3, 1.0), (0.3, 1.0, 0.0))
    )
    for part in PARTS:
        assert_array_equal(short.sums[PARTS.index(part)], long.sums[PARTS.index(part)])


@pytest.mark.parametrize("contrast", [0.25, 4.0])
def test_contrast_cancels(contrast):
    one, other = waves(), waves(0.4, 0.2)
    before = between(one, other, ORDERS_12)
    after = between(contrast * one, contrast * other, ORDERS_12)
    for part in PARTS:  # except where a slope is below the noise floor
        apart = np.abs(after.sums[PARTS.index(part)] - before.sums[PARTS.index(part)])
        assert np.quantile(apart, 0.99) < 5e-3  # px^2


@pytest.mark.parametrize("contrast", [0.25, 4.0])
def test_contrast_and_noise_cancel_exactly(contrast):
    one, other = waves(), waves(0.4, 0.2)
    for weights in ((1.0,), (0.0, 1.0), (0.3, 1.0, 1.0)):
        channels = replace(ALL, weights=weights)
        louder = replace(
            channels,
            noise_codes=contrast * channels.noise_codes,
            light_codes=contrast * channels.light_codes,
        )
        before, after = between(one, other, channels), between(contrast * one, contrast * other, louder)
        for part in PARTS:
            assert_allclose(
                after.sums[PARTS.index(part)], before.sums[PARTS.index(part)], rtol=1e-5, atol=1e-6
            )


def test_noise_counts_less_than_texture():
    rng = np.random.default_rng(0)
    channels = replace(ORDERS_12, noise_codes=2.0)
    noise = 2.0 * rng.standard_normal((3, HEIGHT, WIDTH))
    strengths = []
    for planes in (0.2 * noise, noise, 20 * noise):
        found = between(planes, planes, channels)
        strengths.append((found.sums[0] + found.sums[1])[INNER].mean() / 5)  # per channel
    assert strengths[0] < 0.05
    assert 0.4 < strengths[1] < 0.5  # mean slopes equal to the floor: a channel counts half
    assert strengths[2] > 0.95


def test_the_noise_floor_is_the_mean_squared_slope_of_noise():
    rng = np.random.default_rng(1)
    noise = 4.0 * rng.standard_normal((2, 400, 400)).astype(np.float32)
    channels = replace(ALL, noise_codes=4.0)
    halves = half_derivatives(CV, noise, channels)
    energy = {key: 4 * float((half**2).sum(0).mean()) for key, half in zip(up_to(3), halves, strict=True)}
    floors = [floor for floors in channels.noise_floors for floor in floors]
    for (i, j), floor in zip(up_to(2), floors, strict=True):
        assert energy[i + 1, j] + energy[i, j + 1] == pytest.approx(2 * floor, rel=0.05)  # of two colours


def test_a_colour_without_contrast_adds_no_noise():
    one, other = waves()[:1], waves(0.4, 0.2)[:1]
    flat = np.full_like(one, 80.0)
    alone = between(one, other, ORDERS_12)
    beside = between(np.concatenate([one, flat]), np.concatenate([other, flat]), ORDERS_12)
    for part in PARTS:
        apart = np.abs(beside.sums[PARTS.index(part)] - alone.sums[PARTS.index(part)])
        assert np.quantile(apart, 0.99) < 5e-3  # px^2; the floor is that of two colours


def test_halves_of_two_derivatives_add_up_to_their_mean():
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    one, other = (half_derivatives(CV, plane[None], ALL) for plane in (3 * x + 5 * y, x - 7 * y))
    assert len(one) == len(up_to(3))
    for key, mean in (((1, 0), 2.0), ((0, 1), -1.0), ((1, 1), 0.0)):
        at = up_to(3).index(key)
        assert_allclose((one[at] + other[at])[0][INNER], mean, atol=1e-3)


def test_derivatives_are_ordered_by_total_order():
    assert [up_to(4)[of_order(n)] for n in range(5)] == [
        tuple((n - down, down) for down in range(n + 1)) for n in range(5)
    ]


# order 0


def test_order_0_ignores_a_constant():
    one, other = waves(), waves(0.4, 0.2)
    before, after = (between(one, other + constant, ORDER_0) for constant in (0.0, 40.0))
    assert before.sums[0][INNER].mean() > 0.2
    for part in PARTS:
        assert_allclose(after.sums[PARTS.index(part)], before.sums[PARTS.index(part)], atol=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_change_of_light_switches_order_0_off(axis):
    one = waves()
    ramp = 60 * np.linspace(-1, 1, one.shape[1 + axis])  # codes
    ramp = ramp[:, None] if axis == 0 else ramp[None]
    before, after = between(one, one, ORDER_0), between(one, one + ramp, ORDER_0)
    assert (before.sums[0] + before.sums[1])[INNER].mean() > 0.8
    assert np.quantile((after.sums[0] + after.sums[1])[INNER], 0.8) < 0.05
    for part in ("xt", "yt", "tt"):
        assert np.quantile(np.abs(after.sums[PARTS.index(part)])[INNER], 0.8) < 0.05


def test_motion_alone_leaves_order_0_on():
    found = between(waves(), waves(0.4, 0.2), ORDER_0)
    assert (found.sums[0] + found.sums[1])[INNER].mean() > 0.6


def test_higher_orders_do_not_depend_on_the_light():
    one, other = waves(), waves(0.4, 0.2)
    y, _ = np.mgrid[:HEIGHT, :WIDTH]
    ramp = 2.0 * y  # codes; over 100 in all
    before, after = between(one, other, ORDERS_12), between(one, other + ramp, ORDERS_12)
    # a ramp has no second derivatives and constant first ones: the strength is all of order 0
    strength = (after.sums[0] + after.sums[1])[INNER] / (before.sums[0] + before.sums[1])[INNER]
    assert_allclose(strength, 1, atol=1e-3)


# mismatch


def looks_of(planes, channels=ALL):
    derivatives = half_derivatives(CV, np.float32(planes), channels)
    return appearance(CV, derivatives, channels)


BLUR = gaussian_derivative(0, 1.5, radius=4)


def looked_at(reference, frame, right, down):
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    return mismatch(
        CV, looks_of(reference), looks_of(frame).slopes, x + np.float32(right), y + np.float32(down), BLUR
    )


def test_the_mismatch_is_zero_with_itself_and_grows_with_displacement(picture):
    planes = codes_of(picture(HEIGHT, WIDTH, seed=3, sd_px=2.5))
    assert_allclose(looked_at(planes, planes, 0, 0), 0, atol=1e-4)
    for right, down in ((1, 0), (0, -1)):
        step = looked_at(planes, planes, right, down)[INNER]
        assert 0.3 < np.median(step) < 1.5  # px: about 1, less along edges
    assert np.median(looked_at(planes, planes, 9, 7)[INNER]) > 1.5


def test_the_mismatch_of_a_moved_picture_is_zero_at_its_displacement(picture):
    canvas = codes_of(picture(HEIGHT + 8, WIDTH + 8, seed=4, sd_px=2.5))
    one, other = canvas[:, 4:-4, 4:-4], canvas[:, 6:-2, 1:-7]  # content goes 3 right, 2 up
    inside = np.s_[10:-10, 10:-10]
    assert looked_at(one, other, 3, -2)[inside].max() < 1e-3
    assert np.median(looked_at(one, other, -3, 2)[inside]) > 1.5


def test_a_constant_light_does_not_change_the_mismatch(picture):
    planes = codes_of(picture(HEIGHT, WIDTH, seed=3, sd_px=2.5))
    assert_allclose(looked_at(planes, planes + 30, 0, 0), 0, atol=1e-3)


def test_the_mismatch_is_largest_outside_the_frame(picture):
    planes = codes_of(picture(HEIGHT, WIDTH, seed=3, sd_px=2.5))
    found = looked_at(planes, planes, WIDTH, 0)
    assert_allclose(found, MOST_MISMATCH_PX, rtol=1e-5)
    with np.errstate(all="ignore"):
        found = looked_at(planes, planes, np.inf, 0)
    assert_allclose(found, MOST_MISMATCH_PX, rtol=1e-5)


def test_the_outside_begins_beyond_the_outermost_pixel_centres():
    x = np.array([[0, -0.01, 8, 8.01, 4, 4]], np.float32)
    y = np.array([[0, 3, 5, 3, 5.01, -0.01]], np.float32)
    assert_array_equal(outside(x, y, 6, 9), [[False, True, False, True, True, True]])
