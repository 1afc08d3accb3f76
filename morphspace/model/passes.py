"""Build a model: reference, registration, flow, mean shape, morphs, warp weight, PCA (Nagle et al., section 2).

The build runs in passes over the frames and holds few of them in memory. Registration and flow are kept in the work
folder (`work_frames`). A frame is decoded twice at most: once for its face points and the search of the reference,
and once for its flow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, LoadingTable, Mask
from morphspace.errors import BadInput
from morphspace.face import regions
from morphspace.face.anchor import FaceAnchor
from morphspace.face.crop import check_one_person, several_notes
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame, Frame, RegistrationKind
from morphspace.face.mesh import FacePoints
from morphspace.face.regions import face_mask, rigid_region
from morphspace.face.track import FaceTrack, GivenPoints, track_steps
from morphspace.flow import Flow, methods, starts
from morphspace.flow.starts import StartKind
from morphspace.grid import warp
from morphspace.io.framing import FrameSource
from morphspace.linear.pca import Basis, basis_from_gram, gram_matrix, mean_row
from morphspace.linear.rows import RowFile, temporary_rows
from morphspace.model.carried import Carried, carried_steps
from morphspace.model.keypoints import detect_faceframe, with_detected
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel, model_digest
from morphspace.model.morph import (
    CHANNELS,
    Morph,
    inner_product,
    invert_mean_shape,
    morph_of,
    resource,
    shown_share,
)
from morphspace.model.reference import (
    POOL,
    ReferenceChoice,
    SmallFrame,
    nearest_to_neutral,
    reason_of,
    search,
    shrunk,
)
from morphspace.model.warp_weight import WeightTrial, best_trial, trial_weights
from morphspace.model.work_frames import FramePlan, frame_steps, read_aligned, read_work_frame
from morphspace.steps import Step, Steps, in_order, spread
from morphspace.storage import digest_of_array, digest_of_json

MIN_FRAMES = 3
COMPONENTS = 50
LEAST_SHOWN = 1.0  # frames; places that fewer show keep the colours at the pictures' edges


@dataclass(frozen=True, eq=False)
class BuildSettings:
    """Settings of a build.

    Attributes
    ----------
    components : int
        The largest number of components.
    registration : {"none", "similarity", "affine"}
    flow : str
        Flow method.
    start : {"auto", "none"}
        "auto" repeats hard frames from a neighbour's field (`flow.starts`). It assumes frames in temporal order and
        does no harm otherwise.
    reference : int, optional
        Index of the reference frame; None to choose it.
    warp_weight : float, optional
        Colour per px; None to cross-validate.
    mask : array (h, w), optional
        Drawn on the reference; None for an ellipse over the face.
    faceframe : FaceFrame, optional
        Marked on frame `faceframe_index`. It also places the rigid part and the mask, without registration: the head
        should have the same pose in that frame and in the reference.
    faceframe_index : int, optional
    detector : Detector, optional
        Finds the face in each frame; see `build_steps`.
    given : GivenPoints, optional
        Face points of some frames, px of the frame; the detector searches the others.
    is_video : bool
        Whether the frames are those of a video, in which a face moves little from one to the next.
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
    given: GivenPoints | None = None
    is_video: bool = False


