"""trajectory and continuum as they are called: tables in, sets of stimuli out, bad input in one line."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.avatar.pair import pair_model
from morphspace.cli import main
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.face.faceframe import FaceFrame
from morphspace.grid import warp
from morphspace.io.images import read_image, write_image
from morphspace.io.tables import read_loadings_table, read_metrics_table, write_loadings_table
from morphspace.io.video import read_frames
from morphspace.linear import quality
from morphspace.model.model import load_model
from morphspace.model.morph import Morph
from morphspace.steps import result_of
from morphspace.stimuli import stepping, timing, trajectory
from morphspace.stimuli.continuum import SPACINGS
from morphspace.stimuli.motion_words import GUIDED, WORDS
from morphspace.stimuli.operations import WORKS, Motion, Operation, operations_of, worked
from morphspace.verbs import batch
from morphspace.verbs import continuum as continuum_verb
from morphspace.verbs import trajectory as trajectory_verb
from morphspace.verbs.continuum import ContinuumRequest
from morphspace.verbs.trajectory import TrajectoryRequest

RATE_HZ = 10.0
FACEFRAME = FaceFrame((20.0, 28.0), (39.0, 28.0), (29.5, 46.0))


def wave(frames=12, phase=0.0):
    t = np.arange(frames)[:, None] / frames
    return np.sin(2 * np.pi * (t * [1.0, 0.6, 2.0] + phase))


def write_table(model, path, loadings_sd, rate_hz=RATE_HZ):
    document = {"model_id": model.model_id, "identity": model.identity, "frame_rate_hz": rate_hz}
    names = [f"frame_{row:03d}" for row in range(len(loadings_sd))]
    write_loadings_table(path, loadings_sd, names, document)
    return path


@pytest.fixture(scope="module")
def files(model, tmp_path_factory):
    """A folder with the model, two motions of it, and another person's model with keypoints."""
    folder = tmp_path_factory.mktemp("motion")
    model = model.with_faceframe(FACEFRAME, {"source": "set", "lip": "philtrum", "on": "mean"})
    model.save(folder / "ann.morph")
    write_table(model, folder / "smile.csv", wave())
    write_table(model, folder / "frown.csv", wave(14, 0.3))
    write_table(model, folder / "fast.csv", wave(8), 25.0)
    write_table(model, folder / "still.csv", wave(1))
    other(model).save(folder / "bob.morph")
    return folder


def other(model):
    """The model of somebody whose face is wider and darker, and stands elsewhere; without a common component."""
    height, width = model.mask.shape
    across = np.linspace(-1, 1, width)[None, :].repeat(height, 0)
    field = np.zeros((height, width, 2), np.float32)
    field[..., 0] = 1.5 * across + 2.0
    wide = warp.render(model.mean.texture, field) * np.float32(0.8)
    mean = Morph.of(wide.astype(np.float32), np.zeros_like(field), "0123456789abcdef")
    points = warp.move_points(field, FACEFRAME.points)
    training = replace(model.training, model_id="fedcba9876543210")
    provenance = {**model.provenance, "identity": "bob", "licence": "CC BY"}
    return replace(model, mean=mean, faceframe=FaceFrame.at(points), training=training, provenance=provenance)


def run(request):
    verb = trajectory_verb if isinstance(request, TrajectoryRequest) else continuum_verb
    return result_of(verb.run(request))


def test_every_word_of_the_help_does_something():
    assert list(WORDS) == list(WORKS)
    assert set(GUIDED) <= set(WORDS)
    help_text = CliRunner().invoke(main.main, ["trajectory", "--help"]).output
    for word, told in WORDS.items():
        assert told.form(word) in help_text
    assert all(
        spacing in CliRunner().invoke(main.main, ["continuum", "--help"]).output for spacing in SPACINGS
    )


def test_a_recipe_and_a_command_line_say_the_same():
    line = operations_of(["smooth=6", "loop", "speed=1.5", "part=0.5:2", "loop=0.5"])
    recipe = operations_of([{"smooth": 6}, "loop", {"speed": 1.5}, {"part": [0.5, 2]}, {"loop": 0.5}])
    assert line == recipe
    assert [str(one) for one in line] == ["smooth=6", "loop", "speed=1.5", "part=0.5:2", "loop=0.5"]
    assert operations_of([{"smooth": 6, "loop": None}]) == line[:2]


