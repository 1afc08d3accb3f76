"""measure-mimicry from files to files: what it finds in clips and tables, what it says, and what it refuses."""

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose
from scipy import ndimage

from morphspace.cli.main import main
from morphspace.errors import BadInput, ReferenceMismatch, UnreadableFile
from morphspace.face.faceframe import FaceFrame
from morphspace.grid import warp
from morphspace.imitation.imitator import imitator_of
from morphspace.io.images import read_image, write_image
from morphspace.io.tables import read_loadings_table, read_metrics_table, write_loadings_table
from morphspace.io.video import video_info
from morphspace.model.keypoints import region_of
from morphspace.model.model import load_model
from morphspace.model.morph import Morph
from morphspace.notebook import build
from morphspace.sets import imitation as imitation_set
from morphspace.sets.imitation import WRITTEN
from morphspace.steps import result_of
from morphspace.storage import MARK_NAME, digest_of_file
from morphspace.verbs import measure_mimicry
from morphspace.verbs.measure_mimicry import MeasureMimicryRequest

FRAMES = 24
FACE = np.array([1.0])  # what a detector gives for a face; only that it is something is looked at here


def motion(frames=FRAMES, seed=0):
    noise = np.random.default_rng(seed).standard_normal((frames, 3))
    smooth = ndimage.gaussian_filter1d(noise, 1.5, axis=0)
    return smooth / smooth.std(axis=0)


@pytest.fixture
def work(model, tmp_path):
    """A saved model and a folder for tables and clips of it."""
    model.save(tmp_path / "drawn.morph")
    return tmp_path


def table(folder, name, loadings, model, rate_hz=None, **more):
    document = {"model_id": model.model_id, "identity": model.identity, **more}
    if rate_hz:
        document["frame_rate_hz"] = rate_hz
    names = [f"{name}_{index:03d}" for index in range(len(loadings))]
    write_loadings_table(folder / f"{name}.csv", loadings, names, document)
    return str(folder / f"{name}.csv")


def clip(folder, name, loadings, model, rate_hz=None):
    place = folder / name
    place.mkdir()
    for index, row in enumerate(loadings * model.sd):
        write_image(place / f"{name}_{index:03d}.png", model.render(row), bits=16)
    if rate_hz:
        (place / "clip.json").write_text(json.dumps({"frame_rate_hz": rate_hz}))
    return str(place)


def measured(work, stimulus, imitation, detector=None, **more):
    """Few copies of chance, for speed: as many as a short clip has shifts."""
    more = {"permutations": FRAMES - 1, **more}
    request = MeasureMimicryRequest(stimulus, imitation, work / "drawn.morph", work / "out", **more)
    return result_of(measure_mimicry.run(request, detector))


def rows(work):
    return read_metrics_table(work / "out" / "measures.csv")


def test_a_table_against_itself_is_perfect(work, model):
    given = table(work, "a", motion(), model)
    outcome = measured(work, given, given)
    found = rows(work)
    assert found["name"] == ["pc001", "pc002", "pc003", "all"]
    assert_allclose(found["correlation"], 1)
    assert found["distance_sd"] == [0, 0, 0, 0] and found["lag_frames"] == [0, 0, 0, 0]
    assert found["correlation_p"][-1] == round(1 / FRAMES, 6)
    assert outcome.warnings == (
        "with 23 circular shifts, p of frames in pairs cannot be below 0.042. A smaller p needs more frames",
    )
    assert outcome.document["correlation"] == pytest.approx(1)
    assert outcome.document["least_p"] == dict.fromkeys(
        ("frame_by_frame", "information", "lag", "alignment"), 1 / FRAMES
    )
    back = read_loadings_table(work / "out" / "stimulus.csv")
    assert np.array_equal(back.loadings_sd, read_loadings_table(given).loadings_sd)
    assert back.document["model_id"] == model.model_id


def test_clips_are_measured_as_their_loadings_are(work, model):
    delay = 3
    whole = motion(FRAMES + delay)
    stimulus = clip(work, "stimulus", whole[delay:], model, 20)
    imitation = clip(work, "imitation", whole[:FRAMES], model, 20)
    outcome = measured(work, stimulus, imitation)
    found = rows(work)
    assert found["lag_frames"][-1] == delay and found["lag_s"][-1] == pytest.approx(delay / 20)
    assert found["correlation_at_lag"][-1] > 0.98
    truth = read_loadings_table(work / "out" / "stimulus.csv").loadings_sd
    assert np.corrcoef(truth[:, 0], whole[delay:, 0])[0, 1] > 0.98
    info = video_info(work / "out" / "side-by-side.mp4")
    assert info.frame_count == FRAMES and info.frame_rate_hz == 20
    assert info.size == (4 * 60 + 3 * 4, 72)  # both clips and both drawings, with gaps
    assert outcome.document["stimulus_frames"] == FRAMES


