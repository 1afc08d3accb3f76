"""Adaptive search in face space: a participant picks the best of several faces, the next come from the choices.

    python examples/adaptive_search.py anna.morph -o session-07              # the first faces: session-07/trial_001
    python examples/adaptive_search.py anna.morph -o session-07 --picked 4   # face 4 was the best: the next faces
    python examples/adaptive_search.py anna.morph --simulate                 # how well does it find a hidden face?

What is looked for (say, the face that looks most trustworthy) is a point t of face space, in SD of the first
components. Before any choice t has the distribution of the model's own faces, the standard normal. A participant
who is shown x_1 ... x_m picks i with probability proportional to exp(-precision |x_i - t|^2 / 2): an ideal point
(Coombs 1964) with a conditional logit choice (McFadden 1974). |t|^2 falls out, so the choice is a logit of a linear
function of t and the posterior has one peak: it is taken as a Gaussian there (Laplace), once for each of several
precisions, which are weighed by how well they explain the choices. The next faces are, of many sets drawn from the
posterior and spread about it, the set whose choice tells most about t (expected information; Houlsby et al. 2011).
Copy the file and change what you like.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from morphspace.documents import read_json_object
from morphspace.errors import BadInput, MorphspaceError
from morphspace.io.tables import write_loadings_table
from morphspace.model.model import MorphModel, load_model
from morphspace.steps import result_of
from morphspace.storage import json_text, write_text
from morphspace.verbs import render
from morphspace.verbs.render import RenderRequest

PRECISIONS = 2.0 ** np.arange(-4, 8)  # of choices, per SD^2: from guessing to hardly ever wrong
CANDIDATES = 60  # sets to choose from
BELIEVED = 300  # points of the posterior they are judged by
SPREADS = (1.0, 1.5, 2.0, 3.0)  # of candidates about the estimate: later in a search like faces tell nothing
COMMON_PERCENT = 95  # of the model's own faces lie no further out than the faces shown
CLOSE = 1e-9  # of the log posterior: the peak is found
Keep = Callable[[np.ndarray], np.ndarray]
LETTERS = "abcdefghijklmnopqrstuvwxyz"
SIMULATED_NOISE = (0.0, 0.1, 0.3)
SHOWN_TRIALS = (0, 5, 10, 20, 30, 40, 60, 80, 120)


def kept_plausible(model: MorphModel, components: int) -> Keep:
    """Give a function that brings faces (..., k) in SD to where the model's own faces lie.

    No component goes further than in any of them, either way (a mouth that opens does not close beyond closed), and
    no face is further from the mean than all but a few of them.
    """
    own = model.training.in_sd(model).values[:, :components]
    furthest = float(np.percentile(np.sqrt((own**2).mean(axis=1)), COMMON_PERCENT))

    def keep(faces: np.ndarray) -> np.ndarray:
        inside = np.clip(faces, own.min(axis=0), own.max(axis=0))
        rms = np.sqrt((inside**2).mean(axis=-1, keepdims=True))
        return inside * np.minimum(1, furthest / np.maximum(rms, 1e-9))

    return keep


class Search:
    """What is believed about the face that is looked for, (k,) in SD, after the choices so far.

    `keep` brings faces (..., k) to where faces can be drawn; only such are shown.
    """

    def __init__(self, components: int, shown: int, seed: int, keep: Keep = np.asarray) -> None:
        self.components, self.shown, self.seed, self.keep = components, shown, seed, keep
        self.sets: list[np.ndarray] = []  # (m, k) each, in SD
        self.choices: list[int] = []
        count = len(PRECISIONS)
        self.weights, self.peaks = np.full(count, 1 / count), np.zeros((count, components))
        self.covariances = np.repeat(np.eye(components)[None], count, axis=0)
        self.roots = self.covariances  # of the covariances, triangular

    def add(self, faces: np.ndarray, choice: int) -> None:
        """Learn that of `faces` (m, k) the one at `choice` was picked."""
        self.sets.append(faces)
        self.choices.append(choice)
        evidence = np.array([self._settle(place) for place in range(len(PRECISIONS))])
        self.weights = np.exp(evidence - _log_sum(evidence))
        self.roots = np.linalg.cholesky(self.covariances)

    def estimate(self) -> np.ndarray:
        """Give the expected face (k,)."""
        return self.weights @ self.peaks

    def uncertainty(self) -> float:
        """Give the expected root mean square distance of the estimate from what is looked for, SD."""
        spread = np.trace(self.covariances, axis1=1, axis2=2) + ((self.peaks - self.estimate()) ** 2).sum(
            axis=1
        )
        return float(np.sqrt(self.weights @ spread / self.components))

    def next_faces(self) -> np.ndarray:
        """Give the faces (m, k) to show next; the same choices and seed give the same faces."""
        rng = np.random.default_rng([self.seed, len(self.choices)])
        believed, precision = self._believed(rng, BELIEVED)
        best, most = believed[: self.shown], -np.inf
        for candidate in range(CANDIDATES):
            drawn, _ = self._believed(rng, self.shown)
            spread = SPREADS[candidate % len(SPREADS)]
            faces = self.keep(self.estimate() + spread * (drawn - self.estimate()))
            chances = _chances(faces, believed, precision)
            gained = _entropy(chances.mean(axis=0)) - _entropy(chances).mean()
            if gained > most:
                best, most = faces, gained
        return best

    def _settle(self, place: int) -> float:
        """Find the posterior's peak and covariance for one precision (Newton); give the log evidence (Laplace)."""
        sets, chosen = np.stack(self.sets), np.array(self.choices)
        precision, trials = PRECISIONS[place], np.arange(len(chosen))
        t = self.peaks[place]

        def log_posterior(at: np.ndarray) -> float:
            worth = _worth(sets, at, precision)
            return float(-0.5 * at @ at + (worth[trials, chosen] - _log_sum(worth)).sum())

        height = log_posterior(t)
        while True:
            chances = _chances(sets, t, precision)
            expected = (chances[:, None] @ sets)[:, 0]
            gradient = precision * (sets[trials, chosen] - expected).sum(axis=0) - t
            apart = (np.sqrt(chances)[..., None] * (sets - expected[:, None])).reshape(-1, len(t))
            curvature = np.eye(len(t)) + precision**2 * apart.T @ apart
            step, share = np.linalg.solve(curvature, gradient), 1.0
            while (found := log_posterior(t + share * step)) < height and share > CLOSE:
                share /= 2
            if found - height < CLOSE:
                break
            t, height = t + share * step, found
        self.peaks[place], self.covariances[place] = t, np.linalg.inv(curvature)
        return height - 0.5 * float(np.linalg.slogdet(curvature)[1])

    def _believed(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Draw points (count, k) of the posterior, and the precision (count,) each goes with."""
        which = rng.choice(len(PRECISIONS), count, p=self.weights)
        normal = rng.standard_normal((count, self.components, 1))
        return self.peaks[which] + (self.roots[which] @ normal)[..., 0], PRECISIONS[which]


def _worth(faces: np.ndarray, t: np.ndarray, precision: np.ndarray | float) -> np.ndarray:
    """Give -precision |x - t|^2 / 2 of faces (..., m, k) but for what does not depend on the face: (..., m)."""
    return np.asarray(precision)[..., None] * ((faces @ t[..., None])[..., 0] - 0.5 * (faces**2).sum(-1))


def _chances(faces: np.ndarray, t: np.ndarray, precision: np.ndarray | float) -> np.ndarray:
    worth = _worth(faces, t, precision)
    return np.exp(worth - _log_sum(worth)[..., None])


def _log_sum(worth: np.ndarray) -> np.ndarray:
    """Give the logarithm of the sum of exponentials along the last axis, without overflow."""
    top = worth.max(axis=-1)
    return top + np.log(np.exp(worth - top[..., None]).sum(axis=-1))


def _entropy(chances: np.ndarray) -> np.ndarray:
    return -(chances * np.log(np.maximum(chances, 1e-300))).sum(axis=-1)


def simulated_distances(search: Search, trials: int, noise_sd: float, seed: int) -> np.ndarray:
    """Give how far the estimate is from a hidden target after 0 to `trials` choices, root mean square SD (trials + 1,).

    The target is a face drawn from the model's distribution, where faces can be drawn. The observer sees every
    face's distance from it with Gaussian noise of `noise_sd` (SD) and picks the least: not quite the choices that
    the search assumes. Infinite noise guesses.
    """
    rng = np.random.default_rng([seed, 1])
    target = search.keep(rng.standard_normal(search.components))

    def distance(faces: np.ndarray) -> np.ndarray:
        return np.sqrt(((faces - target) ** 2).mean(axis=-1))

    found = [float(distance(search.estimate()))]
    for _ in range(trials):
        faces = search.next_faces()
        noise = rng.standard_normal(len(faces))
        seen = noise if np.isinf(noise_sd) else distance(faces) + noise_sd * noise
        search.add(faces, int(seen.argmin()))
        found.append(float(distance(search.estimate())))
    return np.array(found)


def simulate(arguments: argparse.Namespace, model: MorphModel, components: int) -> None:
    """Print how the distance falls with trials, for observers of several noises and for one who guesses."""
    noises = (*SIMULATED_NOISE, np.inf) if arguments.noise is None else (arguments.noise,)
    shown = [trial for trial in SHOWN_TRIALS if trial < arguments.trials] + [arguments.trials]
    print(
        f"{components} components, {arguments.shown} faces a trial; median distance of the estimate from "
        f"the hidden face, rms SD, over {arguments.observers} observers; in brackets the third quartile\n"
    )
    print("| noise, SD | " + " | ".join(f"trial {trial}" for trial in shown) + " |")
    print("|---|" + "---|" * len(shown))
    for noise in noises:
        runs = []
        for observer in range(arguments.observers):
            search = Search(
                components, arguments.shown, arguments.seed + observer, kept_plausible(model, components)
            )
            runs.append(simulated_distances(search, arguments.trials, noise, arguments.seed + observer))
        middle, worse = np.percentile(runs, [50, 75], axis=0)
        name = "guesses" if np.isinf(noise) else f"{noise:g}"
        print(
            f"| {name} | " + " | ".join(f"{middle[t]:.2f} ({worse[t]:.2f})" for t in shown) + " |", flush=True
        )


def go_on(arguments: argparse.Namespace, model: MorphModel, components: int) -> None:
    """Take in the choice, and write the next faces and the estimate so far as pictures."""
    folder = arguments.output
    state_path = folder / "search.json"
    state = {
        "model_id": model.model_id,
        "components": components,
        "shown": arguments.shown,
        "seed": arguments.seed,
    }
    trials: list[dict] = []
    if state_path.exists():
        kept = read_json_object(state_path)
        trials = kept.pop("trials")
        if kept["model_id"] != model.model_id:
            raise BadInput(
                f"{folder} is a search with model {kept['model_id']}, this is {model.model_id}: use that one"
            )
        state = kept
    components = state["components"]
    search = Search(components, state["shown"], state["seed"], kept_plausible(model, components))
    if arguments.picked is not None:
        if not trials:
            raise BadInput(f"there is no trial in {folder} to pick from: start without --picked")
        if not 1 <= arguments.picked <= state["shown"]:
            raise BadInput(f"face {arguments.picked} was not shown: pick one of 1 to {state['shown']}")
        trials[-1]["picked"] = arguments.picked
    for trial in trials:
        if trial["picked"] is not None:
            search.add(np.array(trial["faces_sd"]), trial["picked"] - 1)
    if not trials or trials[-1]["picked"] is not None:
        trials.append({"faces_sd": search.next_faces().tolist(), "picked": None})
    number = len(trials)
    _write_faces(
        arguments.model,
        model.model_id,
        np.array(trials[-1]["faces_sd"]),
        folder / f"trial_{number:03d}",
        "face",
    )
    _write_faces(
        arguments.model, model.model_id, search.keep(search.estimate()[None]), folder / "estimate", "estimate"
    )
    write_text(state_path, json_text({**state, "trials": trials}))  # last: a stopped run is asked again
    print(
        f"trial {number}: {folder / f'trial_{number:03d}'}; the estimate is within {search.uncertainty():.2f} SD rms"
    )


def _write_faces(path: Path, model_id: str, faces_sd: np.ndarray, folder: Path, word: str) -> None:
    table = folder.with_suffix(".csv")
    write_loadings_table(
        table, faces_sd, [f"{word}_{i + 1}" for i in range(len(faces_sd))], {"model_id": model_id}
    )
    result_of(render.run(RenderRequest(path, table, folder)))


def main(words: list[str]) -> int:
    """Run what was asked for; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path, help="the model (.morph) whose faces are searched")
    parser.add_argument("-o", "--output", type=Path, help="the folder of the session")
    parser.add_argument(
        "--picked", type=int, help="which of the faces shown last was the best, counted from 1"
    )
    parser.add_argument(
        "-k", "--components", type=int, default=8, help="search the first so many (default 8)"
    )
    parser.add_argument("--shown", type=int, default=6, help="faces a trial (default 6)")
    parser.add_argument("--seed", type=int, default=0, help="the same seed and choices give the same faces")
    parser.add_argument("--simulate", action="store_true", help="let simulated observers search hidden faces")
    parser.add_argument("--trials", type=int, default=60, help="of a simulated observer (default 60)")
    parser.add_argument("--observers", type=int, default=20, help="how many are simulated (default 20)")
    parser.add_argument("--noise", type=float, help="of a simulated observer, SD (default: several)")
    arguments = parser.parse_args(words)
    if (
        arguments.components < 1
        or not 2 <= arguments.shown <= len(LETTERS)
        or arguments.trials < 1
        or arguments.observers < 1
    ):
        parser.error("ask for at least 1 component, 2 to 26 faces, 1 trial and 1 observer")
    if not arguments.simulate and arguments.output is None:
        parser.error("where should the faces go? Give -o FOLDER, or --simulate")
    try:
        model = load_model(arguments.model)
        run = simulate if arguments.simulate else go_on
        run(arguments, model, min(arguments.components, model.rank))
    except MorphspaceError as error:
        print(f"adaptive_search.py: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
