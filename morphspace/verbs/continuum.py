"""continuum: the faces between two, in steps of equal size, with the linear morph as a control.

The two are rows of tables or pictures, shown with one model; or the mean faces of two models, for which a model of the
pair is built and kept beside the stimuli.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.errors import BadInput
from morphspace.model.model import MorphModel
from morphspace.outcome import Outcome
from morphspace.requests import ClipText, request_document
from morphspace.sets.complete import write_set
from morphspace.sets.continuum import (
    COLUMNS,
    LINEAR,
    STEPS_NAME,
    column_of,
    continuum_drawings,
    continuum_ends,
    measured_steps,
    spaced_series,
    unevenness_of,
)
from morphspace.sets.planned import PlannedSet
from morphspace.sets.protect import files_named
from morphspace.steps import Steps
from morphspace.stimuli.continuum import (
    POWERS,
    SPACINGS,
    Spacing,
    even_positions,
    given_positions,
)
from morphspace.stimuli.stepping import unevenness

EQUAL = 0.03  # of their mean: steps that differ by more are not called equal


@dataclass(frozen=True)
class ContinuumRequest:
    """Draw the faces from `first` to `last` in so many `steps`, one face more than steps, into the folder `output`.

    The ends are two models with keypoints, whose mean faces they are; or with `model` each a picture or a row of a
    table, `TABLE.csv:FRAME`. `spacing` says in what the steps are equal (`stimuli.continuum.Spacing`); `positions` are
    taken instead of it where given, 0 the first end and 1 the last. `control` linear adds the linear morph in as many
    steps. `crop` px is cut out of pictures first.
    """

    first: ClipText
    last: ClipText
    output: Path
    model: Path | None = None
    steps: int = 10
    spacing: Spacing = "ciede2000"
    positions: tuple[float, ...] | None = None
    control: Literal["linear", "none"] = "linear"
    crop: tuple[int, int, int, int] | None = None


def run(request: ContinuumRequest) -> Steps[Outcome]:
    """Write the set of stimuli. Returns an `Outcome`."""
    planned = yield from plan(request)
    outcome = yield from write_set(planned, request.output)
    kept = () if request.model is not None else (planned.model_path,)
    return replace(
        outcome,
        lines=(*outcome.lines, *_said(request, planned)),
        document={**outcome.document, "unevenness": unevenness_of(planned.tables[STEPS_NAME])},
        written=(*outcome.written, *kept),
    )


def plan(request: ContinuumRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check everything, space the steps and measure them; `model` where it is open already.

    The model of a pair is to lie in the output folder: `keep_model` puts it there, unless another is in the way; a
    batch may name it otherwise. Returns a `PlannedSet`.
    """
    if request.spacing not in SPACINGS:
        raise BadInput(f"steps cannot be equal in {request.spacing!r}: choose from {', '.join(SPACINGS)}")
    positions = None if request.positions is None else given_positions(request.positions)
    steps = even_positions(request.steps) if positions is None else positions
    ends = yield from continuum_ends(
        request.first, request.last, request.output, request.model, request.crop, model
    )
    line = ends.line
    series = yield from spaced_series(
        line, steps, None if positions is not None else request.spacing, linear=request.control == LINEAR
    )
    spacing = request.spacing if request.positions is None else "given"
    drawings = [
        drawing
        for name, places in series.items()
        for drawing in continuum_drawings(line, name, places, spacing)
    ]
    table = yield from measured_steps(line, series, drawings, spacing)
    return PlannedSet(
        verb="continuum",
        request=request_document(request),
        model_path=ends.model_path,
        model=line.model,
        model_sha256=ends.model_sha256,
        inputs={"model": ends.model_sha256, **ends.inputs},
        drawings=tuple(drawings),
        notes=(*ends.notes, *_notes(request, table)),
        tables={STEPS_NAME: table},
        columns=COLUMNS,
        new_model=request.model is None,
        files=files_named(request),
    )


def _notes(request: ContinuumRequest, table: Mapping[str, Sequence[Any]]) -> tuple[str, ...]:
    if request.positions is not None or request.spacing not in POWERS:
        return ()
    off = unevenness(np.array(column_of(table, "continuum", "size_of_mean")))
    if off <= EQUAL:
        return ()
    return (
        f"the steps differ by up to {off:.1%} from their mean in {request.spacing}, which 8-bit colours may not let be "
        "finer: take fewer steps, or ends that differ more",
    )


def _said(request: ContinuumRequest, planned: PlannedSet) -> tuple[str, ...]:
    table = planned.tables[STEPS_NAME]
    off = unevenness_of(table)
    steps, moved = column_of(table, "continuum", "ciede2000"), column_of(table, "continuum", "warp_rms_px")
    faded = column_of(table, "continuum", "crossfade_ciede2000")
    how = (
        "as they were given"
        if request.positions is not None
        else f"equal in {request.spacing} to {off['continuum']:.1%}"
    )
    linear = f"; of the linear morph, to {off[LINEAR]:.1%}" if LINEAR in off else ""
    return (
        f"{len(steps)} steps, {how}{linear}",
        f"a step changes CIEDE2000 {np.mean(steps):.3g} and the warp {np.mean(moved):.3g} px on average, a plain "
        f"cross-fade CIEDE2000 {np.mean(faded):.3g}; {STEPS_NAME} has each",
    )
