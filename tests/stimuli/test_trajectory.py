"""Laws of recorded motion as data: its timing, its joins, its controls, its mean."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.stimuli import timing, trajectory

RATE_HZ = 25.0
WEIGHTS = np.array([3.0, 1.0, 0.5])


def motion(frames=60, seed=0):
    """A smooth motion (frames, 3) that ends elsewhere than it begins."""
    t = np.linspace(0, 1, frames)[:, None]
    rng = np.random.default_rng(seed)
    amounts, phases = rng.standard_normal((4, 3)), rng.uniform(0, 2 * np.pi, (4, 3))
    waves = [
        a * np.sin(2 * np.pi * f * t + p) for f, a, p in zip((0.5, 1, 2, 3), amounts, phases, strict=True)
    ]
    return np.sum(waves, axis=0)


def distance_from_path(points, path):
    """How far each of points (m, k) lies from the polyline through path (n, k): by brute force over its pieces."""
    starts, pieces = path[:-1], np.diff(path, axis=0)
    lengths = np.maximum((pieces**2).sum(axis=1), 1e-300)
    found = []
    for point in points:
        share = np.clip(((point - starts) * pieces).sum(axis=1) / lengths, 0, 1)
        found.append(np.sqrt(((starts + share[:, None] * pieces - point) ** 2).sum(axis=1)).min())
    return np.array(found)


@pytest.mark.parametrize("speed", [0.3, 0.5, 1.0, 1.7, 4.0])
def test_a_retimed_motion_stays_on_its_path(speed):
    table = motion()
    fast = timing.retimed(table, speed)
    assert len(fast) == int(np.floor(59 / speed + 1e-9)) + 1
    assert distance_from_path(fast, table).max() < 1e-12 * np.abs(table).max()


def test_speed_1_is_the_motion_to_the_bit_and_half_then_double_too():
    table = motion()
    assert_array_equal(timing.retimed(table, 1.0), table)
    assert_array_equal(timing.retimed(timing.retimed(table, 0.5), 2.0), table)
    assert_array_equal(timing.retimed(table, 1.0, "closed"), table)


def test_a_loop_played_at_another_speed_is_still_a_loop():
    t = np.arange(50)[:, None] / 50
    loop = np.sin(2 * np.pi * (t + np.array([0.0, 0.2, 0.5])))
    slow = timing.retimed(loop, 0.4, "closed")
    assert len(slow) == 125
    steps = np.sqrt((np.diff(np.concatenate([slow, slow[:1]]), axis=0) ** 2).sum(axis=1))
    assert steps[-1] < 1.2 * np.median(steps)
    assert distance_from_path(slow, np.concatenate([loop, loop[:1]])).max() < 1e-12


def test_reverse_twice_is_the_motion():
    table = motion()
    assert_array_equal(timing.in_reverse(timing.in_reverse(table)), table)
    assert_array_equal(timing.in_reverse(table)[0], table[-1])


@pytest.mark.parametrize("cutoff_hz", [2.0, 6.0])
def test_smoothing_halves_the_power_at_the_cut_off(cutoff_hz):
    n = 400
    t = np.arange(n) / RATE_HZ
    for frequency in (cutoff_hz / 4, cutoff_hz, 2 * cutoff_hz):
        wave = np.sin(2 * np.pi * frequency * t)[:, None]
        out = timing.smoothed(wave, cutoff_hz, RATE_HZ)[100:-100, 0]
        gain = out.std() / wave[100:-100, 0].std()
        lobe = (1 - np.cos(2 * np.pi * frequency / RATE_HZ)) / (1 - np.cos(2 * np.pi * cutoff_hz / RATE_HZ))
        assert_allclose(gain, 2 ** (-0.5 * lobe), atol=2e-3)
        assert np.corrcoef(out, wave[100:-100, 0])[0, 1] > 0.999  # no delay


def test_smoothing_keeps_even_motion_and_both_ends():
    even = np.arange(30.0)[:, None] * [1.0, -2.0] + 3.0
    assert_allclose(timing.smoothed(even, 2.0, RATE_HZ), even, atol=1e-12)
    table = motion()
    smooth = timing.smoothed(table, 3.0, RATE_HZ)
    assert_allclose(smooth[[0, -1]], table[[0, -1]], atol=1e-12)


def test_smoothing_a_loop_does_not_know_where_it_was_cut():
    loop = np.random.default_rng(1).standard_normal((40, 2))
    turned = np.roll(timing.smoothed(loop, 4.0, RATE_HZ, "closed"), 13, axis=0)
    assert_allclose(timing.smoothed(np.roll(loop, 13, axis=0), 4.0, RATE_HZ, "closed"), turned, atol=1e-12)


def warped(table, power):
    """The same path with another timing: position 59 (t / 59)^power."""
    return timing.at_positions(table, 59 * (np.arange(60) / 59) ** power)


def test_a_motion_takes_on_the_timing_of_its_guide():
    table = motion(seed=3)
    guide = warped(table, 1.3)
    step = np.median(trajectory.step_lengths(table, WEIGHTS))
    found = timing.timed_like(table, guide, WEIGHTS)
    off = np.sqrt((((found - guide) * WEIGHTS) ** 2).sum(axis=1))
    before = np.sqrt((((table - guide) * WEIGHTS) ** 2).sum(axis=1))
    assert np.median(off) < 0.5 * step < 2 * step < np.median(before)
    assert distance_from_path(found, table).max() < 1e-12 * np.abs(table).max()


def test_timing_a_motion_like_itself_changes_nothing():
    table = motion()
    assert_allclose(timing.timed_like(table, table, WEIGHTS), table, atol=1e-12)


def test_timing_never_goes_back_and_keeps_the_ends():
    table, guide = motion(50, seed=4), motion(70, seed=5)
    places = timing.positions_like(table, guide, WEIGHTS)
    assert (np.diff(places) >= 0).all()
    assert (places[0], places[-1]) == (0, 49)


def test_alignment_counts_each_component_by_its_weight():
    table, guide = motion(seed=3), warped(motion(seed=3), 1.3)
    noise = np.random.default_rng(2).standard_normal((60, 1))
    apart = [np.column_stack([one, sign * noise]) for one, sign in ((table, 9), (guide, -9))]
    places = timing.positions_like(*apart, np.array([*WEIGHTS, 0.0]))
    assert_array_equal(places, timing.positions_like(table, guide, WEIGHTS))


@pytest.mark.parametrize("seed", range(8))
def test_a_loop_has_no_jump_larger_than_the_median_step(seed):
    table = motion(45, seed)
    loop = trajectory.looped(table, WEIGHTS)
    assert_array_equal(loop[:45], table)
    back = trajectory.step_lengths(np.concatenate([loop[44:], loop[:1]]), WEIGHTS)
    assert back.max() <= np.median(trajectory.step_lengths(table, WEIGHTS)) * (1 + 1e-9)


def test_a_motion_that_ends_where_it_began_is_a_loop_already():
    table = motion(45)
    assert_array_equal(
        trajectory.looped(np.concatenate([table, table[:1]]), WEIGHTS)[:46],
        np.concatenate([table, table[:1]]),
    )
    assert len(trajectory.looped(np.concatenate([table, table[:1]]), WEIGHTS)) == 46


def test_a_join_of_given_length_leaves_and_arrives_at_the_motions_own_speed():
    t = np.arange(30.0)[:, None]
    one, other = t * [0.1, 0.0, 0.0], 10 + t * [0.0, 0.3, 0.0]  # of one speed, by the weights
    joined = trajectory.spliced([one, other], WEIGHTS, 200)
    assert len(joined) == 260
    assert_array_equal(joined[:30], one)
    assert_array_equal(joined[-30:], other)
    assert_allclose(joined[30] - joined[29], [0.1, 0.0, 0.0], atol=0.013)
    assert_allclose(joined[230] - joined[229], [0.0, 0.3, 0.0], atol=0.04)


def test_a_join_shows_no_component_further_out_than_the_motions_do():
    """Both ends run outwards as fast as anything in the motions."""
    one, other = motion(40, 1), motion(40, 2)
    one[-3:] += np.array([[1.0], [2.0], [3.0]])
    other[:3] += np.array([[3.0], [2.0], [1.0]])
    other += 30
    both = np.concatenate([one, other])
    both[:, 0] *= -1  # this component would run out at its low end
    one, other = both[:40], both[40:]
    for frames in (25, None):
        joined = trajectory.spliced([one, other], WEIGHTS, frames)
        assert len(joined) > 100 or frames is not None
        assert (joined.min(axis=0) >= both.min(axis=0)).all()
        assert (joined.max(axis=0) <= both.max(axis=0)).all()


def test_a_motion_that_mostly_stands_still_is_measured_by_the_steps_that_move():
    still = np.zeros((30, 3))
    still[20:25] = np.arange(5)[:, None] * [0.1, 0.0, 0.0]
    still[25:] = still[24]
    assert_allclose(trajectory._usual_step([still], WEIGHTS), 0.3)
    back = trajectory.looped(still, WEIGHTS)[30:]
    assert 0 < len(back) < 20
    assert trajectory._usual_step([still[:20]], WEIGHTS) == 0


def test_splicing_keeps_every_frame_and_adds_no_long_step():
    tables = [motion(40, seed) for seed in (1, 2, 3)]
    joined = trajectory.spliced(tables, WEIGHTS)
    steps = trajectory.step_lengths(joined, WEIGHTS)
    own = np.concatenate([trajectory.step_lengths(table, WEIGHTS) for table in tables])
    assert_allclose(sorted(steps, reverse=True)[:20], sorted(own, reverse=True)[:20])
    places = [np.flatnonzero((joined == table[0]).all(axis=1))[0] for table in tables]
    for place, table in zip(places, tables, strict=True):
        assert_array_equal(joined[place : place + 40], table)


def test_there_and_back_has_the_motions_own_steps_only():
    table = motion(20)
    loop = trajectory.there_and_back(table)
    assert len(loop) == 38
    own = trajectory.step_lengths(table, WEIGHTS)
    assert_allclose(trajectory.step_lengths(np.concatenate([loop, loop[:1]]), WEIGHTS), [*own, *own[::-1]])


@pytest.mark.parametrize("block", [1, 7, 30])
def test_scrambling_in_time_keeps_every_frame_and_changes_the_order(block):
    table = motion()
    out = trajectory.scrambled_blocks(table, block, np.random.default_rng(3))
    assert not np.array_equal(out, table)
    assert_array_equal(out[np.lexsort(out.T)], table[np.lexsort(table.T)])
    assert_array_equal(out, trajectory.scrambled_blocks(table, block, np.random.default_rng(3)))
    kept = sum((np.diff(table, axis=0) == step).all(axis=1).any() for step in np.diff(out, axis=0))
    assert kept >= 59 - int(np.ceil(60 / block))


@pytest.mark.parametrize("seed", range(8))
def test_two_blocks_always_change_places(seed):
    table = motion()
    out = trajectory.scrambled_blocks(table, 30, np.random.default_rng(seed))
    assert_array_equal(out, np.concatenate([table[30:], table[:30]]))


@pytest.mark.parametrize("frames", [60, 61])
def test_scrambling_in_phase_keeps_spectra_and_how_components_go_together(frames):
    table = motion(frames)
    out = trajectory.scrambled_phase(table, np.random.default_rng(4))
    assert np.sqrt(((out - table) ** 2).mean()) > 0.3
    assert_allclose(out.mean(axis=0), table.mean(axis=0), atol=1e-12)
    spectra = [np.fft.rfft(one, axis=0) for one in (table, out)]
    assert_allclose(np.abs(spectra[1]), np.abs(spectra[0]), atol=1e-9)
    cross = [one[:, :, None] * np.conj(one[:, None, :]) for one in spectra]
    assert_allclose(cross[1], cross[0], atol=1e-9)
    assert_allclose(np.cov(out.T), np.cov(table.T), atol=1e-12)


def test_the_mean_of_a_motion_with_itself_is_that_motion():
    table = motion()
    assert_allclose(trajectory.averaged([table, table, table], WEIGHTS), table, atol=1e-9)


def test_the_mean_of_two_timings_of_a_motion_stays_on_its_path_between_them():
    table = motion(seed=3)
    fast = timing.retimed(table, 1.5)
    mean = trajectory.averaged([table, fast], WEIGHTS)
    assert len(mean) == round((len(table) + len(fast)) / 2)
    step = np.median(trajectory.step_lengths(table, WEIGHTS))
    assert distance_from_path(mean * WEIGHTS, table * WEIGHTS).max() < 0.5 * step


def test_the_mean_of_opposite_deviations_is_the_motion_between():
    table, size = motion(seed=3), 0.2
    tables = [table + size, table - size]
    step = np.median(trajectory.step_lengths(table, WEIGHTS))
    mean = trajectory.averaged(tables, WEIGHTS)
    assert distance_from_path(mean * WEIGHTS, table * WEIGHTS).max() < 0.5 * step


def test_the_mean_does_not_depend_on_the_order():
    tables = [motion(50, seed=3), motion(50, seed=3) + 0.1, motion(40, seed=3)]
    one = trajectory.averaged(tables, WEIGHTS)
    assert_allclose(trajectory.averaged(tables[::-1], WEIGHTS), one, atol=1e-9)


def test_gain_1_is_the_motion_and_gain_0_the_mean_in_its_timing():
    table, mean = motion(seed=3), motion(seed=3) + 0.3
    assert_array_equal(trajectory.caricatured(table, mean, 1.0, WEIGHTS), table)
    usual = timing.timed_like(mean, table, WEIGHTS)
    assert_allclose(trajectory.caricatured(table, mean, 0.0, WEIGHTS), usual, atol=1e-12)
    half = trajectory.caricatured(table, mean, 1.5, WEIGHTS)
    assert_allclose(half - usual, 1.5 * (table - usual), atol=1e-12)


@pytest.mark.parametrize("frames", [2, 60])
def test_the_least_cut_off_that_is_named_can_be_used_and_keeps_even_motion(frames):
    even = np.linspace(0, 1, frames)[:, None] * [1.0, -2.0]
    with pytest.raises(BadInput, match="give at least") as caught:
        timing.smoothed(even, 1e-5, RATE_HZ)
    least = float(str(caught.value).rpartition(" ")[2])
    assert_allclose(timing.smoothed(even, least, RATE_HZ), even, atol=1e-9)


@pytest.mark.parametrize(
    ("work", "said"),
    [
        (lambda t: timing.retimed(t, 0.0), "speed is 0;"),
        (lambda t: timing.retimed(t, float("nan")), "speed is nan"),
        (lambda t: timing.retimed(t, 1e-9), "at most 100000"),
        (lambda t: timing.retimed(t, 100.0), "lower speed"),
        (lambda t: timing.retimed(t[:1], 2.0), "at least 2"),
        (lambda t: timing.smoothed(t, 12.5, RATE_HZ), "half the frame rate"),
        (lambda t: timing.smoothed(t, 0.0, RATE_HZ), "above 0"),
        (lambda t: timing.smoothed(t, 1e-9, RATE_HZ), "give at least"),
        (lambda t: timing.smoothed(np.repeat(t, 1000, 0), 0.00001, RATE_HZ), "give at least"),
        (lambda t: timing.timed_like(t, t[:, :2], WEIGHTS[:2]), "3 components, the other 2"),
        (lambda t: trajectory.looped(t[:2], WEIGHTS), "at least 3"),
        (
            lambda t: trajectory.looped(np.concatenate([np.zeros((3, 3)), t * 1e-9, t[:1] + 9]), WEIGHTS * 1),
            "splice=0.5",
        ),
        (lambda t: trajectory.there_and_back(t[:1]), "at least 2"),
        (lambda t: trajectory.scrambled_blocks(t, 60, np.random.default_rng(0)), "cannot change places"),
        (lambda t: trajectory.scrambled_blocks(t, 0, np.random.default_rng(0)), "blocks of 0"),
        (lambda t: trajectory.scrambled_phase(t[:2], np.random.default_rng(0)), "no phases"),
        (lambda t: trajectory.caricatured(t, t, float("inf"), WEIGHTS), "gain of inf"),
        (lambda t: trajectory.caricatured(t, t, 1e300, WEIGHTS), "gain of 1e[+]300.*-1000 to 1000"),
        (lambda t: trajectory.averaged([t, t[:, :2]], WEIGHTS), "same model"),
    ],
)
def test_what_cannot_be_is_refused_with_what_to_do(work, said):
    with pytest.raises(BadInput, match=said):
        work(motion())
