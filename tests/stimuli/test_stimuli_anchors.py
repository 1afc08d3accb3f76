"""What our constants do to motions and continua: each figure moves when its constant is ten times as large.

A comment gives what a figure becomes with a tenth and with ten times the constant.
"""

from itertools import pairwise

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.stimuli import continuum, trajectory
from morphspace.stimuli.continuum import POWERS, Line, even_positions, given_positions, spaced_positions
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.image_statistics import image_statistics
from morphspace.stimuli.motion_words import WORDS, operations_help
from morphspace.stimuli.operations import Motion, operations_of, worked
from morphspace.stimuli.plausibility import plausibility, plausible_limits_sd
from morphspace.stimuli.sampling import drawn_sd
from morphspace.stimuli.stepping import difference, equalised
from morphspace.stimuli.timing import at_positions, positions_like, retimed, smoothed
from morphspace.stimuli.trajectory import _bridge, _usual_step, averaged, caricatured

WEIGHTS = np.array([3.0, 1.0, 0.5])


def motion(seed, frames=40):
    """A slow motion (frames, 3) with some tremor."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, frames)[:, None]
    waves = rng.standard_normal((3, 3)) * np.sin(2 * np.pi * (np.arange(3)[:, None] + 0.5) * t[..., None] + 1)
    return waves.sum(axis=1) + 0.1 * rng.standard_normal((frames, 3))


def test_a_join_of_two_rough_motions():
    """Frames of a join, and the second and the last but one of twelve of a given one.

    FADING_FRAMES: 17 and 20 frames, -1.647 and -1.930; VELOCITY_FRAMES 1 and 20: -1.979 and -1.745.
    """
    before, after = motion(1), motion(2)
    short = _bridge(before, after, WEIGHTS, _usual_step([before, after], WEIGHTS))
    given = _bridge(before, after, WEIGHTS, 0.5, 12)
    assert len(short) == 17 and given[[1, -2], 1] == pytest.approx([-1.8013, 1.4725], abs=0.002)


def test_a_motion_follows_a_guide_without_stop_and_go():
    """Root mean square change of speed, frames a frame. STEADY_SD_FRAMES: 0.459, 0.0049."""
    table = motion(3)
    guide = at_positions(motion(3), 39 * (np.arange(40) / 39) ** 1.3)
    speed = np.diff(positions_like(table, guide, WEIGHTS))
    assert np.sqrt((np.diff(speed) ** 2).mean()) == pytest.approx(0.0428, abs=0.0002)


def test_only_what_rounding_takes_is_given_back():
    """TINY: a last frame that is missing by 5e-9 of a frame is missing, and one by 5e-10 is not."""
    assert [len(retimed(motion(1, 11), 10 / (10 - missing))) for missing in (5e-9, 5e-10)] == [10, 11]


def test_what_smoothing_leaves_of_a_tremor():
    """Root mean square second difference. KERNEL_REACH_SD / 10: 0.0859."""
    left = np.diff(smoothed(motion(5), 3.0, 25.0), 2, axis=0)
    assert np.sqrt((left**2).mean()) == pytest.approx(0.0837, abs=0.0002)


def test_steps_are_made_even_until_they_are_even_enough(drawn_anna):
    """EVEN: one or two rounds with ten times as much, more with a tenth."""
    model = drawn_anna.model
    line = Line(model, *model.training.values[[1, 4]])
    rounds = []

    def sizes_of(positions):
        rounds.append(positions)
        pictures = [line.picture(position) for position in positions]
        return np.array([difference(*two, model.mask, "ciede2000") for two in pairwise(pictures)])

    found = equalised(sizes_of, even_positions(6))
    assert found.unevenness < 0.005 and len(rounds) == 3


@pytest.mark.parametrize("spacing", POWERS)
def test_steps_become_even_in_three_rounds(drawn_anna, spacing, monkeypatch):
    """POWERS: with a tenth, six rounds and never even; with ten times as much, 21 rounds of CIEDE2000, 27 of SSIM."""
    model, measured = drawn_anna.model, []

    def counted(*arguments):
        measured.append(arguments)
        return difference(*arguments)

    monkeypatch.setattr(continuum, "difference", counted)
    found = spaced_positions(Line(model, *model.training.values[[1, 4]]), 4, spacing)
    assert found.unevenness < 0.005 and len(measured) == 3 * 4


def test_the_statistics_of_a_drawn_face(drawn_anna):
    """LOWEST_CYCLES: -0.63, none; HIGHEST_SHARE: none, -1.42; BANDS_AN_OCTAVE 1 and 30: -1.19, -1.02; DIGITS 1: -1."""
    codes = np.rint(255 * np.clip(drawn_anna.picture(), 0, 1)).astype(np.uint8)
    known = image_statistics([codes])
    assert known["code"]["spectral_slope"] == pytest.approx(-1.1099, abs=1e-3)
    assert known["linear"]["luminance"] == pytest.approx(0.22948, abs=2e-5)  # all channels; LUMINANCE


def test_the_help_of_operations_is_two_columns_two_blanks_apart():
    width = max(len(word.form(name)) for name, word in WORDS.items()) + 2
    lines = operations_help().split("\n")
    for line in lines:
        assert line[width - 2 : width] == "  " and line[width] != " "
    assert 90 < max(map(len, lines)) <= 96  # HELP_WIDTH


@pytest.mark.parametrize(("furthest_sd", "beyond"), [(3.02, ()), (3.05, (1,))])
def test_a_component_beyond_three_sd_is_marked(drawn_anna, furthest_sd, beyond):
    """PLAUSIBLE_SD, and TOLERANCE of it; no training face goes as far."""
    limits = plausible_limits_sd(drawn_anna.model)
    face = np.array([[furthest_sd, 0.0, 0.0]])
    assert plausibility(limits, [face]).beyond == beyond


def test_black_pictures_have_no_contrast():
    """DARK: one blue code of 1 has a luminance of 2.2e-5 on its pixel."""
    contrasts = []
    for side in (4, 5):  # 1.4e-6 and 0.9e-6 over the picture
        codes = np.zeros((side, side, 3), np.uint8)
        codes[0, 0, 2] = 1
        contrasts.append(image_statistics([codes])["linear"]["rms_contrast"])
    assert contrasts[0] == pytest.approx(np.sqrt(15), rel=1e-4) and contrasts[1] is None


def test_steps_that_never_become_even_are_given_up():
    """PATIENCE: five rounds without improvement; ROUNDS: thirty that improve."""
    counts = {}
    for name, size in (("same", lambda n: 0.5), ("better", lambda n: 1 / (2 + n))):
        calls = []

        def sizes_of(positions, size=size, calls=calls):
            calls.append(positions)
            return np.array([1.0, 1.0 + size(len(calls))])

        equalised(sizes_of, even_positions(2), even=0.0)
        counts[name] = len(calls)
    assert counts == {"same": 6, "better": 30}


def test_a_mean_is_averaged_until_it_stands_still(monkeypatch):
    """STILL: a millionth of a step; AVERAGING_ROUNDS: ten, where it does not come to a stand."""
    ramp = np.arange(12.0)[:, None]
    for shifts, rounds in (((0.5, 0.5 + 3e-6, 0.5 + 3.5e-6), 3), ((0.5, 0.0) * 20, 10)):
        calls = []

        def shifted(table, mean, weights, calls=calls, shifts=shifts):
            calls.append(1)
            return np.arange(12) - shifts[len(calls) - 1]

        monkeypatch.setattr(trajectory, "positions_like", shifted)
        averaged([ramp], np.ones(1))
        assert len(calls) == rounds


def changed(*motions, words, guide=None):
    return worked(motions, operations_of(words), np.ones(1), guide)


def wave(name="a", frames=11, rate_hz=25.0):
    return Motion(name, np.sin(np.arange(frames))[:, None], rate_hz)


@pytest.mark.parametrize(
    ("ratio", "is_one"), [(1 + 5e-7, True), (1 - 5e-7, True), (1 + 2e-6, False), (1 - 2e-6, False)]
)
def test_rates_are_one_to_a_millionth(ratio, is_one):
    """SAME_RATE."""
    motions = wave(), wave("b", rate_hz=25 * ratio)
    if is_one:
        assert len(changed(*motions, words=["splice=0.2"])) == 1
    else:
        with pytest.raises(BadInput, match="one frame rate"):
            changed(*motions, words=["splice=0.2"])


def test_a_name_of_two_motions_has_at_most_eighty_letters():
    """LONGEST_NAME."""
    for size, expected in ((39, f"{'a' * 40}-{'b' * 39}"), (40, f"{'a' * 40}-and-1-more")):
        (joined,) = changed(wave("a" * 40), wave("b" * size), words=["splice=0.2"])
        assert joined.name == expected


def test_a_part_is_kept_from_its_start_and_without_its_end():
    (kept,) = changed(wave(), words=["part=0.04:0.12"])
    assert np.array_equal(kept.loadings_sd, wave().loadings_sd[1:3]) and kept.ends == "open"


def drawing(name="a", furthest_sd=0.0):
    return Drawing(name, np.array([[0.0, furthest_sd]]))


def cutoff_of(sd_frames, rate_hz=25.0):
    """The cut-off, Hz, of the discrete Gaussian of this SD: its variance is ln 2 / 2 / (1 - cos w)."""
    return np.arccos(1 - np.log(2) / 2 / sd_frames**2) * rate_hz / (2 * np.pi)


def joined(steps):
    """Join two motions that stand `steps` of the longest step apart."""
    return _bridge(np.zeros((3, 1)), np.ones((3, 1)), np.ones(1), 1 / steps)


@pytest.mark.parametrize(
    ("work", "most", "beyond"),
    [
        (even_positions, 10_000, 10_001),
        (lambda end: given_positions([0.0, end]), 11.0, 11.01),
        (lambda end: given_positions([-end, 0.0]), 10.0, 10.01),
        (lambda size: drawing("a" * size), 200, 201),
        (lambda size: drawing("\u00e4" * size), 100, 101),
        (lambda far: drawing(furthest_sd=far), 1000.0, 1001.0),
        (lambda far: drawing(furthest_sd=-far), 1000.0, 1001.0),
        (lambda gain: caricatured(motion(1), motion(2), gain, WEIGHTS), 1000.0, 1001.0),
        (lambda frames: retimed(motion(1, 11), 10 / frames), 99_999, 100_001),
        (lambda rate: Drawing("a", np.zeros((2, 1)), frame_rate_hz=rate, suffix=".mp4"), 10_000.0, 10_001.0),
        (lambda rate: changed(wave(), words=[f"rate={rate}"]), 10_000, 10_001),
        (lambda rate: changed(wave(), words=[f"rate={rate}"]), 4.6, 4.5),  # two frames of 0.44 s
        (lambda end: changed(wave(), words=[f"part=0:{end}"]), 0.05, 0.04),  # two frames
        (lambda end: changed(wave(), words=[f"part={end}:1"]), 0.36, 0.37),
        (lambda block: changed(wave(), words=[f"scramble-blocks={block}"]), 0.40, 0.44),
        (lambda block: changed(wave(), words=[f"scramble-blocks={block}"]), 0.03, 0.01),
        (lambda join: changed(wave(), words=[f"loop={join}"]), 0.0, -0.05),
        (lambda join: changed(wave(), words=[f"loop={join}"]), 3999, 4001),
        (lambda frames: changed(wave(frames=frames), words=["loop"]), 3, 2),
        (lambda frames: changed(wave(frames=frames), words=["scramble-phase"]), 3, 2),
        (lambda sd: smoothed(np.zeros((1100, 1)), cutoff_of(sd), 25.0), 1099, 1101),  # SD, of as many frames
        (lambda sd: smoothed(np.zeros((10_500, 1)), cutoff_of(sd), 25.0), 100, 10_200),
        (lambda frames: changed(wave(frames=frames), words=["reverse"]), 2, 1),
        (lambda hz: smoothed(wave().loadings_sd, hz, 25.0), 12.4, 12.5),
        (joined, 1050, 10_001),
        (lambda share: drawn_sd(np.random.default_rng(0), 1, 1, spread=1.0, max_sd=share), 0.011, 0.0099),
    ],
)
def test_limits_lie_where_they_are_said_to_lie(work, most, beyond):
    work(most)
    with pytest.raises(BadInput):
        work(beyond)
