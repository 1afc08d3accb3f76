"""Laws of the registration flow: known motions are found, light and order change nothing, bad input is refused."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow import multiscale, pyramid
from morphspace.flow.backends import OpenCVBackend
from morphspace.flow.baselines import dis_medium
from morphspace.flow.methods import METHODS
from morphspace.flow.names import OURS
from morphspace.flow.presets import ACCURATE
from morphspace.grid import warp
from morphspace.synthetic.warped import astronaut_face, flow_pair

PRESETS = ("fast", "balanced", "accurate")
SIZE = 128
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
LEFT_RIGHT, UP_DOWN = np.array([-1, 1], np.float32), np.array([1, -1], np.float32)


@cache
def face(kind="smooth", peak_px=7.0, seed=0, size=SIZE):
    photograph, marks = astronaut_face()
    return flow_pair(photograph, marks, kind=kind, peak_px=peak_px, seed=seed, size=size)


@cache
def found(name, kind="smooth", peak_px=7.0, seed=0):
    pair = face(kind, peak_px, seed)
    return METHODS[name](pair.reference)(pair.frame, None)


def field_of(name, reference, frame, start=None):
    one, other = (np.ascontiguousarray(image) for image in (reference, frame))
    return METHODS[name](one)(other, start).displacement


def apart(field, truth):
    return np.hypot(*np.moveaxis(field - truth, -1, 0))


def error(field, pair):
    return float(apart(field, pair.truth)[pair.visible].mean())


def moved(picture, right, down, size=96, seed=3, sd_px=2.0):
    """Draw a texture, its copy moved `right` and `down` px, the true field, and where the copy is visible."""
    edge = max(abs(right), abs(down))
    canvas = picture(size + 2 * edge, size + 2 * edge, seed=seed, sd_px=sd_px)
    cut = np.s_[edge : edge + size]
    reference = np.ascontiguousarray(canvas[cut, cut])
    frame = np.ascontiguousarray(canvas[edge - down : edge - down + size, edge - right : edge - right + size])
    truth = np.broadcast_to(np.float32((right, down)), (size, size, 2)).copy()
    return reference, frame, truth, deep_inside(truth)


def deep_inside(truth):
    height, width = truth.shape[:2]
    x, y = warp.positions(truth)
    return np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) > 3


# known motions


@pytest.mark.parametrize("name", PRESETS)
def test_the_flow_of_a_picture_with_itself_is_zero_with_confidence(picture, name):
    for image in (face().reference, picture(61, 83)):
        flow = METHODS[name](image)(image, None)
        assert flow.displacement.dtype == flow.confidence.dtype == np.float32
        assert flow.displacement.shape == (*image.shape[:2], 2)
        assert flow.confidence.shape == image.shape[:2]
        assert np.abs(flow.displacement).max() < 1e-3  # px
        assert np.median(flow.confidence) > 0.98


@pytest.mark.parametrize(
    ("name", "mean_px", "most_px"),
    [("fast", 0.045, 0.12), ("balanced", 0.003, 0.03), ("accurate", 0.001, 0.01)],
)
@pytest.mark.parametrize(("right", "down"), [(3, -2), (0, 5), (-1, 0)])
def test_a_translation_is_found(picture, name, mean_px, most_px, right, down):
    reference, frame, truth, inside = moved(picture, right, down)
    miss = apart(field_of(name, reference, frame), truth)[inside]
    assert miss.mean() < mean_px
    assert np.quantile(miss, 0.98) < most_px


@pytest.mark.parametrize(("name", "mean_px"), [("fast", 0.065), ("balanced", 0.018), ("accurate", 0.012)])
@pytest.mark.parametrize("matrix", [((0.04, -0.05), (0.05, 0.03)), ((-0.06, 0.0), (0.02, 0.06))])
def test_an_affine_motion_is_found(picture, name, mean_px, matrix):
    y, x = np.mgrid[:96, :96] - 47.5
    truth = (np.stack([x, y], axis=-1) @ np.transpose(matrix) + (1.0, -1.5)).astype(np.float32)
    reference = picture(96, 96, seed=3)
    miss = apart(field_of(name, reference, warp.render(reference, truth)), truth)[deep_inside(truth)]
    assert miss.mean() < mean_px


# means of three faces, px; measured: .095 .041 .039, .216 .116 .094, .151 .070 .057
@pytest.mark.parametrize(
    ("kind", "peak_px", "most"),
    [
        ("smooth", 7.0, {"fast": 0.12, "balanced": 0.05, "accurate": 0.048}),
        ("lit", 7.0, {"fast": 0.26, "balanced": 0.14, "accurate": 0.12}),
        ("mouth", 8.0, {"fast": 0.19, "balanced": 0.09, "accurate": 0.075}),
    ],
)
def test_expressions_are_found_and_the_slower_preset_finds_them_better(kind, peak_px, most):
    seeds = (0, 1, 2)
    errors = {
        name: np.mean(
            [error(found(name, kind, peak_px, s).displacement, face(kind, peak_px, s)) for s in seeds]
        )
        for name in PRESETS
    }
    for quick, slow in pairwise(PRESETS):
        assert errors[slow] < 0.97 * errors[quick]
    for name in PRESETS:
        assert errors[name] < most[name]


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("kind", ["smooth", "mouth"])
def test_every_preset_finds_faces_better_than_a_quick_stock_flow(name, kind):
    for seed in (0, 1):
        pair = face(kind, seed=seed)
        assert error(found(name, kind, seed=seed).displacement, pair) < 0.9 * error(
            dis_medium(pair.reference, pair.frame), pair
        )


# light


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("constant", [-0.1, 0.05, 0.3])
def test_a_constant_added_to_the_frame_changes_nothing(name, constant):
    pair = face()
    change = apart(
        field_of(name, pair.reference, pair.frame + np.float32(constant)), found(name).displacement
    )
    amplified = 20 if name == "fast" else 1  # without pooling, rounding matters where texture is weak
    assert np.median(change) < 4e-5 * amplified  # px
    assert np.quantile(change, 0.95) < 2e-4 * amplified
    assert change.max() < 0.05  # rivals that are equal to rounding are exchanged


@pytest.mark.parametrize(("name", "px"), [("fast", 0.31), ("balanced", 0.16), ("accurate", 0.12)])
@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_a_gain_changes_little(name, px, gain):
    pair = face()
    assert error(field_of(name, pair.reference, pair.frame * np.float32(gain)), pair) < px


# order and sides


@pytest.mark.parametrize("name", PRESETS)
def test_mirrored_pictures_give_mirrored_fields(name):
    """Exceptions: rivals are tried in a fixed order, and a fixed grid of pixels measures the light."""
    pair, field = face(), found(name).displacement
    for axis, signs in ((1, LEFT_RIGHT), (0, UP_DOWN)):
        mirrored = field_of(name, np.flip(pair.reference, axis), np.flip(pair.frame, axis))
        change = apart(np.flip(mirrored, axis) * signs, field)
        assert change.mean() < 0.015  # px
        assert np.median(change) < 0.01


@pytest.mark.parametrize("name", PRESETS)
def test_transposed_pictures_give_transposed_fields(name):
    """Exception: the smoother filters rows before columns."""
    pair, field = face(), found(name).displacement
    transposed = field_of(name, pair.reference.transpose(1, 0, 2), pair.frame.transpose(1, 0, 2))
    change = apart(transposed.transpose(1, 0, 2)[..., ::-1], field)
    assert change.mean() < 0.03  # px
    assert np.median(change) < 0.01


@pytest.mark.parametrize("name", OURS)
def test_grey_pictures_are_repeated(name):
    pair = face(size=64, peak_px=3.0)
    reference, frame = pair.reference @ LUMA, pair.frame @ LUMA
    alone = field_of(name, reference, frame)
    assert np.abs(alone).max() > 1
    assert_array_equal(field_of(name, reference[..., None], frame[..., None]), alone)
    repeated = [np.repeat(image[..., None], 3, axis=2) for image in (reference, frame)]
    assert_array_equal(field_of(name, *repeated), alone)
    assert_array_equal(field_of(name, repeated[0], frame), alone)


def test_colour_finds_motion_that_grey_does_not(picture):
    """A red and a green texture of equal luma: only presets that compare colours find its motion."""
    canvas = picture(70, 70, seed=5)[..., 0] - np.float32(0.5)
    image = np.stack([0.5 + canvas * 0.587 / 0.299, 0.5 - canvas, 0 * canvas], axis=-1)
    reference, frame = image[3:67, 3:67], image[3:67, 1:65]
    for name in ("balanced", "accurate"):
        assert_allclose(np.median(field_of(name, reference, frame), axis=(0, 1)), (2, 0), atol=0.05)


def test_a_field_scales_with_its_picture():
    field = np.float32((2, 3))[:, None, None] * np.ones((1, 10, 20), np.float32)
    scaled = multiscale._resized_field(field, 40, 30, OpenCVBackend())
    assert scaled.shape == (2, 40, 30)
    assert_allclose(scaled[0], 3, rtol=1e-5)
    assert_allclose(scaled[1], 12, rtol=1e-5)
    assert_array_equal(field[1], 3)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(("right", "down"), [(24, 0), (-14, 20)])
def test_a_camera_that_moved_by_a_fifth_is_followed(picture, name, right, down):
    reference, frame, truth, inside = moved(picture, right, down, size=112, sd_px=2.0)
    miss = apart(field_of(name, reference, frame), truth)[inside]
    assert np.median(miss) < 0.1  # px
    assert np.quantile(miss, 0.9) < 1  # the rest lies beside what has left the frame


def test_a_global_shift_is_used_only_if_it_aligns_the_pictures(picture):
    def planes(image):
        out = 255 * np.ascontiguousarray(image.transpose(2, 0, 1))
        return out - np.median(out, axis=(1, 2), keepdims=True)

    canvas, other = picture(60, 52, seed=3, sd_px=2.0), picture(40, 36, seed=4, sd_px=2.0)
    reference, moved_on = canvas[10:50, 8:44], canvas[4:44, 13:49]
    assert_array_equal(pyramid.shift_between(planes(reference), planes(moved_on))[:, 0, 0], (-5, 6))
    assert pyramid.shift_between(planes(reference), planes(reference)) is None
    assert pyramid.shift_between(planes(reference), planes(0.5 * reference + 0.1)) is None
    assert pyramid.shift_between(planes(reference), planes(other)) is None


# starts


@pytest.mark.parametrize("name", PRESETS)
def test_a_correct_start_is_used_where_coarse_to_fine_fails(picture, wavy_field, name, monkeypatch):
    monkeypatch.setattr(
        multiscale, "shift_between", lambda reference, frame: None
    )  # it would find this motion
    reference, frame, truth, inside = moved(picture, 30, 0, size=112, sd_px=2.0)
    rough = truth + wavy_field(112, 112, 1.0, seed=8, sd_px=8.0)
    to_frame = METHODS[name](reference)
    lost = apart(to_frame(frame, None).displacement, truth)[inside]
    assert np.median(lost) > 10  # px
    for start in (truth, rough):
        flow = to_frame(frame, start)
        miss = apart(flow.displacement, truth)[inside]
        assert np.median(miss) < 0.1
        assert np.quantile(miss, 0.6) < 0.5  # the rest lies beside what has left the frame
        assert flow.confidence[inside][miss < 0.5].mean() > 0.95


@pytest.mark.parametrize("name", PRESETS)
def test_a_start_is_tried_on_a_long_strip(picture, name):
    canvas = picture(60, 440, seed=4)
    reference, frame = (np.ascontiguousarray(image) for image in (canvas[:, 40:], canvas[:, :-40]))
    truth = np.broadcast_to(np.float32((40, 0)), (60, 400, 2)).copy()
    field = field_of(name, reference, frame, truth)
    assert np.median(apart(field, truth)) < 0.1


@pytest.mark.parametrize("name", PRESETS)
def test_a_picture_of_one_scale_is_matched_in_full(picture, name):
    canvas = picture(18, 302, seed=6)
    reference, frame = (np.ascontiguousarray(image) for image in (canvas[1:-1, 2:], canvas[1:-1, :-2]))
    assert_allclose(np.median(field_of(name, reference, frame), axis=(0, 1)), (2, 0), atol=0.05)


@pytest.mark.parametrize("name", PRESETS)
def test_unrelated_pictures_have_low_confidence(picture, name):
    reference, frame = picture(128, 128, seed=1), picture(128, 128, seed=2)
    assert METHODS[name](reference)(frame, None).confidence.mean() < 0.3
    assert METHODS[name](reference)(reference, None).confidence.mean() > 0.9


@pytest.mark.parametrize("name", PRESETS)
def test_points_outside_the_frame_have_no_confidence(picture, name):
    reference, frame, _, _ = moved(picture, 6, 0)
    confidence = METHODS[name](reference)(frame, None).confidence
    assert confidence[:, -5:].mean() < 0.25
    assert confidence[8:-8, 8:-12].mean() > 0.8


def test_a_start_finds_large_motions_of_skin(picture):
    """For the fastest preset; the others find most of it without a start."""
    y, x = np.mgrid[:160, :160].astype(np.float32)
    bump = 42 * np.exp(-((x - 70) ** 2 + (y - 80) ** 2) / (2 * 24.0**2))
    truth = np.stack([bump, 0 * bump], axis=-1)
    reference = picture(160, 160, seed=5, sd_px=1.5)
    frame = warp.render(reference, truth)
    alone, helped = (
        apart(field_of("fast", reference, frame, start), truth).mean() for start in (None, truth)
    )
    assert alone > 1.0  # px
    assert helped < 0.2 * alone


@pytest.mark.parametrize("name", PRESETS)
def test_a_wrong_start_does_not_increase_the_error(wavy_field, name):
    pair = face()
    rng = np.random.default_rng(0)
    alone = error(found(name).displacement, pair)
    to_frame = METHODS[name](pair.reference)
    wrong = {
        "opposite": -pair.truth,
        "noise": rng.normal(0, 5, pair.truth.shape).astype(np.float32),
        "wavy": wavy_field(SIZE, SIZE, 10.0, seed=5, sd_px=8.0),
        "beside": np.full_like(pair.truth, 20),
        "far outside": np.full_like(pair.truth, 1e30),
    }
    for start in wrong.values():
        before = start.copy()
        flow = to_frame(pair.frame, start)
        assert error(flow.displacement, pair) < 1.2 * alone
        assert_array_equal(start, before)


@pytest.mark.parametrize("name", PRESETS)
def test_a_start_that_cannot_be_used_is_refused(name):
    pair = face(size=64, peak_px=3.0)
    to_frame = METHODS[name](pair.reference)
    with pytest.raises(SizeMismatch, match=r"shape \(64, 63, 2\); expected \(64, 64, 2\).*64x64 px"):
        to_frame(pair.frame, pair.truth[:, 1:])
    for bad in (np.nan, np.inf, 1e300):
        start = pair.truth.astype(np.float64)
        start[5, 6, 1] = bad
        with pytest.raises(BadInput, match="start holds values that are not finite"):
            to_frame(pair.frame, start)
    assert_array_equal(to_frame(pair.frame, pair.truth.astype(np.float64)).displacement.shape, (64, 64, 2))


# reproducibility


def same_bytes(one, other):
    return (
        one.displacement.tobytes() == other.displacement.tobytes()
        and one.confidence.tobytes() == other.confidence.tobytes()
    )


def test_every_scale_is_refined_at_least_once(picture, monkeypatch):
    """No warp is one warp, forth and back: the likeness is that of a warp's constraints."""
    canvas = picture(60, 52, seed=4)
    reference, frame = (np.ascontiguousarray(image) for image in (canvas[:, 2:], canvas[:, :-2]))
    found = []
    for warps in (1, 0):
        monkeypatch.setattr(multiscale, "WARPS_BACK", warps)
        preset = replace(ACCURATE, warps=(warps,))
        found.append(multiscale.method(preset)(reference)(frame))
    assert same_bytes(*found)


