"""mimic: drive one person's model with another person's face (Nagle section 3).

Every driving frame becomes a picture and a row of numbers, one frame at a time; then the pictures are laid beside the
frames that drove them, in a video and on a page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, own_detector
from morphspace.io.clips import Clip, open_clip
from morphspace.io.tables import write_loadings_table
from morphspace.model.encode import check_components, first_components
from morphspace.model.keypoints import how_to_learn
from morphspace.model.model import MorphModel
from morphspace.outcome import Outcome, check_folder, picture_names, versions, write_record
from morphspace.report import mimic_advice
from morphspace.report.mimic_page import MimicryShown, mimic_page
from morphspace.requests import ClipText
from morphspace.sets.mimicry import FinishedFrames, frame_steps, video_steps
from morphspace.sets.models import check_apart, check_faces, check_landmarks, opened_model, ready_model
from morphspace.sets.protect import (
    MIMIC_FRAMES,
    MODELS_FOLDER,
    VIDEO_NAME,
    WORK_FOLDER,
    check_ours,
    no_empty_folders,
    remove_unfinished,
    told_what_stays,
)
from morphspace.steps import Steps
from morphspace.storage import write_text
from morphspace.transfer.driver import Driver, UsedModel, clip_driver, training_driver
from morphspace.transfer.mimicry import METHODS, WITH_REST, Method, auto_gain, mimic, offset_of
from morphspace.transfer.neutral import AUTOMATIC, neutral_names, rest_of
from morphspace.transfer.quality import reach_of
from morphspace.transfer.quality_table import (
    BEYOND,
    FLAGS,
    FOLDS,
    NO_FACE,
    TURNED,
    FrameMade,
    quality_columns,
    write_quality,
)
from morphspace.verbs.render import CLIPPED_SHARE

BEST = "auto"  # the default: the method that measured best of those the models allow
MAX_SD = 3.0
MOST_GAIN = 1000.0  # a caricature is 2; with far more every frame shows the same bounded face
LEAST_SD, MOST_SD = 0.001, 1000.0  # faces lie inside 3


@dataclass(frozen=True)
class MimicRequest:
    """Let `source` drive `target`, each a model or a clip to build one of, and write into the folder `output`.

    `frames` is the clip that drives, None for the source's own training frames; `method` is one of `METHODS`, or
    "auto": `guided` where both models know their landmarks, else `transfer`; `gain` multiplies the loadings, "auto" so
    that the target moves as far as the source (`mimic.auto_gain`), None for auto with `guided` and `transfer` and 1
    with the others; `max_sd` bounds each of them; `components` uses the target's first so many, None for all; `neutral`
    says what counts as rest (`neutral.rest_of`).
    """

    source: ClipText
    target: ClipText
    output: Path
    frames: ClipText | None = None
    method: str = BEST
    gain: float | Literal["auto"] | None = None
    max_sd: float = MAX_SD
    components: int | None = None
    neutral: str = AUTOMATIC


def run(request: MimicRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Write frames/, side-by-side.mp4, loadings.csv, quality.csv and index.html. Returns an `Outcome`.

    Its document has `no_face`, the number of driving frames in which no face was found. `detector` None takes the
    package's own, where its files have been fetched.
    """
    detect = detector or own_detector()
    opened = _opened(request, detect)
    with told_what_stays(request.output), no_empty_folders(request.output):
        return (yield from _steps(request, opened, detect))


def check(request: MimicRequest) -> None:
    """Raise what can be found out before any work: a batch asks before it starts."""
    _opened(request, own_detector())
    if request.frames is not None:
        open_clip([request.frames])


def _opened(request: MimicRequest, detect: Detector | None) -> list[UsedModel | Clip]:
    """Open what takes part, and refuse what would fail later."""
    _check_request(request)
    opened = [opened_model("--src", request.source, detect), opened_model("--dst", request.target, detect)]
    _check_early(request, opened, detect)
    return opened


