"""Blending identities: what is chosen, how versions are judged and mixed, sharpness, and resuming."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.avatar import AvatarSettings, blend_steps
from morphspace.avatar.blend import Mixer
from morphspace.avatar.build import NEAR
from morphspace.avatar.common_grid import CommonFace, common_face, placed, places_on
from morphspace.avatar.notes import notes_on
from morphspace.avatar.selection import labels_of, model_key, spread_out
from morphspace.avatar.settings import Expression, shares_of
from morphspace.avatar.sharpness import curve, mean_curve, sharpened, sharpness
from morphspace.avatar.studio import studio_of
from morphspace.avatar.versions import LEAST, Gaps, Version, falling
from morphspace.cli.main import main
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import (
    FACE_OUTLINE,
    INNER_LIPS,
    LANDMARKS,
    LEFT_BROW,
    POINT_COUNT,
    RIGHT_BROW,
    SCHEME,
    landmark_places,
)
from morphspace.grid import warp
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.loadings import Loadings
from morphspace.model.morph import Morph
from morphspace.requests import settings_in
from morphspace.sets import models as set_models
from morphspace.steps import result_of
from morphspace.transfer.neutral import Neutral
from morphspace.verbs import blend_avatar
from morphspace.verbs.blend_avatar import BlendAvatarRequest

FACEFRAME = FaceFrame((20.0, 30.0), (44.0, 30.0), (32.0, 50.0))
ELSEWHERE = FaceFrame((18.0, 28.0), (44.0, 29.0), (31.0, 51.0))
QUICK = {"expressions": 4, "flow": "dis", "components": 3}


def named(model, identity, faceframe=FACEFRAME, brighter=0.0):
    """The drawn model as another person: its own name, keypoints and lightness, so its own digests too."""
    mean = Morph.of(
        model.mean.texture + np.float32(brighter), model.mean.displacement, model.mean.reference_id
    )
    digest = f"{hash_number(identity):016x}"
    training = Loadings(model.training.values, model.training.frame_names, digest)
    provenance = {**model.provenance, "identity": identity}
    return replace(model, mean=mean, training=training, provenance=provenance).with_faceframe(faceframe)


def hash_number(word):
    return int.from_bytes(word.encode()[:7].ljust(7, b"\0"), "big")


@pytest.fixture(scope="module")
def without_networks(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHSPACE_MODELS", str(tmp_path_factory.mktemp("none")))
        yield


@pytest.fixture
def anna(model):
    return named(model, "anna")


@pytest.fixture
def ben(model):
    return named(model, "ben", ELSEWHERE, brighter=0.1)


def settings_of(**changes):
    """Give the settings of a blend as the verb has them, but for some."""
    return settings_in(BlendAvatarRequest(("a", "b"), "avatar.morph", **changes), AvatarSettings)


def blended(models, folder, **changes):
    return result_of(blend_steps(models, settings_of(**{**QUICK, **changes}), folder))


def test_spread_out_faces_start_at_rest_and_leave_no_face_far_from_a_chosen_one():
    loadings = np.random.default_rng(3).standard_normal((40, 4)) * (3, 2, 1, 0.1)
    chosen = spread_out(loadings, 8)
    assert chosen == sorted(set(chosen)) and len(chosen) == 8
    assert int((loadings**2).sum(axis=1).argmin()) in chosen
    distances = np.linalg.norm(loadings[:, None] - loadings[None, chosen], axis=2)
    apart = np.linalg.norm(loadings[chosen][:, None] - loadings[None, chosen], axis=2)
    closest_pair = apart[np.triu_indices(8, 1)].min()
    assert distances.min(axis=1).max() <= closest_pair + 1e-12  # what farthest-point sampling promises


def test_all_expressions_are_taken_where_all_or_more_are_asked():
    loadings = np.zeros((5, 2))
    assert spread_out(loadings, None) == spread_out(loadings, 9) == [0, 1, 2, 3, 4]


def test_equal_faces_are_chosen_once_each():
    assert spread_out(np.zeros((5, 2)), 3) == [0, 1, 2]


def test_labels_are_unique_and_belong_to_the_model_not_to_its_place(model):
    one, other = named(model, "anna"), named(model, "anna", ELSEWHERE)
    there = dict(zip((0, 1), labels_of([one, other], [model_key(one), model_key(other)]), strict=True))
    back = dict(zip((1, 0), labels_of([other, one], [model_key(other), model_key(one)]), strict=True))
    assert there == back and sorted(there.values()) == ["anna", "anna_2"]


def test_keys_tell_keypoints_apart(model):
    assert model_key(named(model, "anna")) != model_key(named(model, "anna", ELSEWHERE))


@pytest.mark.parametrize("value, expected", [(0.0, 1.0), (0.1, 1.0), (0.15, 0.5), (0.2, 0.0), (5.0, 0.0)])
def test_belief_falls_between_its_limits(value, expected):
    assert falling(value, (0.1, 0.2)) == pytest.approx(expected)


def test_the_sharpness_of_a_sharpened_picture_is_foretold(picture):
    image, mask = picture(60, 50, seed=2), np.ones((60, 50), np.float32)
    grows = curve(image, mask)
    assert grows.plain == pytest.approx(sharpness(image, mask), rel=1e-4)
    for amount in (0.5, 2.0):
        assert grows.at(amount) == pytest.approx(sharpness(sharpened(image, mask, amount), mask), rel=1e-3)
    assert grows.at(grows.amount_for(1.7 * grows.plain)) == pytest.approx(1.7 * grows.plain)
    assert grows.amount_for(0.5 * grows.plain) == 0  # never blurred


def test_a_mean_curve_meets_the_mean(picture):
    mask = np.ones((60, 50), np.float32)
    curves = [curve(picture(60, 50, seed=seed), mask) for seed in (1, 2)]
    assert mean_curve(curves).at(0.7) == pytest.approx(np.mean([one.at(0.7) for one in curves]))


def test_sharpening_keeps_to_the_mask(picture):
    image, mask = picture(60, 50, seed=2), np.zeros((60, 50), np.float32)
    mask[20:40] = 1
    made = sharpened(image, mask, 1.0)
    assert_array_equal(made[:20], image[:20])
    assert (made[20:40] != image[20:40]).any()


def test_an_affine_that_moves_nothing_costs_no_rounding(wavy_field):
    field = wavy_field(40, 30, 2.0)
    assert placed(field, np.eye(2, 3) + 1e-13) is field


def test_an_affine_moves_where_a_field_ends(wavy_field):
    field = wavy_field(40, 30, 2.0)
    place = np.array([[1.1, 0.1, 3.0], [-0.1, 0.9, -2.0]])
    x, y = warp.positions(field)
    moved_x, moved_y = warp.positions(placed(field, place))
    ends = np.stack([x, y], axis=-1) @ place[:, :2].T + place[:, 2]
    assert_allclose(np.stack([moved_x, moved_y], axis=-1), ends, atol=1e-4)  # px


@pytest.fixture
def mixer(anna, ben):
    """Two people whose mean faces lie on each other, so that mixing is plain arithmetic."""
    height, width = anna.mask.shape
    zero, ones = np.zeros((height, width, 2), np.float32), np.ones((height, width), np.float32)
    common = CommonFace([anna, ben], [zero, zero], ones, [ones, ones])
    return Mixer(common, np.array([0.75, 0.25]), [np.eye(2, 3)] * 2, 0)


def test_believed_versions_mix_as_their_weighted_mean(mixer, anna, ben):
    one, other = anna.expand(anna.training.values[0]), ben.expand(ben.training.values[5])
    made = mixer.blended([Version(one, 1.0), Version(other, 1.0)])
    assert_allclose(made.texture, 0.75 * one.texture + 0.25 * other.texture, atol=1e-5)
    assert_allclose(made.displacement, 0.75 * one.displacement + 0.25 * other.displacement, atol=1e-4)


def test_a_wrinkle_of_the_lighter_weighted_is_theirs(mixer, anna, ben):
    """Ben has a quarter of the weight, so a quarter of what is coarse and half of what is fine: 0.34 of the wrinkle."""
    wrinkle = np.zeros_like(ben.mean.texture)
    wrinkle[36, 24:36] = -0.4
    other = Morph.of(ben.mean.texture + wrinkle, ben.mean.displacement, ben.mean.reference_id)
    made = mixer.blended([Version(anna.mean, 1.0), Version(other, 1.0)]).texture - mixer.mean.texture
    assert made[36, 28:32].mean() / wrinkle[36, 28:32].mean() == pytest.approx(0.34, abs=0.02)


def test_who_cannot_show_an_expression_enters_with_the_mean_face_alone(mixer, anna, ben):
    one, broken = anna.expand(anna.training.values[0]), ben.expand(5 * ben.sd)
    made = mixer.blended([Version(one, 1.0), Version(broken, LEAST / 2)])
    expected = 0.75 * anna.mean.texture + 0.25 * ben.mean.texture + (one.texture - anna.mean.texture)
    assert_allclose(made.texture, expected, atol=1e-5)
    assert_allclose(mixer.used([Version(one, 1.0), Version(broken, LEAST / 2)]), [1, 0])


def test_a_doubted_version_counts_less(mixer, anna, ben):
    used = mixer.used([Version(anna.mean, 1.0), Version(ben.mean, 0.5)])
    assert_allclose(used, [0.75 / 0.875, 0.125 / 0.875])


def test_hair_over_a_forehead_gives_way_to_skin(mixer):
    height, width = mixer.common.mask.shape
    bald = np.ones((height, width), np.float32)
    fringe = bald.copy()
    fringe[:10] = 0
    shown = replace(mixer, common=replace(mixer.common, skin=[bald, fringe]))
    assert_allclose(shown.mean.texture[:10], mixer.rest[0].texture[:10], atol=2e-3)
    assert_allclose(shown.mean.texture[20:], mixer.mean.texture[20:], atol=1e-5)


def test_outside_the_mask_there_is_one_person_or_grey(anna, ben):
    height, width = anna.mask.shape
    zero, ones = np.zeros((height, width, 2), np.float32), np.ones((height, width), np.float32)
    mask = ones.copy()
    mask[:10] = 0
    common = CommonFace([anna, ben], [zero, zero], mask, [ones, ones])
    at_rest = [Version(anna.mean, 1.0), Version(ben.mean, 1.0)]
    for surround, expected in ((1, ben.mean.texture), (0, anna.mean.texture), (None, 0.5)):
        made = Mixer(common, np.array([0.5, 0.5]), [np.eye(2, 3)] * 2, surround).blended(at_rest)
        assert_allclose(made.texture[:10], np.broadcast_to(expected, made.texture.shape)[:10], atol=1e-5)


def test_a_shifted_face_is_laid_on_the_reference(anna, model):
    shift = np.float32([[1, 0, 2], [0, 1, -1]])
    moved = cv2.warpAffine(anna.mean.texture, shift, anna.size, borderMode=cv2.BORDER_REPLICATE)
    beside = FaceFrame((22.0, 29.0), (46.0, 29.0), (34.0, 49.0))
    other = named(model, "ben", beside)
    other = replace(other, mean=Morph.of(moved, other.mean.displacement, other.mean.reference_id))
    common = common_face([anna, other], ["a", "b"], 0, "dis")
    inside = anna.mask > 0.9
    assert np.abs(common.fields[1][inside] - (2, -1)).mean() < 0.3  # px
    assert not common.fields[0].any()
    laid = common.laid(1, other.mean, places_on([anna, other], FACEFRAME)[1])
    assert np.abs(laid.displacement[inside]).mean() < 0.3  # px; the affine takes the shift out again


def mesh_on(model):
    """The model with mesh points on a circle for the rim, brows on a line, everything else in the middle."""
    points = np.tile([32.0, 40.0], (POINT_COUNT, 1))
    angle = np.linspace(-np.pi / 2, 3 * np.pi / 2, len(FACE_OUTLINE), endpoint=False)
    points[list(FACE_OUTLINE)] = np.column_stack([32 + 22 * np.cos(angle), 40 + 30 * np.sin(angle)])
    for brow, left in ((RIGHT_BROW, 16.0), (LEFT_BROW, 36.0)):
        points[list(brow)] = np.column_stack(
            [np.linspace(left, left + 12, len(brow)), np.full(len(brow), 30.0)]
        )
    origin = {
        **(model.provenance.get("keypoints") or {}),
        "lip": "philtrum",
        "scheme": SCHEME,
        "points": points.tolist(),
    }
    return model.with_faceframe(FACEFRAME, origin)


def test_where_one_has_no_mesh_points_the_faceframes_start_the_correspondence(anna, ben):
    without = common_face([anna, ben], ["a", "b"], 0, "dis").fields[1]
    for models in (
        [mesh_on(anna), ben],
        [anna, mesh_on(ben).with_faceframe(ELSEWHERE, mesh_on(ben).provenance["keypoints"])],
    ):
        assert_array_equal(common_face(models, ["a", "b"], 0, "dis").fields[1], without)


def test_outline_and_hair_need_mesh_points(anna, ben):
    plain = common_face([anna, ben], ["a", "b"], 0, "dis")
    assert all((share == 1).all() for share in plain.skin) and plain.mask[40, 10] > 0.5
    meshed = common_face([mesh_on(anna), ben], ["a", "b"], 0, "dis")
    assert meshed.mask[40, 10] < 0.25  # the rim lies at x = 10
    assert (meshed.mask <= plain.mask + 1e-6).all()
    dark = anna.mean.texture.copy()
    dark[:20] = 0
    hairy = replace(mesh_on(anna), mean=Morph.of(dark, anna.mean.displacement, anna.mean.reference_id))
    assert (common_face([hairy, ben], ["a", "b"], 0, "dis").skin[0][:15] < 0.05).all()


def looking(model, to_right):
    """The model with eyes 10 px wide whose irises stand so many px to the image's right of their middle."""
    points = np.tile([32.0, 40.0], (POINT_COUNT, 1))
    for x, iris, left, right in ((20.0, 468, 33, 133), (44.0, 473, 362, 263)):
        points[left], points[right], points[iris] = (x - 5, 30), (x + 5, 30), (x + to_right, 31)
    origin = {"lip": "philtrum", "scheme": SCHEME, "points": points.tolist()}
    return model.with_faceframe(FACEFRAME, origin)


