"""continuum: the faces between two, in steps of equal size, with the linear morph as a control.

The two are rows of tables or pictures, shown with one model; or the mean faces of two models, for which a model of the
pair is built and kept beside the stimuli.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.avatar.pair import pair_model
from morphspace.errors import BadInput
from morphspace.flow.names import DEFAULT
from morphspace.io.tables import read_loadings_table
from morphspace.model.encode import STRANGE, encoded_frames, energy_outside, framed_for
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import Outcome, versions
from morphspace.requests import ClipText
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.manifest import Column
from morphspace.sets.planned import PlannedSet, files_named, request_document, write_set
from morphspace.sets.sources import LISTED, file_names
from morphspace.steps import Step, Steps, in_order, single_threads
from morphspace.stimuli.continuum import (
    POWERS,
    SPACINGS,
    Line,
    Spacing,
    even_positions,
    given_positions,
    spaced_positions,
)
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.stepping import change, difference, unevenness
from morphspace.stimuli.table_checks import check_table
from morphspace.storage import digest_of_file

MODEL_SUFFIX = ".morph"
TABLE_ROW = re.compile(r"(.+?\.csv):(.+)", re.IGNORECASE | re.DOTALL)
PAIRS_KEPT = 8
EQUAL = 0.03  # of their mean: steps that differ by more are not called equal
STEPS_NAME = "steps.csv"
LINEAR = "linear"
COLUMNS: Mapping[str, Column] = {
    "series": Column("continuum, or linear: the control in even steps of loadings"),
    "position": Column("Where on the line from the first end, 0, to the last, 1"),
    "spacing": Column("In what the steps are equal; given: where they were asked for"),
}


@dataclass(frozen=True)
class ContinuumRequest:
    """Draw the faces from `first` to `last` in so many `steps`, one face more than steps, into the folder `output`.

    The ends are two models with keypoints, whose mean faces they are; or with `model` each a picture or a row of a
    table, `TABLE.csv:FRAME`. `spacing` says in what the steps are equal (`stimuli.continuum.Spacing`); `positions` are
    taken instead of it where given, 0 the first end and 1 the last. `control` linear adds the linear morph in as many
    steps. `crop` px is cut out of pictures first.
    """

    first: ClipText
    last: ClipText
    output: Path
    model: Path | None = None
    steps: int = 10
    spacing: Spacing = "ciede2000"
    positions: tuple[float, ...] | None = None
    control: Literal["linear", "none"] = "linear"
    crop: tuple[int, int, int, int] | None = None


@dataclass(frozen=True, eq=False)
class _Ends:
    """The line between the two ends, the file its model is or will be in, the inputs' digests, and what to note."""

    line: Line
    model_path: Path
    model_sha256: str
    inputs: Mapping[str, str]
    notes: tuple[str, ...]


def run(request: ContinuumRequest) -> Steps[Outcome]:
    """Write the set of stimuli. Returns an `Outcome`."""
    planned = yield from plan(request)
    outcome = yield from write_set(planned, request.output)
    kept = () if request.model is not None else (planned.model_path,)
    return replace(
        outcome,
        lines=(*outcome.lines, *_said(request, planned)),
        document={**outcome.document, "unevenness": _uneven(planned)},
        written=(*outcome.written, *kept),
    )


def plan(request: ContinuumRequest, model: MorphModel | None = None) -> Steps[PlannedSet]:
    """Read and check everything, space the steps and measure them; `model` where it is open already.

    The model of a pair is to lie in the output folder: `keep_model` puts it there, unless another is in the way; a
    batch may name it otherwise. Returns a `PlannedSet`.
    """
    if request.spacing not in SPACINGS:
        raise BadInput(f"steps cannot be equal in {request.spacing!r}: choose from {', '.join(SPACINGS)}")
    positions = (
        even_positions(request.steps) if request.positions is None else given_positions(request.positions)
    )
    ends = yield from _ends(request, model)
    line = ends.line
    yield Step("space", 0, 1)
    with single_threads():
        spaced = _spaced(request, line, positions)
    yield Step("space", 1, 1)
    series = {"continuum": spaced}
    if request.control == LINEAR and not np.array_equal(spaced, even_positions(len(spaced) - 1)):
        series[LINEAR] = even_positions(len(spaced) - 1)
    spacing = request.spacing if request.positions is None else "given"
    drawings = [
        drawing for name, places in series.items() for drawing in _drawings(line, name, places, spacing)
    ]
    table = yield from _measured(line, series, drawings, spacing)
    return PlannedSet(
        verb="continuum",
        request=request_document(request),
        model_path=ends.model_path,
        model=line.model,
        model_sha256=ends.model_sha256,
        inputs={"model": ends.model_sha256, **ends.inputs},
        drawings=tuple(drawings),
        notes=(*ends.notes, *_notes(request, table)),
        tables={STEPS_NAME: table},
        columns=COLUMNS,
        new_model=request.model is None,
        files=files_named(request),
    )