@pytest.mark.parametrize("name", OURS)
def test_reusing_a_reference_does_not_change_a_byte(name):
    pairs = [face(kind, 3.0, seed, 64) for kind, seed in (("smooth", 0), ("mouth", 1), ("lit", 2))]
    reference = pairs[0].reference
    keep = reference.copy()
    prepared = METHODS[name](reference)
    first = [prepared(pair.frame, None) for pair in pairs]
    kept = [flow.displacement.copy() for flow in first]
    prepared(pairs[1].frame, pairs[1].truth)
    prepared(np.zeros_like(reference), None)
    for pair, flow, field in zip(pairs, first, kept, strict=True):
        assert same_bytes(prepared(pair.frame, None), flow)
        assert same_bytes(METHODS[name](reference.copy())(pair.frame.copy(), None), flow)
        assert_array_equal(flow.displacement, field)  # the results are independent arrays
    assert_array_equal(reference, keep)


@pytest.mark.parametrize("name", OURS)
def test_threads_do_not_change_a_byte(name):
    pairs = [face("smooth", 3.0, seed, 60) for seed in range(3)]
    prepared = METHODS[name](pairs[0].reference)
    alone = [prepared(pair.frame, None) for pair in pairs]
    with ThreadPoolExecutor(3) as pool:
        for _ in range(4):
            together = list(pool.map(lambda pair: prepared(pair.frame, None), pairs))
            assert all(same_bytes(*both) for both in zip(alone, together, strict=True))


