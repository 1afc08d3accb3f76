"""Landmarks of the source as observations of the target's loadings (ours).

A closing eye may be a warp in one model and a change of colour in another. The landmark regressions of both models
predict where lids and lips are drawn in either case, so that landmarks match by meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.face.mesh import landmark_places
from morphspace.linear.posterior import Observations
from morphspace.model.keypoints import required_landmarks
from morphspace.transfer.projection import Projection

# Groups of landmarks whose movement models tend to express in colour; brows, jaw and outer lips are in the warp.
GUIDES = ("lids", "inner lips")
GUIDE_TRUST = 1000.0  # factor on a landmark's precision; 10 changed little, 5000 gave similar faces
LEAST_ERROR_PX = 0.5  # px, of a landmark in one model along one axis; smaller leave-one-out errors are chance


@dataclass(frozen=True, eq=False)
class LandmarkGuide:
    """The target's landmarks as functions of its loadings, and the movement that the source requests of them.

    Attributes
    ----------
    observations : Observations
        Weights (k_B, 2 m) px per loading of the target, and precision (2 m,) in 1 / px^2.
    asked : array (k_A, 2 m)
        Requested movement in px on the target's mean face, per loading of the source.
    """

    observations: Observations
    asked: AnyArray

    def moved(self, loadings: LoadingVector) -> AnyArray:
        """Compute the movement (2 m,) px on the target's mean face that raw loadings (k_A,) of the source request."""
        return loadings @ self.asked


def landmark_guide(projection: Projection) -> LandmarkGuide:
    """Prepare the landmarks of `GUIDES` of a pair of models.

    The precision of a landmark follows from its leave-one-out errors in both models.

    Raises
    ------
    BadInput
        If a model has no landmark regression, or the models cannot be linked.
    """
    source, target = projection.source, projection.target
    here, there = required_landmarks(source), required_landmarks(target)
    linear = projection.affine[:, :2]
    weights, asked, precision = [], [], []
    for group in GUIDES:
        places = landmark_places(group)
        weights.append(there.weights[:, places].reshape(target.rank, -1))
        asked.append((here.weights[:, places] @ linear.T).reshape(source.rank, -1))
        scales = (np.sqrt(abs(np.linalg.det(linear))), 1.0)
        errors = [
            np.maximum(scale * one.error_px[places] / np.sqrt(2), LEAST_ERROR_PX)  # along one axis
            for scale, one in zip(scales, (here, there), strict=True)
        ]
        precision.append(np.repeat(GUIDE_TRUST / (errors[0] ** 2 + errors[1] ** 2), 2))
    observations = Observations(np.concatenate(weights, axis=1), np.concatenate(precision))
    return LandmarkGuide(observations, np.concatenate(asked, axis=1))
