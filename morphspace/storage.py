"""Atomic writing of files, and the container of named arrays behind every binary file of morphspace.

A container is a safetensors file (no pickle, nothing is executed on reading) whose header also holds one JSON
document. It is written under a temporary name, flushed to the disk and renamed. It is read as memory maps, so that
an array takes memory only where it is used.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import re
import stat
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import UnreadableFile, UnwritableFile

ALIGNMENT = 64  # bytes; the data start on a cache line, so that maps of float32 and float64 are aligned
MAX_HEADER_BYTES = 100_000_000  # the limit of safetensors; a larger number means random bytes
KEPT_NAME = 40  # characters of a name that its temporary file keeps, within the system's limit
# In the names of unfinished files: no other program writes such, and they may be removed
OURS = ".morphspace-"
UNFINISHED = re.compile(rf"\.(?P<stem>.{{1,40}}){re.escape(OURS)}[a-z0-9_]{{8}}(?P<suffix>\.[a-z0-9]+)")
ABANDONED_AFTER_S = 3600  # a file is written in seconds: one unchanged for so long belongs to a killed run
READ_BLOCK = 1 << 20  # bytes that are read at a time
DEEPEST_JSON = 64  # lists and objects inside each other; our documents have 6, Python's stack ends near 300
MARK_NAME = ".writing.json"  # marks an output while it is written (`sets/protect.py`)
CHECK = "Check the name and the permissions"
CONTAINER_START = b'{"__metadata__": {"morphspace": "'  # after the 8 bytes of the header's length
LONGEST_WHOLE = 310  # digits and sign of the largest number of 64 bits
BEYOND_64_BITS = "a number is not finite, or too large for 64 bits"
# Half of a pair of UTF-16, which JSON can name and UTF-8 cannot hold.
UNPAIRED = re.compile("[\ud800-\udfff]")
DTYPES = {
    "F64": np.float64,
    "F32": np.float32,
    "F16": np.float16,
    "I64": np.int64,
    "I32": np.int32,
    "U8": np.uint8,
}
DTYPE_NAMES = {np.dtype(kind): name for name, kind in DTYPES.items()}


_WATCHES: list[Callable[[Path, Path], None]] = []  # called with each complete file before it gets its name


@contextlib.contextmanager
def watching(watch: Callable[[Path, Path], None]) -> Iterator[None]:
    """Call `watch` with the temporary and the final path of each file that the block writes, before it is renamed."""
    _WATCHES.append(watch)
    try:
        yield
    finally:
        _WATCHES.remove(watch)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Provide a temporary name beside `path` for a block; after the block flush it to the disk and rename it to `path`.

    An older file's permissions are kept. If the block fails, the temporary file is removed and the older file stays.
    Raises `UnwritableFile` if the system refuses.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = unfinished_file(path.parent, path.stem, path.suffix)
    except OSError as error:
        raise UnwritableFile(
            f"cannot write {path}: {error.strerror or error}. Choose another output folder"
        ) from error
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.chmod(stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask())
        for watch in tuple(_WATCHES):
            watch(temporary, path)
        temporary.replace(path)
    except OSError as error:
        raise UnwritableFile(
            f"cannot write {path}: {error.strerror or error}. Free space or choose another name"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def unfinished_file(folder: Path, stem: str, suffix: str) -> Path:
    """Make an empty hidden file with a new name, which `remove_unfinished` recognises. Raises `OSError`."""
    handle, name = tempfile.mkstemp(prefix=f".{stem[:KEPT_NAME]}{OURS}", suffix=suffix, dir=folder)
    os.close(handle)
    return Path(name)


def remove_unfinished(
    folder: Path, *, names: Collection[str] | None = None, suffix: str | None = None, abandoned: bool = False
) -> None:
    """Remove the temporary files that killed runs left in a folder.

    Parameters
    ----------
    folder : Path
        Subfolders are not searched.
    names : collection of str, optional
        Names that the finished files would have; any by default.
    suffix : str, optional
        Suffix of the unfinished files, such as ".png"; any by default.
    abandoned : bool
        Whether to spare files that changed within the last hour, because other runs may be writing them.
    """
    wanted = None if names is None else {_shortened(Path(name)) for name in names}
    for path in unfinished_in(folder):
        found = UNFINISHED.fullmatch(path.name)
        assert found is not None
        if suffix not in (None, found["suffix"]):
            continue
        if wanted is not None and (found["stem"], found["suffix"]) not in wanted:
            continue
        with contextlib.suppress(FileNotFoundError):  # its writer has finished
            if not abandoned or time.time() - path.stat().st_mtime > ABANDONED_AFTER_S:
                path.unlink()


def unfinished_in(folder: Path) -> Iterator[Path]:
    """Yield the temporary files of running and of killed runs in a folder, without its subfolders."""
    return (path for path in folder.glob(".*") if UNFINISHED.fullmatch(path.name) and not path.is_dir())


def _shortened(path: Path) -> tuple[str, str]:
    return path.stem[:KEPT_NAME], path.suffix


def make_folder(folder: Path) -> None:
    """Make a folder for output and check that it can be written. Raises `UnwritableFile`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            prefix=".morphspace-", dir=folder
        ):  # a name that no other process has
            pass
    except OSError as error:
        bar = next((one for one in (folder, *folder.parents) if os.path.lexists(one)), folder)
        if not bar.is_dir():
            what = "a link to nothing" if bar.is_symlink() and not bar.exists() else "a file"
            raise UnwritableFile(f"{bar} is {what}; expected a folder. Choose another output") from error
        raise UnwritableFile(
            f"cannot write into {folder}: {error.strerror}. Choose another output folder"
        ) from error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_text(path: Path, text: str) -> None:
    """Write `text` (UTF-8) to `path`, whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_texts(texts: Mapping[Path, str]) -> None:
    """Write texts (UTF-8) that belong together: all lie complete on the disk before the first gets its name.

    Raises `UnwritableFile`; then no file was changed.
    """
    with contextlib.ExitStack() as all_or_none:
        for path, text in texts.items():
            temporary = all_or_none.enter_context(whole_file(path))
            with temporary.open("w", encoding="utf-8", newline="") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())


def is_being_written(path: Path) -> bool:
    """Return whether a run is writing a file or its folder, or was stopped while it did, by the mark of the run."""
    return any(
        mark.exists() for mark in (path.parent / MARK_NAME, path.with_name(f".{path.name}{MARK_NAME}"))
    )


def json_text(document: Any) -> str:
    """Return a document as JSON text with a fixed key order, so that equal content has equal bytes.

    Examples
    --------
    >>> json_text({"b": 1, "a": 2}) == json_text({"a": 2, "b": 1})
    True
    """
    return json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"


def parsed_json(content: bytes | str) -> Any:
    """Parse JSON in UTF-8, with or without a byte order mark, of which everything can be written again.

    Raises
    ------
    ValueError
        With the reason: no JSON, a repeated key, a number that is not finite in 64 bits, a text with half a character
        or a NUL, or deep nesting.

    Examples
    --------
    >>> parsed_json(b'{"a": [1, 2.5]}')
    {'a': [1, 2.5]}
    """
    text = content if isinstance(content, str) else content.decode("utf-8-sig")
    try:
        document = json.loads(text, object_pairs_hook=_unique, parse_int=_whole)
    except RecursionError as error:
        raise ValueError(f"more than {DEEPEST_JSON} levels lie inside each other") from error
    _check_json(document, 0)
    return document


def _whole(digits: str) -> int:
    if len(digits) > LONGEST_WHOLE:
        raise ValueError(BEYOND_64_BITS)
    return int(digits)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {next(key for key in keys if keys.count(key) > 1)!r} is there twice")
    return document


def _check_json(value: Any, depth: int) -> None:
    if isinstance(value, str):
        if "\0" in value or not (value.isascii() or UNPAIRED.search(value) is None):
            raise ValueError(f"the text {value[:KEPT_NAME]!a} holds NUL or half a character")
    elif isinstance(value, int | float):
        if not abs(value) <= sys.float_info.max:
            raise ValueError(BEYOND_64_BITS)
    elif value is not None:
        if depth == DEEPEST_JSON:
            raise ValueError(f"more than {DEEPEST_JSON} levels lie inside each other")
        parts = value if isinstance(value, list) else (*value, *value.values())
        for one in parts:
            _check_json(one, depth + 1)


def digest_of_bytes(*parts: bytes | memoryview) -> str:
    """Return the SHA-256 of the parts in order, in hexadecimal."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal. Raises `UnreadableFile`."""
    digest = hashlib.sha256()
    try:
        with Path(path).open("rb") as file:
            while block := file.read(READ_BLOCK):
                digest.update(block)
    except OSError as error:
        raise UnreadableFile(f"cannot read {path}: {error.strerror or error}. {CHECK}") from error
    return digest.hexdigest()


