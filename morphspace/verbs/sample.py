"""sample: draw random faces from the distribution of the training faces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Le

from morphspace.requests import Folder, MaxSd, Model, declared
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps


@declared
class SampleRequest:
    """Draw random faces of MODEL."""

    model: Model
    output: Folder
    count: Annotated[int, Ge(1), Le(100_000), Option("-n", "--count"), Help("Number of faces.")] = 16
    seed: Annotated[int, Ge(0), Help("Seed of the random faces.")] = 0
    spread: Annotated[
        float, Ge(0), Le(100), Help("Scale of the distribution, a factor; 1 is that of the training faces.")
    ] = 1.0
    max_sd: Annotated[
        MaxSd | None, Help("Largest loading, SD; larger ones are drawn again [default: no limit].")
    ] = None


def run(request: SampleRequest) -> Steps[Outcome]:
    """Write the set of stimuli."""
    from morphspace.sets.stimulus_set import write_set

    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def asked(request: SampleRequest) -> int:
    """Return the number of stimuli requested."""
    return request.count


def plan(request: SampleRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Draw the random loadings without pictures; `model` is the open model, or None."""
    import numpy as np

    from morphspace.model.model import load_model
    from morphspace.sets.plan import plan_of
    from morphspace.stimuli.drawing import Drawing
    from morphspace.stimuli.sampling import drawn_sd

    yield from ()
    model = model or load_model(request.model)
    rng = np.random.default_rng(request.seed)
    loadings_sd, again = drawn_sd(
        rng, request.count, model.rank, spread=request.spread, max_sd=request.max_sd
    )
    digits = max(4, len(str(request.count - 1)))
    drawings = [
        Drawing(
            f"sample_{row:0{digits}d}",
            loadings_sd[row : row + 1],
            variables={"draw": row, "seed": request.seed},
        )
        for row in range(request.count)
    ]
    notes: tuple[str, ...] = ()
    if again:
        share = again / loadings_sd.size
        notes = (f"{again} loadings ({share:.2g} a loading) beyond {request.max_sd:g} SD were drawn again",)
    return plan_of(request, "sample", model, drawings, notes=notes)
