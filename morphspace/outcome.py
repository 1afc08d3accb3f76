"""What a verb gives back, and the record it leaves beside what it wrote.

Every folder of stimuli gets a `record.json` that says how to make it again: the verb and its settings, the digests of
what went in and of what came out, and the versions of everything that computed.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from morphspace import __version__
from morphspace.errors import BadInput, UnwritableFile
from morphspace.storage import digest_of_file, json_text, write_text

RECORD_NAME = "record.json"
LONGEST_NAME_BYTES = 200  # of the 255 a file system takes; a record and unfinished files have longer names
WORK_FILE = re.compile(
    r"(\.[0-9a-f]{16,40}\.[a-z0-9_]{8}|[0-9a-f]{16,64})\.(frame|points|blend)|morphs-.*\.rows"
)
"""What a build keeps in its work folder; with a point before and eight marks after, what it was stopped in writing."""
FOLDER_MARKS = re.compile(r"[/\\]")
LONGEST_NAME = 200  # bytes; file systems allow 255, and a temporary name is longer
COMPUTING_PACKAGES = (
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "scikit-image",
    "OpenImageIO",
    "av",
)


@dataclass(frozen=True)
class Outcome:
    """What was done: `lines` for a person, `document` for a machine, `warnings` to act on, `written` paths."""

    lines: tuple[str, ...]
    document: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    found = {name: importlib.metadata.version(name) for name in COMPUTING_PACKAGES}
    return (("morphspace", __version__), ("python", platform.python_version()), *found.items())


def versions() -> dict[str, str]:
    """Give the versions of morphspace, Python and every package that computes."""
    return dict(_versions())


def check_folder(folder: Path) -> None:
    """Make the output folder, or raise `UnwritableFile` before any work is done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(prefix=".morphspace-", dir=folder):  # of this process alone
            pass
    except OSError as error:
        raise UnwritableFile(
            f"cannot write into {folder}: {error.strerror}; choose another output folder"
        ) from error


@contextlib.contextmanager
def work_folder_of(asked: Path | None, output: Path) -> Iterator[Path]:
    """Give the work folder. One that was not asked for goes when the work is done, and stays to resume from if not."""
    folder = asked or output.with_name(output.name + ".work")
    made = not folder.exists()
    check_folder(folder)
    try:
        yield folder
    except BaseException:
        if made and not any(folder.iterdir()):
            folder.rmdir()
        raise
    if asked is None:
        remove_work(folder)


def remove_work(folder: Path) -> None:
    """Remove what a build keeps in its work folder, and the folder if nothing else is in it: files of people stay."""
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            remove_work(path)
        elif WORK_FILE.fullmatch(path.name):
            path.unlink()
    with contextlib.suppress(OSError):  # something is left
        folder.rmdir()


def picture_names(names: Sequence[str]) -> tuple[str, ...]:
    """Give the file name of each frame's picture: NAME.png, folders in the name joined by underscores.

    Raises `BadInput` where two frames would share a file, or a name cannot be a file's.
    """
    files = tuple(f"{FOLDER_MARKS.sub('_', name)}.png" for name in names)
    for name, file in zip(names, files, strict=True):
        if not name.strip(". ") or len(file.encode()) > LONGEST_NAME or "\0" in name:
            raise BadInput(f"a frame is called {name!r:.60}, which cannot name a picture: rename it")
        if files.count(file) > 1:
            raise BadInput(
                f"{files.count(file)} frames would be written as {file}: give each frame its own name"
            )
    return files


def check_file(path: Path, suffix: str, kept: Iterable[Path] = ()) -> None:
    """Raise `BadInput` where an output has another suffix, is a folder, or is one of the files to be `kept`."""
    length = len(os.fsencode(path.name))
    if length > LONGEST_NAME_BYTES:
        raise BadInput(
            f"the output {path.name[:20]}... has a name of {length} bytes: give at most {LONGEST_NAME_BYTES}, "
            "so that the files beside it have room"
        )
    if path.suffix.lower() != suffix:
        raise BadInput(f"the output {path} should end in {suffix}: call it {path.stem or 'output'}{suffix}")
    if path.is_dir():
        raise BadInput(f"the output {path} is a folder: give the name of a {suffix} file")
    if path.exists() and path.resolve() in {other.resolve() for other in kept}:
        raise BadInput(f"the output {path} is one of the inputs and would be lost: give it another name")


def write_record(
    folder: Path,
    verb: str,
    settings: Mapping[str, Any],
    inputs: Mapping[str, str],
    outputs: Iterable[Path],
    name: str = RECORD_NAME,
) -> Path:
    """Write a record into the folder: verb, settings, inputs (name to digest), outputs and versions."""
    digests = {path.relative_to(folder).as_posix(): digest_of_file(path) for path in sorted(outputs)}
    return write_record_of(folder / name, verb, settings, inputs, digests)


def write_record_of(
    path: Path,
    verb: str,
    settings: Mapping[str, Any],
    inputs: Mapping[str, str],
    digests: Mapping[str, str],
) -> Path:
    """Write a record as `write_record` does, of outputs whose digests are known (path from the folder to digest)."""
    record = {
        "format": "morphspace-record",
        "version": 1,
        "verb": verb,
        "settings": dict(settings),
        "inputs": dict(inputs),
        "outputs": dict(digests),
        "versions": versions(),
    }
    write_text(path, json_text(record))
    return path