def digest_of_json(document: Any) -> str:
    """Return the SHA-256 of a JSON document in its canonical text, in hexadecimal."""
    return digest_of_bytes(json_text(document).encode())


def digest_of_array(array: AnyArray) -> str:
    """Return the SHA-256 of an array's type, shape and bytes, in hexadecimal."""
    head = f"{array.dtype.str}{array.shape}".encode()
    return digest_of_bytes(head, np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)


def write_container(path: Path, arrays: Mapping[str, AnyArray], document: Mapping[str, Any]) -> None:
    """Write named arrays and one JSON document as a safetensors file, whole or not at all.

    The text of the document is the entry `morphspace` in the header's `__metadata__`. Arrays are written in the given
    order, block by block; a memory-mapped array is never read whole. Raises `UnwritableFile`.

    Parameters
    ----------
    path : Path
    arrays : mapping of name to array
    document : mapping
        JSON content.
    """
    header: dict[str, Any] = {"__metadata__": {"morphspace": json_text(document)}}
    offset = 0
    for name, array in arrays.items():
        size = array.dtype.itemsize * array.size
        header[name] = {
            "dtype": DTYPE_NAMES[array.dtype],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + size],
        }
        offset += size
    text = json.dumps(header, ensure_ascii=False, allow_nan=False).encode()
    text += b" " * (-(len(text) + 8) % ALIGNMENT)
    with whole_file(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<Q", len(text)))
        file.write(text)
        for array in arrays.values():
            flat = array.reshape(-1)
            step = max(1, READ_BLOCK // array.dtype.itemsize)
            for start in range(0, flat.size, step):
                file.write(np.ascontiguousarray(flat[start : start + step]).data)


def is_container_or_nothing(path: Path) -> bool:
    """Return whether a path is free, an empty file, or a container, complete or cut short."""
    try:
        with path.open("rb") as file:
            start = file.read(8 + len(CONTAINER_START))
    except OSError:
        return not path.exists()
    return not start or start.startswith(CONTAINER_START, 8)


def read_container(path: Path) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Open a container.

    Parameters
    ----------
    path : Path

    Returns
    -------
    arrays : dict of name to array
        Read-only memory maps.
    document : dict

    Raises
    ------
    UnreadableFile
        If the file is missing, cut short, too long or not a container of morphspace.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(8)
            if len(head) < 8:
                raise UnreadableFile(
                    f"{path} has {size} bytes; expected at least 8 for its header. Copy it again or rebuild it"
                )
            (length,) = struct.unpack("<Q", head)
            text = file.read(min(length, MAX_HEADER_BYTES, size))
        if len(text) < length:
            raise UnreadableFile(
                f"{path} is cut short: it has {size} bytes; expected {length + 8} or more. Copy it again or rebuild it"
                if text.startswith(CONTAINER_START) and length <= MAX_HEADER_BYTES
                else f"{path} is no .morph file; expected the header of one. Check the name"
            )
        header = parsed_json(text)
        document = parsed_json(header.pop("__metadata__")["morphspace"])
        if not isinstance(document, dict):
            raise TypeError("the document is not an object")
        entries = {name: _entry_of(entry) for name, entry in header.items()}
    except OSError as error:
        what = "it is a folder. Enter a file" if path.is_dir() else f"{error.strerror or error}. {CHECK}"
        raise UnreadableFile(f"cannot read {path}: {what}") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise UnreadableFile(
            f"{path} is not a morphspace file: its header is not readable. Check the name"
        ) from error
    start = 8 + length
    arrays: dict[str, AnyArray] = {}
    end = start
    for name, (dtype, shape, first, last) in entries.items():
        expected = dtype.itemsize * math.prod(shape)  # Python's integers: a header may hold any size
        if min((0, *shape)) < 0 or first < 0 or last - first != expected:
            raise UnreadableFile(
                f"{path}: array {name} of shape {shape} has {last - first} bytes in the header; expected {expected}. "
                "Copy it again or rebuild it"
            )
        end = max(end, start + last)
        if end > size:
            raise UnreadableFile(
                f"{path} is cut short: it has {size} bytes; expected {end}. Copy it again or rebuild it"
            )
        try:
            arrays[name] = _mapped(path, dtype, shape, start + first) if expected else np.zeros(shape, dtype)
        except ValueError as error:  # more axes, or longer empty ones, than numpy allows
            raise UnreadableFile(
                f"{path}: array {name} has {len(shape)} axes, more or longer ones than numpy allows. Rebuild it"
            ) from error
    if end != size:
        raise UnreadableFile(
            f"{path} is too long: it has {size} bytes; expected {end}. Copy it again or rebuild it"
        )
    return arrays, document


def _entry_of(entry: Any) -> tuple[np.dtype[Any], tuple[int, ...], int, int]:
    first, last = entry["data_offsets"]
    return np.dtype(DTYPES[entry["dtype"]]), tuple(map(int, entry["shape"])), int(first), int(last)


def _mapped(path: Path, dtype: np.dtype[Any], shape: tuple[int, ...], offset: int) -> AnyArray:
    return np.memmap(path, dtype=dtype, mode="r", offset=offset, shape=shape)
