"""The three keypoints of a model, and the affine that links two models through them (Nagle section 3, step 2).

The points lie on the mean face. They are checked here, whoever gave them; points that were marked on the reference are
carried to the mean face through the mean shape, and points found in many faces are carried there through the warp of
each (ours: a median over a whole clip is steadier than any single detection). The same detections teach where the
landmarks of a face lie for given loadings (`landmarks.learn_landmarks`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import Affine, AnyArray, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import POINT_COUNT
from morphspace.face.regions import region_mask
from morphspace.grid import warp
from morphspace.io.framing import Framing
from morphspace.io.points import Lip
from morphspace.io.sidecars import eyes_in_order
from morphspace.model.landmarks import LEAST_FACES, LandmarkRegression, learn_landmarks
from morphspace.model.model import MorphModel
from morphspace.steps import Step, Steps, spread

LIPS: tuple[Lip, ...] = ("philtrum", "upper-lip")
POINT_NAMES = ("right eye", "left eye", "philtrum")

LEAST_EYES_PX = 4.0  # from eye to eye; below it an error of half a pixel turns the face by 7 degrees
LEAST_DEPTH = 0.15  # of the eye distance, from the line through the eyes to the lip; faces have 0.7 to 1.2
FACES = 200  # of a model that are looked at, evenly spread over its training frames, besides the mean
LEAST_FOUND = 3  # faces; a median of fewer is one detection
MARK_AGAIN = "mark them again"
TURN_UPRIGHT = "mark the eyes above the lip, or turn the face upright"
WIDE_SPREAD = 0.05  # of the eye distance; beyond it the detections contradict each other


@dataclass(frozen=True, eq=False)
class DetectedFaceframe:
    """A faceframe found in `faces` faces of a model, of which `found` showed one to the detector.

    `spread_px` (3,) is the median distance of the detections from the point, each carried to the mean face; `points`
    (n, 2) px are all that the detector finds, on the mean face; `landmarks` is what was learned of the training faces,
    None where the detector finds other points than the mesh's 478 or finds them in fewer than `LEAST_FACES`.
    """

    faceframe: FaceFrame
    spread_px: AnyArray
    points: Points
    faces: int
    found: int
    landmarks: LandmarkRegression | None = None

    @property
    def origin(self) -> dict[str, Any]:
        """What a model's provenance says of keypoints that were detected; see `MorphModel.with_faceframe`."""
        return {
            "source": "auto",
            "lip": "philtrum",
            "on": "mean",
            "faces": self.faces,
            "found": self.found,
            "spread_px": [round(float(value), 3) for value in self.spread_px],
            "points": [[round(float(x), 2), round(float(y), 2)] for x, y in self.points],
        }


def checked_faceframe(
    points: Points,
    size: tuple[int, int],
    origin: str,
    *,
    if_outside: str = MARK_AGAIN,
    if_upside_down: str = TURN_UPRIGHT,
) -> tuple[FaceFrame, tuple[str, ...]]:
    """Give the faceframe of three points (3, 2) px on a face of `size` (w, h) px, and notes on what was mended.

    Eyes in the wrong order are exchanged, which is noted: right is the subject's right, the smaller x. Raises
    `BadInput` for points outside the face, not finite, repeated, on one line, upside down or too close; `origin` names
    them, `if_outside` and `if_upside_down` say what to do about it.
    """
    points, notes = eyes_in_order(points, origin)
    for name, (x, y) in zip(POINT_NAMES, points.tolist(), strict=True):
        if not (-0.5 <= x <= size[0] - 0.5 and -0.5 <= y <= size[1] - 0.5):
            raise BadInput(
                f"{origin}: the {name} at {x:.1f},{y:.1f} lies outside the mean face of {size[0]}x{size[1]} px: "
                f"{if_outside}"
            )
    _check_triangle(points, origin, if_upside_down)
    return FaceFrame.at(points), notes


