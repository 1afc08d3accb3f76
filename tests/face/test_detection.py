"""Laws of face detection: anchors, boxes and crops by algebra; and, marked slow, what the real networks must keep.

The slow tests need the networks: `morphspace models fetch` once. Without them they fail, they are not skipped.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from skimage import data as pictures

from morphspace.errors import BadInput
from morphspace.face.detector import Detector, MissingModels, load_detector, models_present
from morphspace.face.detector.boxes import (
    FaceBox,
    _anchors,
    decode,
    in_order_of,
    overlap,
    person_of,
    suppress,
)
from morphspace.face.detector.crops import Crop, along, whole_image
from morphspace.face.detector.detect import EYES, LID_ORDER, _crop_of_box, _find_boxes
from morphspace.face.detector.networks import read_network
from morphspace.face.mesh import (
    LEFT_BROW,
    LEFT_IRIS,
    LEFT_LIDS,
    OPPOSITE,
    OUTER_LIPS,
    RIGHT_BROW,
    RIGHT_IRIS,
    RIGHT_LIDS,
    FacePoints,
)


def box(x, y, size, score):
    return FaceBox(np.array([[x, y], [x + size, y + size]], float), np.tile([x + size / 2, y], (6, 1)), score)


def ramp(width, height):
    """A picture whose red is x and whose green is y, in px / 1000, so that a crop's colours reveal its position."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    return np.stack([x, y, 0 * x], axis=-1) / 1000


# Detectors


def test_a_detector_is_known_by_its_identity_and_needs_one():
    one, other = (Detector(lambda image: None, {"version": version}) for version in (1, 2))
    assert one.is_same(Detector(len, {"version": 1})) and not one.is_same(other)
    with pytest.raises(BadInput, match="identity of a face detector is empty"):
        Detector(len, {})


# Boxes


def test_anchors_are_the_cell_centres_of_both_grids():
    found = _anchors()
    assert found.shape == (896, 2)
    assert_array_equal(found[0], found[1])
    assert_allclose(found[0], (4, 4))
    assert_allclose(found[2], (12, 4))  # the next cell of the row: 8 px on
    assert_allclose(found[16 * 16 * 2], (8, 8))
    assert_allclose(found.mean(axis=0), (64, 64))


def test_decoded_box_stands_on_its_anchor():
    scores, regressors = np.full(896, -50.0), np.zeros((896, 16))
    scores[5] = 3.0
    regressors[5] = [1, 2, 30, 20, *range(12)]
    (face,) = decode(scores, regressors)
    anchor = _anchors()[5] - 0.5  # pixel centres at integers
    assert_allclose(face.corners.mean(axis=0), anchor + np.array([1, 2]))
    assert_allclose(face.corners[1] - face.corners[0], (30, 20))
    assert_allclose(face.marks, anchor + np.arange(12).reshape(6, 2))
    assert_allclose(face.score, 1 / (1 + np.exp(-3.0)))


def test_nonsense_of_a_network_is_no_box():
    scores, regressors = np.full(896, 5.0), np.zeros((896, 16))
    regressors[:, 2:4] = 10
    regressors[0, 2] = -1  # turned inside out
    regressors[1, 7] = np.inf
    scores[2], scores[3:] = np.nan, -1e30
    assert decode(scores, regressors) == []
    assert decode(np.full(896, 1e30), regressors)[0].score == 1.0


def test_overlap_is_intersection_over_union():
    assert overlap(box(0, 0, 10, 1), box(0, 0, 10, 1)) == 1
    assert_allclose(overlap(box(0, 0, 10, 1), box(5, 0, 10, 1)), 50 / 150)
    assert overlap(box(0, 0, 10, 1), box(20, 20, 10, 1)) == 0


def test_boxes_of_one_face_become_their_weighted_mean_and_others_stay():
    faces = suppress([box(0, 0, 10, 0.6), box(1, 0, 10, 0.9), box(50, 50, 10, 0.7)])
    assert [face.score for face in faces] == [0.9, 0.7]
    assert_allclose(faces[0].corners[0], ((0 * 0.6 + 1 * 0.9) / 1.5, 0))
    assert_allclose(faces[1].corners[0], (50, 50))


def test_order_of_the_candidates_does_not_matter():
    candidates = [box(0, 0, 10, 0.6), box(1, 0, 10, 0.9), box(50, 50, 10, 0.7), box(2, 1, 10, 0.8)]
    forth, back = suppress(candidates), suppress(candidates[::-1])
    assert_allclose([f.corners for f in forth], [f.corners for f in back], rtol=1e-12)


