"""Laws of the build: same input, same bytes; nothing is done twice; what cannot be a model is refused or warned of."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.cache import read_result
from morphspace.errors import BadInput
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame, identity_affine
from morphspace.face.regions import face_mask, mouth_surroundings, rigid_region
from morphspace.face.track import FaceTrack
from morphspace.flow import methods
from morphspace.grid import warp
from morphspace.linear.quality import psnr_db, rms_px
from morphspace.model import passes as build_module
from morphspace.model.morph import invert_mean_shape, morph_of, resource
from morphspace.model.passes import BuildSettings, build_steps
from morphspace.model.reference import _mouth_contrast
from morphspace.steps import result_of

PLAIN = BuildSettings(
    components=6, registration="none", flow="dis", start="none", reference=0, warp_weight=0.05
)
PROVENANCE = {"identity": "drawn", "licence": "CC0"}


def built(source, work_folder, settings=PLAIN, on_step=None):
    return result_of(build_steps(source, settings, work_folder, PROVENANCE), on_step)


def bytes_of(build, folder):
    build.model.save(folder / "some.morph")
    return (folder / "some.morph").read_bytes()


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def build(clip, work):
    """A build with default settings; its work folder is `work`."""
    return built(clip, work, replace(PLAIN, reference=None, warp_weight=None, registration="similarity"))


def no_flow(reference):
    def to_frame(frame, start):
        raise AssertionError("flow was computed again")

    return to_frame


@pytest.fixture
def counted(monkeypatch):
    """A list that grows by one for each flow computed by "dis"."""
    calls = []
    original = methods.METHODS["dis"]

    def counting(reference):
        to_frame = original(reference)

        def counted_to_frame(frame, start):
            calls.append(1)
            return to_frame(frame, start)

        return counted_to_frame

    monkeypatch.setitem(methods.METHODS, "dis", counting)
    return calls


# what a build gives


def test_training_frames_come_back_from_their_loadings(clip, build):
    model = build.model
    assert model.rank == 6
    for index in range(len(clip.names)):
        frame, _ = build.frame(index)
        assert frame.name == clip.names[index]
        back = model.render(model.training.values[index])
        assert psnr_db(back, frame.image, model.mask) > 30  # dB; slit and light at 60 px width


def test_the_loadings_are_the_projections_of_the_morphs(build):
    model = build.model
    for index in (0, 4):
        frame, flow = build.frame(index)
        morph = morph_of(
            frame.image, resource(flow.displacement, model.mean_inverse), model.mean.reference_id
        )
        assert_allclose(model.project(morph), model.training.values[index], atol=1e-3 * model.sd[0])


def test_the_mean_morph_does_not_move(build):
    inside = build.model.mask > 0.5
    assert np.abs(build.model.mean.displacement[inside]).max() < 0.2  # px; linear look-ups at the slit
    assert np.abs(build.model.mean.displacement[inside]).mean() < 0.02


def test_a_build_says_what_it_was_made_of(clip, build):
    model = build.model
    assert model.identity == "drawn"
    assert model.provenance["licence"] == "CC0"
    assert model.provenance["reference"]["frame"] == build.choice.name == clip.names[build.choice.index]
    assert model.training.frame_names == clip.names
    assert (model.registration, model.flow) == ("similarity", "dis")
    assert_array_equal(model.reference, clip.pictures[build.choice.index])
    assert model.warp_weight in [trial.weight for trial in build.trials]
    assert model.provenance["warp_weight_trials"] == [[t.weight, t.psnr_db] for t in build.trials]
    assert build.warnings == ()


def test_figures_of_each_frame_are_those_of_its_flow(build):
    mask = build.model.mask
    n = len(build.model.training.frame_names)
    assert build.registrations.shape == (n, 2, 3)
    assert build.fold_fractions.shape == build.motion_px.shape == (n,)
    for index in range(n):
        frame, flow = build.frame(index)
        assert_array_equal(frame.registration, build.registrations[index])
        assert build.motion_px[index] == pytest.approx(rms_px(flow.displacement, mask), rel=1e-4)
    assert build.motion_px[build.choice.index] == 0
    assert_array_equal(build.registrations[build.choice.index], identity_affine())


def test_steps_count_up_to_their_totals(clip, tmp_path):
    steps = []
    built(clip, tmp_path, replace(PLAIN, reference=None), steps.append)
    stages = {step.stage: [s for s in steps if s.stage == step.stage] for step in steps}
    assert list(stages) == ["reference", "flow", "morphs", "components"]
    for stage in stages.values():
        assert [step.done for step in stage] == list(range(1, stage[0].total + 1))
        assert len({step.total for step in stage}) == 1


class Counting:
    """A source that counts how often each frame is decoded."""

    def __init__(self, clip):
        self.clip, self.names, self.digests = clip, clip.names, clip.digests
        self.decoded = [0] * len(clip.names)

    def images(self, indices):
        for index, image in zip(indices, self.clip.images(indices), strict=True):
            self.decoded[index] += 1
            yield image


def test_a_frame_is_decoded_once_to_look_at_it_and_once_for_its_flow(clip, tmp_path):
    detector = Detector(lambda image: None, {"version": 1})
    count = len(clip.names)
    for settings in (replace(PLAIN, reference=None), replace(PLAIN, reference=None, detector=detector)):
        source = Counting(clip)
        built(source, tmp_path / str(settings.detector is None), settings)
        assert source.decoded == [2] * count
    source = Counting(clip)
    built(source, tmp_path / "asked", PLAIN)
    assert source.decoded == [1] * count
    again = Counting(clip)
    built(again, tmp_path / "asked", PLAIN)
    assert again.decoded == [1] + [0] * (count - 1)  # the reference alone


def test_of_a_long_clip_evenly_spread_frames_are_looked_at_for_the_reference(clip, tmp_path, monkeypatch):
    few = [0, 3, 5, 8]
    monkeypatch.setattr(build_module, "POOL", len(few))
    looked_at = []
    search = build_module.search

    def searching(frames, far=None):
        place, errors = yield from search(frames)
        looked_at.append((frames, place))
        return place, errors

    monkeypatch.setattr(build_module, "search", searching)
    choice = built(clip, tmp_path, replace(PLAIN, reference=None)).choice
    ((frames, place),) = looked_at
    assert place != few[place]  # which of the four, and below which of the nine
    for index, frame in zip(few, frames, strict=True):
        assert_allclose(frame.image, clip.pictures[index], atol=1e-6)
        contrast = _mouth_contrast(clip.pictures[index], mouth_surroundings(72, 60))
        assert frame.contrast == pytest.approx(contrast)
        assert_allclose(frame.mask, face_mask(72, 60), atol=1e-6)
    assert (choice.index, choice.name) == (few[place], clip.names[few[place]])
    assert "chosen from 4 candidates" in choice.reason


def test_the_reference_of_a_long_clip_is_one_of_120_frames(picture, make_clip, tmp_path, monkeypatch):
    counts = []

    def counting(frames, far=None):
        counts.append(len(frames))
        raise KeyboardInterrupt
        yield  # a generator, as the search is

    monkeypatch.setattr(build_module, "search", counting)
    long = make_clip([picture(20, 16)] * 125)
    with pytest.raises(KeyboardInterrupt):
        built(long, tmp_path, replace(PLAIN, reference=None))
    assert counts == [120]


def test_head_movement_is_taken_out_and_kept(picture, make_clip, tmp_path):
    canvas = picture(160, 140, seed=6, sd_px=2.0)
    shifts = [(0, 0), (3, -2), (-4, 1), (2, 5)]  # px right and down; whole, so that the frames are exact
    frames = [np.ascontiguousarray(canvas[30 - y : 130 - y, 30 - x : 110 - x]) for x, y in shifts]
    result = built(make_clip(frames), tmp_path, replace(PLAIN, registration="similarity"))
    region = rigid_region(100, 80)
    y, x = np.nonzero(region > 0.5)
    points = np.column_stack([x, y]).astype(np.float64)
    for registration, shift in zip(result.registrations, shifts, strict=True):
        assert np.abs(warp.apply_affine(registration, points) - points - shift).max() < 0.1  # px
    assert result.motion_px.max() < 0.1  # px left for the warp
    still, _ = result.frame(1)
    inside = np.s_[10:-10, 10:-10]
    assert_allclose(still.image[inside], frames[0][inside], atol=0.03)  # 0.1 px on this texture


def test_where_a_frame_ends_its_texture_takes_the_colours_of_the_others(picture, make_clip, tmp_path):
    canvas = picture(160, 140, seed=6, sd_px=2.0)
    shifts = [(0, 0), (12, 0), (-12, 0), (0, 12), (0, -12)]  # px
    frames = [np.ascontiguousarray(canvas[30 - y : 130 - y, 30 - x : 110 - x]) for x, y in shifts]
    model = built(make_clip(frames), tmp_path, replace(PLAIN, registration="similarity")).model
    for loadings, (x, y) in zip(model.training.values[1:], shifts[1:], strict=True):
        seen = np.zeros((100, 80), bool)
        seen[max(-y, 0) : 100 - max(y, 0), max(-x, 0) : 80 - max(x, 0)] = True
        difference = (model.expand(loadings).texture - frames[0])[~seen]
        assert np.sqrt((difference**2).mean()) < 0.25 * canvas.std()  # the first px fade


@pytest.fixture(scope="module")
def waving(picture, wavy_field, make_clip):
    """A texture that waves smoothly, so that a stock flow finds its known warps."""
    neutral, wave = picture(96, 80, seed=12), wavy_field(96, 80, 1.0, seed=5, sd_px=12.0)
    fields = [np.float32(amount) * wave for amount in (0.0, 1.0, 2.0, 3.0, 4.0)]
    return make_clip([warp.render(neutral, field) for field in fields], fields, neutral)


def test_frames_of_a_turned_head_count_less_in_mean_shape_and_mean_face(waving, tmp_path, monkeypatch):
    weights = np.array([1.0, 1.0, 1.0, 0.5, 0.01])
    monkeypatch.setattr(FaceTrack, "weights", weights)
    settings = replace(PLAIN, components=2)
    result = built(waving, tmp_path, settings)
    fields = np.array([result.frame(index)[1].displacement for index in range(5)])
    shape = invert_mean_shape(np.average(fields, axis=0, weights=weights).astype(np.float32))
    np.testing.assert_allclose(result.model.mean_inverse, shape, atol=1e-5)
    textures = [morph_of(result.frame(i)[0].image, resource(fields[i], shape), "").texture for i in range(5)]
    inside = result.model.mask > 0.9  # outside the frames' edges a texture is painted
    expected = np.average(textures, axis=0, weights=weights)
    np.testing.assert_allclose(result.model.mean.texture[inside], expected[inside], atol=1e-4)
    assert np.abs(np.mean(textures, axis=0) - expected)[inside].max() > 0.003  # else nothing was tested
    loadings = result.model.training.values
    np.testing.assert_allclose(weights @ loadings, 0, atol=1e-3 * np.abs(loadings).max())


MARKED = FaceFrame((24.0, 36.0), (55.0, 36.0), (39.5, 60.0))


def test_the_faceframe_goes_to_the_mean_face_with_the_mean_warp(waving, tmp_path):
    result = built(waving, tmp_path, replace(PLAIN, faceframe=MARKED))
    expected = warp.move_points(np.mean(waving.fields, axis=0), MARKED.points)
    assert np.abs(expected - MARKED.points).max() > 0.5
    assert_allclose(result.model.faceframe.points, expected, atol=0.3)  # px; what the stock flow misses
    assert_array_equal(result.model.reference_faceframe.points, MARKED.points)


@pytest.mark.parametrize("index", [1, 4])
def test_a_faceframe_may_be_marked_on_any_frame(waving, tmp_path, index):
    moved = FaceFrame.at(warp.move_points(waving.fields[index], MARKED.points))
    result = built(waving, tmp_path, replace(PLAIN, faceframe=moved, faceframe_index=index))
    expected = warp.move_points(np.mean(waving.fields, axis=0), MARKED.points)
    assert_allclose(result.model.faceframe.points, expected, atol=0.3)  # px; two flows


def test_a_faceframe_on_a_frame_with_a_moved_head_is_carried_to_the_reference(picture, make_clip, tmp_path):
    canvas = picture(140, 120, seed=6, sd_px=2.0)
    shifts = [(0, 0), (4, -3), (-3, 2)]
    frames = [np.ascontiguousarray(canvas[22 - y : 118 - y, 20 - x : 100 - x]) for x, y in shifts]
    moved = FaceFrame.at(MARKED.points + shifts[1])
    settings = replace(PLAIN, registration="similarity", faceframe=moved, faceframe_index=1)
    result = built(make_clip(frames), tmp_path, settings)
    assert_allclose(result.model.faceframe.points, MARKED.points, atol=0.15)  # px


def test_a_mask_drawn_on_the_reference_goes_to_the_mean_face(waving, tmp_path):
    mask = np.zeros((96, 80), np.float32)
    mask[15:70, 12:60] = 1
    moved = built(waving, tmp_path, replace(PLAIN, mask=mask)).model.mask
    assert moved.shape == mask.shape
    assert 0 <= moved.min() <= moved.max() <= 1
    expected = warp.sample_field(mask, warp.invert(np.mean(waving.fields, axis=0)))
    miss = np.abs(moved - expected).mean()
    assert miss < 0.3 * np.abs(moved - mask).mean()
    assert miss < 0.01


def test_without_a_mask_it_is_the_ellipse(build):
    assert_array_equal(build.model.mask, face_mask(*build.model.mask.shape))


# the same again


def test_the_same_input_gives_the_same_bytes(clip, build, work, tmp_path):
    settings = replace(PLAIN, reference=None, warp_weight=None, registration="similarity")
    assert bytes_of(built(clip, tmp_path, settings), tmp_path) == bytes_of(build, tmp_path)


def test_the_default_flow_gives_the_same_bytes_each_time(clip, tmp_path):
    settings = replace(PLAIN, flow=methods.DEFAULT, registration="similarity")
    one, other = (bytes_of(built(clip, tmp_path / name, settings), tmp_path) for name in ("a", "b"))
    assert one == other


def test_a_second_build_computes_no_flow_and_gives_the_same_bytes(clip, tmp_path, monkeypatch):
    first = bytes_of(built(clip, tmp_path / "work"), tmp_path)
    monkeypatch.setitem(methods.METHODS, "dis", no_flow)
    assert bytes_of(built(clip, tmp_path / "work"), tmp_path) == first


def test_other_pca_settings_compute_no_flow(clip, tmp_path, monkeypatch):
    first = built(clip, tmp_path).model
    monkeypatch.setitem(methods.METHODS, "dis", no_flow)
    mask = np.ones(first.mask.shape, np.float32)
    for change in ({"warp_weight": 0.2}, {"warp_weight": None}, {"components": 2}, {"mask": mask}):
        other = built(clip, tmp_path, replace(PLAIN, **change)).model
        assert other.model_id != first.model_id


@pytest.mark.parametrize("change", [{"reference": 3}, {"registration": "similarity"}])
def test_what_the_flow_depends_on_computes_it_again(clip, tmp_path, monkeypatch, change):
    built(clip, tmp_path)
    monkeypatch.setitem(methods.METHODS, "dis", no_flow)
    with pytest.raises(AssertionError, match="computed again"):
        built(clip, tmp_path, replace(PLAIN, **change))


def test_a_frame_more_costs_one_flow_more(clip, make_clip, tmp_path, counted):
    built(make_clip(clip.pictures[:-1]), tmp_path)
    assert len(counted) == len(clip.pictures) - 2  # none for the reference
    built(make_clip(clip.pictures), tmp_path)
    assert len(counted) == len(clip.pictures) - 1


@pytest.mark.parametrize(("stage", "done"), [("flow", 3), ("flow", 9), ("morphs", 4), ("components", 2)])
def test_a_build_that_was_stopped_goes_on_to_the_same_bytes(clip, tmp_path, counted, stage, done):
    whole = bytes_of(built(clip, tmp_path / "whole"), tmp_path)
    once = len(counted)
    steps = build_steps(clip, PLAIN, tmp_path / "stopped", PROVENANCE)
    for step in steps:
        if (step.stage, step.done) == (stage, done):
            break
    steps.close()
    assert bytes_of(built(clip, tmp_path / "stopped"), tmp_path) == whole
    assert len(counted) == 2 * once  # none of it twice


def test_a_build_continued_after_a_failed_flow_has_the_same_bytes(clip, tmp_path, monkeypatch):
    whole = bytes_of(built(clip, tmp_path / "whole"), tmp_path)
    original = methods.METHODS["dis"]
    left = [4]

    def failing(reference):
        to_frame = original(reference)

        def failing_to_frame(frame, start):
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
            return to_frame(frame, start)

        return failing_to_frame

    monkeypatch.setitem(methods.METHODS, "dis", failing)
    with pytest.raises(KeyboardInterrupt):
        built(clip, tmp_path / "failed")
    monkeypatch.setitem(methods.METHODS, "dis", original)
    assert bytes_of(built(clip, tmp_path / "failed"), tmp_path) == whole


@pytest.mark.parametrize("size", [0, 40, 20_000])
def test_a_work_frame_cut_short_is_made_again(clip, tmp_path, size, counted):
    first = built(clip, tmp_path / "work")
    damaged = first.frame_files[5]
    damaged.write_bytes(damaged.read_bytes()[:size])
    counted.clear()
    assert bytes_of(built(clip, tmp_path / "work"), tmp_path) == bytes_of(first, tmp_path)
    assert len(counted) == 1


def test_only_work_frames_stay_in_the_work_folder(clip, tmp_path):
    result = built(clip, tmp_path)
    assert set(tmp_path.iterdir()) == set(result.frame_files)
    for file in result.frame_files:
        arrays, _ = read_result(file)
        assert set(arrays) == {"image", "registration", "flow", "confidence"}


# what cannot be a model


def test_fewer_than_three_frames_are_refused(clip, make_clip, tmp_path):
    for count in (0, 1, 2):
        with pytest.raises(BadInput, match=f"number of frames is {count}; expected at least 3"):
            built(make_clip(clip.pictures[:count]), tmp_path)
    assert built(make_clip(clip.pictures[:3]), tmp_path).model.rank == 2


def test_a_constant_clip_gives_rank_zero_a_warning_and_a_mean_that_renders(clip, make_clip, tmp_path):
    result = built(make_clip([clip.pictures[2]] * 4), tmp_path, replace(PLAIN, warp_weight=None))
    model = result.model
    assert model.rank == 0
    assert model.warp_weight == 1.0
    assert any("rank 0" in warning for warning in result.warnings)
    assert_allclose(model.render([]), clip.pictures[2], atol=1e-5)
    model.save(tmp_path / "constant.morph")


def test_frames_identical_to_the_reference_are_warned_of(clip, make_clip, tmp_path):
    pictures = [*clip.pictures[:4], clip.pictures[0], clip.pictures[0]]
    result = built(make_clip(pictures), tmp_path)
    (warning,) = result.warnings
    assert "identical to the reference frame_000" in warning
    assert "frame_004, frame_005 (2 in all)" in warning
    assert result.model.rank == 3
    assert_array_equal(result.motion_px[[0, 4, 5]], 0)


@pytest.mark.parametrize("reference", [0, None])
def test_frames_of_different_size_are_refused(clip, make_clip, picture, tmp_path, reference):
    pictures = [*clip.pictures[:4], picture(80, 64)]
    with pytest.raises(BadInput, match=r"frame_004 has 64x80 px; expected 60x72"):
        built(make_clip(pictures), tmp_path, replace(PLAIN, reference=reference))


def test_a_mask_of_the_wrong_size_is_refused(clip, tmp_path, monkeypatch):
    monkeypatch.setitem(methods.METHODS, "dis", no_flow)  # and that before any work
    with pytest.raises(BadInput, match=r"the mask is 72x60 px; expected 60x72"):
        built(clip, tmp_path, replace(PLAIN, mask=np.ones((60, 72), np.float32)))


def test_an_empty_mask_is_refused(clip, tmp_path):
    with pytest.raises(BadInput, match="the mask is empty"):
        built(clip, tmp_path, replace(PLAIN, mask=np.zeros((72, 60), np.float32)))


@pytest.mark.parametrize("components", [0, -1])
def test_fewer_than_one_component_is_refused_before_any_work(clip, tmp_path, components):
    with pytest.raises(BadInput, match=f"components is {components}; expected"):
        built(clip, tmp_path / "work", replace(PLAIN, components=components))
    assert not (tmp_path / "work").exists()
    assert built(clip, tmp_path / "work", replace(PLAIN, components=1)).model.rank == 1


def test_settings_with_a_mask_can_be_compared_and_kept_in_a_set():
    settings = replace(PLAIN, mask=np.ones((72, 60), np.float32))
    assert settings == settings
    assert settings != replace(settings)  # each is itself: arrays have no single answer
    assert len({settings, replace(settings)}) == 2


def test_an_unknown_flow_is_refused_before_any_work(clip, tmp_path):
    with pytest.raises(BadInput, match="the flow is 'magic'"):
        built(clip, tmp_path / "work", replace(PLAIN, flow="magic"))
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize("reference", [-1, 9])
def test_a_reference_beyond_the_clip_is_refused(clip, tmp_path, reference):
    with pytest.raises(BadInput, match=f"{reference}.*9 frames|9 frames.*{reference}"):
        built(clip, tmp_path, replace(PLAIN, reference=reference))
