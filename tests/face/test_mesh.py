"""Laws of face points: the faceframe by name, and the head's turn by geometry."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.errors import BadInput
from morphspace.face import mesh
from morphspace.face.mesh import FacePoints


def test_names_of_points_are_those_of_the_mesh_and_do_not_overlap():
    lids = mesh.RIGHT_LIDS + mesh.LEFT_LIDS
    irises = mesh.RIGHT_IRIS + mesh.LEFT_IRIS
    brows = mesh.RIGHT_BROW + mesh.LEFT_BROW
    named = lids + irises + brows + mesh.LIPS + mesh.FACE_OUTLINE
    assert len(set(named)) == len(named)
    assert set(irises) == set(range(468, 478))
    assert max(named) < mesh.POINT_COUNT
    assert (len(lids), len(brows), len(mesh.LIPS), len(mesh.FACE_OUTLINE)) == (32, 20, 40, 36)
    assert not set(mesh.RIGID_POINTS) & set(mesh.LIPS + brows)


def test_faceframe_is_the_mean_of_each_lid_ring_and_the_philtrum():
    points = np.zeros((478, 2))
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = np.column_stack([np.cos(angles), 0.4 * np.sin(angles)])
    points[list(mesh.RIGHT_LIDS)] = (40, 50) + 12 * ring
    points[list(mesh.LEFT_LIDS)] = (100, 54) + 12 * ring
    points[164] = (71, 110)
    face = FacePoints(points, 0.9)
    assert_allclose(face.faceframe().points, [(40, 50), (100, 54), (71, 110)], atol=1e-9)
    assert_allclose(face.interocular_px, np.hypot(60, 4), atol=1e-9)


@pytest.mark.parametrize("roll_deg", [0.0, 25.0])
@pytest.mark.parametrize("yaw_deg", [-35.0, -10.0, 0.0, 22.0])
def test_turn_tells_the_yaw_the_head_was_turned_by(turned_face, yaw_deg, roll_deg):
    found = turned_face(yaw_deg=yaw_deg, roll_deg=roll_deg).turn_degrees
    assert_allclose(found[0], yaw_deg, atol=1e-6)  # degrees; rounding alone


@pytest.mark.parametrize("roll_deg", [0.0, -25.0])
@pytest.mark.parametrize("pitch_deg", [-30.0, 0.0, 12.0])
def test_turn_tells_the_pitch_the_head_was_turned_by(turned_face, pitch_deg, roll_deg):
    found = turned_face(pitch_deg=pitch_deg, roll_deg=roll_deg).turn_degrees
    assert_allclose(found, (0, pitch_deg), atol=1e-6)


def test_only_a_head_turned_by_more_than_twenty_degrees_is_flagged(turned_face):
    assert not turned_face(yaw_deg=19).is_turned()
    assert turned_face(yaw_deg=-21).is_turned()
    assert turned_face(pitch_deg=-21).is_turned()
    assert not turned_face(roll_deg=40).is_turned()


@pytest.mark.parametrize("roll_deg", [-40.0, 15.0])
def test_roll_tells_the_turn_in_the_picture(turned_face, roll_deg):
    apart = turned_face(roll_deg=roll_deg).roll_degrees - turned_face().roll_degrees
    assert_allclose(apart, roll_deg, atol=1e-9)


def test_points_that_do_not_fit_the_scheme_are_refused():
    with pytest.raises(BadInput, match=r"\(68, 2\).*\(478, 2\)"):
        FacePoints(np.zeros((68, 2)), 0.9)
    with pytest.raises(BadInput, match="depths have shape"):
        FacePoints(np.zeros((478, 2)), 0.9, depth=np.zeros(3))
    with pytest.raises(BadInput, match="confidences have shape"):
        FacePoints(np.zeros((478, 2)), 0.9, confidence=np.zeros((478, 1)))
    with pytest.raises(BadInput, match="not finite"):
        FacePoints(np.full((478, 2), np.nan), 0.9)


def test_measures_without_their_scheme_or_depth_are_refused():
    with pytest.raises(BadInput, match="no depth"):
        _ = FacePoints(np.zeros((478, 2)), 0.9).turn_degrees
    with pytest.raises(BadInput, match="ibug-68"):
        FacePoints(np.zeros((68, 2)), 0.9, "ibug-68").faceframe()


def test_moved_points_keep_the_score_and_lose_the_depth(turned_face):
    face = turned_face()
    moved = face.moved(face.points + 5)
    assert_allclose(moved.faceframe().points, face.faceframe().points + 5, atol=1e-9)
    assert moved.score == face.score
    assert moved.depth is None