@dataclass(frozen=True, eq=False)
class Build:
    """A finished build: the model, and measures of each frame for the report.

    Attributes
    ----------
    model : MorphModel
    choice : ReferenceChoice
    registrations : array (n, 2, 3)
    fold_fractions : array (n,)
        Share of folded cells inside the mask.
    motion_px : array (n,) px
        Rms of the flow inside the mask.
    confidences : array (n,)
        Mean confidence of the flow inside the mask.
    confidence_map : array (h, w)
        Mean confidence over the frames, on the mean face.
    from_neighbour : array (n,) bool
        Frames whose flow started from a neighbour's.
    trials : tuple of WeightTrial
        Empty if the weight was given.
    held_out_db : float or None, dB
        Mean PSNR of frames drawn from components of the others; None if there are too few frames, or nothing moves.
    warnings : tuple of str
    frame_files : tuple of n Path
        In the work folder.
    track : FaceTrack or None
        The face in each frame; None without a detector.
    carried : Carried or None
        How much of the expressions the warp carries; None if it cannot be estimated.
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
    held_out_db: float | None
    warnings: tuple[str, ...]
    frame_files: tuple[Path, ...] = field(repr=False)
    track: FaceTrack | None = None
    carried: Carried | None = None

    def frame(self, index: int) -> tuple[Frame, Flow]:
        """Read aligned frame `index` and its flow from the reference."""
        work = read_work_frame(self.frame_files[index], self.model.training.frame_names[index])
        return work.frame, work.flow


def build_steps(
    source: FrameSource, settings: BuildSettings, work_folder: Path, provenance: Mapping[str, Any]
) -> Steps[Build]:
    """Build a model; a generator of steps that returns a `Build`.

    With a detector, the face points replace what the settings leave open: rigid part, mask, the start of each
    registration and the keypoints on the mean face. They also choose the reference, and hold each frame's flow
    (`face.anchor`). A frame without a detected face is built without points.

    Parameters
    ----------
    source : FrameSource
        The frames. Each is decoded at most twice.
    settings : BuildSettings
    work_folder : Path
        Keeps finished frames.
    provenance : mapping
        A JSON document with at least `identity`, `framing` and `versions`; the build adds its choices.

    Returns
    -------
    Build

    Raises
    ------
    BadInput
        If there are fewer than three frames, frames of different sizes, or a mask of another size.

    References
    ----------
    Nagle et al., section 2; the choice of reference, mask and warp weight is ours.
    """
    _check(source, settings)
    work_folder.mkdir(parents=True, exist_ok=True)
    survey = yield from _survey_pass(source, settings, work_folder)
    choice = yield from _reference_pass(source, settings, survey)
    face = survey.track.faces[choice.index]
    plan, on_reference = _plan(source, settings, choice, face)
    files = yield from frame_steps(source, plan, work_folder, survey.track.faces)
    carried = yield from carried_steps(plan, files)
    shape = _mean_shape(settings, plan, on_reference, files, survey.track.weights)
    with temporary_rows(work_folder, len(files), CHANNELS * plan.mask.size) as rows:
        measured = yield from _morph_pass(rows, files, shape)
        components = yield from _component_pass(rows, files, shape.mask, settings, survey.track.weights)
    searched = (
        None if settings.detector is None else _landmarks_document(settings, survey.track, choice, carried)
    )
    document = _provenance_of_build(provenance, settings, searched, choice, plan, on_reference, components)
    model = _model(source.names, settings, plan, on_reference, shape, components, document)
    warnings = _warnings(source, choice, model) + several_notes(source.names, survey.track.faces)
    model, without_keypoints = yield from _keypoint_pass(model, settings)
    return Build(
        model=model,
        choice=choice,
        registrations=shape.registrations,
        fold_fractions=measured.folds,
        motion_px=measured.motion_px,
        confidences=measured.confidences,
        confidence_map=measured.confidence_map,
        from_neighbour=measured.from_neighbour,
        trials=components.trials,
        held_out_db=components.held_out_db,
        warnings=warnings + without_keypoints,
        frame_files=tuple(files),
        track=None if settings.detector is None else survey.track,
        carried=carried,
    )


def _check(source: FrameSource, settings: BuildSettings) -> None:
    """Check the settings before any computation. Raises `BadInput`."""
    count = len(source.names)
    if count < MIN_FRAMES:
        raise BadInput(
            f"the number of frames is {count}; expected at least {MIN_FRAMES} for a model. Give more frames"
        )
    if settings.components < 1:
        raise BadInput(f"components is {settings.components}; expected at least 1. Ask for more")
    methods.named(settings.flow)
    starts.check_start(settings.start)
    if settings.reference is not None and not 0 <= settings.reference < count:
        raise BadInput(f"reference is {settings.reference}; expected 0 to {count - 1} for {count} frames")


@dataclass(frozen=True, eq=False)
class _Survey:
    """The first pass over the frames: their face points, and small pictures by index."""

    track: FaceTrack
    small: Mapping[int, SmallFrame]


def _survey_pass(source: FrameSource, settings: BuildSettings, work_folder: Path) -> Steps[_Survey]:
    """Find the face in each frame, and reduce the frames among which the reference is searched."""
    pool = [] if settings.reference is not None else spread(len(source.names), POOL)
    small: dict[int, SmallFrame] = {}

    def shrink(index: int, image: Image) -> None:
        small[index] = shrunk(image, settings.faceframe)

    given = None if settings.given is None else settings.given.faces
    detector = settings.detector
    track = yield from track_steps(source, detector, work_folder, given=given, also=pool, look=shrink)
    check_one_person(source.names, track.faces, is_video=settings.is_video)
    return _Survey(track, small)


def _reference_pass(source: FrameSource, settings: BuildSettings, survey: _Survey) -> Steps[ReferenceChoice]:
    """Choose the reference, unless the settings name it."""
    if settings.reference is not None:
        return ReferenceChoice(
            settings.reference, source.names[settings.reference], "named by the setting reference"
        )
    indices = sorted(survey.small)
    faces = [survey.track.faces[index] for index in indices]
    if any(face is not None for face in faces):
        place, reason = nearest_to_neutral(faces)
    else:
        place, errors = yield from search([survey.small[index] for index in indices])
        reason = reason_of(place, errors)
    return ReferenceChoice(indices[place], source.names[indices[place]], reason)


@dataclass(frozen=True, eq=False)
class _OnReference:
    """The face on the reference: a faceframe for the rigid part and one for the mask; None if unknown."""

    rigid: FaceFrame | None
    masked: FaceFrame | None


def _plan(
    source: FrameSource, settings: BuildSettings, choice: ReferenceChoice, face: FacePoints | None
) -> tuple[FramePlan, _OnReference]:
    """Read the reference and make the plan of every frame. Raises `BadInput` for a mask of another size."""
    (reference,) = source.images([choice.index])
    height, width = reference.shape[:2]
    if settings.mask is not None and settings.mask.shape != (height, width):
        raise BadInput(
            f"the mask is {settings.mask.shape[1]}x{settings.mask.shape[0]} px; expected {width}x{height}, the size of "
            "the frames. Draw it on the reference"
        )
    on_reference = _OnReference(
        settings.faceframe or (None if face is None else face.faceframe()),
        settings.faceframe or regions.place_of_mask(face, height, width),
    )
    plan = FramePlan(
        reference=reference,
        reference_index=choice.index,
        region=rigid_region(height, width, on_reference.rigid),
        mask=face_mask(height, width, on_reference.masked),
        registration=settings.registration,
        flow=settings.flow,
        start=settings.start,
        anchor=FaceAnchor(settings.detector, face) if settings.detector and face else None,
    )
    return plan, on_reference


def _landmarks_document(
    settings: BuildSettings, track: FaceTrack, choice: ReferenceChoice, carried: Carried | None
) -> dict[str, Any]:
    """Describe the face points for the provenance: their sources, the head's pose, and the face of the reference."""
    face = track.faces[choice.index]
    found: dict[str, Any] = {
        "detector": dict(settings.detector.identity) if settings.detector else {},
        "held": face is not None,
        "reference_has_face": face is not None,
        **track.document(),
        **({} if carried is None else {"carried": carried.document()}),
    }
    if settings.given is not None:
        found["given"] = dict(settings.given.origin)
    if face is not None and track.given[choice.index]:
        found["reference_points"] = [[float(x), float(y)] for x, y in face.points]
    return found


