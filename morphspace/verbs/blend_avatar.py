"""blend-avatar: blend several identities into one controllable face of no real person (Nagle section 4)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from annotated_types import Ge, Le

from morphspace.flow.names import DEFAULT, NAMES
from morphspace.requests import ClipOptions, ClipText, MaxSd, MimicryMethod, declared_with
from morphspace.settings import Argument, Help, OneOf, Option, Spelled

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

SUFFIX = ".morph"


@declared_with(ClipOptions)
class BlendAvatarRequest:
    """Blend the identities of several models with keypoints into one face of no real person."""

    models: Annotated[
        tuple[ClipText, ...],
        Argument("A.morph B.morph ..."),
        Help("The models, two or more, with keypoints."),
    ]
    output: Annotated[Path, Option("-o", "--output"), Help("The model to write (.morph).")]
    weights: Annotated[
        tuple[float, ...] | None,
        Option(metavar="W,W,..."),
        Help("Weight of each identity, in the order of the models [default: equal]."),
    ] = None
    faceframe: Annotated[
        str,
        Option(metavar="mean|source|NAME"),
        Help(
            "The keypoints onto which all faces are aligned: the weighted mean, those of the expression's person, or "
            "of an identity."
        ),
    ] = "mean"
    reference: Annotated[
        str | None,
        Option(metavar="NAME"),
        Help(
            "The identity to whose mean face the others are warped [default: the one nearest to all others]."
        ),
    ] = None
    expressions: Annotated[
        int | None,
        Ge(1),
        Spelled("all"),
        Help(
            "Number of expressions of each identity, spread over its range; three identities give three times as many. "
            "all: every training frame."
        ),
    ] = 40
    method: Annotated[
        MimicryMethod, Help("Method of transferring expressions, as in `morphspace mimic`.")
    ] = "auto"
    max_sd: MaxSd = 3.0
    sharpen: Annotated[
        float | None,
        Ge(0),
        Le(3),
        Spelled("auto"),
        Help("Amount of the unsharp mask, a factor; auto: as sharp as the sources."),
    ] = None
    surround: Annotated[
        str | None,
        Option(metavar="NAME|flat"),
        Help(
            "The identity whose hair, ears, neck and background are used, or flat grey [default: the reference "
            "identity's]."
        ),
    ] = None
    correspondence: Annotated[
        Literal["expression", "rest"],
        Help(
            "How faces are matched. rest: by the mean faces; expression: the mouth also in each "
            "expression, by landmarks (`keypoints --auto`) and flow."
        ),
    ] = "expression"
    flow: Annotated[
        str, OneOf(NAMES), Help("The flow estimator between identities and of the final model.")
    ] = DEFAULT
    components: Annotated[
        int, Ge(1), Le(10_000), Option("-k", "--components"), Help("Largest number of components.")
    ] = 50
    clips: Annotated[
        tuple[ClipText, ...] | None,
        Option(metavar="CLIP"),
        Help(
            "The clip of each model, in the order of the models: its original frames are used, not the model's "
            "renderings. Options of clips apply to all of them; clip.json sets those of one."
        ),
    ] = None
    landmarks: Annotated[
        Literal["auto", "none"], Help("Whether faces are detected in the blended pictures.")
    ] = "auto"
    identity: Annotated[str, Help("Name of the avatar.")] = "avatar"
    report: Annotated[Path | None, Help("The HTML report [default: beside the model].")] = None
    work_folder: Annotated[
        Path | None,
        Option("--work-dir"),
        Help("Folder for finished blends, from which a stopped run resumes."),
    ] = None


def run(request: BlendAvatarRequest) -> Steps[Outcome]:
    """Blend the identities, build a model of them, and write the model and its page."""
    from morphspace.avatar.build import blend_steps, checked
    from morphspace.avatar.settings import blend_settings
    from morphspace.cache import work_folder
    from morphspace.model.model import load_model
    from morphspace.outcome import Outcome
    from morphspace.report.avatar_page import avatar_page, avatar_result, blend_lines, landmark_words
    from morphspace.sets.models import held_models
    from morphspace.sets.outputs import Output, check_file, check_work_folder
    from morphspace.sets.protect import writing
    from morphspace.storage import digest_of_file, write_text

    check_work_folder(request.work_folder)
    paths = [Path(given) for given in request.models]
    check_file(request.output, SUFFIX)
    report = request.report or request.output.with_suffix(".html")
    check_file(report, ".html")
    guarded = Output("blend-avatar", request.output, (request.output, report), (), paths, request.identity)
    with held_models(paths) as held:
        models = [load_model(path) for path in held]
        settings, notes = blend_settings(request, models)
        checked(models, settings)  # before any folder is made
        digests = [digest_of_file(path) for path in held]
        with writing(guarded), work_folder(request.work_folder, request.output) as folder:
            avatar = yield from blend_steps(models, settings, folder)
            result = yield from avatar_result(avatar, models, settings)
            avatar.model.save(request.output)
            write_text(report, avatar_page(result))
        notes += (*avatar.notes, *landmark_words(avatar, settings.detector is not None, request.output))
    document = {
        "model": str(request.output),
        "report": str(report),
        "sources_sha256": digests,
        "correspondence": request.correspondence,
        **avatar.figures,
    }
    return Outcome(blend_lines(avatar, request.output, report), document, notes, (request.output, report))
