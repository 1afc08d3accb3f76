"""What a verb writes, and the checks of its names and inputs before any work (ours)."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import glob
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from morphspace.errors import BadInput
from morphspace.io.clips import FRAMES_FOLDER, IMAGE_SUFFIXES, SIDECAR_NAME, VIDEO_SUFFIXES
from morphspace.outcome import RECORD_NAME
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import MARK_NAME

TABLE_SUFFIX = ".csv"
LONGEST_NAME_BYTES = 200  # bytes of the 255 of a file system; records and unfinished files have longer names
FOLDER_FIELDS = ("clip", "first", "last")  # request fields in which a folder is a clip
SET_FILES = (
    "manifest.csv",
    "manifest.json",
    "loadings.csv",
    "loadings.json",
    "colour_loadings.csv",
    "colour_loadings.json",
    "index.html",
    RECORD_NAME,
)


@dataclass(frozen=True, eq=False)
class Output:
    """Everything that a run of a verb writes.

    Attributes
    ----------
    verb : str
    place : Path
        The output folder, or the main output file if it is one of `files` or `stimuli`.
    files : sequence of Path
        Files with fixed names. A folder among them belongs to the verb with all its content.
    stimuli : sequence of (Path, Path)
        Stimuli with their sidecars, by which each is recognised.
    inputs : collection of Path
        Files that are read and must not be replaced.
    identity : str, optional
        The person of a model or a table; that of another person is not replaced.
    """

    verb: str
    place: Path
    files: Sequence[Path]
    stimuli: Sequence[tuple[Path, Path]] = ()
    inputs: Collection[Path] = ()
    identity: str | None = None

    @functools.cached_property
    def is_folder(self) -> bool:
        """Return whether the output is a folder rather than a named file."""
        return self.place not in self.files and all(self.place not in pair for pair in self.stimuli)

    @property
    def own_folders(self) -> list[Path]:
        """Return the folders among the files, whose names have no suffix."""
        return [path for path in self.files if not path.suffix]

    def owns(self, path: Path) -> bool:
        """Return whether a path lies in a folder of the verb's own."""
        return any(path.is_relative_to(folder) for folder in self.own_folders)

    @property
    def written(self) -> tuple[Path, ...]:
        """Return all files and folders that are written."""
        return (*self.files, *(path for pair in self.stimuli for path in pair))

    @property
    def folder(self) -> Path:
        """Return the folder that holds the mark."""
        return self.place if self.is_folder else self.place.parent

    @property
    def mark(self) -> Path:
        """Return the file that marks the output while it is written."""
        return self.folder / (MARK_NAME if self.is_folder else f".{self.place.name}{MARK_NAME}")

    @property
    def record(self) -> Path:
        """Return the record of a finished run."""
        return self.folder / (RECORD_NAME if self.is_folder else f"{self.place.name}.{RECORD_NAME}")


def set_output(
    verb: str,
    folder: Path,
    drawings: Sequence[Drawing],
    inputs: Collection[Path] = (),
    tables: Collection[str] = (),
) -> Output:
    """Return the output of a set of stimuli; `tables` are its own tables beside the usual files."""
    stimuli = [(folder / drawing.file_name, folder / f"{drawing.name}.json") for drawing in drawings]
    return Output(
        verb, folder, [folder / name for name in dict.fromkeys((*SET_FILES, *tables))], stimuli, inputs
    )


def refuse(path: Path, verb: str) -> NoReturn:
    """Raise `BadInput` for a file or folder of another origin."""
    what = "a folder" if path.is_dir() else "a file"
    raise BadInput(
        f"{path} is {what} that no earlier {verb} wrote, or that was changed since, and would be replaced. Choose "
        f"another output, or move {path.name} away"
    )


def check_file(path: Path, suffix: str) -> None:
    """Check the name of an output file: its length and suffix, and that it is no folder. Raises `BadInput`."""
    length = len(os.fsencode(path.name))
    if length > LONGEST_NAME_BYTES:
        raise BadInput(
            f"the output's name {path.name[:20]}... has {length} bytes; expected at most {LONGEST_NAME_BYTES}, "
            "because files beside it have longer names"
        )
    if path.suffix.lower() != suffix:
        raise BadInput(
            f"the output is {path}; expected a name in {suffix}. Call it {path.stem.strip('.') or 'output'}{suffix}"
        )
    if path.is_dir():
        raise BadInput(f"the output {path} is a folder. Give the name of a {suffix} file")


def files_named(request: Any) -> tuple[Path, ...]:
    """List the files that a request reads: models, tables with their sidecars, frames of clips."""
    found: dict[Path, None] = {}
    for entry in dataclasses.fields(request):
        if entry.name != "output":
            for words in _words(getattr(request, entry.name)):
                found |= dict.fromkeys(_files(words, entry.name in FOLDER_FIELDS))
    return tuple(found)


def _words(value: Any) -> Iterator[str]:
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _words(one)
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _words(one)


def _files(words: str, folders: bool) -> Iterator[Path]:
    """Yield the files of a path: the file and its sidecar, the frames of a folder, or the matches of a pattern."""
    head, mark, _ = words.rpartition(":")
    if mark and head.lower().endswith(TABLE_SUFFIX):
        words = head  # TABLE.csv:FRAME
    path = Path(words)
    with contextlib.suppress(OSError, ValueError):  # a name the system cannot have
        if path.is_file():
            yield path
            beside = path.with_suffix(".json" if path.suffix.lower() == TABLE_SUFFIX else f".{SIDECAR_NAME}")
            if beside.is_file():
                yield beside
        elif folders and path.is_dir():
            for place in (path, path / FRAMES_FOLDER):
                if place.is_dir():
                    yield from (one for one in place.iterdir() if one.is_file())
        elif folders and glob.has_magic(words):
            for match in glob.glob(words, recursive=True):  # noqa: PTH207 - a pattern may be absolute
                yield from _files(match, not glob.has_magic(match))


def check_inputs(written: Iterable[Path], inputs: Collection[Path]) -> None:
    """Check that no file to be written is one of the inputs. Raises `BadInput` otherwise."""
    there = [path for path in written if path.exists()]
    kept = {path.resolve() for path in set(inputs)} if there else set()
    for path in there:
        if path.resolve() in kept:
            raise BadInput(
                f"the output {path} is one of the inputs and would be replaced. Choose another output"
            )


def check_work_folder(folder: Path | None) -> None:
    """Check that a given folder for finished results is no clip, which they would join. Raises `BadInput`."""
    for place in () if folder is None else (folder, folder / FRAMES_FOLDER):
        for path in place.iterdir() if place.is_dir() else ():
            if path.name == SIDECAR_NAME or path.suffix.lower() in (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES):
                raise BadInput(
                    f"the work folder {folder} is a clip (it holds {path.name}); expected a folder of its own. Choose "
                    "another, such as one that does not exist yet"
                )


def check_apart(output: Path, inputs: Sequence[Path]) -> None:
    """Check that no input frame is in the output folder, among the outputs. Raises `BadInput` otherwise."""
    for path in inputs:
        if path.suffix.lower() not in VIDEO_SUFFIXES and path.parent.resolve() == output.resolve():
            raise BadInput(
                f"the output folder {output} holds the input frames, such as {path.name}. Choose another "
                "output folder, such as one in it"
            )
