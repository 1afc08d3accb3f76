"""The blend where the right answer is known: two drawn actors against one drawn with their averaged parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from avatar import settings_of
from tables import at_most, print_table, tell

from morphspace.arrays import AnyArray, Displacement, Image, Mask, Points
from morphspace.avatar import Avatar, blend_steps
from morphspace.face.faceframe import FaceFrame
from morphspace.face.regions import face_mask
from morphspace.face.registration import fitted_similarity
from morphspace.flow.baselines import LUMA
from morphspace.flow.methods import named
from morphspace.grid import warp
from morphspace.io.images import write_image
from morphspace.io.sidecars import MarkedFaceframe, Sidecar, write_sidecar
from morphspace.model.model import MorphModel
from morphspace.notebook import build
from morphspace.steps import result_of, spread
from morphspace.synthetic.actor import Actor, ActorFrame
from morphspace.synthetic.drawn import drawn_actor
from morphspace.synthetic.parameters import ACTIONS, SIGNED_ACTIONS, Expression, Identity
from morphspace.synthetic.performance import expression_sequence

SEED = 33
PEOPLE = (22, 9)  # of SEED: 3.7 px apart, the most of those looked at; the one in the middle is 1.8 from both
FRAMES = 100  # of each actor
SIZE = (200, 240)
COMPONENTS = 50
EXPRESSIONS = 30  # of each actor, blended
JUDGED = 12  # of each actor's
SHARES = (0.3, 0.5, 0.7)  # of the first actor
# From the drawn answer to what was made; no estimator of ours, and light does not mislead it
FLOW = "deepflow"
GOAL_PX, GOAL_PERCENT = 1.0, 10.0
GOAL_SHARE = 0.05  # of the way from one actor to the other
NUDGE = 0.05  # of an amount, for its derivative
# SD of an amount's error, and px of the flow's, whose errors run together: for what does not show
PRIOR = (0.3, 3.0)
EDGE = 0.02  # luma per px, where a point counts half: without texture a flow is a guess
EDGE_REACH_PX = 1.5
WORST_NAMED = 3  # amounts
LEAST_RANGE = 0.05  # of a parameter, that it counts as moving
TAKEN = ("hair_style", "seed")  # parameters that have no mean: the first actor's


def avatar_drawn(work: Path) -> None:
    """Print how far blends of two drawn actors are from the actor drawn with the mean of their parameters."""
    print(
        f"Two drawn actors of {FRAMES} frames each (seed {SEED}), with performances of their own, blended with weights "
        f"{', '.join(f'({share:g}, {1 - share:.1f})' for share in SHARES)}, {EXPRESSIONS} expressions of each; fast "
        "flow. The right answer is the actor drawn with the weighted mean of their parameters of identity and with the "
        "same expression. Keypoints: off by the flow from the answer to what was made, at the answer's keypoints, rms "
        "over keypoints and expressions after the similarity that places each head best, and the same before it. "
        "Expression: the same flow is explained by small changes of the drawn amounts (least squares with the drawn "
        "derivatives and a similarity); rms over expressions in % of the range that is asked, for the amounts that "
        "move. Control: a drawing whose identity is a tenth nearer to the first actor and whose amounts differ at "
        "random by up to a tenth, against what it truly is: what the instrument itself errs by. Nearer source: its own "
        "drawing of the same expression. Pixel average: the same versions, without a warp.\n"
    )
    folder = work / "avatar-drawn"
    people = [Identity.random(np.random.default_rng([SEED, k])) for k in PEOPLE]
    performances = [expression_sequence(FRAMES, np.random.default_rng([SEED, 1, k])) for k in PEOPLE]
    models = []
    for k, (identity, performance) in enumerate(zip(people, performances, strict=True)):
        tell(f"avatar-drawn: drawing and building {k + 1} of 2")
        models.append(_model(folder / f"drawn_{k + 1}", identity, performance))
    rows, places = [], []
    for share in SHARES:
        tell(f"avatar-drawn: weights {share:g}, {1 - share:.1f}")
        settings = settings_of(weights=(share, 1 - share), expressions=EXPRESSIONS, flow="fast")
        blend = result_of(blend_steps(models, settings, folder / f"blend_{share:g}"))
        shown = _shown(blend, performances)
        truth = Truth(people, share)
        pictures = {
            "blend": [blend.blend(index) for index, _ in shown],
            "pixel average": [blend.pixel_average(index) for index, _ in shown],
            "nearer source": [truth.source(expression) for _, expression in shown],
            "control": [truth.nudged(expression) for _, expression in shown],
        }
        for name, found in _measured(truth, [expression for _, expression in shown], pictures).items():
            if name == "control":
                found = found.against(truth)
            rows.append([f"{share:g}, {1 - share:.1f}", name, *found.cells(is_goal=name == "blend")])
            if name == "blend":
                off = abs(found.way - found.drawn)
                places.append(
                    [f"{share:g}", f"{found.drawn:.3f}", f"{found.way:.3f}", at_most(off, GOAL_SHARE)]
                )
    heads = ["weights", "what", "keypoints off, px", "goal?", "before placing", "worst keypoint"]
    heads += ["amounts off by %, median", "largest", f"<= {GOAL_PERCENT:g} %", "worst"]
    print_table(heads, rows)
    print(
        "How far the keypoints of the blend stand on the way from the second actor (0) to the first (1), by least "
        "squares over all keypoints and expressions, and how far those of the drawn answer: it is not quite in between "
        f"where jaws open. Goal: within {GOAL_SHARE:g} of the answer.\n"
    )
    print_table(["weight of the first", "drawn answer", "blend", "goal?"], places)


def _shown(blend: Avatar, performances: Sequence[Sequence[Expression]]) -> list[tuple[int, Expression]]:
    """Give the blended expressions that are measured: their index and what was asked, evenly spread for each actor."""
    sources = np.array([expression.source for expression in blend.expressions])
    shown = []
    for place, performance in enumerate(performances):
        mine = np.flatnonzero(sources == place)
        for index in mine[spread(len(mine), JUDGED)]:
            frame = blend.expressions[int(index)].frame
            shown.append((int(index), performance[int(frame.split("_")[-1].split(".")[0])]))
    return shown


class Truth:
    """The actors of one weighting: both, the one between them, and one a tenth nearer to the first."""

    def __init__(self, people: Sequence[Identity], share: float) -> None:
        self.actors = [drawn_actor(identity, SIZE) for identity in people]
        self.answer = drawn_actor(mixed_identity(*people, share), SIZE)
        self.nearer = drawn_actor(mixed_identity(*people, share + 0.1), SIZE)
        self.nearest = self.actors[0 if share >= 0.5 else 1]
        self.rng = np.random.default_rng([SEED, 2])
        self.nudges: list[tuple[AnyArray, Points]] = []

    def source(self, expression: Expression) -> Image:
        """Draw the expression by the actor who has more weight."""
        return _stored(self.nearest.draw(expression).image)

    def nudged(self, expression: Expression) -> Image:
        """Draw the control, and remember by what its amounts and its keypoints differ from the answer's."""
        amounts = _amounts(expression)
        low = np.array([-1.0 if name in SIGNED_ACTIONS else 0.0 for name in ACTIONS])
        other = np.clip(amounts + self.rng.uniform(-0.1, 0.1, len(amounts)), low, 1.0)
        frame = self.nearer.draw(_expression(other))
        self.nudges.append((other - amounts, frame.keypoints - self.answer.draw(expression).keypoints))
        return _stored(frame.image)