def _check_triangle(points: Points, origin: str, if_upside_down: str = TURN_UPRIGHT) -> None:
    """Raise `BadInput` where the points, eyes in order, do not span a face that stands upright."""
    right, left, lip = points
    eyes = left - right
    distance = float(np.hypot(*eyes))
    if distance < LEAST_EYES_PX:
        raise BadInput(
            f"{origin}: the eyes are {distance:.1f} px apart, at least {LEAST_EYES_PX:g} px are needed: mark them "
            "again, or build the model from larger frames"
        )
    depth = float(eyes[0] * (lip - right)[1] - eyes[1] * (lip - right)[0]) / distance
    if abs(depth) < LEAST_DEPTH * distance:
        raise BadInput(
            f"{origin}: the three points lie on one line (the lip is {abs(depth):.1f} px from the line through the "
            f"eyes, which are {distance:.1f} px apart): mark them again"
        )
    if depth < 0:
        raise BadInput(
            f"{origin}: the lip lies {-depth:.1f} px above the eyes, but y counts down here: {if_upside_down}"
        )


def affine_between(source: FaceFrame, target: FaceFrame) -> Affine:
    """Give the affine (2, 3) that moves the points of `source` onto those of `target` (Nagle section 3, step 2).

    Raises `BadInput` where one of them does not span a face: points repeated, on one line, mirrored, too close.
    """
    for faceframe, name in ((source, "the source's faceframe"), (target, "the target's faceframe")):
        _check_triangle(faceframe.points, name)
    design = np.column_stack([source.points, np.ones(3)])
    return np.asarray(np.linalg.solve(design, target.points).T, np.float64)


def affine_between_models(source: MorphModel, target: MorphModel) -> Affine:
    """Give the affine (2, 3) from the mean face of `source` to that of `target`.

    Raises `BadInput` where one has no keypoints (the message says the command), or their third points mark different
    things.
    """
    frames = (required_faceframe(source), required_faceframe(target))
    lips = (lip_of(source), lip_of(target))
    if lips[0] != lips[1]:
        raise BadInput(
            f"the third keypoint of {source.identity} marks the {lips[0]}, that of {target.identity} the {lips[1]}: "
            "set both the same way with `morphspace keypoints`"
        )
    return affine_between(*frames)


def required_faceframe(model: MorphModel) -> FaceFrame:
    """Give the faceframe of a model. Raises `BadInput` with the command that sets it where it has none."""
    if model.faceframe is None:
        raise BadInput(
            f"the model of {model.identity} has no keypoints: set them with `morphspace keypoints MODEL --auto`, or "
            "with --set or --from"
        )
    return model.faceframe


def required_landmarks(model: MorphModel) -> LandmarkRegression:
    """Give the landmark regression of a model. Raises `BadInput` with the command that learns it where it has none."""
    if model.landmarks is None:
        raise BadInput(
            f"the model of {model.identity} does not know where its landmarks lie: {how_to_learn(model, 'MODEL')}, or "
            "choose a method that needs none"
        )
    return model.landmarks


def how_to_learn(model: MorphModel, name: str) -> str:
    """Say how a model comes to know its landmarks: by the command, with `name` for its file, where that can help."""
    count = len(model.training.values)
    if count < LEAST_FACES:
        return (
            f"it holds {count} faces, too few to learn them from: build it from {LEAST_FACES} frames or more, of "
            "different expressions"
        )
    origin = model.provenance.get("keypoints")
    found = origin.get("found") if isinstance(origin, dict) and origin.get("source") == "auto" else None
    if isinstance(found, int) and found <= LEAST_FACES:
        return (
            f"a face was found in {found} of its {count} faces, too few to learn them from: build it from more or "
            "larger frames that show the whole face"
        )
    return f"run `morphspace keypoints {name} --auto`"


def region_of(model: MorphModel, name: str) -> Mask:
    """Return the mask (h, w) of a named part of a model's mean face. Raises as `face.regions.region_mask`."""
    landmarks = None if model.landmarks is None else model.landmarks.mean
    return region_mask(name, model.size[1], model.size[0], model.faceframe, landmarks)


def lip_of(model: MorphModel) -> Lip:
    """Give what the third point of a model's faceframe marks; the philtrum where nothing else is recorded."""
    origin = model.provenance.get("keypoints")
    lip = origin.get("lip") if isinstance(origin, dict) else None
    return "upper-lip" if lip == "upper-lip" else "philtrum"


