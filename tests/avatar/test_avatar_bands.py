"""Mixing textures band by band: nothing is lost of one person, nothing is averaged that is fine."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.avatar.bands import Shown, banded, changed, detail_of, strength
from morphspace.avatar.sharpness import sharpness

ALL = np.ones((60, 50), np.float32)


def skin(seed):
    """A picture (60, 50, 3) as fine as pores are, in grey."""
    rough = np.random.default_rng(seed).standard_normal((60, 50, 1)).astype(np.float32)
    fine = cv2.GaussianBlur(rough, (0, 0), 0.5)[..., None]
    return np.repeat(0.5 + 0.1 * fine, 3, axis=2).astype(np.float32)


def usual_of(*textures):
    return [float(strength(detail_of(texture)).mean()) for texture in textures]


def mean_of(*textures):
    return np.mean(textures, axis=0, dtype=np.float32)


def test_one_person_alone_comes_back():
    texture = skin(2)
    assert_allclose(banded(texture, [Shown(texture, ALL)], usual_of(texture)), texture, atol=1e-6)


def test_a_person_mixed_with_themselves_comes_back():
    texture = skin(2)
    shown = [Shown(texture, ALL, 0.7), Shown(texture, ALL, 0.3)]
    assert_allclose(banded(texture, shown, usual_of(texture, texture)), texture, atol=1e-6)


def test_detail_of_different_people_fades_less_than_in_their_mean():
    one, other = skin(2), skin(9)
    mixed = banded(mean_of(one, other), [Shown(one, ALL), Shown(other, ALL)], usual_of(one, other))
    assert sharpness(mixed, ALL) > 1.1 * sharpness(mean_of(one, other), ALL)


def test_detail_comes_from_where_it_is():
    """One has texture on the left, the other on the right: each half shows its owner's; a mean has half of it."""
    one, other = skin(2), skin(9)
    one[:, 25:], other[:, :25] = 0.5, 0.5
    mixed = banded(mean_of(one, other), [Shown(one, ALL), Shown(other, ALL)], [0.0, 0.0])
    for half, owner in ((np.s_[10:50, 5:15], one), (np.s_[10:50, 35:45], other)):
        assert_allclose(detail_of(mixed)[half], detail_of(owner)[half], atol=0.1)
        # The band below is a mean still, and some of it is fine.
        assert detail_of(mixed)[half].std() > 0.65 * detail_of(owner)[half].std()


def test_a_sharper_camera_has_no_more_say():
    """Twice the detail everywhere is what is usual there: with that known, both count alike."""
    one, other = skin(2), skin(9)
    louder = one + detail_of(one)
    shown = [Shown(louder, ALL), Shown(other, ALL)]
    told, untold = (
        banded(mean_of(louder, other), shown, usual) for usual in (usual_of(louder, other), [1.0, 1.0])
    )
    likeness = [float(np.vdot(detail_of(mixed), detail_of(other))) for mixed in (told, untold)]
    assert likeness[0] > 1.1 * likeness[1]


def test_who_has_no_share_shows_nothing_fine():
    one, other = skin(2), skin(9)
    mixed = banded(one, [Shown(one, ALL), Shown(other, 0 * ALL)], usual_of(one, other))
    assert np.abs(mixed - one).max() < 0.05


def test_where_all_is_flat_all_is_flat():
    flat = np.full((60, 50, 3), 0.4, np.float32)
    assert_allclose(banded(flat, [Shown(flat, ALL)] * 2, [0.0, 0.0]), flat, atol=1e-6)


@pytest.mark.parametrize("added, expected", [(0.0, 0.0), (0.02, 0.0), (0.05, 0.5), (-0.05, 0.5), (0.3, 1.0)])
def test_a_face_becomes_another_by_how_much_its_colours_change(added, expected):
    assert_allclose(changed(np.full((60, 50, 3), added, np.float32)), expected, atol=1e-5)


def glasses():
    """A face (60, 200, 3) with a fine line and next to nothing else that is fine, after one without the line."""
    bare, worn = (np.tile(0.5 + 0.02 * (skin(seed) - 0.5), (1, 4, 1)) for seed in (2, 9))
    worn[30, 40:160] -= np.float32(0.3)
    return bare, worn


def contrast(mixed, worn):
    """How much of the line is left to see in the finest band, 1 as its owner shows it."""
    line = np.s_[27:34, 60:140]
    own = detail_of(worn)[line]
    return float(np.vdot(detail_of(mixed)[line], own) / np.vdot(own, own))


def mixed_with(weights, textures):
    mean = np.tensordot(np.array(weights, np.float32) / sum(weights), np.array(textures), 1)
    shown = [
        Shown(texture, np.ones(texture.shape[:2], np.float32), weight)
        for texture, weight in zip(textures, weights, strict=True)
    ]
    return banded(mean, shown, [1e-4] * len(shown))