def test_operations_are_done_in_the_order_given():
    motions = [Motion("a", wave(), RATE_HZ)]
    weights = np.ones(3)
    one = worked(motions, operations_of(["part=0:0.6", "reverse"]), weights)[0]
    assert_array_equal(one.loadings_sd, wave()[:6][::-1])
    other = worked(motions, operations_of(["reverse", "part=0:0.6"]), weights)[0]
    assert_array_equal(other.loadings_sd, wave()[::-1][:6])


def test_a_loop_stays_one_when_it_is_smoothed_or_slowed():
    motions = [Motion("a", wave()[:9], RATE_HZ)]
    weights = np.ones(3)
    (loop,) = worked(motions, operations_of(["loop"]), weights)
    (slow,) = worked(motions, operations_of(["loop", "speed=0.5", "smooth=2"]), weights)
    assert (loop.ends, slow.ends) == ("closed", "closed")
    assert len(slow.loadings_sd) == 2 * len(loop.loadings_sd)
    expected = timing.smoothed(timing.retimed(loop.loadings_sd, 0.5, "closed"), 2.0, RATE_HZ, "closed")
    assert_array_equal(slow.loadings_sd, expected)


def test_another_frame_rate_keeps_the_duration():
    (shown,) = worked([Motion("a", wave(31), 25.0)], operations_of(["rate=60"]), np.ones(3))
    assert (shown.rate_hz, len(shown.loadings_sd)) == (60.0, 73)
    assert_allclose(shown.loadings_sd[::12], wave(31)[::5], atol=1e-12)


def test_scrambles_differ_with_the_seed_and_with_their_place():
    motions = [Motion("a", wave(40), RATE_HZ)]
    once, again, other = (
        worked(motions, [Operation("scramble-frames")], np.ones(3), seed=seed)[0].loadings_sd
        for seed in (1, 1, 2)
    )
    assert_array_equal(once, again)
    assert not np.array_equal(once, other)
    later = [Operation("speed", (1.0,)), Operation("scramble-frames")]  # at speed 1 nothing changes
    assert not np.array_equal(worked(motions, later, np.ones(3), seed=1)[0].loadings_sd, once)


def test_a_table_is_changed_and_written_with_what_was_done(files):
    request = TrajectoryRequest(
        files / "ann.morph", (files / "smile.csv",), files / "new.csv", ("smooth=2", "reverse")
    )
    outcome = run(request)
    table = read_loadings_table(files / "new.csv")
    assert_array_equal(table.loadings_sd, timing.smoothed(wave(), 2.0, RATE_HZ)[::-1])
    assert table.document["frame_rate_hz"] == RATE_HZ
    assert table.document["trajectory"]["operations"] == "smooth=2 reverse"
    assert outcome.document["ends"] == "open"
    again = TrajectoryRequest(files / "ann.morph", (files / "new.csv",), files / "newer.csv", ("reverse",))
    run(again)
    assert_array_equal(read_loadings_table(files / "newer.csv").loadings_sd, table.loadings_sd[::-1])


def test_motions_are_drawn_as_videos_of_their_loadings(files, tmp_path):
    request = TrajectoryRequest(
        files / "ann.morph",
        (files / "smile.csv", files / "frown.csv"),
        tmp_path / "set",
        ({"speed": 2}, "loop"),
        video=".mkv",
    )
    outcome = run(request)
    assert outcome.document["stimuli"] == 2
    manifest = read_metrics_table(tmp_path / "set" / "manifest.csv")
    assert manifest["name"] == ["smile", "frown"]
    assert manifest["operations"] == ["speed=2 loop"] * 2
    assert manifest["ends"] == ["closed"] * 2
    assert max(manifest["closing_step"]) <= 1
    model = load_model(files / "ann.morph")
    loop = trajectory.looped(timing.retimed(wave(), 2.0), model.sd)
    frames = list(read_frames(tmp_path / "set" / "smile.mkv"))
    assert len(frames) == len(loop)
    assert_array_equal(frames[3], stepping.as_shown(model.render(loop[3] * model.sd)))
    described = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert {"largest_step", "closing_step"} <= {one["name"] for one in described["variableMeasured"]}


