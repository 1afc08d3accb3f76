"""Jobs of a batch whose verb fills a folder of its own: run once, recognised when complete, and listed in a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

from morphspace.documents import Digest, Document
from morphspace.errors import MorphspaceError, UnreadableFile
from morphspace.outcome import RECORD, RECORD_NAME, Outcome
from morphspace.requests import verb_named
from morphspace.steps import Step, Steps, result_of
from morphspace.storage import digest_of_file, json_text, write_text

MARK_NAME = "batch.json"  # describes the job that filled the folder; written last


class Mark(TypedDict):
    """The entries of the mark of a folder (data_spec/recipe.md)."""

    format: Literal["morphspace-batch-folder"]
    version: Literal[1]
    verb: str
    request: dict[str, Any]
    made_from_sha256: Digest
    record_sha256: Digest
    notes: list[str]


MARK = Document("batch-folder", "morphspace batch folder, version 1: the mark of a finished job", Mark)


class Stopped(MorphspaceError):
    """The batch was stopped while a verb filled a folder; its finished files stay."""


@dataclass(frozen=True, eq=False)
class FolderJob:
    """A verb that fills the folder `name` inside the batch's folder.

    Attributes
    ----------
    request
        The request of the verb.
    recorded
        The request as JSON, with the recipe's own paths.
    levels
        Level of each factor.
    made_from
        Digest of request, inputs and versions.
    """

    name: str
    verb: str
    request: Any
    recorded: Mapping[str, Any]
    levels: Mapping[str, Any]
    made_from: str


def fill_folder(job: FolderJob, folder: Path, is_stopped: Callable[[], bool]) -> dict[str, Any]:
    """Run the job's verb, or keep a complete folder; return its row of the table of folders.

    Raises `Stopped` between two steps of the verb if `is_stopped` returns True, and every error of the verb.
    """
    place = folder / job.name
    mark = _mark_of(place, job)
    if mark is None:
        outcome = _run(verb_named(job.verb).run(job.request), job, is_stopped)
        mark = {
            "format": "morphspace-batch-folder",
            "version": 1,
            "verb": job.verb,
            "request": dict(job.recorded),
            "made_from_sha256": job.made_from,
            "record_sha256": digest_of_file(place / RECORD_NAME),
            "notes": list(outcome.warnings),
        }
        write_text(place / MARK_NAME, json_text(mark))
    record = RECORD.read(place / RECORD_NAME)
    return {
        "name": job.name,
        "verb": job.verb,
        **job.levels,
        "files": len(record["outputs"]),
        "record_sha256": mark["record_sha256"],
        "notes": "; ".join(mark["notes"]),
    }


def _run(steps: Steps[Outcome], job: FolderJob, is_stopped: Callable[[], bool]) -> Outcome:
    """Run the steps to their end unless the batch is stopped."""

    def on_step(_: Step) -> None:
        if is_stopped():
            raise Stopped(f"stopped while {job.name} was being filled. Run the same command to resume")

    return result_of(steps, on_step)


def _mark_of(place: Path, job: FolderJob) -> Mark | None:
    """Read the mark of a folder that this job filled and whose files are all present; None otherwise."""
    try:
        mark = MARK.read(place / MARK_NAME)
        record = RECORD.read(place / RECORD_NAME)
        whole = (
            mark["made_from_sha256"] == job.made_from
            and mark["record_sha256"] == digest_of_file(place / RECORD_NAME)
            and all(digest_of_file(place / name) == digest for name, digest in record["outputs"].items())
        )
    except UnreadableFile:
        return None
    return mark if whole else None
