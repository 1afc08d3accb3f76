"""Each kind of file written through the package is what its page in `data_spec/` says; a broken one not."""

import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import safetensors

from morphspace.cli.documents import DOCUMENTS
from morphspace.errors import BadInput, ModelFileError, UnreadableFile
from morphspace.face.mesh import LANDMARKS
from morphspace.io import limits
from morphspace.io.clips import IMAGE_SUFFIXES, Clip
from morphspace.io.points_table import FramePoints, read_points, write_points_table
from morphspace.io.sidecars import MarkedFaceframe, Sidecar, read_faceframe, read_sidecar, write_sidecar
from morphspace.io.tables import read_loadings_table, write_loadings_table
from morphspace.model.file import OPTIONAL_ARRAY_KINDS
from morphspace.model.model import load_model
from morphspace.outcome import RECORD
from morphspace.requests import verb_names
from morphspace.steps import result_of
from morphspace.storage import digest_of_file, read_container, write_container
from morphspace.verbs import build_model, make_actors, sample
from morphspace.verbs.build_model import BuildModelRequest
from morphspace.verbs.make_actors import MakeActorsRequest
from morphspace.verbs.sample import SampleRequest

DATA_SPEC = Path(__file__).parents[2] / "data_spec"
POINTS = np.array([[10.25, 20.0], [30.0, 20.5], [20.0, 35.0]])


