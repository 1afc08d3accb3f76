"""Frames of a face and how they are brought to the reference: framing, registration, faceframe, mask.

Rigid head movement must not end up in the warp fields (Nagle section 2), so each frame is first moved by a similarity
that was fitted on the rigid part of the face. The movement is kept with the frame, so that a rendered face can be put
back where it came from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from morphspace import warp
from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points
from morphspace.errors import BadInput
from morphspace.flow.baselines import LUMA, grey_codes

RegistrationKind = Literal["none", "similarity", "affine"]
REGISTRATION_KINDS: tuple[RegistrationKind, ...] = ("none", "similarity", "affine")

# Where a face stands in a frame cropped to it, as shares of the frame's width and height: centre x, y, half axes x, y.
FACE_ELLIPSE = (0.50, 0.52, 0.37, 0.42)
RIGID_ELLIPSE = (0.50, 0.48, 0.27, 0.19)  # brow to nose
# The same two, measured from a faceframe: in eye-to-eye distances (x) and eye-to-philtrum distances (y).
FACE_FROM_FACEFRAME = (0.0, 0.55, 1.25, 2.0)
RIGID_FROM_FACEFRAME = (0.0, 0.15, 1.0, 0.75)
MOUTH_ELLIPSE = (0.50, 0.77, 0.19, 0.11)  # below the nostrils, which are dark too
MOUTH_FROM_FACEFRAME = (0.0, 1.4, 0.6, 0.5)
SOFT_EDGE = 0.15  # of the radius, over which a mask falls from 1 to 0
REGISTRATION_PASSES = (
    2  # the second measures the flow again on the aligned frame, where it is small and exact
)
ROBUST_PASSES = 10  # of reweighting; forty moved the eyes by 0.01 to 0.18 px on three clips
ANCHORS = 2500  # points at most, evenly spread; all of them moved the eyes by 0.01 to 0.07 px on three clips
SCALE_FLOOR_PX = 0.2  # residuals below this are flow noise, not expression
ONE_PLACE = 0.005  # of the width; movements nearer to each other than this lead to the same place
HOPELESS = (
    1.2  # times the standing error; a start that knows better than a flow that is lost is not behind it
)
CLEARLY_ALIKE = 0.95  # times the standing error; two ways to the same place differ by less
CORNER_WINDOW_PX = 7
CORNER_PERCENTILE = 80  # texture above this percentile of the rigid part counts in full


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """Nagle's faceframe: three points (x, y) px that place a face (sections 3 and 4, step 4).

    `right_eye` is the subject's right, on the image's left.
    """

    right_eye: tuple[float, float]
    left_eye: tuple[float, float]
    philtrum: tuple[float, float]

    @property
    def points(self) -> Points:
        """The three points in order, (3, 2) float64 px."""
        return np.array([self.right_eye, self.left_eye, self.philtrum], np.float64)

    def moved(self, points: Points) -> FaceFrame:
        """Give a faceframe with these three points (3, 2)."""
        right, left, lip = (tuple(map(float, point)) for point in points)
        return FaceFrame(right, left, lip)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Framing:
    """How a source image becomes a model frame: crop, then scale to cover the size and crop to the middle.

    `source_size` (w, h) px of the images; `crop` (x, y, w, h) px or None for the whole; `size` (w, h) px of the
    model's frames. Raises `BadInput` for a crop that leaves the image.
    """

    source_size: tuple[int, int]
    crop: tuple[int, int, int, int] | None
    size: tuple[int, int]

    def __post_init__(self) -> None:
        x, y, w, h = self.box
        width, height = self.source_size
        if x < 0 or y < 0 or w < 1 or h < 1 or x + w > width or y + h > height:
            raise BadInput(
                f"crop {x},{y},{w},{h} leaves the image of {width}x{height}: give x,y,w,h inside it"
            )
        if max(self.size) > MAX_SIDE_PX:
            raise BadInput(
                f"frames of {self.size[0]}x{self.size[1]} are too large: give at most {MAX_SIDE_PX} px a side"
            )
        if min(self.size) < MIN_SIDE_PX:
            raise BadInput(
                f"frames of {self.size[0]}x{self.size[1]} are too small for a face: at least "
                f"{MIN_SIDE_PX}x{MIN_SIDE_PX}, better 200x240"
            )

    @property
    def box(self) -> tuple[int, int, int, int]:
        """The crop (x, y, w, h) px, the whole image where none was asked for."""
        return self.crop or (0, 0, *self.source_size)

    @property
    def scaled_size(self) -> tuple[int, int]:
        """The size (w, h) px of the crop once it is scaled to cover `size`."""
        _, _, w, h = self.box
        scale = max(self.size[0] / w, self.size[1] / h)
        return max(self.size[0], round(w * scale)), max(self.size[1], round(h * scale))

    @property
    def cut_off(self) -> tuple[int, int]:
        """How many scaled pixels the middle crop takes away in x and in y."""
        return self.scaled_size[0] - self.size[0], self.scaled_size[1] - self.size[1]

    def apply(self, image: Image) -> Image:
        """Give the model frame (h, w, 3) of a source image: averaged over areas where it shrinks."""
        x, y, w, h = self.box
        image = image[y : y + h, x : x + w]
        if self.scaled_size != (w, h):
            shrinks = self.scaled_size[0] < w
            method = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
            image = cv2.resize(image, self.scaled_size, interpolation=method)
        left, top = self.cut_off[0] // 2, self.cut_off[1] // 2
        return np.ascontiguousarray(image[top : top + self.size[1], left : left + self.size[0]])

    @property
    def to_source(self) -> Affine:
        """The affine (2, 3) that maps a point of the model frame to the source image."""
        x, y, w, h = self.box
        scale = np.array([w / self.scaled_size[0], h / self.scaled_size[1]])
        corner = np.array([self.cut_off[0] // 2, self.cut_off[1] // 2]) + 0.5
        return np.column_stack([np.diag(scale), scale * corner - 0.5 + (x, y)])


MAX_SIDE_PX = 4096  # a frame of that size has 80 million numbers
MIN_SIDE_PX = 32  # below it the coarsest flow level has nothing to hold on to


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a face on the reference's grid: image (h, w, 3) | name | registration.

    `registration` (2, 3) maps a point of the aligned image to the model frame as it was before alignment.
    """

    image: Image
    name: str
    registration: Affine


