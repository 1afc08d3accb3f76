"""Morphs: a texture on the mean face and a warp that puts it back (Nagle section 2).

A morph is a point, the difference of two morphs a vector; points cannot be added. Both know the mean face they live on
(`reference_id`), so that a number measured on one face cannot silently be used on another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, read_only
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.grid import warp

CHANNELS = 5  # R, G, B, x, y: Nagle's w * h * (2 + 3)
MEAN_FOLDS = (
    0.02  # of the cells; a mean over frames is smooth, and folds where the frames show different things
)
INVERSE_TOL_PX = 0.01  # m(m^-1(p)) = p, checked when the mean shape is inverted


@dataclass(frozen=True, eq=False)
class MorphOffset:
    """A difference between two faces that live on the same mean face.

    Offsets add, subtract and scale: a gain of 1 is veridical, above 1 a caricature, below 0 an anti-face.

    Parameters
    ----------
    vector : (5 h w,) float32
        Texture (h, w, 3) and then displacement (h, w, 2) px, both row by row. It is kept read-only.
    shape : (h, w)
    reference_id : str
        The mean face.

    Raises
    ------
    BadInput
        Where the length of the vector is not 5 h w.
    """

    vector: AnyArray
    shape: tuple[int, int]
    reference_id: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", _checked(self.vector, self.shape))

    @classmethod
    def of(cls, texture: Image, displacement: Displacement, reference_id: str) -> MorphOffset:
        """Copy a texture (h, w, 3) and a displacement (h, w, 2) px into one offset. Raises `BadInput`."""
        return cls(_joined(texture, displacement), _shape_of(texture), reference_id)

    @property
    def texture(self) -> Image:
        """The change of colour (h, w, 3), a view."""
        return self.vector[texture_columns(self.shape)].reshape(*self.shape, 3)

    @property
    def displacement(self) -> Displacement:
        """The change of the warp (h, w, 2) px, a view."""
        return self.vector[displacement_columns(self.shape)].reshape(*self.shape, 2)

    def __add__(self, other: MorphOffset) -> MorphOffset:
        if not isinstance(other, MorphOffset):
            return NotImplemented
        check_same_reference(self, other)
        return MorphOffset(self.vector + other.vector, self.shape, self.reference_id)

    def __sub__(self, other: MorphOffset) -> MorphOffset:
        if not isinstance(other, MorphOffset):
            return NotImplemented
        check_same_reference(self, other)
        return MorphOffset(self.vector - other.vector, self.shape, self.reference_id)

    def __mul__(self, gain: float) -> MorphOffset:
        return MorphOffset(self.vector * np.float32(gain), self.shape, self.reference_id)

    __rmul__ = __mul__


@dataclass(frozen=True, eq=False)
class Morph:
    """A face: a texture on the mean face, and the displacement that moves it to where the face has it.

    The difference of two morphs is a `MorphOffset`; a morph and an offset make a morph; two morphs cannot be added.

    Parameters
    ----------
    vector : (5 h w,) float32
        Texture (h, w, 3) and then displacement (h, w, 2) px, both row by row. It is kept read-only.
    shape : (h, w)
    reference_id : str
        The mean face.

    Raises
    ------
    BadInput
        Where the length of the vector is not 5 h w.
    """

    vector: AnyArray
    shape: tuple[int, int]
    reference_id: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", _checked(self.vector, self.shape))

    @classmethod
    def of(cls, texture: Image, displacement: Displacement, reference_id: str) -> Morph:
        """Copy a texture (h, w, 3) and a displacement (h, w, 2) px into one morph. Raises `BadInput`."""
        return cls(_joined(texture, displacement), _shape_of(texture), reference_id)

    @property
    def texture(self) -> Image:
        """The colours on the mean face (h, w, 3), a view."""
        return self.vector[texture_columns(self.shape)].reshape(*self.shape, 3)

    @property
    def displacement(self) -> Displacement:
        """Where each point of the mean face is sent, relative to itself: (h, w, 2) px, a view."""
        return self.vector[displacement_columns(self.shape)].reshape(*self.shape, 2)

    def __sub__(self, other: Morph) -> MorphOffset:
        if not isinstance(other, Morph):
            return NotImplemented
        check_same_reference(self, other)
        return MorphOffset(self.vector - other.vector, self.shape, self.reference_id)

    def __add__(self, offset: MorphOffset) -> Morph:
        if not isinstance(offset, MorphOffset):
            return NotImplemented
        check_same_reference(self, offset)
        return Morph(self.vector + offset.vector, self.shape, self.reference_id)

    def render(self) -> Image:
        """Give the image (h, w, 3): the texture put where the warp sends it, by exact rasterisation."""
        return warp.render(self.texture, self.displacement)


def texture_columns(shape: tuple[int, int]) -> slice:
    """Give which numbers of a morph vector (5 h w,) are colours; `shape` is (h, w)."""
    return slice(0, 3 * shape[0] * shape[1])


def displacement_columns(shape: tuple[int, int]) -> slice:
    """Give which numbers of a morph vector (5 h w,) are displacements; `shape` is (h, w)."""
    return slice(3 * shape[0] * shape[1], CHANNELS * shape[0] * shape[1])


def _checked(vector: AnyArray, shape: tuple[int, int]) -> AnyArray:
    """Give a read-only view of a vector. Raises `BadInput` where its length is not 5 h w."""
    height, width = shape
    if vector.shape != (CHANNELS * height * width,):
        raise BadInput(
            f"a morph vector of {vector.shape} does not fit {width}x{height}: {CHANNELS * height * width} expected"
        )
    return read_only(np.asarray(vector, np.float32))


def _joined(texture: Image, displacement: Displacement) -> AnyArray:
    """Copy both parts into one vector. Raises `BadInput` where they differ in size or are exchanged."""
    if texture.shape[2:] != (3,) or displacement.shape != (*texture.shape[:2], 2):
        raise BadInput(
            f"a displacement of {displacement.shape} does not fit a texture of {texture.shape}: "
            "(h, w, 2) and (h, w, 3) expected"
        )
    return np.concatenate([texture.reshape(-1), displacement.reshape(-1)], dtype=np.float32)


def _shape_of(texture: Image) -> tuple[int, int]:
    return texture.shape[0], texture.shape[1]


def check_same_reference(one: Morph | MorphOffset, other: Morph | MorphOffset) -> None:
    """Raise `ReferenceMismatch` where two faces live on different mean faces."""
    if one.reference_id != other.reference_id:
        raise ReferenceMismatch(
            f"one face lives on the mean face {one.reference_id}, the other on {other.reference_id}: "
            "encode both with the same model"
        )


def morph_of(image: Image, displacement: Displacement, reference_id: str) -> Morph:
    """Take an aligned image apart: T(p) = I(p + u(p)), by cubic B-spline (methods 3.3)."""
    return Morph.of(warp.sample(image, displacement), displacement, reference_id)


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


def serialise(morph: Morph | MorphOffset) -> AnyArray:
    """Give Nagle's morph vector (5 h w,): column by column over R, then G, then B, then x, then y (section 2)."""
    planes = np.concatenate([morph.texture, morph.displacement], axis=-1)
    return np.ascontiguousarray(planes.transpose(2, 1, 0)).reshape(-1)


def deserialise(vector: AnyArray, height: int, width: int, reference_id: str) -> Morph:
    """Undo `serialise`. Raises `BadInput` where the vector's length is not 5 h w."""
    planes = _checked(vector, (height, width)).reshape(CHANNELS, width, height).transpose(2, 1, 0)
    return Morph.of(planes[..., :3], planes[..., 3:], reference_id)
