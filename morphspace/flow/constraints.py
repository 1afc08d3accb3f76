"""The motion constraints of two pictures at each pixel: many derivative channels, summed in one tensor.

Each derivative (j, k) of the image has its own motion constraint, g_x du + g_y dv + g_t = 0. g_x and g_y are its slopes
in the mean of both pictures, g_t is its change (docs/methods.md, section 4). Divided by its slope a constraint is a
distance in px, from which the picture's contrast cancels: the ratio of the Multi-channel Gradient Model (Johnston,
McOwan and Benton, Proc. R. Soc. B 1999). The sum of their squares is a quadratic in (du, dv), six numbers a pixel, and
all that the solver uses of the pictures.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.flow.backends import Backend, Planes
from morphspace.flow.filters import gaussian_derivative, up_to

LIGHT_CELL_PX = 8  # px a side of the cells in which the light of two pictures is compared
MOST_MISMATCH_PX = 5.0  # px; larger errors count the same, so that they do not spread in the average


@dataclass(frozen=True, eq=False)
class Channels:
    """The derivatives that are compared, and their weights.

    Attributes
    ----------
    weights : tuple of float
        One for each total order 0, 1, ...; a weight of 0 leaves the order out.
    sd_px : float
        Of the Gaussian.
    noise_codes : float
        SD of the noise (8-bit codes) at which a slope counts half.
    light_codes : float
        Local change of light (8-bit codes) beyond which order 0, the raw picture, does not count.
    """

    weights: tuple[float, ...]
    sd_px: float
    noise_codes: float
    light_codes: float

    @cached_property
    def kernels(self) -> tuple[AnyArray, ...]:
        """The Gaussian's derivatives of order 0, 1, ..., one order more than the channels have."""
        radius = max(3, ceil(4 * self.sd_px))
        return tuple(gaussian_derivative(n, self.sd_px, radius=radius) for n in range(len(self.weights) + 1))

    @property
    def total_weight(self) -> float:
        """The total weight of all channels; there are n + 1 of total order n."""
        return sum((order + 1) * weight for order, weight in enumerate(self.weights))

    @cached_property
    def half_kernels(self) -> tuple[tuple[AnyArray, AnyArray], ...]:
        """The kernels (n,) across and down that compute half of each derivative, in the order of `up_to`."""
        halves = [
            kernel / 2 for kernel in self.kernels
        ]  # a backend recognises a shared kernel by its identity
        return tuple((halves[i], self.kernels[j]) for i, j in up_to(len(self.weights)))

    @cached_property
    def right(self) -> tuple[int, ...]:
        """For each channel, the index of its slope to the right among the derivatives from order 1 on."""
        places = up_to(len(self.weights))[1:]
        return tuple(places.index((i + 1, j)) for i, j in up_to(len(self.weights) - 1))

    @cached_property
    def down(self) -> tuple[int, ...]:
        """For each channel, the index of its slope down among the derivatives from order 1 on."""
        places = up_to(len(self.weights))[1:]
        return tuple(places.index((i, j + 1)) for i, j in up_to(len(self.weights) - 1))

    @cached_property
    def noise_floors(self) -> tuple[tuple[float, ...], ...]:
        """For each channel, by order, the squared slope that noise of `noise_codes` alone has in one colour."""
        energy = [float((kernel**2).sum()) for kernel in self.kernels]
        return tuple(
            tuple(
                self.noise_codes**2 * (energy[n - j + 1] * energy[j] + energy[n - j] * energy[j + 1])
                for j in range(n + 1)
            )
            for n in range(len(self.weights))
        )


Derivatives = Planes
"""(n, c, h, w): half of every derivative of each colour, in the order of `up_to`."""


def of_order(order: int) -> slice:
    """Return the slice of the derivatives of one total order, in the order of `up_to`.

    Examples
    --------
    >>> of_order(2)
    slice(3, 6, None)
    """
    first = order * (order + 1) // 2
    return slice(first, first + order + 1)


def half_derivatives(backend: Backend, planes: Planes, channels: Channels) -> Derivatives:
    """Compute half of each derivative of planes (c, h, w): the sum of two is the mean of two pictures."""
    return backend.bank(planes, channels.half_kernels)


@dataclass(frozen=True, eq=False)
class Tensor:
    """The quadratic xx du^2 + yy dv^2 + 2 xy du dv + 2 xt du + 2 yt dv + tt, in px^2.

    Attributes
    ----------
    sums : planes (6, h, w)
        xx, yy, xy, xt, yt, tt.
    """

    sums: Planes

    def residual(self, du: Planes, dv: Planes) -> Planes:
        """Compute the quadratic at (du, dv) px, each (h, w): the squared error of all channels together, px^2."""
        xx, yy, xy, xt, yt, tt = self.sums
        out = xx * du
        out += 2 * xt
        out *= du
        down = xy * du
        down += yt
        down *= 2
        down += yy * dv
        down *= dv
        out += down
        out += tt
        return out


def tensor(
    backend: Backend,
    reference: Derivatives,
    frame: Derivatives,
    channels: Channels,
    shape: tuple[int, int, int],
) -> Tensor:
    """Sum the squared constraints of all channels.

    The colours of a channel share one normalisation, so a colour without contrast adds no noise.

    Parameters
    ----------
    backend : Backend
    reference, frame : planes (n, c, h, w)
        Half derivatives of both pictures; those of the frame after warping.
    channels : Channels
    shape : (c, h, w)

    References
    ----------
    Johnston, McOwan and Benton, Proc. R. Soc. B 266, 1999: the ratio of each derivative; the weights are ours.
    """
    _, height, width = shape
    total = backend.zeros(6, height, width)
    change, agreement = None, 0.0
    if channels.weights[0] > 0:
        change, agreement = _light_apart(backend, frame[0] - reference[0], channels.light_codes / 2)
    for rows in backend.strips(height, width):
        _add_constraints(
            backend,
            total[:, rows],
            reference[:, :, rows],
            frame[:, :, rows],
            None if change is None else change[:, rows],
            agreement,
            channels,
        )
    total[3:5] *= 2
    total[5] *= 4
    return Tensor(total)


