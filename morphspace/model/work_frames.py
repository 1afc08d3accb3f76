"""What a build keeps of each frame in its work folder: registration, aligned picture, flow and confidence.

What is costly about a frame is done once. Its file is named after everything it depends on, so that a build that was
stopped goes on where it was, a build with other PCA settings starts from there, and several builds share a folder.

The flow takes two passes. The first is coarse to fine, each frame by itself. In the second, frames that came out
hard start again from the first pass's field of a neighbour in time, and keep what is better (`flow.starts`). A frame
depends on its own and one neighbour's first pass, never on the order in which frames were finished: the same frames
give the same bytes on any number of threads and after any interruption.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Image, Mask
from morphspace.cache import is_finished, read_result, result_file, write_result
from morphspace.face.anchor import FaceAnchor
from morphspace.face.faceframe import Frame, RegistrationKind, aligned, identity_affine
from morphspace.face.registration import Registration
from morphspace.flow import Flow, FlowFunction, methods, starts
from morphspace.flow.starts import StartKind
from morphspace.grid import warp
from morphspace.io.framing import FrameSource, same_size
from morphspace.steps import Step, Steps, in_order
from morphspace.storage import digest_of_array

FRAME_FORMAT = "morphspace-work-frame-3"
FLOW_VERSION = 7  # raise it when any flow method gives another field: kept frames are then made again

FrameStart = Literal["coarse to fine", "neighbour"]


@dataclass(frozen=True, eq=False)
class FramePlan:
    """How every frame is brought to the reference and found from it: all that its file depends on but the frame.

    `reference` (h, w, 3), which is frame `reference_index` | `region` (h, w) the rigid part that `registration` fits |
    `flow` by name | `mask` (h, w) the face on the reference, inside which `start` chooses; not the model's mask, which
    may change without a new flow | `anchor` holds the flow to the points of the face.
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
    """A frame as the work folder holds it: aligned, its flow from the reference, and the start that flow came from."""

    frame: Frame
    flow: Flow
    start: FrameStart


def frame_steps(
    source: FrameSource,
    plan: FramePlan,
    work_folder: Path,
    movements: Sequence[Affine | None] | None = None,
) -> Steps[list[Path]]:
    """Register each frame and find its flow, or take both from the work folder; give each frame's file.

    `movements`, one for each frame, are starts of its registration (2, 3), None where nothing is known. A generator of
    steps. Raises `BadInput` for a frame of another size than the reference.
    """
    find = methods.for_morphs(plan.flow)(plan.reference)
    if plan.anchor is not None:
        find = plan.anchor.anchored(find, *plan.mask.shape)
    starting = [None] * len(source.names) if movements is None else list(movements)
    files = yield from _first_pass(source, plan, find, work_folder, starting)
    if plan.start == "auto" and plan.flow not in starts.WITHOUT_START:
        files = yield from _second_pass(plan, find, files)
    return files


def _first_pass(
    source: FrameSource,
    plan: FramePlan,
    find: FlowFunction,
    work_folder: Path,
    movements: Sequence[Affine | None],
) -> Steps[list[Path]]:
    """Register each frame and find its flow, coarse to fine."""
    common: list[Any] = [FRAME_FORMAT, FLOW_VERSION, plan.flow, plan.registration, cv2.__version__]
    common += [digest_of_array(array) for array in (plan.reference, plan.region, plan.mask)]
    if plan.anchor is not None:
        common.append(plan.anchor.identity)
    files = [
        result_file(work_folder, *common, digest, *([] if movement is None else [digest_of_array(movement)]))
        for digest, movement in zip(source.digests, movements, strict=True)
    ]
    missing = [index for index, file in enumerate(files) if not is_finished(file)]
    head = Registration(plan.reference, plan.registration, plan.region)

    def make(item: tuple[int, Image]) -> None:
        index, image = item
        if index == plan.reference_index:
            height, width = image.shape[:2]
            frame = Frame(image, "", identity_affine())
            flow = Flow(np.zeros((height, width, 2), np.float32), np.ones((height, width), np.float32))
        else:
            frame = aligned(image, "", head.of(image, movements[index]))
            flow = find(frame.image, None)
        _write(files[index], plan, frame, flow, "coarse to fine")

    finished = len(files) - len(missing)
    if finished:
        yield Step("flow", finished, len(files))
    for _ in in_order(make, _decoded(source, missing, plan)):
        finished += 1
        yield Step("flow", finished, len(files))
    return files


def _decoded(source: FrameSource, indices: list[int], plan: FramePlan) -> Iterator[tuple[int, Image]]:
    """Give frames with their indices; the reference, which was decoded before, is not decoded again."""
    if plan.reference_index in indices:
        yield plan.reference_index, plan.reference
    others = [index for index in indices if index != plan.reference_index]
    yield from same_size(source, others, plan.reference.shape)


def _second_pass(plan: FramePlan, find: FlowFunction, files: list[Path]) -> Steps[list[Path]]:
    """Try hard frames again from a neighbour's field of the first pass; give the files of what is better."""
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
    """Read a frame from its file, and call it `name`. Raises `UnreadableFile`."""
    arrays, document = read_result(file)
    frame = Frame(np.array(arrays["image"]), name, np.array(arrays["registration"]))
    flow = Flow(np.array(arrays["flow"]), np.array(arrays["confidence"]))
    return WorkFrame(frame, flow, document["start"])


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
    document = {
        "start": start,
        "photometric_error": starts.photometric_error(plan.reference, frame.image, field, plan.mask),
        "fold_fraction": warp.fold_fraction(field, plan.mask),
    }
    write_result(file, arrays, document)


def _judgement(file: Path) -> tuple[float, float]:
    """Give the photometric error and the folds of a frame."""
    document = read_result(file)[1]
    return document["photometric_error"], document["fold_fraction"]
