"""Which starting field served a flow best: the choice among candidates by photometric error under a fold limit (ours).

A coarse-to-fine search loses a mouth that opens by more than the coarsest level bridges. In a clip the frame before or
after often shows the same movement half done, and its field is a better start. Between two people no field is half
done, but landmarks say what belongs to what. Neither is always better (a head that turns carries the errors along), so
each frame is judged by itself: the field from another start is kept only where it explains the picture clearly better
and does not buy that by folding.
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
"""`auto`: hard frames are tried again from a neighbour's field; `none`: coarse to fine alone."""

WITHOUT_START = ("paper", "deepflow", "tvl1")  # these have no use for a start: nothing to try again
FOLD_LIMIT = (
    0.003  # of the cells inside the mask; what a flow between real expressions may fold (goals, flow.md C)
)
CLEARLY = 0.98  # times the error of the standing field; a smaller gain is noise, and folding could buy it
HARD = 1.25  # times the clip's median error; trying all frames took 3 times the flows for 0.5 % less error
SPLINE_STEP_PX = 4  # between the points at which a landmark spline is evaluated where it is smooth
SPLINE_NEAR_PX = 8  # each way from a landmark it bends too sharply for that, and is evaluated at every pixel
SPLINE_MARGIN = 8  # such points beyond each edge: there the interpolation's end effects die away
ONE_LANDMARK_PX = 1.0  # landmarks in one cell of this size are one: closed lips are marked twice at a place
LEAST_LANDMARK_SPREAD_PX = 1.0  # root mean square across their best line; below it they lie on the line
INVERSION_STEPS = 8  # of the fixed point that turns a start round; an estimator mends what they leave


def check_start(start: str) -> None:
    """Raise `BadInput` for a start that is not a `StartKind`."""
    if start not in get_args(StartKind):
        raise BadInput(f"there is no start called {start!r}: choose one of {', '.join(get_args(StartKind))}")


def photometric_error(reference: Image, frame: Image, field: Displacement, mask: Mask) -> float:
    """Give how far the frame (h, w, 3), brought to the reference by the field (h, w, 2), misses it.

    The root mean square over the colours, 0 to 1, inside the mask (h, w) on the reference.
    """
    difference = warp.sample(frame, field) - reference
    square = (difference * difference).mean(axis=2)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1.0)))


def better(reference: Image, frame: Image, candidates: Sequence[Flow], mask: Mask) -> Flow:
    """Give the candidate with the least photometric error under the fold limit; the first is the one that stands.

    Another takes its place only where it folds within `FOLD_LIMIT` inside the mask, or no more than the first where
    that folds more, and its error is below `CLEARLY` times the first's. Where the first folds beyond the limit and the
    other keeps it, an error no larger is enough.
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


def best_start(
    to_frame: FlowFunction,
    reference: Image,
    frame: Image,
    starts: Mapping[str, Displacement | None],
    mask: Mask | None = None,
) -> tuple[str, Flow]:
    """Find the frame (h, w, 3) from every start (None: coarse to fine alone); give the best and the name of its start.

    The first of `starts` stands, and `better` says when another takes its place; without a mask all of the reference
    counts.
    """
    flows = {name: to_frame(frame, start) for name, start in starts.items()}
    inside = np.ones(reference.shape[:2], np.float32) if mask is None else mask
    chosen = better(reference, frame, list(flows.values()), inside)
    return next(name for name, flow in flows.items() if flow is chosen), chosen


def landmark_spline(reference_points: Points, frame_points: Points, height: int, width: int) -> Displacement:
    """Give the thin-plate spline through landmarks, a field (height, width, 2) px: the one that bends least.

    Row i of both (m, 2) marks the same point, in the reference and in the frame. The field takes each landmark to its
    fellow, to a tenth of a px where landmarks stand some px apart; landmarks at one place of the reference
    (`ONE_LANDMARK_PX`) go to the mean of theirs. Between landmarks that come together or change sides it may fold.
    Outside them it goes on nearly as an affine map, so far away from all landmarks displacements grow with the
    distance. Raises `BadInput` for counts that differ, values that are not finite, fewer than 3 places, and landmarks
    on one line.

    Bookstein, IEEE PAMI 11 (1989).
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
    """Tell which pixels (h, w) lie within `SPLINE_NEAR_PX` of a place, which may be outside."""
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
                f"the landmarks of the {name} have the shape {points.shape}: give (m, 2), x and y of each"
            )
        if not np.isfinite(points).all():
            raise BadInput(f"the landmarks of the {name} hold values that are not finite: mark them again")
    if len(pair[0]) != len(pair[1]):
        raise BadInput(
            f"the reference has {len(pair[0])} landmarks, the frame {len(pair[1])}: mark the same points in both"
        )
    return pair[0], pair[1]


