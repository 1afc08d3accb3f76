"""Principal components of serialised faces in a weighted inner product: Nagle et al., section 2, "PCA of the morphs".

There are far fewer faces (n) than numbers in a face (d), so the eigenvectors come from the n x n Gram matrix (Turk
and Pentland, Eigenfaces for recognition, 1991). It is summed in float64 over blocks of columns. The data are never in
memory at once, and small components are not lost to rounding.

The inner product is <a, b> = sum_j weight_j a_j b_j with weight_j >= 0. A column of weight 0 (outside the mask) does
not influence the components, yet each component has a value there, by which the column can be expanded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, LoadingVector, Rows, read_only
from morphspace.errors import BadInput
from morphspace.linear.rows import ColumnBlocks, column_ranges

RANK_TOL = 1e-10  # share of the largest eigenvalue; smaller ones are float32 rounding of the offsets
ALL = slice(None)
CONSTANT_TOL = 1e-11  # share of the data's energy; frames that agree to float32 have no component


@dataclass(frozen=True, eq=False)
class Basis:
    """Principal components, orthonormal in the weighted inner product.

    Attributes
    ----------
    components : array (k, d) float32
    variances : array (k,) float64
        Variance of the training data along each component.
    weight : array (d,) float32
        Of the inner product.
    discarded_variance : float
        Mean variance per dimension of the omitted directions: sigma^2 of probabilistic PCA (Tipping and Bishop 1999,
        equation 8).
    """

    components: Rows
    variances: AnyArray
    weight: AnyArray
    discarded_variance: float

    def __post_init__(self) -> None:
        if self.components.shape != (len(self.variances), len(self.weight)):
            raise BadInput(
                f"the components have the shape {self.components.shape}; expected ({len(self.variances)}, "
                f"{len(self.weight)}) for the variances and weights. Build the model again"
            )
        for name in ("components", "variances", "weight"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def rank(self) -> int:
        """The number of components, k."""
        return len(self.variances)

    @property
    def variance_explained(self) -> float:
        """The share of the training data's variance, in the inner product, along the components."""
        kept = float(self.variances.sum())
        dimensions = max(1, int((self.weight > 0).sum()) - self.rank)
        total = kept + self.discarded_variance * dimensions
        return kept / total if total > 0 else 1.0

    def project(self, offsets: AnyArray) -> LoadingTable:
        """Compute the loadings (..., k) of mean-relative vectors (..., d): inner products with each component.

        For many faces one by one, `inner_products` is faster.
        """
        return np.asarray((offsets * self.weight) @ self.components.T, np.float64)

    def inner_products(self) -> InnerProducts:
        """Prepare the inner products with each component for many faces."""
        return InnerProducts(self.components, self.weight)

    def expand(self, loadings: AnyArray, columns: slice = ALL) -> AnyArray:
        """Compute the mean-relative vectors (..., d) float32 of loadings (..., k): R = P L, Nagle et al., section 2.

        `columns` selects a range of the d numbers.
        """
        return np.asarray(np.asarray(loadings, np.float32) @ self.components[:, columns])

    def truncate(self, components: int) -> Basis:
        """Keep the first `components`; the variance of the others is added to the discarded variance.

        Raises `BadInput` if the number is outside 0 to the rank.
        """
        if not 0 <= components <= self.rank:
            raise BadInput(
                f"the components are {components}; expected 0 to {self.rank}, the rank. Choose fewer"
            )
        effective = max(1, int((self.weight > 0).sum()) - components)
        left_out = (
            self.discarded_variance * max(1, effective + components - self.rank)
            + self.variances[components:].sum()
        )
        return Basis(
            self.components[:components],
            self.variances[:components],
            self.weight,
            float(left_out / effective),
        )


@dataclass(frozen=True, eq=False)
class InnerProducts:
    """The inner products P' C R of components P' (k, d) and offsets R (d,) with weights C (d,).

    Many pixels lie outside every mask. The components at the others are copied once, which halves the memory read for
    each face.
    """

    components: Rows
    weight: AnyArray

    @cached_property
    def places(self) -> AnyArray:
        """The columns of positive weight, (n,)."""
        return np.flatnonzero(self.weight)

    @cached_property
    def weighted(self) -> AnyArray:
        """P' C at those columns, (k, n) float32."""
        weighted = np.ascontiguousarray(self.components[:, self.places], np.float32)
        weighted *= self.weight[self.places]
        return weighted

    def with_offset(self, offset: AnyArray) -> LoadingVector:
        """Compute P' C R (k,) of a mean-relative vector (d,)."""
        return np.asarray(self.weighted @ np.take(offset, self.places), np.float64)

    def gram(self) -> AnyArray:
        """Compute P' C P (k, k), summed over blocks of columns in float64."""
        total = np.zeros((len(self.components), len(self.components)))
        for start, stop in column_ranges(2 * len(self.components), 0, len(self.places)):
            places = self.places[start:stop]
            block = np.asarray(self.components[:, places], np.float64)
            total += (block * self.weight[places]) @ block.T
        return total


