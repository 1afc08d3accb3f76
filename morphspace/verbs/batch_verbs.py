"""Which verbs a recipe may use, and what each needs: one request type serves the command line, Python and batches."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from morphspace.outcome import Outcome
from morphspace.sets.planned import PlannedSet
from morphspace.steps import Steps
from morphspace.verbs import caricature, continuum, grid, mimic, place, render, sample, sweep, trajectory
from morphspace.verbs.batch_settings import settings_of


@dataclass(frozen=True)
class DrawingVerb:
    """A verb that plans drawings: `plan(request, model)` gives a planned set, `model` None where it opens its own.

    `request` is its type; `files` names settings that are texts and paths at once, such as a clip; `asked(request)`
    tells how many stimuli are asked for outright, so that too many are refused before they are planned.
    """

    request: type
    plan: Callable[[Any, Any], Steps[PlannedSet]]
    files: tuple[str, ...] = ()
    asked: Callable[[Any], int] = lambda request: 1


@dataclass(frozen=True)
class FolderVerb:
    """A verb that fills a folder of its own: `check` raises what can be found out before, `run` does the work."""

    request: type
    check: Callable[[Any], None]
    run: Callable[[Any], Steps[Outcome]]
    files: tuple[str, ...] = ()


VERBS: Mapping[str, DrawingVerb | FolderVerb] = {
    "caricature": DrawingVerb(caricature.CaricatureRequest, caricature.plan, ("clip",)),
    "continuum": DrawingVerb(continuum.ContinuumRequest, continuum.plan, ("first", "last")),
    "grid": DrawingVerb(grid.GridRequest, grid.plan, asked=lambda request: math.prod(request.steps)),
    "mimic": FolderVerb(mimic.MimicRequest, mimic.check, mimic.run, ("source", "target", "frames")),
    "place": DrawingVerb(place.PlaceRequest, place.plan, ("clip",)),
    "render": DrawingVerb(render.RenderRequest, render.plan),
    "sample": DrawingVerb(sample.SampleRequest, sample.plan, asked=lambda request: int(request.count)),
    "sweep": DrawingVerb(sweep.SweepRequest, sweep.plan),
    "trajectory": DrawingVerb(trajectory.TrajectoryRequest, trajectory.plan),
}
SETTINGS = {name: settings_of(verb.request) for name, verb in VERBS.items()}
