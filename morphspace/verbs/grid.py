"""grid: draw faces over two crossed components to show their joint effect."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Gt, Le

from morphspace.errors import BadInput
from morphspace.requests import Folder, Model, declared
from morphspace.settings import Help, Option
from morphspace.verbs.sweep import amount_words

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps

Component = Annotated[int, Ge(1), Le(10_000)]
Amount = Annotated[float, Gt(0), Le(100)]
Count = Annotated[int, Ge(2), Le(1000)]


@declared
class GridRequest:
    """Draw faces of MODEL over two components, crossed."""

    model: Model
    output: Folder
    components: Annotated[tuple[Component, Component], Help("The two components, from 1.")] = (1, 2)
    amount_sd: Annotated[
        tuple[Amount, Amount],
        Option("-n", "--amount-sd"),
        Help("Largest distance from the mean along each component, SD."),
    ] = (3.0, 3.0)
    steps: Annotated[tuple[Count, Count], Help("Number of faces along each component.")] = (5, 5)


def run(request: GridRequest) -> Steps[Outcome]:
    """Write the set of stimuli."""
    from morphspace.sets.stimulus_set import write_set

    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def asked(request: GridRequest) -> int:
    """Return the number of stimuli requested."""
    return math.prod(request.steps)


def plan(request: GridRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Check all settings without drawing, or raise `BadInput`; `model` is the open model, or None."""
    import numpy as np

    from morphspace.model.model import load_model
    from morphspace.sets.plan import plan_of
    from morphspace.stimuli.drawing import Drawing

    yield from ()
    model = model or load_model(request.model)
    first, second = request.components
    if first == second or not all(1 <= component <= model.rank for component in request.components):
        raise BadInput(
            f"the components are {first} and {second}; expected two different ones from 1 to {model.rank}. "
            "Choose others"
        )
    rows, columns = (
        np.linspace(-amount, amount, steps).tolist()
        for amount, steps in zip(request.amount_sd, request.steps, strict=True)
    )
    drawings = []
    for one in rows:
        for other in columns:
            loadings = np.zeros((1, model.rank))
            loadings[0, first - 1], loadings[0, second - 1] = one, other
            name = f"pc{first:03d}_{amount_words(one)}sd_pc{second:03d}_{amount_words(other)}sd"
            drawings.append(Drawing(name, loadings, variables={"first_sd": one, "second_sd": other}))
    return plan_of(request, "grid", model, drawings)
