"""The stimulus verbs as they are called: exit codes, one line for what is wrong, the same bytes however many work."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from morphspace.cli.main import main
from morphspace.face.regions import REGIONS
from morphspace.io.images import write_image
from morphspace.io.tables import read_loadings_table
from morphspace.model.encode import framed_for
from morphspace.model.loadings import Loadings
from morphspace.model.model import load_model
from morphspace.sets.kept import digest_of_kept, encoded_clip
from morphspace.sets.stimulus import make_stimulus
from morphspace.steps import result_of
from morphspace.verbs import caricature
from morphspace.verbs.caricature import CaricatureRequest
from morphspace.verbs.encode import write_loadings


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def refused(result, *mentioned):
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("morphspace: ") and result.stderr.count("\n") == 1
    for word in mentioned:
        assert word in result.stderr


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    """A folder with a model, a table of its faces, and a clip of pictures of them."""
    folder = tmp_path_factory.mktemp("stimuli")
    framing = {"source_size": [60, 72], "crop": None, "size": [60, 72]}
    replace(model, provenance={**model.provenance, "framing": framing}).save(folder / "a.morph")
    rows = Loadings(model.training.values[:3], model.training.frame_names[:3], model.model_id)
    write_loadings(folder / "t.csv", rows, model, folder / "a.morph", {})
    (folder / "clip").mkdir()
    for name, row in zip(rows.frame_names, rows.values, strict=True):
        write_image(folder / "clip" / f"{name}.png", model.render(row))
    return folder


def test_caricature_of_a_clip_scales_what_encode_finds(folder, tmp_path):
    assert run("encode", folder / "a.morph", folder / "clip", "-o", tmp_path / "e.csv").exit_code == 0
    words = [
        "caricature",
        folder / "a.morph",
        "--clip",
        folder / "clip",
        "--gain=-1,2",
        "-o",
        tmp_path / "out",
    ]
    assert run(*words).exit_code == 0
    encoded = read_loadings_table(tmp_path / "e.csv")
    table = read_loadings_table(tmp_path / "out" / "loadings.csv")
    assert list(table.frame_names) == [f"{name}_g{gain}" for name in encoded.frame_names for gain in (-1, 2)]
    np.testing.assert_array_equal(table.loadings_sd[0::2], -encoded.loadings_sd)
    np.testing.assert_array_equal(table.loadings_sd[1::2], 2 * encoded.loadings_sd)
    sidecar = json.loads((tmp_path / "out" / "frame_001_g2.json").read_text(encoding="utf-8"))
    assert set(sidecar["inputs"]) == {"model", "clip/frame_001"}
    record = json.loads((tmp_path / "out" / "record.json").read_text(encoding="utf-8"))
    assert set(record["inputs"]) == {"model", *(f"clip/frame_00{number}" for number in range(3))}


def test_replay_exits_0_for_the_same_and_3_for_another(folder, tmp_path):
    words = ["caricature", folder / "a.morph", "--loadings", folder / "t.csv", "--gain", "1", "-o", tmp_path]
    assert run(*words).exit_code == 0
    sidecar = tmp_path / "frame_000_g1.json"
    same = run("replay", sidecar, "--model", folder / "a.morph", "-o", tmp_path / "again.png")
    assert same.exit_code == 0 and "byte for byte" in same.stdout
    assert (tmp_path / "again.png").read_bytes() == (tmp_path / "frame_000_g1.png").read_bytes()
    document = json.loads(sidecar.read_text(encoding="utf-8"))
    document["drawing"]["loadings_sd"][0][0] += 0.5
    sidecar.write_text(json.dumps(document), encoding="utf-8")
    other = run("replay", sidecar, "--model", folder / "a.morph", "--json")
    assert other.exit_code == 3
    told = json.loads(other.stdout)
    assert not told["same"] and "largest pixel difference" in told["differences"][0]


def test_render_of_a_video_leaves_its_sidecar_and_replays(folder, tmp_path):
    assert run("render", folder / "a.morph", folder / "t.csv", "-o", tmp_path / "t.mp4").exit_code == 0
    assert run("replay", tmp_path / "t.mp4.json", "--model", folder / "a.morph").exit_code == 0
    (tmp_path / "mine.mp4").write_bytes(b"mine")
    refused(run("render", folder / "a.morph", folder / "t.csv", "-o", tmp_path / "mine.mp4"), "mine.mp4")
    assert (tmp_path / "mine.mp4").read_bytes() == b"mine"


def test_as_many_threads_as_there_are_give_the_same_bytes(folder, tmp_path):
    request = CaricatureRequest(
        folder / "a.morph", tmp_path, folder / "t.csv", gains=(1.5,), video=".mp4", frame_rate_hz=25.0
    )
    planned = result_of(caricature.plan(request))
    made = []
    for workers in (1, 3):
        target = tmp_path / str(workers)
        target.mkdir()
        made.append(
            make_stimulus(planned.model, planned.drawings[0], planned.sidecar_head(), target, workers)
        )
    assert made[0] == made[1]


def test_a_clip_is_encoded_once_and_again_when_a_picture_changes(folder, tmp_path):
    model = load_model(folder / "a.morph")
    for path in (folder / "clip").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())

    write_image(
        tmp_path / "frame_001.png", model.reference * np.float32(0.97)
    )  # a clip no other test encodes

    def steps():
        return list(encoded_clip(model, framed_for(model, (str(tmp_path),), None)))

    assert len(steps()) == 3 and steps() == []
    write_image(tmp_path / "frame_000.png", model.reference * np.float32(0.99))
    assert len(steps()) == 3


def test_a_digest_is_that_of_the_file_as_it_is_now(tmp_path):
    (tmp_path / "a").write_bytes(b"one")
    first = digest_of_kept(tmp_path / "a")
    (tmp_path / "a").write_bytes(b"other")
    assert digest_of_kept(tmp_path / "a") != first


def test_a_broken_sidecar_is_refused(folder, tmp_path):
    words = ["sample", folder / "a.morph", "-n", "1", "-o", tmp_path]
    assert run(*words).exit_code == 0
    sidecar = Path(tmp_path / "sample_0000.json")
    whole = json.loads(sidecar.read_text(encoding="utf-8"))
    for entry, value in (("drawing", {}), ("drawing", None), ("version", 2), ("format", "x"), ("output", 3)):
        sidecar.write_text(json.dumps({**whole, entry: value}), encoding="utf-8")
        refused(run("replay", sidecar, "--model", folder / "a.morph"))


@pytest.mark.parametrize("verb", ["caricature", "measure-mimicry"])
def test_every_verb_knows_the_same_parts_of_a_face(verb):
    help_text = run(verb, "--help").output
    assert all(name in help_text for name in REGIONS if name != "whole")
