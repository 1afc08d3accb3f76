"""Lips and openings: points are met exactly, nothing turns over, and what is unknown follows its neighbours."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.face.mesh import INNER_LIPS, LEFT_LIDS, OUTER_LIPS, POINT_COUNT, RIGHT_LIDS
from morphspace.face.rims import LEAST_GAP, OPENINGS, TRIANGLES, completed, rims_of
from morphspace.grid import warp

SIZE = (80, 64)


def face(opening=6.0, lids=5.0):
    """478 points, px, of which lips and lids lie on ellipses.

    Lips run from the picture's left along the upper side and back, lids from the outer corner along the lower side.
    """
    points = np.zeros((POINT_COUNT, 2))
    for ring, middle, radii, start, sense in (
        (OUTER_LIPS, (32, 58), (14, 4 + opening / 2), np.pi, 1),
        (INNER_LIPS, (32, 58), (10, opening / 2), np.pi, 1),
        (RIGHT_LIDS, (20, 30), (7, lids / 2), np.pi, -1),
        (LEFT_LIDS, (44, 30), (7, lids / 2), 0, 1),
    ):
        turn = start + sense * 2 * np.pi * np.arange(len(ring)) / len(ring)
        points[list(ring)] = np.array(middle) + np.array(radii) * np.column_stack(
            [np.cos(turn), np.sin(turn)]
        )
    return points


RINGS = [*OUTER_LIPS, *INNER_LIPS, *RIGHT_LIDS, *LEFT_LIDS]
RIMS = rims_of(face(), *SIZE)


def inside(rims=RIMS):
    out = np.zeros(SIZE, bool)
    out[rims.rows, rims.columns] = True
    return out


def areas(field):
    return warp.determinants(field)[
        inside()[:-1, :-1] & inside()[1:, 1:] & inside()[1:, :-1] & inside()[:-1, 1:]
    ]


def test_triangles_cover_lips_and_openings_and_nothing_else():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    mouth = ((x - 32) / 14) ** 2 + ((y - 58) / 7) ** 2
    eyes = np.minimum(((x - 20) / 7) ** 2, ((x - 44) / 7) ** 2) + ((y - 30) / 2.5) ** 2
    covered = inside()
    assert covered[(mouth < 0.9) | (eyes < 0.8)].all()
    assert not covered[(mouth > 1) & (eyes > 1)].any()
    assert_allclose(RIMS.weights.sum(axis=1), 1)


def test_an_affine_movement_is_met_exactly_and_the_rest_of_the_field_stays():
    affine = np.array([[1.1, -0.05, 3.0], [0.02, 0.9, -2.0]])
    field = RIMS.filled(np.zeros((*SIZE, 2), np.float32), warp.apply_affine(affine, face()))
    assert_allclose(field[inside()], warp.affine_displacement(affine, *SIZE)[inside()], atol=1e-4)
    assert not field[~inside()].any()


def test_a_mouth_that_opens_wide_opens_between_the_lips_and_folds_nowhere():
    field = RIMS.filled(np.zeros((*SIZE, 2), np.float32), face(opening=30.0))
    assert areas(field).min() > 0.5
    assert abs(areas(field).max() - 5) < 0.5  # 30 px for 6
    upper, lower = (warp.move_points(field, np.array([[32.0, y]]))[0, 1] for y in (55.5, 60.5))
    assert abs(lower - upper - 25) < 1


def test_closed_rims_keep_a_little_of_their_gap_and_their_order():
    for shut in (face(opening=0.0, lids=0.0), face(opening=-4.0, lids=-3.0)):
        parted = RIMS.parted(shut)
        for ring in OPENINGS:
            half = len(ring) // 2
            gap = parted[list(ring[:half:-1])] - parted[list(ring[1:half])]
            wanted = LEAST_GAP * (face()[list(ring[:half:-1])] - face()[list(ring[1:half])])
            assert_allclose(gap[:, 1], wanted[:, 1], atol=1e-6)
        assert_allclose(parted[list(OUTER_LIPS)], shut[list(OUTER_LIPS)])
        field = RIMS.filled(np.zeros((*SIZE, 2), np.float32), parted)
        assert areas(field).min() > 0.04


def test_lips_that_cross_in_the_reference_still_open():
    """The points of closed lips cross by tenths of a px."""
    rims = rims_of(face(opening=-0.2, lids=-0.1), *SIZE)
    wide = face(opening=20.0)
    assert_allclose(rims.parted(wide), wide)
    crossed = rims.parted(face(opening=-3.0))
    half = len(INNER_LIPS) // 2
    gap = crossed[list(INNER_LIPS[:half:-1])] - crossed[list(INNER_LIPS[1:half])]
    assert_allclose(gap[:, 1], 0, atol=1e-9)


def test_a_tilted_face_parts_along_itself():
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    rims = rims_of(face() @ turn.T + (20, 0), 120, 120)
    shut = rims.parted(face(opening=-4.0, lids=-3.0) @ turn.T + (20, 0))
    assert_allclose((shut - (20, 0)) @ turn, RIMS.parted(face(opening=-4.0, lids=-3.0)), atol=1e-6)


def test_open_rims_stay_as_they_are():
    points = face(opening=2.0, lids=1.0)
    assert_array_equal(RIMS.parted(points), points)


def test_a_reference_with_closed_lips_has_no_openings_and_nothing_breaks():
    shut = face(opening=0.0)
    rims = rims_of(shut, *SIZE)
    assert np.isfinite(rims.parted(face())).all()
    field = rims.filled(np.zeros((*SIZE, 2), np.float32), face())
    assert np.isfinite(field).all() and inside(rims)[58, 32] in (True, False)


def test_unknown_points_of_a_rim_move_as_the_mean_of_their_neighbours():
    moved = face() + np.array([2.0, -1.0])
    unknown = [ring[k] for ring in (OUTER_LIPS, INNER_LIPS, RIGHT_LIDS) for k in (0, 3, 6)]
    wrong = moved.copy()
    wrong[unknown] += 50
    known = {*range(POINT_COUNT)} - {*unknown}
    assert_allclose(completed(wrong, face(), known)[RINGS], moved[RINGS])
    assert_array_equal(completed(wrong, face(), range(POINT_COUNT)), face() + (wrong - face()))


def test_every_point_of_the_rims_is_a_corner():
    assert {place for triangle in TRIANGLES for place in triangle} == {*RINGS}
