"""Verbs that fill a folder of their own, as jobs of a batch: done once, recognised as done, listed in a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphspace.errors import MorphspaceError, UnreadableFile
from morphspace.io.sidecars import read_json_object
from morphspace.outcome import RECORD_NAME, Outcome
from morphspace.requests import verb_named
from morphspace.steps import Step, Steps, result_of
from morphspace.storage import digest_of_file, json_text, write_text

MARK_NAME = "batch.json"  # in the folder: what filled it, written when it was whole
MARK_FORMAT = "morphspace-batch-folder"
MARK_VERSION = 1


class Stopped(MorphspaceError):
    """The batch was stopped while a folder was being filled; what is done of it stays."""


@dataclass(frozen=True, eq=False)
class FolderJob:
    """A verb that fills a folder of its own, called `name` in the batch's.

    `request` is its request, `told` the same as JSON with the recipe's words, `levels` of the factors, `made_from`
    the digest of request, inputs and versions.
    """

    name: str
    verb: str
    request: Any
    told: Mapping[str, Any]
    levels: Mapping[str, Any]
    made_from: str


def fill_folder(job: FolderJob, folder: Path, is_stopped: Callable[[], bool]) -> dict[str, Any]:
    """Run the job's verb, or keep the folder where it is whole; give its row of the table of folders.

    Raises what the verb raises, and `Stopped` between two of its steps where `is_stopped` says so.
    """
    place = folder / job.name
    mark = _mark_of(place, job)
    if mark is None:
        outcome = _run(verb_named(job.verb).run(job.request), job, is_stopped)
        mark = {
            "format": MARK_FORMAT,
            "version": MARK_VERSION,
            "verb": job.verb,
            "request": dict(job.told),
            "made_from_sha256": job.made_from,
            "record_sha256": digest_of_file(place / RECORD_NAME),
            "notes": list(outcome.warnings),
        }
        write_text(place / MARK_NAME, json_text(mark))
    record = read_json_object(place / RECORD_NAME)
    return {
        "name": job.name,
        "verb": job.verb,
        **job.levels,
        "files": len(record["outputs"]),
        "record_sha256": mark["record_sha256"],
        "notes": "; ".join(mark.get("notes", [])),
    }


def _run(steps: Steps[Outcome], job: FolderJob, is_stopped: Callable[[], bool]) -> Outcome:
    """Run the work to its end unless the batch is stopped."""

    def on_step(_: Step) -> None:
        if is_stopped():
            raise Stopped(f"stopped while {job.name} was being filled; the same command goes on there")

    return result_of(steps, on_step)


def _mark_of(place: Path, job: FolderJob) -> dict[str, Any] | None:
    """Give what was written when the folder was filled, where it was filled by this job and all of it is there."""
    try:
        mark = read_json_object(place / MARK_NAME)
        record = read_json_object(place / RECORD_NAME)
        whole = (
            mark.get("format") == MARK_FORMAT
            and mark.get("made_from_sha256") == job.made_from
            and mark.get("record_sha256") == digest_of_file(place / RECORD_NAME)
            and all(digest_of_file(place / name) == digest for name, digest in record["outputs"].items())
        )
    except (UnreadableFile, KeyError, AttributeError):
        return None
    return mark if whole else None