def test_who_knows_no_landmarks_is_told_where_mouths_are_matched(anna, ben):
    def said(one, other, **settings):
        return " ".join(notes_on(studio_of([one, other], settings_of(**settings)), (), 1.0))

    known = [with_lips(mesh_on(m), 1.0) for m in (anna, ben)]
    assert "anna, ben lack mesh points or landmarks" in said(anna, ben)
    assert "ben lacks mesh points or landmarks" in said(known[0], ben)
    assert "ben lacks mesh points or landmarks" in said(known[0], with_lips(ben, 1.0))
    assert "landmarks" not in said(*known)
    assert "landmarks" not in said(anna, ben, correspondence="rest")
    assert "landmarks" not in said(anna, ben, weights=(1, 0))
    with pytest.raises(BadInput, match="correspondence is 'both'; expected one of expression, rest"):
        said(anna, ben, correspondence="both")


def test_mouths_are_matched_where_all_know_their_landmarks(anna, ben):
    models = [with_lips(anna, 1.0), with_lips(ben, 1.0)]
    studio = studio_of(models, settings_of(flow="dis"))
    assert studio.mixer(0).match is not None
    alone = studio_of(models, settings_of(flow="dis", correspondence="rest"))
    assert alone.mixer(0).match is None
    assert studio.identity() != alone.identity()  # kept blends of the one are not the other's


