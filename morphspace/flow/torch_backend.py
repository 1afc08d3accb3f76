"""The primitives of the registration flow on torch, for a GPU; on the CPU for tests.

Each primitive equals OpenCV's up to float32 rounding (tests/flow/test_flow_backends.py has the tolerances). They use
shifted slices, gathers and elementwise arithmetic only. A convolution or matrix product would round to TF32 unless a
flag of the whole process forbade it. A long reduction or scatter has no fixed order on a GPU; without them the same
input gives the same bytes. No tensor requires a gradient, so torch records none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import ceil, floor, sqrt
from types import ModuleType

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput
from morphspace.flow.backends import MEDIAN_PX, Planes, domain_transform
from morphspace.grid.warp import SPLINE_POLE, SPLINE_TAPS

try:
    import torch
except ModuleNotFoundError as error:
    raise BadInput(
        "the backend is torch, which is not installed. Run pip install morphspace[torch]"
    ) from error

AREA_SLIVER_PX = 1e-3  # px; OpenCV ignores a pixel that an area covers by less
SMOOTHER_ROUNDS = 3  # OpenCV's default
SMOOTHER_ATTENUATION = 0.25  # OpenCV's default: strength of a round relative to that before
LEAST_COUPLING = 1e-7  # relative; below it a pixel has no effect on the other in float32

DOWN, ACROSS = -2, -1
"""The axes of planes (c, h, w)."""


class TorchBackend:
    """The primitives on torch tensors of one device; `Backend` describes each."""

    xp: ModuleType = torch

    def __init__(self, device: str) -> None:
        """Select a device by torch's name: "cpu", "cuda" or "cuda:1". Raises `BadInput` if it does not exist."""
        self.device = _checked_device(device)
        self._tables: dict[tuple[str, int, int], tuple[Planes, Planes]] = {}

    def strips(self, height: int, width: int) -> Iterable[slice]:
        return (slice(0, height),)  # the whole picture: launching more kernels would take longer

    def planes(self, array: AnyArray) -> Planes:
        return torch.tensor(np.ascontiguousarray(array), dtype=torch.float32, device=self.device)

    def zeros(self, *shape: int) -> Planes:
        return torch.zeros(shape, dtype=torch.float32, device=self.device)

    def numpy(self, planes: Planes) -> AnyArray:
        out: AnyArray = planes.cpu().numpy()
        return out

    def filtered(self, planes: Planes, across: AnyArray, down: AnyArray) -> Planes:
        return self._correlated(self._correlated(planes, across, ACROSS), down, DOWN)

    def bank(self, planes: Planes, kernels: Sequence[tuple[AnyArray, AnyArray]]) -> Planes:
        return torch.stack([self.filtered(planes, across, down) for across, down in kernels])

    def sampler(self, planes: Planes) -> Callable[[Planes, Planes], Planes]:
        taps = np.arange(-SPLINE_TAPS, SPLINE_TAPS + 1)
        inverse = SPLINE_POLE ** np.abs(taps)
        inverse /= inverse.sum()  # as in `warp.spline_coefficients`
        coefficients = self.filtered(planes, inverse, inverse)
        height, width = planes.shape[1:]

        def read(x: Planes, y: Planes) -> Planes:
            columns, weights_across = _spline_taps(x, width)
            rows, weights_down = _spline_taps(y, height)
            across = torch.stack(weights_across)
            place = torch.stack(columns)
            flat = coefficients.reshape(len(coefficients), -1)
            out = torch.zeros_like(flat[:, :1]).reshape(-1, 1, 1)
            for row, weight in zip(rows, weights_down, strict=True):
                out = out + (flat[:, row * width + place] * across).sum(1) * weight
            return out

        return read

    def looked_up(self, planes: Planes, x: Planes, y: Planes) -> Planes:
        height, width = planes.shape[1:]
        (left, right), from_right = _linear_taps(x, width)
        (top, bottom), from_bottom = _linear_taps(y, height)
        flat = planes.reshape(len(planes), -1)
        upper = torch.lerp(flat[:, top * width + left], flat[:, top * width + right], from_right)
        lower = torch.lerp(flat[:, bottom * width + left], flat[:, bottom * width + right], from_right)
        return torch.lerp(upper, lower, from_bottom)

    def resized_linearly(self, planes: Planes, height: int, width: int) -> Planes:
        return self._rescaled(planes, height, width, "linear")

    def averaged(self, planes: Planes, height: int, width: int) -> Planes:
        return self._rescaled(planes, height, width, "area")

    def median(self, planes: Planes) -> Planes:
        """Use `_middle_of_sorted`: each sorted column of five serves the five windows that contain it."""
        height, width = planes.shape[1:]
        reach = MEDIAN_PX // 2
        tall = planes.index_select(DOWN, self._table("repeat", height, reach)[0])
        column = _sorted_five([tall.narrow(DOWN, k, height) for k in range(MEDIAN_PX)])
        wide = torch.stack(column).index_select(ACROSS, self._table("repeat", width, reach)[0])
        return _middle_of_sorted(_sorted_five([wide.narrow(ACROSS, k, width) for k in range(MEDIAN_PX)]))

    def smoother(self, guide: Planes, strength: float, edge_codes: float) -> Callable[[Planes], Planes]:
        """Prepare `_line_solver` for each axis and round; about 60 planes of the guide's size at a strength of 10."""
        codes = guide.clip(0, 255).floor()  # OpenCV takes 8-bit guides
        solvers: list[Callable[[Planes], Planes]] = []
        affinity = {axis: torch.exp(-_steps(codes, axis) / edge_codes) for axis in (ACROSS, DOWN)}
        for round_ in range(SMOOTHER_ROUNDS):
            share = strength * SMOOTHER_ATTENUATION**round_
            solvers += [_line_solver(share * affinity[axis], axis) for axis in (ACROSS, DOWN)]

        def smooth(planes: Planes) -> Planes:
            for solve in solvers:
                planes = solve(planes)
            return planes

        return smooth

    def recursive_smoother(
        self, guide: Planes, strength: float, edge_codes: float
    ) -> Callable[[Planes], Planes]:
        """Prepare `_recursion` for each axis, forward and backward."""
        codes = guide.clip(0, 255).floor()
        space_px, colour_codes = domain_transform(strength, edge_codes, len(codes))
        passes: list[Callable[[Planes], Planes]] = []
        for axis in (ACROSS, DOWN):
            size = codes.shape[axis] - 1
            step = (codes.narrow(axis, 1, size) - codes.narrow(axis, 0, size)).abs().sum(0)
            kept = torch.exp(-sqrt(2) * (1 / space_px + step / colour_codes))
            passes += [_recursion(kept, axis, 1), _recursion(kept, axis, -1)]

        def smooth(planes: Planes) -> Planes:
            for one in passes:
                planes = one(planes)
            return planes

        return smooth

    def middle(self, plane: Planes) -> Planes:
        values = plane.reshape(-1)
        return torch.median(values[: 2 * ((len(values) - 1) // 2) + 1])

    def picked(self, planes: Planes, places: Sequence[int]) -> Planes:
        return torch.stack([planes[place] for place in places])

    def dot(self, a: Planes, b: Planes) -> Planes:
        return (a * b).sum(1)

    def weighted_dot(self, weights: Planes, a: Planes, b: Planes) -> Planes:
        return (weights[:, None] * a * b).sum((0, 1))

    def _correlated(self, planes: Planes, kernel: AnyArray, axis: int) -> Planes:
        size = planes.shape[axis]
        mirrored = planes.index_select(axis, self._table("mirror", size, len(kernel) // 2)[0])
        out = torch.zeros_like(planes)
        for k, tap in enumerate(kernel):
            if tap != 0:
                out.add_(mirrored.narrow(axis, k, size), alpha=float(tap))
        return out

    def _rescaled(self, planes: Planes, height: int, width: int, rule: str) -> Planes:
        if planes.shape[1:] == (height, width):
            return planes.clone()  # a caller may change the result in place
        if width != planes.shape[2]:
            source, weight = self._table(rule, planes.shape[2], width)
            planes = (planes[:, :, source] * weight).sum(2)
        if height != planes.shape[1]:
            source, weight = self._table(rule, planes.shape[1], height)
            planes = (planes[:, source] * weight[:, :, None]).sum(1)
        return planes

    def _table(self, rule: str, size: int, other: int) -> tuple[Planes, Planes]:
        """Return the result of `RULES[rule]` on the device; cached, because each transfer makes a GPU wait."""
        key = rule, size, other
        if key not in self._tables:
            source, weight = RULES[rule](size, other)
            self._tables[key] = (
                torch.tensor(source, dtype=torch.int64, device=self.device),
                torch.tensor(weight, dtype=torch.float32, device=self.device),
            )
        return self._tables[key]


def best_device() -> str:
    """Return "cuda" if torch can use a GPU, else "cpu"."""
    return "cuda" if torch.cuda.is_available() else "cpu"


def _checked_device(name: str) -> Planes:
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise BadInput(f"the torch device is {name!r}; expected cpu or cuda. Choose one of these") from error
    if device.type not in ("cpu", "cuda"):
        raise BadInput(f"the torch device is {name!r}; expected cpu or cuda. Choose one of these")
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise BadInput(
            f"the device {name!r} does not exist; torch has {torch.cuda.device_count()} GPUs. Choose torch:cpu"
        )
    return device


def _mirror_table(size: int, reach: int) -> tuple[AnyArray, AnyArray]:
    """Return the source index of each pixel of a line extended by `reach` both ways by mirroring."""
    period = max(1, 2 * (size - 1))
    place = np.abs(np.arange(-reach, size + reach)) % period
    return np.minimum(place, period - place) if size > 1 else 0 * place, np.ones(1)


def _repeat_table(size: int, reach: int) -> tuple[AnyArray, AnyArray]:
    """Return the source index of each pixel of a line extended by `reach` both ways by repeating the ends."""
    return np.clip(np.arange(-reach, size + reach), 0, size - 1), np.ones(1)


def _linear_table(old: int, new: int) -> tuple[AnyArray, AnyArray]:
    """Return the two source pixels, (2, new), of each pixel of a resized line, and their weights."""
    position = (np.arange(new) + 0.5) * (old / new) - 0.5
    whole = np.floor(position)
    f = position - whole
    source = np.clip(whole.astype(np.int64) + np.arange(2)[:, None], 0, old - 1)
    return source, np.stack([1 - f, f])


def _area_table(old: int, new: int) -> tuple[AnyArray, AnyArray]:
    """Return the source pixels, (k, new), that each pixel of a shrunk line covers, and the share of each."""
    ratio = old / new
    most = ceil(ratio) + 1
    source = np.zeros((most, new), np.int64)
    weight = np.zeros((most, new))
    for pixel in range(new):
        start, end = pixel * ratio, min((pixel + 1) * ratio, old)
        for k in range(most):
            cell = floor(start) + k
            covered = min(end, cell + 1) - max(start, cell)
            if covered > AREA_SLIVER_PX:
                source[k, pixel], weight[k, pixel] = cell, covered / (end - start)
    return source, weight


RULES = {
    "mirror": _mirror_table,
    "repeat": _repeat_table,
    "linear": _linear_table,
    "area": _area_table,
}


def _spline_taps(position: Planes, size: int) -> tuple[list[Planes], list[Planes]]:
    """Return the four pixels of a line under the cubic B-spline at `position` px, clamped, and their weights."""
    position = position.clip(0, size - 1)
    whole = position.floor()
    f = position - whole
    g = 1 - f
    first, last = g * g * g / 6, f * f * f / 6
    second = 2 / 3 - f * f + 3 * last
    weights = [first, second, 1 - first - second - last, last]
    start = whole.long() - 1
    mirrored = [(size - 1) - ((size - 1) - (start + k).abs()).abs() for k in range(4)]
    return [place.clip(0, size - 1) for place in mirrored], weights


def _linear_taps(position: Planes, size: int) -> tuple[tuple[Planes, Planes], Planes]:
    """Return the two pixels of a line around `position` px, clamped, and the weight of the second."""
    position = position.clip(0, size - 1)
    whole = position.floor()
    start = whole.long().clip(0, size - 1)
    return (start, (start + 1).clip(max=size - 1)), position - whole


def _sorted_five(values: Sequence[Planes]) -> list[Planes]:
    """Sort five tensors elementwise in ascending order, by the shortest sorting network (nine exchanges)."""
    out = list(values)
    for i, j in ((0, 3), (1, 4), (0, 2), (1, 3), (0, 1), (2, 4), (1, 2), (3, 4), (2, 3)):
        out[i], out[j] = torch.minimum(out[i], out[j]), torch.maximum(out[i], out[j])
    return out


def _middle_of_sorted(grid: Sequence[Planes]) -> Planes:
    """Return the median of 25 values grid[j][i] that rise along both i and j.

    Three cross diagonals hold thirteen values; six of the other values lie below them and six above. Once sorted, the
    diagonals bound each other: the k-th of four is at most the k-th of the next five, and so on. Three candidates
    remain: the largest of the first diagonal, the median of the middle one and the least of the last (ours).
    """
    before = [grid[3 - i][i] for i in range(4)]
    middle = [grid[4 - i][i] for i in range(5)]
    after = [grid[5 - i][i] for i in range(1, 5)]
    largest = torch.maximum(torch.maximum(before[0], before[1]), torch.maximum(before[2], before[3]))
    least = torch.minimum(torch.minimum(after[0], after[1]), torch.minimum(after[2], after[3]))
    a, b, c, d, e = middle
    low = torch.maximum(torch.minimum(a, b), torch.minimum(c, d))
    high = torch.minimum(torch.maximum(a, b), torch.maximum(c, d))
    return _median_of_three(largest, _median_of_three(low, high, e), least)


def _median_of_three(a: Planes, b: Planes, c: Planes) -> Planes:
    return torch.maximum(torch.minimum(a, b), torch.minimum(torch.maximum(a, b), c))


def _steps(codes: Planes, axis: int) -> Planes:
    """Return the distance between the colours of neighbours along an axis, (h, w) less one along it."""
    size = codes.shape[axis] - 1
    step = codes.narrow(axis, 1, size) - codes.narrow(axis, 0, size)
    return (step * step).sum(0).sqrt()


def _line_solver(coupling: Planes, axis: int) -> Callable[[Planes], Planes]:
    """Return the function that smooths every line along an axis: u_i + sum_j coupling_ij (u_i - u_j) = f_i.

    `coupling` >= 0 between neighbours is (h, w), less one along the axis. The tridiagonal systems are solved by
    parallel cyclic reduction (Hockney and Jesshope, Parallel Computers, 1981). Each equation absorbs those `reach`
    before and after it and then couples to equations twice as far away, until no coupling is left. Everything that
    depends on the coupling alone is computed here. The row sums replace the diagonal, so nothing is subtracted: the
    result is a mean with positive weights, to float32 rounding at any strength.
    """
    size = coupling.shape[axis] + 1
    alone = torch.zeros_like(coupling.sum(axis, keepdim=True))  # the ends of a line have one neighbour only
    before, after = torch.cat([alone, coupling], axis), torch.cat([coupling, alone], axis)
    weight = torch.ones_like(before)
    shares: list[tuple[Planes, Planes]] = []
    while (reach := 2 ** len(shares)) < size:
        diagonal = weight + before + after
        if float(((before + after) / diagonal).max()) < LEAST_COUPLING:
            break
        rest = size - reach
        share = (
            before.narrow(axis, reach, rest) / diagonal.narrow(axis, 0, rest),
            after.narrow(axis, 0, rest) / diagonal.narrow(axis, reach, rest),
        )
        shares.append(share)
        weight = _absorbed(weight, share, axis)
        ends = torch.zeros_like(weight.narrow(axis, 0, reach))
        before = torch.cat([ends, share[0] * before.narrow(axis, 0, rest)], axis)
        after = torch.cat([share[1] * after.narrow(axis, reach, rest), ends], axis)

    def solve(planes: Planes) -> Planes:
        for share in shares:
            planes = _absorbed(planes, share, axis)
        return planes / weight

    return solve


def _recursion(kept: Planes, axis: int, direction: int) -> Callable[[Planes], Planes]:
    """Return the recursive filter of every line: out_i = (1 - kept_i) u_i + kept_i out_(i - 1), or from its end.

    `kept` in [0, 1] between neighbours is (h, w), less one along the axis. After each round of doubling (Hillis and
    Steele, CACM 29, 1986) a value includes those up to twice as far back, until the weight at that distance is
    negligible.
    """
    first = torch.zeros_like(kept.sum(axis, keepdim=True))  # the first pixel of a line has no predecessor
    share = torch.cat([first, kept] if direction > 0 else [kept, first], axis)
    own = 1 - share
    size = share.shape[axis]
    shares: list[Planes] = []
    while (reach := 2 ** len(shares)) < size and float(share.max()) >= LEAST_COUPLING:
        shares.append(share)
        begin = reach if direction > 0 else 0
        doubled = torch.zeros_like(share)
        doubled.narrow(axis, begin, size - reach).copy_(
            share.narrow(axis, begin, size - reach) * share.narrow(axis, reach - begin, size - reach)
        )
        share = doubled

    def run(planes: Planes) -> Planes:
        planes = planes * own
        for number, part in enumerate(shares):
            reach = 2**number
            begin = reach if direction > 0 else 0
            rest = size - reach
            out = planes.clone()
            out.narrow(axis, begin, rest).addcmul_(
                part.narrow(axis, begin, rest), planes.narrow(axis, reach - begin, rest)
            )
            planes = out
        return planes

    return run


def _absorbed(lines: Planes, share: tuple[Planes, Planes], axis: int) -> Planes:
    """Add to each value its shares of the values before and after it; the distance is what the shares are shorter."""
    rest = share[0].shape[axis]
    reach = lines.shape[axis] - rest
    out = lines.clone()
    out.narrow(axis, reach, rest).addcmul_(share[0], lines.narrow(axis, 0, rest))
    out.narrow(axis, 0, rest).addcmul_(share[1], lines.narrow(axis, reach, rest))
    return out
