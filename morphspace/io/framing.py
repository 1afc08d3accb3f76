"""Framing: crop and scale the images of a clip to the size of a model's frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import cv2
import numpy as np

from morphspace.arrays import Affine, Image
from morphspace.errors import BadInput
from morphspace.io.clips import Clip
from morphspace.storage import digest_of_json

MAX_SIDE_PX = 4096  # px; a morph of that size has 80 million numbers
MIN_SIDE_PX = 32  # px; the coarsest level of the flow needs as many


@dataclass(frozen=True, eq=False)
class Framing:
    """How a source image becomes a model frame: crop, scale until it covers the size, then cut to the centre.

    Attributes
    ----------
    source_size : (w, h) px of the source images
    crop : (x, y, w, h) px, or None for the whole image
    size : (w, h) px of the model's frames

    Raises
    ------
    BadInput
        If the crop reaches outside the image, or a side of `size` is outside `MIN_SIDE_PX` to `MAX_SIDE_PX`.

    Examples
    --------
    >>> framing = Framing(source_size=(400, 300), crop=None, size=(100, 100))
    >>> framing.scaled_size, framing.cut_off
    ((133, 100), (33, 0))
    """

    source_size: tuple[int, int]
    crop: tuple[int, int, int, int] | None
    size: tuple[int, int]

    def __post_init__(self) -> None:
        x, y, w, h = self.box
        width, height = self.source_size
        if x < 0 or y < 0 or w < 1 or h < 1 or x + w > width or y + h > height:
            raise BadInput(
                f"the crop is {x},{y},{w},{h}; expected x,y,w,h inside the image of {width}x{height} px. Change it"
            )
        if max(self.size) > MAX_SIDE_PX:
            raise BadInput(
                f"the frames have {self.size[0]}x{self.size[1]} px; expected at most {MAX_SIDE_PX} a side. Reduce them"
            )
        if min(self.size) < MIN_SIDE_PX:
            raise BadInput(
                f"the frames have {self.size[0]}x{self.size[1]} px; expected at least {MIN_SIDE_PX}x{MIN_SIDE_PX} "
                "for a face. "
                "Enlarge them, for example to 200x240"
            )

    @property
    def box(self) -> tuple[int, int, int, int]:
        """The crop (x, y, w, h) px; the whole image if there is none."""
        return self.crop or (0, 0, *self.source_size)

    @property
    def scaled_size(self) -> tuple[int, int]:
        """The size (w, h) px of the crop after scaling, before the cut to the centre."""
        _, _, w, h = self.box
        scale = max(self.size[0] / w, self.size[1] / h)
        return max(self.size[0], round(w * scale)), max(self.size[1], round(h * scale))

    @property
    def cut_off(self) -> tuple[int, int]:
        """The number of scaled pixels that the cut to the centre removes in x and in y."""
        return self.scaled_size[0] - self.size[0], self.scaled_size[1] - self.size[1]

    def apply(self, image: Image) -> Image:
        """Return the model frame (h, w, 3) of a source image. Reduction averages areas; enlargement is cubic."""
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
        """The affine (2, 3) that maps a point of the model frame to the source image, px."""
        x, y, w, h = self.box
        scale = np.array([w / self.scaled_size[0], h / self.scaled_size[1]])
        corner = np.array([self.cut_off[0] // 2, self.cut_off[1] // 2]) + 0.5
        return np.column_stack([np.diag(scale), scale * corner - 0.5 + (x, y)])


def check_person(source: FramedClip) -> None:
    """Raise `BadInput` if the place of the person lies outside the framed images: another face would be taken.

    Examples
    --------
    >>> from morphspace.io.clips import open_clip
    >>> from morphspace.requests import ClipOptions
    >>> clip = open_clip(["anna"], ClipOptions(person=(40.0, 30.0)))
    >>> check_person(FramedClip(clip, Framing(clip.size, (10, 10, 40, 48), (40, 48))))
    """
    chosen, seen = source.clip.person, source.person
    if not isinstance(chosen, tuple) or not isinstance(seen, tuple):
        return
    if not all(-0.5 <= at <= side - 0.5 for at, side in zip(seen, source.framing.size, strict=True)):
        x, y, w, h = source.framing.box
        raise BadInput(
            f"the person is at {chosen[0]:g},{chosen[1]:g} px, outside the part of the frames of {source.clip.name} "
            f"that is read, in the crop {x},{y},{w},{h}; expected a place inside it. Give another --crop"
        )


class FrameSource(Protocol):
    """Frames at the model's size, in order: the input of a build."""

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        ...

    @property
    def digests(self) -> tuple[str, ...]:
        """A digest of what each frame was made from, its framing included."""
        ...

    def images(self, indices: list[int]) -> Iterator[Image]:
        """Yield the frames (h, w, 3) at these indices, in rising order."""
        ...


@dataclass(frozen=True)
class FramedClip:
    """A clip with its framing: a `FrameSource` of images."""

    clip: Clip
    framing: Framing

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        return self.clip.frame_names

    @cached_property
    def file_digests(self) -> tuple[str, ...]:
        """The SHA-256 of each frame's source file."""
        return self.clip.digests()

    @property
    def person(self) -> Literal["largest", "left", "right"] | tuple[float, float] | None:
        """The face to be used if frames show several; a place is px of the framed image."""
        person = self.clip.person
        if person is None or isinstance(person, str):
            return person
        (x, y), (shift_x, shift_y) = person, self.to_source[:, 2]
        return (x - shift_x) / self.to_source[0, 0], (y - shift_y) / self.to_source[1, 1]

    @cached_property
    def digests(self) -> tuple[str, ...]:
        """One digest per frame, of its source file, the framing, and the face that is used."""
        framing: list[Any] = [self.framing.source_size, self.framing.box, self.framing.size]
        framing += [] if self.person is None else [self.person]
        return tuple(digest_of_json([digest, framing]) for digest in self.file_digests)

    def images(self, indices: list[int]) -> Iterator[Image]:
        """Yield the framed images (h, w, 3) at these indices, one at a time."""
        for image in self.clip.images(indices):
            yield self.framing.apply(image)

    @property
    def to_source(self) -> Affine:
        """The affine (2, 3) that maps a point of the framed image to its source image, px."""
        return self.framing.to_source


@dataclass(frozen=True)
class WholeClip:
    """A clip without framing: a `FrameSource` of its own pictures, of any size."""

    clip: Clip

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        return self.clip.frame_names

    @cached_property
    def digests(self) -> tuple[str, ...]:
        """One digest per frame, of its source file and the face that is used."""
        person = self.clip.person
        return tuple(digest_of_json([digest, person]) for digest in self.clip.digests())

    def images(self, indices: list[int]) -> Iterator[Image]:
        """Yield the pictures (h, w, 3) at these indices, one at a time."""
        yield from self.clip.images(indices)


def same_size(
    source: FrameSource, indices: list[int], shape: tuple[int, ...] | None = None
) -> Iterator[tuple[int, Image]]:
    """Yield (index, frame). Raise `BadInput` if a frame differs from `shape`, by default the first's."""
    for index, image in zip(indices, source.images(indices), strict=True):
        shape = shape or image.shape
        if image.shape != shape:
            raise BadInput(
                f"{source.names[index]} has {image.shape[1]}x{image.shape[0]} px; expected {shape[1]}x{shape[0]} "
                "as the "
                "frames before. Bring all to one size"
            )
        yield index, image
