"""Protect files in an output folder: a verb replaces only its own earlier files, never an input (ours)."""

from __future__ import annotations

import contextlib
import dataclasses
import glob
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from morphspace import storage
from morphspace.cache import SUFFIX
from morphspace.errors import BadInput, MorphspaceError, UnreadableFile
from morphspace.io.clips import FRAMES_FOLDER, SIDECAR_NAME, VIDEO_SUFFIXES
from morphspace.io.sidecars import read_json_object
from morphspace.io.stimulus_sidecars import STIMULUS_FORMAT, essentials_in
from morphspace.outcome import RECORD_NAME
from morphspace.sets.manifest import MANIFEST_FORMAT
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import digest_of_file, make_folder

RECORD_FORMAT = "morphspace-record"
TABLE_SUFFIX = ".csv"
LONGEST_NAME_BYTES = 200  # bytes of the 255 of a file system; records and unfinished files have longer names
FOLDER_FIELDS = ("clip", "first", "last")  # request fields in which a folder is a clip
SIDECAR_START = '{\n  "consent": '  # keys are sorted, and this key comes first in every sidecar
OWN_FILES = (
    "manifest.csv",
    "manifest.json",
    "loadings.csv",
    "loadings.json",
    "colour_loadings.csv",
    "colour_loadings.json",
    "index.html",
    RECORD_NAME,
)
MIMIC_FRAMES = "frames"
MODELS_FOLDER = "models"  # models built from clips
WORK_FOLDER = "mimic.work"  # finished frames of a stopped run
VIDEO_NAME = "side-by-side.mp4"
MIMIC_FILES = (
    MIMIC_FRAMES,
    VIDEO_NAME,
    "loadings.csv",
    "loadings.json",
    "quality.csv",
    "quality.json",
    "index.html",
    RECORD_NAME,
)


def check_file(path: Path, suffix: str, kept: Iterable[Path] = ()) -> None:
    """Check the suffix of an output, and that it is neither a folder nor one of the files to be `kept`."""
    length = len(os.fsencode(path.name))
    if length > LONGEST_NAME_BYTES:
        raise BadInput(
            f"the output's name {path.name[:20]}... has {length} bytes; expected at most {LONGEST_NAME_BYTES}, "
            "because files beside it have longer names"
        )
    if path.suffix.lower() != suffix:
        raise BadInput(
            f"the output is {path}; expected a name in {suffix}. Call it {path.stem or 'output'}{suffix}"
        )
    if path.is_dir():
        raise BadInput(f"the output {path} is a folder. Give the name of a {suffix} file")
    check_inputs([path], tuple(kept))


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


def check_apart(output: Path, inputs: Sequence[Path]) -> None:
    """Check that no input frame is in the output folder, where it would be mixed with the outputs."""
    for path in inputs:
        if path.suffix.lower() not in VIDEO_SUFFIXES and path.parent.resolve() == output.resolve():
            raise BadInput(
                f"the output folder {output} holds the input frames, such as {path.name}. Choose another "
                "output folder, such as one in it"
            )


def check_set(
    folder: Path,
    drawings: Sequence[Drawing],
    inputs: Collection[Path] = (),
    tables: Collection[str] = (),
) -> None:
    """Create the folder; check that it can be written and that neither inputs nor files of other origin are replaced.

    `inputs` are the files read; `tables` are the names of the set's own tables beside the usual files.
    """
    stimuli = [(folder / drawing.file_name, folder / f"{drawing.name}.json") for drawing in drawings]
    own = [folder / name for name in dict.fromkeys((*OWN_FILES, *tables))]
    check_inputs([*own, *(path for pair in stimuli for path in pair)], inputs)
    make_folder(folder)
    for picture, sidecar in stimuli:
        check_replaced(picture, sidecar)
    _check_own(folder, [path for path in own if path.exists()], [sidecar for _, sidecar in stimuli])


def _check_own(folder: Path, found: Sequence[Path], sidecars: Sequence[Path]) -> None:
    """Check that existing files with names of a set belong to a set. Raises `BadInput` otherwise."""
    if not found:
        return
    record, manifest = _object(folder / RECORD_NAME), _object(folder / "manifest.json")
    listed = record.get("outputs") if record.get("format") == RECORD_FORMAT else None
    if not isinstance(listed, Mapping):
        listed = {}
    unlisted = _begun(sidecars, listed, folder) or (not listed and manifest.get("format") == MANIFEST_FORMAT)
    for path in found:
        if path.is_dir():
            raise BadInput(f"{path} is a folder; expected a file of the set. Choose another output folder")
        if not (unlisted or path.name in listed or (listed and path.name == RECORD_NAME)):
            raise BadInput(
                f"{path} would be replaced, but is not of a stimulus set. Choose another output folder"
            )


