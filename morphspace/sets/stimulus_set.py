"""Complete a folder of drawn stimuli: manifest, tables of loadings, page and record (ours)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.io.images import read_image
from morphspace.io.tables import write_loadings_table, write_metrics_table
from morphspace.outcome import RECORD_NAME, Outcome, versions, write_record, write_record_of
from morphspace.report.frames import small
from morphspace.report.set_page import CLIPPED_PERCENT, FOLDED_PERCENT, StimulusSet, places_shown, set_page
from morphspace.requests import VIDEO_SUFFIXES
from morphspace.sets.manifest import Column, write_manifest
from morphspace.sets.outputs import Output, set_output
from morphspace.sets.plan import PlannedSet, keep_model
from morphspace.sets.protect import writing
from morphspace.sets.stimulus import make_stimulus
from morphspace.steps import Step, Steps, in_order, worker_count
from morphspace.stimuli.drawing import PICTURE_SUFFIXES, Drawing
from morphspace.stimuli.image_statistics import FIGURES, SPACES
from morphspace.storage import digest_of_file, write_text

PAGE_NAME = "index.html"
OUTLIER_Z = 3.5  # of the modified z-score (Iglewicz and Hoaglin 1993)
LEAST_FOR_OUTLIERS = 8  # stimuli; the spread of fewer is too uncertain
SAME_RATE = 1e-3  # share; a smaller difference is no note
NORMAL_MAD = 0.6745  # the median absolute deviation of a normal distribution, in its sd
LEAST_SPREAD = 0.005  # share of a statistic's median; 3.5 times this is a just visible difference
LOADINGS_KINDS = ("loadings", "colour_loadings")  # two tables if colours have other loadings than the warp


def write_set(planned: PlannedSet, folder: Path) -> Steps[Outcome]:
    """Draw every stimulus of the set into the folder, with sidecars, manifest, loadings, page and record.

    Complete stimuli in the folder are kept.

    Raises
    ------
    UnwritableFile
        If the folder or a file in it cannot be written.
    BadInput
        If a file of another origin would be replaced.
    """
    with writing(set_output(planned.verb, folder, planned.drawings, planned.files, tuple(planned.tables))):
        keep_model(planned)
        head = planned.sidecar_head()
        rows: list[dict[str, Any]] = []
        total = len(planned.drawings)

        def make(drawing: Drawing) -> dict[str, Any]:
            return make_stimulus(planned.model, drawing, head, folder)

        stills = all(drawing.frame_rate_hz is None for drawing in planned.drawings)
        if stills:
            made = in_order(make, planned.drawings)
        else:  # the frames of a video are drawn in parallel, the videos one after the other
            made = (
                make_stimulus(planned.model, drawing, head, folder, worker_count())
                for drawing in planned.drawings
            )
        for row in made:
            rows.append(row)
            yield Step("draw", len(rows), total)
        return complete_set(folder, [planned], rows, planned.verb, planned.request)


def write_animated(planned: PlannedSet, output: Path) -> Steps[Outcome]:
    """Draw the frames of the only video of a set as an animation, with its record beside it."""
    from morphspace.io.animation import shown_rate_hz, write_animation  # loads libav

    (drawing,) = planned.drawings
    model, rate = planned.model, float(drawing.frame_rate_hz or 0)
    loadings, count = drawing.loadings_sd * model.sd[: drawing.loadings_sd.shape[1]], len(drawing.loadings_sd)
    shown = shown_rate_hz(output.suffix.lower(), rate)
    record = output.with_name(f"{output.name}.{RECORD_NAME}")
    with writing(Output("render", output, (output, record), inputs=planned.files)):
        yield Step("render", 0, 1)
        write_animation(output, lambda: in_order(model.render, loadings), frame_rate_hz=rate)
        yield Step("render", 1, 1)
        settings = {**planned.request, "video": None, "frame_rate_hz": shown}
        write_record(output.parent, "render", settings, dict(planned.inputs), [output], record.name)
    notes = planned.notes
    if abs(shown - rate) > SAME_RATE * rate:
        notes += (
            f"{output} is shown at {shown:.4g} Hz, not {rate:g}: a GIF has whole hundredths of a second",
        )
    lines = (f"{output}: {count} frames at {shown:.4g} Hz, for slides and pages; it is no stimulus",)
    return Outcome(lines, {"output": str(output), "frames": count}, notes, (output, record))


def write_lone_video(planned: PlannedSet, output: Path) -> Steps[Outcome]:
    """Write the only video of a set under its own name, with its sidecar and record beside it."""

    (drawing,) = planned.drawings
    sidecar = output.with_name(f"{output.name}.json")
    record = output.with_name(f"{output.name}.{RECORD_NAME}")
    with writing(Output("render", output, (record,), [(output, sidecar)], planned.files)):
        yield Step("render", 0, 1)
        row = make_stimulus(
            planned.model, drawing, planned.sidecar_head(), output.parent, worker_count(), (output, sidecar)
        )
        yield Step("render", 1, 1)
        settings = {**planned.request, "frame_rate_hz": drawing.frame_rate_hz}
        written = (output, sidecar)
        write_record(output.parent, "render", settings, dict(planned.inputs), written, record.name)
    notes = planned.notes
    if row["clipped_percent"] > CLIPPED_PERCENT:
        notes = (*notes, f"{row['clipped_percent']:.2g} % of the colour values were clipped: lower the gain")
    lines = (f"{output}: {row['frames']} frames at {drawing.frame_rate_hz:g} Hz",)
    document = {"output": str(output), "frames": row["frames"], "clipped_percent": row["clipped_percent"]}
    return Outcome(lines, document, notes, (*written, record))


def complete_set(
    folder: Path,
    sets: Sequence[PlannedSet],
    rows: Sequence[Mapping[str, Any]],
    verb: str,
    request: Mapping[str, Any],
) -> Outcome:
    """Write manifest, loadings, page and record of a folder whose stimuli are drawn, and summarise the set.

    Parameters
    ----------
    sets
        The planned sets, in order.
    rows
        The manifest rows that `make_stimulus` returned for their drawings, in the same order.
    verb, request
        The verb and the request of the whole folder.
    """
    rows = flagged(rows)
    columns: dict[str, Column] = {}
    for planned in sets:
        columns |= planned.variable_columns()
    written = [*write_manifest(folder, rows, columns, verb)]
    written += _write_loadings(folder, sets)
    for planned in sets:
        for name, table in planned.tables.items():
            write_metrics_table(folder / name, table)
            written.append(folder / name)
    notes = list(dict.fromkeys(note for planned in sets for note in planned.notes)) + list(notes_on(rows))
    written.append(_write_page(folder, verb, rows, request, notes, list(columns)))
    inputs = {name: digest for planned in sets for name, digest in planned.inputs.items()}
    made = {str(row["file"]): str(row["sha256"]) for row in rows}
    made |= {f"{row['name']}.json": str(row["sidecar_sha256"]) for row in rows}
    record = _write_record(folder, verb, request, inputs, made, written)
    totals = {kind: len(found) for kind, found in to_look_at(rows).items()}
    summary = {
        "output": str(folder),
        "stimuli": len(rows),
        "frames": sum(row["frames"] for row in rows),
        **totals,
    }
    what = "stimulus" if len(rows) == 1 else "stimuli"
    identities = list(dict.fromkeys(planned.model.identity for planned in sets))
    listed = ", ".join(identities[:3]) + (f" and {len(identities) - 3} more" if len(identities) > 3 else "")
    lines = (f"{folder}: {len(rows)} {what} of {listed}; {folder / PAGE_NAME} shows them",)
    stimuli = tuple(folder / name for name in made)
    return Outcome(lines, summary, (*notes, *_others(folder, made)), (*stimuli, *written, record))


def _others(folder: Path, made: Mapping[str, str]) -> tuple[str, ...]:
    """Note stimuli of another set in the folder, which the manifest does not list."""
    kinds = (*PICTURE_SUFFIXES, *VIDEO_SUFFIXES)
    here = (
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix in kinds and path.with_suffix(".json").is_file()
    )
    others = [path.relative_to(folder).as_posix() for path in here]
    others = [name for name in others if name not in made]
    if not others:
        return ()
    what = "a stimulus" if len(others) == 1 else f"{len(others)} stimuli"
    return (
        f"{folder} also holds {what} of another set, such as {others[0]}, which the manifest does not list",
    )


def flagged(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Add `outlier_in` to each row: the image statistics in which the stimulus is an outlier of its set."""
    names = [f"{space}_{figure}" for space in SPACES for figure in FIGURES]
    found: list[list[str]] = [[] for _ in rows]
    for name in names:
        values = np.array([np.nan if row.get(name) is None else row[name] for row in rows], np.float64)
        for place in np.flatnonzero(_stands_out(values)):
            found[place].append(name)
    return [{**row, "outlier_in": " ".join(out)} for row, out in zip(rows, found, strict=True)]


