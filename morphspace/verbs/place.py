"""place: rendered faces put back into the frames they came from; hair, background and size of the picture stay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from morphspace.requests import (
    Clip,
    Folder,
    FrameCrop,
    FrameRate,
    Frames,
    Model,
    VideoOrPictures,
    declared,
)
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.arrays import AnyArray
    from morphspace.io.clips import Clip as OpenClip
    from morphspace.io.framing import FramedClip
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.planned import PlannedSet
    from morphspace.steps import Steps

RIGHTS = ("consent", "licence")


@declared
class PlaceRequest:
    """Put faces of MODEL back into the frames of CLIP: hair, background and size of the picture stay."""

    model: Model
    clip: Clip
    output: Folder
    loadings: Annotated[
        Path | None,
        Option(metavar="TABLE.csv"),
        Help("Faces to put there, rows named after the frames [default: the frames' own]."),
    ] = None
    gain: Annotated[float, Help("Multiply all loadings.")] = 1.0
    frames: Frames = ()
    video: VideoOrPictures = None
    frame_rate_hz: FrameRate = None
    crop: FrameCrop = None


def run(request: PlaceRequest) -> Steps[Outcome]:
    """Write the set of stimuli. Returns an `Outcome`."""
    from morphspace.sets.complete import write_set

    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: PlaceRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read, align and check everything, draw nothing; `model` where it is open already. Returns a `PlannedSet`."""
    import numpy as np

    from morphspace.io.stimulus_sidecars import ORIGINAL_IDENTITY
    from morphspace.io.tables import read_loadings_table
    from morphspace.model.encode import framed_for, notes_on_enlarging
    from morphspace.model.model import load_model
    from morphspace.sets.kept import digest_of_kept, encoded_clip
    from morphspace.sets.manifest import Column
    from morphspace.sets.planned import plan_of
    from morphspace.sets.sources import FRAME_RATE_HZ, Faces, check_frames, notes_on_identity
    from morphspace.stimuli.caricature import caricatured
    from morphspace.stimuli.drawing import Drawing, Placing
    from morphspace.stimuli.table_checks import check_reach, check_table

    model = model or load_model(request.model)
    source = framed_for(model, request.clip, request.crop)
    inputs, notes = {}, notes_on_enlarging(source.framing, model.identity)
    if request.loadings is None:
        source = _chosen(source, request.frames or source.names)
        loadings, registrations = yield from encoded_clip(model, source)
        loadings_sd = loadings.in_sd(model).values
    else:
        table = read_loadings_table(request.loadings)
        notes = check_table(model, table, request.loadings) + notes
        wanted = request.frames or table.frame_names
        check_frames(wanted, table.frame_names, str(request.loadings))
        source = _chosen(source, wanted)
        rows = [table.frame_names.index(name) for name in source.names]
        loadings_sd = np.asarray(table.loadings_sd[rows])
        registrations = yield from _aligned(model, source)
        inputs["loadings"] = digest_of_kept(request.loadings)
    loadings_sd = caricatured(loadings_sd, request.gain)
    check_reach(loadings_sd, source.names, request.loadings or Path(source.clip.name))
    digests = source.file_digests
    inputs |= {f"clip/{name}": digest for name, digest in zip(source.names, digests, strict=True)}
    notes += notes_on_identity(model, source.clip)
    shown = source.clip.sidecar.identity
    rate = request.frame_rate_hz or source.clip.sidecar.frame_rate_hz
    rate = rate or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
    faces = Faces(source.clip.name, source.names, loadings_sd, float(rate), inputs)
    drawings = [
        Drawing(
            name,
            loadings_sd[rows],
            frame_rate_hz=None if request.video is None else faces.frame_rate_hz,
            suffix=request.video or ".png",
            placing=Placing(source.names[rows], digests[rows], registrations[rows], request.clip),
            told={
                "gain": float(request.gain),
                "original": source.names[rows][0] if request.video is None else name,
                **({} if shown is None else {ORIGINAL_IDENTITY: shown}),
            },
        )
        for name, rows in faces.stimuli(request.video)
    ]
    rights = _rights(model, source.clip)
    columns = {ORIGINAL_IDENTITY: Column("Whose pictures the faces were put back into, as the clip says")}
    return plan_of(
        request, "place", model, drawings, inputs=inputs, notes=notes, columns=columns, rights=rights
    )


def _rights(model: MorphModel, clip: OpenClip) -> dict[str, Any]:
    """Give consent and licence of what a stimulus shows: the face is the model's, the rest of the picture the clip's.

    Where they differ each says whose it is; the clip's are named as the clip where it shows the same person.
    """
    from morphspace.avatar.build import told_together

    told = clip.sidecar.identity
    other = told if told not in (None, model.identity) else f"the clip {clip.name}"
    labels = (model.identity, str(other))
    found = {}
    for key in RIGHTS:
        of_model, of_clip = model.provenance.get(key), getattr(clip.sidecar, key)
        if of_clip is None and told == model.identity:
            of_clip = of_model
        found[key] = told_together(labels, [of_model, of_clip])
    return found


def _chosen(source: FramedClip, frames: tuple[str, ...]) -> FramedClip:
    """Give the clip of these frames, in its own order. Raises `BadInput` where one is not there."""
    from morphspace.sets.sources import check_frames

    check_frames(frames, source.names, source.clip.name)
    wanted = set(frames)
    places = [place for place, name in enumerate(source.names) if name in wanted]
    return replace(source, clip=source.clip.subset(places))


def _aligned(model: MorphModel, source: FramedClip) -> Steps[AnyArray]:
    """Give where the faces are in their frames, (n, 2, 3), without reading their expressions."""
    import numpy as np

    from morphspace.grid import warp
    from morphspace.steps import Step, in_order

    registrations: list[AnyArray] = []
    indices = list(range(len(source.names)))
    items = zip(source.names, source.images(indices), strict=True)
    for frame in in_order(lambda item: model.align(item[1], item[0]), items):
        registrations.append(warp.chain_affine(source.to_source, frame.registration))
        yield Step("align", len(registrations), len(indices))
    return np.stack(registrations)
