"""The clips of the benchmark: held-out split, models built on the rest, and the peer they are held against.

Every fourth frame is held out. The reference, the mean shape, the warp weight and the components come from the other
frames alone; a held-out frame is brought to the reference by `MorphModel.align`, as a user's new image would be.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tables import tell

from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.errors import BadInput
from morphspace.face.detector import Detector
from morphspace.face.faceframe import Frame
from morphspace.flow import Flow, FlowFunction, FlowMethod, methods
from morphspace.io.clips import open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.model.model import MorphModel
from morphspace.model.passes import Build, BuildSettings, build_steps
from morphspace.steps import result_of
from morphspace.storage import digest_of_array, digest_of_json, read_container, write_container

CLIPS = ("lp_d18", "lp_d13", "lp_d6", "lp_d0", "grid_pwij3p", "obama_a")
SIZE = (200, 240)  # (w, h) px
TEST_EVERY, TEST_FIRST = 4, 2  # frames 2, 6, 10, ... are held out


def clip_frames(data: Path, name: str, size: tuple[int, int] = SIZE) -> FramedClip:
    """Open the clip `sequences/NAME` of the data folder at a size (w, h) px. Raises `BadInput`."""
    folder = data / "sequences" / name
    if not folder.is_dir():
        raise BadInput(f"{folder} does not exist: give --data a folder that holds sequences/{name}")
    clip = open_clip([folder])
    return FramedClip(clip, Framing(clip.size, None, size))


def split(count: int) -> tuple[list[int], list[int]]:
    """Give the indices of training frames (three of four) and of held-out frames (the rest)."""
    held_out = list(range(TEST_FIRST, count, TEST_EVERY))
    return [index for index in range(count) if index % TEST_EVERY != TEST_FIRST], held_out


@dataclass(frozen=True, eq=False)
class Trial:
    """A model of a clip's training frames, and all frames of the clip aligned to its reference.

    `frames` in the clip's order; `held_out` are indices into them.
    """

    name: str
    build: Build
    frames: tuple[Frame, ...]
    held_out: tuple[int, ...]

    @property
    def model(self) -> MorphModel:
        """The model."""
        return self.build.model

    @property
    def trained(self) -> tuple[int, ...]:
        """Indices of the training frames."""
        return tuple(index for index in range(len(self.frames)) if index not in self.held_out)


def trial(data: Path, name: str, work: Path, detector: Detector | None = None) -> Trial:
    """Build the model of a clip's training frames; what is costly is taken from the work folder where it is there.

    With a `detector` the build and the alignment of held-out frames use the points of the face.
    Call it inside `remembered_flow`, so that the flow of held-out frames is kept as well.
    """
    source = clip_frames(data, name)
    train, test = split(len(source.names))
    kept = FramedClip(source.clip.subset(train), source.framing)
    tell(f"{name}: model of {len(train)} frames")
    settings = BuildSettings(detector=detector)
    build = result_of(build_steps(kept, settings, work / "builds" / name, {"identity": name}))
    frames = {index: build.frame(place)[0] for place, index in enumerate(train)}
    tell(f"{name}: {len(test)} held-out frames")
    for index, image in zip(test, source.images(test), strict=True):
        frames[index] = build.model.align(image, source.names[index])
    return Trial(name, build, tuple(frames[index] for index in range(len(frames))), tuple(test))


@contextlib.contextmanager
def remembered_flow(folder: Path, name: str = methods.DEFAULT) -> Iterator[None]:
    """Keep each flow field in `folder`, by what it was made from: sections share them, results stay the same."""
    plain = methods.METHODS[name]
    folder.mkdir(parents=True, exist_ok=True)

    def remembering(reference: Image) -> FlowFunction:
        to_frame = plain(reference)
        common = [name, cv2.__version__, digest_of_array(reference)]

        def remembered(frame: Image, start: Displacement | None = None) -> Flow:
            begin = None if start is None else digest_of_array(start)
            file = folder / f"{digest_of_json([*common, digest_of_array(frame), begin])[:32]}.flow"
            if not file.exists():
                found = to_frame(frame, start)
                write_container(file, {"flow": found.displacement, "confidence": found.confidence}, {})
            arrays = read_container(file)[0]
            return Flow(np.array(arrays["flow"]), np.array(arrays["confidence"]))

        return remembered

    with replaced_flow(name, remembering):
        yield


@contextlib.contextmanager
def replaced_flow(name: str, method: FlowMethod) -> Iterator[None]:
    """Let `name` mean another method for a while."""
    plain = methods.METHODS[name]
    methods.METHODS[name] = method
    try:
        yield
    finally:
        methods.METHODS[name] = plain


@contextlib.contextmanager
def replaced(owner: Any, name: str, value: object) -> Iterator[None]:
    """Let a module's name mean something else for a while."""
    plain = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, plain)


class PixelPCA:
    """Principal components of plain pixels: what a lab would do without flow, done as well as it can be.

    Float64 throughout, an exact singular value decomposition, the pixels weighted by the model's own mask; the
    components are orthonormal in that weighted product, so that projecting is least squares inside the mask.
    """

    def __init__(self, images: list[Image], mask: Mask) -> None:
        self.shape = images[0].shape
        self.inside = np.flatnonzero(mask > 0)
        self.root = np.sqrt(mask.reshape(-1)[self.inside].astype(np.float64))[:, None]
        vectors = np.stack([self._vector(image) for image in images])
        self.mean = vectors.mean(axis=0)
        self.axes = np.linalg.svd(vectors - self.mean, full_matrices=False)[2][: len(images) - 1]

    def _vector(self, image: Image) -> AnyArray:
        return (image.reshape(-1, 3)[self.inside] * self.root).reshape(-1)

    def reconstruct(self, image: Image, components: int) -> Image:
        """Give the image (h, w, 3) that the first `components` leave of `image`; 0 outside the mask."""
        axes = self.axes[:components]
        vector = self.mean + ((self._vector(image) - self.mean) @ axes.T) @ axes
        out = np.zeros((self.shape[0] * self.shape[1], 3), np.float32)
        out[self.inside] = vector.reshape(-1, 3) / self.root
        return out.reshape(self.shape)
