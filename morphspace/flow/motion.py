"""Motion in a clip as a model of human motion perception sees it: the Multi-channel Gradient Model, video form.

Johnston, McOwan and Buxton (1992) and Johnston, McOwan and Benton (1999, 2003) describe a clip at each point by its
Taylor expansion: derivatives of a Gaussian in space, of a log-Gaussian in time. Every derivative of the image obeys its
own motion constraint, so velocity is a ratio of inner products over all of them: contrast cancels, and where the
gradient vanishes the other derivatives do not. The steps below are numbered as they are taken.

1. Time: three causal kernels over 23 frames (`temporal_kernels`). 2. Space: derivatives up to order 5 (`filters`).
3. Steering: the derivatives along and across 12 directions; the other 12 of the model's 24 only change the sign of
both sides. 4. For each direction three vectors X, Y, T over (i, j, m): the derivative of each Taylor term (i along,
j across, m in time) along, across and in time, weighted by the energy of the term over the integration zone
(`taylor_weights`). Of i = 0 to 4, j = 0 to 1 the term (4, 1) is left out: its derivatives would be of order 6. Their
six inner products make the symmetric 3 x 3 product matrix M, averaged over a small neighbourhood (ours).
5. Speeds along and across, and inverse speeds, by two readings of M:

- the inner form, published: s = (X.T / X.X) / (1 + (X.Y / X.X)^2), Y likewise; inverse X.T / T.T and Y.T / T.T. It is
  exact where the image varies along one direction only (then M = g n n', n the normal of the edge in space-time), and
  gives the velocity along the normal; with two directions it is a few per cent slow and tens of degrees astray.
- the outer form, of the rows' cross products. For any pattern that moves as a whole, the rows of M are orthogonal to
  (u, w, 1), so the cross product of the first two is a multiple of it: s = -(u, w), which is also the least squares
  solution over all channels. Inverse speed s / |s|^2. Where the image has one direction only the product vanishes.

6. Speed is the root of the ratio of the determinants of sums over the directions, direction the angle of a vector sum
(`_velocity`). A common factor of the speeds cancels: it is the inverse speeds that set the speed. 7. Before the sums
the two forms are blended by how two-dimensional the texture is, and how coherently it moves: b = k^2 / (k^2 + (plane +
6 r)^2), k = 4 det / trace^2 of the spatial part of M (0 for one direction, 1 for directions in equal parts), r the
share of T.T that the best velocity leaves over (noise is two-dimensional too, but does not move with the pattern).

That the 2005 form blends an inner and an outer form of M is published; the formulas of the outer form and of b are
ours, chosen by measurement (benchmarks/results/video.md), because the text of the paper was not at hand. So are the
average over the neighbourhood, the confidence, and the sums of (X.T X.X) / (X.X^2 + X.Y^2) in place of two quotients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial, inf, pi, sqrt, tan

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Mask
from morphspace.errors import BadInput
from morphspace.flow import filters

TAPS = 23  # frames, and pixels each way: the model's filters
DIRECTIONS = 12  # half turn; the model's 24 are these and their opposites
ORDERS = filters.up_to(filters.MAX_ORDER)
SPACE_TERMS = tuple((i, j) for j in range(2) for i in range(5) if i + j < filters.MAX_ORDER)
ZONE_RADIUS = 5  # the integration zone is 11 x 11 x 11
ZONE_SCALE = 0.5 / sqrt(
    0.5 * tan(pi / 24)
)  # m1 of the model; the zone is longer across than along by its square
MOST_SD_PX = 100.0  # wider than any picture this is meant for
LARGEST_VALUE = 1e6  # beyond any grey level; squares and their sums stay far inside float32
LEAST_SIDE_PX = 16
LEAST_GRADIENT = sqrt(0.1 / 11**3) / 255
"""The model's threshold, 0.1, on a sum over its 1331 samples at 256 grey levels, as a gradient per px of [0, 1]."""
REST_WEIGHT = 6.0
"""Of r in the blend. 1 takes noise on a grating for a second direction (4 degrees astray with 5 % noise, 0.3 with 6);
12 takes noise on a texture for want of one, and turning textures too."""
RANK_TOL = 1e-6  # of the squared trace; float32 products, whose rounding would pass for a second direction
LEAST_DETERMINANT = 1e-9  # of 36 where all directions agree; below, no direction saw motion
EDGE_SD = 4.5  # of the filters from the edge: from there on a drifting texture was right to 0.2 %
BAND_PX = 1024  # at a time: a direction's derivatives stay in the cache, and BLAS wakes no second thread


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion in a clip, for each of its frames.

    `velocity` (t, h, w, 2) px per frame, [..., 0] right, [..., 1] down: where the pattern in frame n is going.
    `confidence` (t, h, w) in [0, 1]: the share of the change in time that the velocity explains, 0 without texture.
    Of a single edge or grating only the velocity along its normal can be seen; that is what it has, with confidence.
    """

    velocity: Displacement
    confidence: Mask


def motion(
    clip: AnyArray,
    *,
    sd_px: float = 1.5,
    alpha_frames: float = 10.0,
    tau: float = 0.2,
    time_scale: float = 24.0,
    zone_sd_px: float = 1.5,
    plane: float = 3e-4,
    least_gradient: float = LEAST_GRADIENT,
) -> Motion:
    """Give the velocity at every point of a grey clip (t, h, w), any float or integer type, [0, 1] by custom.

    The velocity of frame n rests on the 23 frames n - 12 to n + 10, for `alpha_frames` of 10: the filters are causal
    and peak that many frames back, so an observer has it at frame n + 10. The weight lies within some 3 frames of n
    (its centre is 0.3 frames before n). Frames without a full window, the first 12 and the last 10, have velocity 0 and
    confidence 0. Patterns may turn by up to 2 radians of their phase a frame (a third of a wavelength); what is faster
    is aliased or filtered out. Within 7 px of the edge (4.5 `sd_px`) the mirrored image enters, which moves the other
    way: the velocity there is wrong by up to all of it, and the confidence falls to 0 with the distance to the edge.

    `sd_px` is the width of the Gaussian; sqrt(3) is the heat kernel of one published port. `alpha_frames` and `tau` are
    the peak and width of the log-Gaussian. `time_scale` is the model's weight of the terms in time (24 as published,
    which makes the second derivative in time count most; with 1 the same noise does a fraction of the harm).
    `zone_sd_px` averages the six products by a Gaussian, 0 not at all. `plane` is the two-dimensionality at which inner
    and outer form count alike without noise; infinite is the first form (1999), inner alone. Gradients under
    `least_gradient`, in the clip's units per px, are no texture, and changes under it no motion.

    Noise makes the inner form fast (T.T grows, X.T does not), most where little moves, and the published weights listen
    to the second derivative in time, which has most of it: a texture of 8-bit codes at 0.07 px per frame is seen at
    0.16, with confidence 0; with `time_scale` 1 it is right to 5 %, confidence 0.97. Use 1 for what a camera took.

    Adding a constant to the clip changes nothing; a gain changes nothing while gradients stay well above the least.
    Memory is that of the result and some 200 numbers a pixel, however long the clip. Raises `BadInput` for a clip that
    is not (t, h, w), shorter than 23 frames, smaller than 16 px, or not finite, and for filters that cannot be.
    """
    _check(clip)
    if not (
        0 < sd_px < MOST_SD_PX
        and 0 <= zone_sd_px < MOST_SD_PX
        and plane > 0
        and least_gradient > 0
        and 0 <= time_scale < inf
    ):
        raise BadInput(
            f"there is no motion with sd_px {sd_px}, zone_sd_px {zone_sd_px}, plane {plane}, least_gradient "
            f"{least_gradient} and time_scale {time_scale}: give numbers above 0 (zone and time scale may be 0)"
        )
    kernels = temporal_kernels(alpha_frames, tau).astype(np.float32)
    ahead = round(alpha_frames)  # frames of the window after the one that the velocity belongs to
    steering = _steering()
    gain = np.float32(sqrt(_energy(time_scale, 1)))
    inside = _inside(clip.shape[1], clip.shape[2], EDGE_SD * sd_px)
    velocity = np.zeros((*clip.shape, 2), np.float32)
    confidence = np.zeros(clip.shape, np.float32)
    for first in range(len(clip) - TAPS + 1):
        window = np.asarray(clip[first : first + TAPS], np.float32)[::-1]
        smoothed = np.tensordot(kernels, window - window.mean(), 1)  # the mean only costs digits
        bank = np.stack([filters.derivatives(image, ORDERS, sd_px, radius=TAPS // 2) for image in smoothed])
        products = _products(bank, steering, gain)
        if zone_sd_px > 0:
            for layer in products.reshape(-1, *clip.shape[1:]):
                cv2.GaussianBlur(layer, (0, 0), zone_sd_px, dst=layer, borderType=filters.BORDER)
        at = first + TAPS - 1 - ahead
        velocity[at], explained = _readings(products, plane, least_gradient**2)
        confidence[at] = explained * inside
    return Motion(velocity, confidence)


def _check(clip: AnyArray) -> None:
    if not isinstance(clip, np.ndarray) or clip.ndim != 3 or clip.dtype.kind not in "fiub":
        what = (
            f"an array {clip.shape} of {clip.dtype}" if isinstance(clip, np.ndarray) else type(clip).__name__
        )
        raise BadInput(f"motion is of a grey clip, an array (frames, height, width), not of {what}")
    frames, height, width = clip.shape
    if frames < TAPS:
        raise BadInput(f"the clip has {frames} frames, and motion needs {TAPS} or more: give a longer one")
    if min(height, width) < LEAST_SIDE_PX:
        raise BadInput(
            f"the clip is {width} x {height} px, and motion needs {LEAST_SIDE_PX} px or more each way"
        )
    for number, frame in enumerate(clip):  # one at a time: a clip may be larger than memory
        if not np.isfinite(frame).all():
            raise BadInput(
                f"frame {number} of the clip has values that are not finite: mend or leave out that frame"
            )
        if float(np.abs(frame.astype(np.float64)).max()) > LARGEST_VALUE:
            raise BadInput(
                f"frame {number} of the clip has values beyond {LARGEST_VALUE:.0e}: scale the clip to grey levels"
            )


def temporal_kernels(alpha_frames: float = 10.0, tau: float = 0.2) -> AnyArray:
    """Give the kernels (3, 23) float64 over the frames back from the newest: a log-Gaussian and two derivatives.

    k0(t) = exp(-(ln(t / alpha) / tau)^2) / (sqrt(pi) alpha tau exp(tau^2 / 4)), k(0) = 0; k1 and k2 are its analytic
    derivatives (Johnston, McOwan and Benton 1999). The sampled sums, already 1, 0, 0 to within 3e-7, are made exact
    with multiples of k0 (ours), so that what stands still gives no motion.

    Raises `BadInput` where the kernel does not fit in 23 frames or is narrower than they can sample (sum of k0 off by
    more than 1e-3, of k1 and k2 by more than 1e-2).
    """
    if not (0 < alpha_frames < TAPS and 0 < tau < TAPS):
        raise BadInput(
            f"a log-Gaussian needs a peak and a width above 0 and under {TAPS}, not {alpha_frames} frames and {tau}"
        )
    back = np.arange(1.0, TAPS)
    log = np.log(back / alpha_frames)
    bell = np.exp(-((log / tau) ** 2)) / (sqrt(pi) * alpha_frames * tau * np.exp(tau**2 / 4))
    slope = -2 * log / (tau**2 * back)  # of ln k0
    bend = -2 * (1 - log) / (tau * back) ** 2
    kernels = np.zeros((3, TAPS))
    kernels[:, 1:] = bell, slope * bell, (slope**2 + bend) * bell
    sums = kernels.sum(axis=1)
    if abs(sums[0] - 1) > 1e-3 or np.abs(sums[1:]).max() > 1e-2:
        raise BadInput(
            f"a log-Gaussian of peak {alpha_frames} frames and width {tau} does not fit in {TAPS} frames"
        )
    kernels[0] /= sums[0]
    kernels[1:] -= sums[1:, None] * kernels[0]
    return kernels


def taylor_weights() -> AnyArray:
    """Give the weight (9,) of each of `SPACE_TERMS`: the energy of its Taylor term over the integration zone.

    The mean over p, q = -5 to 5 of [(p / m1)^i (q / m2)^j / (i! j!)]^2, m1 = 0.5 / sqrt(0.5 tan(pi / 24)), m2 = 1 / m1
    (Johnston, McOwan and Benton 1999). The weight of a term (i, j, m) is this times the energy of the term in time, the
    mean of [(time_scale r)^m / m!]^2; a mean, where the model has the sum, makes the weight of the gradient itself 1.
    """
    return np.array([_energy(1 / ZONE_SCALE, i) * _energy(ZONE_SCALE, j) for i, j in SPACE_TERMS])


def _energy(scale: float, power: int) -> float:
    at = np.arange(-ZONE_RADIUS, ZONE_RADIUS + 1)
    return float(np.mean(((scale * at) ** power / factorial(power)) ** 2))


@lru_cache(maxsize=1)
def _steering() -> AnyArray:
    """Give (12, 27, 21) float32: for each direction the rows that make X, Y and T (9 each) of the `ORDERS`.

    D^(a, b) = (c dx + s dy)^a (-s dx + c dy)^b, by the binomials; each row by the root of its Taylor weight.
    """
    polynomial = np.polynomial.polynomial
    roots = np.sqrt(taylor_weights())
    out = np.zeros((DIRECTIONS, 3, len(SPACE_TERMS), len(ORDERS)))
    for direction, (c, s) in enumerate(zip(*_cosines(), strict=True)):
        for term, (i, j) in enumerate(SPACE_TERMS):
            for vector, (a, b) in enumerate(((i + 1, j), (i, j + 1), (i, j))):
                powers: AnyArray = polynomial.polymul(
                    polynomial.polypow([c, s], a), polynomial.polypow([-s, c], b)
                )
                for down, factor in enumerate(powers):
                    out[direction, vector, term, ORDERS.index((a + b - down, down))] = factor * roots[term]
    return out.reshape(DIRECTIONS, -1, len(ORDERS)).astype(np.float32)


def _inside(height: int, width: int, reach_px: float) -> Mask:
    """Give the distance to the nearest edge, across and down, as shares of the reach: 0 on an edge, 1 inside."""
    across, down = (np.minimum(np.arange(n), np.arange(n)[::-1]) / reach_px for n in (width, height))
    return (np.minimum(down, 1)[:, None] * np.minimum(across, 1)).astype(np.float32)


def _cosines() -> tuple[AnyArray, AnyArray]:
    angles = np.arange(DIRECTIONS) * (pi / DIRECTIONS)
    return np.cos(angles), np.sin(angles)


def _products(bank: AnyArray, steering: AnyArray, gain: np.float32) -> AnyArray:
    """Give X.X, X.Y, Y.Y, X.T, Y.T, T.T as (12, 6, h, w), from the derivatives (3, 21, h, w)."""
    height, width = bank.shape[2:]
    flat = bank.reshape(3, len(ORDERS), -1)
    out = np.empty((DIRECTIONS, 6, height * width), np.float32)
    terms = len(SPACE_TERMS)
    for start in range(0, height * width, BAND_PX):
        band = slice(start, start + BAND_PX)
        now, later = flat[:2, :, band].copy(), flat[1:, :, band].copy()  # m = 0, 1 of X and Y; of T
        now[1] *= gain
        later[1] *= gain
        for rows, made in zip(steering, out, strict=True):
            along_across, in_time = rows[: 2 * terms] @ now, rows[2 * terms :] @ later
            x, y = along_across[:, :terms], along_across[:, terms:]
            pairs = ((x, x), (x, y), (y, y), (x, in_time), (y, in_time), (in_time, in_time))
            for product, (one, other) in zip(made, pairs, strict=True):
                np.einsum("mkp,mkp->p", one, other, out=product[band])
    return out.reshape(DIRECTIONS, 6, height, width)


def _readings(products: AnyArray, plane: float, least: float) -> tuple[AnyArray, AnyArray]:
    """Give velocity (h, w, 2) and confidence (h, w) of the products (12, 6, h, w), a band at a time."""
    height, width = products.shape[2:]
    flat = products.reshape(DIRECTIONS, 6, -1)
    velocity = np.empty((height * width, 2), np.float32)
    confidence = np.empty(height * width, np.float32)
    for start in range(0, height * width, BAND_PX):
        band = slice(start, start + BAND_PX)
        matrix = flat[:, :, band].astype(np.float64).transpose(1, 0, 2)
        along, across, inverse_along, inverse_across = _speeds(matrix, plane, least)
        found = _velocity(along, across, inverse_along, inverse_across)
        velocity[band] = found
        confidence[band] = _confidence(matrix, found, least)
    return velocity.reshape(height, width, 2), confidence.reshape(height, width)


def _speeds(matrix: AnyArray, plane: float, least: float) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Give speeds along and across and inverse speeds, each (12, n), inner and outer form blended: steps 5 and 7.

    All with the sign of the ratios (against the motion). A quotient is 0 where its denominator is under the threshold.
    """
    xx, xy, yy, xt, yt, tt = matrix
    inner_along = xt * _quotient(xx, xx**2 + xy**2, least**2)
    inner_across = yt * _quotient(yy, yy**2 + xy**2, least**2)
    # rows (X.X, X.Y, X.T) and (X.Y, Y.Y, Y.T): their cross product is minor (u, w, 1)
    minor = xx * yy - xy**2
    to_along, to_across = yy * xt - xy * yt, xx * yt - xy * xt
    rank = minor > RANK_TOL * (xx + yy) ** 2
    outer_along = np.where(rank, _quotient(to_along, minor, least**2), inner_along)
    outer_across = np.where(rank, _quotient(to_across, minor, least**2), inner_across)
    squared = outer_along**2 + outer_across**2
    # twice the minor over the squared trace, and det M / minor: what least squares leaves of T.T
    spread = 4 * minor.sum(axis=0) / np.maximum(((xx + yy) ** 2).sum(axis=0), least**2)
    left = (tt * minor - xt * to_along - yt * to_across).sum(axis=0)
    rest = _quotient(left, minor.sum(axis=0) * np.maximum(tt.mean(axis=0), least), least**3)
    outer = spread**2 / (spread**2 + (plane + REST_WEIGHT * np.maximum(rest, 0)) ** 2)
    return (
        inner_along + outer * (outer_along - inner_along),
        inner_across + outer * (outer_across - inner_across),
        (1 - outer) * _quotient(xt, tt, least) + outer * _quotient(outer_along, squared, 0.0),
        (1 - outer) * _quotient(yt, tt, least) + outer * _quotient(outer_across, squared, 0.0),
    )


