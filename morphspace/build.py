"""From frames to a model: reference, registration, flow, mean shape, morphs, warp weight, PCA (Nagle section 2).

The work runs in two passes over the frames and never holds more than a few of them. What is costly about a frame (its
registration and flow) is kept in the work folder under a name made from everything it depends on: a build that was
stopped goes on where it was, and a build with other PCA settings starts from there.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from morphspace import faces, warp
from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask
from morphspace.basis import basis_from_gram, gram_matrix, mean_row
from morphspace.errors import BadInput, UnreadableFile
from morphspace.faces import FaceFrame, Frame, RegistrationKind
from morphspace.flow import methods
from morphspace.model import Loadings, MorphModel, inner_product, model_digest
from morphspace.morph import Morph, invert_mean_shape, morph_of, parts_of, resource
from morphspace.progress import Step, Steps, in_order
from morphspace.reference import POOL, ReferenceChoice, mouth_contrast, search, shrunk, spread
from morphspace.rows import RowFile
from morphspace.storage import digest_of_array, digest_of_json, read_container, write_container
from morphspace.warpweight import WeightTrial, best_trial, trial_weights

MIN_FRAMES = 3
COMPONENTS = 50
FRAME_FORMAT = "morphspace-work-frame-1"


class FrameSource(Protocol):
    """Frames at the model's size, in order: what `build_steps` builds from."""

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        ...

    @property
    def digests(self) -> tuple[str, ...]:
        """A digest of what each frame was made from, its framing included."""
        ...

    def images(self, indices: list[int]) -> Iterator[Image]:
        """Give the frames (h, w, 3) at these indices, which rise."""
        ...


@dataclass(frozen=True, eq=False)
class BuildSettings:
    """How to build. `reference` a frame's index, None to choose; `warp_weight` colour per px, None to cross-validate.

    `mask` (h, w) is drawn on the reference, None for an ellipse over the face. `faceframe` is marked on the frame
    `faceframe_index`; unmoved, it also places the rigid part and
    the mask, so the two frames should hold the head alike.
    """

    components: int = COMPONENTS
    registration: RegistrationKind = "similarity"
    flow: str = methods.DEFAULT
    reference: int | None = None
    warp_weight: float | None = None
    mask: Mask | None = None
    faceframe: FaceFrame | None = None
    faceframe_index: int | None = None


@dataclass(frozen=True, eq=False)
class Build:
    """A finished build: the model, and what the report tells of each frame.

    `registrations` (n, 2, 3); `fold_fractions` (n,) inside the mask; `motion_px` (n,) rms of the flow inside
    the mask; `trials` of the warp weight; `work` for the aligned frames.
    """

    model: MorphModel
    choice: ReferenceChoice
    registrations: AnyArray
    fold_fractions: AnyArray
    motion_px: AnyArray
    trials: tuple[WeightTrial, ...]
    warnings: tuple[str, ...]
    frame_files: tuple[Path, ...] = field(repr=False)

    def frame(self, index: int) -> tuple[Frame, Displacement]:
        """Give aligned frame `index` and its flow from the reference, from the work folder."""
        name = self.model.training.frame_names[index]
        return _read_work_frame(self.frame_files[index], name)


