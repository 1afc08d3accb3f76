"""Laws of the nearest mixture: weights on the simplex, optimal by the Karush-Kuhn-Tucker conditions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from morphspace.linear.simplex import nearest_mixture


def aim(apart, costs, weights):
    return float(((weights @ apart) ** 2).sum() + weights @ costs)


@given(
    seed=st.integers(0, 2**32 - 1), count=st.integers(1, 30), size=st.integers(1, 40), price=st.floats(0, 2)
)
def test_the_mixture_satisfies_the_optimality_conditions(seed, count, size, price):
    rng = np.random.default_rng(seed)
    apart = rng.standard_normal((count, size)) + 0.5
    costs = price * (apart**2).sum(axis=1)
    weights = nearest_mixture(apart, costs)
    assert (weights >= 0).all() and weights.sum() == pytest.approx(1, abs=1e-12)
    slope = 2 * apart @ (weights @ apart) + costs
    scale = (apart**2).sum(axis=1).max() * (1 + price)
    assert (slope[weights > 1e-6] - slope.min()).max() < 1e-5 * scale


def test_no_random_mixture_is_nearer():
    rng = np.random.default_rng(1)
    apart = rng.standard_normal((7, 4)) + 1
    costs = 0.3 * (apart**2).sum(axis=1)
    best = aim(apart, costs, nearest_mixture(apart, costs))
    assert all(best <= aim(apart, costs, rng.dirichlet(np.full(7, 0.5))) + 1e-12 for _ in range(2000))


def test_a_face_equal_to_the_target_is_the_mixture():
    apart = np.random.default_rng(2).standard_normal((9, 3))
    apart[4] = 0
    weights = nearest_mixture(apart, 0.3 * (apart**2).sum(axis=1))
    assert_allclose(weights, np.eye(9)[4], atol=1e-9)


def test_of_equal_faces_the_first_is_the_mixture():
    assert_allclose(nearest_mixture(np.zeros((3, 2)), np.zeros(3)), [1, 0, 0])


def test_more_faces_than_dimensions_have_one_solution():
    apart = np.random.default_rng(3).standard_normal((60, 2))
    one = nearest_mixture(apart, np.zeros(60))
    assert aim(apart, np.zeros(60), one) < 1e-9
    assert np.array_equal(one, nearest_mixture(apart, np.zeros(60)))


def test_a_target_in_the_middle_of_many_faces_is_a_mixture_of_all():
    """STEPS / 10: 50 faces have joined."""
    assert_allclose(nearest_mixture(np.eye(80), np.zeros(80)), 1 / 80)


@pytest.mark.parametrize(
    ("nearer", "weight"),
    [
        (3e-8, 0.0),  # RELATIVE_TOL / 10: 4.0e-10
        (1e-7, 1.1e-9),  # RELATIVE_TOL x 10: 0; RIDGE: 1.01e-9, 2.0e-9
    ],
)
def test_a_face_that_hardly_helps_does_not_join(nearer, weight):
    """A face 10 away, of which a share of 1e-9 would bring the mixture nearer by 1e-16."""
    found = nearest_mixture(np.array([[1.0, 0.0], [1 - nearer, 10.0]]), np.zeros(2))
    assert found[1] == pytest.approx(weight, rel=0.02, abs=0.0)
