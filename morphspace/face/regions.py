"""Masks of the face: soft ellipses, named parts, and the mask of a model (ours).

A mask is (h, w) in [0, 1], 1 inside. Three ellipses exist for any frame: the face, its rigid part for registration
(Nagle et al., section 2), and the surroundings of the mouth. A faceframe places them, else the usual position in a
frame cropped to a face. The named parts (`REGIONS`) lie on a mean face. They follow the landmarks if the model has
them, else the usual proportions from its faceframe. Commands accept these names alone.

For an avatar, a blend ends inside the outline of a mean face, because an ellipse includes background beside the jaw.
Hair over one forehead would show through all others. It is recognised by being much darker than the person's own skin,
and is looked for above the brows only, where nothing else of a face is dark.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np
from scipy import ndimage

from morphspace.arrays import AnyArray, Displacement, Image, Mask, Points
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import (
    FACE_OUTLINE,
    LEFT_BROW,
    RIGHT_BROW,
    FacePoints,
    landmark_places,
)
from morphspace.face.rims import OPENINGS
from morphspace.flow.baselines import LUMA
from morphspace.grid import warp

# Ellipses in a frame cropped to a face, in shares of its width and height: centre x, y, half axes x, y.
FACE_ELLIPSE = (0.50, 0.52, 0.37, 0.42)
RIGID_ELLIPSE = (0.50, 0.48, 0.27, 0.19)  # brow to nose
MOUTH_ELLIPSE = (0.50, 0.77, 0.19, 0.11)  # below the nostrils, which are dark as a mouth is
# The same from a faceframe, in eye-to-eye distances (x) and eye-to-philtrum distances (y).
FACE_FROM_FACEFRAME = (0.0, 0.55, 1.25, 2.0)
RIGID_FROM_FACEFRAME = (0.0, 0.15, 1.0, 0.75)
MOUTH_FROM_FACEFRAME = (0.0, 1.4, 0.6, 0.5)
SOFT_EDGE = 0.15  # share of the radius over which an ellipse falls from 1 to 0
# Intersection over union with the detected face's ellipse, from which the usual ellipse is kept
OVERLAP = 0.6

WHOLE = "whole"
REGIONS = (WHOLE, "eyes", "brows", "mouth", "nose", "upper", "lower")
"""Names of parts of the face; several are joined by "+"."""
SOFT = 0.08  # eye distances, SD of a part's edge; avoids seams in warp and colour
FINER = 4  # fractional bits of a polygon's corners in OpenCV
# Eye distances that a part extends beyond the hull of its landmarks.
MARGINS = {"eyes": 0.12, "brows": 0.06, "mouth": 0.14}
# From the faceframe alone: ellipses (x, y, half width, half height) in eye distances, x from the middle of the eyes to
# the subject's left, y down. The philtrum is near (0, 0.95).
ELLIPSES: Mapping[str, tuple[tuple[float, float, float, float], ...]] = {
    "eyes": ((-0.5, 0.0, 0.36, 0.24), (0.5, 0.0, 0.36, 0.24)),
    "brows": ((-0.5, -0.38, 0.46, 0.18), (0.5, -0.38, 0.46, 0.18)),
    "mouth": ((0.0, 1.25, 0.58, 0.36),),
}
# Corners of the nose from the faceframe: across in eye distances, down as a share of the distance to the philtrum.
NOSE = ((-0.14, 0.05), (0.14, 0.05), (0.36, 0.62), (0.36, 0.85), (-0.36, 0.85), (-0.36, 0.62))
HALVES = 0.45  # share of the distance from eyes to philtrum at which upper and lower face meet
# The same share; between these places the colours of the upper part blend into those of the lower, without a seam.
UPPER_FROM, LOWER_FROM = 0.35, 0.70

# Of an avatar, in shares of the width where nothing else is said. An edge is the SD of its blur.
INSIDE_OUTLINE = 0.04  # how far inside the outline a blend ends
OUTLINE_EDGE = 0.03  # there the skin of two people meets
# Of the median luma of a person's skin: hair is below the first, skin above the second
HAIR, SKIN = 0.65, 0.85
HAIR_EDGE = 0.015
AROUND_HAIR = 0.02  # hair is thinner at its ends than its colour tells
ABOVE_BROWS = 0.02  # of the height, from the upper edge of the brows to where hair is looked for
AROUND_LIPS = 0.03  # how far around the lips an expression has its own correspondence
LIPS_EDGE = 0.015
NEXT_TO_MASK = 0.05  # how far around the mask motion still follows the face


def face_mask(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Return a soft ellipse over the face, (h, w): placed by the faceframe, or else for a cropped face.

    Examples
    --------
    >>> mask = face_mask(72, 60)
    >>> mask.shape, mask[37, 30].item(), mask[0, 0].item()
    ((72, 60), 1.0, 0.0)
    """
    return _soft_ellipse(height, width, FACE_ELLIPSE, FACE_FROM_FACEFRAME, faceframe)


