"""Measure how far the mean faces of several people and of their blend lie apart in shape and colour, without a judge.

Identity itself needs a face recogniser to be measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from morphspace.arrays import AnyArray, Image, Points
from morphspace.grid import warp
from morphspace.model.keypoints import affine_between, landmarks_of, required_faceframe
from morphspace.model.model import MorphModel


@dataclass(frozen=True, eq=False)
class MeanDistances:
    """Distances between k people and their blend, which comes last: symmetric, (k + 1, k + 1), 0 on the diagonal.

    Attributes
    ----------
    shape_percent : array or None
        Rms distance of landmarks in % of the eye distance, after size, position and rotation are removed; None where
        a model does not know its landmarks.
    colour_percent : array
        Rms difference of colour in % of white, inside the face that all share, with the mean faces on the blend's
        faceframe.
    """

    shape_percent: AnyArray | None
    colour_percent: AnyArray


def mean_face_distances(models: Sequence[MorphModel], avatar: MorphModel, shared: AnyArray) -> MeanDistances:
    """Compare the mean faces of k models and of their blend (ours).

    Colours are compared where all share the face (`shared`, (h, w), bool). With hair, ears and background, the owner
    of the surround would always be nearest to the blend.

    Raises
    ------
    BadInput
        If a model has no faceframe.
    """
    everyone = [*models, avatar]
    laid = [_laid_on(model, avatar) for model in models] + [np.clip(avatar.mean.render(), 0, 1)]
    inside = shared / max(int(shared.sum()), 1)
    colour = _table(laid, partial(_colour_percent, inside=inside))
    shapes = _shapes(everyone)
    return MeanDistances(None if shapes is None else _table(shapes, shape_percent), colour)


def shape_percent(one: Points, other: Points) -> float:
    """Compute the rms distance between two sets of points (m, 2) after the best similarity, in their unit, times 100.

    Both are centred and scaled to rms size 1 before the rotation is found (ordinary Procrustes analysis), so their
    order does not matter. The result is scaled back by the geometric mean of the sizes.

    References
    ----------
    Dryden and Mardia, Statistical Shape Analysis, section 4.2.
    """
    a, b = (points - points.mean(axis=0) for points in (one, other))
    size_a, size_b = (float(np.sqrt((points**2).sum(axis=1).mean())) for points in (a, b))
    u, _, vt = np.linalg.svd((a / size_a).T @ (b / size_b))
    turned = a / size_a @ (u * [1, np.linalg.det(u @ vt)] @ vt)
    apart = np.sqrt(((turned - b / size_b) ** 2).sum(axis=1).mean())
    return float(100 * apart * np.sqrt(size_a * size_b))


def _shapes(models: Sequence[MorphModel]) -> list[Points] | None:
    """Return the landmarks of every mean face in units of its eye distance."""
    meshes = [landmarks_of(model) for model in models]
    # Only like can be compared with like: the regression's landmarks are a selection of the mesh.
    selections = [None if model.landmarks is None else model.landmarks.mean for model in models]
    for points in (meshes, selections):
        known = [one / _eyes_px(model) for one, model in zip(points, models, strict=True) if one is not None]
        if len(known) == len(models):
            return known
    return None


def _eyes_px(model: MorphModel) -> float:
    right, left, _ = required_faceframe(model).points
    return float(np.hypot(*(left - right)))


def _laid_on(model: MorphModel, avatar: MorphModel) -> Image:
    to_model = affine_between(required_faceframe(avatar), required_faceframe(model))
    height, width = avatar.mask.shape
    x, y = warp.positions(warp.affine_displacement(to_model, height, width))
    return np.clip(warp.sample_at(np.clip(model.mean.render(), 0, 1), x, y), 0, 1)


def _colour_percent(one: Image, other: Image, inside: AnyArray) -> float:
    square = ((one - other) ** 2).mean(axis=2, dtype=np.float64)
    return float(100 * np.sqrt((square * inside).sum()))


def _table(items: Sequence[AnyArray], distance: Callable[[AnyArray, AnyArray], float]) -> AnyArray:
    count = len(items)
    found = np.zeros((count, count))
    for row in range(count):
        for column in range(row):
            found[row, column] = found[column, row] = distance(items[row], items[column])
    return found