def _steps(
    request: MimicRequest,
    opened: Sequence[UsedModel | Clip],
    detect: Detector | None,
) -> Steps[Outcome]:
    folder = request.output
    check_folder(folder)
    models = []
    for given in opened:
        models.append((yield from ready_model(given, folder / MODELS_FOLDER, request.components, detect)))
    source, target = models
    shown_target, rank_notes = first_components(target.model, request.components)
    driver = training_driver(source) if request.frames is None else clip_driver(source, request.frames)
    pictures = tuple(folder / MIMIC_FRAMES / name for name in picture_names(driver.names))
    video = folder / VIDEO_NAME
    check_apart(folder, driver.files)
    _check_inputs_stay((*pictures, video), [*driver.files, *_files_of(opened)])
    check_folder(folder / MIMIC_FRAMES)
    remove_unfinished(folder)
    method, method_notes = _method(request, source, target)
    rest = rest_of(source.model, shown_target, request.neutral)
    asked_gain = request.gain
    if asked_gain is None:
        asked_gain = "auto" if method in WITH_REST else 1.0
    gain = (
        auto_gain(source.model, shown_target, method, origin=rest.origin)
        if asked_gain == "auto"
        else asked_gain
    )
    make = mimic(source.model, shown_target, method, gain=gain, max_sd=request.max_sd, origin=rest.origin)
    resting = None
    if rest.origin is not None:
        resting = (
            offset_of(source.model, rest.origin.source),
            offset_of(shown_target, rest.origin.target),
        )
    reach = reach_of(source.model, shown_target, gain, resting)
    looks = mimic_advice.looks_for_faces(driver, source.model, target.model, detect)
    settings = {
        "method": method,
        "gain": gain,
        "gain_asked": asked_gain,
        "max_sd": request.max_sd,
        "components": shown_target.rank,
        "neutral": rest.settings,
        "frames": "clip" if driver.is_pictures else "training",
        "faces_looked_for": looks.detector is not None,
    }
    work = FinishedFrames(folder / WORK_FOLDER, [settings, source.digest, target.digest], driver, pictures)
    made = yield from frame_steps(source.model, make, reach, work, looks.detector)
    pairs = yield from video_steps(driver, pictures, video)
    columns = quality_columns(driver.names, made)
    loadings = np.array([one.loadings for one in made]).reshape(len(made), shown_target.rank)
    loadings_sd = loadings / shown_target.sd
    advice = mimic_advice.advice_of(source.model, target.model, made, loadings_sd, looks, gain, rest)
    notes = (
        *method_notes,
        *rank_notes,
        *driver.notes,
        *_size_note(source.model, target.model),
        *looks.notes,
        *advice,
    )
    notes += _clipped_note(made, shown_target) + _stale_note(folder / MIMIC_FRAMES, pictures)
    told = {
        **settings,
        "source": {
            "identity": source.model.identity,
            "model_id": source.model.model_id,
            "sha256": source.digest,
        },
        "target": {
            "identity": target.model.identity,
            "model_id": target.model.model_id,
            "sha256": target.digest,
        },
        "driver": driver.name,
        "frame_rate_hz": driver.rate_hz,
        "notes": list(notes),
    }
    written = [*pictures, video, *write_quality(folder, columns, told)]
    written += _write_loadings(folder / "loadings.csv", loadings_sd, target, source, driver)
    page = folder / "index.html"
    shown = MimicryShown(
        names=(source.model.identity, target.model.identity, driver.name),
        pairs=pairs,
        loadings_sd=loadings_sd,
        max_sd=request.max_sd,
        rate_hz=driver.rate_hz,
        columns=columns,
        notes=notes,
        video=video.name,
        settings=_settings_shown(request, told, source, target, driver),
    )
    write_text(page, mimic_page(shown))
    written.append(page)
    inputs = {"source": source.digest, "target": target.digest, **driver.inputs}
    written.append(write_record(folder, "mimic", settings, inputs, written))
    work.remove()
    return _outcome(folder, source.model, target.model, settings, columns, tuple(notes), tuple(written))