def _spaced(request: ContinuumRequest, line: Line, positions: AnyArray) -> AnyArray:
    if request.positions is not None:
        return positions
    return spaced_positions(line, request.steps, request.spacing).positions


def _drawings(line: Line, name: str, positions: AnyArray, spacing: str) -> list[Drawing]:
    digits = max(2, len(str(len(positions) - 1)))
    stem = "step" if name == "continuum" else name
    sd = np.where(line.model.sd[: len(line.first)] > 0, line.model.sd[: len(line.first)], 1.0)
    return [
        Drawing(
            name=f"{stem}_{place:0{digits}d}",
            loadings_sd=(loadings / sd)[None],
            told={
                "series": name,
                "step": place,
                "position": float(position),
                "spacing": spacing if name == "continuum" else "loadings",
            },
        )
        for place, (position, loadings) in enumerate(zip(positions, line.loadings(positions), strict=True))
    ]


def _measured(
    line: Line, series: Mapping[str, AnyArray], drawings: Sequence[Drawing], spacing: str
) -> Steps[dict[str, list[Any]]]:
    """Measure every step of each series: the columns of steps.csv (data_spec/steps-table.md)."""
    mask = line.model.mask
    jobs = [
        (name, place, start, stop)
        for name, positions in series.items()
        for place, (start, stop) in enumerate(pairwise(map(float, positions)))
    ]
    names = {(drawing.told["series"], drawing.told["step"]): drawing.name for drawing in drawings}
    line.crossfade(0.0)  # its ends are drawn before threads share them

    def measured(job: tuple[str, int, float, float]) -> dict[str, Any]:
        name, place, start, stop = job
        found = change(line, start, stop, mask)
        faded = line.crossfade(start), line.crossfade(stop)
        return {
            "series": name,
            "step": place + 1,
            "from": names[name, place],
            "to": names[name, place + 1],
            "from_position": start,
            "to_position": stop,
            **asdict(found),
            "crossfade_ciede2000": difference(*faded, mask, "ciede2000"),
            "crossfade_ssim": 1 - difference(*faded, mask, "ssim"),
        }

    rows = []
    for row in in_order(measured, jobs):
        rows.append(row)
        yield Step("measure", len(rows), len(jobs))
    table: dict[str, list[Any]] = {key: [row[key] for row in rows] for key in rows[0]}
    sizes = np.array(_sizes(table, spacing))
    relative = np.empty(len(rows))
    for name in series:
        own = np.array([row["series"] == name for row in rows])
        mean = sizes[own].mean()
        relative[own] = sizes[own] / mean if mean > 0 else 1.0
    table["size_of_mean"] = relative.tolist()
    return table


def _sizes(table: Mapping[str, Sequence[Any]], spacing: str) -> list[float]:
    """Give the size of each step in what the steps were made equal in."""
    if spacing == "ssim":
        return [1 - value for value in table["ssim"]]
    if spacing in ("warp", "ciede2000"):
        return list(table["warp_rms_px" if spacing == "warp" else spacing])
    pairs = zip(table["from_position"], table["to_position"], strict=True)
    return [stop - start for start, stop in pairs]


def _own(table: Mapping[str, Sequence[Any]], series: str, column: str) -> list[float]:
    return [value for name, value in zip(table["series"], table[column], strict=True) if name == series]


def _notes(request: ContinuumRequest, table: Mapping[str, Sequence[Any]]) -> tuple[str, ...]:
    if request.positions is not None or request.spacing not in POWERS:
        return ()
    off = unevenness(np.array(_own(table, "continuum", "size_of_mean")))
    if off <= EQUAL:
        return ()
    return (
        f"the steps differ by up to {off:.1%} from their mean in {request.spacing}, which 8-bit colours may not let be "
        "finer: take fewer steps, or ends that differ more",
    )


def _uneven(planned: PlannedSet) -> dict[str, float]:
    """Give how far the step furthest from the mean is from it, for each series."""
    table = planned.tables[STEPS_NAME]
    return {
        name: unevenness(np.array(_own(table, name, "size_of_mean")))
        for name in dict.fromkeys(table["series"])
    }


def _said(request: ContinuumRequest, planned: PlannedSet) -> tuple[str, ...]:
    table, off = planned.tables[STEPS_NAME], _uneven(planned)
    steps, moved = _own(table, "continuum", "ciede2000"), _own(table, "continuum", "warp_rms_px")
    faded = _own(table, "continuum", "crossfade_ciede2000")
    how = (
        "as they were given"
        if request.positions is not None
        else f"equal in {request.spacing} to {off['continuum']:.1%}"
    )
    linear = f"; of the linear morph, to {off[LINEAR]:.1%}" if LINEAR in off else ""
    return (
        f"{len(steps)} steps, {how}{linear}",
        f"a step changes CIEDE2000 {np.mean(steps):.3g} and the warp {np.mean(moved):.3g} px on average, a plain "
        f"cross-fade CIEDE2000 {np.mean(faded):.3g}; {STEPS_NAME} has each",
    )


