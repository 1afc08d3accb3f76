"""From frames to a model: reference, registration, flow, mean shape, morphs, warp weight, PCA (Nagle section 2).

The work runs in passes over the frames and never holds more than a few of them. What is costly about a frame, its
registration and flow, is kept in the work folder (`workframes`).
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphspace import cache
from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask
from morphspace.errors import BadInput
from morphspace.face import regions
from morphspace.face.anchor import FaceAnchor, rigid_movement
from morphspace.face.detector import Detector
from morphspace.face.expression import expression_of, far_from_rest
from morphspace.face.faceframe import FaceFrame, Frame, RegistrationKind
from morphspace.face.mesh import FacePoints
from morphspace.face.points_in_clip import points_steps
from morphspace.face.regions import face_mask, mouth_surroundings, rigid_region
from morphspace.flow import Flow, methods, starts
from morphspace.flow.starts import StartKind
from morphspace.grid import warp
from morphspace.io.framing import FrameSource, same_size
from morphspace.linear.pca import basis_from_gram, gram_matrix, mean_row
from morphspace.linear.rows import RowFile
from morphspace.model.keypoints import detect_faceframe, with_detected
from morphspace.model.model import Loadings, MorphModel, inner_product, model_digest
from morphspace.model.morph import Morph, invert_mean_shape, morph_of, resource
from morphspace.model.reference import POOL, ReferenceChoice, mouth_contrast, search, shrunk
from morphspace.model.warp_weight import WeightTrial, best_trial, trial_weights
from morphspace.model.work_frames import FramePlan, frame_steps, read_aligned, read_work_frame
from morphspace.steps import Step, Steps, in_order, spread
from morphspace.storage import digest_of_array, digest_of_json

MIN_FRAMES = 3
COMPONENTS = 50


@dataclass(frozen=True, eq=False)
class BuildSettings:
    """How to build. `reference` a frame's index, None to choose; `warp_weight` colour per px, None to cross-validate.

    `start` "auto" tries hard frames again from a neighbour's field (`flow.starts`): meant for frames in the order of
    time, harmless for others. `mask` (h, w) is drawn on the reference, None for an ellipse over the face. `faceframe`
    is marked on the frame `faceframe_index`; unmoved, it also places the rigid part and the mask, so the two frames
    should hold the head alike. `detector` finds the face in each frame; what follows from it is in
    `build_steps`, and with `anchored` the flow is held to its points.
    """

    components: int = COMPONENTS
    registration: RegistrationKind = "similarity"
    flow: str = methods.DEFAULT
    start: StartKind = "auto"
    reference: int | None = None
    warp_weight: float | None = None
    mask: Mask | None = None
    faceframe: FaceFrame | None = None
    faceframe_index: int | None = None
    detector: Detector | None = None
    anchored: bool = False


@dataclass(frozen=True, eq=False)
class Build:
    """A finished build: the model, and what the report tells of each frame.

    `registrations` (n, 2, 3) | inside the mask, (n,) each: `fold_fractions`, `motion_px` rms of the flow, `confidences`
    mean of the flow's confidence | `confidence_map` (h, w) its mean over the frames, on the mean face |
    `from_neighbour` (n,) bool, where the flow started from a neighbour's | `trials` of the warp weight | `frame_files`
    of the work folder | `faces_found` (n,) bool, where the detector found the face; None where none was asked.
    """

    model: MorphModel
    choice: ReferenceChoice
    registrations: AnyArray
    fold_fractions: AnyArray
    motion_px: AnyArray
    confidences: AnyArray
    confidence_map: Mask
    from_neighbour: AnyArray
    trials: tuple[WeightTrial, ...]
    warnings: tuple[str, ...]
    frame_files: tuple[Path, ...] = field(repr=False)
    faces_found: AnyArray | None = None

    def frame(self, index: int) -> tuple[Frame, Flow]:
        """Give aligned frame `index` and its flow from the reference, from the work folder."""
        work = read_work_frame(self.frame_files[index], self.model.training.frame_names[index])
        return work.frame, work.flow


def build_steps(
    source: FrameSource, settings: BuildSettings, work_folder: Path, provenance: Mapping[str, Any]
) -> Steps[Build]:
    """Build a model; a generator of steps that returns a `Build`.

    Parameters: source, the frames; settings; work_folder, where finished frames are kept; provenance, a JSON document
    with at least `identity`, `framing` and `versions`, to which the build adds what it chose. Raises `BadInput` for
    fewer than three frames, frames of different sizes, or a mask that does not fit.

    With a detector, the points of the face give what was not given: rigid part and mask, a start for each frame's
    registration, and the keypoints on the mean face; with `anchored` also an anchor for each frame's flow
    (`anchoring`), and the choice of the reference among those that serve nearly as well (`facerest`). A frame without a
    face goes without.
    """
    count = len(source.names)
    if count < MIN_FRAMES:
        raise BadInput(f"{count} frames are too few for a model: give at least {MIN_FRAMES}")
    if settings.components < 1:
        raise BadInput(f"{settings.components} components were asked for: ask for at least 1")
    methods.named(settings.flow)  # wrong names are told before any work is done
    starts.check_start(settings.start)
    work_folder.mkdir(parents=True, exist_ok=True)
    found: tuple[FacePoints | None, ...] = (None,) * count
    if settings.detector is not None:
        found = yield from points_steps(source, settings.detector, work_folder)
    choice = yield from _choose_reference(source, settings, found)
    face = found[choice.index]
    (reference,) = source.images([choice.index])
    height, width = reference.shape[:2]
    if settings.mask is not None and settings.mask.shape != (height, width):
        raise BadInput(
            f"the mask is {settings.mask.shape[1]}x{settings.mask.shape[0]}, the frames are {width}x{height}: "
            "draw it on the reference at the size of the frames"
        )
    placed = settings.faceframe or (None if face is None else face.faceframe())
    overlap = 1.0 if settings.anchored else regions.OVERLAP
    masked = settings.faceframe or regions.place_of_mask(face, height, width, overlap)
    plan = FramePlan(
        reference=reference,
        reference_index=choice.index,
        region=rigid_region(height, width, placed),
        mask=face_mask(height, width, masked),
        registration=settings.registration,
        flow=settings.flow,
        start=settings.start,
        anchor=FaceAnchor(settings.detector, face)
        if settings.detector and face and settings.anchored
        else None,
    )
    movements = [_movement(face, one) for one in found]
    files = yield from frame_steps(source, plan, work_folder, movements)
    registrations, mean_field = _mean_field(files)
    mean_inverse = invert_mean_shape(mean_field)
    faceframe = _faceframe_on_mean(settings, files, registrations, mean_field)
    mask = regions.mask_on_mean(
        settings.mask, mean_inverse, faceframe or (masked and _carried(masked, mean_field))
    )
    reference_id = digest_of_json([digest_of_array(reference), digest_of_array(mean_inverse)])[:16]
    with _row_file(work_folder, count, 5 * height * width) as rows:
        measured = yield from _morph_pass(rows, files, mean_inverse, mask, reference_id)
        mean = mean_row(rows)
        yield Step("components", 1, 4)
        trials: tuple[WeightTrial, ...] = ()
        weight = settings.warp_weight
        if weight is None:
            trials = trial_weights(rows, mean, mask, settings.components, list(files), read_aligned)
            weight = best_trial(trials)
        yield Step("components", 2, 4)
        product = inner_product(mask, weight)
        gram = gram_matrix(rows, mean, product, 0, rows.shape[1])
        yield Step("components", 3, 4)
        basis, loadings = basis_from_gram(rows, mean, product, gram, settings.components)
        yield Step("components", 4, 4)
    mean_morph = Morph(mean, (height, width), reference_id)
    full_provenance = {
        **provenance,
        "reference": {"frame": choice.name, "reason": choice.reason, "sha256": digest_of_array(reference)},
        "flow_start": settings.start,
        "mask_from": regions.origin_of_mask(settings.mask, settings.faceframe, masked),
        "landmarks": None if settings.detector is None else _landmarks_document(settings, found, choice),
        "components_asked": settings.components,
        "warp_weight_trials": [[t.weight, t.psnr_db] for t in trials],
    }
    model = MorphModel(
        mean=mean_morph,
        basis=basis,
        warp_weight=weight,
        mask=mask,
        reference=reference,
        mean_inverse=mean_inverse,
        faceframe=faceframe,
        reference_faceframe=placed,
        training=Loadings(loadings, source.names, model_digest(basis, mean_morph, full_provenance)),
        registration=settings.registration,
        flow=settings.flow,
        provenance=full_provenance,
    )
    warnings = _warnings(source, choice, model)
    if settings.detector is not None and faceframe is None and model.rank > 0:
        try:
            model = with_detected(model, (yield from detect_faceframe(model, settings.detector)))
        except BadInput as error:
            warnings += (f"the model has no keypoints: {error}",)
    return Build(
        model=model,
        choice=choice,
        registrations=registrations,
        fold_fractions=measured.folds,
        motion_px=measured.motion_px,
        confidences=measured.confidences,
        confidence_map=measured.confidence_map,
        from_neighbour=measured.from_neighbour,
        trials=trials,
        warnings=warnings,
        frame_files=tuple(files),
        faces_found=None if settings.detector is None else np.array([one is not None for one in found]),
    )


def _movement(reference: FacePoints | None, frame: FacePoints | None) -> Affine | None:
    """Give where a frame's registration may start, (2, 3); None where one of the faces is not known."""
    return None if reference is None or frame is None else rigid_movement(reference, frame)


