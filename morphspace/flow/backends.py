"""The numerical primitives of the registration flow, and their implementation on OpenCV.

The algorithm in `multiscale` is written once, on these primitives and on arithmetic that numpy and torch share. On
the CPU it uses OpenCV, whose separable filter is many times faster there than torch's convolution. On a GPU it uses
torch (`torch_backend`). Planes are (c, h, w) float32 throughout.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from math import log, sqrt
from types import ModuleType
from typing import Any, Protocol

import cv2
import numpy as np

from morphspace.arrays import AnyArray
from morphspace.flow.filters import BORDER
from morphspace.grid.warp import spline_reader
from morphspace.steps import keep_freed_memory

Planes = Any
"""(c, h, w) float32, a numpy array or a torch tensor."""

MEDIAN_PX = 5  # px a side; the largest that OpenCV allows for float32
EDGE_PX = 1.5  # px of distance that a step of `edge_codes` adds in the recursive smoother
SMALL_PX = 4096  # pixels of a plane; below it a call to OpenCV takes longer than its work
STRIP_PX = 2**14  # pixels; nine derivatives of three colours then take 1.8 MB, which fits in the cache
_CREATING = threading.Lock()


class Backend(Protocol):
    """The primitives of one numerical library.

    Attributes
    ----------
    xp : module
        The library's arithmetic, numpy or torch.
    """

    xp: ModuleType

    def strips(self, height: int, width: int) -> Iterable[slice]:
        """Split the rows of a picture (height, width) into slices that fit the cache, for pixelwise work."""
        ...

    def planes(self, array: AnyArray) -> Planes:
        """Convert a numpy array to the backend's float32."""
        ...

    def zeros(self, *shape: int) -> Planes:
        """Return zero planes of a shape."""
        ...

    def numpy(self, planes: Planes) -> AnyArray:
        """Convert planes to a numpy array."""
        ...

    def filtered(self, planes: Planes, across: AnyArray, down: AnyArray) -> Planes:
        """Correlate each plane with a separable kernel, (n,) and (n,), mirrored about the outermost pixels."""
        ...

    def bank(self, planes: Planes, kernels: Sequence[tuple[AnyArray, AnyArray]]) -> Planes:
        """Filter the planes by each pair of kernels, across and down: (n, c, h, w); see `filtered`."""
        ...

    def sampler(self, planes: Planes) -> Callable[[Planes, Planes], Planes]:
        """Return the function that reads the planes at (x, y) px by cubic B-spline, clamped at the edge."""
        ...

    def looked_up(self, planes: Planes, x: Planes, y: Planes) -> Planes:
        """Read the planes at (x, y) px, each (h, w), linearly, clamped at the edge."""
        ...

    def resized_linearly(self, planes: Planes, height: int, width: int) -> Planes:
        """Resize the planes bilinearly; for fields, which must not overshoot."""
        ...

    def averaged(self, planes: Planes, height: int, width: int) -> Planes:
        """Shrink the planes by averaging over the area that each new pixel covers."""
        ...

    def median(self, planes: Planes) -> Planes:
        """Filter each plane by the median of `MEDIAN_PX` x `MEDIAN_PX` pixels, with the edge repeated."""
        ...

    def smoother(self, guide: Planes, strength: float, edge_codes: float) -> Callable[[Planes], Planes]:
        """Return the edge-aware smoother of planes along a guide (1 or 3 planes, codes 0 to 255).

        It is the fast global smoother (Min et al., IEEE TIP 2014): least squares with weights
        `strength` exp(-|step of the guide| / `edge_codes`) between neighbours, one axis after the other, three times.
        """
        ...

    def recursive_smoother(
        self, guide: Planes, strength: float, edge_codes: float
    ) -> Callable[[Planes], Planes]:
        """Return the recursive smoother of the domain transform along a guide (1 or 3 planes, codes 0 to 255).

        It makes one round, rows and then columns (Gastal and Oliveira, ACM TOG 30(4), 2011). Where the guide is
        uniform it equals the first round of `smoother`: both have the same two-sided exponential response. A step of
        the guide, summed over the colours and divided by the root of their number, adds `EDGE_PX` px of distance for
        each `edge_codes`. It precomputes nothing, which suits small pictures.
        """
        ...

    def middle(self, plane: Planes) -> Planes:
        """Return the median of a plane (h, w); of an even number of values the last is left out."""
        ...

    def picked(self, planes: Planes, places: Sequence[int]) -> Planes:
        """Copy the planes at these indices of (n, ...)."""
        ...

    def dot(self, a: Planes, b: Planes) -> Planes:
        """Sum a * b over the planes, (n, c, h, w) each, to (n, h, w)."""
        ...

    def weighted_dot(self, weights: Planes, a: Planes, b: Planes) -> Planes:
        """Sum weights (n, h, w) times a times b over all planes, (n, c, h, w) each, to (h, w)."""
        ...


