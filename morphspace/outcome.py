"""The result of a verb, and the record of how its output was made.

Every folder of stimuli gets a `record.json` from which it can be made again: the verb and its settings, the digests
of the input and output files, and the versions of all computing packages.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from annotated_types import Len

from morphspace import __version__
from morphspace.documents import Digest, Digests, Document, Versions
from morphspace.settings import Pattern
from morphspace.storage import digest_of_file, json_text, write_text

RECORD_NAME = "record.json"
COMPUTING_PACKAGES = (
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "scikit-image",
    "OpenImageIO",
    "av",
)


class Record(TypedDict):
    """The entries of a record (data_spec/record.md)."""

    format: Literal["morphspace-record"]
    version: Literal[1]
    verb: Annotated[str, Pattern("[a-z]+(-[a-z]+)*", "the name of a verb")]
    settings: dict[str, Any]
    inputs: Digests
    outputs: Annotated[
        dict[Annotated[str, Pattern(r"(?!record\.json$)[^/].*", "a path below the folder")], Digest], Len(1)
    ]
    versions: Versions


RECORD = Document("record", "morphspace record, version 1", Record)


@dataclass(frozen=True)
class Outcome:
    """The result of a verb.

    Attributes
    ----------
    lines : tuple of str
        Text for the user.
    document : mapping
        The result for `--json`.
    warnings : tuple of str
        Problems on which the user should act.
    written : tuple of Path
        Files that were written.
    exit_code : int
        0 for success; the help of a verb explains other codes.
    """

    lines: tuple[str, ...]
    document: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()
    exit_code: int = 0


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    found = {name: importlib.metadata.version(name) for name in COMPUTING_PACKAGES}
    return (("morphspace", __version__), ("python", platform.python_version()), *found.items())


def versions() -> dict[str, str]:
    """Return the versions of morphspace, Python and every computing package."""
    return dict(_versions())


def write_record(
    folder: Path,
    verb: str,
    settings: Mapping[str, Any],
    inputs: Mapping[str, str],
    outputs: Iterable[Path],
    name: str = RECORD_NAME,
) -> Path:
    """Write a record into a folder: verb, settings, inputs (name to digest), outputs and versions."""
    digests = {relative_name(path, folder): digest_of_file(path) for path in sorted(outputs)}
    return write_record_of(folder / name, verb, settings, inputs, digests)


def relative_name(path: Path, folder: Path) -> str:
    """Return the path of an output as records list it: relative to the folder of the record."""
    return Path(os.path.relpath(path, folder)).as_posix()


def write_record_of(
    path: Path,
    verb: str,
    settings: Mapping[str, Any],
    inputs: Mapping[str, str],
    digests: Mapping[str, str],
) -> Path:
    """Write a record like `write_record`, for outputs with known digests (path relative to the folder, to digest)."""
    record: Record = {
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
