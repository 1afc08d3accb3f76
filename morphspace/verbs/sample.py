"""sample: faces drawn at random from the distribution of the training faces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.errors import BadInput
from morphspace.model import Loadings, load_model
from morphspace.progress import Steps
from morphspace.storage import digest_of_file
from morphspace.verbs.encode import write_loadings
from morphspace.verbs.outcome import Outcome, check_folder, write_record
from morphspace.verbs.render import write_frames


@dataclass(frozen=True)
class SampleRequest:
    """Draw `count` faces with `model` into the folder `output`; `seed` fixes them, `spread` scales the distribution."""

    model: Path
    output: Path
    count: int = 16
    seed: int = 0
    spread: float = 1.0


def run(request: SampleRequest) -> Steps[Outcome]:
    """Write the images and their loadings. Returns an `Outcome`."""
    model = load_model(request.model)
    if request.count < 1:
        raise BadInput(f"{request.count} faces were asked for: ask for at least 1")
    if not (np.isfinite(request.spread) and request.spread >= 0):
        raise BadInput(
            f"a spread of {request.spread} cannot be used: give a number of at least 0, 1 for the model's own"
        )
    if request.seed < 0:
        raise BadInput(f"a seed of {request.seed} cannot be used: give a whole number of at least 0")
    check_folder(request.output)
    drawn = model.sample(np.random.default_rng(request.seed), request.count)
    loadings = Loadings(drawn.values * request.spread, drawn.frame_names, drawn.model_id)
    clipped, images = yield from write_frames(model, loadings.values, loadings.frame_names, request.output)
    table = write_loadings(request.output / "loadings.csv", loadings, model, request.model, {})
    written = (*images, *table)
    settings = {"count": request.count, "seed": request.seed, "spread": request.spread}
    record = write_record(
        request.output, "sample", settings, {"model": digest_of_file(request.model)}, written
    )
    lines = (f"{request.output}: {request.count} faces of {model.identity}, seed {request.seed}",)
    notes = (f"{clipped} colour values were clipped: lower the spread",) if clipped else ()
    return Outcome(lines, {"output": str(request.output), "faces": request.count}, notes, (*written, record))
