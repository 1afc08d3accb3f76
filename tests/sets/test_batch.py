"""batch: what a recipe makes, planned whole, taken up where it was stopped, the same bytes however made."""

from __future__ import annotations

import csv
import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from morphspace.cli.main import main
from morphspace.errors import BadInput, MorphspaceError
from morphspace.io.tables import read_loadings_table, read_metrics_table, write_loadings_table
from morphspace.model.loadings import Loadings
from morphspace.sets import batch, pool
from morphspace.sets.stimulus import make_stimulus
from morphspace.steps import result_of
from morphspace.storage import MARK_NAME
from morphspace.verbs import batch as verb
from morphspace.verbs.batch import BatchRequest
from morphspace.verbs.caricature import CaricatureRequest

ROOT = Path(__file__).resolve().parents[2]
HEAD = "format: morphspace-recipe\nversion: 1\n"
CROSSED = (
    HEAD
    + """\
sources: {ann: ann.morph, bob: bob.morph}
factors:
  identity:
    ann: {loadings: ann.csv}
    bob: {loadings: bob.csv}
  gain: [0.5, 1, -1.5]
stimuli:
  - verb: caricature
    model: "{identity}"
    loadings: "{identity.loadings}"
    gains: "{gain}"
    name: "{identity}/{frame}_g{gain}"
"""
)


@pytest.fixture(scope="session")
def lab(model, tmp_path_factory):
    """A folder with two models, a table of loadings each, and nothing else."""
    folder = tmp_path_factory.mktemp("lab")
    rows = np.random.default_rng(2).standard_normal((4, model.rank))
    for name, brighter in (("ann", 0.0), ("bob", 0.1)):
        digest = f"{brighter:016.3f}".replace(".", "0")
        texture = (model.mean.texture + np.float32(brighter)).astype(np.float32)
        one = model_like(model, name, texture, digest)
        one.save(folder / f"{name}.morph")
        write_loadings_table(folder / f"{name}.csv", rows, [f"f{i}" for i in range(4)], {"model_id": digest})
    return folder


def model_like(model, identity, texture, digest):
    from dataclasses import replace

    from morphspace.model.morph import Morph

    mean = Morph.of(texture, model.mean.displacement, model.mean.reference_id)
    training = Loadings(model.training.values, model.training.frame_names, digest)
    return replace(model, mean=mean, training=training, provenance={**model.provenance, "identity": identity})


def recipe(lab, text, name="recipe.yaml"):
    (lab / name).write_text(text, encoding="utf-8")
    return lab / name


def made(path, output, most=None, **settings):
    if most is None:
        return result_of(verb.run(BatchRequest(path, output, **settings)))
    return result_of(batch.write_batch(result_of(batch.planned_batch(path, output, most=most, **settings))))


def refused(path, output, *mentioned, **settings):
    with pytest.raises(BadInput) as caught:
        made(path, output, **settings)
    words = str(caught.value)
    assert "\n" not in words
    for word in mentioned:
        assert word in words, words
    assert not output.exists() or not any(output.rglob("*.*"))


