"""What an avatar chooses and says before it blends: the reference, the limits of its settings, its notes, a pair."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.avatar import AvatarSettings
from morphspace.avatar.build import _nearest_to_rest, checked, joint_entry
from morphspace.avatar.notes import notes_on
from morphspace.avatar.pair import pair_model
from morphspace.avatar.selection import nearest_to_all
from morphspace.avatar.settings import Expression, check_models, identity_at, method_of, shares_of
from morphspace.avatar.studio import studio_of
from morphspace.avatar.versions import Version
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LIPS, POINT_COUNT, RIGID_POINTS, SCHEME
from morphspace.grid import warp
from morphspace.linear.quality import psnr_db
from morphspace.requests import settings_in
from morphspace.verbs.blend_avatar import BlendAvatarRequest

EYES = ((20.0, 30.0), (44.0, 30.0))  # 24 px apart


def settings_of(**changes):
    """Give the settings of a blend as the verb has them, but for some."""
    return settings_in(BlendAvatarRequest(("a", "b"), "avatar.morph", **changes), AvatarSettings)


def person(model, lip_y, identity="anna", size=1.0):
    """The model with a faceframe whose lip lies so low, all of it so many times as large."""
    points = size * np.array([*EYES, (32.0, lip_y)])
    named = replace(model, provenance={**model.provenance, "identity": identity})
    return named.with_faceframe(FaceFrame.at(points))


def meshed(model, lower_px, identity="anna"):
    """The model with mesh points in two rows, of which the lips lie so much lower."""
    points = np.column_stack([np.linspace(20, 44, POINT_COUNT), 30 + 20 * (np.arange(POINT_COUNT) % 2)])
    points[list(LIPS), 1] += lower_px
    found = person(model, 50.0, identity)
    return found.with_faceframe(
        found.faceframe, {"lip": "philtrum", "scheme": SCHEME, "points": points.tolist()}
    )


def test_the_reference_is_the_face_nearest_to_all_others(model):
    """By keypoints in eye distances of the other: a small face counts one pixel for more."""
    for made in (person, meshed):
        faces = [made(model, lower) for lower in (0.0, 9.0, 4.0)]
        if made is person:
            faces = [person(model, 50.0 + lower) for lower in (0.0, 9.0, 4.0)]
        assert nearest_to_all(faces) == 2
        assert nearest_to_all(faces[::-1]) == 0
    assert nearest_to_all([person(model, 50.0)]) == 0
    assert nearest_to_all([person(model, 50.0), person(model, 50.0)]) == 0  # the first of equals
    assert nearest_to_all([person(model, 50.0), meshed(model, 5.0), person(model, 52.0)]) in (0, 1)
    # Of a face and its double each is as far from the other; the small one has the smaller unit.
    assert nearest_to_all([person(model, 50.0), person(model, 50.0, size=2.0)]) == 0


@pytest.mark.parametrize(
    ("name", "most", "beyond"),
    [
        ("sharpen", 3.0, 3.01),
        ("sharpen", 0.0, -0.01),
        ("expressions", 1, 0),
        ("components", 1, 0),
        ("max_sd", 1e-3, 0.0),
    ],
)
def test_settings_are_used_up_to_their_limits(name, most, beyond):
    assert getattr(settings_of(**{name: most}), name) == most
    with pytest.raises(BadInput):
        settings_of(**{name: beyond})


def test_weights_are_shares_and_equal_without_words():
    assert_allclose(shares_of(None, 4), [0.25] * 4)
    assert_allclose(shares_of((3, 1, 0), 3), [0.75, 0.25, 0])
    assert_allclose(shares_of((0.0, 1e-9), 2), [0, 1])
    for bad in ((1.0, -1e-9), (0.0, 0.0), (1.0,)):
        with pytest.raises(BadInput):
            shares_of(bad, 2)
    plain = settings_of()
    assert (plain.expressions, plain.components, plain.max_sd) == (40, 50, 3.0)


def test_three_expressions_are_the_least(model):
    people = [person(model, 50.0), person(model, 51.0, "ben")]
    assert len(checked(people, settings_of(expressions=2))[1]) == 4

    def of_frames(one, count):
        training = one.training
        return replace(
            one,
            training=replace(
                training, values=training.values[:count], frame_names=training.frame_names[:count]
            ),
        )

    assert len(checked([of_frames(people[0], 2), of_frames(people[1], 1)], settings_of())[1]) == 3
    with pytest.raises(BadInput, match="2 expressions are too few"):
        checked([of_frames(one, 1) for one in people], settings_of())


def test_the_expression_nearest_to_its_own_mean_is_that_of_the_least_loadings(drawn_anna, drawn_ben):
    studio = studio_of([drawn_anna.model, drawn_ben.model], settings_of(expressions=6))
    chosen = studio.chosen()
    far = [
        np.square(studio.cast.models[source].training.values[frame] / studio.cast.models[source].sd).mean()
        for source, frame in chosen
    ]
    assert _nearest_to_rest(studio, chosen) == np.argmin(far)
    assert _nearest_to_rest(studio, chosen[::-1]) == len(far) - 1 - np.argmin(far)


def test_a_place_is_that_of_its_label_and_a_method_follows_the_landmarks(drawn_anna, model):
    assert [identity_at(name, ("a", "b", "c"), "the surround") for name in "abc"] == [0, 1, 2]
    known, unknown = drawn_anna.model, person(model, 50.0)
    assert method_of("auto", [known, known]) == "guided"
    assert method_of("auto", [known, unknown]) == method_of("auto", [unknown, known]) == "transfer"
    assert [method_of(name, [unknown]) for name in ("paper", "map", "guided")] == ["paper", "map", "guided"]


def test_models_of_one_size_lip_and_finite_numbers_are_blended(model):
    people = [person(model, 50.0), person(model, 51.0, "ben")]
    check_models(people)
    spoilt = model.mask.copy()
    spoilt[0, 0] = np.nan
    empty = replace(people[1].training, values=people[1].training.values[:0], frame_names=())
    for bad in (replace(people[1], mask=spoilt), replace(people[1], training=empty)):
        with pytest.raises(BadInput):
            check_models([people[0], bad])


def said(models, share=1.0, expressions=(), **settings):
    provenance = settings.pop("provenance", {})
    return notes_on(
        studio_of(models, replace(settings_of(**settings), provenance=provenance)), expressions, share
    )


@pytest.mark.parametrize(("share", "is_said"), [(0.84, True), (0.86, False), (1.19, False), (1.21, True)])
def test_a_blend_is_as_sharp_from_85_to_120_percent(model, share, is_said):
    """SHARP_ENOUGH."""
    people = [person(model, 50.0), person(model, 51.0, "ben")]
    notes = " ".join(said(people, share))
    assert ("as sharp as its sources" in notes) == is_said
    assert ("would draw rings around edges" in notes) == (share == 0.84)
    assert ("no more than necessary" in notes) == (share == 1.21)
    assert ("--sharpen auto" in " ".join(said(people, share, sharpen=1.0))) == is_said


@pytest.mark.parametrize(("right_px", "is_said"), [(0.9, False), (1.1, True)])
def test_irises_a_tenth_of_an_eye_apart_are_told(model, right_px, is_said):
    """LOOKING_APART: eyes are 10 px wide."""
    people = []
    for name, moved_px in (("anna", 0.0), ("ben", right_px), ("carl", right_px / 2)):
        points = np.tile([32.0, 40.0], (POINT_COUNT, 1))
        for x, iris, left, right in ((20.0, 468, 33, 133), (44.0, 473, 362, 263)):
            points[left], points[right], points[iris] = (x - 5, 30), (x + 5, 30), (x + moved_px, 31)
        found = person(model, 50.0, name)
        people.append(
            found.with_faceframe(
                found.faceframe, {"lip": "philtrum", "scheme": SCHEME, "points": points.tolist()}
            )
        )
    notes = " ".join(said(people))
    assert ("look in different directions" in notes) == is_said
    assert ("of anna and ben look" in notes) == is_said


def test_who_takes_no_part_repeats_or_shares_a_name_is_told(model):
    anna, ben = person(model, 50.0), person(model, 51.0, "ben")
    assert not [note for note in said([anna, ben]) if "mesh points" not in note]
    assert "the weight of ben is 0" in " ".join(said([anna, ben], weights=(1, 0)))
    assert "only one identity has a weight above 0" in " ".join(said([anna, ben], weights=(1, 0)))
    assert "only one" not in " ".join(said([anna, ben], weights=(1, 0), faceframe="source"))
    assert "2 of the models are of anna" in " ".join(said([anna, person(model, 52.0)]))
    assert "named ben, like one of its sources" in " ".join(said([anna, ben], provenance={"identity": "ben"}))
    assert "is named" not in " ".join(said([anna, ben], provenance={"identity": "dora"}))


@pytest.mark.parametrize(("count", "words"), [(2, "(e0, e1)"), (3, "(e0, e1, e2)"), (4, "(e0, e1, e2, ...)")])
def test_three_of_the_expressions_without_somebody_are_named(model, count, words):
    people = [person(model, 50.0), person(model, 51.0, "ben")]
    one = [Expression(0, "f", f"e{n}", np.array([1.0, 0.5 * (n >= count)]), np.ones(2)) for n in range(6)]
    (note,) = [note for note in said(people, 1.0, one) if "left out" in note]
    assert f"ben is left out of {count} of 6" in note and words in note


def test_an_entry_that_models_share_stands_once_and_others_stand_with_their_labels():
    assert joint_entry(("a", "b"), ["CC0", "CC0"]) == "CC0"
    assert joint_entry(("a", "b"), [None, None]) is None
    assert joint_entry(("a", "b"), ["CC0", None]) == "a: CC0; b: not recorded"


def test_a_version_belongs_to_nobody_unless_it_says_so(drawn_anna):
    assert not Version(drawn_anna.model.mean, 1.0).is_own


@pytest.fixture(scope="module")
def pair(drawn_anna, drawn_ben):
    weighty = replace(drawn_ben.model, warp_weight=0.2)
    return pair_model([drawn_anna.model, weighty], flow="dis", inputs={"a": "1"}, versions={"b": "2"})


def test_a_pair_lies_half_way_between_its_faces(pair, drawn_anna, drawn_ben):
    one, other = drawn_anna.model, drawn_ben.model
    assert pair.model.warp_weight == pytest.approx(0.1)  # the geometric mean of 0.05 and 0.2
    laid = warp.apply_affine(pair.place, other.faceframe.points)
    assert np.abs(pair.model.faceframe.points - (one.faceframe.points + laid) / 2).max() < 0.6  # px
    first, second = pair.model.training.values
    assert_allclose(first, -second, rtol=1e-3)
    onto = warp.affine_displacement(warp.inverse_affine(pair.place), *one.mask.shape)
    truths = one.mean.render(), warp.sample(other.mean.render(), onto)
    for loadings, truth in zip((first, second), truths, strict=True):
        assert psnr_db(pair.model.render(loadings), truth, pair.model.mask) > 34
    assert pair.model.training.frame_names == (one.identity, other.identity)


def test_a_pair_is_placed_from_brow_to_nose(pair, drawn_anna, drawn_ben):
    points = [np.asarray(one.model.provenance["keypoints"]["points"]) for one in (drawn_anna, drawn_ben)]
    rigid = list(RIGID_POINTS)
    off = warp.apply_affine(pair.place, points[1][rigid]) - points[0][rigid]
    assert np.hypot(*off.T).mean() < np.hypot(*(points[1] - points[0])[rigid].T).mean()
    linear = pair.place[:, :2]
    assert_allclose(linear @ linear.T, np.linalg.det(linear) * np.eye(2), atol=1e-9)  # a similarity


def test_the_points_of_a_pair_have_two_decimals(pair):
    """POINT_DIGITS."""
    points = np.asarray(pair.model.provenance["keypoints"]["points"])
    assert_allclose(points, np.round(points, 2), atol=1e-9)
    assert np.abs(points - np.round(points, 1)).max() > 0.02


def test_a_pair_tells_where_it_comes_from(pair, drawn_anna, drawn_ben):
    provenance, size = pair.model.provenance, list(drawn_anna.model.size)
    assert provenance["pair"]["model_ids"] == [drawn_anna.model.model_id, drawn_ben.model.model_id]
    assert_allclose(provenance["pair"]["placed"], pair.place)
    assert provenance["framing"] == {"source_size": size, "crop": None, "size": size}
    assert (provenance["components_asked"], provenance["inputs"], provenance["versions"]) == (
        1,
        {"a": "1"},
        {"b": "2"},
    )


@pytest.mark.parametrize(("count", "word"), [(1, "1 models make no pair"), (2, "same one"), (3, "3 models")])
def test_a_pair_is_of_two_different_faces(drawn_anna, count, word):
    with pytest.raises(BadInput, match=word):
        pair_model([drawn_anna.model] * count, flow="dis", inputs={}, versions={})
