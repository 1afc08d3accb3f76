"""Recorded motion as data: splicing, loops, averages, caricatures, and scrambling for control conditions.

A motion is a table of loadings (n, k), one row per frame; `timing` changes its timing. A step is the Euclidean
distance between successive frames, with `weights` (k,) for the components. With the model's SD it is the model's
distance between faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.imitation.alignment import align
from morphspace.stimuli.timing import MOST_FRAMES, at_positions, check_same_components, positions_like

VELOCITY_FRAMES = 2  # frames of the velocity at an end; a single step is mostly noise
AVERAGING_ROUNDS = 10  # at most; means of real clips converge in 3 to 6
FADING_FRAMES = 2.0  # SD, frames, of the decay of an end's velocity; it overshoots by at most 1.2 steps
STILL = 1e-6  # of the median step; a mean that changes less has converged
LARGEST_GAIN = 1000.0  # absolute; no face can be drawn with more
LONGEST_BRIDGE = 10_000  # frames


def step_lengths(loadings: LoadingTable, weights: AnyArray) -> AnyArray:
    """Return the length (n - 1,) of each step of a motion (n, k).

    Examples
    --------
    >>> import numpy as np
    >>> step_lengths(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0]]), np.ones(2)).tolist()
    [5.0, 0.0]
    """
    return np.sqrt((np.diff(loadings * weights, axis=0) ** 2).sum(axis=1))


def _usual_step(tables: Sequence[LoadingTable], weights: AnyArray) -> float:
    """Return the median step of motions; of the non-zero steps if most are 0, and 0 if all are."""
    steps = np.concatenate([step_lengths(table, weights) for table in tables])
    if not steps.any():
        return 0.0
    median = float(np.median(steps))
    return median if median > 0 else float(np.median(steps[steps > 0]))


def _bridge(
    before: LoadingTable, after: LoadingTable, weights: AnyArray, most_step: float, frames: int | None = None
) -> LoadingTable:
    """Return frames (m, k) that lead smoothly from the end of one motion (n, k) to the start of another (ours).

    The path is a cubic between the two faces. It starts and ends with the velocities of the motions, limited to
    `most_step`, which decay in a few frames. No component exceeds its range in the motions.

    Parameters
    ----------
    before, after : array (n, k)
    weights : array (k,)
    most_step : float
        The longest step allowed. m is the smallest number of frames with which all steps, including those from and to
        the motions, are no longer.
    frames : int or None
        Sets m instead.

    Raises
    ------
    BadInput
        If m would exceed 10,000.
    """
    first, last = before[-1], after[0]
    low = np.minimum(before.min(axis=0), after.min(axis=0))
    high = np.maximum(before.max(axis=0), after.max(axis=0))
    leaving = _velocity(before[-1 - VELOCITY_FRAMES :], weights, most_step)
    arriving = _velocity(after[: 1 + VELOCITY_FRAMES], weights, most_step)
    if frames is not None:
        return np.clip(_between(first, last, leaving, arriving, frames), low, high)
    distance = float(np.sqrt((((last - first) * weights) ** 2).sum()))
    if distance == 0:
        return np.zeros((0, before.shape[1]))
    if most_step <= 0 or distance / most_step > LONGEST_BRIDGE:
        raise BadInput(
            f"the join spans {distance:.3g}, a usual step of these motions is {most_step:.3g}: so slow a join would "
            "take more than "
            f"{LONGEST_BRIDGE} frames; give its seconds, such as splice=0.5 or loop=0.5"
        )
    count = max(0, int(np.ceil(distance / most_step - 1e-9)) - 1)
    while True:
        between = np.clip(_between(first, last, leaving, arriving, count), low, high)
        whole = np.concatenate([first[None], between, last[None]])
        if step_lengths(whole, weights).max() <= most_step * (1 + 1e-9):
            return between
        count += 1


def _velocity(end: LoadingTable, weights: AnyArray, most_step: float) -> AnyArray:
    """Return the mean velocity (k,) per frame over a few frames, limited to the longest step."""
    if len(end) < 2:
        return np.zeros(end.shape[1])
    velocity = (end[-1] - end[0]) / (len(end) - 1)
    length = float(np.sqrt(((velocity * weights) ** 2).sum()))
    return np.asarray(velocity * (min(1.0, most_step / length) if length > 0 else 1.0))


def _between(
    first: AnyArray, last: AnyArray, leaving: AnyArray, arriving: AnyArray, count: int
) -> LoadingTable:
    """Return `count` frames (count, k) between two faces, with these velocities (k,) per frame at the ends."""
    u = (np.arange(1, count + 1) / (count + 1))[:, None]
    to, back = u * (count + 1), (1 - u) * (count + 1)  # frames
    return np.asarray(
        first
        + u**2 * (3 - 2 * u) * (last - first)
        + to * (1 - u) ** 2 * np.exp(-0.5 * (to / FADING_FRAMES) ** 2) * leaving
        - back * u**2 * np.exp(-0.5 * (back / FADING_FRAMES) ** 2) * arriving
    )


def spliced(
    tables: Sequence[LoadingTable], weights: AnyArray, join_frames: int | None = None
) -> LoadingTable:
    """Join motions (n_i, k) in order by smooth transitions; all their frames are kept.

    A transition is a `_bridge` with steps no longer than the median step of all motions, or with `join_frames` frames.

    Examples
    --------
    >>> import numpy as np
    >>> rise, fall = np.array([[0.0], [1], [2]]), np.array([[2.0], [1], [0]])
    >>> spliced([rise, fall], np.ones(1), join_frames=1).round(2).ravel().tolist()
    [0.0, 1.0, 2.0, 2.0, 2.0, 1.0, 0.0]
    """
    for table in tables[1:]:
        check_same_components(tables[0], table)
    most = _usual_step(tables, weights)
    parts = [tables[0]]
    for before, after in pairwise(tables):
        parts += [_bridge(before, after, weights, most, join_frames), after]
    return _bounded(np.concatenate(parts))


def looped(loadings: LoadingTable, weights: AnyArray, join_frames: int | None = None) -> LoadingTable:
    """Close a motion (n, k) to a loop: append frames that lead from its last frame smoothly back to the first.

    Without `join_frames`, no step of the return, the last one to the first frame included, exceeds the motion's
    median step. Raises `BadInput` for fewer than 3 frames.

    Examples
    --------
    >>> import numpy as np
    >>> loop = looped(np.array([[0.0], [1], [2], [3]]), np.ones(1))
    >>> len(loop) > 4, loop[:4].ravel().tolist()
    (True, [0.0, 1.0, 2.0, 3.0])
    """
    if len(loadings) < 3:
        raise BadInput(
            f"the number of frames of the motion is {len(loadings)}; expected at least 3 for a loop. Use a longer one"
        )
    most = _usual_step([loadings], weights)
    return _bounded(np.concatenate([loadings, _bridge(loadings, loadings, weights, most, join_frames)]))


def there_and_back(loadings: LoadingTable) -> LoadingTable:
    """Close a motion (n, k) to a loop that plays forwards, then backwards: (2 n - 2, k). Raises `BadInput` for 1 frame.

    Examples
    --------
    >>> import numpy as np
    >>> there_and_back(np.array([[0.0], [1], [2]])).ravel().tolist()
    [0.0, 1.0, 2.0, 1.0]
    """
    if len(loadings) < 2:
        raise BadInput(
            f"the number of frames of the motion is {len(loadings)}; expected at least 2. Use a longer one"
        )
    return np.concatenate([loadings, loadings[-2:0:-1]])


def _bounded(loadings: LoadingTable) -> LoadingTable:
    if len(loadings) > MOST_FRAMES:
        raise BadInput(
            f"the motion would have {len(loadings)} frames; expected at most {MOST_FRAMES}. Shorten it"
        )
    return loadings


def scrambled_blocks(loadings: LoadingTable, block_frames: int, rng: np.random.Generator) -> LoadingTable:
    """Permute blocks of `block_frames` frames of a motion (n, k) at random; the original order is excluded.

    This control keeps all faces, and the motion within blocks, but not the order. The last block may be shorter.
    Raises `BadInput` for fewer than 2 blocks.

    Examples
    --------
    >>> import numpy as np
    >>> scrambled_blocks(np.arange(6.0)[:, None], 2, np.random.default_rng(1)).ravel().tolist()
    [4.0, 5.0, 0.0, 1.0, 2.0, 3.0]
    """
    starts = np.arange(0, len(loadings), max(block_frames, 1))
    if block_frames < 1 or len(starts) < 2:
        raise BadInput(
            f"{len(loadings)} frames in blocks of {block_frames} cannot change places: give blocks of 1 to "
            f"{len(loadings) - 1} frames"
        )
    order = rng.permutation(len(starts))
    while (order == np.arange(len(starts))).all():
        order = rng.permutation(len(starts))
    return np.concatenate([loadings[start : start + block_frames] for start in starts[order]])


def scrambled_phase(loadings: LoadingTable, rng: np.random.Generator) -> LoadingTable:
    """Shift each frequency of a motion (n, k) by a random phase that is the same for all components: (n, k).

    This control keeps the mean face, the amplitude spectrum of each component and the covariances of components at
    all circular lags, but not the times of events. Raises `BadInput` for fewer than 3 frames.

    References
    ----------
    Prichard and Theiler, Generating surrogate data for time series with several simultaneously measured variables,
    Phys. Rev. Lett. 73, 1994.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.sin(np.arange(16.0))[:, None]
    >>> scrambled = scrambled_phase(motion, np.random.default_rng(1))
    >>> np.allclose(np.abs(np.fft.rfft(scrambled, axis=0)), np.abs(np.fft.rfft(motion, axis=0)))
    True
    """
    count = len(loadings)
    if count < 3:
        raise BadInput(
            f"the motion has {count} frames and no phases to scramble; expected at least 3. Use a longer one"
        )
    spectrum = np.fft.rfft(loadings, axis=0)
    phases = rng.uniform(0, 2 * np.pi, len(spectrum))
    phases[0] = 0.0  # the mean face
    if count % 2 == 0:
        phases[-1] = np.pi * rng.integers(2)  # at half the frame rate only the sign is free
    return np.asarray(np.fft.irfft(spectrum * np.exp(1j * phases)[:, None], count, axis=0))


def averaged(tables: Sequence[LoadingTable], weights: AnyArray) -> LoadingTable:
    """Average motions (n_i, k) in content and in timing: the mean trajectory (m, k).

    The mean starts as the motion with the least distance to all others. All motions are aligned to it and averaged
    until it converges. Each moment then takes the mean of its times in all motions (ours). The mean of equal motions
    is that motion.

    References
    ----------
    Petitjean, Ketterlin and Gancarski, A global averaging method for dynamic time warping, Pattern Recognition 44,
    2011.

    Examples
    --------
    >>> import numpy as np
    >>> early, late = np.array([[0.0], [1], [0], [0]]), np.array([[0.0], [0], [1], [0]])
    >>> averaged([early, late], np.ones(1)).round(2).ravel().tolist()
    [0.0, 0.53, 0.44, 0.0]
    """
    for table in tables[1:]:
        check_same_components(tables[0], table)
    mean = tables[_nearest_to_all(tables, weights)]
    still = STILL * _usual_step(tables, weights)
    for _ in range(AVERAGING_ROUNDS):
        places = [positions_like(table, mean, weights) for table in tables]
        before = mean
        mean = np.mean(
            [at_positions(table, place) for table, place in zip(tables, places, strict=True)], axis=0
        )
        if np.sqrt((((mean - before) * weights) ** 2).sum(axis=1)).max() <= still:
            break
    times = np.mean(places, axis=0)
    wanted = np.linspace(0, times[-1], round(float(times[-1])) + 1)
    return at_positions(mean, np.interp(wanted, times, np.arange(len(mean))))


def _nearest_to_all(tables: Sequence[LoadingTable], weights: AnyArray) -> int:
    """Return the index of the motion with the least mean distance to the others along their alignments."""
    far = np.zeros((len(tables), len(tables)))
    for i, one in enumerate(tables):
        for j, other in enumerate(tables[:i]):
            found = align(one * weights, other * weights)
            far[i, j] = far[j, i] = found.cost / len(found.path)
    return int(far.sum(axis=1).argmin())


def caricatured(loadings: LoadingTable, mean: LoadingTable, gain: float, weights: AnyArray) -> LoadingTable:
    """Exaggerate the difference of a motion (n, k) from a mean trajectory (m, k), aligned to its timing: (n, k).

    Gain 1 is the motion itself, 0 the mean trajectory with the motion's timing, above 1 a dynamic caricature, below 0
    an anti-caricature. Raises `BadInput` for a gain beyond +-1000.

    References
    ----------
    Nagle et al., section 1 (the purpose); the method is ours.

    Examples
    --------
    >>> import numpy as np
    >>> mean = np.array([[0.0], [1], [0]])
    >>> caricatured(2 * mean, mean, gain=2.0, weights=np.ones(1)).ravel().tolist()
    [0.0, 3.0, 0.0]
    """
    if not abs(gain) <= LARGEST_GAIN:
        raise BadInput(
            f"the gain of {gain:g} is too large; expected {-LARGEST_GAIN:g} to {LARGEST_GAIN:g}. Enter 1 for the "
            "unchanged motion"
        )
    usual = at_positions(mean, positions_like(mean, loadings, weights))
    return np.asarray(loadings + (gain - 1) * (loadings - usual))