def test_people_who_look_in_different_directions_are_told(anna, ben):
    said = []
    for to_right in (0.4, 2.0):  # px of 10
        studio = studio_of([looking(anna, 0), looking(ben, to_right)], settings_of())
        said.append(" ".join(notes_on(studio, (), 1.0)))
    assert "different directions" not in said[0]
    assert (
        "anna and ben look in different directions: their irises are 0.20 of an eye's width apart" in said[1]
    )


def with_lips(model, per_loading_px):
    """The model with landmarks whose inner lips stand open by 2 px and by so much more per first loading."""
    mean = np.zeros((len(LANDMARKS), 2))
    weights = np.zeros((model.rank, len(LANDMARKS), 2))
    place = landmark_places("inner lips").start + INNER_LIPS.index(14)
    mean[place], weights[0, place, 1] = (0, 2), per_loading_px
    return model.with_landmarks(LandmarkRegression(mean, weights, np.ones(len(LANDMARKS)), 12, 1.0, False))


def test_gaps_tell_what_is_missed_and_what_was_never_shown(anna, ben):
    source, target = with_lips(anna, 4.0), with_lips(named(ben, "ben"), 1.0)
    means = np.zeros(anna.rank)
    gaps = Gaps(source, target, Neutral("mean", means, means))
    asked, shown = np.array([2.0, 0, 0]), np.array([1.0, 0, 0])
    misfit, beyond = gaps.judged(asked, shown)
    most = 2 + max(target.training.values[:, 0])
    assert misfit == pytest.approx((8 - 1) / 24)
    assert beyond == pytest.approx((8 + 2 - most) / 24)
    assert gaps.judged(means, means)[0] == 0