@pytest.fixture(scope="module")
def told(model, tmp_path_factory):
    """What lies beside the table of two tables that were measured, as text."""
    work = tmp_path_factory.mktemp("told")
    model.save(work / "drawn.morph")
    given = table(work, "a", motion(), model)
    measured(work, given, given)
    return (work / "out" / "measures.json").read_text()


SCHEMA = Path(__file__).parents[2] / "data_spec" / "imitation-table.schema.json"


@cache
def validator():
    schema = json.loads(SCHEMA.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("case", ["tables", "clip", "still", "imitator", "mask"])
def test_what_lies_beside_the_table_fits_its_schema(work, model, case):
    a, b = table(work, "a", motion(), model, rate_hz=25), table(work, "b", motion(seed=1), model)
    more = {}
    if case == "clip":
        b = clip(work, "clip", motion(8), model)
    elif case == "still":
        b = table(work, "still", np.zeros((FRAMES, 3)), model)
    elif case == "imitator":
        model, other = linked(work, model)
        a = table(work, "c", motion(), model)
        b = table(work, "d", motion(seed=1), other)
        more = {"imitator": work / "other.morph"}
    elif case == "mask":
        write_image(work / "white.png", np.ones((72, 60, 3), np.float32))
        more = {"mask": work / "white.png"}
    measured(work, a, b, **more)
    validator().validate(json.loads((work / "out" / "measures.json").read_text()))


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("format", "morphspace-loadings"),
        ("version", 2),
        ("columns", {"correlation": {"unit": ""}}),
        ("columns", {"correlation": {"unit": "", "meaning": "r", "more": 1}}),
        ("frame_rate_hz", 0),
        ("frame_rate_hz", "25"),
        ("paired_frames", 2),
        ("stimulus_frames", 3.5),
        ("region", "ears"),
        ("carried_by", "magic"),
        ("notes", "none"),
        ("still", {"stimulus": []}),
        ("outside_space", {"stimulus": -1, "imitation": None}),
        ("versions", {"numpy": "2"}),
        ("something", "else"),
    ],
)
def test_a_broken_one_does_not(told, entry, value):
    document = json.loads(told)
    validator().validate(document)
    with pytest.raises(jsonschema.ValidationError):
        validator().validate({**document, entry: value})
    del document[entry if entry in document else "seed"]
    with pytest.raises(jsonschema.ValidationError):
        validator().validate(document)


def test_every_entry_of_the_schema_is_on_its_page():
    page = SCHEMA.with_name("imitation-table.md").read_text()
    for entry in validator().schema["properties"]:
        assert f"`{entry}`" in page


def test_every_column_is_described_beside_the_table_and_every_file_recorded(work, model):
    outcome = measured(work, table(work, "a", motion(), model), table(work, "b", motion(seed=1), model))
    described = json.loads((work / "out" / "measures.json").read_text())
    assert set(rows(work)) == set(described["columns"])
    assert all(entry["meaning"] for entry in described["columns"].values())
    assert described["shifts"] == FRAMES - 1 and described["shifts_are_all_there_are"] is True
    record = json.loads((work / "out" / "record.json").read_text())
    names = {path.name for path in outcome.written} - {"record.json"}
    assert (
        set(record["outputs"]) == names == {path.name for path in (work / "out").iterdir()} - {"record.json"}
    )
    assert set(record["inputs"]) == {"model", "stimulus/a.csv", "imitation/b.csv"}


def test_the_same_request_gives_the_same_bytes(work, model):
    given = table(work, "a", motion(), model), table(work, "b", motion(seed=1), model)
    contents = []
    for _ in range(2):
        measured(work, *given, permutations=10)
        contents.append({path.name: path.read_bytes() for path in (work / "out").iterdir()})
    assert contents[0] == contents[1]


def test_different_lengths_are_said(work, model):
    outcome = measured(work, table(work, "a", motion(), model), table(work, "b", motion(30), model))
    assert any("24 frames, the imitation 30" in note and "first 24" in note for note in outcome.warnings)
    assert outcome.document["paired_frames"] == 24


