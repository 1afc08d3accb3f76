"""mimic from files to files: what it writes, what it says, and what it refuses."""

import dataclasses
import gc
import json
import shutil
import weakref
from typing import get_args

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose

from morphspace.cli.main import main
from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.face import anchor
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import (
    LEFT_LIDS,
    LOWER_LIP_TOP,
    POINT_COUNT,
    RIGHT_LIDS,
    UPPER_LIP_BOTTOM,
    FacePoints,
)
from morphspace.face.regions import face_mask
from morphspace.io.clips import open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.io.images import read_image, write_image
from morphspace.io.tables import read_loadings_table, read_metrics_table
from morphspace.io.video import video_info
from morphspace.linear.pca import fit_basis
from morphspace.linear.rows import RowArray
from morphspace.model.encode import notes_on_frames, notes_on_framing
from morphspace.model.keypoints import how_to_learn, required_landmarks
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, load_model, model_digest
from morphspace.model.morph import Morph, inner_product
from morphspace.report.mimic_page import HEADINGS, LEFT_OUT
from morphspace.requests import field_named
from morphspace.sets import mimicry, models
from morphspace.sets.mimicry import FinishedFrames, frame_steps
from morphspace.steps import result_of, worker_count
from morphspace.storage import MARK_NAME
from morphspace.transfer import neutral
from morphspace.transfer.driver import Driver
from morphspace.transfer.mimicry import MAX_SD, METHODS, auto_gain, mimic
from morphspace.transfer.quality import Quality, Reach, reach_of
from morphspace.transfer.quality_table import (
    COLUMNS,
    DECIMALS,
    MIMICRY,
    OUT_OF_RANGE,
)
from morphspace.verbs import mimic as verb
from morphspace.verbs.mimic import MimicRequest

ROUNDING = 0.51 / 255  # of an 8-bit file
LOOSE = 1000.0  # SD; a bound that bounds nothing here
UNGUIDED = tuple(method for method in METHODS if method != "guided")  # which wants landmarks of both models


@pytest.fixture(autouse=True)
def without_networks(monkeypatch, tmp_path):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "none"))


@pytest.fixture(scope="session")
def actor(model):
    """The drawn model with keypoints."""
    return model.with_faceframe(FaceFrame((20.0, 28.0), (40.0, 28.0), (30.0, 44.0)))


@pytest.fixture(scope="session")
def other(picture, wavy_field):
    """Another face of another size, which moves otherwise."""
    height, width = 60, 48
    rng = np.random.default_rng(3)
    amounts = rng.standard_normal((10, 2))
    amounts -= amounts.mean(axis=0)
    face = picture(height, width, seed=11)
    fields = [wavy_field(height, width, 1.5, seed=seed) for seed in (4, 5)]
    rows = [Morph.of(face, a * fields[0] + b * fields[1], "").vector for a, b in amounts]
    mask = face_mask(height, width)
    mean, basis, loadings = fit_basis(RowArray(np.stack(rows)), inner_product(mask, 0.1), 5)
    mean_morph = Morph(mean, (height, width), "aa00112233445566")
    provenance = {
        "identity": "other",
        "framing": {"source_size": [width, height], "crop": None, "size": [width, height]},
        "reference": {"frame": "f0", "reason": "named by the setting reference", "sha256": "0" * 64},
        "versions": {},
    }
    names = tuple(f"o_{index:02d}" for index in range(len(rows)))
    model_id = model_digest(basis, mean_morph, provenance)
    return MorphModel(
        mean=mean_morph,
        basis=basis,
        warp_weight=0.1,
        mask=mask,
        reference=mean_morph.render(),
        mean_inverse=np.zeros((height, width, 2), np.float32),
        faceframe=FaceFrame((16.0, 22.0), (32.0, 22.0), (24.0, 36.0)),
        reference_faceframe=None,
        training=Loadings(loadings, names, model_id),
        registration="none",
        flow="dis",
        provenance=provenance,
    )


@pytest.fixture
def work(actor, other, tmp_path):
    """A folder with two models."""
    actor.save(tmp_path / "a.morph")
    other.save(tmp_path / "b.morph")
    return tmp_path


def clip(folder, model, loadings, name="clip", rate_hz=None):
    place = folder / name
    place.mkdir()
    for index, row in enumerate(loadings):
        write_image(place / f"{name}_{index:03d}.png", model.render(row), bits=16)
    if rate_hz:
        (place / "clip.json").write_text(json.dumps({"frame_rate_hz": rate_hz}))
    return str(place)


def run(work, source="a", target="b", detector=None, **more):
    more.setdefault("output", work / "out")
    request = MimicRequest(str(work / f"{source}.morph"), str(work / f"{target}.morph"), **more)
    return result_of(verb.run(request, detector))


def points(yaw_deg=0.0, opening_px=2.0):
    """Points of a face that is turned so far, as a detector gives them."""
    rng = np.random.default_rng(0)
    x = rng.uniform(10, 50, (POINT_COUNT, 2))
    x[list(RIGHT_LIDS)], x[list(LEFT_LIDS)] = (21, 28), (39, 28)
    x[[33, 133, 362, 263]] = (18, 28), (24, 28), (36, 28), (42, 28)
    for right, left in ((127, 356), (234, 454), (162, 389)):
        x[right], x[left] = (14, 34), (46, 34)
    x[[98, 2, 327]] = (27, 42), (30, 42), (33, 42)
    x[UPPER_LIP_BOTTOM], x[LOWER_LIP_TOP] = (30, 48), (30, 48 + opening_px)
    depth = np.tan(np.radians(yaw_deg)) * (x[:, 0] - 30)
    depth[[98, 2, 327]] -= np.tan(np.radians(23.5)) * 14
    return FacePoints(x, 0.9, depth=depth)


