"""Read a clip with a model: open it, encode its frames in order, and report changes that were made to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import Image, LoadingVector
from morphspace.errors import BadInput
from morphspace.face.faceframe import Frame, identity_affine
from morphspace.face.track import GivenPoints
from morphspace.io.clips import open_clip
from morphspace.io.flow_fields import write_flows
from morphspace.io.framing import MIN_SIDE_PX, FramedClip, Framing, check_person
from morphspace.io.images import picture_names, write_image
from morphspace.io.stimulus_sidecars import essentials_in
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset
from morphspace.requests import AS_IT_IS, ClipOptions
from morphspace.steps import in_order

# Times. Two real clips were reduced and encoded by models of 200 px width. Their first ten loadings correlated with
# those of the full frames: r .99 at 66 px, .98 at 50, .96 to .98 at 40, .88 to .96 at 32, .80 to .88 below.
ENLARGED_MUCH = 2.5
# Energy outside the model's space over its training variance: .2 for held-out frames of the same recording, 2.6 to 26
# for other people and for the same person on another day.
STRANGE = 1.0
LOST_NAMED = 3  # frames without a face that a note names


def _check_components(components: int | None) -> None:
    """Check that a number of components is at least 1. Raises `BadInput` otherwise."""
    if components is not None and components < 1:
        raise BadInput(f"components is {components}; expected at least 1")


def components_used(components: int | None, known: int, what: str) -> tuple[int, tuple[str, ...]]:
    """Return the number of components to use out of `known`, and a note if more were requested.

    As in a build, a number above `known` means all components; None means all as well.

    Examples
    --------
    >>> components_used(5, 20, "Ann")
    (5, ())
    >>> components_used(None, 20, "Ann")
    (20, ())
    """
    _check_components(components)
    if components is None or components <= known:
        return components or known, ()
    return known, (f"{components} components were requested; {what} has {known}, and all are used",)


def first_components(model: MorphModel, components: int | None) -> tuple[MorphModel, tuple[str, ...]]:
    """Return the model with its first `components` (None for all), and a note if it has fewer.

    Examples
    --------
    >>> import morphspace as ms
    >>> few, notes = first_components(ms.load("anna.morph"), 2)
    >>> few.rank, notes
    (2, ())
    """
    used, notes = components_used(components, model.rank, model.identity)
    return (model if used == model.rank else model.truncate(used)), notes


@dataclass(frozen=True, eq=False)
class EncodedFrame:
    """A frame aligned to the model's reference, its morph, and its loadings (one row)."""

    frame: Frame
    morph: Morph
    loadings: Loadings

    @property
    def lost(self) -> tuple[str, ...]:
        """The frame's name if its face was searched and not found, so that its flow is not held; else empty."""
        return (self.frame.name,) if self.frame.points is not None and not len(self.frame.points) else ()


def framed_for(
    model: MorphModel,
    sources: tuple[str, ...],
    crop: tuple[int, int, int, int] | None,
    options: ClipOptions = AS_IT_IS,
) -> FramedClip:
    """Open a clip for a model: scaled to its frame size, and cropped like the build's frames if their size is equal.

    Parameters
    ----------
    model : MorphModel
    sources : tuple of str
        Files or folders of the clip.
    crop : (x, y, w, h) px, optional
    options : ClipOptions
        As in `open_clip`.

    Raises
    ------
    BadInput
        If the pictures are too small for a face to be measured, or as `MorphModel.for_person` raises it.

    Examples
    --------
    >>> import morphspace as ms
    >>> clip = framed_for(ms.load("anna.morph"), ("anna",), None)
    >>> len(clip.names), clip.framing.size
    (12, (60, 72))
    """
    clip = open_clip(sources, options)
    built = model.provenance["framing"]
    if crop is None and list(clip.size) == built["source_size"] and built["crop"] is not None:
        x, y, w, h = built["crop"]
        crop = (x, y, w, h)
    framing = Framing(clip.size, crop, model.size)
    width, height = framing.box[2:]
    if min(width, height) < MIN_SIDE_PX:
        raise BadInput(
            f"pictures in {clip.name} are {width}x{height} px; expected at least {MIN_SIDE_PX} px a side, to measure a "
            f"face for frames of {model.identity} at {model.size[0]}x{model.size[1]}. Give larger pictures"
        )
    framed = FramedClip(clip, framing)
    check_person(framed)
    model.for_person(framed.person)
    return framed


