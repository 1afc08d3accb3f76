"""Laws of the anchor: what the spline explains is taken out first, and the flow finds the rest, in new frames too."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face import anchor
from morphspace.face.anchor import HELD, FaceAnchor, _anchor_on, anchor_of_build, rigid_movement, spline_from
from morphspace.face.detector import Detector, MissingModels
from morphspace.face.mesh import INNER_LIPS, POINT_COUNT, FacePoints
from morphspace.flow import Flow
from morphspace.flow.starts import landmark_spline
from morphspace.grid import warp

HEIGHT, WIDTH = 72, 60


def points(seed=4):
    """478 points in the middle of a frame of 60 x 72 px, px."""
    return np.random.default_rng(seed).uniform((8, 8), (52, 64), (POINT_COUNT, 2))


def held_to(found, reference=None):
    """An anchor on a reference with `points()`; in every other picture it finds `found` (n, 2), or no face."""
    face = FacePoints(points(), 0.9)
    find = (lambda image: None) if found is None else (lambda image: FacePoints(found, 0.9))
    return FaceAnchor(Detector(find, {"version": 1}), face)


def still(frame, start=None):
    """A flow without displacement, of full confidence."""
    return Flow(np.zeros((HEIGHT, WIDTH, 2), np.float32), np.full((HEIGHT, WIDTH), 0.75, np.float32))


def test_an_affine_movement_of_the_places_gives_that_affine_everywhere():
    movement = np.array([[1.03, -0.05, 2.0], [0.04, 0.98, -1.5]])
    places = points()[:40]
    field = spline_from(places, HEIGHT, WIDTH)(warp.apply_affine(movement, places))
    assert_allclose(field, warp.affine_displacement(movement, HEIGHT, WIDTH), atol=2e-3)  # px: float32


def test_the_spline_is_the_thin_plate_spline():
    places = np.stack(np.meshgrid([12.0, 30.0, 47.0], [10.0, 28.0, 45.0, 62.0]), axis=-1).reshape(-1, 2)
    moved = places + np.random.default_rng(8).uniform(-3, 3, places.shape)
    ours = spline_from(places, HEIGHT, WIDTH)(moved)
    theirs = landmark_spline(places, moved, HEIGHT, WIDTH)  # scipy's, exact near the landmarks
    assert_allclose(ours, theirs, atol=0.05)  # px: cubic between points 2 px apart


@pytest.mark.parametrize("size", [(72, 60), (300, 400), (37, 512)])
def test_the_spline_fits_pictures_of_any_size(size):
    height, width = size
    places = np.random.default_rng(2).uniform((2, 2), (width - 3, height - 3), (30, 2))
    moved = places + 0.01 * width * np.sin(places / width * 5)
    field = spline_from(places, height, width)(moved)
    assert field.shape == (height, width, 2) and field.dtype == np.float32
    assert np.abs(warp.move_points(field, places) - moved).max() < 0.3  # px: cubic between points 4 px apart


MOVEMENT = np.array([[0.98, -0.17, 12.0], [0.17, 0.98, -4.0]])  # a similarity: turn of 10 degrees and a shift


def test_the_skulls_movement_is_found_whatever_the_mouth_does():
    opened = points()
    opened[list(INNER_LIPS)] += 9.0
    found = rigid_movement(FacePoints(points(), 0.9), FacePoints(warp.apply_affine(MOVEMENT, opened), 0.9))
    assert_allclose(found, MOVEMENT, atol=1e-6)


def test_one_rigid_point_that_is_off_counts_little():
    off = points()
    off[168] += 9.0
    found = rigid_movement(FacePoints(points(), 0.9), FacePoints(warp.apply_affine(MOVEMENT, off), 0.9))
    miss = warp.apply_affine(found, points()) - warp.apply_affine(MOVEMENT, points())
    assert np.hypot(*miss.T).max() < 0.5  # px


def test_places_at_one_point_go_to_the_mean_of_theirs():
    places = np.array([[10.0, 10], [50, 12], [30, 60], [30.0, 35], [30.2, 35.1]])
    moved = places + np.array([[0, 0], [0, 0], [0, 0], [0, 4.0], [0, 2.0]])
    field = spline_from(places, HEIGHT, WIDTH)(moved)
    assert field[35, 30, 1] == pytest.approx(3, abs=0.1)


def test_places_on_one_line_give_a_finite_field():
    places = np.column_stack([np.linspace(10, 50, 9), np.linspace(20, 40, 9)])
    field = spline_from(places, HEIGHT, WIDTH)(np.add(places, (3.0, -2.0)))
    assert np.isfinite(field).all()
    assert_allclose(warp.move_points(field, places), np.add(places, (3.0, -2.0)), atol=0.05)


def test_what_the_flow_does_not_find_the_points_do(picture):
    found = np.add(points(), (4.0, -3.0))
    flow = held_to(found).anchored(still, HEIGHT, WIDTH)(picture(HEIGHT, WIDTH), None)
    assert_allclose(flow.displacement, np.broadcast_to((4.0, -3.0), (HEIGHT, WIDTH, 2)), atol=2e-3)
    assert (flow.confidence == 0.75).all()


def test_the_flow_sees_the_frame_with_the_spline_taken_out_and_the_two_are_composed(picture, wavy_field):
    reference, field = picture(HEIGHT, WIDTH), wavy_field(HEIGHT, WIDTH, 2.0)
    frame = warp.render(reference, field)
    found = warp.move_points(field, points())
    seen = []

    def rest(image, start=None):
        seen.append(image)
        return Flow(np.full((HEIGHT, WIDTH, 2), 0.5, np.float32), np.ones((HEIGHT, WIDTH), np.float32))

    flow = held_to(found).anchored(rest, HEIGHT, WIDTH)(frame, None)
    spline = spline_from(points()[list(HELD)], HEIGHT, WIDTH)(found[list(HELD)])
    assert_array_equal(seen[0], warp.sample(frame, spline))
    inside = (slice(12, -12), slice(12, -12))
    assert (
        np.abs(seen[0][inside] - reference[inside]).mean()
        < 0.3 * np.abs(frame[inside] - reference[inside]).mean()
    )
    assert_array_equal(flow.displacement, warp.compose(spline, np.full((HEIGHT, WIDTH, 2), 0.5, np.float32)))


def test_a_frame_without_a_face_or_with_a_start_of_its_own_goes_to_the_flow_as_it_is(picture):
    calls = []

    def find(image, start=None):
        calls.append((image, start))
        return still(image)

    frame, start = picture(HEIGHT, WIDTH), np.ones((HEIGHT, WIDTH, 2), np.float32)
    held_to(None).anchored(find, HEIGHT, WIDTH)(frame, None)
    held_to(points() + 5).anchored(find, HEIGHT, WIDTH)(frame, start)
    assert calls[0][0] is frame and calls[0][1] is None
    assert calls[1][0] is frame and calls[1][1] is start


def test_a_reference_without_a_face_anchors_nothing(picture):
    assert _anchor_on(picture(HEIGHT, WIDTH), Detector(lambda image: None, {"version": 1})) is None


ANCHORED = {"landmarks": {"reference_has_face": True, "anchored": True}}


def test_a_model_reads_new_frames_as_its_build_did_where_the_networks_are(model, monkeypatch):
    detector = Detector(lambda image: FacePoints(points(), 0.9), {"version": 1})
    monkeypatch.setattr(anchor, "load_detector", lambda person: detector)
    assert anchor_of_build(model.reference, {}) is None
    assert anchor_of_build(model.reference, {"landmarks": None}) is None
    assert anchor_of_build(model.reference, ANCHORED) is not None
    held = replace(model, provenance={**model.provenance, **ANCHORED}, registration="similarity")
    frame = held.align(np.array(model.reference), "some")
    assert_allclose(frame.registration, np.eye(2, 3), atol=1e-4)  # px: a grey level that rounds otherwise
    asked: list[object] = []
    held.__dict__["anchor"] = replace(
        held.anchor, detector=Detector(lambda image: asked.append(image), {"version": 1})
    )
    known = held.align(np.array(model.reference), "some", detector.find(model.reference))
    assert_array_equal(known.image, frame.image)  # bytes; a known face is not detected again
    assert not asked
    moved = Detector(lambda image: FacePoints(points() + 2.0, 0.9), {"version": 1})
    plain = model.flow_from_reference(model.reference, None)
    held.__dict__["anchor"] = FaceAnchor(moved, FacePoints(points(), 0.9))
    started = held.flow_from_reference(np.array(model.reference), None)
    assert_allclose(started.displacement[20:50, 20:40], plain.displacement[20:50, 20:40], atol=0.2)  # px: DIS
    monkeypatch.setattr(anchor, "load_detector", lambda person: Detector(lambda image: None, {"version": 2}))
    with pytest.raises(BadInput, match="no face in the reference, where the build found one"):
        anchor_of_build(model.reference, ANCHORED)


@pytest.mark.parametrize("anchored", [False, True])
def test_a_model_built_with_face_points_refuses_to_read_without_the_networks(
    model, monkeypatch, tmp_path, anchored
):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path))
    told = {"reference_has_face": True, "anchored": anchored}
    held = replace(model, provenance={**model.provenance, "landmarks": told}, registration="similarity")
    with pytest.raises(
        MissingModels, match=r"drawn was built with face points.*Run `morphspace models fetch`"
    ):
        held.encode(model.reference)
    plain = replace(model, registration="similarity").encode(model.reference)
    assert_array_equal(held.by_flow_alone().encode(model.reference).values, plain.values)  # bytes


def test_a_model_built_without_face_points_needs_no_networks(model, monkeypatch, tmp_path):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path))
    for landmarks in (None, {"reference_has_face": False, "anchored": False}):
        other = replace(
            model, provenance={**model.provenance, "landmarks": landmarks}, registration="similarity"
        )
        assert other.anchor is None and other.encode(model.reference).values.shape == (1, model.rank)
