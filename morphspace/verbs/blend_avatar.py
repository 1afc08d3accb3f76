"""blend-avatar: k identities blended into one controllable face that belongs to nobody (Nagle section 4)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.avatar import Avatar, AvatarSettings, blend_steps
from morphspace.avatar.settings import AUTO, COMPONENTS, EXPRESSIONS, FLAT, MEAN
from morphspace.errors import BadInput
from morphspace.flow import methods
from morphspace.mimic import MAX_SD
from morphspace.model import MorphModel, load_model
from morphspace.modelfile import check_content
from morphspace.progress import Step, Steps
from morphspace.report.avatar_distances import mean_face_distances
from morphspace.report.avatar_page import AvatarShown, ExpressionRow, avatar_page, rows_shown
from morphspace.storage import digest_of_file, write_text
from morphspace.verbs.finding import finder_for
from morphspace.verbs.outcome import Outcome, check_file, check_folder, remove_work, versions

IDENTITY = "avatar"
SUFFIX = ".morph"


@dataclass(frozen=True)
class BlendAvatarRequest:
    """Blend `models`, .morph files with keypoints, into the model `output`.

    `report` the page, None for one beside the model; `work_folder` kept when given, else beside the output and removed
    at the end; `identity` what the avatar is called; `landmarks` "auto" finds the face in the blended pictures where
    the detector's files are. The others are those of `avatar.AvatarSettings`.
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
    flow: str = methods.DEFAULT
    components: int = COMPONENTS
    landmarks: str = "auto"
    identity: str = IDENTITY
    report: Path | None = None
    work_folder: Path | None = None


def run(request: BlendAvatarRequest) -> Steps[Outcome]:
    """Blend, build, and write the model and its page. Returns an `Outcome`."""
    paths = [Path(given) for given in request.models]
    if not request.output.name:
        raise BadInput(
            f"the output {request.output} is a folder: give a file to write, such as avatar{SUFFIX}"
        )
    report = request.report or request.output.with_suffix(".html")
    check_file(request.output, SUFFIX, paths)
    check_file(report, ".html", paths)
    models = [opened(path) for path in paths]
    finder, missing = finder_for(request.landmarks)
    settings = AvatarSettings(
        weights=request.weights,
        faceframe=request.faceframe,
        reference=request.reference,
        expressions=request.expressions,
        method=request.method,
        max_sd=request.max_sd,
        sharpen=request.sharpen,
        surround=request.surround,
        flow=request.flow,
        components=request.components,
        finder=finder,
        provenance={"identity": request.identity, "versions": versions()},
    )
    check_folder(request.output.parent)
    check_folder(report.parent)
    digests = [digest_of_file(path) for path in paths]
    with work_folder_of(request.work_folder, request.output) as folder:
        avatar = yield from blend_steps(models, settings, folder)
        shown = yield from _shown(avatar, models, request)
        avatar.model.save(request.output)
        write_text(report, avatar_page(shown))
    return _outcome(avatar, request, report, digests, (*missing, *avatar.notes))


def opened(path: Path) -> MorphModel:
    """Open a model and check that its file is whole. Raises `BadInput`."""
    if path.suffix.lower() != SUFFIX or path.is_dir():
        raise BadInput(
            f"{path} is no {SUFFIX} file: build a model of a clip first with `morphspace build-model`"
        )
    check_content(path)
    return load_model(path)


@contextlib.contextmanager
def work_folder_of(asked: Path | None, output: Path) -> Iterator[Path]:
    """Give the work folder. One that was not asked for goes when the work is done, and stays to resume from if not."""
    folder = asked or output.with_name(output.name + ".work")
    made = not folder.exists()
    check_folder(folder)
    try:
        yield folder
    except BaseException:
        if made and not any(folder.iterdir()):
            folder.rmdir()
        raise
    if asked is None:
        remove_work(folder)


def _shown(avatar: Avatar, models: Sequence[MorphModel], request: BlendAvatarRequest) -> Steps[AvatarShown]:
    """Gather what the page shows; a generator of steps."""
    used = np.array([one.weights for one in avatar.expressions])
    picked = rows_shown(used, avatar.weights)
    rows = []
    for index in picked:
        rows.append(
            ExpressionRow(index, avatar.versions(index), avatar.blend(index), avatar.pixel_average(index))
        )
        yield Step("report", len(rows), len(picked))
    return AvatarShown(
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
        distances=mean_face_distances(models, avatar.model),
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
    relative = sharpness["blend"] / wanted if wanted > 0 else 1.0
    lines = (
        f"{request.output}: {model.identity}, blended of {shares}; {len(avatar.expressions)} expressions, "
        f"{model.size[0]}x{model.size[1]}, {model.rank} components",
        f"laid on {avatar.identities[avatar.reference_identity]}, hair and background of "
        + ("nobody (flat grey)" if avatar.surround is None else avatar.identities[avatar.surround])
        + f"; in {left_out} expressions somebody is left out",
        f"sharpened by {avatar.sharpen:.2f}: {relative:.0%} of the sources' sharpness, "
        f"{sharpness['unsharpened'] / wanted if wanted > 0 else 1.0:.0%} without",
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
        "sharpen": avatar.sharpen,
        "sharpness": {
            "sources": [float(value) for value in sharpness["sources"]],
            **{name: float(value) for name, value in sharpness.items() if name != "sources"},
        },
        "keypoints": None if model.faceframe is None else model.faceframe.points.tolist(),
    }
    return Outcome(lines, document, notes, (request.output, report))