def test_a_step_is_measured_as_the_model_measures_faces(files, tmp_path):
    model = load_model(files / "ann.morph")
    table = write_table(model, tmp_path / "bend.csv", wave()[:7])
    request = TrajectoryRequest(files / "ann.morph", (table,), tmp_path / "set", ("loop",))
    planned = result_of(trajectory_verb.plan(request))
    loops = [trajectory.looped(wave()[:7], weights) for weights in (model.sd, np.ones(3))]
    assert loops[0].shape != loops[1].shape or np.abs(loops[0] - loops[1]).max() > 1e-3
    assert_array_equal(planned.drawings[0].loadings_sd, loops[0])


def test_tables_called_as_every_verb_calls_them_go_by_their_folders(files, tmp_path):
    model = load_model(files / "ann.morph")
    tables = []
    for folder in ("by_eve", "by_dan", "more/by_dan"):
        (tmp_path / folder).mkdir(parents=True)
        tables.append(write_table(model, tmp_path / folder / "loadings.csv", wave()))
    planned = result_of(
        trajectory_verb.plan(TrajectoryRequest(files / "ann.morph", tuple(tables), tmp_path / "out"))
    )
    assert [drawing.name for drawing in planned.drawings] == ["by_eve", "by_dan", "by_dan_2"]
    assert planned.drawings[0].variables["tables"] == "by_eve by_dan by_dan_2"


def test_a_loop_that_is_given_too_little_time_is_noted(files):
    planned = [
        result_of(
            trajectory_verb.plan(
                TrajectoryRequest(
                    files / "ann.morph", (files / "smile.csv",), files / "x", ("part=0:0.6", word)
                )
            )
        )
        for word in ("loop", "loop=0", "reverse")
    ]
    assert [any("at the end of the loop" in note for note in one.notes) for one in planned] == [
        False,
        True,
        False,
    ]


def test_splicing_and_averaging_make_one_motion_of_all(files):
    tables = (files / "smile.csv", files / "frown.csv")
    for word, frames in (("splice=0.3", 12 + 3 + 14), ("average", 13)):
        run(TrajectoryRequest(files / "ann.morph", tables, files / "one.csv", (word,)))
        assert len(read_loadings_table(files / "one.csv").frame_names) == frames


def test_a_mean_trajectory_that_was_kept_serves_as_the_guide(files, tmp_path):
    tables, model = (files / "smile.csv", files / "frown.csv"), files / "ann.morph"
    run(TrajectoryRequest(model, tables, tmp_path / "mean.csv", ("average",)))
    request = TrajectoryRequest(
        model, tables[:1], tmp_path / "more.csv", ("caricature=1.5",), guide=tmp_path / "mean.csv"
    )
    run(request)
    planned = result_of(
        trajectory_verb.plan(replace(request, tables=tables, operations=("caricature=1.5",), guide=None))
    )
    assert_allclose(
        read_loadings_table(tmp_path / "more.csv").loadings_sd, planned.drawings[0].loadings_sd, atol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tables": ("still.csv",)}, "the number of frames of still is 1; expected at least 2"),
        ({"tables": ()}, "no table"),
        ({"tables": ("smile.csv", "fast.csv"), "operations": ("splice",)}, "rate=10 before splice"),
        ({"operations": ("speed=0",)}, "speed is 0"),
        ({"operations": ("speed=nan",)}, "expected a number"),
        ({"operations": ("speed",)}, "speed=TIMES"),
        ({"operations": ("loop=1:2",)}, r"loop\[=S\]"),
        ({"operations": ("lop",)}, r"Did you mean loop"),
        ({"operations": ("smooth=5",)}, "half the frame rate"),
        ({"operations": ("reverse", "smooth=1e-7")}, "^smooth=1e-07: a cut-off of 1e-07 Hz is too low"),
        ({"operations": ("timing",)}, "--guide"),
        ({"operations": ("caricature=2",)}, "at least 2 tables"),
        ({"operations": ("reverse",), "guide": "frown.csv"}, "a guide is given, but no operation takes one"),
        ({"operations": ("splice",)}, "at least 2 tables"),
        ({"operations": ("part=1:0.5",)}, "0 frames"),
        ({"operations": ("rate=1",)}, "Give a higher rate"),
        ({"operations": ("rate=nan",)}, "expected a number"),
        ({"operations": ("scramble-blocks=2",)}, "20 of the 12 frames"),
        ({"operations": ("loop=-1",)}, "-1 s"),
        ({"video": ".avi"}, ".mp4, .mkv"),
        ({"seed": -1}, "seed is -1; expected a whole number from 0 up"),
        ({"frame_rate_hz": 0.0}, "frame_rate_hz is 0.0; expected a number from 0.01 to 10000"),
        ({"model": "smile.csv"}, "Name the model first"),
        ({"output": "smile.csv"}, "would be replaced"),
        ({"output": "out.mp4"}, "ends in .mp4"),
        ({"tables": ("smile.csv", "frown.csv"), "output": "two.csv"}, "2 motions do not fit one table"),
    ],
)
def test_a_trajectory_that_cannot_be_is_refused_and_nothing_is_written(files, change, said):
    before = sorted(path.name for path in files.rglob("*"))
    given = {"model": "ann.morph", "tables": ("smile.csv",), "output": "refused", **change}
    for key in ("model", "output", "guide"):
        if key in given:
            given[key] = files / given[key]
    given["tables"] = tuple(files / name for name in given["tables"])
    with pytest.raises(BadInput, match=said):
        run(TrajectoryRequest(**given))
    assert sorted(path.name for path in files.rglob("*")) == before


