"""The results of a build for each frame, kept in the work folder: registration, aligned picture, flow and confidence.

These are computed once. A result's file name is a digest of all that the result depends on. So an interrupted build
continues, a build with other PCA settings reuses the results, and several builds share a folder.

The flow takes two passes. In the first, each frame is matched by itself, from coarse to fine. In the second, frames
that were hard to match start from the first-pass field of a neighbour in time, and keep the better field
(`flow.starts`). A result depends on the first pass of the frame and of one neighbour, never on the order of
computation: the bytes are the same for any number of threads and after any interruption.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image, Mask, Points
from morphspace.cache import is_finished, read_result, result_file, write_result
from morphspace.face.anchor import FaceAnchor, points_of, rigid_movement
from morphspace.face.faceframe import Frame, RegistrationKind, aligned, identity_affine
from morphspace.face.mesh import FacePoints
from morphspace.face.registration import Registration
from morphspace.flow import Flow, FlowFunction, methods, starts
from morphspace.flow.starts import StartKind
from morphspace.grid import warp
from morphspace.io.framing import FrameSource, same_size
from morphspace.steps import Step, Steps, in_order
from morphspace.storage import digest_of_array

FRAME_FORMAT = "morphspace-work-frame-4"
FLOW_VERSION = 11  # increase it when a flow method changes its field: old results are then not reused

FrameStart = Literal["coarse to fine", "neighbour"]


@dataclass(frozen=True, eq=False)
class FramePlan:
    """Settings that apply to every frame of a build; with the frame, all that its result depends on.

    Attributes
    ----------
    reference : array (h, w, 3)
    reference_index : int
        The frame that is the reference.
    region : array (h, w)
        The rigid part that registration fits.
    mask : array (h, w)
        The face on the reference, inside which fields are compared. The model's mask may change without a new flow.
    registration : {"none", "similarity", "affine"}
    flow : str
        Flow method.
    start : {"auto", "none"}
        "auto" runs the second pass, unless the flow is held.
    anchor : FaceAnchor or None
        Holds the flow to the face points.
    """

    reference: Image
    reference_index: int
    region: Mask
    mask: Mask
    registration: RegistrationKind
    flow: str
    start: StartKind
    anchor: FaceAnchor | None = None


@dataclass(frozen=True, eq=False)
class WorkFrame:
    """A frame in the work folder: aligned, with its flow from the reference and the start of that flow."""

    frame: Frame
    flow: Flow
    start: FrameStart


def frame_steps(
    source: FrameSource,
    plan: FramePlan,
    work_folder: Path,
    faces: Sequence[FacePoints | None] | None = None,
) -> Steps[list[Path]]:
    """Register each frame and estimate its flow, or find both in the work folder; a generator of steps.

    Parameters
    ----------
    source : FrameSource
        n frames.
    plan : FramePlan
    work_folder : Path
    faces : sequence of n FacePoints, optional
        The face in each frame, None without one. With an anchor they start the registrations and hold the flows.

    Returns
    -------
    list of n Path
        The file of each frame.

    Raises
    ------
    BadInput
        If a frame and the reference differ in size.
    """
    find = methods.for_morphs(plan.flow)(plan.reference)
    files = yield from _first_pass(source, plan, find, work_folder, faces or [None] * len(source.names))
    if plan.start == "auto" and plan.anchor is None and plan.flow not in starts.WITHOUT_START:
        files = yield from _second_pass(plan, find, files)
    return files


def _first_pass(
    source: FrameSource,
    plan: FramePlan,
    find: FlowFunction,
    work_folder: Path,
    faces: Sequence[FacePoints | None],
) -> Steps[list[Path]]:
    """Register each frame and estimate its flow from coarse to fine."""
    common: list[Any] = [FRAME_FORMAT, FLOW_VERSION, plan.flow, plan.registration, cv2.__version__]
    common += [digest_of_array(array) for array in (plan.reference, plan.region, plan.mask)]
    held = None
    if plan.anchor is not None:
        common.append(plan.anchor.identity)
        held = plan.anchor.held(find, *plan.mask.shape)
    points = [None if plan.anchor is None else points_of(face) for face in faces]
    files = [
        result_file(work_folder, *common, digest, *([] if known is None else [digest_of_array(known)]))
        for digest, known in zip(source.digests, points, strict=True)
    ]
    missing = [index for index, file in enumerate(files) if not is_finished(file)]
    head = Registration(plan.reference, plan.registration, plan.region)

    def make(item: tuple[int, Image]) -> None:
        index, image = item
        face = faces[index]
        if index == plan.reference_index:
            height, width = image.shape[:2]
            frame = Frame(image, "", identity_affine(), points[index])
            flow = Flow(np.zeros((height, width, 2), np.float32), np.ones((height, width), np.float32))
        else:
            start = None if plan.anchor is None or face is None else rigid_movement(plan.anchor.face, face)
            frame = aligned(image, "", head.of(image, start), points[index])
            flow = find(frame.image, None) if held is None else held(frame)
        _write(files[index], plan, frame, flow, "coarse to fine")

    finished = len(files) - len(missing)
    if finished:
        yield Step("flow", finished, len(files))
    for _ in in_order(make, _decoded(source, missing, plan)):
        finished += 1
        yield Step("flow", finished, len(files))
    return files


def _decoded(source: FrameSource, indices: list[int], plan: FramePlan) -> Iterator[tuple[int, Image]]:
    """Yield frames with their indices; the reference is decoded already."""
    if plan.reference_index in indices:
        yield plan.reference_index, plan.reference
    others = [index for index in indices if index != plan.reference_index]
    yield from same_size(source, others, plan.reference.shape)


def _second_pass(plan: FramePlan, find: FlowFunction, files: list[Path]) -> Steps[list[Path]]:
    """Repeat hard frames from a neighbour's first-pass field; return the files of the better results."""
    errors, folds = np.array([_judgement(file) for file in files]).T
    pairs = {
        int(index): starts.easier_neighbour(errors, int(index))
        for index in starts.hard_frames(errors, folds)
        if index != plan.reference_index
    }
    limits = [FRAME_FORMAT, "second pass", starts.FOLD_LIMIT, starts.CLEARLY]
    folder = files[0].parent
    again = {i: result_file(folder, *limits, files[i].stem, files[near].stem) for i, near in pairs.items()}
    missing = [index for index, file in again.items() if not is_finished(file)]

    def make(index: int) -> None:
        first = read_work_frame(files[index])
        start = read_work_frame(files[pairs[index]]).flow.displacement
        image = first.frame.image
        tried = find(image, start)
        kept = starts.better(plan.reference, image, [first.flow, tried], plan.mask)
        _write(again[index], plan, first.frame, kept, "neighbour" if kept is tried else "coarse to fine")

    finished = len(again) - len(missing)
    if finished:
        yield Step("starts", finished, len(again))
    for _ in in_order(make, missing):
        finished += 1
        yield Step("starts", finished, len(again))
    return [again.get(index, file) for index, file in enumerate(files)]


