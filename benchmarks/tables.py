"""Time things fairly and print what was found: the two things every section of the benchmark does.

A time means little on another machine, so each is measured beside a peer in the same run. The rounds are interleaved:
what else the machine does then falls on both alike.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

Work = Callable[[], object]


def interleaved(
    works: Mapping[str, Work], rounds: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, np.ndarray]:
    """Run each work once to warm up, then all of them in turn, `rounds` times; give the seconds of each, (rounds,)."""
    for work in works.values():
        work()
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            start = clock()
            work()
            seconds[name].append(clock() - start)
    return {name: np.array(found) for name, found in seconds.items()}


def ratio(seconds: np.ndarray, peer: np.ndarray) -> float:
    """Give the median over the rounds of a time as a share of the peer's in the same round."""
    return float(np.median(seconds / peer))


def milliseconds(seconds: np.ndarray) -> str:
    """Give the median in ms, with the quartiles, as a table shows it."""
    low, middle, high = np.percentile(seconds * 1e3, [25, 50, 75])
    return f"{middle:.2f} ({low:.2f}-{high:.2f})"


def at_least(value: float, target: float) -> str:
    """Say whether a figure reaches its target from below."""
    return "met" if value >= target else "MISSED"


def at_most(value: float, target: float) -> str:
    """Say whether a figure stays within its target."""
    return "met" if value <= target else "MISSED"


GOAL_HEADS = ("preset", "what", "landing", "goal", "measured", "best peer", "landing?", "goal?")


def goal_row(
    preset: str,
    what: str,
    value: float,
    landing: float | None,
    goal: float | None,
    *,
    peer: str = "",
    digits: int = 3,
) -> list[str]:
    """Give a row under `GOAL_HEADS`: a figure that must not exceed a landing mark and a goal, and whether it does."""

    def limit(target: float | None) -> str:
        return "" if target is None else f"<= {target:.{digits}f}"

    def verdict(target: float | None) -> str:
        return "" if target is None else at_most(value, target)

    return [
        preset,
        what,
        limit(landing),
        limit(goal),
        f"{value:.{digits}f}",
        peer,
        verdict(landing),
        verdict(goal),
    ]


def print_table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a Markdown table; numbers stand to the right."""
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(3, len(head), *(len(row[i]) for row in cells)) for i, head in enumerate(heads)]
    numeric = [all(row[i][:1] in "+-.0123456789n" for row in cells if row[i]) for i in range(len(heads))]

    def line(row: Sequence[str]) -> str:
        filled = (
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(row, widths, numeric, strict=True)
        )
        return "| " + " | ".join(filled) + " |"

    rule = ["-" * (width - 1) + (":" if right else "-") for width, right in zip(widths, numeric, strict=True)]
    print(line(heads), line(rule), *map(line, cells), "", sep="\n", flush=True)


def tell(message: str) -> None:
    """Tell on standard error how far the run is, so that standard output stays a page."""
    print(f"bench: {message}", file=sys.stderr, flush=True)
