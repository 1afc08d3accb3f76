"""Landmarks as a linear function of the loadings: lids, brows, lips and outline of the face (ours).

A model's warp moves points of the mean face. But a model may express a closing eye or an opening mouth as a change of
colour, which the warp does not contain. So the points that a detector finds in many rendered faces of the model are
regressed on their loadings. The regression is ridge regression in SD of each component. Its strength, and whether it
shrinks towards zero or towards the warp's own prediction, minimise the leave-one-out error, which has a closed form
(Hastie, Tibshirani and Friedman 2009, section 7.10). That error is stored: it tells how far a landmark can be
trusted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, LoadingVector, Points
from morphspace.errors import BadInput
from morphspace.face.mesh import GROUPS, LANDMARKS, POINT_COUNT, SCHEME

RIDGES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)  # faces, the weight of the prior; loadings are in SD
LEAST_FACES = 8  # faces in a regression


@dataclass(frozen=True, eq=False)
class LandmarkRegression:
    """Positions of the m landmarks of `GROUPS` in a face of raw loadings l (k,): `mean` + l `weights`.

    Attributes
    ----------
    mean : array (m, 2) px
        The landmarks in the mean face's picture.
    weights : array (k, m, 2) px
        Movement per unit of each component.
    error_px : array (m,) px
        Root mean square leave-one-out error. A face was left out of the regression, not of the components.
    faces : int
        Number of faces in the regression.
    ridge : float
        The chosen strength, as a prior of so many faces.
    follows_warp : bool
        Whether the weights shrink towards the warp's own.
    """

    mean: Points
    weights: AnyArray
    error_px: AnyArray
    faces: int
    ridge: float
    follows_warp: bool

    def at(self, loadings: LoadingVector) -> Points:
        """Return the landmarks (m, 2) px in the face of raw loadings (k,)."""
        return self.mean + self.moved(loadings)

    def moved(self, loadings: LoadingVector) -> Points:
        """Return the movement of the landmarks (m, 2) px from the mean face to the face of raw loadings (k,)."""
        return np.tensordot(loadings, self.weights, 1)

    def truncate(self, components: int, training: LoadingTable) -> LandmarkRegression:
        """Return the regression on the first `components`.

        The movement that the other components explain in the `training` faces (n, k) is added to the error.
        """
        lost = np.tensordot(training[:, components:], self.weights[components:], 1)
        error_px = np.sqrt(self.error_px**2 + (lost**2).sum(axis=-1).mean(axis=0))
        return replace(self, weights=self.weights[:components], error_px=error_px)

    def errors(self) -> dict[str, float]:
        """Return the median leave-one-out error in px, of `all` landmarks and of each group."""
        start, medians = 0, {"all": round(float(np.median(self.error_px)), 3)}
        for name, places in GROUPS.items():
            medians[name] = round(float(np.median(self.error_px[start : start + len(places)])), 3)
            start += len(places)
        return medians

    def document(self) -> dict[str, Any]:
        """Return the entry of a model file for the regression, without its arrays (data_spec/model-file.md)."""
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
    """Regress the landmarks on loadings.

    Parameters
    ----------
    loadings : array (n, k)
        Raw loadings of n faces.
    points : array (n, 478, 2) px
        The detector's points in those faces.
    sd : array (k,)
        SD of each component.
    warp_weights : array (k, 478, 2) px
        Movement of the mean face's points by the warp of each component.

    Returns
    -------
    LandmarkRegression

    Raises
    ------
    BadInput
        If there are fewer than `LEAST_FACES` faces, or the points are not finite.

    References
    ----------
    Hastie, Tibshirani and Friedman, The elements of statistical learning (2009), sections 3.4.1 and 7.10; the
    application
    is ours.
    """
    count, rank = loadings.shape
    if points.shape != (count, POINT_COUNT, 2) or not np.isfinite(points).all():
        raise BadInput(
            f"points have shape {points.shape} or are not finite; expected {(count, POINT_COUNT, 2)} for {count} faces"
        )
    if count < LEAST_FACES:
        raise BadInput(
            f"landmarks were found in {count} faces; expected at least {LEAST_FACES}. Give more frames"
        )
    targets = points[:, LANDMARKS].reshape(count, -1)
    by_warp = warp_weights[:, LANDMARKS].reshape(rank, -1)
    design = np.column_stack([np.ones(count), loadings / np.where(sd > 0, sd, 1.0)])
    beyond_warp = targets - loadings @ by_warp
    tried = [
        (ridge, follows_warp, *_ridge(design, beyond_warp if follows_warp else targets, ridge))
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
    """Compute ridge regression with an unpenalised first column: the weights and the leave-one-out residuals."""
    penalty = np.diag(np.r_[0.0, np.full(design.shape[1] - 1, ridge)])
    solved = np.linalg.solve(design.T @ design + penalty, design.T)
    weights = solved @ wanted
    own = np.einsum("nk,kn->n", design, solved)  # leverage: each face's weight in its own prediction
    return weights, (wanted - design @ weights) / (1 - own)[:, None]


def error_summary(landmarks: LandmarkRegression) -> str:
    """Summarise the leave-one-out errors by group, in one line."""
    errors = landmarks.errors()
    groups = ", ".join(f"{name} {error:.2f}" for name, error in errors.items() if name != "all")
    return f"leave-one-out error {errors['all']:.2f} px ({groups})"
