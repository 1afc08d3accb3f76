"""Motion in a clip by the Multi-channel Gradient Model, a model of human motion perception, in its video form.

Johnston, McOwan and Buxton (1992) and Johnston, McOwan and Benton (1999, 2003) describe a clip at each point by its
Taylor expansion: derivatives of a Gaussian in space, of a log-Gaussian in time. Every derivative of the image has its
own motion constraint, so velocity is a ratio of inner products over all of them. Contrast cancels, and where the
gradient vanishes the other derivatives do not. The computation has seven steps.

1. Time: three causal kernels over 23 frames (`temporal_kernels`).
2. Space: derivatives up to order 5 (`filters`).
3. Steering: the derivatives along and across 12 directions. The other 12 of the model's 24 only change the sign of
   both sides.
4. For each direction three vectors X, Y, T over (i, j, m): the derivatives of each Taylor term along, across and in
   time. A term has i derivatives along, j across and m in time; its weight is its energy over the integration zone
   (`taylor_weights`). Of i = 0 to 4, j = 0 to 1 the term (4, 1) is omitted: its derivatives would be of order 6. The
   six inner products of X, Y and T form the symmetric 3 x 3 product matrix M, averaged over a small neighbourhood
   (ours).
5. Speeds along and across, and inverse speeds, in two forms computed from M:

   - The inner form, published: s = (X.T / X.X) / (1 + (X.Y / X.X)^2), Y likewise; inverse X.T / T.T and Y.T / T.T. It
     is exact where the image varies along one direction only; then M = g n n', with n the normal of the edge in
     space-time. It gives the velocity along the normal. With two directions it is a few per cent slow and tens of
     degrees wrong.
   - The outer form, from cross products of the rows. For any pattern that moves as a whole, the rows of M are
     orthogonal to (u, w, 1), so the cross product of the first two is a multiple of it: s = -(u, w). This is also the
     least squares solution over all channels. The inverse speed is s / |s|^2. Where the image has one direction only,
     the product vanishes.

6. Speed is the root of the ratio of the determinants of sums over the directions, direction the angle of a vector sum
   (`_velocity`). A common factor of the speeds cancels, so the inverse speeds determine the speed.
7. Before the sums the two forms are blended: b = k^2 / (k^2 + (plane + 6 r)^2) is the weight of the outer form.
   Two-dimensional texture has a large k = 4 det / trace^2 of the spatial part of M (0 for one direction, 1 for
   directions in equal parts). Incoherent motion has a large r, the share of T.T that the best velocity leaves: noise
   is two-dimensional too, but does not move with the pattern.

That the 2005 form blends an inner and an outer form of M is published. The formulas of the outer form and of b are
ours, chosen by measurement (benchmarks/results/video.md), because the text of the paper was not available. Also ours
are the average over the neighbourhood, the confidence, and the sums of (X.T X.X) / (X.X^2 + X.Y^2) in place of two
quotients.
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

TAPS = 23  # frames of the temporal filters, and pixels each way of the spatial ones
DIRECTIONS = 12  # over half a turn; the model's 24 are these and their opposites
ORDERS = filters.up_to(filters.MAX_ORDER)
SPACE_TERMS = tuple((i, j) for j in range(2) for i in range(5) if i + j < filters.MAX_ORDER)
ZONE_RADIUS = 5  # samples; the integration zone is 11 x 11 x 11
ZONE_SCALE = 0.5 / sqrt(0.5 * tan(pi / 24))  # m1 of the model; its square is the zone's aspect ratio
MOST_SD_PX = 100.0  # px; wider than any useful filter
LARGEST_VALUE = 1e6  # grey levels; its squares and their sums stay far inside float32
LEAST_SIDE_PX = 16  # px; of a smaller clip the filters see mostly the edge
LEAST_GRADIENT = sqrt(0.1 / 11**3) / 255
"""Per px, in [0, 1]: the model's threshold, 0.1 on a sum over 1331 samples at 256 grey levels, as a gradient."""
RESIDUAL_WEIGHT = 6.0
"""Weight of r in the blend. At 1, noise on a grating acts as a second direction: 5 % noise gives an error of 4 degrees,
with 6 one of 0.3. At 12, noise on a texture and turning textures act as a single direction."""
RANK_TOL = 1e-6  # share of the squared trace; float32 rounding would imitate a second direction
LEAST_DETERMINANT = 1e-9  # 36 where all directions agree; below it no direction has motion
EDGE_SD = 4.5  # SD of the filters from the edge, at which a drifting texture was right to 0.2 %
BAND_PX = 1024  # pixels at a time: a direction's derivatives fit the cache, and BLAS starts no second thread


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion in a clip of t frames.

    At a single edge or grating only the velocity along its normal can be measured; `velocity` then has it, with
    confidence.

    Attributes
    ----------
    velocity : array (t, h, w, 2) float32
        In px per frame, [..., 0] right, [..., 1] down: the motion of the pattern in frame n.
    confidence : array (t, h, w) float32
        In [0, 1]: the share of the change in time that the velocity explains; 0 without texture.
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
    """Compute the velocity at every point of a grey clip.

    Parameters
    ----------
    clip : array (t, h, w)
        Any float or integer type, by custom in [0, 1].
    sd_px : float
        Width of the Gaussian; sqrt(3) px is the heat kernel of one published port.
    alpha_frames, tau : float
        Peak (frames) and width of the log-Gaussian.
    time_scale : float
        Weight of the terms in time. The published 24 gives the second derivative in time most weight. Use 1 for
        camera recordings (Notes).
    zone_sd_px : float
        Width of the Gaussian that averages the six products; 0 for no average.
    plane : float
        Two-dimensionality at which the inner and outer form have equal weight without noise. Infinite is the first
        form (1999), the inner form alone.
    least_gradient : float
        Smallest gradient that counts as texture, and change that counts as motion, in the clip's units per px.

    Returns
    -------
    Motion
        Velocity and confidence are 0 in the first 12 and the last 10 frames, which have no full window.

    Raises
    ------
    BadInput
        If the clip is not (t, h, w), shorter than 23 frames, smaller than 16 px, or not finite, or a filter cannot
        exist.

    Notes
    -----
    The velocity of frame n depends on the 23 frames n - 12 to n + 10, for `alpha_frames` of 10. The filters are
    causal and peak
    that many frames back, so an observer has the velocity at frame n + 10. Most weight lies within 3 frames of n; its
    centre is
    0.3 frames before n.

    Patterns may move by up to 2 radians of their phase a frame (a third of a wavelength); faster motion is aliased or
    filtered out. Within 7 px of the edge (4.5 `sd_px`) the mirrored image enters, which moves the opposite way. The
    velocity there may be wrong by its full size, and the confidence falls to 0 towards the edge.

    Noise makes the inner form fast (T.T grows, X.T does not), most where motion is slow. The published weights
    emphasise the second
    derivative in time, which has most noise: a texture of 8-bit codes at 0.07 px per frame is measured as 0.16, with
    confidence
    0. With `time_scale` 1 it is correct to 5 %, with confidence 0.97.

    A constant added to the clip changes nothing, nor does a gain while gradients stay well above `least_gradient`.
    Memory is that of the result and some 200 numbers a pixel, for any length of the clip.

    References
    ----------
    Johnston, McOwan and Benton, Proc. R. Soc. B 266, 1999; the module's steps say which parts are ours.

    Examples
    --------
    >>> import numpy as np
    >>> moving = 0.6 * (np.arange(32) - 0.5 * np.arange(24)[:, None, None]) * np.ones((1, 32, 1))  # 0.5 px a frame
    >>> motion(0.5 + 0.4 * np.sin(moving)).velocity[12, 16, 16, 0].round(2).item()
    0.5
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
            f"sd_px is {sd_px}, zone_sd_px {zone_sd_px}, plane {plane}, least_gradient {least_gradient} and "
            f"time_scale {time_scale}; expected finite numbers above 0 (the zone and time scale may be 0). Change it"
        )
    kernels = temporal_kernels(alpha_frames, tau).astype(np.float32)
    ahead = round(alpha_frames)  # frames of the window after the frame of the velocity
    steering = _steering()
    gain = np.float32(sqrt(_energy(time_scale, 1)))
    inside = _inside(clip.shape[1], clip.shape[2], EDGE_SD * sd_px)
    velocity = np.zeros((*clip.shape, 2), np.float32)
    confidence = np.zeros(clip.shape, np.float32)
    for first in range(len(clip) - TAPS + 1):
        window = np.asarray(clip[first : first + TAPS], np.float32)[::-1]
        smoothed = np.tensordot(kernels, window - window.mean(), 1)  # without the mean, which costs digits
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
        raise BadInput(f"the clip is {what}; expected a grey array (frames, height, width). Convert it")
    frames, height, width = clip.shape
    if frames < TAPS:
        raise BadInput(f"the clip has {frames} frames; expected at least {TAPS}. Use a longer clip")
    if min(height, width) < LEAST_SIDE_PX:
        raise BadInput(
            f"the clip is {width} x {height} px; expected at least {LEAST_SIDE_PX} px a side. Use a larger one"
        )
    for number, frame in enumerate(clip):  # one at a time: a clip may be larger than memory
        if not np.isfinite(frame).all():
            raise BadInput(
                f"frame {number} of the clip has values that are not finite; expected none. Repair or remove it"
            )
        if float(np.abs(frame.astype(np.float64)).max()) > LARGEST_VALUE:
            raise BadInput(
                f"frame {number} of the clip has values beyond {LARGEST_VALUE:.0e}, the limit. Scale the clip to [0, 1]"
            )


def temporal_kernels(alpha_frames: float = 10.0, tau: float = 0.2) -> AnyArray:
    """Compute the temporal filters: a log-Gaussian and its first two derivatives.

    k0(t) = exp(-(ln(t / alpha) / tau)^2) / (sqrt(pi) alpha tau exp(tau^2 / 4)), k0(0) = 0; k1 and k2 are its analytic
    derivatives. The sums of the samples, 1, 0, 0 to within 3e-7, are made exact with multiples of k0 (ours), so that
    a static clip has no motion.

    Parameters
    ----------
    alpha_frames : float
        Peak, in frames back from the newest.
    tau : float
        Width.

    Returns
    -------
    array (3, 23) float64
        Over the frames back from the newest.

    Raises
    ------
    BadInput
        If the kernel does not fit in 23 frames or is too narrow to sample: the sum of k0 is off by more than 1e-3, or
        those of k1 and k2 by more than 1e-2.

    References
    ----------
    Johnston, McOwan and Benton, Proc. R. Soc. B 266, 1999.

    Examples
    --------
    >>> temporal_kernels().argmax(axis=1).tolist()[0]
    10
    """
    if not (0 < alpha_frames < TAPS and 0 < tau < TAPS):
        raise BadInput(
            f"the log-Gaussian has its peak at {alpha_frames} frames and the width {tau}; expected both above 0 and "
            f"under {TAPS}. Change alpha_frames or tau"
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
            f"the log-Gaussian with its peak at {alpha_frames} frames and the width {tau} does not fit {TAPS} frames. "
            "Change alpha_frames or tau"
        )
    kernels[0] /= sums[0]
    kernels[1:] -= sums[1:, None] * kernels[0]
    return kernels


def taylor_weights() -> AnyArray:
    """Compute the weight (9,) of each of `SPACE_TERMS`: the energy of its Taylor term over the integration zone.

    It is the mean over p, q = -5 to 5 of [(p / m1)^i (q / m2)^j / (i! j!)]^2, with m1 = 0.5 / sqrt(0.5 tan(pi / 24))
    and m2 = 1 / m1 (Johnston, McOwan and Benton, 1999). The weight of a term (i, j, m) is this times its energy in
    time, the mean of [(time_scale r)^m / m!]^2. The model has sums in place of means; with means the weight of the
    gradient itself is 1.
    """
    return np.array([_energy(1 / ZONE_SCALE, i) * _energy(ZONE_SCALE, j) for i, j in SPACE_TERMS])


def _energy(scale: float, power: int) -> float:
    at = np.arange(-ZONE_RADIUS, ZONE_RADIUS + 1)
    return float(np.mean(((scale * at) ** power / factorial(power)) ** 2))


@lru_cache(maxsize=1)
def _steering() -> AnyArray:
    """Compute (12, 27, 21) float32: for each direction the rows that map the `ORDERS` to X, Y and T (9 rows each).

    D^(a, b) = (c dx + s dy)^a (-s dx + c dy)^b, expanded by binomials; each row is scaled by the root of its Taylor
    weight.
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
    """Return the distance to the nearest edge, across and down, as shares of the reach: 0 on an edge, 1 inside."""
    across, down = (np.minimum(np.arange(n), np.arange(n)[::-1]) / reach_px for n in (width, height))
    return (np.minimum(down, 1)[:, None] * np.minimum(across, 1)).astype(np.float32)


