"""Laws of the PCA: truth from numpy's SVD in float64 and from scikit-learn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.decomposition import PCA

from morphspace.errors import BadInput
from morphspace.linear import rows as rows_module
from morphspace.linear.pca import Basis, basis_from_gram, fit_basis, gram_matrix, mean_row, principal_axes
from morphspace.linear.rows import RowArray, RowFile

N, D = 14, 900
RELATIVE = 1e-5  # float32 components: 6e-8 a number, some hundred numbers a sum


def rows_of(seed=0, n=N, d=D, rank=None, offset=0.5):
    """Draw rows with decreasing variances about a mean of `offset`, as colours have."""
    rng = np.random.default_rng(seed)
    rank = n if rank is None else rank
    scale = 0.3 * 0.7 ** np.arange(rank)
    return (offset + rng.standard_normal((n, rank)) * scale @ rng.standard_normal((rank, d))).astype(
        np.float32
    )


def weights_of(seed=0, d=D):
    weight = np.random.default_rng(seed + 100).uniform(0, 2, d).astype(np.float32)
    weight[: d // 5] = 0  # outside the mask
    return weight


def svd_of(rows, weight):
    """Compute mean, components (k, d), variances and loadings of the weighted PCA by float64 SVD, where weight > 0."""
    rows, root = rows.astype(np.float64), np.sqrt(weight.astype(np.float64))
    offsets = rows - rows.mean(axis=0)
    left, singular, right = np.linalg.svd(offsets * root, full_matrices=False)
    return rows.mean(axis=0), right, singular**2 / (len(rows) - 1), left * singular


def signs(found, truth):
    return np.sign((found * truth).sum(axis=-1))


def test_components_and_variances_are_those_of_numpys_svd():
    rows, weight = rows_of(), weights_of()
    mean, basis, loadings = fit_basis(RowArray(rows), weight, 8)
    truth_mean, truth, variances, truth_loadings = svd_of(rows, weight)
    assert_allclose(mean, truth_mean, rtol=1e-6)
    assert_allclose(basis.variances, variances[:8], rtol=1e-6)
    ours = basis.components * np.sqrt(weight)
    sign = signs(ours, truth[:8])
    assert_allclose(ours * sign[:, None], truth[:8], atol=RELATIVE)
    assert_allclose(loadings * sign, truth_loadings[:, :8], atol=RELATIVE * np.abs(truth_loadings).max())


def test_with_equal_weights_it_is_the_pca_of_scikit_learn():
    rows = rows_of(seed=1)
    _, basis, loadings = fit_basis(RowArray(rows), np.ones(D, np.float32), N)
    theirs = PCA().fit(rows.astype(np.float64))
    k = basis.rank
    assert k == N - 1
    assert_allclose(basis.variances, theirs.explained_variance_[:k], rtol=1e-6)
    sign = signs(basis.components, theirs.components_[:k])
    assert_allclose(basis.components * sign[:, None], theirs.components_[:k], atol=1e-4)
    assert_allclose(loadings * sign, theirs.transform(rows.astype(np.float64))[:, :k], atol=1e-4)


def test_components_are_orthonormal_in_the_inner_product():
    _, basis, _ = fit_basis(RowArray(rows_of()), weights_of(), N)
    components = basis.components.astype(np.float64)
    inner = components * basis.weight.astype(np.float64) @ components.T
    assert_allclose(inner, np.eye(basis.rank), atol=1e-5)


def test_variances_are_those_of_the_training_loadings():
    _, basis, loadings = fit_basis(RowArray(rows_of()), weights_of(), 9)
    assert_allclose(loadings.var(axis=0, ddof=1), basis.variances, rtol=1e-9)
    assert_allclose(np.cov(loadings.T), np.diag(basis.variances), atol=1e-9 * basis.variances[0])
    assert (np.diff(basis.variances) <= 0).all()


def test_training_loadings_are_the_projections_of_the_rows():
    rows = rows_of()
    mean, basis, loadings = fit_basis(RowArray(rows), weights_of(), 9)
    assert_allclose(basis.project(rows - mean), loadings, atol=RELATIVE * np.abs(loadings).max())
    assert_allclose(basis.project(rows[3] - mean), loadings[3], atol=RELATIVE * np.abs(loadings).max())


def test_a_row_that_counts_twice_is_a_row_that_is_there_twice():
    rows, counts = rows_of(), np.where(np.arange(N) % 3, 1.0, 2.0)
    mean = mean_row(RowArray(rows), counts)
    gram = gram_matrix(RowArray(rows), mean, weights_of(), 0, rows.shape[1])
    basis, loadings = basis_from_gram(RowArray(rows), mean, weights_of(), gram, 5, counts)
    repeated = np.repeat(rows, counts.astype(int), axis=0)
    same_mean, same, theirs = fit_basis(RowArray(repeated), weights_of(), 5)
    assert_allclose(mean, same_mean, atol=1e-6)
    assert_allclose(basis.variances, same.variances, rtol=1e-6)
    assert_allclose(basis.discarded_variance, same.discarded_variance, rtol=1e-6)
    sign = signs(basis.components, same.components)
    assert_allclose(np.repeat(loadings, counts.astype(int), axis=0) * sign, theirs, atol=1e-5)
    assert_allclose(basis.project(rows - mean), loadings, atol=RELATIVE * np.abs(loadings).max())


def test_all_components_reconstruct_the_rows():
    rows = rows_of()
    mean, basis, loadings = fit_basis(RowArray(rows), weights_of(), N)
    assert_allclose(mean + basis.expand(loadings), rows, atol=1e-5)  # columns outside the mask too


def test_rank_is_less_than_the_number_of_faces():
    for n in (2, 3, 5):
        _, basis, loadings = fit_basis(RowArray(rows_of(n=n)), weights_of(), 50)
        assert basis.rank == n - 1
        assert loadings.shape == (n, n - 1)


def test_components_are_at_most_those_requested_and_the_rank():
    assert fit_basis(RowArray(rows_of()), weights_of(), 4)[1].rank == 4
    assert fit_basis(RowArray(rows_of()), weights_of(), 0)[1].rank == 0
    exact = np.round(rows_of(rank=1, offset=0) * 64)  # integers: rounding adds no component
    first, second = exact[0], exact[1]
    few = np.stack([first, second, first + second, first - second, 2 * first, 0 * first])
    assert fit_basis(RowArray(few), np.ones(D, np.float32), 50)[1].rank <= 2


@pytest.mark.parametrize("value", [0.0, 0.3, 200.0])
def test_constant_data_have_rank_zero(value):
    mean, basis, loadings = fit_basis(RowArray(np.full((6, D), value, np.float32)), weights_of(), 5)
    assert basis.rank == 0
    assert loadings.shape == (6, 0)
    assert basis.discarded_variance == pytest.approx(0, abs=1e-12 * max(value, 1) ** 2)
    assert_allclose(mean, value, rtol=1e-6)
    assert basis.project(np.ones(D, np.float32)).shape == (0,)
    assert_array_equal(basis.expand(np.zeros(0)), np.zeros(D))


def test_faces_that_differ_by_float32_rounding_alone_have_rank_zero():
    rows = np.full((6, D), 0.5, np.float32)
    rows[np.random.default_rng(0).random(rows.shape) < 0.5] = np.nextafter(np.float32(0.5), np.float32(1))
    assert len(np.unique(rows)) == 2
    assert fit_basis(RowArray(rows), weights_of(), 5)[1].rank == 0


def test_data_that_vary_only_outside_the_mask_have_rank_zero():
    rows, weight = np.full((6, D), 0.5, np.float32), weights_of()
    rows[:, weight == 0] = rows_of(n=6)[:, weight == 0]
    assert fit_basis(RowArray(rows), weight, 5)[1].rank == 0


def small_beside_large():
    """Draw two exact directions; the second has 1e-9 of the variance of the first, 6e-6 a number.

    All numbers are multiples of 2^-24 below 1/2, so that float32 holds them exactly.
    """
    rng = np.random.default_rng(3)
    n, d = 32, 4096
    large, small = rng.choice([-1.0, 1.0], (2, d))
    amount = np.repeat([-1.0, 1.0], n // 2)
    detail = np.tile([-1.0, 1.0], n // 2)  # uncorrelated with `amount`
    step = 2.0**-24
    tall = np.round(0.2 / step) * step
    low = np.round(0.2 * np.sqrt(1e-9) / step) * step
    rows = 0.25 + tall * np.outer(amount, large) + low * np.outer(detail, small)
    assert (rows.astype(np.float32) == rows).all()
    return rows.astype(np.float32), small, (low / tall) ** 2


def test_a_tiny_component_survives_where_a_float32_gram_matrix_loses_it():
    rows, small, ratio = small_beside_large()
    weight = np.ones(rows.shape[1], np.float32)
    _, basis, _ = fit_basis(RowArray(rows), weight, 5)
    assert basis.rank == 2
    assert basis.variances[1] / basis.variances[0] == pytest.approx(ratio, rel=0.02)
    truth = small / np.linalg.norm(small)
    assert abs(basis.components[1] @ truth) > 0.999
    offsets = rows - rows.mean(axis=0)
    rounded = np.linalg.eigvalsh((offsets @ offsets.T).astype(np.float32))[::-1]
    assert abs(rounded[1] / rounded[0] - ratio) > 0.5 * ratio or rounded[2] > 0.5 * rounded[1]


def test_the_size_of_the_blocks_changes_nothing(monkeypatch):
    rows, weight = rows_of(d=3000), weights_of(d=3000)
    mean, basis, loadings = fit_basis(RowArray(rows), weight, 6)
    for block_bytes in (1, 8 * N * 700):
        monkeypatch.setattr(rows_module, "BLOCK_BYTES", block_bytes)
        other_mean, other, other_loadings = fit_basis(RowArray(rows), weight, 6)
        assert_array_equal(other_mean, mean)
        assert_allclose(other.variances, basis.variances, rtol=1e-10)
        assert_allclose(other.components, basis.components, atol=1e-6)
        assert_allclose(other_loadings, loadings, atol=1e-9)


def test_rows_in_a_file_give_the_same_bits_as_rows_in_memory(tmp_path):
    rows, weight = rows_of(), weights_of()
    _, basis, loadings = fit_basis(RowArray(rows), weight, 6)
    with RowFile(tmp_path / "some.rows", N, D) as file:
        for index, row in enumerate(rows):
            file.write_row(index, row)
        _, other, other_loadings = fit_basis(file, weight, 6)
    assert_array_equal(other.components, basis.components)
    assert_array_equal(other.variances, basis.variances)
    assert_array_equal(other_loadings, loadings)


def test_columns_outside_the_mask_are_regressed_on_the_loadings():
    rows, weight = rows_of(), weights_of()
    _, basis, loadings = fit_basis(RowArray(rows), weight, 6)
    inside = weight > 0
    other = rows.copy()
    other[:, ~inside] = 50 * rows_of(seed=9)[:, ~inside]
    _, changed, changed_loadings = fit_basis(RowArray(other), weight, 6)
    assert_allclose(changed.variances, basis.variances, rtol=1e-9)
    assert_allclose(changed.components[:, inside], basis.components[:, inside], atol=1e-6)
    assert_allclose(changed_loadings, loadings, atol=1e-7)
    # outside, a component is the regression of the column on the standardised loadings
    offsets = rows - rows.mean(axis=0, dtype=np.float64)
    slopes = np.linalg.lstsq(loadings, offsets[:, ~inside], rcond=None)[0]
    assert_allclose(basis.components[:, ~inside], slopes, atol=1e-4)


def test_discarded_variance_is_the_mean_of_numpys_omitted_variances():
    rows, weight = rows_of(), weights_of()
    _, _, variances, _ = svd_of(rows, weight)
    dimensions = int((weight > 0).sum())
    for k in (0, 3, 9):
        _, basis, _ = fit_basis(RowArray(rows), weight, k)
        assert basis.discarded_variance == pytest.approx(variances[k:].sum() / (dimensions - k), rel=1e-6)


def test_with_equal_weights_the_discarded_variance_is_the_noise_of_scikit_learn():
    rows = rows_of(seed=1, d=N - 1)  # with d < n both divide by d - k
    _, basis, _ = fit_basis(RowArray(rows), np.ones(N - 1, np.float32), 5)
    theirs = PCA(5, svd_solver="full").fit(rows.astype(np.float64))
    assert basis.discarded_variance == pytest.approx(theirs.noise_variance_, rel=1e-6)


def test_truncating_is_fitting_fewer_components():
    """To rounding: LAPACK's arithmetic depends on the number of eigenvectors.

    Eigenvalues are exact to float64 rounding of the largest, here at most some thousand times the last: 1e-12 of it.
    Components are stored as float32, and the float64 difference may change the last bit.
    """
    rows, weight = rows_of(), weights_of()
    _, basis, _ = fit_basis(RowArray(rows), weight, 11)
    for k in (0, 1, 7, 11):
        _, fewer, _ = fit_basis(RowArray(rows), weight, k)
        for found in (basis.truncate(k), basis.truncate(11).truncate(k)):
            assert_allclose(found.variances, fewer.variances, rtol=1e-10)
            largest = np.abs(fewer.components).max(initial=0)
            assert_allclose(found.components, fewer.components, rtol=0, atol=2**-23 * largest)  # sign too
            assert found.discarded_variance == pytest.approx(fewer.discarded_variance, rel=1e-9)
    assert basis.truncate(9).truncate(4).discarded_variance == pytest.approx(
        basis.truncate(4).discarded_variance, rel=1e-12
    )


@pytest.mark.parametrize("components", [-1, 12])
def test_more_components_than_there_are_cannot_be_kept(components):
    _, basis, _ = fit_basis(RowArray(rows_of()), weights_of(), 11)
    with pytest.raises(BadInput, match=f"components are {components}; expected 0 to 11"):
        basis.truncate(components)


def test_the_face_furthest_along_a_component_lies_on_its_positive_side():
    for seed in range(4):
        _, _, loadings = fit_basis(RowArray(rows_of(seed=seed)), weights_of(seed), N)
        furthest = np.abs(loadings).argmax(axis=0)
        assert (loadings[furthest, np.arange(loadings.shape[1])] > 0).all()


def test_negating_the_data_negates_the_components():
    rows = rows_of(offset=0)
    _, basis, loadings = fit_basis(RowArray(rows), weights_of(), 6)
    _, other, other_loadings = fit_basis(RowArray(-rows), weights_of(), 6)
    assert_allclose(other_loadings, loadings, atol=1e-6)
    assert_allclose(other.components, -basis.components, atol=1e-6)


def test_the_order_of_the_rows_changes_only_the_order_of_the_loadings():
    rows, order = rows_of(), np.random.default_rng(0).permutation(N)
    _, basis, loadings = fit_basis(RowArray(rows), weights_of(), 6)
    _, other, other_loadings = fit_basis(RowArray(rows[order]), weights_of(), 6)
    assert_allclose(other.components, basis.components, atol=1e-5)
    assert_allclose(other_loadings, loadings[order], atol=1e-6)


def test_gram_coefficients_make_unit_vectors():
    rows = rows_of().astype(np.float64)
    offsets = rows - rows.mean(axis=0)
    coefficients, eigenvalues = principal_axes(offsets @ offsets.T, 5, 0.0)
    components = coefficients @ offsets
    assert coefficients.shape == (5, N)
    assert_allclose(components @ components.T, np.eye(5), atol=1e-9)
    truth = np.linalg.svd(offsets, compute_uv=False) ** 2
    assert_allclose(eigenvalues, truth[:5], rtol=1e-10)
    # the components diagonalise the scatter of the rows: no two of them vary together
    projected = offsets @ components.T
    assert_allclose(projected.T @ projected, np.diag(eigenvalues), atol=1e-9 * eigenvalues[0])


@pytest.mark.parametrize("order", ["C", "F"])
def test_the_order_of_the_gram_matrix_in_memory_does_not_matter(order):
    rows = rows_of().astype(np.float64)
    offsets = rows - rows.mean(axis=0)
    gram = offsets @ offsets.T
    coefficients, eigenvalues = principal_axes(np.array(gram, order=order), 5, 0.0)
    assert_allclose(gram @ coefficients.T, coefficients.T * eigenvalues, atol=1e-9 * eigenvalues[0])


@pytest.mark.parametrize(("start", "stop"), [(0, D), (0, 333), (333, D), (5, 5), (0, D // 5)])
def test_the_gram_matrix_is_that_of_numpy_over_any_columns(start, stop, monkeypatch):
    rows, weight = rows_of(), weights_of()
    mean = mean_row(RowArray(rows))
    offsets = (rows.astype(np.float64) - mean)[:, start:stop]
    truth = offsets * weight[start:stop].astype(np.float64) @ offsets.T
    monkeypatch.setattr(rows_module, "BLOCK_BYTES", 8 * N * 300)  # several blocks
    gram = gram_matrix(RowArray(rows), mean, weight, start, stop)
    assert gram.shape == (N, N)
    assert_allclose(gram, truth, rtol=0, atol=1e-12 * max(np.trace(truth), 1e-300))
    assert_array_equal(gram, gram.T)


def test_a_basis_whose_parts_do_not_fit_is_refused():
    good = np.zeros((2, 5), np.float32), np.zeros(2), np.zeros(5, np.float32)
    Basis(*good, 0.0)
    for wrong in (
        (good[0], np.zeros(3), good[2]),
        (good[0], good[1], np.zeros(6, np.float32)),
    ):
        with pytest.raises(BadInput, match=r"shape \(.*; expected \("):
            Basis(*wrong, 0.0)


@pytest.mark.parametrize(
    ("eigenvalues", "energy", "rank"),
    [
        ((1.0, 2e-10), 0.0, 2),  # RANK_TOL, of the largest
        ((1.0, 0.5e-10), 0.0, 1),
        ((2e-11, 0.0), 1.0, 1),  # CONSTANT_TOL, of the energy
        ((0.5e-11, 0.0), 1.0, 0),
    ],
)
def test_eigenvalues_of_rounding_are_no_components(eigenvalues, energy, rank):
    gram = np.diag((*eigenvalues, 0.0))
    assert len(principal_axes(gram, 2, energy)[1]) == rank
