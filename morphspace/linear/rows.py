"""Serialised faces on the disk, one a row, so that a build of any number of frames needs fixed memory.

A matrix of n faces by d numbers is written row by row and read in blocks of columns: the mean, the Gram matrix and
the components are all sums over columns. Files are read without a memory map, since mapped pages would count as
memory of the process and grow with the number of frames.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol

import numpy as np

from morphspace import cache
from morphspace.arrays import AnyArray, Rows
from morphspace.errors import UnwritableFile
from morphspace.storage import unfinished_file

BLOCK_BYTES = 24 << 20  # bytes of a block of columns in float64; several exist at once


class ColumnBlocks(Protocol):
    """A matrix (n, d) that can be read in blocks of columns."""

    @property
    def shape(self) -> tuple[int, int]:
        """(n, d)"""
        ...

    def columns(self, start: int, stop: int) -> Rows:
        """Read columns start:stop of all rows, (n, stop - start) float32."""
        ...


class RowFile:
    """A float32 matrix (n, d) in one raw file, written by rows, read by rows or by blocks of columns.

    Raises `UnwritableFile` if the disk has no room for it.
    """

    def __init__(self, path: Path, rows: int, width: int) -> None:
        self.shape = (rows, width)
        self.path = path
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            os.ftruncate(self._file, rows * width * 4)
        except OSError as error:
            os.close(self._file)
            raise self._full(error) from error

    def __enter__(self) -> RowFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)

    def write_row(self, index: int, *parts: AnyArray) -> None:
        """Write one row from arrays whose sizes sum to d; threads may write different rows at the same time."""
        offset = index * self.shape[1] * 4
        for part in parts:
            data = np.ascontiguousarray(part, np.float32).reshape(-1)
            self._write(data, offset)
            offset += data.nbytes

    def _write(self, data: AnyArray, offset: int) -> None:
        view = data.view(np.uint8).data
        while len(view):
            try:
                written = os.pwrite(self._file, view, offset)
            except OSError as error:
                raise self._full(error) from error
            view, offset = view[written:], offset + written

    def _full(self, error: OSError) -> UnwritableFile:
        gigabytes = self.shape[0] * self.shape[1] * 4 / 1e9
        return UnwritableFile(
            f"cannot write {self.path}: {error.strerror}; {self.shape[0]} morphs take {gigabytes:.2g} GB. Free "
            "space or choose another work folder"
        )

    def row(self, index: int) -> AnyArray:
        """Read row `index`, (d,) float32."""
        out = np.empty(self.shape[1], np.float32)
        os.preadv(self._file, [out.view(np.uint8).data], index * out.nbytes)
        return out

    def columns(self, start: int, stop: int, rows: Sequence[int] | AnyArray | None = None) -> Rows:
        """Read columns start:stop of all rows or of these `rows`, (n, stop - start) float32."""
        wanted = range(self.shape[0]) if rows is None else rows
        out = np.empty((len(wanted), stop - start), np.float32)
        for index, row in zip(wanted, out, strict=True):
            os.preadv(self._file, [row.view(np.uint8).data], (int(index) * self.shape[1] + start) * 4)
        return out


@contextlib.contextmanager
def temporary_rows(folder: Path, rows: int, width: int) -> Iterator[RowFile]:
    """Open a `RowFile` in a folder for the block. It is unlinked at once, so that a killed process leaves none."""
    path = unfinished_file(folder, "morphs", cache.SUFFIX)
    try:
        with RowFile(path, rows, width) as file:
            with contextlib.suppress(PermissionError):  # Windows cannot unlink an open file
                path.unlink()
            yield file
    finally:
        path.unlink(missing_ok=True)


class RowArray:
    """A matrix (n, d) in memory with the interface of `RowFile`."""

    def __init__(self, values: Rows) -> None:
        self.values = values
        self.shape = (values.shape[0], values.shape[1])

    def columns(self, start: int, stop: int) -> Rows:
        """Return columns start:stop of all rows, (n, stop - start)."""
        return self.values[:, start:stop]


class RowSubset:
    """Selected rows of another matrix, in the given order, for cross-validation."""

    def __init__(self, rows: ColumnBlocks, indices: AnyArray) -> None:
        self.rows, self.indices = rows, indices
        self.shape = (len(indices), rows.shape[1])

    def columns(self, start: int, stop: int) -> Rows:
        """Read columns start:stop of the selected rows."""
        if isinstance(self.rows, RowFile):
            return self.rows.columns(start, stop, self.indices)
        return self.rows.columns(start, stop)[self.indices]


def column_ranges(rows: int, start: int, stop: int) -> Iterator[tuple[int, int]]:
    """Split columns start:stop into ranges whose blocks of `rows` rows take `BLOCK_BYTES` in float64.

    Examples
    --------
    >>> list(column_ranges(3, 0, 500))
    [(0, 500)]
    """
    step = max(256, BLOCK_BYTES // (8 * max(rows, 1)))
    for first in range(start, stop, step):
        yield first, min(first + step, stop)
