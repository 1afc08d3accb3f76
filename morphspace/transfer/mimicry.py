"""Drive one person's model with another person's face (Nagle section 3).

A face of the source is a point on the source's mean face; what mimicry carries over is its difference from that mean.
The affine between the two faceframes lays the difference on the target's mean face, and the target's components say how
much of it the target can show. `paper` takes inner products, as published. `map` asks for the most probable face of the
target instead, and looks only where the source has something to say. `transfer` listens to lids, brows and lips more
than to cheeks, where it knows where they are, keeps half of the motion that the target's components cannot express, and
mixes the colours from faces the target has shown (`texturing`). `guided` does so too, and is told besides how far the
source's lids and inner lips have moved from rest, as the landmark regressions of both models know it: a closing eye is
a warp in one model and a colour in another, and only landmarks match the two by meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, get_args

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, LoadingVector, Mask
from morphspace.errors import BadInput
from morphspace.face.mesh import LEFT_BROW, LEFT_LIDS, LIPS, RIGHT_BROW, RIGHT_LIDS, landmark_places
from morphspace.grid import warp
from morphspace.model.keypoints import (
    affine_between_models,
    landmarks_of,
    required_faceframe,
    required_landmarks,
)
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset, parts_of, vector_of
from morphspace.steps import spread
from morphspace.transfer.colours import Texturing
from morphspace.transfer.neutral import Recentring
from morphspace.transfer.probable import Guide, InnerProducts, Solver, bounded
from morphspace.transfer.residual_motion import unshown_of

Method = Literal["paper", "map", "transfer", "guided"]
METHODS: tuple[Method, ...] = get_args(Method)
WITH_REST: tuple[Method, ...] = ("transfer", "guided")
MAX_SD = 3.0  # of a component, where it is not asked otherwise
MISMATCH = (
    5000.0  # another person's face against what a model leaves out of its own; 20 to 5000 gave like faces
)
FEATURES = (*RIGHT_LIDS, *LEFT_LIDS, *RIGHT_BROW, *LEFT_BROW, *LIPS)
FEATURE_WEIGHT = 30.0  # of a point on them, beside skin's 1; 20 to 100 gave like faces
FEATURE_REACH = 0.06  # sd, of the eye distance
GUIDES = (
    "lids",
    "inner lips",
)  # what models tend to say in colour; the warp knows brows, jaw and outer lips better
GUIDE_TRUST = 1000.0  # of a landmark, beside all that the offset says; 10 moves little, 5000 gave like faces
LEAST_ERROR_PX = 0.5  # of a landmark in one model along one axis: a smaller leave-one-out error is luck
GAIN_FACES = 40  # of the source's training faces, evenly spread, from which `auto_gain` is taken
GAIN_RANGE = (1.0, 1.3)  # beyond it, targets that never show what is asked are torn


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


@dataclass(frozen=True, eq=False)
class Mimicry:
    """A face of the target: its loadings (k,), the morph that was made, and its quality."""

    loadings: LoadingVector
    morph: Morph
    quality: Quality


@dataclass(frozen=True, eq=False)
class Passage:
    """The way from the source's mean face to the target's: the affine of the faceframes, and where both have skin.

    Raises `BadInput` where a model has no keypoints or three that span no face.
    """

    source: MorphModel
    target: MorphModel

    @cached_property
    def affine(self) -> Affine:
        """The affine (2, 3) that takes points of the source's mean face to the target's (Nagle section 3)."""
        return affine_between_models(self.source, self.target)

    @cached_property
    def back(self) -> Displacement:
        """For each pixel of the target's mean face, how far off its source pixel is: (h, w, 2) px."""
        height, width = self.target.mask.shape
        return warp.affine_displacement(warp.inverse_affine(self.affine), height, width)

    @cached_property
    def places(self) -> tuple[AnyArray, AnyArray]:
        """Where each pixel of the target's mean face lies on the source's: x and y px, (h, w) each."""
        return warp.positions(self.back)

    @cached_property
    def seen(self) -> Mask:
        """The source's mask on the target's mean face (h, w): where the source has something to say."""
        return self._looked_up(self.source.mask)

    def carried(self, offset: MorphOffset) -> MorphOffset:
        """Lay a difference of the source on the target's mean face; displacements turn and scale with the affine.

        Outside the source's picture nothing is known to differ: the offset is 0 there.
        """
        right, down = (self._looked_up(offset.displacement[..., axis]) for axis in (0, 1))
        linear = self.affine[:, :2].astype(np.float32)
        displacement = np.empty((*right.shape, 2), np.float32)
        displacement[..., 0] = linear[0, 0] * right + linear[0, 1] * down
        displacement[..., 1] = linear[1, 0] * right + linear[1, 1] * down
        return MorphOffset(displacement, self._looked_up(offset.texture), self.target.mean.reference_id)

    def _looked_up(self, planes: AnyArray) -> AnyArray:
        """Read a plane (H, W) or a texture (H, W, 3) of the source for each pixel of the target, 0 outside."""
        x, y = self.places
        return cv2.remap(
            np.ascontiguousarray(planes),
            x,
            y,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=0,
        )


