"""Derivatives of Gaussians, order 0 to 5: the Taylor expansion by which the flow describes an image around a point.

The samples of a Gaussian derivative at the pixels do not differentiate a polynomial exactly. Their tails are cut, and
below a standard deviation of about 1 px they are too coarse: at 0.5 px the sampled order 2 gives a parabola less than
half its curvature. Each kernel here is therefore the sampled Hermite form plus the smallest change that restores its
moments. On polynomials up to degree 5 it equals the continuous filter. The correction is ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import ceil, factorial, perm

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput

MAX_ORDER = 5  # order of the Multi-channel Gradient Model, and degree of the polynomials that stay exact
CORRECTION_SD_PX = 0.8  # px; least width of the correction: a narrower one changes three taps only
BORDER = cv2.BORDER_REFLECT_101
"""Beyond the edge the image is mirrored about its outermost pixels. This adds no step and no flat strip: the edge adds
no derivative energy, and a constant stays constant. Odd derivatives across the edge are 0 on it, so motion
across the edge cannot be measured there."""


def gaussian_derivative(order: int, sd_px: float, *, radius: int | None = None) -> AnyArray:
    """Compute the kernel of a Gaussian's derivative, for correlation.

    Correlation (`cv2.sepFilter2D`, `scipy.ndimage.correlate1d`) smooths by the Gaussian and differentiates `order`
    times: x**n / n! under the kernel of order n gives +1.

    Parameters
    ----------
    order : int
        0 to 5.
    sd_px : float
        Width of the Gaussian. A heat kernel of time t (one published port uses t = 1.5) is the Gaussian of sqrt(2 t)
        px.
    radius : int, optional
        In px; 5 SD by default, at least 3 px. 11 px with an SD of 1.5 px gives the 23 taps of Johnston, McOwan and
        Benton.

    Returns
    -------
    array (2 radius + 1,) float64

    Raises
    ------
    BadInput
        If the order is outside 0 to 5, the width is not positive or the radius is too small for the order.

    Notes
    -----
    The kernel is He_n(k / s) G(k) / s^n + c(k), with Hermite's polynomials He, s = `sd_px`, and the correction c. Of
    all c with
    the moments sum h(k) k^b of the continuous filter for b = 0 to 5, it has the least norm sum c^2 / w; w is a
    Gaussian of
    max(s, 0.8) px. A radius under 3 px restores fewer moments, the lowest.

    As a share of the largest tap, over orders 0 to 5, c is 3e-12 to 4e-8 at 1.5 px with 23 taps and 1e-6 to 2e-3 at
    1.5 px with the default 17. It is 4e-3 to 2 at 0.7 px and 0.06 to 2 at 0.5 px. The correction is exact at low
    frequencies only. At a quarter of the sampling rate the response of orders 0 to 3 is off by 0.4 to 5 % at 0.7 px
    and by 2 to 12 % at 0.5 px. That of orders 4 and 5 is off by 15 to 43 %: there the kernels are finite differences
    under a slight blur.

    References
    ----------
    Johnston, McOwan and Benton, Proc. R. Soc. B 266, 1999 (the filters); the correction is ours.

    Examples
    --------
    >>> import numpy as np
    >>> kernel = gaussian_derivative(1, 1.5)
    >>> ramp = np.arange(len(kernel))
    >>> round(float(kernel @ ramp), 6)
    1.0
    """
    if not 0 <= order <= MAX_ORDER:
        raise BadInput(
            f"the order of the derivative is {order}; expected 0 to {MAX_ORDER}. Choose a lower order"
        )
    if not 0 < sd_px < np.inf:
        raise BadInput(
            f"the width of the Gaussian is {sd_px} px; expected more than 0. Enter a positive width"
        )
    reach = _radius_of(sd_px) if radius is None else radius
    if reach < (order + 1) // 2:
        raise BadInput(
            f"the radius is {reach} px; expected at least {(order + 1) // 2} px for order {order}. Enlarge it"
        )
    return _kernel(order, float(sd_px), reach).copy()


def _radius_of(sd_px: float) -> int:
    """Return the default radius of a kernel in px: 5 SD, at least 3, so that all six moments can be restored."""
    return max(3, ceil(5 * sd_px))


@lru_cache(maxsize=256)
def _kernel(order: int, sd_px: float, radius: int) -> AnyArray:
    at = np.arange(-radius, radius + 1) / sd_px  # in SD, which keeps the moments near 1
    bell = np.exp(-(at**2) / 2) / (np.sqrt(2 * np.pi) * sd_px)
    sampled = np.polynomial.hermite_e.hermeval(at, np.eye(MAX_ORDER + 1)[order]) * bell
    free = radius + 1 - order % 2  # independent taps of an even or odd kernel
    degrees = range(order % 2, MAX_ORDER + 1, 2)[:free]
    powers = at ** np.array(degrees)[:, None]
    missing = np.array([_moment(order, degree) for degree in degrees]) - powers @ sampled
    weight = np.exp(-((at * sd_px / max(sd_px, CORRECTION_SD_PX)) ** 2) / 2)
    change = weight * (powers.T @ np.linalg.solve((powers * weight) @ powers.T, missing))
    kernel: AnyArray = (sampled + change) / sd_px**order
    kernel = (kernel + (-1) ** order * kernel[::-1]) / 2  # exact parity; rounding would leave a bias
    return kernel


def _moment(order: int, degree: int) -> float:
    """Return the derivative of this order, at 0, of x**degree smoothed by a Gaussian of SD 1."""
    rest = degree - order
    if rest < 0 or rest % 2:
        return 0.0
    return perm(degree, order) * factorial(rest) / (2.0 ** (rest // 2) * factorial(rest // 2))


def derivatives(
    image: AnyArray, orders: Sequence[tuple[int, int]], sd_px: float, *, radius: int | None = None
) -> AnyArray:
    """Compute derivatives of an image by `gaussian_derivative`, with the edge of `BORDER`.

    Parameters
    ----------
    image : array (h, w)
    orders : sequence of (i, j)
        i derivatives to the right and j down.
    sd_px : float
        Width of the Gaussian that smooths the image.
    radius : int, optional
        Of the kernels, in px.

    Returns
    -------
    array (len(orders), h, w) float32

    Raises
    ------
    BadInput
        If the image is not (h, w), and as `gaussian_derivative`.
    """
    if image.ndim != 2:
        raise BadInput(
            f"the image has the shape {image.shape}; expected a grey image (h, w). Convert it to grey"
        )
    source = np.ascontiguousarray(image, np.float32)
    out = np.empty((len(orders), *image.shape), np.float32)
    for layer, (right, down) in zip(out, orders, strict=True):
        across = gaussian_derivative(right, sd_px, radius=radius)
        along = gaussian_derivative(down, sd_px, radius=radius)
        cv2.sepFilter2D(source, cv2.CV_32F, across, along, dst=layer, borderType=BORDER)
    return out


def up_to(order: int) -> tuple[tuple[int, int], ...]:
    """List all (i, j) with i + j <= `order`, by total order.

    Examples
    --------
    >>> up_to(1)
    ((0, 0), (1, 0), (0, 1))
    """
    return tuple((total - down, down) for total in range(order + 1) for down in range(total + 1))


@lru_cache(maxsize=64)
def bell(sd_px: float) -> AnyArray:
    """Return a Gaussian (n,) of sum 1 without negative taps: a filtered sum of squares stays positive."""
    radius = ceil(2 * sd_px)
    at = np.arange(-radius, radius + 1)
    kernel = np.exp(-(at**2) / (2 * sd_px**2))
    return kernel / kernel.sum()
