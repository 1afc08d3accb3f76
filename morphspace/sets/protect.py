"""Protect files at an output: ONE guard decides what a verb may overwrite, and keeps two runs apart (ours).

A verb writes inside `writing`. The guard refuses to replace an input or a file that no earlier run of the verb wrote,
locks the output for this run, and marks it as begun. A stopped run leaves the mark, so that the next one recognises
its files. A finished run leaves its record, sidecars or pages, by which its files are recognised.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from morphspace import storage
from morphspace.documents import read_json_object
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.clips import IMAGE_SUFFIXES, SIDECAR_NAME, VIDEO_SUFFIXES
from morphspace.io.images import read_image
from morphspace.io.points_table import POINTS
from morphspace.io.stimulus_sidecars import STIMULUS, essentials_in
from morphspace.io.tables import LOADINGS
from morphspace.outcome import RECORD, RECORD_NAME, relative_name
from morphspace.sets.marks import begun_in, locked
from morphspace.sets.outputs import TABLE_SUFFIX, Output, check_apart, check_inputs, refuse
from morphspace.sets.stimulus import is_as_written
from morphspace.storage import MARK_NAME, digest_of_file, is_container_or_nothing, make_folder, read_container

TABLES = (LOADINGS.format, POINTS.format)
SIDECAR_START = '{\n  "consent": '  # keys are sorted, and this key comes first in every sidecar
MODEL_SUFFIX = ".morph"
FILE_SUFFIXES = (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES, ".gif")
SYSTEM_FILES = ("thumbs.db", "desktop.ini")  # written by file managers, like all names that begin with a dot
PAGE_FOOTER = b"<footer>Written by morphspace."
END_BYTES = 4096  # bytes at the end of a page that hold its footer


@contextlib.contextmanager
def writing(output: Output) -> Iterator[None]:
    """Guard an output for the duration of the block that writes it.

    Before the block, unfinished files of killed runs are removed. If the block fails before it finished a file, the
    folders that it made are removed.

    Raises
    ------
    BadInput
        If the output would replace an input or a file of another origin, or another run is writing it.
    UnwritableFile
        If the folder cannot be made or written.
    """
    check_inputs(output.written, output.inputs)
    _check_no_clip(output)
    before = _folders(output)
    try:
        inner = () if output.is_folder else (path.parent for path in output.written)
        for folder in dict.fromkeys((output.folder, *inner)):
            make_folder(folder)
        with locked(output) as mark:
            begun = check_origins(output)
            listed = _listed(output)
            _remove_unfinished(output)
            mark.begin(begun)
            try:
                with storage.watching(mark.note):
                    yield
            except BaseException:
                is_known = all(_is_recognised(path, output, {}, listed) for path in _there(output))
                if is_known and not begun and not any(map(_holds, itertools.chain(*output.stimuli))):
                    mark.remove()
                raise
            _remove_stale(output, {**begun, **listed})
            mark.remove()
    finally:
        _remove_empty(output, before)


# What exists, and whose it is.


def _check_no_clip(output: Output) -> None:
    """Check that an output folder is no clip and holds no pictures of others, with which new ones would be mixed."""
    if not output.is_folder:
        return
    if not output.folder.is_dir():
        _check_name_of_folder(output.folder)
        return
    check_apart(output.folder, [path for path in output.inputs if path.suffix.lower() in IMAGE_SUFFIXES])
    sidecar = output.folder / SIDECAR_NAME  # a stimulus may be called clip
    if sidecar.exists() and not _is_sidecar(sidecar):
        raise BadInput(
            f"the output folder {output.folder} is a clip (it holds {SIDECAR_NAME}). Choose another output folder"
        )
    written = set(output.written)
    for path in output.folder.iterdir() if output.stimuli else ():
        is_alone = not (path.with_suffix(".json").exists() or path.with_name(f"{path.name}.json").exists())
        if path.suffix.lower() in IMAGE_SUFFIXES and is_alone and path not in written and _is_content(path):
            raise BadInput(
                f"the output folder {output.folder} holds pictures that are no stimuli, such as {path.name}; they "
                "would be mixed. Choose another output folder"
            )


def _check_name_of_folder(folder: Path) -> None:
    """Check that the name of a new folder is none of a picture or a video, which the user expects then."""
    if folder.suffix.lower() in FILE_SUFFIXES and not folder.exists():
        raise BadInput(
            f"the output {folder} is a folder, but its name ends in {folder.suffix}; expected a name without. Choose "
            f"another, such as {folder.with_suffix('')}"
        )


def _there(output: Output) -> Iterator[Path]:
    """Yield the existing files under names of the output that are not empty; of its own folders, all files."""
    for path in output.files:
        if path.is_dir() and not path.is_symlink():
            if path in output.own_folders:
                yield from (one for one in path.rglob("*") if one.is_file() and _is_content(one))
            elif any(map(_is_content, path.iterdir())):
                yield path
        elif _holds(path):
            yield path


def _holds(path: Path) -> bool:
    """Return whether something that could be lost has this name: a folder, a link, or a file that is not empty."""
    return path.is_symlink() or path.is_dir() or (path.exists() and path.stat().st_size > 0)


def _is_content(path: Path) -> bool:
    return not (path.name.startswith(".") or path.name.lower() in SYSTEM_FILES)


def check_origins(output: Output) -> dict[str, str]:
    """Check that everything that would be replaced was written by an earlier run; return what a stopped run wrote.

    Raises `BadInput` otherwise.
    """
    begun, listed = begun_in(output), _listed(output)
    for path in _there(output):
        if not _is_recognised(path, output, begun, listed):
            refuse(path, output.verb)
        found = None if output.is_folder or output.identity is None else _identity_in(path)
        if found not in (None, output.identity):
            raise BadInput(
                f"{path} is of {found}, and would be replaced by one of {output.identity}. Choose another output, or "
                f"move {path.name} away"
            )
    recorded = _recorded(output) if output.stimuli else {}
    for picture, sidecar in output.stimuli:
        for path in (picture, sidecar):
            if path.is_dir():
                refuse(path, output.verb)
        is_own = _is_sidecar(sidecar)
        if _holds(picture) and not _is_stimulus(picture) and not (is_own and _is_damaged(picture)):
            refuse(picture, output.verb)
        if _holds(sidecar) and not is_own and not _is_stimulus(picture):
            refuse(sidecar, output.verb)
        for path in (picture, sidecar) if is_own else ():
            if _is_edited(path, recorded.get(relative_name(path, output.folder)), path == sidecar):
                raise BadInput(
                    f"{path} was changed since it was written, such as by a note, and would be replaced. Keep notes in "
                    f"a file of your own, and move {path.name} away, or choose another output"
                )
    return begun


def _is_recognised(path: Path, output: Output, begun: Mapping[str, str], listed: Mapping[str, str]) -> bool:
    """Return whether an earlier run wrote a file that is unchanged since: by mark, record, or its own content."""
    if path.is_dir():
        return False
    name = relative_name(path, output.folder)
    if path == output.record:
        return bool(listed) or name in begun
    known = {begun.get(name), listed.get(name)} - {None}
    if known and (digest_of_file(path) in known or _is_damaged(path)):
        return True
    return not output.is_folder and _is_own_format(path) and not _is_of_a_set(path)


def _listed(output: Output) -> dict[str, str]:
    """Return the digests in the record of an earlier run of the verb, by name."""
    record = _object(output.record)
    listed = record.get("outputs")
    is_own = record.get("format") == RECORD.format and record.get("verb") == output.verb
    return (
        {str(name): str(digest) for name, digest in listed.items()}
        if is_own and isinstance(listed, dict)
        else {}
    )


def _is_of_a_set(path: Path) -> bool:
    """Return whether the record of the folder lists a file, which then belongs to a set."""
    listed = _object(path.parent / RECORD_NAME).get("outputs")
    return isinstance(listed, Mapping) and path.name in listed


def _is_own_format(path: Path) -> bool:
    """Return whether the content of a file shows that morphspace wrote it, and of a table that nobody changed it."""
    suffix = path.suffix.lower()
    if suffix == TABLE_SUFFIX:
        beside = _object(path.with_suffix(".json"))
        return beside.get("format") in TABLES and beside.get("table_sha256") == digest_of_file(path)
    if suffix == ".json":
        return _object(path).get("format") in (*TABLES, RECORD.format)
    if suffix == ".html":
        return PAGE_FOOTER in _end(path)
    if path.name.endswith(".keypoints.png"):  # the picture beside a model with new keypoints
        path = path.with_name(f"{path.name.removesuffix('.keypoints.png')}.morph")
    return path.is_file() and is_container_or_nothing(path)


def _identity_in(path: Path) -> str | None:
    """Return the person of a table or a model; None if it is unknown."""
    suffix = path.suffix.lower()
    if suffix == TABLE_SUFFIX:
        found = _object(path.with_suffix(".json")).get("identity")
    elif suffix == MODEL_SUFFIX:
        try:
            found = dict(read_container(path)[1].get("provenance") or {}).get("identity")
        except (UnreadableFile, TypeError, ValueError):
            found = None
    else:
        found = None
    return found if isinstance(found, str) else None


def _is_stimulus(picture: Path) -> bool:
    return picture.is_file() and essentials_in(picture) is not None


def _is_damaged(picture: Path) -> bool:
    """Return whether a picture or video cannot be read, so that nothing is lost if it is drawn again."""
    suffix = picture.suffix.lower()
    if suffix not in (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES):
        return False
    try:
        if suffix in IMAGE_SUFFIXES:
            read_image(picture)
        else:
            from morphspace.io.video import video_info  # loads libav

            video_info(picture)
    except UnreadableFile:
        return True
    return False


def _is_sidecar(path: Path) -> bool:
    """Return whether a file is a stimulus' sidecar, complete or cut short."""
    return _object(path).get("format") == STIMULUS.format or _start(path).startswith(SIDECAR_START.encode())