def _one_each(places: Points, moves: Points) -> tuple[Points, Points]:
    """Give every place once, with the mean of its moves: a spline cannot do two things at one place."""
    cells = np.round(places / ONE_LANDMARK_PX)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    mean = np.zeros((len(count), 4))
    np.add.at(mean, cell.ravel(), np.hstack([places, moves]))
    mean /= count[:, None]
    return mean[:, :2], mean[:, 2:]


def check_spread(points: Points, name: str) -> None:
    """Raise `BadInput`, calling their picture or file `name`, where points (m, 2) px are too few or on one line."""
    places = len(np.unique(points, axis=0))
    if places < 3:
        raise BadInput(f"the landmarks of {name} are at {places} places: a spline needs at least 3")
    spread_px = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points))
    if spread_px < LEAST_LANDMARK_SPREAD_PX:
        raise BadInput(
            f"the {len(points)} landmarks of {name} lie on one line, to {spread_px:.2g} px: mark a point beside it"
        )


def hard_frames(errors: AnyArray, folds: AnyArray) -> AnyArray:
    """Give the indices of the frames worth another try: errors (n,) far above the median, or folds beyond the limit."""
    return np.flatnonzero((errors > HARD * np.median(errors)) | (folds > FOLD_LIMIT))


def easier_neighbour(errors: AnyArray, index: int) -> int:
    """Give the neighbour in time of frame `index`, of errors (n,) with n >= 2, that has the smaller error."""
    near = [other for other in (index - 1, index + 1) if 0 <= other < len(errors)]
    return min(near, key=lambda other: float(errors[other]))


@dataclass(frozen=True, eq=False)
class Pair:
    """The two pictures of a request, (h, w, 3) each, what there is to start from, and notes on them.

    `start` is a field on A's grid, `landmarks` are the same points in both, (m, 2) px each; None where not given.
    """

    reference: Image
    frame: Image
    start: Displacement | None = None
    landmarks: tuple[Points, Points] | None = None
    notes: tuple[str, ...] = ()

    def turned(self) -> Pair:
        """Give the pair for the way back, from B to A."""
        start = None if self.start is None else turned_round(self.start)
        landmarks = None if self.landmarks is None else self.landmarks[::-1]
        return Pair(self.frame, self.reference, start, landmarks)


def as_grey(image: Image) -> Image:
    """Give the luma of an image (h, w, 3) in all three channels."""
    return np.repeat((image @ LUMA)[..., None], 3, axis=2)


def flow_between(
    method: FlowMethod, reference: Image, frame: Image, start: Displacement | None = None
) -> Flow:
    """Give the flow between two checked pictures; zero with zero confidence where one of them shows nothing.

    Raises `BadInput` where OpenCV's estimators cannot work on pictures of this size, and `MorphspaceError` where a
    method gives values that are not finite, which is a fault of ours.
    """
    height, width = reference.shape[:2]
    if is_featureless(reference) or is_featureless(frame):
        return unknown_flow(height, width)
    try:
        flow = method(reference)(frame, start)
    except cv2.error as error:
        raise BadInput(
            f"this preset cannot work on pictures of {width}x{height} px ({error.err}): choose another"
        ) from error
    if not (np.isfinite(flow.displacement).all() and np.isfinite(flow.confidence).all()):
        raise MorphspaceError(
            "the flow holds values that are not finite: try another preset, and report the pictures"
        )
    return flow


def flow_from_best(method: FlowMethod, pair: Pair) -> tuple[str, Flow]:
    """Give the flow of a pair from the best start there is, and which that was: none, start or landmarks."""
    starts = {"none" if pair.start is None else "start": pair.start}
    if pair.landmarks is not None:
        height, width = pair.reference.shape[:2]
        spline = landmark_spline(*pair.landmarks, height, width)
        furthest_px = float(np.abs(spline).max())
        if furthest_px > height + width:
            raise BadInput(
                f"the landmarks move a point of a picture of {width}x{height} px by {furthest_px:.3g} px: mark the "
                "same points in both, in one order"
            )
        starts["landmarks"] = spline
    to_frame = method(pair.reference)
    return best_start(
        partial(flow_between, lambda _: to_frame, pair.reference), pair.reference, pair.frame, starts
    )


def turned_round(displacement: Displacement) -> Displacement:
    """Give about the inverse of a field (h, w, 2) by the fixed point v(q) = -u(q + v(q)): a start, not a result.

    Cheap, and finite where the field folds; `warp.invert` is exact, but a wild field would cost it all memory.
    """
    back = np.zeros_like(displacement)
    for _ in range(INVERSION_STEPS):
        back = -warp.sample_field(displacement, back)
    return back
