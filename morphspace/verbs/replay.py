"""replay: draw a stimulus again from its sidecar and compare the bytes, or say what differs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morphspace.outcome import Outcome
from morphspace.sets.replay import replayed
from morphspace.steps import Steps


@dataclass(frozen=True)
class ReplayRequest:
    """Make the stimulus of `sidecar` again with `model`, found near it where None.

    `clip` opens the frames faces were put back into, where they moved; `output` keeps the new stimulus.
    """

    sidecar: Path
    model: Path | None = None
    clip: tuple[str, ...] = ()
    output: Path | None = None


def run(request: ReplayRequest) -> Steps[Outcome]:
    """Draw, compare, say. `document["same"]` tells whether the bytes and all entries are those of the sidecar.

    Returns an `Outcome`.
    """
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
    return Outcome(lines, told, notes.get(again.found, ()), written)
