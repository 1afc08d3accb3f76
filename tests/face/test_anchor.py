"""Laws of the anchor: what the spline explains is taken out first, and the flow finds the rest, in new frames too."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from threadpoolctl import threadpool_limits

from morphspace.errors import BadInput
from morphspace.face import anchor
from morphspace.face.anchor import (
    HELD,
    FaceAnchor,
    _distance_px,
    anchor_of_build,
    rigid_movement,
    spline_from,
)
from morphspace.face.detector import Detector, MissingModels
from morphspace.face.faceframe import Frame, identity_affine
from morphspace.face.mesh import FACE_OUTLINE, INNER_LIPS, OUTER_LIPS, POINT_COUNT, RIGHT_LIDS, FacePoints
from morphspace.flow import Flow
from morphspace.flow.starts import landmark_spline
from morphspace.grid import warp

HEIGHT, WIDTH = 72, 60


def points(seed=4):
    """478 points in the middle of a frame of 60 x 72 px, px."""
    return np.random.default_rng(seed).uniform((8, 8), (52, 64), (POINT_COUNT, 2))


BLIND = Detector(lambda image: None, {"version": 1})


def frame_of(image, found):
    """An aligned frame with face points (478, 2), or none: the detector need not look."""
    return Frame(image, "some", identity_affine(), np.zeros((0, 2)) if found is None else found)


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


def test_the_spline_has_the_same_bytes_for_any_number_of_cores():
    places = 3 * points()[list(HELD)]
    fields = []
    for threads in (1, 2):
        with threadpool_limits(limits=threads, user_api="blas"):
            fields.append(spline_from(places, 3 * HEIGHT, 3 * WIDTH)(places + np.sin(places)))
    assert_array_equal(fields[1], fields[0])


def test_distances_are_roots_of_whole_numbers_to_the_last_bit(drawn_anna):
    """OpenCV's are off by 4e-6 px, and not by the same from call to call."""
    height, width = drawn_anna.model.mask.shape
    found = _distance_px(drawn_anna.points(), (FACE_OUTLINE,), height, width)
    assert found.max() > 5 and found.min() == 0
    assert_array_equal(found, np.sqrt(np.round(found.astype(np.float64) ** 2)).astype(np.float32))


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


def constant(right, down, height=HEIGHT, width=WIDTH):
    """A flow function that finds one displacement everywhere, and keeps the pictures that it was given."""
    seen = []

    def find(frame, start=None):
        seen.append(frame)
        field = np.broadcast_to(np.float32((right, down)), (height, width, 2))
        return Flow(np.array(field), np.full((height, width), 0.75, np.float32))

    return find, seen


def test_what_the_flow_does_not_find_the_points_do_within_the_face_and_less_and_less_outside(drawn_anna):
    """AROUND_FACE: over two eye distances."""
    face = drawn_anna.points()
    moved = face.moved(np.add(face.points, (4.0, -3.0)))
    height, width = drawn_anna.model.mask.shape
    find, _ = constant(0.0, 0.0, height, width)
    flow = FaceAnchor(BLIND, face).held(find, height, width)(frame_of(drawn_anna.picture(), moved.points))
    outline = face.points[list(FACE_OUTLINE)]
    x, y = np.round(outline.mean(axis=0)).astype(int)
    assert_allclose(flow.displacement[y, x], (4.0, -3.0), atol=0.01)  # px
    assert (flow.confidence == 0.75).all()
    x, y = (outline[:, 0].min() - 8).astype(int), outline[outline[:, 0].argmin(), 1].astype(int)
    share = 1 - 8 / (2 * face.interocular_px)
    assert_allclose(flow.displacement[y, x], (4.0 * share, -3.0 * share), atol=0.15)


def test_the_flow_sees_the_frame_with_the_spline_taken_out(picture, wavy_field, drawn_anna):
    face = drawn_anna.points()
    height, width = drawn_anna.model.mask.shape
    reference, field = picture(height, width), wavy_field(height, width, 2.0)
    frame = warp.render(reference, field)
    found = warp.move_points(field, face.points)
    find, seen = constant(0.0, 0.0, height, width)
    FaceAnchor(BLIND, face).held(find, height, width)(frame_of(frame, found))
    inside = (slice(12, -12), slice(12, -12))
    assert (
        np.abs(seen[0][inside] - reference[inside]).mean()
        < 0.3 * np.abs(frame[inside] - reference[inside]).mean()
    )


