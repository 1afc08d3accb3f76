"""Laws of keypoints: what is set is kept, points follow the warps, and what places no face is refused."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.cli.main import main
from morphspace.errors import BadInput, ModelFileError
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LANDMARKS, LEFT_LIDS, RIGHT_LIDS
from morphspace.grid import warp
from morphspace.io.images import read_image
from morphspace.io.sidecars import MarkedFaceframe
from morphspace.model.file import read_model_file
from morphspace.model.keypoints import (
    affine_between,
    affine_between_models,
    checked_faceframe,
    detect_faceframe,
    lip_of,
    picture_to_mean,
    reference_to_mean,
    required_faceframe,
)
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.model import load_model
from morphspace.steps import result_of
from morphspace.verbs.keypoints import KeypointsRequest, run

POINTS = np.array([[20.0, 30.0], [41.0, 29.0], [30.0, 58.0]])  # the third lies on the jaw, which moves most
FRAME = FaceFrame((20.0, 30.0), (41.0, 29.0), (30.0, 44.0))
SIZE = (60, 72)


class Seen:
    """A detection of three points."""

    def __init__(self, points):
        self.points = points

    def faceframe(self):
        return FaceFrame.at(self.points)


@pytest.fixture
def saved(model, tmp_path):
    path = tmp_path / "drawn.morph"
    model.save(path)
    return path


@pytest.fixture
def command():
    def invoked(*words):
        return CliRunner().invoke(main, ["keypoints", *map(str, words)])

    return invoked


# affines


def test_the_affine_moves_one_faceframe_onto_the_other_and_back():
    other = FaceFrame.at(np.array([[100.0, 80], [160, 90], [120, 160]]))
    there, back = affine_between(FRAME, other), affine_between(other, FRAME)
    assert_allclose(warp.apply_affine(there, FRAME.points), other.points, atol=1e-9)
    assert_allclose(warp.chain_affine(back, there), np.eye(2, 3), atol=1e-9)
    assert_allclose(affine_between(FRAME, FRAME), np.eye(2, 3), atol=1e-12)


@settings(deadline=None, derandomize=True)
@given(st.floats(0.3, 3), st.floats(-0.5, 0.5), st.floats(-50, 50), st.floats(0.5, 2))
def test_the_affine_is_the_one_that_made_the_other_face(scale, turn, shift, tall):
    cosine, sine = scale * np.cos(turn), scale * np.sin(turn)
    truth = np.array([[cosine, -sine * tall, shift], [sine, cosine * tall, -shift]])
    found = affine_between(FRAME, FaceFrame.at(warp.apply_affine(truth, FRAME.points)))
    assert_allclose(found, truth, atol=1e-8)


DEGENERATE = {
    "4 px": [[20, 30], [22, 30], [30, 44]],
    "1.0 px apart": [[20, 30], [21, 30], [30, 44]],
    "one line": [[20, 30], [40, 30], [30, 31]],
    "on one line": [[20, 30], [40, 30], [40, 30]],
    "above the eyes": [[20, 30], [40, 30], [30, 10]],
}


@pytest.mark.parametrize("mentioned", DEGENERATE)
def test_what_spans_no_face_is_refused_on_either_side(mentioned):
    broken = FaceFrame.at(np.array(DEGENERATE[mentioned], np.float64))
    with pytest.raises(BadInput, match=f"the source's faceframe.*{mentioned}"):
        affine_between(broken, FRAME)
    with pytest.raises(BadInput, match=f"the target's faceframe.*{mentioned}"):
        affine_between(FRAME, broken)
    with pytest.raises(BadInput, match=f"given.*{mentioned}"):
        checked_faceframe(broken.points, SIZE, "given")


def test_models_are_linked_only_where_both_mark_the_same_points(model):
    marked = model.with_faceframe(FRAME)
    with pytest.raises(BadInput, match=r"drawn has no keypoints.*morphspace keypoints"):
        affine_between_models(model, marked)
    assert required_faceframe(marked) is FRAME
    assert_allclose(affine_between_models(marked, marked), np.eye(2, 3), atol=1e-12)
    with pytest.raises(BadInput, match="marks the philtrum, that of drawn the upper-lip"):
        affine_between_models(marked, model.with_faceframe(FRAME, {"lip": "upper-lip"}))


# checking


def test_exchanged_eyes_are_put_in_order_with_a_note():
    found, notes = checked_faceframe(POINTS[[1, 0, 2]], SIZE, "given")
    assert_array_equal(found.points, POINTS)
    assert "exchanged" in notes[0]
    assert checked_faceframe(POINTS, SIZE, "given")[1] == ()


@pytest.mark.parametrize(
    ("row", "point", "name"),
    [(0, (-1, 30), "right eye"), (1, (60, 30), "left eye"), (2, (30, 72), "philtrum")],
)
def test_points_outside_the_mean_face_are_named(row, point, name):
    points = POINTS.copy()
    points[row] = point
    with pytest.raises(BadInput, match=f"the {name} at .* outside the mean face of 60x72 px"):
        checked_faceframe(points, SIZE, "given")


# carrying


def test_points_follow_the_mean_shape_from_the_reference(model, wavy_field):
    mean_field = wavy_field(72, 60, 3.0, seed=4, sd_px=12.0)
    bent = replace(model, mean_inverse=warp.invert(mean_field))
    carried = reference_to_mean(bent, POINTS)
    assert_allclose(
        carried, warp.move_points(mean_field, POINTS), atol=0.02
    )  # px: linear between grid points
    assert np.abs(carried - POINTS).max() > 0.5


def test_points_of_the_reference_picture_are_cropped_and_scaled_as_the_frames_were(model):
    framing = {"source_size": [200, 220], "crop": [40, 30, 120, 144], "size": list(SIZE)}
    framed = replace(model, provenance={**model.provenance, "framing": framing})
    pictured = (POINTS + 0.5) * 2 - 0.5 + (40, 30)
    assert_allclose(picture_to_mean(framed, pictured), POINTS, atol=1e-6)


# detecting


def followed(model, faces):
    """A detector that looks up the true points of each training face by its picture."""
    known = [(np.clip(model.mean.render(), 0, 1), model.mean)]
    for row in model.training.values:
        morph = model.expand(row)
        known.append((np.clip(morph.render(), 0, 1), morph))

    def detect(image):
        errors = [np.abs(image - face).mean() for face, _ in known]
        faces.append(image)
        morph = known[int(np.argmin(errors))][1]
        return Seen(warp.move_points(morph.displacement, POINTS))

    return detect


def test_detections_are_carried_through_each_faces_warp(model):
    faces = []
    found = result_of(detect_faceframe(model, followed(model, faces)))
    assert (found.faces, found.found, len(faces)) == (13, 13, 13)
    assert_allclose(found.faceframe.points, POINTS, atol=0.02)
    assert found.spread_px.max() < 0.02
    assert min(face.min() for face in faces) >= 0 and max(face.max() for face in faces) <= 1


def test_a_few_wrong_detections_and_missing_faces_do_not_move_the_median(model):
    detect, count = followed(model, []), iter(range(100))

    def erring(image):
        number, found = next(count), detect(image)
        if number in (3, 7):
            return None
        return Seen(found.points + 20.0) if number in (1, 5, 9) else found

    found = result_of(detect_faceframe(model, erring))
    assert (found.faces, found.found) == (13, 11)
    assert_allclose(found.faceframe.points, POINTS, atol=0.05)


def test_the_spread_is_what_the_detector_scatters_by(model):
    rng, detect = np.random.default_rng(3), followed(model, [])
    unsure = lambda image: Seen(detect(image).points + rng.normal(0, 1, (3, 2)))  # noqa: E731
    found = result_of(detect_faceframe(model, unsure))
    assert 0.6 < found.spread_px.mean() < 1.8  # px: the median of a Rayleigh distance of sigma 1 is 1.18
    assert_allclose(found.faceframe.points, POINTS, atol=1.2)


def test_detection_uses_at_most_the_given_number_of_faces(model):
    faces = []
    result_of(detect_faceframe(model, followed(model, faces), faces=5))
    assert len(faces) == 6


def test_too_few_faces_found_is_refused(model):
    with pytest.raises(BadInput, match=r"found in 0 of 13 faces of drawn.*--set"):
        result_of(detect_faceframe(model, lambda image: None))


# the model


def test_a_faceframe_without_an_origin_does_not_keep_the_origin_of_the_last(model):
    marked = model.with_faceframe(FRAME, {"source": "set", "lip": "upper-lip"})
    again = marked.with_faceframe(FRAME)
    assert "keypoints" not in again.provenance and lip_of(again) == "philtrum"
    assert again.model_id == marked.model_id == model.model_id and model.faceframe is None


# the verb


def test_what_is_set_is_in_the_file_and_nothing_else_changes(model, saved):
    before = load_model(saved)
    outcome = result_of(run(KeypointsRequest(saved, points=tuple(map(tuple, POINTS)), lip="upper-lip")))
    after = load_model(saved)
    read_model_file(saved)
    assert_array_equal(after.faceframe.points, POINTS)
    assert (after.model_id, lip_of(after)) == (before.model_id, "upper-lip")
    assert after.provenance["keypoints"]["source"] == "set"
    assert {k: v for k, v in after.provenance.items() if k != "keypoints"} == dict(before.provenance)
    for name, array in before._arrays().items():
        assert_array_equal(array, after._arrays()[name])
    picture = read_image(outcome.written[1])
    assert outcome.written[1].name == "drawn.keypoints.png" and picture.shape == (72 * 6, 60 * 6, 3)
    plain = read_image(outcome.written[1])[0, 0]
    assert_allclose(plain, np.clip(model.mean.render(), 0, 1)[0, 0], atol=0.05)
    for x, y in POINTS:
        inside = picture[int((y + 0.5) * 6 - 0.5), int((x + 0.5) * 6 - 0.5)]
        assert inside.max() - inside.min() > 0.4  # the dot's ink


def test_an_output_leaves_the_model_as_it_was_and_is_the_same_bytes_twice(saved, tmp_path):
    before = saved.read_bytes()
    request = KeypointsRequest(saved, points=tuple(map(tuple, POINTS)), output=tmp_path / "one.morph")
    result_of(run(request))
    result_of(run(replace(request, output=tmp_path / "two.morph")))
    assert saved.read_bytes() == before
    assert (tmp_path / "one.morph").read_bytes() == (tmp_path / "two.morph").read_bytes()


def test_found_keypoints_say_where_they_came_from(model, saved):
    outcome = result_of(run(KeypointsRequest(saved, automatic=True), followed(model, [])))
    after = load_model(saved)
    assert_allclose(after.faceframe.points, POINTS, atol=0.02)
    origin = after.provenance["keypoints"]
    assert (origin["source"], origin["faces"], origin["found"], origin["lip"]) == ("auto", 13, 13, "philtrum")
    assert any("13 of 13" in line for line in outcome.lines) and outcome.warnings == ()


def test_detections_that_contradict_each_other_give_a_note(model, saved):
    detect, rng = followed(model, []), np.random.default_rng(2)
    unsure = lambda image: Seen(detect(image).points + rng.normal(0, 2, (3, 2)))  # noqa: E731
    outcome = result_of(run(KeypointsRequest(saved, automatic=True), unsure))
    assert "of the eye distance apart" in outcome.warnings[0]


def test_a_file_is_read_carried_and_recorded(saved, tmp_path):
    path = tmp_path / "marked.tps"
    pictured = POINTS * (1, -1)
    path.write_text("LM=3\n" + "".join(f"{x} {y}\n" for x, y in pictured) + "ID=a\n")
    model = load_model(saved)
    framing = {"source_size": [60, 72], "crop": None, "size": list(SIZE)}
    replace(model, provenance={**model.provenance, "framing": framing}).save(saved)
    outcome = result_of(run(KeypointsRequest(saved, file=path, on="reference")))
    after = load_model(saved)
    assert_allclose(after.faceframe.points, POINTS, atol=1e-6)
    origin = after.provenance["keypoints"]
    assert (origin["file"], origin["on"], origin["scheme"]) == ("marked.tps", "reference", "three points")
    assert "negative" in outcome.warnings[0]


def test_without_a_source_the_points_are_printed_and_nothing_is_written(saved, command):
    before = saved.read_bytes()
    assert "no keypoints are set" in command(saved).output
    command(saved, "--set", "20,30 41,29 30,44")
    after = saved.read_bytes()
    shown = command(saved)
    assert shown.exit_code == 0 and "right eye          20.0, 30.0" in shown.output
    assert saved.read_bytes() == after != before


def test_setting_again_says_how_far_they_moved(saved, command):
    command(saved, "--set", "20,30 41,29 30,44")
    assert "moved by 3.0, 0.0, 0.0 px" in command(saved, "--set", "20,33 41,29 30,44").output


def test_the_command_has_help(command):
    assert "--lip" in command("--help").output


def test_a_damaged_model_is_not_written_again(saved):
    content = bytearray(saved.read_bytes())
    content[len(content) // 2] ^= 0xFF
    saved.write_bytes(content)
    with pytest.raises(ModelFileError, match="changed after it was written"):
        result_of(run(KeypointsRequest(saved, points=tuple(map(tuple, FRAME.points)))))
    assert saved.read_bytes() == bytes(content)


# advice that helps


@pytest.mark.parametrize(
    ("name", "points", "words", "advised", "not_advised"),
    [
        ("--set", [(20, 58), (41, 58), (30, 30)], [], "turn the face upright", "--negate-y"),
        ("up.csv", [(20, 43), (41, 43), (30, 13)], [], "give --negate-y", "leave out"),
        (
            "down.csv",
            [(20, 30), (41, 30), (30, 58)],
            ["--negate-y"],
            "leave out --negate-y",
            "give --negate-y",
        ),
        (
            "down.tps",
            [(20, 30), (41, 30), (30, 58)],
            ["--negate-y"],
            "leave out --negate-y",
            "give --negate-y",
        ),
        (
            "below.tps",
            [(20, -58), (41, -58), (30, -30)],
            ["--negate-y"],
            "turn the face upright",
            "--negate-y,",
        ),
        ("aside.tps", [(20, -30), (90, -30), (30, -58)], ["--negate-y"], "give points in its", "--negate-y"),
        ("below.csv", [(20, -30), (41, -30), (30, -58)], [], "give --negate-y", "--on reference"),
    ],
)
def test_what_is_advised_helps(saved, command, tmp_path, name, points, words, advised, not_advised):
    if name == "--set":
        given = ["--set", " ".join(f"{x},{y}" for x, y in points)]
    else:
        rows = "".join(f"{x}{',' if name.endswith('csv') else ' '}{y}\n" for x, y in points)
        (tmp_path / name).write_text(rows if name.endswith("csv") else f"LM=3\n{rows}ID=a\n")
        given = ["--from", tmp_path / name, *words]
    refused = command(saved, *given)
    assert refused.exit_code == 2
    told = refused.output.split("down here: ")[-1].split(" px: ")[-1]
    assert advised in told and not_advised not in told
    if "--negate-y" in advised:
        given = given[:2] if "leave out" in advised else [*given, "--negate-y"]
        assert command(saved, *given).exit_code == 0


def test_points_far_from_the_landmarks_give_a_warning(model, saved):
    """Keypoints set by hand do not move the model's landmarks."""
    count = len(LANDMARKS)
    mean = np.tile([30.0, 46.0], (count, 1))
    for group, at in ((RIGHT_LIDS, FRAME.right_eye), (LEFT_LIDS, FRAME.left_eye)):
        mean[[LANDMARKS.index(place) for place in group]] = at
    weights = np.zeros((model.rank, count, 2))
    learned = LandmarkRegression(mean, weights, np.ones(count), 12, 1.0, False)
    model.with_faceframe(FRAME).with_landmarks(learned).save(saved)
    near = result_of(run(KeypointsRequest(saved, points=((21, 31), (41, 29), (30, 44)))))
    assert near.warnings == ()
    far = result_of(run(KeypointsRequest(saved, points=((20, 30), (55, 29), (30, 44)))))
    assert (
        "the left eye lies 0.7 eye distances from the model's landmark for it at 41.0,29.0" in far.warnings[0]
    )


