"""The stimuli of a batch, drawn in several processes.

A process is started afresh (spawn), opens a model the first time it needs it and keeps it; only numbers travel,
never a model. Each keeps to one thread, so that stimuli are the same bits however many processes draw them. When
the batch is stopped the processes end after what they are at; when it is killed they notice and end too.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput, MorphspaceError
from morphspace.model.model import MorphModel, load_model
from morphspace.sets.draw import make_stimulus
from morphspace.sets.folders import FolderJob, fill_folder
from morphspace.steps import core_count, single_threads, using_workers
from morphspace.stimuli.drawing import Drawing

QUEUED = 4  # pieces a process has waiting: none idles, and stopping is quick
OPEN_MODELS = 64  # a process keeps; they are maps of files, and cost addresses rather than memory

_stop: Any = None  # in a process of the pool: the event that says that the batch was stopped
_held = contextlib.ExitStack()  # what a process of the pool holds as long as it lives


@dataclass(frozen=True, eq=False)
class DrawingPiece:
    """One stimulus to draw into `folder` with the model at `model_path`; `head` opens its sidecar.

    `threads` draw the frames of a video, where there are cores that no process uses.
    """

    model_path: Path
    drawing: Drawing
    head: Mapping[str, Any]
    folder: Path
    threads: int = 1

    def made(self) -> dict[str, Any]:
        """Draw it, or keep it where it is there; give its row of the manifest."""
        model = _opened(self.model_path)
        if model.model_id != self.head["model"]["model_id"]:
            raise BadInput(
                f"{self.model_path} was model {self.head['model']['model_id']} when the batch began and is "
                f"{model.model_id} now: start again, and leave the models alone while it runs"
            )
        return make_stimulus(model, self.drawing, self.head, self.folder, self.threads)


@dataclass(frozen=True, eq=False)
class FolderPiece:
    """One folder to be filled inside `folder`."""

    job: FolderJob
    folder: Path

    def made(self) -> dict[str, Any]:
        """Fill it, or keep it where it is whole; give its row of the table of folders."""
        return fill_folder(self.job, self.folder, lambda: _stop is not None and _stop.is_set())


Piece = DrawingPiece | FolderPiece
Rows = Generator[dict[str, Any], None, None]


@lru_cache(maxsize=OPEN_MODELS)
def _opened(path: Path) -> MorphModel:
    return load_model(path)


def made_here(pieces: Iterable[Piece]) -> Rows:
    """Make the pieces one after the other in this process; give their rows in order."""
    _opened.cache_clear()  # a model may have been built anew since
    with single_threads():
        for piece in pieces:
            yield piece.made()


def made_in_processes(pieces: Iterable[Piece], workers: int) -> Rows:
    """Make the pieces in so many processes; give their rows in order.

    Memory does not grow with the number of pieces. Raises what a piece raises, once those under way are done; and
    `MorphspaceError` where a process was ended from outside.
    """
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin, initargs=(stop, threads_of(workers))
    )
    pending: deque[Future[dict[str, Any]]] = deque()
    try:
        for piece in pieces:
            with (
                contextlib.nullcontext() if pending else _interrupts_waiting()
            ):  # the first starts the processes
                pending.append(pool.submit(_made, piece))
            if len(pending) >= QUEUED * workers:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    except BrokenProcessPool as error:
        raise MorphspaceError(
            "a process of the batch was ended from outside, perhaps for want of memory: give the same "
            "command with fewer --workers, it goes on where it was (in a program of yours, batch runs "
            "below `if __name__ == '__main__':`)"
        ) from error
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def _made(piece: Piece) -> dict[str, Any]:
    return piece.made()


@contextlib.contextmanager
def _interrupts_waiting() -> Iterator[None]:
    """Let Ctrl-C wait for a block. Processes that are started in it never see one."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def threads_of(processes: int) -> int:
    """Return how many frames each of so many processes works on at a time: the cores are shared among them."""
    return max(1, core_count() // processes)


def _begin(stop: Any, threads: int) -> None:
    """Prepare a new process: it ends with the one that started it, and filters run on one thread each."""
    global _stop
    _stop = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _held.enter_context(single_threads())
    _held.enter_context(using_workers(threads))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
