"""Motion outside the model's components, of which a share is added to the face (ours).

The motion comes from another person, and with it that person's errors. So a share is added, limited in length, inside
the face, and without folds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Mask
from morphspace.flow.folds import unfolded
from morphspace.model.keypoints import required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph

RESIDUAL_SHARE = 0.5  # of the missing motion; 1 would carry over all of the source's errors
RESIDUAL_LIMIT = 0.06  # eye distances, of the added motion, so that no gain tears a face


@dataclass(frozen=True, eq=False)
class ResidualMotion:
    """Adds a share of the missing motion to a face.

    Attributes
    ----------
    share : array (h, w)
        Share of the motion at each point.
    limit_px : float
        Limit that the added length approaches.
    """

    share: AnyArray
    limit_px: float

    def added(self, missing: Displacement, morph: Morph) -> Morph:
        """Return the face with its share of the `missing` motion (h, w, 2) px, without folds."""
        right, down = (self.share * missing[..., axis] for axis in (0, 1))
        shrink = right * right  # the last bits of cv2.magnitude depend on memory alignment
        shrink += down * down
        shrink *= np.float32(1 / self.limit_px**2)
        shrink += 1
        np.sqrt(shrink, out=shrink)
        moved = np.empty_like(missing)
        for axis, part in enumerate((right, down)):
            part /= shrink
            np.add(morph.displacement[..., axis], part, out=moved[..., axis])
        return Morph.of(morph.texture, unfolded(moved), morph.reference_id)


def residual_motion_of(target: MorphModel, source_mask: Mask) -> ResidualMotion:
    """Prepare the residual motion for faces of `target`.

    Parameters
    ----------
    target : MorphModel
    source_mask : array (h, w)
        The source's mask on the target's mean face (`Projection.source_mask`).

    Raises
    ------
    BadInput
        If the model has no faceframe.
    """
    right, left, _ = required_faceframe(target).points
    eyes_px = float(np.hypot(*(left - right)))
    return ResidualMotion(np.float32(RESIDUAL_SHARE) * (source_mask * target.mask), RESIDUAL_LIMIT * eyes_px)
