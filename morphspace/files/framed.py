"""A clip as a build or an encoding sees it: its frames brought to the model's size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from morphspace.arrays import Affine, Image
from morphspace.faces import Framing
from morphspace.files.clips import Clip
from morphspace.storage import digest_of_json


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
