"""The verb flow: what it writes and prints is the flow it was given, and no input makes it crash."""

import dataclasses
import json
import os
import re
import resource
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args

import cv2
import jsonschema
import numpy as np
import OpenImageIO as oiio
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.cli.main import main
from morphspace.errors import BadInput, UnwritableFile
from morphspace.flow import Flow, methods, names
from morphspace.flow.pairs import is_grey
from morphspace.flow.starts import WITHOUT_START, StartKind
from morphspace.grid import warp
from morphspace.io import flow_fields
from morphspace.io.flow_fields import UNKNOWN_PX, read_flow, write_flows
from morphspace.io.images import read_image, write_image
from morphspace.io.points import check_inside
from morphspace.io.tables import read_metrics_table
from morphspace.linear.quality import forward_backward_px, stays_inside
from morphspace.requests import field_named
from morphspace.storage import digest_of_file, whole_file
from morphspace.verbs.build_model import BuildModelRequest
from morphspace.verbs.flow import FlowRequest

ROOT = Path(__file__).resolve().parents[2]
HEIGHT, WIDTH = 48, 64
SHIFT_PX = 2  # to the right, from A to B
FAST = ("--preset", "fast")


def run(*words):
    return CliRunner().invoke(main, ["flow", *map(str, words)])


def done(*words):
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result


def told(*words):
    return json.loads(done(*words, "--json").stdout)


def refused(result, *mentioned):
    """One clear line on the error stream, exit 2, and each thing it must name."""
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("morphspace: ") and result.stderr.count("\n") == 1, result.stderr
    for word in mentioned:
        assert word in result.stderr


def field_of(u, v, height=HEIGHT, width=WIDTH):
    return np.broadcast_to(np.array([u, v], np.float32), (height, width, 2)).copy()


@dataclasses.dataclass
class Asked:
    """A method that gives the same field whatever it sees, and keeps what it was asked."""

    field: np.ndarray
    confidence: float = 0.5
    asked: list = dataclasses.field(default_factory=list)

    def __call__(self, reference):
        def to_frame(frame, start=None):
            self.asked.append((reference, frame, start))
            height, width = reference.shape[:2]
            return Flow(self.field[:height, :width], np.full((height, width), self.confidence, np.float32))

        return to_frame


@pytest.fixture
def asked(monkeypatch):
    """The method behind the name fast in this test."""
    method = Asked(field_of(SHIFT_PX, 0))
    monkeypatch.setitem(methods.METHODS, "fast", method)
    return method


@pytest.fixture
def folder(tmp_path, picture):
    """A picture a.png, the same moved by `SHIFT_PX` b.png, and broken companions of them."""
    image = picture(HEIGHT, WIDTH + SHIFT_PX)
    write_image(tmp_path / "a.png", image[:, SHIFT_PX:])
    write_image(tmp_path / "b.png", image[:, :-SHIFT_PX])
    return tmp_path


def test_the_names_offered_are_the_methods_there_are():
    assert tuple(methods.METHODS) == names.NAMES
    assert methods.DEFAULT == names.DEFAULT
    assert names.OURS + names.STOCK == names.NAMES and len(set(names.NAMES)) == len(names.NAMES)
    assert all(name in field_named(FlowRequest, "presets").metavar.split("|") for name in names.NAMES)
    assert field_named(BuildModelRequest, "flow").metavar.split("|") == list(names.NAMES)


def test_a_build_offers_the_starts_there_are():
    start = field_named(BuildModelRequest, "start")
    assert get_args(start.kind) == get_args(StartKind) and start.default in get_args(StartKind)


@pytest.mark.parametrize("preset", names.NAMES)
def test_every_preset_finds_a_picture_moved_by_two_pixels(folder, preset):
    done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--preset", preset)
    stored = read_flow(folder / "o.flo")
    assert stored.known.all()
    inner = stored.displacement[8:-8, 8:-8]
    assert_allclose(np.median(inner, axis=(0, 1)), [SHIFT_PX, 0], atol=0.3)  # px; the roughest of them


