"""What a batch costs beside the plain loop over `render`, and what is left to do after it was killed.

Run as a script it is the fresh process in which one of the loops draws; it prints nothing. Processor time is what
is compared: other work on the machine does not count, and processes that wait do not either.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import mimicry
import numpy as np
from tables import at_least, print_table, tell

from morphspace.io.images import write_image
from morphspace.io.tables import read_loadings_table, write_loadings_table
from morphspace.model.model import load_model
from morphspace.steps import single_threads

NAME = "lp_d18"
SEARCH = Path(__file__).parents[1] / "examples" / "adaptive_search.py"
GAINS = tuple(round(0.1 * step, 1) for step in range(1, 21))  # 20 gains of 50 faces: 1,000 stimuli
FACES = 50
WORKERS = (1, 2)
MOST_ROUNDS = 3  # of some minutes each
OBSERVERS = 20
GOAL = 0.9  # of the plain loop's throughput, per core


def batch_figures(data: Path, work: Path, rounds: int) -> None:
    """Print the throughput of a batch of 1,000 stimuli beside the plain loop's, and a resume after a kill."""
    folder = work / "batch"
    folder.mkdir(exist_ok=True)
    mimicry.keyed_model(data, NAME, work)
    path = work / "mimicry" / f"{NAME}.morph"
    batch_tables(path, folder, min(rounds, MOST_ROUNDS))
    print("## Adaptive search\n")
    print(
        "examples/adaptive_search.py with simulated observers: the hidden face is drawn from the model's "
        "distribution; the "
        "observer sees how far each face shown is from it with Gaussian noise, and picks the nearest. Who "
        "guesses leads "
        "nowhere, as it should be. Rms distance in SD; two faces drawn at random are about 1.3 apart.\n"
    )
    words = [str(path), "--simulate", "--observers", str(OBSERVERS)]
    shown = subprocess.run(
        [sys.executable, str(SEARCH), *words], check=True, stdout=subprocess.PIPE, text=True
    )
    print(shown.stdout)


def batch_tables(model_path: Path, folder: Path, rounds: int) -> None:
    """Print the tables for one model, working in a folder."""
    model = load_model(model_path)
    loadings_sd = model.training.in_sd(model).values[:FACES]
    names = [f"face_{i:03d}" for i in range(len(loadings_sd))]
    write_loadings_table(folder / "faces.csv", loadings_sd, names, {"model_id": model.model_id})
    recipe = _written_recipe(model_path, folder)
    count = len(names) * len(GAINS)
    print(
        f"{count:,} caricatures of {NAME}, {model.size[0]} x {model.size[1]}, k = {model.rank}. Plain loop: "
        "`model.render` and `write_image`, one thread, and nothing else. Batch: `morphspace batch`, the "
        "whole command: planning, drawing, image statistics, sidecars, manifest, page. Processor time of "
        f"all processes, imports included; the median of {rounds} interleaved rounds. Throughput per core: "
        "stimuli a second of processor time, beside the plain loop's.\n"
    )
    seconds: dict[str, list[float]] = {}
    for round_number in range(rounds):
        tell(f"batch: round {round_number + 1} of {rounds}")
        works = {
            "plain loop": [
                sys.executable,
                __file__,
                str(model_path),
                str(folder / "faces.csv"),
                *map(str, GAINS),
            ]
        }
        for workers in WORKERS:
            works[f"batch, {workers} process{'' if workers == 1 else 'es'}"] = _command(recipe, workers)
        for what, command in works.items():
            output = folder / f"{what.replace(', ', '-').replace(' ', '-')}-{round_number}"
            seconds.setdefault(what, []).append(_processor_time([*command, "-o", str(output)]))
    plain = float(np.median(seconds["plain loop"]))
    rows = []
    for what, found in seconds.items():
        median = float(np.median(found))
        share = plain / median
        target = "" if what == "plain loop" else f">= {GOAL:g} {at_least(share, GOAL)}"
        rows.append([what, f"{median:.1f}", f"{1e3 * median / count:.1f}", f"{share:.2f}", target])
    print_table(["what", "processor s", "ms a stimulus", "throughput per core", "target"], rows)
    _resumed(recipe, folder, folder / "batch-2-processes-0", count)


def _resumed(recipe: Path, folder: Path, undisturbed: Path, count: int) -> None:
    """Kill a batch at a random moment, let it go on, and compare all files with those of one that was left alone."""
    print("## Killed and taken up\n")
    print(
        "`kill -9` of the batch in 2 processes at a random moment, then the same command again. Kept: "
        "stimuli that the second run did not draw again. Same bytes: every file of the folder, against a "
        "run that was left alone.\n"
    )
    rows = []
    for attempt in range(3):
        output = folder / f"killed-{attempt}"
        goal = random.SystemRandom().randrange(1, count)
        command = [*_command(recipe, 2), "-o", str(output)]
        process = subprocess.Popen(command, start_new_session=True)
        while len(list(output.rglob("*.png"))) < goal and process.poll() is None:
            time.sleep(0.02)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        time.sleep(1.0)  # the processes of the pool notice
        done = {
            path: path.stat().st_mtime_ns
            for path in output.rglob("*.png")
            if path.with_suffix(".json").exists()
        }
        again = _processor_time(command)
        kept = sum(path.stat().st_mtime_ns == time_ns for path, time_ns in done.items())
        same = _tree(output) == _tree(undisturbed)
        rows.append([f"{goal:,}", f"{len(done):,}", f"{kept:,}", f"{again:.1f}", "yes" if same else "NO"])
    print_table(["killed at picture", "whole then", "kept", "processor s of the rest", "same bytes"], rows)


def _written_recipe(model_path: Path, folder: Path) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(
        f"format: morphspace-recipe\nversion: 1\nfactors:\n  gain: {json.dumps(GAINS)}\nstimuli:\n  - verb: "
        f"caricature\n    model: {json.dumps(os.path.relpath(model_path, folder))}\n    loadings: "
        "faces.csv\n"
        '    gains: "{gain}"\n    name: "{frame}_g{gain}"\n',
        encoding="utf-8",
    )
    return path


def _command(recipe: Path, workers: int) -> list[str]:
    return [sys.executable, "-m", "morphspace", "batch", str(recipe), "--quiet", "--workers", str(workers)]


def _processor_time(command: list[str]) -> float:
    """Run a command; give the processor time of it and its children, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _tree(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def plain_loop(model_path: Path, table: Path, gains: list[float], output: Path) -> None:
    """Render every face at every gain and write it: what a script without the batch would do."""
    model, faces = load_model(model_path), read_loadings_table(table)
    output.mkdir(parents=True, exist_ok=True)
    with single_threads():
        for gain in gains:
            for name, row in zip(faces.frame_names, faces.loadings_sd, strict=True):
                write_image(output / f"{name}_g{gain}.png", model.render(gain * row * model.sd))


if __name__ == "__main__":
    model_words, table_words, *gain_words, _, output_words = sys.argv[1:]
    plain_loop(Path(model_words), Path(table_words), [float(word) for word in gain_words], Path(output_words))
