"""Drive one person's model with another person's face, by four methods (Nagle section 3 and ours).

A face of the source is a point on the source's mean face; what mimicry carries over is its difference from that mean.
The affine between the two faceframes brings the difference to the target's mean face, and the target's components say
how much of it the target can show. `paper` takes inner products, as published (`projection`). `map` asks for the most
probable face of the target instead, and looks only where the source has something to say (`probable`). `transfer`
listens to lids, brows and lips more than to cheeks, where it knows where they are, keeps half of the motion that the
target's components cannot express (`residual_motion`), and mixes the colours from faces the target has shown
(`colours`). `guided` does so too, and also takes how far the source's lids and inner lips have moved, which the
landmark regressions of both models know (`guided`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np

from morphspace.arrays import LoadingVector
from morphspace.errors import BadInput
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset
from morphspace.steps import spread
from morphspace.transfer.colours import MixedColours
from morphspace.transfer.guided import landmark_guide
from morphspace.transfer.neutral import MEAN, Neutral, neutral_of
from morphspace.transfer.probable import bounded, feature_weights, posterior_of
from morphspace.transfer.projection import Projection
from morphspace.transfer.quality import Quality, quality_of
from morphspace.transfer.residual_motion import residual_motion_of

Method = Literal["paper", "map", "transfer", "guided"]
METHODS: tuple[Method, ...] = get_args(Method)
WITH_RESIDUAL: tuple[Method, ...] = ("transfer", "guided")
"""Methods that add residual motion and mix colours; their gain is chosen automatically."""
MAX_SD = 3.0  # of a component, where it is not asked otherwise
GAIN_FACES = 40  # of the source's training faces, evenly spread, from which `auto_gain` is taken
GAIN_RANGE = (1.0, 1.3)  # beyond it, targets that never show what is asked are torn


@dataclass(frozen=True, eq=False)
class Mimicry:
    """A face of the target: its loadings (k,), the morph that was made, and its quality."""

    loadings: LoadingVector
    morph: Morph
    quality: Quality


class Mimic(Protocol):
    """Turns a difference from the source's mean into a face of the target."""

    def __call__(self, offset: MorphOffset, loadings: LoadingVector | None = None) -> Mimicry:
        """Give the face. `loadings` (k_A,) are the offset's on the source's components, read from it where None."""


Solve = Callable[[MorphOffset, MorphOffset, LoadingVector | None], LoadingVector]
"""Reads loadings (k_B,) from a difference of the source, the same carried, and its loadings where known."""


def mimic(
    source: MorphModel,
    target: MorphModel,
    method: Method = "transfer",
    *,
    gain: float = 1.0,
    max_sd: float = MAX_SD,
    neutral: Neutral | None = None,
) -> Mimic:
    """Prepare a pair of models, and give the function that makes the target show what the source shows.

    Parameters
    ----------
    source, target : MorphModel
    method : {"paper", "map", "transfer", "guided"}
    gain : float
        Multiplies the loadings.
    max_sd : float
        Bounds each loading (`bounded`), in SD of its component.
    neutral : Neutral, optional
        The neutral faces of both; the means where None.

    Raises
    ------
    BadInput
        For an unknown method, a bound that is not positive, a model without components or without keypoints, a
        `neutral` of other models, and with `guided` a model without a landmark regression.
    """
    if method not in METHODS:
        raise BadInput(f"there is no mimicry by {method!r}: choose one of {', '.join(METHODS)}")
    if not max_sd > 0 or not np.isfinite(gain):
        raise BadInput(f"a bound of {max_sd} SD and a gain of {gain} cannot be used: give a positive bound")
    if target.rank < 1:
        raise BadInput(f"the model of {target.identity} has no component: there is nothing it could show")
    projection = Projection(source, target)
    _ = projection.affine  # models that cannot be linked are refused here
    solve = _solve_of(projection, method)
    sd = target.sd
    neutral = neutral or neutral_of(source, target, MEAN)
    since_neutral = _since_neutral(source, target, neutral)
    target_neutral = neutral.offsets(source, target)[1]
    colours = MixedColours(target) if method in WITH_RESIDUAL else None
    residual = residual_motion_of(target, projection.seen) if method in WITH_RESIDUAL else None

    def to_target(offset: MorphOffset, loadings: LoadingVector | None = None) -> Mimicry:
        offset, loadings = since_neutral(offset, loadings)
        carried = projection.carried(offset)
        asked = gain * solve(offset, carried, loadings) + neutral.target
        made = sd * bounded(asked / sd, max_sd)
        shown = target.offset(made) if colours is None else colours.offset(made)
        morph = target.mean + shown
        if residual is not None:
            wanted = np.float32(gain) * carried.displacement
            if target_neutral is not None:
                wanted += target_neutral.displacement
            wanted -= shown.displacement
            morph = residual.added(wanted, morph)
        followed = shown if target_neutral is None else shown - target_neutral
        return Mimicry(made, morph, quality_of(target, carried, followed, asked, made, morph))

    return to_target


