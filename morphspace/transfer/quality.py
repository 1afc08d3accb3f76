"""The quality of a mimicry: what became of a face on its way, and how far the target follows (methods 5).

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
from morphspace.grid import warp
from morphspace.model.keypoints import affine_between_models, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset, displacement_columns, texture_columns
from morphspace.transfer.neutral import MEAN, Neutral, neutral_of
from morphspace.transfer.probable import FEATURE_WEIGHT, feature_weights
from morphspace.transfer.projection import Projection

NEAR = 0.3  # of a feature point's weight; with it some 5 % of a face's pixels lie on lids, brows and lips
INSIDE = 0.5  # of both masks
WORST = 0.95  # quantile over those pixels: a corner of the mouth counts, a single pixel does not


@dataclass(frozen=True, eq=False)
class Quality:
    """What became of one face on its way (methods 5).

    `texture_kept` and `warp_kept`: shares of the carried offset's energy that the target's components can show;
    `length_sd`: root mean square of the loadings in SD; `largest_sd`: the largest of them before it was bounded;
    `bounded`: how many components the bound shortened by more than a tenth; `folds`: share of cells inside the mask
    that the face turns over.
    """

    texture_kept: float
    warp_kept: float
    length_sd: float
    largest_sd: float
    bounded: int
    folds: float


def quality_of(
    target: MorphModel,
    carried: MorphOffset,
    shown: MorphOffset,
    asked: LoadingVector,
    loadings: LoadingVector,
    morph: Morph,
) -> Quality:
    """Judge a face of the target.

    Parameters
    ----------
    target : MorphModel
    carried, shown : MorphOffset
        What was asked for on the target's mean face, and what the target's components show of it.
    asked, loadings : (k,)
        The loadings before and after the bound.
    morph : Morph
        The face that was made.
    """
    missing = carried - shown
    kept = []
    for part in (texture_columns(carried.shape), displacement_columns(carried.shape)):
        weight = target.basis.weight[part]
        energy = _energy(weight, carried.vector[part])
        kept.append(1 - _energy(weight, missing.vector[part]) / energy if energy > 0 else 1.0)
    return Quality(
        texture_kept=kept[0],
        warp_kept=kept[1],
        length_sd=float(np.sqrt(np.mean((loadings / target.sd) ** 2))),
        largest_sd=float(np.abs(asked / target.sd).max()),
        bounded=int((np.abs(loadings) < 0.9 * np.abs(asked)).sum()),
        folds=warp.fold_fraction(morph.displacement, target.mask),
    )


def _energy(weight: AnyArray, values: AnyArray) -> float:
    return float(np.dot(weight * values, values))


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

    def __call__(
        self, offset: MorphOffset, made: Morph, made_loadings: LoadingVector, loadings: LoadingVector
    ) -> Reach:
        """Give the reach of the face `made` (its loadings (k_B,)) for an offset of the source (its loadings (k_A,))."""


def reach_of(source: MorphModel, target: MorphModel, gain: float, neutral: Neutral | None = None) -> ReachOf:
    """Prepare a pair of models; give the function that judges each face (ours).

    `gain` multiplies what is asked for; `neutral` are the neutral faces of both, None for the means. Raises as
    `Projection`.
    """
    projection = Projection(source, target)
    neutral = neutral or neutral_of(source, target, MEAN)
    source_neutral, target_neutral = neutral.offsets(source, target)
    inside = projection.seen * target.mask > INSIDE
    places = np.flatnonzero(_features(target) & inside.reshape(-1))
    skin = inside[..., None].astype(np.float32)
    right, left, _ = required_faceframe(target).points
    eyes_px = float(np.hypot(*(left - right)))
    fields = target.component_displacements.reshape(target.rank, -1, 2)
    components = np.take(fields, places, axis=1).reshape(target.rank, -1)
    openings = openings_of(source, target, neutral)
    start = np.zeros((len(places), 2), np.float32)
    coloured = np.zeros_like(target.mean.texture)
    if target_neutral is not None:
        start = target_neutral.displacement.reshape(-1, 2)[places]
        coloured = target_neutral.texture

    def reach(
        offset: MorphOffset, made: Morph, made_loadings: LoadingVector, loadings: LoadingVector
    ) -> Reach:
        since = offset if source_neutral is None else offset - source_neutral
        asked = projection.carried(since) * gain
        shown = (np.asarray(made_loadings, np.float32) @ components).reshape(-1, 2)
        missing = asked.displacement.reshape(-1, 2)[places] + start - shown
        lengths = np.hypot(missing[:, 0], missing[:, 1])
        return Reach(
            float(np.quantile(lengths, WORST)) / eyes_px if len(lengths) else 0.0,
            _agreement(skin * asked.texture, skin * (made.texture - target.mean.texture - coloured)),
            None if openings is None else openings.beyond(loadings, gain),
        )

    return reach


@dataclass(frozen=True, eq=False)
class Openings:
    """How far the lips stand open, from the landmark regressions of both models, in eye distances of the target.

    `asked` (k_A,) per loading of the source, after the affine | `source_neutral`, `target_neutral` of the neutral
    faces | `most`, the widest of the target's training faces. All relative to the means.
    """

    asked: AnyArray
    source_neutral: float
    target_neutral: float
    most: float

    def beyond(self, loadings: LoadingVector, gain: float) -> float:
        """Give how much wider than `most` a face of the source, of loadings (k_A,), asks the lips to open."""
        wanted = gain * (float(loadings @ self.asked) - self.source_neutral)
        return wanted + self.target_neutral - self.most


def openings_of(source: MorphModel, target: MorphModel, neutral: Neutral) -> Openings | None:
    """Prepare what tells how far the lips open; None where a model does not know its landmarks."""
    if source.landmarks is None or target.landmarks is None:
        return None
    right, left, lip = required_faceframe(target).points
    down = lip - (right + left) / 2
    down = down / (np.hypot(*down) * np.hypot(*(left - right)))  # per px, in eye distances
    linear = affine_between_models(source, target)[:, :2]
    lips = landmark_places("inner lips")
    shown = mean_gap(target.landmarks.weights[:, lips]) @ down
    asked = mean_gap(source.landmarks.weights[:, lips]) @ linear.T @ down
    most = float((target.training.values @ shown).max(initial=0.0))
    return Openings(asked, float(neutral.source @ asked), float(neutral.target @ shown), most)


def _features(target: MorphModel) -> AnyArray:
    """Give which pixels lie near lids, brows and lips, (h w,); all where the model does not know."""
    near = (feature_weights(target) - 1).reshape(-1) / FEATURE_WEIGHT > NEAR
    return near if near.any() else np.ones_like(near)


def _agreement(one: AnyArray, other: AnyArray) -> float:
    """Give the correlation of two changes of colour (h, w, 3), without taking means."""
    one, other = one.reshape(-1), other.reshape(-1)
    lengths = float(np.sqrt(np.dot(one, one))) * float(np.sqrt(np.dot(other, other)))
    return float(np.clip(np.dot(one, other) / lengths, -1, 1)) if lengths > 0 else 0.0
