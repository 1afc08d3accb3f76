"""Laws of the posterior: the dense formula of Tipping and Bishop, for part of an offset and with observations."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.errors import BadInput
from morphspace.linear.pca import Basis
from morphspace.linear.posterior import NOISE_FLOOR, Observations, Posterior

RANK, D = 4, 300


@pytest.fixture
def basis():
    rows = np.linalg.qr(np.random.default_rng(0).standard_normal((D, RANK)))[0].T.astype(np.float32)
    return Basis(rows, np.array([40.0, 4.0, 0.3, 0.02]), np.ones(D, np.float32), 0.003)


@pytest.fixture
def weight():
    rng = np.random.default_rng(1)
    return (rng.random(D) * (rng.random(D) < 0.5)).astype(np.float32)


@pytest.fixture
def offset():
    return np.random.default_rng(2).standard_normal(D).astype(np.float32)


def dense(basis, weight, offset, noise):
    """Compute (P C P' + s^2 V^-1)^-1 P C r directly."""
    components = np.asarray(basis.components, np.float64)
    known = (components * weight) @ components.T + np.diag(noise / basis.variances)
    return np.linalg.solve(known, components @ (weight * offset))


@pytest.mark.parametrize("factor", [1.0, 100.0, 5000.0])
def test_the_mean_is_the_dense_formula(basis, weight, offset, factor):
    found = Posterior(basis, weight, factor).mean(offset)
    assert_allclose(found, dense(basis, weight, offset, factor * 0.003), rtol=1e-4, atol=1e-6)


def test_the_mean_with_observations_is_the_dense_formula(basis, weight, offset):
    rng = np.random.default_rng(3)
    seen = Observations(rng.standard_normal((RANK, 8)), rng.random(8))
    observed = rng.standard_normal(8)
    noise = 100 * 0.003
    components = np.asarray(basis.components, np.float64)
    known = (components * weight) @ components.T / noise + np.diag(1 / basis.variances)
    known += (seen.weights * seen.precision) @ seen.weights.T
    right_side = components @ (weight * offset) / noise + seen.weights @ (seen.precision * observed)
    found = Posterior(basis, weight, 100.0, seen).mean(offset, observed)
    assert_allclose(found, np.linalg.solve(known, right_side), rtol=1e-4, atol=1e-6)


def test_the_mean_of_faces_is_the_mean_of_their_expansions(basis, weight):
    loadings = np.random.default_rng(4).standard_normal((5, RANK))
    posterior = Posterior(basis, weight, 100.0)
    read = [posterior.mean(face) for face in basis.expand(loadings)]
    assert_allclose(posterior.mean_of_faces(loadings), read, atol=1e-5)


def test_a_model_without_discarded_variance_has_a_little_noise(basis, weight, offset):
    whole = replace(basis, discarded_variance=0.0)
    least = NOISE_FLOOR * 0.02
    assert Posterior(whole, weight, 5000.0).noise == pytest.approx(least)
    found = Posterior(whole, weight, 5000.0).mean(offset)
    assert_allclose(found, dense(whole, weight, offset, least), rtol=1e-4, atol=1e-5)
    faintest = whole.expand(np.array([0.0, 0.0, 0.0, 0.1]))
    seen_whole = Posterior(whole, np.ones(D, np.float32), 5000.0)
    assert_allclose(seen_whole.mean(faintest)[3], 0.1 / 1.001, rtol=1e-4)  # an anchored figure: .1 % less
    hidden = Posterior(whole, np.zeros(D, np.float32), 1.0)
    assert_allclose(hidden.mean(offset), 0)


def test_a_component_that_never_varied_stays_at_the_mean(basis, weight, offset):
    still = replace(basis, variances=np.array([40.0, 4.0, 0.3, 0.0]))
    found = Posterior(still, weight, 100.0).mean(offset)
    assert found[3] == 0 and np.isfinite(found).all()


def test_a_basis_without_components_is_refused(weight):
    empty = Basis(np.zeros((0, D), np.float32), np.zeros(0), np.ones(D, np.float32), 0.0)
    with pytest.raises(BadInput, match="no component"):
        Posterior(empty, weight, 1.0)