@dataclass(frozen=True, eq=False)
class Found:
    """What was measured of n pictures with m keypoints and p amounts.

    `raw`, `placed` (n, m, 2) px off, before and after the similarity | `amounts` (n, p) off | `ranges` (p,) asked |
    `way` from the second actor to the first, and where the drawn answer is, `drawn`.
    """

    raw: AnyArray
    placed: AnyArray
    amounts: AnyArray
    ranges: AnyArray
    way: float
    drawn: float

    def against(self, truth: Truth) -> Found:
        """Give what is left when what is truly different is taken off; placing is not needed then."""
        amounts, points = (np.array(part) for part in zip(*truth.nudges, strict=True))
        raw = self.raw - points
        return Found(raw, raw, self.amounts - amounts, self.ranges, self.way, self.drawn)

    def cells(self, *, is_goal: bool) -> list[str]:
        """Give the cells of its row; the verdicts stand where it is what the goal is for."""
        moves = self.ranges > LEAST_RANGE
        off = 100 * np.sqrt((self.amounts**2).mean(axis=0))[moves] / self.ranges[moves]
        worst = np.sqrt((self.placed**2).sum(axis=-1).mean(axis=0)).max()
        within = f"{(off <= GOAL_PERCENT).sum()} of {moves.sum()}"
        if is_goal:
            within += " met" if off.max() <= GOAL_PERCENT else " MISSED"
        names = np.array(ACTIONS)[moves][np.argsort(-off)[:WORST_NAMED]]
        return [
            f"{_rms(self.placed):.2f}",
            at_most(_rms(self.placed), GOAL_PX) if is_goal else "",
            f"{_rms(self.raw):.2f}",
            f"{worst:.2f}",
            f"{np.median(off):.1f}",
            f"{off.max():.1f}",
            within,
            ", ".join(names),
        ]


def mixed_identity(one: Identity, other: Identity, share: float) -> Identity:
    """Give the identity with the weighted mean of every parameter; those of `TAKEN` are the first's."""
    values = {}
    for field in fields(Identity):
        first, second = getattr(one, field.name), getattr(other, field.name)
        if field.name in TAKEN:
            values[field.name] = first
        elif isinstance(first, tuple):
            values[field.name] = tuple(
                share * a + (1 - share) * b for a, b in zip(first, second, strict=True)
            )
        else:
            values[field.name] = share * first + (1 - share) * second
    return Identity(**values)