def _recorded(output: Output) -> Mapping[str, Any]:
    """Return the digests in the record of the folder; none if a stopped run has written since."""
    was_stopped = output.mark.is_file() and output.mark.stat().st_size > 0
    found = {} if was_stopped else _object(output.record).get("outputs")
    return found if isinstance(found, dict) else {}


def _is_edited(path: Path, recorded: Any, is_sidecar: bool) -> bool:
    """Return whether an undamaged stimulus or sidecar is not the recorded one, or a sidecar belies its own digests."""
    if not _holds(path) or (is_sidecar and not _object(path)):
        return False
    if recorded is not None:
        return digest_of_file(path) != recorded and not _is_damaged(path)
    return is_sidecar and not is_as_written(path)


def _start(path: Path) -> bytes:
    return _read(path, 0)


def _end(path: Path) -> bytes:
    return _read(path, max(0, path.stat().st_size - END_BYTES))


def _read(path: Path, start: int) -> bytes:
    try:
        with path.open("rb") as file:
            file.seek(start)
            return file.read(END_BYTES)
    except (FileNotFoundError, NotADirectoryError):
        return b""
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror or error}. Check the permissions"
        ) from error


def _object(path: Path) -> dict[str, Any]:
    """Read a JSON object; return an empty one if the file is missing or unreadable."""
    try:
        return read_json_object(path)
    except UnreadableFile:
        return {}


