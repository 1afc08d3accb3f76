"""grid: faces over two components, crossed: what they do together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.errors import BadInput
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome
from morphspace.sets.planned import PlannedSet, plan_of, write_set
from morphspace.steps import Steps
from morphspace.stimuli.drawing import Drawing
from morphspace.verbs.sweep import amount_words, check_amount


@dataclass(frozen=True)
class GridRequest:
    """Cross two `components` (from 1) of `model`, each from -`amount_sd` to +`amount_sd` in `steps`, into `output`."""

    model: Path
    output: Path
    components: tuple[int, int] = (1, 2)
    amount_sd: tuple[float, float] = (3.0, 3.0)
    steps: tuple[int, int] = (5, 5)


def run(request: GridRequest) -> Steps[Outcome]:
    """Write the set of stimuli. Returns an `Outcome`."""
    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def asked(request: GridRequest) -> int:
    """Give how many stimuli are asked for outright."""
    return math.prod(request.steps)


def plan(request: GridRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Check everything, draw nothing; `model` where it is open already. Returns a `PlannedSet`."""
    yield from ()
    model = model or load_model(request.model)
    first, second = request.components
    if first == second or not all(1 <= component <= model.rank for component in request.components):
        raise BadInput(
            f"a grid over components {first} and {second} cannot be drawn: give two different ones of 1 to {model.rank}"
        )
    for amount in request.amount_sd:
        check_amount(amount)
    if min(request.steps) < 2:
        raise BadInput(
            f"a grid of {request.steps[0]} by {request.steps[1]} steps: ask for at least 2 along each"
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
            drawings.append(Drawing(name, loadings, told={"first_sd": one, "second_sd": other}))
    return plan_of(request, "grid", model, drawings)
