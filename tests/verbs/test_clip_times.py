"""Clocks of clips through the verbs: the clip's rate, not the model's, and uneven frames sampled by their times."""

import json
from dataclasses import replace

import av
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.face.faceframe import FaceFrame
from morphspace.io.images import write_image
from morphspace.io.tables import read_loadings_table, write_loadings_table
from morphspace.io.video import read_frames, video_info, write_video
from morphspace.model import encode as encode_room
from morphspace.model.model import load_model
from morphspace.steps import result_of
from morphspace.verbs import (
    build_model,
    caricature,
    encode,
    info,
    measure_mimicry,
    mimic,
    place,
    render,
    trajectory,
)
from morphspace.verbs.build_model import BuildModelRequest
from morphspace.verbs.caricature import CaricatureRequest
from morphspace.verbs.encode import EncodeRequest
from morphspace.verbs.info import InfoRequest
from morphspace.verbs.measure_mimicry import MeasureMimicryRequest
from morphspace.verbs.mimic import MimicRequest
from morphspace.verbs.place import PlaceRequest
from morphspace.verbs.render import RenderRequest
from morphspace.verbs.trajectory import TrajectoryRequest

RATE_HZ = 25.0
KEPT = [0, 1, 2, 3, 5, 6, 7, 9, 10, 11]  # the slots of a recorder that lost two frames
KEYPOINTS = {"source": "set", "lip": "philtrum", "on": "mean"}
GAP = "with a largest gap of 0.08 s after frame 3"


def smile(times_s):
    return np.column_stack([np.sin(6 * times_s), 0.4 * np.cos(4 * times_s), np.sin(2 * times_s)])


@pytest.fixture
def work(model, tmp_path):
    """A model built at 10 Hz, a table of a motion with every frame, and one of a recorder that lost two of them."""
    faceframe = FaceFrame((20.0, 28.0), (39.0, 28.0), (29.5, 46.0))
    model = with_rate(model, 10.0).with_faceframe(faceframe, KEYPOINTS)
    model.save(tmp_path / "drawn.morph")
    times_s = np.arange(12) / RATE_HZ
    for name, kept in (("even", range(12)), ("lost", KEPT)):
        document = {"model_id": model.model_id, "identity": model.identity, "frame_rate_hz": RATE_HZ}
        own_s = times_s[list(kept)]
        names = [f"{name}_{index}" for index in range(len(own_s))]
        write_loadings_table(tmp_path / f"{name}.csv", smile(own_s), names, document, own_s)
    return tmp_path


def with_rate(model, rate_hz):
    return replace(model, provenance={**model.provenance, "frame_rate_hz": rate_hz})


def filled(values):
    """The motion that linear interpolation makes of the kept frames, at every slot."""
    return np.column_stack([np.interp(np.arange(12), KEPT, column) for column in values.T])


def clip_of(work, model, kept, rate_hz=RATE_HZ):
    """A lossless video of the motion; lost frames are lost in its times too."""
    path = work / "take.mkv"
    write_video(
        path, [model.render(row) for row in smile(np.array(kept) / rate_hz) * model.sd], encoding="lossless"
    )
    with av.open(str(path)) as given, av.open(str(work / "clip.mkv"), "w") as container:
        stream = container.add_stream_from_template(given.streams.video[0])
        packets = [packet for packet in given.demux(video=0) if packet.size]
        for packet, slot in zip(packets, kept, strict=True):
            packet.pts = packet.dts = round(1000 * slot / rate_hz)
            packet.stream = stream
            container.mux(packet)
    return work / "clip.mkv"


def test_a_table_has_the_rate_and_the_times_of_its_clip_and_not_the_rate_of_the_model(work, model):
    path = clip_of(work, model, list(range(12)), 50.0)
    result_of(encode.run(EncodeRequest(work / "drawn.morph", (str(path),), work / "t.csv")))
    table = read_loadings_table(work / "t.csv")
    assert table.rate_hz == pytest.approx(50)
    assert_allclose(table.times_s, np.arange(12) / 50)
    folder = work / "stills"
    folder.mkdir()
    write_image(folder / "a.png", model.render(np.zeros(3)))
    result_of(encode.run(EncodeRequest(work / "drawn.morph", (str(folder),), work / "s.csv")))
    still = read_loadings_table(work / "s.csv")
    assert (still.rate_hz, still.times_s) == (10.0, None)  # the model's, for pictures without a rate


def test_a_video_of_an_uneven_table_lasts_as_long_as_the_recording(work):
    outcome = result_of(render.run(RenderRequest(work / "drawn.morph", work / "lost.csv", work / "lost.mkv")))
    assert any(
        GAP in note and "10 frames were resampled by their times to 12" in note for note in outcome.warnings
    )
    result_of(render.run(RenderRequest(work / "drawn.morph", work / "even.csv", work / "even.mkv")))
    lost, even = (list(read_frames(work / f"{name}.mkv")) for name in ("lost", "even"))
    assert len(lost) == len(even) == 12
    assert video_info(work / "lost.mkv").frame_rate_hz == RATE_HZ
    for slot in KEPT:
        assert_array_equal(lost[slot], even[slot])


def test_pictures_of_an_uneven_table_are_its_rows(work):
    outcome = result_of(render.run(RenderRequest(work / "drawn.morph", work / "lost.csv", work / "out")))
    assert outcome.document["stimuli"] == len(KEPT)
    assert not any("unevenly" in note for note in outcome.warnings)