def _cosines() -> tuple[AnyArray, AnyArray]:
    angles = np.arange(DIRECTIONS) * (pi / DIRECTIONS)
    return np.cos(angles), np.sin(angles)


def _products(bank: AnyArray, steering: AnyArray, gain: np.float32) -> AnyArray:
    """Compute X.X, X.Y, Y.Y, X.T, Y.T, T.T, (12, 6, h, w), from the derivatives (3, 21, h, w)."""
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
    """Compute velocity (h, w, 2) and confidence (h, w) from the products (12, 6, h, w), a band at a time."""
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
    """Compute speeds along and across and inverse speeds, each (12, n), blended from both forms: steps 5 and 7.

    All have the sign of the ratios, opposite to the motion. A quotient with a denominator under the threshold is 0.
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
    # k = 4 minor / trace^2, and det M / minor, the residual of least squares
    spread = 4 * minor.sum(axis=0) / np.maximum(((xx + yy) ** 2).sum(axis=0), least**2)
    left = (tt * minor - xt * to_along - yt * to_across).sum(axis=0)
    residual = _quotient(left, minor.sum(axis=0) * np.maximum(tt.mean(axis=0), least), least**3)
    outer = spread**2 / (spread**2 + (plane + RESIDUAL_WEIGHT * np.maximum(residual, 0)) ** 2)
    return (
        inner_along + outer * (outer_along - inner_along),
        inner_across + outer * (outer_across - inner_across),
        (1 - outer) * _quotient(xt, tt, least) + outer * _quotient(outer_along, squared, 0.0),
        (1 - outer) * _quotient(yt, tt, least) + outer * _quotient(outer_across, squared, 0.0),
    )


def _velocity(
    along: AnyArray, across: AnyArray, inverse_along: AnyArray, inverse_across: AnyArray
) -> AnyArray:
    """Compute velocity (n, 2) from speeds and inverse speeds (12, n): step 6.

    The determinant of the sums of speeds has the sign of a reflection, hence the minus. The vector sum has the sign
    of the ratios, opposite to the motion.
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
    """Compute the share of T.T that the velocity explains over all directions, reduced where texture is weak."""
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
    """Divide; the result is 0 where the denominator is not above `least`."""
    enough = denominator > least
    quotient: AnyArray = np.where(enough, numerator, 0) / np.where(enough, denominator, 1)
    return quotient
