"""replay: draw a stimulus again from its sidecar and compare the bytes, or say what differs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import ClipText, declared
from morphspace.settings import Argument, Help, Option

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

DIFFERS = 3  # exit code: it was drawn again, and is not the same


@declared
class ReplayRequest:
    """Draw the stimulus of SIDECAR again and compare the bytes.

    Exits 0 where they are the same, 3 where they differ; then it says what differs.
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
        Help("The clip whose frames faces were put back into, if it moved."),
    ] = ()
    output: Annotated[
        Path | None,
        Option("-o", "--output"),
        Help("Keep the new stimulus here [default: compare and drop it]."),
    ] = None


def run(request: ReplayRequest) -> Steps[Outcome]:
    """Draw, compare, say. `document["same"]` tells whether the bytes and all entries are those of the sidecar.

    Returns an `Outcome`.
    """
    from morphspace.outcome import Outcome
    from morphspace.sets.replay import replayed

    again = yield from replayed(request.sidecar, request.model, request.clip, request.output)
    if again.same:
        first = "the same, byte for byte"
    elif again.same_bytes:
        first = "the same, byte for byte, but its sidecar says something else"
    else:
        first = "not the same"
    lines = (f"{again.name}: {first}", *(f"  {words}" for words in (*again.differences, *again.others)))
    told = {
        "same": again.same,
        "file": again.found,
        "sha256": again.sha256,
        "recorded_sha256": again.recorded_sha256,
        "differences": list(again.differences),
        "others": list(again.others),
    }
    notes = {
        "missing": (f"{again.file} is not there: what was drawn is compared with its sidecar alone",),
        "changed": (
            f"{again.file} is not the file its sidecar describes: it was changed after it was written",
        ),
    }
    written = () if request.output is None else (request.output,)
    return Outcome(lines, told, notes.get(again.found, ()), written, 0 if again.same else DIFFERS)
