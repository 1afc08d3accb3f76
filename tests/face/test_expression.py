"""Laws of rest: calm faces with the lips slightly apart are near it, wherever the head is."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.face.expression import (
    PARTED,
    distance_from_neutral,
    expression_of,
    lid_opening,
    mean_gap,
    mouth_opening,
    ring_gaps,
)
from morphspace.face.mesh import (
    LEFT_BROW,
    LEFT_LIDS,
    LIPS,
    LOWER_LIP_TOP,
    MOUTH_CORNERS,
    POINT_COUNT,
    RIGHT_BROW,
    RIGHT_LIDS,
    UPPER_LIP_BOTTOM,
    FacePoints,
)
from morphspace.grid import warp

EYES_PX = 30.0
TWICE = np.array([[2.0, 0, 0], [0, 2, 0]])
UPPER_LIDS, LOWER_LIDS = (160, 159, 158, 385, 386, 387), (144, 145, 153, 380, 374, 373)  # facing each other
MOVEMENT = np.array([[0.98, -0.17, 12.0], [0.17, 0.98, -4.0]])  # a similarity: turn of 10 degrees and a shift


def face(gap=PARTED, raised=()):
    """A face with the lips `gap` eye distances apart; the points `raised` stand 6 px higher."""
    points = np.random.default_rng(2).uniform((25, 30), (75, 85), (POINT_COUNT, 2))
    for lids, x in ((RIGHT_LIDS, 35.0), (LEFT_LIDS, 35.0 + EYES_PX)):
        points[list(lids)] += np.array([x, 46.0]) - points[list(lids)].mean(axis=0)
    points[list(LIPS), 1] = 78.0
    points[UPPER_LIP_BOTTOM] = (50.0, 78.0)
    points[LOWER_LIP_TOP] = (50.0, 78.0 + gap * EYES_PX)
    points[list(raised), 1] -= 6.0
    return FacePoints(points, 0.9)


def moved(one, movement):
    return one.moved(warp.apply_affine(movement, one.points))


def test_the_mouths_opening_is_in_eye_distances():
    assert expression_of(face(0.25)).mouth_opening == pytest.approx(0.25)
    assert expression_of(moved(face(0.25), TWICE)).mouth_opening == pytest.approx(0.25)


def circle(count):
    """A ring of radius 1 that runs over the top from left to right, and back below."""
    angles = 2 * np.pi * np.arange(count) / count
    return np.column_stack([-np.cos(angles), -np.sin(angles)])


def test_openings_of_a_circle_are_those_of_its_chords():
    """20 points of inner lips stand 18 degrees apart, 16 of lids 22.5; a chord is 2 sin of its angle."""
    assert mouth_opening(circle(20)) == pytest.approx(2)
    assert lid_opening(circle(16)) == pytest.approx((2 + 4 * np.sin(np.radians(67.5))) / 3)
    assert_allclose(
        mean_gap(circle(20)[None])[0], [0, ring_gaps(circle(20)[None])[0, :, 1].mean()], atol=1e-12
    )


def test_the_width_and_the_lids_are_in_eye_distances_too():
    points = face().points.copy()
    points[list(MOUTH_CORNERS)] = (41.0, 78.0), (59.0, 78.0)
    points[list(UPPER_LIDS)] = points[list(LOWER_LIDS)] - (0.0, 0.2 * EYES_PX)
    for one in (FacePoints(points, 0.9), FacePoints(2 * points, 0.9)):
        found = expression_of(one)
        assert found.mouth_width == pytest.approx(18 / one.interocular_px * one.points[61, 0] / 41.0)
        assert found.lid_opening == pytest.approx(
            0.2 * EYES_PX * one.points[61, 0] / 41.0 / one.interocular_px
        )


def test_calm_faces_with_the_lips_slightly_apart_are_nearest_to_rest():
    calm = [face() for _ in range(5)]
    far = distance_from_neutral([*calm, face(0.4), None, face(0.0), face(raised=RIGHT_BROW + LEFT_BROW)])
    assert_allclose(far[:5], 0, atol=1e-6)
    assert np.isinf(far[6])
    assert (far[[5, 7]] > 1).all() and far[8] > 0.5


def test_lips_that_are_closed_count_twice_as_much_as_lips_as_far_open():
    """CLOSED_STEP, OPEN_STEP: 0.04 and 0.08 eye distances; a warp opens no closed lips."""
    calm = [face(PARTED) for _ in range(9)]
    closer, wider = distance_from_neutral([*calm, face(PARTED - 0.1), face(PARTED + 0.1)])[-2:]
    assert 2.5 < closer < 2.6 and 1.25 < wider < 1.45


def test_a_blink_is_distance_from_neutral_and_wide_open_eyes_less():
    def eyed(gap):
        one = face()
        points = one.points.copy()
        points[list(UPPER_LIDS)] = points[list(LOWER_LIDS)] - (0.0, gap * EYES_PX)
        return FacePoints(points, 0.9)

    far = distance_from_neutral([*(eyed(0.12) for _ in range(5)), eyed(0.03), eyed(0.21)])
    assert far[5] > 2.5 and far[6] < 1


def test_where_the_head_is_does_not_count_for_rest():
    faces = [face(gap) for gap in (0.02, 0.15, 0.4, 0.15)]
    turned = [faces[0], moved(faces[1], MOVEMENT), faces[2], moved(faces[3], MOVEMENT)]
    assert_allclose(distance_from_neutral(turned), distance_from_neutral(faces), atol=1e-6)


def test_without_a_face_nothing_is_near_rest():
    assert_array_equal(distance_from_neutral([None, None]), [np.inf, np.inf])