@cache
def validator_of(kind: str) -> jsonschema.Draft202012Validator:
    schema = json.loads((DATA_SPEC / f"{kind}.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def written(kind: str, folder: Path) -> dict:
    path = folder / "file.json"
    if kind == "clip-folder":
        faceframe = MarkedFaceframe("frame_0001", POINTS)
        write_sidecar(path, Sidecar("actor-07", 25.0, "research", "CC BY 4.0", faceframe, {"camera": "left"}))
    elif kind == "faceframe":
        points = dict(zip(("right_eye", "left_eye", "philtrum"), POINTS.tolist(), strict=True))
        head = {"format": "morphspace-faceframe", "version": 1, "image": "frame_0001.png", "size": [40, 50]}
        path.write_text(json.dumps({**head, **points}))
    elif kind == "points-table":
        about = {"scheme": "three", "size": [40, 50], "inputs": {"a": "0" * 64}, "identity": "actor-07"}
        write_points_table(path.with_suffix(".csv"), {"a": None, "b": FramePoints(POINTS)}, 3, about)
    else:
        document = {"model_id": "0f3a", "identity": "actor-07", "frame_rate_hz": 25.0}
        write_loadings_table(path.with_suffix(".csv"), np.array([[0.5, -1.0]]), ["frame_0001"], document)
    return json.loads(path.read_text(encoding="utf-8"))


def read(kind: str, folder: Path) -> object:
    if kind == "clip-folder":
        return read_sidecar(folder / "file.json")
    if kind == "faceframe":
        return read_faceframe(folder / "file.json")
    if kind == "points-table":
        clip = Clip("c", ("a", "b"), (40, 50), Sidecar(), (folder / "file.csv",) * 2, None)
        return read_points(folder / "file.csv", clip, "three", 3)
    return read_loadings_table(folder / "file.csv")


@pytest.mark.parametrize("kind", ["clip-folder", "loadings-table", "points-table"])
def test_what_the_package_writes_fits_the_schema(kind, tmp_path):
    validator_of(kind).validate(written(kind, tmp_path))


BROKEN = [
    ("clip-folder", "frame_rate_hz", 0),
    ("clip-folder", "frame_rate_hz", "25"),
    ("clip-folder", "identity", 7),
    ("clip-folder", "faceframe", [1, 2]),
    ("clip-folder", "faceframe", {"frame": "a", "right_eye": [1, 2], "left_eye": [3, 2]}),
    ("clip-folder", "faceframe", {"right_eye": [1, 2], "left_eye": [3, 2], "philtrum": [2, 3]}),
    ("faceframe", "format", "something else"),
    ("faceframe", "version", 2),
    ("faceframe", "image", None),
    ("faceframe", "philtrum", [1, 2, 3]),
    ("faceframe", "philtrum", [1]),
    ("faceframe", "philtrum", ["1", 2]),
    ("faceframe", "size", [40]),
    ("faceframe", "size", [40, 0]),
    ("faceframe", "size", [40.5, 50]),
    ("loadings-table", "format", "morphspace-faceframe"),
    ("loadings-table", "version", 99),
    ("loadings-table", "unit", "variance"),
    ("points-table", "format", "morphspace-loadings"),
    ("points-table", "version", 2),
    ("points-table", "size", [40]),
    ("points-table", "point_count", 0),
    ("points-table", "inputs", {"a": "no digest"}),
]


@pytest.mark.parametrize(("kind", "entry", "value"), BROKEN)
def test_schema_and_reader_refuse_the_same_broken_files(kind, entry, value, tmp_path):
    document = {**written(kind, tmp_path), entry: value}
    with pytest.raises(jsonschema.ValidationError):
        validator_of(kind).validate(document)
    (tmp_path / "file.json").write_text(json.dumps(document))
    with pytest.raises(BadInput, match=r"file\.json"):
        read(kind, tmp_path)


@pytest.mark.parametrize(
    ("kind", "entry"),
    [
        ("faceframe", "left_eye"),
        ("faceframe", "version"),
        ("loadings-table", "unit"),
        ("points-table", "scheme"),
    ],
)
def test_a_required_entry_is_missed(kind, entry, tmp_path):
    document = written(kind, tmp_path)
    del document[entry]
    with pytest.raises(jsonschema.ValidationError):
        validator_of(kind).validate(document)
    (tmp_path / "file.json").write_text(json.dumps(document))
    with pytest.raises(BadInput, match=entry):
        read(kind, tmp_path)


PAGES = [one.name for one in DOCUMENTS if one.name != "batch-folder"]  # which is on the page of recipes


@pytest.mark.parametrize("kind", PAGES)
def test_every_entry_of_the_schema_is_on_its_page(kind):
    page = (DATA_SPEC / f"{kind}.md").read_text()
    for entry in validator_of(kind).schema["properties"]:
        assert f"`{entry}`" in page


@pytest.mark.parametrize("kind", ["clip-folder", "faceframe"])
def test_the_example_on_the_page_fits_the_schema_and_reads(kind, tmp_path):
    (example,) = re.findall(r"```json\n(.*?)```", (DATA_SPEC / f"{kind}.md").read_text(), re.DOTALL)
    validator_of(kind).validate(json.loads(example))
    (tmp_path / "file.json").write_text(example)
    read(kind, tmp_path)


def test_the_example_table_on_the_page_reads(tmp_path):
    (example,) = re.findall(r"```\n(frame,.*?)```", (DATA_SPEC / "loadings-table.md").read_text(), re.DOTALL)
    (tmp_path / "file.csv").write_text(example)
    assert read_loadings_table(tmp_path / "file.csv").loadings_sd.shape == (2, 3)


def test_the_example_of_points_on_the_page_has_the_columns_that_are_written(tmp_path):
    (example,) = re.findall(r"```\n(frame,.*?)```", (DATA_SPEC / "points-table.md").read_text(), re.DOTALL)
    written("points-table", tmp_path)
    assert example.splitlines()[0] == (tmp_path / "file.csv").read_text().splitlines()[0]


def test_a_sidecar_round_trips_and_a_faceframe_is_read(tmp_path):
    written("clip-folder", tmp_path)
    sidecar = read_sidecar(tmp_path / "file.json")
    told = (sidecar.identity, sidecar.frame_rate_hz, sidecar.consent, sidecar.licence, sidecar.extra)
    assert told == ("actor-07", 25.0, "research", "CC BY 4.0", {"camera": "left"})
    assert sidecar.faceframe.image == "frame_0001"
    np.testing.assert_array_equal(sidecar.faceframe.points, POINTS)
    written("faceframe", tmp_path)
    faceframe = read_faceframe(tmp_path / "file.json")
    assert (faceframe.image, faceframe.size) == ("frame_0001.png", (40, 50))
    np.testing.assert_array_equal(faceframe.points, POINTS)


# the model file


@pytest.fixture(scope="module", autouse=True)
def without_networks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What a build writes must not depend on whether this machine has the networks that find faces."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHSPACE_MODELS", str(tmp_path_factory.mktemp("none")))
        yield


@pytest.fixture(scope="module")
def actors(tmp_path_factory):
    """A folder that the verb make-actors wrote: one drawn clip of six frames, 48 x 60, with a faceframe."""
    folder = tmp_path_factory.mktemp("actors")
    result_of(make_actors.run(MakeActorsRequest(folder, identities=1, frames=6, seed=3, size=(48, 60))))
    return folder


@pytest.fixture(scope="module", params=["everything chosen by the build", "everything given"])
def model_path(actors, request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("model")
    clip, given = actors / "actor_01", {}
    if request.param == "everything given":  # a clip without a sidecar: all that may be null is null
        bare = folder / "bare"
        bare.mkdir()
        frames = sorted(clip.glob("*.png"))
        for path in frames:
            (bare / path.name).write_bytes(path.read_bytes())
        clip = bare
        given = {"warp_weight": 0.02, "registration": "none", "crop": (2, 2, 44, 56)}
        given["reference"] = frames[2].name
    result_of(build_model.run(BuildModelRequest((str(clip),), folder / "a.morph", flow="fast", **given)))
    return folder / "a.morph"


def document_of(path):
    """The JSON document of a model file, taken out by the safetensors library alone."""
    with safetensors.safe_open(path, framework="np") as file:
        metadata = file.metadata()
    assert list(metadata) == ["morphspace"]
    return json.loads(metadata["morphspace"])


def test_the_document_of_a_model_fits_the_schema(model_path):
    validator_of("model-file").validate(document_of(model_path))


def test_the_two_models_differ_in_what_may_be_null(model_path):
    document, loaded = document_of(model_path), load_model(model_path)
    assert (document["faceframe"] is None) == (loaded.faceframe is None)
    trials = document["provenance"]["warp_weight_trials"]
    crop = document["provenance"]["framing"]["crop"]
    assert (document["faceframe"] is None, trials == [], crop is not None) in [(True,) * 3, (False,) * 3]


def documented_arrays(document, mask_shape):
    """The shapes and types in the table of the page, with this model's numbers put in."""
    page = (DATA_SPEC / "model-file.md").read_text()
    height, width = mask_shape
    letters = {"h": height, "w": width, "n": len(document["training_frames"]), "m": len(LANDMARKS)}
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \| (float\d\d) \|", page, re.MULTILINE)
    arrays = {}
    for name, sides, kind in rows:
        shape = []
        for side in sides.split(","):
            factors = [letters.get(factor, factor) for factor in side.split()]
            shape.append("k" if factors == ["k"] else int(np.prod([int(factor) for factor in factors])))
        arrays[name] = (shape, kind)
    return arrays


def test_the_safetensors_library_opens_the_arrays_that_the_page_names(model_path):
    document = document_of(model_path)
    with safetensors.safe_open(model_path, framework="np") as file:
        found = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a dict)
    k = len(found["variances"])
    assert k == load_model(model_path).rank > 0
    documented = documented_arrays(document, found["mask"].shape)
    assert set(documented) == set(found) | set(OPTIONAL_ARRAY_KINDS)
    for name in OPTIONAL_ARRAY_KINDS:
        del documented[name]
    for name, (shape, kind) in documented.items():
        assert found[name].shape == tuple(k if side == "k" else side for side in shape), name
        assert found[name].dtype == kind, name


def test_arrays_start_at_a_multiple_of_64_bytes(model_path):
    assert (8 + int.from_bytes(model_path.read_bytes()[:8], "little")) % 64 == 0


def test_the_inner_product_and_the_variances_are_those_of_the_page(model_path):
    with safetensors.safe_open(model_path, framework="np") as file:
        components, variances, mask, loadings = (
            file.get_tensor(name) for name in ("components", "variances", "mask", "training_loadings")
        )
    s = document_of(model_path)["warp_weight"]
    height, width = mask.shape
    texture = components[:, : 3 * mask.size].reshape(-1, height, width, 3).astype(np.float64)
    moved = components[:, 3 * mask.size :].reshape(-1, height, width, 2).astype(np.float64)
    product = np.einsum("hw,ahwc,bhwc->ab", mask, texture, texture)
    product += s**2 * np.einsum("hw,ahwc,bhwc->ab", mask, moved, moved)
    np.testing.assert_allclose(product, np.eye(len(variances)), atol=1e-5)
    np.testing.assert_allclose(loadings.var(axis=0, ddof=1), variances, rtol=1e-9)


def changed(document, entry, value):
    """The document with one entry, given by its path, set or, where the value is `...`, left out."""
    copy = json.loads(json.dumps(document))
    *path, last = entry.split(".")
    place = copy
    for step in path:
        place = place[step]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return copy


POINT = [1, 2]
BROKEN_MODELS = [
    ("format", "morphspace-loadings"),
    ("version", 2),
    ("warp_weight", "heavy"),
    ("discarded_variance", [1]),
    ("faceframe", {"right_eye": POINT, "left_eye": POINT}),
    ("faceframe", {"right_eye": [1], "left_eye": POINT, "philtrum": POINT}),
    ("training_frames", 12),
    ("registration", "projective"),
    ("provenance", None),
    ("provenance.identity", 7),
    ("provenance.identity", ...),
    *[
        (entry, ...)
        for entry in ("format", "version", "model_id", "reference_id", "warp_weight", "faceframe")
    ],
    *[(entry, ...) for entry in ("reference_faceframe", "training_frames", "registration", "provenance")],
    ("model_id", "0F3A"),
    ("reference_id", None),
    ("warp_weight", 0),
    ("discarded_variance", -1),
    ("training_frames", ["a"]),
    ("flow", None),
    ("surprise", 1),
    ("provenance.consent", 1),
    ("provenance.frame_rate_hz", "25"),
    ("provenance.framing.size", [48]),
    ("provenance.framing.crop", [1, 2, 3]),
    ("provenance.inputs", {"frame_0001": "no digest"}),
    ("provenance.reference.sha256", ...),
    ("provenance.flow_start", "sometimes"),
    ("provenance.components_asked", 0),
    ("provenance.warp_weight_trials", [[0.1]]),
    ("provenance.versions", {"numpy": 2}),
]


@pytest.mark.parametrize(("entry", "value"), BROKEN_MODELS)
def test_schema_and_reader_refuse_the_same_broken_models(model_path, entry, value, tmp_path):
    arrays, document = read_container(model_path)
    broken = changed(document, entry, value)
    with pytest.raises(jsonschema.ValidationError):
        validator_of("model-file").validate(broken)
    write_container(tmp_path / "broken.morph", arrays, broken)
    with pytest.raises(ModelFileError, match=r"broken\.morph"):
        load_model(tmp_path / "broken.morph")


# the record


@pytest.fixture
def sampled(model_path, tmp_path):
    """A folder that the verb sample wrote."""
    result_of(sample.run(SampleRequest(model_path, tmp_path / "faces", count=2, seed=7)))
    return tmp_path / "faces"


def record_in(folder):
    return json.loads((folder / "record.json").read_text(encoding="utf-8"))


def test_the_record_of_a_sample_fits_the_schema(sampled):
    validator_of("record").validate(record_in(sampled))


def test_the_record_of_drawn_actors_fits_the_schema(actors):
    record = record_in(actors)
    validator_of("record").validate(record)
    assert (record["verb"], record["inputs"]) == ("make-actors", {})
    assert record["outputs"]["actor_01/clip.json"] == digest_of_file(actors / "actor_01" / "clip.json")


def test_a_record_names_the_settings_and_the_digest_of_every_file(sampled, model_path):
    record = record_in(sampled)
    assert record["verb"] == "sample"
    assert record["settings"] == {"count": 2, "max_sd": None, "model": "a.morph", "seed": 7, "spread": 1.0}
    assert record["inputs"] == {"model": digest_of_file(model_path)}
    files = {str(path.relative_to(sampled)): path for path in sampled.rglob("*") if path.is_file()}
    del files["record.json"]
    assert record["outputs"] == {name: digest_of_file(path) for name, path in files.items()}
    assert record["versions"]["numpy"] == np.__version__


def test_the_same_sample_in_another_folder_has_the_same_record(sampled, model_path, tmp_path):
    other = tmp_path / "elsewhere" / "again"
    result_of(sample.run(SampleRequest(model_path, other, count=2, seed=7)))
    assert (other / "record.json").read_bytes() == (sampled / "record.json").read_bytes()


BROKEN_RECORDS = [
    ("format", "morphspace-loadings"),
    ("version", 2),
    ("verb", "Dream on"),
    ("settings", [1]),
    ("inputs", {"model": "0f3a"}),
    ("inputs", None),
    ("outputs", {}),
    ("outputs", {"a.png": None}),
    ("outputs", {"/somewhere/a.png": 64 * "0"}),
    ("outputs", {"record.json": 64 * "0"}),
    ("versions.morphspace", ...),
    ("versions.numpy", 2),
    ("date", "2026-11-22"),
    *[(e, ...) for e in ("format", "version", "verb", "settings", "inputs", "outputs", "versions")],
]


@pytest.mark.parametrize(("entry", "value"), BROKEN_RECORDS)
def test_schema_and_reader_refuse_the_same_broken_records(actors, entry, value):
    broken = changed(record_in(actors), entry, value)
    with pytest.raises(jsonschema.ValidationError):
        validator_of("record").validate(broken)
    with pytest.raises(UnreadableFile, match=entry.split(".")[-1]):
        RECORD.checked(broken, actors / "record.json")


def test_the_example_record_on_the_page_fits_the_schema():
    (example,) = re.findall(r"```json\n(.*?)```", (DATA_SPEC / "record.md").read_text(), re.DOTALL)
    validator_of("record").validate(json.loads(example))


def test_the_name_of_every_verb_fits_the_schema_of_a_record():
    pattern = validator_of("record").schema["properties"]["verb"]["pattern"]
    assert all(re.fullmatch(pattern, name) for name in verb_names() if " " not in name)


def test_swapped_eyes_are_exchanged_and_points_outside_are_refused():
    np.testing.assert_array_equal(MarkedFaceframe("a.png", POINTS[[1, 0, 2]]).points, POINTS)
    with pytest.raises(BadInput, match="in its image of 40 x 35"):
        MarkedFaceframe("a.png", POINTS, (40, 35))
    MarkedFaceframe("a.png", POINTS, (40, 36))
    with pytest.raises(BadInput, match="not finite or not three"):
        MarkedFaceframe("a.png", np.full((3, 2), np.nan))


def test_the_page_of_inputs_has_every_limit_and_every_kind_of_picture():
    page = (DATA_SPEC.parent / "docs" / "inputs.md").read_text(encoding="utf-8")
    for limit in (limits.PICTURE_PX, limits.TABLE_BYTES, limits.RECIPE_BYTES, limits.POINTS_BYTES):
        assert re.search(rf"\| {limit.usual:,} {limit.unit}\b.*\| `{limit.variable}` \|", page)
    clip_folder = (DATA_SPEC / "clip-folder.md").read_text(encoding="utf-8")
    assert f"(`{' '.join(IMAGE_SUFFIXES)}`)" in clip_folder