def aligned(image: Image, name: str, registration: Affine) -> Frame:
    """Bring a model frame to the reference: aligned(p) = image(registration p)."""
    if np.array_equal(registration, identity_affine()):
        return Frame(image, name, registration)
    height, width = image.shape[:2]
    return Frame(
        warp.sample(image, warp.affine_displacement(registration, height, width)), name, registration
    )


def identity_affine() -> Affine:
    """Give the affine (2, 3) that moves nothing."""
    return np.eye(2, 3)


def register(
    reference: Image, image: Image, kind: RegistrationKind, region: Mask, start: Affine | None = None
) -> Affine:
    """Fit the head movement between the reference and an image, (2, 3): reference(p) ~ image(A p) on the rigid part.

    Dense flow gives the matches; `region` (h, w) says where the rigid part of the face lies; texture says where the
    flow can be believed; reweighted least squares (Geman and McClure's weights) leave out what moves by itself. Flow
    loses a head that moved or turned far. A `start` (2, 3) that knows better, such as landmarks give, is tried as well
    where it lies elsewhere, and what it leads to is kept where the rigid part then looks clearly more alike.
    """
    if kind == "none":
        return identity_affine()
    points, weights = _anchor_points(reference, region)
    if weights.sum() <= 0:
        return identity_affine()

    columns, rows = points[:, 0].astype(np.intp), points[:, 1].astype(np.intp)
    grey, luma = grey_codes(reference), image @ LUMA
    read_luma = warp.spline_reader([luma])
    width = reference.shape[1]

    def passed(total: Affine) -> Affine:
        """Correct a movement once, by the flow that is left after it."""
        moved = luma
        if not np.array_equal(total, identity_affine()):
            moved = read_luma(*_moved_grid(total, (0, 0), grey.shape))[0]
        field = dis_of_codes(grey, codes_of_luma(moved))
        step = _robust_affine(points, points + field[rows, columns], weights, kind)
        return warp.chain_affine(total, step)

    found = identity_affine()
    for _ in range(REGISTRATION_PASSES):
        found = passed(found)
    if start is None or _apart_px(found, start, points) < ONE_PLACE * width:
        return found
    error = _rigid_error_of(reference, image, region)
    other, standing = start, error(found)
    if error(other) > HOPELESS * standing:
        return found
    for _ in range(REGISTRATION_PASSES):
        other = passed(other)
        if _apart_px(found, other, points) < ONE_PLACE * width:
            return found
    return other if error(other) < CLEARLY_ALIKE * standing else found


def _apart_px(one: Affine, other: Affine, points: Points) -> float:
    """Give how far two movements take the points (n, 2) px apart at most."""
    return float(np.hypot(*(warp.apply_affine(one, points) - warp.apply_affine(other, points)).T).max())


def _moved_grid(
    movement: Affine, corner: tuple[int, int], shape: tuple[int, ...]
) -> tuple[AnyArray, AnyArray]:
    """Give where a movement takes the pixels of a box at `corner` (x, y): x and y, (h, w) px each."""
    x = np.arange(corner[0], corner[0] + shape[1], dtype=np.float64)
    y = np.arange(corner[1], corner[1] + shape[0], dtype=np.float64)[:, None]
    if not np.isfinite(movement).all():
        raise BadInput("the movement of a head came out as not finite: look at the image it was measured in")
    at_x, at_y = (movement[i, 0] * x + movement[i, 1] * y + movement[i, 2] for i in (0, 1))
    return at_x.astype(np.float32), at_y.astype(np.float32)


