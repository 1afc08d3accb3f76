"""trajectory: recorded motion as data: smoothed, retimed, joined, looped, averaged, caricatured, scrambled, drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.io.sidecars import read_json_object
from morphspace.io.tables import LOADINGS_FORMAT, read_loadings_table, write_loadings_table
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome, versions
from morphspace.requests import VIDEO_SUFFIXES
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.manifest import Column
from morphspace.sets.planned import KEPT_STEMS, PlannedSet, plan_of, request_document, write_set
from morphspace.sets.protect import check_file
from morphspace.sets.sources import FRAME_RATE_HZ, file_names, motion_name
from morphspace.steps import Step, Steps
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.motion_words import GUIDED
from morphspace.stimuli.operations import Motion, Operation, operations_of, worked
from morphspace.stimuli.table_checks import check_table
from morphspace.stimuli.trajectory import step_lengths
from morphspace.storage import make_folder

LEAST_FRAMES = 2  # of a motion
JUMP = 1.0 + 1e-6  # median steps: a loop that closes with more jumps
STEP_DIGITS = 6
COLUMNS: Mapping[str, Column] = {
    "tables": Column("The tables of loadings the motion was made from"),
    "operations": Column("What was done to them, in this order"),
    "ends": Column(
        "closed: the last frame leads on to the first, and the motion may be shown in a loop; else open"
    ),
    "duration_s": Column("How long the frames are shown once", "s"),
    "largest_step": Column("Largest step from frame to frame, as the model measures faces", "median steps"),
    "closing_step": Column("Step from the last frame to the first, likewise", "median steps"),
}


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


@dataclass(frozen=True, eq=False)
class Made:
    """The motions that come of a request, with the digests of its tables and what to say of them."""

    motions: tuple[Motion, ...]
    operations: tuple[Operation, ...]
    inputs: Mapping[str, str]
    notes: tuple[str, ...]


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
            told=_told(request, made, motion, model.sd),
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


def _made(request: TrajectoryRequest, model: MorphModel) -> Steps[Made]:
    operations = operations_of(request.operations)
    if not request.tables:
        raise BadInput("no table was given: give the loadings of at least one motion (.csv)")
    if request.seed < 0:
        raise BadInput(f"a seed of {request.seed} cannot be used: give a whole number of at least 0")
    if request.frame_rate_hz is not None and not 0 < request.frame_rate_hz <= 1000:
        raise BadInput(
            f"a frame rate of {request.frame_rate_hz} Hz cannot be shown: give one above 0, at most 1000"
        )
    paths = [*request.tables, *([] if request.guide is None else [request.guide])]
    read = []
    for path in paths:
        read.append((_guide if path is request.guide else _motion)(path, model, request.frame_rate_hz))
        yield Step("read", len(read), len(paths))
    names = _names(request.tables)
    found = [motion for motion, _ in read]
    _check_components(found, paths)
    guide = None if request.guide is None else found.pop()
    if guide is not None and not any(one.word in GUIDED for one in operations):
        raise BadInput(
            f"{request.guide} is the guide, and no operation takes one: add {' or '.join(GUIDED)}, or leave it "
            "out"
        )
    motions = [replace(motion, name=name) for motion, name in zip(found, names, strict=True)]
    weights = model.sd[: motions[0].loadings_sd.shape[1]]
    done = worked(motions, operations, weights, guide, request.seed)
    inputs = {
        f"tables/{name}": digest_of_kept(path) for name, path in zip(names, request.tables, strict=True)
    }
    if request.guide is not None:
        inputs["guide"] = digest_of_kept(request.guide)
    notes = [note for _, said in read for note in said]
    notes += [note for motion in done for note in _notes(motion, weights)]
    return Made(done, operations, inputs, tuple(dict.fromkeys(notes)))


def _motion(path: Path, model: MorphModel, rate_hz: float | None) -> tuple[Motion, tuple[str, ...]]:
    """Read a motion and check that it belongs to the model; give what to note of it too."""
    table = read_loadings_table(path)
    notes = check_table(model, table, path)
    if len(table.frame_names) < LEAST_FRAMES:
        raise BadInput(
            f"{path} has {len(table.frame_names)} frames, a motion has at least {LEAST_FRAMES}: give a table of a clip"
        )
    told = rate_hz or (table.document or {}).get("frame_rate_hz") or model.provenance.get("frame_rate_hz")
    if not told:
        notes += (f"{path} does not tell its frame rate: {FRAME_RATE_HZ:g} Hz is taken; give --frame-rate",)
    return Motion(path.stem, table.loadings_sd, float(told or FRAME_RATE_HZ)), notes


def _guide(path: Path, model: MorphModel, rate_hz: float | None) -> tuple[Motion, tuple[str, ...]]:
    """Read the guide; somebody else's motion first has to become one of this face."""
    try:
        return _motion(path, model, rate_hz)
    except ReferenceMismatch as error:
        raise ReferenceMismatch(
            f"the guide {path} belongs to another model than that of {model.identity}: let its motion drive this model "
            "with `morphspace mimic`, and give the loadings that come of it"
        ) from error


