"""The models that a set starts from: opened from a file, or built from a clip and written with their report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morphspace.io.clips import Clip
from morphspace.model.from_clip import ClipSettings, build_clip
from morphspace.model.passes import Build
from morphspace.report import Case, measure_frames, write_report
from morphspace.steps import Steps


@dataclass(frozen=True, eq=False)
class WrittenModel:
    """A model that was built and written: its build, figures of each frame as a `Case`, notes on the clip's frames."""

    build: Build
    case: Case
    notes: tuple[str, ...]


def written_model(
    clip: Clip, settings: ClipSettings, output: Path, report: Path, work_folder: Path
) -> Steps[WrittenModel]:
    """Build a model from a clip, and write it and its report. Return a `WrittenModel`."""
    build, notes = yield from build_clip(clip, settings, work_folder)
    figures = yield from measure_frames(build)
    build.model.save(output)
    framing = build.model.provenance["framing"]
    width, height = framing["source_size"] if framing["crop"] is None else framing["crop"][2:]
    used = int(width), int(height)
    write_report(report, build, figures, source_size=used)
    return WrittenModel(build, Case(build, figures, used), notes)