def _add_constraints(
    backend: Backend,
    total: Planes,
    reference: Derivatives,
    frame: Derivatives,
    raw_change: Planes | None,
    agreement: Planes | float,
    channels: Channels,
) -> None:
    """Add the constraints of some rows to the six sums `total` (6, h, w); the sums with g_t use half the change."""
    mean = reference[1:] + frame[1:]
    colours = mean.shape[1]
    square = backend.dot(mean, mean)
    used = slice(0 if raw_change is not None else 1, len(channels.right))
    half_change = frame[used] - reference[used]
    if raw_change is not None:
        half_change[0] = raw_change
    weights, floors = _weights_and_floors(backend, channels)  # type: ignore[arg-type]  # hashed by identity
    across, down = (backend.picked(square, places[used]) for places in (channels.right, channels.down))
    per_px = across + down
    per_px += colours * floors[used]
    per_px = weights[used] / per_px
    if raw_change is not None:
        per_px[0] *= agreement
    x, y = (backend.picked(mean, places[used]) for places in (channels.right, channels.down))
    total[0] += backend.dot(per_px[None], across[None])[0]
    total[1] += backend.dot(per_px[None], down[None])[0]
    total[2] += backend.weighted_dot(per_px, x, y)
    total[3] += backend.weighted_dot(per_px, x, half_change)
    total[4] += backend.weighted_dot(per_px, y, half_change)
    total[5] += backend.weighted_dot(per_px, half_change, half_change)


@lru_cache(maxsize=32)
def _weights_and_floors(backend: Backend, channels: Channels) -> tuple[Planes, Planes]:
    """Return weight and noise floor of each channel, (n, 1, 1) each; cached: a transfer makes a GPU wait."""
    weights = [weight for order, weight in enumerate(channels.weights) for _ in range(order + 1)]
    floors = [floor for order in channels.noise_floors for floor in order]
    as_planes = (backend.planes(np.array(values)[:, None, None]) for values in (weights, floors))
    return next(as_planes), next(as_planes)


def _light_apart(backend: Backend, change: Planes, light_codes: float) -> tuple[Planes, Planes]:
    """Subtract the common change of light from a change (c, h, w); return the rest and the weight (0-d) of raw values.

    The common change is the median of every fourth pixel each way, so adding a constant to a picture alters nothing.
    The rest is averaged over cells of `LIGHT_CELL_PX`. Under constant light most cells keep their colour, even while
    a mouth opens in some. If the median cell changes by more than `light_codes`, the light has changed. The weight is
    exp(-1) at that limit and exp(-16) at twice the limit.
    """
    xp = backend.xp
    height, width = change.shape[1:]
    change = change - xp.stack([backend.middle(plane[::4, ::4]) for plane in change])[:, None, None]
    cells = max(1, round(height / LIGHT_CELL_PX)), max(1, round(width / LIGHT_CELL_PX))
    light = backend.averaged(change, *cells)
    off = backend.middle(xp.sqrt((light * light).sum(0) / len(change))) / light_codes
    return change, xp.exp(-(off**4))


@dataclass(frozen=True, eq=False)
class Appearance:
    """The first derivatives of a picture, scaled to px, by which whole fields are compared.

    Attributes
    ----------
    slopes : planes (2, c, h, w)
        Half of each first derivative.
    per_px : planes (2, h, w)
        One over the square of the second derivatives: converts squared differences of slopes to px^2.
    """

    slopes: Planes
    per_px: Planes


def appearance(backend: Backend, derivatives: Derivatives, channels: Channels) -> Appearance:
    """Compute the appearance of a picture from its half derivatives."""
    xp = backend.xp
    colours = derivatives.shape[1]
    right, down = (colours * floor / 4 for floor in channels.noise_floors[1])
    xx, xy, yy = backend.dot(derivatives[of_order(2)], derivatives[of_order(2)])
    per_px = xp.stack([1 / (xx + xy + right), 1 / (xy + yy + down)])
    return Appearance(derivatives[of_order(1)], per_px)


def mismatch(
    backend: Backend, reference: Appearance, slopes: Planes, x: Planes, y: Planes, blur: Any
) -> Planes:
    """Compute how far the frame at (x, y) px differs from each pixel of the reference, (h, w) px.

    Parameters
    ----------
    backend : Backend
    reference : Appearance
    slopes : planes (2, c, h, w)
        Half of each first derivative of the frame.
    x, y : planes (h, w)
        Positions in the frame, px. A position outside the frame has `MOST_MISMATCH_PX`.
    blur : array (n,)
        Kernel of the neighbourhood over which the difference is averaged.
    """
    xp = backend.xp
    _, colours, height, width = slopes.shape
    found = backend.looked_up(slopes.reshape(2 * colours, height, width), x, y)
    difference = found.reshape(2, colours, *x.shape) - reference.slopes
    square = backend.weighted_dot(reference.per_px, difference, difference)
    off = xp.clip(xp.sqrt(square), 0, MOST_MISMATCH_PX)
    off = xp.where(outside(x, y, height, width), MOST_MISMATCH_PX, off)
    return backend.filtered(off[None], blur, blur)[0]


def outside(x: Planes, y: Planes, height: int, width: int) -> Planes:
    """Return where (x, y) px lies outside a picture, (h, w) bool."""
    return (x < 0) | (x > width - 1) | (y < 0) | (y > height - 1)
