"""Landmarks as a linear function of the loadings: where lids, brows, lips and the rim of the face are drawn (ours).

A model's warp moves a point of the mean face, but a model may show a closing eye or an opening mouth in colour instead:
the warp alone does not know. So the points that a detector finds in many rendered faces of the model are regressed on
the loadings of those faces. The components of the warp tell in part where the points go; the regression may learn only
what they leave out. Ridge regression in SD of each component; how strongly it holds back, and whether from nothing or
from the warp, is decided by the leave-one-out error, which has a closed form (Hastie, Tibshirani and Friedman 2009,
section 7.10) and is kept: it says how far a landmark can be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, LoadingVector, Points
from morphspace.errors import BadInput
from morphspace.face.mesh import GROUPS, LANDMARKS, POINT_COUNT, SCHEME

RIDGES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)  # on loadings in SD: a prior of n faces
LEAST_FACES = 8  # to learn from


@dataclass(frozen=True, eq=False)
class LandmarkRegression:
    """Where the m landmarks of `GROUPS`, in their order, lie in a face of loadings l (k,): `mean` + l `weights`.

    `mean` (m, 2) px, in the mean face's picture | `weights` (k, m, 2) px | `error_px` (m,), root mean square
    leave-one-out error of each over the `faces` it was learned from: a face left out of the regression, not of the
    components | `ridge`, what was chosen | `follows_warp`, whether the weights were held back towards the warp's own.
    """

    mean: Points
    weights: AnyArray
    error_px: AnyArray
    faces: int
    ridge: float
    follows_warp: bool

    def at(self, loadings: LoadingVector) -> Points:
        """Give the landmarks (m, 2) px in the face of loadings (k,)."""
        return self.mean + self.moved(loadings)

    def moved(self, loadings: LoadingVector) -> Points:
        """Give how far the landmarks (m, 2) px of the face of loadings (k,) lie from the mean face's."""
        return np.tensordot(loadings, self.weights, 1)

    def truncate(self, components: int, training: LoadingTable) -> LandmarkRegression:
        """Give the regression on the first `components`.

        What the others explained of the `training` faces (n, k) joins the error.
        """
        lost = np.tensordot(training[:, components:], self.weights[components:], 1)
        error_px = np.sqrt(self.error_px**2 + (lost**2).sum(axis=-1).mean(axis=0))
        return replace(self, weights=self.weights[:components], error_px=error_px)

    def errors(self) -> dict[str, float]:
        """Give the median leave-one-out error in px, of `all` landmarks and of each group."""
        start, told = 0, {"all": round(float(np.median(self.error_px)), 3)}
        for name, places in GROUPS.items():
            told[name] = round(float(np.median(self.error_px[start : start + len(places)])), 3)
            start += len(places)
        return told

    def document(self) -> dict[str, Any]:
        """Give what a model file says of it beside the arrays (data_spec/model-file.md)."""
        return {
            "scheme": SCHEME,
            "places": list(LANDMARKS),
            "faces": self.faces,
            "ridge": self.ridge,
            "toward": "warp" if self.follows_warp else "mean",
            "error_px": self.errors(),
        }


def learn_landmarks(
    loadings: LoadingTable, points: AnyArray, sd: AnyArray, warp_weights: AnyArray
) -> LandmarkRegression:
    """Learn where the landmarks lie from loadings (n, k) and the detector's points (n, 478, 2) px in those faces.

    `sd` (k,) of the components; `warp_weights` (k, 478, 2) px: how the warp of each component moves the points of the
    mean face. Raises `BadInput` for fewer than `LEAST_FACES` faces, or points that are not finite.
    """
    count, rank = loadings.shape
    if points.shape != (count, POINT_COUNT, 2) or not np.isfinite(points).all():
        raise BadInput(
            f"{count} faces need points of shape {(count, POINT_COUNT, 2)}, all finite: {points.shape} were given"
        )
    if count < LEAST_FACES:
        raise BadInput(
            f"landmarks were found in {count} faces, at least {LEAST_FACES} are needed to learn from: give more frames"
        )
    seen = points[:, LANDMARKS].reshape(count, -1)
    by_warp = warp_weights[:, LANDMARKS].reshape(rank, -1)
    design = np.column_stack([np.ones(count), loadings / np.where(sd > 0, sd, 1.0)])
    beyond_warp = seen - loadings @ by_warp
    tried = [
        (ridge, follows_warp, *_ridge(design, beyond_warp if follows_warp else seen, ridge))
        for follows_warp in (True, False)
        for ridge in RIDGES
    ]
    ridge, follows_warp, weights, left_out = min(tried, key=lambda one: float((one[3] ** 2).mean()))
    per_loading = weights[1:] / np.where(sd > 0, sd, np.inf)[:, None]
    if follows_warp:
        per_loading = per_loading + by_warp
    squared = (left_out.reshape(count, -1, 2) ** 2).sum(axis=-1)
    return LandmarkRegression(
        weights[0].reshape(-1, 2),
        per_loading.reshape(rank, -1, 2),
        np.sqrt(squared.mean(axis=0)),
        count,
        ridge,
        follows_warp,
    )


def _ridge(design: AnyArray, wanted: AnyArray, ridge: float) -> tuple[AnyArray, AnyArray]:
    """Give the weights of a ridge regression whose first column, the mean, is free, and the leave-one-out residuals."""
    penalty = np.diag(np.r_[0.0, np.full(design.shape[1] - 1, ridge)])
    solved = np.linalg.solve(design.T @ design + penalty, design.T)
    weights = solved @ wanted
    own = np.einsum("nk,kn->n", design, solved)  # the share each face has in its own prediction
    return weights, (wanted - design @ weights) / (1 - own)[:, None]


def told_errors(landmarks: LandmarkRegression) -> str:
    """Say how far the landmarks of a face left out lie from where the regression puts them, by group."""
    errors = landmarks.errors()
    groups = ", ".join(f"{name} {error:.2f}" for name, error in errors.items() if name != "all")
    return f"leave-one-out error {errors['all']:.2f} px ({groups})"