def tree(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_factors_become_stimuli_with_names_sidecars_and_columns(lab, tmp_path):
    outcome = made(recipe(lab, CROSSED), tmp_path / "out", workers=1)
    names = {
        f"{who}/f{i}_g{gain}" for who in ("ann", "bob") for i in range(4) for gain in ("0.5", "1", "-1.5")
    }
    assert {
        str(p.relative_to(tmp_path / "out").with_suffix("")) for p in (tmp_path / "out").glob("*/*.png")
    } == names
    assert outcome.document["stimuli"] == len(names) == 24
    rows = read_metrics_table(tmp_path / "out" / "manifest.csv")
    assert set(rows["name"]) == names
    assert rows["factor_identity"] == rows["identity"] == ["ann"] * 12 + ["bob"] * 12
    assert rows["gain"] == [0.5] * 4 + [1.0] * 4 + [-1.5] * 4 + [0.5] * 4 + [1.0] * 4 + [-1.5] * 4
    described = json.loads((tmp_path / "out" / "manifest.json").read_text())["variableMeasured"]
    assert {one["name"]: one["description"] for one in described}[
        "factor_identity"
    ] == "Level of the factor identity"
    sidecar = json.loads((tmp_path / "out" / "bob" / "f3_g-1.5.json").read_text())
    assert sidecar["request"]["model"] == "bob.morph" and sidecar["request"]["gains"] == [-1.5]
    table = read_loadings_table(lab / "bob.csv").loadings_sd
    np.testing.assert_array_equal(sidecar["drawing"]["loadings_sd"], -1.5 * table[3:])


def test_record_names_the_recipe_and_every_input_with_its_digest(lab, tmp_path):
    from morphspace.storage import digest_of_file

    path = recipe(lab, CROSSED)
    made(path, tmp_path / "out", workers=1)
    record = json.loads((tmp_path / "out" / "record.json").read_text())
    files = {"recipe recipe.yaml": path, **{f"model {n}.morph": lab / f"{n}.morph" for n in ("ann", "bob")}}
    files |= {f"loadings {n}.csv": lab / f"{n}.csv" for n in ("ann", "bob")}
    assert record["inputs"] == {name: digest_of_file(file) for name, file in files.items()}
    found = {name for name in tree(tmp_path / "out") if name != "record.json"}
    assert set(record["outputs"]) == found
    assert str(lab) not in (tmp_path / "out" / "record.json").read_text()


def test_a_batch_makes_the_same_bytes_with_any_number_of_processes_and_from_anywhere(
    lab, tmp_path, monkeypatch
):
    path = recipe(lab, CROSSED)
    made(path, tmp_path / "one", workers=1)
    monkeypatch.chdir(lab.parent)
    made(Path(lab.name) / "recipe.yaml", tmp_path / "two", workers=2)
    assert tree(tmp_path / "one") == tree(tmp_path / "two")


def test_a_batch_draws_what_the_verb_alone_draws(lab, tmp_path):
    from morphspace.verbs import caricature

    made(recipe(lab, CROSSED), tmp_path / "out", workers=1)
    alone = CaricatureRequest(lab / "ann.morph", tmp_path / "alone", loadings=lab / "ann.csv", gains=(0.5,))
    result_of(caricature.run(alone))
    from morphspace.io.images import read_image

    pair = [read_image(tmp_path / name) for name in ("out/ann/f2_g0.5.png", "alone/f2_g0.5.png")]
    np.testing.assert_array_equal(*pair)


def test_what_is_made_is_kept_and_what_is_missing_or_broken_is_made_again(lab, tmp_path):
    path, out = recipe(lab, CROSSED), tmp_path / "out"
    made(path, out, workers=1)
    whole = tree(out)
    times = {name: (out / name).stat().st_mtime_ns for name in whole if name.endswith(".png")}
    (out / "ann" / "f0_g1.png").unlink()
    (out / "ann" / "f1_g1.json").unlink()
    (out / "bob" / "f0_g1.png").write_bytes((out / "bob" / "f0_g1.png").read_bytes()[:-9])
    (out / "manifest.csv").unlink()
    (out / "bob" / ".f0_g1.morphspace-abcd1234.png").write_bytes(
        b"half"
    )  # as a batch that was killed leaves it
    (out / "bob" / ".mine.png").write_bytes(b"mine")
    made(path, out, workers=1)
    again = tree(out)
    assert again.pop("bob/.mine.png") == b"mine"
    assert again == whole
    broken = {"ann/f0_g1.png", "ann/f1_g1.png", "bob/f0_g1.png"}
    for name, time_ns in times.items():
        assert ((out / name).stat().st_mtime_ns == time_ns) == (name not in broken), name


def test_a_changed_recipe_draws_only_what_changed(lab, tmp_path, monkeypatch):
    out = tmp_path / "out"
    made(recipe(lab, CROSSED), out, workers=1)
    drawn = []
    monkeypatch.setattr(
        pool, "make_stimulus", lambda *words: drawn.append(words[1].name) or make_stimulus(*words)
    )
    before = {path: path.stat().st_mtime_ns for path in out.glob("*/*.png")}
    made(recipe(lab, CROSSED.replace("-1.5]", "-1.5, 2]")), out, workers=1)
    assert len(drawn) == 32
    assert {path: path.stat().st_mtime_ns for path in before} == before
    told = made(recipe(lab, CROSSED), out, workers=1).warnings
    assert any("8 stimuli of another recipe, such as ann/f0_g2" in note for note in told)


def test_a_video_is_the_same_however_many_threads_and_processes_draw_it(lab, tmp_path, monkeypatch):
    text = HEAD + "stimuli: [{verb: render, model: ann.morph, table: ann.csv, video: .mkv, name: film}]"
    trees = []
    for cores in (1, 2):
        monkeypatch.setattr(pool, "core_count", lambda cores=cores: cores)
        made(recipe(lab, text), tmp_path / str(cores), workers=1)
        trees.append(tree(tmp_path / str(cores)))
    assert trees[0] == trees[1] and "film.mkv" in trees[0]


def test_a_table_makes_a_stimulus_a_row(lab, tmp_path):
    rows = [
        ("verb", "model", "loadings", "frames", "gains", "name", "factor:mood"),
        ("caricature", "ann.morph", "ann.csv", "f1", "1.5", "sad", "sad"),
        ("caricature", "bob.morph", "bob.csv", "f2;f0", "", "{frame}_{gain}", "glad"),
    ]
    with (lab / "set.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    made(lab / "set.csv", tmp_path / "out", workers=1)
    names = read_metrics_table(tmp_path / "out" / "manifest.csv")["name"]
    gains = CaricatureRequest(Path(), Path()).gains
    assert names == ["sad", *(f"{frame}_{gain:g}" for frame in ("f2", "f0") for gain in gains)]
    assert read_metrics_table(tmp_path / "out" / "manifest.csv")["mood"] == ["sad"] + ["glad"] * 8


def test_without_a_name_stimuli_are_named_by_their_levels(lab, tmp_path):
    made(
        recipe(lab, CROSSED.replace('    name: "{identity}/{frame}_g{gain}"\n', "")),
        tmp_path / "out",
        workers=1,
    )
    assert (tmp_path / "out" / "identity-ann_gain-0.5" / "f0_g0.5.png").exists()


# what is refused before anything is drawn


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{frame}_g{gain}", "{frame}", ("line 10", "'ann/f0'", "{gain}", "gain 0.5", "gain 1")),
        ("{identity}/{frame}_g{gain}", "{frame}_g{gain}", ("line 10", "identity ann", "identity bob")),
        ("{frame}_g{gain}", "{fram}_g{gain}", ("line 10", "{fram}", "'frame'")),
        ("{identity}/{frame}_g{gain}", "../{identity}{frame}{gain}", ("line 10", "dot")),
        ("{identity}/{frame}_g{gain}", "/{identity}{frame}{gain}", ("line 10",)),
        ("{identity}/{frame}_g{gain}", "{identity}{frame}{gain}?", ("line 10", "?")),
        (
            "bob: {loadings: bob.csv}",
            "bob: {loadings: ann.csv}",
            ("line 10", "identity bob", "belongs to model"),
        ),
        ("bob: {loadings: bob.csv}", "bob: {loadings: gone.csv}", ("line 10", "identity bob", "gone.csv")),
        ("bob: bob.morph", "bob: gone.morph", ("line 3", "'bob'", "gone.morph")),
        ("-1.5]", "x]", ("line 13", "gains", "'x'", "number")),
        ("-1.5]", "2000]", ("line 10", "gain 2000", "1000")),
        ("gains:", "warp_gain:", ("line 13", "'warp_gain'", "'warp_gains'")),
        ("    gains:", "    region: nowhere\n    gains:", ("line 10", "nowhere")),
        (
            '    loadings: "{identity.loadings}"\n',
            '    clip: "{identity.loadings}"\n    loadings: ann.csv\n',
            ("line 10",),
        ),
        ('    model: "{identity}"\n', "", ("line 10", "model of caricature is missing")),
        ("    gains:", "    frames: f9\n    gains:", ("line 10", "f9", "f0")),
        ("    gains:", "    frames: true\n    gains:", ("line 13", "frames", "True")),
    ],
)
def test_a_recipe_that_would_fail_is_refused_before_anything_is_drawn(old, new, words, lab, tmp_path):
    assert old in CROSSED
    refused(recipe(lab, CROSSED.replace(old, new)), tmp_path / "out", "recipe.yaml", *words)


