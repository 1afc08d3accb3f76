"""The flow of Nagle et al., reconstructed: the preset `paper`, a baseline.

Nagle et al. (section 2) register each face by the Multi-channel Gradient Model: grey pictures at several resolutions,
whose fields are combined into one of full size. The rest is a reconstruction of their scheme. The pictures are
blurred at 0.05, 0.1, 0.2, 0.4 and 0.8 of the size. Each scale computes the model's motion between the pictures after
the warps so far. 50 passes of a 3 x 3 mean weighted by |Laplacian| then fill flat regions from texture. The field is
upsampled and composed, and the frame is warped again. The result is blended with the field of a single scale by local
error.

The motion at one scale is the model's first form (Johnston, McOwan and Benton 1999) as in `motion`: 24 directions,
Taylor weights, ratios of inner products over all channels, speed from determinants, direction from a vector sum. Two
pictures are the only samples in time. Spatial derivatives are of their mean, the derivative in time is their
difference, and there is no second derivative, so only terms without time remain (m = 0).

The following is ours, where their method is unknown. The frame is sampled onto the reference (they warp the
reference), since our fields live there. Both pictures are scaled by their common contrast, and each is blurred before
a scale. No step is longer than `LONGEST_STEP_PX`, because a ratio has no bound where the image varies little in
space. The single scale is 0.8. The form of the blend and the confidence are ours too.

One scale measures broadband texture that moves by 1 px 4 to 12 % slow and 12 to 15 degrees wrong (medians), as the
first form of the video model does. The pyramid and the averaging correct most of it. A change of light appears as
motion.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.flow import Flow, FlowFunction, filters
from morphspace.flow.baselines import LUMA
from morphspace.flow.motion import DIRECTIONS, LEAST_DETERMINANT, ORDERS, SPACE_TERMS, taylor_weights
from morphspace.flow.pairs import checked_pair, checked_picture, checked_start, is_featureless, unknown_flow
from morphspace.grid import warp

SCALES = (0.05, 0.1, 0.2, 0.4, 0.8)  # shares of the full size, coarsest first
SINGLE_SCALE = 0.8  # share of the full size
LEAST_SIDE_PX = 12  # px of a scale; coarser scales are omitted. 0.8 of the smallest picture is 13 px
DERIVATIVE_SD_PX = 1.5  # px of a scale; SD of the Gaussian that is derived
BLUR_SD_PX = 0.5  # px of a scale; SD of the blur before it
LONGEST_STEP_PX = 2 * DERIVATIVE_SD_PX  # px of a scale; the range of the filters
PASSES = 50  # averagings of the field
LEAST_ENERGY = 1e-6  # squared contrasts per px; a smaller product is no texture, or no motion
LEAST_LAPLACIAN = 1e-3  # share of the mean; a flat region then has equal weights
ERROR_SD_PX = 3.0  # px, over which the local error is averaged
LEAST_ERROR = np.float32(1e-5)  # squared contrasts; two smaller errors are equal, and a region is flat


def method(reference: Image) -> FlowFunction:
    """Return the flow from a reference; this function is a `FlowMethod`.

    The pictures need 16 px each way. A `start` is checked and ignored: the authors had none. Only luma is compared,
    so two colours of equal luma are flat. A gain or offset common to both pictures changes nothing, while the
    contrast is at least half an 8-bit code; one of a single picture does. Hardly any work is shared between frames,
    since mean and difference depend on both pictures.

    Confidence (ours) is the share of the reference's local contrast that the frame reproduces after the warp; 0
    without contrast. It is also high where a straight edge may have moved along itself.

    Parameters
    ----------
    reference : array (h, w, 3)

    Raises
    ------
    BadInput, SizeMismatch
        As `pairs.checked_pair`.

    References
    ----------
    Nagle et al., section 2; Johnston, McOwan and Benton, 1999.
    """
    first = checked_picture(reference, "the reference")

    def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
        _, second = checked_pair(first, frame)
        height, width = first.shape[:2]
        if start is not None:
            checked_start(start, height, width)
        grey, other = first @ LUMA, second @ LUMA
        if is_featureless(grey[..., None]) or is_featureless(other[..., None]):
            return unknown_flow(height, width)
        middle, contrast = grey.mean(), np.sqrt((grey.var() + other.var()) / 2)
        grey, other = (grey - middle) / contrast, (other - middle) / contrast
        scales = [scale for scale in SCALES if scale * min(height, width) >= LEAST_SIDE_PX]
        return _blended(grey, other, _descent(grey, other, scales), _descent(grey, other, [SINGLE_SCALE]))

    return to_frame


def _blended(grey: AnyArray, other: AnyArray, field: Displacement, single: Displacement) -> Flow:
    """Average two fields, each weighted by the other's share of the local error; add the confidence."""
    error, error_single = (_local_error(grey, other, each) for each in (field, single))
    share = ((error_single + LEAST_ERROR) / (error + error_single + 2 * LEAST_ERROR))[..., None]
    mixed: AnyArray = share * field + (1 - share) * single
    contrast = np.maximum(_averaged(grey**2) - _averaged(grey) ** 2, 0)
    explained = np.maximum(contrast - _local_error(grey, other, mixed), 0)
    confidence: Mask = explained / (contrast + LEAST_ERROR)
    return Flow(mixed, confidence)


def _local_error(grey: AnyArray, other: AnyArray, field: Displacement) -> AnyArray:
    return _averaged((warp.sample(other, field) - grey) ** 2)


def _averaged(values: AnyArray) -> AnyArray:
    averaged: AnyArray = cv2.GaussianBlur(values, (0, 0), ERROR_SD_PX, borderType=filters.BORDER)
    return averaged