@pytest.mark.parametrize("preset", names.NAMES)
def test_the_flow_of_a_picture_to_itself_is_zero(folder, preset):
    figures = told(folder / "a.png", folder / "a.png", "-o", folder / "o.flo", "--both", "--preset", preset)
    assert figures["displacement_largest_px"] < 0.05
    assert figures["rmse_before"] == 0 and figures["folds_percent"] == 0


@pytest.mark.parametrize("suffix", [".flo", ".exr", ".FLO", ".EXR"])
def test_what_is_written_is_what_the_method_found(folder, asked, suffix):
    done(folder / "a.png", folder / "b.png", "-o", folder / f"o{suffix}", "--both", *FAST)
    for name in (f"o{suffix}", f"o.back{suffix}"):
        stored = read_flow(folder / name)
        assert_array_equal(stored.displacement, asked.field)
        assert (stored.confidence == (0.5 if suffix.lower() == ".exr" else 1)).all()
    a, b = (read_image(folder / f"{name}.png") for name in "ab")
    for (reference, frame, start), (one, other) in zip(asked.asked, ((a, b), (b, a)), strict=True):
        assert_array_equal(reference, one)
        assert_array_equal(frame, other)
        assert start is None


def test_the_figures_are_those_of_the_field(folder, asked):
    figures = told(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST)
    assert figures["size"] == [WIDTH, HEIGHT] and figures["preset"] == "fast"
    assert figures["displacement_mean_px"] == figures["displacement_largest_px"] == SHIFT_PX
    assert figures["folds_percent"] == 0 and figures["confidence_mean"] == 0.5
    assert figures["rmse_after"] < 0.5 * figures["rmse_before"]  # the rim of two columns is not seen in B
    assert "forward_backward_mean_px" not in figures
    asked.field[20, 20, 0] += 3
    assert told(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST)["folds_percent"] > 0
    lines = done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST).stdout
    for words in ("64x48 px", "2.00 px", "5.00 px", "0.50", "of 255"):
        assert words in lines


def test_both_tells_the_error_there_and_back(folder, asked):
    figures = told(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--both", *FAST)
    assert figures["forward_backward_mean_px"] == pytest.approx(2 * SHIFT_PX)
    done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--both", "--preset", "deepflow")
    forward, back = (read_flow(folder / name).displacement for name in ("o.flo", "o.back.flo"))
    error = forward_backward_px(forward, back)[stays_inside(forward, HEIGHT, WIDTH)]
    figures = told(
        folder / "a.png", folder / "b.png", "-o", folder / "p.flo", "--both", "--preset", "deepflow"
    )
    assert figures["forward_backward_mean_px"] == pytest.approx(error.mean())
    assert figures["forward_backward_p95_px"] == pytest.approx(np.quantile(error, 0.95))
    assert error.mean() < 0.3  # px


def test_where_every_point_leaves_there_is_no_way_back_and_no_nan(folder, asked):
    asked.field[:] = 1000
    result = done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--both", *FAST)
    assert "none stays" in result.stdout
    figures = told(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--both", *FAST)
    assert figures["forward_backward_mean_px"] is None


def test_the_method_starts_from_the_start_and_goes_back_from_its_inverse(folder, asked, wavy_field):
    start = wavy_field(HEIGHT, WIDTH, 3.0)
    write_flows({folder / "start.exr": (start, np.ones((HEIGHT, WIDTH), np.float32))})
    words = (
        folder / "a.png",
        folder / "b.png",
        "-o",
        folder / "o.flo",
        "--both",
        "--start",
        folder / "start.exr",
    )
    done(*words, *FAST)
    (_, _, forward), (_, _, back) = asked.asked
    assert_array_equal(forward, start)
    assert_allclose(back[8:-8, 8:-8], warp.invert(start)[8:-8, 8:-8], atol=0.1)  # px; a start needs no more
    record = json.loads((folder / "o.flo.record.json").read_text())
    assert record["inputs"]["start"] == digest_of_file(folder / "start.exr")


@dataclasses.dataclass
class Obedient(Asked):
    """A method that gives what it starts from, and its own field where it starts from nothing."""

    def __call__(self, reference):
        alone = super().__call__(reference)

        def to_frame(frame, start=None):
            flow = alone(frame, start)
            return flow if start is None else Flow(start, flow.confidence)

        return to_frame


CORNERS = np.array([[2, 2], [60, 4], [5, 44], [58, 40], [30, 20]])


@pytest.fixture
def marked(folder, monkeypatch):
    """Landmarks a.csv and b.csv that move as the picture does, and a method that follows its start."""
    for name, points in (("a", CORNERS), ("b", CORNERS + np.array([SHIFT_PX, 0]))):
        (folder / f"{name}.csv").write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in points))
    method = Obedient(field_of(0, 1))
    monkeypatch.setitem(methods.METHODS, "fast", method)
    return method


