"""Small figures of mimicry by hand: shares of energy, notes on neutral faces, the table, the driver, drawn parts."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.mesh import LIPS
from morphspace.model.morph import MorphOffset
from morphspace.transfer.colours import MixedColours
from morphspace.transfer.driver import UsedModel, training_driver
from morphspace.transfer.guided import landmark_guide
from morphspace.transfer.mimicry import auto_gain, mimic
from morphspace.transfer.neutral import Neutral, neutral_names, neutral_of
from morphspace.transfer.probable import feature_weights
from morphspace.transfer.projection import Projection
from morphspace.transfer.quality import Quality, Reach, quality_of, reach_of
from morphspace.transfer.quality_table import FaceSeen, FrameMade, made_of, quality_columns
from morphspace.transfer.residual_motion import residual_motion_of


def offset_of(model, texture=None, displacement=None):
    zeros = np.zeros_like(model.mean.texture), np.zeros_like(model.mean.displacement)
    parts = (
        zero if part is None else np.float32(part)
        for part, zero in zip((texture, displacement), zeros, strict=True)
    )
    return MorphOffset.of(*parts, model.mean.reference_id)


def test_shares_of_energy_are_one_minus_that_of_the_miss(drawn_anna):
    model = drawn_anna.model
    carried = drawn_anna.face(jaw_open=0.5, lip_corner_up=0.4) - model.mean
    shown = offset_of(model, 0.5 * carried.texture, 0.9 * carried.displacement)
    asked = model.sd * (1.0, 1.0, -2.0, 0.0, 0.0, 0.0)
    loadings = model.sd * (0.89, 0.91, -1.7, 0.0, 0.0, 0.0)
    found = quality_of(model, carried, shown, asked, loadings, model.mean + shown)
    assert (found.texture_kept, found.warp_kept) == pytest.approx((0.75, 0.99), abs=1e-5)
    assert found.length_sd == pytest.approx(np.sqrt((0.89**2 + 0.91**2 + 1.7**2) / 6))
    assert (found.largest_sd, found.bounded, found.folds) == (pytest.approx(2.0), 2, 0.0)
    nothing = quality_of(model, offset_of(model), offset_of(model), asked, loadings, model.mean)
    assert (nothing.texture_kept, nothing.warp_kept) == (1.0, 1.0)
    torn = np.zeros_like(model.mean.displacement)
    torn[50, 40, 0] = 3.0
    assert (
        quality_of(model, carried, shown, asked, loadings, model.mean + offset_of(model, None, torn)).folds
        > 0
    )


def test_missing_motion_is_measured_in_eye_distances(drawn_anna):
    """A shift that the loadings do not show is missing as a whole, whatever the gain, and twice as much at gain 2."""
    model = drawn_anna.model
    right, left, _ = model.faceframe.points
    eyes_px = np.hypot(*(left - right))
    shift = offset_of(model, None, np.broadcast_to(np.float32((3.0, 4.0)), model.mean.displacement.shape))
    nothing = np.zeros(model.rank)
    for gain in (1.0, 2.0):
        reach = reach_of(model, model, gain)(shift, model.mean, nothing, nothing)
        assert reach.missing_motion == pytest.approx(gain * 5 / eyes_px, rel=1e-4)
    row = model.training.values[3]
    shown = reach_of(model, model, 1.0)(model.offset(row), model.expand(row), row, row)
    assert shown.missing_motion < 1e-3 and shown.colour_agreement == pytest.approx(1, abs=1e-4)
    opposite = reach_of(model, model, 1.0)(-1 * model.offset(row), model.expand(row), row, row)
    assert opposite.colour_agreement == pytest.approx(-1, abs=1e-4)
    still = reach_of(model, model, 1.0)(offset_of(model), model.expand(row), nothing, nothing)
    assert still.colour_agreement == 0.0


def test_the_worst_twentieth_of_the_features_tells_what_is_missing(drawn_anna):
    """WORST: a tenth of the feature pixels that miss 2 px are told, a hundredth is not."""
    model = drawn_anna.model
    inside = (model.mask**2 > 0.5) & ((feature_weights(model) - 1) / 30 > 0.3)
    places = np.flatnonzero(inside)
    found = []
    for share in (0.1, 0.01):
        field = np.zeros((model.mask.size, 2), np.float32)
        field[places[: round(share * len(places))], 0] = 2.0
        offset = offset_of(model, None, field.reshape(model.mean.displacement.shape))
        nothing = np.zeros(model.rank)
        found.append(reach_of(model, model, 1.0)(offset, model.mean, nothing, nothing).missing_motion)
    assert found[0] > 0.05 and found[1] == 0


def apart(asked, source_frame, target_frame, means=0.083, after=0.041):
    return Neutral(asked, np.zeros(6), np.zeros(6), source_frame, target_frame, means, after)


def test_notes_name_the_neutral_frames_and_how_far_apart_they_are(drawn_anna, drawn_ben):
    models = drawn_ben.model, drawn_anna.model
    (chosen,) = apart("auto", "f01", None).notes(*models)
    assert chosen.startswith("the source is re-centred on frame f01 of drawn 9: the means differ by 8.3%")
    assert "these faces by 4.1%" in chosen and chosen.endswith("--neutral chooses other frames")
    (named,) = apart("f01,f02", "f01", "f02").notes(*models)
    assert (
        "the source is re-centred on frame f01 of drawn 9 and the target is re-centred on frame f02" in named
    )
    assert "chooses other frames" not in named
    (second,) = apart("mean,f02", None, "f02", None, None).notes(*models)
    assert second == "the target is re-centred on frame f02 of drawn 4"
    (far,) = apart("auto", None, None).notes(*models)
    assert (
        "lie 8.3% of the eye distance apart, and no frame of drawn 9 comes much nearer; expected at most 6.0%"
        in far
    )
    (asked,) = apart("mean", None, None).notes(*models)
    assert "comes much nearer" not in asked and "lie 8.3% of the eye distance apart; expected" in asked
    for near in (0.06, 0.01, None):
        assert apart("auto", None, None, near).notes(*models) == ()


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("mean", (None, None)),
        ("a", ("a", None)),
        ("a,mean", ("a", None)),
        ("mean, b", (None, "b")),
        ("a,b", ("a", "b")),
    ],
)
def test_neutral_frames_are_named_in_their_order(words, names):
    assert neutral_names(words) == names


@pytest.mark.parametrize("words", ["", "a,", ",b", "a,b,c", "auto,b", "a,auto"])
def test_neutral_frames_that_cannot_be_meant_are_refused(words):
    with pytest.raises(BadInput):
        neutral_names(words)


def test_a_neutral_face_is_one_of_its_model(drawn_anna, drawn_ben):
    source, target = drawn_ben.model, drawn_anna.model
    neutral = neutral_of(source, target, "f03,f05")
    assert not neutral.is_means and neutral_of(source, target, "mean").is_means
    assert not Neutral("f", np.zeros(6), np.zeros(6), None, "f").is_means
    here, there = neutral.offsets(source, target)
    assert_allclose(here.vector, source.offset(source.training.values[3]).vector)
    assert_allclose(there.vector, target.offset(target.training.values[5]).vector)
    assert neutral.settings["source_frame"] == "f03" and neutral.settings["target_frame"] == "f05"
    for bad in (replace(neutral, source=np.zeros(5)), replace(neutral, target=np.zeros(7))):
        with pytest.raises(BadInput, match="expected 6"):
            bad.offsets(source, target)


def test_lips_of_neutral_faces_are_apart_by_what_their_warps_move_them(drawn_anna):
    """Root mean square over the lips after the affine; a person to herself: the lips' own movement."""
    model = drawn_anna.model
    points = np.asarray(model.provenance["keypoints"]["points"])[list(LIPS)]
    right, left, _ = model.faceframe.points
    row = model.training.values[7]
    neutral = neutral_of(model, model, "f07")
    assert_array_equal(neutral.source, row)
    columns, rows = np.round(points).astype(int).T
    moved = model.displacement_offset(row)[rows, columns]  # to the nearest pixel
    expected = np.sqrt((moved**2).sum(axis=1).mean()) / np.hypot(*(left - right))
    assert neutral.apart == pytest.approx(expected, rel=0.1) and neutral.means_apart == pytest.approx(
        0, abs=1e-6
    )


