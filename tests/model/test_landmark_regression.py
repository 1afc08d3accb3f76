"""Laws of the landmarks of a model: what is linear is learned, the error is that of faces left out, a file keeps it."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, ModelFileError
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import GROUPS, INNER_LIPS, LANDMARKS, POINT_COUNT, landmark_places
from morphspace.grid import warp
from morphspace.model.file import read_model_file
from morphspace.model.keypoints import detect_faceframe, with_detected
from morphspace.model.landmarks import learn_landmarks
from morphspace.model.model import load_model
from morphspace.steps import result_of
from morphspace.storage import read_container, write_container
from morphspace.verbs import info, keypoints
from morphspace.verbs.info import InfoRequest
from morphspace.verbs.keypoints import KeypointsRequest

FRAME = FaceFrame((20.0, 30.0), (41.0, 29.0), (30.0, 44.0))
FACES, RANK = 40, 3
SD = np.array([2.0, 1.0, 0.5])
NOTHING = np.zeros((RANK, POINT_COUNT, 2))


def drawn(seed=0, noise_px=0.0):
    """Loadings, weights and points of faces whose points are linear in the loadings, but for noise."""
    rng = np.random.default_rng(seed)
    loadings = rng.standard_normal((FACES, RANK)) * SD
    weights = rng.standard_normal((RANK, POINT_COUNT, 2))
    points = 30 + np.tensordot(loadings, weights, 1) + noise_px * rng.standard_normal((FACES, POINT_COUNT, 2))
    return loadings, weights, points


def test_what_is_linear_is_learned():
    loadings, weights, points = drawn()
    learned = learn_landmarks(loadings, points, SD, NOTHING)
    assert learned.mean.shape == (len(LANDMARKS), 2) and learned.weights.shape == (RANK, len(LANDMARKS), 2)
    assert_allclose(learned.at(loadings[7]), points[7, LANDMARKS], atol=0.1)
    assert_allclose(learned.weights, weights[:, LANDMARKS], atol=0.05)
    assert learned.error_px.max() < 0.2 and learned.faces == FACES


def test_a_warp_that_knows_the_points_is_followed():
    loadings, weights, points = drawn()
    learned = learn_landmarks(loadings, points, SD, weights)
    assert learned.follows_warp
    assert_allclose(learned.weights, weights[:, LANDMARKS], atol=1e-9)
    assert learned.error_px.max() < 1e-9


def test_the_error_is_that_of_faces_left_out():
    """The closed form equals FACES regressions without one face each, with the chosen ridge."""
    loadings, _, points = drawn(noise_px=3.0)
    learned = learn_landmarks(loadings, points, SD, NOTHING)
    seen, design = points[:, LANDMARKS].reshape(FACES, -1), np.column_stack([np.ones(FACES), loadings / SD])
    penalty = learned.ridge * np.diag([0.0, 1, 1, 1])
    missed = []
    for out in range(FACES):
        kept = np.arange(FACES) != out
        solved = np.linalg.solve(design[kept].T @ design[kept] + penalty, design[kept].T @ seen[kept])
        missed.append((seen[out] - design[out] @ solved).reshape(-1, 2))
    assert_allclose(learned.error_px, np.sqrt((np.array(missed) ** 2).sum(axis=-1).mean(axis=0)), rtol=1e-9)
    assert (
        3.0 * np.sqrt(2) < learned.errors()["all"] < 3.0 * np.sqrt(2) * 1.3
    )  # above the noise of a single face


def test_more_noise_holds_the_regression_back_more():
    quiet, loud = (learn_landmarks(*drawn(1, noise)[::2], SD, NOTHING) for noise in (0.1, 30.0))
    assert quiet.ridge < loud.ridge


def test_errors_are_listed_by_group():
    loadings, _, points = drawn()
    points[:, INNER_LIPS] += 5 * np.random.default_rng(4).standard_normal((FACES, len(INNER_LIPS), 2))
    errors = learn_landmarks(loadings, points, SD, NOTHING).errors()
    assert set(errors) == {"all", *GROUPS}
    assert errors["inner lips"] > 5 > 10 * errors["lids"]
    assert LANDMARKS[landmark_places("inner lips")] == INNER_LIPS
    with pytest.raises(BadInput, match="expected one of lids"):
        landmark_places("nose")


def test_fewer_components_err_by_what_the_others_explained():
    loadings, _, points = drawn()
    learned = learn_landmarks(loadings, points, SD, NOTHING)
    fewer = learned.truncate(2, loadings)
    assert fewer.weights.shape[0] == 2
    lost = loadings[:, 2:] @ learned.weights[2:].reshape(1, -1)
    expected = np.sqrt(learned.error_px**2 + (lost.reshape(FACES, -1, 2) ** 2).sum(-1).mean(0))
    assert_allclose(fewer.error_px, expected)
    assert_array_equal(learned.truncate(3, loadings).error_px, learned.error_px)


def test_what_cannot_be_learned_from_is_refused():
    loadings, _, points = drawn()
    with pytest.raises(BadInput, match="in 7 faces; expected at least 8"):
        learn_landmarks(loadings[:7], points[:7], SD, NOTHING)
    with pytest.raises(BadInput, match="478"):
        learn_landmarks(loadings, points[:, :468], SD, NOTHING)
    points[3, 5] = np.nan
    with pytest.raises(BadInput, match="finite"):
        learn_landmarks(loadings, points, SD, NOTHING)


# in a model


class Mesh:
    """A detection of 478 points."""

    def __init__(self, points):
        self.points = points

    def faceframe(self):
        return FRAME


def mesh_of(model):
    """A detector whose points follow the warp of each training face, looked up by its picture."""
    height, width = model.mask.shape
    rng = np.random.default_rng(0)
    rest = rng.uniform((8, 8), (width - 8, height - 8), (POINT_COUNT, 2))
    morphs = [model.mean, *(model.expand(row) for row in model.training.values)]
    known = [(np.clip(morph.render(), 0, 1), morph) for morph in morphs]

    def detect(image):
        errors = [np.abs(image - face).mean() for face, _ in known]
        return Mesh(warp.move_points(known[int(np.argmin(errors))][1].displacement, rest))

    return detect


@pytest.fixture(scope="module")
def taught(model):
    return with_detected(model, result_of(detect_faceframe(model, mesh_of(model))))


def test_detections_in_training_faces_teach_the_landmarks(model, taught):
    assert taught.landmarks.faces == len(model.training.values)  # and not the mean face beside them
    assert taught.landmarks.follows_warp
    assert taught.landmarks.errors()["all"] < 0.3
    assert taught.model_id == model.model_id and taught.provenance["keypoints"]["source"] == "auto"


def test_the_file_keeps_the_landmarks_and_old_files_have_none(model, taught, tmp_path):
    taught.save(tmp_path / "taught.morph")
    model.save(tmp_path / "old.morph")
    loaded = load_model(tmp_path / "taught.morph")
    read_model_file(tmp_path / "taught.morph")
    for name in ("mean", "weights", "error_px", "faces", "ridge", "follows_warp"):
        assert_array_equal(getattr(loaded.landmarks, name), getattr(taught.landmarks, name))
    assert load_model(tmp_path / "old.morph").landmarks is None
    assert "landmarks" not in read_container(tmp_path / "old.morph")[1]
    assert loaded.truncate(1).landmarks.weights.shape[0] == 1 and model.truncate(1).landmarks is None
    loaded.save(tmp_path / "again.morph")
    assert (tmp_path / "again.morph").read_bytes() == (tmp_path / "taught.morph").read_bytes()


def test_the_document_with_landmarks_fits_the_schema(taught):
    schema = json.loads((Path(__file__).parents[2] / "data_spec" / "model-file.schema.json").read_text())
    told = schema["properties"]["landmarks"]
    document = json.loads(json.dumps(taught.landmarks.document()))
    jsonschema.Draft202012Validator(told).validate(document)
    assert document["places"] == list(LANDMARKS) and document["toward"] == "warp"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(told).validate({**document, "faces": 3})


@pytest.mark.parametrize("broken", ["no array", "shape", "nan", "negative", "no document", "other places"])
def test_landmarks_that_do_not_fit_are_refused(taught, tmp_path, broken):
    path = tmp_path / "a.morph"
    taught.save(path)
    arrays, document = read_container(path)
    arrays = {name: np.array(array) for name, array in arrays.items()}
    if broken == "no array":
        del arrays["landmark_weights"]
    elif broken == "shape":
        arrays["landmark_mean"] = arrays["landmark_mean"][:-1]
    elif broken == "nan":
        arrays["landmark_weights"][0, 0, 0] = np.nan
    elif broken == "negative":
        arrays["landmark_error"][3] = -1
    elif broken == "no document":
        del document["landmarks"]
    else:
        document["landmarks"]["places"][0] += 1
    write_container(path, arrays, json.loads(json.dumps(document)))
    with pytest.raises(ModelFileError, match="landmark"):
        load_model(path)


def test_the_command_teaches_and_info_tells_the_error(model, tmp_path):
    path = tmp_path / "a.morph"
    model.save(path)
    before = result_of(info.run(InfoRequest(path)))
    assert before.document["landmarks"] is None
    assert any("keypoints MODEL --auto" in line for line in before.lines)
    outcome = result_of(keypoints.run(KeypointsRequest(path, automatic=True), mesh_of(model)))
    assert any("leave-one-out error" in line for line in outcome.lines)
    assert outcome.document["landmarks"]["faces"] == len(model.training.values)
    after = result_of(info.run(InfoRequest(path)))
    assert after.document["landmarks"] == outcome.document["landmarks"]
    assert any("inner lips" in line for line in after.lines)


def test_too_few_faces_set_keypoints_but_teach_nothing(model, tmp_path):
    path = tmp_path / "few.morph"
    few = replace(
        model.training, values=model.training.values[:5], frame_names=model.training.frame_names[:5]
    )
    replace(model, training=few).save(path)
    outcome = result_of(keypoints.run(KeypointsRequest(path, automatic=True), mesh_of(model)))
    assert load_model(path).landmarks is None and load_model(path).faceframe is not None
    assert any("found in 6 faces" in note for note in outcome.warnings)


def test_keypoints_set_by_hand_leave_the_landmarks(taught, tmp_path):
    path = tmp_path / "a.morph"
    taught.save(path)
    result_of(keypoints.run(KeypointsRequest(path, points=tuple(map(tuple, FRAME.points)))))
    assert load_model(path).landmarks is not None