def point_names(model: MorphModel) -> tuple[str, str, str]:
    """Give what the three points of a model with a faceframe mark."""
    return "right eye", "left eye", "philtrum" if lip_of(model) == "philtrum" else "upper lip's bottom"


def landmarks_of(model: MorphModel) -> Points | None:
    """Give the points of the face mesh on the mean face, (478, 2) px, where `keypoints --auto` left them."""
    origin = model.provenance.get("keypoints")
    points = origin.get("points") if isinstance(origin, dict) else None
    if points is None or len(points) != POINT_COUNT:
        return None
    return np.asarray(points, np.float64)


def framing_of(model: MorphModel) -> Framing:
    """Give how the build turned source pictures into the model's frames."""
    built = model.provenance["framing"]
    width, height = built["source_size"]
    x, y, w, h = built["crop"] or (0, 0, width, height)
    return Framing((int(width), int(height)), (int(x), int(y), int(w), int(h)), model.size)


def reference_to_mean(model: MorphModel, points: Points) -> Points:
    """Carry points (m, 2) px of the model's reference to its mean face: m(p), the inverse of `mean_inverse`."""
    return warp.move_points(warp.invert(model.mean_inverse), points)


def picture_to_mean(model: MorphModel, points: Points) -> Points:
    """Carry points (m, 2) px of the reference frame's own picture to the mean face: framed as the build did, then m."""
    return reference_to_mean(
        model, warp.apply_affine(warp.inverse_affine(framing_of(model).to_source), points)
    )


def detect_faceframe(model: MorphModel, detect: Detector, *, faces: int = FACES) -> Steps[DetectedFaceframe]:
    """Find the faceframe on the mean face of a model: on the mean and on up to `faces` of its training faces.

    The training faces come back from their loadings; what `detect` finds in each is carried to the mean face through
    the warp of that face, and the median is taken, point by point and axis by axis. A generator of steps. Raises
    `BadInput` where a face was found in fewer than three, or in fewer than half of them.
    """
    training = model.training.values
    rows = [np.zeros(model.rank), *(training[index] for index in spread(len(training), faces))]
    carried, seen, shown_by = [], [], []
    for number, loadings in enumerate(rows):
        morph = model.expand(loadings)
        inverse = warp.invert(morph.displacement)
        face = np.clip(warp.sample(morph.texture, inverse), 0, 1)
        found = detect(face)
        if found is not None:
            carried.append(warp.move_points(inverse, np.vstack([found.faceframe().points, found.points])))
            if number > 0:
                seen.append(found.points)
                shown_by.append(loadings)
        yield Step("keypoints", number + 1, len(rows))
    if len(carried) < max(LEAST_FOUND, len(rows) / 2):
        raise BadInput(
            f"a face was found in {len(carried)} of {len(rows)} faces of {model.identity}, too few to place keypoints: "
            "give them with --set or --from"
        )
    stack = np.array(carried)
    points = np.median(stack, axis=0)
    spread_px = np.median(np.hypot(*np.moveaxis(stack - points, -1, 0)), axis=0)
    faceframe, _ = checked_faceframe(points[:3], model.size, "the detector")
    learned = None
    if points[3:].shape == (POINT_COUNT, 2) and len(seen) >= LEAST_FACES and model.rank > 0:
        by_warp = moved_by_components(model, points[3:])
        learned = learn_landmarks(np.array(shown_by), np.array(seen), model.sd, by_warp)
    return DetectedFaceframe(faceframe, spread_px[:3], points[3:], len(rows), len(carried), learned)


def with_detected(model: MorphModel, found: DetectedFaceframe) -> MorphModel:
    """Give the model with the faceframe that was found, where it came from, and what was learned of its landmarks."""
    return model.with_faceframe(found.faceframe, found.origin).with_landmarks(found.landmarks)


def moved_by_components(model: MorphModel, points: Points) -> AnyArray:
    """Give how far one unit of each component moves the points (n, 2) px of the mean face: (k, n, 2) px."""
    fields = model.component_displacements
    return np.array([warp.move_points(np.ascontiguousarray(field), points) - points for field in fields])
