"""Nagle's mimicry: the expression of person A on the face of person B (section 3, "Expression Projection").

The steps and symbols are the paper's:

    2  R_a = M_a - M_ma    the face of A relative to the mean of A
       G R_a               the same on the mean face of B: texture and warp field moved by the affine G between the
                           faceframes; a displacement is a vector, so the linear part of G turns and scales it too
    3  L_b = R_a x P_b     its loadings in B's expression space: inner products with B's components
    4  R_b = P_b x L_b     what B's components can show of it
    5  M_b = R_b + M_mb    the face of B

Step 1 is `MorphModel.morph_of`, which encodes a picture as M_a; step 6 is `Morph.render`.

References
----------
Nagle, Griffin, Johnston and McOwan, Techniques for mimicry and identity blending using morph space PCA, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, LoadingVector, Mask
from morphspace.grid import warp
from morphspace.linear.pca import InnerProducts
from morphspace.model.keypoints import affine_between_models
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset


@dataclass(frozen=True, eq=False)
class Projection:
    """The projection of faces of `source`, person A, into the expression space of `target`, person B.

    Attributes
    ----------
    source, target : MorphModel

    Raises
    ------
    BadInput
        On first use, if a model has no keypoints, or its keypoints span no face.
    """

    source: MorphModel
    target: MorphModel

    def mimicry(self, face: Morph) -> Morph:
        """Compute the face of B, M_b, with the expression of a face of A, M_a."""
        relative = face - self.source.mean
        loadings = self.loadings(self.carried(relative))
        return self.target.mean + self.target.offset(loadings)

    @cached_property
    def affine(self) -> Affine:
        """G (2, 3): moves points of A's mean face to B's, so that the faceframes coincide."""
        return affine_between_models(self.source, self.target)

    def carried(self, relative: MorphOffset) -> MorphOffset:
        """Compute G R_a on the grid of B's mean face; 0 outside A's picture."""
        linear = self.affine[:, :2].astype(np.float32)
        right, down = (self._on_target(relative.displacement[..., axis]) for axis in (0, 1))
        displacement = np.empty((*right.shape, 2), np.float32)
        displacement[..., 0] = linear[0, 0] * right + linear[0, 1] * down
        displacement[..., 1] = linear[1, 0] * right + linear[1, 1] * down
        texture = self._on_target(relative.texture)
        return MorphOffset.of(texture, displacement, self.target.mean.reference_id)

    def loadings(self, relative: MorphOffset) -> LoadingVector:
        """Compute L_b (k_B,) of an offset on B's mean face."""
        return self._components.with_offset(relative.vector)

    @cached_property
    def _components(self) -> InnerProducts:
        """P_b, in the inner product of B's model."""
        return self.target.basis.inner_products()

    @cached_property
    def source_mask(self) -> Mask:
        """A's mask (h, w) on B's mean face."""
        return self._on_target(self.source.mask)

    @cached_property
    def _places(self) -> tuple[AnyArray, AnyArray]:
        """The position on A's mean face of each pixel of B's: x and y px, (h, w) each."""
        back = warp.inverse_affine(self.affine)
        return warp.positions(warp.affine_displacement(back, *self.target.mask.shape))

    def _on_target(self, planes: AnyArray) -> AnyArray:
        """Sample a plane (H, W) or a texture (H, W, 3) of A at each pixel of B; 0 outside."""
        x, y = self._places
        outside = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": 0}
        return cv2.remap(np.ascontiguousarray(planes), x, y, cv2.INTER_LINEAR, **outside)
