"""Laws of face points: the faceframe by name, and the head's turn by geometry."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.errors import BadInput
from morphspace.face import mesh
from morphspace.face.mesh import FacePoints


def solid_face():
    """478 points (x, y, depth) of a made-up head in its own axes: eyes at y 0, the base of the nose in front."""
    rng = np.random.default_rng(3)
    solid = np.column_stack([rng.uniform(-60, 60, 478), rng.uniform(-80, 80, 478), rng.uniform(-20, 40, 478)])
    for outer, inner, place in ((33, 133, -1), (263, 362, 1)):
        solid[outer], solid[inner] = (place * 45, 0, 10), (place * 15, 0, 0)
    for right, left, x, y, depth in ((127, 356, 70, 5, 70), (234, 454, 70, 25, 75), (162, 389, 65, -20, 60)):
        solid[right], solid[left] = (-x, y, depth), (x, y, depth)
    # The base of the nose stands before the eyes by the angle a resting face has.
    forward = 50 * np.tan(np.radians(mesh.RESTING_PITCH_DEG))
    solid[98], solid[2], solid[327] = (-12, 50, 5 - forward), (0, 50, 5 - forward), (12, 50, 5 - forward)
    return solid


def turned(solid, yaw_deg=0.0, pitch_deg=0.0, roll_deg=0.0):
    """The head turned to the image's right, up, and clockwise in the picture."""
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    # A face that looks to the image's right brings its right-hand side (larger x) away from the camera.
    about_y = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]])
    about_z = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    solid = solid @ (about_z @ about_y @ about_x).T
    return FacePoints(solid[:, :2] + 100, 0.9, depth=solid[:, 2])


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
def test_turn_tells_the_yaw_the_head_was_turned_by(yaw_deg, roll_deg):
    found = turned(solid_face(), yaw_deg=yaw_deg, roll_deg=roll_deg).turn_degrees
    assert_allclose(found[0], yaw_deg, atol=1e-6)  # degrees; rounding alone


@pytest.mark.parametrize("roll_deg", [0.0, -25.0])
@pytest.mark.parametrize("pitch_deg", [-30.0, 0.0, 12.0])
def test_turn_tells_the_pitch_the_head_was_turned_by(pitch_deg, roll_deg):
    found = turned(solid_face(), pitch_deg=pitch_deg, roll_deg=roll_deg).turn_degrees
    assert_allclose(found, (0, pitch_deg), atol=1e-6)


def test_only_a_head_turned_by_more_than_twenty_degrees_is_flagged():
    assert not turned(solid_face(), yaw_deg=19).is_turned()
    assert turned(solid_face(), yaw_deg=-21).is_turned()
    assert turned(solid_face(), pitch_deg=-21).is_turned()
    assert not turned(solid_face(), roll_deg=40).is_turned()


def test_points_that_do_not_fit_the_scheme_are_refused():
    with pytest.raises(BadInput, match=r"\(68, 2\).*\(478, 2\)"):
        FacePoints(np.zeros((68, 2)), 0.9)
    with pytest.raises(BadInput, match="depths have shape"):
        FacePoints(np.zeros((478, 2)), 0.9, depth=np.zeros(3))
    with pytest.raises(BadInput, match="not finite"):
        FacePoints(np.full((478, 2), np.nan), 0.9)


def test_measures_without_their_scheme_or_depth_are_refused():
    with pytest.raises(BadInput, match="no depth"):
        _ = FacePoints(np.zeros((478, 2)), 0.9).turn_degrees
    with pytest.raises(BadInput, match="ibug-68"):
        FacePoints(np.zeros((68, 2)), 0.9, "ibug-68").faceframe()


def test_moved_points_keep_the_score_and_lose_the_depth():
    face = turned(solid_face())
    moved = face.moved(face.points + 5)
    assert_allclose(moved.faceframe().points, face.faceframe().points + 5, atol=1e-9)
    assert moved.score == face.score
    assert moved.depth is None
