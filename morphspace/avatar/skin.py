"""Find the visible face in a mean face: inside its outline, and skin where another person has hair (ours).

An ellipse over the face includes background beside the jaw, and hair over one forehead would show through all others.
The outline is that of the face mesh. Hair is recognised by being much darker than the person's own skin, and is
looked for above the brows only, where nothing else of a face is dark.
"""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.face.mesh import FACE_OUTLINE, LEFT_BROW, RIGHT_BROW
from morphspace.flow.baselines import LUMA
from morphspace.model.keypoints import landmarks_of
from morphspace.model.model import MorphModel

INSIDE_OUTLINE = 0.04  # of the width: how far inside the outline the blend ends
SOFT = 0.015  # of the width, sd of the edge of hair
EDGE = 0.03  # of the width, sd of the edge of the blend: skin of two people meets there
ABOVE_BROWS = 0.02  # of the height, from the brows' upper edge to where hair is looked for
HAIR, SKIN = (
    0.65,
    0.85,
)  # of the luma of a person's skin: darker than the first is hair, lighter than the second skin
AROUND_HAIR = 0.02  # of the width: hair is thinner at its ends than its colour tells
SUBPIXEL = 4  # bits


def inside_outline(model: MorphModel) -> Mask | None:
    """Return a soft mask (h, w) inside the outline of a mean face; None where its mesh points are not known."""
    points = landmarks_of(model)
    if points is None:
        return None
    height, width = model.mask.shape
    outline = filled(points[list(FACE_OUTLINE)], height, width)
    # Beyond the picture there is face: a chin that touches the edge keeps its mask there.
    smaller = cv2.erode(outline, disc(INSIDE_OUTLINE * width), borderType=cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(smaller, (0, 0), EDGE * width, borderType=cv2.BORDER_REPLICATE)


def skin_share(home: MorphModel, texture: Image, mask: Mask) -> Mask:
    """Return the share of skin (h, w) in a texture on the mean face of `home`: 0 is hair over the forehead.

    All ones where the mesh points of `home` are not known, or the mask (h, w) is empty.
    """
    height, width = mask.shape
    points = landmarks_of(home)
    share = np.ones((height, width), np.float32)
    if points is None or not (mask > 0.5).any():
        return share
    luma = cv2.GaussianBlur(texture @ LUMA, (0, 0), SOFT * width / 2)
    own = float(np.median(luma[mask > 0.5]))
    if own <= 0:
        return share
    like_skin = np.clip((luma / own - HAIR) / (SKIN - HAIR), 0, 1).astype(np.float32)
    forehead = _forehead(points, height, width)
    share -= forehead * (1 - like_skin)
    share = cv2.erode(share, disc(AROUND_HAIR * width), borderType=cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(share, (0, 0), SOFT * width, borderType=cv2.BORDER_REPLICATE)


def _forehead(points: AnyArray, height: int, width: int) -> Mask:
    """Return the region above the brows, (h, w) 0 or 1: above a line through their upper edges, level beyond them."""
    brows = points[[*RIGHT_BROW[:5], *LEFT_BROW[:5]]]
    order = brows[:, 0].argsort(kind="stable")
    edge = np.interp(np.arange(width), brows[order, 0], brows[order, 1]) - ABOVE_BROWS * height
    return (np.arange(height)[:, None] < edge).astype(np.float32)


def filled(points: AnyArray, height: int, width: int) -> Mask:
    """Fill a polygon (m, 2) px: (h, w), 1 inside, smooth at its edge."""
    canvas = np.zeros((height, width), np.uint8)
    cv2.fillPoly(canvas, [np.round(points * 2**SUBPIXEL).astype(np.int32)], 255, cv2.LINE_AA, SUBPIXEL)
    return (canvas / np.float32(255)).astype(np.float32)


def disc(radius_px: float) -> AnyArray:
    """Return a disc for dilation and erosion, with a radius of at least 1 px."""
    side = 2 * max(1, round(radius_px)) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
