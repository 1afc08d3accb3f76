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

REST_SHARE = (
    0.5  # of the motion the components cannot express; all of it carries the source's errors over too
)
REST_LIMIT = 0.06  # of the eye distance: what is added back bends towards it, so that no gain tears a face


@dataclass(frozen=True, eq=False)
class Unshown:
    """Adds a `share` (h, w) of what is missing; it bends towards `limit_px`: much is held back."""

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
        moved = np.empty_like(morph.displacement)
        for axis, rest in enumerate((right, down)):
            rest /= held
            np.add(morph.displacement[..., axis], rest, out=moved[..., axis])
        return Morph(unfolded(moved), morph.texture, morph.reference_id)


def unshown_of(target: MorphModel, seen: Mask) -> Unshown:
    """Prepare it for faces of `target`, inside its mask and where the source has something to say, `seen` (h, w).

    Raises `BadInput` where the model has no faceframe.
    """
    right, left, _ = required_faceframe(target).points
    return Unshown(
        np.float32(REST_SHARE) * (seen * target.mask), REST_LIMIT * float(np.hypot(*(left - right)))
    )
