"""Small figures of blends by hand: surround, doubt, places, judged versions, and what a studio prepares."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.avatar import AvatarSettings
from morphspace.avatar.blend import Mixer
from morphspace.avatar.build import BlendedFrames
from morphspace.avatar.common_grid import (
    CommonFace,
    Laid,
    check_finite,
    mean_faceframe,
    places_on,
    shortened,
    version_picture,
)
from morphspace.avatar.distances import mean_face_distances
from morphspace.avatar.notes import gaze
from morphspace.avatar.sharpness import Curve, _detail, curve, mean_curve, sharpened
from morphspace.avatar.studio import studio_of
from morphspace.avatar.versions import Cast, Gaps, Version, believed, falling
from morphspace.cache import result_file, write_result
from morphspace.errors import BadInput
from morphspace.face.mesh import POINT_COUNT
from morphspace.grid import warp
from morphspace.model.morph import Morph
from morphspace.requests import settings_in
from morphspace.transfer.neutral import neutral_of
from morphspace.verbs.blend_avatar import BlendAvatarRequest


def settings_of(**changes):
    """Give the settings of a blend as the verb has them, but for some."""
    return settings_in(BlendAvatarRequest(("a", "b"), "avatar.morph", **changes), AvatarSettings)


def test_vectors_are_shortened_towards_a_length_and_keep_their_direction():
    field = np.float32([[[0.03, 0.04], [3.0, 4.0], [-300.0, 400.0]]])
    found = shortened(field, 5.0)
    for short, long in zip(found[0], field[0], strict=True):
        length = np.hypot(*long)
        assert_allclose(short, long / np.sqrt(1 + (length / 5) ** 2), rtol=1e-5)
    assert found.shape == field.shape


def test_pictures_go_where_the_faceframes_lie(drawn_anna, drawn_ben):
    models = [drawn_anna.model, drawn_ben.model]
    frame = mean_faceframe(models, np.array([0.75, 0.25]))
    expected = 0.75 * models[0].faceframe.points + 0.25 * models[1].faceframe.points
    assert_allclose(frame.points, expected)
    for model, place in zip(models, places_on(models, frame), strict=True):
        assert_allclose(warp.apply_affine(place, model.faceframe.points), frame.points, atol=1e-6)
    mean = models[0].mean
    assert_allclose(version_picture(mean, np.eye(2, 3)), mean.render(), atol=1e-6)
    broken = Morph.of(mean.texture, np.full_like(mean.displacement, np.nan), mean.reference_id)
    with pytest.raises(BadInput, match="15360 of 15360"):
        check_finite(models[0], broken)


def common(models, mask=None):
    height, width = models[0].mask.shape
    zero, ones = np.zeros((height, width, 2), np.float32), np.ones((height, width), np.float32)
    return CommonFace(models, [zero] * len(models), ones if mask is None else mask, [ones] * len(models))


def test_the_surround_moves_with_its_owner_as_far_as_she_is_believed(drawn_anna):
    """Outside the mask: the owner's own version at full belief, her neutral face moved by the blend at none."""
    model = drawn_anna.model
    mask = np.zeros_like(model.mask)
    mask[40:60, 30:50] = 1
    mixer = Mixer(common([model, model], mask), np.array([0.5, 0.5]), [np.eye(2, 3)] * 2, 0)
    shown = model.expand(model.training.values[5])
    far = np.s_[:20]
    for belief, share in ((1.0, 1.0), (0.5, 0.5), (0.05, 0.0)):
        made = mixer.blended([Version(shown, belief), Version(shown, 1.0)])
        expected = model.mean.texture + share * (shown.texture - model.mean.texture)
        assert_allclose(made.texture[far], expected[far], atol=1e-5)
        moved = model.mean.displacement + share * (shown.displacement - model.mean.displacement)
        assert_allclose(made.displacement[far], moved[far], atol=1e-4)
    flat = replace(mixer, surround=None).blended([Version(shown, 1.0), Version(shown, 1.0)])
    assert_allclose(flat.texture[far], 0.5)
    assert_allclose(flat.displacement[far], model.mean.displacement[far], atol=1e-5)
    inside = np.s_[45:55, 35:45]
    assert_allclose(flat.displacement[inside], shown.displacement[inside], atol=1e-3)