def _method(request: MimicRequest, source: UsedModel, target: UsedModel) -> tuple[Method, tuple[str, ...]]:
    """Give the method, and a note where a better one wants something."""
    for method in METHODS:
        if method == request.method:
            if method == "guided":
                check_landmarks(source)
                check_landmarks(target)
            return method, ()
    unlearned = {used.digest: used for used in (source, target) if used.model.landmarks is None}
    if not unlearned:
        return "guided", ()
    ways = "; ".join(
        f"{used.path.name} does not know its landmarks: {how_to_learn(used.model, used.path.name)}"
        for used in unlearned.values()
    )
    return "transfer", (f"the method is transfer, not guided, which follows lids and lips better: {ways}",)


def _check_request(request: MimicRequest) -> None:
    if request.method not in (BEST, *METHODS):
        raise BadInput(
            f"there is no mimicry by {request.method!r}: choose {BEST}, or one of {', '.join(METHODS)}"
        )
    for option, given in (("--src", request.source), ("--dst", request.target), ("--frames", request.frames)):
        if given is not None and not given.strip():
            raise BadInput(f"{option} is empty: name a model or a clip")
    if isinstance(request.gain, float | int) and not abs(request.gain) <= MOST_GAIN:
        raise BadInput(
            f"--gain {request.gain:g} cannot be used: give a number from {-MOST_GAIN:g} to {MOST_GAIN:g}, 1 for the "
            "motion as it is"
        )
    if not LEAST_SD <= request.max_sd <= MOST_SD:
        raise BadInput(
            f"--max-sd {request.max_sd:g} cannot be used: give a number from {LEAST_SD:g} to {MOST_SD:g}, such as "
            f"{MAX_SD:g}"
        )
    check_components(request.components)
    neutral_names(request.neutral)
    check_ours(request.output)


def _check_early(request: MimicRequest, opened: Sequence[UsedModel | Clip], detect: Detector | None) -> None:
    """Find before a model is built what would be found after it."""
    for role, given in zip(("--src", "--dst"), opened, strict=True):
        if isinstance(given, Clip):
            check_apart(request.output, given.paths)
            check_faces(role, given, request.output / MODELS_FOLDER, request.components, detect)
        if request.method == "guided":
            check_landmarks(given)
    if request.frames is not None and any(isinstance(given, Clip) for given in opened):
        check_apart(request.output, open_clip([request.frames]).paths)


def _files_of(opened: Sequence[UsedModel | Clip]) -> list[Path]:
    return [path for given in opened if isinstance(given, Clip) for path in given.paths]