def _landmarks_document(
    settings: BuildSettings, found: tuple[FacePoints | None, ...], choice: ReferenceChoice
) -> dict[str, Any]:
    """Say for the provenance which detector looked, in how many frames it found a face, and if in the reference."""
    return {
        "detector": dict(settings.detector.identity) if settings.detector else {},
        "anchored": settings.anchored and found[choice.index] is not None,
        "frames": len(found),
        "frames_with_face": sum(one is not None for one in found),
        "reference_has_face": found[choice.index] is not None,
    }


def _choose_reference(
    source: FrameSource, settings: BuildSettings, found: tuple[FacePoints | None, ...]
) -> Steps[ReferenceChoice]:
    if settings.reference is not None:
        if not 0 <= settings.reference < len(source.names):
            raise BadInput(
                f"reference {settings.reference} was asked for, there are {len(source.names)} frames: "
                f"choose 0 to {len(source.names) - 1}"
            )
        name = source.names[settings.reference]
        return ReferenceChoice(settings.reference, name, "it was asked for")
    indices = spread(len(source.names), POOL)
    small: list[Image] = []
    contrasts: list[float] = []
    mask: Mask = np.zeros((0, 0), np.float32)
    for _, image in same_size(source, indices):
        height, width = image.shape[:2]
        contrasts.append(mouth_contrast(image, mouth_surroundings(height, width, settings.faceframe)))
        little, mask = shrunk(image, face_mask(height, width, settings.faceframe))
        small.append(little)
    looked_at = [found[index] if settings.anchored else None for index in indices]
    far = far_from_rest(looked_at)
    known = bool(np.isfinite(far).any())
    place, errors = yield from search(small, np.array(contrasts), mask, far if known else None)
    best, worst = min(errors.values()), max(errors.values())
    reason = (
        f"of {len(errors)} frames tried it is among those that reach the hardest frames best (error "
        f"{errors[place]:.4f}, best {best:.4f}, worst {worst:.4f}, colour 0 to 1), and of these "
        f"{_nearest(looked_at[place])}"
    )
    return ReferenceChoice(indices[place], source.names[indices[place]], reason)


