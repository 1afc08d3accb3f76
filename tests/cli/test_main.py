"""The command line: every verb on a small drawn clip, and every bad input it must survive."""

from __future__ import annotations

import importlib.abc
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner, Result

from morphspace import __main__ as entry
from morphspace.cli.main import main
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.io.images import read_image, write_image
from morphspace.io.tables import read_loadings_table, read_metrics_table
from morphspace.model.model import load_model
from morphspace.requests import all_verbs, fields_of, verb_names
from morphspace.settings import WrongSetting, converted
from morphspace.synthetic import make_actors

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {"cv2", "scipy", "skimage", "torch", "OpenImageIO", "av", "numpy", "tqdm"}
FAST = ["--flow", "fast", "--warp-weight", "0.02"]


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


def refused(result: Result, *mentioned: str) -> None:
    """One clear line on the error stream, exit 2, and each thing it must name."""
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("morphspace: "), result.stderr
    assert result.stderr.count("\n") == 1
    for word in mentioned:
        assert word in result.stderr


@pytest.fixture(scope="module", autouse=True)
def without_networks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What a build writes must not depend on whether this machine has the networks that find faces."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MORPHSPACE_MODELS", str(tmp_path_factory.mktemp("none")))
        yield


@pytest.fixture(scope="module")
def actor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drawn clip of eight frames, 64 x 80."""
    folder = tmp_path_factory.mktemp("actors")
    for _ in make_actors(folder, identities=1, frames=8, seed=3, size=(64, 80)):
        pass
    return folder / "actor_01"


@pytest.fixture(scope="module")
def model(actor: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "a.morph"
    result = run("build-model", actor, "-o", path, *FAST)
    assert result.exit_code == 0, result.output
    return path


def test_a_build_without_the_networks_says_once_how_to_get_better(actor, tmp_path):
    result = run("build-model", actor, "-o", tmp_path / "a.morph", *FAST)
    assert result.exit_code == 0
    assert result.stderr.count("morphspace models fetch") == 1
    told = run("build-model", actor, "-o", tmp_path / "b.morph", "--landmarks", "none", *FAST)
    assert told.exit_code == 0 and "models fetch" not in told.stderr
    models = [load_model(tmp_path / name) for name in ("a.morph", "b.morph")]
    assert [one.provenance["landmarks"] for one in models] == [None, None]
    assert models[0].model_id == models[1].model_id
    assert "not searched" in (tmp_path / "a.html").read_text()


def test_a_crop_that_needs_the_networks_is_refused_with_the_command_that_brings_them(actor, tmp_path):
    result = run("build-model", actor, "-o", tmp_path / "a.morph", "--crop", "auto", *FAST)
    refused(result, "morphspace models fetch")
    assert not list(tmp_path.iterdir())
    refused(run("build-model", actor, "--crop", "around"), "around", "auto")


def test_help_of_every_verb_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from morphspace.cli.main import main\n"
        "for words in [['--help'], *[[name, '--help'] for name in main.list_commands(None)]]:\n"
        "    try:\n        main(words)\n"
        "    except SystemExit as end:\n        assert end.code == 0, words\n"
        f"print('HEAVY', sorted({HEAVY!r} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert "HEAVY []" in done.stdout


def test_every_verb_has_help_and_its_settings_too():
    context = click.Context(main)
    names = [name.partition(" ")[0] for name in verb_names()]
    assert set(main.list_commands(context)) <= set(names)
    for verb in all_verbs():
        if verb.name in (*main.commands, "fetch-models"):
            continue
        assert verb.help and all(field.help for field in fields_of(verb.request)), verb.name
        assert not verb.help.startswith(f"{verb.request.__name__}("), verb.name  # the dataclass' own


def test_the_whole_path_on_a_drawn_clip(actor: Path, model: Path, tmp_path: Path):
    assert model.with_suffix(".html").stat().st_size > 10_000
    assert not model.with_name("a.morph.work").exists()
    told = json.loads(run("info", model, "--json").stdout)
    assert told["identity"] == "actor_01" and told["size"] == [64, 80]
    assert told["faceframe"] is not None and told["provenance"]["licence"] == "CC0-1.0"

    table = tmp_path / "a.csv"
    assert run("encode", model, actor, "-o", table).exit_code == 0
    loadings = read_loadings_table(table)
    assert loadings.loadings_sd.shape == (8, told["components"])
    assert loadings.document is not None and loadings.document["model_id"] == told["model_id"]

    assert run("render", model, table, "-o", tmp_path / "images").exit_code == 0
    first = read_image(tmp_path / "images" / "frame_0000.png")
    expected = load_model(model).render(loadings.loadings_sd[0] * load_model(model).sd)
    assert np.abs(first - np.clip(expected, 0, 1)).max() <= 0.51 / 255  # the rounding of an 8-bit file

    assert run("render", model, table, "-o", tmp_path / "film.mkv").exit_code == 0
    assert run("reconstruct", model, actor, "-o", tmp_path / "back", "-k", 3).exit_code == 0
    metrics = read_metrics_table(tmp_path / "back" / "metrics.csv")
    assert metrics["frame"] == list(loadings.frame_names)
    assert min(metrics["psnr_db"]) > 25  # dB; the mean face alone gives 20 to 25 on these frames
    assert read_image(tmp_path / "back" / "placed" / "frame_0003.png").shape == (80, 64, 3)
    assert run("render", model, tmp_path / "back" / "loadings.csv", "-o", tmp_path / "again").exit_code == 0

    assert run("sample", model, "-o", tmp_path / "random", "-n", 3, "--seed", 7).exit_code == 0
    assert run("sweep", model, "-o", tmp_path / "sweep", "-k", 1, "--steps", 3).exit_code == 0
    assert read_image(tmp_path / "sweep" / "pc001_+3sd.png").shape == (80, 64, 3)
    record = json.loads((tmp_path / "random" / "record.json").read_text(encoding="utf-8"))
    assert record["settings"]["seed"] == 7 and "sample_0000.png" in record["outputs"]


def test_the_same_build_gives_the_same_bytes(actor: Path, model: Path, tmp_path: Path):
    again = tmp_path / "a.morph"
    assert run("build-model", actor, "-o", again, *FAST).exit_code == 0
    assert again.read_bytes() == model.read_bytes()
    assert again.with_suffix(".html").read_bytes() == model.with_suffix(".html").read_bytes()


def test_size_covers_and_crops_to_the_middle_and_says_so(actor: Path, tmp_path: Path):
    result = run("build-model", actor, "-o", tmp_path / "a.morph", "--size", "48x48", *FAST)
    assert result.exit_code == 0
    assert "scaled to 48x60 and cropped to the middle 48x48" in result.stderr
    assert load_model(tmp_path / "a.morph").size == (48, 48)


def test_more_components_than_a_model_has_uses_all_of_them_with_a_note(
    actor: Path, model: Path, tmp_path: Path
):
    result = run("reconstruct", model, actor, "-o", tmp_path / "back", "-k", "99")
    assert result.exit_code == 0 and "99 components were requested" in result.stderr
    assert f"from {load_model(model).rank} components" in result.stdout


def test_info_names_the_keypoints_or_says_how_to_mark_them(model: Path, tmp_path: Path):
    marked = tmp_path / "m.morph"
    load_model(model).with_faceframe(FaceFrame((20.0, 28.06), (40.0, 28.0), (30.0, 44.0))).save(marked)
    (line,) = (line for line in run("info", marked).stdout.splitlines() if line.startswith("faceframe"))
    assert (
        line == "faceframe  right eye 20.0,28.1, left eye 40.0,28.0, philtrum 30.0,44.0 (px of the mean face)"
    )
    load_model(marked).with_faceframe(None).save(tmp_path / "n.morph")
    assert (
        "not marked. Mark it with `morphspace keypoints MODEL --auto`"
        in run("info", tmp_path / "n.morph").stdout
    )


def test_render_refuses_a_table_of_another_model(actor: Path, model: Path, tmp_path: Path):
    other = tmp_path / "b.morph"
    assert run("build-model", actor, "-o", other, "--flow", "fast", "--warp-weight", "0.05").exit_code == 0
    assert run("encode", other, actor, "-o", tmp_path / "b.csv").exit_code == 0
    refused(
        run("render", model, tmp_path / "b.csv", "-o", tmp_path / "out"),
        "belongs to model",
        load_model(model).model_id,
    )
    assert not (tmp_path / "out").exists()


def copied(actor: Path, folder: Path, frames: int = 8) -> Path:
    folder.mkdir()
    for path in sorted(actor.glob("*.png"))[:frames]:
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


@pytest.mark.parametrize("content", [b"", b"not a picture", "truncated"], ids=["empty", "text", "truncated"])
def test_an_unreadable_image_is_named(actor: Path, tmp_path: Path, content: bytes | str):
    clip = copied(actor, tmp_path / "clip")
    bad = clip / "frame_0004.png"
    bad.write_bytes(bad.read_bytes()[:-500] if isinstance(content, str) else content)
    refused(run("build-model", clip, "-o", tmp_path / "a.morph", *FAST), "frame_0004.png")
    assert not (tmp_path / "a.morph").exists() and not (tmp_path / "a.html").exists()


def test_sizes_that_differ_are_listed(actor: Path, tmp_path: Path):
    clip = copied(actor, tmp_path / "clip")
    write_image(clip / "frame_0099.png", np.zeros((40, 30, 3), np.float32))
    refused(run("build-model", clip, "-o", tmp_path / "a.morph", *FAST), "64 x 80: 8", "30 x 40: 1")


def test_two_frames_are_too_few(actor: Path, tmp_path: Path):
    clip = copied(actor, tmp_path / "clip", 2)
    refused(run("build-model", clip, "-o", tmp_path / "a.morph", *FAST), "frames is 2", "3")


def test_a_clip_without_motion_gives_rank_0_and_its_mean_renders(actor: Path, tmp_path: Path):
    clip = tmp_path / "still"
    clip.mkdir()
    for index in range(4):
        (clip / f"{index}.png").write_bytes((actor / "frame_0000.png").read_bytes())
    result = run("build-model", clip, "-o", tmp_path / "a.morph", "--flow", "fast")
    assert result.exit_code == 0
    assert "rank 0" in result.stderr and "identical to the reference" in result.stderr
    still = load_model(tmp_path / "a.morph")
    assert still.rank == 0
    assert np.abs(still.render(np.zeros(0)) - read_image(actor / "frame_0000.png")).max() < 1e-5  # float32
    refused(run("sweep", tmp_path / "a.morph", "-o", tmp_path / "sweep"), "rank 0")
    assert run("encode", tmp_path / "a.morph", clip, "-o", tmp_path / "a.csv").exit_code == 0
    assert run("info", tmp_path / "a.morph").exit_code == 0


def test_nan_in_an_exr_is_named(actor: Path, tmp_path: Path):
    clip = copied(actor, tmp_path / "clip", 0)
    for index in range(4):
        write_image(clip / f"f{index}.exr", read_image(actor / f"frame_000{index}.png"))
    image = read_image(actor / "frame_0004.png")
    with pytest.raises(Exception, match="finite"):
        write_image(clip / "f9.exr", np.where(image > 0.5, np.nan, image).astype(np.float32))


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        lambda data: data[:5],
        lambda data: b"",
        lambda data: np.random.default_rng(0).bytes(4000),
        lambda data: data + b"more",
        lambda data: re.sub(rb'\\"version\\": 1\b', b'\\\\"version\\\\": 7', data),
        lambda data: data.replace(b'"shape": [', b'"shape":[1', 1),
    ],
    ids=["half", "five bytes", "empty", "random", "longer", "future", "shape"],
)
def test_a_damaged_model_is_refused(model: Path, tmp_path: Path, damage):
    bad = tmp_path / "bad.morph"
    data = model.read_bytes()
    assert damage(data) != data
    bad.write_bytes(damage(data))
    for words in (["info", bad], ["sample", bad, "-o", tmp_path / "out"]):
        refused(run(*words), "bad.morph")
    assert not (tmp_path / "out").exists()


def test_info_notices_a_changed_number(model: Path, tmp_path: Path):
    bad = tmp_path / "bad.morph"
    data = bytearray(model.read_bytes())
    components = load_model(model).basis.components
    place = data.index(np.ascontiguousarray(components[0, 5000:5008]).tobytes())
    data[place] ^= 1
    bad.write_bytes(data)
    refused(run("info", bad), "changed after it was written")


@pytest.mark.parametrize(
    ("words", "mentioned"),
    [
        (["build-model", "nowhere", "-o", "OUT/a.morph"], ["nowhere"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "--reference", "frame_0077.png"], ["frame_0077.png"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "--crop", "10,10,100,20"], ["10,10,100,20", "64x80"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "--size", "8x8"], ["8x8"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "-k", "0"], ["--components", "0"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "--warp-weight", "-1"], ["-1"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "--warp-weight", "nan"], ["nan"]),
        (["build-model", "CLIP", "-o", "OUT/a.morph", "--mask", "nowhere.png"], ["nowhere.png"]),
        (["info", "nowhere.morph"], ["nowhere.morph"]),
        (["encode", "MODEL", "nowhere", "-o", "OUT/a.csv"], ["nowhere"]),
        (["render", "MODEL", "nowhere.csv", "-o", "OUT/images"], ["nowhere.csv"]),
        (["reconstruct", "MODEL", "CLIP", "-o", "OUT/back", "-k", "0"], ["--components is 0", "from 1 up"]),
        (["sample", "MODEL", "-o", "OUT/s", "-n", "0"], ["--count", "0"]),
        (["sample", "MODEL", "-o", "OUT/s", "--seed", "-1"], ["-1"]),
        (["sweep", "MODEL", "-o", "OUT/s", "--steps", "1"], ["--steps", "1"]),
        (["make-actors", "-o", "OUT/s", "--identities", "0"], ["0 identities"]),
    ],
)
def test_bad_words_get_one_line(
    actor: Path, model: Path, tmp_path: Path, words: list[str], mentioned: list[str]
):
    places = {"CLIP": str(actor), "MODEL": str(model)}
    out = tmp_path / "out"
    result = run(*(places.get(word, word.replace("OUT", str(out))) for word in words))
    refused(result, *mentioned)
    left = [path for path in out.rglob("*") if path.is_file()] if out.exists() else []
    assert left == []


def test_an_output_folder_that_refuses_is_named(model: Path, tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    refused(run("sample", model, "-o", tmp_path / "file" / "out"), "file")
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_full_disk_leaves_the_old_model_and_its_report(actor: Path, model: Path, tmp_path: Path):
    out = tmp_path / "a.morph"
    out.write_bytes(b"the old model")
    limit = model.stat().st_size // 2

    def little_room() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    words = [sys.executable, "-m", "morphspace", "build-model", str(actor), "-o", str(out), *FAST]
    done = subprocess.run(
        words, capture_output=True, text=True, cwd=ROOT, preexec_fn=little_room, check=False
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("morphspace: ") and done.stderr.count("\n") == 1
    assert out.read_bytes() == b"the old model"
    assert not [path for path in tmp_path.iterdir() if path.is_file() and path != out]


@pytest.mark.slow
def test_a_stopped_build_goes_on_and_gives_the_same_bytes(tmp_path: Path):
    for _ in make_actors(tmp_path, identities=1, frames=30, seed=3, size=(128, 160)):
        pass
    clip, out, work = tmp_path / "actor_01", tmp_path / "a.morph", tmp_path / "work"
    words = [
        sys.executable,
        "-m",
        "morphspace",
        "build-model",
        str(clip),
        "-o",
        str(out),
        "--work-dir",
        str(work),
    ]
    started = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    patience = time.monotonic() + 60  # s; far more than the first frames need, so that a hang ends
    while len(list(work.glob("*.kept"))) < 5 and time.monotonic() < patience:
        time.sleep(0.02)
    started.send_signal(signal.SIGTERM)  # ends it as Ctrl-C does, and no shell ignores it for its jobs
    _, told = started.communicate()
    assert started.returncode == 130, told
    assert told.strip().splitlines()[-1].startswith("morphspace: stopped")
    kept = {path: path.stat().st_mtime_ns for path in work.glob("*.kept")}
    assert 5 <= len(kept) < 30 and not out.exists()
    assert run(*words[3:]).exit_code == 0
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    fresh = tmp_path / "fresh.morph"
    assert run("build-model", clip, "-o", fresh).exit_code == 0
    assert fresh.read_bytes() == out.read_bytes()


def test_debug_shows_where_it_failed():
    result = run("info", "nowhere.morph", "--debug")
    assert result.exit_code != 0 and result.exception is not None
    assert os.fspath("nowhere.morph") in str(result.exception)


def test_frames_with_dots_in_their_names_keep_apart(actor: Path, model: Path, tmp_path: Path):
    clip = tmp_path / "dots"
    clip.mkdir()
    for index in range(4):
        (clip / f"anna.take{index:02d}.png").write_bytes((actor / f"frame_000{index}.png").read_bytes())
    assert run("reconstruct", model, clip, "-o", tmp_path / "back").exit_code == 0
    names = [f"anna.take{index:02d}.png" for index in range(4)]
    assert sorted(path.name for path in (tmp_path / "back" / "placed").iterdir()) == names
    assert run("render", model, tmp_path / "back" / "loadings.csv", "-o", tmp_path / "again").exit_code == 0
    assert sorted(path.name for path in (tmp_path / "again").glob("*.png")) == names


def test_an_output_never_replaces_an_input(actor: Path, model: Path, tmp_path: Path):
    clip = copied(actor, tmp_path / "clip")
    (clip / "clip.json").write_bytes((actor / "clip.json").read_bytes())
    before = {path.name: path.read_bytes() for path in clip.iterdir()}
    for words in (
        ["build-model", clip, "-o", clip / "frame_0002.png", *FAST],
        ["build-model", clip, "-o", tmp_path / "a.html", *FAST],
        ["build-model", clip, "-o", tmp_path / "a.morph", "--report", tmp_path / "a.morph", *FAST],
        ["build-model", clip, "-o", tmp_path / "a.morph", "--report", clip / "frame_0003.png", *FAST],
        ["encode", model, clip, "-o", clip / "clip.csv"],
        ["encode", model, clip, "-o", tmp_path / "table"],
        ["render", model, tmp_path / "t.csv", "-o", tmp_path / "x.gif"],
    ):
        assert run(*words).exit_code == 2, words
    assert {path.name: path.read_bytes() for path in clip.iterdir()} == before


def test_a_truncated_model_is_whole_when_it_is_saved(model: Path, tmp_path: Path):
    small = load_model(model).truncate(2)
    small.save(tmp_path / "small.morph")
    assert run("info", tmp_path / "small.morph").exit_code == 0


def test_a_table_may_lose_rows_and_gain_them(actor: Path, model: Path, tmp_path: Path):
    table = tmp_path / "a.csv"
    assert run("encode", model, actor, "-o", table).exit_code == 0
    lines = table.read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join([*lines[:4], lines[5].replace("frame_0004", "new")]) + "\n", encoding="utf-8")
    assert run("render", model, table, "-o", tmp_path / "out").exit_code == 0
    assert (tmp_path / "out" / "new.png").exists() and len(list((tmp_path / "out").glob("*.png"))) == 4


def test_loadings_beyond_reason_are_refused_before_anything_is_drawn(
    actor: Path, model: Path, tmp_path: Path
):
    table = tmp_path / "a.csv"
    assert run("encode", model, actor, "-o", table).exit_code == 0
    refused(run("render", model, table, "-o", tmp_path / "out", "--gain", "1e9"), "SD", "a.csv")
    assert list((tmp_path / "out").glob("*")) == [] if (tmp_path / "out").exists() else True


def test_a_video_has_its_record_beside_it(actor: Path, model: Path, tmp_path: Path):
    assert run("encode", model, actor, "-o", tmp_path / "a.csv").exit_code == 0
    assert run("render", model, tmp_path / "a.csv", "-o", tmp_path / "a.mp4").exit_code == 0
    record = json.loads((tmp_path / "a.mp4.record.json").read_text(encoding="utf-8"))
    assert record["verb"] == "render" and list(record["outputs"]) == ["a.mp4", "a.mp4.json"]


@pytest.mark.parametrize(
    "points", [[[-900, 20], [-880, 20], [-890, 40]], [[30, 30], [30.0001, 30], [30, 40]]]
)
def test_a_faceframe_that_places_no_face_is_refused(actor: Path, tmp_path: Path, points: list[list[float]]):
    clip = copied(actor, tmp_path / "clip")
    sidecar = json.loads((actor / "clip.json").read_text(encoding="utf-8"))
    sidecar["faceframe"].update(zip(("right_eye", "left_eye", "philtrum"), points, strict=True))
    (clip / "clip.json").write_text(json.dumps(sidecar), encoding="utf-8")
    refused(run("build-model", clip, "-o", tmp_path / "a.morph", *FAST), "faceframe")


def test_an_image_that_is_not_finite_is_refused(model: Path):
    opened = load_model(model)
    with pytest.raises(BadInput, match="not finite"):
        opened.encode(np.full_like(opened.reference, np.nan))
    with pytest.raises(BadInput, match="uint8"):
        opened.encode(np.zeros(opened.reference.shape, np.uint8))


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (("info", "nowhere.morph"), "ModelFileError"),
        (("info",), "Usage"),
        (("render", "a", "b", "-o", "c", "--gain", "x"), "Usage"),
        (("nonsense",), "Usage"),
    ],
)
def test_a_failure_is_json_too_for_a_machine(words, kind):
    plain, told = run(*words), run(*words, "--json")
    assert plain.exit_code == told.exit_code and plain.stderr == told.stderr and plain.stdout == ""
    error = json.loads(told.stdout)["error"]
    assert error["exit_code"] == told.exit_code and error["kind"] == kind
    assert told.stderr == f"morphspace: {error['message']}\n"


def test_a_fault_of_ours_is_json_too(monkeypatch):
    from morphspace.verbs import info

    monkeypatch.setattr(info, "run", lambda request: 1 / 0)
    result = run("info", "a.morph", "--json")
    error = json.loads(result.stdout)["error"]
    assert (result.exit_code, error["exit_code"], error["kind"]) == (1, 1, "Fault")
    assert "ZeroDivisionError" in error["message"]


def test_an_empty_path_is_never_the_current_folder():
    paths = [field for verb in all_verbs() for field in fields_of(verb.request) if "a path" in field.words]
    assert len(paths) > 30
    for field in paths:
        with pytest.raises(WrongSetting, match=r"is empty; expected .*a path"):
            converted(field, "")


def test_output_in_a_legacy_code_page_has_other_characters_replaced(actor: Path, tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    folder.mkdir()
    for number, path in enumerate(sorted(actor.glob("*.png"))):
        (folder / f"\u017aba_{number}.png").write_bytes(path.read_bytes())
    for encoding in ("cp1252", "cp437"):
        words = ["build-model", folder, "-o", tmp_path / "m.morph", "--landmarks", "none", *FAST]
        result = subprocess.run(
            [sys.executable, "-c", "from morphspace.cli.main import main; main()", *map(str, words)],
            env={**os.environ, "PYTHONIOENCODING": encoding},
            capture_output=True,
        )
        assert result.returncode == 0, result.stderr
        assert b"Traceback" not in result.stderr
        assert re.search(rb"reference \?ba_\d:", result.stdout)


def test_pictures_that_were_passed_over_are_said(actor: Path, tmp_path: Path) -> None:
    for path in actor.glob("*.png"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    for number in range(6):
        (tmp_path / f"IMG_{number}.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    built = run("build-model", tmp_path, "-o", tmp_path / "m.morph", "--landmarks", "none", *FAST)
    encoded = run("encode", tmp_path / "m.morph", tmp_path, "-o", tmp_path / "t.csv")
    for result in (built, encoded):
        assert result.exit_code == 0, result.output
        assert "note: 6 .HEIC pictures were passed over" in result.stderr


def test_no_message_moves_the_cursor_of_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("frame,\x1b[2Jpc\nx,1\n")
    (tmp_path / "clip\x1b[2J").mkdir()
    for words in (
        ("render", "gone\x1b[2J\x9b.morph", "t.csv", "-o", tmp_path / "out"),
        ("build-model", tmp_path / "clip\x1b[2J"),
    ):
        result = run(*words)
        refused(result)
        assert result.stderr.strip().isprintable()


def test_a_frame_name_is_found_whichever_way_its_accent_is_written(
    actor: Path, model: Path, tmp_path: Path
) -> None:
    for number, path in enumerate(sorted(actor.glob("*.png"))[:2]):
        (tmp_path / f"a\u0301{number}.png").write_bytes(path.read_bytes())
    assert run("encode", model, f"{tmp_path}/*.png", "-o", tmp_path / "t.csv").exit_code == 0
    for name in ("a\u03011", "\u00e11"):
        result = run(
            "caricature", model, "--loadings", tmp_path / "t.csv", "--frame", name, "-o", tmp_path / name
        )
        assert result.exit_code == 0, result.output


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("words", [["--help"], ["models", "list"], ["models", "list", "--json"]])
def test_a_full_standard_output_ends_in_one_line(words):
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "morphspace", *words],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
    assert ended.returncode == 2
    *notes, last = ended.stderr.splitlines()
    assert last.startswith("morphspace: cannot write to the standard output: ")
    assert all(note.startswith("note: ") for note in notes)


def test_an_interrupt_during_the_import_ends_in_one_line(monkeypatch, capsys):
    class Interrupted(importlib.abc.MetaPathFinder):
        def find_spec(self, name, path, target=None):
            if name == "morphspace.cli.main":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "morphspace.cli.main")
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        entry.run()
    assert ended.value.code == 130 and capsys.readouterr().err == "morphspace: stopped\n"


@pytest.mark.parametrize(
    "words",
    [
        ("--gain", "2", "--gain", "1"),
        ("--gain=2", "--gain=1"),
        ("-o", "a", "--output", "b", "--gain", "1"),
        ("--gain", "-1", "--video", ".mp4", "--gain", "-1"),
    ],
)
def test_an_option_of_one_value_is_not_given_twice(words: tuple[str, ...]) -> None:
    """The last alone would count: of three gains, two would be lost without a word."""
    refused(run("caricature", "a.morph", *words), "is given twice; expected once")
    result = run("caricature", "a.morph", "-o", "a", "--frame", "a", "--frame", "b", "--quiet", "--quiet")
    assert "twice" not in result.output