def build_steps(
    source: FrameSource, settings: BuildSettings, work_folder: Path, provenance: Mapping[str, Any]
) -> Steps[Build]:
    """Build a model; a generator of steps that returns a `Build`.

    Parameters: source, the frames; settings; work_folder, where finished frames are kept; provenance, a JSON document
    with at least `identity`, `framing` and `versions`, to which the build adds what it chose. Raises `BadInput` for
    fewer than three frames, frames of different sizes, or a mask that does not fit.
    """
    count = len(source.names)
    if count < MIN_FRAMES:
        raise BadInput(f"{count} frames are too few for a model: give at least {MIN_FRAMES}")
    if settings.components < 1:
        raise BadInput(f"{settings.components} components were asked for: ask for at least 1")
    methods.named(settings.flow)  # a wrong name is told before any work is done
    work_folder.mkdir(parents=True, exist_ok=True)
    choice = yield from _choose_reference(source, settings)
    (reference,) = source.images([choice.index])
    height, width = reference.shape[:2]
    if settings.mask is not None and settings.mask.shape != (height, width):
        raise BadInput(
            f"the mask is {settings.mask.shape[1]}x{settings.mask.shape[0]}, the frames are {width}x{height}: "
            "draw it on the reference at the size of the frames"
        )
    region = faces.rigid_region(height, width, settings.faceframe)
    files, registrations, mean_field = yield from _flow_pass(
        source, settings, reference, choice.index, region, work_folder
    )
    mean_inverse = invert_mean_shape(mean_field)
    faceframe = _faceframe_on_mean(settings, files, registrations, mean_field)
    mask = _mask_on_mean(settings, mean_inverse, faceframe)
    reference_id = digest_of_json([digest_of_array(reference), digest_of_array(mean_inverse)])[:16]
    with _row_file(work_folder, count, 5 * height * width) as rows:
        folds, motion = yield from _morph_pass(rows, files, source.names, mean_inverse, mask, reference_id)
        mean = mean_row(rows)
        yield Step("components", 1, 4)
        trials: tuple[WeightTrial, ...] = ()
        weight = settings.warp_weight
        if weight is None:
            trials = trial_weights(rows, mean, mask, settings.components, list(files), _aligned_image)
            weight = best_trial(trials)
        yield Step("components", 2, 4)
        product = inner_product(mask, weight)
        gram = gram_matrix(rows, mean, product, 0, rows.shape[1])
        yield Step("components", 3, 4)
        basis, loadings = basis_from_gram(rows, mean, product, gram, settings.components)
        yield Step("components", 4, 4)
    texture, displacement = parts_of(mean, height, width)
    mean_morph = Morph(displacement, texture, reference_id)
    full_provenance = {
        **provenance,
        "reference": {"frame": choice.name, "reason": choice.reason, "sha256": digest_of_array(reference)},
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
        reference_faceframe=settings.faceframe,
        training=Loadings(loadings, source.names, model_digest(basis, mean_morph, full_provenance)),
        registration=settings.registration,
        flow=settings.flow,
        provenance=full_provenance,
    )
    warnings = _warnings(source, choice, model)
    return Build(model, choice, registrations, folds, motion, trials, warnings, tuple(files))


def _choose_reference(source: FrameSource, settings: BuildSettings) -> Steps[ReferenceChoice]:
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
    for _, image in _same_size(source, indices):
        height, width = image.shape[:2]
        contrasts.append(mouth_contrast(image, faces.mouth_region(height, width, settings.faceframe)))
        little, mask = shrunk(image, faces.face_mask(height, width, settings.faceframe))
        small.append(little)
    place, errors = yield from search(small, np.array(contrasts), mask)
    best, worst = min(errors.values()), max(errors.values())
    reason = (
        f"of {len(errors)} frames tried it is among those that reach the hardest frames best (error "
        f"{errors[place]:.4f}, best {best:.4f}, worst {worst:.4f}, colour 0 to 1), and of these its mouth is nearest "
        "to half open"
    )
    return ReferenceChoice(indices[place], source.names[indices[place]], reason)


def _flow_pass(
    source: FrameSource,
    settings: BuildSettings,
    reference: Image,
    reference_index: int,
    region: Mask,
    work_folder: Path,
) -> Steps[tuple[list[Path], AnyArray, Displacement]]:
    """Register each frame and find its flow, or take both from the work folder; and average the flow."""
    height, width = reference.shape[:2]
    common = [
        FRAME_FORMAT,
        digest_of_array(reference),
        digest_of_array(region),
        settings.registration,
        settings.flow,
        cv2.__version__,
    ]
    files = [work_folder / f"{digest_of_json([*common, digest])[:32]}.frame" for digest in source.digests]
    done = [_is_whole(file) for file in files]
    missing = [index for index, whole in enumerate(done) if not whole]

    flow_to = methods.named(settings.flow)(reference)

    def make(item: tuple[int, Image]) -> None:
        index, image = item
        if index == reference_index:
            registration, still = faces.identity_affine(), image
            flow = np.zeros((height, width, 2), np.float32)
        else:
            registration = faces.register(reference, image, settings.registration, region)
            still = faces.aligned(image, "", registration).image
            flow = flow_to(still, None).displacement
        arrays: dict[str, AnyArray] = {"image": still, "registration": registration, "flow": flow}
        write_container(files[index], arrays, {"format": FRAME_FORMAT})

    finished = len(files) - len(missing)
    if finished:
        yield Step("flow", finished, len(files))
    for _ in in_order(make, _same_size(source, missing, reference.shape)):
        finished += 1
        yield Step("flow", finished, len(files))
    total = np.zeros((height, width, 2))
    registrations = np.empty((len(files), 2, 3))
    for index, file in enumerate(files):
        frame, flow = _read_work_frame(file, "")
        registrations[index] = frame.registration
        total += flow
    return files, registrations, (total / len(files)).astype(np.float32)