class Mimic(Protocol):
    """Turns a difference from the source's mean into a face of the target."""

    def __call__(self, offset: MorphOffset, loadings: LoadingVector | None = None) -> Mimicry:
        """Give the face. `loadings` (k_A,) are the offset's on the source's components, read from it where None."""


Solve = Callable[[MorphOffset, AnyArray, LoadingVector | None], LoadingVector]
"""Reads loadings (k_B,) from an offset of the source, the same carried (5 h w,), and its loadings where known."""


def mimic(
    source: MorphModel,
    target: MorphModel,
    method: Method = "transfer",
    *,
    gain: float = 1.0,
    max_sd: float = MAX_SD,
    origin: Recentring | None = None,
) -> Mimic:
    """Prepare a pair of models, and give the function that makes the target show what the source shows.

    `gain` multiplies the loadings, `max_sd` bounds each of them (`bounded`), `origin` says from where the source's
    faces are counted and on what they are laid, None for the means. Raises `BadInput` for an unknown method, a bound
    that is not positive, a model without components, an origin of other models, where `Passage` does, and with
    `guided` where a model has no landmark regression.
    """
    if method not in METHODS:
        raise BadInput(f"there is no mimicry by {method!r}: choose one of {', '.join(METHODS)}")
    if not max_sd > 0 or not np.isfinite(gain):
        raise BadInput(f"a bound of {max_sd} SD and a gain of {gain} cannot be used: give a positive bound")
    if target.rank < 1:
        raise BadInput(f"the model of {target.identity} has no component: there is nothing it could show")
    passage = Passage(source, target)
    _ = passage.affine  # models that cannot be linked are refused here
    solve = _solve_of(passage, method)
    sd = target.sd
    rests = _rests(source, target, origin)
    texturing = Texturing(target) if method in WITH_REST else None
    unshown = unshown_of(target, passage.seen) if method in WITH_REST else None
    at_rest = target.basis.expand(rests.to_loadings) if rests.to_loadings.any() else None

    def to_target(offset: MorphOffset, loadings: LoadingVector | None = None) -> Mimicry:
        offset, loadings = rests.counted_from(offset, loadings)
        carried = passage.carried(offset)
        vector = vector_of(carried.texture, carried.displacement)
        asked = gain * solve(offset, vector, loadings) + rests.to_loadings
        made = sd * bounded(asked / sd, max_sd)
        shown = target.basis.expand(made) if texturing is None else texturing.offset(made)
        texture, displacement = parts_of(shown, *target.mask.shape)
        morph = target.mean + MorphOffset(displacement, texture, target.mean.reference_id)
        if unshown is not None:
            wanted = np.float32(gain) * carried.displacement
            if at_rest is not None:
                wanted += parts_of(at_rest, *target.mask.shape)[1]
            wanted -= displacement
            morph = unshown.added(wanted, morph)
        followed = shown if at_rest is None else shown - at_rest
        return Mimicry(made, morph, _quality(target, vector, followed, asked, made, morph))

    return to_target


@dataclass(frozen=True, eq=False)
class Rests:
    """What is taken off the source's faces: an offset and its loadings (k_A,), None for nothing; and the loadings
    (k_B,) that are added to the target's.
    """

    from_offset: MorphOffset | None
    from_loadings: LoadingVector
    to_loadings: LoadingVector

    def counted_from(
        self, offset: MorphOffset, loadings: LoadingVector | None
    ) -> tuple[MorphOffset, LoadingVector | None]:
        """Take it off a face of the source, and off its loadings where they are known."""
        if self.from_offset is None:
            return offset, loadings
        return offset - self.from_offset, None if loadings is None else loadings - self.from_loadings


def _rests(source: MorphModel, target: MorphModel, origin: Recentring | None) -> Rests:
    if origin is None:
        return Rests(None, np.zeros(source.rank), np.zeros(target.rank))
    for model, loadings in ((source, origin.source), (target, origin.target)):
        if loadings.shape != (model.rank,):
            raise BadInput(
                f"the origin has {len(loadings)} loadings for {model.identity}, whose model has {model.rank} "
                "components: make it from the same models"
            )
    return Rests(
        offset_of(source, origin.source) if origin.source.any() else None, origin.source, origin.target
    )


def _solve_of(passage: Passage, method: Method) -> Solve:
    target = passage.target
    if method == "paper":
        products = InnerProducts(target, target.basis.weight)
        return lambda _offset, carried, _loadings: products.with_offset(carried)
    seen = passage.seen.reshape(-1)
    if method in WITH_REST:
        seen = seen * feature_weights(target).reshape(-1)
    both = np.concatenate([np.repeat(seen, 3), np.repeat(seen, 2)]) * target.basis.weight
    noise = MISMATCH * target.basis.discarded_variance
    if method != "guided":
        unguided = Solver(target, both, noise)
        return lambda _offset, carried, _loadings: unguided.loadings(carried)
    guide = guide_of(passage)
    solver = Solver(target, both, noise, guide)
    driving = InnerProducts(passage.source, passage.source.basis.weight)

    def guided(offset: MorphOffset, carried: AnyArray, loadings: LoadingVector | None) -> LoadingVector:
        if loadings is None:
            loadings = driving.with_offset(vector_of(offset.texture, offset.displacement))
        return solver.loadings(carried, loadings @ guide.asked)

    return guided


