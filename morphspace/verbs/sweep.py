"""sweep: what each component does, from minus to plus n SD, as a strip and as a video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput
from morphspace.files.images import write_image
from morphspace.files.video import write_video
from morphspace.model import MorphModel, load_model
from morphspace.progress import Step, Steps
from morphspace.storage import digest_of_file
from morphspace.verbs.outcome import Outcome, check_folder, write_record

VIDEO_FRAMES = 50  # there and back again, so that it loops
FRAME_RATE_HZ = 25.0


@dataclass(frozen=True)
class SweepRequest:
    """Sweep the first `components` of `model` from -`amount_sd` to +`amount_sd` in `steps`, into `output`."""

    model: Path
    output: Path
    components: int = 10
    amount_sd: float = 3.0
    steps: int = 7


def run(request: SweepRequest) -> Steps[Outcome]:
    """Write pcNNN.png (a strip) and pcNNN.mp4 for each component. Returns an `Outcome`."""
    model = load_model(request.model)
    if request.components < 1 or request.steps < 2:
        raise BadInput(
            f"{request.components} components in {request.steps} steps: ask for at least 1 in 2 steps"
        )
    if not (np.isfinite(request.amount_sd) and request.amount_sd > 0):
        raise BadInput(f"an amount of {request.amount_sd} SD cannot be swept: give a number above 0")
    if model.rank == 0:
        raise BadInput(f"{model.identity} has rank 0, nothing to sweep: build it from frames that differ")
    check_folder(request.output)
    count = min(request.components, model.rank)
    written: list[Path] = []
    clipped = 0
    amounts_sd = np.linspace(-request.amount_sd, request.amount_sd, request.steps)
    phase = np.sin(2 * np.pi * np.arange(VIDEO_FRAMES) / VIDEO_FRAMES)
    for component in range(count):
        strip = request.output / f"pc{component + 1:03d}.png"
        clipped += write_image(strip, np.concatenate(component_faces(model, component, amounts_sd), axis=1))
        video = request.output / f"pc{component + 1:03d}.mp4"
        write_video(
            video,
            component_faces(model, component, request.amount_sd * phase),
            frame_rate_hz=FRAME_RATE_HZ,
            encoding="people",
        )
        written += [strip, video]
        yield Step("sweep", component + 1, count)
    settings = {"components": count, "amount_sd": request.amount_sd, "steps": request.steps}
    record = write_record(
        request.output, "sweep", settings, {"model": digest_of_file(request.model)}, written
    )
    lines = (
        f"{request.output}: {count} components of {model.identity}, "
        f"-{request.amount_sd:g} to +{request.amount_sd:g} SD",
    )
    notes = (f"{clipped} colour values were clipped: sweep fewer SD",) if clipped else ()
    document = {"output": str(request.output), "components": count, "amount_sd": request.amount_sd}
    return Outcome(lines, document, notes, (*written, record))


def component_faces(model: MorphModel, component: int, amounts_sd: AnyArray) -> list[Image]:
    """Give the faces (h, w, 3) at these amounts (SD) along one component, all others at 0."""
    faces = []
    for amount in amounts_sd:
        loadings = np.zeros(model.rank)
        loadings[component] = amount * model.sd[component]
        faces.append(model.render(loadings))
    return faces
