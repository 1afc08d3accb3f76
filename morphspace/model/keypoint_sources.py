"""Sources of keypoints: a detector, points given by a person, or a file of marked points."""

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
from morphspace.model.landmarks import LEAST_FACES, LandmarkRegression, error_summary
from morphspace.model.model import MorphModel
from morphspace.steps import Steps
from morphspace.storage import digest_of_file

FAR = 0.5  # eye distances; keypoints and landmarks of one face agree to a quarter
Marked = Literal["mean", "reference"]
"""The picture on which points were marked: the mean face, or the reference frame's own picture."""


@dataclass(frozen=True, eq=False)
class FoundKeypoints:
    """Keypoints from one source.

    Attributes
    ----------
    faceframe : FaceFrame
        Checked, on the mean face.
    origin : mapping
        The record of the source for the provenance.
    lines : tuple of str
        Results for the user.
    notes : tuple of str
        Warnings for the user.
    landmarks : LandmarkRegression or None
    """

    faceframe: FaceFrame
    origin: Mapping[str, Any]
    lines: tuple[str, ...]
    notes: tuple[str, ...]
    landmarks: LandmarkRegression | None = None


def detected_keypoints(model: MorphModel, detector: Detector) -> Steps[FoundKeypoints]:
    """Find the keypoints with a detector in faces of the model; a generator of steps that returns `FoundKeypoints`."""
    found = yield from detect_faceframe(model, detector)
    eyes_px = float(np.hypot(*np.diff(found.faceframe.points[:2], axis=0)[0]))
    worst = float(found.spread_px.max()) / eyes_px
    line = f"found in {found.found} of {found.faces} faces; they lie {_listed(found.spread_px)} px from it (median)"
    notes: tuple[str, ...] = (
        (
            f"the detections lie {worst:.0%} of the eye distance apart; expected at most {WIDE_SPREAD:.0%}. Check the "
            "picture, and mark wrong points with --set",
        )
        if worst > WIDE_SPREAD
        else ()
    )
    learned = found.landmarks
    if learned is None:
        if found.found <= LEAST_FACES:
            notes += (
                f"a face was found in {found.found} faces of the model; its landmark regression needs more than "
                f"{LEAST_FACES}, and `mimic --method guided` needs the regression. Build it from more frames",
            )
        return FoundKeypoints(found.faceframe, found.origin, (line,), notes)
    learned_line = f"landmarks learned from {learned.faces} faces; {error_summary(learned)}"
    return FoundKeypoints(found.faceframe, found.origin, (line, learned_line), notes, learned)


def given_keypoints(
    model: MorphModel, points: Points, lip: Lip | None = None, on: Marked = "mean"
) -> FoundKeypoints:
    """Check points (3, 2) px that a person gave, and carry them to the mean face.

    Parameters
    ----------
    model : MorphModel
    points : array (3, 2) px
        Right eye, left eye, lip point.
    lip : {"philtrum", "upper-lip"}, optional
        The meaning of the third point; None for the philtrum.
    on : {"mean", "reference"}
        The picture on which they were marked: the mean face, or the reference frame's own picture.

    Raises
    ------
    BadInput
        If the points lie outside the picture or span no upright face.

    Examples
    --------
    >>> import numpy as np
    >>> import morphspace as ms
    >>> found = given_keypoints(ms.load("anna.morph"), np.array([[20.0, 30.0], [44.0, 30.0], [32.0, 50.0]]))
    >>> found.faceframe.left_eye
    (44.0, 30.0)
    """
    faceframe, notes = _on_mean(model, np.array(points, np.float64), on, "--set", None)
    origin = {"source": "set", "lip": lip or "philtrum", "on": on}
    return FoundKeypoints(faceframe, origin, (), notes)


def read_keypoints(
    model: MorphModel, path: Path, lip: Lip | None = None, y_axis: YAxis = "auto", on: Marked = "mean"
) -> FoundKeypoints:
    """Read marked points from a file and carry them to the mean face.

    Parameters
    ----------
    model, lip, on
        As `given_keypoints`.
    path : Path
    y_axis : {"auto", "up"}
        "up" if y counts upwards in the file; "auto" follows the format.

    Raises
    ------
    BadInput
        If the file has no such points, or they lie outside the picture or span no upright face.
    """
    size = framing_of(model).source_size if on == "reference" else model.size
    marked = read_marked_points(path, size, lip=lip, y_axis=y_axis)
    turned = _turned_words(path, size, lip, y_axis, marked.points)
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


def _turned_words(
    path: Path, size: tuple[int, int], lip: Lip | None, y_axis: YAxis, points: Points
) -> str | None:
    """Return the option that would count y the other way, or None if the face would still not be upright."""
    is_turned = y_axis == "up"
    other: YAxis = "auto" if is_turned else "up"
    try:
        x = read_marked_points(path, size, lip=lip, y_axis=other).points
    except BadInput:  # some landmarks would lie outside
        return None
    if np.array_equal(x, points):
        return None
    if (x[:, 1] < -0.5).any() or (x[:, 1] > size[1] - 0.5).any() or x[2, 1] <= x[:2, 1].max():
        return None
    return "leave out --negate-y" if is_turned else "give --negate-y"


def _on_mean(
    model: MorphModel, points: Points, on: Marked, name: str, turned: str | None
) -> tuple[FaceFrame, tuple[str, ...]]:
    """Check marked points (3, 2) px and carry them to the mean face.

    Errors call the points `name`, and recommend `turned` if it is not None (`_turned_words`).
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
    """Warn of a keypoint that lies far from the model's landmarks for it."""
    if model.landmarks is None or model.faceframe is None:
        return ()
    lip = (
        0 if lip_of(model) == "philtrum" else UPPER_LIP_BOTTOM
    )  # mesh point 0 is the cupid's bow, just below the philtrum
    places = [[LANDMARKS.index(place) for place in group] for group in (RIGHT_LIDS, LEFT_LIDS, (lip,))]
    learned = np.array([model.landmarks.mean[rows].mean(axis=0) for rows in places])
    eyes_px = float(np.hypot(*(learned[1] - learned[0])))
    apart = np.hypot(*(model.faceframe.points - learned).T) / eyes_px
    if apart.max() <= FAR:
        return ()
    far = int(apart.argmax())
    x, y = learned[far].tolist()
    return (
        f"the {point_names(model)[far]} lies {apart[far]:.1f} eye distances from the model's landmark for it at "
        f"{x:.1f},{y:.1f}; expected at most {FAR:g}, as `mimic --method guided` uses both. Check the picture; set the "
        "points again, or find both with --auto",
    )


def _listed(values: Any) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def point_lines(model: MorphModel, previous: MorphModel | None = None) -> tuple[str, ...]:
    """Report the keypoints of a model, and how far they moved from those of `previous`."""
    if model.faceframe is None:
        return ()
    points = model.faceframe.points
    lines = [
        f"{name:<18} {x:.1f}, {y:.1f}"
        for name, (x, y) in zip(point_names(model), points.tolist(), strict=True)
    ]
    if previous is not None and previous.faceframe is not None:
        moved = np.hypot(*(points - previous.faceframe.points).T)
        lines.append(f"the previous points moved by {', '.join(f'{value:.1f}' for value in moved)} px")
    return tuple(lines)


def points_document(model: MorphModel) -> dict[str, Any]:
    """Return the keypoints of a model as JSON."""
    points = None if model.faceframe is None else model.faceframe.points.tolist()
    return {"model_id": model.model_id, "points": points, "lip": lip_of(model) if points else None}