@pytest.mark.parametrize(("score", "count"), [(0.49, 0), (0.51, 1)])
def test_a_box_is_a_candidate_from_half_of_the_score(score, count):
    """CANDIDATE_SCORE."""
    scores, regressors = np.full(896, -50.0), np.full((896, 16), 10.0)
    scores[5] = np.log(score / (1 - score))
    assert len(decode(scores, regressors)) == count


@pytest.mark.parametrize(("right_px", "count"), [(5.0, 1), (5.8, 2)])
def test_boxes_show_one_face_where_they_share_three_tenths(right_px, count):
    """OVERLAP: of two boxes of 10 px, 5 of 15 or 4.2 of 15.8."""
    assert len(suppress([box(0, 0, 10, 0.9), box(right_px, 0, 10, 0.8)])) == count


class FixedNetwork:
    """A box network that finds one box of 30 px in its input at call number `call`, with this score."""

    def __init__(self, call, score, box_px=30.0):
        self.call, self.score, self.calls, self.box_px = call, score, 0, box_px

    def answer(self, picture):
        self.calls += 1
        scores, regressors = np.full(896, -50.0), np.full((896, 16), self.box_px)
        if self.calls == self.call:
            scores[5] = np.log(self.score / (1 - self.score))
        return scores, regressors


def found_by(network, width=128, height=64, far=None):
    networks = SimpleNamespace(face=network, far_face=far or FixedNetwork(0, 0.5))
    return _find_boxes(networks, np.zeros((height, width, 3), np.float32))


@pytest.mark.parametrize(("score", "count"), [(0.69, 0), (0.71, 1)])
def test_a_box_shows_a_face_from_seven_tenths_of_the_score(score, count):
    """LEAST_SCORE."""
    assert len(found_by(FixedNetwork(1, score))) == count


def test_a_face_that_fills_the_frame_is_looked_for_with_more_room_around():
    """MARGINS, of the longer side: a box of 30 px of 128 is found with each, and with none after the last."""
    boxes = [found_by(FixedNetwork(call, 0.9)) for call in range(1, 6)]
    sizes = [float(np.ptp(one[0].corners, axis=0)[0]) for one in boxes[:4]]
    assert_allclose(sizes, (30, 37.5, 45, 60))
    assert boxes[4] == []


@pytest.mark.parametrize(("box_px", "second_looks"), [(19.5, 0), (19.0, 1)])
def test_faces_below_fifteen_hundredths_of_the_picture_are_searched_again(box_px, second_looks):
    """SMALL_SHARE: of the input's 128 px."""
    far = FixedNetwork(1, 0.9)
    (found,) = found_by(FixedNetwork(1, 0.9, box_px), far=far)
    assert far.calls == second_looks
    # The picture is 128 px wide, the second input 256.
    assert_allclose(np.ptp(found.corners, axis=0), 15 if second_looks else box_px)


def test_the_first_crop_is_half_as_large_again_as_the_box():
    """ENLARGED."""
    assert _crop_of_box(box(0, 0, 10, 0.9)).extent_px == 15.0


def test_the_wanted_person_is_first():
    left, large, right = faces = [box(0, 0, 10, 0.95), box(50, 50, 30, 0.8), box(90, 50, 20, 0.9)]
    assert in_order_of("largest", faces) == [large, right, left]
    assert in_order_of("left", faces) == [left, large, right]
    assert in_order_of("right", faces) == [right, large, left]
    assert in_order_of((102, 61), faces)[0] is right and in_order_of((60, 60), faces)[0] is large
    assert in_order_of("largest", []) == []


@pytest.mark.parametrize("person", ["largest", "left", "right", (3.0, 4.5)])
def test_the_person_is_read_back_from_an_identity(person):
    assert person_of(person if isinstance(person, str) else list(person)) == person
    assert person_of(None) == "largest"
    for wrong in ("middle", [1], ["1", "2"], 3):
        with pytest.raises(BadInput, match="the person is"):
            person_of(wrong)


# Crops


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("extent_px", [40.0, 130.0, 333.0])
def test_pixels_of_a_crop_are_those_it_says_they_are(extent_px, mirrored):
    crop = Crop((203.3, 181.7), extent_px, 0.4, 64, mirrored)
    cut = crop.cut(ramp(400, 360))
    y, x = np.mgrid[10:54:11, 10:54:11].reshape(2, -1)
    told = crop.in_image(np.column_stack([x, y]).astype(float))
    # px of the image: OpenCV places samples to 1/32 px of what it samples, here blocks of up to 5 px
    assert_allclose(1000 * cut[y, x, :2], told, atol=0.2)


def test_crop_outside_the_image_is_black():
    cut = Crop((-500.0, -500.0), 300.0, 0.0, 32).cut(ramp(400, 360) + 0.5)
    assert_array_equal(cut, 0)
    edge = Crop((0.0, 0.0), 400.0, 0.0, 64).cut(np.ones((200, 200, 3), np.float32))
    assert_array_equal(edge[:30, :30], 0)
    assert_allclose(edge[34:60, 34:60], 1, atol=1e-6)