def _check_inputs_stay(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    kept = {path.resolve() for path in inputs}
    for path in outputs:
        if path.resolve() in kept:
            raise BadInput(
                f"the output {path} is one of the inputs and would be lost: choose another output folder"
            )


def _write_loadings(
    path: Path, loadings_sd: AnyArray, target: UsedModel, source: UsedModel, driver: Driver
) -> tuple[Path, Path]:
    """Write the loadings in SD of the target, with a sidecar as `encode` does, and whose motion it was."""
    model = target.model
    document = {
        "model_id": model.model_id,
        "model_sha256": target.digest,
        "identity": model.identity,
        "consent": model.provenance.get("consent"),
        "licence": model.provenance.get("licence"),
        "frame_rate_hz": driver.rate_hz,
        "source_model_id": source.model.model_id,
        "source_identity": source.model.identity,
        "inputs": driver.inputs,
        "versions": versions(),
    }
    write_loadings_table(path, loadings_sd, driver.names, document)
    return path, path.with_suffix(".json")


def _size_note(source: MorphModel, target: MorphModel) -> tuple[str, ...]:
    if source.size == target.size:
        return ()
    return (
        f"{source.identity} has frames of {source.size[0]}x{source.size[1]}, {target.identity} of {target.size[0]}x"
        f"{target.size[1]}: what is carried over is resampled to the latter",
    )


def _clipped_note(made: Sequence[FrameMade], target: MorphModel) -> tuple[str, ...]:
    clipped = sum(one.clipped for one in made)
    if clipped <= CLIPPED_SHARE * len(made) * target.mask.size * 3:
        return ()
    return (f"{clipped} colour values left the range of the files and were clipped",)


def _stale_note(folder: Path, pictures: Sequence[Path]) -> tuple[str, ...]:
    others = sorted({path.name for path in folder.glob("*.png")} - {path.name for path in pictures})
    if not others:
        return ()
    return (
        f"the folder {folder.name} holds {len(others)} other pictures, such as {others[0]}: an earlier run "
        "left them there",
    )


def _settings_shown(
    request: MimicRequest, told: dict[str, Any], source: UsedModel, target: UsedModel, driver: Driver
) -> dict[str, str]:
    sizes = [f"{used.model.size[0]}x{used.model.size[1]}" for used in (source, target)]
    rate = "not known" if driver.rate_hz is None else f"{driver.rate_hz:g} Hz"
    what = "a clip" if driver.is_pictures else "the source's training frames, from their loadings"
    return {
        "method": told["method"] + (" (auto)" if request.method == BEST else ""),
        "gain": f"{told['gain']:g}" + (" (auto)" if told["gain_asked"] == "auto" else ""),
        "bound of each loading": f"{request.max_sd:g} SD",
        "components": f"{told['components']} of {target.model.rank}",
        "source": f"{source.model.identity}, model {source.model.model_id}, {sizes[0]}, {source.path.name}",
        "target": f"{target.model.identity}, model {target.model.model_id}, {sizes[1]}, {target.path.name}",
        "driven by": f"{driver.name}: {what}, {len(driver.names)} frames",
        "frame rate": rate,
        "what counts as rest": _rest_shown(told["neutral"]),
        "faces looked for": "yes" if told["faces_looked_for"] else "no",
    }


def _rest_shown(neutral: dict[str, Any]) -> str:
    frames = [neutral[f"{role}_frame"] or "the mean" for role in ("source", "target")]
    how = f"--neutral {neutral['asked']}"
    apart = "" if neutral["apart"] is None else f", {neutral['apart']:.1%} of the eye distance apart"
    return f"source {frames[0]}, target {frames[1]}{apart} ({how})"


def _outcome(
    folder: Path,
    source: MorphModel,
    target: MorphModel,
    settings: Mapping[str, Any],
    columns: dict[str, list[Any]],
    notes: tuple[str, ...],
    written: tuple[Path, ...],
) -> Outcome:
    flags = columns["flags"]
    flagged = sum(bool(words) for words in flags)
    counts = {flag: sum(flag in words.split() for words in flags) for flag in FLAGS}
    warp_kept, missing, agreement = (
        float(np.median(columns[name])) for name in ("warp_kept", "missing_motion", "colour_agreement")
    )
    lines = (
        f"{folder}: {target.identity} shows {len(flags)} frames of {source.identity} by {settings['method']}, "
        f"gain {settings['gain']:.3g}; of the motion {max(warp_kept, 0):.0%} is kept (median), {flagged} frames are "
        "flagged",
        f"page: {folder / 'index.html'}",
    )
    document = {
        "output": str(folder),
        "page": str(folder / "index.html"),
        "frames": len(flags),
        "flagged": flagged,
        "no_face": counts[NO_FACE],
        "out_of_range": counts[BEYOND],
        "turned": counts[TURNED],
        "folds": counts[FOLDS],
        **{name: settings[name] for name in ("method", "gain", "max_sd", "neutral")},
        "warp_kept_median": warp_kept,
        "missing_motion_median": missing,
        "colour_agreement_median": agreement,
        "model_id": target.model_id,
    }
    return Outcome(lines, document, notes, written)
