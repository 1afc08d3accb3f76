"""Two pictures and what their flow may start from, as files give them, and the flow from the best start."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from morphspace.arrays import Displacement, Image, Points
from morphspace.errors import BadInput, MorphspaceError, SizeMismatch
from morphspace.flow import Flow, FlowMethod
from morphspace.flow.baselines import LUMA
from morphspace.flow.pairs import checked_pair, is_featureless, is_grey, unknown_flow
from morphspace.flow.starts import best_start, check_spread, landmark_spline
from morphspace.grid import warp
from morphspace.io.flow_fields import read_flow
from morphspace.io.images import read_image
from morphspace.io.points import read_landmark_pair

INVERSION_STEPS = 8  # of the fixed point that turns a start round; an estimator mends what they leave


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


def read_pair(
    reference_path: Path,
    frame_path: Path,
    start_path: Path | None = None,
    landmark_paths: tuple[Path, Path] | None = None,
) -> Pair:
    """Read the pictures, the start and the landmarks.

    Raises `BadInput` where no flow can be asked for between them, or they do not belong together.
    """
    names = (str(reference_path), str(frame_path))
    reference, frame = checked_pair(read_image(reference_path), read_image(frame_path), names)
    notes = [
        f"{name} is one colour all over: nothing can be found, the flow is zero with zero confidence"
        for name, image in zip(names, (reference, frame), strict=True)
        if is_featureless(image)
    ]
    if not notes and is_grey(reference) != is_grey(frame):
        notes.append("one picture is grey and the other in colour: they are compared in grey")
        reference, frame = as_grey(reference), as_grey(frame)
    start, landmarks = None, None
    height, width = reference.shape[:2]
    if start_path is not None:
        stored = read_flow(start_path)
        if stored.known.shape != (height, width):
            raise SizeMismatch(
                f"{start_path} has {stored.known.shape[1]}x{stored.known.shape[0]} px, {names[0]} has "
                f"{width}x{height}: a start lies on A's grid"
            )
        start = stored.displacement
        furthest_px = float(np.abs(start).max())
        if furthest_px > height + width:
            raise BadInput(
                f"{start_path} moves a point by {furthest_px:.3g} px, {names[0]} has {width}x{height} px: a start "
                "is a field of displacements"
            )
        if not stored.known.all():
            notes.append(f"{start_path} is unknown in places: points start at rest there")
    if landmark_paths is not None:
        landmarks = read_landmark_pair(*landmark_paths)
        for points, path, name in zip(landmarks, landmark_paths, names, strict=True):
            check_spread(points, str(path))
            check_inside(points, path, name, height, width)
    return Pair(reference, frame, start, landmarks, tuple(notes))


def check_inside(points: Points, path: Path, picture: str, height: int, width: int) -> None:
    """Raise `BadInput` where most landmarks (m, 2) lie outside their picture; those of a cropped ear may."""
    outside = ((points < -0.5) | (points > np.array([width, height]) - 0.5)).any(axis=1)
    if 2 * outside.sum() > len(points):
        raise BadInput(
            f"{path}: {outside.sum()} of {len(points)} landmarks lie outside {picture}, which has {width}x{height} px: "
            "give those that were marked on this picture, at this size"
        )


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