def test_an_imitation_at_another_rate_is_brought_to_the_rate_of_the_stimulus(work, model):
    time = np.arange(40) / 20
    wave = np.column_stack([np.sin(3 * time), np.cos(2 * time), np.sin(5 * time)])
    fast = np.arange(79) / 40
    faster = np.column_stack([np.sin(3 * fast), np.cos(2 * fast), np.sin(5 * fast)])
    outcome = measured(
        work, table(work, "a", wave, model, rate_hz=20), table(work, "b", faster, model, rate_hz=40)
    )
    assert any("20 Hz, the imitation 40 Hz" in note for note in outcome.warnings)
    assert outcome.document["imitation_frames"] == 40
    assert_allclose(rows(work)["correlation"], 1, atol=1e-9)
    assert rows(work)["lag_frames"][-1] == 0


def test_one_known_rate_is_said_to_be_taken_for_both(work, model):
    outcome = measured(
        work, table(work, "a", motion(), model, rate_hz=25), table(work, "b", motion(seed=1), model)
    )
    assert any("only the stimulus has a frame rate, 25 Hz" in note for note in outcome.warnings)


def test_few_shifts_are_said_to_be_no_test(work, model):
    given = table(work, "a", motion(9), model), table(work, "b", motion(9, 1), model)
    outcome = measured(work, *given, permutations=99)
    said = "with 8 circular shifts, p of frames in pairs cannot be below 0.11 (at the best lag and aligned, below 0.01)"
    assert any(note.startswith(said) and "more frames" in note for note in outcome.warnings)
    page = (work / "out" / "index.html").read_text()
    assert "can be no smaller than 0.11 (0.11 for information)" in page
    assert "can be no smaller than 0.01 (0.01 after alignment)" in page
    assert any(
        "4 circular shifts" in n and "more permutations" in n
        for n in measured(work, *given, permutations=4).warnings
    )


def test_an_imitation_that_is_merely_late_is_told_from_chance_at_its_best_lag(work, model):
    whole = motion(65)
    outcome = measured(
        work, table(work, "a", whole[5:], model), table(work, "b", whole[:-5], model), permutations=199
    )
    found = rows(work)
    assert outcome.document["lag_frames"] == 5
    assert found["correlation_at_lag_p"][-1] <= 0.02 < found["correlation_p"][-1]


def test_a_lag_at_the_end_of_the_search_is_said(work, model):
    ramp = np.linspace(-1, 1, 20)
    late = np.column_stack([np.exp(-(((ramp - at) / 0.5) ** 2)) for at in (-0.5, -0.5, -0.5)])
    later = np.column_stack([np.exp(-(((ramp - at) / 0.5) ** 2)) for at in (0.9, 0.9, 0.9)])
    outcome = measured(
        work,
        table(work, "a", late, model),
        table(work, "b", later, model),
    )
    assert any("10 frames, is the longest that was tried" in note for note in outcome.warnings)


def test_a_still_imitation_has_empty_cells_and_a_reason(work, model):
    outcome = measured(
        work, table(work, "a", motion(), model), table(work, "b", np.full((FRAMES, 3), 0.3), model)
    )
    found = rows(work)
    assert found["undefined"] == ["the imitation does not move"] * 4
    for name in ("correlation", "correlation_p", "lag_frames", "alignment_cost", "alignment_steps"):
        assert found[name] == [""] * 4, name
    lines = (work / "out" / "measures.csv").read_text().splitlines()
    assert "nan" not in "".join(lines).lower()
    assert outcome.document["correlation"] is None
    assert outcome.document["still"] == {"stimulus": [], "imitation": ["pc001", "pc002", "pc003"]}
    assert outcome.lines[1:] == (outcome.lines[1],)
    assert outcome.lines[1].startswith("the imitation does not move: ") and "SD" in outcome.lines[1]
    assert "p can be below" not in " ".join(outcome.warnings)
    page = (work / "out" / "index.html").read_text()
    assert (
        page.count(outcome.lines[1]) == 2 and "frames of lag" not in page
    )  # first of all, and for the timing
    assert "the imitation does not move: pc001, pc002, pc003, all" in page


def test_measures_are_written_to_what_they_are_good_for(work, model):
    measured(work, table(work, "a", motion(), model), table(work, "b", motion(seed=1), model))
    lines = (work / "out" / "measures.csv").read_text().splitlines()
    decimals = [len(cell.partition(".")[2]) for line in lines[1:] for cell in line.split(",")[1:]]
    assert 3 < max(decimals) <= 6
    assert not any(cell == "-0.0" for line in lines for cell in line.split(","))


