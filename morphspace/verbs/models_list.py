"""models list: list the networks that find faces, and check their files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from morphspace.requests import declared
from morphspace.verbs.models_fetch import NetworksFolder, credit_lines

if TYPE_CHECKING:
    from morphspace.face.detector.models import Origin
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared
class ModelsListRequest:
    """List the networks and check that their files are present and undamaged."""

    folder: NetworksFolder = None


def run(request: ModelsListRequest, *, origins: tuple[Origin, ...] | None = None) -> Steps[Outcome]:
    """Describe for each network its task and whether its file is present and undamaged."""
    from morphspace.face.detector.models import FETCH_COMMAND, ORIGINS, models_folder, state_of
    from morphspace.outcome import Outcome
    from morphspace.steps import Step

    origins = origins or ORIGINS
    files = [file for origin in origins for file in origin.files]
    folder = models_folder() if request.folder is None else request.folder
    states = {}
    for done, file in enumerate(files):
        yield Step("check", done, len(files))
        states[file.name] = state_of(file, folder)
    widest = max(map(len, states))
    lines = [f"{folder}", *credit_lines(origins)]
    lines += [
        f"{file.name:<{widest}}  {states[file.name]:<7}  {file.size_bytes / 1e6:.2f} MB  {file.task}"
        for file in files
    ]
    absent = [name for name, state in states.items() if state != "present"]
    warnings = (f"{len(absent)} of {len(states)} are not usable: run `{FETCH_COMMAND}`",) if absent else ()
    document = {"folder": str(folder), "present": not absent, "models": states}
    return Outcome(tuple(lines), document, warnings)
