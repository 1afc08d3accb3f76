"""continuum: draw the faces between two, in steps of equal size, with the linear morph as a control.

The two faces are rows of tables or pictures, shown with one model; or the mean faces of two models. For two models, a
model of the pair is built and stored beside the stimuli.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Ge, Le

from morphspace.requests import ClipText, Crop, Folder, declared, request_document
from morphspace.settings import Argument, Help, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps

EQUAL = 0.03  # share of the mean step; steps that deviate more are not reported as equal


@declared
class ContinuumRequest:
    """Draw the faces between A and B, in steps of equal size.

    A and B are two models (.morph, with keypoints: their mean faces), or with --model two pictures or two rows of
    tables (TABLE.csv:FRAME). steps.csv gives the change of each step, shape and colour apart, and that of a plain
    cross-fade of the two ends.
    """

    first: Annotated[
        ClipText, Argument("A"), Help("The face at 0 %: a model, a picture or a row of a table.")
    ]
    last: Annotated[ClipText, Argument("B"), Help("The face at 100 %, likewise.")]
    output: Folder
    model: Annotated[
        Path | None,
        Help("The model that draws A and B if they are pictures or rows TABLE.csv:FRAME."),
    ] = None
    steps: Annotated[
        int,
        Ge(1),
        Le(10_000),
        Help("Number of steps; 10 steps give the 11 faces 0 %, 10 %, ... 100 %."),
    ] = 10
    spacing: Annotated[
        Literal["loadings", "warp", "ciede2000", "ssim"],
        Help(
            "The measure in which steps are equal: loadings (the linear morph), warp (rms px), or in the files, mean "
            "CIEDE2000 or 1 - SSIM inside the mask."
        ),
    ] = "ciede2000"
    positions: Annotated[
        tuple[float, ...] | None,
        Option("--at", metavar="P,P,..."),
        Help(
            "Positions instead of equal steps, such as 0,0.25,0.5,1: 0 is A, 1 is B, other values extrapolate."
        ),
    ] = None
    control: Annotated[
        Literal["linear", "none"], Help("Whether to add the linear morph in as many steps, as linear_*.")
    ] = "linear"
    crop: Annotated[Crop | None, Help("Cut this box out of the pictures first, px.")] = None


def run(request: ContinuumRequest) -> Steps[Outcome]:
    """Write the set of stimuli."""
    from morphspace.sets.continuum import STEPS_NAME, unevenness_of
    from morphspace.sets.stimulus_set import write_set

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
    """Read and check all inputs, space the steps and measure them; `model` is the open model, or None.

    The path of a pair's model is in the output folder; `keep_model` writes it unless another model is there. A batch
    may rename it.
    """
    from morphspace.sets.continuum import (
        COLUMNS,
        LINEAR,
        STEPS_NAME,
        continuum_drawings,
        continuum_ends,
        measured_steps,
        spaced_series,
    )
    from morphspace.sets.plan import PlannedSet
    from morphspace.sets.protect import files_named
    from morphspace.stimuli.continuum import even_positions, given_positions

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
    import numpy as np

    from morphspace.sets.continuum import column_of
    from morphspace.stimuli.continuum import POWERS
    from morphspace.stimuli.stepping import unevenness

    if request.positions is not None or request.spacing not in POWERS:
        return ()
    off = unevenness(np.array(column_of(table, "continuum", "size_of_mean")))
    if off <= EQUAL:
        return ()
    return (
        f"the steps differ by up to {off:.1%} from their mean in {request.spacing}, which 8-bit colours may "
        "cause: use fewer steps, or ends that differ more",
    )


def _said(request: ContinuumRequest, planned: PlannedSet) -> tuple[str, ...]:
    import numpy as np

    from morphspace.sets.continuum import LINEAR, STEPS_NAME, column_of, unevenness_of

    table = planned.tables[STEPS_NAME]
    off = unevenness_of(table)
    steps, moved = column_of(table, "continuum", "ciede2000"), column_of(table, "continuum", "warp_rms_px")
    faded = column_of(table, "continuum", "crossfade_ciede2000")
    how = (
        "as given"
        if request.positions is not None
        else f"equal in {request.spacing} to {off['continuum']:.1%}"
    )
    linear = f"; of the linear morph, to {off[LINEAR]:.1%}" if LINEAR in off else ""
    return (
        f"{len(steps)} steps, {how}{linear}",
        f"a step changes CIEDE2000 {np.mean(steps):.3g} and the warp {np.mean(moved):.3g} px on average, a plain "
        f"cross-fade CIEDE2000 {np.mean(faded):.3g}; {STEPS_NAME} has each",
    )