def test_a_smoother_can_be_used_by_several_threads():
    rng = np.random.default_rng(0)
    backend = OpenCVBackend()
    guide = 255 * rng.random((3, 210, 166), np.float32)  # neither side is a multiple of a strip
    smooth = backend.smoother(guide, 30.0, 10.0)
    planes = [rng.random((2, 210, 166), np.float32) for _ in range(6)]
    alone = [smooth(each) for each in planes]
    with ThreadPoolExecutor(3) as pool:
        for _ in range(5):
            for one, other in zip(alone, pool.map(smooth, planes), strict=True):
                assert_array_equal(other, one)


# confidence


@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize("cover", ["grey", "noise", "texture"])
def test_confidence_is_lower_where_the_frame_hides_the_point(picture, name, cover):
    pair = face(peak_px=4.0, seed=1, size=96)
    frame = pair.frame.copy()
    rows, columns = slice(38, 68), slice(30, 60)
    frame[rows, columns] = {
        "grey": np.float32(0.5),
        "noise": np.random.default_rng(0).random((30, 30, 3)),
        "texture": picture(30, 30, seed=77, sd_px=3.0),
    }[cover]
    confidence = METHODS[name](pair.reference)(frame, None).confidence
    x, y = warp.positions(pair.truth)
    beyond = np.maximum(np.abs(x - 44.5), np.abs(y - 52.5)) - 15  # px from the cover's edge
    assert confidence[beyond < -3].mean() < 0.8
    assert confidence[beyond > 8].mean() > 0.95
    assert confidence.min() >= 0
    assert confidence.max() <= 1


