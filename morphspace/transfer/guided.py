"""Landmarks of the source as observations of the target's loadings (ours; methods 5, step 6).

A closing eye is a warp in one model and a change of colour in another. The landmark regressions of both models know
where lids and lips are drawn either way, so that landmarks match the two by meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, LoadingVector
from morphspace.face.mesh import landmark_places
from morphspace.linear.posterior import Observations
from morphspace.model.keypoints import required_landmarks
from morphspace.transfer.projection import Projection

# Groups of landmarks that models tend to say in colour; the warp knows brows, jaw and outer lips better.
GUIDES = ("lids", "inner lips")
GUIDE_TRUST = 1000.0  # of a landmark, beside all that the offset says; 10 moves little, 5000 gave like faces
LEAST_ERROR_PX = 0.5  # of a landmark in one model along one axis: a smaller leave-one-out error is luck


@dataclass(frozen=True, eq=False)
class LandmarkGuide:
    """How far the target's landmarks move with its loadings, and how far the source asks them to.

    Parameters
    ----------
    observations : Observations
        Weights (k_B, 2 m) px per loading of the target, and precision (2 m,) in 1 / px^2.
    asked : (k_A, 2 m)
        Movement in px on the target's mean face per loading of the source.
    """

    observations: Observations
    asked: AnyArray

    def moved(self, loadings: LoadingVector) -> AnyArray:
        """Give how far the source's loadings (k_A,) ask the landmarks to move, (2 m,) px on the target's mean face."""
        return loadings @ self.asked


def landmark_guide(projection: Projection) -> LandmarkGuide:
    """Give what the landmarks of the source ask of the target's: those of `GUIDES`, from both models' regressions.

    A landmark counts as its leave-one-out errors in both models allow. Raises `BadInput` where a model has no
    regression.
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
            np.maximum(scale * one.error_px[places] / np.sqrt(2), LEAST_ERROR_PX)  # of each axis
            for scale, one in zip(scales, (here, there), strict=True)
        ]
        precision.append(np.repeat(GUIDE_TRUST / (errors[0] ** 2 + errors[1] ** 2), 2))
    observations = Observations(np.concatenate(weights, axis=1), np.concatenate(precision))
    return LandmarkGuide(observations, np.concatenate(asked, axis=1))
