"""replay: draw a stimulus again from its sidecar, compare the bytes, and list differences."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import ClipText, declared
from morphspace.settings import Argument, Help, Option

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

DIFFERS = 3  # exit code: the stimulus was drawn again and differs


@declared
class ReplayRequest:
    """Draw the stimulus of SIDECAR again and compare the bytes.

    The exit code is 0 if they are the same, 3 if they differ; the differences are listed.
    """

    sidecar: Annotated[Path, Argument("SIDECAR"), Help("The .json beside a stimulus.")]
    model: Annotated[
        Path | None,
        Option(metavar="MODEL"),
        Help("The model [default: found by name and digest near the sidecar]."),
    ] = None
    clip: Annotated[
        tuple[ClipText, ...],
        Option(metavar="CLIP"),
        Help("The clip behind the faces if it was moved."),
    ] = ()
    output: Annotated[
        Path | None,
        Option("-o", "--output"),
        Help("File for the new stimulus [default: discard it]."),
    ] = None


def run(request: ReplayRequest) -> Steps[Outcome]:
    """Draw the stimulus and compare it; `document["same"]` is True if the bytes and all sidecar entries agree."""
    from morphspace.outcome import Outcome
    from morphspace.sets.replay import replayed

    again = yield from replayed(request.sidecar, request.model, request.clip, request.output)
    if again.same:
        first = "the same, byte for byte"
    elif again.same_bytes:
        first = "the same, byte for byte, but its sidecar differs"
    else:
        first = "not the same"
    lines = (f"{again.name}: {first}", *(f"  {words}" for words in (*again.differences, *again.others)))
    document = {
        "same": again.same,
        "file": again.found,
        "sha256": again.sha256,
        "recorded_sha256": again.recorded_sha256,
        "differences": list(again.differences),
        "others": list(again.others),
    }
    notes = {
        "missing": (f"{again.file} is missing: the new stimulus is compared with the sidecar alone",),
        "changed": (
            f"{again.file} is not the file that its sidecar describes: it was changed after it was written",
        ),
    }
    written = () if request.output is None else (request.output,)
    return Outcome(lines, document, notes.get(again.found, ()), written, 0 if again.same else DIFFERS)
