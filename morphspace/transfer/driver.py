"""The driving frames of a mimicry: pictures of a clip, or the source's own training loadings (Nagle et al., section 3).

Pictures are aligned and vectorised on the source's mean face. Frames are read one at a time, so that a clip may have
any length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput
from morphspace.face.detector import Person
from morphspace.face.mesh import FacePoints
from morphspace.io.clock import frames_shown
from morphspace.model.encode import framed_for, notes_on_framing
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset
from morphspace.requests import AS_IT_IS, ClipOptions
from morphspace.storage import digest_of_json


@dataclass(frozen=True, eq=False)
class UsedModel:
    """A model of the mimicry, its file and the file's SHA-256."""

    model: MorphModel
    path: Path
    digest: str


@dataclass(frozen=True, eq=False)
class Driver:
    """The driving frames of a source.

    Attributes
    ----------
    name : str
    names, digests : tuple of n str
        Name and content digest of each frame.
    inputs : dict
        Name to digest, for the record.
    rate_hz : float or None
    given : function
        Yields the frames at some places, one at a time: pictures (h, w, 3) of the source's size, or raw loadings
        (k,).
    offset : function
        Computes the offset of a frame from the source's mean, from its name, the frame, and its face points if known.
    picture : function
        Draws a frame (h, w, 3).
    files : tuple of Path
    notes : tuple of str
        Changes that were made to the frames.
    times_s : tuple of n floats, s, or None
        The times of the frames of a clip that has them.
    is_pictures : bool
        Whether the frames are pictures, in which faces can be detected, or loadings.
    person : Person or None
        The face to be used if a frame shows several (`FramedClip.person`).
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
    times_s: tuple[float, ...] | None = None
    is_pictures: bool = True
    person: Person | None = None

    def shown(self) -> AnyArray:
        """Return the frame (m,) that each picture of a video at even times shows: the nearest one."""
        return frames_shown(len(self.names), self.times_s, self.rate_hz)


def training_driver(source: UsedModel) -> Driver:
    """Make a driver of the source's training loadings; the picture of a frame is its reconstruction.

    Raises
    ------
    BadInput
        If the model holds no training frames.
    """
    model = source.model
    loadings = model.training.values
    if len(loadings) == 0:
        raise BadInput(
            f"{source.path} has no training frames; expected at least 1. Give driving frames with --frames"
        )
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
        times_s=model.training_times_s,
        is_pictures=False,
    )


def clip_driver(source: UsedModel, frames: str, options: ClipOptions = AS_IT_IS) -> Driver:
    """Make a driver of a clip, whose frames are aligned to the source's reference.

    Raises
    ------
    BadInput, UnreadableFile
        If the clip cannot be read, or its pictures are too small.
    """
    framed = framed_for(source.model, (frames,), None, options)
    model = source.model.for_person(framed.person)

    def offset(name: str, picture: Image, found: FacePoints | None) -> MorphOffset:
        return model.morph_of(model.align(picture, name, found)) - model.mean

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
        notes=framed.clip.notes + notes_on_framing(framed.framing, model.identity, "driving frames"),
        times_s=framed.clip.times_s,
        person=framed.person,
    )
