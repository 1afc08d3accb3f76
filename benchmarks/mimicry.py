"""Whether one person's model, driven by another's, does what the source does, by a judge that no build uses.

The judge runs in its own interpreter (benchmarks/judges/face.py says how to make it). Drivers are training faces of the
source, drawn from all their loadings; what is judged are the pictures of the target.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from judges import measures, reading
from scipy.interpolate import RBFInterpolator
from tables import print_table, tell

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, load_detector
from morphspace.face.mesh import MESH_COUNT
from morphspace.grid import warp
from morphspace.io.images import write_image
from morphspace.model.keypoints import affine_between_models, landmarks_of
from morphspace.model.model import MorphModel, load_model
from morphspace.notebook import build
from morphspace.steps import result_of, spread
from morphspace.transfer.mimicry import MAX_SD, METHODS, Method, auto_gain, mimic
from morphspace.verbs import keypoints

PAIRS = (
    ("lp_d18", "lp_d6"),
    ("lp_d6", "lp_d18"),
    ("lp_d18", "lp_d13"),
    ("lp_d13", "lp_d18"),
    ("lp_d18", "lp_d0"),
    ("grid_pwij3p", "lp_d18"),
)
WAYS: dict[str, tuple[Method, float | Literal["auto"], float]] = {
    **{method: (method, 1.0, MAX_SD) for method in METHODS},
    "transfer, auto": ("transfer", "auto", MAX_SD),
    "guided, auto": ("guided", "auto", MAX_SD),
    "guided, auto, 5 SD": ("guided", "auto", 5.0),
}
"""By name: method, gain, bound in SD."""
SPLINE = "spline"
SPLINE_STIFFNESS = 1.0  # px^2; the detector's points jitter
SIZE = (200, 240)
COMPONENTS = 50
FRAMES = 24  # of each source, evenly spread
VIEWS = 8  # copies of a picture the judge averages over
READ_DRIVER, READ_DRIVEN = 0.85, 0.75  # r of two detectors on a person's own faces
REPORTED = ("paper", "transfer", "guided, auto", SPLINE)
MEASURED = tuple(name.replace("_", " ") for name in measures.MEASURES)
HEADS = ("way", "pair", *MEASURED, "mean", "to target", "to source", "folds %")
GOAL_R, GOAL_SLOPES, GOAL_IDENTITY, LEAST_R, GOAL_FOLDS = 0.88, (0.8, 1.2), 0.30, 0.75, 0.5


def mimicry(data: Path, work: Path, judge: str) -> None:
    """Print, for each pair and way, r and slope of the judge's measures, identity distances and folds."""
    print(
        f"Six pairs of models at {SIZE[0]} x {SIZE[1]}, k = {COMPONENTS}, keypoints by `keypoints --auto`; {FRAMES} "
        "training faces of the source drive, gain 1 and a bound of 3 SD unless it says otherwise; `guided, auto` is "
        "what `morphspace mimic` does by default. For each measure of the judge (68 landmarks, in eye distances): "
        "r / slope of the mimicry on the source; then their means, the distance of the identity embedding to the "
        "target and to the source (one person: below .6), and folded cells. Goals: mean r >= "
        f"{GOAL_R}, no pair below {LEAST_R}, slope {GOAL_SLOPES[0]} to {GOAL_SLOPES[1]}, identity <= {GOAL_IDENTITY}, "
        f"folds <= {GOAL_FOLDS} %. {SPLINE}: what one would do today, the target's mean face warped by a thin-plate "
        "spline through the source's landmarks, found in each driving face and carried by the affine.\n"
    )
    people = sorted({name for pair in PAIRS for name in pair})
    cast = _cast(people, data, work, judge)
    rows = [row for way in (*WAYS, SPLINE) for row in _rows_of_way(way, PAIRS, cast, work, judge)]
    print_table(HEADS, rows)