def frame(face=None, outside=None):
    quality = Quality(0.5, 0.6, 1.0, 2.0, 1, 0.0)
    return FrameMade((1.0, 2.0), quality, Reach(0.01, 0.5, None), face, outside, 3, "abc")


def test_a_finished_frame_goes_through_json():
    for one in (frame(), frame(FaceSeen(True, True, 25.04, -3.0), 0.1234), frame(FaceSeen(False))):
        assert asdict(made_of(one.document())) == one.document() == asdict(one)


def test_the_table_has_a_row_a_frame_and_says_what_was_seen():
    made = [frame(), frame(FaceSeen(True, True, 25.04, -3.0), 0.12345), frame(FaceSeen(False))]
    table = quality_columns(["a", "b", "c"], made)
    assert table["frame"] == ["a", "b", "c"] and table["texture_kept"] == [0.5] * 3
    assert table["yaw_deg"] == [None, 25.0, None] and table["pitch_deg"] == [None, -3.0, None]
    assert table["outside_source"] == [None, 0.123, None] and table["opening_beyond"] == [None] * 3
    assert table["flags"] == ["", "turned", "no-face"]


def test_training_faces_drive_as_their_reconstructions(drawn_anna):
    model = drawn_anna.model
    driver = training_driver(UsedModel(model, Path("a.morph"), "0" * 64))
    assert driver.names == model.training.frame_names and len(set(driver.digests)) == 16
    assert driver.rate_hz is None and not driver.is_pictures
    known = replace(model, provenance={**model.provenance, "frame_rate_hz": 25})
    assert training_driver(UsedModel(known, Path("a.morph"), "0" * 64)).rate_hz == 25.0
    (row,) = driver.given([4])
    assert_array_equal(row, model.training.values[4])
    assert_array_equal(driver.offset("f04", row, None).vector, model.offset(row).vector)
    assert_array_equal(driver.picture(row), model.render(row))
    empty = replace(model, training=replace(model.training, values=model.training.values[:0], frame_names=()))
    with pytest.raises(BadInput, match="no training frames"):
        training_driver(UsedModel(empty, Path("a.morph"), "0" * 64))


