"""build-model: from a clip or photographs of one person to a controllable face model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.arrays import Mask
from morphspace.errors import BadInput
from morphspace.face.crop import FoundCrop
from morphspace.face.faceframe import FaceFrame, RegistrationKind
from morphspace.face.finder import own_finder
from morphspace.flow import methods
from morphspace.flow.starts import StartKind
from morphspace.grid.warp import apply_affine, inverse_affine
from morphspace.io.clips import Clip, open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.io.images import read_mask
from morphspace.io.sidecars import MarkedFaceframe
from morphspace.model.finding import Landmarks, crop_steps, finder_for
from morphspace.model.model import MorphModel
from morphspace.model.passes import COMPONENTS, Build, BuildSettings, build_steps
from morphspace.outcome import Outcome, check_file, check_folder, versions, work_folder_of
from morphspace.report import Case, advice_for, measure_frames, write_report
from morphspace.steps import Steps, result_of
from morphspace.storage import digest_of_array

DEFAULT_SIDE_PX = 400  # frames larger than this are scaled to cover 200 x 240 unless a size is given
MOST_WEIGHT = 1000.0  # colour per px; builds choose 0.02 to 0.1
LEAST_FACEFRAME_PX = 4.0  # below it the points do not place a face
DEFAULT_SIZE = (200, 240)  # Nagle section 2

Crop = tuple[int, int, int, int] | Literal["auto"]
"""A box (x, y, w, h) px of every frame, or `auto`: around the head, as found in a spread of frames."""


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
    check_request(request)
    clip = open_clip(request.sources)
    output = request.output or Path(f"{clip.name}.morph")
    report = request.report or output.with_suffix(".html")
    check_file(output, ".morph", clip.paths)
    check_file(report, ".html", clip.paths)
    check_folder(output.parent)
    check_folder(report.parent)
    with work_folder_of(request.work_folder, output) as work_folder:
        build, notes = yield from build_clip(clip, request, work_folder)
        figures = yield from measure_frames(build)
        build.model.save(output)
        used = _used_size(build.model)
        write_report(report, build, figures, source_size=used)
    model = build.model
    psnr = np.array(figures.psnr_db)
    share = explained_variance(model)
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
    case = Case(build, figures, used)
    advice = tuple(item.text for item in advice_for(case) if item.level == "mend")
    return Outcome(lines, document, (*notes, *dict.fromkeys((*build.warnings, *advice))), (output, report))


def build_clip(
    clip: Clip, request: BuildModelRequest, work_folder: Path
) -> Steps[tuple[Build, tuple[str, ...]]]:
    """Build from an open clip; give the build, and notes on what was done to the frames."""
    finder, missing = finder_for(request.landmarks)
    notes = list(missing)
    crop, found_crop = request.crop, None
    if crop == "auto":
        width, height = request.size or DEFAULT_SIZE
        found_crop = yield from crop_steps(clip, finder or own_finder(), width / height)
        crop = found_crop.box
    framing = Framing(clip.size, crop, request.size or default_size(clip.size, crop))
    source = FramedClip(clip, framing)
    if max(framing.cut_off) > 0:
        notes.append(
            f"frames of {framing.box[2]}x{framing.box[3]} are scaled to {framing.scaled_size[0]}x"
            f"{framing.scaled_size[1]} and cropped to the middle {framing.size[0]}x{framing.size[1]}"
        )
    mask, mask_digest = _mask(request.mask, framing, clip.size)
    faceframe, faceframe_index = _faceframe(clip, framing)
    settings = BuildSettings(
        components=request.components,
        registration=request.registration,
        flow=request.flow,
        start=request.start,
        reference=None if request.reference is None else _index_of(request.reference, clip),
        warp_weight=request.warp_weight,
        mask=mask,
        faceframe=faceframe,
        faceframe_index=faceframe_index,
        finder=finder,
        anchored=request.landmarks == "anchor",
    )
    build = yield from build_steps(
        source, settings, work_folder, _provenance(clip, source, request, mask_digest, found_crop)
    )
    return build, tuple(notes)


def build_model(
    *sources: str | Path,
    components: int = COMPONENTS,
    size: tuple[int, int] | None = None,
    crop: Crop | None = None,
    landmarks: Landmarks = "auto",
    mask: Path | None = None,
    reference: str | None = None,
    registration: RegistrationKind = "similarity",
    flow: str = methods.DEFAULT,
    start: StartKind = "auto",
    warp_weight: float | None = None,
    work_folder: Path | None = None,
    identity: str | None = None,
) -> MorphModel:
    """Build a model from a folder, a glob, a video or image files; the parameters are those of `BuildModelRequest`.

    Nothing is written but the work folder, which is temporary unless one is given. Raises `BadInput` and its children.
    """
    import tempfile

    request = BuildModelRequest(
        sources=tuple(map(str, sources)),
        components=components,
        size=size,
        crop=crop,
        landmarks=landmarks,
        mask=mask,
        reference=reference,
        registration=registration,
        flow=flow,
        start=start,
        warp_weight=warp_weight,
        identity=identity,
    )
    check_request(request)
    clip = open_clip(request.sources)
    if work_folder is not None:
        build, _ = result_of(build_clip(clip, request, work_folder))
        return build.model
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        build, _ = result_of(build_clip(clip, request, Path(folder)))
        return build.model


def check_request(request: BuildModelRequest) -> None:
    """Raise `BadInput` for settings that cannot be meant."""
    weight = request.warp_weight
    if weight is not None and not 0 < weight <= MOST_WEIGHT:
        raise BadInput(
            f"a warp weight of {weight} cannot be used: give a number above 0, at most "
            f"{MOST_WEIGHT:g} colour per px, or auto"
        )


def _used_size(model: MorphModel) -> tuple[int, int]:
    """Give the size (w, h) px of what was used of each image."""
    framing = model.provenance["framing"]
    width, height = framing["source_size"] if framing["crop"] is None else framing["crop"][2:]
    return int(width), int(height)


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


def source_size(size: tuple[int, int], crop: tuple[int, int, int, int] | None) -> tuple[int, int]:
    """Give the size (w, h) px of what is used of each image: the crop, or all of it."""
    return size if crop is None else (crop[2], crop[3])


def default_size(size: tuple[int, int], crop: tuple[int, int, int, int] | None) -> tuple[int, int]:
    """Give the model's frame size (w, h) where none was asked for: their own, or 200 x 240 where they are large."""
    used = source_size(size, crop)
    return DEFAULT_SIZE if max(used) > DEFAULT_SIDE_PX else used


