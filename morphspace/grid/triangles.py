"""Find the triangle of a moved grid that covers a pixel, and the position inside it (ours).

Each cell of the grid is cut from its upper right to its lower left corner, and each triangle moves with its corners.
To invert the field is to find, for every pixel, the triangle that covers it. From a guess one can walk: the triangle
at the guess maps the pixel back linearly; the result lies in that triangle, or in the next one to try. Most pixels
arrive at once. Where the field folds, several triangles cover a pixel; at least one of them is flipped. Only pixels
near flipped triangles therefore need a search through all triangles that might cover them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement

EDGE_TOLERANCE = 1e-4  # cells; a pixel on a shared edge belongs to both triangles, so that no crack opens
# Beyond the largest displacement: the ring of cells that continues the field outside the grid
MARGIN_PX = 2.0
STEPS = 8  # of a walk; a smooth field needs two, and the pixels that are left then are searched
STRETCH = 6  # the row of `MovedGrid.triangles` that holds the determinant

Source = tuple[AnyArray, AnyArray, AnyArray, AnyArray]
"""The right-angled corner of each triangle before it moved, and the extent of its edges: x, dx, y, dy in px."""


@dataclass(frozen=True, eq=False)
class MovedGrid:
    """The triangles of a finite displacement (h, w, 2) px, with a ring of cells that moves with the edge.

    The ring lies far outside the grid, so that the cells cover every pixel. Triangles are numbered cell by cell, row
    by row, the upper ones first.
    """

    displacement: Displacement

    @cached_property
    def steps(self) -> tuple[AnyArray, AnyArray]:
        """The positions of the columns (w + 2,) and rows (h + 2,) of vertices before they moved, px."""
        height, width = self.displacement.shape[:2]
        margin = np.float32(np.abs(self.displacement).max(initial=0) + MARGIN_PX)
        return tuple(
            np.concatenate([[-margin], np.arange(size), [size - 1 + margin]]).astype(np.float32)
            for size in (width, height)
        )  # type: ignore[return-value]

    @cached_property
    def moved(self) -> tuple[AnyArray, AnyArray]:
        """The positions of the vertices after they moved, x and y px, (h + 2, w + 2) each."""
        step_x, step_y = self.steps
        ringed = cv2.copyMakeBorder(self.displacement, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        return ringed[..., 0] + step_x, ringed[..., 1] + step_y[:, None]

    @cached_property
    def triangles(self) -> AnyArray:
        """Both triangles of each moved cell as numbers: (7, 2, cells), upper ones first.

        With o the right-angled corner and e, f the moved edges along x and y, a pixel q lies at
        along = A (q - o).x + B (q - o).y, beside = C (q - o).x + D (q - o).y. The rows are o.x, o.y, A, B, C, D and
        the determinant e x f, the stretch of the triangle. A triangle without area has zeros and is never hit.
        """
        x, y = self.moved
        out = np.empty((7, 2, *(size - 1 for size in x.shape)), np.float32)
        here, after = slice(None, -1), slice(1, None)
        for side, (o, e, f) in enumerate(
            (((here, here), (here, after), (after, here)), ((after, after), (after, here), (here, after)))
        ):
            ox, oy, a, b, c, d, stretch = out[:, side]
            ox[:], oy[:] = x[o], y[o]
            np.subtract(x[e], ox, out=d)
            np.subtract(y[e], oy, out=c)
            np.subtract(x[f], ox, out=b)
            np.subtract(y[f], oy, out=a)
            np.multiply(d, a, out=stretch)
            stretch -= c * b
            scale = np.reciprocal(np.where(stretch == 0, np.float32(np.inf), stretch))
            a *= scale
            d *= scale
            np.negative(scale, out=scale)
            b *= scale
            c *= scale
        return out.reshape(7, 2, -1)

    @cached_property
    def spans(self) -> tuple[AnyArray, AnyArray]:
        """The width of each column of cells (w + 1,) and the height of each row (h + 1,) before they moved, px."""
        step_x, step_y = self.steps
        return np.diff(step_x), np.diff(step_y)

    @cached_property
    def folded(self) -> AnyArray:
        """The cells with a flipped triangle or one without area, (n,)."""
        return np.flatnonzero(self.triangles[STRETCH].min(axis=0) <= 0)

    @cached_property
    def where_folds(self) -> AnyArray:
        """The pixels in the boxes around folded cells, (h, w) bool."""
        out = np.zeros(self.displacement.shape[:2], bool)
        if len(self.folded):
            _, x, y = self._candidates(self.folded)
            out[y, x] = True
        return out

    def walked(self, guess: tuple[AnyArray, AnyArray]) -> tuple[Displacement, AnyArray]:
        """Walk from a guess of each pixel's origin, x and y px (h, w), to a triangle that covers the pixel.

        Returns
        -------
        back : array (h, w, 2) float32
            The displacement from each pixel to its origin, px.
        arrived : array (h, w) bool
            The pixels whose walk ended in a covering triangle.
        """
        height, width = self.displacement.shape[:2]
        back = np.empty((height * width, 2), np.float32)
        known = np.zeros(height * width, bool)
        rows = self.triangles.reshape(7, -1)
        x, y = (places.reshape(-1) for places in guess)
        qx = np.tile(np.arange(width, dtype=np.float32), height)
        qy = np.repeat(np.arange(height, dtype=np.float32), width)
        left: AnyArray | slice = slice(None)
        with np.errstate(over="ignore", invalid="ignore"):  # of triangles with hardly any area
            for _ in range(STEPS):
                number, source = self._met(x, y)
                along, beside = _place(rows, number, qx, qy)
                inside = _is_inside(along, beside)
                if len(self.folded):
                    inside &= np.take(rows[STRETCH], number) > 0
                x, y = _unmoved(source, along, beside)
                back[left, 0], back[left, 1], known[left] = x - qx, y - qy, inside
                wrong = np.flatnonzero(~inside)
                if not len(wrong):
                    break
                left = wrong if isinstance(left, slice) else left[wrong]
                qx, qy, x, y = qx[wrong], qy[wrong], x[wrong], y[wrong]
        return back.reshape(height, width, 2), known.reshape(height, width)

    def searched(self, wanted: AnyArray) -> tuple[Displacement, AnyArray]:
        """Try every triangle that might cover one of the `wanted` pixels (h, w) bool; the most stretched triangle wins.

        Returns
        -------
        back : array (h, w, 2) float32
            The displacement from each wanted pixel to its origin, px; 0 elsewhere.
        covered : array (h, w) bool
            The pixels that a triangle covers.
        """
        height, width = wanted.shape
        cell, qx, qy = self._candidates(self._around(wanted))
        asked = np.flatnonzero(wanted[qy, qx])
        number = np.concatenate([cell[asked], cell[asked] + self.triangles.shape[2]])
        qx, qy = np.tile(qx[asked], 2), np.tile(qy[asked], 2)
        rows = self.triangles.reshape(7, -1)
        with np.errstate(over="ignore", invalid="ignore"):  # of triangles with hardly any area
            along, beside = _place(rows, number, qx.astype(np.float32), qy.astype(np.float32))
            hit = np.flatnonzero(_is_inside(along, beside) & (rows[STRETCH][number] != 0))
        source = self._source(number[hit])
        _, edge_x, _, edge_y = source
        least_first = np.argsort(rows[STRETCH][number[hit]] / (edge_x * edge_y), kind="stable")
        x, y = _unmoved(source, along[hit], beside[hit])
        target = (qy[hit] * width + qx[hit])[least_first]  # of several at one pixel the last stays
        back = np.zeros((height * width, 2), np.float32)
        back[target, 0] = (x - qx[hit])[least_first]
        back[target, 1] = (y - qy[hit])[least_first]
        covered = np.zeros(height * width, bool)
        covered[target] = True
        return back.reshape(height, width, 2), covered.reshape(height, width)

    def _met(self, x: AnyArray, y: AnyArray) -> tuple[AnyArray, Source]:
        """Return the number and the source of the triangle that holds each position (n,) before it moves."""
        (step_x, step_y), (wide, high) = self.steps, self.spans
        column = np.clip(x + 1, 0, len(wide) - 0.5).astype(np.intp)  # what is positive is cut off downwards
        row = np.clip(y + 1, 0, len(high) - 0.5).astype(np.intp)
        from_x, edge_x = np.take(step_x, column), np.take(wide, column)
        from_y, edge_y = np.take(step_y, row), np.take(high, row)
        across = (x - from_x) / edge_x
        across += (y - from_y) / edge_y
        lower = across > 1
        row *= len(wide)
        row += column
        row += np.multiply(lower, self.triangles.shape[2])
        for begin, edge in ((from_x, edge_x), (from_y, edge_y)):  # a lower one starts at the other end
            back = edge * lower
            begin += back
            edge -= back
            edge -= back
        return row, (from_x, edge_x, from_y, edge_y)

    def _source(self, number: AnyArray) -> Source:
        """Return the source of triangles (n,) by their numbers."""
        (step_x, step_y), (wide, high) = self.steps, self.spans
        lower, cell = np.divmod(number, self.triangles.shape[2])
        row, column = np.divmod(cell, len(wide))
        side = 1 - 2 * lower  # upper triangles start left and above, lower ones right and below
        return (
            step_x[column + lower],
            wide[column] * side,
            step_y[row + lower],
            high[row] * side,
        )

    @cached_property
    def boxes(self) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """The box of pixels around each moved cell: first x, last x, first y, last y, (cells,) each.

        In a cell without a pixel the last lies before the first.
        """
        height, width = self.displacement.shape[:2]
        x, y = self.moved
        return *_pixels_across(x, width), *_pixels_across(y, height)

    def _candidates(self, cells: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Return every (cell, pixel x, pixel y) with the pixel inside the box around one of the `cells`."""
        first_x, last_x, first_y, last_y = (np.take(side, cells) for side in self.boxes)
        wide, high = last_x - first_x + 1, last_y - first_y + 1
        count = np.where((wide > 0) & (high > 0), wide * high, 0)
        busy = np.repeat(np.arange(len(cells)), count)
        place = np.arange(len(busy)) - np.repeat(np.cumsum(count) - count, count)
        row, column = np.divmod(place, wide[busy])
        return cells[busy], first_x[busy] + column, first_y[busy] + row

    def _around(self, wanted: AnyArray) -> AnyArray:
        """Return the cells whose boxes hold a wanted pixel, (n,)."""
        first_x, last_x, first_y, last_y = self.boxes
        before = cv2.integral(wanted.astype(np.uint8))
        width = before.shape[1]
        top, bottom = first_y * width, (last_y + 1) * width
        held = np.take(before, bottom + last_x + 1) - np.take(before, bottom + first_x)
        held -= np.take(before, top + last_x + 1) - np.take(before, top + first_x)
        return np.flatnonzero((held > 0) & (last_x >= first_x) & (last_y >= first_y))


