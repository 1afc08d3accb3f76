"""What may be replaced in an output folder: files of the verb itself, never an input, never a file of somebody else."""

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
LONGEST_NAME_BYTES = 200  # of the 255 a file system takes; a record and unfinished files have longer names
FOLDER_FIELDS = ("clip", "first", "last")  # of requests: a folder named there is a clip's
SIDECAR_START = '{\n  "consent": '  # keys are in order, and every sidecar of ours has this one
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
MODELS_FOLDER = "models"  # models that were built on the way
WORK_FOLDER = "mimic.work"  # finished frames of a run that was stopped
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
    check_inputs([path], tuple(kept))


def files_named(request: Any) -> tuple[Path, ...]:
    """Give the files on the disk that a frozen request reads: models, tables with their sidecars, frames of clips."""
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
    """Give the files that words name: a file and what is beside it, a folder's frames, a pattern's matches."""
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
    """Raise `BadInput` where a file that is to be written is one of the inputs."""
    there = [path for path in written if path.exists()]
    kept = {path.resolve() for path in set(inputs)} if there else set()
    for path in there:
        if path.resolve() in kept:
            raise BadInput(f"the output {path} is one of the inputs and would be lost: choose another output")


def check_apart(output: Path, inputs: Sequence[Path]) -> None:
    """Raise `BadInput` where frames lie in the output folder itself: they and what is written would be mixed."""
    for path in inputs:
        if path.suffix.lower() not in VIDEO_SUFFIXES and path.parent.resolve() == output.resolve():
            raise BadInput(
                f"the output folder {output} holds the frames that are read, such as {path.name}: choose another "
                "output folder, such as one in it"
            )


def check_set(
    folder: Path,
    drawings: Sequence[Drawing],
    inputs: Collection[Path] = (),
    tables: Collection[str] = (),
) -> None:
    """Make the folder, or raise where it cannot be written, or inputs or files that are not ours would be replaced.

    `inputs` are the files read; `tables` the names of the set's own tables beside the usual files.
    """
    stimuli = [(folder / drawing.file_name, folder / f"{drawing.name}.json") for drawing in drawings]
    own = [folder / name for name in dict.fromkeys((*OWN_FILES, *tables))]
    check_inputs([*own, *(path for pair in stimuli for path in pair)], inputs)
    make_folder(folder)
    for picture, sidecar in stimuli:
        check_replaced(picture, sidecar)
    _check_own(folder, [path for path in own if path.exists()], [sidecar for _, sidecar in stimuli])


def _check_own(folder: Path, found: Sequence[Path], sidecars: Sequence[Path]) -> None:
    """Raise `BadInput` where a file called like one of a set is there and the folder is no set's."""
    if not found:
        return
    record, manifest = _object(folder / RECORD_NAME), _object(folder / "manifest.json")
    listed = record.get("outputs") if record.get("format") == RECORD_FORMAT else None
    if not isinstance(listed, Mapping):
        listed = {}
    unlisted = _begun(sidecars, listed, folder) or (not listed and manifest.get("format") == MANIFEST_FORMAT)
    for path in found:
        if path.is_dir():
            raise BadInput(
                f"{path} is a folder, and the set writes a file there: choose another output folder"
            )
        if not (unlisted or path.name in listed or (listed and path.name == RECORD_NAME)):
            raise BadInput(
                f"{path} would be replaced, and is not of a stimulus set: choose another output folder"
            )


def _begun(sidecars: Sequence[Path], listed: Mapping[str, Any], folder: Path) -> bool:
    """Tell whether a set was killed while it took over a folder: a stimulus of it is there that no record lists."""
    for sidecar in sidecars:
        if _object(sidecar).get("format") == STIMULUS_FORMAT:
            recorded = listed.get(sidecar.relative_to(folder).as_posix())
            if recorded != digest_of_file(sidecar):
                return True
    return False


def _object(path: Path) -> dict[str, Any]:
    """Give a JSON object, an empty one where there is none that can be read."""
    try:
        return read_json_object(path)
    except UnreadableFile:
        return {}


def check_replaced(picture: Path, sidecar: Path) -> None:
    """Raise `BadInput` where a stimulus or its sidecar would replace a file that is no stimulus of ours.

    A sidecar that is not whole is made again where it, or the picture beside it, shows that it was ours.
    """
    for path in (picture, sidecar):
        if path.is_dir():
            raise BadInput(
                f"{path} is a folder, and a stimulus is written there: choose another output folder"
            )
    if sidecar.exists():
        if _object(sidecar).get("format") == STIMULUS_FORMAT or _starts_like_ours(sidecar):
            return
        if picture.exists() and essentials_in(picture) is not None:
            return
        raise BadInput(
            f"{sidecar} would be replaced, and is no stimulus' sidecar: delete it or choose another folder"
        )
    if picture.exists() and essentials_in(picture) is None:
        raise BadInput(
            f"{picture} would be replaced, and is no stimulus of ours: delete it or choose another folder"
        )


def _starts_like_ours(sidecar: Path) -> bool:
    try:
        with sidecar.open("rb") as file:
            return file.read(len(SIDECAR_START)) == SIDECAR_START.encode()
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {sidecar}: {error.strerror or error}; check the permissions"
        ) from error


def check_ours(folder: Path, verb: str = "mimic", written: Sequence[str] = MIMIC_FILES) -> None:
    """Raise `BadInput` where the folder holds something under a name of ours that no run of the verb left there.

    A folder VERB.work there says that a run was stopped.
    """
    begun = (folder / f"{verb}.work").is_dir()
    if not folder.is_dir() or begun or _object(folder / RECORD_NAME).get("verb") == verb:
        return
    for name in written:
        path = folder / name
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            lost = "be mixed with the new pictures" if name == MIMIC_FRAMES else "be written over"
            raise BadInput(
                f"{folder} is no folder of an earlier {verb}, and its {name} would {lost}: choose another output "
                f"folder, or move {name} away"
            )


def remove_unfinished(folder: Path) -> None:
    """Take away the files that a killed run was in the middle of writing; the folder must be ours."""
    for place in (folder, *(folder / name for name in (MIMIC_FRAMES, WORK_FOLDER, MODELS_FOLDER))):
        storage.remove_unfinished(place, ".png", ".mp4", ".csv", ".json", ".html", ".morph", SUFFIX)


@contextlib.contextmanager
def told_what_stays(folder: Path) -> Iterator[None]:
    """Where the block ends in an error of ours, add to its words which models, begun or built in it, lie here now."""
    before = _models(folder)
    try:
        yield
    except MorphspaceError as error:
        made = [path.name for path in _models(folder) if path not in before]
        if not made:
            raise
        raise type(error)(
            f"{error}; what was made for it stays in {folder / MODELS_FOLDER} ({', '.join(made)}), and the next run "
            "here goes on from it"
        ) from error


def _models(folder: Path) -> list[Path]:
    """Give the models, and the work folders of models that were begun."""
    place = folder / MODELS_FOLDER
    return sorted(path for kind in ("*.morph", "*.morph.work") for path in place.glob(kind))


@contextlib.contextmanager
def no_empty_folders(
    folder: Path, inner: Sequence[str] = (MIMIC_FRAMES, WORK_FOLDER, MODELS_FOLDER)
) -> Iterator[None]:
    """Take away, however the block ends, what folders it made here that are empty: `inner` ones, this, its parents."""
    places = [folder / name for name in inner]
    made = [path for path in (*places, folder, *folder.parents) if not path.exists()]
    begun = folder / MODELS_FOLDER
    try:
        yield
    finally:
        for path in (*begun.glob("*.morph.work"), *made):
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
