"""keypoints: the three points on a model's mean face, which place it and link it to other models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from morphspace.arrays import Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, load_detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LANDMARKS, LEFT_LIDS, RIGHT_LIDS, UPPER_LIP_BOTTOM
from morphspace.io.images import write_image
from morphspace.io.templates import LipName, YAxis, read_marked_points
from morphspace.model.file import check_content
from morphspace.model.keypoints import (
    TURN_UPRIGHT,
    WIDE_SPREAD,
    checked_faceframe,
    detect_faceframe,
    framing_of,
    lip_of,
    picture_to_mean,
)
from morphspace.model.landmarks import LEAST_FACES, LandmarkRegression
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome
from morphspace.sets.protect import check_file
from morphspace.steps import Steps
from morphspace.storage import digest_of_file

PICTURE_SIDE_PX = 480  # the drawn mean is enlarged by whole numbers up to it
FAR = 0.5  # eye distances from the landmarks; points that mark the same face lie within a quarter
MARKS = (("R", (215, 40, 40)), ("L", (30, 90, 230)), ("P", (20, 130, 60)))  # letter and colour
WHITE = (255, 255, 255)
Marked = Literal["mean", "reference"]


@dataclass(frozen=True)
class KeypointsRequest:
    """Set the keypoints of `model` from one source: `automatic`, `points` ((x, y) three times, px) or a `file`.

    With none of them the present ones are shown. `lip` says what the third point is, `y_axis` which way y counts in the
    file, `on` whether the points were marked on the mean face or on the reference frame's own picture. `output` None
    rewrites the model itself.
    """

    model: Path
    automatic: bool = False
    points: tuple[tuple[float, float], ...] | None = None
    file: Path | None = None
    lip: LipName | None = None
    y_axis: YAxis = "auto"
    on: Marked = "mean"
    output: Path | None = None


@dataclass(frozen=True, eq=False)
class Found:
    """A checked faceframe, the record of where it came from, and what a person should know of it."""

    faceframe: FaceFrame
    origin: Mapping[str, Any]
    lines: tuple[str, ...]
    notes: tuple[str, ...]
    landmarks: LandmarkRegression | None = None


def run(request: KeypointsRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Set the keypoints, write the model and a picture of them; or show them. Returns an `Outcome`.

    `detector` None takes the package's own, with --auto.
    """
    _check(request)
    check_content(request.model)  # a damaged model must not be written again as a whole one
    model = load_model(request.model)
    if not request.automatic and request.points is None and request.file is None:
        return _shown(request.model, model)
    output = request.output or request.model
    check_file(output, ".morph")
    if request.automatic:
        found = yield from _detected(model, detector or load_detector())
    elif request.file is not None:
        found = _read(model, request.file, request)
    else:
        found = _given(model, request)
    changed = model.with_faceframe(found.faceframe, found.origin)
    if request.automatic:
        changed = changed.with_landmarks(found.landmarks)
    marked_mean = drawn(changed.mean.render(), found.faceframe)
    changed.save(output)
    picture = output.with_name(f"{output.stem}.keypoints.png")
    write_image(picture, marked_mean)
    lines = (
        f"{output}: keypoints of {model.identity} set",
        *_lines(changed),
        *found.lines,
        f"picture: {picture}",
    )
    if model.faceframe is not None:
        moved = np.hypot(*(found.faceframe.points - model.faceframe.points).T)
        lines += (f"they were there before, and moved by {_listed(moved)} px",)
    document = {
        **_document(changed),
        "output": str(output),
        "picture": str(picture),
        "origin": dict(found.origin),
        "landmarks": None if changed.landmarks is None else changed.landmarks.document(),
    }
    notes = found.notes if request.automatic else (*found.notes, *_far_notes(changed))
    return Outcome(lines, document, notes, (output, picture))


def _check(request: KeypointsRequest) -> None:
    sources = {
        "--auto": request.automatic,
        "--set": request.points is not None,
        "--from": request.file is not None,
    }
    given = [name for name, is_given in sources.items() if is_given]
    if len(given) > 1:
        raise BadInput(
            f"{' and '.join(given)} were given: the keypoints come from one source, leave out the other"
        )
    if request.y_axis != "auto" and request.file is None:
        raise BadInput("--negate-y was given without --from: it says how y counts in a file")
    if request.automatic and (request.lip == "upper-lip" or request.on == "reference"):
        raise BadInput(
            "--auto finds the philtrum on the mean face: leave out --lip and --on, or mark the points"
        )
    if not given and (request.lip or request.output or request.on != "mean"):
        raise BadInput("no keypoints were given: give --auto, --set or --from")


