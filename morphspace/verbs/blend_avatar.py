"""blend-avatar: k identities blended into one controllable face that belongs to nobody (Nagle section 4)."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.avatar import Avatar, AvatarSettings, blend_steps
from morphspace.avatar.build import checked
from morphspace.avatar.distances import mean_face_distances
from morphspace.avatar.originals import check_clips
from morphspace.avatar.settings import AUTO, COMPONENTS, EXPRESSION, EXPRESSIONS, FLAT, MEAN
from morphspace.cache import work_folder
from morphspace.errors import BadInput, UnreadableFile
from morphspace.face.detector import Detector, detector_for
from morphspace.flow import methods
from morphspace.io.framing import FramedClip
from morphspace.model.encode import framed_for
from morphspace.model.file import check_content
from morphspace.model.landmarks import LEAST_FACES
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome, versions
from morphspace.report.avatar_page import AvatarResult, ExpressionRow, avatar_page, rows_shown
from morphspace.sets.protect import check_file
from morphspace.steps import Step, Steps
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
    with _held(paths) as held:
        models = [load_model(path) for path in held]
        detector, missing = detector_for(request.landmarks)
        settings = AvatarSettings(
            weights=request.weights,
            faceframe=request.faceframe,
            reference=request.reference,
            expressions=request.expressions,
            method=request.method,
            max_sd=request.max_sd,
            sharpen=request.sharpen,
            surround=request.surround,
            correspondence=request.correspondence,
            flow=request.flow,
            components=request.components,
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
            shown = yield from _shown(avatar, models, request)
            avatar.model.save(request.output)
            write_text(report, avatar_page(shown))
        notes = (
            *((NO_FINDER,) if missing else ()),
            *avatar.notes,
            *_without_landmarks(avatar, request, detector),
        )
        return _outcome(avatar, request, report, digests, notes)


@contextlib.contextmanager
def _held(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Give copies of model files for as long as they are needed, checked to be whole. Raises `BadInput`.

    A model is read from its file as it is used. One that is written anew or cut short meanwhile would change under the
    blend, or end the process.
    """
    with tempfile.TemporaryDirectory(prefix="morphspace-", ignore_cleanup_errors=True) as folder:
        held = []
        for number, path in enumerate(paths):
            if path.suffix.lower() != SUFFIX or path.is_dir():
                raise BadInput(
                    f"{path} is no {SUFFIX} file: build a model of a clip first with `morphspace build-model`"
                )
            check_content(path)
            copy = Path(folder) / f"{number}{SUFFIX}"
            try:
                shutil.copyfile(path, copy)
            except OSError as error:
                raise UnreadableFile(
                    f"cannot copy {path} to {folder}, where it is held while it is blended: {error.strerror or error}"
                ) from error
            if not _is_unchanged(copy):
                raise UnreadableFile(
                    f"{path} was changed while it was read ({copy.stat().st_size} bytes came of it): let the program "
                    "that writes it finish, then start again"
                )
            held.append(copy)
        yield held


def _is_unchanged(copy: Path) -> bool:
    try:
        check_content(copy)
    except BadInput:
        return False
    return True


def _clips(request: BlendAvatarRequest, models: Sequence[MorphModel]) -> list[FramedClip] | None:
    """Open the clips the models were built from. Raises `BadInput` where there is not one for each."""
    if request.clips is None:
        return None
    check_clips(len(request.clips), len(models))
    return [framed_for(model, (clip,), None) for model, clip in zip(models, request.clips, strict=True)]


def _without_landmarks(
    avatar: Avatar, request: BlendAvatarRequest, detector: Detector | None
) -> tuple[str, ...]:
    """Say that landmarks were not learned, and what would teach them: more pictures, or looking for the face at all."""
    if avatar.model.landmarks is not None:
        return ()
    lacks = f"{avatar.model.identity} does not know its landmarks, which `mimic --method guided` wants"
    count = len(avatar.expressions)
    if detector is not None or count < LEAST_FACES:
        return (
            f"{lacks}: they are learned from at least {LEAST_FACES} pictures with a face that is found, and {count} "
            "expressions were blended; ask for more --expressions",
        )
    return (f"{lacks}: run `morphspace keypoints {request.output} --auto`",)


def _shown(avatar: Avatar, models: Sequence[MorphModel], request: BlendAvatarRequest) -> Steps[AvatarResult]:
    """Gather what the page shows; a generator of steps."""
    used = np.array([one.weights for one in avatar.expressions])
    picked = rows_shown(used, avatar.weights)
    rows = []
    for index in picked:
        rows.append(
            ExpressionRow(index, avatar.versions(index), avatar.blend(index), avatar.pixel_average(index))
        )
        yield Step("report", len(rows), len(picked))
    return AvatarResult(
        model=avatar.model,
        identities=avatar.identities,
        asked=avatar.weights,
        sources=[one.source for one in avatar.expressions],
        frames=[one.frame for one in avatar.expressions],
        used=used,
        plausibility=np.array([one.plausibility for one in avatar.expressions]),
        rows=rows,
        sharpness=avatar.sharpness,
        sharpen=avatar.sharpen,
        surround=_surround(avatar),
        distances=mean_face_distances(models, avatar.model, avatar.judged),
        notes=avatar.notes,
        settings=_settings_shown(avatar, request),
    )


def _surround(avatar: Avatar) -> str:
    return "flat field" if avatar.surround is None else avatar.identities[avatar.surround]


def _settings_shown(avatar: Avatar, request: BlendAvatarRequest) -> dict[str, str]:
    count = "all" if request.expressions is None else f"{request.expressions}"
    blend = avatar.model.provenance["blend"]
    return {
        "method": blend["method"] + (" (auto)" if request.method == AUTO else ""),
        "bound of each loading": f"{request.max_sd:g} SD",
        "expressions": f"{len(avatar.expressions)}; of each identity {count}"
        + ("" if request.expressions is None else ", by farthest-point sampling"),
        "frames": "rendered by the models" if request.clips is None else "of the clips",
        "correspondence": "mean faces at rest"
        + (", mouths in each expression" if request.correspondence == EXPRESSION else ""),
        "reference identity": avatar.identities[avatar.reference_identity],
        "reference expression": avatar.expressions[avatar.reference].name,
        "faceframe": request.faceframe,
        "surround": _surround(avatar),
        "flow": request.flow,
        "sharpening": f"{avatar.sharpen:.2f}" + (" (auto)" if request.sharpen is None else ""),
        "components": f"{avatar.model.rank}",
    }


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
    left_out = int(sum((one.weights[avatar.weights > 0] == 0).any() for one in avatar.expressions))
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
        "model_id": model.model_id,
        "identity": model.identity,
        "identities": list(avatar.identities),
        "weights": [float(weight) for weight in avatar.weights],
        "sources_sha256": list(digests),
        "expressions": len(avatar.expressions),
        "expressions_with_one_left_out": left_out,
        "components": model.rank,
        "reference_identity": avatar.identities[avatar.reference_identity],
        "surround": FLAT if avatar.surround is None else avatar.identities[avatar.surround],
        "method": model.provenance["blend"]["method"],
        "correspondence": request.correspondence,
        "sharpen": avatar.sharpen,
        "sharpness": {
            "sources": [float(value) for value in sharpness["sources"]],
            **{name: float(value) for name, value in sharpness.items() if name != "sources"},
        },
        "keypoints": None if model.faceframe is None else model.faceframe.points.tolist(),
    }
    return Outcome(lines, document, notes, (request.output, report))
