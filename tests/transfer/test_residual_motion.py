"""Laws of what is added back: a small miss by its share, a large one never by more than the limit, and no folds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.face.faceframe import FaceFrame
from morphspace.grid import warp
from morphspace.model.morph import Morph
from morphspace.transfer.residual_motion import RESIDUAL_LIMIT, RESIDUAL_SHARE, residual_motion_of

FRAME = FaceFrame((20.0, 30.0), (40.0, 30.0), (30.0, 44.0))
LIMIT_PX = RESIDUAL_LIMIT * 20.0


@pytest.fixture
def person(model):
    return model.with_faceframe(FRAME)


def added(person, missing, seen=1.0):
    """The motion that is added to the mean face."""
    height, width = person.mask.shape
    still = Morph.of(person.mean.texture, np.zeros((height, width, 2), np.float32), person.mean.reference_id)
    field = np.broadcast_to(np.float32(missing), (height, width, 2)).astype(np.float32)
    return (
        residual_motion_of(person, np.full((height, width), seen, np.float32))
        .added(field, still)
        .displacement
    )


def test_a_small_miss_is_added_by_its_share_inside_the_masks(person):
    for seen in (1.0, 0.3):
        expected = RESIDUAL_SHARE * seen * person.mask[..., None] * np.float32((0.03, -0.04))
        assert_allclose(added(person, (0.03, -0.04), seen), expected, atol=1e-4)


def test_a_large_miss_bends_towards_the_limit_and_keeps_its_direction(person):
    field = added(person, (300.0, -400.0))
    length = np.hypot(field[..., 0], field[..., 1])
    inside = person.mask > 0.99
    assert length.max() <= LIMIT_PX * 1.0001 and length[inside].min() > 0.99 * LIMIT_PX
    assert_allclose(field[inside, 1], -4 / 3 * field[inside, 0], rtol=1e-4)


def test_nothing_folds(person, wavy_field):
    height, width = person.mask.shape
    wild = wavy_field(height, width, 200.0, seed=5, sd_px=2.0)
    still = Morph.of(person.mean.texture, np.zeros((height, width, 2), np.float32), person.mean.reference_id)
    residual = residual_motion_of(person, np.ones((height, width), np.float32))
    assert (warp.determinants(residual.share[..., None] * wild) <= 0).any()
    assert (warp.determinants(residual.added(wild, still).displacement) > 0).all()
