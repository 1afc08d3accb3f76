"""Choice of the starting field of a flow by photometric error under a fold limit (ours).

A coarse-to-fine search loses a mouth that opens by more than the coarsest level can bridge. In a clip a neighbouring
frame often shows the same movement half done, and its field is a better start. Between two people landmarks give a
start. A start may also be worse: if the head turns, it carries errors along. Each frame is therefore judged by
itself: a field from another start is used only if it explains the picture clearly better and does not fold more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, Mask, Points
from morphspace.errors import BadInput, MorphspaceError
from morphspace.flow import Flow, FlowFunction, FlowMethod
from morphspace.flow.baselines import LUMA
from morphspace.flow.pairs import is_featureless, unknown_flow
from morphspace.grid import warp

StartKind = Literal["auto", "none"]
"""`auto`: difficult frames are tried again from a neighbour's field; `none`: coarse to fine alone."""

WITHOUT_START = ("paper", "deepflow", "tvl1")  # methods that ignore a start
FOLD_LIMIT = 0.003  # share of the cells inside the mask that may fold (goals, flow.md C)
CLEARLY = 0.98  # ratio to the error of the first field; a smaller gain is noise, and folds could cause it
HARD = 1.25  # ratio to the clip's median error; trying all frames took 3 times the flows for 0.5 % less error
SPLINE_STEP_PX = 4  # px between the points at which a smooth part of a landmark spline is evaluated
SPLINE_NEAR_PX = 8  # px each way from a landmark; the spline bends sharply there: evaluated at every pixel
SPLINE_MARGIN = 8  # evaluated points beyond each edge, over which the end effects of the interpolation decay
ONE_LANDMARK_PX = 1.0  # px a side of a cell whose landmarks are merged: closed lips have two at a place
LEAST_LANDMARK_SPREAD_PX = 1.0  # px, RMS distance from the best line; below it the landmarks lie on it
INVERSION_STEPS = 8  # fixed-point steps of an inverted start; the estimator corrects the rest


def check_start(start: str) -> None:
    """Check that a start is a `StartKind`; raise `BadInput` otherwise."""
    if start not in get_args(StartKind):
        raise BadInput(
            f"the start is {start!r}; expected one of {', '.join(get_args(StartKind))}. Choose one of these"
        )


def photometric_error(reference: Image, frame: Image, field: Displacement, mask: Mask) -> float:
    """Compute the root mean square difference between a warped frame and the reference.

    Parameters
    ----------
    reference, frame : array (h, w, 3)
    field : array (h, w, 2), px
        Where each point of the reference lies in the frame.
    mask : array (h, w)
        Weights on the reference.

    Returns
    -------
    float
        Over the colours, inside the mask; 0 to 1.

    Examples
    --------
    >>> import numpy as np
    >>> black, grey = np.zeros((20, 20, 3), np.float32), np.full((20, 20, 3), 0.5, np.float32)
    >>> still, mask = np.zeros((20, 20, 2), np.float32), np.ones((20, 20), np.float32)
    >>> round(photometric_error(black, grey, still, mask), 3)
    0.5
    """
    difference = warp.sample(frame, field) - reference
    square = (difference * difference).mean(axis=2)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1.0)))


