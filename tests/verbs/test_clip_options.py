"""Options of clips: every verb that reads a clip has them, with the same effect, and replay knows them."""

import json
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from morphspace import notebook
from morphspace.errors import BadInput
from morphspace.face import anchor as anchor_room
from morphspace.face.anchor import rigid_movement
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import POINT_COUNT, FacePoints
from morphspace.grid import warp
from morphspace.io.clips import open_clip
from morphspace.io.images import write_image
from morphspace.io.tables import read_loadings_table
from morphspace.io.video import video_info
from morphspace.model.encode import encoded_frames, framed_for, notes_on_frames
from morphspace.requests import CLIP_OPTIONS, ClipOptions, all_verbs, settings_of, verb_named
from morphspace.sets import models as models_room
from morphspace.steps import result_of

FRAMES = 8
KEYPOINTS = {"source": "set", "lip": "philtrum", "on": "mean"}


@pytest.fixture
def work(model, tmp_path, monkeypatch):
    """A model, and an interlaced video of its face at 25 Hz."""
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "none"))
    monkeypatch.chdir(tmp_path)
    faceframe = FaceFrame((20.0, 28.0), (39.0, 28.0), (29.5, 46.0))
    model.with_faceframe(faceframe, KEYPOINTS).save(tmp_path / "a.morph")
    phase = 2 * np.pi * np.arange(FRAMES) / FRAMES
    rows = np.column_stack([np.sin(phase), np.cos(phase), np.sin(2 * phase)]) * model.sd
    with av.open("clip.mp4", "w") as container:
        options = {"flags": "+ildct+ilme", "x264-params": "tff=1", "crf": "4"}
        stream = container.add_stream("libx264", rate=25, options=options)
        stream.pix_fmt, stream.width, stream.height = "yuv420p", *model.size
        for row in rows:
            codes = np.rint(255 * np.clip(model.render(row), 0, 1)).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes, format="rgb24")))
        container.mux(stream.encode(None))
    return tmp_path


def run(verb, **given):
    found = verb_named(verb)
    return result_of(found.run(found.request(**given)))


RUNS = {
    "encode": {"model": "a.morph", "sources": "clip.mp4", "output": "t.csv"},
    "reconstruct": {"model": "a.morph", "sources": "clip.mp4", "output": "out"},
    "build-model": {"sources": "clip.mp4", "output": "b.morph", "landmarks": "none", "components": 3},
    "place": {"model": "a.morph", "clip": "clip.mp4", "output": "out", "video": "mkv"},
    "caricature": {"model": "a.morph", "clip": "clip.mp4", "output": "out", "gains": 1, "video": "mkv"},
    "measure-mimicry": {
        **{"model": "a.morph", "stimulus": "clip.mp4", "imitation": "clip.mp4"},
        **{"output": "out", "permutations": 2},
    },
    "mimic": {"source": "a.morph", "target": "a.morph", "frames": "clip.mp4", "output": "out"},
}


def rate_in(verb):
    """The frame rate, Hz, that a run wrote down."""
    match verb:
        case "encode" | "reconstruct":
            return read_loadings_table("t.csv" if verb == "encode" else "out/loadings.csv").rate_hz
        case "build-model":
            return notebook.load("b.morph").provenance["frame_rate_hz"]
        case "place" | "caricature":
            (path,) = Path("out").glob("*.mkv")
            return video_info(path).frame_rate_hz
    return video_info("out/side-by-side.mp4").frame_rate_hz


def test_every_verb_that_reads_a_clip_has_the_options_with_one_declaration():
    own = settings_of(ClipOptions)
    assert tuple(field.name for field in own) == CLIP_OPTIONS
    with_clips = {"blend-avatar", "continuum", "track", *RUNS}
    for verb in all_verbs():
        found = [field for field in settings_of(verb.request) if field.name in CLIP_OPTIONS]
        assert (tuple(found) == own) == (verb.name in with_clips), verb.name
        if verb.files and verb.name != "replay":  # which reads the clip as its sidecar says
            assert verb.name in with_clips


@pytest.mark.parametrize("verb", RUNS)
def test_an_interlaced_clip_is_refused_without_the_option_and_read_at_the_given_rate_with_it(work, verb):
    with pytest.raises(BadInput, match=r"clip\.mp4 is interlaced.*Give --deinterlace"):
        run(verb, **RUNS[verb])
    run(verb, **RUNS[verb], deinterlace=True, frame_rate_hz=50)
    assert rate_in(verb) == pytest.approx(50)


def test_a_table_keeps_its_times_in_proportion_to_the_rate(work):
    run("encode", **RUNS["encode"], deinterlace=True, frame_rate_hz=50)
    np.testing.assert_allclose(read_loadings_table("t.csv").times_s, np.arange(FRAMES) / 50, atol=1e-9)


