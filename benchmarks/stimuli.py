"""Stimulus sets: the gain of a picture read back, the statistics of a file read back, and speed."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mimicry
import numpy as np
from flow_estimators import one_thread
from tables import at_least, at_most, milliseconds, print_table, tell

from morphspace.face.faceframe import Frame, identity_affine
from morphspace.io.colour import codes_of
from morphspace.io.images import read_image, write_image
from morphspace.io.stimulus_sidecars import read_stimulus_sidecar
from morphspace.io.video import read_frames
from morphspace.model import fit
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel
from morphspace.steps import in_order, result_of, spread
from morphspace.stimuli.image_statistics import image_statistics
from morphspace.verbs import caricature, replay
from morphspace.verbs.caricature import CaricatureRequest
from morphspace.verbs.encode import write_loadings
from morphspace.verbs.replay import ReplayRequest

CLIPS = ("lp_d18", "lp_d13", "lp_d6", "grid_pwij3p")
FACES = 8  # of each model, evenly chosen
GAINS = (-1.5, -1.0, -0.5, 0.5, 1.0, 1.5)
GOAL_SLOPE = 0.05  # of the gain
LONG = 20  # steps of the fit where it is to find all there is
GOAL_SPEED = 0.9  # of the plain loop
TIMED = 100  # stimuli of one round
MOST_ROUNDS = 7
LOSSY, LOSSLESS = ".mp4", ".mkv"


def stimuli(data: Path, work: Path, rounds: int) -> None:
    """Print the round trip of a gain, the statistics of files read back, and the speed against a plain loop."""
    models = {name: mimicry.keyed_model(data, name, work) for name in CLIPS}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, model in models.items():
            shutil.copyfile(work / "mimicry" / f"{name}.morph", folder / f"{name}.morph")
            training = spread(len(model.training.values), FACES)
            _table(
                model, folder / f"{name}.morph", folder / f"{name}.csv", model.training.values[list(training)]
            )
        _gains(models, folder)
        _read_back(models, folder)
        _speed(models[CLIPS[0]], folder, min(rounds, MOST_ROUNDS))


def _table(model: MorphModel, path: Path, table: Path, values: np.ndarray) -> None:
    names = tuple(f"face_{row:04d}" for row in range(len(values)))
    write_loadings(table, Loadings(values, names, model.model_id), model, path, {})


def _gains(models: dict[str, MorphModel], folder: Path) -> None:
    print("## A gain, once it is a picture\n")
    print(
        f"{FACES} training faces of each model, drawn by `caricature` at each gain into 8-bit PNGs and read in three "
        "ways. Encode: as `encode` does, which knows the model's own pictures and does not align them. Aligned: as if "
        "they were somebody's photographs; a strong expression is taken in part for a movement of the head. To the "
        f"end: as encode, with up to {LONG} steps of the fit, from the loadings drawn: what the picture itself "
        "tells. Slope: of the loadings read on "
        "those drawn at gain 1, in SD, all components of a face together, over the gain; median over the faces, and in "
        f"brackets how many lie within {GOAL_SLOPE:.0%}. Weighed: the same of `encode`, each component as much as it "
        "varies in the training faces, which is as much as it shows. Off: root mean square of what was read less what "
        "was drawn, SD, median over the faces. Worst: the slope furthest from 1, and the share of the face's grid that "
        "the warp of this face turns over, %: what is folded under is not in the picture.\n"
    )
    rows = []
    for name, model in models.items():
        tell(f"stimuli: gains of {name}")
        output, path = folder / f"{name}_gains", folder / f"{name}.morph"
        result_of(caricature.run(CaricatureRequest(path, output, folder / f"{name}.csv", gains=GAINS)))
        drawn = model.training.values[list(spread(len(model.training.values), FACES))]
        for gain in GAINS:
            files = [output / f"face_{row:04d}_g{gain:g}" for row in range(FACES)]
            read = list(in_order(_reader(model, gain), zip(files, drawn, strict=True)))
            folds = [read_stimulus_sidecar(_sidecar(file))["quality"]["folded_percent"] for file in files]
            rows.append(
                [name, f"{gain:+g}", *_gain_cells(np.stack(read), drawn / model.sd, model.sd, gain, folds)]
            )
    goal = f"1 +- {GOAL_SLOPE:.0%}"
    print_table(
        [
            "model",
            "gain",
            "encode",
            goal,
            "weighed",
            goal,
            "aligned",
            "to the end",
            "off",
            "worst, encode",
            "folded",
            "worst, to the end",
        ],
        rows,
    )


def _gain_cells(
    read: np.ndarray, veridical: np.ndarray, sd: np.ndarray, gain: float, folds: list[float]
) -> list[str]:
    """Give the cells of a row from loadings (faces, ways, k) in SD read of faces (faces, k) drawn at a gain."""
    slopes = (read * veridical[:, None]).sum(axis=2) / (veridical**2).sum(axis=1)[:, None] / gain
    shown = veridical * sd**2
    weighed = float(np.median((read[:, 0] * shown).sum(axis=1) / (veridical * shown).sum(axis=1))) / gain
    off = np.sqrt(((read[:, 0] - gain * veridical) ** 2).mean(axis=1))
    middle, near = np.median(slopes, axis=0), (np.abs(slopes - 1) <= GOAL_SLOPE).sum(axis=0)
    told = [f"{one:.3f} ({count} of {len(slopes)})" for one, count in zip(middle, near, strict=True)]
    worst = np.abs(slopes - 1).argmax(axis=0)
    return [
        told[0],
        at_most(abs(float(middle[0]) - 1), GOAL_SLOPE),
        f"{weighed:.3f}",
        at_most(abs(weighed - 1), GOAL_SLOPE),
        *told[1:],
        f"{np.median(off):.3f}",
        f"{slopes[worst[0], 0]:.3f}",
        f"{folds[worst[0]]:.1f}",
        f"{slopes[worst[2], 2]:.3f}",
    ]


def _sidecar(file: Path) -> Path:
    return file.with_name(f"{file.name}.json")


def _reader(model: MorphModel, gain: float) -> Callable[[tuple[Path, np.ndarray]], np.ndarray]:
    """Give the function that reads a drawn face in three ways, (3, k) SD."""
    fitter = fit.Fitter(model.mean, model.basis, model.mask)
    _ = model.flow_from_reference  # prepared once

    def read(item: tuple[Path, np.ndarray]) -> np.ndarray:
        file, drawn = item
        image = read_image(file.with_name(f"{file.name}.png"))
        own = Frame(image, file.name, identity_affine())
        encoded = model.fit(own, model.project(model.morph_of(own))).values[0]
        aligned = model.encode(image, name=file.name).values[0]
        to_the_end = fitter.fit(image, gain * drawn, steps=LONG)
        return np.stack([encoded, aligned, to_the_end]) / model.sd

    return read


def _read_back(models: dict[str, MorphModel], folder: Path) -> None:
    print("## What the sidecar says of the file\n")
    print(
        "The statistics in each sidecar against the same measured from the file read back, and `replay` of each "
        "stimulus. Differ: files in which any figure differs at all.\n"
    )
    rows = []
    for name in models:
        for video in (None, LOSSLESS, LOSSY):
            output = folder / f"{name}_{(video or '.png')[1:]}"
            request = CaricatureRequest(folder / f"{name}.morph", output, folder / f"{name}.csv", video=video)
            outcome = result_of(caricature.run(request))
            differ, same = 0, 0
            stimuli = [path for path in outcome.written if path.suffix == (video or ".png")]
            for path in stimuli:
                sidecar = path.with_suffix(".json")
                frames = [read_image(path)] if video is None else read_frames(path)
                measured = image_statistics(codes_of(frame, 8)[0] for frame in frames)
                differ += measured != read_stimulus_sidecar(sidecar)["statistics"]
                again = result_of(replay.run(ReplayRequest(sidecar, folder / f"{name}.morph")))
                same += bool(again.document["same"])
            cells = [
                str(len(stimuli)),
                str(differ),
                at_most(differ, 0),
                str(same),
                at_least(same, len(stimuli)),
            ]
            rows.append([name, (video or ".png")[1:], *cells])
    print_table(["model", "file", "stimuli", "differ", "0", "replayed", "all"], rows)


def _speed(model: MorphModel, folder: Path, rounds: int) -> None:
    print("## Speed of a set\n")
    print(
        f"{TIMED} pictures of {model.identity}, {model.size[0]} x {model.size[1]}, k = {model.rank}: `caricature` from "
        "a table, with sidecars, statistics, manifest, page and record, against a loop of `model.render` and "
        "`write_image` over the same rows, which writes the pictures alone. Processor time of one stimulus, one thread "
        f"each, median and quartiles of {rounds} interleaved rounds; share: the loop's time over the set's.\n"
    )
    values = model.sample(np.random.default_rng(0), TIMED).values
    path, table = folder / f"{CLIPS[0]}.morph", folder / "timed.csv"
    _table(model, path, table, values)
    seconds: dict[str, list[float]] = {"set": [], "loop": []}
    with one_thread():
        for count in range(rounds + 1):
            for name in seconds:
                target = folder / "timed"
                shutil.rmtree(target, ignore_errors=True)
                start = time.process_time()
                if name == "set":
                    result_of(caricature.run(CaricatureRequest(path, target, table, gains=(1.0,))))
                else:
                    for row, loadings in enumerate(values):
                        write_image(target / f"{row:04d}.png", model.render(loadings))
                if count:
                    seconds[name].append((time.process_time() - start) / TIMED)
    found = {name: np.array(one) for name, one in seconds.items()}
    share = float(np.median(found["loop"] / found["set"]))
    cells = [
        milliseconds(found["set"]),
        milliseconds(found["loop"]),
        f"{share:.2f}",
        at_least(share, GOAL_SPEED),
    ]
    print_table(["what", "set, ms", "loop, ms", "share", f">= {GOAL_SPEED}"], [["one stimulus", *cells]])
