"""Loadings from a part of the face: the posterior mean under the model's probabilistic PCA within a mask (ours).

Components are orthonormal over the whole face and not over a part of it, so an inner product over the part alone would
mix them. With C the part's weights and P the components, l = (P^T C P + s^2 diag(1 / variances))^-1 P^T C r
(Tipping and Bishop, Probabilistic principal component analysis, 1999; methods 5.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.linear.pca import Basis
from morphspace.linear.rows import column_ranges

# Neighbouring pixels and the colours of one err together: one number in so many is independent, and the rest must not
# make a faint component look certain. Of 1, 10, 100 and 1000, tried on held-out frames and on another person's, 1 let
# the eyes of the other go to 39 SD and 1000 halved the motion; 100 agreed with the whole face as well as 1 did.
ONE_IN = 100
NOISE_FLOOR = 1e-3  # of the least variance, where a model leaves nothing out


@dataclass(frozen=True, eq=False)
class MaskedBasis:
    """A basis seen through a part of the face: `weight` (d,) of the part, `gram` (k, k) = P^T C P, `noise` = s^2."""

    basis: Basis
    weight: AnyArray
    gram: AnyArray
    noise: float

    @property
    def visible_share(self) -> AnyArray:
        """How much of each component the part shows, (k,), 1 is all of it."""
        return np.asarray(np.diag(self.gram))

    def project(self, offset: AnyArray) -> LoadingTable:
        """Give the loadings (k,) of a mean-relative vector (d,), from the part alone."""
        return self._solved(self.basis.components @ (self.weight * offset))

    def seen(self, loadings: LoadingTable) -> LoadingTable:
        """Give what the part shows of faces known by their loadings (n, k): the projection of what they expand to."""
        return self._solved((loadings @ self.gram).T).T

    def _solved(self, products: AnyArray) -> AnyArray:
        system = self.gram + np.diag(self.noise / self.basis.variances)
        return np.asarray(np.linalg.solve(system, np.asarray(products, np.float64)))


def masked_basis(basis: Basis, share: AnyArray) -> MaskedBasis:
    """See a basis through a part of the face; `share` (d,) in [0, 1] says how much of each number counts.

    Raises `BadInput` where nothing of the face is left, or the model has no component.
    """
    if basis.rank == 0:
        raise BadInput("the model has no component: nothing can be measured in its space")
    weight = np.asarray(basis.weight * share, np.float32)
    if not weight.any():
        raise BadInput("the mask leaves nothing of the model's face: make it white where the face is")
    gram = np.zeros((basis.rank, basis.rank))
    for start, stop in column_ranges(basis.rank, 0, len(weight)):
        block = np.asarray(basis.components[:, start:stop], np.float64)
        gram += (block * weight[start:stop]) @ block.T
    noise = max(ONE_IN * basis.discarded_variance, NOISE_FLOOR * float(basis.variances.min()))
    return MaskedBasis(basis, weight, gram, noise)