@pytest.mark.parametrize(
    ("stimulus", "imitation", "words"),
    [
        (np.ones((9, 3)), motion(9), "the stimulus does not move: "),
        (np.ones((9, 3)), np.zeros((9, 3)), "neither the stimulus nor the imitation moves: "),
    ],
)
def test_what_does_not_move_is_said_in_one_line(work, model, stimulus, imitation, words):
    outcome = measured(work, table(work, "a", stimulus, model), table(work, "b", imitation, model))
    assert outcome.lines[1].startswith(words) and len(outcome.lines) == 2


def test_a_component_that_does_not_move_is_named(work, model):
    still = motion(seed=1)
    still[:, 1] = 0.2
    later = motion(30, seed=2)
    later[:FRAMES, 2] = -0.1
    outcome = measured(work, table(work, "a", still, model), table(work, "b", later, model))
    assert any("1 of 3 components of the stimulus do not move (pc002)" in note for note in outcome.warnings)
    reasons = rows(work)["undefined"]
    assert reasons == [
        "",
        "the stimulus does not move",
        "the imitation does not move in the first 24 frames",
        "",
    ]
    assert outcome.document["still"] == {"stimulus": ["pc002"], "imitation": []}


def test_a_motion_that_is_next_to_nothing_is_said(work, model):
    given = table(work, "a", motion(), model)
    outcome = measured(work, given, table(work, "b", 0.02 * motion(seed=1), model))
    assert any(
        "the imitation hardly moves: its motion is 2.0 % of the stimulus" in note for note in outcome.warnings
    )
    assert not any("hardly" in note for note in measured(work, given, given).warnings)


def test_another_face_is_measured_about_its_own_mean_and_said(work, model):
    stimulus = motion()
    outcome = measured(
        work, table(work, "a", stimulus, model), table(work, "b", stimulus + np.array([5, 0, 0]), model)
    )
    assert any("5.0 SD from that of the stimulus (pc001)" in note for note in outcome.warnings)
    found = rows(work)
    assert_allclose(found["correlation"], 1)
    assert_allclose(found["distance_centred_sd"], 0, atol=1e-12)
    assert found["distance_sd"][0] == pytest.approx(5)


def test_components_are_the_first_so_many(work, model):
    given = table(work, "a", motion(), model), table(work, "b", motion(seed=1), model)
    measured(work, *given)
    every = rows(work)
    measured(work, *given, components=2)
    some = rows(work)
    assert some["name"] == ["pc001", "pc002", "all"]
    assert some["correlation"][:2] == every["correlation"][:2]


def test_more_components_than_there_are_is_all_of_them_and_is_said(work, model):
    good, narrow = table(work, "a", motion(), model), table(work, "narrow", motion()[:, :2], model)
    outcome = measured(work, good, good, components=9)
    assert "9 components were requested; drawn has 3, and all are used" in outcome.warnings
    assert outcome.document["components"] == 3
    outcome = measured(work, good, narrow, components=3)
    assert "3 components were requested; a table has 2, and all are used" in outcome.warnings
    said = f"{narrow} has 2 of 3 components of drawn: the others are not measured"
    assert said in outcome.warnings and said in measured(work, narrow, good).warnings
    assert rows(work)["name"] == ["pc001", "pc002", "all"]


def test_the_page_says_which_p_is_of_what(work, model):
    outcome = measured(work, table(work, "a", motion(), model), table(work, "b", motion(seed=1), model))
    page = (work / "out" / "index.html").read_text()
    headings = re.findall(r"<th[^>]*scope=.col.[^>]*>(.*?)</th>", page)
    assert len(headings) == len(set(headings)) > 10 and "p of r at best lag" in headings
    assert "with chance free to choose its lag" in page and "it does not say how sure" in page
    assert "chance at its own best lag" in outcome.lines[2]


def test_a_part_of_the_face_hides_what_happens_elsewhere(work, model):
    """The drawn face opens its mouth below row 50: eyes alone can tell little of it, the mouth nearly all."""
    model = with_keypoints(work, model)
    given = table(work, "a", motion(), model), table(work, "b", motion(seed=1), model)
    shares = {}
    for region in ("eyes", "mouth", "eyes+brows"):
        measured(work, *given, region=region)
        shares[region] = np.array(rows(work)["visible_share"][:3])
        assert json.loads((work / "out" / "measures.json").read_text())["region"] == region
    assert (shares["eyes"] < 1).all() and (shares["mouth"] < 1).all()
    mask = region_of(model, "mouth")
    truth = [
        (component * model.basis.weight * spread(mask)) @ component for component in model.basis.components
    ]
    assert_allclose(shares["mouth"], truth, atol=1e-4)


