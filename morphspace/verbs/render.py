"""render: draw the faces of a table of loadings as images or a video; edited loadings give new faces."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.errors import BadInput
from morphspace.requests import VIDEO_SUFFIXES, FrameRate, Model, VideoSuffix, clip_options, declared
from morphspace.settings import Argument, Help, NotAnOption, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps

ANIMATION_SUFFIXES = (".gif", ".webp")  # `io/animation.py`, which loads libav


@declared
class RenderRequest:
    """Draw the faces of a TABLE of loadings with MODEL."""

    model: Model
    table: Annotated[Path, Argument("TABLE"), Help("The loadings (.csv).")]
    output: Annotated[
        Path,
        Option("-o", "--output"),
        Help(
            "A folder for images, a video (.mkv is lossless, .mp4 plays everywhere), or an animation for slides "
            "(.gif, .webp)."
        ),
    ]
    gain: Annotated[float, Help("Factor on all loadings; above 1 caricatures.")] = 1.0
    frame_rate_hz: FrameRate = None
    video: Annotated[
        VideoSuffix | None, NotAnOption(), Help("Draw one video, not images, as a stimulus of a set.")
    ] = None


def run(request: RenderRequest) -> Steps[Outcome]:
    """Draw the faces and write them. Raises `BadInput` if the output's name does not fit the format."""
    from morphspace.sets.stimulus_set import write_animated, write_lone_video, write_set

    suffix = request.output.suffix.lower()
    video = next((one for one in VIDEO_SUFFIXES if one == suffix), None)
    if suffix in ANIMATION_SUFFIXES and not request.output.is_dir():
        planned = yield from plan(dataclasses.replace(request, video=".mkv"))
        return (yield from write_animated(planned, request.output))
    if request.output.suffix and video is None and not request.output.is_dir():
        raise BadInput(
            f"{request.output} ends in {request.output.suffix}. Give a folder for images, or a name in "
            f"{', '.join((*VIDEO_SUFFIXES, *ANIMATION_SUFFIXES))}"
        )
    if video is None:
        planned = yield from plan(request)
        return (yield from write_set(planned, request.output))
    if request.output.is_dir():
        raise BadInput(f"{request.output} is a folder. Give the name of a video, or a folder without suffix")
    planned = yield from plan(dataclasses.replace(request, video=video))
    return (yield from write_lone_video(planned, request.output))


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
    faces = yield from faces_of(model, request.table, options=clip_options(request))
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