# bad input


KINDS = (
    "noise",
    "smooth",
    "dark",
    "white",
    "black",
    "dot",
    "step",
    "stripes",
    "ramp",
    "red",
    "huge",
    "faint",
)


def drawn(kind, height, width, rng):
    noise = rng.random((height, width, 3), np.float32)
    image = np.zeros_like(noise)
    match kind:
        case "noise":
            return noise
        case "smooth":
            y, x = np.mgrid[:height, :width].astype(np.float32)
            return np.stack(
                [0.5 + 0.4 * np.sin(x / 3 + y / step + rng.random()) for step in (2, 4, 9)], axis=-1
            )
        case "dark":
            return noise * np.float32(0.004)
        case "faint":
            return np.where(noise > 0.5, np.float32(0.002), np.float32(1e-39))
        case "huge":
            return np.where(noise > 0.3, np.float32(1000), np.float32(-1000))
        case "white":
            return image + 1
        case "dot":
            image[height // 2, width // 2] = 1
        case "step":
            image[:, width // 2 :] = 1
        case "stripes":
            image[:, ::2] = 1
        case "ramp":
            image += np.linspace(0, 1, width, dtype=np.float32)[:, None]
        case "red":
            image[..., 0] = noise[..., 0]
    return image


def sound(name, reference, frame, start=None):
    """Compute the flow and check every law of two arbitrary pictures; numpy errors raise, except underflow."""
    with np.errstate(divide="raise", invalid="raise", over="raise"), warnings.catch_warnings():
        warnings.simplefilter("error")
        flow = METHODS[name](reference)(frame, start)
    height, width = reference.shape[:2]
    assert flow.displacement.shape == (height, width, 2)
    assert flow.confidence.shape == (height, width)
    assert flow.displacement.dtype == flow.confidence.dtype == np.float32
    assert np.isfinite(flow.displacement).all()
    assert np.abs(flow.displacement).max() <= 2 * max(height, width)
    assert 0 <= flow.confidence.min() <= flow.confidence.max() <= 1  # and not NaN
    return flow


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    st.sampled_from(PRESETS),
    st.one_of(
        st.tuples(st.integers(16, 60), st.integers(16, 60)),
        st.tuples(st.just(16), st.integers(100, 300)),
        st.tuples(st.integers(100, 300), st.integers(16, 19)),
    ),
    st.sampled_from(KINDS),
    st.sampled_from(KINDS),
    st.one_of(st.none(), st.floats(0.1, 1e30)),
    st.integers(0, 999),
)
@example("balanced", (16, 300), "noise", "step", None, 0)
@example("accurate", (300, 16), "smooth", "noise", 5.0, 0)
@example("fast", (16, 16), "noise", "noise", None, 0)
@example("accurate", (16, 17), "huge", "dark", 1e30, 0)
@example("balanced", (33, 47), "faint", "huge", 1e20, 1)
def test_any_two_pictures_give_finite_fields_without_folds(name, size, one, other, start_px, seed):
    rng = np.random.default_rng(seed)
    start = None if start_px is None else (start_px * rng.standard_normal((*size, 2))).astype(np.float32)
    flow = sound(name, drawn(one, *size, rng), drawn(other, *size, rng), start)
    assert warp.determinants(flow.displacement).min() > 0


@pytest.mark.parametrize("size", [(16, 300), (300, 16), (17, 97), (31, 33)])
@pytest.mark.parametrize("name", PRESETS)
def test_odd_and_narrow_pictures_are_matched(picture, name, size):
    canvas = picture(size[0] + 2, size[1] + 2, seed=2)
    reference, frame = (np.ascontiguousarray(image) for image in (canvas[1:-1, 1:-1], canvas[1:-1, :-2]))
    field = sound(name, reference, frame).displacement
    assert_allclose(np.median(field, axis=(0, 1)), (1, 0), atol=0.1)


@pytest.mark.parametrize("nothing", ["white", "black", "grey", "below half a code"])
@pytest.mark.parametrize("name", OURS)
def test_flow_and_confidence_of_flat_pictures_are_zero(picture, name, nothing):
    image = picture(40, 50)
    flat = np.full_like(image, {"white": 1.0, "black": 0.0}.get(nothing, 0.4))
    if nothing == "below half a code":
        flat += np.float32(0.4 / 255) * image
    for one, other in ((flat, image), (image, flat), (flat, flat)):
        flow = sound(name, one, other)
        assert_array_equal(flow.displacement, 0)
        assert_array_equal(flow.confidence, 0)


@pytest.mark.parametrize("name", OURS)
def test_pictures_that_cannot_be_used_are_refused_in_one_line(picture, name):
    image = picture(40, 50)
    to_frame = METHODS[name](image)
    narrow, short = picture(40, 15), picture(15, 50)
    large = image.copy()
    large[0, 0] = 1e6
    bad = {
        r"15x40 px": narrow,
        r"50x15 px": short,
        r"1 values that are not finite": np.where(np.arange(6000).reshape(40, 50, 3) == 77, np.nan, image),
        r"6000 values that are not finite": np.full_like(image, np.inf),
        r"values up to 1e\+06": large,
        r"shape \(40, 50, 2\)": image[..., :2],
        r"shape \(40, 50, 4\)": np.concatenate([image, image[..., :1]], axis=2),
        r"shape \(6000,\)": image.ravel(),
        r"holds uint8": (image * 255).astype(np.uint8),
    }
    for message, picture_ in bad.items():
        with pytest.raises(BadInput, match=f"the reference.*{message}") as caught:
            METHODS[name](picture_)
        assert "\n" not in str(caught.value)
        with pytest.raises(BadInput, match=f"the frame.*{message}") as caught:
            to_frame(picture_, None)
        assert "\n" not in str(caught.value)
    with pytest.raises(SizeMismatch, match=r"the frame has 40x50 px; expected 50x40 px"):
        to_frame(picture(50, 40), None)
    assert_array_equal(to_frame(image[..., :1], None).displacement.shape, (40, 50, 2))  # one channel is grey
