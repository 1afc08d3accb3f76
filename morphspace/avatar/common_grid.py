"""Put all identities on one grid: the mean face of the reference identity, to which the other mean faces correspond.

Nagle computes the flow from the k versions of each expression to that of the reference identity (section 4, step 8).
Here each version is a morph, whose warp says where each point of its mean face went. So the mean faces are put in
correspondence, where all are neutral and the flow is most certain, held by the points of the face mesh. The
correspondence of a version follows by composition. The mouth, which a neutral face cannot show, is matched anew in
each expression (`mouth`). Nothing is resampled twice. (Ours.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask
from morphspace.errors import BadInput
from morphspace.face.anchor import HELD, spline_from
from morphspace.face.faceframe import FaceFrame, identity_affine
from morphspace.face.regions import inside_outline, skin_share
from morphspace.flow import methods
from morphspace.flow.folds import unfolded
from morphspace.grid import warp
from morphspace.model.keypoints import affine_between, affine_between_models, landmarks_of, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph

MOST_BEYOND_POINTS = 0.02  # of the width: how far the flow may leave the spline through the points


@dataclass(frozen=True, eq=False)
class Laid:
    """A morph on the common grid: texture (h, w, 3), and displacement (h, w, 2) px to the aligned picture."""

    texture: Image
    displacement: Displacement


@dataclass(frozen=True, eq=False)
class CommonFace:
    """The common grid.

    Attributes
    ----------
    fields : sequence of arrays (h, w, 2) px
        From the grid to each identity's mean face.
    mask : array (h, w)
        The mask of the blend.
    skin : sequence of arrays (h, w)
        The share of skin, rather than hair, in each identity's mean face.
    """

    models: Sequence[MorphModel]
    fields: Sequence[Displacement]
    mask: Mask
    skin: Sequence[Mask]

    def laid(self, identity: int, morph: Morph, place: Affine) -> Laid:
        """Bring an identity's morph to the grid; `place` (2, 3) maps its pictures to the aligned picture."""
        check_finite(self.models[identity], morph)
        field = self.fields[identity]
        texture, moved = morph.texture, morph.displacement
        if field.any():
            texture = warp.sample(texture, field)
            moved = warp.compose(moved, field)
        return Laid(texture, placed(moved, place))


def placed(displacement: Displacement, place: Affine) -> Displacement:
    """Move the end points of a displacement by an affine (2, 3)."""
    if np.allclose(place, identity_affine(), rtol=0, atol=1e-9):
        return displacement
    height, width = displacement.shape[:2]
    x, y = warp.positions(displacement)
    x, y = x.astype(np.float64), y.astype(np.float64)
    out = np.empty_like(displacement)
    out[..., 0] = place[0, 0] * x + place[0, 1] * y + place[0, 2] - np.arange(width)
    out[..., 1] = place[1, 0] * x + place[1, 1] * y + place[1, 2] - np.arange(height)[:, None]
    return out


def version_picture(morph: Morph, place: Affine) -> Image:
    """Draw a version (h, w, 3) in its alignment (Nagle section 4, step 7)."""
    return warp.render(morph.texture, placed(morph.displacement, place))


def check_finite(model: MorphModel, morph: Morph) -> None:
    """Raise `BadInput` if a morph of a model is not finite: no picture can be drawn of it."""
    count = int((~np.isfinite(morph.displacement)).sum())
    if count:
        raise BadInput(
            f"the model of {model.identity} gives a face in which {count} of {morph.displacement.size} displacements "
            "are not finite numbers: build it again"
        )


def places_on(models: Sequence[MorphModel], faceframe: FaceFrame) -> list[Affine]:
    """Return the affine (2, 3) that takes each identity's mean face onto a faceframe."""
    return [affine_between(required_faceframe(model), faceframe) for model in models]


def mean_faceframe(models: Sequence[MorphModel], weights: AnyArray) -> FaceFrame:
    """Return the weighted mean of the identities' faceframes."""
    points = [required_faceframe(model).points for model in models]
    return FaceFrame.at(np.tensordot(weights, np.array(points), 1))


def common_face(models: Sequence[MorphModel], keys: Sequence[str], reference: int, flow: str) -> CommonFace:
    """Put the mean face of every identity in correspondence with that of `reference`."""
    home = models[reference]
    height, width = home.mask.shape
    find = methods.for_morphs(flow)(np.array(home.mean.texture))
    fields = []
    for model, key in zip(models, keys, strict=True):
        if key == keys[reference]:
            fields.append(np.zeros((height, width, 2), np.float32))
            continue
        start, held = _start(home, model)
        rest = find(warp.sample(np.array(model.mean.texture), start), None).displacement
        if held:
            rest = shortened(rest, MOST_BEYOND_POINTS * width)
        fields.append(unfolded(warp.compose(start, rest)))
    masks = [warp.sample_field(model.mask, field) for model, field in zip(models, fields, strict=True)]
    points = landmarks_of(home)
    if points is not None:
        masks.append(inside_outline(points, height, width))
    mask = np.clip(np.min(masks, axis=0), 0, 1).astype(np.float32)
    skin = [np.ones((height, width), np.float32)] * len(models)
    if points is not None:
        textures = [
            warp.sample(np.array(model.mean.texture), field)
            for model, field in zip(models, fields, strict=True)
        ]
        skin = [skin_share(points, texture, mask) for texture in textures]
    return CommonFace(models, fields, mask, skin)


def _start(home: MorphModel, other: MorphModel) -> tuple[Displacement, bool]:
    """Return the start of a correspondence, (h, w, 2) px, and whether points of the face hold it."""
    height, width = home.mask.shape
    points = [landmarks_of(model) for model in (home, other)]
    if points[0] is None or points[1] is None:
        return warp.affine_displacement(affine_between_models(home, other), height, width), False
    held = list(HELD)
    return unfolded(spline_from(points[0][held], height, width)(points[1][held])), True


def shortened(field: Displacement, most_px: float) -> Displacement:
    """Shorten the vectors of a field smoothly below a length in px."""
    square = (field * field).sum(axis=2, keepdims=True) / np.float32(most_px**2)
    return (field / np.sqrt(1 + square)).astype(np.float32)