def explained_variance(model: MorphModel) -> float:
    """Give the share of the training frames' variance (in the inner product) that the components hold."""
    kept = float(model.basis.variances.sum())
    dimensions = max(1, int((model.basis.weight > 0).sum()) - model.rank)
    total = kept + model.basis.discarded_variance * dimensions
    return kept / total if total > 0 else 1.0


def _mask(
    path: Path | None, framing: Framing, source_size: tuple[int, int]
) -> tuple[Mask | None, str | None]:
    if path is None:
        return None, None
    mask = read_mask(path)
    size = (mask.shape[1], mask.shape[0])
    if size == source_size and size != framing.size:
        mask = framing.apply(np.repeat(mask[..., None], 3, axis=2))[..., 0]
    elif size != framing.size:
        raise BadInput(
            f"the mask {path} is {size[0]}x{size[1]}, the frames are {source_size[0]}x{source_size[1]} and the model's "
            f"{framing.size[0]}x{framing.size[1]}: draw it at one of these sizes"
        )
    return mask, digest_of_array(mask)


def _index_of(reference: str, clip: Clip) -> int:
    """Find the frame the user means by its name, with or without folder and suffix."""
    for wanted in (reference, Path(reference).name, Path(reference).stem):
        if wanted in clip.frame_names:
            return clip.frame_names.index(wanted)
    raise BadInput(
        f"there is no frame {reference!r} in {clip.name}: its frames are {clip.frame_names[0]} to "
        f"{clip.frame_names[-1]}"
    )


def _faceframe(clip: Clip, framing: Framing) -> tuple[FaceFrame | None, int | None]:
    marked = clip.sidecar.faceframe
    if marked is None:
        return None, None
    marked = MarkedFaceframe(marked.image, marked.points, clip.size)  # checks that it lies in the picture
    points = apply_affine(inverse_affine(framing.to_source), marked.points)
    width, height = np.hypot(*(points[1] - points[0])), np.hypot(*(points[2] - points[:2].mean(axis=0)))
    if min(width, height) < LEAST_FACEFRAME_PX:
        raise BadInput(
            f"the faceframe of {marked.image} is {width:.1f} px from eye to eye and {height:.1f} px from eyes to "
            f"philtrum at the model's size, at least {LEAST_FACEFRAME_PX:g} px are needed: mark it again"
        )
    right, left, lip = (tuple(map(float, point)) for point in points)
    return FaceFrame(right, left, lip), _index_of(marked.image, clip)  # type: ignore[arg-type]


def _provenance(
    clip: Clip,
    source: FramedClip,
    request: BuildModelRequest,
    mask_digest: str | None,
    found_crop: FoundCrop | None,
) -> dict[str, Any]:
    framing = source.framing
    return {
        "identity": request.identity or clip.sidecar.identity or clip.name,
        "consent": clip.sidecar.consent,
        "licence": clip.sidecar.licence,
        "frame_rate_hz": clip.sidecar.frame_rate_hz,
        "framing": {
            "source_size": list(framing.source_size),
            "crop": None if framing.crop is None else list(framing.crop),
            "size": list(framing.size),
            **({} if found_crop is None else {"crop_found": found_crop.document}),
        },
        "mask_sha256": mask_digest,
        "inputs": dict(zip(clip.frame_names, source.file_digests, strict=True)),
        "versions": versions(),
    }