def test_a_value_of_another_kind_is_told_with_one_line_of_the_recipe(lab, tmp_path):
    with pytest.raises(BadInput) as caught:
        made(recipe(lab, CROSSED.replace("-1.5]", "x]")), tmp_path / "out")
    assert str(caught.value).count("recipe.yaml line") == 1


def test_a_million_stimuli_are_asked_for_before_anything_is_opened(lab, tmp_path):
    many = ", ".join(map(str, range(1, 1001)))
    text = HEAD + f"factors: {{identity: [{many}], gain: [{many}]}}\nstimuli:\n"
    text += '  - {verb: caricature, model: gone.morph, loadings: "{identity}", gains: "{gain}"}\n'
    refused(recipe(lab, text), tmp_path / "out", "1,000,000", "--yes")
    refused(recipe(lab, CROSSED), tmp_path / "out", "more than 20", "--yes", most=20)
    alone = HEAD + "stimuli: [{verb: sample, model: ann.morph, count: 1000000000}]"
    refused(recipe(lab, alone), tmp_path / "out", "line 3", "from 1 to 100,000")
    alone = HEAD + "stimuli: [{verb: grid, model: ann.morph, steps: [1000, 1000]}]"
    refused(recipe(lab, alone), tmp_path / "out", "line 3", "--yes", most=999_999)
    assert made(recipe(lab, CROSSED), tmp_path / "out", most=24, workers=1).document["stimuli"] == 24


