"""All masks of the face: soft ellipses, named parts, and the mask of a model (ours).

A mask is (h, w) in [0, 1], 1 inside. Three are ellipses, on any frame: the face, its rigid part for registration (Nagle
section 2), and the surroundings of the mouth. They are placed by a faceframe, or where a frame cropped to a face
usually has them. The named parts (`REGIONS`) lie on a mean face; verbs accept these words and no others. They
are drawn around the landmarks where a model has them, else by usual proportions from its faceframe.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np
from scipy import ndimage

from morphspace.arrays import AnyArray, Displacement, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import FacePoints, landmark_places
from morphspace.grid import warp

# Where a face stands in a frame cropped to it, as shares of the frame's width and height: centre x, y, half axes x, y.
FACE_ELLIPSE = (0.50, 0.52, 0.37, 0.42)
RIGID_ELLIPSE = (0.50, 0.48, 0.27, 0.19)  # brow to nose
MOUTH_ELLIPSE = (0.50, 0.77, 0.19, 0.11)  # below the nostrils, which are dark too
# The same, measured from a faceframe: in eye-to-eye distances (x) and eye-to-philtrum distances (y).
FACE_FROM_FACEFRAME = (0.0, 0.55, 1.25, 2.0)
RIGID_FROM_FACEFRAME = (0.0, 0.15, 1.0, 0.75)
MOUTH_FROM_FACEFRAME = (0.0, 1.4, 0.6, 0.5)
SOFT_EDGE = 0.15  # of the radius, over which an ellipse falls from 1 to 0
OVERLAP = 0.6  # intersection over union of the usual ellipse with that of the face found, at which the usual one fits

WHOLE = "whole"
REGIONS = (WHOLE, "eyes", "brows", "mouth", "nose", "upper", "lower")
"""The words for a part of the face; several are joined by "+"."""
SOFT = 0.08  # eye distances: sd of a part's edge, so that neither warp nor colour gets a seam
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


def face_mask(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Return a soft ellipse over the face, (h, w): by the faceframe, else where a cropped face stands."""
    return _soft_ellipse(height, width, FACE_ELLIPSE, FACE_FROM_FACEFRAME, faceframe)


