"""What a verb gives back, and the record it leaves beside what it wrote.

Every folder of stimuli gets a `record.json` that says how to make it again: the verb and its settings, the digests of
what went in and of what came out, and the versions of everything that computed.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphspace import __version__
from morphspace.errors import UnwritableFile
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


@dataclass(frozen=True)
class Outcome:
    """What was done: `lines` for a person, `document` for a machine, `warnings` to act on, `written` paths."""

    lines: tuple[str, ...]
    document: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()


def versions() -> dict[str, str]:
    """Give the versions of morphspace, Python and every package that computes."""
    found = {name: importlib.metadata.version(name) for name in COMPUTING_PACKAGES}
    return {"morphspace": __version__, "python": platform.python_version(), **found}


def check_folder(folder: Path) -> None:
    """Make the output folder, or raise `UnwritableFile` before any work is done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".morphspace-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UnwritableFile(
            f"cannot write into {folder}: {error.strerror}; choose another output folder"
        ) from error


def write_record(
    folder: Path, verb: str, settings: Mapping[str, Any], inputs: Mapping[str, str], outputs: Iterable[Path]
) -> Path:
    """Write `record.json` into the folder: verb, settings, inputs (name to digest), outputs and versions."""
    record = {
        "format": "morphspace-record",
        "version": 1,
        "verb": verb,
        "settings": dict(settings),
        "inputs": dict(inputs),
        "outputs": {path.relative_to(folder).as_posix(): digest_of_file(path) for path in sorted(outputs)},
        "versions": versions(),
    }
    path = folder / RECORD_NAME
    write_text(path, json_text(record))
    return path