def test_names_that_differ_in_capitals_alone_collide(lab, tmp_path):
    text = CROSSED.replace("bob: {loadings", "Ann: {loadings").replace(
        "sources: {ann: ann.morph, bob", "sources: {ann: ann.morph, Ann"
    )
    refused(recipe(lab, text), tmp_path / "out", "'Ann/f0_g0.5'", "'ann/f0_g0.5'")


def test_files_of_others_are_never_replaced(lab, tmp_path):
    out = tmp_path / "out"
    (out / "ann").mkdir(parents=True)
    (out / "ann" / "f0_g1.png").write_bytes(b"mine")
    with pytest.raises(BadInput, match=r"f0_g1\.png"):
        made(recipe(lab, CROSSED), out, workers=1)
    assert (out / "ann" / "f0_g1.png").read_bytes() == b"mine"


def test_tables_of_others_are_never_replaced(lab, tmp_path):
    made(recipe(lab, CROSSED), tmp_path / "there", workers=1)
    names = [path.name for path in (tmp_path / "there").glob("loadings_*")]
    assert len(names) == 4  # of two models, each with its document
    for name in names:
        out = tmp_path / Path(name).stem / Path(name).suffix[1:]
        out.mkdir(parents=True)
        (out / name).write_bytes(b"mine")
        with pytest.raises(BadInput, match=f"{name} is a file that no earlier batch wrote"):
            made(recipe(lab, CROSSED), out, workers=1)
        assert tree(out) == {name: b"mine"}
    made(recipe(lab, CROSSED), tmp_path / "there", workers=1)  # its own it takes up


def test_two_batches_do_not_write_into_one_folder_at_once(lab, tmp_path):
    steps = verb.run(BatchRequest(recipe(lab, CROSSED), tmp_path / "out", workers=1))
    while next(steps).stage != "batch":
        pass
    with pytest.raises(BadInput, match="another batch"):
        made(lab / "recipe.yaml", tmp_path / "out", workers=1)
    steps.close()
    made(lab / "recipe.yaml", tmp_path / "out", workers=1)


def test_a_model_that_is_built_anew_during_the_batch_is_noticed(lab, tmp_path, model):
    text = CROSSED.replace("sources: {ann: ann.morph", "sources: {ann: changing.morph")
    (lab / "changing.morph").write_bytes((lab / "ann.morph").read_bytes())
    planned = result_of(batch.planned_batch(recipe(lab, text), tmp_path / "out", workers=1))
    model_like(model, "ann", model.mean.texture, "f" * 16).save(lab / "changing.morph")
    with pytest.raises(BadInput, match=r"changing\.morph was model"):
        result_of(batch.write_batch(planned))


# the command line


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def test_the_plan_is_told_and_nothing_is_made(lab, tmp_path):
    result = run("batch", recipe(lab, CROSSED), "-o", tmp_path / "out", "--plan")
    assert result.exit_code == 0 and not (tmp_path / "out").exists()
    assert (
        "24 pictures, from 2 models" in result.stdout
        and re.search(r"about \d+ (s|min) in", result.stdout)
        and "kB" in result.stdout
    )
    told = json.loads(run("batch", lab / "recipe.yaml", "-o", tmp_path / "out", "--plan", "--json").stdout)
    assert (told["stimuli"], told["frames"], told["folders"]) == (24, 24, 0)
    size = sum(len(data) for name, data in tree_of(lab, tmp_path).items() if "/" in name)
    assert told["bytes"] == pytest.approx(size, rel=0.3)


def test_a_plan_of_more_than_is_made_unasked_is_told(lab, tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "MOST_UNASKED", 20)
    words = ["batch", recipe(lab, CROSSED), "-o", tmp_path / "out"]
    result = run(*words, "--plan")
    assert result.exit_code == 0 and "24 pictures" in result.stdout and "kB" in result.stdout
    assert "more than 20 stimuli. Give --yes to make them" in result.stdout
    assert json.loads(run(*words, "--plan", "--json").stdout)["needs_yes"]
    assert run(*words).exit_code == 2 and not (tmp_path / "out").exists()
    monkeypatch.setattr(batch, "MOST_PLANNED", 22)
    assert "more than 22" in run(*words, "--plan").output


def tree_of(lab, tmp_path):
    made(lab / "recipe.yaml", tmp_path / "whole", workers=1)
    return tree(tmp_path / "whole")


