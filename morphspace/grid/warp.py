"""Sample, invert and compose displacement fields: the geometry under every morph.

A displacement u lives on a grid and says that the point p is found at p + u(p). `sample` reads an image there (the
backward warp). `render` puts each grid point where the field sends it (the forward warp). The forward warp is exact:
the grid is cut into triangles, the triangles are moved, and each output pixel asks which triangle covers it. A
fixed-point iteration would lose most of an opening mouth: there the field stretches one line of skin over many
pixels, and the iteration does not contract.

Images are read with the interpolating cubic B-spline (Unser, Splines: a perfect fit for signal and image processing,
IEEE Signal Processing Magazine 1999), which reproduces polynomials up to the third order. OpenCV's own cubic does not
reproduce a ramp, and its Lanczos filter rounds positions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points
from morphspace.errors import BadInput
from morphspace.grid.triangles import MovedGrid

SPLINE_POLE = np.sqrt(3.0) - 2.0  # of the cubic B-spline's inverse filter
SPLINE_TAPS = 15  # a side; the pole to this power is 3e-9, below float32
STRIP_PX = 2**14  # read at a time: some twenty planes of a strip fit in the cache
FIXED_POINT_STEPS = 2  # before the triangles are asked; more find few pixels more


def sample(image: Image, displacement: Displacement) -> Image:
    """Read an image at p + u(p) for each grid point p, by interpolating cubic B-spline.

    Parameters
    ----------
    image : array (H, W, c) or (H, W) float32
    displacement : array (h, w, 2) float32
        u in px, to the right and down. Points outside the image take the value of its nearest edge point.

    Returns
    -------
    array (h, w, c) or (h, w) float32
        The image's range plus the small overshoot of a sharp edge. Zero displacement returns the image to 1e-6.

    Raises
    ------
    BadInput
        If the displacement is not finite.

    References
    ----------
    Unser, Splines: a perfect fit for signal and image processing, IEEE Signal Processing Magazine 16, 1999.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.arange(5, dtype=np.float32).repeat(4).reshape(5, 4)
    >>> one_down = np.zeros((5, 4, 2), np.float32) + (0, 1)
    >>> sample(ramp, one_down)[:, 0].round(3).tolist()
    [1.0, 2.0, 3.0, 4.0, 4.0]
    """
    x, y = positions(displacement)
    return sample_at(image, x, y)


def sample_at(image: Image, x: AnyArray, y: AnyArray) -> Image:
    """Read an image (H, W, c) or (H, W) at the points (x, y) px, arrays of one shape (h, w), as `sample` does.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.array([[0.0, 2.0], [4.0, 6.0]], np.float32)
    >>> sample_at(image, np.array([[0.5]]), np.array([[1.0]])).round(3).tolist()
    [[5.0]]
    """
    _check_positions(x, y)
    if image.ndim == 2:
        return spline_reader([image])(x, y)[0]
    found = spline_reader([image[..., c] for c in range(image.shape[2])])(x, y)
    return cv2.merge(list(found)).reshape(*x.shape, len(found))


def spline_reader(planes: Sequence[AnyArray] | AnyArray) -> Callable[[AnyArray, AnyArray], AnyArray]:
    """Return the function that reads c planes (H, W) at finite points (x, y) px, by cubic B-spline.

    The function takes two arrays (h, w) and returns (c, h, w). Three or four planes are read together as four
    channels, which OpenCV does in little more than the time of one. The points are read in strips of rows that fit
    the processor's cache.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.tile(np.arange(30, dtype=np.float32), (4, 1))
    >>> round(spline_reader([ramp])(np.array([[14.5]]), np.array([[2.0]])).item(), 3)
    14.5
    """
    height, width = planes[0].shape
    count = len(planes)
    coefficients = [spline_coefficients(plane) for plane in planes]
    together = count in (3, 4)
    if together:
        coefficients = [cv2.merge((coefficients + coefficients[:1])[:4])]

    def read(x: AnyArray, y: AnyArray) -> AnyArray:
        out = np.empty((count, *x.shape), np.float32)
        step = max(1, STRIP_PX // x.shape[1])
        for top in range(0, len(x), step):
            rows = slice(top, top + step)
            position = np.maximum([x[rows], y[rows]], 0)
            np.minimum(position[0], width - 1, out=position[0])
            np.minimum(position[1], height - 1, out=position[1])
            pairs = _spline_pairs(position)
            for image, targets in zip(coefficients, out[None] if together else out[:, None], strict=True):
                _read_pairs(image, pairs, targets[:, rows])
        return out

    return read


def _read_pairs(image: AnyArray, pairs: tuple[AnyArray, ...], targets: AnyArray) -> None:
    """Write the first channels of spline coefficients (H, W) or (H, W, 4), looked up by `_spline_pairs`, to targets."""
    (left, top), (right, bottom), (from_left, from_top), (from_right, from_bottom) = pairs
    corners = [_linear(image, column, row) for row in (top, bottom) for column in (left, right)]
    several = image.ndim == 3
    for channel, target in enumerate(targets):
        upper, upper_right, lower, lower_right = (
            cv2.extractChannel(corner, channel) if several else corner for corner in corners
        )
        upper *= from_left
        upper_right *= from_right
        upper += upper_right
        upper *= from_top
        lower *= from_left
        lower_right *= from_right
        lower += lower_right
        lower *= from_bottom
        np.add(upper, lower, out=target)


def _check_positions(x: AnyArray, y: AnyArray) -> None:
    """Raise `BadInput` if a position is not finite: OpenCV would reflect it at the edges for ever."""
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise BadInput(
            "a displacement holds values that are not finite: look at the image or the loadings it came from"
        )


def spline_coefficients(image: Image) -> Image:
    """Return the cubic B-spline coefficients that interpolate an image (H, W, c), mirrored at its edges; same shape."""
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
    w3 = f * f
    w1 = 2 / 3 - w3
    w3 *= f
    w1 += w3 / 2
    w3 /= 6
    g = np.subtract(1, f, out=f)
    first = g * g
    first *= g
    first /= 6
    first += w1
    second = 1 - first
    w1 /= first
    w1 -= 1
    w1 += whole
    w3 /= second
    whole += 1
    whole += w3
    return w1, whole, first, second


def _linear(image: AnyArray, x: AnyArray, y: AnyArray) -> AnyArray:
    """Read an image linearly at (x, y). OpenCV rounds positions to 1/32 px for two channels: those go one by one."""
    if image.ndim == 3 and image.shape[2] == 2:
        return np.stack([_linear(np.ascontiguousarray(image[..., c]), x, y) for c in range(2)], axis=-1)
    x, y = x.astype(np.float32, copy=False), y.astype(np.float32, copy=False)
    out: AnyArray = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    return out


def sample_field(field: AnyArray, displacement: Displacement) -> AnyArray:
    """Read a field (H, W, c) at p + u(p) linearly, with its edge values continued outside.

    Displacements are piecewise linear between grid points everywhere in morphspace, so this reading is exact.

    Raises
    ------
    BadInput
        If the displacement is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> right = np.zeros((1, 3, 2), np.float32)
    >>> right[..., 0] = 0.5
    >>> sample_field(np.float32([[0, 10, 30]]), right).tolist()
    [[5.0, 20.0, 30.0]]
    """
    x, y = positions(displacement)
    _check_positions(x, y)
    height, width = field.shape[:2]
    return _linear(field, np.clip(x, 0, width - 1), np.clip(y, 0, height - 1))


def positions(displacement: Displacement) -> tuple[AnyArray, AnyArray]:
    """Return p + u(p) as two arrays (h, w) float32, x and y in px: Nagle's absolute coding of a warp (section 2).

    Examples
    --------
    >>> import numpy as np
    >>> x, y = positions(np.full((1, 2, 2), 0.5, np.float32))
    >>> x.tolist(), y.tolist()
    ([[0.5, 1.5]], [[0.5, 0.5]])
    """
    height, width = displacement.shape[:2]
    x = displacement[..., 0] + np.arange(width, dtype=np.float32)
    y = displacement[..., 1] + np.arange(height, dtype=np.float32)[:, None]
    return x, y


def compose(outer: Displacement, inner: Displacement) -> Displacement:
    """Compose two displacements: through `inner` first, then `outer`, v(p) + u(p + v(p)), (h, w, 2) px.

    Examples
    --------
    >>> import numpy as np
    >>> right, down = np.zeros((4, 4, 2), np.float32) + (1, 0), np.zeros((4, 4, 2), np.float32) + (0, 2)
    >>> compose(down, right)[0, 0].tolist()
    [1.0, 2.0]
    """
    out: Displacement = inner + sample_field(outer, inner)
    return out


def render(texture: Image, displacement: Displacement) -> Image:
    """Put each point p of a texture (h, w, c) at p + u(p): the forward warp, by exact rasterisation.

    Where the field folds, `invert` chooses which point is visible. A pixel whose point lies outside the texture takes
    the colour of the point mirrored at the edge, which continues the surroundings where the edge's own colour would
    smear into stripes.

    Parameters
    ----------
    texture : array (h, w, c) float32
    displacement : array (h, w, 2) float32, px

    Returns
    -------
    array (h, w, c) float32

    Raises
    ------
    BadInput
        If the displacement is not finite.

    References
    ----------
    Nagle et al., section 2, steps 1 and 2 (the rendering of a morph); the rasterisation is ours.

    Examples
    --------
    >>> import numpy as np
    >>> dot = np.zeros((5, 5, 1), np.float32)
    >>> dot[2, 2] = 1
    >>> moved = render(dot, np.zeros((5, 5, 2), np.float32) + (1, 1))
    >>> np.argwhere(moved[..., 0] > 0.5).tolist()
    [[3, 3]]
    """
    points = positions(invert(displacement))
    x, y = (_mirrored(at, size) for at, size in zip(points, texture.shape[1::-1], strict=True))
    return sample_at(texture, x, y)


def _mirrored(position: AnyArray, size: int) -> AnyArray:
    """Mirror positions px at the first and last of `size` pixels."""
    last = size - 1
    outside = (position < 0) | (position > last)
    position[outside] = last - np.abs(last - np.mod(position[outside], max(2 * last, 1)))
    return position


def invert(displacement: Displacement) -> Displacement:
    """Invert a displacement: return v with q + v(q) = p wherever p + u(p) = q, (h, w, 2) px.

    The grid is read as triangles, each cell cut from its upper right to its lower left corner and linear in between;
    the inverse is exact on them. Outside the grid the field continues with its edge values. Where the field folds,
    several points land on one pixel: the most stretched triangle wins, and a flipped triangle (determinant <= 0)
    loses against any other. A pixel that no triangle covers takes the value of the nearest covered pixel.

    Raises
    ------
    BadInput
        If the displacement is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> to_right = np.zeros((5, 5, 2), np.float32)
    >>> to_right[..., 0] = 1.5
    >>> invert(to_right)[2, 2].tolist()
    [-1.5, 0.0]
    """
    _check_positions(displacement[..., 0], displacement[..., 1])
    displacement = displacement.astype(np.float32, copy=False)
    grid = MovedGrid(displacement)
    back, is_known = grid.walked(_fixed_point(displacement))
    doubtful = ~is_known | grid.where_folds
    if not doubtful.any():
        return back
    searched, is_covered = grid.searched(doubtful)
    inverse = np.where(doubtful[..., None], searched, back)
    missing = doubtful & ~is_covered
    return _filled_from_nearest(inverse, missing) if missing.any() else inverse


def _fixed_point(displacement: Displacement) -> tuple[AnyArray, AnyArray]:
    """Give about where each pixel comes from, x and y px (h, w): a few steps of p = q - u(p)."""
    height, width = displacement.shape[:2]
    to_x, to_y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    moved = displacement
    for step in range(FIXED_POINT_STEPS + 1):
        x, y = to_x - moved[..., 0], to_y - moved[..., 1]
        if step < FIXED_POINT_STEPS:
            moved = cv2.remap(displacement, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return x, y


def _filled_from_nearest(field: AnyArray, missing: AnyArray) -> AnyArray:
    _, labels = cv2.distanceTransformWithLabels(
        missing.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known = np.flatnonzero(~missing.ravel())
    source = np.zeros(labels.max() + 1, np.int64)
    source[labels.ravel()[known]] = known
    return field.reshape(-1, field.shape[2])[source[labels.ravel()]].reshape(field.shape)


def determinants(displacement: Displacement) -> AnyArray:
    """Return the smaller determinant of each cell's two triangles, (h - 1, w - 1).

    It is 1 without a displacement, and <= 0 where the field folds.

    Examples
    --------
    >>> import numpy as np
    >>> wider = np.zeros((2, 2, 2), np.float32)
    >>> wider[:, 1, 0] = 1
    >>> determinants(wider).tolist()
    [[2.0]]
    """
    x, y = displacement[..., 0], displacement[..., 1]
    ab_x, ab_y = x[:, 1:] - x[:, :-1], y[:, 1:] - y[:, :-1]
    ac_x, ac_y = x[1:] - x[:-1], y[1:] - y[:-1]
    ab_x += 1
    ac_y += 1
    upper = ab_x[:-1] * ac_y[:, :-1]
    upper -= ab_y[:-1] * ac_x[:, :-1]
    lower = ab_x[1:] * ac_y[:, 1:]
    lower -= ab_y[1:] * ac_x[:, 1:]
    return np.minimum(upper, lower, out=lower)


def fold_fraction(displacement: Displacement, mask: Mask) -> float:
    """Return the share of folded grid cells, of those whose upper left corner lies inside the mask (> 0.5).

    Examples
    --------
    >>> import numpy as np
    >>> mirrored = np.zeros((3, 3, 2), np.float32)
    >>> mirrored[..., 0] = [2, 0, -2]
    >>> fold_fraction(mirrored, np.ones((3, 3), np.float32))
    1.0
    """
    inside = mask[:-1, :-1] > 0.5
    cells = int(inside.sum())
    return float((determinants(displacement)[inside] <= 0).sum() / cells) if cells else 0.0


def affine_displacement(affine: Affine, height: int, width: int) -> Displacement:
    """Return the field u with p + u(p) = A p + t on a grid of (height, width) px, (h, w, 2) px.

    Examples
    --------
    >>> import numpy as np
    >>> twice = np.array([[2.0, 0, 0], [0, 2, 0]])
    >>> affine_displacement(twice, 2, 3)[1, 2].tolist()
    [2.0, 1.0]
    """
    x, y = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)[:, None]
    linear = affine[:, :2] - np.eye(2)
    out = np.empty((height, width, 2), np.float32)
    for axis in (0, 1):
        out[..., axis] = (linear[axis, 0] * x + affine[axis, 2]) + linear[axis, 1] * y
    return out


def inverse_affine(affine: Affine) -> Affine:
    """Invert an affine (2, 3).

    Examples
    --------
    >>> import numpy as np
    >>> inverse_affine(np.array([[2.0, 0, 6], [0, 2, 0]])).tolist()
    [[0.5, 0.0, -3.0], [0.0, 0.5, 0.0]]
    """
    linear = np.linalg.inv(affine[:, :2])
    return np.column_stack([linear, -linear @ affine[:, 2]])


def chain_affine(outer: Affine, inner: Affine) -> Affine:
    """Compose two affines (2, 3): `inner` first, then `outer`.

    Examples
    --------
    >>> import numpy as np
    >>> twice, shift = np.array([[2.0, 0, 0], [0, 2, 0]]), np.array([[1.0, 0, 5], [0, 1, 0]])
    >>> chain_affine(twice, shift).tolist()
    [[2.0, 0.0, 10.0], [0.0, 2.0, 0.0]]
    """
    return np.column_stack([outer[:, :2] @ inner[:, :2], outer[:, :2] @ inner[:, 2] + outer[:, 2]])


def apply_affine(affine: Affine, points: Points) -> Points:
    """Move points (m, 2) px by an affine (2, 3).

    Examples
    --------
    >>> import numpy as np
    >>> apply_affine(np.array([[2.0, 0, 1], [0, 2, 0]]), np.array([[3.0, 4]])).tolist()
    [[7.0, 8.0]]
    """
    return points @ affine[:, :2].T + affine[:, 2]


def move_points(displacement: Displacement, points: Points) -> Points:
    """Move points (m, 2) px on the grid by a field (h, w, 2): p + u(p), with u read linearly.

    Examples
    --------
    >>> import numpy as np
    >>> down = np.zeros((4, 4, 2), np.float32)
    >>> down[..., 1] = 0.5
    >>> move_points(down, np.array([[1.0, 2.0]])).tolist()
    [[1.0, 2.5]]
    """
    x = points[None, :, 0].astype(np.float32)
    y = points[None, :, 1].astype(np.float32)
    height, width = displacement.shape[:2]
    moved = _linear(displacement, np.clip(x, 0, width - 1), np.clip(y, 0, height - 1))[0]
    return points + moved.astype(np.float64)
