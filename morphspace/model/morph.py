"""Morphs: a texture on the mean face and a warp that puts it back (Nagle section 2).

A morph is a point, the difference of two morphs a vector; points cannot be added. Both know the mean face they live on
(`reference_id`), so that a number measured on one face cannot silently be used on another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.grid import warp

CHANNELS = 5  # R, G, B, x, y: Nagle's w * h * (2 + 3)
MEAN_FOLDS = (
    0.02  # of the cells; a mean over frames is smooth, and folds where the frames show different things
)
INVERSE_TOL_PX = 0.01  # m(m^-1(p)) = p, checked when the mean shape is inverted


@dataclass(frozen=True, eq=False)
class MorphOffset:
    """A difference between faces: displacement (h, w, 2) px and texture (h, w, 3), on the face `reference_id`."""

    displacement: Displacement
    texture: Image
    reference_id: str

    def __add__(self, other: MorphOffset) -> MorphOffset:
        if not isinstance(other, MorphOffset):
            return NotImplemented
        check_same_reference(self, other)
        return MorphOffset(
            self.displacement + other.displacement, self.texture + other.texture, self.reference_id
        )

    def __sub__(self, other: MorphOffset) -> MorphOffset:
        return self + other * -1.0

    def __mul__(self, gain: float) -> MorphOffset:
        factor = np.float32(gain)
        return MorphOffset(self.displacement * factor, self.texture * factor, self.reference_id)

    __rmul__ = __mul__


@dataclass(frozen=True, eq=False)
class Morph:
    """A face: texture (h, w, 3) on the mean face of `reference_id`, and displacement (h, w, 2) px that moves it.

    Raises `BadInput` where the two differ in size.
    """

    displacement: Displacement
    texture: Image
    reference_id: str

    def __post_init__(self) -> None:
        if self.displacement.shape[:2] != self.texture.shape[:2]:
            raise BadInput(
                f"a displacement of {self.displacement.shape[:2]} does not fit a texture of {self.texture.shape[:2]}"
            )

    def __sub__(self, other: Morph) -> MorphOffset:
        if not isinstance(other, Morph):
            return NotImplemented
        check_same_reference(self, other)
        return MorphOffset(
            self.displacement - other.displacement, self.texture - other.texture, self.reference_id
        )

    def __add__(self, offset: MorphOffset) -> Morph:
        if not isinstance(offset, MorphOffset):
            return NotImplemented
        check_same_reference(self, offset)
        return Morph(
            self.displacement + offset.displacement, self.texture + offset.texture, self.reference_id
        )

    def render(self) -> Image:
        """Give the image (h, w, 3): the texture put where the warp sends it, by exact rasterisation."""
        return warp.render(self.texture, self.displacement)


def check_same_reference(one: Morph | MorphOffset, other: Morph | MorphOffset) -> None:
    """Raise `ReferenceMismatch` where two faces live on different mean faces."""
    if one.reference_id != other.reference_id:
        raise ReferenceMismatch(
            f"one face lives on the mean face {one.reference_id}, the other on {other.reference_id}: "
            "encode both with the same model"
        )


def morph_of(image: Image, displacement: Displacement, reference_id: str) -> Morph:
    """Take an aligned image apart: T(p) = I(p + u(p)), by cubic B-spline (methods 3.3)."""
    return Morph(displacement, warp.sample(image, displacement), reference_id)


def invert_mean_shape(mean_field: Displacement) -> Displacement:
    """Invert the mean shape m(x) = x + mean_i F_i(x): give v with p + v(p) = m^-1(p), (h, w, 2) px.

    Raises `BadInput` where the mean flow folds in more than `MEAN_FOLDS` of its cells, or m(m^-1(p)) misses p by more
    than 0.01 px at the median: then there is no mean face.
    """
    if not np.isfinite(mean_field).all():
        raise BadInput(
            "the mean flow is not finite: choose another flow, or leave out frames without texture"
        )
    folded = float((warp.determinants(mean_field) <= 0).mean())
    if folded > MEAN_FOLDS:
        raise BadInput(
            f"the mean shape folds in {folded:.1%} of the frame, allowed are {MEAN_FOLDS:.0%}: choose another "
            "reference or leave out frames that show something else"
        )
    inverse = warp.invert(mean_field)
    miss = warp.compose(mean_field, inverse)
    worst = float(np.median(np.hypot(miss[..., 0], miss[..., 1])))
    if worst > INVERSE_TOL_PX:
        raise BadInput(
            f"the mean shape cannot be inverted: it misses by {worst:.3f} px, allowed are {INVERSE_TOL_PX} px; "
            "choose another reference or leave out frames that show something else"
        )
    return inverse


def resource(field: Displacement, mean_inverse: Displacement) -> Displacement:
    """Carry a flow from the reference to the mean face: u(p) = m^-1(p) + F(m^-1(p)) - p (Nagle: "resourced")."""
    return warp.compose(field, mean_inverse)


def vector_of(texture: Image, displacement: Displacement) -> AnyArray:
    """Give the vector (5 h w,) that models compute with: texture, then displacement, both row by row."""
    return np.concatenate([texture.reshape(-1), displacement.reshape(-1)])


def parts_of(vector: AnyArray, height: int, width: int) -> tuple[Image, Displacement]:
    """Undo `vector_of`: give the texture (h, w, 3) and the displacement (h, w, 2)."""
    colours = height * width * 3
    return vector[:colours].reshape(height, width, 3), vector[colours:].reshape(height, width, 2)


def serialise(morph: Morph | MorphOffset) -> AnyArray:
    """Give Nagle's morph vector (5 h w,): column by column over R, then G, then B, then x, then y (section 2)."""
    planes = np.concatenate([morph.texture, morph.displacement], axis=-1)
    return np.ascontiguousarray(planes.transpose(2, 1, 0)).reshape(-1)


def deserialise(vector: AnyArray, height: int, width: int, reference_id: str) -> Morph:
    """Undo `serialise`. Raises `BadInput` where the vector's length is not 5 h w."""
    if vector.shape != (CHANNELS * height * width,):
        raise BadInput(
            f"a morph vector of {vector.shape} does not fit {width}x{height}: {CHANNELS * height * width} expected"
        )
    planes = np.ascontiguousarray(vector.reshape(CHANNELS, width, height).transpose(2, 1, 0), np.float32)
    return Morph(planes[..., 3:].copy(), planes[..., :3].copy(), reference_id)