def test_mimic_of_self_is_reconstruction(work, actor):
    run(work, target="a", method="paper", max_sd=LOOSE)
    found = read_loadings_table(work / "out" / "loadings.csv")
    assert found.frame_names == actor.training.frame_names
    assert_allclose(found.loadings_sd, actor.training.values / actor.sd, atol=1e-4)
    for name, row in zip(actor.training.frame_names, actor.training.values, strict=True):
        drawn = np.clip(actor.render(row), 0, 1)
        assert np.abs(read_image(work / "out" / "frames" / f"{name}.png") - drawn).max() < ROUNDING + 1e-3
    assert found.document["model_id"] == actor.model_id


def test_a_clip_drives_itself_back(work, actor):
    loadings = 0.8 * actor.training.values[:4]
    given = clip(work, actor, loadings, rate_hz=20)
    run(work, target="a", frames=given, method="paper", max_sd=LOOSE)
    found = read_loadings_table(work / "out" / "loadings.csv")
    truth = loadings / actor.sd
    assert np.corrcoef(found.loadings_sd[:, 0], truth[:, 0])[0, 1] > 0.95  # the flow is on 60 x 72 px
    assert found.document["frame_rate_hz"] == 20
    assert video_info(work / "out" / "side-by-side.mp4").frame_rate_hz == 20


@pytest.mark.parametrize("method", UNGUIDED)
def test_gain_0_is_the_mean_of_the_target(work, other, method):
    run(work, gain=0.0, method=method)
    mean = np.clip(other.mean.render(), 0, 1)
    for path in (work / "out" / "frames").iterdir():
        assert np.abs(read_image(path) - mean).max() < ROUNDING
    assert not read_loadings_table(work / "out" / "loadings.csv").loadings_sd.any()


def test_every_output_is_there_with_its_name_and_size(work, actor, other):
    outcome = run(work)
    out = work / "out"
    frames = sorted(path.name for path in (out / "frames").iterdir())
    assert frames == [f"{name}.png" for name in actor.training.frame_names]
    assert all(read_image(out / "frames" / name).shape == (60, 48, 3) for name in frames)
    info = video_info(out / "side-by-side.mp4")
    assert info.frame_count == len(frames)
    assert info.size == (50 + 4 + 48, 60)  # 60 x 72 brought to the height of 60
    record = json.loads((out / "record.json").read_text())
    lying = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()} - {"record.json"}
    assert set(record["outputs"]) == lying
    assert lying - {f"frames/{name}" for name in frames} == {
        "index.html",
        "loadings.csv",
        "loadings.json",
        "quality.csv",
        "quality.json",
        "side-by-side.mp4",
    }
    assert any("resampled" in note and "60x72" in note and "48x60" in note for note in outcome.warnings)
    page = (out / "index.html").read_text()
    assert page.count("data:image/jpeg") == len(frames) and "http" not in page.replace("http-equiv", "")


def test_every_column_of_quality_is_described(work):
    run(work)
    table = read_metrics_table(work / "out" / "quality.csv")
    told = MIMICRY.read(work / "out" / "quality.json")
    assert list(table) == list(COLUMNS) and set(told["columns"]) == set(table)
    fields = {entry.name for kind in (Quality, Reach) for entry in dataclasses.fields(kind)}
    assert fields <= set(COLUMNS) and fields == set(HEADINGS) - {
        "outside_source",
        "yaw_deg",
        "pitch_deg",
    } | set(LEFT_OUT)


def test_the_same_request_gives_the_same_bytes(work):
    contents = []
    for _ in range(2):
        run(work)
        contents.append({path: path.read_bytes() for path in (work / "out").rglob("*") if path.is_file()})
    assert contents[0] == contents[1]


def test_the_first_components_alone_move(work, other):
    run(work, components=1, max_sd=LOOSE, method="map")
    found = read_loadings_table(work / "out" / "loadings.csv")
    assert found.loadings_sd.shape == (12, 1)
    drawn = np.clip(other.render(found.loadings_sd[0] * other.sd[:1]), 0, 1)
    assert np.abs(read_image(work / "out" / "frames" / "frame_000.png") - drawn).max() < ROUNDING


def test_a_stopped_run_goes_on_and_gives_the_same_bytes(work, monkeypatch):
    run(work, output=work / "whole")
    steps = verb.run(MimicRequest(str(work / "a.morph"), str(work / "b.morph"), work / "out"))
    for step in steps:
        if step.stage == "mimic" and step.done == 5:
            steps.close()
    assert not (work / "out" / "quality.csv").exists() and not (work / "out" / "record.json").exists()
    (work / "out" / "frames" / "frame_001.png").unlink()
    written = []
    monkeypatch.setattr(
        mimicry,
        "write_image",
        lambda path, image: (written.append(path.name), write_image(path, image))[1],
    )
    run(work)
    assert "frame_001.png" in written and "frame_000.png" not in written and len(written) <= 12 - 4
    for path in (work / "whole").rglob("*"):
        if path.is_file():
            assert path.read_bytes() == (work / "out" / path.relative_to(work / "whole")).read_bytes(), path
    assert not (work / "out" / "mimic.work").exists()


