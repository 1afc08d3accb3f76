"""Operations on recorded motions, applied in order, as a command line or a recipe names them.

Most operations change each motion separately. `splice` and `average` combine all motions, `caricature` compares them.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.errors import BadInput
from morphspace.requests import check_rate
from morphspace.stimuli import timing, trajectory
from morphspace.stimuli.motion_words import GUIDED, WORDS, Word
from morphspace.stimuli.timing import Ends

LEAST_FRAMES = 2  # of a motion
LONGEST_NAME = 80  # characters; the names of more motions are replaced by their number
SAME_RATE = 1e-6  # relative
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded motion.

    Attributes
    ----------
    name : str
    loadings_sd : array (n, k), SD, one row per frame
    rate_hz : float
    ends : "open" or "closed"
        "closed" if the motion is a loop.
    """

    name: str
    loadings_sd: LoadingTable
    rate_hz: float
    ends: Ends = "open"

    @property
    def duration_s(self) -> float:
        """The duration of its frames, s."""
        return len(self.loadings_sd) / self.rate_hz


@dataclass(frozen=True)
class Operation:
    """An operation and its numbers: none, one or two."""

    word: str
    numbers: tuple[float, ...] = ()

    def __str__(self) -> str:
        shown = ":".join(f"{number:.12g}" for number in self.numbers)
        return f"{self.word}={shown}" if shown else self.word


@dataclass(frozen=True, eq=False)
class Setting:
    """The input of operations apart from the motions.

    Attributes
    ----------
    weights : array (k,)
        The model's SD.
    guide : Motion or None
    rng : numpy.random.Generator
    """

    weights: AnyArray
    guide: Motion | None
    rng: np.random.Generator


Work: TypeAlias = Callable[[Sequence[Motion], tuple[float, ...], Setting], Sequence[Motion]]


def _each(work: Callable[[Motion, tuple[float, ...], Setting], Motion]) -> Work:
    """Make a function of several motions from a function of one."""

    def apply(motions: Sequence[Motion], numbers: tuple[float, ...], setting: Setting) -> Sequence[Motion]:
        return [work(motion, numbers, setting) for motion in motions]

    return apply


