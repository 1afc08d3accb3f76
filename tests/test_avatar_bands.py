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
    shown = [Shown(texture, ALL * 0.7), Shown(texture, ALL * 0.3)]
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
