"""Mimicry where the right answer is known: a drawn actor drives another, who is drawn with the same expression."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tables import print_table, tell

from morphspace.arrays import AnyArray, Image
from morphspace.linear.quality import psnr_db
from morphspace.model.model import MorphModel
from morphspace.notebook import build
from morphspace.synthetic.clips import Truth, make_actors, read_truth
from morphspace.synthetic.drawn import drawn_actor
from morphspace.synthetic.parameters import Expression, Identity
from morphspace.transfer.mimicry import METHODS, mimic

SEED = 21
TRAINED = 100  # frames of each actor
DRIVING = 25  # of the first actor's, evenly spread
COMPONENTS = 50
RIDGE = 1e-3  # of the loadings' variance
GOAL_PERCENT = 10.0  # of a parameter's range, rms


def mimicry_drawn(work: Path) -> None:
    """Print how far mimicry is from the drawn right answer, in the picture and in the parameters of expression."""
    print(
        f"Two drawn actors of {TRAINED} frames each (seed {SEED}), with performances of their own; {DRIVING} frames of "
        "the first drive the model of the second, keypoints as drawn. The right answer is the second actor drawn with "
        "the first one's expression. PSNR inside the mask, median and lowest. Parameters: read from the loadings by a "
        "ridge regression learned on the second actor's own frames; rms error over frames in % of the range "
        "asked, median and largest over the parameters that move. Encoded: the right answer itself, encoded by the "
        "second model: what can be had at best. Mean face: the second actor's mean, whatever is asked.\n"
    )
    folder = work / "mimicry-drawn"
    for piece in make_actors(folder, identities=2, frames=TRAINED, seed=SEED):
        if piece.truth is not None:
            tell(f"mimicry-drawn: drew {piece.actor}")
    models = [build(folder / f"actor_{k:02d}", components=COMPONENTS) for k in (1, 2)]
    truths = [read_truth(folder / "truth" / f"actor_{k:02d}.truth") for k in (1, 2)]
    driven = np.linspace(0, TRAINED - 1, DRIVING).astype(int)
    asked = _parameters(truths[0])[driven]
    answers = _answers(truths[1], asked)
    read = _reader(models[1], _parameters(truths[1]))
    rows = []
    encoded = np.array([models[1].encode(answer).values[0] for answer in answers])
    rows.append(
        _row("encoded", models[1], answers, [models[1].render(row) for row in encoded], read(encoded), asked)
    )
    for method in METHODS:
        if method == "guided" and any(model.landmarks is None for model in models):
            tell("mimicry-drawn: no landmarks without the detector's files, so no guided mimicry")
            continue
        tell(f"mimicry-drawn: {method}")
        to_target = mimic(models[0], models[1], method)
        made = [to_target(models[0].offset(models[0].training.values[index])) for index in driven]
        loadings = np.array([one.loadings for one in made])
        pictures = [one.morph.render() for one in made]
        rows.append(_row(method, models[1], answers, pictures, read(loadings), asked))
    still = np.zeros((DRIVING, models[1].rank))
    rows.append(
        _row("mean face", models[1], answers, [models[1].render(still[0])] * DRIVING, read(still), asked)
    )
    heads = ["what", "PSNR dB", "lowest", "parameters off by %", "largest", f"<= {GOAL_PERCENT:g} %"]
    print_table(heads, rows)


def _parameters(truth: Truth) -> AnyArray:
    names = list(Expression().as_dict())
    return np.array([[frame["expression"][name] for name in names] for frame in truth.document["frames"]])


def _answers(truth: Truth, asked: AnyArray) -> list[Image]:
    """Draw the actor of a truth with other expressions (n, 20), as 8-bit files would hold them."""
    rng = np.random.default_rng([SEED, 1])
    height, width = truth.labels.shape
    actor = drawn_actor(Identity.random(rng), (width, height))
    names = list(Expression().as_dict())
    drawn = (actor.draw(Expression(**dict(zip(names, map(float, row), strict=True)))).image for row in asked)
    return [np.float32(np.round(255 * np.clip(image, 0, 1)) / 255) for image in drawn]


def _reader(model: MorphModel, parameters: AnyArray):  # type: ignore[no-untyped-def]
    """Learn expression parameters (n, p) from loadings on the model's own frames; give the function that reads them."""
    loadings = model.training.values / model.sd
    centre = parameters.mean(axis=0)
    gram = loadings.T @ loadings + RIDGE * len(loadings) * np.eye(model.rank)
    slopes = np.linalg.solve(gram, loadings.T @ (parameters - centre))
    return lambda values: values / model.sd @ slopes + centre


def _row(
    name: str, model: MorphModel, answers: list[Image], made: list[Image], read: AnyArray, asked: AnyArray
) -> list[str]:
    decibels = [
        psnr_db(np.clip(image, 0, 1), model.align(answer, "answer").image, model.mask)
        for answer, image in zip(answers, made, strict=True)
    ]
    moves = np.ptp(asked, axis=0) > 0.05
    off = 100 * np.sqrt(((read - asked) ** 2).mean(axis=0))[moves] / np.ptp(asked, axis=0)[moves]
    return [
        name,
        f"{np.median(decibels):.2f}",
        f"{min(decibels):.2f}",
        f"{np.median(off):.1f}",
        f"{off.max():.1f}",
        "met" if off.max() <= GOAL_PERCENT else f"{(off <= GOAL_PERCENT).sum()} of {moves.sum()} met",
    ]