def test_a_part_that_is_not_known_is_refused(work, model):
    given = table(work, "a", motion(), model), table(work, "b", motion(seed=1), model)
    with pytest.raises(BadInput, match=r"region is 'ears'; expected one of whole, eyes, brows, mouth, nose"):
        measured(work, *given, region="ears")
    with pytest.raises(BadInput, match=r"no keypoints; its region eyes needs them.*morphspace keypoints"):
        measured(work, *given, region="eyes")


def spread(mask):
    return np.concatenate([np.repeat(mask.reshape(-1), 3), np.repeat(mask.reshape(-1), 2)])


def test_a_clip_and_the_table_of_it_say_the_same_of_a_part(work, model):
    model, loadings = with_keypoints(work, model), 0.7 * motion(8)
    measured(work, clip(work, "clip", loadings, model), table(work, "b", loadings, model), region="mouth")
    found = rows(work)
    assert (
        found["correlation"][-1] > 0.85
    )  # the stock flow errs on a face 60 px wide, and nothing is fitted after it


def test_a_white_mask_is_the_whole_face(work, model):
    write_image(work / "white.png", np.ones((72, 60, 3), np.float32))
    given = table(work, "a", motion(), model), table(work, "b", motion(seed=1), model)
    measured(work, *given)
    whole = rows(work)
    measured(work, *given, mask=work / "white.png")
    assert_allclose(rows(work)["correlation"], whole["correlation"], atol=0.01)  # the prior shrinks by 1e-3
    assert_allclose(rows(work)["visible_share"][:3], 1, atol=1e-4)


def test_the_page_is_complete_and_harmless(work, model):
    stimulus = table(work, "<b>a", motion(), model)
    measured(work, stimulus, table(work, "b", motion(seed=1), model))
    page = (work / "out" / "index.html").read_text()
    assert "<b>a" not in page and "&lt;b&gt;a" in page
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page).lower()
    assert page.count("<svg") == 3 + 2  # a trace a component, the lag, the alignment
    assert 'src="side-by-side.mp4"' in page
    for svg in re.findall(r"<svg.*?</svg>", page, re.S):
        ElementTree.fromstring(svg)


def test_a_table_of_another_model_is_refused_and_says_what_to_do(work, model):
    given = table(work, "a", motion(), model)
    other = table(work, "b", motion(), model, model_id="other")
    document = json.loads((work / "b.json").read_text())
    (work / "b.json").write_text(json.dumps({**document, "model_id": "0123"}))
    with pytest.raises(ReferenceMismatch, match=r"b\.csv belongs to model 0123.*Give its clip instead"):
        measured(work, given, other)
    assert not (work / "out").exists()


KEYPOINTS = FaceFrame((20.0, 28.0), (40.0, 28.0), (30.0, 44.0))


def with_keypoints(work, model):
    """The stimulus' model with keypoints, saved."""
    marked = model.with_faceframe(KEYPOINTS)
    marked.save(work / "drawn.morph")
    return load_model(work / "drawn.morph")


def linked(work, model):
    """The stimulus' model with keypoints, saved, and another person's: mirrored in colour, components reordered."""
    stimulus = model.with_faceframe(KEYPOINTS)
    stimulus.save(work / "drawn.morph")
    basis = replace(model.basis, components=np.ascontiguousarray(-model.basis.components))
    training = replace(model.training, values=-model.training.values, model_id="ffff0123ffff0123")
    mean = Morph.of((1 - model.mean.texture).astype(np.float32), model.mean.displacement, "e2a11f0123456789")
    other = replace(
        stimulus,
        mean=mean,
        basis=basis,
        training=training,
        reference=mean.render(),
        provenance={**model.provenance, "identity": "other"},
    )
    other.save(work / "other.morph")
    return load_model(work / "drawn.morph"), load_model(work / "other.morph")


