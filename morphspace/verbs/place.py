"""place: put rendered faces back into their original frames; hair, background and picture size stay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import (
    Clip,
    ClipOptions,
    Folder,
    FrameCrop,
    Frames,
    Model,
    VideoOrPictures,
    clip_options,
    declared_with,
)
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.sets.plan import PlannedSet
    from morphspace.steps import Steps


@declared_with(ClipOptions)
class PlaceRequest:
    """Put faces of MODEL back into the frames of CLIP; hair, background and picture size stay."""

    model: Model
    clip: Clip
    output: Folder
    loadings: Annotated[
        Path | None,
        Option(metavar="TABLE.csv"),
        Help("Table of the faces, rows named after the frames [default: the frames' own faces]."),
    ] = None
    gain: Annotated[float, Help("Factor on all loadings.")] = 1.0
    frames: Frames = ()
    video: VideoOrPictures = None
    crop: FrameCrop = None


def run(request: PlaceRequest) -> Steps[Outcome]:
    """Write the set of stimuli."""
    from morphspace.sets.stimulus_set import write_set

    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: PlaceRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read, align and check all inputs without drawing; `model` is the open model, or None."""
    import numpy as np

    from morphspace.io.clock import frames_shown, is_even, uneven_words
    from morphspace.io.stimulus_sidecars import ORIGINAL_IDENTITY
    from morphspace.io.tables import read_loadings_table
    from morphspace.model.encode import framed_for, notes_on_frames
    from morphspace.model.model import load_model
    from morphspace.sets.kept import aligned_clip, digest_of_kept, encoded_clip
    from morphspace.sets.manifest import Column
    from morphspace.sets.plan import plan_of
    from morphspace.sets.sources import (
        FRAME_RATE_HZ,
        Faces,
        check_frames,
        frames_of,
        notes_on_identity,
        rights_of,
    )
    from morphspace.stimuli.caricature import caricatured
    from morphspace.stimuli.drawing import Drawing, Placing
    from morphspace.stimuli.table_checks import check_reach, check_table

    model = model or load_model(request.model)
    options = clip_options(request)
    source = framed_for(model, request.clip, request.crop, options)
    inputs, notes = {}, notes_on_frames(source, model.identity)
    if request.loadings is None:
        source = frames_of(source, request.frames or source.names)
        loadings, registrations = yield from encoded_clip(model, source)
        loadings_sd = loadings.in_sd(model).values
    else:
        table = read_loadings_table(request.loadings)
        notes = check_table(model, table, request.loadings) + notes
        wanted = request.frames or table.frame_names
        check_frames(wanted, table.frame_names, str(request.loadings))
        source = frames_of(source, wanted)
        rows = [table.frame_names.index(name) for name in source.names]
        loadings_sd = np.asarray(table.loadings_sd[rows])
        registrations = yield from aligned_clip(model, source)
        inputs["loadings"] = digest_of_kept(request.loadings)
    loadings_sd = caricatured(loadings_sd, request.gain)
    check_reach(loadings_sd, source.names, request.loadings or Path(source.clip.name))
    digests = source.file_digests
    inputs |= {f"clip/{name}": digest for name, digest in zip(source.names, digests, strict=True)}
    notes += notes_on_identity(model, source.clip)
    identity = source.clip.sidecar.identity
    clock = (source.clip.times_s, source.clip.sidecar.frame_rate_hz)
    names = source.names
    if request.video is not None and not is_even(*clock):
        notes += (
            uneven_words(source.clip.name, clock[0] or (), "the video shows the nearest frame at each time"),
        )
        shown = frames_shown(len(names), *clock)
        loadings_sd, registrations = loadings_sd[shown], registrations[shown]
        names, digests = (tuple(each[place] for place in shown) for each in (names, digests))
    rate = clock[1] or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
    faces = Faces(source.clip.name, names, loadings_sd, float(rate), inputs)
    drawings = [
        Drawing(
            name,
            loadings_sd[rows],
            frame_rate_hz=None if request.video is None else faces.frame_rate_hz,
            suffix=request.video or ".png",
            placing=Placing(
                names[rows], digests[rows], registrations[rows], request.clip, replace(options, person=None)
            ),
            variables={
                "gain": float(request.gain),
                "original": names[rows][0] if request.video is None else name,
                **({} if identity is None else {ORIGINAL_IDENTITY: identity}),
            },
        )
        for name, rows in faces.stimuli(request.video)
    ]
    rights = rights_of(model, source.clip)
    columns = {ORIGINAL_IDENTITY: Column("Whose pictures the faces were put back into, as the clip says")}
    return plan_of(
        request, "place", model, drawings, inputs=inputs, notes=notes, columns=columns, rights=rights
    )