def test_a_guide_of_somebody_else_is_sent_to_mimic(files, tmp_path):
    bob = load_model(files / "bob.morph")
    guide = write_table(bob, tmp_path / "bob.csv", wave())
    request = TrajectoryRequest(
        files / "ann.morph", (files / "smile.csv",), tmp_path / "out", ("timing",), guide=guide
    )
    with pytest.raises(ReferenceMismatch, match="mimic"):
        run(request)


def test_a_continuum_is_written_with_equal_steps_and_the_linear_morph_beside(files, tmp_path):
    ends = tuple(f"{files / 'smile.csv'}:frame_00{row}" for row in (3, 8))
    request = ContinuumRequest(*ends, tmp_path, model=files / "ann.morph", steps=4)
    outcome = run(request)
    model = load_model(files / "ann.morph")
    pictures = [read_image(tmp_path / f"step_{row:02d}.png") for row in range(5)]
    for end, row in ((0, 3), (4, 8)):
        assert_array_equal(pictures[end], stepping.as_shown(model.render(wave()[row] * model.sd)))
    table = read_metrics_table(tmp_path / "steps.csv")
    assert table["series"] == ["continuum"] * 4 + ["linear"] * 4
    for row in range(4):
        shown = stepping.ciede2000(pictures[row], pictures[row + 1], model.mask)
        assert_allclose(table["ciede2000"][row], shown, rtol=0.01)
    assert outcome.document["unevenness"]["continuum"] < 0.03
    assert_allclose([np.mean(table["size_of_mean"][:4]), np.mean(table["size_of_mean"][4:])], 1)
    assert_allclose(table["size_of_mean"][:4], 1, atol=0.03)
    faded = [stepping.as_shown(share * pictures[0] + (1 - share) * pictures[4]) for share in (0.75, 0.5)]
    assert_allclose(table["crossfade_ssim"][5], quality.ssim(*faded, model.mask), atol=1e-3)
    assert_allclose(table["crossfade_ciede2000"][5], stepping.ciede2000(*faded, model.mask), rtol=0.01)
    assert_allclose(np.diff(table["from_position"][4:]), 0.25)
    assert_allclose(table["warp_rms_px"][4:], table["warp_rms_px"][4], rtol=1e-3)
    manifest = read_metrics_table(tmp_path / "manifest.csv")
    assert manifest["position"][:5] == [*table["from_position"][:4], 1.0]


def test_every_column_of_steps_is_in_the_data_specification(files, tmp_path):
    from pathlib import Path

    ends = tuple(f"{files / 'smile.csv'}:frame_00{row}" for row in (3, 8))
    planned = result_of(
        continuum_verb.plan(ContinuumRequest(*ends, tmp_path, files / "ann.morph", 1, spacing="loadings"))
    )
    told = (Path(__file__).parents[2] / "data_spec" / "steps-table.md").read_text()
    assert all(f"`{name}`" in told for name in planned.tables["steps.csv"])
    assert [drawing.name for drawing in planned.drawings] == ["step_00", "step_01"]