def mean_row(rows: ColumnBlocks, counts: AnyArray | None = None) -> AnyArray:
    """Compute the mean of the rows, (d,) float32, summed in float64.

    `counts` (n,), all > 0, says how much each row counts; None counts them alike.

    Examples
    --------
    >>> import numpy as np
    >>> from morphspace.linear.rows import RowArray
    >>> mean_row(RowArray(np.array([[0.0, 2.0], [4.0, 2.0]]))).tolist()
    [2.0, 2.0]
    """
    n, d = rows.shape
    mean = np.empty(d, np.float32)
    for start, stop in column_ranges(n, 0, d):
        block = rows.columns(start, stop)
        mean[start:stop] = (
            block.mean(axis=0, dtype=np.float64) if counts is None else counts @ block / counts.sum()
        )
    return mean


def gram_matrix(rows: ColumnBlocks, mean: AnyArray, weight: AnyArray, start: int, stop: int) -> AnyArray:
    """Compute the inner products of all mean-relative rows over columns start:stop, (n, n) float64.

    Examples
    --------
    >>> import numpy as np
    >>> from morphspace.linear.rows import RowArray
    >>> rows = RowArray(np.array([[1.0, 0.0], [3.0, 4.0]], np.float32))
    >>> gram_matrix(rows, mean_row(rows), np.ones(2, np.float32), 0, 2).tolist()
    [[5.0, -5.0], [-5.0, 5.0]]
    """
    from scipy.linalg.blas import dsyrk  # slow to import, and only a build needs it

    n = rows.shape[0]
    lower = np.zeros((n, n), order="F")
    for first, last in column_ranges(n, start, stop):
        scale = np.sqrt(weight[first:last], dtype=np.float64)
        if not scale.any():
            continue
        block = rows.columns(first, last).astype(np.float64)
        block -= mean[first:last]
        block *= scale
        lower = dsyrk(1.0, block.T, beta=1.0, c=lower, trans=1, lower=1, overwrite_c=1)
    upper = np.triu_indices(n, 1)
    lower[upper] = lower.T[upper]
    return lower


def principal_axes(gram: AnyArray, components: int, energy: float) -> tuple[AnyArray, AnyArray]:
    """Diagonalise a Gram matrix: find the weighted sums of the rows that are the components.

    Parameters
    ----------
    gram : array (n, n) float64
        Overwritten.
    components : int
        Largest number of components.
    energy : float
        Mean square of the data in the inner product. Eigenvalues below `CONSTANT_TOL` of it are no variation.

    Returns
    -------
    coefficients : array (k, n)
        components = coefficients @ offsets; k is at most `components`, n - 1 and the numerical rank. Each sign is
        such that the training face furthest along the component lies on its positive side.
    eigenvalues : array (k,)
        In descending order.

    References
    ----------
    Nagle et al., section 2 (PCA of the morphs).

    Examples
    --------
    >>> import numpy as np
    >>> weights, variances = principal_axes(np.array([[5.0, -5.0], [-5.0, 5.0]]), 3, 1.0)
    >>> weights.shape, variances.round(6).tolist()
    ((1, 2), [10.0])
    """
    from scipy.linalg import eigh

    n = len(gram)
    wanted = min(components, n - 1)
    if wanted < 1:
        return np.zeros((0, n)), np.zeros(0)
    eigenvalues, vectors = eigh(
        gram, subset_by_index=(n - wanted, n - 1), overwrite_a=True, check_finite=False
    )
    eigenvalues, vectors = np.maximum(eigenvalues[::-1], 0), vectors[:, ::-1]
    floor = max(RANK_TOL * eigenvalues[0], CONSTANT_TOL * energy)
    k = int((eigenvalues > floor).sum())
    vectors = vectors[:, :k]
    furthest = np.abs(vectors).argmax(axis=0)
    vectors = vectors * np.where(vectors[furthest, np.arange(k)] < 0, -1.0, 1.0)
    return (vectors / np.sqrt(eigenvalues[:k])).T, eigenvalues[:k]


