"""The quality of a mimicry: what a face kept of the requested expression, and how far the target follows (ours).

Shares of energy say little between people. Skin and light differ, so that the target can show only a small part of
the carried change of colour. And a small share of a large motion may be a closed mouth that should be open. So motion
is measured where expressions are seen, in units of the face, and of colours only the direction of change.
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

NEAR = 0.3  # of a feature point's weight; about 5 % of a face's pixels are nearer to lids, brows and lips
INSIDE = 0.5  # product of both masks, from which a pixel counts as inside
WORST = 0.95  # quantile over those pixels; includes a mouth corner, excludes single pixels


@dataclass(frozen=True, eq=False)
class Quality:
    """What a face kept of the requested expression.

    Attributes
    ----------
    texture_kept, warp_kept : float
        Share of the carried offset's energy that the target's components show.
    length_sd : float
        Root mean square of the loadings, in SD.
    largest_sd : float
        The largest loading before the bound, in SD.
    bounded : int
        Components that the bound shortened by more than a tenth.
    folds : float
        Share of folded cells inside the mask.
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
    """Measure the quality of a face of the target.

    Parameters
    ----------
    target : MorphModel
    carried, shown : MorphOffset
        The requested offset on the target's mean face, and what the target's components show of it.
    asked, loadings : array (k,)
        The raw loadings before and after the bound.
    morph : Morph
        The finished face.
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
    """How far the target follows one face, and how far the request exceeds its training faces.

    Attributes
    ----------
    missing_motion : float
        Requested motion at lids, brows and lips that the loadings do not show: 95th percentile, in eye distances of
        the target. It covers the whole face if the model has no mesh points.
    colour_agreement : float
        Uncentred correlation of the requested and the shown change of colour, inside both masks; 0 if one is zero.
    opening_beyond : float or None
        Requested lip opening minus the widest of the target's training faces, mean over the inner lips, in its eye
        distances. None if a model has no landmark regression.
    """

    missing_motion: float
    colour_agreement: float
    opening_beyond: float | None = None


class ReachOf(Protocol):
    """A function that measures the reach of a face."""

    def __call__(
        self, offset: MorphOffset, made: Morph, made_loadings: LoadingVector, loadings: LoadingVector
    ) -> Reach:
        """Measure the face `made`, of loadings (k_B,), for an offset of the source, of loadings (k_A,)."""


def reach_of(source: MorphModel, target: MorphModel, gain: float, neutral: Neutral | None = None) -> ReachOf:
    """Prepare a pair of models; return the function that measures each face (ours).

    Parameters
    ----------
    source, target : MorphModel
    gain : float
        Multiplies the request.
    neutral : Neutral, optional
        The neutral faces of both; None for the means.

    Raises
    ------
    BadInput
        If the models cannot be linked.
    """
    projection = Projection(source, target)
    neutral = neutral or neutral_of(source, target, MEAN)
    source_neutral, target_neutral = neutral.offsets(source, target)
    inside = projection.source_mask * target.mask > INSIDE
    places = np.flatnonzero(_features(target) & inside.reshape(-1))
    skin = inside[..., None].astype(np.float32)
    right, left, _ = required_faceframe(target).points
    eyes_px = float(np.hypot(*(left - right)))
    fields = target.component_displacements.reshape(target.rank, -1, 2)
    components = np.take(fields, places, axis=1).reshape(target.rank, -1)
    openings = _openings_of(source, target, neutral)
    start = np.zeros((len(places), 2), np.float32)
    neutral_texture = np.zeros_like(target.mean.texture)
    if target_neutral is not None:
        start = target_neutral.displacement.reshape(-1, 2)[places]
        neutral_texture = target_neutral.texture

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
            _agreement(skin * asked.texture, skin * (made.texture - target.mean.texture - neutral_texture)),
            None if openings is None else openings.beyond(loadings, gain),
        )

    return reach


@dataclass(frozen=True, eq=False)
class Openings:
    """Lip opening as a function of the loadings of both models, in eye distances of the target, relative to the means.

    Attributes
    ----------
    asked : array (k_A,)
        Per loading of the source, after the affine.
    source_neutral, target_neutral : float
        Of the neutral faces.
    most : float
        The widest of the target's training faces.
    """

    asked: AnyArray
    source_neutral: float
    target_neutral: float
    most: float

    def beyond(self, loadings: LoadingVector, gain: float) -> float:
        """Compute how far the opening requested by a face of the source, of loadings (k_A,), exceeds `most`."""
        wanted = gain * (float(loadings @ self.asked) - self.source_neutral)
        return wanted + self.target_neutral - self.most


def _openings_of(source: MorphModel, target: MorphModel, neutral: Neutral) -> Openings | None:
    """Prepare the lip openings of a pair; None if a model has no landmark regression."""
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
    """Return which pixels (h w,) lie near lids, brows and lips; all if the model has no mesh points."""
    near = (feature_weights(target) - 1).reshape(-1) / FEATURE_WEIGHT > NEAR
    return near if near.any() else np.ones_like(near)


def _agreement(one: AnyArray, other: AnyArray) -> float:
    """Compute the uncentred correlation of two changes of colour (h, w, 3)."""
    one, other = one.reshape(-1), other.reshape(-1)
    lengths = float(np.sqrt(np.dot(one, one))) * float(np.sqrt(np.dot(other, other)))
    return float(np.clip(np.dot(one, other) / lengths, -1, 1)) if lengths > 0 else 0.0