def test_what_another_person_does_is_read_in_their_own_model_and_carried_over(work, model):
    """The other's components are the stimulus' turned round, about another mean: the same motion has turned signs."""
    model, other = linked(work, model)
    stimulus = motion()
    given = table(work, "a", stimulus, model), table(work, "b", -stimulus, other)
    outcome = measured(work, *given, imitator=work / "other.morph")
    found = rows(work)
    assert_allclose(found["correlation"], 1, atol=0.02)  # the affine interpolates nothing, the prior shrinks
    assert found["gain"][-1] == pytest.approx(1, abs=0.05)
    assert outcome.document["imitator_identity"] == "other"
    beside = json.loads((work / "out" / "imitation.json").read_text())
    assert (beside["model_id"], beside["source_model_id"]) == (model.model_id, other.model_id)
    record = json.loads((work / "out" / "record.json").read_text())
    assert record["inputs"]["imitator"] == digest_of_file(work / "other.morph")
    page = (work / "out" / "index.html").read_text()
    assert "encoded with the model of other and transferred" in page
    measured(work, *given, imitator=work / "other.morph", region="mouth")
    part = [
        read_loadings_table(work / "out" / f"{role}.csv").loadings_sd for role in ("stimulus", "imitation")
    ]
    assert_allclose(part[1], part[0], atol=0.02)  # SD; the part shows the same of both
    measured(work, given[0], table(work, "c", -stimulus[:, :2], other), imitator=work / "other.morph")
    assert rows(work)["name"][-2:] == [
        "pc003",
        "all",
    ]  # fewer columns of the other's are all of the stimulus'


def test_what_another_person_does_elsewhere_does_not_reach_a_part(work, model):
    """The other's last component colours all but the mouth: the whole face carries it over, the mouth does not."""
    model, other = linked(work, model)
    mouth = region_of(model, "mouth")
    elsewhere = np.where(spread(mouth) > 0, 0, model.basis.components[2]).astype(np.float32)
    components = np.concatenate([other.basis.components[:2], elsewhere[None]])
    replace(other, basis=replace(other.basis, components=components)).save(work / "elsewhere.morph")
    loadings = np.array([0, 0, other.sd[2]])
    whole = imitator_of(work / "elsewhere.morph", model, None).carry(loadings) / model.sd
    part = imitator_of(work / "elsewhere.morph", model, mouth).carry(loadings) / model.sd
    assert np.abs(whole).max() > 0.1
    assert np.abs(part).max() < 1e-4


def test_a_clip_of_another_person_is_said_to_be_one_unless_their_model_is_given(work, model):
    model, other = linked(work, model)
    stimulus = 0.7 * motion(10)
    given = table(work, "a", stimulus, model), clip(work, "b", -stimulus, other)
    direct = measured(work, *given)
    assert direct.warnings[0].startswith("the imitation b is evidently of another person")
    assert "--imitator" in direct.warnings[0]
    assert direct.document["outside_space"]["imitation"] > 1
    far = rows(work)["distance_centred_sd"][-1]
    carried = measured(work, *given, imitator=work / "other.morph")
    assert not any("another person" in note for note in carried.warnings)
    assert carried.document["outside_space"]["imitation"] is None
    assert rows(work)["distance_centred_sd"][-1] < 0.5 * far
    assert rows(work)["correlation"][-1] > 0.8
    calls = []

    def faceless(image):  # a face in the mean alone
        calls.append(image)
        return FACE if len(calls) == 1 else None

    unseen = measured(work, *given, detector=faceless)
    assert "finds no face" in unseen.warnings[0]
    assert not any("another person" in note for note in unseen.warnings)  # nor of anybody
    with_stimulus = measured(work, given[1], given[0])
    assert with_stimulus.warnings[0].startswith("the stimulus b is evidently of another person")


def test_held_out_frames_of_the_models_own_recording_are_not_called_anothers(tmp_path, picture):
    """Every other frame builds the model, by the flow that reads the rest; another face is far outside."""
    phase = 2 * np.pi * np.arange(18) / 18
    bend = np.zeros((72, 60, 2), np.float32)
    bend[..., 1] = np.exp(-((np.arange(72) - 45) ** 2) / 200)[:, None]
    light = np.linspace(-1, 1, 60, dtype=np.float32)[None, :, None]
    for name, seed in (("own", 1), ("other", 7)):
        face = picture(72, 60, seed=seed)
        for index, angle in enumerate(phase):
            frame = warp.render(face, (2 - 2 * np.cos(angle)) * bend) + 0.05 * np.sin(angle + 1) * light
            place = tmp_path / (name if index % 2 else f"{name}-built") / f"f_{index:03d}.png"
            place.parent.mkdir(exist_ok=True)
            write_image(place, np.clip(frame, 0, 1).astype(np.float32), bits=16)
    built = build(tmp_path / "own-built", components=4, flow="fast", warp_weight=0.05)
    built.save(tmp_path / "drawn.morph")
    given = str(tmp_path / "own"), str(tmp_path / "other")
    outcome = measured(tmp_path, *given)
    strange = [note for note in outcome.warnings if "another person" in note]
    assert len(strange) == 1 and strange[0].startswith("the imitation other")
    found = outcome.document["outside_space"]
    assert found["stimulus"] < 0.5 and found["imitation"] > 2  # where it says so lies at 1


