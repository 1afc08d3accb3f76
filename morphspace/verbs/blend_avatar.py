"""blend-avatar: k identities blended into one controllable face that belongs to nobody (Nagle section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from morphspace.avatar import Avatar, AvatarSettings, blend_steps
from morphspace.avatar.build import checked
from morphspace.avatar.originals import check_clips
from morphspace.avatar.settings import AUTO, COMPONENTS, EXPRESSION, EXPRESSIONS, MEAN
from morphspace.cache import work_folder
from morphspace.errors import BadInput
from morphspace.face.detector import detector_for
from morphspace.flow import methods
from morphspace.io.framing import FramedClip
from morphspace.model.encode import framed_for
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome, versions
from morphspace.report.avatar_page import avatar_page, avatar_result, landmark_words
from morphspace.sets.models import held_models
from morphspace.sets.protect import check_file
from morphspace.steps import Steps
from morphspace.storage import digest_of_file, make_folder, write_text
from morphspace.transfer.mimicry import MAX_SD

IDENTITY = "avatar"
SUFFIX = ".morph"
NO_FINDER = (
    "blended without what finds faces: the keypoints are the sources', and no landmarks were learned; run `morphspace "
    "models fetch` once for better, or give --landmarks none to say that this is meant"
)


@dataclass(frozen=True)
class BlendAvatarRequest:
    """Blend `models`, .morph files with keypoints, into the model `output`.

    `report` the page, None for one beside the model; `work_folder` kept when given, else beside the output and removed
    at the end; `clips` the folders, globs or videos the models were built from, in their order; `identity` what the
    avatar is called; `landmarks` "auto" finds the face in the blended pictures where the detector's files are. The
    others are those of `avatar.AvatarSettings`.
    """

    models: tuple[str, ...]
    output: Path
    weights: tuple[float, ...] | None = None
    faceframe: str = MEAN
    reference: str | None = None
    expressions: int | None = EXPRESSIONS
    method: str = AUTO
    max_sd: float = MAX_SD
    sharpen: float | None = None
    surround: str | None = None
    correspondence: str = EXPRESSION
    flow: str = methods.DEFAULT
    components: int = COMPONENTS
    clips: tuple[str, ...] | None = None
    landmarks: str = "auto"
    identity: str = IDENTITY
    report: Path | None = None
    work_folder: Path | None = None


def run(request: BlendAvatarRequest) -> Steps[Outcome]:
    """Blend, build, and write the model and its page. Returns an `Outcome`."""
    paths = [Path(given) for given in request.models]
    if not request.identity.strip():
        raise BadInput(
            f"the identity {request.identity!r} is no name: give the avatar one, or leave --identity out"
        )
    if not request.output.name:
        raise BadInput(
            f"the output {request.output} is a folder: give a file to write, such as avatar{SUFFIX}"
        )
    report = request.report or request.output.with_suffix(".html")
    check_file(request.output, SUFFIX, paths)
    check_file(report, ".html", paths)
    with held_models(paths) as held:
        models = [load_model(path) for path in held]
        detector, missing = detector_for(request.landmarks)
        same = {one.name for one in fields(AvatarSettings)} & {one.name for one in fields(request)} - {
            "clips"
        }
        settings = AvatarSettings(
            **{name: getattr(request, name) for name in same},
            detector=detector,
            clips=_clips(request, models),
            provenance={"identity": request.identity, "versions": versions()},
        )
        checked(models, settings)  # before any folder is made
        make_folder(request.output.parent)
        make_folder(report.parent)
        digests = [digest_of_file(path) for path in held]
        with work_folder(request.work_folder, request.output) as folder:
            avatar = yield from blend_steps(models, settings, folder)
            shown = yield from avatar_result(avatar, models, settings)
            avatar.model.save(request.output)
            write_text(report, avatar_page(shown))
        advice = landmark_words(avatar, detector is not None, request.output)
        notes = (*((NO_FINDER,) if missing else ()), *avatar.notes, *advice)
        return _outcome(avatar, request, report, digests, notes)


def _clips(request: BlendAvatarRequest, models: Sequence[MorphModel]) -> list[FramedClip] | None:
    """Open the clips the models were built from. Raises `BadInput` where there is not one for each."""
    if request.clips is None:
        return None
    check_clips(len(request.clips), len(models))
    return [framed_for(model, (clip,), None) for model, clip in zip(models, request.clips, strict=True)]


def _outcome(
    avatar: Avatar,
    request: BlendAvatarRequest,
    report: Path,
    digests: Sequence[str],
    notes: tuple[str, ...],
) -> Outcome:
    model, sharpness = avatar.model, avatar.sharpness
    wanted = float(sharpness["sources"] @ avatar.weights)
    shares = ", ".join(
        f"{name} {weight:.2g}" for name, weight in zip(avatar.identities, avatar.weights, strict=True)
    )
    left_out = avatar.figures["expressions_with_one_left_out"]
    drawn, pictures, plain = (
        f"{sharpness[name] / wanted if wanted > 0 else 1.0:.0%}"
        for name in ("blend", "pictures", "unsharpened")
    )
    lines = (
        f"{request.output}: {model.identity}, blended of {shares}; {len(avatar.expressions)} expressions, "
        f"{model.size[0]}x{model.size[1]}, {model.rank} components",
        f"laid on {avatar.identities[avatar.reference_identity]}; hair, ears, neck and background of "
        + ("nobody (flat grey)" if avatar.surround is None else avatar.identities[avatar.surround])
        + f"; in {left_out} expressions somebody is left out",
        f"sharpness, against the sources': {drawn} as the model draws it; its pictures {plain} plain, {pictures} "
        f"sharpened by {avatar.sharpen:.2f}",
        f"report: {report}",
    )
    document = {
        "model": str(request.output),
        "report": str(report),
        "sources_sha256": list(digests),
        "correspondence": request.correspondence,
        **avatar.figures,
    }
    return Outcome(lines, document, notes, (request.output, report))
