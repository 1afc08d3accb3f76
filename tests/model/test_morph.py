"""Laws of morphs: points and vectors, the paper's order of numbers, the mean shape."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.grid import warp
from morphspace.linear.pca import fit_basis
from morphspace.linear.rows import RowArray
from morphspace.model.morph import (
    MEAN_FOLDS,
    Morph,
    MorphOffset,
    _check_same_reference,
    deserialise,
    inner_product,
    invert_mean_shape,
    morph_of,
    resource,
    serialise,
)

HEIGHT, WIDTH = 40, 48


@pytest.fixture
def face(picture, wavy_field):
    def make(seed, reference_id="here"):
        return Morph.of(picture(HEIGHT, WIDTH, seed), wavy_field(HEIGHT, WIDTH, 3.0, seed), reference_id)

    return make


def assert_same_face(one, other, atol=1e-6):
    assert_allclose(one.texture, other.texture, atol=atol)
    assert_allclose(one.displacement, other.displacement, atol=atol)
    assert one.reference_id == other.reference_id


# points and vectors


def test_a_face_plus_the_way_to_another_is_the_other(face):
    one, other = face(1), face(2)
    assert isinstance(other - one, MorphOffset)
    assert_same_face(one + (other - one), other)


def test_offsets_are_vectors(face):
    a, b, c = face(1), face(2), face(3)
    assert_same_face((b - a) + (c - b), c - a)
    assert_same_face((b - a) - (c - a), b - c)
    assert_same_face(2 * (b - a), (b - a) + (b - a))
    assert_same_face((b - a) * 0.5 + (b - a) * 0.5, b - a)
    assert_same_face(a + 0 * (b - a), a, atol=0)
    assert (b - a).texture.dtype == ((b - a) * 2.5).texture.dtype == np.float32


def test_faces_are_points_and_cannot_be_added(face):
    one, other = face(1), face(2)
    offset = one - other
    for wrong in (
        lambda: one + other,
        lambda: one * 2.0,
        lambda: offset + one,
        lambda: one + 1.0,
        lambda: one - offset,
        lambda: one - 1.0,
        lambda: offset + 1.0,
    ):
        with pytest.raises(TypeError):
            wrong()


def test_faces_of_different_reference_do_not_mix(face):
    here, there = face(1), face(2, "there")
    for wrong in (
        lambda: here - there,
        lambda: here + (there - there),
        lambda: (here - here) + (there - there),
        lambda: (here - here) - (there - there),
        lambda: _check_same_reference(here, there),
    ):
        with pytest.raises(ReferenceMismatch, match=r"here.*there"):
            wrong()


def test_a_warp_that_does_not_fit_its_texture_is_refused(picture, wavy_field):
    with pytest.raises(BadInput, match="texture and displacement have shapes"):
        Morph.of(picture(WIDTH, HEIGHT), wavy_field(HEIGHT, WIDTH, 1.0), "here")


# the order of numbers


def test_serialised_order_is_column_by_column_over_r_g_b_x_y(face):
    one = face(1)
    vector = []
    for plane in (
        one.texture[..., 0],
        one.texture[..., 1],
        one.texture[..., 2],
        one.displacement[..., 0],
        one.displacement[..., 1],
    ):
        for column in range(WIDTH):
            for row in range(HEIGHT):
                vector.append(plane[row, column])
    assert_array_equal(serialise(one), np.array(vector))
    assert serialise(one).shape == (5 * HEIGHT * WIDTH,)


def test_an_offset_is_serialised_as_the_difference(face):
    one, other = face(1), face(2)
    assert_allclose(serialise(one - other), serialise(one) - serialise(other), atol=1e-6)


def test_a_vector_of_the_wrong_length_is_refused():
    with pytest.raises(BadInput, match="a morph vector has shape"):
        deserialise(np.zeros(5 * HEIGHT * WIDTH - 1, np.float32), HEIGHT, WIDTH, "here")
    with pytest.raises(BadInput, match="a morph vector has shape"):
        deserialise(np.zeros((5, HEIGHT * WIDTH), np.float32), HEIGHT, WIDTH, "here")


def test_vector_and_parts_are_inverse(face):
    one = face(4)
    again = Morph.of(one.texture, one.displacement, one.reference_id)
    assert_array_equal(again.vector, one.vector)
    assert again.shape == one.shape == (HEIGHT, WIDTH)
    assert np.shares_memory(one.texture, one.vector) and np.shares_memory(one.displacement, one.vector)


def test_a_morph_cannot_be_written_to(face):
    for part in (face(1).vector, face(1).texture, (face(2) - face(1)).displacement):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = 0


def test_two_faces_cannot_be_added(face):
    for wrong in (lambda: face(1) + face(2), lambda: (face(1) - face(2)) + face(3), lambda: face(1) * 2.0):
        with pytest.raises(TypeError):
            wrong()


def test_pca_of_the_papers_vectors_is_the_model_we_compute_with(face):
    mask = np.random.default_rng(0).uniform(0, 1, (HEIGHT, WIDTH)).astype(np.float32)
    mask[:, :5] = 0
    weight, warp_weight = inner_product(mask, 0.2), 0.2
    faces = [face(seed) for seed in range(7)]
    ours = np.stack([each.vector for each in faces])
    _, basis, loadings = fit_basis(RowArray(ours), weight, 6)
    # the paper's side, in numpy alone: weights in the paper's order, then the SVD of weighted offsets
    column_wise = mask.T.reshape(-1).astype(np.float64)
    root = np.sqrt(np.concatenate([column_wise] * 3 + [column_wise * warp_weight**2] * 2))
    paper = np.stack([serialise(each) for each in faces]).astype(np.float64)
    left, singular, right = np.linalg.svd((paper - paper.mean(axis=0)) * root, full_matrices=False)
    assert_allclose(basis.variances, singular[:6] ** 2 / 6, rtol=1e-6)
    sign = np.sign((left * singular)[:, :6] * loadings).sum(axis=0) / len(faces)
    assert_allclose(np.abs(sign), 1)
    assert_allclose((left * singular)[:, :6] * sign, loadings, atol=1e-5 * np.abs(loadings).max())
    for k in range(6):
        permuted = serialise(MorphOffset(basis.components[k], (HEIGHT, WIDTH), "here"))
        assert_allclose(permuted * root, sign[k] * right[k], atol=1e-5)


# taking apart and putting together


def test_taking_apart_and_rendering_gives_the_frame_back(picture, wavy_field):
    frame, field = picture(HEIGHT, WIDTH, sd_px=4.0), wavy_field(HEIGHT, WIDTH, 2.0)
    one = morph_of(frame, field, "here")
    assert one.reference_id == "here"
    inside = np.s_[5:-5, 5:-5]
    assert_allclose(one.render()[inside], frame[inside], atol=0.01)  # colour; two resamplings


def test_taking_apart_undoes_rendering(picture, wavy_field):
    texture, field = picture(HEIGHT, WIDTH, sd_px=4.0), wavy_field(HEIGHT, WIDTH, 2.0)
    back = morph_of(Morph.of(texture, field, "here").render(), field, "here")
    inside = np.s_[5:-5, 5:-5]
    assert_allclose(back.texture[inside], texture[inside], atol=0.01)


def test_the_mean_shape_composed_with_its_inverse_is_zero_inside(wavy_field):
    field = wavy_field(HEIGHT, WIDTH, 2.0)
    miss = warp.compose(field, invert_mean_shape(field))
    inside = np.s_[4:-4, 4:-4]
    assert np.median(np.abs(miss[inside])) < 0.01  # px
    assert np.abs(miss[inside]).max() < 0.1  # the linear look-up of a cell against its two triangles


def torn_field(amount_px):
    return (amount_px * np.random.default_rng(0).standard_normal((HEIGHT, WIDTH, 2))).astype(np.float32)


def test_a_mean_shape_that_cannot_be_inverted_is_refused():
    torn = torn_field(0.25)  # noise: few cells fold, and yet a look-up does not find the way back
    assert (warp.determinants(torn) <= 0).mean() < MEAN_FOLDS
    with pytest.raises(BadInput, match=r"inverse of the mean shape misses by .* px"):
        invert_mean_shape(torn)
    invert_mean_shape(torn_field(0.1))


def test_a_mean_shape_that_folds_is_refused():
    with pytest.raises(BadInput, match=r"folds in 8\d\.\d% of the frame; expected at most 2%"):
        invert_mean_shape(torn_field(20.0))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_mean_shape_is_refused_though_it_has_an_inverse(axis):
    points = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).astype(np.float32)
    mirrored = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    mirrored[..., axis] = points[..., axis].max() - 2 * points[..., axis]
    miss = warp.compose(mirrored, warp.invert(mirrored))
    assert np.abs(miss).max() < 1e-3
    with pytest.raises(BadInput, match=r"folds in 100\.0% of the frame"):
        invert_mean_shape(mirrored)


def test_a_mean_shape_may_fold_in_few_cells_and_no_more():
    """Whole columns of cells fold: just below the limit, and just above."""
    width = 120
    for columns, allowed in ((2, True), (3, False)):
        field = np.zeros((HEIGHT, width, 2), np.float32)
        for column in range(columns):
            field[:, 20 + 30 * column, 0] = 1.5  # beyond its right neighbour
        folded = (warp.determinants(field) <= 0).mean()
        assert (folded <= MEAN_FOLDS) == allowed
        if allowed:
            invert_mean_shape(field)
        else:
            with pytest.raises(BadInput, match=r"folds in 2\.5%"):
                invert_mean_shape(field)


def test_flows_carried_to_the_mean_face_are_zero_on_average(wavy_field):
    fields = [wavy_field(HEIGHT, WIDTH, 2.5, seed) for seed in range(6)]
    mean_inverse = invert_mean_shape(np.mean(fields, axis=0))
    carried = np.mean([resource(field, mean_inverse) for field in fields], axis=0)
    inside = np.s_[4:-4, 4:-4]
    assert np.abs(carried[inside]).max() < 0.1  # px


def test_a_flow_equal_to_the_mean_shape_becomes_zero_on_the_mean_face(wavy_field):
    mean = wavy_field(HEIGHT, WIDTH, 2.5)
    inside = np.s_[4:-4, 4:-4]
    assert np.abs(resource(mean, invert_mean_shape(mean))[inside]).max() < 0.1  # px


def test_points_stay_where_they_are_in_the_frame_when_carried_to_the_mean_face(wavy_field):
    flow, mean = wavy_field(HEIGHT, WIDTH, 2.5, seed=1), wavy_field(HEIGHT, WIDTH, 2.0, seed=2)
    carried = resource(flow, invert_mean_shape(mean))
    on_reference = np.array([[15.0, 12.0], [30.0, 20.0], [22.0, 31.0]])
    on_mean = warp.move_points(mean, on_reference)
    assert_allclose(warp.move_points(carried, on_mean), warp.move_points(flow, on_reference), atol=0.05)