@pytest.mark.parametrize(
    "what", ["itself", "no keypoints", "table of the stimulus", "third table", "no file"]
)
def test_an_imitator_that_cannot_be_used_is_named(work, model, what):
    model, other = linked(work, model)
    a, b = table(work, "a", motion(), model), table(work, "b", motion(), other)
    imitator, imitation, words = {
        "itself": ("drawn.morph", b, "is the model of the stimulus itself"),
        "no keypoints": ("bare.morph", b, "--imitator other has no keypoints.*morphspace keypoints"),
        "table of the stimulus": (
            "other.morph",
            a,
            r"a\.csv belongs to the model of the stimulus.*Leave out --imitator",
        ),
        "third table": (
            "other.morph",
            table(work, "c", motion(), model, model_id="third"),
            "that of --imitator",
        ),
        "no file": ("none.morph", b, r"none\.morph"),
    }[what]
    if what == "no keypoints":
        replace(other, faceframe=None).save(work / "bare.morph")
    if what == "third table":
        document = json.loads((work / "c.json").read_text())
        (work / "c.json").write_text(json.dumps({**document, "model_id": "third"}))
    with pytest.raises(BadInput, match=words):
        measured(work, a, imitation, imitator=work / imitator)
    assert not (work / "out").exists()
    with pytest.raises(BadInput, match="--imitator"):
        measured(work, a, b)  # without it, the line says there is such an option


def bad(work, model, what):
    good = table(work, "a", motion(), model)
    one_frame = table(work, "one", motion()[:1], model)
    (work / "empty").mkdir()
    write_image(work / "small.png", np.ones((10, 12, 3), np.float32))
    (work / "nan.csv").write_text("frame,pc001_sd\nf1,0.5\nf2,nan\nf3,1\n")
    return {
        "one frame": ((good, one_frame), {}, r"imitation .*one\.csv has 1 frame\(s\); expected at least 3"),
        "empty folder": ((good, str(work / "empty")), {}, "holds no images"),
        "no such file": ((str(work / "no.csv"), good), {}, r"cannot read .*no\.csv"),
        "no such clip": ((good, str(work / "gone")), {}, "gone does not exist"),
        "no components": (
            (good, good),
            {"components": 0},
            "components is 0; expected a whole number from 1 up",
        ),
        "mask of another size": (
            (good, good),
            {"mask": work / "small.png"},
            "small.png is 12x10; expected 60x72",
        ),
        "mask and region": ((good, good), {"mask": work / "small.png", "region": "eyes"}, "Give one"),
        "nan": ((good, str(work / "nan.csv")), {}, "line 3, column pc001_sd is 'nan'"),
        "no mask": ((good, good), {"mask": work / "none.png"}, r"none\.png"),
    }[what]


@pytest.mark.parametrize(
    "what",
    [
        "one frame",
        "empty folder",
        "no such file",
        "no such clip",
        "no components",
        "mask of another size",
        "mask and region",
        "nan",
        "no mask",
    ],
)
def test_bad_input_is_named_and_nothing_is_written(work, model, what):
    given, more, words = bad(work, model, what)
    with pytest.raises((BadInput, UnreadableFile), match=words):
        measured(work, *given, **more)
    assert not (work / "out").exists()


def test_frames_without_a_face_are_named(work, model):
    given = clip(work, "clip", 0.5 * motion(6), model, 20), table(work, "b", 0.5 * motion(6, 1), model)
    seen = [read_image(path) for path in sorted((work / "clip").glob("*.png"))]

    def detector(image):
        place = next((i for i, frame in enumerate(seen) if np.array_equal(frame, image)), None)
        return None if place in (2, 5) else FACE

    outcome = measured(work, *given, detector=detector)
    assert outcome.document["no_face"] == 2
    assert outcome.document["frames_without_face"] == {
        "stimulus": ["clip_002", "clip_005"],
        "imitation": None,
    }
    said = "the detector finds no face in 2 of 6 frames of the stimulus clip (the first is clip_002): "
    assert outcome.warnings[0].startswith(said)
    assert said in (work / "out" / "index.html").read_text()
    validator().validate(json.loads((work / "out" / "measures.json").read_text()))
    outcome = measured(work, *given, detector=lambda image: FACE)
    assert outcome.document["no_face"] == 0 and not any("finds no face" in note for note in outcome.warnings)
    assert outcome.document["frames_without_face"]["stimulus"] == []


