"""Register head movement: a similarity fitted on the part of the face that moves with the skull.

Nagle et al. (section 2) remove rigid movement first; the method is ours. Dense flow gives the matches, local texture
their weight, and reweighted least squares reject parts that move by themselves. Flow fails on large movements and
takes most of the time. Detected points locate the skull to about a pixel. From there two flows of the skull's
surroundings suffice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.faceframe import RegistrationKind, identity_affine
from morphspace.flow.baselines import LUMA, grey_codes
from morphspace.grid import warp

PASSES = 2  # the second measures the flow on the aligned frame, where it is small and exact
# Shares of the width around the rigid part, in which flow from a start is measured. On five clips the whole picture
# gave movements within 0.1 px of these, and no smaller errors on the rigid part.
SURROUNDINGS = (0.12, 0.04)
CONFIRMED = 0.05  # share of the width; a start that flow corrects by more is rejected
NOT_WORSE = 1.02  # times the error without movement; a start that ends above it is rejected
CLEARLY_ALIKE = 0.95  # times the error without a start; two fits of one movement differ by less
ROBUST_PASSES = 10  # reweightings; forty moved the eyes by 0.01 to 0.18 px on three clips
STILL_PX = 0.003  # px; a reweighting that moves every point by less is the last
ANCHORS = 2500  # points at most, evenly spread; all points moved the eyes by 0.01 to 0.07 px on three clips
SCALE_FLOOR_PX = 0.2  # px; smaller residuals are flow noise, not expression
CORNER_WINDOW_PX = 7  # px, side of the window in which texture is judged
CORNER_PERCENTILE = 80  # percentile of texture in the rigid part, from which the weight is 1

Box = tuple[slice, slice]
"""Rows and columns of a picture."""


def register(
    reference: Image, image: Image, kind: RegistrationKind, region: Mask, start: Affine | None = None
) -> Affine:
    """Fit the head movement A between reference and image: reference(p) ~ image(A p) on the rigid part.

    Parameters
    ----------
    reference, image : array (h, w, 3)
    kind : {"none", "similarity", "affine"}
    region : array (h, w)
        Weight of the rigid part.
    start : array (2, 3), optional
        An estimate, for example from landmarks. It saves time if flow confirms it, and finds heads that flow loses. A
        wrong start costs time only.

    Returns
    -------
    array (2, 3)

    Raises
    ------
    BadInput
        If the movement is not finite.

    References
    ----------
    Umeyama, IEEE PAMI 13, 1991 (the similarity of least squares). Nagle et al., section 2, ask for the removal of
    rigid movement; the method is ours.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.random.default_rng(1).random((60, 60, 3)).astype(np.float32)
    >>> found = register(picture, picture, "similarity", np.ones((60, 60), np.float32))
    >>> np.allclose(found, np.eye(2, 3), atol=0.01)
    True
    """
    return Registration(reference, kind, region).of(image, start)


@dataclass(frozen=True, eq=False)
class Registration:
    """Registers images to one reference (h, w, 3), with its share of the computation done once; see `register`."""

    reference: Image
    kind: RegistrationKind
    region: Mask

    def of(self, image: Image, start: Affine | None = None) -> Affine:
        """Fit the head movement (2, 3) of an image (h, w, 3) of the reference's size."""
        _, weights = self._anchors
        if self.kind == "none" or weights.sum() <= 0:
            return identity_affine()
        luma = Luma(image)
        if start is None:
            return self._plainly(luma)
        found, width = start, self.region.shape[1]
        for share in SURROUNDINGS:
            found = self._corrected(found, luma, self._around(round(share * width)))
        error = self._error(found, luma)
        is_confirmed = _apart_px(found, start, self._anchors[0]) <= CONFIRMED * width
        if is_confirmed and error <= NOT_WORSE * self._error(identity_affine(), luma):
            return found
        plain = self._plainly(luma)
        return found if error < CLEARLY_ALIKE * self._error(plain, luma) else plain

    def _plainly(self, luma: Luma) -> Affine:
        """Fit the movement without a start."""
        found = identity_affine()
        for _ in range(PASSES):
            found = self._corrected(found, luma, self._around(max(self.region.shape)))
        return found

    def _corrected(self, total: Affine, luma: Luma, box: Box) -> Affine:
        """Correct a movement once, by the remaining flow in a box of the picture."""
        points, weights = self._anchors
        corner = box[1].start, box[0].start
        grey = np.ascontiguousarray(self._grey[box])
        field = _dis_of_codes(grey, _codes_of_luma(luma.moved(total, corner, grey.shape)))
        columns, rows = (points - corner).astype(np.intp).T
        step = _robust_affine(points, points + field[rows, columns], weights, self.kind)
        return warp.chain_affine(total, step)

    def _error(self, movement: Affine, luma: Luma) -> float:
        """Compute the rms luma difference, 0 to 1, of the moved image and the reference on the rigid part."""
        box = self._around(0)
        weight = self.region[box]
        difference = luma.moved(movement, (box[1].start, box[0].start), weight.shape) - self._luma[box]
        return float(np.sqrt((difference * difference * weight).sum() / weight.sum()))

    def _around(self, margin: int) -> Box:
        """Return the box of the rigid part, with a margin in px, within the picture."""
        return tuple(
            slice(max(inside[0] - margin, 0), min(inside[-1] + 1 + margin, size))
            for inside, size in zip(self._inside, self.region.shape, strict=True)
        )  # type: ignore[return-value]

    @cached_property
    def _inside(self) -> tuple[AnyArray, AnyArray]:
        return np.flatnonzero(self.region.any(axis=1)), np.flatnonzero(self.region.any(axis=0))

    @cached_property
    def _luma(self) -> AnyArray:
        return self.reference @ LUMA

    @cached_property
    def _grey(self) -> AnyArray:
        return grey_codes(self.reference)

    @cached_property
    def _anchors(self) -> tuple[Points, AnyArray]:
        """Points (m, 2) px of the rigid part, and the weight of their texture, (m,) in [0, 1]."""
        corners = cv2.cornerMinEigenVal(self._grey, CORNER_WINDOW_PX)
        inside = self.region > 0.5
        full = np.percentile(corners[inside], CORNER_PERCENTILE) if inside.any() else 0.0
        weight = self.region * np.minimum(corners / full, 1) if full > 0 else np.zeros_like(self.region)
        y, x = np.nonzero(weight > 1e-3)
        every = max(1, len(x) // ANCHORS)
        y, x = y[::every], x[::every]
        return np.column_stack([x, y]).astype(np.float64), weight[y, x].astype(np.float64)


class Luma:
    """The luma of an image (h, w, 3), sampled after any movement."""

    def __init__(self, image: Image) -> None:
        self.still: AnyArray = image @ LUMA
        self.read = warp.spline_reader([self.still])

    def moved(self, movement: Affine, corner: tuple[int, int], shape: tuple[int, ...]) -> AnyArray:
        """Sample the pixels of a box (h, w) at `corner` (x, y) px after a movement (2, 3)."""
        if np.array_equal(movement, identity_affine()):
            return self.still[corner[1] : corner[1] + shape[0], corner[0] : corner[0] + shape[1]]
        return self.read(*_moved_grid(movement, corner, shape))[0]


def _apart_px(one: Affine, other: Affine, points: Points) -> float:
    """Compute the largest distance between two movements over the points (n, 2) px."""
    return float(np.hypot(*(warp.apply_affine(one, points) - warp.apply_affine(other, points)).T).max())


def _moved_grid(
    movement: Affine, corner: tuple[int, int], shape: tuple[int, ...]
) -> tuple[AnyArray, AnyArray]:
    """Compute the position of each pixel of a box at `corner` (x, y) after a movement: x and y, (h, w) px."""
    x = np.arange(corner[0], corner[0] + shape[1], dtype=np.float64)
    y = np.arange(corner[1], corner[1] + shape[0], dtype=np.float64)[:, None]
    if not np.isfinite(movement).all():
        raise BadInput("the head movement is not finite. Check the image in which it was measured")
    at_x, at_y = (movement[i, 0] * x + movement[i, 1] * y + movement[i, 2] for i in (0, 1))
    return at_x.astype(np.float32), at_y.astype(np.float32)


def _codes_of_luma(luma: AnyArray) -> AnyArray:
    """Convert luma (h, w) in [0, 1] to uint8, as `grey_codes` converts a picture."""
    return np.clip(luma * 255 + 0.5, 0, 255).astype(np.uint8)


def _dis_of_codes(reference: AnyArray, frame: AnyArray) -> Displacement:
    """Estimate flow between grey pictures (h, w) uint8 by dense inverse search, preset "medium": approximate, and fast.

    It equals `flow.baselines.dis_medium`, which starts from colours.
    """
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    field: Displacement = estimator.calc(reference, frame, None)
    return field


def _robust_affine(source: Points, target: Points, prior: AnyArray, kind: RegistrationKind) -> Affine:
    fit = _similarity if kind == "similarity" else _affine
    source, target = np.ascontiguousarray(source.T), np.ascontiguousarray(target.T)  # (2, m): half the time
    weight = prior
    furthest = np.append(np.abs(source).max(axis=1), 1.0)
    found = identity_affine()
    for _ in range(ROBUST_PASSES):
        before, found = found, fit(source, target, weight)
        if (np.abs(found - before) @ furthest < STILL_PX).all():
            break
        apart = target - found[:, :2] @ source
        apart -= found[:, 2:]
        apart *= apart
        square = apart[0] + apart[1]
        scale = max(SCALE_FLOOR_PX, 1.4826 * float(np.median(np.sqrt(square))))
        square /= scale**2
        square += 1
        square *= square
        weight = prior / square
    return found


def fitted_similarity(source: Points, target: Points) -> Affine:
    """Fit scale, rotation and shift, (2, 3), between points (m, 2) and (m, 2), robustly: outliers have little weight.

    Examples
    --------
    >>> import numpy as np
    >>> square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    >>> (fitted_similarity(square, 2 * square + (1, 3)) @ (4, 4, 1)).round(6).tolist()
    [9.0, 11.0]
    """
    return _robust_affine(source, target, np.ones(len(source)), "similarity")


def _similarity(source: AnyArray, target: AnyArray, weight: AnyArray) -> Affine:
    """Fit scale, rotation and shift of points (2, m) by weighted least squares (Umeyama 1991, without reflection)."""
    total = weight.sum()
    from_mean, to_mean = source @ weight / total, target @ weight / total
    both = np.concatenate([source - from_mean[:, None], target - to_mean[:, None]])
    products = (both[:2] * weight) @ both.T  # (2, 4): this runs some forty times a frame
    spread = products[0, 0] + products[1, 1]
    cosine = (products[0, 2] + products[1, 3]) / spread
    sine = (products[0, 3] - products[1, 2]) / spread
    linear = np.array([[cosine, -sine], [sine, cosine]])
    return np.column_stack([linear, to_mean - linear @ from_mean])


def _affine(source: AnyArray, target: AnyArray, weight: AnyArray) -> Affine:
    root = np.sqrt(weight)[:, None]
    design = np.column_stack([source.T, np.ones(len(weight))])
    solution, *_ = np.linalg.lstsq(design * root, target.T * root, rcond=None)
    return np.asarray(solution.T)
