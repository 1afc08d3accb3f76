"""Long work as generators of steps: one mechanism for progress bars, cancelling and resuming.

A generator yields a `Step` whenever a piece is finished and returns its result at the end. Whoever drives it decides
what to do with the steps; stopping is not asking for the next one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import TypeVar

import cv2
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


def spread(count: int, most: int) -> list[int]:
    """Return at most `most` of `count` places, evenly spread in rising order, the first and the last among them."""
    number = min(count, most)
    if number < 2:
        return [0] * number
    step = (count - 1) / (number - 1)
    return [*dict.fromkeys(round(place * step) for place in range(number - 1)), count - 1]


def result_of(steps: Generator[Step, None, Result], on_step: Callable[[Step], None] | None = None) -> Result:
    """Run the work to its end, telling `on_step` of each finished piece, and give its result."""
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
        if on_step is not None:
            on_step(step)


class _SingleThreads:
    """Keeps the threads inside BLAS and OpenCV at one while anybody asks for it, and gives back what was before.

    Both limits are the whole process's. Loops may overlap, and end in another order than they began: each setting back
    what it had found would leave the limit of one that is over. So the first sets it and the last one out undoes it.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._asking = 0
        self._undo = ExitStack()

    @contextmanager
    def asked(self) -> Iterator[None]:
        """Hold the limit for a block."""
        with self._lock:
            if self._asking == 0:
                self._undo.enter_context(threadpool_limits(limits=1, user_api="blas"))
                self._undo.callback(cv2.setNumThreads, cv2.getNumThreads())
                cv2.setNumThreads(1)
            self._asking += 1
        try:
            yield
        finally:
            with self._lock:
                self._asking -= 1
                if self._asking == 0:
                    self._undo.close()


_SINGLE_THREADS = _SingleThreads()


def single_threads() -> AbstractContextManager[None]:
    """Keep BLAS and OpenCV at one thread each for a block, as `in_order` does: the same bits on every machine."""
    return _SINGLE_THREADS.asked()


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int = WORKERS
) -> Iterator[Result]:
    """Do `work` on the items in several threads and give the results in the items' order.

    Only a few items are under way at a time, so memory does not grow with their number. Matrix products and OpenCV's
    filters inside the work run on one thread each: on a busy machine BLAS threads that wait for each other made an
    encoding ten times slower, and some of OpenCV's results depend in their last bits on how many threads share a
    picture.
    """
    with _SINGLE_THREADS.asked(), ThreadPoolExecutor(workers) as pool:
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
