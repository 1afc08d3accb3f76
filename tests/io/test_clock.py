"""Laws of frame times: even recordings are left alone, others are sampled by their times."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.io.clock import (
    even_positions,
    evenly_sampled,
    frames_shown,
    is_even,
    sampled_at,
)


def test_resampling_keeps_what_is_linear_and_the_rate_it_has():
    ramp = np.column_stack([np.arange(11.0), -np.arange(11.0)])

    def resampled(rate_hz, to_hz):
        return sampled_at(ramp, even_positions(np.arange(11) / rate_hz, to_hz))

    assert_allclose(resampled(25, 50)[:, 0], np.arange(21) / 2)
    assert_array_equal(resampled(25, 25), ramp)
    assert_allclose(resampled(30, 25)[:, 0], np.arange(9) * 1.2)


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_that_is_linear_in_time_stays_so_however_its_frames_are_spaced(seed):
    rng = np.random.default_rng(seed)
    times_s = np.cumsum(rng.uniform(0.01, 0.09, 40))
    values, notes = evenly_sampled("take", np.column_stack([3 * times_s, 1 - times_s]), times_s, 25.0)
    wanted_s = times_s[0] + np.arange(len(values)) / 25
    assert_allclose(values, np.column_stack([3 * wanted_s, 1 - wanted_s]))
    assert times_s[-1] - 1 / 25 < wanted_s[-1] <= times_s[-1]
    gap_s = np.diff(times_s).max()
    assert f"largest gap of {gap_s:.3g} s" in notes[0]


def test_frames_between_lost_ones_are_kept_bit_equal():
    values = np.random.default_rng(0).normal(size=(6, 3))
    sampled, _ = evenly_sampled("take", values, np.array([0, 1, 2, 5, 6, 7]) / 25, 25.0)
    assert len(sampled) == 8
    assert_array_equal(sampled[[0, 1, 2, 5, 6, 7]], values)
    assert_allclose(sampled[3], values[2] + (values[3] - values[2]) / 3)


def test_even_and_unknown_times_change_nothing():
    values = np.random.default_rng(0).normal(size=(50, 2))
    jitter = np.random.default_rng(1).uniform(-0.0003, 0.0003, 50)  # s; less than a fiftieth of a frame
    for times_s in (None, np.arange(50) / 25, np.arange(50) / 25 + 7.0 + jitter - jitter[0]):
        same, notes = evenly_sampled("take", values, times_s, 25.0)
        assert same is values
        assert notes == ()
    assert not is_even(np.arange(50) / 24.9, 25.0)


def test_a_video_shows_the_nearest_frame():
    assert frames_shown(4, (0.0, 0.1, 0.5, 0.6), 10.0).tolist() == [0, 1, 1, 2, 2, 2, 3]
    assert (
        frames_shown(3, None, 10.0).tolist() == frames_shown(3, (0.0, 0.1, 0.2), 10.0).tolist() == [0, 1, 2]
    )


@pytest.mark.parametrize(
    "rate", [Fraction(24), Fraction(25), Fraction(30_000, 1001), Fraction(30), Fraction(60)]
)
def test_an_hour_with_a_lost_frame_loses_no_other_and_keeps_all_bit_equal(rate):
    kept = np.delete(np.arange(90_000), 45_000)
    values = np.random.default_rng(2).normal(size=(len(kept), 1))
    times_s = [float(slot / rate) for slot in kept.tolist()]  # rounded once, as the times of a video are
    sampled, _ = evenly_sampled("take", values, times_s, float(rate))
    assert len(sampled) == 90_000
    assert_array_equal(sampled[kept], values)
