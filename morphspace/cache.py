"""Stored results from which interrupted work resumes: files in a folder, each named by the digest of its inputs (ours).

A build, a blend and a mimicry store here the results of each frame. The same work resumes from them; work with other
settings reuses those that do not depend on these settings. Several runs may share a folder.
"""

from __future__ import annotations

import contextlib
import re
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput, UnreadableFile
from morphspace.storage import (
    digest_of_json,
    json_text,
    make_folder,
    read_container,
    remove_unfinished,
    write_container,
)

SUFFIX = ".kept"
KEY_DIGITS = 32  # hexadecimal digits; 128 bits do not collide by chance
NAME = re.compile(rf"[0-9a-f]{{{KEY_DIGITS}}}{re.escape(SUFFIX)}")


def result_file(folder: Path, *parts: Any) -> Path:
    """Return the file of a result in a folder.

    Parameters
    ----------
    folder : Path
    *parts
        Everything that the result depends on, as JSON: name and version of its kind, versions of the code, settings,
        digests of its inputs.
    """
    return folder / f"{digest_of_json(parts)[:KEY_DIGITS]}{SUFFIX}"


def write_result(file: Path, arrays: Mapping[str, AnyArray], document: Mapping[str, Any]) -> None:
    """Write a result, named arrays and a JSON document, whole or not at all. Raises `UnwritableFile`."""
    write_container(file, arrays, {"checksum": _checksum(arrays, document), "document": dict(document)})


def read_result(file: Path) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Read a result and compare its content with its checksum.

    Parameters
    ----------
    file : Path

    Returns
    -------
    arrays : dict of name to array
        Read-only memory maps.
    document : dict

    Raises
    ------
    UnreadableFile
        If the file is missing or damaged.
    """
    arrays, head = read_container(file)
    document = head.get("document")
    if not isinstance(document, dict) or head.get("checksum") != _checksum(arrays, document):
        raise UnreadableFile(
            f"{file} is damaged: its content differs from its checksum. Run the command again"
        )
    return arrays, document


def is_finished(file: Path) -> bool:
    """Return whether a result exists and is undamaged."""
    try:
        read_result(file)
    except UnreadableFile:
        return False
    return True


def forget(folder: Path) -> None:
    """Remove all results from a folder, then the folder if it is empty. Other files stay."""
    if not folder.is_dir():
        return
    remove_unfinished(folder, suffix=SUFFIX)
    for path in folder.iterdir():
        if NAME.fullmatch(path.name) and not path.is_dir():
            path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # it holds other files
        folder.rmdir()


def check_no_link(folder: Path) -> None:
    """Check that a folder whose results will be removed is no link to another place. Raises `BadInput`."""
    if folder.is_symlink():
        raise BadInput(
            f"{folder} is a link; expected a folder of this run. Remove the link, or choose another output"
        )


@contextlib.contextmanager
def work_folder(given: Path | None, output: Path) -> Iterator[Path]:
    """Provide the folder of results for a block that writes `output`: the given one, or OUTPUT.work.

    OUTPUT.work is removed if the block succeeds. If it fails after a result was finished, the folder stays and the
    next run resumes from it. Raises `UnwritableFile`, and for OUTPUT.work that is a link `BadInput`.
    """
    folder = given or output.with_name(f"{output.name}.work")
    if given is None:
        check_no_link(folder)
    is_new = not folder.exists()
    make_folder(folder)
    remove_unfinished(folder, suffix=SUFFIX, abandoned=True)
    try:
        yield folder
    except BaseException:
        if is_new:
            with contextlib.suppress(OSError):  # it holds finished results
                folder.rmdir()
        raise
    if given is None:
        forget(folder)


def _checksum(arrays: Mapping[str, AnyArray], document: Mapping[str, Any]) -> int:
    """Return the CRC-32 of a result: it detects accidental damage, in a third of the time of SHA-256."""
    total = zlib.crc32(json_text(document).encode())
    for name, array in arrays.items():
        total = zlib.crc32(f"{name}{array.dtype.str}{array.shape}".encode(), total)
        total = zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data, total)
    return total
