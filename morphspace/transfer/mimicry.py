"""Drive one person's model with another person's face, by four methods (Nagle et al., section 3, and ours).

Mimicry carries over the difference between a face of the source and the source's mean. The affine between the two
faceframes brings it to the target's mean face. The methods differ in how the target's loadings are computed:

- `paper`: inner products with the target's components, as published (`projection`).
- `map`: the most probable face of the target, given only what lies inside the source's mask (`probable`).
- `transfer`: as `map`, with lids, brows and lips weighted more than cheeks if their position is known. Half of the
  motion outside the target's components is added (`residual_motion`), and the colours are mixed from training faces
  of the target (`colours`).
- `guided`: as `transfer`, with the movement of the source's lids and inner lips as further observations, by the
  landmark
  regressions of both models (`guided`).
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
MAX_SD = 3.0  # SD of a component, the default bound
GAIN_FACES = 40  # training faces of the source, evenly spread, for `auto_gain`
GAIN_RANGE = (1.0, 1.3)  # a higher gain tears targets whose frames show nothing similar


@dataclass(frozen=True, eq=False)
class Mimicry:
    """A face of the target: its raw loadings (k_B,), its morph, and its quality."""

    loadings: LoadingVector
    morph: Morph
    quality: Quality


class Mimic(Protocol):
    """A function from an offset of the source to a face of the target."""

    def __call__(self, offset: MorphOffset, loadings: LoadingVector | None = None) -> Mimicry:
        """Compute the face. `loadings` (k_A,) are the offset's in the source's model; None projects the offset."""


Solve = Callable[[MorphOffset, MorphOffset, LoadingVector | None], LoadingVector]
"""Computes loadings (k_B,) from an offset of the source, the carried offset, and the source's loadings if known."""


def mimic(
    source: MorphModel,
    target: MorphModel,
    method: Method = "transfer",
    *,
    gain: float = 1.0,
    max_sd: float = MAX_SD,
    neutral: Neutral | None = None,
) -> Mimic:
    """Prepare a pair of models; return the function that transfers an expression from source to target.

    Parameters
    ----------
    source, target : MorphModel
    method : {"paper", "map", "transfer", "guided"}
    gain : float
        Multiplies the target's loadings; 1 is veridical.
    max_sd : float
        Bound of each loading, in SD of its component (`bounded`).
    neutral : Neutral, optional
        The neutral faces of both; None for the means.

    Returns
    -------
    Mimic

    Raises
    ------
    BadInput
        If the method is unknown, the bound is not positive, a model has no components or no keypoints, or `neutral`
        belongs to other models; with `guided` also if a model has no landmark regression.

    References
    ----------
    Nagle et al., section 3, for `paper`; the other methods are ours.

    Examples
    --------
    >>> import morphspace as ms
    >>> anna, ben = ms.load("anna.morph"), ms.load("ben.morph")
    >>> face = mimic(anna, ben, "paper")(anna.offset(anna.training.values[0]))
    >>> face.morph.shape, face.loadings.shape
    ((72, 60), (3,))
    """
    if method not in METHODS:
        raise BadInput(f"the method is {method!r}; expected one of {', '.join(METHODS)}")
    if not max_sd > 0 or not np.isfinite(gain):
        raise BadInput(f"max_sd is {max_sd} and gain {gain}; expected a bound above 0 and a finite gain")
    if target.rank < 1:
        raise BadInput(
            f"the model of {target.identity} has no component; expected at least 1. Build it from frames that differ"
        )
    projection = Projection(source, target)
    _ = projection.affine  # raises if the models cannot be linked
    solve = _solve_of(projection, method)
    sd = target.sd
    neutral = neutral or neutral_of(source, target, MEAN)
    since_neutral = _since_neutral(source, target, neutral)
    target_neutral = neutral.offsets(source, target)[1]
    colours = MixedColours(target) if method in WITH_RESIDUAL else None
    residual = residual_motion_of(target, projection.source_mask) if method in WITH_RESIDUAL else None

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
    """Return the function that subtracts the source's neutral face from an offset, and from its loadings if known."""
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
    """Compute the gain at which the target moves as far as the source, on average over training faces (ours).

    A projection keeps only what the target's components can show, so that faces come out muted. The gain is the ratio
    of the root mean squares of the carried and the projected displacement inside both masks, within `GAIN_RANGE`.

    Parameters
    ----------
    source, target, method, neutral
        As `mimic`, which also lists the errors.

    Examples
    --------
    >>> import morphspace as ms
    >>> round(auto_gain(ms.load("anna.morph"), ms.load("ben.morph"), "paper"), 1)
    1.0
    """
    projection = Projection(source, target)
    solve = _solve_of(projection, method)
    inside = (projection.source_mask * target.mask)[..., None]
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
