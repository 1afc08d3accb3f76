"""The motion that a model's components cannot show, a share of which is added to the face all the same (ours).

Mimicry carries it over from another person, so that it holds that person's errors too. It is added as far as it is
small, inside the face, and never so that skin folds over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Mask
from morphspace.flow.folds import unfolded
from morphspace.model.keypoints import required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph

RESIDUAL_SHARE = 0.5  # of that motion; all of it carries the source's errors over too
RESIDUAL_LIMIT = 0.06  # of the eye distance: what is added bends towards it, so that no gain tears a face


@dataclass(frozen=True, eq=False)
class ResidualMotion:
    """Adds a `share` (h, w) of the motion that is missing; it bends towards `limit_px`: much is held back."""

    share: AnyArray
    limit_px: float

    def added(self, missing: Displacement, morph: Morph) -> Morph:
        """Give the face with its share of what is `missing` (h, w, 2) px, without folds."""
        right, down = (self.share * missing[..., axis] for axis in (0, 1))
        held = right * right  # cv2.magnitude differs in its last bits with where the memory lies
        held += down * down
        held *= np.float32(1 / self.limit_px**2)
        held += 1
        np.sqrt(held, out=held)
        moved = np.empty_like(missing)
        for axis, part in enumerate((right, down)):
            part /= held
            np.add(morph.displacement[..., axis], part, out=moved[..., axis])
        return Morph.of(morph.texture, unfolded(moved), morph.reference_id)


def residual_motion_of(target: MorphModel, seen: Mask) -> ResidualMotion:
    """Prepare it for faces of `target`, inside its mask and where the source has something to say, `seen` (h, w).

    Raises `BadInput` where the model has no faceframe.
    """
    right, left, _ = required_faceframe(target).points
    eyes_px = float(np.hypot(*(left - right)))
    return ResidualMotion(np.float32(RESIDUAL_SHARE) * (seen * target.mask), RESIDUAL_LIMIT * eyes_px)