def test_why_faces_were_not_looked_for_is_said(work, model, tmp_path, monkeypatch):
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "none"))
    given = clip(work, "clip", 0.5 * motion(6), model, 20), table(work, "b", 0.5 * motion(6, 1), model)
    without = measured(work, *given)
    assert any(
        "of the stimulus clip were not searched for faces" in n and "models fetch" in n
        for n in without.warnings
    )
    unknown = measured(work, *given, detector=lambda image: None)
    assert any("finds no face in the mean of drawn" in note for note in unknown.warnings)
    for outcome in (without, unknown):
        assert outcome.document["no_face"] == 0
        assert outcome.document["frames_without_face"] == {"stimulus": None, "imitation": None}
    assert not any("face" in note for note in measured(work, given[1], given[1]).warnings)  # tables


def test_the_command_line_exits_3_where_a_frame_shows_no_face(work, model, monkeypatch):
    given = clip(work, "clip", 0.5 * motion(6), model, 20), table(work, "b", 0.5 * motion(6, 1), model)
    words = [
        "measure-mimicry",
        *given,
        "--model",
        work / "drawn.morph",
        "-o",
        work / "out",
        "--permutations",
        5,
    ]
    calls = []

    def detector(image):  # finds a face in the mean, and in nothing else
        calls.append(image)
        return FACE if len(calls) == 1 else None

    assert CliRunner().invoke(main, list(map(str, words))).exit_code == 0
    monkeypatch.setattr("morphspace.face.detector.own_detector", lambda: detector)
    result = CliRunner().invoke(main, list(map(str, words)))
    assert result.exit_code == 3, result.output
    assert "the detector finds no face in 6 of 6 frames of the stimulus clip: " in result.stderr


@pytest.mark.parametrize("name", WRITTEN)
def test_files_that_are_not_ours_are_not_written_over(work, model, name):
    given = table(work, "a", motion(), model)
    (work / "out").mkdir()
    (work / "out" / name).write_text('{"verb": "mimic"}')
    with pytest.raises(BadInput, match=f"{name} is a file that no earlier measure-mimicry wrote"):
        measured(work, given, given)
    assert {path.name: path.read_text() for path in (work / "out").iterdir()} == {name: '{"verb": "mimic"}'}


def test_nothing_is_written_among_the_frames_of_a_clip(work, model):
    given = clip(work, "out", 0.5 * motion(4), model), table(work, "b", 0.5 * motion(4, 1), model)
    with pytest.raises(BadInput, match=r"out is one of the two clips\. Choose another output folder"):
        measured(work, *given)
    assert {path.suffix for path in (work / "out").iterdir()} == {".png"}


def test_files_under_other_names_stay_beside_ours(work, model):
    given = table(work, "a", motion(), model)
    (work / "out").mkdir()
    (work / "out" / "notes.txt").write_text("mine")
    measured(work, given, given)
    assert (work / "out" / "notes.txt").read_text() == "mine"


def test_a_run_that_fails_half_way_leaves_a_folder_the_next_one_takes(work, model, monkeypatch):
    given = table(work, "a", motion(), model)

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(imitation_set, "write_measures", stop)
        with pytest.raises(KeyboardInterrupt):
            measured(work, given, given)
    assert {path.name for path in (work / "out").iterdir()} == {"side-by-side.mp4", MARK_NAME}
    measured(work, given, given)
    assert {path.name for path in (work / "out").iterdir()} == set(WRITTEN)


@pytest.mark.parametrize("where", ["compare", "_drawn"])
def test_a_run_that_fails_before_anything_is_written_leaves_no_folder(work, model, monkeypatch, where):
    given = table(work, "a", motion(), model)

    def fail(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(imitation_set, where, fail)
    with pytest.raises(KeyboardInterrupt):
        measured(work, given, given)
    assert not (work / "out").exists()


def test_an_input_is_never_written_over(work, model):
    (work / "out").mkdir()
    given = table(work / "out", "imitation", motion(), model)
    before = Path(given).read_bytes()
    with pytest.raises(BadInput, match="one of the inputs and would be replaced"):
        measured(work, given, given)
    assert Path(given).read_bytes() == before
