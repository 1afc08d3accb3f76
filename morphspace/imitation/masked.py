"""Loadings from a part of the face: the posterior mean under the model's probabilistic PCA within a mask (ours)."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput
from morphspace.linear.pca import Basis
from morphspace.linear.posterior import Posterior

# Neighbouring pixels and the colours of one err together: one number in so many is independent, and the rest must not
# make a faint component look certain. Of 1, 10, 100 and 1000, tried on held-out frames and on another person's, 1 let
# the eyes of the other go to 39 SD and 1000 halved the motion; 100 agreed with the whole face as well as 1 did.
ONE_IN = 100.0


def masked_basis(basis: Basis, share: AnyArray) -> Posterior:
    """See a basis through a part of the face; `share` (d,) in [0, 1] says how much of each number counts.

    Raises `BadInput` where nothing of the face is left, or the model has no component.
    """
    weight = np.asarray(basis.weight * share, np.float32)
    if not weight.any():
        raise BadInput("the mask leaves nothing of the model's face: make it white where the face is")
    return Posterior(basis, weight, ONE_IN)
