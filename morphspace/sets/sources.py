"""Read the faces of a stimulus verb: rows of a table of loadings, or encoded frames of a clip (ours)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.avatar.build import joint_entry
from morphspace.errors import BadInput
from morphspace.io.clips import Clip
from morphspace.io.clock import evenly_sampled
from morphspace.io.framing import FramedClip
from morphspace.io.names import UNFIT
from morphspace.io.tables import read_loadings_table
from morphspace.model.encode import framed_for, notes_on_frames
from morphspace.model.model import MorphModel
from morphspace.requests import AS_IT_IS, ClipOptions, check_no_options
from morphspace.sets.kept import digest_of_kept, encoded_clip
from morphspace.sets.plan import KEPT_STEMS
from morphspace.steps import Steps
from morphspace.stimuli.table_checks import check_table

FRAME_RATE_HZ = 25.0  # Hz; used if neither request, table nor model has a frame rate
LISTED = 3  # names listed in a message
RIGHTS = ("consent", "licence")


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces to start from.

    Attributes
    ----------
    name
        Name of the table or clip.
    names
        n names of the rows.
    loadings_sd
        (n, k), SD.
    frame_rate_hz
        Frame rate of the rows.
    inputs
        Source files, name to SHA-256.
    times_s
        The times of the rows (n,), s, if they are a recording that has them.
    """

    name: str
    names: tuple[str, ...]
    loadings_sd: LoadingTable
    frame_rate_hz: float
    inputs: Mapping[str, str]
    notes: tuple[str, ...] = ()
    times_s: Sequence[float] | AnyArray | None = None

    def for_video(self, video: str | None) -> Faces:
        """Return the faces as the frames of a video, at even times; unchanged for pictures (`video` None)."""
        values, notes = evenly_sampled(self.name, self.loadings_sd, self.times_s, self.frame_rate_hz)
        if video is None or not notes:
            return self
        names = tuple(f"{self.name}_{row:06d}" for row in range(len(values)))
        return replace(self, names=names, loadings_sd=values, notes=(*self.notes, *notes), times_s=None)

    def stimuli(self, video: str | None) -> list[tuple[str, slice]]:
        """Return the stimuli: each row by itself, or all rows as one motion if a `video` suffix is given."""
        if video is None:
            return [(name, slice(row, row + 1)) for row, name in enumerate(file_names(self.names))]
        return [(motion_name(self.name), slice(None))]


def notes_on_identity(model: MorphModel, clip: Clip) -> tuple[str, ...]:
    """Note if a clip shows another person than the model."""
    identity = clip.sidecar.identity
    if identity is None or identity == model.identity:
        return ()
    return (
        f"the clip {clip.name} shows {identity}, the model shows {model.identity}: check that this is intended",
    )


def rights_of(model: MorphModel, clip: Clip) -> dict[str, Any]:
    """Return consent and licence of a stimulus: the face is the model's, the surrounding picture the clip's.

    If they differ, each is listed with its person; for the same person the clip's entry is listed under the clip's
    name.
    """
    identity = clip.sidecar.identity
    other = identity if identity not in (None, model.identity) else f"the clip {clip.name}"
    labels = (model.identity, str(other))
    found = {}
    for key in RIGHTS:
        of_model, of_clip = model.provenance.get(key), getattr(clip.sidecar, key)
        if of_clip is None and identity == model.identity:
            of_clip = of_model
        found[key] = joint_entry(labels, [of_model, of_clip])
    return found


def motion_name(name: str) -> str:
    """Convert the name of a table or clip to a file name; `motion` if a set reserves that name."""
    (word,) = file_names([name])
    return "motion" if word.casefold() in KEPT_STEMS else word


def file_names(names: Sequence[str]) -> tuple[str, ...]:
    """Convert frame names to file names: folders and invalid characters become underscores."""
    return tuple(UNFIT.sub("_", name.replace("/", "_")).strip(". ") or "_" for name in names)