def test_three_people_mix_by_their_weights(drawn_anna):
    """One face three times, in three shades: the mean shade, and what each version adds, by weight times belief."""
    model = drawn_anna.model
    people = [
        replace(model, mean=Morph.of(model.mean.texture + np.float32(c), model.mean.displacement, "x"))
        for c in (0.0, 0.1, 0.2)
    ]
    mixer = Mixer(common(people), np.array([0.5, 0.3, 0.2]), [np.eye(2, 3)] * 3, 0)
    assert_allclose(mixer.mean.texture, model.mean.texture + 0.07, atol=1e-5)
    versions = [Version(one.mean, belief) for one, belief in zip(people, (1.0, 0.5, 0.05), strict=True)]
    assert_allclose(mixer.used(versions), [0.5 / 0.65, 0.15 / 0.65, 0])
    made = mixer.blended(versions)
    assert_allclose(made.texture, mixer.mean.texture, atol=2e-3)
    assert len(mixer.rest) == 3 and len(mixer.usual) == 3
    empty = replace(mixer, common=common(people, np.zeros_like(model.mask)))
    assert empty.usual == (1.0, 1.0, 1.0)
    assert mixer.mask_picture.max() <= 1 and mixer.judged_picture[48, 40] == pytest.approx(1, abs=1e-3)
    half = replace(mixer.common, skin=[np.float32(0.4) * model.mask] * 3)
    assert replace(mixer, common=half).judged_picture[48, 40] == pytest.approx(0.4, abs=1e-3)


def test_a_version_is_laid_where_its_field_and_place_say(drawn_anna):
    model = drawn_anna.model
    shift = np.broadcast_to(np.float32((2.0, -1.0)), model.mean.displacement.shape)
    grid = replace(common([model, model]), fields=[np.zeros_like(shift), shift])
    place = np.array([[1.0, 0, -2.0], [0, 1.0, 1.0]])
    inner = np.s_[10:-10, 10:-10]
    laid = grid.laid(1, model.mean, place)
    assert isinstance(laid, Laid)
    assert_allclose(laid.texture[inner], np.roll(model.mean.texture, (1, -2), axis=(0, 1))[inner], atol=1e-5)
    moved = np.roll(model.mean.displacement, (1, -2), axis=(0, 1))
    assert_allclose(laid.displacement[inner], moved[inner], atol=1e-3)
    assert_array_equal(grid.laid(0, model.mean, np.eye(2, 3)).texture, model.mean.texture)


@pytest.mark.parametrize(
    ("value", "share"), [(-1.0, 1.0), (0.05, 1.0), (0.075, 0.75), (0.15, 0.0), (9.0, 0.0)]
)
def test_belief_falls_in_a_straight_line(value, share):
    assert falling(value, (0.05, 0.15)) == pytest.approx(share)


def test_a_persons_own_faces_are_shown_as_they_are(drawn_anna, drawn_ben):
    models = drawn_anna.model, drawn_ben.model
    cast = Cast(models, ["a", "b"], "map", 3.0, [None, None])
    for source in (0, 1):
        versions = cast.versions(source, cast.shows_from(source), 4)
        own, other = versions[source], versions[1 - source]
        row = models[source].training.values[4]
        assert own.is_own and not other.is_own and (own.plausibility, believed(own)) == (1.0, 1.0)
        assert_allclose(own.loadings, row) and assert_allclose(
            own.morph.vector, models[source].expand(row).vector
        )
        assert other.loadings.shape == (6,) and 0 <= other.plausibility <= 1
    twice = Cast((models[0], models[0]), ["a", "a"], "map", 3.0, [None, None])
    assert all(one.is_own for one in twice.versions(0, twice.shows_from(0), 2))


def test_gaps_are_measured_from_the_neutral_faces_of_both(drawn_anna):
    """A person to herself misses nothing; lids that should close and do not are missed by what they stand open."""
    model = drawn_anna.model
    gaps = Gaps(model, model, neutral_of(model, model, "f02,f02"))
    row = model.training.values[7]
    misfit, beyond = gaps.judged(row, row)
    assert misfit == pytest.approx(0, abs=1e-6) and beyond <= 1e-6
    widest = max(gaps.judged(one, one)[1] for one in model.training.values)
    assert widest == pytest.approx(0, abs=1e-6)
    right, left, _ = model.faceframe.points
    assert gaps.eyes_px == pytest.approx(np.hypot(*(left - right)))
    missed = gaps.judged(row, model.training.values[2])[0]
    of = [gaps._of(model, values) for values in (row, model.training.values[2])]
    assert missed == pytest.approx(np.abs(of[0] - of[1]).max() / gaps.eyes_px)


def test_the_amount_of_sharpening_is_the_least_root():
    grows = Curve(4.0, 1.0, 2.0)  # 4 + 2 a + 2 a^2
    assert [grows.at(amount) for amount in (0.0, 1.0, 2.0)] == [4, 8, 16]
    assert [grows.amount_for(wanted) for wanted in (3.0, 4.0, 8.0, 16.0)] == [0, 0, 1, 2]
    assert Curve(4.0, 1.0, 0.0).amount_for(9.0) == 0
    mean = mean_curve([Curve(1.0, 2.0, 3.0), Curve(3.0, 4.0, 5.0)])
    assert (mean.plain, mean.shared, mean.added) == (2.0, 3.0, 4.0)


