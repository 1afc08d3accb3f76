"""render: draw the faces of a table of loadings as images or a video; edited loadings give new faces."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.errors import BadInput
from morphspace.requests import VIDEO_SUFFIXES, FrameRate, Model, VideoSuffix, declared
from morphspace.settings import Argument, Help, NotAnOption, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps


@declared
class RenderRequest:
    """Draw the faces of a TABLE of loadings with MODEL."""

    model: Model
    table: Annotated[Path, Argument("TABLE"), Help("The loadings (.csv).")]
    output: Annotated[
        Path,
        Option("-o", "--output"),
        Help("A folder for images, or a video: .mkv is lossless, .mp4 plays everywhere."),
    ]
    gain: Annotated[float, Help("Factor on all loadings; above 1 caricatures.")] = 1.0
    frame_rate_hz: FrameRate = None
    video: Annotated[
        VideoSuffix | None, NotAnOption(), Help("Draw one video, not images, as a stimulus of a set.")
    ] = None


def run(request: RenderRequest) -> Steps[Outcome]:
    """Draw the faces and write them."""
    from morphspace.sets.stimulus_set import write_set

    video = next((one for one in VIDEO_SUFFIXES if one == request.output.suffix.lower()), None)
    if request.output.suffix and video is None and not request.output.is_dir():
        raise BadInput(
            f"{request.output} ends in {request.output.suffix}. Give a folder for images, or a video in "
            f"{' or '.join(VIDEO_SUFFIXES)}"
        )
    if video is None:
        planned = yield from plan(request)
        return (yield from write_set(planned, request.output))
    if request.output.is_dir():
        raise BadInput(f"{request.output} is a folder. Give the name of a video, or a folder without suffix")
    planned = yield from plan(dataclasses.replace(request, video=video))
    return (yield from _lone_video(planned, request.output))


def plan(request: RenderRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check all inputs without drawing; `model` is the open model, or None."""
    from morphspace.io.images import picture_names
    from morphspace.model.model import load_model
    from morphspace.sets.plan import plan_of
    from morphspace.sets.sources import faces_of
    from morphspace.stimuli.caricature import caricatured
    from morphspace.stimuli.drawing import Drawing
    from morphspace.stimuli.table_checks import check_reach

    model = model or load_model(request.model)
    faces = yield from faces_of(model, request.table, frame_rate_hz=request.frame_rate_hz)
    faces = faces.for_video(request.video)
    loadings_sd = caricatured(faces.loadings_sd, request.gain)
    check_reach(loadings_sd, faces.names, request.table)
    gains = {"gain": float(request.gain)}
    if request.video is None:
        files = picture_names(faces.names)
        drawings = [
            Drawing(
                file.removesuffix(".png"),
                loadings_sd[row : row + 1],
                variables={"frame": faces.names[row], **gains},
            )
            for row, file in enumerate(files)
        ]
    else:
        ((name, rows),) = faces.stimuli(request.video)
        drawings = [
            Drawing(
                name,
                loadings_sd[rows],
                frame_rate_hz=faces.frame_rate_hz,
                suffix=request.video,
                variables={**gains},
            )
        ]
    return plan_of(request, "render", model, drawings, inputs=faces.inputs, notes=faces.notes)


def _lone_video(planned: PlannedSet, output: Path) -> Steps[Outcome]:
    """Write the only video of a set under its own name, with its sidecar and record beside it."""
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.report.set_page import CLIPPED_PERCENT
    from morphspace.sets.protect import Output, writing
    from morphspace.sets.stimulus import make_stimulus
    from morphspace.steps import Step, worker_count

    (drawing,) = planned.drawings
    sidecar = output.with_name(f"{output.name}.json")
    record = output.with_name(f"{output.name}.{RECORD_NAME}")
    with writing(Output("render", output, (record,), [(output, sidecar)], planned.files)):
        yield Step("render", 0, 1)
        row = make_stimulus(
            planned.model, drawing, planned.sidecar_head(), output.parent, worker_count(), (output, sidecar)
        )
        yield Step("render", 1, 1)
        settings = {**planned.request, "frame_rate_hz": drawing.frame_rate_hz}
        written = (output, sidecar)
        write_record(output.parent, "render", settings, dict(planned.inputs), written, record.name)
    notes = planned.notes
    if row["clipped_percent"] > CLIPPED_PERCENT:
        notes = (*notes, f"{row['clipped_percent']:.2g} % of the colour values were clipped: lower the gain")
    lines = (f"{output}: {row['frames']} frames at {drawing.frame_rate_hz:g} Hz",)
    document = {"output": str(output), "frames": row["frames"], "clipped_percent": row["clipped_percent"]}
    return Outcome(lines, document, notes, (*written, record))
