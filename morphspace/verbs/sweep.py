"""sweep: what each component does, from minus to plus n SD, as pictures and as a video that goes there and back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image, LoadingTable
from morphspace.errors import BadInput
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome
from morphspace.sets.planned import PlannedSet, plan_of, write_set
from morphspace.steps import Steps
from morphspace.stimuli.drawing import Drawing

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
    """Write the set of stimuli: pictures pcNNN_AMOUNTsd and a video pcNNN a component. Returns an `Outcome`."""
    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: SweepRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Check everything, draw nothing; `model` where it is open already. Returns a `PlannedSet`."""
    yield from ()
    model = model or load_model(request.model)
    if request.components < 1 or request.steps < 2:
        raise BadInput(
            f"{request.components} components in {request.steps} steps: ask for at least 1 in 2 steps"
        )
    check_amount(request.amount_sd)
    if model.rank == 0:
        raise BadInput(f"{model.identity} has rank 0, nothing to sweep: build it from frames that differ")
    amounts_sd = np.linspace(-request.amount_sd, request.amount_sd, request.steps)
    count = min(request.components, model.rank)
    drawings = [
        drawing
        for component in range(count)
        for drawing in _of_component(model, component, amounts_sd, request.amount_sd)
    ]
    notes = (
        ()
        if count == request.components
        else (f"{request.components} components were asked for, {model.identity} has {count}: all are swept",)
    )
    return plan_of(request, "sweep", model, drawings, notes=notes)


def check_amount(amount_sd: float) -> None:
    """Raise `BadInput` for an amount that leads nowhere."""
    if not (np.isfinite(amount_sd) and amount_sd > 0):
        raise BadInput(f"an amount of {amount_sd} SD cannot be swept: give a number above 0")


def _of_component(
    model: MorphModel, component: int, amounts_sd: AnyArray, furthest_sd: float
) -> Iterator[Drawing]:
    name = f"pc{component + 1:03d}"
    for amount in amounts_sd.tolist():
        told = {"component": component + 1, "amount_sd": amount}
        yield Drawing(
            f"{name}_{amount_words(amount)}sd", along(model, component, np.array([amount])), told=told
        )
    phase = np.sin(2 * np.pi * np.arange(VIDEO_FRAMES) / VIDEO_FRAMES)
    there_and_back = along(model, component, furthest_sd * phase)
    told = {"component": component + 1}
    yield Drawing(name, there_and_back, frame_rate_hz=FRAME_RATE_HZ, suffix=".mp4", told=told)


def amount_words(amount_sd: float) -> str:
    """Give an amount as a part of a name, with its sign; 0 has none."""
    return "0" if abs(amount_sd) < 1e-9 else f"{amount_sd:+g}"


def along(model: MorphModel, component: int, amounts_sd: AnyArray) -> LoadingTable:
    """Give the loadings (n, k) SD at these amounts along one component, all others at 0."""
    table = np.zeros((len(amounts_sd), model.rank))
    table[:, component] = amounts_sd
    return table


def component_faces(model: MorphModel, component: int, amounts_sd: AnyArray) -> list[Image]:
    """Give the faces (h, w, 3) at these amounts (SD) along one component, all others at 0."""
    return [model.render(row * model.sd) for row in along(model, component, amounts_sd)]