def test_what_a_blend_gives_back_fits_together(anna, ben, tmp_path):
    avatar = blended([anna, ben], tmp_path, weights=(3, 1))
    assert avatar.identities == ("anna", "ben")
    assert_allclose(avatar.weights, [0.75, 0.25])
    assert tuple(one.name for one in avatar.expressions) == avatar.model.training.frame_names
    assert len(avatar.expressions) == 8
    for one in avatar.expressions:
        assert one.weights.sum() == pytest.approx(1) and one.plausibility[one.source] == 1
        assert one.frame in anna.training.frame_names and one.name.startswith(avatar.identities[one.source])
    assert len(avatar.versions(0)) == 2
    assert avatar.blend(0).shape == avatar.pixel_average(0).shape == anna.reference.shape
    blend = avatar.model.provenance["blend"]
    assert dict(zip(blend["identities"], blend["weights"], strict=True)) == {"anna": 0.75, "ben": 0.25}


def test_keypoints_of_a_blend_without_a_detector_are_the_mean_of_the_sources(anna, ben, tmp_path):
    avatar = blended([anna, ben], tmp_path)
    expected = (FACEFRAME.points + ELSEWHERE.points) / 2
    assert np.abs(avatar.model.faceframe.points - expected).max() < 1.0  # px


def test_the_finished_model_is_as_sharp_as_its_sources(anna, ben, tmp_path):
    avatar = blended([anna, ben], tmp_path)
    wanted = float(avatar.sharpness["sources"].mean())
    mask = avatar.studio.mixer(0).judged_picture
    drawn = [sharpness(avatar.model.render(row), mask) for row in avatar.model.training.values]
    assert avatar.sharpness["blend"] == pytest.approx(np.mean(drawn), rel=1e-6)
    assert avatar.sharpen == 0 or NEAR[0] <= avatar.sharpness["blend"] / wanted <= NEAR[1]
    assert avatar.sharpness["blend"] >= NEAR[0] * wanted


