"""Refine loadings on the picture: Gauss-Newton steps on the rendering error.

A projection minimises an error in texture and warp together. An observer sees the error of the picture. A few steps
from the projection minimise that error. This is the fitting of active appearance models (Matthews and Baker, Active
appearance models revisited, IJCV 2004, section 2). It runs on the mean face's grid, where the components need no
resampling, and weighs each point by its area in the picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, LoadingVector, Mask
from morphspace.grid import warp
from morphspace.linear.pca import Basis
from morphspace.model.morph import Morph, displacement_columns, texture_columns

STEPS = 12  # at most; most faces converge after three or four
STILL = 1e-3  # share of the sum; a step that lowers it by less is the last
NOISE_VARIANCE = 1e-5  # colour^2, the weight of the prior; 1e-7 to 1e-4 gave the same faces on two clips
AREA_RANGE = (0.05, 4.0)  # px^2 of a point in the picture; a fold would have a negative area
SPARED = 4  # pixels; one of so many gives the curvature, all give the gradient
BLOCK_PIXELS = 2048  # pixels of the Jacobian that fit into the second cache
SCHARR_SUM = 32.0  # scales the Scharr kernel to a derivative per px


@dataclass(frozen=True, eq=False)
class _State:
    """The model at some loadings.

    Attributes
    ----------
    displacement : array (h, w, 2) px
    residual : array (3, m)
        Picture minus model at the m pixels inside the mask.
    weight : array (m,)
        Mask times area in the picture.
    cost : float
        The sum that `Fitter.fit` minimises.
    """

    displacement: Displacement
    residual: AnyArray
    weight: AnyArray
    cost: float


@dataclass(frozen=True, eq=False)
class Fitter:
    """Refines loadings so that the rendered face comes closest to an aligned picture inside the mask.

    Attributes
    ----------
    mean : Morph
        The model's mean face.
    basis : Basis
        Components (k, 5 h w). Those of the m pixels inside the mask are copied once.
    mask : array (h, w)
    """

    mean: Morph
    basis: Basis
    mask: Mask

    def fit(self, image: Image, start: LoadingVector, *, steps: int = STEPS) -> LoadingVector:
        """Minimise sum_p area(p) mask(p) |I(p + u(p)) - T(p)|^2 + noise * sum_j L_j^2 / variance_j over the loadings L.

        area(p) is the area of p in the picture. The curvature of the sum comes from a subset of the pixels, the
        gradient from all: the subset changes the number of steps, not the minimum. A step that does not lower the sum
        is halved, twice at most.

        Parameters
        ----------
        image : array (h, w, 3) float32
        start : array (k,)
            Raw loadings, usually the projection.
        steps : int
            The largest number of steps.

        Returns
        -------
        array (k,)
            The best loadings found; their sum is never larger than at the start.

        References
        ----------
        Matthews and Baker (2004), section 2; area weights, prior and step halving are ours.
        """
        best = np.array(start, np.float64)
        read = warp.spline_reader([image[..., channel] for channel in range(3)])
        state = self._at(best, read)
        slopes = [cv2.Scharr(image, cv2.CV_32F, *axes) / np.float32(SCHARR_SUM) for axes in ((1, 0), (0, 1))]
        for _ in range(steps if self.basis.rank else 0):
            along = self._along(slopes, state)
            step = np.linalg.solve(self._normal(along, state), self._downhill(best, along, state))
            for shrink in (1.0, 0.5, 0.25):
                trial = self._at(best + shrink * step, read)
                if trial.cost < state.cost:
                    break
            else:
                break
            is_last = trial.cost > (1 - STILL) * state.cost
            best, state = best + shrink * step, trial
            if is_last:
                break
        return best

    @cached_property
    def _inside(self) -> AnyArray:
        return np.flatnonzero(self.mask > 0)

    @cached_property
    def _textures(self) -> AnyArray:
        """The components' textures inside the mask, (k, 3 m), channel by channel."""
        return self._of_inside(texture_columns(self.mask.shape), 3)

    @cached_property
    def _displacements(self) -> AnyArray:
        """The components' displacements inside the mask, (k, 2 m), first to the right, then down."""
        return self._of_inside(displacement_columns(self.mask.shape), 2)

    def _of_inside(self, part: slice, channels: int) -> AnyArray:
        planes = self.basis.components[:, part].reshape(self.basis.rank, self.mask.size, channels)
        inside = np.ascontiguousarray(planes[:, self._inside].transpose(0, 2, 1))
        return inside.reshape(self.basis.rank, channels * len(self._inside))

    @cached_property
    def _precision(self) -> AnyArray:
        return NOISE_VARIANCE / np.maximum(self.basis.variances, np.finfo(np.float64).tiny)

    def _planes(self, picture: AnyArray) -> AnyArray:
        """Return the pixels (c, m) inside the mask of a picture (h, w, c)."""
        return np.ascontiguousarray(picture.reshape(self.mask.size, -1)[self._inside].T)

    def _at(self, loadings: LoadingVector, read: Callable[[AnyArray, AnyArray], AnyArray]) -> _State:
        moved = self.basis.expand(loadings, displacement_columns(self.mask.shape))
        displacement = self.mean.displacement + moved.reshape(*self.mask.shape, 2)
        residual = read(*warp.positions(displacement)).reshape(3, -1)[:, self._inside]
        residual -= self._mean_texture
        residual -= (np.asarray(loadings, np.float32) @ self._textures).reshape(3, -1)
        area = cv2.copyMakeBorder(warp.determinants(displacement), 0, 1, 0, 1, cv2.BORDER_REPLICATE)
        weight = (self.mask * np.clip(area, *AREA_RANGE)).reshape(-1)[self._inside]
        square = float((weight * residual * residual).sum(dtype=np.float64))
        cost = square + float((self._precision * loadings * loadings).sum())
        return _State(displacement, residual, weight, cost)

    @cached_property
    def _mean_texture(self) -> AnyArray:
        return self._planes(self.mean.texture)

    def _along(self, slopes: list[AnyArray], state: _State) -> tuple[AnyArray, AnyArray]:
        """Return the picture's gradient to the right and down at the face's points, (3, m) each."""
        right, down = (self._planes(warp.sample_field(slope, state.displacement)) for slope in slopes)
        return right, down

    def _downhill(
        self, loadings: LoadingVector, along: tuple[AnyArray, AnyArray], state: _State
    ) -> LoadingVector:
        """Compute half the negative gradient of the sum, (k,): d residual / d L_j = grad I . u_j - T_j."""
        weighed = state.weight * state.residual
        by_moving = np.concatenate([(weighed * slope).sum(axis=0) for slope in along])
        gradient = self._textures @ weighed.reshape(-1) - self._displacements @ by_moving
        return np.asarray(gradient, np.float64) - self._precision * loadings

    def _normal(self, along: tuple[AnyArray, AnyArray], state: _State) -> AnyArray:
        """Compute half the Gauss-Newton curvature of the sum, (k, k), from one pixel in `SPARED`."""
        rank, count = self.basis.rank, len(self._inside)
        textures = self._textures.reshape(rank, 3, count)[:, :, ::SPARED]
        displacements = self._displacements.reshape(rank, 2, count)[:, :, ::SPARED]
        right, down = (slope[:, ::SPARED] for slope in along)
        root = np.sqrt(SPARED * state.weight[::SPARED])
        normal = np.diag(self._precision)
        for start in range(0, textures.shape[2], BLOCK_PIXELS):
            block = slice(start, start + BLOCK_PIXELS)
            for channel in range(3):
                jacobian = displacements[:, 0, block] * right[channel, block]
                jacobian += displacements[:, 1, block] * down[channel, block]
                np.subtract(textures[:, channel, block], jacobian, out=jacobian)
                jacobian *= root[block]
                normal += jacobian @ jacobian.T
        return normal
