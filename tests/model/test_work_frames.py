"""Laws of the frames in the work folder: what is kept comes back, and a second start makes nothing worse."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.regions import face_mask
from morphspace.flow import Flow, methods
from morphspace.flow.starts import FOLD_LIMIT, photometric_error
from morphspace.grid import warp
from morphspace.model import work_frames
from morphspace.model.passes import BuildSettings, build_steps
from morphspace.steps import result_of, using_workers
from morphspace.storage import digest_of_array

AUTO = BuildSettings(components=6, registration="none", flow="drawn", reference=0, warp_weight=0.05)
PROVENANCE = {"identity": "drawn", "licence": "CC0"}
LOST = (3, 4)  # frames that the drawn flow does not find from nothing
NEVER = (6,)  # nor this one from a neighbour
TRIED = {*LOST, *NEVER, 5}  # frame 5 is found at once, but its light and open mouth make it hard


def built(source, work_folder, settings=AUTO):
    return result_of(build_steps(source, settings, work_folder, PROVENANCE))


def bytes_of(build, folder):
    build.model.save(folder / "some.morph")
    return (folder / "some.morph").read_bytes()


@pytest.fixture
def calls(clip, monkeypatch):
    """Make the flow "drawn" return the true fields, except for lost frames; record its calls (frame, started)."""
    asked = []
    index_of = {digest_of_array(image): index for index, image in enumerate(clip.pictures)}

    def drawn(reference):
        asked.append("prepared")

        def to_frame(frame, start):
            index = index_of[digest_of_array(frame)]
            asked.append((index, start is not None))
            found = index not in NEVER and (start is not None or index not in LOST)
            return Flow(clip.fields[index] * np.float32(found), ramp(index))

        return to_frame

    monkeypatch.setitem(methods.METHODS, "drawn", drawn)
    return asked


def ramp(index):
    """A confidence (h, w) that differs from frame to frame and from place to place."""
    y, x = np.mgrid[:72, :60].astype(np.float32)
    return (0.05 * index + 0.3 * x / 60 + 0.2 * y / 72).astype(np.float32)


# what is kept


def test_the_reference_is_prepared_once_a_build(clip, calls, tmp_path):
    built(clip, tmp_path)
    assert calls.count("prepared") == 1
    assert len(calls) > len(clip.pictures)  # both passes took place


def test_flow_and_confidence_come_back_as_they_were_found(clip, calls, tmp_path):
    build = built(clip, tmp_path)
    for index in (1, 2, 5, *LOST):
        frame, flow = build.frame(index)
        assert frame.name == clip.names[index]
        assert_array_equal(frame.image, clip.pictures[index])
        assert_array_equal(flow.displacement, clip.fields[index])
        assert_array_equal(flow.confidence, ramp(index))
    assert_array_equal(build.frame(0)[1].confidence, 1)  # the reference is found in itself


def test_confidences_are_means_inside_the_mask_on_the_mean_face(clip, calls, tmp_path):
    build = built(clip, tmp_path)
    model = build.model
    maps = [np.ones((72, 60)), *(ramp(index) for index in range(1, len(clip.pictures)))]
    maps = [warp.sample_field(each.astype(np.float32), model.mean_inverse) for each in maps]
    assert_allclose(build.confidences, [np.average(each, weights=model.mask) for each in maps], atol=1e-5)
    assert_allclose(build.confidence_map, np.mean(maps, axis=0), atol=1e-6)
    assert build.confidence_map.dtype == np.float32


def test_a_change_of_the_flow_makes_the_frames_again(clip, calls, tmp_path, monkeypatch):
    built(clip, tmp_path)
    once = len(calls)
    built(clip, tmp_path)
    assert calls[once:] == ["prepared"]
    monkeypatch.setattr(work_frames, "FLOW_VERSION", work_frames.FLOW_VERSION + 1)
    built(clip, tmp_path)
    assert len(calls) == 2 * once + 1


@pytest.fixture(autouse=True)
def flow_as_it_is_found(monkeypatch):
    """Disable the smoothing of fields for morphs, so that fields compare bit by bit."""
    monkeypatch.setattr(methods, "for_morphs", methods.named)


# the second start


def test_only_hard_frames_are_tried_again(clip, calls, tmp_path):
    build = built(clip, tmp_path)
    assert sorted(call for call in calls if call != "prepared" and call[1]) == sorted(
        (i, True) for i in TRIED
    )
    assert_array_equal(np.flatnonzero(build.from_neighbour), LOST)


def test_a_second_start_is_the_first_field_of_the_easier_neighbour(clip, calls, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "LOST", (3, 4, 5))  # 4 and 5 have only lost frames beside them
    begun = {}
    drawn = methods.METHODS["drawn"]

    def watched(reference):
        to_frame = drawn(reference)

        def watched_to_frame(frame, start):
            if start is not None:
                begun[digest_of_array(frame)] = start
            return to_frame(frame, start)

        return watched_to_frame

    monkeypatch.setitem(methods.METHODS, "drawn", watched)
    with using_workers(1):  # 3 is done before 4 begins
        build = built(clip, tmp_path)
    assert_array_equal(np.flatnonzero(build.from_neighbour), (3, 4, 5))
    starts = {index: begun[digest_of_array(clip.pictures[index])] for index in (3, 4, 5, 6)}
    assert_array_equal(starts[3], clip.fields[2])
    for index in (4, 5):
        assert_array_equal(
            starts[index], 0
        )  # not what a neighbour became: that would depend on who was first
    assert_array_equal(starts[6], clip.fields[7])


def test_beside_another_neighbour_a_frame_is_tried_again(clip, make_clip, calls, tmp_path):
    built(clip, tmp_path)
    calls.clear()
    without = [image for index, image in enumerate(clip.pictures) if index != LOST[0] - 1]
    built(make_clip(without), tmp_path)
    assert calls == ["prepared", (LOST[0], True)]


def test_a_second_start_never_raises_the_error_nor_passes_the_fold_limit(clip, tmp_path):
    settings = replace(AUTO, flow="dis")
    plain = built(clip, tmp_path, replace(settings, start="none"))
    auto = built(clip, tmp_path, settings)
    check_never_worse(clip, plain, auto)


def test_a_flow_that_gets_lost_from_some_starts_is_never_made_worse(clip, tmp_path, monkeypatch):
    indices = {digest_of_array(image): index for index, image in enumerate(clip.pictures)}

    def shaky(reference):
        def to_frame(frame, start):
            index = indices[digest_of_array(frame)]
            rng = np.random.default_rng([index, start is not None])
            noise = rng.normal(0, rng.uniform(0, 0.8), (72, 60, 2)).astype(np.float32)
            return Flow(clip.fields[index] + noise, np.ones((72, 60), np.float32))

        return to_frame

    monkeypatch.setitem(methods.METHODS, "shaky", shaky)
    plain = built(clip, tmp_path, replace(AUTO, flow="shaky", start="none"))
    auto = built(clip, tmp_path, replace(AUTO, flow="shaky"))
    assert auto.from_neighbour.any()
    check_never_worse(clip, plain, auto)


def check_never_worse(clip, plain, auto):
    mask = face_mask(72, 60)
    assert not plain.from_neighbour.any()
    for index, image in enumerate(clip.pictures):
        first, second = (build.frame(index)[1].displacement for build in (plain, auto))
        errors = [photometric_error(clip.pictures[0], image, field, mask) for field in (first, second)]
        assert errors[1] <= errors[0]
        assert warp.fold_fraction(second, mask) <= max(FOLD_LIMIT, warp.fold_fraction(first, mask))
        if not auto.from_neighbour[index]:
            assert_array_equal(first, second)


def test_without_a_second_start_none_is_made(clip, calls, tmp_path):
    build = built(clip, tmp_path, replace(AUTO, start="none"))
    assert not any(started for _, started in (call for call in calls if call != "prepared"))
    assert not build.from_neighbour.any()
    assert build.model.provenance["flow_start"] == "none"


def test_both_starts_share_the_first_pass(clip, calls, tmp_path):
    built(clip, tmp_path, replace(AUTO, start="none"))
    calls.clear()
    built(clip, tmp_path)
    assert set(calls) == {"prepared", *((index, True) for index in TRIED)}


def test_a_flow_that_takes_no_start_is_not_tried_again(clip, calls, tmp_path, monkeypatch):
    monkeypatch.setitem(methods.METHODS, "tvl1", methods.METHODS["drawn"])
    built(clip, tmp_path, replace(AUTO, flow="tvl1"))
    assert not any(started for _, started in (call for call in calls if call != "prepared"))


def test_an_unknown_start_is_refused_before_any_work(clip, calls, tmp_path):
    with pytest.raises(BadInput, match="start is 'previous'"):
        built(clip, tmp_path / "work", replace(AUTO, start="previous"))
    assert not (tmp_path / "work").exists()
    assert calls == []


# the same again


def test_a_second_build_tries_nothing_again_and_gives_the_same_bytes(clip, calls, tmp_path):
    first = bytes_of(built(clip, tmp_path / "work"), tmp_path)
    calls.clear()
    assert bytes_of(built(clip, tmp_path / "work"), tmp_path) == first
    assert calls == ["prepared"]  # nor the frame whose second start was no better


@pytest.mark.parametrize(("stage", "done"), [("flow", 4), ("flow", 9), ("starts", 1), ("starts", 3)])
def test_a_build_stopped_between_starts_goes_on_to_the_same_bytes(clip, calls, tmp_path, stage, done):
    whole = bytes_of(built(clip, tmp_path / "whole"), tmp_path)
    asked = len(calls)
    steps = build_steps(clip, AUTO, tmp_path / "stopped", PROVENANCE)
    assert any((step.stage, step.done) == (stage, done) for step in steps)  # and no step further
    steps.close()
    assert bytes_of(built(clip, tmp_path / "stopped"), tmp_path) == whole
    assert len(calls) == 2 * asked + 1  # the reference was prepared once more, and no flow twice


@pytest.mark.parametrize("flow", ["drawn", "dis"])
def test_any_number_of_workers_gives_the_same_bytes(clip, calls, tmp_path, flow):
    made = set()
    for count in (1, 2, 5):
        with using_workers(count):
            made.add(bytes_of(built(clip, tmp_path / f"{count}", replace(AUTO, flow=flow)), tmp_path))
    assert len(made) == 1


def test_a_second_start_cut_short_is_made_again(clip, calls, tmp_path):
    first = built(clip, tmp_path / "work")
    damaged = first.frame_files[LOST[0]]
    damaged.write_bytes(damaged.read_bytes()[:20_000])
    calls.clear()
    assert bytes_of(built(clip, tmp_path / "work"), tmp_path) == bytes_of(first, tmp_path)
    assert calls == ["prepared", (LOST[0], True)]
