"""The most probable face of the target for what a face of the source asks (ours; methods 5, step 4).

The paper's inner products count every pixel alike. Here the target is read as probabilistic PCA (`linear.posterior`):
what lies outside the source's face asks for nothing, lids, brows and lips may count more than cheeks, and another
person's face is expected to differ from whatever the target can show.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, Mask
from morphspace.face.mesh import LEFT_BROW, LEFT_LIDS, LIPS, RIGHT_BROW, RIGHT_LIDS
from morphspace.linear.posterior import Observations, Posterior
from morphspace.model.keypoints import landmarks_of, required_faceframe
from morphspace.model.model import MorphModel, inner_product
from morphspace.transfer.projection import Projection

# Times the noise of a model of its own person: another person's face differs from the target's by more than what the
# target's components leave out of its own frames. 20 to 5000 gave like faces.
MISMATCH = 5000.0
FEATURES = (*RIGHT_LIDS, *LEFT_LIDS, *RIGHT_BROW, *LEFT_BROW, *LIPS)
FEATURE_WEIGHT = 30.0  # of a point on them, beside skin's 1; 20 to 100 gave like faces
FEATURE_REACH = 0.06  # sd, of the eye distance
KNEE = 4.0  # how sharply the bound sets in: at a third of it a loading keeps .997 of its length


def posterior_of(
    projection: Projection, importance: Mask | float = 1.0, observations: Observations | None = None
) -> Posterior:
    """Give the posterior of the target's loadings for an offset that was carried to its mean face.

    Parameters
    ----------
    projection : Projection
        The pair of models. Only what both masks hold counts.
    importance : (h, w), optional
        How much each point of the target's mean face counts, as `feature_weights` gives it.
    observations : Observations, optional
        What is known besides, as `guided.landmark_guide` gives it.
    """
    target = projection.target
    seen = projection.seen * importance
    weight = inner_product(seen, 1.0) * target.basis.weight
    return Posterior(target.basis, weight, MISMATCH, observations)


def feature_weights(model: MorphModel) -> Mask:
    """Give how much each point of the mean face says about an expression, (h, w).

    Skin counts 1; points near lids, brows and lips count more. All count 1 where the model does not know where those
    are (`keypoints.landmarks_of`).
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


def bounded(loadings_sd: AnyArray, max_sd: float) -> AnyArray:
    """Give loadings (..., k) in SD drawn smoothly inside `max_sd`, each component by itself, its sign kept."""
    return loadings_sd / (1 + np.abs(loadings_sd / max_sd) ** KNEE) ** (1 / KNEE)
