"""Use the frames a model was built from in place of its reconstructions (Nagle section 4, step 3).

A model draws its training frames from their loadings, without what its components leave out. With the clip at hand,
the colours are those of the frame, read where the model's warp says that each point of the mean face went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from morphspace.errors import BadInput
from morphspace.face.detector import Person
from morphspace.io.framing import FramedClip, FrameSource
from morphspace.model.encode import framed_for
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, morph_of
from morphspace.requests import AS_IT_IS, ClipOptions


class Clip(FrameSource, Protocol):
    """Frames at the model's size with the digests of their files."""

    @property
    def file_digests(self) -> tuple[str, ...]:
        """The SHA-256 of each frame's file."""
        ...

    @property
    def person(self) -> Person | None:
        """The face to be used if frames show several (`FramedClip.person`)."""
        ...


@dataclass(frozen=True, eq=False)
class Originals:
    """The frames of `clip` as morphs of `model`; `places` (n,) of its training frames in the clip."""

    model: MorphModel
    clip: Clip
    places: tuple[int, ...]

    def prepare(self) -> None:
        """Prepare what all frames share: the face in the reference."""
        _ = self.model.anchor

    def morph(self, frame: int) -> Morph:
        """Compute the morph of training frame `frame`."""
        training = self.model.training
        (image,) = self.clip.images([self.places[frame]])
        aligned = self.model.align(image, training.frame_names[frame]).image
        shown = self.model.expand(training.values[frame])
        return morph_of(aligned, shown.displacement, shown.reference_id)

    @property
    def identity(self) -> str:
        """What the morphs depend on beside the model."""
        return self.model.reading if self.model.person is None else f"face {self.model.person}"


def originals_of(models: Sequence[MorphModel], clips: Sequence[Clip] | None) -> list[Originals | None]:
    """Pair each model with the clip it was built from; None for each without clips. Raises `BadInput`."""
    if clips is None:
        return [None] * len(models)
    _check_clips(len(clips), len(models))
    return [_checked(model, clip) for model, clip in zip(models, clips, strict=True)]


def opened_clips(
    given: Sequence[str], models: Sequence[MorphModel], options: ClipOptions = AS_IT_IS
) -> list[FramedClip]:
    """Open the clips from which the models were built. Raises `BadInput` unless there is one for each."""
    _check_clips(len(given), len(models))
    return [framed_for(model, (clip,), None, options) for model, clip in zip(models, given, strict=True)]


def _check_clips(clips: int, models: int) -> None:
    """Raise `BadInput` if the clips are not one for each model."""
    if clips != models:
        raise BadInput(
            f"{clips} clips do not fit {models} models; expected {models}. Give the clip of each, in the order of the "
            "models"
        )


def _checked(model: MorphModel, clip: Clip) -> Originals:
    """Check that the clip holds the frames of the model."""
    known = dict(zip(clip.names, zip(range(len(clip.names)), clip.file_digests, strict=True), strict=True))
    inputs = model.provenance.get("inputs") or {}
    places = []
    for name in model.training.frame_names:
        if name not in known:
            raise BadInput(
                f"the clip of {len(clip.names)} frames from {clip.names[0]} has no frame {name}, from which the model "
                f"of {model.identity} was built. Give the clip it was built from"
            )
        place, digest = known[name]
        if digest != inputs.get(name):
            raise BadInput(
                f"frame {name} of the clip (SHA-256 {digest[:12]}...) is not the one the model of {model.identity} was "
                f"built from ({str(inputs.get(name))[:12]}...). Give the clip it was built from"
            )
        places.append(place)
    return Originals(model.for_person(clip.person), clip, tuple(places))