def _ends(request: ContinuumRequest, model: MorphModel | None) -> Steps[_Ends]:
    given = (request.first, request.last)
    models = [end for end in given if end.lower().endswith(MODEL_SUFFIX)]
    if request.model is None:
        if len(models) < 2:
            other = next(end for end in given if end not in models)
            raise BadInput(
                f"{other} is no model ({MODEL_SUFFIX}): give two models, or the model that shows both (--model)"
            )
        if request.crop is not None:
            raise BadInput("a crop cuts pictures, and the ends are models: leave it out")
        return (yield from _ends_of_pair(request))
    if models:
        raise BadInput(
            f"{models[0]} is a model: leave out the model {request.model} for the faces of two models, or give "
            "pictures or rows TABLE.csv:FRAME"
        )
    model = model or load_model(request.model)
    loadings: list[LoadingVector] = []
    inputs: dict[str, str] = {}
    notes: list[str] = []
    for role, end in zip(("first", "last"), given, strict=True):
        row = TABLE_ROW.fullmatch(end)
        found = _of_row(model, Path(row[1]), row[2]) if row else _of_picture(model, end, request.crop)
        loadings.append(found[0])
        inputs[role] = found[1]
        notes += found[2]
        yield Step("read", len(loadings), 2)
    shortest = min(map(len, loadings))
    if any(values[shortest:].any() for values in loadings):
        shortest = max(map(len, loadings))  # what a table leaves out is 0
    first, last = (
        np.pad(values, (0, shortest - len(values))) for values in (one[:shortest] for one in loadings)
    )
    digest = digest_of_kept(request.model)
    return _Ends(Line(model, first, last), request.model, digest, inputs, tuple(dict.fromkeys(notes)))


def _of_row(model: MorphModel, path: Path, frame: str) -> tuple[LoadingVector, str, tuple[str, ...]]:
    """Give the loadings (k,) of a row, the table's digest, and what to note."""
    table = read_loadings_table(path)
    notes = check_table(model, table, path)
    if frame not in table.frame_names:
        listed = ", ".join(table.frame_names[:LISTED])
        raise BadInput(
            f"{path} has no frame {frame!r}: its frames are {listed} and so on ({len(table.frame_names)} in all)"
        )
    values = table.loadings_sd[table.frame_names.index(frame)]
    return values * model.sd[: len(values)], digest_of_kept(path), notes


def _of_picture(
    model: MorphModel, path: str, crop: tuple[int, int, int, int] | None
) -> tuple[LoadingVector, str, tuple[str, ...]]:
    """Give the loadings (k,) of a picture, its digest, and what to note."""
    if path.lower().endswith(".csv"):
        raise BadInput(f"{path} is a table: say which of its frames is meant, {path}:FRAME")
    source = framed_for(model, (path,), crop)
    if len(source.names) != 1:
        raise BadInput(f"{path} holds {len(source.names)} frames: give one picture")
    (encoded,) = encoded_frames(model, source)
    loadings = encoded.loadings.values[0]
    notes: tuple[str, ...] = ()
    outside = energy_outside(encoded.morph - model.mean, model)
    if outside > STRANGE:
        notes += (
            f"{Path(path).name} is unlike the faces {model.identity} was built from (it leaves {outside:.1f} times "
            "their variance unexplained): the continuum starts or ends at what the model makes of it",
        )
    return loadings, source.file_digests[0], notes


def _ends_of_pair(request: ContinuumRequest) -> Steps[_Ends]:
    paths = (Path(request.first), Path(request.last))
    digests = tuple(digest_of_kept(path) for path in paths)
    yield Step("pair", 0, 1)
    with single_threads():
        pair = _pair(paths, digests)
    yield Step("pair", 1, 1)
    first, last = np.asarray(pair.training.values)
    path = request.output / ("-".join(file_names([one.stem for one in paths])) + MODEL_SUFFIX)
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        pair.save(Path(folder) / path.name)
        digest = digest_of_file(Path(folder) / path.name)
    inputs = dict(zip(("first", "last"), digests, strict=True))
    return _Ends(Line(pair, first, last), path, digest, inputs, ())


@lru_cache(maxsize=PAIRS_KEPT)
def _pair(paths: tuple[Path, ...], digests: tuple[str, ...]) -> MorphModel:
    """Build the model of a pair, once for all jobs of a batch that ask for it."""
    inputs = dict(zip(("first", "last"), digests, strict=True))
    models = [load_model(path) for path in paths]
    return pair_model(models, flow=DEFAULT, inputs=inputs, versions=versions()).model
