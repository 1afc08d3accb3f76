"""A correspondence of its own for each expression: landmarks start it, flow refines it, the mouth alone has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.avatar.blend import Mixer
from morphspace.avatar.common_grid import CommonFace, Laid
from morphspace.avatar.mouth import Landmarks, Matcher, _sure
from morphspace.avatar.versions import LEAST, Version
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import INNER_LIPS, LANDMARKS, OUTER_LIPS, POINT_COUNT, RIGID_POINTS, SCHEME
from morphspace.grid import warp
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.morph import Morph

FACEFRAME = FaceFrame((20.0, 30.0), (44.0, 30.0), (32.0, 50.0))
MOUTH = (32.0, 56.0)
HIGH, WIDE = 4.0, 9.0  # px, half axes of the outer lips
LOWER_PX = 2.0  # by how much lower than the first one's the mouth of the second is drawn
SURE, UNSURE = 0.1, 50.0  # px, error of the landmarks
STILL = [np.eye(2, 3)] * 2


def mesh(lower_px=0.0):
    """The points of the face mesh, (478, 2) px: two rings of lips, the nose, and the rest around the face."""
    angle = np.linspace(0, 2 * np.pi, POINT_COUNT, endpoint=False)
    points = np.stack([32 + 24 * np.cos(angle), 40 + 34 * np.sin(angle)], axis=-1)
    points[list(RIGID_POINTS)] = np.stack([32 + 8 * np.cos(np.arange(14)), 34 + np.arange(14.0)], axis=-1)
    for ring, share in ((OUTER_LIPS, 1.0), (INNER_LIPS, 0.6)):
        turn = np.pi + 2 * np.pi * np.arange(len(ring)) / len(ring)
        points[list(ring), 0] = MOUTH[0] + share * WIDE * np.cos(turn)
        points[list(ring), 1] = MOUTH[1] + lower_px + share * HIGH * np.sin(turn)
    return points


def mouth_drawn(model, lower_px):
    """The mean texture with a dark red mouth on plain skin, so low."""
    y, x = np.mgrid[: model.mask.shape[0], : model.mask.shape[1]].astype(np.float32)
    radius = np.hypot((x - MOUTH[0]) / WIDE, (y - MOUTH[1] - lower_px) / HIGH)
    lips = 0.5 - 0.5 * np.tanh(6 * (radius - 1))
    line = np.exp(-(((y - MOUTH[1] - lower_px) / 1.2) ** 2)) * lips
    skin = np.float32([0.8, 0.65, 0.55]) * np.ones_like(model.mean.texture)
    drawn = skin + lips[..., None] * (np.float32([0.6, 0.3, 0.3]) - skin) - np.float32(0.25) * line[..., None]
    return drawn.astype(np.float32)


def person(model, identity, lower_px, error_px=SURE):
    """A person who shows the mouth lower in colour than the mesh of the mean face tells, and whose regression knows."""
    mean = Morph.of(
        mouth_drawn(model, lower_px), np.zeros_like(model.mean.displacement), model.mean.reference_id
    )
    provenance = {**model.provenance, "identity": identity}
    made = replace(model, mean=mean, provenance=provenance)
    made = made.with_faceframe(FACEFRAME, {"lip": "philtrum", "scheme": SCHEME, "points": mesh().tolist()})
    places = list(LANDMARKS)
    zeros = np.zeros((model.rank, len(places), 2))
    return made.with_landmarks(
        LandmarkRegression(mesh(lower_px)[places], zeros, np.full(len(places), error_px), 12, 1.0, False)
    )


@pytest.fixture
def anna(model):
    return person(model, "anna", 0.0)


@pytest.fixture
def ben(model):
    return person(model, "ben", LOWER_PX)


def shown(*models, plausibility=1.0):
    """Everybody's mean face as their version; the first one's own expression."""
    rest = np.zeros(models[0].rank)
    return [
        Version(m.mean, 1.0 if k == 0 else plausibility, rest, is_own=k == 0) for k, m in enumerate(models)
    ]


def laid(*models):
    return {k: Laid(np.array(m.mean.texture), np.array(m.mean.displacement)) for k, m in enumerate(models)}


def matcher(*models, keys=("a", "b"), flow="dis"):
    return Matcher(models, keys, STILL, flow)


def at_mouth(field):
    x, y = (round(value) for value in MOUTH)
    return field[y - 2 : y + 3, x - 5 : x + 6]


def test_a_mouth_drawn_lower_is_found_there_and_nothing_else_moves(anna, ben):
    before = laid(anna, ben)
    out = matcher(anna, ben).matched(shown(anna, ben), before)
    assert out[0] is before[0]
    moved = out[1].displacement
    assert_allclose(at_mouth(moved)[..., 1], LOWER_PX, atol=0.4)  # px
    assert_allclose(at_mouth(moved)[..., 0], 0, atol=0.4)
    assert np.abs(moved[:30]).max() < 0.01
    assert np.abs(at_mouth(out[1].texture) - at_mouth(anna.mean.texture)).max() < 0.05
    assert np.abs(at_mouth(before[1].texture) - at_mouth(anna.mean.texture)).max() > 0.15


def test_flow_leaves_the_start_by_a_twentyfifth_of_the_width_at_most(model, anna):
    """MOST_BEYOND_START, 2.6 px of 64: a mouth 5 px lower than its landmarks say is followed by 2.3 px."""
    low = person(model, "ben", 0.0)
    drawn = Morph.of(mouth_drawn(model, 5.0), low.mean.displacement, low.mean.reference_id)
    out = matcher(anna, replace(low, mean=drawn)).matched(
        shown(anna, replace(low, mean=drawn)), laid(anna, low)
    )
    width = model.mask.shape[1]
    found = at_mouth(out[1].displacement)[..., 1]
    assert 0.5 * 0.04 * width < found.mean() and found.max() < 0.04 * width


def test_what_was_found_is_read_where_it_is_drawn(anna, ben):
    """The texture on the grid, put where the field says, is the version's own picture there."""
    one = matcher(anna, ben).matched(shown(anna, ben), laid(anna, ben))[1]
    again = warp.sample(np.array(ben.mean.texture), one.displacement)
    assert_allclose(one.texture, again, atol=1e-5)


