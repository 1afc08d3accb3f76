"""mimic: drive one person's model with another person's face (Nagle section 3).

Every driving frame becomes a picture and a row of numbers, one frame at a time; then the pictures are laid beside the
frames that drove them, in a video and on a page.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from morphspace.errors import BadInput
from morphspace.face.detector import Detector, own_detector
from morphspace.io.clips import Clip, open_clip
from morphspace.model.model import MorphModel
from morphspace.outcome import Outcome
from morphspace.requests import ClipText
from morphspace.sets.mimicry import BEST, MAX_SD, MimicSettings, WrittenMimicry, written_mimicry
from morphspace.sets.models import check_faces, check_landmarks, opened_model, ready_model
from morphspace.sets.protect import MODELS_FOLDER, check_apart, check_ours, no_empty_folders, told_what_stays
from morphspace.steps import Steps
from morphspace.storage import make_folder
from morphspace.transfer.driver import UsedModel, clip_driver, training_driver
from morphspace.transfer.neutral import AUTOMATIC
from morphspace.transfer.quality_table import (
    BEYOND,
    FLAGS,
    FOLDS,
    NO_FACE,
    TURNED,
)


@dataclass(frozen=True)
class MimicRequest:
    """Let `source` drive `target`, each a model or a clip to build one of, and write into the folder `output`.

    `frames` is the clip that drives, None for the source's own training frames; `method` is one of `METHODS`, or
    "auto": `guided` where both models know their landmarks, else `transfer`; `gain` multiplies the loadings, "auto" so
    that the target moves as far as the source (`mimic.auto_gain`), None for auto with `guided` and `transfer` and 1
    with the others; `max_sd` bounds each of them; `components` uses the target's first so many, None for all; `neutral`
    names the neutral faces of both (`neutral.neutral_of`).
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
    folder, detect = request.output, detector or own_detector()
    opened, settings = _opened(request, detect)
    with told_what_stays(folder), no_empty_folders(folder):
        make_folder(folder)
        models = []
        for given in opened:
            models.append((yield from ready_model(given, folder / MODELS_FOLDER, request.components, detect)))
        source, target = models
        driver = training_driver(source) if request.frames is None else clip_driver(source, request.frames)
        inputs = [path for given in opened if isinstance(given, Clip) for path in given.paths]
        made = yield from written_mimicry(folder, source, target, driver, settings, detect, inputs)
    return _outcome(folder, source.model, target.model, made)


def check(request: MimicRequest) -> None:
    """Raise what can be found out before any work: a batch asks before it starts."""
    _opened(request, own_detector())
    if request.frames is not None:
        open_clip([request.frames])


def _opened(request: MimicRequest, detect: Detector | None) -> tuple[list[UsedModel | Clip], MimicSettings]:
    """Open what takes part, and refuse before a model is built what would fail after it."""
    settings = MimicSettings(
        request.method, request.gain, request.max_sd, request.components, request.neutral
    )
    sides = {"--src": request.source, "--dst": request.target}
    for option, words in {**sides, "--frames": request.frames}.items():
        if words is not None and not words.strip():
            raise BadInput(f"{option} is empty: name a model or a clip")
    check_ours(request.output)
    opened = [opened_model(role, words, detect) for role, words in sides.items()]
    for role, given in zip(sides, opened, strict=True):
        if isinstance(given, Clip):
            check_apart(request.output, given.paths)
            check_faces(role, given, request.output / MODELS_FOLDER, request.components, detect)
        if request.method == "guided":
            check_landmarks(given)
    if request.frames is not None and any(isinstance(given, Clip) for given in opened):
        check_apart(request.output, open_clip([request.frames]).paths)
    return opened, settings


def _outcome(folder: Path, source: MorphModel, target: MorphModel, made: WrittenMimicry) -> Outcome:
    flags, settings = made.columns["flags"], made.settings
    flagged = sum(bool(words) for words in flags)
    counts = {flag: sum(flag in words.split() for words in flags) for flag in FLAGS}
    warp_kept, missing, agreement = (
        float(np.median(made.columns[name])) for name in ("warp_kept", "missing_motion", "colour_agreement")
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
    return Outcome(lines, document, made.notes, made.files)
