"""The three keypoints of a model, and the affine between two models (Nagle et al., section 3, step 2).

The points lie on the mean face. All are checked here. Points that were marked on the reference are carried to the
mean face by the mean shape. Points that were detected in many faces are carried there by the warp of each face, and
their median is taken (ours: it varies less than a single detection). The same detections train the landmark
regression (`landmarks.learn_landmarks`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import Affine, AnyArray, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.anchor import face_of_reference, was_held
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import POINT_COUNT, SCHEME
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

LEAST_EYES_PX = 4.0  # px, from eye to eye; nearer, an error of half a pixel turns the face by 7 degrees
LEAST_DEPTH = 0.15  # eye distances from the line through the eyes to the lip; 0.7 to 1.2 in faces
FACES = 200  # training faces in which keypoints are detected, evenly spread, besides the mean
LEAST_FOUND = 3  # faces; a median of fewer rejects no outlier
MARK_AGAIN = "mark them again"
TURN_UPRIGHT = "mark the eyes above the lip, or turn the face upright"
WIDE_SPREAD = 0.05  # eye distances; above it the detections contradict each other


@dataclass(frozen=True, eq=False)
class DetectedFaceframe:
    """A faceframe that a detector found in faces of a model.

    Attributes
    ----------
    faceframe : FaceFrame
        On the mean face.
    spread_px : array (3,) px
        Median distance of the detections, carried to the mean face, from each point.
    points : array (n, 2) px
        All points of the detector on the mean face.
    faces, found : int
        Faces that were searched, and those in which a face was found.
    landmarks : LandmarkRegression or None
        None if the detector does not find the mesh's 478 points, or finds them in fewer than `LEAST_FACES` faces.
    """

    faceframe: FaceFrame
    spread_px: AnyArray
    points: Points
    faces: int
    found: int
    landmarks: LandmarkRegression | None = None

    @property
    def origin(self) -> dict[str, Any]:
        """The entry `keypoints` of a model's provenance for detected points (`MorphModel.with_faceframe`)."""
        return {
            "source": "auto",
            "lip": "philtrum",
            "on": "mean",
            "scheme": SCHEME,
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
    """Check three points on a face and return its faceframe.

    Eyes in the wrong order are exchanged: right is the subject's right, the smaller x.

    Parameters
    ----------
    points : array (3, 2) px
        Right eye, left eye, lip point.
    size : (w, h) px
        Of the face's picture.
    origin : str
        Names the points in messages.
    if_outside, if_upside_down : str
        What the user should do in these cases.

    Returns
    -------
    faceframe : FaceFrame
    notes : tuple of str
        A note if the eyes were exchanged.

    Raises
    ------
    BadInput
        If points are outside the face, not finite, repeated, on one line, upside down or too close.
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
    """Check that the points, eyes in order, span an upright face. Raises `BadInput` otherwise."""
    right, left, lip = points
    eyes = left - right
    distance = float(np.hypot(*eyes))
    if distance < LEAST_EYES_PX:
        raise BadInput(
            f"{origin}: the eyes are {distance:.1f} px apart; expected at least {LEAST_EYES_PX:g} px. Mark them again, "
            "or build the model from larger frames"
        )
    depth = float(eyes[0] * (lip - right)[1] - eyes[1] * (lip - right)[0]) / distance
    if abs(depth) < LEAST_DEPTH * distance:
        raise BadInput(
            f"{origin}: the three points lie on one line: the lip is {abs(depth):.1f} px from the line through the "
            f"eyes; expected at least {LEAST_DEPTH * distance:.1f} px. Mark them again"
        )
    if depth < 0:
        raise BadInput(
            f"{origin}: the lip lies {-depth:.1f} px above the eyes; expected below, as y counts down: {if_upside_down}"
        )


def affine_between(source: FaceFrame, target: FaceFrame) -> Affine:
    """Compute the affine (2, 3) that moves the points of `source` onto those of `target`.

    Raises
    ------
    BadInput
        If the points of one are repeated, on one line, mirrored or too close.

    References
    ----------
    Nagle et al., section 3, step 2.

    Examples
    --------
    >>> import numpy as np
    >>> one = FaceFrame.at(np.array([[20.0, 30.0], [40.0, 30.0], [30.0, 46.0]]))
    >>> other = FaceFrame.at(2 * one.points + (1, 5))
    >>> (affine_between(one, other) @ (20, 30, 1)).round(6).tolist()
    [41.0, 65.0]
    """
    for faceframe, name in ((source, "the source's faceframe"), (target, "the target's faceframe")):
        _check_triangle(faceframe.points, name)
    design = np.column_stack([source.points, np.ones(3)])
    return np.asarray(np.linalg.solve(design, target.points).T, np.float64)


def affine_between_models(source: MorphModel, target: MorphModel) -> Affine:
    """Compute the affine (2, 3) from the mean face of `source` to that of `target`.

    Raises
    ------
    BadInput
        If a model has no keypoints, or the third points have different meanings.

    References
    ----------
    Nagle et al., section 3, step 2.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna, ben = ms.load("anna.morph"), ms.load("ben.morph")
    >>> (affine_between_models(anna, ben) @ [20.0, 30.0, 1.0]).round(6).tolist(), required_faceframe(ben).right_eye
    ([18.0, 30.0], (18.0, 30.0))
    """
    frames = (required_faceframe(source), required_faceframe(target))
    lips = (lip_of(source), lip_of(target))
    if lips[0] != lips[1]:
        raise BadInput(
            f"the third keypoint of {source.identity} marks the {lips[0]}, that of {target.identity} the {lips[1]}; "
            "expected the same point. Set both alike with `morphspace keypoints`"
        )
    return affine_between(*frames)


def required_faceframe(model: MorphModel) -> FaceFrame:
    """Return the faceframe of a model. Raises `BadInput` with the command that sets it if there is none.

    Examples
    --------
    >>> import morphspace as ms
    >>> required_faceframe(ms.load("anna.morph")).left_eye
    (44.0, 30.0)
    """
    if model.faceframe is None:
        raise BadInput(
            f"the model of {model.identity} has no keypoints: set them with `morphspace keypoints MODEL --auto`, or "
            "with --set or --from"
        )
    return model.faceframe


def required_landmarks(model: MorphModel) -> LandmarkRegression:
    """Return the landmark regression of a model. Raises `BadInput` with a remedy if there is none."""
    if model.landmarks is None:
        raise BadInput(
            f"the model of {model.identity} has no landmark regression: {how_to_learn(model, 'MODEL')}, or choose a "
            "method that needs none"
        )
    return model.landmarks


def how_to_learn(model: MorphModel, name: str) -> str:
    """Return the remedy for a model without landmark regression: the command on the file `name`, or another build."""
    count = len(model.training.values)
    if count < LEAST_FACES:
        return (
            f"it has {count} training faces; expected at least {LEAST_FACES}. Build it from more frames, of different "
            "expressions"
        )
    origin = model.provenance.get("keypoints")
    found = origin.get("found") if isinstance(origin, dict) and origin.get("source") == "auto" else None
    if isinstance(found, int) and found <= LEAST_FACES:
        return (
            f"a face was found in {found} of its {count} training faces; expected more than {LEAST_FACES}. Build it "
            "from more or larger frames of the whole face"
        )
    older = (
        "its face points are those of an older mesh, and are not used: " if _has_older_points(model) else ""
    )
    return f"{older}run `morphspace keypoints {name} --auto`"


def region_of(model: MorphModel, name: str) -> Mask:
    """Return the mask (h, w) of a named part of a model's mean face. Raises as `face.regions.region_mask`.

    Examples
    --------
    >>> import morphspace as ms
    >>> mouth = region_of(ms.load("anna.morph"), "mouth")
    >>> mouth[56, 32].item(), mouth[10, 32].item()
    (1.0, 0.0)
    """
    landmarks = None if model.landmarks is None else model.landmarks.mean
    return region_mask(name, model.size[1], model.size[0], model.faceframe, landmarks)


def lip_of(model: MorphModel) -> Lip:
    """Return the meaning of the third point of a model's faceframe; the philtrum if none is recorded."""
    origin = model.provenance.get("keypoints")
    lip = origin.get("lip") if isinstance(origin, dict) else None
    return "upper-lip" if lip == "upper-lip" else "philtrum"


def point_names(model: MorphModel) -> tuple[str, str, str]:
    """Return the names of the three points of a model with a faceframe."""
    return "right eye", "left eye", "philtrum" if lip_of(model) == "philtrum" else "upper lip's bottom"


def landmarks_of(model: MorphModel) -> Points | None:
    """Return the points (478, 2) px of the face mesh on the mean face.

    None if `keypoints --auto` found none, or found those of an older mesh.

    Examples
    --------
    >>> import morphspace as ms
    >>> landmarks_of(ms.load("anna.morph")) is None  # until `keypoints --auto` has found them
    True
    """
    points = _stored_points(model)
    return None if points is None or _has_older_points(model) else np.asarray(points, np.float64)


def _has_older_points(model: MorphModel) -> bool:
    """Return whether the points of the face mesh that a model holds are those of another mesh than `SCHEME`."""
    return _stored_points(model) is not None and model.provenance["keypoints"].get("scheme") != SCHEME


def _stored_points(model: MorphModel) -> list[list[float]] | None:
    origin = model.provenance.get("keypoints")
    points = origin.get("points") if isinstance(origin, dict) else None
    return points if points is not None and len(points) == POINT_COUNT else None


def framing_of(model: MorphModel) -> Framing:
    """Return the framing by which the build turned source pictures into the model's frames."""
    built = model.provenance["framing"]
    width, height = built["source_size"]
    x, y, w, h = built["crop"] or (0, 0, width, height)
    return Framing((int(width), int(height)), (int(x), int(y), int(w), int(h)), model.size)


def reference_to_mean(model: MorphModel, points: Points) -> Points:
    """Carry points (m, 2) px from the model's reference to its mean face by m, the inverse of `mean_inverse`."""
    return warp.move_points(warp.invert(model.mean_inverse), points)


def picture_to_mean(model: MorphModel, points: Points) -> Points:
    """Carry points (m, 2) px from the reference frame's own picture to the mean face: the build's framing, then m."""
    return reference_to_mean(
        model, warp.apply_affine(warp.inverse_affine(framing_of(model).to_source), points)
    )


def detect_faceframe(model: MorphModel, detect: Detector, *, faces: int = FACES) -> Steps[DetectedFaceframe]:
    """Detect the faceframe of a model on its mean face and training faces; a generator of steps.

    The training faces are rendered from their loadings. The detected points of each are carried to the mean face
    through its warp, and the median is taken of each coordinate (ours).

    Parameters
    ----------
    model : MorphModel
    detect : Detector
    faces : int
        The largest number of training faces, evenly spread.

    Returns
    -------
    DetectedFaceframe

    Raises
    ------
    BadInput
        If a face was found in fewer than `LEAST_FOUND` faces, or in fewer than half of them.
    """
    training = model.training.values
    rows = [np.zeros(model.rank), *(training[index] for index in spread(len(training), faces))]
    carried, detected_points, detected_loadings = [], [], []
    for number, loadings in enumerate(rows):
        morph = model.expand(loadings)
        inverse = warp.invert(morph.displacement)
        face = np.clip(warp.sample(morph.texture, inverse), 0, 1)
        found = detect(face)
        if found is not None:
            carried.append(warp.move_points(inverse, np.vstack([found.faceframe().points, found.points])))
            if number > 0:
                detected_points.append(found.points)
                detected_loadings.append(loadings)
        yield Step("keypoints", number + 1, len(rows))
    if len(carried) < max(LEAST_FOUND, len(rows) / 2):
        raise BadInput(
            f"a face was found in {len(carried)} of {len(rows)} faces of {model.identity}; expected at "
            f"least half and {LEAST_FOUND}. Give the keypoints with --set or --from"
        )
    stack = np.array(carried)
    points = np.median(stack, axis=0)
    spread_px = np.median(np.hypot(*np.moveaxis(stack - points, -1, 0)), axis=0)
    faceframe, _ = checked_faceframe(points[:3], model.size, "the detector")
    own = face_of_reference(model.reference, model.provenance, detect) if was_held(model.provenance) else None
    if own is not None:
        # The warp carries the reference's own points to those of each frame; medians miss them by up to a px.
        points[3:] = reference_to_mean(model, own.points)
    learned = None
    if points[3:].shape == (POINT_COUNT, 2) and len(detected_points) >= LEAST_FACES and model.rank > 0:
        by_warp = moved_by_components(model, points[3:])
        learned = learn_landmarks(np.array(detected_loadings), np.array(detected_points), model.sd, by_warp)
    return DetectedFaceframe(faceframe, spread_px[:3], points[3:], len(rows), len(carried), learned)


def with_detected(model: MorphModel, found: DetectedFaceframe) -> MorphModel:
    """Return the model with a detected faceframe, its origin and its landmark regression."""
    return model.with_faceframe(found.faceframe, found.origin).with_landmarks(found.landmarks)


def moved_by_components(model: MorphModel, points: Points) -> AnyArray:
    """Compute the movement of points (n, 2) px of the mean face by one unit of each component, (k, n, 2) px.

    Examples
    --------
    >>> import numpy as np
    >>> import morphspace as ms
    >>> moved_by_components(ms.load("anna.morph"), np.array([[30.0, 36.0]])).shape
    (3, 1, 2)
    """
    fields = model.component_displacements
    return np.array([warp.move_points(np.ascontiguousarray(field), points) - points for field in fields])
