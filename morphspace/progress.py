"""Long work as generators of steps: one mechanism for progress bars, cancelling and resuming.

A generator yields a `Step` whenever a piece is finished and returns its result at the end. Whoever drives it decides
what to do with the steps; stopping is not asking for the next one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")

WORKERS = 2  # frames at a time; more gains nothing on two cores and costs memory


@dataclass(frozen=True)
class Step:
    """A finished piece of long work: `stage` says what is being done, `done` of `total` pieces are finished."""

    stage: str
    done: int
    total: int


Steps = Generator[Step, None, Result]


def result_of(steps: Generator[Step, None, Result], on_step: Callable[[Step], None] | None = None) -> Result:
    """Run the work to its end, telling `on_step` of each finished piece, and give its result."""
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        if on_step is not None:
            on_step(step)


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int = WORKERS
) -> Iterator[Result]:
    """Do `work` on the items in several threads and give the results in the items' order.

    Only a few items are under way at a time, so memory does not grow with their number. Matrix products inside the work
    run on one thread each: on a busy machine BLAS threads that wait for each other made an encoding ten times slower.
    """
    with threadpool_limits(limits=1, user_api="blas"), ThreadPoolExecutor(workers) as pool:
        pending: deque[Future[Result]] = deque()
        try:
            for item in items:
                pending.append(pool.submit(work, item))
                if len(pending) > workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()