def with_landmarks(folder, a="a.csv", b="b.csv", *words):
    pictures = (folder / "a.png", folder / "b.png", "-o", folder / "o.flo")
    return (*pictures, "--landmarks", folder / a, folder / b, *FAST, *words)


def test_landmarks_start_both_ways_and_the_record_tells_it(folder, marked):
    figures = told(*with_landmarks(folder, "a.csv", "b.csv", "--both"))
    starts = [start for _, _, start in marked.asked]
    assert starts[0] is None and starts[2] is None
    assert_allclose(starts[1], field_of(SHIFT_PX, 0), atol=1e-4)
    assert_allclose(starts[3], field_of(-SHIFT_PX, 0), atol=1e-4)
    assert_array_equal(read_flow(folder / "o.flo").displacement, starts[1])
    assert_array_equal(read_flow(folder / "o.back.flo").displacement, starts[3])
    assert figures["started_from"] == ["landmarks", "landmarks"]
    assert figures["landmarks_missed_mean_px"] == pytest.approx(0, abs=1e-4)
    record = json.loads((folder / "o.flo.record.json").read_text())
    assert record["settings"]["landmarks"] == ["a.csv", "b.csv"]
    assert record["settings"]["started_from"] == ["landmarks", "landmarks"]
    for which in "ab":
        digest = digest_of_file(folder / f"{which}.csv")
        assert record["inputs"][f"landmarks of {which.upper()}"] == digest


def test_what_landmarks_do_not_better_stands(folder, marked):
    marked.field[:] = SHIFT_PX, 0
    wrong = CORNERS + np.array([SHIFT_PX, 3])
    (folder / "b.tem").write_text("5\n" + "".join(f"{x}\t{y}\n" for x, y in wrong) + "0\n")
    figures = told(*with_landmarks(folder, "a.csv", "b.tem"))
    assert figures["started_from"] == ["none"] and figures["landmarks_missed_mean_px"] == pytest.approx(3)
    assert_array_equal(read_flow(folder / "o.flo").displacement, marked.field)
    lines = done(*with_landmarks(folder, "a.csv", "b.tem", "--both")).stdout
    assert re.search(r"start +none, back from", lines) and re.search(r"landmarks missed by +3\.00 px", lines)


def test_a_start_that_is_given_is_the_landmarks_rival(folder, marked):
    write_flows({folder / "start.flo": (field_of(SHIFT_PX, 0), np.ones((HEIGHT, WIDTH), np.float32))})
    figures = told(*with_landmarks(folder, "a.csv", "b.csv", "--start", folder / "start.flo"))
    assert figures["started_from"] == ["start"]  # the landmarks explain no more
    assert [start is None for _, _, start in marked.asked] == [False, False]


@pytest.mark.parametrize("preset", names.OURS[:3])
def test_our_presets_take_landmarks(folder, marked, preset):
    words = with_landmarks(folder)
    figures = told(*words[: words.index("--preset")], "--preset", preset)
    assert figures["landmarks_missed_mean_px"] < 0.5
    assert figures["started_from"][0] in ("none", "landmarks")


def test_landmarks_on_pictures_without_anything_in_them_give_zero_flow(folder, marked):
    write_image(folder / "b.png", np.zeros((HEIGHT, WIDTH, 3), np.float32))
    figures = told(*with_landmarks(folder))
    assert figures["started_from"] == ["none"] and figures["displacement_largest_px"] == 0


