"""Compute one expression as every identity shows it, and the plausibility of each version (Nagle section 4, step 5).

A model that is asked for what its person never did draws noise and torn lips, and one such version ruins a blend. So
each version is judged by the motion that is missing at lids, brows and lips, by the distance of its loadings from
known faces, and by whether mouth and lids open as far as the source's, according to the landmark regressions. A mouth
that opens further than the target's ever did shows skin in place of teeth, whatever its warp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.avatar.source_frames import Originals
from morphspace.face.expression import lid_opening, mouth_opening
from morphspace.face.mesh import landmark_places
from morphspace.model.keypoints import affine_between_models, required_faceframe
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset
from morphspace.transfer.mimicry import WITH_RESIDUAL, Method, Mimicry, auto_gain, mimic
from morphspace.transfer.neutral import Neutral, neutral_of
from morphspace.transfer.quality import reach_of

# Where a version begins to lose weight, and where it is believed no more. By eye, on twenty pairs of five clips.
MISSING = (0.05, 0.15)  # eye distances of motion; what `mimic` flags at .10 is wrong rather than torn
LENGTH_SD = (2.0, 3.5)  # root mean square loading; training faces have 1
MISFIT = (0.06, 0.14)  # eye distances between the gap asked for and the one shown, of lips or lids
BEYOND = (0.03, 0.10)  # eye distances by which the lips are asked to open further than they ever did
LEAST = 0.1  # plausibility below which a version is left out


@dataclass(frozen=True, eq=False)
class Version:
    """An expression as one identity shows it.

    Attributes
    ----------
    morph : Morph
        On that identity's mean face.
    plausibility : float, 0 to 1
    loadings : array (k,)
        In that identity's model.
    is_own : bool
        Whether the expression is the identity's own.
    """

    morph: Morph
    plausibility: float
    loadings: LoadingVector = field(default_factory=lambda: np.zeros(0))
    is_own: bool = False


Show = Callable[[LoadingVector, MorphOffset], Version]
"""Takes loadings (k,) and offset of a face of the source, and gives the target's version of it."""


@dataclass(frozen=True, eq=False)
class Cast:
    """The identities that take part, and how expressions are carried between them.

    `originals` are the frames of each model's clip; None where the model's reconstructions are used.
    """

    models: Sequence[MorphModel]
    keys: Sequence[str]
    method: Method
    max_sd: float
    originals: Sequence[Originals | None]

    def shows_from(self, source: int) -> tuple[Show, ...]:
        """Prepare every identity to show the expressions of `source`, whose own model shows them unchanged."""
        own, original = self.models[source], self.originals[source]
        if original is not None:
            original.prepare()
        return tuple(
            _as_it_is(own) if key == self.keys[source] else _projected(own, model, self.method, self.max_sd)
            for model, key in zip(self.models, self.keys, strict=True)
        )

    def versions(self, source: int, shows: Sequence[Show], frame: int) -> list[Version]:
        """Compute each identity's version of training frame `frame` of `source`."""
        model, original = self.models[source], self.originals[source]
        loadings = np.array(model.training.values[frame], np.float64)
        offset = model.offset(loadings) if original is None else original.morph(frame) - model.mean
        return [show(loadings, offset) for show in shows]


def _as_it_is(model: MorphModel) -> Show:
    return lambda loadings, offset: Version(model.mean + offset, 1.0, loadings, is_own=True)


def _projected(source: MorphModel, target: MorphModel, method: Method, max_sd: float) -> Show:
    neutral = neutral_of(source, target)
    gain = 1.0
    if method in WITH_RESIDUAL:
        gain = auto_gain(source, target, method, neutral=neutral)
    make = mimic(source, target, method, gain=gain, max_sd=max_sd, neutral=neutral)
    reach = reach_of(source, target, 1.0, neutral)  # the motion that was made, not what the gain makes of it
    gaps = Gaps(source, target, neutral) if _know_landmarks(source, target) else None

    def show(loadings: LoadingVector, offset: MorphOffset) -> Version:
        made: Mimicry = make(offset)
        factors = [
            falling(reach(offset, made.morph, made.loadings, loadings).missing_motion, MISSING),
            falling(made.quality.length_sd, LENGTH_SD),
        ]
        if gaps is not None:
            misfit, beyond = gaps.judged(loadings, made.loadings)
            factors += [falling(misfit, MISFIT), falling(beyond, BEYOND)]
        return Version(made.morph, float(np.prod(factors)), made.loadings)

    return show


def believed(version: Version) -> float:
    """Return the share, 0 to 1, with which a version counts."""
    return 0.0 if version.plausibility < LEAST else version.plausibility


def _know_landmarks(source: MorphModel, target: MorphModel) -> bool:
    return source.landmarks is not None and target.landmarks is not None


def falling(value: float, limits: tuple[float, float]) -> float:
    """Return 1 up to the first limit, 0 from the second, and a straight line between.

    Examples
    --------
    >>> falling(0.5, (0.0, 2.0))
    0.75
    """
    return float(np.clip((limits[1] - value) / (limits[1] - limits[0]), 0, 1))


@dataclass(frozen=True, eq=False)
class Gaps:
    """The openings of lips and lids, wanted and made, in eye distances of the target.

    Neutral faces differ in their openings, so changes from neutral are compared.
    """

    source: MorphModel
    target: MorphModel
    neutral: Neutral
    linear: AnyArray = field(init=False)
    eyes_px: float = field(init=False)
    most_px: float = field(init=False)

    def __post_init__(self) -> None:
        right, left, _ = required_faceframe(self.target).points
        object.__setattr__(self, "linear", affine_between_models(self.source, self.target)[:, :2])
        object.__setattr__(self, "eyes_px", float(np.hypot(*(left - right))))
        known = [self._of(self.target, row)[0] for row in self.target.training.values]
        object.__setattr__(self, "most_px", float(max(known)))

    def judged(self, loadings: LoadingVector, shown: LoadingVector) -> tuple[float, float]:
        """Return the largest miss of an opening, and the excess of the lips over any training face.

        Both in eye distances. `loadings` (k_A,) are of the source's face, `shown` (k_B,) of the target's.
        """
        neutral = self._of(self.target, self.neutral.target)
        asked = self._of(self.source, loadings, self.linear)
        asked = asked - self._of(self.source, self.neutral.source, self.linear)
        made = self._of(self.target, shown) - neutral
        misfit = np.abs(asked - made).max()
        return float(misfit) / self.eyes_px, float(asked[0] + neutral[0] - self.most_px) / self.eyes_px

    def _of(self, model: MorphModel, loadings: LoadingVector, linear: AnyArray | None = None) -> AnyArray:
        """Return the openings (3,) px of the inner lips and of both pairs of lids in a face of a model."""
        points = _regression(model).at(loadings)
        if linear is not None:
            points = points @ linear.T
        lips, lids = points[landmark_places("inner lips")], points[landmark_places("lids")]
        half = len(lids) // 2
        return np.array([mouth_opening(lips), lid_opening(lids[:half]), lid_opening(lids[half:])])


def _regression(model: MorphModel) -> LandmarkRegression:
    learned = model.landmarks
    if learned is None:
        raise AssertionError("gaps are only asked of models that know their landmarks")
    return learned
