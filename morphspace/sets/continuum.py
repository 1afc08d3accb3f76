"""A continuum as a set: read its two ends, draw its steps, and measure every step (ours)."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.avatar.pair import pair_model
from morphspace.errors import BadInput
from morphspace.flow.names import DEFAULT
from morphspace.io.names import composed
from morphspace.io.tables import read_loadings_table
from morphspace.model.encode import STRANGE, encoded_frames, energy_outside, framed_for
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions
from morphspace.requests import AS_IT_IS, ClipOptions, check_no_options
from morphspace.sets.kept import digest_of_kept
from morphspace.sets.manifest import Column
from morphspace.sets.sources import LISTED, file_names
from morphspace.steps import Step, Steps, in_order, single_threads
from morphspace.stimuli.continuum import POWERS, Line, Spacing, even_positions, spaced_positions
from morphspace.stimuli.drawing import Drawing
from morphspace.stimuli.stepping import change, difference, unevenness
from morphspace.stimuli.table_checks import check_table
from morphspace.storage import digest_of_file

MODEL_SUFFIX = ".morph"
TABLE_ROW = re.compile(r"(.+?\.csv):(.+)", re.IGNORECASE | re.DOTALL)
PAIRS_KEPT = 8  # pairs of models kept open in a process
EQUAL = 0.03  # share of the mean step; steps that deviate more are not reported as equal
GIVEN = "given"  # the spacing of positions that the user gives
STEPS_NAME = "steps.csv"
LINEAR = "linear"
COLUMNS: Mapping[str, Column] = {
    "series": Column("continuum, or linear: the control in even steps of loadings"),
    "position": Column("Where on the line from the first end, 0, to the last, 1"),
    "spacing": Column("In what the steps are equal; given: where they were asked for"),
}


@dataclass(frozen=True, eq=False)
class ContinuumEnds:
    """The line between two ends, the path of its model, the digests of the inputs, and notes."""

    line: Line
    model_path: Path
    model_sha256: str
    inputs: Mapping[str, str]
    notes: tuple[str, ...]


def continuum_ends(
    first: str,
    last: str,
    folder: Path,
    model_path: Path | None = None,
    crop: tuple[int, int, int, int] | None = None,
    model: MorphModel | None = None,
    options: ClipOptions = AS_IT_IS,
) -> Steps[ContinuumEnds]:
    """Read the two ends of a continuum: two models, or two pictures or table rows of one model.

    Parameters
    ----------
    folder
        Folder for the new model if the ends are two models.
    model_path
        The model of both ends; None if the ends are two models.
    crop
        (x, y, w, h) px, cut out of pictures first.
    model
        The model of `model_path` if it is open already.
    options
        How pictures are read.

    Raises
    ------
    BadInput
        If the ends are of two kinds, or one of them cannot be read.
    """
    given = (first, last)
    models = [end for end in given if end.lower().endswith(MODEL_SUFFIX)]
    if model_path is None:
        if len(models) < 2:
            other = next(end for end in given if end not in models)
            raise BadInput(
                f"{other} is not a model ({MODEL_SUFFIX}). Give two models, or the model that shows both (--model)"
            )
        if crop is not None:
            raise BadInput("a crop applies to pictures, but the ends are models. Leave it out")
        check_no_options(options, "the ends are models")
        return (yield from _ends_of_pair((Path(first), Path(last)), folder))
    if models:
        raise BadInput(
            f"{models[0]} is a model, and --model is {model_path}. Leave out --model for two models, or give "
            "pictures or rows TABLE.csv:FRAME"
        )
    if all(map(TABLE_ROW.fullmatch, given)):
        check_no_options(options, "the ends are rows of tables")
    model = model or load_model(model_path)
    loadings: list[LoadingVector] = []
    inputs: dict[str, str] = {}
    notes: list[str] = []
    for role, end in zip(("first", "last"), given, strict=True):
        row = TABLE_ROW.fullmatch(end)
        found = _of_row(model, Path(row[1]), row[2]) if row else _of_picture(model, end, crop, options)
        loadings.append(found[0])
        inputs[role] = found[1]
        notes += found[2]
        yield Step("read", len(loadings), 2)
    shortest = min(map(len, loadings))
    if any(values[shortest:].any() for values in loadings):
        shortest = max(map(len, loadings))  # components that a table lacks are 0
    start, stop = (
        np.pad(values, (0, shortest - len(values))) for values in (one[:shortest] for one in loadings)
    )
    digest = digest_of_kept(model_path)
    return ContinuumEnds(Line(model, start, stop), model_path, digest, inputs, tuple(dict.fromkeys(notes)))


def _of_row(model: MorphModel, path: Path, frame: str) -> tuple[LoadingVector, str, tuple[str, ...]]:
    """Return the loadings (k,) of a table row, the digest of the table, and notes."""
    table = read_loadings_table(path)
    notes = check_table(model, table, path)
    frame = composed(frame)
    if frame not in table.frame_names:
        listed = ", ".join(table.frame_names[:LISTED])
        raise BadInput(
            f"{path} has no frame {frame!r}; expected one of its {len(table.frame_names)}, such as {listed}. Correct it"
        )
    values = table.loadings_sd[table.frame_names.index(frame)]
    return values * model.sd[: len(values)], digest_of_kept(path), notes


def _of_picture(
    model: MorphModel, path: str, crop: tuple[int, int, int, int] | None, options: ClipOptions
) -> tuple[LoadingVector, str, tuple[str, ...]]:
    """Return the loadings (k,) of a picture, its digest, and notes."""
    if path.lower().endswith(".csv"):
        raise BadInput(f"{path} is a table. Name one of its frames: {path}:FRAME")
    source = framed_for(model, (path,), crop, options)
    if len(source.names) != 1:
        raise BadInput(f"{path} has {len(source.names)} frames; expected one. Give one picture")
    (encoded,) = encoded_frames(model, source)
    loadings = encoded.loadings.values[0]
    notes: tuple[str, ...] = ()
    outside = energy_outside(encoded.morph - model.mean, model)
    if outside > STRANGE:
        notes += (
            f"{Path(path).name} is unlike the faces {model.identity} was built from (it leaves {outside:.1f} times "
            "their variance unexplained): the continuum starts or ends at the model's reconstruction of it",
        )
    return loadings, source.file_digests[0], notes


def _ends_of_pair(paths: tuple[Path, Path], folder: Path) -> Steps[ContinuumEnds]:
    digests = tuple(digest_of_kept(path) for path in paths)
    yield Step("pair", 0, 1)
    with single_threads():
        pair = _pair(paths, digests)
    yield Step("pair", 1, 1)
    first, last = np.asarray(pair.training.values)
    path = folder / ("-".join(file_names([one.stem for one in paths])) + MODEL_SUFFIX)
    with tempfile.TemporaryDirectory(prefix="morphspace-") as place:
        pair.save(Path(place) / path.name)
        digest = digest_of_file(Path(place) / path.name)
    inputs = dict(zip(("first", "last"), digests, strict=True))
    return ContinuumEnds(Line(pair, first, last), path, digest, inputs, ())


@lru_cache(maxsize=PAIRS_KEPT)
def _pair(paths: tuple[Path, ...], digests: tuple[str, ...]) -> MorphModel:
    """Build the model of a pair once for all jobs of a batch."""
    inputs = dict(zip(("first", "last"), digests, strict=True))
    models = [load_model(path) for path in paths]
    return pair_model(models, flow=DEFAULT, inputs=inputs, versions=versions()).model


def spaced_series(
    line: Line, positions: AnyArray, spacing: Spacing | None, *, linear: bool
) -> Steps[dict[str, AnyArray]]:
    """Return the positions of each series by name: the continuum, and the linear control if it differs.

    Parameters
    ----------
    positions
        (n,) on the line; evenly spaced if `spacing` is given.
    spacing
        The measure in which the steps are made equal; None to keep the positions.
    linear
        Whether to add the control with even steps of loadings.
    """

    yield Step("space", 0, 1)
    found = positions
    if spacing is not None:
        with single_threads():
            found = spaced_positions(line, len(positions) - 1, spacing).positions
    yield Step("space", 1, 1)
    even = even_positions(len(found) - 1)
    control = {LINEAR: even} if linear and not np.array_equal(found, even) else {}
    return {"continuum": found, **control}


def continuum_drawings(line: Line, name: str, positions: AnyArray, spacing: str) -> list[Drawing]:
    """Return the drawings of one series: the faces at the positions (n,) of the line."""
    digits = max(2, len(str(len(positions) - 1)))
    stem = "step" if name == "continuum" else name
    sd = np.where(line.model.sd[: len(line.first)] > 0, line.model.sd[: len(line.first)], 1.0)
    return [
        Drawing(
            name=f"{stem}_{place:0{digits}d}",
            loadings_sd=(loadings / sd)[None],
            variables={
                "series": name,
                "step": place,
                "position": float(position),
                "spacing": spacing if name == "continuum" else "loadings",
            },
        )
        for place, (position, loadings) in enumerate(zip(positions, line.loadings(positions), strict=True))
    ]


def measured_steps(
    line: Line, series: Mapping[str, AnyArray], drawings: Sequence[Drawing], spacing: str
) -> Steps[dict[str, list[Any]]]:
    """Measure every step of each series; return the columns of steps.csv (data_spec/steps-table.md)."""
    mask = line.model.mask
    jobs = [
        (name, place, start, stop)
        for name, positions in series.items()
        for place, (start, stop) in enumerate(pairwise(map(float, positions)))
    ]
    names = {(drawing.variables["series"], drawing.variables["step"]): drawing.name for drawing in drawings}
    line.crossfade(0.0)  # draws the ends before threads share them

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
    """Return the size of each step in the measure that was made equal."""
    if spacing == "ssim":
        return [1 - value for value in table["ssim"]]
    if spacing in ("warp", "ciede2000"):
        return list(table["warp_rms_px" if spacing == "warp" else spacing])
    pairs = zip(table["from_position"], table["to_position"], strict=True)
    return [stop - start for start, stop in pairs]


def column_of(table: Mapping[str, Sequence[Any]], series: str, column: str) -> list[float]:
    """Return a column of steps.csv for one series."""
    return [value for name, value in zip(table["series"], table[column], strict=True) if name == series]


def unevenness_of(table: Mapping[str, Sequence[Any]]) -> dict[str, float]:
    """Compute the largest deviation of a step from the mean step, for each series."""
    return {
        name: unevenness(np.array(column_of(table, name, "size_of_mean")))
        for name in dict.fromkeys(table["series"])
    }


def evenness_notes(table: Mapping[str, Sequence[Any]], spacing: str) -> tuple[str, ...]:
    """Note steps that were to be equal in `spacing` and are not; `table` has the columns of steps.csv."""
    if spacing not in POWERS:
        return ()
    off = unevenness(np.array(column_of(table, "continuum", "size_of_mean")))
    if off <= EQUAL:
        return ()
    return (
        f"the steps differ by up to {off:.1%} from their mean in {spacing}, which 8-bit colours may cause. Use fewer "
        "steps, or ends that differ more",
    )


def step_lines(table: Mapping[str, Sequence[Any]], spacing: str) -> tuple[str, ...]:
    """Report how even the steps are and how large, from the columns of steps.csv."""
    off = unevenness_of(table)
    steps, moved = column_of(table, "continuum", "ciede2000"), column_of(table, "continuum", "warp_rms_px")
    faded = column_of(table, "continuum", "crossfade_ciede2000")
    how = "as given" if spacing == GIVEN else f"equal in {spacing} to {off['continuum']:.1%}"
    linear = f"; of the linear morph, to {off[LINEAR]:.1%}" if LINEAR in off else ""
    return (
        f"{len(steps)} steps, {how}{linear}",
        f"a step changes CIEDE2000 {np.mean(steps):.3g} and the warp {np.mean(moved):.3g} px on average, a plain "
        f"cross-fade CIEDE2000 {np.mean(faded):.3g}; {STEPS_NAME} has each",
    )