@pytest.mark.parametrize("preset", WITHOUT_START)
def test_a_preset_without_a_use_for_landmarks_says_so(folder, marked, preset):
    words = with_landmarks(folder)
    refused(run(*words[: words.index("--preset")], "--preset", preset), preset, "landmarks", "balanced")


@pytest.mark.parametrize(
    ("a", "b", "mentioned"),
    [
        ("1,2\n30,4\n", "1,2\n30,4\n", "a.txt 2 places"),
        ("1,1\n10,10\n40,40\n", "1,2\n30,4\n9,30\n", "a.txt line"),
        ("1,2\n30,4\n9,30\n", "1,2\n30,4\n", "a.txt 3 b.txt 2"),
        ("1,2\n30,4\n9,x\n", "1,2\n30,4\n9,30\n", "a.txt line 3"),
        ("1,2\n300,4\n9,300\n", "1,2\n30,4\n9,30\n", "a.txt 2 of 3 a.png 64x48"),
        ("1,2\n30,4\n9,30\n", "1,2\n-30,4\n9,-30\n", "b.txt 2 of 3 b.png 64x48"),
        ("20,20\n24,20\n20,25\n", "2,2\n60,4\n5,44\n", "64x48 px landmarks move"),
        ("", "1,2\n30,4\n9,30\n", "a.txt empty"),
    ],
)
def test_landmarks_that_are_none_get_one_line_and_nothing_is_written(folder, marked, a, b, mentioned):
    (folder / "a.txt").write_text(a)
    (folder / "b.txt").write_text(b)
    before = sorted(folder.iterdir())
    refused(run(*with_landmarks(folder, "a.txt", "b.txt", "--both")), *mentioned.split(" "))
    assert sorted(folder.iterdir()) == before


# what it runs on


def test_the_backends_offered_are_the_ones_there_are():
    backend = field_named(FlowRequest, "backend")
    assert backend.metavar.split("|") == list(names.BACKENDS) and backend.default == names.DEFAULT_BACKEND
    assert methods.named("fast") is methods.named("fast", "opencv") is methods.METHODS["fast"]
    with pytest.raises(
        BadInput, match=r"backend is 'abacus'; expected opencv, torch, torch:cpu or torch:cuda"
    ):
        methods.named("fast", "abacus")


