"""The laws every part of the package keeps, one test each; what a module adds to them stands in its own file."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import ReferenceMismatch
from morphspace.flow.methods import DEFAULT, named
from morphspace.grid import warp
from morphspace.linear.pca import Basis, fit_basis
from morphspace.linear.rows import RowArray
from morphspace.model.model import load_model
from morphspace.model.morph import Morph, deserialise, serialise

few = settings(max_examples=20, deadline=None, derandomize=True)
numbers = st.floats(-1e3, 1e3, width=32)
sides = st.integers(1, 9)


@few
@given(data=st.data(), height=sides, width=sides)
def test_serialise_and_deserialise_are_inverse(data, height, width):
    texture = data.draw(arrays(np.float32, (height, width, 3), elements=numbers))
    displacement = data.draw(arrays(np.float32, (height, width, 2), elements=numbers))
    back = deserialise(serialise(Morph.of(texture, displacement, "here")), height, width, "here")
    assert_array_equal(back.texture, texture)
    assert_array_equal(back.displacement, displacement)
    vector = data.draw(arrays(np.float32, 5 * height * width, elements=numbers))
    assert_array_equal(serialise(deserialise(vector, height, width, "here")), vector)


@few
@given(values=arrays(np.float64, 3, elements=st.floats(-5, 5)))
def test_project_of_expand_is_the_loadings(model, values):
    assert_allclose(
        model.basis.project(model.basis.expand(values)), values, atol=1e-4
    )  # float32, 21600 numbers


def test_variances_are_those_of_the_training_loadings(model):
    assert_allclose(model.training.values.var(axis=0, ddof=1), model.basis.variances, rtol=1e-6)


@few
@given(data=st.data(), n=st.integers(2, 6), d=st.integers(1, 12))
def test_rank_is_less_than_the_number_of_faces_and_all_numbers_are_finite(data, n, d):
    rows = data.draw(arrays(np.float32, (n, d), elements=st.floats(-10, 10, width=16)))
    weight = data.draw(arrays(np.float32, d, elements=st.floats(0, 2, width=16)))
    mean, basis, loadings = fit_basis(RowArray(rows), weight, 50)
    assert basis.rank <= n - 1
    for found in (mean, basis.components, basis.variances, loadings, basis.discarded_variance):
        assert np.isfinite(found).all()


@pytest.mark.parametrize("value", [0.0, 0.1, 1.0])
def test_constant_data_give_rank_zero(value):
    _, basis, _ = fit_basis(RowArray(np.full((5, 40), value, np.float32)), np.ones(40, np.float32), 5)
    assert basis.rank == 0


def test_render_of_zero_loadings_is_the_mean(model):
    assert_array_equal(model.render(np.zeros(model.rank)), model.mean.render())


def test_warping_by_zero_is_the_identity(picture):
    image, zero = picture(40, 50), np.zeros((40, 50, 2), np.float32)
    assert_allclose(warp.sample(image, zero), image, atol=1e-6)
    assert_allclose(warp.render(image, zero), image, atol=1e-6)
    assert_array_equal(warp.invert(zero), zero)


@few
@given(seed=st.integers(0, 999), amplitude=st.floats(0.1, 4))
def test_a_field_composed_with_its_inverse_is_zero_inside(wavy_field, seed, amplitude):
    field = wavy_field(48, 56, amplitude, seed)
    inside = np.s_[6:-6, 6:-6]  # the grid's edge, moved by up to 4 px
    for miss in (warp.compose(field, warp.invert(field)), warp.compose(warp.invert(field), field)):
        assert np.median(np.abs(miss[inside])) < 0.01  # px
        assert np.abs(miss[inside]).max() < 0.3  # px; a cell's two triangles against a bilinear look-up


@few
@given(value=st.floats(-2, 2, width=32), seed=st.integers(0, 999), amplitude=st.floats(0, 60))
def test_sampling_a_constant_image_is_constant(wavy_field, value, seed, amplitude):
    constant = np.full((30, 40, 3), value, np.float32)
    assert_allclose(warp.sample(constant, wavy_field(30, 40, amplitude, seed)), constant, atol=3e-6)


def test_flow_of_an_image_with_itself_is_zero(picture):
    image = picture(64, 64)
    assert_allclose(named(DEFAULT)(image)(image, None).displacement, 0, atol=1e-3)  # px


def test_save_and_load_are_bit_equal(model, tmp_path):
    model.save(tmp_path / "some.morph")
    loaded = load_model(tmp_path / "some.morph")
    assert loaded.model_id == model.model_id
    for get in (
        lambda m: m.basis.components,
        lambda m: m.basis.variances,
        lambda m: m.mean.texture,
        lambda m: m.mean.displacement,
        lambda m: m.mean_inverse,
        lambda m: m.mask,
        lambda m: m.reference,
        lambda m: m.training.values,
    ):
        assert get(loaded).dtype == get(model).dtype
        assert get(loaded).tobytes() == get(model).tobytes()


def test_another_reference_raises(model):
    elsewhere = Morph.of(model.mean.texture, model.mean.displacement, "elsewhere")
    for wrong in (lambda: model.project(elsewhere), lambda: elsewhere - model.mean):
        with pytest.raises(ReferenceMismatch):
            wrong()


def test_the_sign_of_a_component_never_changes_a_rendered_image(model):
    signs = np.array([1.0, -1.0, -1.0])
    flipped = Basis(
        model.basis.components * signs[:, None].astype(np.float32),
        model.basis.variances,
        model.basis.weight,
        model.basis.discarded_variance,
    )
    face = model.expand([0.8, -0.5, 0.3])
    offset = face - model.mean
    images = []
    for basis in (model.basis, flipped):
        moved = model.mean.vector + basis.expand(basis.project(offset.vector))
        images.append(Morph(moved, model.mask.shape, "here").render())
    assert_allclose(images[0], images[1], atol=1e-5)