def _smooth(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    return _changed(motion, timing.smoothed(motion.loadings_sd, numbers[0], motion.rate_hz, motion.ends))


def _speed(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    return _changed(motion, timing.retimed(motion.loadings_sd, numbers[0], motion.ends))


def _rate(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    (rate_hz,) = numbers
    check_rate(rate_hz, "the frame rate")
    if motion.duration_s * rate_hz < 2:
        raise BadInput(
            f"{motion.name} lasts {motion.duration_s:g} s; expected at least 2 frames at {rate_hz:g} Hz. Give a higher "
            "rate"
        )
    loadings = timing.retimed(motion.loadings_sd, motion.rate_hz / rate_hz, motion.ends)
    return replace(motion, loadings_sd=loadings, rate_hz=rate_hz)


def _part(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    start, stop = numbers
    times = np.arange(len(motion.loadings_sd)) / motion.rate_hz
    inside = (times >= start - 1e-9) & (times < stop - 1e-9)
    if inside.sum() < 2:
        raise BadInput(
            f"the part from {start:g} s to {stop:g} s of {motion.name}, which lasts {motion.duration_s:g} s, has "
            f"{int(inside.sum())} frames; expected at least 2. Give a longer part"
        )
    return replace(motion, loadings_sd=motion.loadings_sd[inside], ends="open")


def _timing(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    guide = setting.guide
    if guide is None:
        raise BadInput(
            "the operation has no guide; expected the motion whose timing is taken. Give its table with --guide"
        )
    timing.check_same_components(motion.loadings_sd, guide.loadings_sd)
    loadings = timing.timed_like(motion.loadings_sd, guide.loadings_sd, setting.weights)
    return replace(motion, loadings_sd=loadings, rate_hz=guide.rate_hz, ends="open")


def _reverse(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    return _changed(motion, timing.in_reverse(motion.loadings_sd))


def _there_and_back(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    return replace(motion, loadings_sd=trajectory.there_and_back(motion.loadings_sd), ends="closed")


def _loop(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    frames = _join_frames(numbers, motion.rate_hz, "loop")
    return replace(
        motion, loadings_sd=trajectory.looped(motion.loadings_sd, setting.weights, frames), ends="closed"
    )


def _scramble_frames(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    return _changed(motion, trajectory.scrambled_blocks(motion.loadings_sd, 1, setting.rng), "open")


def _scramble_blocks(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    frames = _frames(numbers[0], motion.rate_hz, "scramble-blocks")
    if not 1 <= frames < len(motion.loadings_sd):
        raise BadInput(
            f"blocks of {numbers[0]:g} s are {frames} of the {len(motion.loadings_sd)} frames of {motion.name}; "
            f"expected 1 to {len(motion.loadings_sd) - 1}. Give {1 / motion.rate_hz:g} s to "
            f"{(len(motion.loadings_sd) - 1) / motion.rate_hz:g} s"
        )
    return _changed(motion, trajectory.scrambled_blocks(motion.loadings_sd, frames, setting.rng), "open")


def _scramble_phase(motion: Motion, numbers: tuple[float, ...], setting: Setting) -> Motion:
    return _changed(motion, trajectory.scrambled_phase(motion.loadings_sd, setting.rng))


def _splice(motions: Sequence[Motion], numbers: tuple[float, ...], setting: Setting) -> Sequence[Motion]:
    _check_alike(motions, "splice")
    frames = _join_frames(numbers, motions[0].rate_hz, "splice")
    joined = trajectory.spliced([motion.loadings_sd for motion in motions], setting.weights, frames)
    return [Motion(_joined_name(motions), joined, motions[0].rate_hz)]


def _average(motions: Sequence[Motion], numbers: tuple[float, ...], setting: Setting) -> Sequence[Motion]:
    _check_alike(motions, "average")
    mean = trajectory.averaged([motion.loadings_sd for motion in motions], setting.weights)
    return [Motion(_joined_name(motions), mean, motions[0].rate_hz)]


def _caricature(motions: Sequence[Motion], numbers: tuple[float, ...], setting: Setting) -> Sequence[Motion]:
    if len(motions) > 1:
        _check_alike(motions, "caricature")
        mean = trajectory.averaged([motion.loadings_sd for motion in motions], setting.weights)
    elif setting.guide is not None:
        mean = setting.guide.loadings_sd
        timing.check_same_components(motions[0].loadings_sd, mean)
    else:
        raise BadInput(
            "there is one motion and no guide; expected at least 2 tables, or a mean trajectory as the guide. "
            "Give more tables or --guide; `morphspace caricature` exaggerates about the mean face"
        )
    return [
        _changed(
            motion, trajectory.caricatured(motion.loadings_sd, mean, numbers[0], setting.weights), "open"
        )
        for motion in motions
    ]


WORKS: Mapping[str, Work] = {
    "smooth": _each(_smooth),
    "speed": _each(_speed),
    "rate": _each(_rate),
    "part": _each(_part),
    "timing": _each(_timing),
    "reverse": _each(_reverse),
    "loop": _each(_loop),
    "there-and-back": _each(_there_and_back),
    "splice": _splice,
    "average": _average,
    "caricature": _caricature,
    "scramble-frames": _each(_scramble_frames),
    "scramble-blocks": _each(_scramble_blocks),
    "scramble-phase": _each(_scramble_phase),
}


def operations_of(given: Sequence[str | Mapping[str, Any]]) -> tuple[Operation, ...]:
    """Parse operations of a command line (`smooth=6`, `loop`) or a recipe (`{smooth: 6}`, `loop`).

    Raises
    ------
    BadInput
        If a name is unknown (the message suggests the nearest), or the numbers are not as needed.

    Examples
    --------
    >>> [str(operation) for operation in operations_of(["smooth=6", {"part": "0:2"}, "loop"])]
    ['smooth=6', 'part=0:2', 'loop']
    """
    found = []
    for one in given:
        if isinstance(one, Mapping):
            found += [_operation(str(word), value) for word, value in one.items()]
        else:
            word, equals, value = str(one).partition("=")
            found.append(_operation(word.strip(), value.strip() if equals else None))
    return tuple(found)


def _operation(word: str, value: Any) -> Operation:
    kind = WORDS.get(word)
    if kind is None:
        near = difflib.get_close_matches(word, WORDS, 1, 0.5)
        hint = f"Did you mean {WORDS[near[0]].form(near[0])}?" if near else "Choose one"
        raise BadInput(f"the operation is {word!r}; expected one of {', '.join(WORDS)}. {hint}")
    if value is None or value == "":
        parts: list[Any] = []
    elif isinstance(value, list | tuple):
        parts = list(value)
    else:
        parts = str(value).split(":")
    numbers = tuple(_number(part, word, kind) for part in parts)
    wanted = {"nothing": (0,), "number": (1,), "number or nothing": (0, 1), "span": (2,)}[kind.takes]
    if len(numbers) not in wanted:
        raise BadInput(f"{word} has {len(numbers) or 'no'} numbers; expected {kind.form(word)}. Write it so")
    return Operation(word, numbers)


def _number(part: Any, word: str, kind: Word) -> float:
    text = str(part).strip()
    if isinstance(part, bool) or not NUMBER.fullmatch(text) or not np.isfinite(float(text)):
        raise BadInput(f"{word} has {text!r}; expected a number. Write {kind.form(word)}")
    return float(text)


def worked(
    motions: Sequence[Motion],
    operations: Sequence[Operation],
    weights: AnyArray,
    guide: Motion | None = None,
    seed: int = 0,
) -> tuple[Motion, ...]:
    """Apply operations to motions, in order.

    Parameters
    ----------
    motions : sequence of Motion
    operations : sequence of Operation
    weights : array (k,)
        The model's SD.
    guide : Motion or None
    seed : int
        Each operation has its own random numbers, fixed by the seed and its place.

    Returns
    -------
    tuple of Motion
        One motion, or as many as before.

    Raises
    ------
    BadInput
        If an operation cannot be applied; the message starts with it.
    """
    if guide is not None and not any(one.word in GUIDED for one in operations):
        raise BadInput(
            f"a guide is given, but no operation takes one; expected {' or '.join(GUIDED)}. Add one, or leave the "
            "guide out"
        )
    for motion in motions:
        if len(motion.loadings_sd) < LEAST_FRAMES:
            raise BadInput(
                f"the number of frames of {motion.name} is {len(motion.loadings_sd)}; expected at least "
                f"{LEAST_FRAMES}. Give a longer motion"
            )
    found = list(motions)
    for place, operation in enumerate(operations):
        setting = Setting(weights, guide, np.random.default_rng([seed, place]))
        try:
            found = list(WORKS[operation.word](found, operation.numbers, setting))
        except BadInput as error:
            raise type(error)(f"{operation}: {error}") from error
        if not all(np.isfinite(motion.loadings_sd).all() for motion in found):
            raise BadInput(
                f"{operation} makes loadings that are not finite; expected finite numbers. Use smaller gains"
            )
    return tuple(found)


def _changed(motion: Motion, loadings_sd: LoadingTable, ends: Ends | None = None) -> Motion:
    return replace(motion, loadings_sd=loadings_sd, ends=ends or motion.ends)


def _frames(seconds: float, rate_hz: float, word: str) -> int:
    if not 0 <= seconds * rate_hz <= timing.MOST_FRAMES:
        raise BadInput(
            f"{word} is {seconds:g} s; expected 0 to {timing.MOST_FRAMES / rate_hz:g} s. Change it"
        )
    return round(seconds * rate_hz)


def _join_frames(numbers: tuple[float, ...], rate_hz: float, word: str) -> int | None:
    return _frames(numbers[0], rate_hz, word) if numbers else None


def _check_alike(motions: Sequence[Motion], word: str) -> None:
    """Raise `BadInput` if motions cannot be combined: there is one, or their rates or components differ."""
    if len(motions) < 2:
        raise BadInput(
            f"{word} has {len(motions)} motion; expected at least 2 to combine. Give at least 2 tables"
        )
    first = motions[0]
    for motion in motions[1:]:
        if abs(motion.rate_hz - first.rate_hz) > SAME_RATE * first.rate_hz:
            raise BadInput(
                f"{first.name} has {first.rate_hz:g} Hz, {motion.name} has {motion.rate_hz:g} Hz; expected one frame "
                f"rate. Put rate={first.rate_hz:g} before {word}"
            )
        timing.check_same_components(first.loadings_sd, motion.loadings_sd)


def _joined_name(motions: Sequence[Motion]) -> str:
    name = "-".join(motion.name for motion in motions)
    return name if len(name) <= LONGEST_NAME else f"{motions[0].name}-and-{len(motions) - 1}-more"
