"""Fit loadings to an image by what the model would draw: Gauss-Newton on the rendering error.

Projecting a face on the components minimises an error in texture and warp together; what a viewer sees is the error of
the picture. Starting from the projection, a few Gauss-Newton steps minimise just that. This is the fitting of active
appearance models (Matthews and Baker, Active appearance models revisited, IJCV 2004, section 2), done on the mean
face's grid, where the components need no resampling, and weighted by the area each point takes in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from morphspace import warp
from morphspace.arrays import AnyArray, Image, LoadingVector, Mask
from morphspace.basis import Basis
from morphspace.morph import parts_of

STEPS = 3  # ten gained nothing on the two clips tried
NOISE_VARIANCE = 1e-5  # colour^2; how strongly the prior holds; 1e-7 to 1e-4 gave the same faces on two clips
AREA_RANGE = (0.05, 4.0)  # a point's area in the picture, limited so that folds do not count negative
BLOCK_PIXELS = 2048  # a block of the Jacobian stays in the second cache
SCHARR_SUM = 32.0  # makes the Scharr kernel a derivative per px


@dataclass(frozen=True, eq=False)
class Fit:
    """Loadings (k,) and the error before and after: root mean square colour difference inside the mask."""

    loadings: LoadingVector
    start_error: float
    error: float


def fit_loadings(
    image: Image, mean: AnyArray, basis: Basis, mask: Mask, start: LoadingVector, *, steps: int = STEPS
) -> Fit:
    """Refine loadings so that the rendered face comes closest to an aligned image inside the mask.

    Parameters: image (h, w, 3); mean (5 h w,) and basis (k, 5 h w) in the order of `morph.vector_of`; mask (h, w);
    start (k,) loadings, usually the projection. Minimises sum_p A(p) mask(p) |I(p + u(p)) - T(p)|^2 + noise * sum_j
    l_j^2 / variance_j with A the area of p in the picture. A step that does not lower this sum is halved. Returns the
    best loadings met, so the sum is never larger than at the start.
    """
    best = np.array(start, np.float64)
    problem = _Problem(image, mean, basis, mask)
    state = problem.at(best)
    start_state = state
    for _ in range(steps if basis.rank else 0):
        step = problem.step(best, state)
        for shrink in (1.0, 0.5, 0.25):
            trial = problem.at(best + shrink * step)
            if trial.cost < state.cost:
                best, state = best + shrink * step, trial
                break
        else:
            break
    return Fit(best, start_state.error, state.error)


@dataclass(frozen=True, eq=False)
class _State:
    """The model at some loadings: its displacement, residual image (h w 3,), root weights (h w,) and cost."""

    displacement: AnyArray
    residual: AnyArray
    root_weight: AnyArray
    cost: float
    error: float


class _Problem:
    def __init__(self, image: Image, mean: AnyArray, basis: Basis, mask: Mask) -> None:
        self.image, self.mean, self.basis, self.mask = image, mean, basis, mask
        self.height, self.width = mask.shape
        self.precision = NOISE_VARIANCE / np.maximum(basis.variances, np.finfo(np.float64).tiny)
        self.inside = np.flatnonzero(mask > 0)
        slope_x = cv2.Scharr(image, cv2.CV_32F, 1, 0) / np.float32(SCHARR_SUM)
        slope_y = cv2.Scharr(image, cv2.CV_32F, 0, 1) / np.float32(SCHARR_SUM)
        self.slopes = slope_x, slope_y
        textures, displacements = np.split(basis.components, [3 * mask.size], axis=1)
        self.textures = textures.reshape(basis.rank, mask.size, 3)[:, self.inside]
        self.displacements = displacements.reshape(basis.rank, mask.size, 2)[:, self.inside]

    def at(self, loadings: LoadingVector) -> _State:
        texture, displacement = parts_of(self.mean + self.basis.expand(loadings), self.height, self.width)
        residual = (warp.sample(self.image, displacement) - texture).reshape(-1, 3)[self.inside]
        area = cv2.copyMakeBorder(warp.determinants(displacement), 0, 1, 0, 1, cv2.BORDER_REPLICATE)
        weight = (self.mask * np.clip(area, *AREA_RANGE)).reshape(-1)[self.inside]
        square = float((weight[:, None] * residual * residual).sum(dtype=np.float64))
        cost = square + float((self.precision * loadings * loadings).sum())
        total = max(float(weight.sum(dtype=np.float64)), 1.0)
        return _State(displacement, residual, np.sqrt(weight), cost, float(np.sqrt(square / total / 3)))

    def step(self, loadings: LoadingVector, state: _State) -> LoadingVector:
        """Solve the linearised problem: d residual / d l_j = grad I . u_j - T_j; summed over blocks of pixels."""
        along_x, along_y = (
            warp.sample(slope, state.displacement).reshape(-1, 3)[self.inside] for slope in self.slopes
        )
        normal = np.diag(self.precision)
        target = -self.precision * loadings
        for start in range(0, len(self.inside), BLOCK_PIXELS):
            block = slice(start, start + BLOCK_PIXELS)
            jacobian = self.displacements[:, block, :1] * along_x[block]
            jacobian += self.displacements[:, block, 1:] * along_y[block]
            np.subtract(self.textures[:, block], jacobian, out=jacobian)
            root = state.root_weight[block, None]
            jacobian *= root
            flat = jacobian.reshape(len(loadings), -1)
            normal += flat @ flat.T
            target += flat @ (state.residual[block] * root).reshape(-1)
        return np.asarray(np.linalg.solve(normal, target), np.float64)