def test_other_settings_do_not_take_over_finished_frames(work):
    steps = verb.run(MimicRequest(str(work / "a.morph"), str(work / "b.morph"), work / "out"))
    for step in steps:
        if step.done == 5:
            steps.close()
    run(work, gain=0.5)
    run(work, gain=0.5, output=work / "fresh")
    for name in ("loadings.csv", "quality.csv", "frames/frame_000.png"):
        assert (work / "out" / name).read_bytes() == (work / "fresh" / name).read_bytes()


def test_a_long_clip_holds_a_few_frames_at_a_time(work, actor, other):
    """Whatever the clip's length, no more pictures are alive than the threads and their queue hold."""
    total, alive, most = 40, [0], [0]
    shape = actor.mask.shape

    def gone():
        alive[0] -= 1

    def given(places):
        for _ in places:
            image = np.full((*shape, 3), 0.5, np.float32)
            alive[0] += 1
            most[0] = max(most[0], alive[0])
            weakref.finalize(image, gone)
            yield image
            del image

    def offset(name, image, found):
        return actor.mean - actor.mean

    names = tuple(f"f{index}" for index in range(total))
    driver = Driver("long", names, names, {}, None, given, offset, lambda image: image)
    pictures = tuple(work / "frames" / f"{name}.png" for name in names)
    finished = FinishedFrames(work / "work", [], driver, pictures)
    made = result_of(frame_steps(actor, mimic(actor, other), reach_of(actor, other, 1.0), finished, None))
    gc.collect()
    assert len(made) == total and alive[0] <= 1
    result_of(mimicry.video_steps(driver, pictures, work / "v.mp4"))
    assert most[0] <= 3 * (worker_count() + 2)


def test_a_frame_without_a_face_and_a_turned_one_are_marked_and_the_clip_goes_on(work, actor):
    given = clip(work, actor, 0.5 * actor.training.values[:4])
    mean = np.clip(actor.mean.render(), 0, 1)
    seen = [read_image(path) for path in sorted((work / "clip").glob("*.png"))]

    def detector(image):
        place = next((i for i, frame in enumerate(seen) if np.array_equal(frame, image)), None)
        return {1: None, 2: points(yaw_deg=30)}.get(place, points())

    assert detector(mean) is not None
    outcome = run(work, frames=given, detector=detector)
    table = read_metrics_table(work / "out" / "quality.csv")
    flags = [set(words.split()) & {"no-face", "turned"} for words in table["flags"]]
    assert flags == [set(), {"no-face"}, {"turned"}, set()]
    assert_allclose(table["yaw_deg"], [0, np.nan, 30, 0], atol=2)
    assert outcome.document["no_face"] == 1 and outcome.document["frames"] == 4
    assert any("1 of 4 frames show no face" in note for note in outcome.warnings)


def test_a_driving_frame_is_looked_at_once(work, actor, monkeypatch):
    """Where the source aligns with the same detector; the files are those of a run that looks twice."""
    told = {**actor.provenance, "landmarks": {"reference_has_face": True, "anchored": False}}
    dataclasses.replace(actor, provenance=told, registration="similarity").save(work / "held.morph")
    given = clip(work, actor, 0.5 * actor.training.values[:4])
    looked = []

    def find(image):
        looked.append(image)
        return points(yaw_deg=5)

    detector, other = (Detector(find, {"version": version}) for version in (1, 2))
    monkeypatch.setattr(anchor, "load_detector", lambda person: detector)
    monkeypatch.setattr("morphspace.face.detector.own_detector", lambda: Detector(find, {"version": 1}))
    run(work, source="held", frames=given)
    assert len(looked) == 1 + 2 + 4  # the reference, both means, each frame
    looked.clear()
    run(work, source="held", frames=given, detector=other, output=work / "twice")
    assert len(looked) == 1 + 2 + 2 * 4
    for name in ("loadings.csv", "quality.csv", *(f"frames/clip_{index:03d}.png" for index in range(4))):
        assert (work / "out" / name).read_bytes() == (work / "twice" / name).read_bytes()


def test_a_turned_training_frame_is_marked_when_it_drives(work, actor):
    """It is looked at as its loadings draw it; one that the detector does not find there is not marked for that."""
    pictures = [actor.render(row) for row in actor.training.values]

    def detector(image):
        place = next((i for i, picture in enumerate(pictures) if np.array_equal(picture, image)), None)
        return {1: None, 2: points(yaw_deg=30)}.get(place, points())

    outcome = run(work, detector=detector)
    table = read_metrics_table(work / "out" / "quality.csv")
    flags = [set(words.split()) & {"no-face", "turned"} for words in table["flags"]]
    assert flags == [{"turned"} if place == 2 else set() for place in range(len(pictures))]
    assert np.isnan(table["yaw_deg"][1]) and table["yaw_deg"][2] == pytest.approx(30, abs=2)
    assert outcome.document["no_face"] == 0 and outcome.document["turned"] == 1


def test_means_of_other_expressions_are_said(work, actor, other):
    def detector(image):
        return points(opening_px=6.0 if image.shape[0] == 72 else 1.0)

    outcome = run(work, detector=detector)
    assert any(
        "the mouth's opening is 33% of the eye distance in drawn, 6% in other" in note
        for note in outcome.warnings
    )


