"""Derivatives of Gaussians, order 0 to 5: how the flow describes an image around a point (its Taylor expansion).

A Gaussian derivative sampled at the pixels is not the derivative of a smoothed polynomial any more: the tails are cut,
and below a standard deviation of about 1 px the samples are too coarse (at 0.5 px the sampled order 2 gives a parabola
less than half its curvature). So every kernel here is the sampled Hermite form plus the smallest change that restores
its moments: on polynomials up to degree 5 it then gives exactly what the continuous filter gives. The correction
is ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import ceil, factorial, perm

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput

MAX_ORDER = 5  # of the Multi-channel Gradient Model; also the degree of the polynomials that are kept
CORRECTION_SD_PX = (
    0.8  # least width of the correction; narrower, and it has no tap but the middle three to work with
)
BORDER = cv2.BORDER_REFLECT_101
"""Past the edge the image is mirrored about its outermost pixels. Any rule invents what lies there; this one makes no
step and no flat strip, so an edge adds no derivative energy that the picture has not, and a constant stays constant.
Odd derivatives across the edge are 0 on it, so that motion across the edge is not seen there."""


def gaussian_derivative(order: int, sd_px: float, *, radius: int | None = None) -> AnyArray:
    """Give the kernel (2 radius + 1,) float64 of a Gaussian's derivative, for correlation.

    Correlating (as `cv2.sepFilter2D` and `scipy.ndimage.correlate1d` do) smooths by a Gaussian of `sd_px` and
    differentiates `order` times (0 to 5): x**n / n! under the kernel of order n gives +1. `radius` defaults to
    `radius_of(sd_px)`; 11 with 1.5 px are the 23 taps of Johnston, McOwan and Benton (1999). A heat kernel of time t
    (one published port takes t = 1.5) is the Gaussian of sqrt(2 t) px, here just another `sd_px`.

    The kernel is He_n(k / s) G(k) / s^n (He: Hermite's polynomials, s: `sd_px`) plus c(k), the change of least norm
    sum c^2 / w, w a Gaussian of max(s, 0.8) px, that makes the moments sum h(k) k^b those of the continuous filter for
    b = 0 to 5 (fewer, the lowest, where the radius is under 3). As a share of the largest tap, over orders 0 to 5, c is
    3e-12 to 4e-8 at 1.5 px with 23 taps, 1e-6 to 2e-3 at 1.5 px with the default 17 (the cut tails), 4e-3 to 2 at
    0.7 px and 0.06 to 2 at 0.5 px. What c restores holds for low frequencies: at a quarter of the sampling rate the
    response of orders 0 to 3 is off by 0.4 to 5 % at 0.7 px and by 2 to 12 % at 0.5 px, that of orders 4 and 5 by
    15 to 43 %: there they are finite differences under a slight blur rather than derivatives of that Gaussian.

    Raises `BadInput` for an order outside 0 to 5, a width that is not positive, or a radius too small for the order.
    """
    if not 0 <= order <= MAX_ORDER:
        raise BadInput(f"there is no derivative of order {order} here: take 0 to {MAX_ORDER}")
    if not 0 < sd_px < np.inf:
        raise BadInput(f"a Gaussian of {sd_px} px has no derivatives: give a positive width")
    reach = radius_of(sd_px) if radius is None else radius
    if reach < (order + 1) // 2:
        raise BadInput(
            f"a derivative of order {order} needs a radius of {(order + 1) // 2} px or more, not {reach}"
        )
    return _kernel(order, float(sd_px), reach).copy()


def radius_of(sd_px: float) -> int:
    """Give the radius in px that a kernel has by itself: 5 sd, 3 at least, so that all six moments can be kept."""
    return max(3, ceil(5 * sd_px))


@lru_cache(maxsize=256)
def _kernel(order: int, sd_px: float, radius: int) -> AnyArray:
    at = np.arange(-radius, radius + 1) / sd_px  # in units of sd, which keeps the moments near 1
    bell = np.exp(-(at**2) / 2) / (np.sqrt(2 * np.pi) * sd_px)
    sampled = np.polynomial.hermite_e.hermeval(at, np.eye(MAX_ORDER + 1)[order]) * bell
    free = radius + 1 - order % 2  # taps that may differ, given the kernel is even or odd
    degrees = range(order % 2, MAX_ORDER + 1, 2)[:free]
    powers = at ** np.array(degrees)[:, None]
    missing = np.array([_moment(order, degree) for degree in degrees]) - powers @ sampled
    weight = np.exp(-((at * sd_px / max(sd_px, CORRECTION_SD_PX)) ** 2) / 2)
    change = weight * (powers.T @ np.linalg.solve((powers * weight) @ powers.T, missing))
    kernel: AnyArray = (sampled + change) / sd_px**order
    kernel = (kernel + (-1) ** order * kernel[::-1]) / 2  # exact parity: rounding would leave a bias
    return kernel


def _moment(order: int, degree: int) -> float:
    """Give the derivative of this order, at 0, of x**degree smoothed by a Gaussian of sd 1."""
    rest = degree - order
    if rest < 0 or rest % 2:
        return 0.0
    return perm(degree, order) * factorial(rest) / (2.0 ** (rest // 2) * factorial(rest // 2))


def derivatives(
    image: AnyArray, orders: Sequence[tuple[int, int]], sd_px: float, *, radius: int | None = None
) -> AnyArray:
    """Give derivatives of an image (h, w) as (len(orders), h, w) float32.

    Each order (i, j) is i times right and j times down, of the image smoothed by a Gaussian of `sd_px`; see
    `gaussian_derivative` for the kernels and `BORDER` for the edge. Raises `BadInput` as that does, and for an image
    that is not (h, w).
    """
    if image.ndim != 2:
        raise BadInput(f"derivatives are of one grey image (h, w), not of an array {image.shape}")
    source = np.ascontiguousarray(image, np.float32)
    out = np.empty((len(orders), *image.shape), np.float32)
    for layer, (right, down) in zip(out, orders, strict=True):
        across = gaussian_derivative(right, sd_px, radius=radius)
        along = gaussian_derivative(down, sd_px, radius=radius)
        cv2.sepFilter2D(source, cv2.CV_32F, across, along, dst=layer, borderType=BORDER)
    return out


def up_to(order: int) -> tuple[tuple[int, int], ...]:
    """List all (i, j) with i + j <= `order`, by total order: (0, 0), (1, 0), (0, 1), (2, 0), ..."""
    return tuple((total - down, down) for total in range(order + 1) for down in range(total + 1))


@lru_cache(maxsize=64)
def bell(sd_px: float) -> AnyArray:
    """Give a Gaussian (n,) that is nowhere negative: a weighted sum of squares must stay one."""
    radius = ceil(2 * sd_px)
    at = np.arange(-radius, radius + 1)
    kernel = np.exp(-(at**2) / (2 * sd_px**2))
    return kernel / kernel.sum()