@dataclass(frozen=True, eq=False)
class _MeanShape:
    """The mean shape of the frames and its mean face.

    Attributes
    ----------
    registrations : array (n, 2, 3)
    mean_inverse : array (h, w, 2) px
        From the mean face to the reference.
    faceframe : FaceFrame or None
        On the mean face.
    mask : array (h, w)
        On the mean face.
    reference_id : str
        Names the mean face.
    """

    registrations: AnyArray
    mean_inverse: Displacement
    faceframe: FaceFrame | None
    mask: Mask
    reference_id: str


def _mean_shape(
    settings: BuildSettings, plan: FramePlan, on_reference: _OnReference, files: list[Path], counts: AnyArray
) -> _MeanShape:
    """Average the flows by `counts` (n,), invert the mean shape, and carry faceframe and mask to the mean face."""
    registrations, mean_field = _mean_field(files, counts)
    mean_inverse = invert_mean_shape(mean_field)
    faceframe = _faceframe_on_mean(settings, files, registrations, mean_field)
    masked = on_reference.masked
    place = faceframe or (masked and FaceFrame.at(warp.move_points(mean_field, masked.points)))
    mask = regions.mask_on_mean(settings.mask, mean_inverse, place)
    digests = [digest_of_array(plan.reference), digest_of_array(mean_inverse)]
    return _MeanShape(registrations, mean_inverse, faceframe, mask, digest_of_json(digests)[:16])


