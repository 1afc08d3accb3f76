"""Parts of the face as soft masks on the mean face: eyes, brows, mouth, nose, upper and lower half (ours).

Where the model knows its landmarks the parts are drawn around them; else by usual proportions from the faceframe. The
unit is the distance between the eye centres. Inside a region the mask is 1; it falls off over some hundredths of that
distance, so that neither warp nor colour gets a seam.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np
from scipy import ndimage

from morphspace.arrays import AnyArray, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.model.landmarks import landmark_places
from morphspace.model.model import MorphModel

WHOLE = "whole"
SOFT = 0.08  # of the eye distance: sd of the edge
FINER = 4  # bits of the corners' fractions OpenCV fills polygons with
# How far a part reaches beyond its landmarks' hull, in eye distances.
MARGINS = {"eyes": 0.12, "brows": 0.06, "mouth": 0.14}
# By the faceframe alone: ellipses (x, y, half width, half height) in eye distances; x to the subject's left from the
# middle of the eyes, y down. The philtrum lies near (0, 0.95).
ELLIPSES: Mapping[str, tuple[tuple[float, float, float, float], ...]] = {
    "eyes": ((-0.5, 0.0, 0.36, 0.24), (0.5, 0.0, 0.36, 0.24)),
    "brows": ((-0.5, -0.38, 0.46, 0.18), (0.5, -0.38, 0.46, 0.18)),
    "mouth": ((0.0, 1.25, 0.58, 0.36),),
}
# The nose by the faceframe: corners as shares (across in eye distances, down as a share of the way to the philtrum).
NOSE = ((-0.14, 0.05), (0.14, 0.05), (0.36, 0.62), (0.36, 0.85), (-0.36, 0.85), (-0.36, 0.62))
HALVES = 0.45  # of the way from the eyes to the philtrum: the line between upper and lower face
REGIONS = (WHOLE, "eyes", "brows", "mouth", "nose", "upper", "lower")


def region_mask(model: MorphModel, name: str) -> Mask:
    """Give the mask (h, w) of a region, or of several joined by "+", on the mean face.

    Raises `BadInput` for a name that is none of `REGIONS`, or a model that does not know where its eyes are.
    """
    masks = [_one(model, part.strip()) for part in name.split("+")]
    mask: Mask = np.maximum.reduce(masks)
    mask.setflags(write=False)
    return mask


def check_region(name: str) -> None:
    """Raise `BadInput` for a name that is none of `REGIONS`."""
    for part in name.split("+"):
        if part.strip() not in REGIONS:
            raise BadInput(
                f"there is no region {part.strip()!r}: choose of {', '.join(REGIONS)}, join several by +, or give a "
                "grey picture of the model's size"
            )


def _one(model: MorphModel, name: str) -> Mask:
    check_region(name)
    height, width = model.mask.shape
    if name == WHOLE:
        return np.ones((height, width), np.float32)
    frame = model.faceframe
    if frame is None:
        raise BadInput(
            f"{model.identity} has no keypoints, so nobody knows where its {name} is: run `morphspace keypoints` on "
            "it, or give a grey picture as the region"
        )
    if name in ("upper", "lower"):
        upper = _upper(frame, height, width)
        return upper if name == "upper" else 1 - upper
    to_px = _from_eyes(frame)
    if name == "nose":
        down = _eyes_to_philtrum(frame)
        return _filled([to_px(np.array([(x, y * down) for x, y in NOSE]))], 0.0, frame, height, width)
    if model.landmarks is not None:
        hulls = _landmark_hulls(model.landmarks.mean, name)
        return _filled(hulls, MARGINS[name], frame, height, width)
    return _filled([to_px(_ellipse(*one)) for one in ELLIPSES[name]], 0.0, frame, height, width)


def _landmark_hulls(mean: Points, name: str) -> list[Points]:
    group = {"eyes": "lids", "brows": "brows", "mouth": "outer lips"}[name]
    points = mean[landmark_places(group)]
    sides = [points] if name == "mouth" else [points[: len(points) // 2], points[len(points) // 2 :]]
    return [cv2.convexHull(side.astype(np.float32)).reshape(-1, 2).astype(np.float64) for side in sides]


def _eye_distance(frame: FaceFrame) -> float:
    return float(np.hypot(*np.subtract(frame.left_eye, frame.right_eye)))


def _from_eyes(frame: FaceFrame) -> Callable[[AnyArray], Points]:
    """Give what maps (x, y) in eye distances, from the middle of the eyes along the face's own axes, to px."""
    across = np.subtract(frame.left_eye, frame.right_eye)
    down = np.array([-across[1], across[0]])
    middle = np.add(frame.left_eye, frame.right_eye) / 2
    return lambda points: middle + points[:, :1] * across + points[:, 1:] * down


def _eyes_to_philtrum(frame: FaceFrame) -> float:
    """Give how far the philtrum lies below the eyes, in eye distances."""
    across = np.subtract(frame.left_eye, frame.right_eye)
    down = np.array([-across[1], across[0]]) / (across @ across)
    return float(np.subtract(frame.philtrum, np.add(frame.left_eye, frame.right_eye) / 2) @ down)


def _ellipse(x: float, y: float, half_width: float, half_height: float) -> AnyArray:
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return np.column_stack([x + half_width * np.cos(turn), y + half_height * np.sin(turn)])


def _filled(polygons: list[Points], margin: float, frame: FaceFrame, height: int, width: int) -> Mask:
    """Fill polygons (m, 2) px, grow them by a margin in eye distances, and soften the edge outwards from there."""
    unit = _eye_distance(frame)
    inside = np.zeros((height, width), np.uint8)
    for polygon in polygons:
        cv2.fillPoly(inside, [np.rint(polygon * 2**FINER).astype(np.int32)], 1, shift=FINER)
    # OpenCV's exact distance transform differs in its last bits from call to call; this one counts in whole numbers.
    distance = ndimage.distance_transform_edt(1 - inside)
    beyond = np.maximum(distance - margin * unit, 0)
    out: Mask = np.exp(-0.5 * (beyond / (SOFT * unit)) ** 2).astype(np.float32)
    return out


def _upper(frame: FaceFrame, height: int, width: int) -> Mask:
    """Give the upper face: a smooth step across the line between the halves."""
    unit = _eye_distance(frame)
    across = np.subtract(frame.left_eye, frame.right_eye) / unit
    down = np.array([-across[1], across[0]])
    middle = np.add(frame.left_eye, frame.right_eye) / 2
    y, x = np.mgrid[:height, :width].astype(np.float64)
    below = (x - middle[0]) * down[0] + (y - middle[1]) * down[1] - HALVES * _eyes_to_philtrum(frame) * unit
    out: Mask = (1 / (1 + np.exp(1.7 * below / (SOFT * unit)))).astype(
        np.float32
    )  # 1.7: near a Gaussian's edge
    return out