def rigid_region(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Return a soft ellipse from brow to nose, the part that moves with the skull, (h, w).

    Examples
    --------
    >>> region = rigid_region(72, 60)
    >>> region[34, 30].item(), region[60, 30].item()
    (1.0, 0.0)
    """
    return _soft_ellipse(height, width, RIGID_ELLIPSE, RIGID_FROM_FACEFRAME, faceframe)


def mouth_surroundings(height: int, width: int, faceframe: FaceFrame | None = None) -> Mask:
    """Return a soft ellipse over all positions of an open or closed mouth in a clip, (h, w).

    It is wider than the part "mouth" of `region_mask`, which surrounds the lips of one mean face.

    Examples
    --------
    >>> region = mouth_surroundings(72, 60)
    >>> region[55, 30].item(), region[34, 30].item()
    (1.0, 0.0)
    """
    return _soft_ellipse(height, width, MOUTH_ELLIPSE, MOUTH_FROM_FACEFRAME, faceframe)


def lower_share(height: int, width: int, faceframe: FaceFrame) -> Mask:
    """Return the share of the lower face in each point of a mean face, (h, w): a ramp from eyes to philtrum.

    It is wider than the edge between "upper" and "lower" of `region_mask`: colours are mixed across it.

    Examples
    --------
    >>> share = lower_share(72, 60, FaceFrame((20.0, 30.0), (40.0, 30.0), (30.0, 70.0)))
    >>> share[[30, 51, 70], 30].round(2).tolist()
    [0.0, 0.5, 1.0]
    """
    right, left, lip = faceframe.points
    eyes = (right + left) / 2
    down = (lip - eyes) / float((lip - eyes) @ (lip - eyes))
    y, x = np.mgrid[:height, :width]
    along = (x - eyes[0]) * down[0] + (y - eyes[1]) * down[1]
    ramp = np.clip((along - UPPER_FROM) / (LOWER_FROM - UPPER_FROM), 0, 1)
    return (ramp * ramp * (3 - 2 * ramp)).astype(np.float32)


def _check_region(name: str) -> None:
    """Check that a name is one of `REGIONS`, or several joined by "+". Raises `BadInput` otherwise."""
    for part in name.split("+"):
        if part.strip() not in REGIONS:
            raise BadInput(
                f"the region is {part.strip()!r}; expected one of {', '.join(REGIONS)}, or several joined by +. Or "
                "give a grey picture of the model's size"
            )


def region_mask(
    name: str, height: int, width: int, faceframe: FaceFrame | None, landmarks: Points | None = None
) -> Mask:
    """Draw the mask of one or several parts of a mean face.

    Parameters
    ----------
    name : str
        One of `REGIONS`, or several joined by "+".
    height, width : int
        Size of the mean face, px.
    faceframe : FaceFrame or None
        The three points on the mean face; only "whole" needs none.
    landmarks : array (m, 2) px, optional
        On the mean face, in the order of `mesh.LANDMARKS`. Eyes, brows and mouth are drawn around them.

    Returns
    -------
    array (h, w) in [0, 1], read-only
        1 inside, with an edge of some hundredths of the eye distance.

    Raises
    ------
    BadInput
        If the name is no region, or the faceframe is missing.

    Examples
    --------
    >>> frame = FaceFrame((20.0, 30.0), (40.0, 30.0), (30.0, 46.0))
    >>> mask = region_mask("eyes + mouth", 72, 60, frame)
    >>> mask.shape, mask[30, 20].item(), mask[55, 30].item(), mask[0, 0].item()
    ((72, 60), 1.0, 1.0, 0.0)
    """
    _check_region(name)
    parts = [part.strip() for part in name.split("+")]
    mask: Mask = np.maximum.reduce([_part(part, height, width, faceframe, landmarks) for part in parts])
    mask.setflags(write=False)
    return mask


def _part(name: str, height: int, width: int, frame: FaceFrame | None, landmarks: Points | None) -> Mask:
    if name == WHOLE:
        return np.ones((height, width), np.float32)
    if frame is None:
        raise BadInput(
            f"the model has no keypoints; its region {name} needs them. Run `morphspace keypoints` on it, or give a "
            "grey picture as the region"
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


def place_of_mask(face: FacePoints | None, height: int, width: int) -> FaceFrame | None:
    """Return the faceframe that places the ellipse on the reference; None for that of a cropped face.

    The ellipse of a cropped face covers more of forehead and chin, and held-out frames are reconstructed slightly
    better with it. It is kept if its intersection over union with the detected face's ellipse is `OVERLAP` or more.
    """
    if face is None:
        return None
    found, usual = face_mask(height, width, face.faceframe()), face_mask(height, width)
    shared = float(np.minimum(found, usual).sum()) / float(np.maximum(found, usual).sum())
    return None if shared >= OVERLAP else face.faceframe()


def origin_of_mask(drawn: Mask | None, marked: FaceFrame | None, placed: FaceFrame | None) -> str:
    """Return the origin of the mask for the provenance: `given`, `faceframe`, `found face` or `ellipse`."""
    if drawn is not None:
        return "given"
    if marked is not None:
        return "faceframe"
    return "ellipse" if placed is None else "found face"


def mask_on_mean(drawn: Mask | None, mean_inverse: Displacement, faceframe: FaceFrame | None) -> Mask:
    """Carry the mask (h, w) from the reference to the mean face, or draw an ellipse there if none was drawn.

    Raises
    ------
    BadInput
        If the mask is 0 everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> drawn = np.zeros((4, 4))
    >>> drawn[1:3, 1:3] = 1
    >>> mask_on_mean(drawn, np.zeros((4, 4, 2), np.float32), None).sum().item()
    4.0
    """
    if drawn is None:
        height, width = mean_inverse.shape[:2]
        return face_mask(height, width, faceframe)
    mask = np.clip(warp.sample_field(drawn.astype(np.float32), mean_inverse), 0, 1)
    if not mask.any():
        raise BadInput("the mask is empty (0 everywhere); expected white inside the face. Draw it again")
    return mask


def inside_outline(points: Points, height: int, width: int) -> Mask:
    """Draw a soft mask (h, w) inside the outline of a face.

    Parameters
    ----------
    points : array (478, 2) px
        The points of the face mesh.
    height, width : int
        Size of the picture, px.

    Returns
    -------
    array (h, w) in [0, 1]
    """
    outline = _polygon(points[list(FACE_OUTLINE)], height, width)
    # Beyond the picture there is face: a chin that touches the edge keeps its mask there.
    smaller = cv2.erode(outline, _disc(INSIDE_OUTLINE * width), borderType=cv2.BORDER_REPLICATE)
    return _blurred(smaller, OUTLINE_EDGE * width)


def inside_openings(points: Points, height: int, width: int) -> Mask:
    """Draw a mask (h, w) of what lies between the lips and between the lids of a face `points` (478, 2) px.

    Examples
    --------
    >>> import numpy as np
    >>> turn = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    >>> points = np.zeros((478, 2))
    >>> points[list(OPENINGS[0])] = np.array([30, 50]) + 8 * np.column_stack([np.cos(turn), np.sin(turn)])
    >>> mask = inside_openings(points, 72, 60)
    >>> mask[50, 30].item(), mask[30, 30].item()
    (1.0, 0.0)
    """
    out: Mask = np.maximum.reduce([_polygon(points[list(ring)], height, width) for ring in OPENINGS])
    return out


def skin_share(points: Points, texture: Image, mask: Mask) -> Mask:
    """Compute the share of skin in a texture: 0 is hair over the forehead, 1 everything else.

    Parameters
    ----------
    points : array (478, 2) px
        The points of the face mesh on the texture.
    texture : array (h, w, 3)
    mask : array (h, w)
        The face; its median luma is that of the person's skin.

    Returns
    -------
    array (h, w) in [0, 1]
        All ones if the mask is empty.
    """
    height, width = mask.shape
    share = np.ones((height, width), np.float32)
    if not (mask > 0.5).any():
        return share
    luma = cv2.GaussianBlur(texture @ LUMA, (0, 0), HAIR_EDGE * width / 2)
    own = float(np.median(luma[mask > 0.5]))
    if own <= 0:
        return share
    like_skin = np.clip((luma / own - HAIR) / (SKIN - HAIR), 0, 1).astype(np.float32)
    share -= _forehead(points, height, width) * (1 - like_skin)
    share = cv2.erode(share, _disc(AROUND_HAIR * width), borderType=cv2.BORDER_REPLICATE)
    return _blurred(share, HAIR_EDGE * width)


def lips_region(lips: Points, height: int, width: int) -> Mask:
    """Draw a soft mask (h, w) of the lips and what lies between them, from points (m, 2) px on the lips.

    Examples
    --------
    >>> import numpy as np
    >>> region = lips_region(np.array([[20.0, 50], [40, 50], [30, 60]]), 72, 60)
    >>> round(region[53, 30].item(), 2), region[20, 30].item()
    (1.0, 0.0)
    """
    mouth = _polygon(cv2.convexHull(lips.astype(np.float32))[:, 0], height, width)
    return _blurred(cv2.dilate(mouth, _disc(AROUND_LIPS * width)), LIPS_EDGE * width)


def widened(mask: Mask) -> Mask:
    """Widen and soften a mask (h, w): 1 inside, falling to 0 at some distance.

    Examples
    --------
    >>> import numpy as np
    >>> mask = np.zeros((40, 40), np.float32)
    >>> mask[15:25, 15:25] = 1
    >>> wide = widened(mask)
    >>> wide[20, 20].item(), wide[20, 14].item() > 0.5, wide[0, 0].item()
    (1.0, True, 0.0)
    """
    sd_px = NEXT_TO_MASK * mask.shape[1]
    side = 2 * round(sd_px) + 1
    wide = cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
    out: Mask = np.maximum(mask, _blurred(wide, sd_px / 2))
    return out


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
    """Return the function from (x, y) in eye distances, from the middle of the eyes along the face's axes, to px."""
    across = np.subtract(frame.left_eye, frame.right_eye)
    down = np.array([-across[1], across[0]])
    middle = np.add(frame.left_eye, frame.right_eye) / 2
    return lambda points: middle + points[:, :1] * across + points[:, 1:] * down


def _eyes_to_philtrum(frame: FaceFrame) -> float:
    """Measure the distance of the philtrum below the eyes, in eye distances."""
    across = np.subtract(frame.left_eye, frame.right_eye)
    down = np.array([-across[1], across[0]]) / (across @ across)
    return float(np.subtract(frame.philtrum, np.add(frame.left_eye, frame.right_eye) / 2) @ down)


def _ellipse(x: float, y: float, half_width: float, half_height: float) -> AnyArray:
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return np.column_stack([x + half_width * np.cos(turn), y + half_height * np.sin(turn)])


def _filled(polygons: list[Points], margin: float, frame: FaceFrame, height: int, width: int) -> Mask:
    """Fill polygons (m, 2) px, grow them by a margin in eye distances, and soften the edge outside."""
    unit = _eye_distance(frame)
    inside = np.zeros((height, width), np.uint8)
    for polygon in polygons:
        cv2.fillPoly(inside, [np.rint(polygon * 2**FINER).astype(np.int32)], 1, shift=FINER)
    # The last bits of OpenCV's exact distance transform differ between calls; this one uses integers.
    distance = ndimage.distance_transform_edt(1 - inside)
    beyond = np.maximum(distance - margin * unit, 0)
    out: Mask = np.exp(-0.5 * (beyond / (SOFT * unit)) ** 2).astype(np.float32)
    return out


def _upper(frame: FaceFrame, height: int, width: int) -> Mask:
    """Draw the upper face: a smooth step across the line between the halves."""
    unit = _eye_distance(frame)
    across = np.subtract(frame.left_eye, frame.right_eye) / unit
    down = np.array([-across[1], across[0]])
    middle = np.add(frame.left_eye, frame.right_eye) / 2
    y, x = np.mgrid[:height, :width].astype(np.float64)
    below = (x - middle[0]) * down[0] + (y - middle[1]) * down[1] - HALVES * _eyes_to_philtrum(frame) * unit
    out: Mask = (1 / (1 + np.exp(1.7 * below / (SOFT * unit)))).astype(
        np.float32
    )  # 1.7 approximates a Gaussian edge
    return out


def _forehead(points: Points, height: int, width: int) -> Mask:
    """Return the region above the brows, (h, w) 0 or 1: above a line through their upper edges, level beyond them."""
    brows = points[[*RIGHT_BROW[:5], *LEFT_BROW[:5]]]
    order = brows[:, 0].argsort(kind="stable")
    edge = np.interp(np.arange(width), brows[order, 0], brows[order, 1]) - ABOVE_BROWS * height
    return (np.arange(height)[:, None] < edge).astype(np.float32)


def _polygon(points: Points, height: int, width: int) -> Mask:
    """Fill a polygon (m, 2) px: (h, w), 1 inside, smooth at its edge."""
    canvas = np.zeros((height, width), np.uint8)
    cv2.fillPoly(canvas, [np.round(points * 2**FINER).astype(np.int32)], 255, cv2.LINE_AA, FINER)
    return (canvas / np.float32(255)).astype(np.float32)


def _disc(radius_px: float) -> AnyArray:
    """Return a disc for dilation and erosion, with a radius of at least 1 px."""
    side = 2 * max(1, round(radius_px)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def _blurred(mask: Mask, sd_px: float) -> Mask:
    return cv2.GaussianBlur(mask, (0, 0), sd_px, borderType=cv2.BORDER_REPLICATE)
