"""batch: a recipe becomes a stimulus set, planned whole, drawn in parallel, and resumed after an interruption."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morphspace.outcome import Outcome
from morphspace.sets.batch import MOST_UNASKED, planned_batch, write_batch
from morphspace.steps import Steps


@dataclass(frozen=True)
class BatchRequest:
    """Make the stimuli of `recipe` in the folder `output`, in `workers` processes (None: one a core).

    `most` is how many stimuli are made without asking, None for any number.
    """

    recipe: Path
    output: Path
    workers: int | None = None
    most: int | None = MOST_UNASKED


def run(request: BatchRequest) -> Steps[Outcome]:
    """Plan the recipe and make all of it. Returns an `Outcome`."""
    batch = yield from planned_batch(request.recipe, request.output, request.workers, request.most)
    return (yield from write_batch(batch))
