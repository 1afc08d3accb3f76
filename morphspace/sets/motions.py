"""Recorded motion as data: read tables of loadings, apply operations, and describe the result (ours)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.io.clock import evenly_sampled
from morphspace.io.tables import read_loadings_table, write_loadings_table
from morphspace.model.model import MorphModel
from morphspace.outcome import versions
from morphspace.requests import request_document
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.manifest import Column
from morphspace.sets.plan import KEPT_STEMS
from morphspace.sets.sources import FRAME_RATE_HZ, file_names
from morphspace.steps import Step, Steps
from morphspace.stimuli.operations import Motion, Operation, operations_of, worked
from morphspace.stimuli.table_checks import check_table
from morphspace.stimuli.trajectory import step_lengths

JUMP = 1.0 + 1e-6  # median steps; a larger closing step is a visible jump
STEP_DIGITS = 6  # decimals in the manifest
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


@dataclass(frozen=True, eq=False)
class MadeMotions:
    """The motions made from tables: the tables' `names`, their digests (`inputs`), and notes for the user."""

    names: tuple[str, ...]
    motions: tuple[Motion, ...]
    operations: tuple[Operation, ...]
    inputs: Mapping[str, str]
    notes: tuple[str, ...]


def made_motions(
    model: MorphModel,
    tables: Sequence[Path],
    words: Sequence[str | Mapping[str, Any]] = (),
    guide_path: Path | None = None,
    frame_rate_hz: float | None = None,
    seed: int = 0,
) -> Steps[MadeMotions]:
    """Read motions from tables and apply the operations.

    Parameters
    ----------
    words
        The operations as words or mappings (`stimuli.motion_words`).
    guide_path
        The table that provides the timing, or with whose motion a single table is compared.
    frame_rate_hz
        Frame rate of the tables; None to use the rate in their sidecars.

    Raises
    ------
    BadInput
        If a table, an operation or a number cannot be used.
    """
    operations = operations_of(words)
    if not tables:
        raise BadInput("no table was given. Give the loadings of at least one motion (.csv)")
    paths = [*tables, *([] if guide_path is None else [guide_path])]
    read = []
    for path in paths:
        read.append((_guide if path is guide_path else _motion)(path, model, frame_rate_hz))
        yield Step("read", len(read), len(paths))
    names = _names(tables)
    found = [motion for motion, _ in read]
    _check_components(found, paths)
    guide = None if guide_path is None else found.pop()
    motions = [replace(motion, name=name) for motion, name in zip(found, names, strict=True)]
    weights = model.sd[: motions[0].loadings_sd.shape[1]]
    done = worked(motions, operations, weights, guide, seed)
    inputs = {f"tables/{name}": digest_of_kept(path) for name, path in zip(names, tables, strict=True)}
    if guide_path is not None:
        inputs["guide"] = digest_of_kept(guide_path)
    notes = [note for _, said in read for note in said]
    notes += [note for motion in done for note in _notes(motion, weights)]
    return MadeMotions(names, done, operations, inputs, tuple(dict.fromkeys(notes)))


def _motion(path: Path, model: MorphModel, rate_hz: float | None) -> tuple[Motion, tuple[str, ...]]:
    """Read a motion, check that it belongs to the model, and return it with notes."""
    table = read_loadings_table(path)
    notes = check_table(model, table, path)
    own_hz = table.rate_hz or model.provenance.get("frame_rate_hz")
    known_hz = rate_hz or own_hz
    if not known_hz:
        notes += (f"{path} has no frame rate: {FRAME_RATE_HZ:g} Hz is assumed; give --frame-rate",)
    loadings_sd, uneven = evenly_sampled(str(path), table.loadings_sd, table.times_s, own_hz)
    return Motion(path.stem, loadings_sd, float(known_hz or FRAME_RATE_HZ)), notes + uneven


def _guide(path: Path, model: MorphModel, rate_hz: float | None) -> tuple[Motion, tuple[str, ...]]:
    """Read the guide; check that its motion is that of this model."""
    try:
        return _motion(path, model, rate_hz)
    except ReferenceMismatch as error:
        raise ReferenceMismatch(
            f"the guide {path} belongs to another model than that of {model.identity}. Transfer its motion to this "
            "model with `morphspace mimic`, and give the resulting loadings"
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
    """Name each table for use in file names: NAME, NAME_2, NAME_3 if several share a name.

    A table named `loadings`, like the set's own table, takes the name of its folder.
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
    """Return the median step, the largest step, and the step from last to first frame of a motion."""
    steps = step_lengths(motion.loadings_sd, weights)
    closing = step_lengths(motion.loadings_sd[[-1, 0]], weights)
    return float(np.median(steps)), float(steps.max()), float(closing[0])


def _notes(motion: Motion, weights: AnyArray) -> tuple[str, ...]:
    median, _, closing = _steps(motion, weights)
    if motion.ends == "open" or closing <= JUMP * median:
        return ()
    far = f"by {closing / median:.3g} median steps" if median > 0 else "though it mostly stands still"
    return (
        f"{motion.name} jumps {far} at the end of the loop: give the loop more seconds, or none to choose them "
        "automatically",
    )


def _share(step: float, median: float) -> float | None:
    return round(step / median, STEP_DIGITS) if median > 0 else None


def variables_of(made: MadeMotions, motion: Motion, weights: AnyArray, seed: int) -> dict[str, Any]:
    """Return the manifest entries of a motion (`COLUMNS`); `weights` are the SDs of the model."""
    median, largest, closing = _steps(motion, weights[: motion.loadings_sd.shape[1]])
    entries: dict[str, Any] = {
        "tables": " ".join(made.names),
        "operations": " ".join(map(str, made.operations)),
        "ends": motion.ends,
        "duration_s": motion.duration_s,
        "largest_step": _share(largest, median),
        "closing_step": _share(closing, median),
    }
    if any(one.word.startswith("scramble") for one in made.operations):
        entries["seed"] = seed
    return entries


def write_motion(path: Path, made: MadeMotions, model: MorphModel, request: Any) -> None:
    """Write the only motion as a table of loadings with its sidecar; `request` is that of `trajectory`."""
    (motion,) = made.motions
    count = len(motion.loadings_sd)
    document = {
        "model_id": model.model_id,
        "model_sha256": digest_of_kept(request.model),
        "identity": model.identity,
        "consent": model.provenance.get("consent"),
        "licence": model.provenance.get("licence"),
        "frame_rate_hz": motion.rate_hz,
        "inputs": dict(made.inputs),
        "trajectory": {
            "request": request_document(request),
            **variables_of(made, motion, model.sd, request.seed),
        },
        "versions": versions(),
    }
    names = [f"frame_{row:0{max(4, len(str(count - 1)))}d}" for row in range(count)]
    write_loadings_table(path, motion.loadings_sd, names, document)
