"""The frames that drive a mimicry: pictures of a clip, or the source's own training loadings (Nagle section 3).

A driving frame is either a picture, which is aligned and taken apart on the source's mean face, or a row of the
source's own training loadings. Frames are read one at a time, so that a clip may be of any length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput
from morphspace.face.mesh import FacePoints
from morphspace.model.encode import framed_for, notes_on_framing
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset
from morphspace.storage import digest_of_json


@dataclass(frozen=True, eq=False)
class UsedModel:
    """A model that takes part, the file it lies in, and that file's SHA-256."""

    model: MorphModel
    path: Path
    digest: str


@dataclass(frozen=True, eq=False)
class Driver:
    """The frames that drive.

    `names` of the frames | `digests` of what each is | `inputs` name to digest, for the record | `given` yields what is
    known of the frames at these places, one at a time: pictures (h, w, 3) of the source's size, or loadings (k,) |
    `offset` takes one of them apart, by its name, relative to the source's mean, told what the source's own detector
    found in it where that was asked | `picture` draws one of them (h, w, 3) | `files` they lie in | `notes` on what was
    done to the frames | `is_pictures` tells whether faces can be looked for in them, or their loadings are known.
    """

    name: str
    names: tuple[str, ...]
    digests: tuple[str, ...]
    inputs: dict[str, str]
    rate_hz: float | None
    given: Callable[[Sequence[int]], Iterator[AnyArray]]
    offset: Callable[[str, AnyArray, FacePoints | None], MorphOffset]
    picture: Callable[[AnyArray], Image]
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    is_pictures: bool = True


def training_driver(source: UsedModel) -> Driver:
    """Let the source's own training frames drive, from their loadings; a picture of one is its reconstruction."""
    model = source.model
    loadings = model.training.values
    if len(loadings) == 0:
        raise BadInput(f"{source.path} holds no training frames: give driving frames with --frames")
    rate = model.provenance.get("frame_rate_hz")
    return Driver(
        name=model.identity,
        names=model.training.frame_names,
        digests=tuple(digest_of_json([source.digest, place]) for place in range(len(loadings))),
        inputs={},
        rate_hz=float(rate) if rate else None,
        given=lambda places: (np.array(loadings[place], np.float64) for place in places),
        offset=lambda name, row, found: model.offset(row),
        picture=model.render,
        is_pictures=False,
    )


def clip_driver(source: UsedModel, frames: str) -> Driver:
    """Let a clip drive: each frame is aligned to the source's reference and taken apart on its mean face."""
    model = source.model
    framed = framed_for(model, (frames,), None)

    def offset(name: str, picture: Image, found: FacePoints | None) -> MorphOffset:
        aligned = model.align(picture, name, found).image
        return model.morph_of(aligned, model.flow_from_reference) - model.mean

    return Driver(
        name=framed.clip.name,
        names=framed.names,
        digests=framed.digests,
        inputs={
            f"frames/{name}": digest for name, digest in zip(framed.names, framed.file_digests, strict=True)
        },
        rate_hz=framed.clip.sidecar.frame_rate_hz,
        given=lambda places: framed.images(list(places)),
        offset=offset,
        picture=lambda picture: picture,
        files=framed.clip.paths,
        notes=notes_on_framing(framed.framing, model.identity, "driving frames"),
    )
