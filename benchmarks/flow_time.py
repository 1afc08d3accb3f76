"""How long the flow takes, beside DIS medium and DeepFlow: processor seconds on one thread, in interleaved rounds.

Run it on a quiet machine. Processor time leaves out what others do while they have the processor, not what they do to
its caches and its clock.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from flow_estimators import DEEPFLOW, DIS, PEERS, PRESETS, SLOW, Prepare, one_thread, ours, ours_further
from flow_truth import FACE_SIZE, face_sets
from tables import GOAL_HEADS, goal_row, milliseconds, print_table, ratio, tell

from morphspace.arrays import AnyArray
from morphspace.synthetic.warped import FlowPair

TIMED_SET = "face 14"
LARGE_SIZE = 512  # px a side
LARGE_ROUNDS = 12  # at most; two of every pair
SLOW_ROUNDS = 3  # of what takes half a second and more
FIRST, FURTHER = "first frame", "each further frame"
MARKS = {  # preset: peer, landing mark, goal
    "fast": (DIS, 1.0, 1.0),
    "balanced": (DIS, 6.0, 2.0),
    "accurate": (DEEPFLOW, 1.0, 0.5),
}

Seconds = dict[str, AnyArray]
"""Processor seconds (rounds,) by estimator; those in `SLOW` have the first few rounds only."""


def flow_time(data: Path, rounds: int) -> None:
    """Measure and print the times, and the halves of the goals that are times."""
    ours_both = {_row_name(name, FIRST): ours(name) for name in PRESETS}
    ours_both |= {_row_name(name, FURTHER): ours_further(name) for name in PRESETS}
    large_ones = {DIS: PEERS[DIS], DEEPFLOW: PEERS[DEEPFLOW]}
    with one_thread():
        seconds = {
            FACE_SIZE: timed(_pairs(data, FACE_SIZE), PEERS | ours_both, rounds),
            LARGE_SIZE: timed(_pairs(data, LARGE_SIZE), large_ones | ours_both, min(rounds, LARGE_ROUNDS)),
        }
    for size, found in seconds.items():
        print_times(size, found)
    print_goals(seconds)


def _row_name(preset: str, which: str) -> str:
    return f"{preset}, {which}"


def _pairs(data: Path, size: int) -> Sequence[FlowPair]:
    tell(f"flow-time: {size} x {size}")
    return face_sets(data, "report", (TIMED_SET,), size)[TIMED_SET]


def timed(pairs: Sequence[FlowPair], estimators: Mapping[str, Prepare], rounds: int) -> Seconds:
    """Time all in turn on one pair a round, after a round that does not count.

    Each has just had the pair of the round before, untimed: what the estimator before it left in the caches is not on
    its clock.
    """
    seconds: dict[str, list[float]] = {name: [] for name in estimators}
    for number in range(-1, rounds):
        before, pair = pairs[(number - 1) % len(pairs)], pairs[number % len(pairs)]
        for name, prepare in estimators.items():
            if name in SLOW and number >= SLOW_ROUNDS:
                continue
            prepare(before.reference, before.frame)()
            work = prepare(pair.reference, pair.frame)
            start = time.process_time()
            work()
            if number >= 0:
                seconds[name].append(time.process_time() - start)
    return {name: np.array(found) for name, found in seconds.items()}


def _multiple(seconds: Seconds, name: str, peer: str) -> float:
    """Give a time as a multiple of the peer's in the same round, median."""
    return ratio(seconds[name], seconds[peer][: len(seconds[name])])


def print_times(size: int, seconds: Seconds) -> None:
    """Print the times at one size."""
    print(f"## {size} x {size} px\n")
    print(
        f"Processor time on one thread for one pair of `{TIMED_SET}`, the next pair each round: ms, median with "
        f"quartiles of {len(seconds[DIS])} rounds (at most {SLOW_ROUNDS} of the slow ones), and as a multiple of the "
        "peers' in the same round, median. First frame: preparing the reference is on the clock. Each further frame: "
        "it has had one already, as in a build. None has a start. Each has just had the pair of the round before, "
        "untimed: what the estimator before it left in the caches is not on its clock.\n"
    )
    rows = [
        [name, milliseconds(found), *(f"{_multiple(seconds, name, peer):.2f}" for peer in (DIS, DEEPFLOW))]
        for name, found in seconds.items()
    ]
    print_table(["estimator", "ms", "x DIS medium", "x DeepFlow"], rows)


def print_goals(seconds: Mapping[int, Seconds]) -> None:
    """Print each landing mark and each goal that is a time with what was found."""
    print("## Marks and goals of the flow: times\n")
    print(
        "Each is one half of a goal; the other half, the error, is in the section `flow`. The marks were set at "
        f"{FACE_SIZE} x {FACE_SIZE} px.\n"
    )
    rows = [
        goal_row(
            preset,
            f"time / {peer.removeprefix('OpenCV ')}'s, {size} px, {which} (half)",
            _multiple(found, _row_name(preset, which), peer),
            landing,
            goal,
            peer=f"{1e3 * float(np.median(found[peer])):.1f} ms",
            digits=2,
        )
        for preset, (peer, landing, goal) in MARKS.items()
        for size, found in seconds.items()
        for which in (FIRST, FURTHER)
    ]
    print_table(GOAL_HEADS, rows)