def _mean_field(files: list[Path], counts: AnyArray) -> tuple[AnyArray, Displacement]:
    """Return the registration of each frame (n, 2, 3) and the mean of their flows (h, w, 2) px."""
    registrations = np.empty((len(files), 2, 3))
    total = np.zeros(())
    for index, file in enumerate(files):
        work = read_work_frame(file)
        registrations[index] = work.frame.registration
        total = total + counts[index] * work.flow.displacement.astype(np.float64)
    return registrations, (total / counts.sum()).astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Measured:
    """Measures of each frame's flow, as in `Build`."""

    folds: AnyArray
    motion_px: AnyArray
    confidences: AnyArray
    confidence_map: Mask
    from_neighbour: AnyArray


def _morph_pass(rows: RowFile, files: list[Path], shape: _MeanShape) -> Steps[_Measured]:
    """Vectorise each frame on the mean face, write its row, and measure its flow there."""
    mask, mean_inverse = shape.mask, shape.mean_inverse
    total = max(float(mask.sum()), 1.0)
    colours, shown = np.zeros((*mask.shape, 3)), np.zeros((*mask.shape, 1))

    def take_apart(item: tuple[int, Path]) -> tuple[tuple[float, ...], Mask, Mask, Image]:
        index, file = item
        work = read_work_frame(file)
        flow = work.flow.displacement
        morph = morph_of(work.frame.image, resource(flow, mean_inverse), shape.reference_id)
        rows.write_row(index, morph.vector)
        square = (flow * flow).sum(axis=2)
        moved = float(np.sqrt((square * mask).sum() / total))
        confidence = warp.sample_field(work.flow.confidence, mean_inverse)
        sure = float((confidence * mask).sum() / total)
        folds = warp.fold_fraction(morph.displacement, mask)
        share = shown_share(morph.displacement, work.frame.registration)
        return (folds, moved, sure, float(work.start == "neighbour")), confidence, share, morph.texture

    measured = []
    confidences = np.zeros(mask.shape)
    for figures, confidence, share, texture in in_order(take_apart, enumerate(files)):
        measured.append(figures)
        confidences += confidence
        colours += share * texture
        shown += share
        yield Step("morphs", len(measured), len(files))
    _paint_surroundings(rows, shape, colours, shown)
    folds, motion_px, sure, near = np.array(measured).T
    mean = (confidences / len(files)).astype(np.float32)
    return _Measured(folds, motion_px, np.clip(sure, 0, 1), mean, near > 0)


def _paint_surroundings(rows: RowFile, shape: _MeanShape, colours: AnyArray, shown: AnyArray) -> None:
    """Where a frame's picture ends, give its texture the mean colours of the frames that go on there.

    Otherwise the last pixels of the frame would stand there, smeared into stripes that move with the head.

    Parameters
    ----------
    colours, shown : array (h, w, 3) and (h, w, 1)
        Sums over the frames of their colours, weighted by `shown_share`, and of these weights.
    """
    known = shown[..., 0] >= LEAST_SHOWN
    mean = colours[known] / shown[known]
    for index, registration in enumerate(shape.registrations):
        morph = Morph(rows.row(index), shape.mask.shape, shape.reference_id)
        share = shown_share(morph.displacement, registration)[known]
        if (share < 1).any():
            texture = morph.texture.copy()
            texture[known] = share * texture[known] + (1 - share) * mean
            rows.write_row(index, texture)


def _faceframe_on_mean(
    settings: BuildSettings, files: list[Path], registrations: AnyArray, mean_field: Displacement
) -> FaceFrame | None:
    """Carry the faceframe from its frame, through the reference, to the mean face."""
    if settings.faceframe is None:
        return None
    points = settings.faceframe.points
    if settings.faceframe_index is not None:
        flow = read_work_frame(files[settings.faceframe_index]).flow.displacement
        registration: Affine = registrations[settings.faceframe_index]
        points = warp.apply_affine(warp.inverse_affine(registration), points)
        points = warp.move_points(warp.invert(flow), points)
    return FaceFrame.at(warp.move_points(mean_field, points))