def _model(folder: Path, identity: Identity, performance: list[Expression]) -> MorphModel:
    actor = drawn_actor(identity, SIZE)
    for index, expression in enumerate(performance):
        write_image(folder / f"frame_{index:04d}.png", actor.draw(expression).image)
    points = np.round(actor.draw(performance[0]).faceframe, 3)
    marked = MarkedFaceframe(image="frame_0000.png", points=points, size=actor.size)
    write_sidecar(
        folder / "clip.json", Sidecar(identity=folder.name, consent="drawn: no person", faceframe=marked)
    )
    return build(folder, components=COMPONENTS, identity=folder.name, flow="fast")


def _measured(
    truth: Truth, asked: Sequence[Expression], made: Mapping[str, Sequence[Image]]
) -> dict[str, Found]:
    """Measure what was made of the expressions, each kind by its name."""
    parts: dict[str, list[tuple[AnyArray, ...]]] = {name: [] for name in made}
    for place, expression in enumerate(asked):
        right = truth.answer.draw(expression)
        points = right.keypoints
        read = _amounts_reader(truth.answer, right)
        find = named(FLOW)(_stored(right.image))
        ends = [_placed(actor.draw(expression).keypoints, points) for actor in truth.actors]
        for name, pictures in made.items():
            flow = find(np.clip(pictures[place], 0, 1), None).displacement
            there = warp.move_points(flow, points)
            placed = _placed(there, points) - points
            parts[name].append((there - points, placed, read(flow), points - ends[1], ends[0] - ends[1]))
    ranges = np.ptp([_amounts(expression) for expression in asked], axis=0)
    found = {}
    for name, rows in parts.items():
        raw, placed, amounts, offsets, ways = (np.array(part) for part in zip(*rows, strict=True))
        unit = ways / (ways**2).sum()
        drawn = float((offsets * unit).sum())
        found[name] = Found(raw, placed, amounts, ranges, drawn + float((placed * unit).sum()), drawn)
    return found


def _amounts_reader(actor: Actor, right: ActorFrame) -> Callable[[Displacement], AnyArray]:
    """Give the function from a flow (h, w, 2) off a drawing to the changes (p,) of its amounts that explain it.

    A similarity is allowed beside them. The derivative of each point's place is taken from drawings with one amount
    changed. Points count by their texture; those of the neutral face that are hidden in the drawing, or in one with a
    changed amount, do not.
    """
    asked = _amounts(right.expression)
    columns, seen = [], right.visibility > 0
    for place in range(len(asked)):
        step = -NUDGE if asked[place] + NUDGE > 1 else NUDGE
        changed = asked.copy()
        changed[place] += step
        frame = actor.draw(_expression(changed))
        seen &= frame.visibility > 0
        columns.append((frame.displacement - right.displacement) / step)
    height, width = seen.shape
    seen &= face_mask(height, width, FaceFrame(*map(tuple, right.faceframe))) > 0.5
    rows, across = np.nonzero(seen)
    x, y = across - width / 2, rows - height / 2
    turn, grow = np.stack([-y, x], axis=-1) / width, np.stack([x, y], axis=-1) / width
    ones, none = np.ones(len(x)), np.zeros(len(x))
    head = [turn, grow, np.stack([ones, none], axis=-1), np.stack([none, ones], axis=-1)]
    design = np.stack([*(column[rows, across] for column in columns), *head], axis=-1).reshape(2 * len(x), -1)
    textured = np.repeat(_textured(right.image)[..., None], 2, axis=2)
    weighted = design * warp.sample_field(textured, right.displacement)[rows, across].reshape(-1, 1)
    gram = weighted.T @ design
    gram[np.diag_indices(len(asked))] += (PRIOR[1] / PRIOR[0]) ** 2

    def read(flow: Displacement) -> AnyArray:
        off = warp.sample_field(flow, right.displacement)[rows, across].reshape(-1)
        return np.asarray(np.linalg.solve(gram, weighted.T @ off)[: len(asked)])

    return read


def _textured(image: Image) -> Mask:
    luma = (image @ LUMA).astype(np.float32)
    across, down = (cv2.Sobel(luma, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    power = cv2.GaussianBlur(across**2 + down**2, (0, 0), EDGE_REACH_PX)
    return np.asarray(power / (power + EDGE**2), np.float32)


def _placed(points: Points, onto: Points) -> Points:
    return warp.apply_affine(fitted_similarity(points, onto), points)


def _amounts(expression: Expression) -> AnyArray:
    return np.array(list(expression.as_dict().values()))


def _expression(amounts: AnyArray) -> Expression:
    return Expression(**dict(zip(ACTIONS, map(float, amounts), strict=True)))


def _stored(image: Image) -> Image:
    return np.float32(np.round(255 * np.clip(image, 0, 1)) / 255)


def _rms(vectors: AnyArray) -> float:
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))
