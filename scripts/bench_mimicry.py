"""Whether one person's model, driven by another's, does what the source does, by a judge that no build uses.

The judge runs in its own interpreter (scripts/face_judge.py says how to make it). What drives are training faces of the
source, drawn from all their loadings; what is judged are the pictures of the target.
"""

from __future__ import annotations

from pathlib import Path

import face_judge_runner
import judge_measures
import numpy as np
from bench_tables import print_table, tell

from morphspace.detection import load_detector
from morphspace.files.images import write_image
from morphspace.mimic import METHODS, Method, mimic, offset_of
from morphspace.model import MorphModel, load_model
from morphspace.progress import result_of
from morphspace.reference import spread
from morphspace.verbs import keypoints
from morphspace.verbs.build_model import build_model

PAIRS = (
    ("lp_d18", "lp_d6"),
    ("lp_d6", "lp_d18"),
    ("lp_d18", "lp_d13"),
    ("lp_d13", "lp_d18"),
    ("lp_d18", "lp_d0"),
    ("grid_pwij3p", "lp_d18"),
)
SIZE = (200, 240)
COMPONENTS = 50
FRAMES = 24  # of each source, evenly spread
VIEWS = 8  # copies of a picture the judge averages over
GOAL_R, GOAL_SLOPES, GOAL_IDENTITY, LEAST_R, GOAL_FOLDS = 0.88, (0.8, 1.2), 0.30, 0.75, 0.5


def mimicry(data: Path, work: Path, judge: str) -> None:
    """Print, for each pair and method, r and slope of the judge's measures, identity distances and folds."""
    print("## Mimicry\n")
    print(
        f"Six pairs of models at {SIZE[0]} x {SIZE[1]}, k = {COMPONENTS}, keypoints by `keypoints --auto`; {FRAMES} "
        "training faces of the source drive. For each measure of the judge (68 landmarks of dlib, in eye distances): "
        "r / slope of the mimicry on the source; then their means, the distance of the identity embedding to the "
        "target and to the source (one person: below .6), and folded cells. Goals: mean r >= "
        f"{GOAL_R}, no pair below {LEAST_R}, slope {GOAL_SLOPES[0]} to {GOAL_SLOPES[1]}, identity <= {GOAL_IDENTITY}, "
        f"folds <= {GOAL_FOLDS} %.\n"
    )
    models = {name: _model(data, name, work) for name in sorted({name for pair in PAIRS for name in pair})}
    readings = {name: _read(judge, _drawn(model, work / "mimicry" / name)) for name, model in models.items()}
    heads = ["method", "pair", *(name.replace("_", " ") for name in judge_measures.MEASURES)]
    rows = []
    for method in METHODS:
        means = []
        for source, target in PAIRS:
            folder, folds = _driven(
                models[source], models[target], method, work / "mimicry" / f"{method}-{source}-{target}"
            )
            made, true = _read(judge, folder), readings[source]
            here, there = judge_measures.paired(true, made)
            both = judge_measures.mimicry(
                judge_measures.expression(true.landmarks[here]),
                judge_measures.expression(made.landmarks[there]),
            )
            r, slope = np.nanmean(both, axis=0)
            to_target = judge_measures.identity_distance(made.embeddings, readings[target].embeddings)
            to_source = judge_measures.identity_distance(made.embeddings, true.embeddings)
            means.append((r, slope, to_target))
            cells = ["-" if np.isnan(one) else f"{one:.2f} / {two:.2f}" for one, two in both]
            rows.append(
                [
                    method,
                    f"{source} to {target}",
                    *cells,
                    f"{r:.2f} / {slope:.2f}",
                    f"{to_target:.2f}",
                    f"{to_source:.2f}",
                    f"{100 * folds:.2f}",
                ]
            )
        mean, least = np.mean(means, axis=0), np.min(means, axis=0)
        met = mean[0] >= GOAL_R and least[0] >= LEAST_R and GOAL_SLOPES[0] <= mean[1] <= GOAL_SLOPES[1]
        rows.append(
            [
                method,
                f"mean; lowest r {least[0]:.2f}",
                *[""] * len(judge_measures.MEASURES),
                f"{mean[0]:.3f} / {mean[1]:.2f}",
                f"{mean[2]:.2f}",
                "",
                "goal met" if met else "goal MISSED",
            ]
        )
    print_table([*heads, "mean", "to target", "to source", "folds %"], rows)


def _model(data: Path, name: str, work: Path) -> MorphModel:
    path = work / "mimicry" / f"{name}.morph"
    if not path.exists():
        tell(f"mimicry: building {name}")
        path.parent.mkdir(parents=True, exist_ok=True)
        frames = data / "sequences" / name / "frames" / "*.jpg"
        build_model(frames, components=COMPONENTS, size=SIZE, identity=name).save(path)
        result_of(keypoints.run(keypoints.KeypointsRequest(path, automatic=True), load_detector()))
    return load_model(path)


def _drawn(model: MorphModel, folder: Path) -> Path:
    for index in spread(len(model.training.values), FRAMES):
        write_image(folder / f"{index:04d}.png", np.clip(model.render(model.training.values[index]), 0, 1))
    return folder


def _driven(source: MorphModel, target: MorphModel, method: Method, folder: Path) -> tuple[Path, float]:
    """Draw the target as the source drives it; give the folder and the mean share of folded cells."""
    to_target = mimic(source, target, method)
    folds = []
    for index in spread(len(source.training.values), FRAMES):
        made = to_target(offset_of(source, source.training.values[index]))
        folds.append(made.quality.folds)
        write_image(folder / f"{index:04d}.png", np.clip(made.morph.render(), 0, 1))
    return folder, float(np.mean(folds))


def _read(judge: str, folder: Path) -> judge_measures.Readings:
    tell(f"mimicry: judging {folder.name}")
    return face_judge_runner.read(judge, folder, VIEWS)
