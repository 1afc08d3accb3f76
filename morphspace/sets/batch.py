"""A batch draws the stimulus set of a recipe (ours).

It plans the whole set first, draws it in several processes, and resumes after an interruption.
"""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.recipe.grammar import read_recipe
from morphspace.io.tables import write_metrics_table
from morphspace.outcome import Outcome, write_record
from morphspace.requests import VIDEO_SUFFIXES, recipe_verbs
from morphspace.sets.batch_plan import FOLDERS_TABLE, Planned, planned_recipe
from morphspace.sets.outputs import set_output
from morphspace.sets.plan import PlannedSet, keep_model
from morphspace.sets.pool import DrawingPiece, FolderPiece, Piece, made_here, made_in_processes, threads_of
from morphspace.sets.protect import writing
from morphspace.sets.stimulus import make_stimulus
from morphspace.sets.stimulus_set import complete_set, loadings_tables
from morphspace.steps import Step, Steps, core_count, worker_count
from morphspace.stimuli.drawing import PICTURE_SUFFIXES, Drawing

MOST_UNASKED = 100_000  # stimuli drawn without --yes: about a day, and tens of gigabytes
MOST_PLANNED = 1_000_000  # stimuli planned by --plan without --yes: minutes, and gigabytes of memory
FEW_FRAMES = 64  # frames; fewer are drawn before other processes have started
TRIED_FRAMES = 8  # frames drawn of a video to estimate the duration of a batch
SHOWN_NOTES = 5  # notes on folders
STIMULUS_SUFFIXES = (*PICTURE_SUFFIXES, *VIDEO_SUFFIXES)
TRIED_KINDS = 6  # pairs of model and file type that are tried


@dataclass(frozen=True, eq=False)
class Estimate:
    """The time that drawing takes, s, and the size of the set, bytes; folders filled by verbs are not included."""

    seconds: float
    size_bytes: float


@dataclass(frozen=True, eq=False)
class BatchPlan:
    """A batch that is checked and ready to be drawn into the folder `output`; only the disk can still refuse it.

    `asked_workers` is the requested number of processes; None for one per core.
    """

    recipe: Path
    output: Path
    planned: Planned
    description: str
    asked_workers: int | None = None

    @property
    def workers(self) -> int:
        """Return the number of processes that draw the batch."""
        if self.asked_workers is not None:
            return self.asked_workers
        pieces = len(self.planned.drawings) + len(self.planned.folders)
        few = self.frames < FEW_FRAMES and len(self.planned.folders) < 2
        return 1 if few else min(worker_count(), pieces)

    @property
    def frames(self) -> int:
        """Count the pictures to draw, including the frames of videos."""
        return sum(len(drawing.loadings_sd) for _, drawing in self.planned.drawings)

    @property
    def asks(self) -> bool:
        """Check whether the batch is so large that the command line requires --yes."""
        return len(self.planned.drawings) + len(self.planned.folders) > MOST_UNASKED

    def lines(self, estimate: Estimate | None) -> tuple[str, ...]:
        """Describe the plan: number of stimuli, duration and size."""
        drawings = [drawing for _, drawing in self.planned.drawings]
        videos = sum(drawing.frame_rate_hz is not None for drawing in drawings)
        models = len({planned.model.model_id for planned in self.planned.sets})
        kinds = [_counted(len(drawings) - videos, "picture")] if len(drawings) > videos else []
        if videos:
            kinds.append(
                f"{_counted(videos, 'video')} of {self.frames - len(drawings) + videos:,} frames in all"
            )
        if self.planned.folders:
            kinds.append(_counted(len(self.planned.folders), "folder"))
        lines = [f"{self.recipe}: {', '.join(kinds)}, from {_counted(models, 'model')}"]
        begun = sum((self.output / f"{drawing.name}.json").exists() for drawing in drawings)
        if begun:
            lines.append(f"{begun:,} of them are in {self.output} already; complete ones are kept")
        if estimate is not None and drawings:
            also = ", and the folders" if self.planned.folders else ""
            lines.append(
                f"about {_duration(estimate.seconds)} in {_counted(self.workers, 'process', 'processes')}, "
                f"{_size(estimate.size_bytes)}{also}"
            )
        if self.asks:
            lines.append(f"these are more than {MOST_UNASKED:,} stimuli. Give --yes to make them")
        return tuple(lines)

    def document(self, estimate: Estimate) -> dict[str, Any]:
        """Return the plan as JSON."""
        return {
            "stimuli": len(self.planned.drawings),
            "frames": self.frames,
            "folders": len(self.planned.folders),
            "needs_yes": self.asks,
            "workers": self.workers,
            "seconds": round(estimate.seconds, 1),
            "bytes": round(estimate.size_bytes),
        }