def test_torch_finds_the_same_flow_and_is_recorded(folder):
    pytest.importorskip("torch")
    flow_fields = []
    for backend in ("opencv", "torch:cpu"):
        words = (folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--preset", "fast")
        done(*words, "--backend", backend)
        flow_fields.append(read_flow(folder / "o.flo").displacement)
        assert json.loads((folder / "o.flo.record.json").read_text())["settings"]["backend"] == backend
    one, other = (
        field[8:-8, 8:-8] for field in flow_fields
    )  # the rim leaves the picture: nothing holds it there
    assert_allclose(one, other, atol=0.01)  # px
    assert (flow_fields[0] != flow_fields[1]).any()  # it was another machine


@pytest.mark.parametrize("preset", [name for name in names.NAMES if name not in names.OURS[:3]])
def test_other_presets_have_no_choice_of_a_backend(folder, preset):
    words = (folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--preset", preset)
    refused(run(*words, "--backend", "torch:cpu"), preset, "torch:cpu", "fast, balanced, accurate")
    assert not (folder / "o.flo").exists()


def test_unknown_points_of_a_start_are_at_rest(folder, asked):
    known = np.ones((HEIGHT, WIDTH), bool)
    known[:, :10] = False
    field = np.where(known[..., None], field_of(1, 1), np.float32(UNKNOWN_PX))
    (folder / "start.flo").write_bytes(struct.pack("<4sii", b"PIEH", WIDTH, HEIGHT) + field.tobytes())
    result = done(
        folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--start", folder / "start.flo", *FAST
    )
    assert "start at rest" in result.stderr
    assert_array_equal(asked.asked[0][2], np.where(known[..., None], field_of(1, 1), 0))


def test_the_record_fits_the_schema_and_its_digests_the_files(folder, asked):
    words = [
        folder / "a.png",
        folder / "b.png",
        "-o",
        folder / "o.exr",
        "--both",
        "--picture",
        folder / "p.png",
    ]
    done(*words, *FAST)
    record = json.loads((folder / "o.exr.record.json").read_text())
    schema = json.loads((ROOT / "data_spec" / "record.schema.json").read_text())
    jsonschema.Draft202012Validator(schema).validate(record)
    assert record["verb"] == "flow" and record["settings"] == {
        "preset": "fast",
        "backend": "opencv",
        "both": True,
    }
    assert record["inputs"] == {"A": digest_of_file(folder / "a.png"), "B": digest_of_file(folder / "b.png")}
    assert sorted(record["outputs"]) == ["o.back.exr", "o.exr", "p.png"]
    before = {name: digest_of_file(folder / name) for name in (*record["outputs"], "o.exr.record.json")}
    assert record["outputs"].items() <= before.items()
    done(*words, *FAST)
    assert before == {name: digest_of_file(folder / name) for name in before}


def test_a_picture_may_lie_in_another_folder(folder, asked):
    elsewhere = folder / "pictures" / "p.png"
    done(folder / "a.png", folder / "b.png", "-o", folder / "fields" / "o.flo", "--picture", elsewhere, *FAST)
    assert read_image(elsewhere).shape[2] == 3
    record = json.loads((folder / "fields" / "o.flo.record.json").read_text())
    assert list(record["outputs"]) == ["../pictures/p.png", "o.flo"]


# bad input


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("which", ["A", "B", "both"])
def test_a_picture_without_anything_in_it_gives_zero_flow_and_zero_confidence(folder, level, which):
    write_image(folder / "flat.png", np.full((HEIGHT, WIDTH, 3), level, np.float32))
    a = folder / ("a.png" if which == "B" else "flat.png")
    b = folder / ("b.png" if which == "A" else "flat.png")
    result = done(a, b, "-o", folder / "o.exr", "--both", "--picture", folder / "p.png")
    assert "one colour all over" in result.stderr
    for name in ("o.exr", "o.back.exr"):
        flow = read_flow(folder / name)
        assert not flow.displacement.any() and not flow.confidence.any()


def test_grey_against_colour_is_compared_in_grey(folder, asked):
    image = read_image(folder / "b.png")
    write_image(folder / "grey.png", np.repeat(image[..., :1], 3, axis=2))
    result = done(folder / "a.png", folder / "grey.png", "-o", folder / "o.flo", *FAST)
    assert "compared in grey" in result.stderr
    reference, frame, _ = asked.asked[0]
    assert is_grey(reference) and is_grey(frame)
    assert_allclose(frame, np.repeat(image[..., :1], 3, axis=2), atol=1e-6)


def raw_exr(path, image):
    target = oiio.ImageOutput.create(str(path))
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], "float")
    assert target.open(str(path), spec) and target.write_image(image) and target.close()


@pytest.mark.parametrize("preset", names.NAMES)
@pytest.mark.parametrize(("height", "width"), [(16, 16), (16, 400), (401, 17), (33, 17)])
def test_small_and_narrow_pictures_give_a_finite_flow_or_one_line(picture, tmp_path, preset, height, width):
    for name, seed in (("a", 1), ("b", 2)):
        write_image(tmp_path / f"{name}.png", picture(height, width, seed))
    result = run(tmp_path / "a.png", tmp_path / "b.png", "-o", tmp_path / "o.exr", "--preset", preset)
    if result.exit_code == 0:
        assert read_flow(tmp_path / "o.exr").known.shape == (height, width)
    else:
        refused(result, f"{width}x{height}")
        assert preset in names.STOCK  # ours take whatever is large enough to be asked


def test_a_method_that_fails_is_a_fault_of_ours(folder, asked):
    asked.field[3, 3] = np.nan
    result = run(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST)
    assert result.exit_code == 1 and result.stderr.count("\n") == 1 and "not finite" in result.stderr
    assert not (folder / "o.flo").exists()