def better(reference: Image, frame: Image, candidates: Sequence[Flow], mask: Mask) -> Flow:
    """Return the flow with the least photometric error under the fold limit; the first candidate is the default.

    Another candidate replaces it only if it folds within `FOLD_LIMIT` inside the mask (or no more than the first, if
    that folds more) and its error is below `CLEARLY` times the first's. If the first exceeds the limit and the other
    does not, an equal error is enough.

    Examples
    --------
    >>> import numpy as np
    >>> shifted = np.full((8, 8, 2), [1.0, 0.0], np.float32)
    >>> frame = np.tile(np.linspace(0, 1, 8, dtype=np.float32)[:, None], (8, 1, 3))
    >>> flows = [Flow(field, np.ones((8, 8), np.float32)) for field in (0 * shifted, shifted)]
    >>> reference = warp.sample(frame, shifted)
    >>> better(reference, frame, flows, np.ones((8, 8), np.float32)) is flows[1]
    True
    """
    first = candidates[0]
    standing = photometric_error(reference, frame, first.displacement, mask)
    folds = warp.fold_fraction(first.displacement, mask)
    chosen, least = first, np.inf
    for other in candidates[1:]:
        other_folds = warp.fold_fraction(other.displacement, mask)
        if other_folds > max(FOLD_LIMIT, folds):
            continue
        error = photometric_error(reference, frame, other.displacement, mask)
        mends = other_folds <= FOLD_LIMIT < folds
        if error <= (1.0 if mends else CLEARLY) * standing and error < least:
            chosen, least = other, error
    return chosen


def _best_start(
    to_frame: FlowFunction,
    reference: Image,
    frame: Image,
    starts: Mapping[str, Displacement | None],
    mask: Mask | None = None,
) -> tuple[str, Flow]:
    """Estimate the flow from every start and return the name of the best start and its flow.

    Parameters
    ----------
    to_frame : FlowFunction
        The flow from the reference.
    reference, frame : array (h, w, 3)
    starts : mapping of name to field (h, w, 2) px or None
        None is the coarse-to-fine search alone. The first start is the default; `better` decides.
    mask : array (h, w), optional
        Weights on the reference; all ones by default.
    """
    flows = {name: to_frame(frame, start) for name, start in starts.items()}
    inside = np.ones(reference.shape[:2], np.float32) if mask is None else mask
    chosen = better(reference, frame, list(flows.values()), inside)
    return next(name for name, flow in flows.items() if flow is chosen), chosen


