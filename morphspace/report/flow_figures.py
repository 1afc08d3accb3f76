"""A flow between two picture files: read the pictures, find the flow from the best start, and describe it (ours)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Displacement, Points
from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow import Flow, FlowMethod
from morphspace.flow.baselines import LUMA
from morphspace.flow.names import NAMES
from morphspace.flow.pairs import checked_pair, is_featureless, is_grey
from morphspace.flow.starts import WITHOUT_START, Pair, as_grey, check_spread, flow_from_best
from morphspace.grid import warp
from morphspace.io.flow_fields import read_flow
from morphspace.io.images import read_image
from morphspace.io.points import check_inside, read_landmark_pair
from morphspace.linear.quality import endpoint_error, forward_backward_px, photometric_rmse, stays_inside
from morphspace.steps import Step, Steps

MARK_INSIDE = "Mark them on this picture, at this size, or leave them out of both files"


def read_pair(
    reference_path: Path,
    frame_path: Path,
    start_path: Path | None = None,
    landmark_paths: tuple[Path, Path] | None = None,
) -> Pair:
    """Read the pictures, the start and the landmarks.

    Raises `BadInput` if no flow can be found between the pictures, or if start or landmarks do not fit them.
    """
    names = (str(reference_path), str(frame_path))
    reference, frame = checked_pair(read_image(reference_path), read_image(frame_path), names)
    notes = [
        f"{name} is one colour all over: no motion can be found, the flow is zero with zero confidence"
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
                f"{width}x{height}: a start is defined on A's grid"
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
            check_inside(path, points, (width, height), name, MARK_INSIDE)
    return Pair(reference, frame, start, landmarks, tuple(notes))


@dataclass(frozen=True, eq=False)
class FoundFlows:
    """The flow from A to B, the flow `back` if requested, the start of each (`started_from`), and figures."""

    flow: Flow
    back: Flow | None
    started_from: list[str]
    figures: dict[str, Any]


def found_flows(method: FlowMethod, pair: Pair, *, both: bool = False) -> Steps[FoundFlows]:
    """Find the flow of a pair from the best start; with `both`, also the flow back."""
    wanted = [pair, pair.reversed()] if both else [pair]
    flows: list[Flow] = []
    taken: list[str] = []
    for one in wanted:
        yield Step("flow", len(flows), len(wanted))
        start, flow = flow_from_best(method, one)
        taken.append(start)
        flows.append(flow)
    yield Step("flow", len(flows), len(wanted))
    there, back = flows[0], flows[1] if both else None
    figures = figures_of(pair, there, back)
    if pair.landmarks is not None:
        figures["started_from"] = taken
        figures["landmarks_missed_mean_px"] = landmarks_missed_px(there.displacement, *pair.landmarks)
    return FoundFlows(there, back, taken, figures)


def figures_of(pair: Pair, flow: Flow, back: Flow | None) -> dict[str, Any]:
    """Compute the figures of a flow, units in their names; differences are grey levels (0 to 255) over all pixels.

    With the flow `back`, the error of both flows in sequence is added, over points that stay inside the second
    picture.
    """
    field = flow.displacement
    height, width = field.shape[:2]
    everywhere = np.ones((height, width), np.float32)
    length_px = endpoint_error(field, np.zeros_like(field))
    grey_reference, grey_frame = pair.reference @ LUMA, pair.frame @ LUMA
    figures: dict[str, Any] = {
        "size": [width, height],
        "displacement_mean_px": float(length_px.mean()),
        "displacement_largest_px": float(length_px.max()),
        "folds_percent": 100 * warp.fold_fraction(field, everywhere),
        "confidence_mean": float(flow.confidence.mean(dtype=np.float64)),
        "rmse_before": photometric_rmse(grey_frame, grey_reference, everywhere),
        "rmse_after": photometric_rmse(warp.sample(grey_frame, field), grey_reference, everywhere),
    }
    if back is not None:
        inside = stays_inside(field, height, width)
        error_px = forward_backward_px(field, back.displacement)[inside]
        figures["forward_backward_mean_px"] = float(error_px.mean()) if error_px.size else None
        figures["forward_backward_p95_px"] = float(np.quantile(error_px, 0.95)) if error_px.size else None
    return figures


def landmarks_missed_px(field: Displacement, reference_points: Points, frame_points: Points) -> float:
    """Compute the mean distance, px, of landmarks (m, 2) moved by the field from those of the second picture.

    Between two persons this is more informative than colours, which may differ everywhere.
    """
    off_px = warp.move_points(field, reference_points) - frame_points
    return float(np.hypot(off_px[:, 0], off_px[:, 1]).mean())


def figure_words(figures: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Format figures for reading: names, and values with their units."""
    width, height = figures["size"]
    rows = [
        ("size", f"{width}x{height} px"),
        ("mean displacement", f"{figures['displacement_mean_px']:.2f} px"),
        ("largest displacement", f"{figures['displacement_largest_px']:.2f} px"),
        ("folds", f"{figures['folds_percent']:.2f} %"),
        ("mean confidence", f"{figures['confidence_mean']:.2f}"),
        ("B against A, RMSE", f"{figures['rmse_before']:.2f} of 255"),
        ("warped B against A", f"{figures['rmse_after']:.2f} of 255"),
    ]
    if "forward_backward_mean_px" in figures:
        mean_px, p95_px = figures["forward_backward_mean_px"], figures["forward_backward_p95_px"]
        distances = (
            ("none stays", "none stays") if mean_px is None else (f"{mean_px:.2f} px", f"{p95_px:.2f} px")
        )
        rows += [("there and back, mean", distances[0]), ("95 % are within", distances[1])]
    if "started_from" in figures:
        rows.append(("start", ", back from ".join(figures["started_from"])))
        rows.append(("landmarks missed by", f"{figures['landmarks_missed_mean_px']:.2f} px"))
    return tuple(rows)


def recorded_settings(request: Any, started_from: list[str]) -> dict[str, Any]:
    """Return the settings of a request of `flow` for its record, and the start that each direction used."""
    settings = {"preset": request.presets[0], "backend": request.backend, "both": request.both}
    if request.landmarks is None:
        return settings
    return {**settings, "landmarks": [path.name for path in request.landmarks], "started_from": started_from}


def check_start(preset: str, request: Any) -> None:
    """Check that a preset can start from the landmarks or the field of a request. Raises `BadInput` otherwise."""
    given = "landmarks" if request.landmarks is not None else "a field" if request.start is not None else None
    if given is not None and preset in WITHOUT_START:
        able = [name for name in NAMES if name not in WITHOUT_START]
        raise BadInput(f"{preset} cannot start from {given}. Choose one of {', '.join(able)}")


def input_files(request: Any) -> dict[str, Path]:
    """Return the files that a request of `flow` reads, by their names in the record."""
    inputs = dict(zip("AB", request.pictures, strict=True))
    if request.start is not None:
        inputs["start"] = request.start
    if request.landmarks is not None:
        inputs["landmarks of A"], inputs["landmarks of B"] = request.landmarks
    return inputs