def test_without_networks_what_was_left_out_is_said(work, actor):
    assert any("morphspace models fetch" in note for note in run(work).warnings)
    given = clip(work, actor, 0.5 * actor.training.values[:2])
    assert any("shows a face" in note and "models fetch" in note for note in run(work, frames=given).warnings)


def test_a_detector_that_does_not_know_the_source_is_not_believed(work, actor):
    given = clip(work, actor, 0.5 * actor.training.values[:2])
    outcome = run(work, frames=given, detector=lambda image: None)
    assert outcome.document["no_face"] == 0
    assert any("finds no face in the mean of drawn" in note for note in outcome.warnings)


def test_little_motion_kept_is_said(work, actor):
    assert not any(
        "of the motion's energy" in note for note in run(work, target="a", method="paper").warnings
    )
    assert any("of the motion's energy" in note for note in run(work, components=1, gain=1.0).warnings)
    assert not any("of the motion's energy" in note for note in run(work, components=1, gain=0.0).warnings)


def test_pictures_of_an_earlier_run_go_and_those_of_others_stop_the_next(work, actor):
    run(work)
    given = clip(work, actor, 0.5 * actor.training.values[:2])
    run(work, frames=given)
    frames = sorted(path.name for path in (work / "out" / "frames").iterdir())
    assert frames == ["clip_000.png", "clip_001.png"]
    (work / "out" / "frames" / "mine.png").write_bytes(b"mine")
    with pytest.raises(BadInput, match=r"mine\.png is a file that no earlier mimic wrote"):
        run(work, frames=given)


@pytest.mark.parametrize("name", ["frames/old.png", "loadings.csv", "index.html", "side-by-side.mp4"])
def test_what_no_run_of_mimic_wrote_is_neither_replaced_nor_mixed(work, name):
    mine = work / "out" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    with pytest.raises(BadInput, match="no earlier mimic wrote") as refusal:
        run(work)
    assert name.split("/")[0] in str(refusal.value) and "\n" not in str(refusal.value)
    assert [path for path in (work / "out").rglob("*") if path.is_file()] == [mine]
    assert mine.read_text() == "mine"


def test_a_folder_of_another_verb_is_not_taken_for_ours_and_other_files_may_lie_there(work):
    (work / "out").mkdir()
    (work / "out" / "notes.txt").write_text("mine")
    run(work)
    assert (work / "out" / "notes.txt").read_text() == "mine"
    (work / "out" / "record.json").write_text(json.dumps({"format": "morphspace-record", "verb": "render"}))
    with pytest.raises(BadInput, match="no earlier mimic wrote"):
        run(work)


def test_an_out_of_range_frame_is_flagged_and_stays_inside_the_bound(work):
    for gain in (0.2, 8.0):
        run(work, target="a", method="paper", gain=gain)
        table = read_metrics_table(work / "out" / "quality.csv")
        missing = np.array(table["missing_motion"])
        assert [("out-of-range" in words) for words in table["flags"]] == (missing > OUT_OF_RANGE).tolist()
        assert (missing > OUT_OF_RANGE).any() == (gain > 1)
    assert np.abs(read_loadings_table(work / "out" / "loadings.csv").loadings_sd).max() < 3


def test_what_a_target_cannot_show_is_missing_and_oneself_misses_nothing(work, actor):
    offset = actor.offset(actor.training.values[2])
    loadings = actor.training.values[2]

    def judged(asked_gain, method="transfer", **settings):
        made = mimic(actor, actor, method, **settings)(offset)
        return reach_of(actor, actor, asked_gain)(offset, made.morph, made.loadings, loadings)

    own = judged(1.0, "paper", max_sd=LOOSE)
    assert own.missing_motion < 0.01 and own.colour_agreement == pytest.approx(1, abs=0.02)
    still = judged(1.0, gain=0.0)
    lengths = np.hypot(*np.moveaxis(offset.displacement[actor.mask > 0.9], -1, 0))
    assert still.missing_motion == pytest.approx(np.quantile(lengths, 0.95) / 20, rel=0.3)
    assert still.colour_agreement == 0
    anti = judged(1.0, "paper", gain=-1.0, max_sd=LOOSE)
    assert anti.colour_agreement == pytest.approx(-own.colour_agreement, abs=0.02)
    assert anti.missing_motion == pytest.approx(2 * still.missing_motion, rel=0.05)
    asked = judged(-1.0, "paper", gain=-1.0, max_sd=LOOSE)
    assert asked.missing_motion < 0.01


def test_negative_shares_stand_in_the_file_and_read_as_none_on_the_page(work):
    run(work, target="a", method="paper", gain=-1.0, max_sd=LOOSE)
    table = read_metrics_table(work / "out" / "quality.csv")
    assert max(table["warp_kept"]) < 0 and max(table["texture_kept"]) < 0
    page = (work / "out" / "index.html").read_text()
    first = page[page.index("<dl") : page.index("</dl>")]
    assert "<dd>0 %</dd>" in first and "-" not in first.split("motion")[0].split("<dd>")[-1]
    assert "colour kept" not in page


def test_a_model_is_built_of_a_clip_and_found_again(work, actor, monkeypatch):
    given = clip(work, actor, actor.training.values[:6])
    faceframe = {"right_eye": [20, 28], "left_eye": [40, 28], "philtrum": [30, 44], "frame": "clip_000.png"}
    (work / "clip" / "clip.json").write_text(json.dumps({"faceframe": faceframe}))
    request = MimicRequest(given, str(work / "b.morph"), work / "out")
    result_of(verb.run(request))
    built = work / "out" / "models" / "clip.morph"
    assert built.is_file() and not list(built.parent.glob("*.work"))

    def never(*given):
        raise AssertionError("it was built again")
        yield

    monkeypatch.setattr(models, "written_model", never)
    result_of(verb.run(request))
    shutil.rmtree(work / "out" / "models")
    with pytest.raises(AssertionError, match="built again"):
        result_of(verb.run(request))