def _nearest(face: FacePoints | None) -> str:
    if face is None:
        return "its mouth is nearest to half open"
    return (
        "its face is nearest to rest with the lips slightly apart (their gap is "
        f"{expression_of(face).mouth_opening:.2f} eye distances)"
    )


def _mean_field(files: list[Path]) -> tuple[AnyArray, Displacement]:
    """Give the registration of each frame (n, 2, 3) and the mean of their flows (h, w, 2)."""
    registrations = np.empty((len(files), 2, 3))
    total = np.zeros(())
    for index, file in enumerate(files):
        work = read_work_frame(file)
        registrations[index] = work.frame.registration
        total = total + work.flow.displacement.astype(np.float64)
    return registrations, (total / len(files)).astype(np.float32)


@contextlib.contextmanager
def _row_file(work_folder: Path, rows: int, width: int) -> Iterator[RowFile]:
    """Provide a file of rows for a block. It has no name while it is open, so that a killed build leaves none."""
    handle, name = tempfile.mkstemp(prefix=".morphs.", suffix=cache.SUFFIX, dir=work_folder)
    os.close(handle)
    path = Path(name)
    try:
        with RowFile(path, rows, width) as file:
            with contextlib.suppress(PermissionError):  # Windows removes no open file
                path.unlink()
            yield file
    finally:
        path.unlink(missing_ok=True)


