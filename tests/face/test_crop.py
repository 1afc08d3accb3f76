"""Laws of the crop around the head: one box a clip, inside the picture, of the asked shape, that holds the head."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from morphspace.errors import BadInput
from morphspace.face.crop import _head_crop, check_one_person, crop_steps, several_notes
from morphspace.face.detector import Detector, detector_for
from morphspace.face.mesh import LEFT_LIDS, PHILTRUM, POINT_COUNT, RIGHT_LIDS, FacePoints
from morphspace.io.clips import open_clip
from morphspace.io.images import write_image
from morphspace.steps import result_of, using_workers

PICTURE = (640, 480)
ABOVE, BELOW, BESIDE = 1.95, 2.35, 1.75  # eye distances, as the module documents them
CROP_FRAMES = 24


def face_at(x, y, eyes_px):
    """A face whose eyes are centred at (x, y), `eyes_px` apart."""
    points = np.full((POINT_COUNT, 2), (x, y), np.float64)
    points[list(RIGHT_LIDS), 0] -= eyes_px / 2
    points[list(LEFT_LIDS), 0] += eyes_px / 2
    points[PHILTRUM, 1] += 0.85 * eyes_px
    return FacePoints(points, 0.9)


def test_a_face_at_rest_gives_the_proportions_of_a_cropped_head():
    x, y, w, h = _head_crop([face_at(300, 200, 60)] * 5, PICTURE, 2 * BESIDE / (ABOVE + BELOW))
    assert w == pytest.approx(2 * BESIDE * 60, abs=1)  # px: whole numbers
    assert h == pytest.approx((ABOVE + BELOW) * 60, abs=1)
    assert x + w / 2 == pytest.approx(300.5, abs=1)
    assert y == pytest.approx(200 - ABOVE * 60, abs=1)


def test_the_box_holds_the_head_wherever_it_went():
    faces = [face_at(x, 220, 50) for x in np.linspace(250, 380, 41)]
    x, _, w, _ = _head_crop(faces, PICTURE, 200 / 240)
    first, last = np.percentile([250, 380], [5, 95])
    assert x <= first - BESIDE * 50 + 1 and x + w >= last + BESIDE * 50 - 1


def test_one_frame_that_found_something_else_does_not_decide():
    calm = [face_at(300, 200, 60)] * 30
    assert _head_crop([*calm, face_at(560, 430, 25)], PICTURE, 5 / 6) == _head_crop(calm, PICTURE, 5 / 6)


@given(st.floats(0, 640), st.floats(0, 480), st.floats(8, 600), st.sampled_from([0.5, 5 / 6, 1.0, 1.9]))
def test_the_box_lies_in_the_picture_and_has_the_aspect(x, y, eyes_px, aspect):
    left, top, w, h = _head_crop([face_at(x, y, eyes_px)], PICTURE, aspect)
    assert left >= 0 and top >= 0 and w >= 1 and h >= 1 and left + w <= PICTURE[0] and top + h <= PICTURE[1]
    # Sides are whole numbers: each may be off by half a pixel.
    assert abs(w - aspect * h) <= 0.5 + 0.5 * aspect + 1e-6


def clip_folder(folder, count):
    for index in range(count):
        picture = np.full((48, 64, 3), 0.5, np.float32)
        picture[0, 0] = index / 255
        write_image(folder / f"f{index:03d}.png", picture)
    return open_clip([str(folder)])


def test_the_crop_is_found_in_a_spread_of_frames_and_says_in_how_many(tmp_path):
    asked = []

    def find(image):
        number = round(float(image[0, 0, 0]) * 255)
        asked.append(number)
        return None if number == 0 else face_at(32, 20, 10)

    crop = result_of(crop_steps(clip_folder(tmp_path / "clip", 30), Detector(find, {"version": 1}), 5 / 6))
    assert crop.frames == len(asked) == CROP_FRAMES and {0, 29} <= set(asked)
    assert crop.found == CROP_FRAMES - 1 and crop.eyes_px == pytest.approx(10)
    assert crop.box == _head_crop([face_at(32, 20, 10)], (64, 48), 5 / 6)


def test_a_clip_without_faces_is_not_cropped_at_random(tmp_path):
    clip = clip_folder(tmp_path / "clip", 5)
    with pytest.raises(BadInput, match=r"found in 0 of 5 frames of clip.*--crop x,y,w,h"):
        result_of(crop_steps(clip, Detector(lambda image: None, {"version": 1}), 5 / 6))


def test_without_the_detectors_files_a_build_says_in_one_line_how_to_get_better(monkeypatch, tmp_path):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "empty"))
    detector, notes = detector_for("auto")
    assert detector is None
    (note,) = notes
    assert "morphspace models fetch" in note and "\n" not in note
    assert detector_for("none") == (None, ())
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "iris_landmark.tflite").write_bytes(b"cut short")
    (damaged,) = detector_for("auto")[1]
    assert damaged == f"iris_landmark.tflite is damaged: {note}"
    with pytest.raises(BadInput, match=r"landmarks is 'yes'; expected one of auto, none"):
        detector_for("yes")


def beside(face, *places):
    return FacePoints(
        face.points, face.score, depth=face.depth, others=np.array(places, float).reshape(-1, 2)
    )


NAMES = ("a", "b", "c")


def test_a_face_that_jumps_to_another_person_is_refused_with_both_places():
    first, second = face_at(100, 80, 40), face_at(320, 80, 40)
    both = [beside(first, (320, 80)), None, beside(second, (100, 80))]
    with pytest.raises(BadInput, match=r"jumps from 100,80 px in a to 320,80 px in c.*\(88 px\).*--person"):
        check_one_person(NAMES, both)
    with pytest.raises(BadInput, match="jumps"):
        check_one_person(NAMES, [first, second, second], is_video=True)


def test_stills_of_one_face_each_and_heads_that_move_are_no_jump():
    check_one_person(NAMES, [face_at(100, 80, 40), face_at(320, 80, 40), None])
    near = [
        beside(face_at(100 + 80 * step, 80, 40), (900, 900)) for step in range(3)
    ]  # a step is 2 eye distances
    check_one_person(NAMES, near, is_video=True)


def test_several_faces_are_counted_and_located():
    face = face_at(100, 80, 40)
    assert several_notes(NAMES, [face, None, face]) == ()
    (note,) = several_notes(NAMES, [beside(face, (320, 80)), beside(face, (320, 80), (500, 60)), face])
    assert note.startswith("2 of 3 frames show several faces: in b the one at 100,80 px is used, of 2 more")
    assert "at 320,80 and 500,60" in note


def test_a_clip_whose_largest_face_alternates_is_not_cropped_between_two_people(tmp_path):
    clip_folder(tmp_path, 4)
    faces = iter([beside(face_at(x, 30, 12), (150 - x, 30)) for x in (30, 120, 30, 120)])
    detector = Detector(lambda image: next(faces), {"of": "this test"})
    with using_workers(1), pytest.raises(BadInput, match="--person left, right or x,y"):
        result_of(crop_steps(open_clip([tmp_path]), detector, 0.8))
