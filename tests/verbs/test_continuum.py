"""Laws of continua: faces on a line between two, steps of equal size, and what each step changes."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.linear import quality
from morphspace.stimuli import stepping
from morphspace.stimuli.continuum import SPACINGS, Line, even_positions, given_positions, spaced_positions


@pytest.fixture(scope="module")
def line(model):
    """Light and shade change much more than in the model's own faces, so that no measure of colour is even."""
    return Line(model, np.array([-2.0, 1.0, -6.0]) * model.sd, np.array([2.0, -1.0, 12.0]) * model.sd)


def test_the_ends_of_a_line_are_the_two_faces_to_the_bit(line):
    loadings = line.loadings(np.array([0.0, 0.3, 1.0]))
    assert_array_equal(loadings[[0, 2]], [line.first, line.last])
    assert_allclose(loadings[1], 0.7 * line.first + 0.3 * line.last, rtol=1e-12)


def test_a_line_shows_what_the_model_renders(line, model):
    for position in (-0.5, 0.0, 0.25, 1.0):
        shown = stepping.as_shown(model.render(line.loadings(np.array([position]))[0]))
        assert np.abs(line.picture(position) - shown).max() <= 1.01 / 255


def sizes(line, positions, kind):
    pictures = [line.picture(float(position)) for position in positions]
    pairs = pairwise(pictures)
    if kind == "warp":
        fields = [line.displacement(float(position)) for position in positions]
        return np.array([quality.rms_px(b - a, line.model.mask) for a, b in pairwise(fields)])
    return np.array([stepping.difference(one, other, line.model.mask, kind) for one, other in pairs])


@pytest.mark.parametrize("spacing", SPACINGS[1:])
@pytest.mark.parametrize("steps", [2, 5, 8])
def test_steps_are_equal_in_what_was_asked(line, spacing, steps):
    found = spaced_positions(line, steps, spacing)
    assert (found.positions[0], found.positions[-1]) == (0, 1)
    assert (np.diff(found.positions) > 0).all()
    assert stepping.unevenness(sizes(line, found.positions, spacing)) < 0.03


def test_even_loadings_are_uneven_to_the_eye(line):
    """Else the test above would pass with no spacing at all."""
    assert stepping.unevenness(sizes(line, even_positions(5), "ciede2000")) > 0.03
    assert_array_equal(spaced_positions(line, 5, "loadings").positions, np.arange(6) / 5)


def test_one_step_is_from_end_to_end(line):
    assert_array_equal(spaced_positions(line, 1, "ciede2000").positions, [0, 1])


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_equal_arc_lengths_are_found_where_they_are_known(power):
    """Positions x on a curve whose length is x^3: equal steps stand at the cube roots of even shares."""
    found = stepping.equalised(lambda x: np.diff(x**3) ** power, np.linspace(0, 1, 9), power, even=1e-9)
    assert_allclose(found.positions, np.linspace(0, 1, 9) ** (1 / 3), atol=1e-6)


def test_steps_that_cannot_be_made_even_are_given_up_soon_and_the_best_is_kept():
    rounds = []

    def sizes(positions):
        rounds.append(positions)
        return np.array([1.0, 1.0 + (0.5 if len(rounds) == 2 else 1.0)])

    found = stepping.equalised(sizes, np.linspace(0, 1, 3))
    assert len(rounds) == 2 + stepping.PATIENCE
    assert_array_equal(found.positions, rounds[1])


def test_a_still_stretch_is_passed_in_one_step():
    found = stepping.equalised(lambda x: np.diff(np.maximum(x, 0.5)), np.linspace(0, 1, 11))
    assert found.unevenness < 0.01


@pytest.mark.parametrize(
    ("one", "other", "published"),
    [
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((50, 2.5, 0), (61, -5, 29), 22.8977),
        ((50, 2.5, 0), (58, 24, 15), 19.4535),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ],
)
def test_ciede2000_is_that_of_published_pairs(one, other, published):
    """Of table 1 in Sharma, Wu and Dalal, Color Research and Application 30 (2005), in CIELAB."""
    from skimage.color import lab2rgb

    mask = np.array([[1.0, 1.0], [0.0, 0.0]], np.float32)
    pictures = [np.tile(lab2rgb(np.array(lab, np.float64)), (2, 2, 1)) for lab in (one, other)]
    assert all(0 < picture.min() < picture.max() < 1 for picture in pictures)
    assert_allclose(stepping.ciede2000(*pictures, mask), published, atol=2e-3)
    pictures[1][1] = 0  # outside the mask
    assert_allclose(stepping.ciede2000(*pictures, mask), published, atol=2e-3)


def test_where_only_the_shape_changes_nothing_is_said_of_colour(line):
    class Shape:
        texture = staticmethod(lambda position: line.texture(0.0))
        displacement = line.displacement

    found = stepping.change(Shape(), 0.0, 0.4, line.model.mask)
    assert (found.texture_rms_codes, found.colour_ciede2000, found.colour_ssim) == (0, 0, 1)
    assert_allclose((found.shape_ciede2000, found.shape_ssim), (found.ciede2000, found.ssim), atol=1e-9)
    assert found.ciede2000 > 0.1


def test_where_only_the_colour_changes_nothing_is_said_of_shape(line):
    class Colour:
        texture = line.texture
        displacement = staticmethod(lambda position: line.displacement(0.0))

    found = stepping.change(Colour(), 0.0, 0.4, line.model.mask)
    assert (found.warp_rms_px, found.shape_ciede2000, found.shape_ssim) == (0, 0, 1)
    assert_allclose((found.colour_ciede2000, found.colour_ssim), (found.ciede2000, found.ssim), atol=1e-9)


def test_a_step_back_changes_as_much_as_the_step_there(line):
    there, back = (stepping.change(line, *ends, line.model.mask) for ends in ((0.2, 0.5), (0.5, 0.2)))
    assert_allclose(list(vars(there).values()), list(vars(back).values()), atol=1e-4)


def test_equal_loadings_are_equal_steps_of_the_warp(line):
    steps = [stepping.change(line, a, a + 0.25, line.model.mask).warp_rms_px for a in (0.0, 0.25, 0.75)]
    assert_allclose(steps, steps[0], rtol=1e-3)


def test_a_crossfade_has_both_faces_at_once(line):
    assert_array_equal(line.crossfade(0.0), line.picture(0.0))
    middle = (line.picture(0.0) + line.picture(1.0)) / 2
    assert np.abs(line.crossfade(0.5) - middle).max() <= 0.51 / 255


@pytest.mark.parametrize(
    ("work", "said"),
    [
        (lambda line: even_positions(0), "number of steps is 0"),
        (lambda line: given_positions([0.5]), "at least 2"),
        (lambda line: given_positions([]), "number of positions is 0"),
        (lambda line: given_positions([0, float("nan"), 1]), "not all numbers"),
        (lambda line: given_positions([0, 1, 0.5]), "0.5 comes after 1"),
        (lambda line: given_positions([0, 0, 1]), "rising order"),
        (lambda line: given_positions([0, 99]), "-10 to 11"),
        (lambda line: Line(line.model, line.first, line.first), "same face"),
        (lambda line: Line(line.model, line.first, line.last[:2]), "3 and 2 loadings"),
        (
            lambda line: spaced_positions(Line(line.model, line.first, line.first + 1e-9), 3, "ssim"),
            "equal in 8-bit codes",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_what_to_do(line, work, said):
    with pytest.raises(BadInput, match=said):
        work(line)