def test_sharpening_adds_the_difference_from_a_blur(picture):
    """RADIUS: 0.006 of the width, 1.2 px of 200; a wave of 10 px keeps exp(-0.284) in the blur."""
    x = np.arange(200, dtype=np.float32)
    wave = np.repeat(np.tile(0.1 * np.cos(2 * np.pi * x / 10), (40, 1))[..., None], 3, axis=2)
    kept = 1 - np.exp(-((2 * np.pi * 1.2 / 10) ** 2) / 2)
    middle = np.s_[10:30, 50:150]
    assert_allclose(_detail(wave)[middle], kept * wave[middle], atol=2e-3)
    mask = np.full((40, 200), 0.5, np.float32)
    assert_allclose(sharpened(wave, mask, 2.0)[middle], (1 + kept) * wave[middle], atol=2e-3)
    assert sharpened(wave, mask, 0) is wave
    codes = 255 * wave[..., 0]
    laplacian = codes[:, :-2] + codes[:, 2:] - 2 * codes[:, 1:-1]
    inner = np.zeros_like(mask)
    inner[:, 1:-1] = 1
    assert curve(wave, inner).plain == pytest.approx(laplacian.var(), rel=0.01)


def test_blended_pictures_are_sharpened_in_their_masks_and_clipped(picture, tmp_path):
    file = result_file(tmp_path, "a")
    image = 1.2 * picture(20, 30)
    write_result(file, {"image": image}, {})
    mask = np.ones((20, 30), np.float32)
    frames = [BlendedFrames(("a",), (file,), (mask,), amount) for amount in (0.0, 1.0)]
    for one, amount in zip(frames, (0.0, 1.0), strict=True):
        (found,) = one.images([0])
        assert_allclose(found, np.clip(sharpened(image, mask, amount), 0, 1), atol=1e-6)
    assert frames[0].digests != frames[1].digests


def test_gaze_is_where_irises_stand_between_the_corners():
    points = np.zeros((POINT_COUNT, 2))
    for iris, left, right, x in ((468, 33, 133, 20.0), (473, 362, 263, 60.0)):
        points[left], points[right], points[iris] = (x - 6, 30), (x + 6, 30), (x + 3, 33)
    assert gaze(points) == pytest.approx(0.25)
    points[473, 0] = 60.0 - 3
    assert gaze(points) == pytest.approx(0.0)


def test_mean_faces_are_as_far_apart_as_their_landmarks(drawn_anna, drawn_ben):
    models = [drawn_anna.model, drawn_ben.model]
    found = mean_face_distances(models, drawn_anna.model, drawn_anna.model.mask > 0.5)
    assert found.shape_percent.shape == found.colour_percent.shape == (3, 3)
    assert_allclose(np.diag(found.shape_percent), 0)
    assert found.shape_percent[0, 2] < 1e-4 < found.shape_percent[0, 1]
    assert found.shape_percent[0, 1] == pytest.approx(found.shape_percent[1, 2], rel=1e-4)
    assert found.colour_percent[0, 2] < 1e-3 < found.colour_percent[0, 1] < 100


def test_a_studio_takes_who_has_weight_in_the_order_of_names_whatever_else_is_recorded(drawn_anna, drawn_ben):
    models = [drawn_ben.model, drawn_anna.model]
    studio = studio_of(models, settings_of(weights=(3, 1), expressions=2))
    assert [models[i].identity for i in studio.part] == ["drawn 4", "drawn 9"]
    for words in ("CC0", "CC BY", "none"):
        other = replace(models[1], provenance={**models[1].provenance, "licence": words})
        assert studio_of([models[0], other], settings_of(weights=(3, 1), expressions=2)).part == studio.part
    assert_allclose(studio.shares, [0.25, 0.75])
    assert studio.surround == studio.reference and len(studio.chosen()) == 4
    names = [model.identity for model in models]
    for place, name in enumerate(names):
        chosen = studio_of(models, settings_of(reference=name, surround=name, faceframe=name))
        assert chosen.part[chosen.reference] == chosen.part[chosen.surround] == place
        assert_allclose(chosen.faceframe(0).points, models[place].faceframe.points)
    flat = studio_of(models, settings_of(surround="flat", faceframe="source"))
    assert flat.surround is None
    assert_allclose(flat.faceframe(1).points, models[flat.part[1]].faceframe.points)
    assert flat.mixer(0) is not flat.mixer(1) and studio.mixer(0) is studio.mixer(1)
    alone = studio_of(models, settings_of(weights=(0, 2)))
    assert alone.part == (1,) and alone.reference == 0 and len(alone.cast.models) == 1
    with pytest.raises(BadInput, match="has the weight 0"):
        studio_of(models, settings_of(weights=(0, 2), reference=names[0]))
    assert len({str(one.identity()) for one in (studio, flat, alone)}) == 3
