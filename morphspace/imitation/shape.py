"""The shape of a motion, independent of its position and size: centred sequences, their correlation and their lag."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable

LEAST_FRAMES = 3  # frames; with two, every correlation is 1 or -1
LEAST_OVERLAP = 0.5  # of the shorter sequence; fewer frames in common correlate by chance
CONSTANT_TOL = 1e-12  # relative to the largest value; rounding of a constant
WINDOW_TOL = 1e-10  # relative to a column's sum of squares; rounding of running sums


def varies(sequence: AnyArray) -> AnyArray:
    """Return which columns of (..., n, k) are not constant, (..., k) bool.

    Examples
    --------
    >>> import numpy as np
    >>> varies(np.array([[1.0, 5.0], [2.0, 5.0]])).tolist()
    [True, False]
    """
    reach = np.abs(sequence).max(axis=-2)
    return np.asarray(np.ptp(sequence, axis=-2) > CONSTANT_TOL * reach)


def centred(sequence: AnyArray) -> AnyArray:
    """Subtract the mean over frames from each column of (..., n, k); a constant column becomes exactly 0.

    Examples
    --------
    >>> import numpy as np
    >>> centred(np.array([[1.0, 5.0], [3.0, 5.0]])).tolist()
    [[-1.0, 0.0], [1.0, 0.0]]
    """
    moving = varies(sequence)[..., None, :]
    return np.asarray(np.where(moving, sequence - sequence.mean(axis=-2, keepdims=True), 0.0))


def standardised(sequence: LoadingTable) -> LoadingTable:
    """Centre a sequence (n, k), and scale it to a mean squared length of 1 per frame.

    Examples
    --------
    >>> import numpy as np
    >>> standardised(np.array([[1.0], [5.0]])).tolist()
    [[-1.0], [1.0]]
    """
    shape = centred(sequence)
    size = np.sqrt((shape * shape).sum() / len(shape))
    return np.asarray(shape / size) if size > 0 else shape


def ratio(above: AnyArray, below: AnyArray) -> AnyArray:
    """Divide where the denominator is above 0; NaN elsewhere.

    Examples
    --------
    >>> import numpy as np
    >>> ratio(np.array([1.0, 1.0]), np.array([2.0, 0.0])).tolist()
    [0.5, nan]
    """
    out: AnyArray = np.full(np.shape(above), np.nan)
    np.divide(above, below, out=out, where=below > 0)
    return out


def with_total(products: AnyArray) -> AnyArray:
    """Append to the sums of each component (..., k) that of all, (..., k + 1).

    Examples
    --------
    >>> import numpy as np
    >>> with_total(np.array([1.0, 2.0])).tolist()
    [1.0, 2.0, 3.0]
    """
    return np.concatenate([products, products.sum(axis=-1, keepdims=True)], axis=-1)


def similarity(one: AnyArray, other: AnyArray) -> AnyArray:
    """Return the correlation (..., k + 1) of two sequences (..., n, k), per component and last of all together.

    That of all together is the sum of covariances over the root of the product of summed variances: the cosine of the
    two centred motions in the space of faces. NaN if one is constant.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.array([[0.0], [1], [3]])
    >>> similarity(motion, 5 - 2 * motion).round(6).tolist()
    [-1.0, -1.0]
    """
    a, b = centred(one), centred(other)
    along = with_total((a * b).sum(axis=-2))
    sizes = with_total((a * a).sum(axis=-2)) * with_total((b * b).sum(axis=-2))
    return np.clip(ratio(along, np.sqrt(sizes)), -1, 1)


def lag_curves(stimulus: LoadingTable, imitations: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Correlate a stimulus (n, k) with imitations (s, m, k) at each lag: lags (L,) frames, curves (s, L, k + 1).

    At lag L, frame t of the stimulus is paired with frame t + L of the imitation; above 0 the imitation is later.
    Each correlation uses the overlap at its lag, at least `LEAST_OVERLAP` of the shorter sequence. The last column is
    that of all components together; NaN if one is constant.

    Examples
    --------
    >>> import numpy as np
    >>> bump = np.array([[0.0], [1], [4], [1], [0], [0]])
    >>> lags, curves = lag_curves(bump, np.roll(bump, 1, axis=0)[None])
    >>> int(lags[curves[0, :, 0].argmax()])
    1
    """
    n, m = len(stimulus), imitations.shape[1]
    overlap = max(LEAST_FRAMES, int(np.ceil(LEAST_OVERLAP * min(n, m))))
    lags = np.arange(overlap - n, m - overlap + 1)
    a, b = centred(stimulus), centred(imitations)
    length = n + m
    spectrum = np.conj(np.fft.rfft(a, length, axis=0)) * np.fft.rfft(b, length, axis=1)
    cross = np.fft.irfft(spectrum, length, axis=1)[:, lags % length]
    first, last = np.maximum(0, -lags), np.minimum(n, m - lags)
    count = (last - first)[:, None]
    sum_a, square_a = _window_sums(a, first, last)
    sum_b, square_b = _window_sums(b, first + lags, last + lags)
    along = with_total(cross - sum_a * sum_b / count)
    spread_a = with_total(square_a - sum_a**2 / count)
    spread_b = with_total(square_b - sum_b**2 / count)
    floor_a = WINDOW_TOL * with_total((a * a).sum(axis=0))
    floor_b = WINDOW_TOL * with_total((b * b).sum(axis=1))[:, None]
    is_moving = (spread_a > floor_a) & (spread_b > floor_b)
    sizes = np.where(is_moving, np.maximum(spread_a, 0) * np.maximum(spread_b, 0), 0)
    return lags, np.clip(ratio(along, np.sqrt(sizes)), -1, 1)


def _window_sums(values: AnyArray, first: AnyArray, last: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the sums of values (..., n, k) and of their squares over frames `first` to `last` - 1, (..., L, k)."""
    zero = np.zeros((*values.shape[:-2], 1, values.shape[-1]))
    sums = []
    for each in (values, values * values):
        running = np.concatenate([zero, np.cumsum(each, axis=-2)], axis=-2)
        sums.append(running[..., last, :] - running[..., first, :])
    return sums[0], sums[1]


def peak(curve: AnyArray, lags: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Return the lag (frames) and the height of the maximum of each column of a curve (L, k + 1).

    Equal maxima give the smallest lag; NaN if a column is undefined at all lags.

    Examples
    --------
    >>> import numpy as np
    >>> lag, height = peak(np.array([[0.2], [0.9], [0.4]]), np.array([-1, 0, 1]))
    >>> lag.tolist(), height.tolist()
    ([0.0], [0.9])
    """
    order = np.argsort(np.abs(lags), kind="stable")
    known = np.isfinite(curve)
    place = order[np.where(known, np.round(curve, 9), -2.0)[order].argmax(axis=0)]
    height = curve[place, np.arange(curve.shape[1])]
    return np.where(known.any(axis=0), lags[place], np.nan), height