def test_the_keypoints_of_a_blend_say_that_they_come_from_the_blend(anna, ben, tmp_path):
    avatar = blended([anna, ben], tmp_path)
    assert avatar.model.provenance["keypoints"]["source"] == "blend"
    assert avatar.model.provenance["keypoints"]["on"] == "mean"


def test_an_identity_that_is_left_out_is_named_with_its_count(anna, ben):
    studio = studio_of([anna, ben], settings_of())
    expressions = [
        Expression(
            0, f"f{place}", f"anna_f{place}", np.array([1.0, 0.0] if place < 4 else [0.5, 0.5]), np.ones(2)
        )
        for place in range(8)
    ]
    (note,) = [one for one in notes_on(studio, expressions, 1.0) if "left out" in one]
    assert "ben is left out of 4 of 8 expressions" in note
    assert "(anna_f0, anna_f1, anna_f2, ...)" in note


def test_a_blend_that_is_not_as_sharp_as_its_sources_is_told(anna, ben, tmp_path):
    avatar = blended([anna, ben], tmp_path, sharpen=3.0)
    share = avatar.sharpness["blend"] / avatar.sharpness["sources"].mean()
    assert share > 1.2
    assert f"{share:.0%} as sharp as its sources" in " ".join(avatar.notes)
    assert not [note for note in blended([anna, ben], tmp_path).notes if "as sharp" in note]


