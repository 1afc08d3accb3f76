"""The timing of recorded motion: frame rate, speed, smoothing, and alignment to the timing of another motion.

A motion is a table of loadings (n, k), one row per frame. All functions except the filter interpolate linearly
between frames, so that a retimed motion stays on the recorded path. Curved interpolation is no more accurate: every
second frame of five real clips was predicted from the others, and the errors of cubic splines differed by -5 to +9 %
from those of linear interpolation, those of monotone cubics by -11 to +2 %.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.imitation.alignment import BAND, align

Ends: TypeAlias = Literal["open", "closed"]
"""Whether a motion ends with its last frame, or goes on with its first one: a loop."""

MOST_FRAMES = 100_000  # frames; an hour at 25 Hz
KERNEL_REACH_SD = 6.0  # SD, plus as many frames; the weight beyond is below a millionth
LARGEST_KERNEL_SD = 10_000  # frames; little but a uniform drift remains beyond it
STEADY_SD_FRAMES = 2.0  # alignment moves in whole frames; unsmoothed, motion would stop and start
TINY = 1e-9  # frames; rounding of n / speed


def at_positions(loadings: LoadingTable, positions: AnyArray, ends: Ends = "open") -> LoadingTable:
    """Interpolate a motion (n, k) linearly at positions (m,) in frames: (m, k).

    Beyond the ends, an open motion keeps its first or last frame; a closed motion repeats. An integer position
    returns the frame bit-equal.

    Examples
    --------
    >>> import numpy as np
    >>> at_positions(np.array([[0.0], [2.0]]), np.array([0.5, 3.0])).ravel().tolist()
    [1.0, 2.0]
    """
    count = len(loadings)
    positions = np.asarray(positions, np.float64)
    if ends == "closed":
        positions = np.mod(positions, count)
    else:
        positions = np.clip(positions, 0, count - 1)
    before = np.minimum(np.floor(positions).astype(np.int64), count - 1)
    after = (before + 1) % count if ends == "closed" else np.minimum(before + 1, count - 1)
    share = (positions - before)[:, None]
    there = loadings[before]
    return np.asarray(np.where(share == 0, there, (1 - share) * there + share * loadings[after]), np.float64)


def retimed(loadings: LoadingTable, speed: float, ends: Ends = "open") -> LoadingTable:
    """Play a motion (n, k) at another speed: (m, k) on the same path.

    An open motion is sampled every `speed` frames from the first; less than one new step remains at its end. A closed
    motion keeps a whole number of frames, and its speed is rounded accordingly.

    Raises
    ------
    BadInput
        If the speed is not above 0, or leaves fewer than 2 or more than 100,000 frames.

    Examples
    --------
    >>> import numpy as np
    >>> retimed(np.array([[0.0], [1], [2], [3], [4]]), 2.0).ravel().tolist()
    [0.0, 2.0, 4.0]
    """
    if not (np.isfinite(speed) and speed > 0):
        raise BadInput(
            f"the speed is {speed:g}; expected a number above 0. Enter, for example, 0.5 or 2, or use `reverse` "
            "to play "
            "backwards"
        )
    length = len(loadings) if ends == "closed" else len(loadings) - 1
    count = length / speed
    if count > MOST_FRAMES:
        raise BadInput(
            f"{len(loadings)} frames at a speed of {speed:g} times become {count:.3g}, at most {MOST_FRAMES} are made: "
            "give a higher speed"
        )
    if ends == "closed":
        frames = round(count)
        positions = np.arange(frames) * (length / max(frames, 1))
    else:
        frames = int(np.floor(count + TINY)) + 1
        positions = np.minimum(np.arange(frames) * speed, length)
    if frames < 2:
        raise BadInput(
            f"{len(loadings)} frames at a speed of {speed:g} times leave {max(frames, 0)}, a motion has at least 2: "
            "give a lower speed"
        )
    return at_positions(loadings, positions, ends)


def in_reverse(loadings: LoadingTable) -> LoadingTable:
    """Reverse a motion (n, k) in time.

    Examples
    --------
    >>> import numpy as np
    >>> in_reverse(np.array([[1.0], [2.0], [3.0]])).tolist()
    [[3.0], [2.0], [1.0]]
    """
    return np.ascontiguousarray(loadings[::-1])


def smoothed(loadings: LoadingTable, cutoff_hz: float, rate_hz: float, ends: Ends = "open") -> LoadingTable:
    """Low-pass filter a motion (n, k), without delay: (n, k).

    An open motion is extended by point reflection at its end frames. The end frames, constant motions and motions of
    constant velocity are therefore unchanged. The filter does not overshoot.

    Parameters
    ----------
    loadings : array (n, k)
    cutoff_hz : float, Hz
        The frequency at which the gain is 1 / sqrt(2).
    rate_hz : float, Hz
        The frame rate.
    ends : "open" or "closed"

    Raises
    ------
    BadInput
        If the cut-off is not between 0 and half the frame rate, or the Gaussian's SD exceeds the motion or 10,000
        frames.

    References
    ----------
    Lindeberg, Scale-space for discrete signals, IEEE PAMI 12, 1990: the discrete Gaussian.

    Examples
    --------
    >>> import numpy as np
    >>> even = np.arange(5.0)[:, None]
    >>> np.allclose(smoothed(even, cutoff_hz=4.0, rate_hz=25.0), even)
    True
    """
    if not (np.isfinite(cutoff_hz) and cutoff_hz > 0):
        raise BadInput(
            f"the cut-off is {cutoff_hz:g} Hz; expected a number above 0. Enter, for example, 6 for a face's motion"
        )
    if cutoff_hz >= rate_hz / 2:
        raise BadInput(
            f"the cut-off is {cutoff_hz:g} Hz; expected less than half the frame rate of {rate_hz:g} Hz. Lower it or "
            "leave out the smoothing"
        )
    largest_sd = min(max(len(loadings), 1), LARGEST_KERNEL_SD)
    least_hz = float(np.arccos(1 - np.log(2) / 2 / largest_sd**2)) * rate_hz / (2 * np.pi)
    if cutoff_hz < least_hz:
        raise BadInput(
            f"a cut-off of {cutoff_hz:g} Hz is too low for {len(loadings)} frames at {rate_hz:g} Hz, of which next to "
            f"nothing would be left: give at least {np.ceil(least_hz * 1e4) / 1e4:g}"
        )
    angle = 2 * np.pi * cutoff_hz / rate_hz
    return _blurred(loadings, float(np.log(2) / 2 / (1 - np.cos(angle))), ends)


def _blurred(values: AnyArray, variance: float, ends: Ends) -> AnyArray:
    """Filter (n, k) along time with the discrete Gaussian of this variance, frames^2: gain exp(v (cos w - 1))."""
    from scipy.special import ive

    if len(values) < 2:
        return np.array(values)
    reach = int(np.ceil(KERNEL_REACH_SD * (np.sqrt(variance) + 1)))
    kernel = ive(np.abs(np.arange(-reach, reach + 1)), variance)
    kernel /= kernel.sum()
    if ends == "closed":
        index = np.mod(np.arange(-reach, len(values) + reach), len(values))
        wide = values[index]
    else:
        wide = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    out = np.empty_like(values, dtype=np.float64)
    for column in range(values.shape[1]):
        out[:, column] = np.convolve(wide[:, column], kernel, mode="valid")
    return out


def positions_like(
    loadings: LoadingTable, guide: LoadingTable, weights: AnyArray, *, band: float = BAND
) -> AnyArray:
    """Return the position in a motion (n, k) of each frame of a guide (m, k): (m,) frames, non-decreasing. Ours.

    The positions are the path of dynamic time warping (`imitation.alignment`). A frame of the guide that the path
    meets several times takes the mean position. A Gaussian of 2 frames smooths the positions and keeps the ends.

    Parameters
    ----------
    loadings : array (n, k)
    guide : array (m, k)
    weights : array (k,)
        The weight of each component in the distances; with the model's SD they are distances between faces.
    band : float
        The largest shift of a frame, as a share of the longer motion.

    References
    ----------
    Sakoe and Chiba, IEEE ASSP 26, 1978 (the path); the smoothing is ours.

    Examples
    --------
    >>> import numpy as np
    >>> guide = np.array([[0.0], [0], [0], [1], [2]])
    >>> positions_like(np.array([[0.0], [1], [2]]), guide, np.ones(1)).round(1).tolist()
    [0.0, 0.3, 0.7, 1.3, 2.0]
    """
    check_same_components(loadings, guide)
    weighed, weighed_guide = (np.asarray(table[:, : len(weights)]) * weights for table in (loadings, guide))
    path = align(weighed_guide, weighed, band=band).path
    count = np.bincount(path[:, 0], minlength=len(guide))
    place = np.bincount(path[:, 0], weights=path[:, 1], minlength=len(guide)) / count
    ends = [0.0, len(loadings) - 1.0]
    place[[0, -1]] = ends
    steady = _blurred(place[:, None], STEADY_SD_FRAMES**2, "open")[:, 0]
    steady[[0, -1]] = ends
    return np.asarray(np.clip(np.maximum.accumulate(steady), ends[0], ends[1]))


def timed_like(
    loadings: LoadingTable, guide: LoadingTable, weights: AnyArray, *, band: float = BAND
) -> LoadingTable:
    """Align a motion (n, k) to the timing of a guide (m, k) of the same model: (m, k), on the motion's own path.

    `positions_like` describes the parameters.

    Examples
    --------
    >>> import numpy as np
    >>> guide = np.array([[0.0], [0], [0], [1], [2]])
    >>> timed_like(np.array([[0.0], [1], [2]]), guide, np.ones(1)).round(1).tolist()
    [[0.0], [0.3], [0.7], [1.3], [2.0]]
    """
    return at_positions(loadings, positions_like(loadings, guide, weights, band=band))


def check_same_components(one: LoadingTable, other: LoadingTable) -> None:
    """Raise `BadInput` if two motions have different numbers of components, or one has no frames."""
    if one.shape[1] != other.shape[1]:
        raise BadInput(
            f"one motion has {one.shape[1]} components, the other {other.shape[1]}; expected equal numbers. "
            "Encode both with the same model"
        )
    if min(len(one), len(other)) < 1:
        raise BadInput("a motion has no frames; expected at least one. Use a table with rows")
