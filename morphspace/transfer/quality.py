"""How far the target follows, judged alike for every method: what is missing of the motion, and how colours agree.

Shares of energy say little between people. Skin and light differ, so that most of the carried change of colour is
nothing the target could show; and a small share of a large motion may be a closed mouth that should stand open. So the
motion is looked at where expressions are read, in units of the face, and of the colours only whether they change alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.face.expression import mean_gap
from morphspace.face.mesh import landmark_places
from morphspace.model.keypoints import affine_between_models, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset, vector_of
from morphspace.transfer.mimicry import FEATURE_WEIGHT, Mimicry, Passage, feature_weights
from morphspace.transfer.probable import InnerProducts

NEAR = 0.3  # of a feature point's weight; with it some 5 % of a face's pixels lie on lids, brows and lips
INSIDE = 0.5  # of both masks
WORST = 0.95  # quantile over those pixels: a corner of the mouth counts, a single pixel does not


@dataclass(frozen=True, eq=False)
class Reach:
    """How far the target follows one face, and how far beyond what it has shown it was asked.

    `missing_motion`: what its loadings leave of the motion asked for at lids, brows and lips, 95th percentile, in eye
    distances of the target; over the whole face where the target does not know where those are. `colour_agreement`:
    correlation, without taking means, of the change of colour asked for with the one shown, inside both masks; 0 where
    one of them changes nothing. `opening_beyond`: how much wider the lips are asked to stand open than in any training
    face of the target, mean over the inner lips, in its eye distances, below 0 where they are not; None where a model
    does not know its landmarks.
    """

    missing_motion: float
    colour_agreement: float
    opening_beyond: float | None = None


class ReachOf(Protocol):
    """Judges what a difference from the source's mean became."""

    def __call__(self, offset: MorphOffset, mimicry: Mimicry, loadings: LoadingVector | None = None) -> Reach:
        """Give the reach. `loadings` (k_A,) are the offset's on the source's components, read from it where None."""


def reach_of(
    source: MorphModel, target: MorphModel, gain: float, rest: tuple[MorphOffset, MorphOffset] | None = None
) -> ReachOf:
    """Prepare a pair of models; give the function that judges each face (ours).

    `gain` multiplies what is asked for; `rest` are the faces of source and target that count as rest, relative to their
    means, None for the means. Raises as `Passage`.
    """
    passage = Passage(source, target)
    inside = passage.seen * target.mask > INSIDE
    places = np.flatnonzero(_features(target) & inside.reshape(-1))
    skin = inside[..., None].astype(np.float32)
    right, left, _ = required_faceframe(target).points
    eyes_px = float(np.hypot(*(left - right)))
    colours = 3 * target.mask.size
    columns = colours + (2 * places[:, None] + (0, 1)).reshape(-1)
    components = np.array(target.basis.components[:, columns])
    at_rest = np.zeros((len(places), 2), np.float32)
    coloured = np.zeros_like(target.mean.texture)
    openings = openings_of(source, target, rest)
    if rest is not None:
        at_rest = rest[1].displacement.reshape(-1, 2)[places]
        coloured = rest[1].texture

    def reach(offset: MorphOffset, mimicry: Mimicry, loadings: LoadingVector | None = None) -> Reach:
        asked = passage.carried(offset if rest is None else offset - rest[0]) * gain
        shown = (np.asarray(mimicry.loadings, np.float32) @ components).reshape(-1, 2)
        missing = asked.displacement.reshape(-1, 2)[places] + at_rest - shown
        lengths = np.hypot(missing[:, 0], missing[:, 1])
        texture = mimicry.morph.texture - target.mean.texture - coloured
        return Reach(
            float(np.quantile(lengths, WORST)) / eyes_px if len(lengths) else 0.0,
            _agreement(skin * asked.texture, skin * texture),
            None if openings is None else openings.beyond(offset, gain, loadings),
        )

    return reach


@dataclass(frozen=True, eq=False)
class Openings:
    """How far the lips stand open, from the landmark regressions of both models, in eye distances of the target.

    `asked` (k_A,) per loading of the source, after the affine | `at_rest`, of the faces of source and target that count
    as rest | `most`, the widest of the target's training faces. All relative to the means.
    """

    source: InnerProducts
    asked: AnyArray
    at_rest: tuple[float, float]
    most: float

    def beyond(self, offset: MorphOffset, gain: float, loadings: LoadingVector | None = None) -> float:
        """Give how much wider than `most` an offset of the source asks the lips to open.

        `loadings` (k_A,) are its own, read from it where None.
        """
        if loadings is None:
            loadings = self.source.with_offset(vector_of(offset.texture, offset.displacement))
        from_rest, to_rest = self.at_rest
        return gain * (float(loadings @ self.asked) - from_rest) + to_rest - self.most


def openings_of(
    source: MorphModel, target: MorphModel, rest: tuple[MorphOffset, MorphOffset] | None = None
) -> Openings | None:
    """Prepare what tells how far the lips open; None where a model does not know its landmarks.

    `rest` as `reach_of` has it.
    """
    if source.landmarks is None or target.landmarks is None:
        return None
    right, left, lip = required_faceframe(target).points
    down = lip - (right + left) / 2
    down = down / (np.hypot(*down) * np.hypot(*(left - right)))  # per px, in eye distances
    linear = affine_between_models(source, target)[:, :2]
    shown = mean_gap(target.landmarks.weights[:, landmark_places("inner lips")]) @ down
    asked = mean_gap(source.landmarks.weights[:, landmark_places("inner lips")]) @ linear.T @ down
    at_rest = (0.0, 0.0)
    if rest is not None:
        loadings = [
            model.basis.project(vector_of(face.texture, face.displacement))
            for model, face in zip((source, target), rest, strict=True)
        ]
        at_rest = (float(loadings[0] @ asked), float(loadings[1] @ shown))
    most = float((target.training.values @ shown).max(initial=0.0))
    return Openings(InnerProducts(source, source.basis.weight), asked, at_rest, most)


def _features(target: MorphModel) -> AnyArray:
    """Give which pixels lie near lids, brows and lips, (h w,); all where the model does not know."""
    near = (feature_weights(target) - 1).reshape(-1) / FEATURE_WEIGHT > NEAR
    return near if near.any() else np.ones_like(near)


def _agreement(one: AnyArray, other: AnyArray) -> float:
    """Give the correlation of two changes of colour (h, w, 3), without taking means."""
    one, other = one.reshape(-1), other.reshape(-1)
    lengths = float(np.sqrt(np.dot(one, one))) * float(np.sqrt(np.dot(other, other)))
    return float(np.clip(np.dot(one, other) / lengths, -1, 1)) if lengths > 0 else 0.0