def faces_of(
    model: MorphModel,
    table: Path | None,
    clip: tuple[str, ...] = (),
    frames: tuple[str, ...] = (),
    crop: tuple[int, int, int, int] | None = None,
    options: ClipOptions = AS_IT_IS,
) -> Steps[Faces]:
    """Read the faces of a table, or encode those of a clip.

    Parameters
    ----------
    frames
        Names of the selected frames; empty for all.
    crop
        (x, y, w, h) px, cut out of the clip's pictures first.
    options
        How the clip is read; of a table only the frame rate, None for that of the table, clip or model.

    Raises
    ------
    BadInput
        If neither or both of table and clip are given, a frame is missing, or a table has options of clips.
    """
    if (table is None) == (not clip):
        given = "neither was given" if table is None else "both were given"
        raise BadInput(f"the faces come from a table (--loadings) or a clip (--clip); {given}. Give one")
    if table is None:
        faces = yield from _of_clip(model, clip, frames, crop, options)
    else:
        check_no_options(options, f"{table} is a table", "frame_rate_hz")
        faces = _at_rate(_of_table(model, table), options.frame_rate_hz)
    return _chosen(faces, frames)


def _at_rate(faces: Faces, rate_hz: float | None) -> Faces:
    """Show the frames faster or slower; None leaves them as they are."""
    if rate_hz is None:
        return faces
    times_s = None if faces.times_s is None else np.asarray(faces.times_s) * (faces.frame_rate_hz / rate_hz)
    return replace(faces, frame_rate_hz=rate_hz, times_s=times_s)


def _of_table(model: MorphModel, path: Path) -> Faces:
    table = read_loadings_table(path)
    notes = check_table(model, table, path)
    if not table.frame_names:
        raise BadInput(f"{path} has 0 rows; expected at least one. Give a table with loadings")
    rate = table.rate_hz or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
    return Faces(
        path.stem,
        table.frame_names,
        table.loadings_sd,
        float(rate),
        {"loadings": digest_of_kept(path)},
        notes,
        table.times_s,
    )


def _of_clip(
    model: MorphModel,
    sources: tuple[str, ...],
    frames: tuple[str, ...],
    crop: tuple[int, int, int, int] | None,
    options: ClipOptions,
) -> Steps[Faces]:
    source = framed_for(model, sources, crop, options)
    if frames:
        places = [row for row, name in enumerate(source.names) if name in set(frames)]
        if len(places) < len(set(frames)):
            check_frames(frames, source.names, source.clip.name)
        source = replace(source, clip=source.clip.subset(places))
    loadings, _ = yield from encoded_clip(model, source)
    rate = source.clip.sidecar.frame_rate_hz or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
    inputs = {f"clip/{name}": digest for name, digest in zip(source.names, source.file_digests, strict=True)}
    notes = notes_on_frames(source, model.identity)
    notes += notes_on_identity(model, source.clip)
    values = loadings.in_sd(model).values
    return Faces(source.clip.name, source.names, values, float(rate), inputs, notes, source.clip.times_s)


def _chosen(faces: Faces, frames: tuple[str, ...]) -> Faces:
    if not frames:
        return faces
    check_frames(frames, faces.names, faces.name)
    places = [faces.names.index(name) for name in frames]
    return replace(faces, names=frames, loadings_sd=np.asarray(faces.loadings_sd[places]), times_s=None)


def frames_of(source: FramedClip, frames: tuple[str, ...]) -> FramedClip:
    """Select frames of a clip, in the clip's order. Raises `BadInput` if one is missing."""
    check_frames(frames, source.names, source.clip.name)
    wanted = set(frames)
    places = [place for place, name in enumerate(source.names) if name in wanted]
    return replace(source, clip=source.clip.subset(places))


def check_frames(frames: Sequence[str], names: Sequence[str], where: str) -> None:
    """Check that each requested frame exists and is requested once. Raises `BadInput` otherwise."""
    for frame in frames:
        if frame not in names:
            listed = ", ".join(names[:LISTED])
            raise BadInput(
                f"{where} has no frame {frame!r}; expected one of its {len(names)}, such as {listed}"
            )
        if list(frames).count(frame) > 1:
            raise BadInput(f"the frame {frame!r} was given twice. Give each once")
