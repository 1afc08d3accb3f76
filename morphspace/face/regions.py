"""Which mask a model gets: one that was drawn, else an ellipse over the face, and where it stands (ours)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import Displacement, Mask
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame, face_mask
from morphspace.face.mesh import FacePoints
from morphspace.grid import warp

OVERLAP = 0.6  # intersection over union of the usual ellipse with that of the face found, at which the usual one fits


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
