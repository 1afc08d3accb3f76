"""The picture of a flow: what its colours and its grid mean, and that any field gives a sheet."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.flow import Flow
from morphspace.grid.warp import affine_displacement
from morphspace.report.flow_picture import (
    BEYOND,
    FOLD_INK,
    colours_of,
    flow_picture,
    rim_of,
    warped_grid,
    wheel,
)

HEIGHT, WIDTH = 30, 24
RED, YELLOW, GREEN, CYAN, BLUE, MAGENTA = np.eye(3)[0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1]


def colour_towards(turn, length_px=1.0, rim_px=1.0):
    """The colour of a displacement: `turn` is 0 to the right, 0.25 down."""
    angle = 2 * np.pi * turn
    field = np.array([[[np.cos(angle), np.sin(angle)]]], np.float32) * np.float32(length_px)
    return colours_of(field, rim_px)[0, 0]


def flow_of(field):
    return Flow(field, np.ones(field.shape[:2], np.float32))


def constant(u, v, height=HEIGHT, width=WIDTH):
    return np.broadcast_to(np.array([u, v], np.float32), (height, width, 2)).copy()


@pytest.mark.parametrize(
    ("turn", "colour"),
    [(0, RED), (15 / 55, YELLOW), (21 / 55, GREEN), (25 / 55, CYAN), (36 / 55, BLUE), (49 / 55, MAGENTA)],
)
def test_the_six_corners_of_the_wheel_stand_where_middlebury_has_them(turn, colour):
    assert_allclose(colour_towards(turn, 0.99999), colour, atol=1e-3)


def test_rest_is_white_and_length_is_saturation():
    for turn in np.linspace(0, 1, 12):
        full = colour_towards(turn, 0.99999)
        assert_allclose(colour_towards(turn, 0), 1)
        assert_allclose(colour_towards(turn, 0.25), 1 - 0.25 * (1 - full), atol=1e-4)
        assert_allclose(colour_towards(turn, 3.0, 12.0), colour_towards(turn, 0.25), atol=1e-6)
        assert_allclose(colour_towards(turn, 1.5), BEYOND * full, atol=1e-3)


def test_neighbouring_directions_have_neighbouring_colours():
    turns = np.linspace(-1, 2, 3001)  # past the seam, three times round
    colours = np.array([colour_towards(turn, 0.999) for turn in turns])
    steepest = 55 / 4  # colour per turn, from green to cyan
    assert np.abs(np.diff(colours, axis=0)).max() < 1.01 * steepest * 0.001


@given(st.floats(0.11, 5000))
def test_the_rim_is_round_and_just_beyond_the_field(length_px):
    rim_px = rim_of(constant(0.6 * length_px, 0.8 * length_px))
    assert length_px * (1 - 1e-5) <= rim_px <= 1.51 * length_px
    assert float(f"{rim_px:.2g}") == pytest.approx(rim_px)


def test_the_rim_of_a_field_at_rest_and_of_one_with_an_outlier():
    assert 0 < rim_of(constant(0, 0)) <= 0.1
    field = constant(1.9, 0)
    field[0, 0] = 500
    assert rim_of(field) == pytest.approx(2)


def test_the_wheel_shows_each_direction_at_its_own_place():
    colours, inside = wheel(101)
    assert_allclose(colours[50, 50], 1, atol=0.02)
    assert_allclose(colours[50, 99], RED, atol=0.03)
    assert_allclose(colours[99, 50], colour_towards(0.25), atol=0.03)
    assert inside[50, 50] == 1 and inside[0, 0] == 0


def test_the_grid_of_an_affine_field_is_the_grid_after_that_affine():
    affine = np.array([[1.1, 0.2, 3.0], [-0.1, 0.9, -2.0]])
    still = warped_grid(np.zeros((HEIGHT, WIDTH, 2), np.float32), 5)
    moved = warped_grid(affine_displacement(affine, HEIGHT, WIDTH), 5)
    assert len(still) == len(moved) == 6 + 5
    for before, after in zip(still, moved, strict=True):
        assert_allclose(after, before @ affine[:, :2].T + affine[:, 2], atol=1e-4)
    for row in still[:6]:
        assert_array_equal(row[:, 0], np.arange(WIDTH))
        assert np.ptp(row[:, 1]) == 0
    for column in still[6:]:
        assert_array_equal(column[:, 1], np.arange(HEIGHT))
    rows = [row[0, 1] for row in still[:6]]
    assert_array_equal(np.diff(rows), 5)
    assert rows[0] - (HEIGHT - 1 - rows[-1]) in (-1, 0, 1)


def is_marked(sheet):
    return (np.rint(255 * sheet) == FOLD_INK).all(axis=2).any()


def test_folds_are_marked_and_only_folds(picture):
    image = picture(HEIGHT, WIDTH) * 0.5  # no colour of the pictures is the red of the marks
    field = constant(0, 0)
    assert not is_marked(flow_picture(image, image, flow_of(field)))
    field[10, 10, 0] = 3
    assert is_marked(flow_picture(image, image, flow_of(field)))


@pytest.mark.parametrize(("height", "width"), [(16, 16), (16, 900), (900, 16), (480, 500)])
@pytest.mark.parametrize("amount_px", [0.0, 5.0, 5000.0])
def test_any_field_gives_a_sheet_that_can_be_seen(picture, wavy_field, height, width, amount_px):
    image = picture(height, width)
    field = wavy_field(height, width, amount_px)
    confidence = np.clip(image[..., 0], 0, 1)
    for flow in (flow_of(field), Flow(field, confidence)):
        sheet = flow_picture(image, image, flow, names=("a.png", "b.png"), figures=[("size", "1 px")] * 9)
        assert sheet.shape[2] == 3 and min(sheet.shape[:2]) > 300 and max(sheet.shape[:2]) < 2000
        assert np.isfinite(sheet).all() and sheet.min() >= 0 and sheet.max() <= 1


@pytest.mark.parametrize("name", ["", "a\nb\tc.png", "x" * 3000, "名前.png", "\udcff.png", "%s{}"])
def test_any_name_can_be_written(picture, name):
    image = picture(HEIGHT, WIDTH)
    sheet = flow_picture(image, image, flow_of(constant(1, 0)), names=(name, name), figures=[(name, name)])
    other = flow_picture(image, image, flow_of(constant(1, 0)), names=("a", "b"), figures=[("c", "d")])
    assert sheet.shape == other.shape


def test_the_same_flow_gives_the_same_sheet(picture, wavy_field):
    image, field = picture(HEIGHT, WIDTH), wavy_field(HEIGHT, WIDTH, 4.0)
    assert_array_equal(flow_picture(image, image, flow_of(field)), flow_picture(image, image, flow_of(field)))


def test_a_flow_that_explains_the_frame_leaves_less(picture):
    image = picture(64, 64)
    frame = np.roll(image, 3, axis=1)
    left, found = (
        flow_picture(image, frame, flow_of(constant(u, 0, 64, 64)))[-400:, -760:-330].mean() for u in (0, 3)
    )
    assert found > left + 0.05  # the last panel is white where nothing is left
