"""Each kind of file written through the package is what its page in `data_spec/` says; a broken one not."""

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.files.sidecars import (
    MarkedFaceframe,
    Sidecar,
    read_faceframe,
    read_sidecar,
    write_faceframe,
    write_sidecar,
)
from morphspace.files.tables import read_loadings_table, write_loadings_table

DATA_SPEC = Path(__file__).parent.parent / "data_spec"
POINTS = np.array([[10.25, 20.0], [30.0, 20.5], [20.0, 35.0]])
OURS = ("clip-folder", "faceframe", "loadings-table")


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
        write_faceframe(path, MarkedFaceframe("frame_0001.png", POINTS, (40, 50)))
    else:
        document = {"model_id": "0f3a", "identity": "actor-07", "frame_rate_hz": 25.0}
        write_loadings_table(path.with_suffix(".csv"), np.array([[0.5, -1.0]]), ["frame_0001"], document)
    return json.loads(path.read_text(encoding="utf-8"))


def read(kind: str, folder: Path) -> object:
    if kind == "clip-folder":
        return read_sidecar(folder / "file.json")
    if kind == "faceframe":
        return read_faceframe(folder / "file.json")
    return read_loadings_table(folder / "file.csv")


@pytest.mark.parametrize("kind", OURS)
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
    ("kind", "entry"), [("faceframe", "left_eye"), ("faceframe", "version"), ("loadings-table", "unit")]
)
def test_a_required_entry_is_missed(kind, entry, tmp_path):
    document = written(kind, tmp_path)
    del document[entry]
    with pytest.raises(jsonschema.ValidationError):
        validator_of(kind).validate(document)
    (tmp_path / "file.json").write_text(json.dumps(document))
    with pytest.raises(BadInput, match=entry):
        read(kind, tmp_path)


@pytest.mark.parametrize("kind", OURS)
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


def test_sidecar_and_faceframe_round_trip(tmp_path):
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


def test_swapped_eyes_and_points_outside_are_refused():
    with pytest.raises(BadInput, match=r"right eye at x 30 and the left eye at x 10.25"):
        MarkedFaceframe("a.png", POINTS[[1, 0, 2]])
    with pytest.raises(BadInput, match="outside its picture of 40 x 35"):
        MarkedFaceframe("a.png", POINTS, (40, 35))
    MarkedFaceframe("a.png", POINTS, (40, 36))
    with pytest.raises(BadInput, match="three finite"):
        MarkedFaceframe("a.png", np.full((3, 2), np.nan))
