"""Laws of sampling, inverting and composing: truth from algebra, scipy's splines and scipy's triangulation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator

from morphspace.grid import warp

HEIGHT, WIDTH = 60, 72
EXACT_PX = 2e-3  # float32 rounding of positions near 100 px, through one division by a triangle's area


def grid(height=HEIGHT, width=WIDTH):
    y, x = np.mgrid[:height, :width].astype(np.float32)
    return x, y


def field_of(right, down):
    shape = np.broadcast_shapes(np.shape(right), np.shape(down), (HEIGHT, WIDTH))
    return np.stack([np.broadcast_to(right, shape), np.broadcast_to(down, shape)], axis=-1).astype(np.float32)


def moved_on_triangles(displacement, x, y):
    """p + u(p) by the documented rule: cells cut from upper right to lower left, linear in each triangle."""
    height, width = displacement.shape[:2]
    column = np.clip(np.floor(x), 0, width - 2).astype(int)
    row = np.clip(np.floor(y), 0, height - 2).astype(int)
    s, t = (x - column)[..., None], (y - row)[..., None]
    a, b = displacement[row, column], displacement[row, column + 1]
    c, d = displacement[row + 1, column], displacement[row + 1, column + 1]
    upper = a + s * (b - a) + t * (c - a)
    lower = d + (1 - s) * (c - d) + (1 - t) * (b - d)
    return np.stack([x, y], axis=-1) + np.where(s + t <= 1, upper, lower)


# sampling


@pytest.mark.parametrize("shape", [(HEIGHT, WIDTH, 3), (HEIGHT, WIDTH)])
def test_sampling_a_constant_is_that_constant_inside_and_outside(wavy_field, shape):
    constant = np.full(shape, 0.37, np.float32)
    assert_allclose(warp.sample(constant, wavy_field(HEIGHT, WIDTH, 40.0)), constant, atol=1e-6)


def test_sampling_a_ramp_is_exact(wavy_field):
    x, y = grid()
    field = wavy_field(HEIGHT, WIDTH, 5.0, seed=2)
    found = warp.sample(np.stack([x, y, 2 * x - y], axis=-1), field)
    expected_x, expected_y = x + field[..., 0], y + field[..., 1]
    inside = np.s_[16:-16, 16:-16]  # a mirrored ramp has a kink at the edge, felt for a dozen pixels
    assert_allclose(found[..., 0][inside], expected_x[inside], atol=1e-4)  # px
    assert_allclose(found[..., 1][inside], expected_y[inside], atol=1e-4)
    assert_allclose(found[..., 2][inside], (2 * expected_x - expected_y)[inside], atol=3e-4)


def test_sampling_is_the_mirrored_cubic_spline_of_scipy(picture, wavy_field):
    image = picture(HEIGHT, WIDTH, seed=3, sd_px=0.6)
    field = wavy_field(HEIGHT, WIDTH, 9.0, seed=4)
    x, y = grid()
    at = np.clip(y + field[..., 1], 0, HEIGHT - 1), np.clip(x + field[..., 0], 0, WIDTH - 1)
    theirs = np.stack(
        [
            ndimage.map_coordinates(image[..., c].astype(np.float64), at, order=3, mode="mirror")
            for c in range(3)
        ],
        axis=-1,
    )
    assert_allclose(
        warp.sample(image, field), theirs, atol=5e-5
    )  # float32 positions: 4e-6 px times the slope


def test_outside_the_image_the_nearest_edge_point_is_read(picture):
    image = picture(HEIGHT, WIDTH)
    far = warp.sample(image, field_of(-500.0, 0.0))
    assert_allclose(far, np.broadcast_to(image[:, :1], image.shape), atol=1e-6)
    assert_allclose(
        warp.sample(image, field_of(500.0, 500.0)), np.broadcast_to(image[-1:, -1:], image.shape), atol=1e-6
    )


def test_the_grid_of_the_field_decides_the_size_of_the_result(picture):
    image = picture(40, 50)
    out = warp.sample(image, np.full((20, 30, 2), 4.0, np.float32))
    assert_allclose(out, image[4:24, 4:34], atol=1e-6)


def test_first_axis_of_a_field_points_right_the_second_down(picture):
    image = picture(HEIGHT, WIDTH)
    assert_allclose(warp.sample(image, field_of(3.0, 0.0))[:, :-3], image[:, 3:], atol=1e-6)
    assert_allclose(warp.sample(image, field_of(0.0, 3.0))[:-3], image[3:], atol=1e-6)


def test_sample_leaves_its_inputs_alone(picture, wavy_field):
    image, field = picture(HEIGHT, WIDTH), wavy_field(HEIGHT, WIDTH, 3.0)
    before = image.copy(), field.copy()
    warp.sample(image, field)
    warp.invert(field)
    assert_array_equal(image, before[0])
    assert_array_equal(field, before[1])


def test_a_field_is_read_linearly_and_its_edge_continues(wavy_field):
    field = wavy_field(HEIGHT, WIDTH, 4.0, seed=6)
    shift = wavy_field(HEIGHT, WIDTH, 30.0, seed=7)
    x, y = grid()
    at = np.clip(y + shift[..., 1], 0, HEIGHT - 1), np.clip(x + shift[..., 0], 0, WIDTH - 1)
    theirs = np.stack([ndimage.map_coordinates(field[..., c], at, order=1) for c in range(2)], axis=-1)
    assert_allclose(warp.sample_field(field, shift), theirs, atol=1e-4)  # px; float32 positions
    assert_allclose(warp.sample_field(field[..., 0], shift), theirs[..., 0], atol=1e-4)


# inverting


def test_field_composed_with_its_inverse_is_zero_inside(wavy_field):
    field = wavy_field(HEIGHT, WIDTH, 4.0, seed=8)
    assert warp.determinants(field).min() > 0
    inverse = warp.invert(field)
    x, y = grid()
    px, py = x + inverse[..., 0], y + inverse[..., 1]
    inside = (px >= 0) & (px <= WIDTH - 1) & (py >= 0) & (py <= HEIGHT - 1)
    assert inside.mean() > 0.8
    back = moved_on_triangles(field, px, py)
    assert_allclose(back[..., 0][inside], x[inside], atol=EXACT_PX)
    assert_allclose(back[..., 1][inside], y[inside], atol=EXACT_PX)


def test_inverse_is_that_of_scipys_triangulation(wavy_field):
    field = wavy_field(HEIGHT, WIDTH, 5.0, seed=9)
    assert warp.determinants(field).min() > 0
    x, y = grid()
    moved = np.stack([(x + field[..., 0]).ravel(), (y + field[..., 1]).ravel()], axis=-1)
    source = np.stack([x.ravel(), y.ravel()], axis=-1)
    theirs = LinearNDInterpolator(moved, source)(np.stack([x, y], axis=-1)) - np.stack([x, y], axis=-1)
    inside = np.s_[8:-8, 8:-8]
    miss = np.hypot(*np.moveaxis(warp.invert(field)[inside] - theirs[inside], -1, 0))
    assert np.isfinite(miss).all()
    assert np.median(miss) <= 0.02  # px; the two cut cells along different diagonals
    assert np.percentile(miss, 99) <= 0.3


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    angle=st.floats(-0.4, 0.4),
    scale=st.floats(0.6, 1.8),
    shift=st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
)
def test_inverse_of_an_affine_field_is_the_field_of_the_inverse_affine(angle, scale, shift):
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = np.column_stack([linear, shift])
    found = warp.invert(warp.affine_displacement(affine, HEIGHT, WIDTH))
    expected = warp.affine_displacement(warp.inverse_affine(affine), HEIGHT, WIDTH)
    x, y = grid()
    px, py = x + expected[..., 0], y + expected[..., 1]
    # within 1e-4 of a ring cell's size of the edge (`EDGE_TOLERANCE`) the ring's own triangle may answer
    inside = (px >= 0.01) & (px <= WIDTH - 1.01) & (py >= 0.01) & (py <= HEIGHT - 1.01)
    assert_allclose(found[inside], expected[inside], atol=EXACT_PX)


def test_outside_the_grid_the_field_goes_on_with_its_edge_values():
    shift = field_of(3.0, -2.0)
    assert_allclose(warp.invert(shift), -shift, atol=EXACT_PX)
    x, _ = grid()
    widened = field_of(0.5 * (x - WIDTH / 2), 0.0)  # pushes 18 px out at each side
    narrowed = field_of(-0.5 * (x - WIDTH / 2), 0.0)  # leaves 18 px uncovered at each side
    assert np.isfinite(warp.invert(widened)).all()
    inverse = warp.invert(narrowed)
    assert_allclose(inverse[:, :10, 0], -narrowed[0, 0, 0], atol=EXACT_PX)
    assert_allclose(inverse[:, -10:, 0], -narrowed[0, -1, 0], atol=EXACT_PX)


def opening_mouth(half_px):
    """The skin between rows 29 and 30 is stretched over 2 half_px + 1 px in the middle columns."""
    x, y = grid()
    bell = np.exp(-(((x - WIDTH / 2) / 14) ** 2))
    far = np.exp(-(((y - 29.5) / 14) ** 2))
    return field_of(0.0, half_px * np.sign(y - 29.5) * bell * far)


def test_an_opening_mouth_is_inverted_exactly_where_the_fixed_point_iteration_fails():
    field = opening_mouth(10.0)
    column = WIDTH // 2
    assert warp.determinants(field).min() > 0
    top, bottom = 29 + field[29, column, 1], 30 + field[30, column, 1]
    assert bottom - top > 20
    rows = np.arange(np.ceil(top), np.floor(bottom) + 1)
    expected = 29 + (rows - top) / (bottom - top) - rows
    found = warp.invert(field)[rows.astype(int), column]
    assert_allclose(found[:, 1], expected, atol=EXACT_PX)
    assert_allclose(found[:, 0], 0, atol=EXACT_PX)
    guess = np.zeros_like(field)
    for _ in range(20):
        guess = -warp.sample_field(field, guess)
    wrong = np.abs(guess[rows.astype(int), column, 1] - expected)
    assert wrong.max() > 5  # px: what the module's first paragraph says


def test_an_opening_mouth_renders_with_its_whole_gap():
    texture = np.ones((HEIGHT, WIDTH, 3), np.float32)
    texture[24:36] = (
        0  # the dark of the mouth; so wide that the spline of its edges has died away at the slit
    )
    column = WIDTH // 2
    for half_px in (2.0, 5.0, 10.0):
        field = opening_mouth(half_px)
        edges = [row + np.interp(row, np.arange(HEIGHT), field[:, column, 1]) for row in (23.5, 35.5)]
        dark = (1 - warp.render(texture, field)[:, column, 0]).sum()
        assert dark == pytest.approx(edges[1] - edges[0], abs=0.5)  # px


@pytest.mark.parametrize("moved", [3, -3])
def test_where_the_texture_ends_the_picture_goes_on_mirrored(picture, moved):
    texture = picture(12, 16, seed=2)
    field = np.full((12, 16, 2), moved, np.float32)
    expected = np.pad(texture, ((3, 3), (3, 3), (0, 0)), mode="reflect")[3 - moved :, 3 - moved :][:12, :16]
    assert_allclose(warp.render(texture, field), expected, atol=1e-5)


def folded_line(positions):
    """A field that moves the columns to these x, the same in each row."""
    x, _ = grid(12, len(positions))
    return np.stack([np.asarray(positions, np.float32) - x, np.zeros_like(x)], axis=-1)


def test_where_a_field_folds_the_most_stretched_wins():
    # columns 0..4 stay, 4..5 turn back by 2, 5.. go on with steps of 1.75: x = 2..4 is covered three times
    positions = [0, 1, 2, 3, 4, 2, 3.75, 5.5, 7.25, 9, 10, 11, 12, 13]
    inverse = warp.invert(folded_line(positions))
    found = (np.arange(len(positions)) + inverse[5, :, 0])[2:5]
    expected = np.interp([2, 3, 4], [2, 3.75, 5.5], [5, 6, 7])
    expected[0] = 5.0
    assert_allclose(found[1:], expected[1:], atol=EXACT_PX)
    assert_allclose(found[0], 5.0, atol=EXACT_PX)


def test_where_a_field_folds_what_is_turned_over_loses():
    # the turned-over cell 4..5 is stretched tenfold, and shows nowhere
    positions = [0, 2, 4, 8, 13, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]
    inverse = warp.invert(folded_line(positions))
    source = np.arange(len(positions)) + inverse[5, :, 0]
    assert not ((source > 4 + EXACT_PX) & (source < 5 - EXACT_PX)).any()


def brute_force_inverse(displacement, width, height, margin):
    """The documented rule, triangle by triangle: for each pixel its source, the winner's stretch and its lead.

    The field is continued by `margin` cells of ordinary size; pixels near a triangle's edge have no lead.
    """
    field = np.pad(displacement.astype(np.float64), ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    y, x = np.mgrid[: field.shape[0], : field.shape[1]] - margin
    source = np.stack([x, y], axis=-1).astype(np.float64)
    moved = source + field
    corners = [
        (source[i : i - 1 or None, j : j - 1 or None], moved[i : i - 1 or None, j : j - 1 or None])
        for i in (0, 1)
        for j in (0, 1)
    ]
    (a, b, c, d) = [(s.reshape(-1, 2), m.reshape(-1, 2)) for s, m in corners]
    found = np.full((height, width, 2), np.nan)
    lead = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            hits, near_edge = [], False
            for (o, om), (e, em), (f, fm) in ((a, b, c), (d, c, b)):
                edge_e, edge_f, q = em - om, fm - om, np.array([column, row]) - om
                stretch = edge_e[:, 0] * edge_f[:, 1] - edge_e[:, 1] * edge_f[:, 0]
                safe = np.where(stretch == 0, np.inf, stretch)
                along = (q[:, 0] * edge_f[:, 1] - q[:, 1] * edge_f[:, 0]) / safe
                beside = (edge_e[:, 0] * q[:, 1] - edge_e[:, 1] * q[:, 0]) / safe
                depth = np.minimum(np.minimum(along, beside), 1 - along - beside)
                near_edge |= bool((np.abs(depth[stretch != 0]) < 1e-3).any())
                for k in np.flatnonzero((depth >= 0) & (stretch != 0)):
                    hits.append((stretch[k], o[k] + along[k] * (e[k] - o[k]) + beside[k] * (f[k] - o[k])))
            hits.sort(key=lambda hit: -hit[0])
            if hits:
                found[row, column] = hits[0][1] - (column, row)
                second = hits[1][0] if len(hits) > 1 else -np.inf
                lead[row, column] = 0 if near_edge else hits[0][0] - second
    return found, lead


@pytest.mark.parametrize("amplitude", [0.7, 1.5, 4.0])
def test_where_a_field_folds_the_winner_is_that_of_a_search_through_all_triangles(amplitude):
    rng = np.random.default_rng(int(10 * amplitude))
    field = rng.uniform(-amplitude, amplitude, (14, 16, 2)).astype(np.float32)
    assert warp.fold_fraction(field, np.ones((14, 16), np.float32)) > 0.05
    expected, lead = brute_force_inverse(field, 16, 14, 7)
    clear = lead > 1e-2
    assert clear.mean() > 0.5
    assert_allclose(
        warp.invert(field)[clear], expected[clear], atol=0.02
    )  # px; slivers divide by small areas


def test_fold_fraction_counts_turned_over_cells_inside_the_mask():
    positions = [0, 1, 2, 3, 4, 2, 3, 4, 5, 6, 7]
    field = folded_line(positions)
    everywhere = np.ones((12, 11), np.float32)
    assert warp.fold_fraction(field, everywhere) == pytest.approx(1 / 10)
    left = everywhere.copy()
    left[:, 4:] = 0
    assert warp.fold_fraction(field, left) == 0
    half = everywhere.copy()
    half[:, :4] = 0
    half[:, 6:] = 0
    assert warp.fold_fraction(field, half) == pytest.approx(1 / 2)
    one = np.zeros_like(everywhere)
    one[:, 4] = 1  # the upper left corners of the cells that turn over
    assert warp.fold_fraction(field, one) == 1
    collapsed = folded_line([0, 1, 2, 2, 4])
    assert warp.fold_fraction(collapsed, np.ones((12, 5), np.float32)) == pytest.approx(1 / 4)
    assert warp.fold_fraction(field, np.zeros_like(everywhere)) == 0
    assert warp.fold_fraction(np.zeros_like(field), everywhere) == 0


def test_determinants_are_those_of_the_gradient(wavy_field):
    assert_array_equal(warp.determinants(np.zeros((9, 8, 2), np.float32)), np.ones((8, 7)))
    affine = np.array([[1.2, 0.3, 4.0], [-0.1, 0.7, 2.0]])
    found = warp.determinants(warp.affine_displacement(affine, 20, 30))
    assert_allclose(found, np.linalg.det(affine[:, :2]), atol=1e-4)


def test_every_pixel_gets_a_finite_answer_however_wild_the_field():
    rng = np.random.default_rng(0)
    for amplitude in (1.0, 30.0, 300.0):
        field = (amplitude * rng.standard_normal((20, 25, 2))).astype(np.float32)
        assert np.isfinite(warp.invert(field)).all()
    assert np.isfinite(warp.invert(-np.stack(grid(20, 25), axis=-1))).all()  # all points in one place


def test_a_pixel_that_nothing_covers_takes_its_nearest_covered_neighbour(wavy_field):
    field = wavy_field(30, 40, 5.0)
    missing = np.zeros((30, 40), bool)
    missing[10:15, 8:12] = missing[3, 3] = missing[-1, -4:] = True
    filled = warp._filled_from_nearest(field, missing)
    distance, (row, column) = ndimage.distance_transform_edt(missing, return_indices=True)
    alone = missing & (distance <= 1)  # one pixel deep: the nearest values are at distance one
    neighbours = [np.roll(field, shift, axis) for shift in (-1, 1) for axis in (0, 1)]
    assert_array_equal(filled[~missing], field[~missing])
    for y, x in np.argwhere(alone):
        assert any(np.array_equal(filled[y, x], each[y, x]) for each in neighbours)
    y, x = 12, 8  # on the left side of the hole its nearest is unique
    assert_array_equal(filled[y, x], field[row[y, x], column[y, x]])


# composing


def test_composing_affine_fields_is_chaining_the_affines():
    outer = np.array([[1.05, 0.02, 3.0], [-0.02, 0.98, -2.0]])
    inner = np.array([[0.97, -0.03, 1.0], [0.03, 0.97, 0.5]])
    found = warp.compose(
        warp.affine_displacement(outer, HEIGHT, WIDTH), warp.affine_displacement(inner, HEIGHT, WIDTH)
    )
    expected = warp.affine_displacement(warp.chain_affine(outer, inner), HEIGHT, WIDTH)
    inside = np.s_[6:-6, 6:-6]
    assert_allclose(found[inside], expected[inside], atol=0.01)  # px; linear look-up of the gradient


def test_composing_with_zero_changes_nothing(wavy_field):
    field, zero = wavy_field(HEIGHT, WIDTH, 4.0), np.zeros((HEIGHT, WIDTH, 2), np.float32)
    assert_array_equal(warp.compose(zero, field), field)
    assert_allclose(warp.compose(field, zero), field, atol=1e-6)


def test_sampling_twice_is_sampling_once_by_the_composed_field(picture, wavy_field):
    image = picture(HEIGHT, WIDTH, seed=1, sd_px=4.0)
    outer, inner = wavy_field(HEIGHT, WIDTH, 2.0, seed=1), wavy_field(HEIGHT, WIDTH, 2.0, seed=2)
    twice = warp.sample(warp.sample(image, outer), inner)
    once = warp.sample(image, warp.compose(outer, inner))
    inside = np.s_[6:-6, 6:-6]
    assert_allclose(twice[inside], once[inside], atol=0.01)  # colour; one resampling more


def test_rendering_undoes_sampling(picture, wavy_field):
    image = picture(HEIGHT, WIDTH, seed=2, sd_px=4.0)
    field = wavy_field(HEIGHT, WIDTH, 3.0, seed=3)
    back = warp.render(warp.sample(image, field), field)
    inside = np.s_[6:-6, 6:-6]
    assert_allclose(back[inside], image[inside], atol=0.01)  # colour; two resamplings of a smooth picture


# affine maps and points


def test_inverse_affine_undoes_and_chain_applies_inner_first():
    outer = np.array([[1.1, -0.2, 4.0], [0.2, 0.9, -3.0]])
    inner = np.array([[0.0, -1.0, 10.0], [1.0, 0.0, 2.0]])
    points = np.array([[0.0, 0.0], [3.0, -2.0], [17.5, 40.25]])
    moved = warp.apply_affine(outer, warp.apply_affine(inner, points))
    assert_allclose(warp.apply_affine(warp.chain_affine(outer, inner), points), moved, atol=1e-12)
    assert_allclose(warp.apply_affine(warp.inverse_affine(outer), warp.apply_affine(outer, points)), points)
    assert_allclose(warp.chain_affine(outer, warp.inverse_affine(outer)), np.eye(2, 3), atol=1e-12)
    assert_allclose(warp.apply_affine(inner, np.array([[1.0, 0.0]])), [[10.0, 3.0]])


def test_an_affine_field_moves_points_as_the_affine_does():
    affine = np.array([[1.03, -0.05, 2.0], [0.05, 1.03, -1.0]])
    points = np.array([[10.0, 20.0], [33.25, 41.5], [5.5, 7.75]])
    moved = warp.move_points(warp.affine_displacement(affine, HEIGHT, WIDTH), points)
    assert_allclose(moved, warp.apply_affine(affine, points), atol=0.01)  # px


def test_points_outside_the_grid_move_with_its_edge():
    field = field_of(grid()[0] * 0.1, 0.0)
    moved = warp.move_points(field, np.array([[-8.0, 5.0], [WIDTH + 20.0, 5.0]]))
    assert_allclose(moved, [[-8.0, 5.0], [WIDTH + 20.0 + 0.1 * (WIDTH - 1), 5.0]], atol=1e-4)