def _unmoved(source: Source, along: AnyArray, beside: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the position along a triangle's edges before it moved, x and y px."""
    from_x, edge_x, from_y, edge_y = source
    return from_x + along * edge_x, from_y + beside * edge_y


def _place(rows: AnyArray, number: AnyArray, qx: AnyArray, qy: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the position of each pixel (n,) along both edges of its triangle, 0 to 1 inside."""
    ox, oy, a, b, c, d = (np.take(row, number) for row in rows[:STRETCH])
    np.subtract(qx, ox, out=ox)
    np.subtract(qy, oy, out=oy)
    a *= ox
    b *= oy
    a += b
    c *= ox
    d *= oy
    c += d
    return a, c


def _is_inside(along: AnyArray, beside: AnyArray) -> AnyArray:
    return np.minimum(np.minimum(along, beside), 1 - along - beside) >= -EDGE_TOLERANCE


def _pixels_across(corners: AnyArray, size: int) -> tuple[AnyArray, AnyArray]:
    """Return the first and the last pixel along one axis that each cell can cover, (cells,) each, within the image."""
    above, below = corners[:-1], corners[1:]
    least, most = np.minimum(above, below), np.maximum(above, below)
    least = np.minimum(least[:, :-1], least[:, 1:]) - EDGE_TOLERANCE
    most = np.maximum(most[:, :-1], most[:, 1:]) + EDGE_TOLERANCE
    first = np.ceil(np.clip(least, 0, size)).astype(np.int32)
    last = np.floor(np.clip(most, -1, size - 1)).astype(np.int32)
    return first.reshape(-1), last.reshape(-1)