# What killed and failed runs left.


def _remove_unfinished(output: Output) -> None:
    """Remove the temporary files of killed runs: with names of the output, and all in folders that it alone writes.

    A run that was killed in this folder, perhaps of another verb, has left its mark, and all goes. But other runs may
    be writing single files here: their marks come before their temporary files.
    """
    if output.is_folder and output.mark.stat().st_size:
        found = list(storage.unfinished_in(output.folder))
        if not any(output.folder.glob(f".*{MARK_NAME}")):  # `.NAME.writing.json`
            for path in found:
                path.unlink(missing_ok=True)
    names: dict[Path, set[str]] = {}
    for path in output.written:
        if path.is_dir():
            storage.remove_unfinished(path)
        else:
            names.setdefault(path.parent, set()).add(path.name)
    for folder, here in names.items():
        if folder.is_dir():
            storage.remove_unfinished(folder, names=here)


def _remove_stale(output: Output, earlier: Mapping[str, str]) -> None:
    """Remove from the output's own folders the unchanged files of an earlier run that this run did not write."""
    written = _listed(output)
    for name, digest in earlier.items() if written else ():
        path = output.folder / name
        if output.owns(path) and name not in written and path.is_file() and digest_of_file(path) == digest:
            path.unlink()


def _folders(output: Output) -> set[Path]:
    """Return the existing folders of an output: its own and its subfolders, those of its files, and all parents."""
    places = {output.folder, *(path.parent for path in output.written)}
    there = {one for place in places for one in (place, *place.parents)}
    if output.is_folder and output.folder.is_dir():
        there |= {one for one in output.folder.iterdir() if one.is_dir()}
    return {one for one in there if one.is_dir()}


def _remove_empty(output: Output, before: Collection[Path]) -> None:
    """Remove the empty folders that a run made."""
    made = _folders(output) - set(before)
    made |= {Path(inner) for place in made for inner, _, _ in os.walk(place)}
    for path in sorted(made, key=lambda path: len(path.parts), reverse=True):
        with contextlib.suppress(OSError):  # it holds files
            path.rmdir()
