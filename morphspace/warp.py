"""Sampling, inverting and composing displacement fields: the geometry under every morph.

A displacement u lives on a grid and says that the point p is found at p + u(p). `sample` reads an image there (the
backward warp); `render` does the opposite and puts each grid point where the field sends it (the forward warp). The
forward warp is exact: the grid is cut into triangles, the triangles are moved, and each output pixel asks which
triangle covers it. An iteration to a fixed point would lose most of an opening mouth, because there the field
stretches one line of skin over many pixels and the iteration does not contract.

Images are read with the interpolating cubic B-spline (Unser, Splines: a perfect fit for signal and image processing,
IEEE Signal Processing Magazine 1999), which reproduces polynomials to the third order; OpenCV's own cubic does not
reproduce a ramp and its Lanczos rounds the position.
"""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points

SPLINE_POLE = np.sqrt(3.0) - 2.0  # of the cubic B-spline's inverse filter
SPLINE_TAPS = 15  # a side; the pole to this power is 3e-9, below float32
EDGE_TOLERANCE = 1e-4  # cells; a pixel on a shared edge belongs to both triangles, so that no crack opens
MARGIN_PX = (
    2.0  # beyond the largest displacement: the ring of cells that continues the field outside the grid
)


def sample(image: Image, displacement: Displacement) -> Image:
    """Read `image` at p + u(p) for each grid point p, by interpolating cubic B-spline.

    Parameters: image (H, W, c) or (H, W) float32; displacement u (h, w, 2) px. Points outside the image take the
    value of its nearest edge point. Returns (h, w, c), the image's own range plus the small overshoot a sharp edge
    gives. Zero displacement returns the image to 1e-6.
    """
    x, y = positions(displacement)
    return sample_at(image, x, y)


def sample_at(image: Image, x: AnyArray, y: AnyArray) -> Image:
    """Read `image` (H, W, c) at the points (x, y) px, arrays of one shape (h, w), by cubic B-spline; see `sample`."""
    coefficients = spline_coefficients(image)
    height, width = image.shape[:2]
    (left, right, from_left, from_right) = _spline_pairs(np.clip(x, 0, width - 1))
    (top, bottom, from_top, from_bottom) = _spline_pairs(np.clip(y, 0, height - 1))
    if image.ndim == 3:
        from_left, from_right = from_left[..., None], from_right[..., None]
        from_top, from_bottom = from_top[..., None], from_bottom[..., None]
    upper = _linear(coefficients, left, top) * from_left
    upper += _linear(coefficients, right, top) * from_right
    upper *= from_top
    lower = _linear(coefficients, left, bottom) * from_left
    lower += _linear(coefficients, right, bottom) * from_right
    lower *= from_bottom
    upper += lower
    return upper


def spline_coefficients(image: Image) -> Image:
    """Give the cubic B-spline coefficients that interpolate `image`, mirrored at its edges; same shape."""
    taps = np.arange(-SPLINE_TAPS, SPLINE_TAPS + 1)
    kernel = -6 * SPLINE_POLE / (1 - SPLINE_POLE**2) * SPLINE_POLE ** np.abs(taps)
    kernel /= kernel.sum()  # a constant stays that constant
    out: Image = cv2.sepFilter2D(
        np.ascontiguousarray(image, np.float32), -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101
    )
    return out


