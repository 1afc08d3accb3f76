"""batch: draw the stimulus set of a recipe; plan it whole, draw it in parallel, and resume after an interruption."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import Folder, Workers, declared
from morphspace.settings import Argument, Help, NotAnOption, Option

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared
class BatchRequest:
    """Make the stimulus set of RECIPE: a .yaml that crosses factors, or a .csv with one stimulus per row.

    Everything is checked before anything is drawn. The same command resumes a stopped batch.
    """

    recipe: Annotated[Path, Argument("RECIPE"), Help("The recipe (.yaml, .csv).")]
    output: Folder
    workers: Annotated[
        Workers, NotAnOption(), Help("Number of processes that draw [default: as the verbs' --workers].")
    ] = None
    is_plan: Annotated[
        bool, Option("--plan"), Help("Show number, duration and size of the stimuli; draw nothing.")
    ] = False
    is_meant: Annotated[bool, Option("--yes"), Help("Make more than 100,000 stimuli without asking.")] = False


def run(request: BatchRequest) -> Steps[Outcome]:
    """Plan the recipe and draw all of it, or show the plan alone."""
    from morphspace.outcome import Outcome
    from morphspace.sets import batch
    from morphspace.steps import Step

    unasked = batch.MOST_PLANNED if request.is_plan else batch.MOST_UNASKED
    most = None if request.is_meant else unasked
    planned = yield from batch.planned_batch(request.recipe, request.output, request.workers, most)
    estimate = batch.estimated(planned)
    lines = planned.lines(estimate)
    if request.is_plan:
        return Outcome(lines, {"output": str(request.output), **planned.document(estimate)})
    yield Step("plan", 1, 1, lines)
    return (yield from batch.write_batch(planned))