def mimicry_report(data: Path, work: Path, judge: str, mesh_judge: str) -> None:
    """Print mimicry between people on whom nothing was chosen, of the measures that can be read on both people."""
    with (data / "people.csv").open(newline="", encoding="utf-8") as stream:
        people = [row["person"] for row in csv.DictReader(stream) if row["use"] == "report"]
    pairs = tuple(zip(people, [*people[1:], people[0]], strict=True))
    print(
        "People on whom no constant was chosen (`report` in people.csv), each driven by the one before in that list. "
        "Models, drivers, judge and goals as in mimicry.md. A measure counts for a pair where two detectors that share "
        f"nothing agree on the {FRAMES} faces of each person: r >= {READ_DRIVER} for the driver, >= {READ_DRIVEN} for "
        "the target (dlib, which judges, and MediaPipe's attention mesh). What they do not agree on is unread (-), not "
        "scored.\n"
    )
    cast = _cast(people, data, work, judge)
    agreement, moves = {}, {}
    rows = []
    for name in people:
        points = reading.read_mesh(
            mesh_judge, [work / "mimicry" / name], work / "mimicry" / f"{name}-mesh.csv"
        )
        one = measures.expression(cast[name].readings.landmarks)
        other = measures.expression(
            np.array([points[file] for file in cast[name].readings.names]), measures.MESH
        )
        agreement[name] = measures.mimicry(one, other)[:, 0]
        moves[name] = np.nanstd(one, axis=0)
        cells = zip(agreement[name], 100 * moves[name], strict=True)
        rows.append([name, *("-" if np.isnan(r) else f"{r:.2f} / {sd:.1f}" for r, sd in cells)])
    print(
        "## What can be read\n\nFor each measure: r of the two detectors / sd in the person's own faces, % of the eye "
        "distance.\n"
    )
    print_table(["person", *MEASURED], rows)
    print("## Mimicry of these measures\n")
    counted = {
        (source, target): (np.nan_to_num(agreement[source]) >= READ_DRIVER)
        & (np.nan_to_num(agreement[target]) >= READ_DRIVEN)
        for source, target in pairs
    }
    print_table(
        HEADS, [row for way in REPORTED for row in _rows_of_way(way, pairs, cast, work, judge, counted)]
    )


@dataclass(frozen=True, eq=False)
class Person:
    """A person's model, and what the judge reads in `FRAMES` of its training faces."""

    model: MorphModel
    readings: measures.Readings


def _cast(people: Sequence[str], data: Path, work: Path, judge: str) -> dict[str, Person]:
    cast = {}
    for name in people:
        model = keyed_model(data, name, work)
        cast[name] = Person(model, _read(judge, _drawn(model, work / "mimicry" / name)))
    return cast


def _rows_of_way(
    way: str,
    pairs: Sequence[tuple[str, str]],
    cast: Mapping[str, Person],
    work: Path,
    judge: str,
    counted: Mapping[tuple[str, str], AnyArray] | None = None,
) -> list[list[str]]:
    """Measure all pairs by one way; give their rows and the row of their means. `counted`: the measures, (6,) bool."""
    rows, means = [], []
    detect = load_detector()
    for source, target in pairs:
        folder = work / "mimicry" / f"{way}-{source}-{target}"
        if way == SPLINE:
            folder, folds = _splined(cast[source].model, cast[target].model, detect, folder)
        else:
            folder, folds = _driven(cast[source].model, cast[target].model, way, folder)
        made, true = _read(judge, folder), cast[source].readings
        here, there = measures.paired(true, made)
        both = measures.mimicry(
            measures.expression(true.landmarks[here]), measures.expression(made.landmarks[there])
        )
        if counted is not None:
            both[~counted[source, target]] = np.nan
        read = both[~np.isnan(both[:, 0])]
        r, slope = read.mean(axis=0) if len(read) else (np.nan, np.nan)
        to_target = measures.identity_distance(made.embeddings, cast[target].readings.embeddings)
        to_source = measures.identity_distance(made.embeddings, true.embeddings)
        means.append((r, slope, to_target))
        cells = ["-" if np.isnan(one) else f"{one:.2f} / {two:.2f}" for one, two in both]
        summary = f"{r:.2f} / {slope:.2f}" if len(read) else "-"
        distances = [f"{to_target:.2f}", f"{to_source:.2f}", f"{100 * folds:.2f}"]
        rows.append([way, f"{source} to {target}", *cells, summary, *distances])
    mean, least, most = np.nanmean(means, axis=0), np.nanmin(means, axis=0), np.nanmax(means, axis=0)
    goals = {
        "mean r": mean[0] >= GOAL_R,
        "lowest r": least[0] >= LEAST_R,
        "slope": GOAL_SLOPES[0] <= mean[1] <= GOAL_SLOPES[1],
        "identity": most[2] <= GOAL_IDENTITY,
    }
    missed = [name for name, met in goals.items() if not met]
    verdict = f"MISSED: {', '.join(missed)}" if missed else "goals met"
    blank = [""] * len(MEASURED)
    summary = f"{mean[0]:.3f} / {mean[1]:.2f}"
    return [*rows, [way, f"mean; lowest r {least[0]:.2f}", *blank, summary, f"{mean[2]:.2f}", "", verdict]]