class OpenCVBackend:
    """The primitives on numpy arrays and OpenCV, for the CPU."""

    xp: ModuleType = np

    def __init__(self) -> None:
        """Let the process keep freed memory: the flow allocates the same arrays for each frame."""
        keep_freed_memory()

    def strips(self, height: int, width: int) -> Iterable[slice]:
        step = max(1, STRIP_PX // width)
        return (slice(top, top + step) for top in range(0, height, step))

    def planes(self, array: AnyArray) -> AnyArray:
        return np.ascontiguousarray(array, np.float32)

    def zeros(self, *shape: int) -> AnyArray:
        return np.zeros(shape, np.float32)

    def numpy(self, planes: AnyArray) -> AnyArray:
        return planes

    def filtered(self, planes: AnyArray, across: AnyArray, down: AnyArray) -> AnyArray:
        count, height, width = planes.shape
        reach = len(down) // 2
        if count > 1 and height * width <= SMALL_PX and reach < height:
            tall = _mirrored_rows(planes, reach).reshape(-1, width)
            tall = cv2.sepFilter2D(tall, cv2.CV_32F, across, down, borderType=BORDER)
            return tall.reshape(count, -1, width)[:, reach : reach + height]
        out = np.empty_like(planes)
        for plane, target in zip(planes, out, strict=True):
            cv2.sepFilter2D(plane, cv2.CV_32F, across, down, dst=target, borderType=BORDER)
        return out

    def bank(self, planes: AnyArray, kernels: Sequence[tuple[AnyArray, AnyArray]]) -> AnyArray:
        out = np.empty((len(kernels), *planes.shape), np.float32)
        for plane, targets in zip(planes, out.swapaxes(0, 1), strict=True):
            rows: dict[
                int, AnyArray
            ] = {}  # filtered across, by the identity of the kernel: many pairs share one
            for (across, down), target in zip(kernels, targets, strict=True):
                if id(across) not in rows:
                    rows[id(across)] = cv2.filter2D(plane, cv2.CV_32F, across[None], borderType=BORDER)
                cv2.filter2D(rows[id(across)], cv2.CV_32F, down[:, None], dst=target, borderType=BORDER)
        return out

    def sampler(self, planes: AnyArray) -> Callable[[AnyArray, AnyArray], AnyArray]:
        return spline_reader(planes)

    def looked_up(self, planes: AnyArray, x: AnyArray, y: AnyArray) -> AnyArray:
        out = np.empty((len(planes), *x.shape), np.float32)
        for plane, target in zip(planes, out, strict=True):
            cv2.remap(plane, x, y, cv2.INTER_LINEAR, dst=target, borderMode=cv2.BORDER_REPLICATE)
        return out

    def shrunk(self, planes: AnyArray, height: int, width: int) -> AnyArray:
        """Shrink planes bicubically; for pictures, which are blurred before. `Backend` has no such primitive."""
        return _resized(planes, height, width, cv2.INTER_CUBIC)

    def resized_linearly(self, planes: AnyArray, height: int, width: int) -> AnyArray:
        return _resized(planes, height, width, cv2.INTER_LINEAR)

    def averaged(self, planes: AnyArray, height: int, width: int) -> AnyArray:
        return _resized(planes, height, width, cv2.INTER_AREA)

    def median(self, planes: AnyArray) -> AnyArray:
        out = np.empty_like(planes)
        for plane, target in zip(planes, out, strict=True):
            cv2.medianBlur(plane, MEDIAN_PX, dst=target)
        return out

    def smoother(self, guide: AnyArray, strength: float, edge_codes: float) -> Callable[[AnyArray], AnyArray]:
        picture = _guide_picture(guide)
        return _plane_by_plane(lambda: _single_striped_smoother(picture, strength, edge_codes))

    def recursive_smoother(
        self, guide: AnyArray, strength: float, edge_codes: float
    ) -> Callable[[AnyArray], AnyArray]:
        picture = _guide_picture(guide)
        space_px, colour_codes = domain_transform(strength, edge_codes, len(guide))
        create = cv2.ximgproc.createDTFilter
        return _plane_by_plane(lambda: create(picture, space_px, colour_codes, cv2.ximgproc.DTF_RF, 1))

    def middle(self, plane: AnyArray) -> AnyArray:
        values = plane.ravel()
        half = (len(values) - 1) // 2
        return np.partition(values[: 2 * half + 1], half)[half]

    def picked(self, planes: AnyArray, places: Sequence[int]) -> AnyArray:
        out: AnyArray = planes.take(places, axis=0)
        return out

    def dot(self, a: AnyArray, b: AnyArray) -> AnyArray:
        out: AnyArray = a[:, 0] * b[:, 0] if a.shape[1] == 1 else np.einsum("ncij,ncij->nij", a, b)
        return out

    def weighted_dot(self, weights: AnyArray, a: AnyArray, b: AnyArray) -> AnyArray:
        out: AnyArray = np.einsum("nij,ncij,ncij->ij", weights, a, b)  # one pass, without arrays of products
        return out


def _mirrored_rows(planes: AnyArray, reach: int) -> AnyArray:
    """Add `reach` < h rows above and below planes (c, h, w), mirrored about the outermost row."""
    count, height, width = planes.shape
    out = np.empty((count, height + 2 * reach, width), np.float32)
    out[:, reach : reach + height] = planes
    if reach:
        out[:, :reach] = planes[:, reach:0:-1]
        out[:, -reach:] = planes[:, -2 : -2 - reach : -1]
    return out


def _resized(planes: AnyArray, height: int, width: int, interpolation: int) -> AnyArray:
    out = np.empty((len(planes), height, width), np.float32)
    for plane, target in zip(planes, out, strict=True):
        cv2.resize(plane, (width, height), dst=target, interpolation=interpolation)
    return out


def _guide_picture(guide: AnyArray) -> AnyArray:
    """Convert a guide, 1 or 3 planes in codes, to OpenCV's 8-bit picture."""
    codes = np.clip(guide, 0, 255).astype(np.uint8)
    return codes[0] if len(codes) == 1 else np.ascontiguousarray(codes.transpose(1, 2, 0))


def _plane_by_plane(create: Callable[[], Any]) -> Callable[[AnyArray], AnyArray]:
    """Return the function that smooths each plane with one of OpenCV's filters."""
    own = threading.local()  # a filter has buffers of its own: one filter for each thread

    def smooth(planes: AnyArray) -> AnyArray:
        if not hasattr(own, "smoother"):
            own.smoother = create()
        out = np.empty_like(planes)
        for plane, target in zip(planes, out, strict=True):
            target[...] = own.smoother.filter(plane)  # OpenCV does not write its dst
        return out

    return smooth


def domain_transform(strength: float, edge_codes: float, colours: int) -> tuple[float, float]:
    """Return the domain transform's sigmas, of space (px) and of colour (codes), that match a smoother's settings.

    Along a line the global smoother of strength s has the response a^|x| with a / (1 - a)^2 = s; the recursive
    smoother of sigma H has exp(-sqrt(2) |x| / H). OpenCV accepts no H below 1 px, which is a strength below 0.4.

    Parameters
    ----------
    strength : float
        Weight of the smoothness against the data.
    edge_codes : float
        Step of the guide (codes) at which the weight falls to 1/e.
    colours : int
        Number of planes of the guide, 1 or 3.

    References
    ----------
    Gastal and Oliveira, ACM Transactions on Graphics 30(4), 2011 (the filter); the match of settings is ours.
    """
    middle = 1 + 1 / (2 * strength)
    pole = middle - sqrt(middle**2 - 1)
    space_px = max(1.0, sqrt(2) / -log(pole))
    return space_px, space_px * edge_codes * sqrt(colours) / EDGE_PX


def _single_striped_smoother(picture: AnyArray, strength: float, edge_codes: float) -> Any:
    """Create OpenCV's smoother so that it works in one stripe.

    It divides its work by the number of threads that OpenCV has when it is created. The last bits of its result
    depend on where the stripes end, and so on what other threads do.
    """
    with _CREATING:
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            return cv2.ximgproc.createFastGlobalSmootherFilter(picture, strength, edge_codes)
        finally:
            cv2.setNumThreads(threads)
