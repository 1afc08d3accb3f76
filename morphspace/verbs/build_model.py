"""build-model: build a controllable face model from a clip or photographs of one person."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from annotated_types import Ge, Gt, Le

from morphspace.flow.names import DEFAULT, NAMES
from morphspace.requests import Clip, ClipOptions, Crop, Size, clip_options, declared_with, settings_in
from morphspace.settings import Help, OneOf, Option, Spelled

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared_with(ClipOptions)
class BuildModelRequest:
    """Build a face model from CLIP: image files, a folder, a quoted glob, or a video."""

    sources: Clip
    output: Annotated[
        Path | None, Option("-o", "--output"), Help("The .morph file [default: the clip's name].")
    ] = None
    report: Annotated[Path | None, Help("The HTML report [default: beside the model].")] = None
    components: Annotated[
        int, Ge(1), Le(10_000), Option("-k", "--components"), Help("Largest number of components.")
    ] = 50
    size: Annotated[
        Size | None,
        Help(
            "Size of the model's frames, px; frames are scaled to cover it and cropped centrally. A component needs "
            "20 bytes a pixel [default: the frames' own, or 200x240 for a video above 400 px or stills above 1 Mpx]."
        ),
    ] = None
    crop: Annotated[
        Crop | Literal["auto"] | None,
        Option(metavar="auto|X,Y,W,H"),
        Help(
            "Cut this box out of every frame first, px; auto finds one around the head (`morphspace models fetch`)."
        ),
    ] = None
    landmarks: Annotated[
        Literal["auto", "none"] | Path,
        Option(metavar="auto|none|FILE"),
        Help(
            "Whether the face is detected in every frame, for registration, mask and keypoints, and to hold the flow "
            "to lips, lids and brows; auto does so if `morphspace models fetch` has been run. FILE is a table of "
            "points, or a folder of templates, for the frames that it names (`morphspace track`)."
        ),
    ] = "auto"
    mask: Annotated[Path | None, Help("Grey picture of the reference's size, white on the face.")] = None
    reference: Annotated[
        str | None, Option(metavar="FILE"), Help("The reference frame [default: chosen, with the reason].")
    ] = None
    registration: Annotated[
        Literal["none", "similarity", "affine"],
        Option("--register"),
        Help("How head movement is removed."),
    ] = "similarity"
    flow: Annotated[str, OneOf(NAMES), Help("The flow estimator, as in `morphspace flow`.")] = DEFAULT
    start: Annotated[
        Literal["auto", "none"], Help("Whether difficult frames are repeated from a neighbour's flow.")
    ] = "auto"
    warp_weight: Annotated[
        float | None,
        Gt(0),
        Le(1000),
        Spelled("auto"),
        Help("Colour per px of warp in the inner product; auto cross-validates."),
    ] = None
    work_folder: Annotated[
        Path | None,
        Option("--work-dir"),
        Help("Folder for finished frames, from which a stopped run resumes."),
    ] = None
    identity: Annotated[
        str | None, Help("Name of the person [default: from clip.json, else the clip's name].")
    ] = None


def run(request: BuildModelRequest) -> Steps[Outcome]:
    """Build the model; write the model and its report."""
    from morphspace import cache
    from morphspace.io.clips import open_clip
    from morphspace.model.from_clip import ClipSettings
    from morphspace.outcome import Outcome
    from morphspace.report.advice.build import advice_for
    from morphspace.sets.models import build_document, build_lines, written_model
    from morphspace.sets.outputs import Output, check_file, check_work_folder
    from morphspace.sets.protect import writing

    check_work_folder(request.work_folder)
    settings = settings_in(request, ClipSettings)
    clip = open_clip(request.sources, clip_options(request))
    output = request.output or Path(f"{clip.name}.morph")
    check_file(output, ".morph")
    report = request.report or output.with_suffix(".html")
    check_file(report, ".html")
    identity = request.identity or clip.sidecar.identity or clip.name
    given = [request.landmarks] if isinstance(request.landmarks, Path) else []
    guarded = Output("build-model", output, (output, report), inputs=(*clip.paths, *given), identity=identity)
    with writing(guarded), cache.work_folder(request.work_folder, output) as work_folder:
        made = yield from written_model(clip, settings, output, report, work_folder)
    document = {"model": str(output), "report": str(report), **build_document(made)}
    advice = tuple(item.text for item in advice_for(made.case) if item.level == "mend")
    notes = (*made.notes, *dict.fromkeys((*made.build.warnings, *advice)))
    return Outcome(build_lines(made, output, report), document, notes, (output, report))
