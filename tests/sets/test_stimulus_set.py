"""Laws of stimulus sets: same request, same bytes; what is done is kept; sidecars, manifest, page and files agree."""

import contextlib
import csv
import importlib
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from morphspace import storage
from morphspace.errors import BadInput
from morphspace.io.colour import codes_of
from morphspace.io.images import read_image, write_image
from morphspace.io.stimulus_sidecars import essentials_in, read_stimulus_sidecar
from morphspace.io.tables import read_loadings_table
from morphspace.io.video import read_frames
from morphspace.model.loadings import Loadings
from morphspace.model.model import load_model
from morphspace.model.morph import Morph
from morphspace.outcome import versions
from morphspace.report.set_page import SHOWN_AT_MOST, places_shown, sheet_columns
from morphspace.requests import recorded_path
from morphspace.sets.manifest import Column
from morphspace.sets.plan import PlannedSet, check_names, plan_of
from morphspace.sets.stimulus_set import flagged, notes_on, write_set
from morphspace.steps import result_of
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.image_statistics import image_statistics
from morphspace.storage import digest_of_file
from morphspace.verbs import caricature, grid, place, render, replay, sample, sweep
from morphspace.verbs.caricature import CaricatureRequest
from morphspace.verbs.encode import write_loadings
from morphspace.verbs.grid import GridRequest
from morphspace.verbs.place import PlaceRequest
from morphspace.verbs.render import RenderRequest
from morphspace.verbs.replay import ReplayRequest
from morphspace.verbs.sample import SampleRequest
from morphspace.verbs.sweep import SweepRequest

SCHEMA = json.loads(
    (Path(__file__).parents[2] / "data_spec" / "stimulus.schema.json").read_text(encoding="utf-8")
)


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    """A folder with a model and a table of six of its training faces."""
    folder = tmp_path_factory.mktemp("set")
    model = replace(model, provenance={**model.provenance, "consent": "research", "framing": FRAMING})
    model.save(folder / "a.morph")
    training = Loadings(model.training.values[:6], model.training.frame_names[:6], model.model_id)
    write_loadings(folder / "t.csv", training, model, folder / "a.morph", {})
    return folder


FRAMING = {"source_size": [60, 72], "crop": None, "size": [60, 72]}