def _stands_out(values: AnyArray) -> AnyArray:
    """Return which values (n,) exceed the modified z-score limit, (n,) bool."""
    known = np.isfinite(values)
    if known.sum() < LEAST_FOR_OUTLIERS:
        return np.zeros(len(values), bool)
    median = np.median(values[known])
    spread = np.median(np.abs(values[known] - median)) / NORMAL_MAD
    spread = max(float(spread), LEAST_SPREAD * abs(float(median)), 1e-12)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(values - median) > OUTLIER_Z * spread)


def to_look_at(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Select the rows of stimuli with clipped colours, folds, implausible loadings or outlying statistics."""
    return {
        "clipped": [row for row in rows if row["clipped_percent"] > CLIPPED_PERCENT],
        "folded": [row for row in rows if row["folded_percent"] > FOLDED_PERCENT],
        "beyond": [row for row in rows if row["beyond"]],
        "outliers": [row for row in rows if row["outlier_in"]],
    }


def _advice(row: Mapping[str, Any]) -> str | None:
    """Name the setting of the verb that moves a stimulus towards the mean face; None if it has no such setting."""
    advice = {"sweep": "use fewer SD", "grid": "use fewer SD", "sample": "lower the spread or --max-sd"}
    verb = row.get("verb")
    return advice.get(str(verb), None if verb in ("continuum", "trajectory") else "lower the gain")


def notes_on(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Summarise the problems of a set: clipped colours, folds, implausible faces and outliers."""
    notes = []
    clipped, folded, beyond, outliers = to_look_at(rows).values()
    if clipped:
        worst = max(clipped, key=lambda row: float(row["clipped_percent"]))
        notes.append(
            f"in {len(clipped)} of {len(rows)} stimuli colour values were clipped, most in {worst['name']} "
            f"({worst['clipped_percent']:.2g} %): {_advice(worst) or 'look at them'}"
        )
    if folded:
        worst = max(folded, key=lambda row: float(row["folded_percent"]))
        notes.append(
            f"in {len(folded)} of {len(rows)} stimuli the face folds over itself, most in {worst['name']} "
            f"({worst['folded_percent']:.2g} % of it): {', or '.join(filter(None, ('look at them', _advice(worst))))}"
        )
    if beyond:
        worst = max(beyond, key=lambda row: float(row["largest_sd"]))
        notes.append(
            f"{len(beyond)} of {len(rows)} stimuli lie beyond 3 SD and beyond every training face, furthest "
            f"{worst['name']} ({worst['largest_sd']:.1f} SD in pc{worst['largest_component']:03d}): look at them; the "
            "manifest marks them"
        )
    if outliers:
        notes.append(
            f"{len(outliers)} of {len(rows)} stimuli stand out in their image statistics, such as "
            f"{outliers[0]['name']} ({outliers[0]['outlier_in'].split()[0]}): the manifest marks them"
        )
    return tuple(notes)


def loadings_tables(sets: Sequence[PlannedSet]) -> list[str]:
    """Return the file names that the loadings of all stimuli may have, one table per model."""
    endings = _by_ending(sets)
    return [
        f"{kind}{ending}{suffix}"
        for ending in endings
        for kind in LOADINGS_KINDS
        for suffix in (".csv", ".json")
    ]


def _by_ending(sets: Sequence[PlannedSet]) -> dict[str, list[PlannedSet]]:
    """Group the sets by model; the keys are the endings of the tables' names."""
    by_model: dict[str, list[PlannedSet]] = {}
    for planned in sets:
        by_model.setdefault(planned.model.model_id, []).append(planned)
    return {"" if len(by_model) == 1 else f"_{model_id}": group for model_id, group in by_model.items()}


def _write_loadings(folder: Path, sets: Sequence[PlannedSet]) -> list[Path]:
    """Write the loadings of all stimuli, one table per model."""
    written: list[Path] = []
    for ending, group in _by_ending(sets).items():
        drawings = [drawing for planned in group for drawing in planned.drawings]
        first = group[0]
        rates = {drawing.frame_rate_hz for drawing in drawings}
        document = {
            "model_id": first.model.model_id,
            "model_sha256": first.model_sha256,
            "identity": first.model.identity,
            "consent": first.model.provenance.get("consent"),
            "licence": first.model.provenance.get("licence"),
            "frame_rate_hz": rates.pop() if len(rates) == 1 else None,
            "versions": versions(),
        }
        names = [name for drawing in drawings for name in frame_names(drawing)]
        plain, coloured = LOADINGS_KINDS
        kinds = [(plain, [drawing.loadings_sd for drawing in drawings])]
        if any(drawing.colour_sd is not None for drawing in drawings):
            colours = [one.loadings_sd if one.colour_sd is None else one.colour_sd for one in drawings]
            kinds.append((coloured, colours))
        for kind, tables in kinds:
            path = folder / f"{kind}{ending}.csv"
            write_loadings_table(path, _stacked(tables), names, document)
            written += [path, path.with_suffix(".json")]
    return written


def _stacked(tables: Sequence[AnyArray]) -> AnyArray:
    """Stack tables of loadings (n, k) vertically; missing later components are 0."""
    width = max(table.shape[1] for table in tables)
    return np.concatenate([np.pad(table, ((0, 0), (0, width - table.shape[1]))) for table in tables])


def frame_names(drawing: Drawing) -> tuple[str, ...]:
    """Return the row names of a stimulus in the table of loadings; for a video the frame number from 0 is added."""
    count = len(drawing.loadings_sd)
    if drawing.frame_rate_hz is None:
        return (drawing.name,)
    digits = max(4, len(str(count - 1)))
    return tuple(f"{drawing.name}_{row:0{digits}d}" for row in range(count))


def _write_page(
    folder: Path,
    verb: str,
    rows: Sequence[Mapping[str, Any]],
    request: Mapping[str, Any],
    notes: Sequence[str],
    columns: Sequence[str],
) -> Path:
    """Write index.html: contact sheet, image statistics and stimuli to inspect."""
    thumbnails = {
        place: _middle(folder / str(rows[place]["file"]), rows[place])
        for place in places_shown(rows, columns)
    }
    settings = {name: json.dumps(value, ensure_ascii=False) for name, value in request.items()}
    made = StimulusSet(f"Stimuli: {verb}", rows, thumbnails, notes, settings, columns)
    path = folder / PAGE_NAME
    write_text(path, set_page(made))
    return path


def _middle(path: Path, row: Mapping[str, Any]) -> Image:
    """Read the picture, or the middle frame of a video, and reduce it to a thumbnail (h, w, 3)."""
    if row["frame_rate_hz"] is None:
        return small(read_image(path))
    from morphspace.io.video import read_frames  # loads libav, which stills do not need

    return small(next(read_frames(path, [int(row["frames"]) // 2])))


def _write_record(
    folder: Path,
    verb: str,
    settings: Mapping[str, Any],
    inputs: Mapping[str, str],
    made: Mapping[str, str],
    written: Sequence[Path],
) -> Path:
    """Write the record with the known digests of the stimuli and new digests of the set's own files."""
    outputs = {path.relative_to(folder).as_posix(): digest_of_file(path) for path in written}
    return write_record_of(folder / RECORD_NAME, verb, settings, inputs, {**made, **outputs})
