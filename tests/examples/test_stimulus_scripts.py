"""The scripts that a lab can copy: each runs on small drawn models; the adaptive search finds what is hidden."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.io.tables import read_metrics_table
from morphspace.io.video import read_frames, video_info
from morphspace.model.loadings import Loadings
from morphspace.model.morph import Morph
from morphspace.sets import batch
from morphspace.sets.folders import Stopped, fill_folder
from morphspace.steps import result_of

SCRIPTS = Path(__file__).parents[2] / "examples"
TRUE_PRECISION = 4.0
NAMES = ("adaptive_search", "avatar_motion", "caricature_series", "mimic_by_all")


@pytest.fixture(scope="module", autouse=True)
def scripts():
    """The scripts as modules, found where they lie."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        yield {name: __import__(name) for name in NAMES}


@pytest.fixture(scope="module")
def actors(model, tmp_path_factory):
    """Three drawn models with keypoints, as files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHSPACE_MODELS", str(tmp_path_factory.mktemp("none")))
        folder = tmp_path_factory.mktemp("actors")
        for number, name in enumerate(("ann", "bob", "cat")):
            texture = (model.mean.texture + np.float32(0.03 * number)).astype(np.float32)
            mean = Morph.of(texture, model.mean.displacement, model.mean.reference_id)
            training = Loadings(model.training.values, model.training.frame_names, f"{number:016d}")
            one = replace(
                model, mean=mean, training=training, provenance={**model.provenance, "identity": name}
            )
            frame = FaceFrame((20.0 + number, 28.0), (40.0 - number, 28.0), (30.0, 44.0))
            one.with_faceframe(frame).save(folder / f"{name}.morph")
        yield folder


def paths(folder, *names):
    return [str(folder / f"{name}.morph") for name in names]


@pytest.mark.parametrize("name", NAMES)
def test_a_script_tells_how_it_is_used_and_refuses_in_one_line(name, scripts, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        scripts[name].main(["--help"])
    assert ended.value.code == 0 and "python examples/" in capsys.readouterr().out
    gone = str(tmp_path / "gone.morph")
    words = {
        "adaptive_search": [gone],
        "avatar_motion": [gone, gone, "--driver", gone],
        "mimic_by_all": [gone, gone],
    }
    assert scripts[name].main([*words.get(name, [gone]), "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "gone.morph" in told


def test_a_caricature_series_has_the_same_gains_for_everybody(scripts, actors, tmp_path, capsys):
    words = [
        *paths(actors, "ann", "bob"),
        "-o",
        str(tmp_path / "out"),
        "--gains=-1,1",
        "--faces",
        "2",
        "--workers",
        "1",
    ]
    assert scripts["caricature_series"].main(words) == 0, capsys.readouterr().err
    rows = read_metrics_table(tmp_path / "out" / "stimuli" / "manifest.csv")
    assert rows["person"] == ["ann"] * 4 + ["bob"] * 4 and rows["gain"] == [-1, -1, 1, 1] * 2
    assert scripts["caricature_series"].most_different(np.array([[0, 1], [5, 0], [5, 0.1], [-3, 0]]), 2) == [
        2,
        3,
    ]


def test_all_actors_show_the_drivers_motion_frame_by_frame(scripts, actors, tmp_path, capsys):
    words = [
        *paths(actors, "ann", "bob", "cat"),
        "-o",
        str(tmp_path / "out"),
        "--workers",
        "1",
        "--video",
        ".mkv",
    ]
    assert scripts["mimic_by_all"].main([*words, "--method", "map", "--gain", "1"]) == 0, (
        capsys.readouterr().err
    )
    videos = tmp_path / "out" / "videos"
    rows = read_metrics_table(videos / "manifest.csv")
    assert rows["actor"] == ["bob", "cat"] and rows["frames"] == [12, 12]
    pages = [tmp_path / "out" / "mimicry" / name for name in ("bob", "cat")]
    for page, video in zip(pages, ("bob.mkv", "cat.mkv"), strict=True):
        from morphspace.io.images import read_image

        frames = sorted((page / "frames").glob("*.png"))
        for shown, path in zip(read_frames(videos / video), frames, strict=True):
            np.testing.assert_allclose(shown, read_image(path), atol=0.51 / 255)
        assert json.loads((page / "batch.json").read_text())["verb"] == "mimic"
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.png")}
    assert scripts["mimic_by_all"].main([*words, "--method", "map", "--gain", "1"]) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before, "work was repeated"


def test_a_folder_whose_filling_was_stopped_is_filled_again(actors, tmp_path):
    text = (
        "format: morphspace-recipe\nversion: 1\nstimuli:\n"
        "  - {verb: mimic, source: ann.morph, target: bob.morph, method: map, name: copied}\n"
    )
    (actors / "copy.yaml").write_text(text, encoding="utf-8")
    planned = result_of(batch.planned_batch(actors / "copy.yaml", tmp_path / "out", workers=1))
    (job,) = planned.planned.folders
    with pytest.raises(Stopped, match="copied"):
        fill_folder(job, tmp_path / "out", lambda: True)
    assert not (tmp_path / "out" / "copied" / "batch.json").exists()
    outcome = result_of(batch.write_batch(planned))
    assert outcome.document["folders"] == 1
    rows = read_metrics_table(tmp_path / "out" / "folders.csv")
    assert rows["name"] == ["copied"] and rows["verb"] == ["mimic"] and rows["files"][0] > 12
    record = json.loads((tmp_path / "out" / "record.json").read_text())
    assert set(record["inputs"]) == {"recipe copy.yaml"} and set(record["outputs"]) == {"folders.csv"}
    broken = next((tmp_path / "out" / "copied" / "frames").glob("*.png"))
    whole = broken.read_bytes()
    broken.write_bytes(whole[:-5])
    result_of(batch.write_batch(planned))
    assert broken.read_bytes() == whole
    clash = text + "  - {verb: sample, model: ann.morph, count: 1, name: copied/more}\n"
    (actors / "clash.yaml").write_text(clash, encoding="utf-8")
    with pytest.raises(BadInput, match=r"line 5.*inside a folder that mimic fills"):
        result_of(batch.planned_batch(actors / "clash.yaml", tmp_path / "other"))


@pytest.mark.slow
def test_avatars_between_two_people_show_one_motion(scripts, actors, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "none"))
    words = [
        *paths(actors, "ann", "bob"),
        "--driver",
        *paths(actors, "cat"),
        "-o",
        str(tmp_path / "out"),
        "--workers",
        "1",
    ]
    words += ["--weights", "1,3", "1,1", "--expressions", "4", "--flow", "dis", "--components", "3"]
    assert scripts["avatar_motion"].main(words) == 0, capsys.readouterr().err
    rows = read_metrics_table(tmp_path / "out" / "videos" / "manifest.csv")
    assert rows["avatar"] == rows["identity"] == ["ann-25_bob-75", "ann-50_bob-50"]
    rates = {video_info(path).frame_count for path in (tmp_path / "out" / "videos").glob("*.mp4")}
    assert rates == {12}


# the adaptive search


def test_the_search_finds_a_hidden_face(scripts):
    search = scripts["adaptive_search"]
    runs = [search.simulated_distances(search.Search(4, 5, seed), 18, 0.1, seed) for seed in range(3)]
    start, end = np.median(runs, axis=0)[[0, 18]]
    assert start > 0.6 and end < 0.35 * start  # rms SD; the noise is 0.1


def test_an_observer_who_guesses_does_not_lead_the_search_anywhere_for_sure(scripts):
    search = scripts["adaptive_search"].Search(4, 5, 0)
    rng = np.random.default_rng(3)
    for _ in range(25):
        search.add(search.next_faces(), int(rng.integers(5)))
    assert search.uncertainty() > 0.6  # of 1 SD before any choice: nothing was learned


def test_the_posterior_is_that_of_the_conditional_logit(scripts):
    module = scripts["adaptive_search"]
    search = module.Search(1, 3, 0)
    rng = np.random.default_rng(1)
    for _ in range(30):
        faces = rng.standard_normal((3, 1))
        noise = rng.gumbel(size=3)  # what makes a choice a logit
        search.add(faces, int((-0.5 * TRUE_PRECISION * (faces[:, 0] - 0.7) ** 2 + noise).argmax()))
    grid = np.linspace(-6, 6, 24001)
    step = grid[1] - grid[0]
    evidence, means = [], []
    for precision in module.PRECISIONS:
        log = -0.5 * grid**2 - 0.5 * np.log(2 * np.pi)
        for faces, choice in zip(search.sets, search.choices, strict=True):
            worth = -0.5 * precision * (faces - grid) ** 2
            log += worth[choice] - np.log(np.exp(worth - worth.max(axis=0)).sum(axis=0)) - worth.max(axis=0)
        density = np.exp(log)
        evidence.append(density.sum() * step)
        means.append((grid * density).sum() / density.sum())
    weights = np.array(evidence) / np.sum(evidence)
    np.testing.assert_allclose(search.weights, weights, atol=0.03)  # Laplace's error, of probabilities
    np.testing.assert_allclose(search.estimate(), weights @ means, atol=0.05)  # SD


def test_a_session_goes_on_from_the_choices_and_can_be_asked_again(scripts, actors, tmp_path, capsys):
    main, out = scripts["adaptive_search"].main, tmp_path / "session"
    words = [*paths(actors, "ann"), "-o", str(out), "-k", "2", "--shown", "3"]
    for more in ([], ["--picked", "2"], []):
        assert main([*words, *more]) == 0, capsys.readouterr().err
    state = json.loads((out / "search.json").read_text())
    assert [trial["picked"] for trial in state["trials"]] == [2, None]
    assert sorted(path.stem for path in (out / "trial_002").glob("*.png")) == ["face_1", "face_2", "face_3"]
    assert main([*words, "--picked", "4"]) == 2 and "1 to 3" in capsys.readouterr().err
    assert (
        main([*paths(actors, "bob"), "-o", str(out)]) == 2
        and "is a search with model" in capsys.readouterr().err
    )
    (out / "search.json").write_text("{")
    assert main(words) == 2 and "search.json" in capsys.readouterr().err


@pytest.mark.slow
def test_a_script_that_draws_in_processes_can_be_run_as_a_program(actors, tmp_path):
    words = [
        *paths(actors, "ann"),
        "-o",
        str(tmp_path / "out"),
        "--gains=1",
        "--faces",
        "2",
        "--workers",
        "2",
    ]
    done = subprocess.run(
        [sys.executable, str(SCRIPTS / "caricature_series.py"), *words],
        cwd=SCRIPTS.parent,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(SCRIPTS.parent)},
    )
    assert done.returncode == 0 and "2 stimuli of ann" in done.stdout, done.stderr