def _begun(sidecars: Sequence[Path], listed: Mapping[str, Any], folder: Path) -> bool:
    """Check whether an interrupted set began in this folder: it holds a stimulus that no record lists."""
    for sidecar in sidecars:
        if _object(sidecar).get("format") == STIMULUS_FORMAT:
            recorded = listed.get(sidecar.relative_to(folder).as_posix())
            if recorded != digest_of_file(sidecar):
                return True
    return False


def _object(path: Path) -> dict[str, Any]:
    """Read a JSON object; return an empty one if the file is missing or unreadable."""
    try:
        return read_json_object(path)
    except UnreadableFile:
        return {}


def check_replaced(picture: Path, sidecar: Path) -> None:
    """Check that a stimulus and its sidecar replace only a stimulus of ours. Raises `BadInput` otherwise.

    An incomplete sidecar is replaced if it, or the picture beside it, was written by us.
    """
    for path in (picture, sidecar):
        if path.is_dir():
            raise BadInput(f"{path} is a folder; expected a stimulus. Choose another output folder")
    if sidecar.exists():
        if _object(sidecar).get("format") == STIMULUS_FORMAT or _starts_like_ours(sidecar):
            return
        if picture.exists() and essentials_in(picture) is not None:
            return
        raise BadInput(
            f"{sidecar} would be replaced, but is not a stimulus' sidecar. Delete it or choose another folder"
        )
    if picture.exists() and essentials_in(picture) is None:
        raise BadInput(
            f"{picture} would be replaced, but is not a stimulus of morphspace. Delete it or choose another folder"
        )


def _starts_like_ours(sidecar: Path) -> bool:
    try:
        with sidecar.open("rb") as file:
            return file.read(len(SIDECAR_START)) == SIDECAR_START.encode()
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {sidecar}: {error.strerror or error}. Check the permissions"
        ) from error


def check_ours(folder: Path, verb: str = "mimic", written: Sequence[str] = MIMIC_FILES) -> None:
    """Check that all files with our names in the folder were written by a run of the verb.

    A folder VERB.work marks a run that was stopped. Raises `BadInput` for a file of other origin.
    """
    begun = (folder / f"{verb}.work").is_dir()
    if not folder.is_dir() or begun or _object(folder / RECORD_NAME).get("verb") == verb:
        return
    for name in written:
        path = folder / name
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            lost = "be mixed with the new pictures" if name == MIMIC_FRAMES else "be replaced"
            raise BadInput(
                f"{folder} is not the folder of an earlier {verb}, and its {name} would {lost}. Choose another output "
                f"folder, or move {name} away"
            )


def remove_unfinished(folder: Path) -> None:
    """Remove the unfinished files of a stopped run; the folder must be ours."""
    for place in (folder, *(folder / name for name in (MIMIC_FRAMES, WORK_FOLDER, MODELS_FOLDER))):
        storage.remove_unfinished(place, ".png", ".mp4", ".csv", ".json", ".html", ".morph", SUFFIX)


@contextlib.contextmanager
def told_what_stays(folder: Path) -> Iterator[None]:
    """Add to an error of the block the names of the finished or begun models that stay in the folder."""
    before = _models(folder)
    try:
        yield
    except MorphspaceError as error:
        made = [path.name for path in _models(folder) if path not in before]
        if not made:
            raise
        raise type(error)(
            f"{error}; the models made for it stay in {folder / MODELS_FOLDER} ({', '.join(made)}), and the next run "
            "here reuses them"
        ) from error


def _models(folder: Path) -> list[Path]:
    """List the models, and the work folders of begun models."""
    place = folder / MODELS_FOLDER
    return sorted(path for kind in ("*.morph", "*.morph.work") for path in place.glob(kind))


@contextlib.contextmanager
def no_empty_folders(
    folder: Path, inner: Sequence[str] = (MIMIC_FRAMES, WORK_FOLDER, MODELS_FOLDER)
) -> Iterator[None]:
    """Remove, at the end of the block, the empty folders that it created: `inner` ones, the folder and its parents."""
    places = [folder / name for name in inner]
    made = [path for path in (*places, folder, *folder.parents) if not path.exists()]
    begun = folder / MODELS_FOLDER
    try:
        yield
    finally:
        for path in (*begun.glob("*.morph.work"), *made):
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
