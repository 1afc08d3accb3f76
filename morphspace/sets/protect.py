"""Protect files at an output: ONE guard decides what a verb may overwrite, and keeps two runs apart (ours).

A verb writes inside `writing`. The guard refuses to replace an input or a file that no earlier run of the verb wrote,
locks the output for this run, and marks it as begun. A stopped run leaves the mark, so that the next one recognises
its files. A finished run leaves its record, sidecars or pages, by which its files are recognised.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import glob
import json
import os
import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphspace import storage
from morphspace.documents import read_json_object
from morphspace.errors import BadInput, MorphspaceError, UnreadableFile, UnwritableFile
from morphspace.io.clips import FRAMES_FOLDER, IMAGE_SUFFIXES, SIDECAR_NAME, VIDEO_SUFFIXES
from morphspace.io.images import read_image
from morphspace.io.stimulus_sidecars import STIMULUS, essentials_in
from morphspace.io.tables import LOADINGS
from morphspace.outcome import RECORD, RECORD_NAME, relative_name
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import MARK_NAME, digest_of_file, is_container_or_nothing, make_folder, read_container

TABLE_SUFFIX = ".csv"
LONGEST_NAME_BYTES = 200  # bytes of the 255 of a file system; records and unfinished files have longer names
FOLDER_FIELDS = ("clip", "first", "last")  # request fields in which a folder is a clip
SIDECAR_START = '{\n  "consent": '  # keys are sorted, and this key comes first in every sidecar
MODEL_SUFFIX = ".morph"
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
MODELS_FOLDER = "models"  # models built from clips
MARK_FORMAT = "morphspace-writing"
SYSTEM_FILES = ("thumbs.db", "desktop.ini")  # written by file managers, like all names that begin with a dot
PAGE_FOOTER = b"<footer>Written by morphspace."
HOLDER_TRIES, HOLDER_WAIT_S = 10, 0.05  # and s; a run writes the head of its mark at once
END_BYTES = 4096  # bytes at the end of a page that hold its footer


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
        with _locked(output) as mark:
            begun = check_origins(output)
            earlier = {**begun, **_listed(output)}
            _remove_unfinished(output)
            mark.begin(output, begun)
            try:
                with storage.watching(mark.note):
                    yield
            except BaseException:
                if not begun and all(_is_recognised(path, output, {}) for path in _there(output)):
                    mark.remove()
                raise
            _remove_stale(output, earlier)
            mark.remove()
    finally:
        _remove_empty(output, before)


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


# What exists, and whose it is.


def _check_no_clip(output: Output) -> None:
    """Check that an output folder is no clip and holds no pictures of others, with which new ones would be mixed."""
    if not output.is_folder or not output.folder.is_dir():
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


def _there(output: Output) -> Iterator[Path]:
    """Yield the existing files under names of the output that are not empty; of its own folders, all files."""
    for path in output.files:
        if path.is_dir() and not path.is_symlink():
            if path in _folders_of(output):
                yield from (one for one in path.rglob("*") if one.is_file() and _is_content(one))
            elif any(map(_is_content, path.iterdir())):
                yield path
        elif _holds(path):
            yield path


def _folders_of(output: Output) -> list[Path]:
    """Return the folders among the files of the output, whose names have no suffix."""
    return [path for path in output.files if not path.suffix]


def _holds(path: Path) -> bool:
    """Return whether something that could be lost has this name: a folder, a link, or a file that is not empty."""
    return path.is_symlink() or path.is_dir() or (path.exists() and path.stat().st_size > 0)


def _is_content(path: Path) -> bool:
    return not (path.name.startswith(".") or path.name.lower() in SYSTEM_FILES)


def check_origins(output: Output) -> dict[str, str]:
    """Check that everything that would be replaced was written by an earlier run; return what a stopped run wrote.

    Raises `BadInput` otherwise.
    """
    begun = _begun(output)
    for path in _there(output):
        if not _is_recognised(path, output, begun):
            _refuse(path, output.verb)
        found = None if output.is_folder or output.identity is None else _identity_in(path)
        if found not in (None, output.identity):
            raise BadInput(
                f"{path} is of {found}, and would be replaced by one of {output.identity}. Choose another output, or "
                f"move {path.name} away"
            )
    for picture, sidecar in output.stimuli:
        for path in (picture, sidecar):
            if path.is_dir():
                _refuse(path, output.verb)
        is_own = _is_sidecar(sidecar)
        if _holds(picture) and not _is_stimulus(picture) and not (is_own and _is_damaged(picture)):
            _refuse(picture, output.verb)
        if _holds(sidecar) and not is_own and not _is_stimulus(picture):
            _refuse(sidecar, output.verb)
    return begun


def _refuse(path: Path, verb: str) -> None:
    what = "a folder" if path.is_dir() else "a file"
    raise BadInput(
        f"{path} is {what} that no earlier {verb} wrote, or that was changed since, and would be replaced. Choose "
        f"another output, or move {path.name} away"
    )


def _is_recognised(path: Path, output: Output, begun: Mapping[str, str]) -> bool:
    """Return whether an earlier run wrote a file that is unchanged since: by mark, record, or its own content."""
    if path.is_dir():
        return False
    if path == output.record:
        return bool(_listed(output)) or relative_name(path, output.folder) in begun
    name = relative_name(path, output.folder)
    known = {begun.get(name), _listed(output).get(name)} - {None}
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
        return beside.get("format") == LOADINGS.format and beside.get("table_sha256") == digest_of_file(path)
    if suffix == ".json":
        return _object(path).get("format") in (LOADINGS.format, RECORD.format)
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


# Names and inputs, checked before any work.


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


def check_apart(output: Path, inputs: Sequence[Path]) -> None:
    """Check that no input frame is in the output folder, where it would be mixed with the outputs."""
    for path in inputs:
        if path.suffix.lower() not in VIDEO_SUFFIXES and path.parent.resolve() == output.resolve():
            raise BadInput(
                f"the output folder {output} holds the input frames, such as {path.name}. Choose another "
                "output folder, such as one in it"
            )


# The mark, which is also the lock: a line that names the run, then a line for each file with its digest.


@dataclass(frozen=True, eq=False)
class _Mark:
    output: Output
    handle: int
    lock: threading.Lock = dataclasses.field(default_factory=threading.Lock)

    def begin(self, output: Output, begun: Mapping[str, str]) -> None:
        """Write the head, and the files of a stopped run."""
        head = {"format": MARK_FORMAT, "verb": output.verb, "process": os.getpid()}
        lines = [json.dumps(head), *(json.dumps(list(item)) for item in begun.items())]
        try:
            os.ftruncate(self.handle, 0)
        except OSError as error:
            raise self._full(error) from error
        self._append("".join(f"{line}\n" for line in lines))

    def note(self, temporary: Path, path: Path) -> None:
        """Note a file and its digest before it gets its name, if it is one of the output."""
        inside = any(path.is_relative_to(folder) for folder in _folders_of(self.output))
        if inside or path in self.output.files:
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
        self.output.mark.unlink(missing_ok=True)


def _lines(mark: Path) -> list[Any]:
    """Read the JSON of each complete line of a mark; none if it is missing or of another format."""
    found: list[Any] = []
    with contextlib.suppress(OSError, ValueError, RecursionError):  # missing; the last line may be cut short
        for line in mark.read_text(encoding="utf-8").splitlines():
            found.append(json.loads(line))
    head = found[0] if found else None
    return found if isinstance(head, dict) and head.get("format") == MARK_FORMAT else []


def _begun(output: Output) -> dict[str, str]:
    """Return the digests of the files that a stopped run of the verb wrote, by name."""
    lines = _lines(output.mark)
    if not lines:
        if output.mark.is_file() and output.mark.stat().st_size and not output.mark.is_symlink():
            _refuse(output.mark, output.verb)
        return {}
    head, *entries = lines
    is_own = head.get("verb") == output.verb
    pairs = (entry for entry in entries if isinstance(entry, list) and len(entry) == 2)
    return {str(name): str(digest) for name, digest in pairs} if is_own else {}


@contextlib.contextmanager
def _locked(output: Output) -> Iterator[_Mark]:
    """Lock the mark for this run; the lock ends with the process. Raises `BadInput` if another run holds it."""
    while True:
        is_new = not output.mark.exists()
        try:
            handle = os.open(output.mark, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except OSError as error:
            raise UnwritableFile(
                f"cannot write {output.mark}: {error.strerror or error}. Choose another output"
            ) from error
        mark = _Mark(output, handle)
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


# What killed and failed runs left.


def _remove_unfinished(output: Output) -> None:
    """Remove the temporary files of killed runs with names of the output, and all in the output's own folders."""
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
        inside = any(path.is_relative_to(folder) for folder in _folders_of(output))
        if inside and name not in written and path.is_file() and digest_of_file(path) == digest:
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