def test_no_room_for_both_leaves_what_was_there(folder):
    done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST)
    old = (folder / "o.flo").read_bytes()
    size = HEIGHT * WIDTH * 8 + 12

    def little_room():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size - 1, size - 1))

    words = [
        sys.executable,
        "-m",
        "morphspace",
        "flow",
        folder / "a.png",
        folder / "b.png",
        "-o",
        folder / "o.flo",
    ]
    ended = subprocess.run(
        [*map(str, words), "--both", *FAST],
        capture_output=True,
        text=True,
        cwd=ROOT,
        preexec_fn=little_room,
        check=False,
    )
    assert ended.returncode == 2 and ended.stderr.count("\n") == 1, ended.stderr
    assert ended.stderr.startswith("morphspace: cannot write")
    assert (folder / "o.flo").read_bytes() == old
    assert sorted(path.name for path in folder.iterdir()) == ["a.png", "b.png", "o.flo", "o.flo.record.json"]


def test_a_way_back_that_cannot_be_written_takes_the_way_there_with_it(folder, asked, monkeypatch):
    written = flow_fields._write_into

    def no_room_for_the_second(temporary, path, field, confidence):
        if ".back" in path.name:
            raise UnwritableFile(f"cannot write {path}: no room")
        written(temporary, path, field, confidence)

    monkeypatch.setattr(flow_fields, "_write_into", no_room_for_the_second)
    refused(run(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", "--both", *FAST), "o.back.flo")
    assert sorted(path.name for path in folder.iterdir()) == ["a.png", "b.png"]


# scenes


def write_scene(pictures, truth, image, field):
    pictures.mkdir(parents=True, exist_ok=True)
    for name in ("frame10.png", "frame11.png"):
        write_image(pictures / name, image)
    if field is not None:
        truth.mkdir(parents=True, exist_ok=True)
        height, width = field.shape[:2]
        (truth / "flow10.flo").write_bytes(struct.pack("<4sii", b"PIEH", width, height) + field.tobytes())


@pytest.fixture
def scenes(tmp_path, picture):
    """Three scenes in both layouts, off by (0, 0.5), (0, 2) and, where it is known, 0 px; and one without a truth."""
    image = picture(HEIGHT, WIDTH)
    split = tmp_path / "other-data", tmp_path / "other-gt-flow"
    write_scene(tmp_path / "Half", tmp_path / "Half", image, field_of(SHIFT_PX, 0.5))
    write_scene(split[0] / "Two", split[1] / "Two", image, field_of(SHIFT_PX, 2))
    partly = field_of(SHIFT_PX, 0)
    partly[:5] = 1.666666752e9
    partly[5, :, 1] = -2e6
    write_scene(split[0] / "Partly", split[1] / "Partly", image, partly)
    write_scene(split[0] / "Bare", split[1] / "Bare", image, None)
    return tmp_path


def test_the_bench_gives_the_errors_of_every_scene_and_their_mean(scenes, asked):
    result = done("--bench", scenes, "-o", scenes / "t.csv", *FAST)
    assert "skipped, without a true flow: Bare" in result.stderr
    table = read_metrics_table(scenes / "t.csv")
    assert table["scene"] == ["Half", "Partly", "Two", "mean"] and table["preset"] == 4 * ["fast"]
    assert_allclose(table["aee_px"], [0.5, 0, 2, 2.5 / 3], atol=1e-6)
    assert_allclose(table["r1_percent"], [0, 0, 100, 100 / 3])
    angles = [np.degrees(np.arccos(5 / np.sqrt(5 * (5 + dv * dv)))) for dv in (0.5, 0, 2)]
    assert_allclose(table["aae_deg"], [*angles, np.mean(angles)], atol=1e-6)
    assert min(table["time_s"]) >= 0 and table["time_s"][3] == pytest.approx(np.mean(table["time_s"][:3]))
    for words in (r"Half +0\.500 ", r"Two +2\.000 .* 100\.00 ", r"mean +0\.833 "):
        assert re.search(words, result.stdout)
    record = json.loads((scenes / "t.csv.record.json").read_text())
    assert record["settings"] == {
        "presets": ["fast"],
        "backend": "opencv",
        "scenes": ["Half", "Partly", "Two"],
    }
    assert record["inputs"]["Half/flow10.flo"] == digest_of_file(scenes / "Half" / "flow10.flo")


def test_several_presets_stand_one_below_the_other(scenes, asked):
    rows = told("--bench", scenes, *FAST, "--preset", "deepflow")["table"]
    assert [(row["preset"], row["scene"]) for row in rows] == [
        (preset, scene) for preset in ("fast", "deepflow") for scene in ("Half", "Partly", "Two", "mean")
    ]
    assert rows[4]["aee_px"] == pytest.approx(np.hypot(SHIFT_PX, 0.5), abs=0.01)  # its pictures do not move


def test_colour_comes_before_grey(scenes, asked, picture):
    write_scene(scenes / "other-data-gray" / "Two", scenes, picture(HEIGHT, WIDTH, 9), None)
    done("--bench", scenes, *FAST)
    seen = [reference for reference, _, _ in asked.asked if reference.shape[:2] == (HEIGHT, WIDTH)]
    assert all(np.abs(reference - picture(HEIGHT, WIDTH)).max() < 0.01 for reference in seen)


@pytest.mark.parametrize(
    ("field", "mentioned"),
    [
        (field_of(0, 0)[1:], "64x47"),
        (field_of(1e10, 0), "no pixel with known flow"),
        (field_of(np.nan, 0), "finite"),
    ],
    ids=["size", "unknown", "nan"],
)
def test_a_truth_that_does_not_fit_is_named(scenes, asked, field, mentioned):
    write_scene(scenes / "Half", scenes / "Half", read_image(scenes / "Half" / "frame10.png"), field)
    refused(run("--bench", scenes, *FAST), "Half", "flow10.flo", mentioned)


def test_the_table_never_replaces_a_scene(scenes, asked):
    refused(run("--bench", scenes, "-o", scenes / "Half" / "flow10.flo", *FAST), ".csv")


def test_the_word_auto_is_no_file(folder, asked):
    for words in ((), ("--start", "auto")):
        done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST, *words)
    assert [start for *_, start in asked.asked] == [None, None]


def test_a_name_that_leaves_no_room_is_refused(folder, asked):
    refused(
        run(folder / "a.png", folder / "b.png", "-o", folder / f"{'x' * 240}.flo", *FAST), "244 bytes", "200"
    )
    assert not list(folder.glob("x*"))


def test_a_bench_names_the_scene_and_the_preset_that_fail(scenes, monkeypatch):
    def fails(reference):
        raise cv2.error("too small")

    monkeypatch.setitem(methods.METHODS, "fast", fails)
    refused(run("--bench", scenes, *FAST), "scene Half", "preset fast")


@pytest.fixture(params=[signal.SIGTERM, signal.SIGHUP])
def number(request):
    """A signal that is neither ignored nor handled when the verb starts."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_who_is_asked_to_stop_tidies_up(folder, monkeypatch, number):
    def stopped(flows):
        with whole_file(folder / "o.flo") as unfinished:
            unfinished.write_bytes(b"half")
            os.kill(os.getpid(), number)
            time.sleep(10)  # the signal comes first

    monkeypatch.setattr("morphspace.io.flow_fields.write_flows", stopped)
    before = sorted(folder.iterdir())
    result = run(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST)
    assert result.exit_code == 130 and "stopped" in result.stderr
    assert sorted(folder.iterdir()) == before


def test_a_hangup_that_is_ignored_stays_ignored(folder, asked, number):
    signal.signal(number, signal.SIG_IGN)
    done(folder / "a.png", folder / "b.png", "-o", folder / "o.flo", *FAST)
    assert signal.getsignal(number) == signal.SIG_IGN


def test_landmarks_outside_their_picture_are_refused_by_number():
    points = np.tile([[5.0, 5.0]], (13, 1))
    given = Path("a.tem"), points, (30, 20), "a.png", "Mark them"
    check_inside(*given)
    points[[2, 6]] = (-0.6, 5), (5, 19.6)
    line = r"a\.tem: landmarks 3, 7 of 13 lie outside a\.png, the first at -0\.6,5; expected places inside its 30x20"
    with pytest.raises(BadInput, match=line):
        check_inside(*given)
    points[:8] = (29.6, 5)
    with pytest.raises(BadInput, match=r"landmarks 1, 2, 3, 4, 5 and 3 more of 13 lie outside a\.png"):
        check_inside(*given)
