"""The most probable loadings for what is seen of an offset: the posterior mean under probabilistic PCA.

Components are orthonormal over the whole face and not over a part of it, so inner products over a part would mix them.
A basis is read as probabilistic PCA instead: each loading has its variance, and what the components leave out is noise.
The posterior mean is then the answer, of a part of the face, and where points are observed besides (Tipping and Bishop,
Probabilistic principal component analysis, 1999, equation 12; methods 5, steps 4 and 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, LoadingVector
from morphspace.errors import BadInput
from morphspace.linear.pca import Basis, InnerProducts

# Share of the least variance of a component. It is the noise of a model that leaves nothing out, so that a component
# that cannot be seen stays at the mean. It shrinks the faintest component by 0.1 % and the others by less.
NOISE_FLOOR = 1e-3


@dataclass(frozen=True, eq=False)
class Observations:
    """Numbers y (m,) that depend on the loadings linearly, y = l `weights` and noise, beside the offset.

    Parameters
    ----------
    weights : (k, m)
        Change of each number per unit of each loading.
    precision : (m,)
        How much each number counts: 1 over its variance.
    """

    weights: AnyArray
    precision: AnyArray


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of loadings l given an offset r, seen where `weight` says.

    With P the components, C the weights, s^2 the noise and V the variances, the mean is
    l = (P C P' + s^2 V^-1)^-1 P C r. With observations y of weights W and precision N it is
    l = (P C P' + s^2 W N W' + s^2 V^-1)^-1 (P C r + s^2 W N y).
    The system is solved in SD of the components, where it is well conditioned, by Cholesky's method in float64.

    Parameters
    ----------
    basis : Basis
        Components (k, d) and variances.
    weight : (d,) float32
        How much each number of an offset counts; 0 is not seen.
    noise_factor : float
        The noise as a multiple of what the basis leaves out, per number. Neighbouring numbers err together: one in so
        many counts as independent.
    observations : Observations, optional
        What is observed besides.

    Raises
    ------
    BadInput
        Where the basis has no component.
    """

    basis: Basis
    weight: AnyArray
    noise_factor: float
    observations: Observations | None = None

    def __post_init__(self) -> None:
        if self.basis.rank == 0:
            raise BadInput("the model has no component: build it from more frames, of different expressions")

    @cached_property
    def noise(self) -> float:
        """The noise s^2, at least `NOISE_FLOOR` of the least variance."""
        least = NOISE_FLOOR * float(self.basis.variances.min())
        return max(self.noise_factor * self.basis.discarded_variance, least)

    @cached_property
    def inner_products(self) -> InnerProducts:
        """P C."""
        return InnerProducts(self.basis.components, self.weight)

    @cached_property
    def gram(self) -> AnyArray:
        """P C P', (k, k) float64."""
        return self.inner_products.gram()

    @property
    def visible_share(self) -> AnyArray:
        """How much of each component is seen, (k,); 1 is all of it."""
        return np.asarray(np.diag(self.gram))

    def mean(self, offset: AnyArray, observed: AnyArray | None = None) -> LoadingVector:
        """Give the loadings (k,) of an offset (d,) and of observations y (m,), where there are any."""
        products = self.inner_products.with_offset(offset)
        if self.observations is not None and observed is not None:
            products = products + self.noise * (
                self.observations.weights @ (self.observations.precision * observed)
            )
        return self._solved(products)

    def mean_of_faces(self, loadings: LoadingTable) -> LoadingTable:
        """Give what is seen of faces that are known by their loadings (n, k): the mean for what they expand to."""
        return self._solved((loadings @ self.gram).T).T

    def _solved(self, products: AnyArray) -> AnyArray:
        from scipy.linalg import cho_solve  # here, because it is slow to import

        sd = np.sqrt(self.basis.variances).reshape(-1, *[1] * (products.ndim - 1))
        return np.asarray(sd * cho_solve((self._factor, True), sd * products, check_finite=False))

    @cached_property
    def _factor(self) -> AnyArray:
        """Cholesky's factor of the system in SD: S (P C P' + s^2 W N W') S + s^2, with S the SD of each component."""
        known = self.gram
        if self.observations is not None:
            weights = self.observations.weights
            known = known + self.noise * (weights * self.observations.precision) @ weights.T
        sd = np.sqrt(self.basis.variances)
        return np.linalg.cholesky(sd[:, None] * known * sd + self.noise * np.eye(len(sd)))