def notes_on_framing(framing: Framing, identity: str, what: str = "frames") -> tuple[str, ...]:
    """Report in one line how frames were cropped and scaled to fit the model of `identity`; empty if they were not."""

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


def notes_on_frames(source: FramedClip, identity: str, what: str = "frames") -> tuple[str, ...]:
    """Report pictures that a clip passed over, a crop in which a face was chosen, and enlarged frames."""
    framing = source.framing
    person, crop = source.clip.person, framing.crop
    faces: tuple[str, ...] = ()
    if isinstance(person, str) and crop is not None:
        faces = (f"--person {person} chooses among the faces inside the crop {','.join(map(str, crop))}",)
    is_enlarged = framing.scaled_size[0] > framing.box[2]
    return source.clip.notes + faces + (notes_on_framing(framing, identity, what) if is_enlarged else ())


def energy_outside(offset: MorphOffset, model: MorphModel, inside: LoadingVector | None = None) -> float:
    """Compute the energy of an offset outside the model's space, in units of its training variance.

    Parameters
    ----------
    offset : MorphOffset
    model : MorphModel
    inside : array (k,), optional
        The offset's raw loadings, if known.

    Returns
    -------
    float
        Distance from the face space; see `STRANGE`. Infinite if the training faces do not vary.

    References
    ----------
    Moghaddam and Pentland, Probabilistic visual learning for object representation, IEEE PAMI 19 (1997).

    Examples
    --------
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> round(energy_outside(model.offset(model.training.values[0]), model), 3)
    0.0
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
    model: MorphModel,
    source: FramedClip,
    own: tuple[bool, ...] | None = None,
    given: GivenPoints | None = None,
) -> Iterator[EncodedFrame]:
    """Encode each frame of a clip, in order, a few at a time.

    Stimuli that the model itself rendered lie on its reference and are not aligned: registration would take a strong
    expression for head movement. `own` marks them; None looks them up with `drawn_by`. The loadings of
    frames that the model was built from (`rows_of_build`) are refined from those of the build, whose flow started from
    neighbouring frames. Frames with `given` face points, px of the frame, are not searched.

    Raises
    ------
    BadInput
        If points are given, and the model reads frames without them.

    Examples
    --------
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> first = next(encoded_frames(model, framed_for(model, ("anna",), None)))
    >>> first.loadings.unit
    'raw'
    """
    model = model.for_person(source.person)
    _ = model.flow_from_reference  # prepared once, before the threads start
    own = drawn_by(model, source) if own is None else own
    rows = rows_of_build(model, source)
    faces = {} if given is None else given.faces
    if given is not None and model.anchor is None:
        raise BadInput(
            f"--landmarks gives face points, but {model.identity} was built without. Leave it out, or build the model "
            "again after `morphspace models fetch`"
        )

    def encode(item: tuple[str, Image, bool, int | None]) -> EncodedFrame:
        name, image, is_own, row = item
        face = faces.get(name)
        if is_own:
            frame = Frame(image, name, identity_affine(), None if face is None else face.points)
        else:
            frame = model.align(image, name, face)
        morph = model.morph_of(frame)
        is_known = row is not None and face is None
        start = model.training.values[row] if is_known else model.project(morph)
        return EncodedFrame(frame, morph, model.fit(frame, start))

    indices = list(range(len(source.names)))
    yield from in_order(encode, zip(source.names, source.images(indices), own, rows, strict=True))


def rows_of_build(model: MorphModel, source: FramedClip) -> tuple[int | None, ...]:
    """Return the training row of each frame that the model was built from, None for each other frame.

    Such a frame has the same file, or the same place in the same video, the same framing, and no other person chosen.

    Examples
    --------
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> rows_of_build(model, framed_for(model, ("anna",), None))[:3]
    (0, 1, 2)
    """
    inputs, built, framing = model.provenance.get("inputs"), model.provenance.get("framing"), source.framing
    crop = None if framing.crop is None else list(framing.crop)
    alike = {"source_size": list(framing.source_size), "size": list(framing.size), "crop": crop}
    if not inputs or not built or source.person is not None or {**built, **alike} != built:
        return (None,) * len(source.names)
    places = {name: row for row, name in enumerate(model.training.frame_names) if name in inputs}
    by_digest = {inputs[name]: row for name, row in reversed(places.items())}
    return tuple(
        places[name] if name in places and inputs[name] == digest else by_digest.get(digest)
        for name, digest in zip(source.names, source.file_digests, strict=True)
    )


def drawn_by(model: MorphModel, source: FramedClip) -> tuple[bool, ...]:
    """Return for each frame whether this model rendered it at its own size, by the metadata of its file.

    Examples
    --------
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> any(drawn_by(model, framed_for(model, ("anna",), None)))
    False
    """
    framing = source.framing
    if framing.crop is not None or framing.size != framing.source_size or framing.size != model.size:
        return (False,) * len(source.names)
    described = {path: essentials_in(path) for path in dict.fromkeys(source.clip.paths)}
    own = {
        path: found is not None and found.get("model_id") == model.model_id and found.get("verb") != "place"
        for path, found in described.items()
    }
    if len(source.clip.paths) != len(source.names):  # one video
        return (all(own.values()),) * len(source.names)
    return tuple(own[path] for path in source.clip.paths)


def notes_on_own(own: tuple[bool, ...]) -> tuple[str, ...]:
    """Report the number of frames that were not aligned because the model rendered them; `own` as from `drawn_by`."""
    count = sum(own)
    return (f"{count} frames were rendered by this model and are not aligned",) if count else ()


def notes_on_lost(lost: Sequence[str], frames: int) -> tuple[str, ...]:
    """Report in one line the frames without a face (`EncodedFrame.lost`), of so many.

    Examples
    --------
    >>> notes_on_lost(["0003", "0007"], 24)
    ('no face was found in 2 of 24 frames (0003, 0007): their flow is not held to it',)
    """
    shown = ", ".join(lost[:LOST_NAMED]) + (", ..." if len(lost) > LOST_NAMED else "")
    if not lost:
        return ()
    return (f"no face was found in {len(lost)} of {frames} frames ({shown}): their flow is not held to it",)


def joined(model: MorphModel, parts: list[Loadings]) -> Loadings:
    """Stack single rows of loadings, (n, k).

    Examples
    --------
    >>> import morphspace as ms
    >>> model = ms.load("anna.morph")
    >>> joined(model, [model.training[0], model.training[2]]).frame_names
    ('frame_000', 'frame_002')
    """
    values = np.concatenate([part.values for part in parts]) if parts else np.zeros((0, model.rank))
    return Loadings(values, tuple(name for part in parts for name in part.frame_names), model.model_id)


def morph_files(folder: Path, names: Sequence[str]) -> list[tuple[Path, Path]]:
    """Return the files of each frame's texture (.exr) and warp (.flo) in a folder.

    Raises
    ------
    BadInput
        As `picture_names`.

    Examples
    --------
    >>> [(texture.name, field.name) for texture, field in morph_files(Path("morphs"), ["smile/0001"])]
    [('smile_0001.exr', 'smile_0001.flo')]
    """
    stems = [name.removesuffix(".png") for name in picture_names(names)]
    return [(folder / f"{stem}.exr", folder / f"{stem}.flo") for stem in stems]


def write_morph(morph: Morph, texture: Path, field: Path) -> None:
    """Write a morph's texture as `.exr`, in linear light, and its warp as `.flo`, px, both on the mean face's grid.

    Raises
    ------
    UnwritableFile
        If the folder or disk refuses a file.

    Examples
    --------
    >>> import morphspace as ms
    >>> from morphspace.io.flow_fields import read_flow
    >>> write_morph(ms.load("anna.morph").mean, Path("mean.exr"), Path("mean.flo"))
    >>> read_flow("mean.flo").displacement.shape
    (72, 60, 2)
    """
    write_image(texture, morph.texture)
    write_flows({field: (morph.displacement, np.ones(morph.shape, np.float32))})
