"""Small figures of stimuli by hand: names, plausibility, positions, steps of a line, joins and their limits."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.stimuli import trajectory
from morphspace.stimuli.caricature import _caricature_drawing, caricatured, components_named
from morphspace.stimuli.continuum import Line, given_positions, spaced_positions
from morphspace.stimuli.drawing import Drawing, Placing, check_name, drawing_of
from morphspace.stimuli.image_statistics import image_statistics, spectral_slope
from morphspace.stimuli.plausibility import plausibility, plausible_limits_sd
from morphspace.stimuli.sampling import along, drawn_sd
from morphspace.stimuli.stepping import as_shown, change, ciede2000, difference, unevenness
from morphspace.stimuli.timing import at_positions, check_same_components, in_reverse, retimed
from morphspace.stimuli.trajectory import (
    _bridge,
    _usual_step,
    looped,
    scrambled_blocks,
    spliced,
    step_lengths,
)

ONE = np.ones(1)


def column(*values):
    return np.array(values, np.float64)[:, None]


def test_plausibility_is_the_largest_value_its_component_and_the_largest_rms():
    found = plausibility(np.array([3.0, 3.0]), [np.array([[1.0, -4.0], [2.0, 0.0]]), np.array([[3.02, 0.5]])])
    assert (found.largest_sd, found.largest_component, found.beyond) == (4.0, 2, (2,))
    assert found.rms_sd == pytest.approx(np.sqrt((1 + 16) / 2))
    nothing = plausibility(np.array([3.0, 3.0]), [np.zeros((0, 2))])
    assert (nothing.largest_sd, nothing.largest_component, nothing.rms_sd, nothing.beyond) == (
        0.0,
        1,
        0.0,
        (),
    )
    none = plausibility(np.zeros(0), [np.zeros((1, 0))])
    assert (none.largest_sd, none.largest_component, none.rms_sd) == (0.0, 1, 0.0)


def test_the_limit_of_a_component_is_its_furthest_training_face(model):
    far = model.training.values / model.sd
    far[4, 1] = -3.7
    wide = replace(model, training=replace(model.training, values=far * model.sd))
    assert_allclose(plausible_limits_sd(wide), np.maximum(3.0, np.abs(far).max(axis=0)))


@pytest.mark.parametrize(
    ("words", "rank", "places"),
    [("1", 1, (0,)), ("2-4", 4, (1, 2, 3)), ("3,1-2, 2", 3, (0, 1, 2)), ("4-4", 5, (3,))],
)
def test_components_are_counted_from_one(words, rank, places):
    assert components_named(words, rank) == places


@pytest.mark.parametrize("words", ["0", "0-2", "3-2", "5", "2-5", "a", "", "1;2"])
def test_components_that_are_not_there_are_refused(words):
    with pytest.raises(BadInput):
        components_named(words, 4)


def test_a_caricature_is_named_by_its_gains_and_changes_what_was_asked():
    faces = np.array([[1.0, -2.0, 0.5]])
    plain = _caricature_drawing("a", faces, {"gain": 1.5})
    assert (plain.name, plain.colour_sd, plain.region, plain.outside_sd) == ("a_g1.5", None, None, None)
    assert_array_equal(plain.loadings_sd, 1.5 * faces)
    assert plain.variables == {"frame": "a", "gain": 1.5}
    apart = _caricature_drawing(
        "a", faces, {"warp_gain": 2.0, "texture_gain": 0.5}, components=(1,), components_named_as="2"
    )
    assert apart.name == "a_w2_t0.5" and apart.variables["components"] == "2"
    assert_array_equal(apart.loadings_sd, [[1.0, -4.0, 0.5]])
    assert_array_equal(apart.colour_sd, [[1.0, -1.0, 0.5]])
    for region, mask, told in (("mouth", None, "mouth"), ("masks/half.png", np.ones((2, 2)), "half.png")):
        part = _caricature_drawing("a", faces, {"gain": 2.0}, region=region, mask=mask)
        assert (part.region, part.variables["region"]) == (told, told)
        assert_array_equal(part.outside_sd, faces)
    assert _caricature_drawing("a", faces, {"gain": 2.0}, region="whole").region is None
    for gain in (np.inf, np.nan):
        with pytest.raises(BadInput):
            caricatured(faces, gain)


def test_positions_rise_from_ten_lengths_before_to_ten_after():
    assert_array_equal(given_positions([-10.0, 0.0, 11.0]), [-10, 0, 11])
    for bad in ([0.0], [0.0, 0.0], [0.5, 0.2], [0.0, np.nan], [-10.1, 0.0], [0.0, 11.1]):
        with pytest.raises(BadInput):
            given_positions(bad)
    with pytest.raises(BadInput, match=r"position 0\.3 comes after 0\.5"):
        given_positions([0.1, 0.5, 0.3])


def test_a_line_goes_straight_from_face_to_face(model):
    one, other = model.training.values[:2]
    line = Line(model, one, other)
    assert_array_equal(line.loadings(np.array([0.0, 1.0])), [one, other])
    assert_allclose(line.loadings(np.array([0.25, -1.0])), [0.75 * one + 0.25 * other, 2 * one - other])
    for at in (0.0, 0.3):
        face = model.expand(line.loadings(np.array([at]))[0])
        assert_allclose(line.texture(at), face.texture, atol=1e-5)
        assert_allclose(line.displacement(at), face.displacement, atol=1e-4)
        assert np.abs(line.picture(at) - face.render()).max() <= 0.51 / 255 or np.abs(face.render()).max() > 1
    ends = line.picture(0.0), line.picture(1.0)
    assert_allclose(line.crossfade(0.25), 0.75 * ends[0] + 0.25 * ends[1], atol=0.51 / 255)
    even = spaced_positions(line, 4, "loadings")
    assert_array_equal(even.positions, [0, 0.25, 0.5, 0.75, 1])
    assert_allclose(even.sizes, 0.25)
    assert even.unevenness == pytest.approx(0, abs=1e-12)
    for first, last in ((one, one), (one, other[:2])):
        with pytest.raises(BadInput):
            Line(model, first, last)


def test_a_picture_is_shown_in_codes_and_compared_inside_the_mask(picture):
    image = np.float32([[[-0.1, 0.5, 1.2]]])
    assert_allclose(as_shown(image), [[[0, 128 / 255, 1]]], atol=1e-7)
    one, other = picture(20, 16, seed=1), picture(20, 16, seed=2)
    half = np.zeros((20, 16), np.float32)
    half[:10] = 1
    spoilt = other.copy()
    spoilt[12:] = 0
    assert ciede2000(one, spoilt, half) == pytest.approx(ciede2000(one, other, half))
    assert ciede2000(one, one, half) == 0 == difference(one, one, half, "ssim")
    assert 0 < difference(one, other, half, "ssim") < 2
    assert ciede2000(one, other, 0 * half) == 0
    white, black = np.ones((4, 4, 3), np.float32), np.zeros((4, 4, 3), np.float32)
    assert ciede2000(white, black, np.ones((4, 4))) == pytest.approx(100, abs=0.1)  # the range of lightness
    with pytest.raises(BadInput, match="ciede2000 or ssim"):
        difference(one, other, half, "rms")
    assert unevenness(np.array([2.0, 2.0, 5.0])) == pytest.approx(2 / 3) and unevenness(np.zeros(3)) == 0


def test_a_step_is_measured_as_a_whole_and_by_shape_and_colour(model):
    """One component moves only, so that colours do not change; another changes colours only."""
    line = Line(model, model.training.values[0], model.training.values[5])
    found = change(line, 0.2, 0.6, model.mask)
    moved = line.displacement(0.6) - line.displacement(0.2)
    weight = model.mask / model.mask.sum()
    assert found.warp_rms_px == pytest.approx(np.sqrt((weight * (moved**2).sum(axis=2)).sum()), rel=1e-4)
    texture = line.texture(0.6) - line.texture(0.2)
    rms = np.sqrt((weight * (texture**2).mean(axis=2)).sum()) * 255
    assert found.texture_rms_codes == pytest.approx(rms, rel=1e-3)
    assert found.ciede2000 == pytest.approx(ciede2000(line.picture(0.2), line.picture(0.6), model.mask))
    still = change(line, 0.4, 0.4, model.mask)
    assert (still.warp_rms_px, still.ciede2000, still.shape_ciede2000, still.colour_ssim) == (0, 0, 0, 1)
    assert 0 < found.colour_ciede2000 < found.shape_ciede2000 < 2 * found.ciede2000
    assert found.ssim < 1 and found.shape_ssim < found.colour_ssim < 1


def test_a_loop_repeats_and_an_open_motion_waits():
    table = column(0, 10, 40)
    assert_allclose(at_positions(table, np.array([-1.0, 0.5, 1.5, 2.5, 9.0])).ravel(), [0, 5, 25, 40, 40])
    loop = at_positions(table, np.array([-1.0, 0.5, 2.5, 3.0, 4.5]), "closed").ravel()
    assert_allclose(loop, [40, 5, 20, 0, 25])
    assert_allclose(in_reverse(table).ravel(), [40, 10, 0])
    assert_allclose(retimed(table, 1.5, "closed").ravel(), [0, 25])  # two frames of a loop of three
    assert_allclose(retimed(table, 0.5).ravel(), [0, 5, 10, 25, 40])
    with pytest.raises(BadInput, match="no frames"):
        check_same_components(table, table[:0])


def test_steps_are_lengths_in_the_models_units():
    table = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0]])
    assert_allclose(step_lengths(table, np.array([1.0, 1.0])), [5, 0])
    assert_allclose(step_lengths(table, np.array([2.0, 0.0])), [6, 0])
    assert _usual_step([column(0, 1, 4), column(0, 2)], ONE) == 2.0  # steps 1, 3 and 2
    assert _usual_step([column(0, 0, 0, 0, 3)], ONE) == 3.0  # most are 0
    assert _usual_step([column(1, 1)], ONE) == 0.0


def test_a_join_has_the_frames_asked_for_and_stays_within_the_motions():
    before, after = column(0, 1, 2), column(9, 10, 11)
    assert len(_bridge(before, after, ONE, 1.0, 5)) == 5
    long = _bridge(before, after, ONE, 1.0)
    whole = np.concatenate([before[-1:], long, after[:1]])
    assert step_lengths(whole, ONE).max() <= 1 + 1e-9 and len(long) >= 6
    shorter = _bridge(before, after, ONE, 1.0, len(long) - 1)
    assert step_lengths(np.concatenate([before[-1:], shorter, after[:1]]), ONE).max() > 1  # no fewer would do
    assert len(_bridge(column(0, 1, 2), column(2, 3, 4), ONE, 1.0)) == 0  # the same face
    assert len(_bridge(column(0, 1, 2), column(3, 4, 5), ONE, 1.0)) == 0  # a step away
    still = _bridge(column(5.0), column(8.0), ONE, 1.0, 2)  # one frame has no velocity
    assert_allclose(still.ravel(), [5 + 3 * (1 / 9) * (3 - 2 / 3), 5 + 3 * (4 / 9) * (3 - 4 / 3)])


def test_a_join_leaves_and_arrives_with_the_velocities_of_the_motions():
    """Velocities over two frames, at most the longest step; their decay has an SD of two frames."""
    before, after = column(0, 1, 3), column(3, 5, 6)  # 1.5 frames each way; the faces are the same
    found = _bridge(before, after, ONE, 1.0, 3).ravel()
    u = np.arange(1, 4) / 4
    to, back = 4 * u, 4 * (1 - u)
    expected = (
        3 + to * (1 - u) ** 2 * np.exp(-0.5 * (to / 2) ** 2) - back * u**2 * np.exp(-0.5 * (back / 2) ** 2)
    )
    assert_allclose(found, expected, atol=1e-12)
    slower = _bridge(before, after, ONE, 2.0, 3).ravel()
    assert_allclose(slower - 3, 1.5 * (expected - 3), atol=1e-12)


def test_loops_and_joins_have_as_many_frames_as_a_motion_may_have(monkeypatch):
    monkeypatch.setattr(trajectory, "MOST_FRAMES", 9)
    table = column(0, 1, 2, 3)
    assert len(looped(table, ONE, 5)) == 9 and len(spliced([table, table], ONE, 1)) == 9
    for work in (lambda: looped(table, ONE, 6), lambda: spliced([table, table], ONE, 2)):
        with pytest.raises(BadInput, match="at most 9"):
            work()


def test_blocks_keep_their_length_and_the_last_may_be_shorter():
    table = column(*range(7))
    found = scrambled_blocks(table, 3, np.random.default_rng(0)).ravel()
    blocks = sorted(([0, 1, 2], [3, 4, 5], [6]), key=lambda block: list(found).index(block[0]))
    assert_array_equal(found, np.concatenate(blocks))
    assert not np.array_equal(found, table.ravel())
    for frames in (7, 0):
        with pytest.raises(BadInput):
            scrambled_blocks(table, frames, np.random.default_rng(0))
    assert len(scrambled_blocks(table, 6, np.random.default_rng(0))) == 7


def test_faces_are_drawn_from_a_bounded_normal_distribution(model):
    values, again = drawn_sd(np.random.default_rng(1), 4000, 2, spread=2.0, max_sd=None)
    assert again == 0 and values.shape == (4000, 2)
    assert values.std() == pytest.approx(2.0, abs=0.05) and abs(np.corrcoef(values.T)[0, 1]) < 0.05
    bounded, again = drawn_sd(np.random.default_rng(1), 4000, 2, spread=2.0, max_sd=2.0)
    assert np.abs(bounded).max() <= 2.0 and again > 0.31 * 8000
    kept = np.abs(values) <= 2.0
    assert_array_equal(bounded[kept], values[kept])
    table = along(model, 1, np.array([-1.0, 0.0, 2.0]))
    assert_array_equal(table, [[0, -1, 0], [0, 0, 0], [0, 2, 0]])


def test_statistics_of_a_picture_by_hand():
    codes = np.zeros((2, 2, 3), np.uint8)
    codes[0] = 255, 0, 51
    found = image_statistics([codes])["code"]
    assert [found[name] for name in ("red", "green", "blue")] == pytest.approx([0.5, 0.0, 0.1])
    bright = 0.2126 + 0.2 * 0.0722
    assert found["luminance"] == pytest.approx(bright / 2, rel=1e-5)
    assert found["rms_contrast"] == pytest.approx(1.0, rel=1e-5) and found["spectral_slope"] is None
    linear = image_statistics([codes])["linear"]
    assert linear["blue"] == pytest.approx(((0.2 + 0.055) / 1.055) ** 2.4 / 2, rel=1e-5)
    low = np.full((2, 2, 3), 10, np.uint8)  # 0.0392 lies on the straight part of the curve
    assert image_statistics([low])["linear"]["red"] == pytest.approx(10 / 255 / 12.92, rel=1e-5)
    half = image_statistics([codes, 0 * codes])["code"]  # contrast is not known of the black frame
    assert half["luminance"] == pytest.approx(bright / 4, rel=1e-5) and half["rms_contrast"] == pytest.approx(
        1.0
    )


@pytest.mark.parametrize(("side", "is_known"), [(14, False), (15, True)])
def test_a_slope_needs_three_bands(side, is_known):
    """LEAST_BANDS of a third of an octave, from 2 cycles a side to half the Nyquist frequency: 3.5 and 3.75."""
    plane = np.random.default_rng(0).standard_normal((side, side)).astype(np.float32)
    assert np.isfinite(spectral_slope(plane)) == is_known


def test_a_drawing_says_what_it_cannot_be():
    names, digests = ("a", "b"), ("1", "2")
    maps = np.tile(np.eye(2, 3), (2, 1, 1))
    placing = Placing(names, digests, maps, ("clip",))
    video = {"frame_rate_hz": 25.0, "suffix": ".mp4", "placing": placing}
    made = Drawing("folder/a", np.zeros((2, 1)), **video)
    assert made.file_name == "folder/a.mp4"
    back = drawing_of(made.document())
    assert (back.name, back.suffix, back.frame_rate_hz, back.placing.names) == (
        "folder/a",
        ".mp4",
        25.0,
        names,
    )
    assert_array_equal(back.placing.registrations, maps)
    with pytest.raises(BadInput, match="3 frames and 2 originals"):
        Drawing("a", np.zeros((3, 1)), **video)
    for bad in (
        (names[:1], digests, maps),
        (names, digests[:1], maps),
        (names, digests, maps[:1]),
        (names, digests, maps * np.nan),
    ):
        with pytest.raises(BadInput):
            Placing(*bad, ("clip",))
    for name in ("a/../b", "a.", ".a", " a", "a ", "a//b", "con", "LPT1.x", "a:b", "a\tb"):
        with pytest.raises(BadInput):
            check_name(name)
    for name in ("a b", "console", "a.b", "com", "lpt10"):
        check_name(name)
