"""The faces a stimulus verb starts from: rows of a table of loadings, or the frames of a clip, encoded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import LoadingTable
from morphspace.avatar.build import told_together
from morphspace.errors import BadInput
from morphspace.io.clips import Clip
from morphspace.io.framing import FramedClip
from morphspace.io.tables import read_loadings_table
from morphspace.model.encode import framed_for, notes_on_enlarging
from morphspace.model.model import MorphModel
from morphspace.sets.kept import digest_of_kept, encoded_clip
from morphspace.sets.planned import KEPT_STEMS
from morphspace.steps import Steps
from morphspace.stimuli.drawing import UNFIT
from morphspace.stimuli.table_checks import check_table

FRAME_RATE_HZ = 25.0  # where neither the request, the table nor the model tells it
LISTED = 3  # names a message gives before it stops
RIGHTS = ("consent", "licence")


@dataclass(frozen=True, eq=False)
class Faces:
    """Rows to start from: `names`, `loadings_sd` (n, k) SD, what they are called together, the rate in Hz, and where
    they came from (`inputs`, name to SHA-256).
    """

    name: str
    names: tuple[str, ...]
    loadings_sd: LoadingTable
    frame_rate_hz: float
    inputs: Mapping[str, str]
    notes: tuple[str, ...] = ()

    def stimuli(self, video: str | None) -> list[tuple[str, slice]]:
        """Give the stimuli: each row by itself, or all rows as one motion where a `video` suffix is given."""
        if video is None:
            return [(name, slice(row, row + 1)) for row, name in enumerate(file_names(self.names))]
        return [(motion_name(self.name), slice(None))]


def notes_on_identity(model: MorphModel, clip: Clip) -> tuple[str, ...]:
    """Say where a clip says that it shows somebody else than the model does."""
    told = clip.sidecar.identity
    if told is None or told == model.identity:
        return ()
    return (
        f"the clip {clip.name} shows {told}, the model shows {model.identity}: make sure that this is meant",
    )


def rights_of(model: MorphModel, clip: Clip) -> dict[str, Any]:
    """Give consent and licence of what a stimulus shows: the face is the model's, the rest of the picture the clip's.

    Where they differ each says whose it is; the clip's are named as the clip where it shows the same person.
    """
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


def motion_name(name: str) -> str:
    """Give the name of a table or clip as that of a file, `motion` where a set has a file of its own called so."""
    (word,) = file_names([name])
    return "motion" if word.casefold() in KEPT_STEMS else word


def file_names(names: Sequence[str]) -> tuple[str, ...]:
    """Give names of frames as names of files: folders joined by underscores, as is what no file can be called."""
    return tuple(UNFIT.sub("_", name.replace("/", "_")).strip(". ") or "_" for name in names)


def faces_of(
    model: MorphModel,
    table: Path | None,
    clip: tuple[str, ...] = (),
    frames: tuple[str, ...] = (),
    crop: tuple[int, int, int, int] | None = None,
    frame_rate_hz: float | None = None,
) -> Steps[Faces]:
    """Read the faces of a table or encode those of a clip; `frames` names the ones wanted, none for all.

    Raises `BadInput` where neither or both are given, or a frame is not there.
    """
    if (table is None) == (not clip):
        given = "neither was given" if table is None else "both were given"
        raise BadInput(
            f"the faces to start from are a table (--loadings) or a clip (--clip), {given}: give one"
        )
    check_rate(frame_rate_hz)
    faces = _of_table(model, table) if table is not None else (yield from _of_clip(model, clip, frames, crop))
    if frame_rate_hz is not None:
        faces = Faces(faces.name, faces.names, faces.loadings_sd, frame_rate_hz, faces.inputs, faces.notes)
    return _chosen(faces, frames)


def _of_table(model: MorphModel, path: Path) -> Faces:
    table = read_loadings_table(path)
    notes = check_table(model, table, path)
    if not table.frame_names:
        raise BadInput(f"{path} has no rows: nothing to draw")
    rate = (
        (table.document or {}).get("frame_rate_hz") or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
    )
    return Faces(
        path.stem,
        table.frame_names,
        table.loadings_sd,
        float(rate),
        {"loadings": digest_of_kept(path)},
        notes,
    )


def _of_clip(
    model: MorphModel,
    sources: tuple[str, ...],
    frames: tuple[str, ...],
    crop: tuple[int, int, int, int] | None,
) -> Steps[Faces]:
    source = framed_for(model, sources, crop)
    if frames:
        places = [row for row, name in enumerate(source.names) if name in set(frames)]
        if len(places) < len(set(frames)):
            check_frames(frames, source.names, source.clip.name)
        source = type(source)(source.clip.subset(places), source.framing)
    loadings, _ = yield from encoded_clip(model, source)
    rate = source.clip.sidecar.frame_rate_hz or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
    inputs = {f"clip/{name}": digest for name, digest in zip(source.names, source.file_digests, strict=True)}
    notes = notes_on_enlarging(source.framing, model.identity)
    notes += notes_on_identity(model, source.clip)
    return Faces(source.clip.name, source.names, loadings.in_sd(model).values, float(rate), inputs, notes)


def _chosen(faces: Faces, frames: tuple[str, ...]) -> Faces:
    if not frames:
        return faces
    check_frames(frames, faces.names, faces.name)
    places = [faces.names.index(name) for name in frames]
    return Faces(
        faces.name,
        frames,
        np.asarray(faces.loadings_sd[places]),
        faces.frame_rate_hz,
        faces.inputs,
        faces.notes,
    )


def frames_of(source: FramedClip, frames: tuple[str, ...]) -> FramedClip:
    """Give the clip of these frames, in its own order. Raises `BadInput` where one is not there."""
    check_frames(frames, source.names, source.clip.name)
    wanted = set(frames)
    places = [place for place, name in enumerate(source.names) if name in wanted]
    return replace(source, clip=source.clip.subset(places))


def check_frames(frames: Sequence[str], names: Sequence[str], where: str) -> None:
    """Raise `BadInput` where a frame that was asked for is not there, or is asked for twice."""
    for frame in frames:
        if frame not in names:
            listed = ", ".join(names[:LISTED])
            raise BadInput(
                f"{where} has no frame {frame!r}: its frames are {listed} and so on ({len(names)} in all)"
            )
        if list(frames).count(frame) > 1:
            raise BadInput(f"the frame {frame!r} was given twice: give each once")


def check_rate(frame_rate_hz: float | None) -> None:
    """Raise `BadInput` for a frame rate no video has."""
    if frame_rate_hz is not None and not 0 < frame_rate_hz <= 1000:
        raise BadInput(f"a frame rate of {frame_rate_hz:g} Hz cannot be used: give one above 0, at most 1000")