def bytes_of(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def rows_of(folder):
    with (folder / "manifest.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def made(folder, output, **entries):
    request = CaricatureRequest(folder / "a.morph", output, folder / "t.csv", **entries)
    return result_of(caricature.run(request))


@pytest.fixture(scope="module")
def pictures(folder):
    made(folder, folder / "pictures", gains=(0.5, 1.0, 2.0))
    return folder / "pictures"


@pytest.fixture(scope="module")
def films(folder):
    made(folder, folder / "films", gains=(1.0, -1.0), video=".mp4", frame_rate_hz=30000 / 1001)
    return folder / "films"


@pytest.fixture(scope="module")
def lossless(folder):
    made(folder, folder / "lossless", gains=(1.5,), texture_gains=(0.0,), video=".mkv")
    return folder / "lossless"


@pytest.fixture(scope="module")
def warps(folder):
    request = SweepRequest(
        folder / "a.morph", folder / "warps", components=1, amount_sd=1.5, steps=2, warp_only=True
    )
    result_of(sweep.run(request))
    return folder / "warps"


@pytest.fixture(params=["pictures", "films", "lossless", "warps"])
def any_set(request):
    return request.getfixturevalue(request.param)


def test_the_same_request_gives_the_same_bytes(folder, pictures, films):
    made(folder, folder / "again", gains=(0.5, 1.0, 2.0))
    assert bytes_of(folder / "again") == bytes_of(pictures)
    made(folder, folder / "films again", gains=(1.0, -1.0), video=".mp4", frame_rate_hz=30000 / 1001)
    assert bytes_of(folder / "films again") == bytes_of(films)


def test_a_caricature_is_the_models_rendering_of_scaled_loadings(folder, pictures):
    model, table = load_model(folder / "a.morph"), read_loadings_table(folder / "t.csv")
    expected = np.clip(model.render(2 * table.loadings_sd[3] * model.sd), 0, 1)
    shown = read_image(pictures / f"{table.frame_names[3]}_g2.png")
    assert np.abs(shown - expected).max() <= 0.501 / 255  # the rounding of an 8-bit file


def test_a_sweep_of_the_warp_is_a_caricature_without_texture(folder, warps, tmp_path):
    model = load_model(folder / "a.morph")
    along = np.eye(1, model.rank) * model.sd
    write_loadings(
        tmp_path / "one.csv", Loadings(along, ("one",), model.model_id), model, folder / "a.morph", {}
    )
    request = CaricatureRequest(
        folder / "a.morph", tmp_path / "out", tmp_path / "one.csv", gains=(1.5,), texture_gains=(0.0,)
    )
    result_of(caricature.run(request))
    (same,) = (tmp_path / "out").glob("*.png")
    np.testing.assert_array_equal(read_image(warps / "pc001_warp_+1.5sd.png"), read_image(same))
    assert {row["texture_gain"] for row in rows_of(warps)} == {"0.0"}
    assert (read_image(warps / "pc001_warp_-1.5sd.png") != read_image(same)).any()


def test_every_sidecar_fits_the_schema(any_set):
    sidecars = [any_set / f"{row['name']}.json" for row in rows_of(any_set)]
    assert sidecars
    for path in sidecars:
        jsonschema.Draft202012Validator(SCHEMA).validate(json.loads(path.read_text(encoding="utf-8")))


def test_statistics_read_back_are_those_of_the_sidecar(any_set):
    for row in rows_of(any_set):
        path = any_set / row["file"]
        frames = [read_image(path)] if path.suffix == ".png" else read_frames(path)
        measured = image_statistics(codes_of(frame, 8)[0] for frame in frames)
        assert measured == read_stimulus_sidecar(any_set / f"{row['name']}.json")["statistics"]


def test_manifest_sidecar_and_file_agree(any_set):
    described = json.loads((any_set / "manifest.json").read_text(encoding="utf-8"))
    rows = rows_of(any_set)
    assert [entry["name"] for entry in described["variableMeasured"]] == list(rows[0])
    assert all(entry["description"] for entry in described["variableMeasured"])
    for row in rows:
        sidecar = any_set / f"{row['name']}.json"
        document = read_stimulus_sidecar(sidecar)
        assert row["sha256"] == document["output"]["sha256"] == digest_of_file(any_set / row["file"])
        assert row["sidecar_sha256"] == digest_of_file(sidecar)
        assert float(row["code_luminance"]) == document["statistics"]["code"]["luminance"]
        assert (row["consent"], row["licence"]) == ("research", "CC0")


def test_the_record_names_every_file_with_its_digest(any_set):
    record = json.loads((any_set / "record.json").read_text(encoding="utf-8"))
    files = {name for name in bytes_of(any_set) if name != "record.json"}
    assert record["outputs"] == {name: digest_of_file(any_set / name) for name in files}


def test_the_essentials_are_inside_the_file(any_set, folder):
    for row in rows_of(any_set):
        told = essentials_in(any_set / row["file"])
        assert told["model_id"] == load_model(folder / "a.morph").model_id == row["model_id"]
        assert (told["verb"], told["consent"], told["licence"]) == (row["verb"], "research", "CC0")


def test_the_loadings_table_of_a_set_renders_to_the_same_pictures(folder, pictures):
    output = folder / "rendered"
    result_of(render.run(RenderRequest(folder / "a.morph", pictures / "loadings.csv", output)))
    for row in rows_of(pictures):
        np.testing.assert_array_equal(read_image(output / row["file"]), read_image(pictures / row["file"]))


def test_no_place_on_a_disk_is_told(any_set, folder):
    for name, content in bytes_of(any_set).items():
        assert str(folder).encode() not in content, name


def test_absolute_paths_are_told_without_the_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert recorded_path(tmp_path / "models" / "a.morph") == "models/a.morph"
    assert recorded_path(Path("../a.morph")) == "../a.morph"
    assert recorded_path(Path("/somewhere/private/a.morph")) == "a.morph"


def test_what_is_done_is_kept_and_what_is_not_is_made(folder, pictures, tmp_path, monkeypatch):
    output = tmp_path / "out"
    made(folder, output, gains=(0.5, 1.0, 2.0))
    names = [row["name"] for row in rows_of(output)]
    (output / f"{names[1]}.json").unlink()  # killed before its sidecar
    (output / f"{names[2]}.png").write_bytes(b"cut short")
    cut = output / f"{names[3]}.json"
    cut.write_bytes(cut.read_bytes()[:-9])
    drawn = []
    draw = importlib.import_module("morphspace.sets.stimulus").draw_file
    monkeypatch.setattr(
        "morphspace.sets.stimulus.draw_file",
        lambda model, drawing, *rest: drawn.append(drawing.name) or draw(model, drawing, *rest),
    )
    made(folder, output, gains=(0.5, 1.0, 2.0))
    assert sorted(drawn) == sorted(names[1:4])
    assert bytes_of(output) == bytes_of(pictures)


def test_another_request_draws_anew(folder, tmp_path):
    assert not any("another set" in note for note in made(folder, tmp_path / "out", gains=(2.0,)).warnings)
    before = bytes_of(tmp_path / "out")
    made(folder, tmp_path / "out", gains=(2.0,), components="1")
    after = bytes_of(tmp_path / "out")
    changed = [name for name in before if name.endswith(".png") and before[name] != after[name]]
    assert len(changed) == 6
    outcome = made(folder, tmp_path / "out", gains=(3.0,))
    assert "6 stimuli of another set" in outcome.warnings[-1] and "_g2.png" in outcome.warnings[-1]


def test_replay_gives_the_same_bytes(any_set, folder):
    for row in rows_of(any_set)[:2]:
        outcome = result_of(replay.run(ReplayRequest(any_set / f"{row['name']}.json")))
        assert outcome.document["same"] and "byte for byte" in outcome.lines[0]


def test_replay_says_what_differs(folder, pictures, tmp_path):
    model = load_model(folder / "a.morph")
    other = replace(
        model,
        mean=Morph.of(
            model.mean.texture + np.float32(4 / 255), model.mean.displacement, model.mean.reference_id
        ),
    )
    other.save(tmp_path / "other.morph")
    name = rows_of(pictures)[0]["name"]
    request = ReplayRequest(pictures / f"{name}.json", tmp_path / "other.morph")
    outcome = result_of(replay.run(request))
    assert not outcome.document["same"]
    assert "the model's digest is" in " ".join(outcome.lines)
    assert "largest pixel difference is 4 of 255" in " ".join(outcome.lines)

    sidecar = tmp_path / "old.json"
    document = json.loads((pictures / f"{name}.json").read_text(encoding="utf-8"))
    document["versions"]["numpy"], document["licence"] = "1.0.0", "another"
    sidecar.write_text(json.dumps(document), encoding="utf-8")
    (tmp_path / f"{name}.png").write_bytes((pictures / f"{name}.png").read_bytes())
    told = " ".join(result_of(replay.run(ReplayRequest(sidecar, folder / "a.morph"))).lines)
    assert "numpy was 1.0.0" in told and "every pixel is the same" in told


def test_replay_notices_a_file_that_was_changed_and_one_that_is_gone(folder, pictures, tmp_path):
    name = rows_of(pictures)[0]["name"]
    (tmp_path / f"{name}.json").write_bytes((pictures / f"{name}.json").read_bytes())
    request = ReplayRequest(tmp_path / f"{name}.json", folder / "a.morph")
    gone = result_of(replay.run(request))
    assert gone.document["same"] and "is missing" in gone.warnings[0]
    write_image(tmp_path / f"{name}.png", read_image(pictures / f"{name}.png") * np.float32(0.9))
    changed = result_of(replay.run(request))
    assert changed.document["same"] and "changed after it was written" in changed.warnings[0]


def test_replay_without_the_model_says_how_to_name_it(pictures, tmp_path):
    name = rows_of(pictures)[0]["name"]
    (tmp_path / "deep" / "er" / "er").mkdir(parents=True)
    sidecar = tmp_path / "deep" / "er" / "er" / f"{name}.json"
    sidecar.write_bytes((pictures / f"{name}.json").read_bytes())
    with pytest.raises(BadInput, match="--model"):
        result_of(replay.run(ReplayRequest(sidecar)))


def test_a_painted_region_is_kept_by_its_digest(folder, tmp_path, monkeypatch):
    mask = np.zeros((72, 60, 3), np.float32)
    mask[:36] = 1
    write_image(tmp_path / "half.png", mask)
    monkeypatch.chdir(tmp_path)
    made(folder, tmp_path / "out", gains=(3.0,), region="half.png", frames=("frame_002",))
    sidecar = tmp_path / "out" / "frame_002_g3.json"
    assert result_of(replay.run(ReplayRequest(sidecar, folder / "a.morph"))).document["same"]
    model, table = load_model(folder / "a.morph"), read_loadings_table(folder / "t.csv")
    veridical = np.clip(model.render(table.loadings_sd[2] * model.sd), 0, 1)
    shown = read_image(tmp_path / "out" / "frame_002_g3.png")
    assert np.abs(shown[45:] - veridical[45:]).max() < 0.02 < np.abs(shown[:30] - veridical[:30]).max()
    write_image(tmp_path / "half.png", 1 - mask)
    with pytest.raises(BadInput, match="has changed"):
        result_of(replay.run(ReplayRequest(sidecar, folder / "a.morph")))


def test_faces_put_back_leave_the_rest_of_the_picture(folder, tmp_path):
    model = load_model(folder / "a.morph")
    frames = tmp_path / "frames"
    frames.mkdir()
    names = model.training.frame_names[:2]
    for row, name in enumerate(names):
        write_image(frames / f"{name}.png", model.render(model.training.values[row]))
    request = PlaceRequest(
        folder / "a.morph", (str(frames),), tmp_path / "out", folder / "t.csv", gain=2.0, frames=names
    )
    result_of(place.run(request))
    original, shown = read_image(frames / f"{names[0]}.png"), read_image(tmp_path / "out" / f"{names[0]}.png")
    outside = model.mask < 1e-6
    assert outside.any()
    np.testing.assert_allclose(shown[outside], original[outside], atol=1e-6)
    assert np.abs(shown - original).max() > 0.02
    sidecar = tmp_path / "out" / f"{names[0]}.json"
    again = ReplayRequest(sidecar, folder / "a.morph", (str(frames),))
    assert result_of(replay.run(again)).document["same"]
    with pytest.raises(BadInput, match="--clip"):
        result_of(replay.run(ReplayRequest(sidecar, folder / "a.morph")))
    (frames / f"{names[0]}.png").write_bytes((frames / f"{names[1]}.png").read_bytes())
    with pytest.raises(BadInput, match="which has changed"):
        result_of(replay.run(again))


def test_a_grid_crosses_its_two_components(folder, tmp_path):
    result_of(grid.run(GridRequest(folder / "a.morph", tmp_path, (3, 1), (2.0, 1.0), (2, 3))))
    table = read_loadings_table(tmp_path / "loadings.csv").loadings_sd
    assert sorted(map(tuple, table.tolist())) == sorted(
        (one, 0.0, two) for one in (-1, 0, 1) for two in (-2, 2)
    )


def test_a_sample_within_bounds_stays_there_and_one_without_is_the_models_own(folder, tmp_path):
    model = load_model(folder / "a.morph")
    result_of(sample.run(SampleRequest(folder / "a.morph", tmp_path / "all", count=8, seed=3)))
    table = read_loadings_table(tmp_path / "all" / "loadings.csv").loadings_sd
    np.testing.assert_allclose(table * model.sd, model.sample(np.random.default_rng(3), 8).values, rtol=1e-12)
    result_of(sample.run(SampleRequest(folder / "a.morph", tmp_path / "near", count=8, seed=3, max_sd=0.5)))
    near = read_loadings_table(tmp_path / "near" / "loadings.csv").loadings_sd
    assert np.abs(near).max() <= 0.5 < np.abs(table).max()
    inside = np.abs(table) <= 0.5
    np.testing.assert_array_equal(near[inside], table[inside])


def test_names_that_collide_are_refused_before_anything_is_drawn(folder, tmp_path):
    with pytest.raises(BadInput, match="'a' or 'A'"):
        check_names(["a", "b", "A"])
    with pytest.raises(BadInput, match="'Manifest'"):
        check_names(["Manifest"])
    with pytest.raises(BadInput, match="'steps'"):
        check_names(["steps"], ("steps.csv",))
    with pytest.raises(BadInput, match="given twice"):
        made(folder, tmp_path / "out", gains=(1.0, 1.0))
    assert not (tmp_path / "out").exists()


def test_told_entries_need_a_description(folder):
    model = load_model(folder / "a.morph")
    request = SampleRequest(folder / "a.morph", folder)

    def planned(columns, **told) -> PlannedSet:
        return plan_of(
            request, "sample", model, [Drawing("a", np.zeros((1, 3)), variables=told)], columns=columns
        )

    assert list(planned({"mood": Column("How it looks")}, mood="glad").variable_columns()) == ["mood"]
    with pytest.raises(BadInput, match="'mood' has no description"):
        planned({}, mood="glad")
    with pytest.raises(BadInput, match="'sha256' is one of the manifest's own"):
        planned({}, sha256="x")
    with pytest.raises(BadInput, match="nothing to draw"):
        plan_of(request, "sample", model, [])


def test_files_that_are_not_ours_are_never_replaced(folder, tmp_path):
    model = load_model(folder / "a.morph")
    planned = plan_of(
        SampleRequest(folder / "a.morph", folder), "sample", model, [Drawing("frame", np.zeros((1, 3)))]
    )
    for name, content in (
        ("frame.png", b"mine"),
        ("frame.json", b'{"mine": 1}'),
        ("manifest.json", b'{"mine": 1}'),
        ("loadings.json", b"{}"),
    ):
        output = tmp_path / name
        output.mkdir()
        (output / name).write_bytes(content)
        with pytest.raises(BadInput, match="would be replaced"):
            result_of(write_set(planned, output))
        assert bytes_of(output) == {name: content}


def test_the_one_that_stands_out_is_flagged_and_no_other():
    rng = np.random.default_rng(0)
    rows = [{"linear_luminance": 0.3 + 0.001 * rng.standard_normal(), "code_red": 0.5} for _ in range(40)]
    rows[7]["linear_luminance"] = 0.4
    rows[9]["code_red"] = None
    out = [row["outlier_in"] for row in flagged(rows)]
    assert out[7] == "linear_luminance" and not any(out[:7] + out[8:])
    assert not any(row["outlier_in"] for row in flagged(rows[5:10]))  # too few to say


@pytest.mark.parametrize(
    ("rest", "value", "is_out"),
    [
        ((0.99, 1.01) * 4, 1.115, True),  # OUTLIER_Z and NORMAL_MAD: 0.104 from the median, 1.01
        ((0.99, 1.01) * 4, 1.113, False),
        ((1.0, 1.0) * 4, 1.018, True),  # LEAST_SPREAD: 0.0175
        ((1.0, 1.0) * 4, 1.017, False),
        ((1.0, 1.0) * 3, 1.1, False),  # LEAST_FOR_OUTLIERS: 8 in all
        ((1.0, 1.0, 1.0) * 2 + (1.0,), 1.1, True),
    ],
)
def test_an_outlier_is_three_and_a_half_robust_sd_away(rest, value, is_out):
    rows = flagged([{"linear_luminance": one} for one in (*rest, value)])
    assert (rows[-1]["outlier_in"] == "linear_luminance") == is_out
    assert not any(row["outlier_in"] for row in rows[:-1])


def test_a_set_says_which_of_its_stimuli_to_look_at():
    fine = {"name": "a", "clipped_percent": 0.05, "folded_percent": 0.2, "beyond": "", "outlier_in": ""}
    fine |= {"largest_sd": 2.0, "largest_component": 1}
    assert notes_on([fine]) == ()
    for change, said in (
        ({"clipped_percent": 3.0}, "clipped, most in b (3 %)"),
        ({"folded_percent": 2.0}, "folds over itself, most in b (2 % of it)"),
        ({"beyond": "pc002", "largest_sd": 5.0, "largest_component": 2}, "furthest b (5.0 SD in pc002)"),
        ({"outlier_in": "code_red"}, "such as b (code_red)"),
    ):
        (note,) = notes_on([fine, {**fine, "name": "b", **change}])
        assert "1 of 2" in note and said in note


def test_what_belongs_together_stands_in_one_row_of_the_sheet():
    def rows(*groups):
        return [{"frame": name} for name, count in groups for _ in range(count)]

    assert sheet_columns(rows(("a", 5), ("b", 5), ("c", 5)), ["frame"]) == 5
    assert sheet_columns(rows(("a", 4), ("b", 4)), ["frame"]) == 8
    assert sheet_columns(rows(("a", 3), ("b", 3)), ["frame"]) == 6
    assert sheet_columns(rows(("a", 3), ("b", 4)), ["frame"]) == 8
    assert sheet_columns(rows(("a", 30), ("b", 30)), ["frame"]) == 8
    assert sheet_columns(rows(("a", 1), ("b", 1)), ["frame"]) == sheet_columns(rows(("a", 9)), []) == 8


def test_a_sheet_of_many_faces_shows_each_shown_face_at_all_its_gains():
    rows = [{"frame": f"f{number}", "gain": gain} for number in range(40) for gain in (0.5, 1.0, 2.0)]
    places = places_shown(rows, ["frame", "gain"])
    assert len(places) == SHOWN_AT_MOST and places[:3] == (0, 1, 2) and places[-1] == 119
    assert all(places[at] % 3 == 0 and places[at + 2] == places[at] + 2 for at in range(0, len(places), 3))
    alone = [{"frame": f"f{number}"} for number in range(200)]
    assert len(places_shown(alone, ["frame"])) == SHOWN_AT_MOST
    assert places_shown(alone[:3], ["frame"]) == (0, 1, 2)


def test_a_page_shows_every_stimulus_and_loads_nothing(any_set):
    page = (any_set / "index.html").read_text(encoding="utf-8")
    for row in rows_of(any_set):
        assert row["name"] in page
    assert "http" not in page.replace("http-equiv", "") and "<script" not in page


@pytest.mark.parametrize("name", ["loadings", "manifest", "steps"])
def test_an_input_is_never_written_over(folder, tmp_path, name):
    for suffix in (".csv", ".json"):
        (tmp_path / f"{name}{suffix}").write_bytes((folder / f"t{suffix}").read_bytes())
    before = bytes_of(tmp_path)
    request = CaricatureRequest(folder / "a.morph", tmp_path, tmp_path / f"{name}.csv", gains=(1.0,))
    if name == "steps":
        planned = result_of(caricature.plan(request))
        steps = write_set(replace(planned, tables={"steps.csv": {"a": [1]}}), tmp_path)
    else:
        steps = caricature.run(request)
    with pytest.raises(
        BadInput, match=f"{name}.csv is one of the inputs and would be replaced. Choose another output"
    ):
        result_of(steps)
    assert bytes_of(tmp_path) == before


def test_a_set_in_the_clips_own_folder_is_refused(folder, tmp_path):
    model = load_model(folder / "a.morph")
    name = model.training.frame_names[0]
    write_image(tmp_path / f"{name}.png", model.render(model.training.values[0]))
    request = PlaceRequest(folder / "a.morph", (str(tmp_path),), tmp_path, folder / "t.csv", frames=(name,))
    with pytest.raises(BadInput, match=f"{name}.png is one of the inputs"):
        result_of(place.run(request))
    pattern = replace(request, clip=(str(tmp_path / "*.png"),))
    with pytest.raises(BadInput, match=f"{name}.png is one of the inputs"):
        result_of(place.run(pattern))


def test_a_set_whose_own_table_is_read_goes_elsewhere(folder, tmp_path):
    made(folder, tmp_path / "out", gains=(1.0,))
    table = tmp_path / "out" / "loadings.csv"
    before = bytes_of(tmp_path)
    with pytest.raises(BadInput, match=r"loadings\.csv is one of the inputs"):
        result_of(render.run(RenderRequest(folder / "a.morph", table, tmp_path / "out")))
    assert bytes_of(tmp_path) == before


@pytest.mark.parametrize(
    "name", ["manifest.csv", "index.html", "loadings.csv", "record.json", "colour_loadings.csv"]
)
def test_a_file_of_somebody_else_is_named_and_stays(folder, tmp_path, name):
    (tmp_path / name).write_bytes(b"{}")
    with pytest.raises(BadInput, match=f"{name} is a file that no earlier caricature wrote"):
        made(folder, tmp_path, gains=(1.0,))
    assert bytes_of(tmp_path) == {name: b"{}"}


def test_a_file_that_a_sets_record_does_not_list_stays(folder, tmp_path):
    made(folder, tmp_path, gains=(1.0,))
    (tmp_path / "colour_loadings.csv").write_bytes(b"mine")
    before = bytes_of(tmp_path)
    with pytest.raises(BadInput, match=r"colour_loadings\.csv is a file that no earlier caricature wrote"):
        made(folder, tmp_path, gains=(1.0,))
    assert bytes_of(tmp_path) == before


@pytest.mark.parametrize(
    "left", ["record.json", "index.html", "loadings.json", "manifest.json", "manifest.csv"]
)
def test_a_stopped_set_resumes(folder, pictures, tmp_path, monkeypatch, left):
    with stopped_at(left, monkeypatch):
        made(folder, tmp_path, gains=(0.5, 1.0, 2.0))
    made(folder, tmp_path, gains=(0.5, 1.0, 2.0))
    assert bytes_of(tmp_path) == bytes_of(pictures)


def test_a_set_that_is_stopped_in_the_folder_of_another_resumes(folder, tmp_path, monkeypatch):
    made(folder, tmp_path / "a", gains=(1.0,))
    made(folder, tmp_path / "a", gains=(1.0,), texture_gains=(2.0,))
    made(folder, tmp_path / "b", gains=(1.0,))
    with stopped_at("record.json", monkeypatch):  # the old record lists no colour_loadings.csv
        made(folder, tmp_path / "b", gains=(1.0,), texture_gains=(2.0,))
    made(folder, tmp_path / "b", gains=(1.0,), texture_gains=(2.0,))
    assert bytes_of(tmp_path / "b") == bytes_of(tmp_path / "a")


@contextlib.contextmanager
def stopped_at(name, monkeypatch):
    """Stop a run when it begins to write the file `name`."""
    whole_file = storage.whole_file

    def stopping(path):
        if path.name == name:
            raise KeyboardInterrupt
        return whole_file(path)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(storage, "whole_file", stopping)
        yield


def placed(folder, output, told):
    model = load_model(folder / "a.morph")
    clip = output / "clip"
    clip.mkdir()
    (clip / "clip.json").write_text(json.dumps(told), encoding="utf-8")
    name = model.training.frame_names[0]
    write_image(clip / f"{name}.png", model.render(model.training.values[0]))
    request = PlaceRequest(folder / "a.morph", (str(clip),), output / "out", folder / "t.csv", frames=(name,))
    outcome = result_of(place.run(request))
    document = read_stimulus_sidecar(output / "out" / f"{name}.json")
    jsonschema.Draft202012Validator(SCHEMA).validate(document)
    again = result_of(
        replay.run(ReplayRequest(output / "out" / f"{name}.json", folder / "a.morph", (str(clip),)))
    )
    assert again.document["same"]
    (row,) = rows_of(output / "out")
    return outcome, document, row, essentials_in(output / "out" / f"{name}.png")


def test_a_face_in_a_picture_of_somebody_else_tells_of_both(folder, tmp_path):
    identity = load_model(folder / "a.morph").identity
    told = {"identity": "other", "consent": "no publication", "licence": "CC0"}
    outcome, document, row, inside = placed(folder, tmp_path, told)
    both = f"{identity}: research; other: no publication"
    assert document["consent"] == row["consent"] == inside["consent"] == both
    assert document["licence"] == row["licence"] == inside["licence"] == "CC0"
    assert row["original_identity"] == inside["original_identity"] == "other" and row["identity"] == identity
    assert any(f"shows other, the model shows {identity}" in note for note in outcome.warnings)


def test_a_face_in_a_picture_of_the_same_person_tells_of_one(folder, tmp_path):
    outcome, document, *_ = placed(folder, tmp_path, {"identity": load_model(folder / "a.morph").identity})
    assert document["consent"] == "research"
    assert not any("the model shows" in note for note in outcome.warnings)


def test_a_caricature_of_somebody_elses_clip_is_noted(folder, tmp_path):
    model = load_model(folder / "a.morph")
    write_image(tmp_path / "a.png", model.reference)
    (tmp_path / "clip.json").write_text('{"identity": "other"}', encoding="utf-8")
    request = CaricatureRequest(folder / "a.morph", tmp_path / "out", clip=(str(tmp_path),), gains=(1.0,))
    assert any("shows other, the model shows" in note for note in result_of(caricature.plan(request)).notes)


def damaged(text):
    """Give a sidecar's text as a disk may give it back."""
    yield ""
    yield text[: len(text) // 2]
    yield text[:-3]
    yield "\0" * len(text)
    yield "[" + text
    yield text.replace('"statistics": {', '"statistics": [', 1)
    yield text.replace('"size": [', '"size": "', 1)


def changed(text):
    """Give a sidecar's text as a user may have edited it; a disk seldom changes it so."""
    yield text.replace('"format"', '"fosmat"')
    yield text.replace('"luminance"', '"luminanca"')
    yield text.replace('"largest_component"', '"largest_componenu"')
    yield text.replace('"research"', '"researcj"')
    yield text.replace('"version": 1', '"version": 3')
    yield text.replace("{", '{"note": "the best of all",', 1)


def test_a_damaged_sidecar_is_made_again(folder, tmp_path):
    made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
    whole = bytes_of(tmp_path)
    sidecar = tmp_path / "frame_001_g1.json"
    for text in damaged(whole[sidecar.name].decode()):
        assert text.encode() != whole[sidecar.name]
        sidecar.write_text(text, encoding="utf-8")
        made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
        assert bytes_of(tmp_path) == whole
    sidecar.write_bytes(b"\xff\xfe")
    made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
    assert bytes_of(tmp_path) == whole


def test_a_changed_sidecar_is_refused_and_stays(folder, tmp_path):
    made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
    sidecar = tmp_path / "frame_001_g1.json"
    whole = sidecar.read_text(encoding="utf-8")
    for text in changed(whole):
        assert text != whole
        sidecar.write_text(text, encoding="utf-8")
        before = bytes_of(tmp_path)
        with pytest.raises(BadInput, match=r"frame_001_g1\.json (was changed since|is a file)"):
            made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
        assert bytes_of(tmp_path) == before


def test_a_cut_sidecar_without_its_picture_is_ours_by_its_start_and_another_is_refused(folder, tmp_path):
    made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
    whole = bytes_of(tmp_path)
    sidecar = tmp_path / "frame_001_g1.json"
    for left in tmp_path.iterdir():
        left.unlink()
    sidecar.write_bytes(whole[sidecar.name][:200])
    made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
    assert bytes_of(tmp_path) == whole
    for left in tmp_path.iterdir():
        left.unlink()
    for content in (b"mine", b"{"):
        sidecar.write_bytes(content)
        with pytest.raises(BadInput, match="no earlier caricature wrote"):
            made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
        assert bytes_of(tmp_path) == {sidecar.name: content}


def edits():
    """What somebody may change in a sidecar whose pictures stay, and what replay says of it."""
    yield ("drawing", "variables", "gain"), 9.0, "variables.gain is 9.0 in the sidecar, '0.5"
    yield (
        ("statistics", "code", "luminance"),
        0.125,
        "statistics.code.luminance is 0.125 in the sidecar, drawn again it is 0.",
    )
    yield ("quality", "largest_sd"), 0.25, "quality.largest_sd is 0.25 in the sidecar, drawn again it is "
    yield ("quality", "beyond"), [1], "quality.beyond is [1] in the sidecar, drawn again it is []"
    yield (
        ("made_from_sha256",),
        "0" * 64,
        "made_from_sha256 is 0000000000000000, the digest of the entries is ",
    )
    yield ("versions", "numpy"), "1.0.0", "the digest of the entries is "
    yield ("inputs", "loadings"), "0" * 64, "the digest of the entries is "
    yield ("request", "gains"), [7.0], "request_sha256 is "
    yield ("consent",), "anything", 'consent is "anything" in the sidecar, "research" in the stimulus'
    yield ("model", "identity"), "other", 'model.identity is "other" in the sidecar, drawn again it is '
    yield ("output", "bytes"), 3, "output.bytes is 3 in the sidecar, drawn again it is "
    yield ("output", "size"), [3, 4], "output.size is [3, 4] in the sidecar, drawn again it is [60, 72]"
    yield ("units", "red"), "pounds", "the digest of the entries is "


@pytest.mark.parametrize(("entry", "value", "said"), list(edits()))
def test_replay_names_an_entry_that_was_edited(folder, pictures, tmp_path, entry, value, said):
    name = rows_of(pictures)[0]["name"]
    for file in (f"{name}.png", "manifest.csv"):
        (tmp_path / file).write_bytes((pictures / file).read_bytes())
    document = json.loads((pictures / f"{name}.json").read_text(encoding="utf-8"))
    (tmp_path / f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
    request = ReplayRequest(tmp_path / f"{name}.json", folder / "a.morph")
    assert result_of(replay.run(request)).document["same"]
    *path, last = entry
    place = document
    for key in path:
        place = place[key]
    place[last] = value
    (tmp_path / f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
    outcome = result_of(replay.run(request))
    assert not outcome.document["same"]
    assert any(said in line for line in outcome.document["differences"]), outcome.lines


def test_replay_says_other_versions_that_gave_the_same_bytes(folder, tmp_path, monkeypatch):
    elsewhere = {**versions(), "numpy": "1.0.0"}
    monkeypatch.setattr("morphspace.sets.plan.versions", lambda: elsewhere)
    made(folder, tmp_path, gains=(1.0,), frames=("frame_001",))
    outcome = result_of(replay.run(ReplayRequest(tmp_path / "frame_001_g1.json", folder / "a.morph")))
    assert outcome.document["same"] and outcome.document["differences"] == []
    assert "numpy was 1.0.0, here it is" in outcome.lines[1]


def test_replay_of_a_folder_or_a_stimulus_says_what_to_give(pictures, tmp_path):
    name = rows_of(pictures)[0]["name"]
    with pytest.raises(BadInput, match=r"is a folder. Give the \.json beside"):
        result_of(replay.run(ReplayRequest(pictures)))
    with pytest.raises(BadInput, match=rf"Give the \.json beside it, .*{name}\.json"):
        result_of(replay.run(ReplayRequest(pictures / f"{name}.png")))
    (tmp_path / "alone.png").write_bytes((pictures / f"{name}.png").read_bytes())
    with pytest.raises(BadInput, match="which is missing"):
        result_of(replay.run(ReplayRequest(tmp_path / "alone.png")))
