"""build-model: from a clip or photographs of one person to a controllable face model."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from morphspace import cache
from morphspace.face.detector import Landmarks
from morphspace.face.faceframe import RegistrationKind
from morphspace.flow import methods
from morphspace.flow.starts import StartKind
from morphspace.io.clips import open_clip
from morphspace.model.from_clip import ClipSettings, Crop
from morphspace.model.passes import COMPONENTS, Build
from morphspace.outcome import Outcome
from morphspace.report.advice.build import advice_for
from morphspace.sets.models import written_model
from morphspace.sets.protect import check_file
from morphspace.steps import Steps
from morphspace.storage import make_folder


@dataclass(frozen=True)
class BuildModelRequest:
    """What to build a model from, and how.

    `sources` a folder, a glob, a video or files; `output` the .morph file, None for one named after the clip;
    `report` the page, None for one beside the model; `components` the most to keep; `size` (w, h) px or None for the
    frames' own (200 x 240 where they are larger than 400 px); `crop` (x, y, w, h) px, or "auto" for one around the
    head; `landmarks` "auto" finds the face in every frame where the detector's files are, "anchor" also holds the flow
    to it, "none" does not; `mask` a grey picture of the reference's size, white where the face is; `reference` a
    frame's name or file, None to choose; `start` "auto" tries hard frames again from a neighbour's flow, "none" does
    not; `warp_weight` colour per px, None to cross-validate; `work_folder` kept when given, else beside the output and
    removed at the end.
    """

    sources: tuple[str, ...]
    output: Path | None = None
    report: Path | None = None
    components: int = COMPONENTS
    size: tuple[int, int] | None = None
    crop: Crop | None = None
    landmarks: Landmarks = "auto"
    mask: Path | None = None
    reference: str | None = None
    registration: RegistrationKind = "similarity"
    flow: str = methods.DEFAULT
    start: StartKind = "auto"
    warp_weight: float | None = None
    work_folder: Path | None = None
    identity: str | None = None


def run(request: BuildModelRequest) -> Steps[Outcome]:
    """Build the model, write it and its report. Returns an `Outcome`."""
    settings = ClipSettings(**{field.name: getattr(request, field.name) for field in fields(ClipSettings)})
    clip = open_clip(request.sources)
    output = request.output or Path(f"{clip.name}.morph")
    report = request.report or output.with_suffix(".html")
    check_file(output, ".morph", clip.paths)
    check_file(report, ".html", clip.paths)
    make_folder(output.parent)
    make_folder(report.parent)
    with cache.work_folder(request.work_folder, output) as work_folder:
        made = yield from written_model(clip, settings, output, report, work_folder)
    build, model = made.build, made.build.model
    psnr = np.array(made.case.figures.psnr_db)
    share = model.basis.variance_explained
    lines = (
        f"{output}: {model.identity}, {len(clip)} frames, {model.size[0]}x{model.size[1]}, "
        f"{model.rank} components ({share:.1%} of the variance)",
        f"reference {build.choice.name}: {build.choice.reason}",
        f"training frames come back at {np.median(psnr):.1f} dB (median), {np.percentile(psnr, 10):.1f} dB (10th "
        f"percentile); {build.fold_fractions.mean():.2%} of the warp folds",
        f"flow {model.flow}: confidence {build.confidences.mean():.2f} (mean), {build.confidences.min():.2f} (lowest); "
        f"{int(build.from_neighbour.sum())} frames kept from a neighbour's start",
        *_found_lines(build),
        f"report: {report}",
    )
    document = {
        "model": str(output),
        "report": str(report),
        "model_id": model.model_id,
        "identity": model.identity,
        "frames": len(clip),
        "size": list(model.size),
        "components": model.rank,
        "variance_explained": share,
        "reference": build.choice.name,
        "warp_weight": model.warp_weight,
        "psnr_db_median": float(np.median(psnr)),
        "psnr_db_10th_percentile": float(np.percentile(psnr, 10)),
        "fold_fraction": float(build.fold_fractions.mean()),
        "flow_confidence_mean": float(build.confidences.mean()),
        "flow_confidence_lowest": float(build.confidences.min()),
        "neighbour_starts": int(build.from_neighbour.sum()),
        "crop": model.provenance["framing"]["crop"],
        "frames_with_face": None if build.faces_found is None else int(build.faces_found.sum()),
        "keypoints": None if model.faceframe is None else model.faceframe.points.tolist(),
    }
    advice = tuple(item.text for item in advice_for(made.case) if item.level == "mend")
    return Outcome(
        lines, document, (*made.notes, *dict.fromkeys((*build.warnings, *advice))), (output, report)
    )


def _found_lines(build: Build) -> tuple[str, ...]:
    """Say in how many frames the face was found, and what the crop is where it was found."""
    framing = build.model.provenance["framing"]
    lines: tuple[str, ...] = ()
    if "crop_found" in framing:
        told = framing["crop_found"]
        box = ",".join(map(str, framing["crop"]))
        lines += (f"crop {box}: around the head, found in {told['found']} of {told['frames']} frames",)
    if build.faces_found is not None:
        keypoints = "set" if build.model.faceframe is not None else "not set"
        if build.model.faceframe is not None and build.model.landmarks is None:
            keypoints += (
                " as marked, landmarks not learned: `morphspace keypoints MODEL --auto` sets and learns both"
            )
        lines += (
            f"face found in {int(build.faces_found.sum())} of {len(build.faces_found)} frames; keypoints {keypoints}",
        )
    return lines