def guide_of(passage: Passage) -> Guide:
    """Give what the landmarks of the source ask of the target's: those of `GUIDES`, from both models' regressions.

    A landmark counts as its leave-one-out errors in both models allow. Raises `BadInput` where a model has no
    regression.
    """
    learned = [required_landmarks(model) for model in (passage.source, passage.target)]
    linear = passage.affine[:, :2]
    weights, asked, precision = [], [], []
    for group in GUIDES:
        places = landmark_places(group)
        weights.append(learned[1].weights[:, places].reshape(passage.target.rank, -1))
        asked.append((learned[0].weights[:, places] @ linear.T).reshape(passage.source.rank, -1))
        scales = (np.sqrt(abs(np.linalg.det(linear))), 1.0)
        errors = [
            np.maximum(scale * one.error_px[places] / np.sqrt(2), LEAST_ERROR_PX)  # of each axis
            for scale, one in zip(scales, learned, strict=True)
        ]
        precision.append(np.repeat(GUIDE_TRUST / (errors[0] ** 2 + errors[1] ** 2), 2))
    return Guide(np.concatenate(weights, axis=1), np.concatenate(precision), np.concatenate(asked, axis=1))


def feature_weights(model: MorphModel) -> Mask:
    """Give how much each point of the mean face tells of an expression, (h, w): 1 of skin, more near lids, brows, lips.

    All ones where the model does not know where those are (`keypoints.landmarks_of`).
    """
    height, width = model.mask.shape
    near = np.zeros((height, width), np.float32)
    points = landmarks_of(model)
    if points is None:
        return near + 1
    right, left, _ = required_faceframe(model).points
    reach_px = FEATURE_REACH * float(np.hypot(*(left - right)))
    x, y = np.arange(width), np.arange(height)
    for across, down in points[list(FEATURES)]:
        bell = np.exp(-((y - down)[:, None] ** 2 + (x - across) ** 2) / (2 * reach_px**2))
        near = np.maximum(near, bell.astype(np.float32))
    return 1 + np.float32(FEATURE_WEIGHT) * near


def _quality(
    target: MorphModel,
    offset: AnyArray,
    shown: AnyArray,
    asked: LoadingVector,
    loadings: LoadingVector,
    morph: Morph,
) -> Quality:
    height, width = target.mask.shape
    kept = []
    for part in (slice(0, 3 * height * width), slice(3 * height * width, None)):
        weight = target.basis.weight[part]
        energy = _energy(weight, offset[part])
        left = _energy(weight, offset[part] - shown[part])
        kept.append(1 - left / energy if energy > 0 else 1.0)
    in_sd = np.abs(asked / target.sd)
    return Quality(
        texture_kept=kept[0],
        warp_kept=kept[1],
        length_sd=float(np.sqrt(np.mean((loadings / target.sd) ** 2))),
        largest_sd=float(in_sd.max()),
        bounded=int((np.abs(loadings) < 0.9 * np.abs(asked)).sum()),
        folds=warp.fold_fraction(morph.displacement, target.mask),
    )


def _energy(weight: AnyArray, values: AnyArray) -> float:
    return float(np.dot(weight * values, values))


def offset_of(model: MorphModel, loadings: AnyArray) -> MorphOffset:
    """Give the difference from the mean that loadings (k,) stand for, or the first so many."""
    values = np.zeros(model.rank)
    values[: len(loadings)] = loadings
    texture, displacement = parts_of(model.basis.expand(values), *model.mask.shape)
    return MorphOffset(displacement, texture, model.mean.reference_id)


def auto_gain(
    source: MorphModel,
    target: MorphModel,
    method: Method = "transfer",
    *,
    origin: Recentring | None = None,
) -> float:
    """Give the gain at which the target moves as far as the source, on average over the source's training faces.

    A projection keeps what the target's components can show, so it moves less: faces come out muted. The gain is the
    ratio of the root mean squares of the carried and of the projected displacement inside both masks, within
    `GAIN_RANGE`. Raises as `mimic`.
    """
    passage = Passage(source, target)
    solve = _solve_of(passage, method)
    inside = (passage.seen * target.mask)[..., None]
    rests = _rests(source, target, origin)
    asked, shown = 0.0, 0.0
    for index in spread(len(source.training.values), GAIN_FACES):
        row = source.training.values[index]
        offset, loadings = rests.counted_from(offset_of(source, row), row)
        carried = passage.carried(offset)
        vector = vector_of(carried.texture, carried.displacement)
        projected = target.basis.expand(solve(offset, vector, loadings), slice(3 * target.mask.size, None))
        asked += float((inside * carried.displacement**2).sum(dtype=np.float64))
        shown += float((inside.reshape(-1, 1) * projected.reshape(-1, 2) ** 2).sum(dtype=np.float64))
    if shown == 0:
        return GAIN_RANGE[0]
    return float(np.clip(np.sqrt(asked / shown), *GAIN_RANGE))
