"""Clips at a model's size: how source images become model frames, and a clip seen through that framing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np

from morphspace.arrays import Affine, Image
from morphspace.errors import BadInput
from morphspace.io.clips import Clip
from morphspace.storage import digest_of_json

MAX_SIDE_PX = 4096  # a frame of that size has 80 million numbers
MIN_SIDE_PX = 32  # below it the coarsest flow level has nothing to hold on to


@dataclass(frozen=True, eq=False)
class Framing:
    """How a source image becomes a model frame: crop, then scale to cover the size and crop to the middle.

    `source_size` (w, h) px of the images; `crop` (x, y, w, h) px or None for the whole; `size` (w, h) px of the
    model's frames. Raises `BadInput` for a crop that leaves the image.
    """

    source_size: tuple[int, int]
    crop: tuple[int, int, int, int] | None
    size: tuple[int, int]

    def __post_init__(self) -> None:
        x, y, w, h = self.box
        width, height = self.source_size
        if x < 0 or y < 0 or w < 1 or h < 1 or x + w > width or y + h > height:
            raise BadInput(
                f"crop {x},{y},{w},{h} leaves the image of {width}x{height}: give x,y,w,h inside it"
            )
        if max(self.size) > MAX_SIDE_PX:
            raise BadInput(
                f"frames of {self.size[0]}x{self.size[1]} are too large: give at most {MAX_SIDE_PX} px a side"
            )
        if min(self.size) < MIN_SIDE_PX:
            raise BadInput(
                f"frames of {self.size[0]}x{self.size[1]} are too small for a face: at least "
                f"{MIN_SIDE_PX}x{MIN_SIDE_PX}, better 200x240"
            )

    @property
    def box(self) -> tuple[int, int, int, int]:
        """The crop (x, y, w, h) px, the whole image where none was asked for."""
        return self.crop or (0, 0, *self.source_size)

    @property
    def scaled_size(self) -> tuple[int, int]:
        """The size (w, h) px of the crop once it is scaled to cover `size`."""
        _, _, w, h = self.box
        scale = max(self.size[0] / w, self.size[1] / h)
        return max(self.size[0], round(w * scale)), max(self.size[1], round(h * scale))

    @property
    def cut_off(self) -> tuple[int, int]:
        """How many scaled pixels the middle crop takes away in x and in y."""
        return self.scaled_size[0] - self.size[0], self.scaled_size[1] - self.size[1]

    def apply(self, image: Image) -> Image:
        """Give the model frame (h, w, 3) of a source image: averaged over areas where it shrinks."""
        x, y, w, h = self.box
        image = image[y : y + h, x : x + w]
        if self.scaled_size != (w, h):
            shrinks = self.scaled_size[0] < w
            method = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
            image = cv2.resize(image, self.scaled_size, interpolation=method)
        left, top = self.cut_off[0] // 2, self.cut_off[1] // 2
        return np.ascontiguousarray(image[top : top + self.size[1], left : left + self.size[0]])

    @property
    def to_source(self) -> Affine:
        """The affine (2, 3) that maps a point of the model frame to the source image."""
        x, y, w, h = self.box
        scale = np.array([w / self.scaled_size[0], h / self.scaled_size[1]])
        corner = np.array([self.cut_off[0] // 2, self.cut_off[1] // 2]) + 0.5
        return np.column_stack([np.diag(scale), scale * corner - 0.5 + (x, y)])


class FrameSource(Protocol):
    """Frames at the model's size, in order: what a build builds from."""

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


@dataclass(frozen=True)
class FramedClip:
    """A clip and its framing; gives frames (h, w, 3) at the size of the framing."""

    clip: Clip
    framing: Framing

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        return self.clip.frame_names

    @cached_property
    def file_digests(self) -> tuple[str, ...]:
        """The SHA-256 of each frame's source."""
        return self.clip.digests()

    @cached_property
    def digests(self) -> tuple[str, ...]:
        """A digest of each frame's source and the framing together."""
        framing = [self.framing.source_size, self.framing.box, self.framing.size]
        return tuple(digest_of_json([digest, framing]) for digest in self.file_digests)

    def images(self, indices: list[int]) -> Iterator[Image]:
        """Give the framed images at these indices, one at a time."""
        for image in self.clip.images(indices):
            yield self.framing.apply(image)

    @property
    def to_source(self) -> Affine:
        """The affine (2, 3) from a framed image to the image it was made from."""
        return self.framing.to_source


def same_size(
    source: FrameSource, indices: list[int], shape: tuple[int, ...] | None = None
) -> Iterator[tuple[int, Image]]:
    """Give the frames with their indices. Raises `BadInput` for one of another shape than asked for, or the first's."""
    for index, image in zip(indices, source.images(indices), strict=True):
        shape = shape or image.shape
        if image.shape != shape:
            raise BadInput(
                f"{source.names[index]} is {image.shape[1]}x{image.shape[0]}, the frames before are "
                f"{shape[1]}x{shape[0]}: bring the frames to one size"
            )
        yield index, image
