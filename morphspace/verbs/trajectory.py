"""trajectory: recorded motion as data: smoothed, retimed, joined, looped, averaged, caricatured, scrambled, drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.sidecars import read_json_object
from morphspace.io.tables import LOADINGS_FORMAT, write_loadings_table
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome, versions
from morphspace.requests import VIDEO_SUFFIXES, request_document
from morphspace.sets.complete import write_set
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.motions import COLUMNS, MadeMotions, made_motions, told_of
from morphspace.sets.planned import PlannedSet, plan_of
from morphspace.sets.protect import check_file
from morphspace.sets.sources import motion_name
from morphspace.steps import Steps
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import make_folder


@dataclass(frozen=True)
class TrajectoryRequest:
    """Do `operations` to the motions of `tables` (loadings on `model`), and draw them into the folder `output`.

    Operations are words with numbers (`smooth=6`, `loop`) or mappings (`{"smooth": 6}`); see `stimuli.motion_words`. An
    output ending in .csv gets the new table alone. `guide` is the table whose timing is taken, or the mean trajectory
    that a single table is compared with | `frame_rate_hz` of the tables, None for what they tell | `seed` of the
    scrambles | `video` .mp4 or .mkv.
    """

    model: Path
    tables: tuple[Path, ...]
    output: Path
    operations: tuple[str | Mapping[str, Any], ...] = ()
    guide: Path | None = None
    frame_rate_hz: float | None = None
    seed: int = 0
    video: str = ".mp4"


def run(request: TrajectoryRequest) -> Steps[Outcome]:
    """Write the set of stimuli, or the table. Returns an `Outcome`."""
    if request.output.suffix.lower() == ".csv":
        return (yield from _write_table(request))
    if request.output.suffix and not request.output.is_dir():
        raise BadInput(
            f"{request.output} ends in {request.output.suffix}: give a folder for videos, or a table (.csv)"
        )
    planned = yield from plan(request)
    return (yield from write_set(planned, request.output))


def plan(request: TrajectoryRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check everything, draw nothing; `model` where it is open already. Returns a `PlannedSet`."""
    model = model or _opened(request)
    if request.video not in VIDEO_SUFFIXES:
        raise BadInput(
            f"a motion cannot be written as {request.video!r}: use one of {', '.join(VIDEO_SUFFIXES)}"
        )
    made = yield from _made(request, model)
    drawings = [
        Drawing(
            name=motion_name(motion.name),
            loadings_sd=motion.loadings_sd,
            frame_rate_hz=motion.rate_hz,
            suffix=request.video,
            told=told_of(made, motion, model.sd, request.seed),
        )
        for motion in made.motions
    ]
    return plan_of(
        request, "trajectory", model, drawings, inputs=made.inputs, notes=made.notes, columns=COLUMNS
    )


def _opened(request: TrajectoryRequest) -> MorphModel:
    if request.model.suffix.lower() == ".csv":
        raise BadInput(f"{request.model} is a table: name the model first, then its tables")
    return load_model(request.model)


def _made(request: TrajectoryRequest, model: MorphModel) -> Steps[MadeMotions]:
    return made_motions(
        model, request.tables, request.operations, request.guide, request.frame_rate_hz, request.seed
    )


def _write_table(request: TrajectoryRequest) -> Steps[Outcome]:
    """Write the new motion as a table of loadings, which any verb that takes one can go on with."""
    model = _opened(request)
    paths = [*request.tables, *([] if request.guide is None else [request.guide])]
    check_file(request.output, ".csv", paths)
    made = yield from _made(request, model)
    if len(made.motions) > 1:
        raise BadInput(
            f"{len(made.motions)} motions do not fit one table {request.output}: put them together with splice or "
            "average, or give one table"
        )
    make_folder(request.output.parent)
    sidecar = request.output.with_suffix(".json")
    if sidecar.exists() and read_json_object(sidecar).get("format") != LOADINGS_FORMAT:
        raise BadInput(f"{sidecar} would be replaced, and is no table's sidecar: give the table another name")
    motion = made.motions[0]
    weights = model.sd[: motion.loadings_sd.shape[1]]
    count = len(motion.loadings_sd)
    document = {
        "model_id": model.model_id,
        "model_sha256": digest_of_kept(request.model),
        "identity": model.identity,
        "consent": model.provenance.get("consent"),
        "licence": model.provenance.get("licence"),
        "frame_rate_hz": motion.rate_hz,
        "inputs": dict(made.inputs),
        "trajectory": {"request": request_document(request), **told_of(made, motion, weights, request.seed)},
        "versions": versions(),
    }
    names = [f"frame_{row:0{max(4, len(str(count - 1)))}d}" for row in range(count)]
    write_loadings_table(request.output, motion.loadings_sd, names, document)
    lines = (
        f"{request.output}: {count} frames at {motion.rate_hz:g} Hz, {motion.duration_s:.2f} s"
        + (", a loop" if motion.ends == "closed" else ""),
    )
    told = {"table": str(request.output), "frames": count, **told_of(made, motion, weights, request.seed)}
    return Outcome(lines, told, made.notes, (request.output, sidecar))