def test_another_rate_plays_the_same_frames_faster(work):
    request = RenderRequest(work / "drawn.morph", work / "lost.csv", work / "fast.mkv", frame_rate_hz=50.0)
    result_of(render.run(request))
    info = video_info(work / "fast.mkv")
    assert (info.frame_count, info.frame_rate_hz) == (12, 50.0)


def test_trajectory_and_caricature_count_in_seconds(work):
    request = TrajectoryRequest(work / "drawn.morph", (work / "lost.csv",), work / "new.csv")
    outcome = result_of(trajectory.run(request))
    assert any(GAP in note for note in outcome.warnings)
    values = smile(np.array(KEPT) / RATE_HZ)
    assert_allclose(read_loadings_table(work / "new.csv").loadings_sd, filled(values))
    request = CaricatureRequest(
        work / "drawn.morph", work / "set", loadings=work / "lost.csv", gains=(1.0,), video=".mkv"
    )
    outcome = result_of(caricature.run(request))
    assert any(GAP in note for note in outcome.warnings)
    assert_allclose(read_loadings_table(work / "set" / "loadings.csv").loadings_sd, filled(values))


def test_an_uneven_imitation_is_measured_at_its_times(work):
    request = MeasureMimicryRequest(
        str(work / "even.csv"), str(work / "lost.csv"), work / "drawn.morph", work / "m", permutations=5
    )
    outcome = result_of(measure_mimicry.run(request))
    assert any(GAP in note for note in outcome.warnings)
    assert outcome.document["imitation_frames"] == 12
    back = read_loadings_table(work / "m" / "imitation.csv")
    assert_allclose(back.loadings_sd, filled(smile(np.array(KEPT) / RATE_HZ)))
    assert outcome.document["lag_frames"] == 0
    assert outcome.document["correlation"] > 0.999


def test_tables_measure_as_the_clips_they_are_of(work, model):
    path = clip_of(work, model, KEPT)
    result_of(encode.run(EncodeRequest(work / "drawn.morph", (str(path),), work / "t.csv")))
    found = []
    for given in (str(path), str(work / "t.csv")):
        request = MeasureMimicryRequest(
            str(work / "even.csv"), given, work / "drawn.morph", work / "m", permutations=5
        )
        found.append(result_of(measure_mimicry.run(request)).document)
    for name in ("correlation", "gain", "distance_sd", "lag_frames", "imitation_frames"):
        assert found[0][name] == pytest.approx(found[1][name])


def test_videos_of_recorded_pictures_show_the_nearest_frame(work, model):
    path = clip_of(work, model, KEPT)
    request = PlaceRequest(work / "drawn.morph", (str(path),), work / "placed", video=".mkv")
    outcome = result_of(place.run(request))
    assert any(GAP in note for note in outcome.warnings)
    assert video_info(work / "placed" / "clip.mkv").frame_count == 12
    again = result_of(place.run(request))
    assert again.document["frames"] == 12
    request = MimicRequest(
        str(work / "drawn.morph"), str(work / "drawn.morph"), work / "mimic", frames=str(path), method="map"
    )
    outcome = result_of(mimic.run(request))
    assert any(GAP in note for note in outcome.warnings)
    assert video_info(work / "mimic" / "side-by-side.mp4").frame_count == 12
    table = read_loadings_table(work / "mimic" / "loadings.csv")
    assert_allclose(table.times_s, np.array(KEPT) / RATE_HZ)
    assert len(list((work / "mimic" / "frames").glob("*.png"))) == len(KEPT)


def test_what_reading_changes_is_a_note_of_the_verb(work, model, monkeypatch):
    path = clip_of(work, model, list(range(12)))
    (work / "clip.clip.json").write_text(json.dumps({"identity": "drawn"}))
    opened = encode_room.open_clip

    def noted(*given):
        return replace(opened(*given), notes=("its pixels became square",))

    monkeypatch.setattr(encode_room, "open_clip", noted)
    outcome = result_of(encode.run(EncodeRequest(work / "drawn.morph", (str(path),), work / "t.csv")))
    assert "its pixels became square" in outcome.warnings


def test_training_frames_keep_their_times(work, model):
    times_s = [0.1 * slot for slot in range(10)] + [1.3, 1.4]
    timed = replace(load_model(work / "drawn.morph"), provenance={**model.provenance, "times_s": times_s})
    timed = with_rate(timed, 10.0).with_faceframe(
        FaceFrame((20.0, 28.0), (39.0, 28.0), (29.5, 46.0)), KEYPOINTS
    )
    timed.save(work / "timed.morph")
    result_of(info.run(InfoRequest(work / "timed.morph", loadings=work / "t.csv")))
    assert read_loadings_table(work / "t.csv").times_s.tolist() == times_s
    request = MimicRequest(
        str(work / "timed.morph"), str(work / "timed.morph"), work / "mimic", method="map", neutral="mean"
    )
    outcome = result_of(mimic.run(request))
    assert any("with a largest gap of 0.4 s after frame 9" in note for note in outcome.warnings)
    assert video_info(work / "mimic" / "side-by-side.mp4").frame_count == 15
    assert read_loadings_table(work / "mimic" / "loadings.csv").times_s.tolist() == times_s


def test_a_build_keeps_the_times_of_its_video(work, model):
    path = clip_of(work, model, KEPT)
    request = BuildModelRequest(
        (str(path),), work / "built.morph", flow="fast", landmarks="none", start="none", registration="none"
    )
    outcome = result_of(build_model.run(request))
    assert any(GAP in note for note in outcome.warnings)
    built = load_model(work / "built.morph")
    assert built.provenance["frame_rate_hz"] == RATE_HZ
    assert_allclose(built.training_times_s, np.array(KEPT) / RATE_HZ)