def test_the_parts_of_a_face_blend_from_the_eyes_to_the_lip(drawn_anna):
    """UPPER_FROM and LOWER_FROM: of the way from eyes to lip, 0.35 is the upper part alone, 0.70 the lower alone."""
    model = drawn_anna.model
    right, left, lip = model.faceframe.points
    eyes = (right + left) / 2
    parts = MixedColours(model).parts
    texture = model.component_textures.reshape(model.rank, -1, 3)
    for along, lower in ((0.25, 0.0), (0.33, 0.0), (0.525, 0.5), (0.72, 1.0), (0.9, 1.0)):
        x, y = np.round(eyes + along * (lip - eyes)).astype(int)
        place = y * model.mask.shape[1] + x
        own = np.zeros((2, model.rank, 3))
        for number, part in enumerate(parts[:2]):
            if place in part.places:
                colours = part.colours.reshape(model.rank, -1, 3)
                own[number] = colours[:, list(part.places).index(place)]
        if np.abs(texture[:, place]).max() > 0:
            share = np.abs(own[1]).sum() / np.abs(own).sum()
            assert share == pytest.approx(lower, abs=0.16 if lower == 0.5 else 0.01)


def test_a_guide_carries_landmarks_by_the_linear_part_and_doubts_both_regressions(drawn_anna, drawn_ben):
    """Precision of a landmark along one axis: GUIDE_TRUST over the summed squares, each at least 0.5 px."""
    source, target = drawn_ben.model, drawn_anna.model
    projection = Projection(source, target)
    guide = landmark_guide(projection)
    linear = projection.affine[:, :2]
    scale = np.sqrt(np.linalg.det(linear))
    lids = slice(0, 32)
    errors = [
        np.maximum(factor * one.landmarks.error_px[lids] / np.sqrt(2), 0.5)
        for factor, one in ((scale, source), (1.0, target))
    ]
    assert_allclose(guide.observations.precision[:64:2], 1000 / (errors[0] ** 2 + errors[1] ** 2))
    loadings = np.arange(1.0, 7.0) * source.sd
    asked = np.tensordot(loadings, source.landmarks.weights[:, lids], 1) @ linear.T
    assert_allclose(guide.moved(loadings)[:64].reshape(-1, 2), asked)


def test_residual_motion_is_half_of_what_is_missing_up_to_its_limit(drawn_anna):
    """RESIDUAL_SHARE 0.5; a long motion approaches RESIDUAL_LIMIT, 0.06 eye distances."""
    model = drawn_anna.model
    right, left, _ = model.faceframe.points
    limit_px = 0.06 * np.hypot(*(left - right))
    residual = residual_motion_of(model, np.ones_like(model.mask))
    for right_px, down_px in ((0.01, 0.0), (3.0, 4.0), (300.0, -400.0)):
        missing = np.broadcast_to(np.float32((right_px, down_px)), model.mean.displacement.shape)
        added = residual.added(missing, model.mean).displacement - model.mean.displacement
        half = 0.5 * np.hypot(right_px, down_px)
        expected = half / np.sqrt(1 + (half / limit_px) ** 2)
        assert np.hypot(*added[48, 40]) == pytest.approx(expected, rel=1e-3)
        assert_allclose(
            added[48, 40] * np.hypot(right_px, down_px), expected * missing[48, 40], rtol=1e-3, atol=1e-5
        )
    assert not residual_motion_of(model, np.zeros_like(model.mask)).share.any()


def test_a_gain_lies_between_one_and_one_point_three(drawn_anna, drawn_ben):
    """GAIN_RANGE; a person to herself needs no gain, and a target that shows nothing gets none."""
    model = drawn_anna.model
    assert auto_gain(model, model, "paper") == pytest.approx(1.0, abs=0.01)
    still = replace(model, training=replace(model.training, values=0 * model.training.values))
    assert auto_gain(still, drawn_ben.model, "paper") == 1.0


@pytest.mark.parametrize(
    ("name", "value"), [("max_sd", 0.0), ("max_sd", -1.0), ("max_sd", np.nan), ("gain", np.inf)]
)
def test_a_bound_above_nothing_and_a_finite_gain_are_needed(drawn_anna, name, value):
    with pytest.raises(BadInput):
        mimic(drawn_anna.model, drawn_anna.model, **{name: value})
    with pytest.raises(BadInput, match="the method is 'magic'"):
        mimic(drawn_anna.model, drawn_anna.model, "magic")
