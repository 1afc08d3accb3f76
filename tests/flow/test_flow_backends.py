"""Laws of the primitives: torch equals OpenCV on pictures of any shape, and so does the flow on both."""

import builtins
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from morphspace.errors import BadInput
from morphspace.flow.backends import OpenCVBackend
from morphspace.flow.constraints import Channels
from morphspace.flow.filters import gaussian_derivative
from morphspace.flow.methods import _named_backend
from morphspace.flow.multiscale import method
from morphspace.flow.presets import PRESETS, Preset
from morphspace.grid import warp
from morphspace.synthetic.warped import astronaut_face, flow_pair

CV = OpenCVBackend()
SHAPES = ((48, 40), (33, 27), (16, 400), (400, 16), (7, 3), (2, 40), (40, 2), (1, 25), (25, 1), (1, 1))
CODES = 255.0
ROUNDING = 1e-6 * CODES  # a few float32 roundings of codes 0 to 255
FLOW_PX = 0.01  # px; tolerance between the backends


@pytest.fixture(scope="module")
def ours():
    """Return the torch backend, on a GPU if there is one."""
    torch = pytest.importorskip("torch")
    torch.set_num_threads(1)
    return _named_backend("torch")


def noise(shape, seed=0, planes=3):
    return (CODES * np.random.default_rng(seed).random((planes, *shape))).astype(np.float32)


def soft(shape, seed=0, planes=3):
    """Draw a smooth random picture (planes, h, w) with codes from 0 to 255."""
    out = ndimage.gaussian_filter(noise(shape, seed, planes), (0, 2, 2), mode="mirror")
    out -= out.min()
    return (CODES * out / max(out.max(), 1e-6)).astype(np.float32)


def positions(shape, seed=0, beyond_px=6.0):
    """Draw random (x, y) px, some of them outside the picture."""
    height, width = shape
    random = np.random.default_rng(seed)
    x = random.uniform(-beyond_px, width - 1 + beyond_px, shape)
    y = random.uniform(-beyond_px, height - 1 + beyond_px, shape)
    return x.astype(np.float32), y.astype(np.float32)


def on(backend, *arrays):
    return tuple(backend.planes(array) for array in arrays)


# each primitive


@pytest.mark.parametrize("radius", [3, 6, 15])
@pytest.mark.parametrize("shape", SHAPES)
def test_filters_agree_at_any_size(ours, shape, radius):
    planes = noise(shape)
    for order in (0, 1, 2):
        across, down = (
            gaussian_derivative(order, 1.0, radius=radius),
            gaussian_derivative(0, 2.0, radius=radius),
        )
        found = ours.numpy(ours.filtered(ours.planes(planes), across, down))
        assert found.dtype == np.float32
        assert_allclose(found, CV.filtered(planes, across, down), rtol=0, atol=ROUNDING)


def test_a_kernel_correlates_and_keeps_its_axes(ours):
    planes = np.zeros((1, 9, 11), np.float32)
    planes[0, 4, 5] = 1
    found = ours.numpy(ours.filtered(ours.planes(planes), np.array([1.0, 2, 4]), np.array([0.0, 8, 32])))[0]
    assert_array_equal(found[3:5, 4:7], [[128, 64, 32], [32, 16, 8]])
    assert found.sum() == 280


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_sampler_reads_the_interpolating_spline(ours, shape, count):
    planes = noise(shape, planes=count)
    x, y = positions(shape)
    inside = np.stack([np.clip(y, 0, shape[0] - 1), np.clip(x, 0, shape[1] - 1)]).astype(np.float64)
    truth = [ndimage.map_coordinates(plane.astype(float), inside, order=3, mode="mirror") for plane in planes]
    found = ours.numpy(ours.sampler(ours.planes(planes))(*on(ours, x, y)))
    assert_allclose(found, truth, rtol=0, atol=3 * ROUNDING)