def _velocity(
    along: AnyArray, across: AnyArray, inverse_along: AnyArray, inverse_across: AnyArray
) -> AnyArray:
    """Give velocity (n, 2) from speeds and inverse speeds (12, n): step 6.

    The determinant of the sums of speeds has the sign of a reflection, hence the minus; the vector sum has that of the
    ratios, against the motion.
    """
    c, s = (each[:, None] for each in _cosines())
    speeds = (along * c).sum(0) * (across * s).sum(0) - (along * s).sum(0) * (across * c).sum(0)
    inverses = (along * inverse_along).sum(0) * (across * inverse_across).sum(0)
    inverses -= (along * inverse_across).sum(0) * (across * inverse_along).sum(0)
    speed = np.sqrt(np.maximum(_quotient(-speeds, inverses, LEAST_DETERMINANT), 0))
    right = ((along + inverse_along) * c - (across + inverse_across) * s).sum(axis=0)
    down = ((along + inverse_along) * s + (across + inverse_across) * c).sum(axis=0)
    return -np.stack([right, down], axis=-1) * _quotient(speed, np.hypot(right, down), 0.0)[:, None]


def _confidence(matrix: AnyArray, velocity: AnyArray, least: float) -> AnyArray:
    """Give the share of T.T that this velocity explains, over all directions; less where there is hardly texture."""
    xx, xy, yy, xt, yt, tt = matrix
    c, s = (each[:, None] for each in _cosines())
    u, w = velocity.T
    along, across = c * u + s * w, -s * u + c * w
    left = tt + along * (2 * xt + along * xx + 2 * across * xy) + across * (2 * yt + across * yy)
    texture = (xx + yy).sum(axis=0)
    explained = 1 - left.sum(axis=0) / (tt.sum(axis=0) + DIRECTIONS * least)
    confidence: AnyArray = np.clip(explained, 0, 1) * (texture / (texture + DIRECTIONS * least))
    return confidence


def _quotient(numerator: AnyArray, denominator: AnyArray, least: float) -> AnyArray:
    """Divide, and give 0 where the denominator is not above `least`."""
    enough = denominator > least
    quotient: AnyArray = np.where(enough, numerator, 0) / np.where(enough, denominator, 1)
    return quotient