def planned_batch(
    recipe: Path, output: Path, workers: int | None = None, most: int | None = MOST_UNASKED
) -> Steps[BatchPlan]:
    """Read and check a whole recipe without drawing anything.

    Parameters
    ----------
    workers
        Number of processes that draw; None for one per core.
    most
        Largest number of stimuli; None for no limit.

    Returns
    -------
    BatchPlan

    Raises
    ------
    BadInput
        If the recipe cannot be used; the message names its line.
    """
    if workers is not None and workers < 1:
        raise BadInput(
            f"the number of processes is {workers}; expected at least 1. Leave it out for one per core"
        )
    read = read_recipe(recipe, {name: verb.settings for name, verb in recipe_verbs().items()})
    planned = yield from planned_recipe(read, output, most)
    return BatchPlan(recipe, output, planned, read.description, workers)


def estimated(batch: BatchPlan) -> Estimate:
    """Estimate duration and size of a batch from a few trial stimuli, one of each model and file type."""
    kinds: dict[tuple[str, str], list[tuple[PlannedSet, Drawing]]] = {}
    for planned, drawing in batch.planned.drawings:
        kinds.setdefault((planned.model.model_id, drawing.suffix), []).append((planned, drawing))
    seconds = size = frames = 0.0
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        for pairs in list(kinds.values())[:TRIED_KINDS]:
            took, bytes_of_one = _tried(*pairs[0], Path(folder))
            here = sum(len(drawing.loadings_sd) for _, drawing in pairs)
            seconds, size, frames = seconds + took * here, size + bytes_of_one * here, frames + here
    share = batch.frames / frames if frames else 0.0
    return Estimate(share * seconds / min(batch.workers, core_count()), share * size)


def write_batch(batch: BatchPlan) -> Steps[Outcome]:
    """Draw every stimulus that is not complete yet, then write manifest, loadings, page and record."""
    folder, planned = batch.output, batch.planned
    read = [batch.recipe, *(path for one in planned.sets for path in one.files)]
    tables = [name for one in planned.sets for name in one.tables]
    tables += [*loadings_tables(planned.sets), *([FOLDERS_TABLE] if planned.folders else [])]
    with writing(set_output("batch", folder, [drawing for _, drawing in planned.drawings], read, tables)):
        for one in planned.sets:
            keep_model(one)
        pieces = len(planned.drawings) + len(planned.folders)
        make = (
            made_here(_pieces(batch))
            if batch.workers == 1
            else made_in_processes(_pieces(batch), batch.workers)
        )
        rows: list[dict[str, Any]] = []
        with contextlib.closing(make):
            for row in make:
                rows.append(row)
                yield Step("batch", len(rows), pieces)
        drawn = len(planned.drawings)
        return _completed(batch, rows[:drawn], rows[drawn:])


def _pieces(batch: BatchPlan) -> Iterator[Piece]:
    folder = batch.output
    threads = threads_of(batch.workers)
    for planned in batch.planned.sets:
        head = planned.sidecar_head()
        for drawing in planned.drawings:
            yield DrawingPiece(planned.model_path, drawing, head, folder, threads)
    for job in batch.planned.folders:
        yield FolderPiece(job, folder)


