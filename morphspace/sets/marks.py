"""The mark of an output that is being written, which is also its lock (ours).

It is a file of lines: the first names the run, and each further one a file with its digest, noted before the file gets
its name. A killed run leaves its mark, by which the next run recognises the files.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput, UnwritableFile
from morphspace.outcome import relative_name
from morphspace.sets.outputs import Output, refuse
from morphspace.storage import digest_of_file

MARK_FORMAT = "morphspace-writing"
HOLDER_TRIES, HOLDER_WAIT_S = 10, 0.05  # and s; a run writes the head of its mark at once


@dataclass(frozen=True, eq=False)
class Mark:
    """The open and locked mark of a run that writes `output`."""

    output: Output
    handle: int
    lock: threading.Lock = dataclasses.field(default_factory=threading.Lock)

    def begin(self, begun: Mapping[str, str]) -> None:
        """Write the head, and the files of a stopped run. Raises `UnwritableFile` if the disk is full."""
        head = {"format": MARK_FORMAT, "verb": self.output.verb, "process": os.getpid()}
        lines = [json.dumps(head), *(json.dumps(list(item)) for item in begun.items())]
        try:
            os.ftruncate(self.handle, 0)
        except OSError as error:
            raise self._full(error) from error
        self._append("".join(f"{line}\n" for line in lines))

    def note(self, temporary: Path, path: Path) -> None:
        """Note a file and its digest before it gets its name, if it is one of the output."""
        if self.output.owns(path) or path in self.output.files:
            entry = [relative_name(path, self.output.folder), digest_of_file(temporary)]
            self._append(f"{json.dumps(entry)}\n")

    def _append(self, text: str) -> None:
        with self.lock:
            try:
                os.lseek(self.handle, 0, os.SEEK_END)
                os.write(self.handle, text.encode())
                os.fsync(self.handle)
            except OSError as error:
                raise self._full(error) from error

    def _full(self, error: OSError) -> UnwritableFile:
        return UnwritableFile(
            f"cannot write {self.output.mark}: {error.strerror or error}. Free space or choose another output"
        )

    def remove(self) -> None:
        """Remove the mark at the end of a run."""
        self.output.mark.unlink(missing_ok=True)


def _lines(mark: Path) -> list[Any]:
    """Read the JSON of each complete line of a mark; none if it is missing or of another format."""
    found: list[Any] = []
    with contextlib.suppress(OSError, ValueError, RecursionError):  # missing; the last line may be cut short
        for line in mark.read_text(encoding="utf-8").splitlines():
            found.append(json.loads(line))
    head = found[0] if found else None
    return found if isinstance(head, dict) and head.get("format") == MARK_FORMAT else []


def begun_in(output: Output) -> dict[str, str]:
    """Return the digests of the files that a stopped run of the verb wrote, by name."""
    lines = _lines(output.mark)
    if not lines:
        if output.mark.is_file() and output.mark.stat().st_size and not output.mark.is_symlink():
            refuse(output.mark, output.verb)
        return {}
    head, *entries = lines
    is_own = head.get("verb") == output.verb
    pairs = (entry for entry in entries if isinstance(entry, list) and len(entry) == 2)
    return {str(name): str(digest) for name, digest in pairs} if is_own else {}


@contextlib.contextmanager
def locked(output: Output) -> Iterator[Mark]:
    """Lock the mark for this run; the lock ends with the process. Raises `BadInput` if another run holds it."""
    while True:
        is_new = not output.mark.exists()
        try:
            handle = os.open(output.mark, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except OSError as error:
            raise UnwritableFile(
                f"cannot write {output.mark}: {error.strerror or error}. Choose another output"
            ) from error
        mark = Mark(output, handle)
        try:
            if not _is_free(handle):
                holder = _holder(output.mark)
                who = f"{holder.get('verb', 'run')} (process {holder.get('process', 'unknown')})"
                raise BadInput(
                    f"another {who} is writing {output.place}. Wait until it ends, or choose another output"
                )
            if not _is_same(handle, output.mark):  # its last holder removed it meanwhile
                continue
            try:
                yield mark
            finally:
                if is_new and output.mark.exists() and not os.fstat(handle).st_size:
                    mark.remove()  # refused before it was written
            return
        finally:
            os.close(handle)


def _holder(mark: Path) -> dict[str, Any]:
    """Return the head of a mark that another run holds, which may not have written it yet."""
    for _ in range(HOLDER_TRIES):
        if lines := _lines(mark):
            return dict(lines[0])
        time.sleep(HOLDER_WAIT_S)
    return {}


def _is_free(handle: int) -> bool:
    """Lock an open file if the system supports locks; return False if another process holds the lock."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        pass
    return True


def _is_same(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False