def _check_components(motions: Sequence[Motion], paths: Sequence[Path]) -> None:
    first = motions[0].loadings_sd.shape[1]
    for motion, path in zip(motions, paths, strict=True):
        if motion.loadings_sd.shape[1] != first:
            raise BadInput(
                f"{paths[0]} has {first} components, {path} has {motion.loadings_sd.shape[1]}: encode both with the "
                "whole model"
            )


def _names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Give each table a name of its own, fit for a file: NAME, NAME_2, NAME_3 where several are called alike.

    One that is called as every set's own table is, `loadings`, goes by the name of its folder.
    """
    kept = [path.stem.casefold() in KEPT_STEMS and bool(path.parent.name) for path in paths]
    words = [path.parent.name if named else path.stem for path, named in zip(paths, kept, strict=True)]
    names: list[str] = []
    for stem in file_names(words):
        name, number = stem, 1
        while name.casefold() in (taken.casefold() for taken in names):
            number += 1
            name = f"{stem}_{number}"
        names.append(name)
    return tuple(names)


def _steps(motion: Motion, weights: AnyArray) -> tuple[float, float, float]:
    """Give the median and the largest step of a motion, and that from its last frame to its first."""
    steps = step_lengths(motion.loadings_sd, weights)
    closing = step_lengths(motion.loadings_sd[[-1, 0]], weights)
    return float(np.median(steps)), float(steps.max()), float(closing[0])


def _notes(motion: Motion, weights: AnyArray) -> tuple[str, ...]:
    median, _, closing = _steps(motion, weights)
    if motion.ends == "open" or closing <= JUMP * median:
        return ()
    far = f"by {closing / median:.3g} median steps" if median > 0 else "though it mostly stands still"
    return (
        f"{motion.name} jumps {far} where the loop closes: give the loop more seconds, or none, and it takes what it "
        "needs",
    )


def _share(step: float, median: float) -> float | None:
    return round(step / median, STEP_DIGITS) if median > 0 else None


def _told(request: TrajectoryRequest, made: Made, motion: Motion, weights: AnyArray) -> dict[str, Any]:
    median, largest, closing = _steps(motion, weights)
    told: dict[str, Any] = {
        "tables": " ".join(_names(request.tables)),
        "operations": " ".join(map(str, made.operations)),
        "ends": motion.ends,
        "duration_s": motion.duration_s,
        "largest_step": _share(largest, median),
        "closing_step": _share(closing, median),
    }
    if any(one.word.startswith("scramble") for one in made.operations):
        told["seed"] = request.seed
    return told


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
        "trajectory": {"request": request_document(request), **_told(request, made, motion, weights)},
        "versions": versions(),
    }
    names = [f"frame_{row:0{max(4, len(str(count - 1)))}d}" for row in range(count)]
    write_loadings_table(request.output, motion.loadings_sd, names, document)
    lines = (
        f"{request.output}: {count} frames at {motion.rate_hz:g} Hz, {motion.duration_s:.2f} s"
        + (", a loop" if motion.ends == "closed" else ""),
    )
    told = {"table": str(request.output), "frames": count, **_told(request, made, motion, weights)}
    return Outcome(lines, told, made.notes, (request.output, sidecar))