def _rigid_error_of(reference: Image, image: Image, region: Mask) -> Callable[[Affine], float]:
    """Give the function that tells how far the moved image misses the reference on its rigid part.

    Root mean square colour, 0 to 1. Only the box that holds the part is read.
    """
    rows, columns = (np.flatnonzero(region.any(axis=axis)) for axis in (1, 0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    wanted, weight = reference[box], region[box]
    read = warp.spline_reader([image[..., channel] for channel in range(3)])

    def error(movement: Affine) -> float:
        seen = read(*_moved_grid(movement, (int(columns[0]), int(rows[0])), weight.shape))
        difference = np.moveaxis(seen, 0, -1) - wanted
        square = (difference * difference).mean(axis=2)
        return float(np.sqrt((square * weight).sum() / weight.sum()))

    return error


def codes_of_luma(luma: AnyArray) -> AnyArray:
    """Give luma (h, w) in [0, 1] as uint8, as `grey_codes` does of a picture."""
    return np.clip(luma * 255 + 0.5, 0, 255).astype(np.uint8)


def dis_of_codes(reference: AnyArray, frame: AnyArray) -> Displacement:
    """Estimate the flow between grey pictures (h, w) uint8 by dense inverse search, preset "medium"; rough, and fast.

    The same as `flow.baselines.dis_medium` finds, which starts from colours.
    """
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    field: Displacement = estimator.calc(reference, frame, None)
    return field


def _anchor_points(reference: Image, region: Mask) -> tuple[Points, AnyArray]:
    corners = cv2.cornerMinEigenVal(grey_codes(reference), CORNER_WINDOW_PX)
    full = np.percentile(corners[region > 0.5], CORNER_PERCENTILE) if (region > 0.5).any() else 0.0
    weight = region * np.minimum(corners / full, 1) if full > 0 else np.zeros_like(region)
    y, x = np.nonzero(weight > 1e-3)
    every = max(1, len(x) // ANCHORS)
    y, x = y[::every], x[::every]
    return np.column_stack([x, y]).astype(np.float64), weight[y, x].astype(np.float64)


def _robust_affine(source: Points, target: Points, prior: AnyArray, kind: RegistrationKind) -> Affine:
    fit = _similarity if kind == "similarity" else _affine
    source, target = np.ascontiguousarray(source.T), np.ascontiguousarray(target.T)  # (2, m): half the time
    weight = prior
    found = identity_affine()
    for _ in range(ROBUST_PASSES):
        found = fit(source, target, weight)
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
    """Fit scale, turn and shift, (2, 3), between points (m, 2) and (m, 2), robustly: those far off count little."""
    return _robust_affine(source, target, np.ones(len(source)), "similarity")


def _similarity(source: AnyArray, target: AnyArray, weight: AnyArray) -> Affine:
    """Fit scale, turn and shift of points (2, m) by weighted least squares (Umeyama 1991, without reflection)."""
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


def face_mask(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Give a soft ellipse over the face, (h, w) in [0, 1]: by the faceframe, else where a cropped face stands."""
    return _soft_ellipse(height, width, FACE_ELLIPSE, FACE_FROM_FACEFRAME, faceframe)


def rigid_region(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Give a soft ellipse over the part of the face that moves with the skull, brow to nose, (h, w) in [0, 1]."""
    return _soft_ellipse(height, width, RIGID_ELLIPSE, RIGID_FROM_FACEFRAME, faceframe)


def mouth_region(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Give a soft ellipse over where the mouth is to be expected, (h, w) in [0, 1]."""
    return _soft_ellipse(height, width, MOUTH_ELLIPSE, MOUTH_FROM_FACEFRAME, faceframe)


def _soft_ellipse(
    height: int,
    width: int,
    of_frame: tuple[float, float, float, float],
    of_faceframe: tuple[float, float, float, float],
    faceframe: FaceFrame | None,
) -> Mask:
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if faceframe is None:
        centre_x, centre_y, half_x, half_y = np.array(of_frame) * (width, height, width, height)
        across, down = x - centre_x, y - centre_y
    else:
        right, left, lip = faceframe.points
        eyes = (right + left) / 2
        axis_x, axis_y = left - right, lip - eyes
        unit_x, unit_y = axis_x / np.hypot(*axis_x), axis_y / np.hypot(*axis_y)
        half_x, half_y = of_faceframe[2] * np.hypot(*axis_x), of_faceframe[3] * np.hypot(*axis_y)
        centre = eyes + of_faceframe[0] * axis_x + of_faceframe[1] * axis_y
        across = (x - centre[0]) * unit_x[0] + (y - centre[1]) * unit_x[1]
        down = (x - centre[0]) * unit_y[0] + (y - centre[1]) * unit_y[1]
    radius = np.sqrt((across / half_x) ** 2 + (down / half_y) ** 2)
    return np.clip((1 - radius) / SOFT_EDGE + 0.5, 0, 1).astype(np.float32)
