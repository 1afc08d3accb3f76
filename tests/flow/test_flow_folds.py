"""Laws of unfolding: no cell is flipped, ordered fields stay, and pixels far from a fold do not change."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.flow.folds import FIRST_SD_PX, LEAST_DETERMINANT, REACH_SD, suspects_when_enlarged, unfolded
from morphspace.flow.methods import METHODS
from morphspace.grid import warp
from morphspace.synthetic.warped import astronaut_face, flow_pair


def torn(height, width, right_px, left_px):
    """Draw a field (h, w, 2) of two halves that cross: the left one moves right, the right one left."""
    field = np.zeros((height, width, 2), np.float32)
    field[:, : width // 2, 0], field[:, width // 2 :, 0] = right_px, -left_px
    return field


@pytest.mark.parametrize("seed", range(4))
def test_a_field_without_folds_is_unchanged(wavy_field, seed):
    field = wavy_field(60, 50, 4.0, seed=seed, sd_px=9.0)
    assert warp.determinants(field).min() > LEAST_DETERMINANT
    before = field.copy()
    assert unfolded(field) is field
    assert_array_equal(field, before)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.integers(9, 60),
    st.integers(9, 60),
    st.floats(1.03, 4),
    st.floats(0.5, 4),
    st.floats(0.1, 8),
    st.integers(0, 10**6),
)
def test_an_enlarged_field_folds_among_the_suspects_alone(
    wavy_field, height, width, ratio, sd_px, amplitude_px, seed
):
    field = np.ascontiguousarray(
        wavy_field(height, width, amplitude_px, seed=seed, sd_px=sd_px).transpose(2, 0, 1)
    )
    tall, wide = round(height * ratio), round(width * ratio)
    large = np.stack(
        [
            cv2.resize(field[0], (wide, tall), interpolation=cv2.INTER_LINEAR) * (wide / width),
            cv2.resize(field[1], (wide, tall), interpolation=cv2.INTER_LINEAR) * (tall / height),
        ],
        axis=-1,
    ).astype(np.float32)
    suspects = suspects_when_enlarged(field, tall, wide)
    determinants = warp.determinants(large)
    if suspects is None:
        assert unfolded(large) is large
    else:
        assert_array_equal(unfolded(large, suspects), unfolded(large))
        suspects.cells().of(determinants)[...] = 1
    assert determinants.min() >= LEAST_DETERMINANT - 1e-4


def test_a_gentle_field_has_no_suspects_and_a_torn_one_few(wavy_field):
    gentle = wavy_field(60, 50, 3.0, seed=1, sd_px=12.0).transpose(2, 0, 1)
    assert suspects_when_enlarged(np.ascontiguousarray(gentle), 120, 100) is None
    field = np.zeros((2, 60, 50), np.float32)
    field[0, 20:24, 25], field[0, 20:24, 24] = -4, 4
    box = suspects_when_enlarged(field, 120, 100)
    assert box is not None
    assert box.top >= 30
    assert box.bottom <= 58
    assert box.left >= 36
    assert box.right <= 64


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(16, 110), st.integers(16, 110), st.floats(1, 15), st.floats(0.5, 60), st.integers(0, 10**6)
)
def test_any_smooth_field_is_unfolded(wavy_field, height, width, sd_px, amplitude_px, seed):
    field = wavy_field(height, width, amplitude_px, seed=seed, sd_px=sd_px)
    before = field.copy()
    result = unfolded(field)
    assert result.dtype == np.float32
    assert result.shape == field.shape
    assert warp.determinants(result).min() >= LEAST_DETERMINANT
    assert np.abs(result).max() <= amplitude_px * (1 + 1e-5)  # means of the values
    assert_array_equal(field, before)  # the input is unchanged


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.integers(16, 80), st.integers(16, 80), st.floats(0.5, 20), st.integers(0, 10**6))
def test_noise_is_unfolded(height, width, sd_px, seed):
    field = sd_px * np.random.default_rng(seed).standard_normal((height, width, 2))
    assert warp.determinants(unfolded(field.astype(np.float32))).min() >= LEAST_DETERMINANT


@pytest.mark.parametrize("apart_px", [1.0, 2.0, 6.0, 12.0])
def test_two_sheets_that_cross_are_put_in_order(apart_px):
    field = torn(64, 96, apart_px / 2, apart_px / 2)
    result = unfolded(field)
    assert warp.determinants(field).min() < LEAST_DETERMINANT <= warp.determinants(result).min()
    assert (np.diff(result[..., 0], axis=1) <= 1e-5).all()  # one ordered step from right to left
    assert_allclose(result[..., 1], 0, atol=1e-6)


def test_what_lies_far_from_a_fold_is_unchanged(wavy_field):
    field = wavy_field(120, 120, 3.0, seed=1, sd_px=12.0)
    assert warp.determinants(field).min() > LEAST_DETERMINANT
    folded = field.copy()
    folded[58:62, 60] += (3.0, 0.0)
    assert warp.determinants(folded).min() < 0
    result = unfolded(folded)
    assert warp.determinants(result).min() >= LEAST_DETERMINANT
    y, x = np.mgrid[:120, :120]
    far = np.hypot(x - 60, y - 60) > 12
    assert_array_equal(result[far], field[far])
    near = np.hypot(x - 60, y - 60) < REACH_SD * FIRST_SD_PX
    assert np.abs(result - folded)[near].max() > 0.5


def test_a_fold_at_the_border_is_removed():
    for edge in (np.s_[0, 20], np.s_[-1, 20], np.s_[20, 0], np.s_[20, -1]):
        field = np.zeros((40, 40, 2), np.float32)
        field[edge] = (5.0, 5.0) if edge[0] == 0 or edge[1] == 0 else (-5.0, -5.0)
        assert warp.determinants(field).min() < 0
        assert warp.determinants(unfolded(field)).min() >= LEAST_DETERMINANT


def test_turned_and_transposed_fields_are_unfolded_alike(wavy_field):
    """Mirrored fields differ: a mirror exchanges the diagonal along which cells are split."""
    field = wavy_field(60, 50, 14.0, seed=2, sd_px=6.0)
    result = unfolded(field)
    assert_allclose(-unfolded(np.ascontiguousarray(-field[::-1, ::-1]))[::-1, ::-1], result, atol=1e-3)
    transposed = np.ascontiguousarray(field.transpose(1, 0, 2)[..., ::-1])
    assert_allclose(unfolded(transposed).transpose(1, 0, 2)[..., ::-1], result, atol=1e-3)


@pytest.mark.parametrize("name", ["fast", "balanced", "accurate"])
@pytest.mark.parametrize("seed", [0, 2])
def test_a_mouth_that_opens_or_closes_does_not_tear(name, seed):
    photograph, marks = astronaut_face()
    pair = flow_pair(photograph, marks, kind="mouth", peak_px=8.0, seed=seed, size=128)
    for one, other in ((pair.reference, pair.frame), (pair.frame, pair.reference)):
        assert warp.determinants(METHODS[name](one)(other, None).displacement).min() >= LEAST_DETERMINANT