def test_an_option_is_that_of_a_file_beside_the_clip(work):
    run("encode", **{**RUNS["encode"], "output": "a.csv"}, deinterlace=True, frame_rate_hz=50)
    (work / "clip.clip.json").write_text('{"deinterlace": true, "frame_rate_hz": 50.0}')
    run("encode", **RUNS["encode"])
    for suffix in (".csv", ".json"):
        assert (work / f"a{suffix}").read_bytes() == (work / f"t{suffix}").read_bytes()


def test_a_stimulus_of_a_deinterlaced_clip_is_replayed(work):
    run("place", **RUNS["place"], deinterlace=True)
    (path,) = (work / "out").glob("clip*.json")
    placing = json.loads(path.read_text())["drawing"]["placing"]
    assert (placing["deinterlace"], placing["frame_rate_hz"]) == (True, None)
    assert run("replay", sidecar=path).document["same"]


@pytest.mark.parametrize("words", ["clip.mp4", "'cl*.mp4'"])
@pytest.mark.parametrize("verb", ["place", "mimic"])
def test_a_recipe_has_the_options(work, verb, words):
    given = {key: value for key, value in RUNS[verb].items() if key != "output"}
    given["clip" if verb == "place" else "frames"] = words
    head = "format: morphspace-recipe\nversion: 1\n"
    lines = "".join(f"    {key}: {value}\n" for key, value in {**given, "frame_rate_hz": 50}.items())
    for option, is_read in (("", False), ("    deinterlace: true\n", True)):
        (work / "recipe.yaml").write_text(f"{head}stimuli:\n  - verb: {verb}\n{lines}{option}")
        if is_read:
            assert run("batch", recipe="recipe.yaml", output="set").document["output"] == "set"
        else:
            with pytest.raises(BadInput, match="is interlaced"):
                run("batch", recipe="recipe.yaml", output="set")


def test_a_notebook_has_the_options(work, model):
    with pytest.raises(BadInput, match="is interlaced"):
        notebook.encode(model, "clip.mp4")
    assert len(notebook.encode(model, "clip.mp4", deinterlace=True)) == FRAMES
    built = notebook.build("clip.mp4", deinterlace=True, frame_rate_hz=50, landmarks="none", components=2)
    assert built.provenance["frame_rate_hz"] == 50


@pytest.mark.parametrize(
    ("verb", "given", "line"),
    [
        ("mimic", {"source": "a.morph", "target": "a.morph"}, "both persons are models"),
        ("caricature", {"model": "a.morph", "loadings": "t.csv"}, "t.csv is a table"),
        ("continuum", {"first": "a.morph", "last": "a.morph"}, "the ends are models"),
        ("continuum", {"model": "a.morph", "first": "t.csv:x", "last": "t.csv:y"}, "the ends are rows"),
        ("measure-mimicry", {"model": "a.morph", "stimulus": "t.csv", "imitation": "t.csv"}, "both motions"),
        ("blend-avatar", {"models": ("a.morph", "a.morph"), "landmarks": "none"}, "no clips are given"),
    ],
)
def test_an_option_without_a_clip_is_refused(work, verb, given, line):
    run("encode", **RUNS["encode"], deinterlace=True)
    output = "out.morph" if verb == "blend-avatar" else "out"
    with pytest.raises(BadInput, match=f"--deinterlace applies to clips, but {line}.*Leave it out"):
        run(verb, **given, output=output, deinterlace=True)
    assert not (work / output).exists()


# Several persons.


def face_at(x, y):
    around = np.random.default_rng(5).uniform(-8, 8, (POINT_COUNT, 2))
    return FacePoints(around + np.array([x, y]), 0.9)


@pytest.fixture
def of_two(model, monkeypatch):
    """A model that was built with face points, and a detector that finds a face left or right of the middle."""
    asked = []

    def load(folder=None, person="largest"):
        asked.append(person)
        places = {"largest": 30.0, "left": 29.0, "right": 31.0}
        x = places.get(person, 30.0) if isinstance(person, str) else person[0]
        return Detector(lambda image: face_at(x, 36.0), {"person": str(person)})

    monkeypatch.setattr(anchor_room, "load_detector", load)
    found = {"reference_has_face": True, "detector": {"scheme": "test"}}
    provenance = {**model.provenance, "landmarks": found}
    return replace(model, provenance=provenance, registration="similarity"), asked