def test_a_clip_without_keypoints_needs_the_networks_and_says_so(work, actor):
    given = clip(work, actor, actor.training.values[:3])
    with pytest.raises(BadInput, match="morphspace models fetch"):
        result_of(verb.run(MimicRequest(given, str(work / "b.morph"), work / "out")))
    assert not (work / "out").exists()


def test_a_model_without_keypoints_says_the_command(work, model):
    model.save(work / "bare.morph")
    for source, target in (("bare", "b"), ("a", "bare")):
        with pytest.raises(BadInput, match=r"morphspace keypoints \S*bare\.morph --auto"):
            run(work, source, target)
    assert not (work / "out").exists()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"method": "magic"}, "method is 'magic'; expected one of auto, paper, map"),
        ({"gain": float("nan")}, "gain is nan; expected a number"),
        ({"gain": float("inf")}, "gain is inf"),
        ({"gain": -1e30}, "gain is -1e+30"),
        ({"gain": 1001.0}, "from -1,000 to 1,000, or auto"),
        ({"max_sd": 0.0}, "max_sd is 0.0"),
        ({"max_sd": float("nan")}, "max_sd is nan"),
        ({"max_sd": 1e9}, "from 0.001 to 1,000"),
        ({"frames": ""}, "frames is empty; expected a text"),
        ({"components": 0}, "components is 0; expected a whole number from 1 up"),
        ({"method": "guided"}, "a.morph --auto`"),
        ({"neutral": "a,b,c"}, "--neutral is 'a,b,c'"),
        ({"neutral": ""}, "neutral is empty"),
        ({"neutral": "auto,frame_001"}, "--neutral is 'auto,frame_001'"),
        ({"neutral": "nowhere"}, "no training frame 'nowhere'"),
        ({"neutral": "mean,nowhere"}, "no training frame 'nowhere'"),
        ({"source": "missing"}, "missing.morph"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_is_written(work, more, words):
    with pytest.raises(BadInput) as refusal:
        run(work, **more)
    assert words in str(refusal.value) and "\n" not in str(refusal.value)
    assert not (work / "out").exists()


def test_more_components_than_there_are_is_all_of_them_and_is_said(work):
    outcome = run(work, components=3, method="paper")
    assert "3 components were requested; other has 2, and all are used" in outcome.warnings
    frames = {path.name: path.read_bytes() for path in (work / "out" / "frames").iterdir()}
    assert not any("components were requested" in note for note in run(work, method="paper").warnings)
    assert {path.name: path.read_bytes() for path in (work / "out" / "frames").iterdir()} == frames


def test_tiny_driving_frames_are_said_to_be_enlarged_and_tinier_ones_refused(work, picture):
    for width, height in ((36, 43), (30, 36)):
        (work / f"w{width}").mkdir()
        write_image(work / f"w{width}" / "f.png", picture(height, width))
    (note,) = (n for n in run(work, frames=str(work / "w36")).warnings if "driving frames of 36x43" in n)
    assert "enlarged to 60x72" in note and "lost" not in note
    with pytest.raises(
        BadInput, match=r"pictures in w30 are 30x36 px; expected at least 32 px .* drawn at 60x72"
    ):
        run(work, frames=str(work / "w30"), output=work / "new")
    assert not (work / "new").exists()
    framing = Framing((36, 43), None, (200, 240))
    assert "enlarged to 201x240" in notes_on_framing(framing, "x")[0]
    assert "5.6 times, and small motions are lost" in notes_on_framing(framing, "x")[0]
    large = FramedClip(open_clip([str(work / "w36")]), Framing((400, 480), None, (200, 240)))
    assert notes_on_frames(large, "x") == ()
    said = dataclasses.replace(large, clip=dataclasses.replace(large.clip, notes=("6 .HEIC",)))
    assert notes_on_frames(said, "x") == ("6 .HEIC",)


def test_driving_frames_of_another_person_are_said_to_be(work, actor, other):
    """By how much of them the source's model cannot show; its own frames drive without a word."""
    own = clip(work, actor, 0.7 * actor.training.values[:4])
    assert not any("another person" in note for note in run(work, frames=own).warnings)
    table = read_metrics_table(work / "out" / "quality.csv")
    assert np.median(table["outside_source"]) < 0.5  # variances of the training faces; the flow errs on 60 px
    strangers = clip(work, other, other.training.values[:4], name="strangers")
    outcome = run(work, frames=strangers)
    (note,) = (note for note in outcome.warnings if "another person" in note)
    assert "than drawn" in note and "outside_source" in note
    assert min(read_metrics_table(work / "out" / "quality.csv")["outside_source"]) > 1
    assert not any("on average the frames drive" in note for note in outcome.warnings)
    run(work)
    assert not any(read_metrics_table(work / "out" / "quality.csv")["outside_source"])  # empty cells


def test_figures_are_written_to_what_they_are_good_for(work, actor):
    run(work, frames=clip(work, actor, 0.5 * actor.training.values[:3]))
    lines = (work / "out" / "quality.csv").read_text().splitlines()
    cells = [cell for line in lines[1:] for cell in line.split(",")[1:]]
    assert max(len(cell.partition(".")[2]) for cell in cells) <= 6
    assert set(DECIMALS) == set(COLUMNS) - {"frame", "bounded", "flags"}


def test_a_clip_without_a_face_is_refused_before_a_model_is_built_of_it(work, actor):
    given = clip(work, actor, actor.training.values[:3])
    looked = []

    def blind(picture):
        looked.append(picture)

    with pytest.raises(BadInput, match=r"--dst clip is a clip, but none of 3 frames .* clip\.json"):
        request = MimicRequest(str(work / "a.morph"), given, work / "out")
        result_of(verb.run(request, blind))
    assert len(looked) == 3 and not (work / "out").exists()


def test_a_refusal_says_which_models_stay_and_the_next_run_takes_them(work, actor, monkeypatch):
    given = clip(work, actor, actor.training.values)
    seen = []

    def one_face(picture):  # enough for a build, too few for keypoints
        seen.append(picture)
        return points() if len(seen) == 1 else None

    request = MimicRequest(str(work / "a.morph"), given, work / "out")
    with pytest.raises(BadInput, match=r"expected at least half.*stay in .*models \(clip\.morph\)"):
        result_of(verb.run(request, one_face))
    stays = work / "out" / "models" / "clip.morph"
    assert load_model(stays).faceframe is None
    assert not (work / "out" / "frames").exists()
    load_model(stays).with_faceframe(actor.faceframe).save(stays)
    before = stays.read_bytes()
    result_of(verb.run(request, lambda picture: None))
    assert stays.read_bytes() == before


def test_an_empty_clip_is_refused(work):
    (work / "empty").mkdir()
    for given in ("empty", "nowhere"):
        with pytest.raises(BadInput, match=given):
            run(work, frames=str(work / given))


def test_a_file_where_the_folder_should_be_is_refused(work):
    (work / "out").write_text("mine")
    with pytest.raises(UnwritableFile, match="is a file; expected a folder"):
        run(work)
    assert (work / "out").read_text() == "mine"


def test_inputs_are_never_written_over(work, actor):
    run(work)
    frames = work / "out" / "frames"
    before = {path: path.read_bytes() for path in frames.iterdir()}
    with pytest.raises(BadInput, match="one of the inputs"):
        run(work, frames=str(frames))
    with pytest.raises(BadInput, match="one of the inputs"):
        run(work, frames=str(work / "out" / "side-by-side.mp4"))
    assert {path: path.read_bytes() for path in frames.iterdir()} == before


def test_a_refusal_leaves_no_folder_behind(work, actor, other):
    origin = {"source": "set", "lip": "upper-lip"}
    other.with_faceframe(FaceFrame((16.0, 22.0), (32.0, 22.0), (24.0, 36.0)), origin).save(work / "lip.morph")
    for more in ({"target": "lip"}, {"neutral": "nowhere"}, {"frames": str(work / "none")}):
        with pytest.raises(BadInput):
            run(work, output=work / "deep" / "out", **more)
        assert not (work / "deep").exists()
    (work / "deep" / "out").mkdir(parents=True)
    with pytest.raises(BadInput):
        run(work, output=work / "deep" / "out", target="lip")
    assert (work / "deep" / "out").is_dir() and not any((work / "deep" / "out").iterdir())


def test_a_damaged_driving_frame_is_named_and_leaves_no_record(work, actor):
    given = clip(work, actor, actor.training.values[:3])
    bad = work / "clip" / "clip_002.png"
    bad.write_bytes(bad.read_bytes()[:-300])
    with pytest.raises(UnreadableFile, match=r"clip_002\.png"):
        run(work, frames=given)
    assert not (work / "out" / "record.json").exists()


def test_the_words_of_methods_are_the_methods():
    method = field_named(verb.MimicRequest, "method")
    assert get_args(method.kind) == (mimicry.BEST, *METHODS)
    assert method.default == mimicry.BEST and field_named(verb.MimicRequest, "max_sd").default == MAX_SD


def test_the_method_is_guided_only_where_both_know_their_landmarks(work):
    outcome = run(work)
    assert json.loads((work / "out" / "quality.json").read_text())["method"] == "transfer"
    (note,) = (note for note in outcome.warnings if "the method is transfer" in note)
    assert "`morphspace keypoints a.morph --auto`" in note and "keypoints b.morph --auto" in note
    assert not any("method is" in note for note in run(work, method="transfer").warnings)


def test_the_command_line_exits_3_where_a_frame_shows_no_face(work, monkeypatch, actor):
    given = clip(work, actor, 0.5 * actor.training.values[:2])
    words = [
        "mimic",
        "--src",
        work / "a.morph",
        "--dst",
        work / "b.morph",
        "-o",
        work / "out",
        "--frames",
        given,
    ]
    calls = []

    def detector(image):  # finds a face in the two means, and in nothing else
        calls.append(image)
        return points() if len(calls) <= 2 else None

    assert CliRunner().invoke(main, list(map(str, words))).exit_code == 0
    monkeypatch.setattr("morphspace.face.detector.own_detector", lambda: detector)
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exit_code == 3, result.output
    assert "2 of 2 frames show no face" in result.stderr
    refused = CliRunner().invoke(main, [*map(str, words), "--max-sd", "0"])
    assert refused.exit_code == 2 and len(refused.stderr.strip().splitlines()) == 1


def test_the_automatic_gain_is_found_and_told(work, other):
    run(work, gain="auto", components=1)
    told = json.loads((work / "out" / "record.json").read_text())["settings"]
    expected = auto_gain(load_model(work / "a.morph"), other.truncate(1))
    assert told["gain"] == pytest.approx(expected)


def test_named_resting_frames_show_each_other(work, actor, other):
    """The source's neutral frame becomes the target's, and the rest follows from there."""
    outcome = run(work, neutral="frame_003,o_02", method="paper", max_sd=LOOSE)
    found = read_loadings_table(work / "out" / "loadings.csv")
    assert_allclose(found.loadings_sd[3], other.training.values[2] / other.sd, atol=1e-5)
    assert any(
        "source is re-centred on frame frame_003 of drawn and the target is re-centred on frame o_02 of other"
        in n
        for n in outcome.warnings
    )
    missing = read_metrics_table(work / "out" / "quality.csv")["missing_motion"]
    assert missing[3] < 1e-6 and min(missing[:3]) > 1e-3
    kept = read_metrics_table(work / "out" / "quality.csv")["warp_kept"]
    run(work, neutral="frame_003", method="paper", max_sd=LOOSE)
    assert_allclose(read_metrics_table(work / "out" / "quality.csv")["warp_kept"], kept, atol=1e-4)
    run(work, neutral="frame_003,o_02", method="paper", max_sd=LOOSE)
    told = json.loads((work / "out" / "quality.json").read_text())["neutral"]
    assert (told["source_frame"], told["target_frame"]) == ("frame_003", "o_02")
    run(work, neutral="frame_003", method="paper", max_sd=LOOSE)
    assert_allclose(read_loadings_table(work / "out" / "loadings.csv").loadings_sd[3], 0, atol=1e-6)


def test_the_means_are_moved_where_they_lie_apart_and_not_where_it_is_forbidden(
    work, actor, other, monkeypatch
):
    apart = np.full(len(actor.training.values), 0.09)
    apart[5] = 0.04
    monkeypatch.setattr(neutral, "_lips_apart", lambda *faces: apart)
    monkeypatch.setattr(neutral, "means_apart", lambda source, target: 0.09)
    notes = run(work, method="paper", max_sd=LOOSE).warnings
    assert_allclose(read_loadings_table(work / "out" / "loadings.csv").loadings_sd[5], 0, atol=1e-6)
    assert any("on frame frame_005" in note and "9.0% of the eye distance" in note for note in notes)
    assert "frame_005" in (work / "out" / "index.html").read_text()
    notes = run(work, method="paper", max_sd=LOOSE, neutral="mean").warnings
    assert not any("re-centred" in note for note in notes)
    assert any("9.0% of the eye distance apart; expected at most 6.0%" in note for note in notes)
    apart[5] = 0.09
    assert any("no frame of drawn comes much nearer" in note for note in run(work).warnings)
    monkeypatch.setattr(neutral, "means_apart", lambda source, target: 0.03)
    assert not any("eye distance apart" in note for note in run(work).warnings)
    run(work, method="paper", max_sd=LOOSE, neutral="mean")
    assert np.abs(read_loadings_table(work / "out" / "loadings.csv").loadings_sd[5]).max() > 0.01


@pytest.mark.parametrize(
    ("size", "words"),
    [
        ((60, 72), None),
        ((120, 144), "of 120x144 are scaled to 60x72, as"),
        ((90, 72), "of 90x72 are cropped to the middle 60x72, as"),
        ((120, 200), "of 120x200 are scaled to 60x100 and cropped to the middle 60x72, as"),
    ],
)
def test_what_was_done_to_driving_frames_is_said_and_nothing_else(work, picture, size, words):
    place = work / "sized"
    place.mkdir()
    write_image(place / "f.png", picture(size[1], size[0]))
    notes = [note for note in run(work, frames=str(place)).warnings if note.startswith("driving frames")]
    assert len(notes) == (words is not None)
    assert words is None or words in notes[0]


def test_after_an_error_the_mended_command_goes_on(work, actor):
    """The folder is marked as ours before there is a picture, however early the run fails."""
    given = clip(work, actor, actor.training.values[:3])
    bad = work / "clip" / "clip_001.png"
    whole = bad.read_bytes()
    bad.write_bytes(whole[:-300])
    with pytest.raises(UnreadableFile, match=r"clip_001\.png"):
        run(work, frames=given)
    assert (work / "out" / "frames").exists() and (work / "out" / MARK_NAME).is_file()
    bad.write_bytes(whole)
    run(work, frames=given)
    run(work, frames=given, output=work / "fresh")
    files = {path.relative_to(work / "fresh") for path in (work / "fresh").rglob("*") if path.is_file()}
    assert {path.relative_to(work / "out") for path in (work / "out").rglob("*") if path.is_file()} == files
    for name in files:
        assert (work / "fresh" / name).read_bytes() == (work / "out" / name).read_bytes(), name


def test_a_run_that_fails_before_the_first_picture_leaves_nothing(work, actor):
    given = clip(work, actor, actor.training.values[:3])
    bad = work / "clip" / "clip_000.png"
    bad.write_bytes(bad.read_bytes()[:-300])
    with pytest.raises(UnreadableFile):
        run(work, frames=given)
    assert not (work / "out").exists()


def test_the_mark_is_there_before_any_picture(work, monkeypatch):
    seen = []

    def written(path, image):
        seen.append((work / "out" / MARK_NAME).stat().st_size > 0)
        raise UnwritableFile("full")

    monkeypatch.setattr(mimicry, "write_image", written)
    with pytest.raises(UnwritableFile):
        run(work)
    assert seen and all(seen) and not (work / "out").exists()


def test_what_a_killed_run_left_unfinished_goes_and_other_settings_take_all_of_it(work):
    steps = verb.run(MimicRequest(str(work / "a.morph"), str(work / "b.morph"), work / "out"))
    for step in steps:
        if step.stage == "mimic" and step.done == 5:
            steps.close()
    ours = ("frames/.frame_007.{}.png", "mimic.work/.abc.{}.json", ".index.{}.html")
    for name in (one.format("morphspace-q9dm_n9r") for one in ours):
        (work / "out" / name).write_bytes(b"half")
    (work / "out" / ".mine.png").write_bytes(b"mine")
    run(work, gain=0.5)
    run(work, gain=0.5, output=work / "fresh")
    (work / "out" / ".mine.png").unlink()
    lying = [
        {path.relative_to(work / name) for path in (work / name).rglob("*")} for name in ("out", "fresh")
    ]
    assert lying[0] == lying[1]


def test_frames_in_the_output_folder_itself_are_refused(work, actor):
    given = clip(work, actor, actor.training.values[:3])
    before = sorted((work / "clip").iterdir())
    with pytest.raises(BadInput, match="holds the input frames"):
        run(work, frames=given, output=work / "clip")
    with pytest.raises(BadInput, match="holds the input frames"):
        run(work, frames=str(work / "clip" / "*.png"), output=work / "clip")
    assert sorted((work / "clip").iterdir()) == before


@pytest.mark.parametrize("side", ["source", "target"])
def test_a_clip_too_short_for_a_model_is_named_with_its_side(work, actor, side):
    given = clip(work, actor, actor.training.values[:1])
    sides = {"source": str(work / "a.morph"), "target": str(work / "b.morph"), side: given}
    flag = {"source": "--src", "target": "--dst"}[side]
    with pytest.raises(BadInput, match=rf"{flag} .*clip is a clip of 1 frame, .*at least 3"):
        result_of(verb.run(MimicRequest(**sides, output=work / "out")))
    assert not (work / "out").exists()


def test_a_model_of_too_few_faces_is_not_sent_to_a_command_that_cannot_help(work, actor):
    names = actor.training.frame_names[:5]
    training = Loadings(actor.training.values[:5], names, actor.model_id)
    dataclasses.replace(actor, training=training).save(work / "few.morph")
    with pytest.raises(
        BadInput, match=r"few\.morph .*it has 5 training faces; expected at least 8"
    ) as refusal:
        run(work, "few", "a", method="guided")
    assert "--auto" not in str(refusal.value)
    with pytest.raises(BadInput, match="it has 5 training faces"):
        required_landmarks(load_model(work / "few.morph"))
    (note,) = (note for note in run(work, "few", "a").warnings if "the method is transfer" in note)
    assert "few.morph --auto" not in note and "a.morph --auto" in note
    given = clip(work, actor, actor.training.values[:5])
    for detect in (None, lambda picture: points()):
        request = MimicRequest(given, str(work / "b.morph"), work / "new", method="guided")
        with pytest.raises(
            BadInput, match="models fetch" if detect is None else "clip has 5 frames; expected at least 8"
        ):
            result_of(verb.run(request, detect))
    assert not (work / "new").exists()
    tried = actor.with_faceframe(actor.faceframe, {"source": "auto", "lip": "philtrum", "found": 4})
    assert how_to_learn(tried, "x").startswith("a face was found in 4 of its 12 training faces")


def test_damaged_networks_are_told_from_missing_ones(work, actor, tmp_path, monkeypatch):
    folder = tmp_path / "networks"
    folder.mkdir()
    (folder / "face_landmark_with_attention.tflite").write_bytes(b"half")
    monkeypatch.setenv("MORPHSPACE_MODELS", str(folder))
    (note,) = (note for note in run(work).warnings if "models fetch" in note)
    assert "face_landmark_with_attention.tflite" in note and "damaged" in note and str(folder) not in note
    given = clip(work, actor, actor.training.values[:3])
    with pytest.raises(BadInput, match=r"face_landmark_with_attention\.tflite .* damaged"):
        result_of(verb.run(MimicRequest(given, str(work / "b.morph"), work / "new")))


def test_the_number_of_components_is_named_where_it_keeps_the_motion_back(work):
    (note,) = (n for n in run(work, components=1, gain=1.0).warnings if "of the motion's energy" in n)
    assert "with 1 of its 2 components" in note and "-k" in note


def test_a_share_is_the_same_in_the_line_and_in_the_note(work, monkeypatch):
    prepared = mimicry.mimic

    def mimic_that_keeps_little(*models, **settings):
        make = prepared(*models, **settings)

        def made(*given):
            one = make(*given)
            # 15 %, but 16 of the figure in the table
            quality = dataclasses.replace(one.quality, warp_kept=0.15499999)
            return dataclasses.replace(one, quality=quality)

        return made

    monkeypatch.setattr(mimicry, "mimic", mimic_that_keeps_little)
    outcome = run(work, gain=1.0)
    (note,) = (n for n in outcome.warnings if "of the motion's energy" in n)
    assert "shows only 16%" in note and "of the motion 16% is kept" in outcome.lines[0]