def test_detail_that_one_alone_has_fades_in_a_straight_line_with_the_weight():
    """Were strength and weight one product, a twentieth of the weight would show the line almost whole."""
    bare, worn = glasses()
    weights = np.array([0.0, 0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.0])
    seen = np.array([contrast(mixed_with((1 - w, w), (bare, worn)), worn) for w in weights])
    assert (np.diff(seen) > 0).all()
    assert abs(seen[0]) < 0.01 and seen[-1] == pytest.approx(1, abs=1e-4)
    up_to_equal = weights <= 0.5
    assert_allclose(seen[up_to_equal], 2 * weights[up_to_equal] * seen[4], atol=0.01)
    assert seen[4] > 0.9  # with equal weights it is not halved, as a mean would halve it


def test_a_weight_near_zero_is_as_no_weight():
    bare, worn = glasses()
    third = np.flipud(bare)
    for weights in ((1.0, 0.0), (0.6, 0.4)):
        without = mixed_with(weights, (bare, worn))
        nearly = mixed_with((*weights, 1e-6), (bare, worn, third))
        assert_allclose(nearly, without, atol=1e-4)


def test_equal_weights_deal_detail_out_by_strength_alone():
    one, other = skin(2), skin(9)
    for weight in (0.5, 1.0, 7.0):
        assert_allclose(
            mixed_with((weight, weight), (one, other)), mixed_with((1, 1), (one, other)), atol=1e-5
        )
    strong = [strength(detail_of(texture))[..., None] for texture in (one, other)]
    expected = (strong[0] * detail_of(one) + strong[1] * detail_of(other)) / (strong[0] + strong[1])
    coarser = np.mean([texture - detail_of(texture) for texture in (one, other)], axis=0, dtype=np.float32)
    assert_allclose(mixed_with((1, 1), (one, other)) - coarser, expected, atol=2e-3)


def test_detail_of_one_among_three_is_never_less_with_more_weight():
    bare, worn = glasses()
    third = np.flipud(bare)
    seen = [contrast(mixed_with((0.5, w, 0.3), (bare, worn, third)), worn) for w in np.linspace(0, 1, 11)]
    assert (np.diff(seen) > -1e-3).all() and seen[0] < 0.02 and seen[-1] > 0.95


def test_a_wave_is_mixed_by_the_bands_it_lies_in():
    """FINE and COARSE: Gaussians of 2 and 8 px leave 0.881 and 0.132 of a wave of 25 px.

    The mean has half of it, the band below the coarse part 0.8, as shares tell, and the finest band all of it.
    """
    x = np.arange(200, dtype=np.float32)
    wave = np.tile(np.cos(2 * np.pi * x / 25)[None, :, None], (60, 1, 3)).astype(np.float32)
    one, flat = 0.5 + 0.1 * wave, np.full_like(wave, 0.5)
    ones = np.ones(wave.shape[:2], np.float32)
    mixed = banded(mean_of(one, flat), [Shown(one, ones), Shown(flat, 0.25 * ones)], [0.0, 0.0])
    middle = np.s_[20:40, 50:150]  # four waves
    fine, coarse = (np.exp(-((2 * np.pi * sd_px / 25) ** 2) / 2) for sd_px in (2.0, 8.0))
    expected = 0.5 * coarse + 0.8 * (fine - coarse) + (1 - fine)
    seen = np.vdot(mixed[middle] - 0.5, wave[middle]) / np.vdot(wave[middle], wave[middle])
    assert seen / 0.1 == pytest.approx(expected, abs=0.01)


def test_detail_weaker_than_a_thousandth_of_luma_counts_as_much_as_none():
    """LEAST_STRENGTH: detail whose variance is a millionth counts two to one against none."""
    one, flat = skin(2), np.full((60, 50, 3), 0.5, np.float32)
    one = 0.5 + (one - 0.5) * np.float32(1e-3 / np.sqrt(strength(detail_of(one)).mean()))
    strong = strength(detail_of(one))[..., None]
    expected = (strong + 1e-6) / (strong + 2e-6) * detail_of(one)
    mixed = banded(mean_of(one, flat), [Shown(one, ALL), Shown(flat, ALL)], [0.0, 0.0])
    coarser = mean_of(one - detail_of(one), flat)
    assert_allclose(mixed - coarser, expected, atol=2e-5)


def test_a_share_of_nothing_counts_as_a_thousandth():
    """LEAST_SHARE."""
    one, other = skin(2), np.roll(skin(9), 5, axis=0)
    mixed = [
        banded(one, [Shown(one, share * ALL), Shown(other, share * ALL)], [0.0, 0.0]) for share in (0, 1)
    ]
    assert_allclose(*mixed, atol=1e-5)  # of nothing and nothing each counts half
    beside = [
        banded(one, [Shown(one, ALL), Shown(other, share * ALL)], [0.0, 0.0]) for share in (0, 1e-3, 5e-3)
    ]
    assert_allclose(beside[0], beside[1], atol=1e-7)
    assert np.abs(beside[2] - beside[1]).max() > 1e-5
