"""Laws of the derivative kernels: exact polynomials, analytic forms, and the frequency response of a Gaussian."""

from math import factorial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage, special

from morphspace.errors import BadInput
from morphspace.flow.filters import MAX_ORDER, _radius_of, derivatives, gaussian_derivative, up_to

ORDERS = range(MAX_ORDER + 1)
WIDTHS_PX = (0.5, 0.6, 0.7, 1.0, 1.5, 3.0**0.5, 3.0)


def smoothed_power(degree, sd):
    """Smooth x**degree by a Gaussian, from the moments of the normal distribution (numpy polynomial)."""
    moments = [0.0 if k % 2 else sd**k * (1.0, 1.0, 1.0, 0.0, 3.0, 0.0)[k] for k in range(degree + 1)]
    terms = [special.comb(degree, k) * moments[k] for k in range(degree, -1, -1)]
    return np.polynomial.Polynomial(terms)


@pytest.mark.parametrize("sd_px", WIDTHS_PX)
@pytest.mark.parametrize("order", ORDERS)
def test_polynomials_are_filtered_as_by_the_continuous_filter(order, sd_px):
    kernel = gaussian_derivative(order, sd_px)
    x = np.arange(-30.0, 31.0)
    for degree in range(MAX_ORDER + 1):
        answer = smoothed_power(degree, sd_px).deriv(order) if order else smoothed_power(degree, sd_px)
        found = ndimage.correlate1d(x**degree, kernel)[26:-26]
        assert_allclose(found, answer(x[26:-26]), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
def test_the_kernel_of_an_order_gives_plus_one_on_its_taylor_term(order):
    for sd_px in WIDTHS_PX:
        kernel = gaussian_derivative(order, sd_px)
        at = np.arange(kernel.size) - kernel.size // 2
        assert kernel @ (at**order / factorial(order)) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_23_taps_at_one_and_a_half_px_are_the_analytic_derivative(order):
    at = np.arange(-11, 12) / 1.5
    bell = np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi) / 1.5
    analytic = special.eval_hermitenorm(order, at) * bell / 1.5**order
    kernel = gaussian_derivative(order, 1.5, radius=11)
    assert_allclose(
        kernel, analytic, atol=1e-7 * np.abs(analytic).max()
    )  # the correction restores the cut tails only


@pytest.mark.parametrize(("sd_px", "tolerance"), [(0.5, 0.15), (0.7, 0.07), (1.5, 0.01), (3.0, 0.01)])
def test_the_response_at_low_frequencies_is_that_of_a_gaussian(sd_px, tolerance):
    for order in ORDERS:
        kernel = gaussian_derivative(order, sd_px)
        at = np.arange(kernel.size) - kernel.size // 2
        omega = np.linspace(0.02, min(np.pi / 4, 1 / sd_px), 30)  # radians a px
        response = np.exp(1j * np.outer(omega, at)) @ kernel
        gaussian = (1j * omega) ** order * np.exp(-((sd_px * omega) ** 2) / 2)
        assert np.abs(response / gaussian - 1).max() < tolerance, order


def test_kernels_are_even_or_odd_to_the_bit():
    for order in ORDERS:
        kernel = gaussian_derivative(order, 0.6)
        assert_array_equal(kernel, (-1) ** order * kernel[::-1])


def test_few_taps_keep_the_lowest_moments():
    assert_allclose(gaussian_derivative(1, 0.5, radius=1), [-0.5, 0, 0.5], atol=1e-12)
    assert_allclose(gaussian_derivative(2, 0.5, radius=1), [1, -2, 1], atol=1e-12)
    assert_allclose(
        gaussian_derivative(0, 0.5, radius=1), [0.125, 0.75, 0.125], atol=1e-12
    )  # variance 0.25 px^2


def test_each_call_returns_its_own_kernel():
    kernel = gaussian_derivative(1, 1.0)
    kernel[:] = 0
    assert gaussian_derivative(1, 1.0).any()


def test_derivatives_of_a_plane_wave_are_exact_in_both_axes():
    y, x = np.mgrid[:64, :72].astype(np.float64)
    across, down = 0.35, -0.2  # radians a px
    orders = up_to(5)
    found = derivatives(np.cos(across * x + down * y), orders, 1.5, radius=11)
    assert found.shape == (21, 64, 72)
    assert found.dtype == np.float32
    damped = np.exp(-(1.5**2) * (across**2 + down**2) / 2)
    for layer, (i, j) in zip(found, orders, strict=True):
        wave = np.exp(1j * (across * x + down * y)) * (1j * across) ** i * (1j * down) ** j
        assert_allclose(layer[11:-11, 11:-11], damped * wave.real[11:-11, 11:-11], atol=2e-6)


def test_derivatives_agree_with_an_independent_gaussian():
    image = np.random.default_rng(0).random((40, 50)).astype(np.float32)
    for (i, j), layer in zip(up_to(3), derivatives(image, up_to(3), 2.0, radius=16), strict=True):
        other = ndimage.gaussian_filter(
            image.astype(np.float64), 2.0, order=(j, i), mode="mirror", truncate=8
        )
        assert_allclose(layer, other, atol=1e-6)


def test_a_constant_image_has_no_derivatives_up_to_its_edge():
    found = derivatives(np.full((9, 7), 0.8, np.float32), up_to(5), 1.5)  # smaller than the kernel too
    assert_allclose(found[0], 0.8, atol=1e-6)
    assert_allclose(found[1:], 0, atol=1e-6)


def test_up_to_lists_every_order_once():
    assert up_to(2) == ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


@pytest.mark.parametrize(
    ("order", "sd_px", "radius", "message"),
    [
        (6, 1.0, None, "order of the derivative is 6; expected 0 to 5"),
        (-1, 1.0, None, "order of the derivative is -1"),
        (1, 0.0, None, "Gaussian is 0.0 px"),
        (1, float("nan"), None, "Gaussian is nan px"),
        (4, 1.0, 1, "radius is 1 px; expected at least 2 px"),
    ],
)
def test_impossible_kernels_are_refused(order, sd_px, radius, message):
    with pytest.raises(BadInput, match=message):
        gaussian_derivative(order, sd_px, radius=radius)


def test_a_colour_image_is_refused():
    with pytest.raises(BadInput, match=r"\(4, 4, 3\); expected a grey image \(h, w\)"):
        derivatives(np.zeros((4, 4, 3), np.float32), [(0, 0)], 1.0)


def test_the_radius_grows_with_the_width():
    assert (_radius_of(0.5), _radius_of(1.5), _radius_of(3.0)) == (3, 8, 15)