def _descent(grey: AnyArray, other: AnyArray, scales: list[float]) -> Displacement:
    """Compute the field (h, w, 2) px of two pictures (h, w), scale by scale from zero."""
    height, width = grey.shape
    field: Displacement = np.zeros((height, width, 2), np.float32)
    for scale in scales:
        one, two = (_scaled(picture, scale) for picture in (grey, warp.sample(other, field)))
        step = _filled(_velocity(one, two), one)
        factors = np.array([width / step.shape[1], height / step.shape[0]], np.float32)
        full = cv2.resize(step, (width, height), interpolation=cv2.INTER_LINEAR) * factors
        field = warp.compose(field, full)
    return field


def _scaled(picture: AnyArray, scale: float) -> AnyArray:
    height, width = picture.shape
    blurred = cv2.GaussianBlur(picture, (0, 0), BLUR_SD_PX / scale, borderType=filters.BORDER)
    size = round(width * scale), round(height * scale)
    scaled: AnyArray = cv2.resize(blurred, size, interpolation=cv2.INTER_AREA)
    return scaled


def _filled(step: Displacement, picture: AnyArray) -> Displacement:
    """Average a field (h, w, 2) `PASSES` times, each pixel weighted by the texture of `picture`."""
    bends = filters.derivatives(picture, ((2, 0), (0, 2)), 1.0)
    weight = np.abs(bends[0] + bends[1])
    weight += LEAST_LAPLACIAN * weight.mean() + np.float32(1e-12)  # a flat picture: equal weights
    total = cv2.blur(weight, (3, 3), borderType=filters.BORDER)[..., None]
    for _ in range(PASSES):
        step = cv2.blur(step * weight[..., None], (3, 3), borderType=filters.BORDER) / total
    return step


def _velocity(one: AnyArray, two: AnyArray) -> Displacement:
    """Compute the model's velocity (h, w, 2) px, float32, from one picture (h, w) to the other: its steps 3 to 6."""
    space = filters.derivatives((one + two) / 2, ORDERS, DERIVATIVE_SD_PX).reshape(len(ORDERS), -1)
    time = filters.derivatives(two - one, ORDERS, DERIVATIVE_SD_PX).reshape(len(ORDERS), -1)
    speeds = np.zeros((2, 2, one.size))  # s_along (c, s); s_across (c, s), summed over the directions
    inverses = np.zeros((2, 2, one.size))  # s_along (i_along, i_across); s_across (...)
    pointer = np.zeros((2, one.size))
    for angle, rows in zip(*_steering(), strict=True):
        turn = np.array([np.cos(angle), np.sin(angle)])
        x, y, t = rows[0] @ space, rows[1] @ space, rows[2] @ time
        xx, xy, yy, xt, yt, tt = (
            np.einsum("kp,kp->p", a, b) for a, b in ((x, x), (x, y), (y, y), (x, t), (y, t), (t, t))
        )
        # (X.T / X.X) / (1 + (X.Y / X.X)^2), in one quotient
        speed = np.stack(
            [
                xt * _quotient(xx, xx**2 + xy**2, LEAST_ENERGY**2),
                yt * _quotient(yy, yy**2 + xy**2, LEAST_ENERGY**2),
            ]
        )
        inverse = np.stack([_quotient(xt, tt, LEAST_ENERGY), _quotient(yt, tt, LEAST_ENERGY)])
        speeds += speed[:, None] * turn[:, None]
        inverses += speed[:, None] * inverse
        along, across = speed + inverse
        pointer += along * turn[:, None] + across * np.array([-turn[1], turn[0]])[:, None]
    squared = _quotient(-_determinant(speeds), _determinant(inverses), LEAST_DETERMINANT)
    length = np.minimum(np.sqrt(np.maximum(squared, 0)), LONGEST_STEP_PX)
    velocity = -pointer * _quotient(length, np.hypot(*pointer), 0.0)  # the ratios have the opposite sign
    return np.ascontiguousarray(velocity.T.reshape(*one.shape, 2), np.float32)


@lru_cache(maxsize=1)
def _steering() -> tuple[AnyArray, AnyArray]:
    """Compute the directions (12,) and the maps from the `ORDERS` to X, Y and T in each, (12, 3, 9, 21) float32.

    The other 12 of the model's 24 directions only change the sign of both sides.
    """
    polynomial = np.polynomial.polynomial
    angles = np.arange(DIRECTIONS) * (np.pi / DIRECTIONS)
    rows = np.zeros((DIRECTIONS, 3, len(SPACE_TERMS), len(ORDERS)), np.float32)
    for angle, made in zip(angles, rows, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        for term, ((i, j), weight) in enumerate(zip(SPACE_TERMS, taylor_weights(), strict=True)):
            for vector, (a, b) in enumerate(((i + 1, j), (i, j + 1), (i, j))):
                powers: AnyArray = polynomial.polymul(
                    polynomial.polypow([c, s], a), polynomial.polypow([-s, c], b)
                )
                for down, factor in enumerate(powers):
                    made[vector, term, ORDERS.index((a + b - down, down))] = factor * np.sqrt(weight)
    return angles, rows


def _determinant(matrix: AnyArray) -> AnyArray:
    determinant: AnyArray = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
    return determinant


def _quotient(numerator: AnyArray, denominator: AnyArray, least: float) -> AnyArray:
    """Divide; the result is 0 where the denominator is not above `least`."""
    enough = denominator > least
    quotient: AnyArray = np.where(enough, numerator, 0) / np.where(enough, denominator, 1)
    return quotient
