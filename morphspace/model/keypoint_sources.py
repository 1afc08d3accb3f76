"""Where keypoints come from: a detector, points that a person gave, or a file of marked points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.arrays import Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LANDMARKS, LEFT_LIDS, RIGHT_LIDS, UPPER_LIP_BOTTOM
from morphspace.io.points import Lip, YAxis, read_marked_points
from morphspace.model.keypoints import (
    TURN_UPRIGHT,
    WIDE_SPREAD,
    checked_faceframe,
    detect_faceframe,
    framing_of,
    lip_of,
    picture_to_mean,
    point_names,
)
from morphspace.model.landmarks import LEAST_FACES, LandmarkRegression, told_errors
from morphspace.model.model import MorphModel
from morphspace.steps import Steps
from morphspace.storage import digest_of_file

FAR = 0.5  # eye distances from the landmarks; points that mark the same face lie within a quarter
Marked = Literal["mean", "reference"]
"""Where points were marked: on the mean face, or on the reference frame's own picture."""


@dataclass(frozen=True, eq=False)
class FoundKeypoints:
    """A checked faceframe, the record of where it came from, and what a person should know of it."""

    faceframe: FaceFrame
    origin: Mapping[str, Any]
    lines: tuple[str, ...]
    notes: tuple[str, ...]
    landmarks: LandmarkRegression | None = None


def detected_keypoints(model: MorphModel, detector: Detector) -> Steps[FoundKeypoints]:
    """Find the keypoints in the faces of a model. Return `FoundKeypoints`."""
    found = yield from detect_faceframe(model, detector)
    eyes_px = float(np.hypot(*np.diff(found.faceframe.points[:2], axis=0)[0]))
    worst = float(found.spread_px.max()) / eyes_px
    said = f"found in {found.found} of {found.faces} faces; they lie {_listed(found.spread_px)} px from it (median)"
    notes: tuple[str, ...] = (
        (
            f"the detections lie {worst:.0%} of the eye distance apart: look at the picture, and mark the points with "
            "--set if they are wrong",
        )
        if worst > WIDE_SPREAD
        else ()
    )
    learned = found.landmarks
    if learned is None:
        if found.found <= LEAST_FACES:
            notes += (
                f"a face was found in {found.found} faces of the model, too few to learn where its landmarks lie: "
                "`mimic --method guided` will not work with it; build it from more frames",
            )
        return FoundKeypoints(found.faceframe, found.origin, (said,), notes)
    taught = f"landmarks learned from {learned.faces} faces; {told_errors(learned)}"
    return FoundKeypoints(found.faceframe, found.origin, (said, taught), notes, learned)


def given_keypoints(
    model: MorphModel, points: Points, lip: Lip | None = None, on: Marked = "mean"
) -> FoundKeypoints:
    """Check points (3, 2) px that a person gave, and carry them to the mean face. Raises `BadInput`."""
    faceframe, notes = _on_mean(model, np.array(points, np.float64), on, "--set", None)
    origin = {"source": "set", "lip": lip or "philtrum", "on": on}
    return FoundKeypoints(faceframe, origin, (), notes)


def read_keypoints(
    model: MorphModel, path: Path, lip: Lip | None = None, y_axis: YAxis = "auto", on: Marked = "mean"
) -> FoundKeypoints:
    """Read marked points from a file and carry them to the mean face. Raises `BadInput`."""
    height = framing_of(model).source_size[1] if on == "reference" else model.size[1]
    marked = read_marked_points(path, height, lip=lip, y_axis=y_axis)
    turned = _turned_words(path, height, lip, y_axis, marked.points)
    faceframe, notes = _on_mean(model, marked.points, on, str(path), turned)
    origin = {
        "source": "file",
        "file": path.name,
        "sha256": digest_of_file(path),
        "scheme": marked.scheme,
        "lip": marked.lip,
        "on": on,
    }
    return FoundKeypoints(faceframe, origin, (f"read as {marked.scheme}",), marked.notes + notes)


def _turned_words(path: Path, height: int, lip: Lip | None, y_axis: YAxis, points: Points) -> str | None:
    """Say how to count y in the file the other way, where its face would then stand upright in the picture."""
    is_turned = y_axis == "up"
    other: YAxis = "auto" if is_turned else "up"
    x = read_marked_points(path, height, lip=lip, y_axis=other).points
    if np.array_equal(x, points):
        return None
    if (x[:, 1] < -0.5).any() or (x[:, 1] > height - 0.5).any() or x[2, 1] <= x[:2, 1].max():
        return None
    return "leave out --negate-y" if is_turned else "give --negate-y"


def _on_mean(
    model: MorphModel, points: Points, on: Marked, name: str, turned: str | None
) -> tuple[FaceFrame, tuple[str, ...]]:
    """Check marked points (3, 2) px and carry them to the mean face; `name` is where they came from, for errors, and
    `turned` is what would turn their y round, None where that would not help.
    """
    pictured = "points in the pixels of the picture the model was built from"
    if on == "reference":
        width, height = framing_of(model).source_size
        for x, y in points.tolist():
            if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
                raise BadInput(
                    f"{name}: {x:.1f},{y:.1f} lies outside the reference frame's picture of {width}x{height} px: "
                    f"{turned or f'give {pictured}'}"
                )
        points = picture_to_mean(model, points)
        outside = f"give {pictured}, inside what was cropped from it"
    else:
        outside = "give points in its pixels, or --on reference for points marked on the reference frame's own picture"
    return checked_faceframe(
        points, model.size, name, if_outside=turned or outside, if_upside_down=turned or TURN_UPRIGHT
    )


def far_notes(model: MorphModel) -> tuple[str, ...]:
    """Say where a keypoint lies far from where the model's landmarks have it: the two then contradict each other."""
    if model.landmarks is None or model.faceframe is None:
        return ()
    lip = (
        0 if lip_of(model) == "philtrum" else UPPER_LIP_BOTTOM
    )  # of the mesh; 0 is the bow, just below the philtrum
    places = [[LANDMARKS.index(place) for place in group] for group in (RIGHT_LIDS, LEFT_LIDS, (lip,))]
    learned = np.array([model.landmarks.mean[rows].mean(axis=0) for rows in places])
    eyes_px = float(np.hypot(*(learned[1] - learned[0])))
    apart = np.hypot(*(model.faceframe.points - learned).T) / eyes_px
    if apart.max() <= FAR:
        return ()
    far = int(apart.argmax())
    x, y = learned[far].tolist()
    return (
        f"the {point_names(model)[far]} lies {apart[far]:.1f} eye distances from {x:.1f},{y:.1f}, where the model's "
        "landmarks have it, and `mimic --method guided`, which goes by both, would go wrong: look at the picture, and "
        "set the points again or find both anew with --auto",
    )


def _listed(values: Any) -> str:
    return ", ".join(f"{value:.1f}" for value in values)