def test_a_file_of_another_format_says_what_to_write(saved, command, tmp_path):
    (tmp_path / "points.json").write_text('{"shapes": []}')
    refused = command(saved, "--from", tmp_path / "points.json")
    assert refused.exit_code == 2 and "write both eyes and the philtrum to a .csv" in refused.output


def test_a_marked_point_that_cannot_be_is_named_with_its_value():
    with pytest.raises(
        BadInput, match=r"the philtrum .* of f is 30,90; expected a point in its image of 60 x"
    ):
        MarkedFaceframe("f", np.array([[20.0, 30], [40, 30], [30, 90]]), (60, 72))
    with pytest.raises(BadInput, match="both eyes are at 20,30; expected"):
        MarkedFaceframe("f", np.array([[20.0, 30], [20, 30], [30, 50]]))
    with pytest.raises(BadInput, match="both eyes are at x 20, one above the other"):
        MarkedFaceframe("f", np.array([[20.0, 30], [20, 40], [30, 50]]))


def test_a_model_that_is_not_there_or_a_folder_says_what_to_do(tmp_path, command):
    (tmp_path / "folder").mkdir()
    assert "Check the name" in command(tmp_path / "nowhere.morph").output
    assert "it is a folder. Enter a file" in command(tmp_path / "folder").output