def _spline_pairs(position: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Turn the four cubic B-spline taps at `position` into two linear look-ups and their weights.

    Between neighbours i and i + 1 a linear look-up weighs them f and 1 - f, so two look-ups carry four taps (Sigg and
    Hadwiger, GPU Gems 2, chapter 20).
    """
    whole = np.floor(position)
    f = position - whole
    g = 1 - f
    w0 = g * g * g / 6
    w3 = f * f * f / 6
    w1 = 2 / 3 - f * f + w3 * 3
    second = 1 - w0 - w1
    first = w0 + w1
    return whole - 1 + w1 / first, whole + 1 + w3 / second, first, second


def _linear(image: AnyArray, x: AnyArray, y: AnyArray) -> AnyArray:
    """Read an image linearly at (x, y). OpenCV rounds positions to 1/32 px for two channels: those go one by one."""
    if image.ndim == 3 and image.shape[2] == 2:
        return np.stack([_linear(np.ascontiguousarray(image[..., c]), x, y) for c in range(2)], axis=-1)
    x, y = x.astype(np.float32, copy=False), y.astype(np.float32, copy=False)
    out: AnyArray = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    return out


def sample_field(field: AnyArray, displacement: Displacement) -> AnyArray:
    """Read a field (H, W, c) at p + u(p) linearly, its edge values continued outside; the field of a smooth thing.

    Displacements are piecewise linear between grid points everywhere in morphspace, so this reading is exact.
    """
    x, y = positions(displacement)
    height, width = field.shape[:2]
    return _linear(field, np.clip(x, 0, width - 1), np.clip(y, 0, height - 1))


def positions(displacement: Displacement) -> tuple[AnyArray, AnyArray]:
    """Give p + u(p) as two (h, w) float32 arrays, x and y px: Nagle's absolute coding of a warp (section 2)."""
    height, width = displacement.shape[:2]
    x = displacement[..., 0] + np.arange(width, dtype=np.float32)
    y = displacement[..., 1] + np.arange(height, dtype=np.float32)[:, None]
    return x, y


def compose(outer: Displacement, inner: Displacement) -> Displacement:
    """Give the displacement that goes through `inner` first, then `outer`: v(p) + u(p + v(p)), (h, w, 2) px."""
    out: Displacement = inner + sample_field(outer, inner)
    return out


def render(texture: Image, displacement: Displacement) -> Image:
    """Put each point p of `texture` (h, w, c) at p + u(p): the forward warp, by exact rasterisation.

    Where the field folds, the point shown is the one `invert` chooses.
    """
    return sample(texture, invert(displacement))


def invert(displacement: Displacement) -> Displacement:
    """Give v with q + v(q) = p wherever p + u(p) = q: the inverse of the field, (h, w, 2) px.

    The grid is read as triangles (each cell cut from its upper right to its lower left corner), linear in between; the
    inverse is exact on them. Outside the grid the field goes on with its edge values. Where the field folds, several
    points land on one pixel: the one whose triangle is most stretched wins, and a triangle turned over (determinant
    <= 0) loses against any that is not. A pixel that no triangle covers takes the value of the nearest that is
    covered.
    """
    height, width = displacement.shape[:2]
    vertex_x, vertex_y, step_x, step_y = _moved_grid(displacement)
    cells = _Cells(vertex_x, vertex_y)
    cell, qx, qy = cells.candidates(height, width)
    proper = cells.proper[cell]
    hits = [_hits(cells, cell[proper], qx[proper], qy[proper], None)]
    if not proper.all():
        folded = ~proper
        hits += [_hits(cells, cell[folded], qx[folded], qy[folded], upper) for upper in (True, False)]
    cell, qx, qy, across, down, stretch = (np.concatenate(parts) for parts in zip(*hits, strict=True))
    row, column = np.divmod(cell, cells.columns)
    x = step_x[column] + across * (step_x[column + 1] - step_x[column])
    y = step_y[row] + down * (step_y[row + 1] - step_y[row])
    target = qy * width + qx
    covered = np.bincount(target, minlength=height * width)
    if covered.max(initial=0) > 1:
        order = _least_stretched_first(target, stretch, covered)
        target, x, y = target[order], x[order], y[order]
    inverse = np.empty((height * width, 2), np.float32)
    inverse[target, 0] = x - target % width
    inverse[target, 1] = y - target // width
    inverse = inverse.reshape(height, width, 2)
    missing = (covered == 0).reshape(height, width)
    if missing.any():
        inverse = _filled_from_nearest(inverse, missing)
    return inverse


def _moved_grid(displacement: Displacement) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Give the moved vertices (h + 2, w + 2), x and y, and the places they came from along each axis.

    The outermost ring stands far outside the grid and moves with the edge, so that the cells cover every pixel.
    """
    height, width = displacement.shape[:2]
    margin = np.float32(np.abs(displacement).max(initial=0) + MARGIN_PX)
    step_x = np.concatenate([[-margin], np.arange(width), [width - 1 + margin]]).astype(np.float32)
    step_y = np.concatenate([[-margin], np.arange(height), [height - 1 + margin]]).astype(np.float32)
    ringed = cv2.copyMakeBorder(displacement, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    return ringed[..., 0] + step_x, ringed[..., 1] + step_y[:, None], step_x, step_y


class _Cells:
    """The moved grid cells as flat arrays: corners a b / c d, edges, and the two triangles' determinants."""

    def __init__(self, x: AnyArray, y: AnyArray) -> None:
        self.columns = x.shape[1] - 1
        self.ax, self.ay = x[:-1, :-1].ravel(), y[:-1, :-1].ravel()
        self.dx, self.dy = x[1:, 1:].ravel(), y[1:, 1:].ravel()
        bx, by = x[:-1, 1:].ravel(), y[:-1, 1:].ravel()
        cx, cy = x[1:, :-1].ravel(), y[1:, :-1].ravel()
        self.bx, self.by = bx, by
        self.cut_x, self.cut_y = cx - bx, cy - by
        self.ab_x, self.ab_y, self.ac_x, self.ac_y = bx - self.ax, by - self.ay, cx - self.ax, cy - self.ay
        self.dc_x, self.dc_y, self.db_x, self.db_y = cx - self.dx, cy - self.dy, bx - self.dx, by - self.dy
        self.upper = self.ab_x * self.ac_y - self.ab_y * self.ac_x
        self.lower = self.dc_x * self.db_y - self.dc_y * self.db_x
        self.proper = (self.upper > 0) & (self.lower > 0)
        self.left, self.right = _extent(self.ax, bx, cx, self.dx)
        self.top, self.bottom = _extent(self.ay, by, cy, self.dy)

    def candidates(self, height: int, width: int) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Give every (cell, x, y) where the pixel lies in the cell's bounding box; a handful a pixel."""
        first_x = np.maximum(np.ceil(self.left - EDGE_TOLERANCE), 0).astype(np.int32)
        first_y = np.maximum(np.ceil(self.top - EDGE_TOLERANCE), 0).astype(np.int32)
        wide = np.minimum(np.floor(self.right + EDGE_TOLERANCE), width - 1).astype(np.int32) - first_x + 1
        high = np.minimum(np.floor(self.bottom + EDGE_TOLERANCE), height - 1).astype(np.int32) - first_y + 1
        count = np.where((wide > 0) & (high > 0), wide * high, 0)
        busy = np.flatnonzero(count)
        count = count[busy]
        cell = np.repeat(busy, count)
        place = np.arange(cell.size, dtype=np.int32) - np.repeat(
            np.cumsum(count, dtype=np.int32) - count, count
        )
        row, column = np.divmod(place, wide[cell])
        return cell, first_x[cell] + column, first_y[cell] + row


def _extent(a: AnyArray, b: AnyArray, c: AnyArray, d: AnyArray) -> tuple[AnyArray, AnyArray]:
    return np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))


