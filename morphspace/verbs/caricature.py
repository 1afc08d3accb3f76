"""caricature: move a person's faces away from or towards that person's mean face, or to its other side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import (
    ClipOptions,
    ClipText,
    Folder,
    FrameCrop,
    Frames,
    Model,
    VideoOrPictures,
    clip_options,
    declared_with,
)
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps


@declared_with(ClipOptions)
class CaricatureRequest:
    """Draw faces of MODEL's person further from the mean face, nearer to it, or on its other side.

    A gain of 1 is veridical, above 1 a caricature, between 0 and 1 an anti-caricature, below 0 an anti-face.
    """

    model: Model
    output: Folder
    loadings: Annotated[
        Path | None, Option(metavar="TABLE.csv"), Help("The faces: rows of a table of loadings.")
    ] = None
    clip: Annotated[
        tuple[ClipText, ...],
        Option(metavar="CLIP"),
        Help("The faces: a folder, a quoted glob, images (give --clip for each) or a video of the person."),
    ] = ()
    gains: Annotated[
        tuple[float, ...],
        Option("--gain", metavar="G,G,..."),
        Help("Gains, factors on the loadings; one set of stimuli each."),
    ] = (
        0.5,
        1.0,
        1.5,
        -1.0,
    )
    warp_gains: Annotated[
        tuple[float, ...] | None,
        Option("--warp-gain", metavar="G,G,..."),
        Help("Gains of the warp alone [default: --gain]."),
    ] = None
    texture_gains: Annotated[
        tuple[float, ...] | None,
        Option("--texture-gain", metavar="G,G,..."),
        Help("Gains of the texture alone [default: --gain]."),
    ] = None
    components: Annotated[
        str | None,
        Option(metavar="1-5,8"),
        Help("Only these components, from 1; the others do not change [default: all]."),
    ] = None
    region: Annotated[
        str | None,
        Option(metavar="NAME|FILE"),
        Help(
            "Only this part of the face: eyes, brows, mouth, nose, upper, lower, several joined by +, or a grey "
            "picture of the model's size, white where the face changes."
        ),
    ] = None
    frames: Frames = ()
    video: VideoOrPictures = None
    crop: FrameCrop = None


def run(request: CaricatureRequest) -> Steps[Outcome]:
    """Write the set of stimuli."""
    from morphspace.sets.stimulus_set import write_set

    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: CaricatureRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check all inputs without drawing; `model` is the open model, or None."""
    from morphspace.model.model import load_model
    from morphspace.sets.plan import plan_of
    from morphspace.sets.sources import faces_of
    from morphspace.stimuli.caricature import change_of

    model = model or load_model(request.model)
    change, inputs = change_of(request, model)
    faces = yield from faces_of(
        model, request.loadings, request.clip, request.frames, request.crop, clip_options(request)
    )
    faces = faces.for_video(request.video)
    rate = None if request.video is None else faces.frame_rate_hz
    drawings = [
        drawing
        for name, rows in faces.stimuli(request.video)
        for drawing in change(name, faces.loadings_sd[rows], rate)
    ]
    return plan_of(
        request, "caricature", model, drawings, inputs={**faces.inputs, **inputs}, notes=faces.notes
    )