def _since_neutral(
    source: MorphModel, target: MorphModel, neutral: Neutral
) -> Callable[[MorphOffset, LoadingVector | None], tuple[MorphOffset, LoadingVector | None]]:
    """Prepare what takes the source's neutral face off a face of the source, and off its loadings where known."""
    neutral_face = neutral.offsets(source, target)[0]

    def since(
        offset: MorphOffset, loadings: LoadingVector | None
    ) -> tuple[MorphOffset, LoadingVector | None]:
        if neutral_face is None:
            return offset, loadings
        return offset - neutral_face, None if loadings is None else loadings - neutral.source

    return since


def _solve_of(projection: Projection, method: Method) -> Solve:
    if method == "paper":
        return lambda _offset, carried, _loadings: projection.loadings(carried)
    if method == "map":
        whole = posterior_of(projection)
        return lambda _offset, carried, _loadings: whole.mean(carried.vector)
    features = feature_weights(projection.target)
    if method == "transfer":
        expressive = posterior_of(projection, features)
        return lambda _offset, carried, _loadings: expressive.mean(carried.vector)
    guide = landmark_guide(projection)
    posterior = posterior_of(projection, features, guide.observations)
    own = projection.source.basis.inner_products()

    def guided(offset: MorphOffset, carried: MorphOffset, loadings: LoadingVector | None) -> LoadingVector:
        known = own.with_offset(offset.vector) if loadings is None else loadings
        return posterior.mean(carried.vector, guide.moved(known))

    return guided


def auto_gain(
    source: MorphModel, target: MorphModel, method: Method = "transfer", *, neutral: Neutral | None = None
) -> float:
    """Give the gain at which the target moves as far as the source, on average over the source's training faces.

    A projection keeps what the target's components can show, so it moves less: faces come out muted. The gain is the
    ratio of the root mean squares of the carried and of the projected displacement inside both masks, within
    `GAIN_RANGE`. Raises as `mimic`.
    """
    projection = Projection(source, target)
    solve = _solve_of(projection, method)
    inside = (projection.seen * target.mask)[..., None]
    since_neutral = _since_neutral(source, target, neutral or neutral_of(source, target, MEAN))
    asked, shown = 0.0, 0.0
    for index in spread(len(source.training.values), GAIN_FACES):
        row = source.training.values[index]
        offset, loadings = since_neutral(source.offset(row), row)
        carried = projection.carried(offset)
        projected = target.displacement_offset(solve(offset, carried, loadings))
        asked += float((inside * carried.displacement**2).sum(dtype=np.float64))
        shown += float((inside * projected**2).sum(dtype=np.float64))
    if shown == 0:
        return GAIN_RANGE[0]
    return float(np.clip(np.sqrt(asked / shown), *GAIN_RANGE))
