"""The most probable face of the target, given an offset of the source (ours).

The paper's inner products weigh every pixel alike. Here the target is a probabilistic PCA model (`linear.posterior`).
Pixels outside the source's face have no weight, lids, brows and lips may have more than cheeks, and the noise
includes the difference between two people.
"""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray, Mask
from morphspace.face.mesh import LEFT_BROW, LEFT_LIDS, LIPS, RIGHT_BROW, RIGHT_LIDS
from morphspace.linear.posterior import Observations, Posterior
from morphspace.model.keypoints import landmarks_of, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import inner_product
from morphspace.transfer.projection import Projection

# Times the noise variance of the target's own frames: another person's face differs by more than what the components
# leave out. 20 to 5000 gave similar faces.
MISMATCH = 5000.0
FEATURES = (*RIGHT_LIDS, *LEFT_LIDS, *RIGHT_BROW, *LEFT_BROW, *LIPS)
FEATURE_WEIGHT = 30.0  # of a feature point, where skin has 1; 20 to 100 gave similar faces
FEATURE_REACH = 0.06  # eye distances, SD of the bell around a point
KNEE = 4.0  # exponent; at a third of the bound a loading keeps .997 of its length


def posterior_of(
    projection: Projection, importance: Mask | float = 1.0, observations: Observations | None = None
) -> Posterior:
    """Prepare the posterior of the target's loadings, given an offset on its mean face.

    Parameters
    ----------
    projection : Projection
        The pair of models. Only pixels inside both masks have weight.
    importance : array (h, w), optional
        Weight of each point of the target's mean face (`feature_weights`).
    observations : Observations, optional
        Further observations (`guided.landmark_guide`).

    References
    ----------
    Tipping and Bishop, Probabilistic principal component analysis, J. R. Statist. Soc. B 61 (1999); the weights are
    ours.
    """
    target = projection.target
    common = projection.source_mask * importance
    weight = inner_product(common, 1.0) * target.basis.weight
    return Posterior(target.basis, weight, MISMATCH, observations)


def feature_weights(model: MorphModel) -> Mask:
    """Compute the weight (h, w) of each point of the mean face for expressions.

    Skin has 1, points near lids, brows and lips up to 1 + `FEATURE_WEIGHT`. All points have 1 if the model has no
    mesh points (`keypoints.landmarks_of`).

    Examples
    --------
    >>> import morphspace as ms
    >>> feature_weights(ms.load("anna.morph")).max().item()  # no mesh points
    1.0
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
    """Bound loadings (..., k) in SD smoothly by `max_sd`, each by itself; signs do not change.

    Examples
    --------
    >>> import numpy as np
    >>> bounded(np.array([0.0, 1.0, -30.0]), 3.0).round(2).tolist()
    [0.0, 1.0, -3.0]
    """
    return loadings_sd / (1 + np.abs(loadings_sd / max_sd) ** KNEE) ** (1 / KNEE)