def test_lips_and_lids_follow_the_points_and_the_flow_counts_around_them_within_its_limit(drawn_anna):
    """HELD_AROUND, MOST_BEYOND: a tenth of the eye distance within the face, and a pixel more per pixel outside."""
    face = drawn_anna.points()
    height, width = drawn_anna.model.mask.shape
    find, _ = constant(1.5, 0.0, height, width)  # px; it is not found in the pictures
    frame = frame_of(drawn_anna.picture(), face.points)
    right = FaceAnchor(BLIND, face).held(find, height, width)(frame).displacement[..., 0]

    def at(place):
        x, y = np.round(place).astype(int)
        return float(right[y, x])

    lips, outline, eyes_px = (
        face.points[list(OUTER_LIPS)],
        face.points[list(FACE_OUTLINE)],
        face.interocular_px,
    )
    assert max(abs(at(place)) for place in lips) < 0.05  # px
    assert abs(at(face.points[list(RIGHT_LIDS)].mean(axis=0))) < 1e-3
    beside = outline[outline[:, 0] > lips[10][0]]  # of the corner of the mouth
    cheek = (lips[10] + beside[np.abs(beside[:, 1] - lips[10][1]).argmin()]) / 2
    within, outside = 0.1 * eyes_px, 0.1 * eyes_px + 6
    assert at(cheek) == pytest.approx(within * np.tanh(1.5 / within), abs=0.02)
    left_of_face = outline[:, 0].min() - 6, outline[outline[:, 0].argmin(), 1]
    assert at(left_of_face) == pytest.approx(outside * np.tanh(1.5 / outside), abs=0.02)


def test_a_frame_without_a_face_goes_to_the_flow_as_it_is(picture):
    frame = picture(HEIGHT, WIDTH)
    find, seen = constant(1.0, 0.0)
    flow = FaceAnchor(BLIND, FacePoints(points(), 0.9)).held(find, HEIGHT, WIDTH)(frame_of(frame, None))
    assert seen[0] is frame and (flow.displacement == (1.0, 0.0)).all()


HELD_BUILD = {"landmarks": {"reference_has_face": True, "held": True}}


def test_a_model_reads_new_frames_as_its_build_did_where_the_networks_are(model, monkeypatch):
    detector = Detector(lambda image: FacePoints(points(), 0.9), {"version": 1})
    monkeypatch.setattr(anchor, "load_detector", lambda person: detector)
    assert anchor_of_build(model.reference, {}) is None
    assert anchor_of_build(model.reference, {"landmarks": None}) is None
    assert anchor_of_build(model.reference, HELD_BUILD) is not None
    held = replace(model, provenance={**model.provenance, **HELD_BUILD}, registration="similarity")
    frame = held.align(np.array(model.reference), "some")
    assert_allclose(frame.registration, np.eye(2, 3), atol=1e-4)  # px: a grey level that rounds otherwise
    asked: list[object] = []
    held.__dict__["anchor"] = replace(
        held.anchor, detector=Detector(lambda image: asked.append(image), {"version": 1})
    )
    known = held.align(np.array(model.reference), "some", detector.find(model.reference))
    assert_array_equal(known.image, frame.image)  # bytes; a known face is not detected again
    held.morph_of(known)  # nor in the aligned frame
    assert not asked
    assert_allclose(known.points, warp.apply_affine(warp.inverse_affine(known.registration), points()))
    moved = Detector(lambda image: FacePoints(points() + 2.0, 0.9), {"version": 1})
    held = replace(held)
    held.__dict__["anchor"] = FaceAnchor(moved, FacePoints(points(), 0.9))
    started = held.flow_from_reference(Frame(np.array(model.reference), "some", identity_affine()))
    assert (
        np.median(np.abs(started.displacement[20:50, 20:40] - 2.0)) < 0.1
    )  # px: as the points say, not as the picture
    monkeypatch.setattr(anchor, "load_detector", lambda person: Detector(lambda image: None, {"version": 2}))
    with pytest.raises(BadInput, match="no face in the reference, where the build found one"):
        anchor_of_build(model.reference, HELD_BUILD)


@pytest.mark.parametrize("is_held", [False, True])
def test_a_model_built_with_face_points_refuses_to_read_without_the_networks(
    model, monkeypatch, tmp_path, is_held
):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path))
    told = {"reference_has_face": True, "held": is_held}
    held = replace(model, provenance={**model.provenance, "landmarks": told}, registration="similarity")
    with pytest.raises(
        MissingModels, match=r"drawn was built with face points.*Run `morphspace models fetch`"
    ):
        held.encode(model.reference)
    plain = replace(model, registration="similarity").encode(model.reference)
    assert_array_equal(held.by_flow_alone().encode(model.reference).values, plain.values)  # bytes


def test_points_that_were_given_for_the_reference_are_those_of_the_anchor(model, monkeypatch):
    monkeypatch.setattr(anchor, "load_detector", lambda person: BLIND)
    given = {"landmarks": {**HELD_BUILD["landmarks"], "reference_points": points().tolist()}}
    assert_array_equal(anchor_of_build(model.reference, given).face.points, points())
    with pytest.raises(BadInput, match="no face in the reference"):
        anchor_of_build(model.reference, HELD_BUILD)


def test_a_model_of_the_former_anchored_builds_is_built_again(model):
    told = {"reference_has_face": True, "anchored": True}
    older = replace(model, provenance={**model.provenance, "landmarks": told}, registration="similarity")
    with pytest.raises(BadInput, match=r"--landmarks anchor.*Build the model again"):
        older.encode(model.reference)


def test_a_model_built_without_face_points_needs_no_networks(model, monkeypatch, tmp_path):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path))
    for landmarks in (None, {"reference_has_face": False, "held": False}):
        other = replace(
            model, provenance={**model.provenance, "landmarks": landmarks}, registration="similarity"
        )
        assert other.anchor is None and other.encode(model.reference).values.shape == (1, model.rank)