def _completed(batch: BatchPlan, rows: list[dict[str, Any]], folder_rows: list[dict[str, Any]]) -> Outcome:
    """Write the files of the whole set: manifest, loadings, page, table of folders and record."""
    folder, planned = batch.output, batch.planned
    settings = {"recipe": batch.recipe.name, "description": batch.description}
    tables: dict[str, Mapping[str, Any]] = {}
    if folder_rows:
        names = dict.fromkeys(key for row in folder_rows for key in row)
        tables[FOLDERS_TABLE] = {name: [row.get(name) for row in folder_rows] for name in names}
    notes = (*_folder_notes(folder_rows), *_stale_notes(folder, planned))
    if not planned.sets:
        write_metrics_table(folder / FOLDERS_TABLE, tables[FOLDERS_TABLE])
        record = write_record(folder, "batch", settings, planned.inputs, [folder / FOLDERS_TABLE])
        written = (folder / FOLDERS_TABLE, record)
        document = {"output": str(folder), "stimuli": 0, "folders": len(folder_rows)}
        return Outcome(_folder_lines(batch), document, notes, written)
    first, *rest = planned.sets
    sets = [dataclasses.replace(first, inputs=planned.inputs, tables={**first.tables, **tables})]
    sets += [dataclasses.replace(one, inputs={}) for one in rest]
    outcome = complete_set(folder, sets, rows, "batch", settings)
    lines = (*outcome.lines, *(_folder_lines(batch) if folder_rows else ()))
    document = {**outcome.document, "folders": len(folder_rows)}
    return dataclasses.replace(outcome, lines=lines, document=document, warnings=(*outcome.warnings, *notes))


def _folder_notes(rows: list[dict[str, Any]]) -> list[str]:
    """Return the first few notes of the verbs that filled folders; the table holds all of them."""
    notes = [f"{row['name']}: {row['notes']}" for row in rows if row["notes"]]
    if len(notes) <= SHOWN_NOTES:
        return notes
    return [*notes[:SHOWN_NOTES], f"{len(notes) - SHOWN_NOTES} more folders have notes, in {FOLDERS_TABLE}"]


def _stale_notes(folder: Path, planned: Planned) -> list[str]:
    """Note how many stimuli in the folder do not belong to this recipe."""
    ours = {drawing.name for _, drawing in planned.drawings}
    own = [folder / job.name for job in planned.folders]
    others = [
        name
        for path in sorted(folder.rglob("*.json"))
        if any(path.with_suffix(suffix).exists() for suffix in STIMULUS_SUFFIXES)
        and (name := path.relative_to(folder).with_suffix("").as_posix()) not in ours
        and not any(path.is_relative_to(place) for place in own)
    ]
    if not others:
        return []
    return [
        f"{folder} holds {_counted(len(others), 'stimulus', 'stimuli')} of another recipe, such as {others[0]}"
    ]


def _folder_lines(batch: BatchPlan) -> tuple[str, ...]:
    names = [job.name for job in batch.planned.folders]
    listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return (f"{batch.output}: {_counted(len(names), 'folder')} ({listed}), listed in {FOLDERS_TABLE}",)


def _tried(planned: PlannedSet, drawing: Drawing, folder: Path) -> tuple[float, float]:
    """Draw the first frames of a stimulus twice; return seconds and bytes per frame of the second run."""
    few = dataclasses.replace(
        drawing,
        loadings_sd=drawing.loadings_sd[:TRIED_FRAMES],
        colour_sd=None if drawing.colour_sd is None else drawing.colour_sd[:TRIED_FRAMES],
        outside_sd=None if drawing.outside_sd is None else drawing.outside_sd[:TRIED_FRAMES],
        placing=None,
    )
    head = planned.sidecar_head()
    for place in ("first", "second"):  # the first run opens files and fills caches
        start = time.perf_counter()
        make_stimulus(planned.model, few, head, folder / place)
        seconds = time.perf_counter() - start
    made = [folder / "second" / few.file_name, folder / "second" / f"{few.name}.json"]
    count = len(few.loadings_sd)
    return seconds / count, sum(path.stat().st_size for path in made) / count


def _counted(count: int, what: str, more: str | None = None) -> str:
    return f"{count:,} {what if count == 1 else more or f'{what}s'}"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _size(count: float) -> str:
    for unit, large in (("GB", 1e9), ("MB", 1e6)):
        if count >= large:
            return f"{count / large:.2g} {unit}" if count < 10 * large else f"{count / large:,.0f} {unit}"
    return f"{max(count / 1e3, 1):.0f} kB"
