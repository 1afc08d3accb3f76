"""What verbs that read a clip with a model share: opening it, encoding its frames in order, and what to say of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import Image, LoadingVector
from morphspace.errors import BadInput
from morphspace.face.faceframe import Frame, identity_affine
from morphspace.io.clips import open_clip
from morphspace.io.framing import MIN_SIDE_PX, FramedClip, Framing
from morphspace.io.stimulus_sidecars import essentials_in
from morphspace.model.model import Loadings, MorphModel
from morphspace.model.morph import Morph, MorphOffset
from morphspace.steps import in_order

# Two real clips made smaller, read by models of 200 px width, first ten loadings against those of the full frames:
# r .98 at 50 px and .99 at 66, .96 to .98 at 40, .88 to .96 at 32, .80 to .88 below.
ENLARGED_MUCH = 2.5
# Energy that frames leave outside a model's space, over the variance of its training faces: .2 of frames of the same
# recording that were held out, 2.6 to 26 of other people and of the same person on another day.
STRANGE = 1.0


def check_components(components: int | None) -> None:
    """Raise `BadInput` where fewer than one component is asked for."""
    if components is not None and components < 1:
        raise BadInput(f"{components} components were asked for: ask for at least 1")


def components_used(components: int | None, known: int, what: str) -> tuple[int, tuple[str, ...]]:
    """Give how many components are used of those that are `known`, and a note where more were asked for.

    As in a build, so many are the most: who wants all of them need not know their number.
    """
    check_components(components)
    if components is None or components <= known:
        return components or known, ()
    return known, (f"{components} components were asked for, {what} has {known}: all of them are used",)


def first_components(model: MorphModel, components: int | None) -> tuple[MorphModel, tuple[str, ...]]:
    """Give the model with its first so many components, None for all, and a note where it has fewer."""
    used, notes = components_used(components, model.rank, model.identity)
    return (model if used == model.rank else model.truncate(used)), notes


@dataclass(frozen=True, eq=False)
class EncodedFrame:
    """A frame aligned to the model's reference, its morph as the flow saw it, and its loadings (one row)."""

    frame: Frame
    morph: Morph
    loadings: Loadings


def framed_for(
    model: MorphModel, sources: tuple[str, ...], crop: tuple[int, int, int, int] | None
) -> FramedClip:
    """Open a clip for a model: scaled to its frames, and cropped as its own frames were where the size is the same.

    Raises `BadInput` for pictures smaller than a face can be read from.
    """
    clip = open_clip(sources)
    built = model.provenance["framing"]
    if crop is None and list(clip.size) == built["source_size"] and built["crop"] is not None:
        x, y, w, h = built["crop"]
        crop = (x, y, w, h)
    framing = Framing(clip.size, crop, model.size)
    width, height = framing.box[2:]
    if min(width, height) < MIN_SIDE_PX:
        raise BadInput(
            f"pictures of {width}x{height} in {clip.name} are too small to read a face from, the frames of "
            f"{model.identity} are {model.size[0]}x{model.size[1]}: give at least {MIN_SIDE_PX} px a side"
        )
    return FramedClip(clip, framing)


def notes_on_framing(framing: Framing, identity: str, what: str = "frames") -> tuple[str, ...]:
    """Say in one line what was done to frames so that they fit the model of `identity`, where anything was."""

    def size(wide: int, high: int) -> str:
        return f"{wide}x{high}"

    times = framing.scaled_size[0] / framing.box[2]
    done = []
    if framing.crop is not None:
        done.append(f"cropped to {size(*framing.box[2:])} at {framing.box[0]},{framing.box[1]}")
    if framing.scaled_size != framing.box[2:]:
        how = "enlarged" if times > 1 else "scaled"
        done.append(f"{how} to {size(*framing.scaled_size)}")
    if any(framing.cut_off):
        done.append(f"cropped to the middle {size(*framing.size)}")
    if not done:
        return ()
    *first, last = done
    steps = f"{', '.join(first)} and {last}" if first else last
    lost = (
        f": {times:.1f} times, and small motions are lost; give larger pictures"
        if times > ENLARGED_MUCH
        else ""
    )
    return (
        f"{what} of {size(*framing.source_size)} are {steps}, as the frames of {identity} are {size(*framing.size)}"
        f"{lost}",
    )


def notes_on_enlarging(framing: Framing, identity: str, what: str = "frames") -> tuple[str, ...]:
    """Say the same only where frames were made larger, which no size of theirs can make good."""
    return notes_on_framing(framing, identity, what) if framing.scaled_size[0] > framing.box[2] else ()


def energy_outside(offset: MorphOffset, model: MorphModel, inside: LoadingVector | None = None) -> float:
    """Give the energy of an offset that a model's components cannot show, in variances of its training faces.

    The distance from the space (Moghaddam and Pentland 1997); see `STRANGE`. `inside` (k,) are the offset's loadings,
    read from it where None.
    """
    basis = model.basis
    values = offset.vector
    if inside is None:
        inside = basis.project(values)
    whole = float((basis.weight * values * values).sum(dtype=np.float64))
    variance = float(basis.variances.sum() + basis.discarded_variance)
    held = float(inside @ inside)  # the components are orthonormal
    return max(whole - held, 0.0) / variance if variance > 0 else np.inf


def encoded_frames(
    model: MorphModel, source: FramedClip, own: tuple[bool, ...] | None = None
) -> Iterator[EncodedFrame]:
    """Encode each frame of the clip, in order, a few at a time.

    What the model has drawn itself (`own`, looked up by `drawn_by` where None) lies on its reference already and is
    not moved: a strong expression would be taken for a movement of the head.
    """
    flow = model.flow_from_reference  # prepared here, once, and not by each thread
    own = drawn_by(model, source) if own is None else own

    def encode(item: tuple[str, Image, bool]) -> EncodedFrame:
        name, image, is_own = item
        frame = Frame(image, name, identity_affine()) if is_own else model.align(image, name)
        morph = model.morph_of(frame.image, flow)
        return EncodedFrame(frame, morph, model.fit(frame, morph))

    indices = list(range(len(source.names)))
    yield from in_order(encode, zip(source.names, source.images(indices), own, strict=True))


def drawn_by(model: MorphModel, source: FramedClip) -> tuple[bool, ...]:
    """Tell which frames are stimuli that this model has drawn on its own frame, by what stands in their files."""
    framing = source.framing
    if framing.crop is not None or framing.size != framing.source_size or framing.size != model.size:
        return (False,) * len(source.names)
    told = {path: essentials_in(path) for path in dict.fromkeys(source.clip.paths)}
    own = {
        path: found is not None and found.get("model_id") == model.model_id and found.get("verb") != "place"
        for path, found in told.items()
    }
    if len(source.clip.paths) != len(source.names):  # one video
        return (all(own.values()),) * len(source.names)
    return tuple(own[path] for path in source.clip.paths)


def notes_on_own(own: tuple[bool, ...]) -> tuple[str, ...]:
    """Say how many frames were not aligned, since the model has drawn them itself; `own` as `drawn_by` gives it."""
    count = sum(own)
    return (f"{count} frames are this model's own pictures, and are read without alignment",) if count else ()


def joined(model: MorphModel, parts: list[Loadings]) -> Loadings:
    """Put single rows of loadings together, (n, k)."""
    values = np.concatenate([part.values for part in parts]) if parts else np.zeros((0, model.rank))
    return Loadings(values, tuple(name for part in parts for name in part.frame_names), model.model_id)
