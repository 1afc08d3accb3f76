"""sweep: show the effect of each component from minus to plus n SD, as pictures and as a looping video."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import Ge, Gt, Le

from morphspace.errors import BadInput
from morphspace.requests import Folder, Model, declared
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.arrays import AnyArray
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps
    from morphspace.stimuli.drawing import Drawing

VIDEO_FRAMES = 50  # frames forth and back, so that the video loops
FRAME_RATE_HZ = 25.0  # Hz; a sweep takes two seconds


@declared
class SweepRequest:
    """Show the effect of each component of MODEL as pictures and videos."""

    model: Model
    output: Folder
    components: Annotated[
        int, Ge(1), Le(10_000), Option("-k", "--components"), Help("Number of components, from the first.")
    ] = 10
    amount_sd: Annotated[
        float,
        Gt(0),
        Le(100),
        Option("-n", "--amount-sd"),
        Help("Largest amount, SD; the sweep goes from minus to plus it."),
    ] = 3.0
    steps: Annotated[int, Ge(2), Le(1000), Help("Number of pictures per component.")] = 7
    warp_only: Annotated[
        bool,
        Help(
            "Move the warp alone, with the colours of the mean face, as `caricature --texture-gain 0` does."
        ),
    ] = False


def run(request: SweepRequest) -> Steps[Outcome]:
    """Write the set of stimuli: for each component, pictures pcNNN_AMOUNTsd and a video pcNNN."""
    from morphspace.sets.stimulus_set import write_set

    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: SweepRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Check all settings without drawing, or raise `BadInput`; `model` is the open model, or None."""
    import numpy as np

    from morphspace.model.model import load_model
    from morphspace.sets.plan import plan_of

    yield from ()
    model = model or load_model(request.model)
    if model.rank == 0:
        raise BadInput(f"{model.identity} has rank 0; expected at least 1. Build it from frames that differ")
    amounts_sd = np.linspace(-request.amount_sd, request.amount_sd, request.steps)
    count = min(request.components, model.rank)
    drawings = [
        drawing
        for component in range(count)
        for drawing in _of_component(model, component, amounts_sd, request)
    ]
    notes = (
        ()
        if count == request.components
        else (f"{request.components} components were requested, {model.identity} has {count}: all are swept",)
    )
    return plan_of(request, "sweep", model, drawings, notes=notes)


def _of_component(
    model: MorphModel, component: int, amounts_sd: AnyArray, request: SweepRequest
) -> Iterator[Drawing]:
    import numpy as np

    from morphspace.stimuli.drawing import Drawing
    from morphspace.stimuli.sampling import along

    def drawing(name: str, moved_sd: AnyArray, variables: dict[str, float], **kinds: Any) -> Drawing:
        if request.warp_only:
            variables, kinds = (
                {**variables, "texture_gain": 0.0},
                {**kinds, "colour_sd": np.zeros_like(moved_sd)},
            )
        return Drawing(name, moved_sd, variables=variables, **kinds)

    name = f"pc{component + 1:03d}{'_warp' if request.warp_only else ''}"
    for amount in amounts_sd.tolist():
        entries = {"component": component + 1, "amount_sd": amount}
        yield drawing(
            f"{name}_{amount_words(amount)}sd", along(model, component, np.array([amount])), entries
        )
    phase = np.sin(2 * np.pi * np.arange(VIDEO_FRAMES) / VIDEO_FRAMES)
    there_and_back = along(model, component, request.amount_sd * phase)
    entries = {"component": component + 1}
    yield drawing(name, there_and_back, entries, frame_rate_hz=FRAME_RATE_HZ, suffix=".mp4")


def amount_words(amount_sd: float) -> str:
    """Format an amount, SD, with its sign as a part of a name; 0 has none."""
    return "0" if abs(amount_sd) < 1e-9 else f"{amount_sd:+g}"
