"""trajectory: smooth, retime, join, loop, average, caricature or scramble recorded motion, and draw it."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from annotated_types import Ge

from morphspace.errors import BadInput
from morphspace.requests import FrameRate, Model, VideoSuffix, declared
from morphspace.settings import Argument, Help, Option
from morphspace.stimuli.motion_words import operations_help

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.motions import MadeMotions
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps


@declared
class TrajectoryRequest:
    """Change the motion of each TABLE of loadings on MODEL, and draw it.

    Operations are applied in the given order:
    """

    model: Model
    tables: Annotated[tuple[Path, ...], Argument("TABLE..."), Help("Tables of loadings on MODEL (.csv).")]
    output: Annotated[
        Path,
        Option("-o", "--output", metavar="DIR|NEW.csv"),
        Help("A folder for the videos, or a new table of loadings (.csv)."),
    ]
    operations: Annotated[
        tuple[str | Mapping[str, Any], ...],
        Option("--op", metavar="WORD[=NUMBER]"),
        Help("An operation, see above; may be repeated."),
    ] = ()
    guide: Annotated[
        Path | None,
        Option(metavar="TABLE"),
        Help(
            "A table of loadings on MODEL: provides the timing for `timing`, or the mean trajectory for `caricature` "
            "of one table."
        ),
    ] = None
    frame_rate_hz: Annotated[
        FrameRate, Help("Frame rate of the tables, Hz [default: from their sidecars, else 25].")
    ] = None
    seed: Annotated[int, Ge(0), Help("Seed of the random order; the same seed gives the same result.")] = 0
    video: Annotated[
        VideoSuffix, Help("Type of video: .mkv is lossless, .mp4 plays everywhere; the point is optional.")
    ] = ".mp4"


TrajectoryRequest.__doc__ = f"{inspect.cleandoc(TrajectoryRequest.__doc__ or '')}\n\n\b\n{operations_help()}"


def run(request: TrajectoryRequest) -> Steps[Outcome]:
    """Write the set of stimuli, or the table. Raises `BadInput` if the output is another file."""
    from morphspace.sets.stimulus_set import write_set

    if request.output.suffix.lower() == ".csv":
        return (yield from _write_table(request))
    if request.output.suffix and not request.output.is_dir():
        raise BadInput(
            f"{request.output} ends in {request.output.suffix}. Give a folder for videos, or a table (.csv)"
        )
    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: TrajectoryRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check all inputs without drawing; `model` is the open model, or None."""
    from morphspace.sets.motions import COLUMNS, variables_of
    from morphspace.sets.plan import plan_of
    from morphspace.sets.sources import motion_name
    from morphspace.stimuli.drawing import Drawing

    model = model or _opened(request)
    made = yield from _made(request, model)
    drawings = [
        Drawing(
            name=motion_name(motion.name),
            loadings_sd=motion.loadings_sd,
            frame_rate_hz=motion.rate_hz,
            suffix=request.video,
            variables=variables_of(made, motion, model.sd, request.seed),
        )
        for motion in made.motions
    ]
    return plan_of(
        request, "trajectory", model, drawings, inputs=made.inputs, notes=made.notes, columns=COLUMNS
    )


def _opened(request: TrajectoryRequest) -> MorphModel:
    from morphspace.model.model import load_model

    if request.model.suffix.lower() == ".csv":
        raise BadInput(f"{request.model} is a table. Name the model first, then its tables")
    return load_model(request.model)


def _made(request: TrajectoryRequest, model: MorphModel) -> Steps[MadeMotions]:
    from morphspace.sets.motions import made_motions

    return made_motions(
        model, request.tables, request.operations, request.guide, request.frame_rate_hz, request.seed
    )


def _write_table(request: TrajectoryRequest) -> Steps[Outcome]:
    """Write the new motion as a table of loadings, for any verb that reads one."""
    from morphspace.outcome import Outcome
    from morphspace.sets.motions import variables_of, write_motion
    from morphspace.sets.outputs import Output, check_file
    from morphspace.sets.protect import check_origins, writing

    model = _opened(request)
    paths = [*request.tables, *([] if request.guide is None else [request.guide])]
    check_file(request.output, ".csv")
    sidecar = request.output.with_suffix(".json")
    guarded = Output(
        "trajectory", request.output, (request.output, sidecar), inputs=paths, identity=model.identity
    )
    check_origins(guarded)
    made = yield from _made(request, model)
    if len(made.motions) > 1:
        raise BadInput(
            f"{len(made.motions)} motions do not fit one table {request.output}. Join them with splice or "
            "average, or give one table"
        )
    (motion,) = made.motions
    with writing(guarded):
        write_motion(request.output, made, model, request)
    lines = (
        f"{request.output}: {len(motion.loadings_sd)} frames at {motion.rate_hz:g} Hz, {motion.duration_s:.2f} s"
        + (", a loop" if motion.ends == "closed" else ""),
    )
    entries = variables_of(made, motion, model.sd, request.seed)
    outcome = {"table": str(request.output), "frames": len(motion.loadings_sd), **entries}
    return Outcome(lines, outcome, made.notes, (request.output, sidecar))