def _hits(
    cells: _Cells, cell: AnyArray, qx: AnyArray, qy: AnyArray, upper: bool | None
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray, AnyArray, AnyArray]:
    """Keep the candidates that a triangle covers, with their place in the cell (across, down in [0, 1]).

    In a proper cell the side of the cut tells which triangle to ask (`upper` None); in a folded one both are asked.
    """
    if upper is None:
        side = cells.cut_x[cell] * (qy - cells.by[cell]) - cells.cut_y[cell] * (qx - cells.bx[cell])
        in_upper = side >= 0
    else:
        in_upper = np.full(cell.shape, upper)
    px = (qx - np.where(in_upper, cells.ax[cell], cells.dx[cell])).astype(np.float32)
    py = (qy - np.where(in_upper, cells.ay[cell], cells.dy[cell])).astype(np.float32)
    e_x = np.where(in_upper, cells.ab_x[cell], cells.dc_x[cell])
    e_y = np.where(in_upper, cells.ab_y[cell], cells.dc_y[cell])
    f_x = np.where(in_upper, cells.ac_x[cell], cells.db_x[cell])
    f_y = np.where(in_upper, cells.ac_y[cell], cells.db_y[cell])
    stretch = np.where(in_upper, cells.upper[cell], cells.lower[cell])
    scale = 1 / np.where(stretch == 0, np.float32(np.inf), stretch)
    along = (px * f_y - py * f_x) * scale
    beside = (e_x * py - e_y * px) * scale
    inside = (along >= -EDGE_TOLERANCE) & (beside >= -EDGE_TOLERANCE) & (along + beside <= 1 + EDGE_TOLERANCE)
    inside &= stretch != 0
    across = np.where(in_upper, along, 1 - along)
    down = np.where(in_upper, beside, 1 - beside)
    return cell[inside], qx[inside], qy[inside], across[inside], down[inside], stretch[inside]