def _same_size(
    source: FrameSource, indices: list[int], shape: tuple[int, ...] | None = None
) -> Iterator[tuple[int, Image]]:
    """Give the frames with their indices; raise where one has another shape than it should, or than the first."""
    for index, image in zip(indices, source.images(indices), strict=True):
        shape = shape or image.shape
        if image.shape != shape:
            raise BadInput(
                f"{source.names[index]} is {image.shape[1]}x{image.shape[0]}, the frames before are "
                f"{shape[1]}x{shape[0]}: bring the frames to one size"
            )
        yield index, image


def _is_whole(file: Path) -> bool:
    try:
        read_container(file)
    except UnreadableFile:
        return False
    return True


def _read_work_frame(file: Path, name: str) -> tuple[Frame, Displacement]:
    arrays, _ = read_container(file)
    frame = Frame(np.array(arrays["image"]), name, np.array(arrays["registration"]))
    return frame, np.array(arrays["flow"])


def _aligned_image(file: Path) -> Image:
    return _read_work_frame(file, "")[0].image


@contextlib.contextmanager
def _row_file(work_folder: Path, rows: int, width: int) -> Iterator[RowFile]:
    handle, name = tempfile.mkstemp(
        prefix="morphs-", suffix=".rows", dir=work_folder
    )  # its own: folders are shared
    os.close(handle)
    path = Path(name)
    try:
        with RowFile(path, rows, width) as file:
            yield file
    finally:
        path.unlink(missing_ok=True)


def _morph_pass(
    rows: RowFile,
    files: list[Path],
    names: tuple[str, ...],
    mean_inverse: Displacement,
    mask: Mask,
    reference_id: str,
) -> Steps[tuple[AnyArray, AnyArray]]:
    """Take each frame apart on the mean face and write its row; give its folds and how much it moves."""

    def take_apart(item: tuple[int, Path]) -> tuple[float, float]:
        index, file = item
        frame, flow = _read_work_frame(file, names[index])
        morph = morph_of(frame.image, resource(flow, mean_inverse), reference_id)
        rows.write_row(index, morph.texture, morph.displacement)
        square = (flow * flow).sum(axis=2)
        moved = float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1.0)))
        return warp.fold_fraction(morph.displacement, mask), moved

    measured = []
    for pair in in_order(take_apart, enumerate(files)):
        measured.append(pair)
        yield Step("morphs", len(measured), len(files))
    folds, motion = np.array(measured).T
    return folds, motion


def _faceframe_on_mean(
    settings: BuildSettings, files: list[Path], registrations: AnyArray, mean_field: Displacement
) -> FaceFrame | None:
    """Carry the faceframe from the frame it was marked on over the reference to the mean face."""
    if settings.faceframe is None:
        return None
    points = settings.faceframe.points
    if settings.faceframe_index is not None:
        _, flow = _read_work_frame(files[settings.faceframe_index], "")
        registration: Affine = registrations[settings.faceframe_index]
        points = warp.apply_affine(warp.inverse_affine(registration), points)
        points = warp.move_points(warp.invert(flow), points)
    return settings.faceframe.moved(warp.move_points(mean_field, points))


def _mask_on_mean(settings: BuildSettings, mean_inverse: Displacement, faceframe: FaceFrame | None) -> Mask:
    if settings.mask is None:
        height, width = mean_inverse.shape[:2]
        return faces.face_mask(height, width, faceframe)
    mask = np.clip(warp.sample_field(settings.mask.astype(np.float32), mean_inverse), 0, 1)
    if not mask.any():
        raise BadInput("the mask is empty (0 everywhere): paint the face white")
    return mask


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