def test_the_chosen_face_starts_the_registration_and_changes_what_is_stored_of_a_frame(
    of_two, tmp_path, model
):
    two, asked = of_two
    write_image(tmp_path / "two" / "a.png", np.kron(model.render(np.zeros(3)), np.ones((2, 2, 1))))
    shifts, digests = {}, set()
    for person in (None, "left", "right", (58.0, 72.0)):
        asked.clear()
        source = framed_for(two, (str(tmp_path / "two"),), None, ClipOptions(person=person))
        reader = two.for_person(source.person)
        found = reader.anchor.detector(model.render(np.zeros(3)))
        shifts[person] = round(float(rigid_movement(reader.anchor.face, found)[0, 2]), 6)
        digests |= set(source.digests)
        assert len(list(encoded_frames(two, source))) == 1
        if isinstance(person, tuple):  # px of the frames of 120 x 144; the model has 60 x 72
            assert (28.75, 35.75) in asked
    assert shifts == {None: 0.0, "left": -1.0, "right": 1.0, (58.0, 72.0): -1.25}
    assert len(digests) == 4


def test_a_place_outside_the_crop_of_the_build_is_refused_and_a_side_is_said(of_two, tmp_path, model):
    """Another face would be read: the one inside the crop."""
    two, _ = of_two
    write_image(tmp_path / "two" / "a.png", np.kron(model.render(np.zeros(3)), np.ones((2, 2, 1))))
    framing = {"source_size": [120, 144], "crop": [0, 0, 60, 72], "size": [60, 72]}
    two = replace(two, provenance={**two.provenance, "framing": framing})
    sources = (str(tmp_path / "two"),)
    assert framed_for(two, sources, None, ClipOptions(person=(58.0, 70.0))).person == (58.0, 70.0)
    with pytest.raises(BadInput, match=r"the person is at 90,72 px, outside .* in the crop 0,0,60,72"):
        framed_for(two, sources, None, ClipOptions(person=(90.0, 72.0)))
    (note,) = notes_on_frames(framed_for(two, sources, None, ClipOptions(person="right")), "two")
    assert note == "--person right chooses among the faces inside the crop 0,0,60,72"


def test_the_points_that_hold_a_frame_are_those_of_the_chosen_face(of_two):
    two, _ = of_two
    frame = two.for_person("left").align(two.render(np.zeros(3)))
    expected = warp.apply_affine(warp.inverse_affine(frame.registration), face_at(29.0, 36.0).points)
    np.testing.assert_allclose(frame.points, expected)


def test_a_person_without_face_points_is_refused(work, model):
    with pytest.raises(BadInput, match=r"--person selects a face, but .* built without face points"):
        run("encode", **RUNS["encode"], deinterlace=True, person="left")
    with pytest.raises(BadInput, match="--person selects a face, but landmarks is none"):
        run("build-model", **RUNS["build-model"], deinterlace=True, person="left")
    assert open_clip([work / "clip.mp4"], ClipOptions(deinterlace=True, person="left")).person == "left"


@pytest.mark.parametrize("place", [(60, 5), (-1, 5), (5, 72)])
def test_a_person_outside_the_frames_is_refused(tmp_path, model, place):
    write_image(tmp_path / "one" / "a.png", model.render(np.zeros(3)))
    line = rf"the person is at {place[0]},{place[1]} px; expected a place in the frames of one, which have 60x72 px"
    with pytest.raises(BadInput, match=line):
        open_clip([tmp_path / "one"], ClipOptions(person=place))
    assert open_clip([tmp_path / "one"], ClipOptions(person=(59, 71))).person == (59.0, 71.0)


def test_a_model_that_mimic_built_is_found_again_for_the_same_face(work, model):
    options = ClipOptions(deinterlace=True)
    built = notebook.build("clip.mp4", deinterlace=True, landmarks="none", components=50)
    points = FaceFrame((20.0, 28.0), (39.0, 28.0), (29.5, 46.0))  # as a detector found them
    for person in (None, "left", (30.0, 36.0)):
        detector = {"scheme": "test"} if person is None else {"person": person}
        landmarks = {"detector": detector, "reference_has_face": True}
        provenance = {**built.provenance, "landmarks": landmarks, "mask_from": "found face"}
        folder = work / "models"
        replace(built, provenance=provenance, reference_faceframe=points).save(folder / "clip.morph")
        for asked in (None, "left", "right", (30.0, 36.0), (31.0, 36.0)):
            clip = open_clip(["clip.mp4"], replace(options, person=asked))
            assert (models_room._found(clip, folder, 50)[1] is not None) == (asked == person)
    largest = replace(options, person="largest")  # is the default of a build
    replace(built, provenance=built.provenance).save(folder / "clip.morph")
    assert models_room._found(open_clip(["clip.mp4"], largest), folder, 50)[1] is not None
