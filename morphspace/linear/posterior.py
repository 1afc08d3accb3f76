"""The most probable loadings of a partly visible offset: the posterior mean under probabilistic PCA.

Components are orthonormal over the whole face. They are not over a part of it, so inner products over a part would
mix them. Under probabilistic PCA each loading has its variance, and the variance outside the components is noise. The
posterior mean then estimates the loadings from a part of the face, and from further observations such as landmarks
(Tipping and Bishop, Probabilistic principal component analysis, 1999, equation 12).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, LoadingVector
from morphspace.errors import BadInput
from morphspace.linear.pca import Basis, InnerProducts

# Share of the smallest variance of a component: the noise of a model without discarded variance. With it an invisible
# component stays at the mean. It shrinks the smallest component by 0.1 % and the others by less.
NOISE_FLOOR = 1e-3


@dataclass(frozen=True, eq=False)
class Observations:
    """Further observations y (m,) that depend on the loadings L (k,) linearly, y = Y L + noise.

    Attributes
    ----------
    weights : array (k, m)
        Y': the change of each observation per unit of each loading.
    precision : array (m,)
        N: 1 over the variance of each observation.
    """

    weights: AnyArray
    precision: AnyArray


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of loadings L given an offset R with weights (docs/methods.md, section 8).

    With P' the components (k, d), C the weights, sigma^2 the noise and V the variances, the mean is
    L = (P' C P + sigma^2 V^-1)^-1 P' C R. With `Observations` y it is
    L = (P' C P + sigma^2 Y' N Y + sigma^2 V^-1)^-1 (P' C R + sigma^2 Y' N y).
    The system is solved in SD of the components, where it is well conditioned, by Cholesky's method in float64.

    Parameters
    ----------
    basis : Basis
        Components (k, d) and variances.
    weight : array (d,) float32
        Weight of each number of an offset; 0 is not visible.
    noise_factor : float
        Ratio of the noise to the discarded variance per number. The errors of neighbouring numbers correlate, so only
        one in this many counts as independent.
    observations : Observations, optional
        Observations besides the offset.

    Raises
    ------
    BadInput
        If the basis has no component.

    References
    ----------
    Tipping and Bishop, Probabilistic principal component analysis, 1999, equation 12; the observations are ours.

    Examples
    --------
    >>> import numpy as np
    >>> from morphspace.linear.pca import Basis
    >>> basis = Basis(np.eye(2, 3, dtype=np.float32), np.array([4.0, 1.0]), np.ones(3, np.float32), 0.0)
    >>> first_two = np.array([1, 0, 1], np.float32)
    >>> Posterior(basis, first_two, 1.0).mean(np.array([2.0, 5.0, 0.0])).round(2).tolist()
    [2.0, 0.0]
    """

    basis: Basis
    weight: AnyArray
    noise_factor: float
    observations: Observations | None = None

    def __post_init__(self) -> None:
        if self.basis.rank == 0:
            raise BadInput(
                "the model has no component; expected at least 1. Build it from more frames, of different expressions"
            )

    @cached_property
    def noise(self) -> float:
        """The noise s^2, at least `NOISE_FLOOR` of the smallest variance."""
        least = NOISE_FLOOR * float(self.basis.variances.min())
        return max(self.noise_factor * self.basis.discarded_variance, least)

    @cached_property
    def inner_products(self) -> InnerProducts:
        """P' C."""
        return InnerProducts(self.basis.components, self.weight)

    @cached_property
    def gram(self) -> AnyArray:
        """P' C P, (k, k) float64."""
        return self.inner_products.gram()

    @property
    def visible_share(self) -> AnyArray:
        """The visible share of each component, (k,), 0 to 1."""
        return np.asarray(np.diag(self.gram))

    def mean(self, offset: AnyArray, observed: AnyArray | None = None) -> LoadingVector:
        """Compute the posterior mean (k,) of the loadings, from an offset (d,) and from observations y (m,), if any."""
        products = self.inner_products.with_offset(offset)
        if self.observations is not None and observed is not None:
            products = products + self.noise * (
                self.observations.weights @ (self.observations.precision * observed)
            )
        return self._solved(products)

    def mean_of_faces(self, loadings: LoadingTable) -> LoadingTable:
        """Compute the posterior mean (n, k) of faces with known loadings (n, k) that are partly visible."""
        return self._solved((loadings @ self.gram).T).T

    def _solved(self, products: AnyArray) -> AnyArray:
        from scipy.linalg import cho_solve  # slow to import

        sd = np.sqrt(self.basis.variances).reshape(-1, *[1] * (products.ndim - 1))
        return np.asarray(sd * cho_solve((self._factor, True), sd * products, check_finite=False))

    @cached_property
    def _factor(self) -> AnyArray:
        """Cholesky's factor of the system in SD of the components: sd (P' C P + sigma^2 Y' N Y) sd + sigma^2."""
        known = self.gram
        if self.observations is not None:
            weights = self.observations.weights
            known = known + self.noise * (weights * self.observations.precision) @ weights.T
        sd = np.sqrt(self.basis.variances)
        return np.linalg.cholesky(sd[:, None] * known * sd + self.noise * np.eye(len(sd)))
