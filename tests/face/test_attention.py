"""Laws of the attention mesh: boxes and readings by algebra; marked slow, that the cut network is MediaPipe's."""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from morphspace.errors import UnreadableFile
from morphspace.face.detector.attention import (
    BASE,
    HEADS,
    LEFT_EYE_POINTS,
    LIP_POINTS,
    RIGHT_EYE_POINTS,
    AttentionMesh,
    Part,
    cut,
    head_box,
    read_box,
)
from morphspace.face.detector.models import MESH, models_folder
from morphspace.face.mesh import LIPS, OPPOSITE, RIGHT_BROW, RIGHT_LIDS

REFERENCE = (
    Path(os.environ.get("MORPHSPACE_DATA", "no-such-folder")).parent / "cases/attention-mesh/reference.npz"
)


def test_heads_refine_lips_lids_and_brows_each_point_once():
    points = [*LIP_POINTS, *RIGHT_EYE_POINTS, *LEFT_EYE_POINTS]
    assert len(points) == len(set(points)) == 222
    assert set(LIPS) < set(LIP_POINTS) and {*RIGHT_LIDS, *RIGHT_BROW} < set(RIGHT_EYE_POINTS)
    assert set(RIGHT_EYE_POINTS[:16]) == set(RIGHT_LIDS)
    assert [OPPOSITE[place] for place in RIGHT_EYE_POINTS] == list(LEFT_EYE_POINTS)


@pytest.mark.parametrize("turn_rad", [0.0, 0.5, -2.0])
def test_a_box_holds_its_points_with_a_quarter_to_spare_on_each_side(turn_rad):
    """ENLARGED: the box is half as large again, along the line through its two points and across."""
    turn = np.array([[np.cos(turn_rad), -np.sin(turn_rad)], [np.sin(turn_rad), np.cos(turn_rad)]])
    upright = np.array([[-4.0, 0], [4, 0], [0, -1], [1, 3]])
    part = Part((), (), (), (0, 1, 2, 3), (0, 1))
    box = head_box(upright @ turn.T + (20, 24), part)
    corners = np.array([[0, 0], [16, 0], [0, 16], [16, 16], [8, 8]])
    found = (corners @ box[:, :2].T + box[:, 2] - (20, 24)) @ turn
    assert_allclose(found, [[-6, -2], [6, -2], [-6, 4], [6, 4], [0, 1]], atol=1e-12)


def test_features_are_read_at_the_centres_of_a_boxs_pixels_and_are_0_outside():
    rows, columns = np.mgrid[:48, :48].astype(np.float32)
    box = np.array([[0.5, 0.0, 42.0], [0.0, 0.25, 10.0]])
    x, y = read_box(np.stack([columns, rows]), box)
    expected = 42 + 0.5 * (np.arange(16) + 0.5) - 0.5
    assert_allclose(x, np.where(expected <= 47, expected, 0)[None].repeat(16, axis=0), atol=1e-5)
    assert_allclose(y[:, 0], 10 + 0.25 * (np.arange(16) + 0.5) - 0.5, atol=1e-5)


@given(st.binary(max_size=200))
def test_what_is_no_network_is_refused(content):
    with pytest.raises(UnreadableFile, match="expected MediaPipe's file"):
        cut(content, BASE.inputs, BASE.outputs)


@pytest.fixture(scope="module")
def whole():
    """The real file; without the networks the test fails and names the command."""
    return (models_folder() / MESH.name).read_bytes()


@pytest.mark.slow
def test_the_parts_are_whole_files_that_do_not_change(whole):
    """The digests are those of parts whose answers were compared with MediaPipe's."""
    digests = [hashlib.sha256(cut(whole, part.inputs, part.outputs)).hexdigest() for part in (BASE, *HEADS)]
    assert [digest[:8] for digest in digests] == ["6bb395d1", "93dd1752", "d61c943e", "1c406640"]


@pytest.mark.slow
def test_a_file_cut_short_or_changed_at_its_head_is_refused(whole):
    for content in (whole[:1000], b"\xff" * 64 + whole[64:]):
        with pytest.raises(UnreadableFile, match="expected MediaPipe's file"):
            cut(content, BASE.inputs, BASE.outputs)


@pytest.mark.slow
@pytest.mark.skipif(
    not REFERENCE.is_file(), reason="MORPHSPACE_DATA does not name a folder beside the reference"
)
def test_points_are_those_of_mediapipe():
    reference = np.load(REFERENCE)
    network = AttentionMesh.read(models_folder() / MESH.name)
    crops = [name for name in reference.files if name.endswith("_crop")]
    assert len(crops) == 18
    for name in crops:
        points, presence = network.points((reference[name] / 255).astype(np.float32))
        assert_allclose(points, reference[name.replace("_crop", "_points")], atol=5e-4)  # px of the crop
        assert presence > 0


@pytest.mark.slow
def test_black_and_noise_are_finite_and_no_face():
    network = AttentionMesh.read(models_folder() / MESH.name)
    noise = np.random.default_rng(0).random((192, 192, 3), np.float32)
    for picture in (np.zeros((192, 192, 3), np.float32), noise):
        points, presence = network.points(picture)
        assert np.isfinite(points).all() and presence < np.log(1e-5)
