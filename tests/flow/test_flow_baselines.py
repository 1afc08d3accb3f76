"""Laws of the library flows: direction, size and zero for equal pictures, on drawn movements."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.flow import baselines
from morphspace.flow.baselines import grey_codes, smoothed
from morphspace.flow.methods import DEFAULT, METHODS, named
from morphspace.grid import warp

HEIGHT, WIDTH = 96, 80
STOCK = {
    "deepflow": METHODS["deepflow"],
    "dis": METHODS["dis"],
    "DIS medium": baselines.stock(baselines.dis_medium),
    "tvl1": METHODS["tvl1"],
}


@pytest.mark.parametrize("name", STOCK)
def test_flow_of_a_picture_with_itself_is_zero(picture, name):
    image = picture(HEIGHT, WIDTH)
    field = STOCK[name](image)(image, None).displacement
    assert field.shape == (HEIGHT, WIDTH, 2)
    assert field.dtype == np.float32
    assert_allclose(field, 0, atol=1e-3)  # px


@pytest.mark.parametrize("name", STOCK)
def test_flow_points_from_the_reference_to_the_frame(picture, name):
    canvas = picture(HEIGHT + 10, WIDTH + 10, seed=2, sd_px=2.5)
    reference = np.ascontiguousarray(canvas[5:-5, 5:-5])
    frame = np.ascontiguousarray(canvas[7:-3, 2:-8])  # its content moves 3 px right and 2 px up
    field = STOCK[name](reference)(frame, None).displacement[15:-15, 15:-15]
    assert_allclose(field[..., 0], 3, atol=0.25)  # px
    assert_allclose(field[..., 1], -2, atol=0.25)


@pytest.mark.parametrize("name", STOCK)
def test_a_known_warp_is_found(picture, wavy_field, name):
    reference, truth = (
        picture(HEIGHT, WIDTH, seed=3, sd_px=2.0),
        wavy_field(HEIGHT, WIDTH, 2.5, seed=1, sd_px=12),
    )
    frame = warp.render(reference, truth)
    miss = np.hypot(*np.moveaxis(STOCK[name](reference)(frame, None).displacement - truth, -1, 0))[
        10:-10, 10:-10
    ]
    assert np.median(miss) < 0.15  # px; 8-bit grey
    assert np.percentile(miss, 95) < 0.5


def test_a_start_is_not_changed(picture):
    image, start = picture(HEIGHT, WIDTH), np.zeros((HEIGHT, WIDTH, 2), np.float32)
    for name in STOCK:
        STOCK[name](image)(picture(HEIGHT, WIDTH, 2), start)
        assert_array_equal(start, 0)


@pytest.mark.parametrize("name", STOCK)
def test_the_same_pictures_give_the_same_bits(picture, name):
    one, other = picture(HEIGHT, WIDTH, 1), picture(HEIGHT, WIDTH, 2)
    first, second = (STOCK[name](one)(other, None).displacement for _ in range(2))
    assert_array_equal(first, second)


def test_a_name_that_does_not_exist_is_refused_and_the_others_listed():
    with pytest.raises(BadInput, match=r"flow is 'magic'.*fast, .*deepflow, dis, tvl1.*built again"):
        named("magic")
    assert named(DEFAULT) is METHODS[DEFAULT]


def test_grey_codes_are_rounded_luma():
    pure = np.eye(3, dtype=np.float32)[None]
    assert_array_equal(grey_codes(pure), [[76, 150, 29]])  # BT.601: 76.245, 149.685, 29.07
    assert_array_equal(grey_codes(np.float32([[[2, 2, 2], [-1, -1, -1], [1, 1, 1]]])), [[255, 0, 255]])


def test_smoothing_keeps_a_constant_field_and_the_mean_of_any(wavy_field):
    constant = np.full((HEIGHT, WIDTH, 2), 1.5, np.float32)
    assert_allclose(smoothed(constant), 1.5, atol=1e-5)
    spike = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    spike[HEIGHT // 2, WIDTH // 2, 0] = 1
    out = smoothed(spike)
    _, x = np.mgrid[:HEIGHT, :WIDTH]
    assert out[..., 0].sum() == pytest.approx(1, abs=1e-4)
    spread = (out[..., 0] * (x - WIDTH // 2) ** 2).sum()
    assert np.sqrt(spread) == pytest.approx(baselines.SMOOTHING * WIDTH, rel=0.03)
    assert_array_equal(out[..., 1], 0)