@dataclass(frozen=True, eq=False)
class _Components:
    """The components of the morphs.

    Attributes
    ----------
    mean : array (5 h w,)
    basis : Basis
    loadings : array (n, k)
        Raw loadings of the training frames.
    weight : float
        Warp weight, colour per px.
    trials : tuple of WeightTrial
        Empty if the weight was given.
    held_out_db : float or None, dB
    """

    mean: AnyArray
    basis: Basis
    loadings: LoadingTable
    weight: float
    trials: tuple[WeightTrial, ...]
    held_out_db: float | None


def _component_pass(
    rows: RowFile, files: list[Path], mask: Mask, settings: BuildSettings, counts: AnyArray
) -> Steps[_Components]:
    """Choose the warp weight and compute the principal components of the morphs."""
    mean = mean_row(rows, counts)
    yield Step("components", 1, 4)
    given = settings.warp_weight
    asked = () if given is None else (given,)
    trials = trial_weights(rows, mean, mask, settings.components, files, read_aligned, asked)
    held_out_db = max((trial.psnr_db for trial in trials), default=None)
    weight = best_trial(trials) if given is None else given
    yield Step("components", 2, 4)
    product = inner_product(mask, weight)
    gram = gram_matrix(rows, mean, product, 0, rows.shape[1])
    yield Step("components", 3, 4)
    basis, loadings = basis_from_gram(rows, mean, product, gram, settings.components, counts)
    yield Step("components", 4, 4)
    return _Components(mean, basis, loadings, weight, trials if given is None else (), held_out_db)


def _provenance_of_build(
    provenance: Mapping[str, Any],
    settings: BuildSettings,
    searched: Mapping[str, Any] | None,
    choice: ReferenceChoice,
    plan: FramePlan,
    on_reference: _OnReference,
    components: _Components,
) -> dict[str, Any]:
    """Return the provenance with the choices of the build."""
    digest = digest_of_array(plan.reference)
    return {
        **provenance,
        "reference": {"frame": choice.name, "reason": choice.reason, "sha256": digest},
        "flow_start": settings.start,
        "mask_from": regions.origin_of_mask(settings.mask, settings.faceframe, on_reference.masked),
        "landmarks": searched,
        "components_asked": settings.components,
        "warp_weight_trials": [[trial.weight, trial.psnr_db] for trial in components.trials],
    }


def _model(
    names: tuple[str, ...],
    settings: BuildSettings,
    plan: FramePlan,
    on_reference: _OnReference,
    shape: _MeanShape,
    components: _Components,
    provenance: Mapping[str, Any],
) -> MorphModel:
    """Assemble the model."""
    mean = Morph(components.mean, plan.mask.shape, shape.reference_id)
    model_id = model_digest(components.basis, mean, provenance)
    return MorphModel(
        mean=mean,
        basis=components.basis,
        warp_weight=components.weight,
        mask=shape.mask,
        reference=plan.reference,
        mean_inverse=shape.mean_inverse,
        faceframe=shape.faceframe,
        reference_faceframe=on_reference.rigid,
        training=Loadings(components.loadings, names, model_id),
        registration=settings.registration,
        flow=settings.flow,
        provenance=provenance,
    )


def _keypoint_pass(model: MorphModel, settings: BuildSettings) -> Steps[tuple[MorphModel, tuple[str, ...]]]:
    """Detect the keypoints on the mean face if none were given; return a warning if that fails."""
    if settings.detector is None or model.faceframe is not None or model.rank == 0:
        return model, ()
    try:
        return with_detected(model, (yield from detect_faceframe(model, settings.detector))), ()
    except BadInput as error:
        return model, (f"the model has no keypoints: {error}",)


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
            f"{', ...' if len(same) > 3 else ''} ({len(same)} in all); leave out repeated frames"
        )
    if model.rank == 0:
        found.append("the frames do not differ: the model has rank 0 and shows only its mean")
    return tuple(found)