def test_a_shrunk_crop_does_not_alias():
    stripes = np.zeros((960, 960, 3), np.float32)
    stripes[:, ::2] = 1
    cut = Crop((479.5, 479.5), 900.0, 0.0, 128).cut(stripes)
    assert_allclose(cut, 0.5, atol=0.09)  # blocks of 7 hold 3 or 4 stripes


def test_the_whole_image_fits_its_crop_with_even_margins():
    crop = whole_image(200, 400, 128, 1.5)
    inside = np.linalg.inv(np.vstack([crop.to_image, (0, 0, 1)]))[:2]
    corners = np.array([[-0.5, -0.5], [199.5, 399.5]]) @ inside[:, :2].T + inside[:, 2] + 0.5
    assert_allclose(corners.sum(axis=0), (128, 128))
    assert_allclose(corners[1, 1] - corners[0, 1], 128 / 1.5)


def test_a_crop_turns_and_grows_with_its_points():
    points = np.random.default_rng(0).uniform(0, 50, (30, 2))
    angle, scale = 0.7, 3.0
    similarity = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = points @ similarity.T + (20, -5)
    before = along(points, points[0], points[1], 1.5, 192)
    after = along(moved, moved[0], moved[1], 1.5, 192)
    corners = np.array([[0, 0], [191, 0], [0, 191]], float)
    # Edges of pixels scale, centres follow: compare through the crops' continuous coordinates.
    assert_allclose(after.in_image(corners), before.in_image(corners) @ similarity.T + (20, -5), atol=1e-9)


# Names of points


def test_opposite_points_are_opposite_each_other():
    order = np.array(OPPOSITE)
    assert_array_equal(order[order], np.arange(468))
    assert_array_equal(order[list(RIGHT_LIDS)], LEFT_LIDS)
    assert_array_equal(order[list(RIGHT_BROW)], LEFT_BROW)
    assert set(order[list(OUTER_LIPS)]) == set(OUTER_LIPS)
    assert order[164] == 164


def test_lid_order_runs_round_the_eye():
    assert sorted(LID_ORDER) == list(range(16))
    assert [eye.lids[0] for eye in EYES] == [33, 263]
    assert sorted(EYES[1].iris) == list(LEFT_IRIS)


# Without the networks


def test_networks_are_read_one_at_a_time(monkeypatch):
    """OpenCV fills its table of operators without a lock."""
    reading, most = [], []

    def read(path, engine):
        reading.append(path)
        time.sleep(0.01)
        most.append(len(reading))
        reading.remove(path)

    monkeypatch.setattr(cv2.dnn, "readNetFromTFLite", read)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda number: read_network(Path(f"{number}.tflite"), ()), range(6)))
    assert most == [1] * 6


def test_missing_networks_name_the_command_that_brings_them(tmp_path):
    assert not models_present(tmp_path)
    with pytest.raises(MissingModels, match="morphspace models fetch"):
        load_detector(tmp_path)


# With the networks


@pytest.fixture(scope="module")
def detector():
    """The real detector; without the networks the test fails and names the command."""
    return load_detector()


@pytest.fixture(scope="module")
def portrait():
    """A photograph of a face, slightly turned, that comes with scikit-image."""
    return (pictures.astronaut()[:300, 60:380] / 255).astype(np.float32)


@pytest.fixture(scope="module")
def face(detector, portrait):
    return detector(portrait)


def apart(one: FacePoints, other: FacePoints):
    """The rms distance of two sets of points, in % of the eye distance."""
    return 100 * np.sqrt(np.mean((one.points - other.points) ** 2) * 2) / one.interocular_px


@pytest.mark.slow
def test_a_face_is_found_where_it_is(face):
    # Read off the enlarged photograph by eye, to 2 px.
    assert_allclose(face.faceframe().points, [(144, 102), (186, 104), (163, 135)], atol=3)
    assert face.score >= 0.7
    assert face.points.dtype == np.float64
    pupils = face.points[[RIGHT_IRIS[0], LEFT_IRIS[0]]]
    assert_allclose(pupils, face.faceframe().points[:2], atol=4)


@pytest.mark.slow
def test_the_same_image_gives_the_same_points_whatever_the_threads(detector, portrait, face):
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        assert_array_equal(detector(portrait).points, face.points)
    finally:
        cv2.setNumThreads(threads)
    others = [np.ascontiguousarray(portrait[:, shift:]) for shift in range(0, 16, 2)]
    one_by_one = [detector(image).points for image in others]
    with ThreadPoolExecutor(4) as pool:
        together = [found.points for found in pool.map(detector, others)]
    assert_array_equal(one_by_one, together)


