"""make-actors: draw people with exact ground truth, for tests, teaching and published figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Le

from morphspace.errors import BadInput
from morphspace.requests import Folder, Size, declared, request_document
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

LEAST_SIDE_PX, MOST_SIDE_PX = 48, 1024  # px; larger faces take minutes to draw


@declared
class MakeActorsRequest:
    """Draw actors as clip folders, with their exact ground truth beside them."""

    output: Folder
    identities: Annotated[int, Ge(0), Le(1000), Help("Number of drawn people.")] = 4
    portraits: Annotated[int, Ge(0), Le(1000), Help("Number of animated photographs in addition.")] = 0
    frames: Annotated[int, Ge(1), Le(100_000), Help("Number of frames of each clip.")] = 60
    seed: Annotated[int, Ge(0), Help("The same seed draws the same people.")] = 1
    size: Annotated[Size, Help("Size of the frames, px.")] = (200, 240)
    head_motion_px: Annotated[
        float, Ge(0), Le(100), Option("--head-motion"), Help("Amplitude of rigid head movement, px.")
    ] = 0.0
    light_change: Annotated[
        float, Ge(0), Le(1), Help("Change of light over the clip, share of its intensity.")
    ] = 0.0
    noise_sd: Annotated[
        float, Ge(0), Le(1), Option("--noise"), Help("Sensor noise, SD in colour units (0 to 1).")
    ] = 0.0


def run(request: MakeActorsRequest) -> Steps[Outcome]:
    """Write the clip folders and truth/. Raises `BadInput` if the size is too small or too large."""
    from morphspace import synthetic
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.sets.outputs import Output
    from morphspace.sets.protect import writing
    from morphspace.steps import Step

    width, height = request.size
    if not (min(width, height) >= LEAST_SIDE_PX and max(width, height) <= MOST_SIDE_PX):
        raise BadInput(
            f"the size is {width}x{height} px; expected sides from {LEAST_SIDE_PX} to {MOST_SIDE_PX} px. Choose another"
        )
    total = (request.identities + request.portraits) * request.frames
    written: list[Path] = []
    names = synthetic.actor_names(request.identities, request.portraits)
    own = [request.output / name for name in (*names, "truth", RECORD_NAME)]
    pieces = synthetic.make_actors(
        request.output,
        identities=request.identities,
        frames=request.frames,
        seed=request.seed,
        size=request.size,
        head_motion_px=request.head_motion_px,
        light_change=request.light_change,
        noise_sd=request.noise_sd,
        portrait=request.portraits,
    )
    with writing(Output("make-actors", request.output, own)):
        for count, piece in enumerate(pieces, 1):
            written.append(piece.path)
            if piece.truth is not None:
                written += [piece.truth, piece.path.with_name("clip.json")]
            yield Step("draw", count, total)
        settings = request_document(request)
        record = write_record(request.output, "make-actors", settings, {}, written)
    lines = (f"{request.output}: {', '.join(names)} (frames of each: {request.frames}), truth in truth/",)
    return Outcome(lines, {"output": str(request.output), "actors": list(names)}, (), (*written, record))