def rigid_region(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Return a soft ellipse over the part of the face that moves with the skull, brow to nose, (h, w)."""
    return _soft_ellipse(height, width, RIGID_ELLIPSE, RIGID_FROM_FACEFRAME, faceframe)


def mouth_surroundings(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Return a soft ellipse over where the mouth may be in any frame of a clip, open or closed, (h, w).

    It is wider than the part "mouth" of `region_mask`, which lies around the lips of one mean face.
    """
    return _soft_ellipse(height, width, MOUTH_ELLIPSE, MOUTH_FROM_FACEFRAME, faceframe)


def check_region(name: str) -> None:
    """Raise `BadInput` for a name that is none of `REGIONS`, nor several joined by "+"."""
    for part in name.split("+"):
        if part.strip() not in REGIONS:
            raise BadInput(
                f"there is no region {part.strip()!r}: choose of {', '.join(REGIONS)}, join several by +, or give a "
                "grey picture of the model's size"
            )


def region_mask(
    name: str, height: int, width: int, faceframe: FaceFrame | None, landmarks: Points | None = None
) -> Mask:
    """Return the mask of a part of a mean face, or of several.

    Parameters
    ----------
    name
        One of `REGIONS`, or several joined by "+".
    height, width
        Size of the mean face, px.
    faceframe
        The three points on the mean face; only "whole" can do without.
    landmarks
        (m, 2) px on the mean face in the order of `mesh.LANDMARKS`, or None where they are not known. Eyes, brows and
        mouth are drawn around them.

    Returns
    -------
    (h, w) in [0, 1], read-only: 1 inside, falling off over some hundredths of the eye distance.

    Raises
    ------
    BadInput
        The name is no region, or `faceframe` is None.
    """
    check_region(name)
    parts = [part.strip() for part in name.split("+")]
    mask: Mask = np.maximum.reduce([_part(part, height, width, faceframe, landmarks) for part in parts])
    mask.setflags(write=False)
    return mask


def _part(name: str, height: int, width: int, frame: FaceFrame | None, landmarks: Points | None) -> Mask:
    if name == WHOLE:
        return np.ones((height, width), np.float32)
    if frame is None:
        raise BadInput(
            f"the model has no keypoints, so it is not known where its {name} is: run `morphspace keypoints` on it, or "
            "give a grey picture as the region"
        )
    if name in ("upper", "lower"):
        upper = _upper(frame, height, width)
        return upper if name == "upper" else 1 - upper
    to_px = _from_eyes(frame)
    if name == "nose":
        down = _eyes_to_philtrum(frame)
        return _filled([to_px(np.array([(x, y * down) for x, y in NOSE]))], 0.0, frame, height, width)
    if landmarks is not None:
        return _filled(_landmark_hulls(landmarks, name), MARGINS[name], frame, height, width)
    return _filled([to_px(_ellipse(*one)) for one in ELLIPSES[name]], 0.0, frame, height, width)


def place_of_mask(face: FacePoints | None, height: int, width: int, overlap: float) -> FaceFrame | None:
    """Give what places the ellipse on the reference: the face found there, None for where a cropped face stands.

    The usual ellipse takes in more of forehead and chin, and held-out frames come back a little better with it, so it
    stays where it overlaps with that of the face by `overlap` (intersection over union) or more.
    """
    if face is None:
        return None
    found, usual = face_mask(height, width, face.faceframe()), face_mask(height, width)
    shared = float(np.minimum(found, usual).sum()) / float(np.maximum(found, usual).sum())
    return None if shared >= overlap else face.faceframe()


def origin_of_mask(drawn: Mask | None, marked: FaceFrame | None, placed: FaceFrame | None) -> str:
    """Say for the provenance where the mask came from: `given`, `faceframe`, `found face` or `ellipse`."""
    if drawn is not None:
        return "given"
    if marked is not None:
        return "faceframe"
    return "ellipse" if placed is None else "found face"


def mask_on_mean(drawn: Mask | None, mean_inverse: Displacement, faceframe: FaceFrame | None) -> Mask:
    """Carry the mask (h, w) from the reference to the mean face; an ellipse where none was drawn there.

    Raises `BadInput` for one that is 0 everywhere.
    """
    if drawn is None:
        height, width = mean_inverse.shape[:2]
        return face_mask(height, width, faceframe)
    mask = np.clip(warp.sample_field(drawn.astype(np.float32), mean_inverse), 0, 1)
    if not mask.any():
        raise BadInput("the mask is empty (0 everywhere): paint the face white")
    return mask


def _soft_ellipse(
    height: int,
    width: int,
    of_frame: tuple[float, float, float, float],
    of_faceframe: tuple[float, float, float, float],
    faceframe: FaceFrame | None,
) -> Mask:
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if faceframe is None:
        centre_x, centre_y, half_x, half_y = np.array(of_frame) * (width, height, width, height)
        across, down = x - centre_x, y - centre_y
    else:
        right, left, lip = faceframe.points
        eyes = (right + left) / 2
        axis_x, axis_y = left - right, lip - eyes
        unit_x, unit_y = axis_x / np.hypot(*axis_x), axis_y / np.hypot(*axis_y)
        half_x, half_y = of_faceframe[2] * np.hypot(*axis_x), of_faceframe[3] * np.hypot(*axis_y)
        centre = eyes + of_faceframe[0] * axis_x + of_faceframe[1] * axis_y
        across = (x - centre[0]) * unit_x[0] + (y - centre[1]) * unit_x[1]
        down = (x - centre[0]) * unit_y[0] + (y - centre[1]) * unit_y[1]
    radius = np.sqrt((across / half_x) ** 2 + (down / half_y) ** 2)
    return np.clip((1 - radius) / SOFT_EDGE + 0.5, 0, 1).astype(np.float32)


def _landmark_hulls(landmarks: Points, name: str) -> list[Points]:
    group = {"eyes": "lids", "brows": "brows", "mouth": "outer lips"}[name]
    points = landmarks[landmark_places(group)]
    sides = [points] if name == "mouth" else [points[: len(points) // 2], points[len(points) // 2 :]]
    return [cv2.convexHull(side.astype(np.float32)).reshape(-1, 2).astype(np.float64) for side in sides]


def _eye_distance(frame: FaceFrame) -> float:
    return float(np.hypot(*np.subtract(frame.left_eye, frame.right_eye)))


def _from_eyes(frame: FaceFrame) -> Callable[[AnyArray], Points]:
    """Return what maps (x, y) in eye distances, from the middle of the eyes along the face's own axes, to px."""
    across = np.subtract(frame.left_eye, frame.right_eye)
    down = np.array([-across[1], across[0]])
    middle = np.add(frame.left_eye, frame.right_eye) / 2
    return lambda points: middle + points[:, :1] * across + points[:, 1:] * down


def _eyes_to_philtrum(frame: FaceFrame) -> float:
    """Return how far the philtrum lies below the eyes, in eye distances."""
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
    """Return the upper face: a smooth step across the line between the halves."""
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