@dataclass(frozen=True, eq=False)
class _Measured:
    """What `Build` tells of each frame's flow."""

    folds: AnyArray
    motion_px: AnyArray
    confidences: AnyArray
    confidence_map: Mask
    from_neighbour: AnyArray


def _morph_pass(
    rows: RowFile, files: list[Path], mean_inverse: Displacement, mask: Mask, reference_id: str
) -> Steps[_Measured]:
    """Take each frame apart on the mean face and write its row; measure its flow there."""
    total = max(float(mask.sum()), 1.0)

    def take_apart(item: tuple[int, Path]) -> tuple[tuple[float, ...], Mask]:
        index, file = item
        work = read_work_frame(file)
        flow = work.flow.displacement
        morph = morph_of(work.frame.image, resource(flow, mean_inverse), reference_id)
        rows.write_row(index, morph.vector)
        square = (flow * flow).sum(axis=2)
        moved = float(np.sqrt((square * mask).sum() / total))
        confidence = warp.sample_field(work.flow.confidence, mean_inverse)
        sure = float((confidence * mask).sum() / total)
        folds = warp.fold_fraction(morph.displacement, mask)
        return (folds, moved, sure, float(work.start == "neighbour")), confidence

    measured = []
    confidences = np.zeros(mask.shape)
    for figures, confidence in in_order(take_apart, enumerate(files)):
        measured.append(figures)
        confidences += confidence
        yield Step("morphs", len(measured), len(files))
    folds, motion_px, sure, near = np.array(measured).T
    mean = (confidences / len(files)).astype(np.float32)
    return _Measured(folds, motion_px, np.clip(sure, 0, 1), mean, near > 0)


def _faceframe_on_mean(
    settings: BuildSettings, files: list[Path], registrations: AnyArray, mean_field: Displacement
) -> FaceFrame | None:
    """Carry the faceframe from the frame it was marked on over the reference to the mean face."""
    if settings.faceframe is None:
        return None
    points = settings.faceframe.points
    if settings.faceframe_index is not None:
        flow = read_work_frame(files[settings.faceframe_index]).flow.displacement
        registration: Affine = registrations[settings.faceframe_index]
        points = warp.apply_affine(warp.inverse_affine(registration), points)
        points = warp.move_points(warp.invert(flow), points)
    return settings.faceframe.moved(warp.move_points(mean_field, points))


def _carried(faceframe: FaceFrame, mean_field: Displacement) -> FaceFrame:
    """Carry a faceframe from the reference to the mean face."""
    return faceframe.moved(warp.move_points(mean_field, faceframe.points))


def _warnings(source: FrameSource, choice: ReferenceChoice, model: MorphModel) -> tuple[str, ...]:
    found = []
    same = [
        name
        for name, digest in zip(source.names, source.digests, strict=True)
        if digest == source.digests[choice.index] and name != choice.name
    ]
    if same:
        found.append(
            f"identical to the reference {choice.name}, byte for byte: {', '.join(same[:3])}"
            f"{', ...' if len(same) > 3 else ''} ({len(same)} in all); leave out what repeats"
        )
    if model.rank == 0:
        found.append(
            "the frames do not differ from each other: the model has rank 0 and only its mean renders"
        )
    return tuple(found)