def test_an_amount_that_was_asked_for_stays(anna, ben, tmp_path):
    avatar = blended([anna, ben], tmp_path, sharpen=0.0)
    assert avatar.sharpen == 0
    assert avatar.sharpness["pictures"] == avatar.sharpness["unsharpened"]


def test_finished_blends_are_taken_again_and_missing_or_damaged_ones_made_again_alike(anna, ben, tmp_path):
    first = blended([anna, ben], tmp_path)
    files = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in first.frames.files}
    lost, damaged = sorted(files)[1:3]
    lost.unlink()
    damaged.write_bytes(files[damaged][1][:-1] + bytes([files[damaged][1][-1] ^ 1]))  # one bit of the picture
    again = blended([ben, anna], tmp_path)
    assert sorted(again.frames.files) == sorted(files)
    for path, (time_ns, content) in files.items():
        assert path.read_bytes() == content
        assert (path.stat().st_mtime_ns == time_ns) == (path not in (lost, damaged))
    assert again.identities == ("ben", "anna")


def test_other_settings_blend_anew(anna, ben, tmp_path):
    first = blended([anna, ben], tmp_path)
    other = blended([anna, ben], tmp_path, weights=(2, 1))
    assert not set(first.frames.files) & set(other.frames.files)


@pytest.mark.parametrize(
    "changes, word",
    [
        ({"weights": (1, 2, 3)}, "3 weights do not fit 2 models"),
        ({"weights": (0, 0)}, "sum to 0"),
        ({"weights": (1, -1)}, "at least 0"),
        ({"weights": (1, float("nan"))}, "a list of numbers"),
        ({"weights": (1e308, 1e308)}, "more than a number can hold"),
        ({"method": "magic"}, "magic"),
        ({"max_sd": 0.0}, "max_sd is 0.0; expected a number from 0.001 to 1,000"),
        ({"max_sd": float("inf")}, "max_sd"),
        ({"expressions": 0}, "expressions"),
        ({"sharpen": -1.0}, "sharpen"),
        ({"sharpen": float("nan")}, "sharpen"),
        ({"sharpen": 3.1}, "from 0 to 3"),
        ({"components": 0}, "components"),
        ({"flow": "magic"}, "magic"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(changes, word):
    with pytest.raises(BadInput, match=word):
        shares_of(settings_of(**changes).weights, 2)


@pytest.mark.parametrize("role", ["faceframe", "reference", "surround"])
def test_an_identity_that_is_not_there_is_named_with_those_that_are(anna, ben, role):
    with pytest.raises(BadInput, match=r"carl.*anna, ben"):
        studio_of([anna, ben], settings_of(**{role: "carl"}))


def test_an_identity_without_weight_cannot_lend_its_face(anna, ben):
    with pytest.raises(BadInput, match="ben has the weight 0"):
        studio_of([anna, ben], settings_of(weights=(1, 0), surround="ben"))


def test_models_that_cannot_be_blended_are_refused(anna, ben, model):
    for models, word in (
        ([anna], "at least 2"),
        ([anna, model], "no keypoints"),
        ([anna, ben.with_faceframe(ELSEWHERE, {"lip": "upper-lip"})], "third keypoint"),
        ([anna, ben.truncate(0)], "0 components"),
    ):
        with pytest.raises(BadInput, match=word):
            studio_of(models, settings_of())


def test_the_same_person_twice_is_told(anna, model, tmp_path):
    other = named(model, "anna", ELSEWHERE)
    notes = " ".join(blended([anna, other], tmp_path).notes)
    assert "2 of the models are of anna" in notes


@pytest.fixture
def saved(anna, ben, model, tmp_path):
    paths = {}
    for name, one in (("anna", anna), ("ben", ben), ("plain", model)):
        paths[name] = tmp_path / f"{name}.morph"
        one.save(paths[name])
    return paths


@pytest.mark.usefixtures("without_networks")
def test_the_command_writes_a_model_that_opens_and_its_page(saved, tmp_path):
    out = tmp_path / "out" / "avatar.morph"
    words = [*map(str, (saved["anna"], saved["ben"])), "-o", str(out), "--expressions", "4", "--flow", "dis"]
    ran = CliRunner().invoke(main, ["blend-avatar", *words])
    assert ran.exit_code == 0, ran.output
    assert sorted(path.name for path in out.parent.iterdir()) == ["avatar.html", "avatar.morph"]
    assert "keypoints" in ran.output and "--auto" in ran.output  # for the landmarks that were not learned
    ran = CliRunner().invoke(main, ["info", str(out)])
    assert ran.exit_code == 0 and "avatar" in ran.output
    assert "anna 0.5, ben 0.5" in ran.output and "background of anna" in ran.output
    assert "registration" not in ran.output and "blended onto one faceframe" in ran.output


@pytest.mark.usefixtures("without_networks")
def test_too_few_expressions_for_landmarks_are_not_answered_with_a_verb_that_needs_as_many(saved, tmp_path):
    words = [str(saved["anna"]), str(saved["ben"]), "-o", str(tmp_path / "a.morph"), "--flow", "dis"]
    ran = CliRunner().invoke(main, ["blend-avatar", *words, "--expressions", "3", "--identity", "anna"])
    assert ran.exit_code == 0, ran.output
    assert "more --expressions" in ran.output and "keypoints" not in ran.output.split("landmarks, which")[1]
    assert "the avatar is named anna, like one of its sources" in ran.output


@pytest.mark.slow  # it blends twice
@pytest.mark.usefixtures("without_networks")
def test_a_model_file_that_is_cut_short_meanwhile_changes_nothing(saved, tmp_path):
    """The file is read as it is used: without a copy of its own the process would end on a bus error."""
    paths = (str(saved["anna"]), str(saved["ben"]))
    made = []
    for name in ("quiet", "cut"):
        request = blend_avatar.BlendAvatarRequest(
            paths, tmp_path / f"{name}.morph", expressions=4, flow="dis"
        )
        steps = blend_avatar.run(request)
        next(steps)
        if name == "cut":
            saved["ben"].write_bytes(saved["ben"].read_bytes()[:1000])
        made.append(result_of(steps))
    assert (tmp_path / "quiet.morph").read_bytes() == (tmp_path / "cut.morph").read_bytes()


@pytest.mark.usefixtures("without_networks")
def test_a_model_that_is_written_while_it_is_read_is_told(saved, tmp_path, monkeypatch):
    monkeypatch.setattr(set_models.shutil, "copyfile", lambda _, there: there.write_bytes(b"half"))
    request = blend_avatar.BlendAvatarRequest((str(saved["anna"]), str(saved["ben"])), tmp_path / "a.morph")
    with pytest.raises(BadInput, match="changed while it was read"):
        result_of(blend_avatar.run(request))
    assert not list(tmp_path.glob("a.*"))


def test_numbers_that_are_not_finite_are_refused(anna, ben):
    components = np.array(ben.basis.components)
    components[1, -5] = np.nan
    broken = replace(ben, basis=replace(ben.basis, components=components))
    with pytest.raises(BadInput, match="ben has numbers that are not finite"):
        studio_of([anna, broken], settings_of())


def test_a_version_that_goes_nowhere_is_refused_not_drawn(mixer, anna):
    displacement = np.array(anna.mean.displacement)
    displacement[3, 4] = np.nan
    nowhere = Version(Morph.of(anna.mean.texture, displacement, anna.mean.reference_id), 1.0)
    with pytest.raises(BadInput, match=r"2 of .* not finite"):
        mixer.mixed([nowhere, nowhere])
    with pytest.raises(BadInput, match="not finite"):
        mixer.picture(0, nowhere)
