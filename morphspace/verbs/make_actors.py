"""make-actors: drawn people with exact truth, for tests, for teaching, and for pictures that may be shown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morphspace import synthetic
from morphspace.errors import BadInput
from morphspace.outcome import Outcome, write_record
from morphspace.steps import Step, Steps
from morphspace.storage import make_folder

LEAST_SIDE_PX, MOST_SIDE_PX = 48, 1024  # larger ones take minutes to paint


@dataclass(frozen=True)
class MakeActorsRequest:
    """Draw `identities` actors and `portraits` animated photographs of `frames` frames each into `output`.

    `size` (w, h) px; `head_motion_px`, `light_change`, `noise_sd` as in `synthetic.capture_sequence`.
    """

    output: Path
    identities: int = 4
    portraits: int = 0
    frames: int = 60
    seed: int = 1
    size: tuple[int, int] = (200, 240)
    head_motion_px: float = 0.0
    light_change: float = 0.0
    noise_sd: float = 0.0


def run(request: MakeActorsRequest) -> Steps[Outcome]:
    """Write the clip folders and truth/. Returns an `Outcome`."""
    width, height = request.size
    if not (min(width, height) >= LEAST_SIDE_PX and max(width, height) <= MOST_SIDE_PX):
        raise BadInput(
            f"actors of {width}x{height} cannot be drawn: give {LEAST_SIDE_PX} to {MOST_SIDE_PX} px a side"
        )
    make_folder(request.output)
    total = (request.identities + request.portraits) * request.frames
    written: list[Path] = []
    names: dict[str, None] = {}
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
    for count, piece in enumerate(pieces, 1):
        written.append(piece.path)
        names[piece.actor] = None
        if piece.truth is not None:
            written += [piece.truth, piece.path.with_name("clip.json")]
        yield Step("draw", count, total)
    settings = {name: value for name, value in vars(request).items() if name != "output"}
    record = write_record(request.output, "make-actors", settings, {}, written)
    lines = (
        f"{request.output}: {len(names)} actors of {request.frames} frames ({', '.join(names)}), truth in truth/",
    )
    return Outcome(lines, {"output": str(request.output), "actors": list(names)}, (), (*written, record))
