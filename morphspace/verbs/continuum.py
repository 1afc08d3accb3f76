"""continuum: draw the faces between two, in steps of equal size, with the linear morph as a control.

The two faces are rows of tables or pictures, shown with one model; or the mean faces of two models. For two models, a
model of the pair is built and stored beside the stimuli.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from annotated_types import Ge, Le

from morphspace.requests import (
    ClipOptions,
    ClipText,
    Crop,
    Folder,
    clip_options,
    declared_with,
    request_document,
)
from morphspace.settings import Argument, Help, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps


@declared_with(ClipOptions)
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
    from morphspace.sets.continuum import STEPS_NAME, step_lines, unevenness_of
    from morphspace.sets.stimulus_set import write_set

    planned = yield from plan(request)
    outcome = yield from write_set(planned, request.output)
    kept = () if request.model is not None else (planned.model_path,)
    table = planned.tables[STEPS_NAME]
    return replace(
        outcome,
        lines=(*outcome.lines, *step_lines(table, _spacing(request))),
        document={**outcome.document, "unevenness": unevenness_of(table)},
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
        evenness_notes,
        measured_steps,
        spaced_series,
    )
    from morphspace.sets.outputs import files_named
    from morphspace.sets.plan import PlannedSet
    from morphspace.stimuli.continuum import even_positions, given_positions

    positions = None if request.positions is None else given_positions(request.positions)
    steps = even_positions(request.steps) if positions is None else positions
    ends = yield from continuum_ends(
        request.first, request.last, request.output, request.model, request.crop, model, clip_options(request)
    )
    line = ends.line
    series = yield from spaced_series(
        line, steps, None if positions is not None else request.spacing, linear=request.control == LINEAR
    )
    spacing = _spacing(request)
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
        notes=(*ends.notes, *evenness_notes(table, spacing)),
        tables={STEPS_NAME: table},
        columns=COLUMNS,
        new_model=request.model is None,
        files=files_named(request),
    )


def _spacing(request: ContinuumRequest) -> str:
    from morphspace.sets.continuum import GIVEN

    return request.spacing if request.positions is None else GIVEN
