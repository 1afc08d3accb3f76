"""What our constants do to motions and continua: each figure moves when its constant is ten times as large.

A comment gives what a figure becomes with a tenth and with ten times the constant.
"""

from itertools import pairwise

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.stimuli.continuum import Line, even_positions, given_positions
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.image_statistics import image_statistics
from morphspace.stimuli.motion_words import WORDS, operations_help
from morphspace.stimuli.plausibility import plausibility, plausible_limits_sd
from morphspace.stimuli.stepping import difference, equalised
from morphspace.stimuli.timing import at_positions, positions_like, retimed, smoothed
from morphspace.stimuli.trajectory import bridge, caricatured, usual_step

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
    short = bridge(before, after, WEIGHTS, usual_step([before, after], WEIGHTS))
    given = bridge(before, after, WEIGHTS, 0.5, 12)
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


def test_the_statistics_of_a_drawn_face(drawn_anna):
    """LOWEST_CYCLES: -0.63, none; HIGHEST_SHARE: none, -1.42; BANDS_AN_OCTAVE 1 and 30: -1.19, -1.02; DIGITS 1: -1."""
    codes = np.rint(255 * np.clip(drawn_anna.picture(), 0, 1)).astype(np.uint8)
    known = image_statistics([codes])
    assert known["code"]["spectral_slope"] == pytest.approx(-1.1099, abs=1e-3)
    assert known["linear"]["luminance"] == pytest.approx(0.22948, abs=2e-5)  # all channels; LUMINANCE


def test_the_help_of_operations_is_two_columns_two_blanks_apart():
    width = max(len(word.form(name)) for name, word in WORDS.items()) + 2
    for line in operations_help().split("\n"):
        assert line[width - 2 : width] == "  " and line[width] != " "


@pytest.mark.parametrize(("furthest_sd", "beyond"), [(3.02, ()), (3.05, (1,))])
def test_a_component_beyond_three_sd_is_marked(drawn_anna, furthest_sd, beyond):
    """PLAUSIBLE_SD, and TOLERANCE of it; no training face goes as far."""
    limits = plausible_limits_sd(drawn_anna.model)
    face = np.array([[furthest_sd, 0.0, 0.0]])
    assert plausibility(limits, [face]).beyond == beyond


def drawing(name="a", furthest_sd=0.0):
    return Drawing(name, np.array([[0.0, furthest_sd]]))


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
    ],
)
def test_limits_lie_where_they_are_said_to_lie(work, most, beyond):
    work(most)
    with pytest.raises(BadInput):
        work(beyond)
