"""Laws of the row file: rows are written, columns are read, and a file equals an array."""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from morphspace.linear import rows as rows_module
from morphspace.linear.rows import RowArray, RowFile, RowSubset, column_ranges

N, D = 7, 1003


@pytest.fixture
def values():
    return np.random.default_rng(1).standard_normal((N, D)).astype(np.float32)


@pytest.fixture
def row_file(tmp_path, values):
    with RowFile(tmp_path / "some.rows", N, D) as file:
        for index in reversed(range(N)):
            file.write_row(index, values[index])
        yield file


def test_a_row_file_reads_the_written_rows(row_file, values):
    assert row_file.shape == (N, D)
    assert_array_equal(row_file.columns(0, D), values)
    for index in range(N):
        assert_array_equal(row_file.row(index), values[index])


@pytest.mark.parametrize(("start", "stop"), [(0, 1), (3, 700), (D - 1, D), (5, 5)])
def test_a_row_file_and_a_row_array_give_the_same_columns(row_file, values, start, stop):
    assert_array_equal(row_file.columns(start, stop), RowArray(values).columns(start, stop))


def test_a_row_may_be_given_in_parts_of_any_shape_and_type(row_file, values):
    texture, displacement = values[2, :600].reshape(10, 20, 3), values[2, 600:].astype(np.float64)
    row_file.write_row(4, texture.transpose(1, 0, 2).transpose(1, 0, 2), displacement)
    assert_array_equal(row_file.row(4), values[2])
    assert_array_equal(row_file.row(3), values[3])
    assert_array_equal(row_file.row(5), values[5])


def test_short_writes_lose_nothing(monkeypatch, row_file, values):
    write = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda file, data, offset: write(file, data[:1000], offset))
    row_file.write_row(3, values[6])
    assert_array_equal(row_file.row(3), values[6])
    assert_array_equal(row_file.row(4), values[4])


def test_rows_may_be_written_from_several_threads(tmp_path):
    wide = np.random.default_rng(2).standard_normal((40, 5000)).astype(np.float32)
    with RowFile(tmp_path / "threads.rows", *wide.shape) as file, ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda index: file.write_row(index, wide[index]), range(len(wide))))
        assert_array_equal(file.columns(0, 5000), wide)


def test_a_row_file_takes_four_bytes_a_number(tmp_path):
    with RowFile(tmp_path / "some.rows", N, D):
        pass
    assert (tmp_path / "some.rows").stat().st_size == 4 * N * D


def test_a_subset_has_the_rows_in_the_order_given(row_file, values):
    subset = RowSubset(row_file, np.array([5, 0, 3]))
    assert subset.shape == (3, D)
    assert_array_equal(subset.columns(10, 30), values[[5, 0, 3], 10:30])


@pytest.mark.parametrize("block_bytes", [1, 8 * 5 * 300, 1 << 24])
def test_column_ranges_cover_each_column_once_and_keep_to_the_block(monkeypatch, block_bytes):
    monkeypatch.setattr(rows_module, "BLOCK_BYTES", block_bytes)
    ranges = list(column_ranges(5, 17, 2000))
    covered = [column for start, stop in ranges for column in range(start, stop)]
    assert covered == list(range(17, 2000))
    assert all(8 * 5 * (stop - start) <= max(block_bytes, 8 * 5 * 256) for start, stop in ranges)


def test_a_block_does_not_grow_with_the_number_of_rows():
    for n in (1, 100, 10_000):
        start, stop = next(column_ranges(n, 0, 10**9))
        assert 8 * n * (stop - start) <= rows_module.BLOCK_BYTES