def test_positions_may_be_given_and_go_beyond_the_ends(files, tmp_path):
    ends = tuple(f"{files / 'smile.csv'}:frame_00{row}" for row in (3, 8))
    request = ContinuumRequest(
        *ends, tmp_path, files / "ann.morph", positions=(-0.5, 0.25, 1.5), control="none"
    )
    planned = result_of(continuum_verb.plan(request))
    first, last = wave()[3], wave()[8]
    assert_allclose(planned.drawings[0].loadings_sd[0], first - 0.5 * (last - first), atol=1e-12)
    assert [drawing.variables["spacing"] for drawing in planned.drawings] == ["given"] * 3


def test_pictures_are_encoded_and_drawn_again(files, tmp_path):
    model = load_model(files / "ann.morph")
    for row in (3, 8):
        write_image(tmp_path / f"{row}.png", np.clip(model.render(wave()[row] * model.sd), 0, 1))
    ends = (str(tmp_path / "3.png"), str(tmp_path / "8.png"))
    planned = result_of(
        continuum_verb.plan(ContinuumRequest(*ends, tmp_path / "out", files / "ann.morph", 2))
    )
    for place, row in ((0, 3), (2, 8)):
        truth = model.render(wave()[row] * model.sd)
        shown = model.render(planned.drawings[place].loadings_sd[0] * model.sd)
        assert quality.psnr_db(shown, truth, model.mask) > 30


def test_the_model_of_a_pair_begins_and_ends_with_their_mean_faces(files):
    ann, bob = (load_model(files / f"{name}.morph") for name in ("ann", "bob"))
    pair = pair_model([ann, bob], flow="dis", inputs={}, versions={})
    assert (pair.model.rank, pair.model.identity) == (1, "drawn-bob")
    assert_allclose(pair.model.training.values.sum(), 0, atol=1e-4)
    laid = warp.apply_affine(pair.place, bob.faceframe.points)
    assert (
        np.hypot(*(laid - FACEFRAME.points).T).max()
        < 0.7
        < 1.5
        < np.hypot(*(bob.faceframe.points - FACEFRAME.points).T).min()
    )
    onto = warp.affine_displacement(warp.inverse_affine(pair.place), *ann.mask.shape)
    truths = [ann.mean.render(), warp.sample(bob.mean.render(), onto)]
    for loadings, truth in zip(pair.model.training.values, truths, strict=True):
        assert quality.psnr_db(pair.model.render(loadings), truth, pair.model.mask) > 40
    assert pair.model.provenance["licence"] == "drawn: CC0; bob: CC BY"
    assert_allclose(pair.model.mean.displacement, 0, atol=0.15)


def test_two_models_make_a_continuum_that_is_drawn_from_the_pair_beside_it(files, tmp_path):
    request = ContinuumRequest(str(files / "ann.morph"), str(files / "bob.morph"), tmp_path / "out", steps=2)
    run(request)
    pair = load_model(tmp_path / "out" / "ann-bob.morph")
    sidecar = json.loads((tmp_path / "out" / "step_01.json").read_text())
    assert sidecar["model"]["model_id"] == pair.model_id
    assert sidecar["model"]["file"] == "ann-bob.morph"
    first = (tmp_path / "out" / "ann-bob.morph").read_bytes()
    run(request)
    assert (tmp_path / "out" / "ann-bob.morph").read_bytes() == first