def test_the_plan_is_told_before_the_work_and_not_when_quiet(lab, tmp_path):
    result = run("batch", recipe(lab, CROSSED), "-o", tmp_path / "out", "--workers", 1)
    assert result.exit_code == 0 and "24 pictures" in result.stderr and "index.html" in result.stdout
    assert run("batch", lab / "recipe.yaml", "-o", tmp_path / "out", "--quiet", "--workers", 1).output == ""
    again = run("batch", lab / "recipe.yaml", "-o", tmp_path / "out", "--workers", 1)
    assert "24 of them are in" in again.stderr


# processes


def test_what_fails_in_a_process_is_told_in_one_line_and_ends_the_batch(lab, tmp_path):
    planned = result_of(batch.planned_batch(recipe(lab, CROSSED), tmp_path / "out", workers=2))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "bob").write_bytes(b"a file where a folder belongs")
    with pytest.raises(BadInput, match="cannot write"):
        result_of(batch.write_batch(planned))


def command(path, output):
    words = [sys.executable, "-m", "morphspace", "batch", path, "-o", output, "--workers", "2", "--quiet"]
    return subprocess.Popen(
        [str(word) for word in words],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell starts what runs in its background deaf to Ctrl-C, and the tests may run there.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def waited_for(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    return condition()


def processes_of(session):
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(words[3]) == session and words[0] != "Z":
            found.append(int(path.parent.name))
    return found


MANY = CROSSED.replace("-1.5]", ", ".join(map(str, np.arange(2, 102) / 10)) + "]").replace("[0.5, 1, ", "[")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to see which processes live")
def test_control_c_ends_a_batch_with_one_line_and_whole_files(lab, tmp_path):
    out = tmp_path / "out"
    with command(recipe(lab, MANY), out) as process:
        assert waited_for(lambda: len(list(out.rglob("*.png"))) > 20, 60)
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 130 and told.count("\n") == 1 and "stopped" in told, told
    assert waited_for(lambda: not processes_of(process.pid), 20), "processes outlive their batch"
    # Nothing unfinished stays; the mark does, by which the next run knows its own files.
    assert [path.name for path in out.rglob(".*") if path.is_file()] == [MARK_NAME]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to see which processes live")
def test_control_c_while_the_processes_start_ends_in_one_line(lab, tmp_path):
    with command(recipe(lab, MANY), tmp_path / "out") as process:
        assert waited_for(
            lambda: len(processes_of(process.pid)) == 4, 60
        )  # its own, the tracker's, and two workers
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=60)
    assert process.returncode == 130 and told.count("\n") == 1 and "stopped" in told, told


THOUSAND = (
    MANY
    + """\
  - {verb: caricature, model: ann, loadings: ann.csv, gains: "{gain}", components: "1", name: "one/{frame}_{gain}"}
  - {verb: sample, model: bob, count: 10, seed: 3, name: "any/{draw}"}
"""
)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc to see which processes live")
def test_a_batch_of_a_thousand_that_is_killed_goes_on_to_identical_bytes(lab, tmp_path):
    path, out = recipe(lab, THOUSAND), tmp_path / "killed"
    made(path, tmp_path / "whole", workers=1)
    whole = tree(tmp_path / "whole")
    total = sum(name.endswith(".png") for name in whole)
    assert total >= 1000
    with command(path, out) as process:
        goal = random.SystemRandom().randrange(1, total)
        assert waited_for(lambda: len(list(out.rglob("*.png"))) >= goal, 120)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert waited_for(lambda: not processes_of(process.pid), 20), "processes outlive their batch"
    done = {
        side.with_suffix(".png")
        for side in out.rglob("*.json")
        if side.stem not in ("manifest", "loadings", "record") and not side.name.startswith(".")
    }
    times = {picture: picture.stat().st_mtime_ns for picture in done}
    with command(path, out) as process:
        assert process.wait(timeout=300) == 0, process.stderr.read()
    assert tree(out) == whole, f"killed at {goal} pictures"
    for picture, time_ns in times.items():
        assert picture.stat().st_mtime_ns == time_ns, (
            f"{picture.name} was made again, killed at {goal} pictures"
        )


@pytest.mark.slow
def test_a_process_that_is_ended_from_outside_is_told_in_one_line(lab, tmp_path):
    planned = result_of(batch.planned_batch(recipe(lab, MANY), tmp_path / "out", workers=2))
    steps = batch.write_batch(planned)
    next(steps)
    children = [child for child in pool.multiprocessing.active_children() if child.is_alive()]
    os.kill(children[0].pid, signal.SIGKILL)
    with pytest.raises(MorphspaceError, match="ended from outside"):
        result_of(steps)
