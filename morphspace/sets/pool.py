"""Draw the stimuli of a batch in several processes (ours).

Each process is spawned, and opens each model at its first use; only numbers are sent between processes. Filters use
one thread per process, so the bits of a stimulus do not depend on the number of processes. If the batch stops, each
process finishes its current piece and ends; if the batch is killed, the processes end too.
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
from morphspace.sets.folders import FolderJob, fill_folder
from morphspace.sets.stimulus import make_stimulus
from morphspace.steps import core_count, single_threads, using_workers
from morphspace.stimuli.drawing import Drawing

QUEUED = 4  # pieces waiting per process; enough to keep it busy, few enough to stop quickly
OPEN_MODELS = 64  # models open per process; they are memory maps and use address space, not memory

_stop: Any = None  # in a process of the pool: the event that is set when the batch stops
_held = contextlib.ExitStack()  # contexts that last as long as a process of the pool


@dataclass(frozen=True, eq=False)
class DrawingPiece:
    """One stimulus to draw into `folder` with the model at `model_path`; `head` begins its sidecar.

    `threads` draw the frames of a video if there are more cores than processes.
    """

    model_path: Path
    drawing: Drawing
    head: Mapping[str, Any]
    folder: Path
    threads: int = 1

    def made(self) -> dict[str, Any]:
        """Draw the stimulus, or keep a complete one; return its manifest row.

        Raises `BadInput` if the model is another one than at the start of the batch.
        """
        model = _opened(self.model_path)
        if model.model_id != self.head["model"]["model_id"]:
            raise BadInput(
                f"{self.model_path} was model {self.head['model']['model_id']} when the batch began and is "
                f"{model.model_id} now. Start again, and do not change models during a batch"
            )
        return make_stimulus(model, self.drawing, self.head, self.folder, self.threads)


@dataclass(frozen=True, eq=False)
class FolderPiece:
    """One folder to fill inside `folder`."""

    job: FolderJob
    folder: Path

    def made(self) -> dict[str, Any]:
        """Fill the folder, or keep a complete one; return its row of the table of folders."""
        return fill_folder(self.job, self.folder, lambda: _stop is not None and _stop.is_set())


Piece = DrawingPiece | FolderPiece
Rows = Generator[dict[str, Any], None, None]


@lru_cache(maxsize=OPEN_MODELS)
def _opened(path: Path) -> MorphModel:
    return load_model(path)


def made_here(pieces: Iterable[Piece]) -> Rows:
    """Make the pieces one after the other in this process; yield their rows in order."""
    _opened.cache_clear()  # a model file may have been replaced since
    with single_threads():
        for piece in pieces:
            yield piece.made()


def made_in_processes(pieces: Iterable[Piece], workers: int) -> Rows:
    """Make the pieces in several processes; yield their rows in order.

    Memory does not grow with the number of pieces. The error of a piece is raised after the pieces in progress are
    done. Raises `MorphspaceError` if a process was ended from outside.
    """
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin, initargs=(stop, threads_of(workers))
    )
    pending: deque[Future[dict[str, Any]]] = deque()
    try:
        for piece in pieces:
            with _interrupts_waiting():  # each of the first pieces starts a process
                pending.append(pool.submit(_made, piece))
            if len(pending) >= QUEUED * workers:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    except BrokenProcessPool as error:
        raise MorphspaceError(
            "a process of the batch was ended from outside, perhaps for lack of memory. Resume with the same "
            "command and fewer --workers (in your own program, call batch "
            "below `if __name__ == '__main__':`)"
        ) from error
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def _made(piece: Piece) -> dict[str, Any]:
    return piece.made()


@contextlib.contextmanager
def _interrupts_waiting() -> Iterator[None]:
    """Delay Ctrl-C until the block ends. Processes started in the block ignore it, from their first import on."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def threads_of(processes: int) -> int:
    """Return the number of frames that each process draws in parallel, so that the processes share the cores."""
    return max(1, core_count() // processes)


def _begin(stop: Any, threads: int) -> None:
    """Prepare a new process: it ends with its parent, and its filters use one thread each."""
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