def test_the_model_of_another_pair_is_not_replaced(files, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    kept = (files / "bob.morph").read_bytes()
    (out / "ann-bob.morph").write_bytes(kept)
    with pytest.raises(BadInput, match="is another model"):
        run(ContinuumRequest(str(files / "ann.morph"), str(files / "bob.morph"), out, steps=2))
    assert (out / "ann-bob.morph").read_bytes() == kept


def test_two_pairs_of_models_of_one_name_are_kept_apart_in_a_batch(files, tmp_path):
    for folder, name in (("a", "ann"), ("b", "bob"), ("c", "ann")):
        (tmp_path / folder).mkdir()
        shutil.copy(files / f"{name}.morph", tmp_path / folder / "model.morph")
    text = "format: morphspace-recipe\nversion: 1\nfactors: {way: {ab: [a, b], ba: [b, c]}}\nstimuli:\n"
    text = text.replace("[a, b]", "{first: a/model.morph, last: b/model.morph}")
    text = text.replace("[b, c]", "{first: b/model.morph, last: c/model.morph}")
    text += '  - {verb: continuum, first: "{way.first}", last: "{way.last}", steps: 1, control: none}\n'
    (tmp_path / "recipe.yaml").write_text(text)
    out = tmp_path / "out"
    for _ in range(2):  # what is there is gone on with
        result_of(batch.run(batch.BatchRequest(tmp_path / "recipe.yaml", out, workers=1)))
        names = set()
        for sidecar in sorted(out.rglob("step_*.json")):
            told = json.loads(sidecar.read_text())["model"]
            assert load_model(out / told["file"]).model_id == told["model_id"]
            names.add(told["file"])
        assert names == {path.name for path in out.glob("*.morph")}
        assert len(names) == 2


def test_a_loop_that_jumps_is_told_in_few_digits(files, tmp_path):
    request = TrajectoryRequest(files / "ann.morph", (files / "frown.csv",), tmp_path, ("loop=0",))
    (note,) = result_of(trajectory_verb.plan(request)).notes
    assert re.search(r"jumps by \d(\.\d{1,2})? median steps at the end of the loop", note), note


@pytest.mark.parametrize(
    ("first", "last", "change", "said"),
    [
        ("smile.csv:frame_003", "smile.csv:frame_003", {}, "same face"),
        ("smile.csv:frame_003", "smile.csv:frame_099", {}, "no frame 'frame_099'"),
        ("smile.csv:frame_003", "smile.csv", {}, "smile.csv:FRAME"),
        ("smile.csv:frame_003", "none.png", {}, "does not exist"),
        ("smile.csv:frame_003", "bob.morph", {}, "is a model"),
        ("smile.csv:frame_003", "bob.morph", {"model": None}, "frame_003 is not a model"),
        ("ann.morph", "ann.morph", {"model": None}, "the same one"),
        ("ann.morph", "bob.morph", {"model": None, "crop": (0, 0, 40, 40)}, "Leave it out"),
        (
            "smile.csv:frame_003",
            "smile.csv:frame_004",
            {"steps": 0},
            "steps is 0; expected",
        ),
        ("smile.csv:frame_003", "smile.csv:frame_004", {"positions": (1.0, 0.0)}, "0 comes after 1"),
        (
            "smile.csv:frame_003",
            "smile.csv:frame_004",
            {"spacing": "psnr"},
            "spacing is 'psnr'; expected one of",
        ),
    ],
)
def test_a_continuum_that_cannot_be_is_refused_and_nothing_is_written(files, first, last, change, said):
    before = sorted(path.name for path in files.rglob("*"))
    given = {"model": files / "ann.morph", **change}
    with pytest.raises(BadInput, match=said):
        run(ContinuumRequest(str(files / first), str(files / last), files / "refused", **given))
    assert sorted(path.name for path in files.rglob("*")) == before


def test_the_command_line_says_what_came_out(files, tmp_path):
    words = [
        "trajectory",
        str(files / "ann.morph"),
        str(files / "smile.csv"),
        "--op",
        "loop",
        "-o",
        str(tmp_path / "l.csv"),
    ]
    result = CliRunner().invoke(main.main, words)
    assert (result.exit_code, "a loop" in result.output) == (0, True)
    result = CliRunner().invoke(main.main, [*words, "--op", "smoth=3"])
    assert result.exit_code == 2
    assert "Did you mean smooth=HZ?" in result.output
    ends = [f"{files / 'smile.csv'}:frame_00{row}" for row in (3, 8)]
    words = [
        "continuum",
        *ends,
        "--model",
        str(files / "ann.morph"),
        "--at",
        "0,1",
        "-o",
        str(tmp_path / "c"),
    ]
    result = CliRunner().invoke(main.main, words)
    assert (result.exit_code, "1 steps" in result.output) == (0, True)