def _detected(model: MorphModel, detector: Detector) -> Steps[Found]:
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
        return Found(found.faceframe, found.origin, (said,), notes)
    taught = f"landmarks learned from {learned.faces} faces; {told_errors(learned)}"
    return Found(found.faceframe, found.origin, (said, taught), notes, learned)


def _given(model: MorphModel, request: KeypointsRequest) -> Found:
    faceframe, notes = _on_mean(model, np.array(request.points, np.float64), request.on, "--set", None)
    origin = {"source": "set", "lip": request.lip or "philtrum", "on": request.on}
    return Found(faceframe, origin, (), notes)


def _read(model: MorphModel, path: Path, request: KeypointsRequest) -> Found:
    height = framing_of(model).source_size[1] if request.on == "reference" else model.size[1]
    marked = read_marked_points(path, height, lip=request.lip, y_axis=request.y_axis)
    turned = _turned_words(path, height, request, marked.points)
    faceframe, notes = _on_mean(model, marked.points, request.on, str(path), turned)
    origin = {
        "source": "file",
        "file": path.name,
        "sha256": digest_of_file(path),
        "scheme": marked.scheme,
        "lip": marked.lip,
        "on": request.on,
    }
    return Found(faceframe, origin, (f"read as {marked.scheme}",), marked.notes + notes)


def _turned_words(path: Path, height: int, request: KeypointsRequest, points: Points) -> str | None:
    """Say how to count y in the file the other way, where its face would then stand upright in the picture."""
    is_turned = request.y_axis == "up"
    other: YAxis = "auto" if is_turned else "up"
    x = read_marked_points(path, height, lip=request.lip, y_axis=other).points
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


def _far_notes(model: MorphModel) -> tuple[str, ...]:
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


def _shown(path: Path, model: MorphModel) -> Outcome:
    if model.faceframe is None:
        lines: tuple[str, ...] = (f"{path}: no keypoints are set: give --auto, --set or --from",)
    else:
        lines = (f"{path}: keypoints of {model.identity}", *_lines(model))
    return Outcome(lines, _document(model))


def _lines(model: MorphModel) -> tuple[str, ...]:
    if model.faceframe is None:
        return ()
    points = model.faceframe.points.tolist()
    return tuple(
        f"{name:<18} {x:.1f}, {y:.1f}" for name, (x, y) in zip(point_names(model), points, strict=True)
    )


def point_names(model: MorphModel) -> tuple[str, str, str]:
    """Give what the three points of a model with a faceframe mark."""
    return "right eye", "left eye", "philtrum" if lip_of(model) == "philtrum" else "upper lip's bottom"


def _document(model: MorphModel) -> dict[str, Any]:
    points = None if model.faceframe is None else model.faceframe.points.tolist()
    return {"model_id": model.model_id, "points": points, "lip": lip_of(model) if points else None}


def told_errors(landmarks: LandmarkRegression) -> str:
    """Say how far the landmarks of a face left out lie from where the regression puts them, by group."""
    errors = landmarks.errors()
    groups = ", ".join(f"{name} {error:.2f}" for name, error in errors.items() if name != "all")
    return f"leave-one-out error {errors['all']:.2f} px ({groups})"


def _listed(values: Any) -> str:
    return ", ".join(f"{value:.1f}" for value in values)


def drawn(mean: Image, faceframe: FaceFrame) -> Image:
    """Draw the three points on a mean face (h, w, 3), enlarged by a whole number: R and L the eyes, P the lip."""
    height, width = mean.shape[:2]
    times = max(1, PICTURE_SIDE_PX // max(height, width))
    size = (width * times, height * times)
    larger = cv2.resize(np.clip(mean, 0, 1), size, interpolation=cv2.INTER_CUBIC)
    out = np.rint(255 * np.clip(larger, 0, 1)).astype(np.uint8)
    radius = max(4, min(size) // 80)
    for (letter, colour), point in zip(MARKS, faceframe.points, strict=True):
        x, y = (round(float(value)) for value in (point + 0.5) * times - 0.5)
        place = (x + radius + 3, y - radius)
        for ink, thickness in ((WHITE, 3), (colour, 1)):
            cv2.circle(out, (x, y), radius, ink, thickness, cv2.LINE_AA)
            cv2.putText(out, letter, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, thickness, cv2.LINE_AA)
        cv2.circle(out, (x, y), 1, colour, -1)
    return out.astype(np.float32) / np.float32(255)