@pytest.mark.slow
def test_a_mirrored_face_gives_mirrored_points(detector, portrait, face):
    found = detector(np.ascontiguousarray(portrait[:, ::-1]))
    order = [*OPPOSITE, *(LEFT_IRIS[i] for i in (0, 3, 2, 1, 4)), *(RIGHT_IRIS[i] for i in (0, 3, 2, 1, 4))]
    back = found.points[order]
    back[:, 0] = portrait.shape[1] - 1 - back[:, 0]
    # 1.5 % of the eye distance is 0.6 px here: the first crop, from the box, is not the mirror image to the pixel.
    assert apart(face, face.moved(back)) < 1.5
    assert_allclose(found.turn_degrees[0], -face.turn_degrees[0], atol=2)


@pytest.mark.slow
def test_points_behind_a_hand_are_less_sure(detector, portrait, face):
    eye, cheek = face.points[list(LEFT_LIDS)].mean(axis=0), face.points[50].round().astype(int)
    hidden = portrait.copy()
    for finger in range(4):
        centre = eye + (finger - 1.5) * np.array([0.2 * face.interocular_px, 0])
        size = (0.1 * face.interocular_px, 0.6 * face.interocular_px)
        colour = portrait[cheek[1], cheek[0]] * (0.8 + 0.1 * finger)
        box = (tuple(map(float, centre)), tuple(2 * side for side in size), 10.0)
        cv2.ellipse(hidden, box, colour.tolist(), -1)
    found = detector(hidden)
    assert (face.confidence > 0).all() and (face.confidence <= 1).all()
    behind = np.hypot(*(face.points - eye).T) < 0.4 * face.interocular_px
    assert np.median(found.confidence[behind]) < 0.7 * np.median(found.confidence[~behind])
    assert np.median(face.confidence[behind]) > 0.9 * np.median(face.confidence[~behind])


@pytest.mark.slow
@pytest.mark.parametrize("angle_deg", [-30.0, 20.0])
def test_points_turn_with_the_face(detector, portrait, face, angle_deg):
    height, width = portrait.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), angle_deg, 1.0)
    image = cv2.warpAffine(portrait, matrix, (width, height), flags=cv2.INTER_CUBIC)
    found = detector(image)
    assert apart(face.moved(face.points @ matrix[:, :2].T + matrix[:, 2]), found) < 2


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.7, 2.0, 5.0])
def test_points_grow_with_the_face(detector, portrait, face, scale):
    size = (round(portrait.shape[1] * scale), round(portrait.shape[0] * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    found = detector(cv2.resize(portrait, size, interpolation=method))
    assert apart(face, face.moved((found.points + 0.5) / scale - 0.5)) < 1.5


@pytest.mark.slow
def test_a_face_that_more_than_fills_the_frame_is_found(detector, portrait, face):
    low, high = face.points.min(axis=0), face.points.max(axis=0)
    inset = 0.1 * (
        high - low
    )  # cut off on every side; without room around it the box network misses this one
    (x0, y0), (x1, y1) = (low + inset).astype(int), (high - inset).astype(int)
    found = detector(np.ascontiguousarray(portrait[y0:y1, x0:x1]))
    # Forehead and chin, a fifth of the points, lie outside and are guessed.
    assert apart(face, face.moved(found.points + np.array([x0, y0]))) < 8


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.9, 0.7])
def test_a_face_that_is_small_in_its_picture_is_found(detector, portrait, face, scale):
    """The face is 8 or 6 % of the width; only the network for far faces finds it."""
    small = cv2.resize(portrait, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    image = np.full((900, 1200, 3), 0.4, np.float32)
    image[400 : 400 + small.shape[0], 700 : 700 + small.shape[1]] = small
    found = detector(image)
    back = (found.points - (700, 400) + 0.5) / scale - 0.5
    assert apart(face, face.moved(back)) < 6


@pytest.mark.slow
def test_no_face_is_none(detector):
    assert detector(np.zeros((240, 200, 3), np.float32)) is None
    assert detector(np.random.default_rng(0).random((240, 200, 3), np.float32)) is None
    assert detector(np.full((1, 1, 3), 0.5, np.float32)) is None
    brick = np.repeat(pictures.brick()[:, :, None] / 255, 3, axis=2).astype(np.float32)
    assert detector(brick) is None


@pytest.mark.slow
def test_what_is_no_image_is_refused(detector, portrait):
    with pytest.raises(BadInput, match=r"\(300, 320\)"):
        detector(portrait[:, :, 0])
    broken = portrait.copy()
    broken[5, 5] = np.nan
    with pytest.raises(BadInput, match="not finite"):
        detector(broken)