def keyed_model(data: Path, name: str, work: Path) -> MorphModel:
    """Give the model of a clip with keypoints, as the pairs are made of; it is kept in the work folder."""
    path = work / "mimicry" / f"{name}.morph"
    if not path.exists():
        tell(f"mimicry: building {name}")
        path.parent.mkdir(parents=True, exist_ok=True)
        frames = data / "sequences" / name / "frames" / "*.jpg"
        build(frames, components=COMPONENTS, size=SIZE, identity=name).save(path)
    if load_model(path).landmarks is None:
        result_of(keypoints.run(keypoints.KeypointsRequest(path, automatic=True), load_detector()))
    return load_model(path)


def _drawn(model: MorphModel, folder: Path) -> Path:
    for index in spread(len(model.training.values), FRAMES):
        write_image(folder / f"{index:04d}.png", np.clip(model.render(model.training.values[index]), 0, 1))
    return folder


def _driven(source: MorphModel, target: MorphModel, way: str, folder: Path) -> tuple[Path, float]:
    """Draw the target as the source drives it; give the folder and the mean share of folded cells."""
    method, asked, max_sd = WAYS[way]
    gain = auto_gain(source, target, method) if asked == "auto" else asked
    to_target = mimic(source, target, method, gain=gain, max_sd=max_sd)
    folds = []
    for index in spread(len(source.training.values), FRAMES):
        made = to_target(source.offset(source.training.values[index]))
        folds.append(made.quality.folds)
        write_image(folder / f"{index:04d}.png", np.clip(made.morph.render(), 0, 1))
    return folder, float(np.mean(folds))


def _splined(source: MorphModel, target: MorphModel, detect: Detector, folder: Path) -> tuple[Path, float]:
    """Warp the target's mean face by the source's landmarks; give the folder and the mean share of folded cells."""
    linear = affine_between_models(source, target)[:, :2]
    fixed, rest = landmarks_of(target), landmarks_of(source)
    if fixed is None or rest is None:
        raise BadInput("the spline needs mesh points on both mean faces: run keypoints --auto on both")
    fixed, rest = fixed[:MESH_COUNT], rest[:MESH_COUNT]
    width, height = target.size
    border = np.array([(x, y) for x in (0, width / 2, width - 1) for y in (0, height / 2, height - 1)])
    border = border[[0, 1, 2, 3, 5, 6, 7, 8]]
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float)
    folds = []
    for index in spread(len(source.training.values), FRAMES):
        found = detect(np.clip(source.render(source.training.values[index]), 0, 1))
        moved = np.zeros_like(fixed) if found is None else (found.points[:MESH_COUNT] - rest) @ linear.T
        through = RBFInterpolator(
            np.vstack([fixed, border]),
            np.vstack([moved, np.zeros_like(border)]),
            smoothing=SPLINE_STIFFNESS,
            kernel="thin_plate_spline",
        )
        field = through(grid).reshape(height, width, 2).astype(np.float32)
        folds.append(warp.fold_fraction(field, target.mask))
        write_image(folder / f"{index:04d}.png", np.clip(warp.render(target.mean.render(), field), 0, 1))
    return folder, float(np.mean(folds))


def _read(judge: str, folder: Path) -> measures.Readings:
    tell(f"mimicry: judging {folder.name}")
    return reading.read_faces(judge, folder, VIEWS)