def _least_stretched_first(target: AnyArray, stretch: AnyArray, covered: AnyArray) -> AnyArray:
    """Order the hits so that, written one over the other, the most stretched stays; ties keep raster order."""
    shared = covered[target] > 1
    several = np.flatnonzero(shared)
    return np.concatenate([np.flatnonzero(~shared), several[np.argsort(stretch[several], kind="stable")]])


def _filled_from_nearest(field: AnyArray, missing: AnyArray) -> AnyArray:
    _, labels = cv2.distanceTransformWithLabels(
        missing.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known = np.flatnonzero(~missing.ravel())
    source = np.zeros(labels.max() + 1, np.int64)
    source[labels.ravel()[known]] = known
    return field.reshape(-1, field.shape[2])[source[labels.ravel()]].reshape(field.shape)


def determinants(displacement: Displacement) -> AnyArray:
    """Give the smaller determinant of each cell's two triangles, (h - 1, w - 1): 1 at rest, <= 0 where it folds."""
    x, y = positions(displacement)
    ab_x, ab_y = np.diff(x, axis=1), np.diff(y, axis=1)
    ac_x, ac_y = np.diff(x, axis=0), np.diff(y, axis=0)
    upper = ab_x[:-1] * ac_y[:, :-1] - ab_y[:-1] * ac_x[:, :-1]
    lower = ab_x[1:] * ac_y[:, 1:] - ab_y[1:] * ac_x[:, 1:]
    return np.minimum(upper, lower)


def fold_fraction(displacement: Displacement, mask: Mask) -> float:
    """Give the share of grid cells inside the mask (> 0.5 at the cell's upper left) that the field turns over."""
    inside = mask[:-1, :-1] > 0.5
    cells = int(inside.sum())
    return float((determinants(displacement)[inside] <= 0).sum() / cells) if cells else 0.0


def affine_displacement(affine: Affine, height: int, width: int) -> Displacement:
    """Give the field u with p + u(p) = A p + t on a (height, width) grid, (h, w, 2) px."""
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    moved = np.stack([affine[i, 0] * x + affine[i, 1] * y + affine[i, 2] for i in (0, 1)], axis=-1)
    return (moved - np.stack([x, y], axis=-1)).astype(np.float32)


def inverse_affine(affine: Affine) -> Affine:
    """Give the affine (2, 3) that undoes `affine`."""
    linear = np.linalg.inv(affine[:, :2])
    return np.column_stack([linear, -linear @ affine[:, 2]])


def chain_affine(outer: Affine, inner: Affine) -> Affine:
    """Give the affine (2, 3) that applies `inner` first, then `outer`."""
    return np.column_stack([outer[:, :2] @ inner[:, :2], outer[:, :2] @ inner[:, 2] + outer[:, 2]])


def apply_affine(affine: Affine, points: Points) -> Points:
    """Move points (m, 2) px by an affine (2, 3)."""
    return points @ affine[:, :2].T + affine[:, 2]


def move_points(displacement: Displacement, points: Points) -> Points:
    """Move points (m, 2) px on the grid by the field: p + u(p), u read linearly."""
    x = points[None, :, 0].astype(np.float32)
    y = points[None, :, 1].astype(np.float32)
    height, width = displacement.shape[:2]
    moved = _linear(displacement, np.clip(x, 0, width - 1), np.clip(y, 0, height - 1))[0]
    return points + moved.astype(np.float64)
