"""track: points of a face in each frame, written for people, and read again by every verb that takes them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face import anchor as anchor_room
from morphspace.face.detector import Detector
from morphspace.face.mesh import LEFT_LIDS, LIPS, PHILTRUM, POINT_COUNT, RIGHT_LIDS, FacePoints
from morphspace.face.track import framed_points, given_points
from morphspace.grid import warp
from morphspace.io.clips import open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.io.images import write_image
from morphspace.io.tables import read_loadings_table
from morphspace.model import encode as encode_room
from morphspace.model import from_clip
from morphspace.model.encode import encoded_frames
from morphspace.model.from_clip import ClipSettings, build_clip
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, load_model
from morphspace.steps import result_of
from morphspace.storage import digest_of_file
from morphspace.verbs import encode
from morphspace.verbs.encode import EncodeRequest
from morphspace.verbs.track import TrackRequest, run

WIDTH, HEIGHT, BLIND = 60, 72, "frame_002"


def _points():
    """478 points of a face at the usual position in a frame of 60 x 72 px."""
    points = np.random.default_rng(6).uniform((12, 20), (48, 60), (POINT_COUNT, 2))
    for lids, x in ((RIGHT_LIDS, 21.0), (LEFT_LIDS, 39.0)):
        points[list(lids)] += np.array([x, 30.0]) - points[list(lids)].mean(axis=0)
    points[PHILTRUM] = (30.0, 45.0)
    return points


FOUND = _points()


@pytest.fixture
def lab(clip, tmp_path, monkeypatch):
    """A folder with the drawn clip; its third frame is black, and the detector finds no face there."""
    for name, picture in zip(clip.names, clip.pictures, strict=True):
        write_image(tmp_path / "clip" / f"{name}.png", 0 * picture if name == BLIND else picture)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class Seeing:
    """A detector that finds `FOUND`, px of a picture of 60 x 72, in every picture that is not black."""

    def __init__(self):
        self.calls = 0

    def __call__(self, image):
        self.calls += 1
        if image.max() == 0:
            return None
        points = FOUND * (image.shape[1] / WIDTH)
        return FacePoints(points, 0.9, depth=np.zeros(POINT_COUNT), confidence=np.full(POINT_COUNT, 0.5))


def tracked(output, look=None, **more):
    detector = Detector(look or Seeing(), {"version": 1})
    return result_of(run(TrackRequest(("clip",), output=output, **more), detector))


def rows_of(path):
    lines = path.read_text().splitlines()
    return lines[0], [line.split(",") for line in lines[1:]]


def test_the_table_holds_the_points_of_each_frame_and_says_where_no_face_was(lab, clip):
    outcome = tracked("points.csv")
    _, rows = rows_of(lab / "points.csv")
    assert len(rows) == len(clip.names) * POINT_COUNT
    assert_allclose([list(map(float, row[2:4])) for row in rows[:POINT_COUNT]], FOUND, atol=0.0005)
    assert rows[2 * POINT_COUNT][:4] == [BLIND, "0", "", ""]
    assert outcome.lines[0] == f"points.csv: 478 points of the face in {len(clip.names) - 1} of 9 frames"
    (note,) = outcome.warnings
    assert BLIND in note and "1 of 9 frames" in note
    document = json.loads((lab / "points.json").read_text())
    assert document["table_sha256"] == digest_of_file(lab / "points.csv")
    assert document["frame_rate_hz"] is None
    tracked("at.csv", frame_rate_hz=50.0)
    assert json.loads((lab / "at.json").read_text())["frame_rate_hz"] == 50
    assert document["inputs"][BLIND] == digest_of_file(lab / "clip" / f"{BLIND}.png")


def test_corrected_points_stay_as_they_are_and_the_other_frames_are_searched(lab, clip):
    tracked("points.csv")
    heading, rows = rows_of(lab / "points.csv")
    corrected = [row for row in rows if row[0] in ("frame_001", BLIND)]
    for row in corrected:
        row[2:6] = [f"{FOUND[int(row[1]), 0] + 1.5:.3f}", f"{FOUND[int(row[1]), 1]:.3f}", "", ""]
    (lab / "mended.csv").write_text("\n".join([heading, *map(",".join, corrected)]) + "\n")
    look = Seeing()
    outcome = tracked("all.csv", look, points="mended.csv")
    assert look.calls == len(clip.names) - 2
    assert outcome.lines[0].endswith("9 of 9 frames, of which 2 were given") and not outcome.warnings
    found = given_points(lab / "all.csv", open_clip(["clip"])).faces
    for name in clip.names:
        shift = 1.5 if name in ("frame_001", BLIND) else 0.0
        assert_allclose(found[name].points, FOUND + np.array([shift, 0]), atol=0.001)
    assert found[BLIND].depth is None and found["frame_000"].depth is not None


def test_a_folder_gets_one_template_for_each_frame_with_a_face(lab, clip):
    outcome = tracked("marked")
    names = [path.name for path in sorted((lab / "marked").iterdir())]
    assert names == [*(f"{name}.tem" for name in clip.names if name != BLIND), "record.json"]
    assert set(outcome.written) == {lab.joinpath("marked", name).relative_to(lab) for name in names}
    found = given_points(lab / "marked", open_clip(["clip"])).faces
    assert_allclose(found["frame_003"].points, FOUND, atol=0.0005)


@pytest.mark.parametrize("output", ["points.csv", "marked"])
def test_a_second_run_replaces_its_files_and_none_that_was_corrected(lab, output):
    tracked(output)
    file = lab / output if output.endswith(".csv") else lab / output / "frame_003.tem"
    content = file.read_bytes()
    tracked(output)
    assert file.read_bytes() == content
    mended = (
        content.replace(b"frame_003,7,", b"frame_003,7,1") if output.endswith(".csv") else content + b"\n"
    )
    file.write_bytes(mended)
    with pytest.raises(BadInput, match=r"was changed|changed since"):
        tracked(output)
    assert file.read_bytes() == mended


def test_the_given_table_is_not_replaced(lab):
    tracked("points.csv")
    with pytest.raises(BadInput, match="one of the inputs"):
        tracked("points.csv", points="points.csv")


def test_points_in_a_frame_are_those_of_the_picture_scaled_and_cropped(lab):
    tracked("points.csv")
    source = FramedClip(open_clip(["clip"]), Framing((WIDTH, HEIGHT), (6, 0, 48, 72), (96, 144)))
    given = given_points(lab / "points.csv", source.clip)
    face = given.framed(source.to_source).faces["frame_000"]
    # Pixel centres are integers: the corner of the picture is at -.5 in both.
    assert_allclose(face.points, 2 * (np.round(FOUND, 3) - (6, 0) + 0.5) - 0.5, atol=1e-9)
    deep = replace(given, faces={"a": replace(given.faces["frame_000"], depth=np.arange(478.0))})
    assert_allclose(deep.framed(source.to_source).faces["a"].depth, 2 * np.arange(478.0))


def built(lab, monkeypatch, landmarks, name):
    detector = Detector(Seeing(), {"version": 1})
    monkeypatch.setattr(from_clip, "load_detector", lambda person: detector)
    monkeypatch.setattr(from_clip, "detector_for", lambda landmarks, person: (detector, ()))
    settings = ClipSettings(components=3, flow="dis", warp_weight=0.05, landmarks=landmarks, size=(90, 108))
    return result_of(build_clip(open_clip(["clip"]), settings, lab / name))[0]


def test_a_build_uses_given_points_records_their_file_and_finds_the_others(lab, clip, monkeypatch):
    tracked("points.csv")
    heading, rows = rows_of(lab / "points.csv")
    some = [row for row in rows if row[0] == "frame_005"]
    (lab / "some.csv").write_text("\n".join([heading, *map(",".join, some)]) + "\n")
    build = built(lab, monkeypatch, lab / "some.csv", "work")
    assert build.track.given.tolist() == [name == "frame_005" for name in clip.names]
    assert build.track.words == "given in 1 of 9 frames, found in 7 of the other 8"
    frame, _ = build.frame(5)
    # Pixel centres are integers: the corner of the picture is at -.5 in both.
    framed = 1.5 * (np.round(FOUND, 3) + 0.5) - 0.5
    assert_allclose(warp.apply_affine(frame.registration, frame.points), framed, atol=1e-6)
    told = build.model.provenance["landmarks"]
    assert told["given"] == {"file": "some.csv", "sha256": digest_of_file(lab / "some.csv")}
    assert told["frames_given"] == 1 and told["frames_with_face"] == len(clip.names) - 1
    assert built(lab, monkeypatch, "auto", "plain").track.words == "found in 8 of 9 frames"


def test_a_frame_of_the_build_with_other_points_does_not_start_from_its_loadings(lab, model, monkeypatch):
    tracked("points.csv")
    told = {"landmarks": {"reference_has_face": True, "held": True}}
    held = replace(model, provenance={**model.provenance, **told}, registration="similarity")
    monkeypatch.setattr(anchor_room, "load_detector", lambda person: Detector(Seeing(), {"version": 1}))
    monkeypatch.setattr(encode_room, "rows_of_build", lambda model, source: tuple(range(9)))
    starts = {}

    def fit(model, frame, start):
        starts[frame.name] = start
        return Loadings(start[None], (frame.name,), model.model_id)

    monkeypatch.setattr(MorphModel, "fit", fit)
    source = FramedClip(open_clip(["clip"]), Framing((WIDTH, HEIGHT), None, (WIDTH, HEIGHT)))
    for encoded in encoded_frames(held, source, given=framed_points(lab / "points.csv", source)):
        name, row = encoded.frame.name, source.names.index(encoded.frame.name)
        expected = held.training.values[row] if name == BLIND else held.project(encoded.morph)
        assert_array_equal(starts[name], expected)


def test_encoding_uses_given_points_and_refuses_them_without_face_points_in_the_model(
    lab, model, monkeypatch
):
    tracked("points.csv")
    framing = {"source_size": [WIDTH, HEIGHT], "crop": None, "size": [WIDTH, HEIGHT]}
    plain = replace(model, provenance={**model.provenance, "framing": framing})
    plain.save(lab / "plain.morph")
    request = EncodeRequest("plain.morph", ("clip",), "t.csv", landmarks="points.csv")
    with pytest.raises(BadInput, match="--landmarks gives face points, but drawn was built without"):
        result_of(encode.run(request))
    look = Seeing()
    monkeypatch.setattr(anchor_room, "load_detector", lambda person: Detector(look, {"version": 1}))
    told = {"landmarks": {"reference_has_face": True, "held": True}}
    replace(plain, provenance={**plain.provenance, **told}, registration="similarity").save(
        lab / "held.morph"
    )
    result_of(encode.run(replace(request, model=lab / "held.morph")))
    assert look.calls == 2  # the reference, and the frame without points
    found = read_loadings_table(lab / "t.csv")
    assert found.document["inputs"]["points.csv"] == digest_of_file(lab / "points.csv")
    result_of(encode.run(replace(request, model=lab / "held.morph", output="u.csv", landmarks=None)))
    # The detector finds the same points, to the .001 px of the table.
    assert_allclose(read_loadings_table(lab / "u.csv").loadings_sd, found.loadings_sd, atol=0.02)
    heading, rows = rows_of(lab / "points.csv")
    for row in rows:
        row[3] = str(float(row[3]) + 4) if row[3] and int(row[1]) in LIPS else row[3]
    (lab / "moved.csv").write_text("\n".join([heading, *map(",".join, rows)]) + "\n")
    held, source = (
        load_model(lab / "held.morph"),
        FramedClip(open_clip(["clip"]), Framing((60, 72), None, (60, 72))),
    )
    fields = [
        np.stack([one.morph.displacement for one in encoded_frames(held, source, given=given)])
        for given in (None, framed_points(lab / "moved.csv", source))
    ]
    apart_px = np.abs(fields[1] - fields[0]).max(axis=(1, 2, 3))
    assert (np.delete(apart_px, 2) > 2).all() and apart_px[2] == 0