@pytest.mark.parametrize("shape", SHAPES)
def test_samplers_agree_on_smooth_pictures(ours, shape):
    planes = soft(shape)
    x, y = positions(shape)
    found = ours.numpy(ours.sampler(ours.planes(planes))(*on(ours, x, y)))
    # codes; float32 rounds OpenCV's positions to 3e-5 px at 400 px
    assert_allclose(found, CV.sampler(planes)(x, y), rtol=0, atol=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_look_ups_agree_inside_and_outside(ours, shape):
    planes = noise(shape, planes=2)
    x, y = positions(shape)
    found = ours.numpy(ours.looked_up(ours.planes(planes), *on(ours, x, y)))
    assert_allclose(found, CV.looked_up(planes, x, y), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("shape", SHAPES)
def test_resized_planes_agree_up_and_down(ours, shape):
    planes = noise(shape, planes=2)
    height, width = shape
    for down, across in ((0.8, 0.8), (0.5, 0.5), (1 / 0.7, 1 / 0.7), (1, 2), (0.3, 3)):
        size = max(1, round(height * down)), max(1, round(width * across))
        found = ours.numpy(ours.resized_linearly(ours.planes(planes), *size))
        assert found.shape == (2, *size)
        # codes; OpenCV rounds the position to float32
        assert_allclose(found, CV.resized_linearly(planes, *size), rtol=0, atol=4 * ROUNDING)


@pytest.mark.parametrize("shape", [*SHAPES, (90, 70)])
def test_averages_over_areas_agree_at_any_ratio(ours, shape):
    planes = noise(shape, planes=2)
    for ratio in (1, 1.7, 3, 8):
        size = tuple(max(1, round(side / ratio)) for side in shape)
        found = ours.numpy(ours.averaged(ours.planes(planes), *size))
        assert_allclose(found, CV.averaged(planes, *size), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("shape", SHAPES)
def test_medians_are_the_same_to_the_bit(ours, shape):
    levels = np.random.default_rng(3).integers(0, 2, (2, *shape)).astype(np.float32)  # many ties
    for planes in (noise(shape), levels):
        assert_array_equal(ours.numpy(ours.median(ours.planes(planes))), CV.median(planes))


@pytest.mark.parametrize("guides", [1, 3])
@pytest.mark.parametrize(("strength", "edge_codes"), [(10.0, 8.0), (300.0, 20.0)])
@pytest.mark.parametrize("shape", SHAPES)
def test_smoothers_agree(ours, shape, strength, edge_codes, guides):
    guide = 1.2 * soft(shape, seed=1, planes=guides) - 20  # partly outside 0 to 255
    planes = noise(shape, planes=2)
    found = ours.numpy(ours.smoother(ours.planes(guide), strength, edge_codes)(ours.planes(planes)))
    # of the largest code; OpenCV's own distance from the exact solution
    assert_allclose(found, CV.smoother(guide, strength, edge_codes)(planes), rtol=0, atol=1e-5 * CODES)


@pytest.mark.parametrize("guides", [1, 3])
@pytest.mark.parametrize(("strength", "edge_codes"), [(0.1, 8.0), (20.0, 10.0), (3000.0, 20.0)])
@pytest.mark.parametrize("shape", SHAPES)
def test_recursive_smoothers_agree(ours, shape, strength, edge_codes, guides):
    guide = 1.2 * soft(shape, seed=1, planes=guides) - 20
    planes = noise(shape, planes=2)
    found = ours.numpy(ours.recursive_smoother(ours.planes(guide), strength, edge_codes)(ours.planes(planes)))
    expected = CV.recursive_smoother(guide, strength, edge_codes)(planes)
    assert_allclose(found, expected, rtol=0, atol=2e-6 * CODES)


@pytest.mark.parametrize("strength", [2.0, 20.0])
def test_a_recursive_smoother_has_the_impulse_response_of_one_global_round(strength):
    dot = np.zeros((1, 101, 101), np.float32)
    dot[0, 50, 50] = 1
    found = CV.recursive_smoother(np.zeros_like(dot), strength, 10.0)(dot)[0]
    middle = 1 + 1 / (2 * strength)
    pole = middle - np.sqrt(middle**2 - 1)  # pole / (1 - pole)^2 = strength
    line = (1 - pole) / (1 + pole) * pole ** np.abs(np.arange(101) - 50)
    assert_allclose(found, np.outer(line, line), rtol=0, atol=1e-6)


@pytest.mark.parametrize(("at_32_px", "is_seen"), [(3e-7, True), (5e-8, False)])
def test_a_pixel_has_an_effect_down_to_a_ten_millionth(ours, at_32_px, is_seen):
    """LEAST_COUPLING: the share that remains 32 px away decides about pixels farther away."""
    pole = at_32_px ** (1 / 32)
    dot = np.zeros((1, 1, 64), np.float32)
    dot[..., 0] = 1
    flat = ours.planes(np.zeros_like(dot))
    found = ours.numpy(ours.recursive_smoother(flat, pole / (1 - pole) ** 2, 10.0)(ours.planes(dot)))
    assert (found[0, 0, 40] > 0) == is_seen


def test_a_recursive_smoother_stops_at_a_step_of_its_guide():
    guide = np.zeros((1, 40, 60), np.float32)
    guide[..., 30:] = 120
    field = np.where(guide > 0, np.float32(5), np.float32(-5))
    found = CV.recursive_smoother(guide, 20.0, 10.0)(field)
    assert_allclose(found, field, rtol=0, atol=0.2)
    free = CV.recursive_smoother(np.zeros_like(guide), 20.0, 10.0)(field)
    assert abs(free[0, 20, 29]) < 1


@pytest.mark.parametrize("kind", ["smoother", "recursive_smoother"])
@pytest.mark.parametrize("strength", [1e-3, 1.0, 1e4, 1e7])
def test_smoothing_keeps_a_constant_and_all_extremes(ours, kind, strength):
    guide, planes = soft((40, 56)), noise((40, 56), planes=2)
    smooth = getattr(ours, kind)(ours.planes(guide), strength, 8.0)
    assert_allclose(ours.numpy(smooth(ours.planes(np.full_like(planes, 7)))), 7, rtol=1e-5)
    found = ours.numpy(smooth(ours.planes(planes)))
    assert planes.min() - ROUNDING <= found.min()
    assert found.max() <= planes.max() + ROUNDING


def test_results_are_new_planes(ours):
    x, y = positions((9, 7))
    for results in (
        lambda b, planes: b.filtered(planes, np.ones(1), np.ones(1)),
        lambda b, planes: b.resized_linearly(planes, 9, 7),
        lambda b, planes: b.averaged(planes, 9, 7),
        lambda b, planes: b.median(planes),
        lambda b, planes: b.smoother(planes, 0.0, 8.0)(planes),
        lambda b, planes: b.recursive_smoother(planes, 1.0, 8.0)(planes),
        lambda b, planes: b.looked_up(planes, *on(b, x, y)),
    ):
        for backend in (CV, ours):
            planes = backend.planes(np.ones((1, 9, 7)))
            out = results(backend, planes)
            out += 1
            assert_array_equal(backend.numpy(planes), 1)


@pytest.mark.parametrize("count", [1, 3])
def test_dots_sum_over_the_planes(ours, count):
    shape = (2, count, 9, 7)
    a, b = (noise((9, 7), seed, planes=2 * count).reshape(shape) for seed in (1, 2))
    a = a - 100
    weights = noise((9, 7), 3, planes=2) / CODES
    for backend in (CV, ours):
        found = backend.dot(*on(backend, a, b))
        assert_allclose(backend.numpy(found), (a * b).sum(1), rtol=1e-5, atol=ROUNDING * CODES)
        found = backend.weighted_dot(*on(backend, weights, a, b))
        expected = (weights[:, None] * a * b).sum((0, 1))
        assert_allclose(backend.numpy(found), expected, rtol=1e-5, atol=2 * ROUNDING * CODES)


def test_a_bank_is_its_filters_one_by_one(ours):
    planes = noise((20, 30), 4)
    across, down = ([gaussian_derivative(n, sd_px) for n in range(3)] for sd_px in (1.0, 0.7))
    kernels = [(across[i], down[j]) for i, j in ((0, 0), (1, 0), (1, 2))]  # two share a kernel
    for backend in (CV, ours):
        (own,) = on(backend, planes)
        found = backend.numpy(backend.bank(own, kernels))
        assert found.shape == (3, *planes.shape)
        for layer, (across, down) in zip(found, kernels, strict=True):
            alone = backend.numpy(backend.filtered(own, across, down))
            assert_allclose(layer, alone, rtol=0, atol=ROUNDING * CODES)


def test_planes_are_float32_copies(ours):
    array = np.arange(12.0).reshape(3, 2, 2).transpose(1, 2, 0)
    array.flags.writeable = False
    planes = ours.planes(array)
    planes *= 2
    back = ours.numpy(planes)
    assert back.dtype == np.float32
    assert_array_equal(back, 2 * array)
    single = np.ones((1, 2, 2), np.float32)
    mine = ours.planes(single)
    mine += 1
    assert_array_equal(single, 1)


# the flow

CHANNELS = Channels(weights=(1.0, 1.0, 1.0), sd_px=0.6, noise_codes=1.0, light_codes=10.0)


def preset(colours, rivals_px, checked_px=0):
    return Preset(
        colours=colours,
        finest=1.0,
        factor=0.7,
        warps=(2, 3, 4),
        channels=CHANNELS,
        rivals_px=rivals_px,
        checked_px=checked_px,
    )


def apart_px(backend, chosen, reference, frame):
    """Compute the distance between the fields of both backends at each pixel, px."""
    theirs = method(chosen, CV)(reference)(frame).displacement
    mine = method(chosen, backend)(reference)(frame).displacement
    assert mine.dtype == np.float32
    return np.hypot(*(mine - theirs).transpose(2, 0, 1)), theirs


@pytest.mark.parametrize("colours", ["grey", "rgb"])
@pytest.mark.parametrize("shape", [(96, 80), (61, 97), (16, 150)])
def test_the_flow_is_the_same_on_both(ours, picture, wavy_field, shape, colours):
    reference, true = picture(*shape, seed=4), wavy_field(*shape, 3.0, seed=5)
    apart, field = apart_px(ours, preset(colours, 0), reference, warp.render(reference, true))
    assert np.hypot(*field.transpose(2, 0, 1)).max() > 1  # there is motion
    assert apart.max() < FLOW_PX


@pytest.mark.parametrize("name", ["fast", "balanced"])
def test_the_flow_of_a_face_is_the_same(ours, name):
    photograph, marks = astronaut_face()
    pair = flow_pair(photograph, marks, kind="mouth", peak_px=8.0, size=128)
    apart, field = apart_px(ours, PRESETS[name], pair.reference, pair.frame)
    assert np.hypot(*field.transpose(2, 0, 1)).max() > 4
    assert apart.max() < FLOW_PX


@pytest.mark.parametrize("checked_px", [0, 64])
def test_the_flow_of_a_face_is_the_same_but_for_a_few_close_choices(ours, checked_px):
    photograph, marks = astronaut_face()
    pair = flow_pair(photograph, marks, kind="mouth", peak_px=8.0, size=96)
    apart, _ = apart_px(ours, preset("rgb", 140, checked_px), pair.reference, pair.frame)
    # two rivals may be equal to rounding, and then the choice is arbitrary: no error of a primitive
    assert np.median(apart) < 1e-4
    assert np.quantile(apart, 0.99) < FLOW_PX
    assert apart.max() < 0.3


def test_the_same_pair_gives_the_same_bytes(ours, picture, wavy_field):
    reference = picture(64, 56, seed=1)
    frame = warp.render(reference, wavy_field(64, 56, 2.0, seed=2))
    first, second = (method(preset("rgb", 140), ours)(reference)(frame).displacement for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_only_the_result_leaves_the_device(monkeypatch, picture):
    torch = pytest.importorskip("torch")
    backend = _named_backend("torch:cpu")
    backend.device = torch.device("meta")  # shapes without values; mixing it with the CPU raises, as on a GPU
    monkeypatch.setattr(torch.Tensor, "__float__", lambda tensor: 1.0)  # the smoother reads when to stop
    back = []

    def shapes_alone(planes):
        back.append(planes.device.type)
        return np.zeros(planes.shape, np.float32)

    monkeypatch.setattr(backend, "numpy", shapes_alone)
    to_frame = method(preset("rgb", 140, 24), backend)(picture(30, 24, seed=1))  # two scales, every step
    assert to_frame(picture(30, 24, seed=2)).displacement.shape == (30, 24, 2)
    assert set(back) == {"meta"}


# choice by name


def test_opencv_is_chosen_by_name():
    assert isinstance(_named_backend("opencv"), OpenCVBackend)


def test_torch_uses_a_gpu_if_there_is_one(ours):
    import torch

    chosen = _named_backend("torch").planes(np.ones((1, 2, 2)))
    assert chosen.device.type == ("cuda" if torch.cuda.is_available() else "cpu")
    assert _named_backend("torch:cpu").planes(np.ones((1, 2, 2))).device.type == "cpu"


@pytest.mark.parametrize("name", ["numpy", "", "opencv:cpu", "tensorflow", "torchcpu"])
def test_an_unknown_backend_is_named(name):
    with pytest.raises(BadInput, match=f"backend is {name!r}; expected opencv, torch"):
        _named_backend(name)


@pytest.mark.parametrize("device", ["gpu", "meta", "cuda:x", "cuda:99", "cpu:cpu"])
def test_a_missing_device_is_named(device):
    pytest.importorskip("torch")
    with pytest.raises(BadInput, match=repr(device)) as caught:
        _named_backend(f"torch:{device}")
    assert "Choose" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_without_torch_the_extra_is_named(monkeypatch):
    load = builtins.__import__

    def without_torch(name, *arguments, **keywords):
        if name == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")
        return load(name, *arguments, **keywords)

    import morphspace.flow

    monkeypatch.delitem(sys.modules, "morphspace.flow.torch_backend", raising=False)
    monkeypatch.delattr(morphspace.flow, "torch_backend", raising=False)
    monkeypatch.setattr(builtins, "__import__", without_torch)
    with pytest.raises(BadInput, match=r"install morphspace\[torch\]"):
        _named_backend("torch")
