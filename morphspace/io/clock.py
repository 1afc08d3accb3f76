"""The times of frames: which recordings are uneven, and where even samples of them lie (ours).

Phones, webcams and browsers take frames when they can, and recorders lose some. A motion is counted in seconds, so it
is sampled at even times, linear between the frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morphspace.arrays import AnyArray

EVEN_TOL = 0.02  # of a frame; files keep times as decimals, and a face moves less than its loadings' noise
WHOLE_TOL = 1e-6  # of a frame; rounding of times in s


def is_even(times_s: Sequence[float] | AnyArray | None, rate_hz: float | None) -> bool:
    """Return whether frames follow each other at the rate; also if the times (n,) s or the rate are unknown.

    Examples
    --------
    >>> is_even((0.0, 0.04, 0.08), 25.0), is_even((0.0, 0.04, 0.12), 25.0)
    (True, False)
    """
    if times_s is None or rate_hz is None:
        return True
    places = np.asarray(times_s, np.float64) * rate_hz
    return bool(np.abs(places - places[:1] - np.arange(len(places))).max(initial=0) <= EVEN_TOL)


def even_positions(times_s: Sequence[float] | AnyArray, rate_hz: float) -> AnyArray:
    """Return where even samples at a rate, Hz, lie among frames with these times (n,), s: (m,) in frames.

    The first sample is the first frame; less than one step remains after the last.

    Examples
    --------
    >>> even_positions((0.0, 0.04, 0.12), 25.0).round(6).tolist()
    [0.0, 1.0, 1.5, 2.0]
    """
    times = np.asarray(times_s, np.float64) - times_s[0]
    count = int(np.floor(times[-1] * rate_hz + WHOLE_TOL)) + 1
    positions = np.interp(np.arange(count) / rate_hz, times, np.arange(len(times)))
    whole = np.rint(positions)
    return np.where(np.abs(positions - whole) <= WHOLE_TOL, whole, positions)


def frames_shown(count: int, times_s: Sequence[float] | AnyArray | None, rate_hz: float | None) -> AnyArray:
    """Return the frame (m,) that each picture of a video at even times shows: the nearest of `count` frames.

    Examples
    --------
    >>> frames_shown(3, (0.0, 0.04, 0.16), 25.0).tolist()
    [0, 1, 1, 2, 2]
    """
    if times_s is None or rate_hz is None or is_even(times_s, rate_hz):
        return np.arange(count)
    return np.rint(even_positions(times_s, rate_hz)).astype(np.intp)


def sampled_at(values: AnyArray, positions: AnyArray) -> AnyArray:
    """Interpolate rows (n, k) linearly at positions (m,) in frames, (m, k); whole positions give rows bit-equal.

    Examples
    --------
    >>> import numpy as np
    >>> sampled_at(np.array([[0.0], [10.0], [20.0]]), np.array([0.5, 2.0])).tolist()
    [[5.0], [20.0]]
    """
    before = np.floor(positions).astype(np.intp)
    after = np.minimum(before + 1, len(values) - 1)
    share = (positions - before)[:, None]
    return np.asarray(
        np.where(share == 0, values[before], (1 - share) * values[before] + share * values[after])
    )


def evenly_sampled(
    name: str, values: AnyArray, times_s: Sequence[float] | AnyArray | None, rate_hz: float | None
) -> tuple[AnyArray, tuple[str, ...]]:
    """Return rows (n, k) of frames with these times (n,), s, at even times, (m, k), and a note if they were uneven.

    Examples
    --------
    >>> import numpy as np
    >>> values, notes = evenly_sampled("smile", np.array([[0.0], [1.0], [3.0]]), [0.0, 0.1, 0.3], 10.0)
    >>> values.ravel().round(6).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    if times_s is None or rate_hz is None or is_even(times_s, rate_hz):
        return values, ()
    sampled = sampled_at(values, even_positions(times_s, rate_hz))
    return sampled, (uneven_words(name, times_s, sampled_words(len(values), rate_hz, len(sampled))),)


def uneven_words(name: str, times_s: Sequence[float] | AnyArray, rest: str) -> str:
    """Say that frames of `name` at these times (n,), s, are uneven, with the largest gap, and the `rest`."""
    steps = np.diff(times_s)
    worst = int(steps.argmax())
    return (
        f"the frames of {name} are unevenly spaced: {np.median(steps):.3g} s apart (median), with a largest gap of "
        f"{steps[worst]:.3g} s after frame {worst}; {rest}"
    )


def sampled_words(count: int, rate_hz: float, samples: int) -> str:
    """Say that a motion was sampled by the times of its frames."""
    return f"its {count} frames were resampled by their times to {samples} at {rate_hz:g} Hz, linear between frames"
