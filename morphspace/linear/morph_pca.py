"""Principal components in the manner of scikit-learn, for pipelines and cross-validation around morphs (ours).

A thin adapter: the mathematics is `pca.fit_basis`. It needs scikit-learn, which nothing else of the package does.
"""

from __future__ import annotations

import numbers
from typing import Any, Self

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput, optional
from morphspace.linear.pca import fit_basis
from morphspace.linear.rows import RowArray

optional("sklearn")
from sklearn.base import BaseEstimator, ClassNamePrefixFeaturesOutMixin, TransformerMixin  # noqa: E402
from sklearn.utils.validation import check_is_fitted, validate_data  # noqa: E402


class MorphPCA(ClassNamePrefixFeaturesOutMixin, TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """Fit principal components of rows, such as morph vectors, in a weighted inner product.

    Parameters
    ----------
    n_components : int or None
        The most components to keep; None keeps all of them (at most the number of rows less one).
    weight : array (d,) or None
        The inner product <a, b> = sum weight a b, not negative; None weighs all columns alike. `inner_product` gives
        the weights of a mask and a warp weight.

    Attributes
    ----------
    mean_ : array (d,) float32
    components_ : array (k, d) float32, orthonormal in the inner product
    explained_variance_ : array (k,), the variance of the training rows along each component
    noise_variance_ : float, the mean variance of the directions left out (Tipping and Bishop 1999, equation 8)

    Raises
    ------
    BadInput
        For a weight of another length than the rows, or a negative one; `n_components` below 1.

    References
    ----------
    Nagle, Griffin, Johnston and McOwan, Techniques for mimicry and identity blending using morph space PCA, section 2.

    Examples
    --------
    >>> import numpy as np
    >>> rows = np.random.default_rng(0).normal(size=(6, 20))
    >>> pca = MorphPCA(n_components=2).fit(rows)
    >>> pca.transform(rows).shape
    (6, 2)
    """

    def __init__(self, n_components: int | None = None, weight: AnyArray | None = None) -> None:
        self.n_components = n_components
        self.weight = weight

    def fit(self, X: AnyArray, y: Any = None) -> Self:
        """Fit the mean and the components to rows X (n, d); y is ignored.

        Raises `BadInput` if the weight or `n_components` cannot be used.
        """
        rows = validate_data(self, X, dtype=[np.float64, np.float32], ensure_min_samples=2)
        count, columns = rows.shape
        weight = np.ones(columns) if self.weight is None else np.asarray(self.weight, np.float64)
        if weight.shape != (columns,) or not (weight >= 0).all():
            raise BadInput(
                f"the weight has shape {weight.shape} and lowest value {weight.min():g}; expected ({columns},) and no "
                "negative value. Give one weight for each column of X."
            )
        wanted = count - 1 if self.n_components is None else self.n_components
        if not isinstance(wanted, numbers.Integral) or wanted < 1:
            raise BadInput(
                f"n_components is {wanted!r}; expected a whole number from 1 up, or None for all. Correct it"
            )
        mean, basis, _ = fit_basis(RowArray(rows), weight.astype(np.float32), int(wanted))
        self.mean_ = mean
        self.basis_ = basis
        self.components_ = basis.components
        self.explained_variance_ = basis.variances
        self.noise_variance_ = basis.discarded_variance
        return self

    def transform(self, X: AnyArray) -> AnyArray:
        """Return the loadings (n, k) of rows X (n, d)."""
        check_is_fitted(self)
        rows = validate_data(self, X, dtype=[np.float64, np.float32], reset=False)
        return self.basis_.project(rows - self.mean_)

    def inverse_transform(self, X: AnyArray) -> AnyArray:
        """Return the rows (n, d) of loadings X (n, k). Raises `BadInput` if k differs."""
        check_is_fitted(self)
        loadings = np.asarray(X)
        if loadings.shape[-1:] != (self.basis_.rank,):
            raise BadInput(
                f"the loadings have shape {loadings.shape}; expected (n, {self.basis_.rank}), one column a component. "
                "Give what transform returned"
            )
        return self.mean_ + self.basis_.expand(loadings)

    @property
    def _n_features_out(self) -> int:
        return self.basis_.rank