def read_work_frame(file: Path, name: str = "") -> WorkFrame:
    """Read a frame from its file, under the name `name`. Raises `UnreadableFile`."""
    arrays, document = read_result(file)
    points = np.array(arrays["points"]) if "points" in arrays else None
    frame = Frame(np.array(arrays["image"]), name, np.array(arrays["registration"]), points)
    flow = Flow(np.array(arrays["flow"]), np.array(arrays["confidence"]))
    return WorkFrame(frame, flow, document["start"])


def read_points(file: Path) -> Points | None:
    """Read only the face points of an aligned frame, as in `Frame`. Raises `UnreadableFile`."""
    points = read_result(file)[0].get("points")
    return None if points is None else np.array(points)


def read_aligned(file: Path) -> Image:
    """Read only the aligned picture (h, w, 3) of a frame. Raises `UnreadableFile`."""
    return np.array(read_result(file)[0]["image"])


def _write(file: Path, plan: FramePlan, frame: Frame, flow: Flow, start: FrameStart) -> None:
    field = flow.displacement
    arrays: dict[str, AnyArray] = {
        "image": frame.image,
        "registration": frame.registration,
        "flow": field,
        "confidence": flow.confidence,
    }
    if frame.points is not None:
        arrays["points"] = frame.points
    document = {
        "start": start,
        "photometric_error": starts.photometric_error(plan.reference, frame.image, field, plan.mask),
        "fold_fraction": warp.fold_fraction(field, plan.mask),
    }
    write_result(file, arrays, document)


def _judgement(file: Path) -> tuple[float, float]:
    """Read the photometric error and the share of folds of a frame."""
    document = read_result(file)[1]
    return document["photometric_error"], document["fold_fraction"]
