"""sample: faces drawn at random from the distribution of the training faces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.errors import BadInput
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome
from morphspace.sets.planned import PlannedSet, plan_of, write_set
from morphspace.steps import Steps
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.sampling import drawn_sd


@dataclass(frozen=True)
class SampleRequest:
    """Draw `count` faces with `model` into the folder `output`; `seed` fixes them, `spread` scales the distribution.

    What lies further than `max_sd` along a component is drawn again, None keeps all.
    """

    model: Path
    output: Path
    count: int = 16
    seed: int = 0
    spread: float = 1.0
    max_sd: float | None = None


def run(request: SampleRequest) -> Steps[Outcome]:
    """Write the set of stimuli. Returns an `Outcome`."""
    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def asked(request: SampleRequest) -> int:
    """Give how many stimuli are asked for outright."""
    return request.count


def plan(request: SampleRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Draw the numbers, not the pictures; `model` where it is open already. Returns a `PlannedSet`."""
    yield from ()
    model = model or load_model(request.model)
    if request.count < 1:
        raise BadInput(f"{request.count} faces were asked for: ask for at least 1")
    if not (np.isfinite(request.spread) and request.spread >= 0):
        raise BadInput(
            f"a spread of {request.spread} cannot be used: give a number of at least 0, 1 for the model's own"
        )
    if request.seed < 0:
        raise BadInput(f"a seed of {request.seed} cannot be used: give a whole number of at least 0")
    if request.max_sd is not None and np.isnan(request.max_sd):
        raise BadInput("--max-sd nan is no number: give how many SD a loading may have, such as 3")
    rng = np.random.default_rng(request.seed)
    loadings_sd, again = drawn_sd(
        rng, request.count, model.rank, spread=request.spread, max_sd=request.max_sd
    )
    digits = max(4, len(str(request.count - 1)))
    drawings = [
        Drawing(
            f"sample_{row:0{digits}d}", loadings_sd[row : row + 1], told={"draw": row, "seed": request.seed}
        )
        for row in range(request.count)
    ]
    notes: tuple[str, ...] = ()
    if again:
        share = again / loadings_sd.size
        notes = (f"{again} loadings ({share:.2g} a loading) beyond {request.max_sd:g} SD were drawn again",)
    return plan_of(request, "sample", model, drawings, notes=notes)