def test_matched_mouths_blend_into_one_mouth_in_between(anna, ben):
    height, width = anna.mask.shape
    zero, ones = np.zeros((height, width, 2), np.float32), np.ones((height, width), np.float32)
    common = CommonFace([anna, ben], [zero, zero], ones, [ones, ones])
    match = matcher(anna, ben).matched
    for weights, expected in (((0.5, 0.5), 0.5), ((0.75, 0.25), 0.25)):
        made = Mixer(common, np.array(weights), STILL, 0, match).mixed(shown(anna, ben))
        column = made[:, round(MOUTH[0])].mean(axis=-1)
        line = np.argmin(column[45:70]) + 45
        assert line == pytest.approx(MOUTH[1] + expected * LOWER_PX, abs=0.8)  # px


def test_landmarks_that_err_by_more_than_they_are_off_move_nothing(model, anna):
    unsure = person(model, "ben", LOWER_PX, UNSURE)
    same = replace(
        unsure, mean=Morph.of(anna.mean.texture, unsure.mean.displacement, unsure.mean.reference_id)
    )
    out = matcher(anna, same).matched(shown(anna, same), laid(anna, same))
    assert (
        np.abs(out[1].displacement).max() < 0.1
    )  # px: the pictures are the same, and the points say otherwise


def test_what_landmarks_are_off_is_doubted_by_the_errors_of_both():
    """DOUBT: 2.5 times both errors; 5 px off with errors of 1.2 and 1.6 px count as 5 x 25 / 50."""
    off = np.array([[3.0, 4.0], [3.0, 4.0], [0.0, 0.0]])
    errors = np.array([1.2, 0.0, 1.0]), np.array([1.6, 0.0, 0.0])
    one, other = (Landmarks(np.zeros((3, 2)), each) for each in errors)
    assert_allclose(_sure(off, one, other), [[1.5, 2.0], [3.0, 4.0], [0.0, 0.0]])


def test_a_person_without_landmarks_stays_as_at_rest(anna, ben):
    for models in ((anna, ben.with_landmarks(None)), (anna.with_landmarks(None), ben)):
        before = laid(*models)
        out = matcher(*models).matched(shown(*models), before)
        assert all(out[k] is before[k] for k in before)


def test_what_is_not_believed_or_is_the_same_model_is_not_matched(anna, ben):
    before = laid(anna, ben)
    out = matcher(anna, ben).matched(shown(anna, ben, plausibility=LEAST / 2), before)
    assert out[1] is before[1]
    out = matcher(anna, ben, keys=("a", "a")).matched(shown(anna, ben), before)
    assert out[1] is before[1]


def test_everything_is_matched_to_whose_expression_it_is(anna, ben):
    versions = [replace(one, is_own=k == 1) for k, one in enumerate(shown(anna, ben))]
    before = laid(anna, ben)
    out = matcher(anna, ben).matched(versions, before)
    assert out[1] is before[1]
    assert_allclose(at_mouth(out[0].displacement)[..., 1], -LOWER_PX, atol=0.4)  # px


def test_the_region_is_around_the_lips(anna, ben):
    points = Landmarks(mesh()[list(Matcher.holding)], np.zeros(len(Matcher.holding)))
    height, width = anna.mask.shape
    region = matcher(anna, ben).region(points, height, width)
    x, y = (round(value) for value in MOUTH)
    assert region[y, x] > 0.99 and region[y, x + round(WIDE)] > 0.5
    assert region[y - 14, x] < 0.01 and region[y, 5] < 0.01


def test_the_same_again_gives_the_same_bytes(anna, ben):
    out = [matcher(anna, ben).matched(shown(anna, ben), laid(anna, ben))[1] for _ in range(2)]
    assert_array_equal(out[0].displacement, out[1].displacement)
    assert_array_equal(out[0].texture, out[1].texture)


def test_places_are_where_the_landmarks_go_too(anna, ben):
    shift = np.float64([[1, 0, 3], [0, 1, -2]])
    moved = replace(matcher(anna, ben), places=[shift, shift])
    one, other = (m.landmarks(0, shown(anna)[0]) for m in (matcher(anna, ben), moved))
    assert_allclose(other.points - one.points, np.broadcast_to([3.0, -2.0], one.points.shape))
