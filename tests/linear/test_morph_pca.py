"""The adapter follows scikit-learn's rules and has the components of the models."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.utils.estimator_checks import parametrize_with_checks

from morphspace.errors import BadInput
from morphspace.linear.morph_pca import MorphPCA
from morphspace.linear.pca import fit_basis
from morphspace.linear.rows import RowArray


@parametrize_with_checks([MorphPCA(n_components=2)])
def test_scikit_learn_accepts_it(estimator, check):
    check(estimator)


def test_it_gives_the_components_of_the_models():
    rng = np.random.default_rng(1)
    rows, weight = rng.normal(size=(7, 30)).astype(np.float32), rng.uniform(0, 2, 30).astype(np.float32)
    mean, basis, loadings = fit_basis(RowArray(rows), weight, 4)
    pca = MorphPCA(4, weight).fit(rows)
    assert_allclose(pca.transform(rows), loadings, atol=1e-4)  # float32 rows
    assert_allclose(pca.inverse_transform(loadings), mean + loadings @ basis.components, atol=1e-5)
    assert list(pca.get_feature_names_out()) == [f"morphpca{i}" for i in range(4)]


def test_constant_rows_have_no_component():
    pca = MorphPCA().fit(np.ones((4, 5)))
    assert pca.components_.shape == (0, 5)
    assert pca.transform(np.ones((2, 5))).shape == (2, 0)


@pytest.mark.parametrize("weight", [np.ones(4), -np.ones(5)])
def test_a_weight_that_does_not_fit_is_refused(weight):
    with pytest.raises(BadInput, match=r"expected \(5,\)"):
        MorphPCA(weight=weight).fit(np.eye(5))


@pytest.mark.parametrize("components", ["x", 0, 1.5])
def test_a_number_of_components_that_is_none_is_refused(components):
    with pytest.raises(
        BadInput, match=r"n_components is .*; expected a whole number from 1 up, or None for all"
    ):
        MorphPCA(components).fit(np.eye(5))


@pytest.mark.parametrize("shape", [(2, 5), (3,), ()])
def test_loadings_of_another_width_are_refused(shape):
    with pytest.raises(BadInput, match=r"expected \(n, 2\)"):
        MorphPCA(2).fit(np.eye(5)).inverse_transform(np.zeros(shape))