def landmark_spline(reference_points: Points, frame_points: Points, height: int, width: int) -> Displacement:
    """Compute the thin-plate spline through landmarks: the interpolating field of least bending.

    The field maps each landmark to its counterpart, to a tenth of a px if landmarks are some px apart. Landmarks at
    one place of the reference (`ONE_LANDMARK_PX`) map to the mean of their counterparts. Between landmarks that
    converge or cross, the field may fold. Outside the landmarks it is nearly affine, so displacements grow with the
    distance.

    Parameters
    ----------
    reference_points, frame_points : array (m, 2), px
        Row i of both is the same point.
    height, width : int
        Size of the field, px.

    Returns
    -------
    array (height, width, 2) float32, px

    Raises
    ------
    BadInput
        If the counts differ, a value is not finite, the landmarks have fewer than 3 places or lie on one line.

    References
    ----------
    Bookstein, Principal warps, IEEE PAMI 11, 1989.

    Examples
    --------
    >>> import numpy as np
    >>> points = np.array([[5.0, 5], [25, 5], [5, 25], [25, 25]])
    >>> landmark_spline(points, points + (3, 1), 32, 32)[16, 16].round(3).tolist()
    [3.0, 1.0]
    """
    from scipy.interpolate import RBFInterpolator  # slow to import, and only landmarks need it

    reference_points, frame_points = _checked_landmarks(reference_points, frame_points)
    places, moves = _one_each(reference_points, frame_points - reference_points)
    check_spread(places, "the reference")
    check_spread(frame_points, "the frame")
    spline = RBFInterpolator(places, moves, kernel="thin_plate_spline", degree=1)
    nodes_x, nodes_y = np.meshgrid(
        *(
            SPLINE_STEP_PX * np.arange(-SPLINE_MARGIN, size // SPLINE_STEP_PX + 2 + SPLINE_MARGIN)
            for size in (width, height)
        )
    )
    nodes = np.stack([nodes_x, nodes_y], axis=-1, dtype=np.float64)
    coarse = spline(nodes.reshape(-1, 2)).reshape(nodes.shape).astype(np.float32)
    x, y = np.meshgrid(*(np.arange(size, dtype=np.float32) for size in (width, height)))
    field = warp.sample_at(coarse, x / SPLINE_STEP_PX + SPLINE_MARGIN, y / SPLINE_STEP_PX + SPLINE_MARGIN)
    exact = _near(places, height, width)
    if exact.any():
        field[exact] = spline(np.stack([x[exact], y[exact]], axis=-1, dtype=np.float64))
    return field


def _near(places: Points, height: int, width: int) -> AnyArray:
    """Return which pixels (height, width) lie within `SPLINE_NEAR_PX` of a place; places may lie outside."""
    far = SPLINE_NEAR_PX
    within = ((places > -far) & (places < np.array([width, height]) + far - 1)).all(axis=1)
    columns, rows = np.round(places[within]).astype(int).T
    near = np.zeros((height + 2 * far, width + 2 * far), np.uint8)
    near[rows + far, columns + far] = 1
    near = cv2.dilate(near, np.ones((2 * far + 1, 2 * far + 1), np.uint8))
    return near[far:-far, far:-far] > 0


def _checked_landmarks(reference_points: Points, frame_points: Points) -> tuple[Points, Points]:
    pair = tuple(np.asarray(points, np.float64) for points in (reference_points, frame_points))
    for points, name in zip(pair, ("reference", "frame"), strict=True):
        if points.ndim != 2 or points.shape[1] != 2:
            raise BadInput(
                f"the landmarks of the {name} have the shape {points.shape}; expected (m, 2), x and y of each. Use that"
            )
        if not np.isfinite(points).all():
            raise BadInput(
                f"the landmarks of the {name} are not finite; expected positions in px. Mark them again"
            )
    if len(pair[0]) != len(pair[1]):
        raise BadInput(
            f"the frame has {len(pair[1])} landmarks; expected {len(pair[0])}, as in the reference. "
            "Mark the same points in both"
        )
    return pair[0], pair[1]


def _one_each(places: Points, moves: Points) -> tuple[Points, Points]:
    """Merge landmarks at one place, with the mean of their moves: a spline has one value at a place."""
    cells = np.round(places / ONE_LANDMARK_PX)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    mean = np.zeros((len(count), 4))
    np.add.at(mean, cell.ravel(), np.hstack([places, moves]))
    mean /= count[:, None]
    return mean[:, :2], mean[:, 2:]


def check_spread(points: Points, name: str) -> None:
    """Check that points (m, 2) px have at least 3 places and do not lie on one line; `name` is their picture or file.

    Raises `BadInput`.
    """
    places = len(np.unique(points, axis=0))
    if places < 3:
        raise BadInput(
            f"the landmarks of {name} are at {places} places; expected at least 3. Mark more points"
        )
    spread_px = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
    if spread_px < LEAST_LANDMARK_SPREAD_PX:
        raise BadInput(
            f"the {len(points)} landmarks of {name} lie on one line, to {spread_px:.2g} px; expected a spread of at "
            f"least {LEAST_LANDMARK_SPREAD_PX:.2g} px. Mark a point beside the line"
        )


def hard_frames(errors: AnyArray, folds: AnyArray) -> AnyArray:
    """Return the frames to try again: errors (n,) far above the median, or fold shares (n,) over the limit.

    Examples
    --------
    >>> import numpy as np
    >>> hard_frames(np.array([1.0, 1.0, 2.0, 1.0]), np.array([0.0, 0.01, 0.0, 0.0])).tolist()
    [1, 2]
    """
    return np.flatnonzero((errors > HARD * np.median(errors)) | (folds > FOLD_LIMIT))


def easier_neighbour(errors: AnyArray, index: int) -> int:
    """Return which of the frames before and after frame `index` has the smaller error, of errors (n,) with n >= 2.

    Examples
    --------
    >>> import numpy as np
    >>> easier_neighbour(np.array([0.3, 0.9, 0.1]), 1)
    2
    """
    near = [other for other in (index - 1, index + 1) if 0 <= other < len(errors)]
    return min(near, key=lambda other: float(errors[other]))


@dataclass(frozen=True, eq=False)
class Pair:
    """The two pictures of a request and their starts.

    Attributes
    ----------
    reference, frame : array (h, w, 3)
    start : array (h, w, 2), px, optional
        A field on the reference's grid.
    landmarks : two arrays (m, 2), px, optional
        The same points in both pictures.
    notes : tuple of str
        Remarks for the user.
    """

    reference: Image
    frame: Image
    start: Displacement | None = None
    landmarks: tuple[Points, Points] | None = None
    notes: tuple[str, ...] = ()

    def reversed(self) -> Pair:
        """Return the pair for the backward flow, from frame to reference."""
        start = None if self.start is None else _approximate_inverse(self.start)
        landmarks = None if self.landmarks is None else self.landmarks[::-1]
        return Pair(self.frame, self.reference, start, landmarks)


def as_grey(image: Image) -> Image:
    """Return the luma of an image (h, w, 3) in all three channels.

    Examples
    --------
    >>> import numpy as np
    >>> as_grey(np.full((1, 1, 3), [0.0, 1.0, 0.0])).round(3).tolist()
    [[[0.587, 0.587, 0.587]]]
    """
    return np.repeat((image @ LUMA)[..., None], 3, axis=2)


def flow_between(
    method: FlowMethod, reference: Image, frame: Image, start: Displacement | None = None
) -> Flow:
    """Estimate the flow between two checked pictures (h, w, 3); zero flow if one of them is of one colour.

    Raises
    ------
    BadInput
        If OpenCV's estimators cannot use pictures of this size.
    MorphspaceError
        If a method returns values that are not finite, a fault of morphspace.
    """
    height, width = reference.shape[:2]
    if is_featureless(reference) or is_featureless(frame):
        return unknown_flow(height, width)
    try:
        flow = method(reference)(frame, start)
    except cv2.error as error:
        raise BadInput(
            f"the flow failed on pictures of {width}x{height} px ({error.err}). Choose another preset"
        ) from error
    if not (np.isfinite(flow.displacement).all() and np.isfinite(flow.confidence).all()):
        raise MorphspaceError(
            "the flow holds values that are not finite, a fault of morphspace. Report the pictures and choose "
            "another preset"
        )
    return flow


def flow_from_best(method: FlowMethod, pair: Pair) -> tuple[str, Flow]:
    """Estimate the flow of a pair from its best start; return the start's name (none, start or landmarks) and the flow.

    Raises `BadInput` if the landmark spline moves a point by more than the picture's height plus width.
    """
    starts = {"none" if pair.start is None else "start": pair.start}
    if pair.landmarks is not None:
        height, width = pair.reference.shape[:2]
        spline = landmark_spline(*pair.landmarks, height, width)
        furthest_px = float(np.abs(spline).max())
        if furthest_px > height + width:
            raise BadInput(
                f"the landmarks move a point by {furthest_px:.3g} px; expected at most {height + width} px in a "
                f"picture of {width}x{height} px. Mark the same points in both, in the same order"
            )
        starts["landmarks"] = spline
    to_frame = method(pair.reference)
    return _best_start(
        partial(flow_between, lambda _: to_frame, pair.reference), pair.reference, pair.frame, starts
    )


def _approximate_inverse(displacement: Displacement) -> Displacement:
    """Invert a field (h, w, 2) px approximately, by the fixed point v(q) = -u(q + v(q)); for use as a start.

    It is fast and stays finite where the field folds. `warp.invert` is exact, but a wild field would need too much
    memory.
    """
    back = np.zeros_like(displacement)
    for _ in range(INVERSION_STEPS):
        back = -warp.sample_field(displacement, back)
    return back