def combine_rows(rows: ColumnBlocks, coefficients: AnyArray, mean: AnyArray, out: AnyArray) -> None:
    """Write coefficients (k, n) @ (rows - mean) into `out` (k, d) float32, block by block.

    Examples
    --------
    >>> import numpy as np
    >>> from morphspace.linear.rows import RowArray
    >>> rows, out = RowArray(np.array([[1.0, 0.0], [3.0, 4.0]], np.float32)), np.empty((1, 2), np.float32)
    >>> combine_rows(rows, np.array([[0.5, 0.5]]), np.zeros(2, np.float32), out)
    >>> out.tolist()
    [[2.0, 2.0]]
    """
    n, d = rows.shape
    total = coefficients.sum(axis=1)
    for start, stop in column_ranges(n + len(coefficients), 0, d):
        block = coefficients @ rows.columns(start, stop).astype(np.float64)
        out[:, start:stop] = block - total[:, None] * mean[start:stop]


def basis_from_gram(
    rows: ColumnBlocks,
    mean: AnyArray,
    weight: AnyArray,
    gram: AnyArray,
    components: int,
    counts: AnyArray | None = None,
) -> tuple[Basis, LoadingTable]:
    """Compute the basis of the mean-relative rows and their loadings (n, k); the Gram matrix is overwritten.

    `counts` are those of `mean_row`: a row that counts half shapes the components half as much.

    References
    ----------
    Nagle et al., section 2; Tipping and Bishop, J. R. Statist. Soc. B 61, 1999, equation 8 (what the components omit).

    Examples
    --------
    >>> import numpy as np
    >>> from morphspace.linear.rows import RowArray
    >>> rows, weight = RowArray(np.array([[1.0, 0.0], [3.0, 4.0]], np.float32)), np.ones(2, np.float32)
    >>> gram = gram_matrix(rows, mean_row(rows), weight, 0, 2)
    >>> basis, loadings = basis_from_gram(rows, mean_row(rows), weight, gram, 3)
    >>> basis.components.shape, np.abs(loadings).round(3).tolist()
    ((1, 2), [[2.236], [2.236]])
    """
    n, d = rows.shape
    energy = float((np.square(mean, dtype=np.float64) * weight).sum())
    root = np.ones(n) if counts is None else np.sqrt(counts)
    number = max(float((root * root).sum()) - 1, 1)
    gram *= root
    gram *= root[:, None]
    total = float(np.trace(gram))
    coefficients, eigenvalues = principal_axes(gram, components, energy)
    k = len(eigenvalues)
    out = np.empty((k, d), np.float32)
    combine_rows(rows, coefficients * root, mean, out)
    dimensions = max(1, int((weight > 0).sum()) - k)
    discarded = max(0.0, total - float(eigenvalues.sum())) / number / dimensions
    loadings = (coefficients * (eigenvalues[:, None] / root)).T
    return Basis(out, eigenvalues / number, weight, discarded), loadings


def fit_basis(rows: ColumnBlocks, weight: AnyArray, components: int) -> tuple[AnyArray, Basis, LoadingTable]:
    """Fit a PCA to the rows of a matrix.

    Parameters
    ----------
    rows : ColumnBlocks (n, d)
        n >= 2 faces.
    weight : array (d,)
        Of the inner product, >= 0.
    components : int
        Largest number of components. Constant data have none.

    Returns
    -------
    mean : array (d,) float32
    basis : Basis
    loadings : array (n, k) float64
        Of the rows.

    References
    ----------
    Nagle et al., section 2; Turk and Pentland, Eigenfaces for recognition, 1991.

    Examples
    --------
    >>> import numpy as np
    >>> from morphspace.linear.rows import RowArray
    >>> faces = np.array([[0, 1], [2, 1], [4, 1]], np.float32)
    >>> mean, basis, loadings = fit_basis(RowArray(faces), np.ones(2, np.float32), 2)
    >>> mean.tolist(), basis.variances.round(6).tolist(), abs(loadings).round(6).tolist()
    ([2.0, 1.0], [4.0], [[2.0], [0.0], [2.0]])
    """
    mean = mean_row(rows)
    gram = gram_matrix(rows, mean, weight, 0, rows.shape[1])
    basis, loadings = basis_from_gram(rows, mean, weight, gram, components)
    return mean, basis, loadings
