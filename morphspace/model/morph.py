"""Morphs: a texture on the mean face and the warp from the mean face to the frame (Nagle et al., section 2).

A morph is a point of the face space; the difference of two morphs is a vector. Two morphs cannot be added. Both types
name their mean face (`reference_id`), so that faces of different models are never mixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, read_only
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.grid import warp

CHANNELS = 5  # R, G, B, x, y: Nagle's w * h * (2 + 3)
FADE_PX = 4.0  # px beyond the edge of a frame, over which its colours fade; a cut would show as a line
MEAN_FOLDS = 0.02  # share of cells; a mean over frames is smooth unless the frames show different things
INVERSE_TOL_PX = 0.01  # px, of m(m^-1(p)) - p at the median; the exact inverse stays below it


@dataclass(frozen=True, eq=False)
class MorphOffset:
    """The difference between two faces on the same mean face.

    Offsets add, subtract and scale. A gain of 1 is veridical, above 1 a caricature, below 0 an anti-face.

    Attributes
    ----------
    vector : array (5 h w,) float32, read-only
        Texture (h, w, 3), then displacement (h, w, 2) px, both in row order.
    shape : (h, w)
    reference_id : str
        The mean face.

    Raises
    ------
    BadInput
        If the length of the vector is not 5 h w.

    Examples
    --------
    >>> import numpy as np
    >>> smile = MorphOffset.of(np.zeros((2, 2, 3)), np.ones((2, 2, 2)), "mean of A")
    >>> (2 * smile - smile).displacement[0, 0].tolist()
    [1.0, 1.0]
    """

    vector: AnyArray
    shape: tuple[int, int]
    reference_id: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", _checked(self.vector, self.shape))

    @classmethod
    def of(cls, texture: Image, displacement: Displacement, reference_id: str) -> MorphOffset:
        """Copy a texture (h, w, 3) and a displacement (h, w, 2) px into one offset.

        Raises `BadInput` if their shapes do not fit.
        """
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
        _check_same_reference(self, other)
        return MorphOffset(self.vector + other.vector, self.shape, self.reference_id)

    def __sub__(self, other: MorphOffset) -> MorphOffset:
        if not isinstance(other, MorphOffset):
            return NotImplemented
        _check_same_reference(self, other)
        return MorphOffset(self.vector - other.vector, self.shape, self.reference_id)

    def __mul__(self, gain: float) -> MorphOffset:
        return MorphOffset(self.vector * np.float32(gain), self.shape, self.reference_id)

    __rmul__ = __mul__


@dataclass(frozen=True, eq=False)
class Morph:
    """A face: a texture on the mean face, and the displacement of each of its points from the mean face to the frame.

    The difference of two morphs is a `MorphOffset`. A morph plus an offset is a morph.

    Attributes
    ----------
    vector : array (5 h w,) float32, read-only
        Texture (h, w, 3), then displacement (h, w, 2) px, both in row order.
    shape : (h, w)
    reference_id : str
        The mean face.

    Raises
    ------
    BadInput
        If the length of the vector is not 5 h w.

    References
    ----------
    Nagle et al., section 2.

    Examples
    --------
    >>> import numpy as np
    >>> mean = Morph.of(np.zeros((2, 2, 3)), np.zeros((2, 2, 2)), "mean of A")
    >>> face = Morph.of(np.ones((2, 2, 3)), np.zeros((2, 2, 2)), "mean of A")
    >>> (mean + 0.5 * (face - mean)).texture[0, 0].tolist()
    [0.5, 0.5, 0.5]
    """

    vector: AnyArray
    shape: tuple[int, int]
    reference_id: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", _checked(self.vector, self.shape))

    @classmethod
    def of(cls, texture: Image, displacement: Displacement, reference_id: str) -> Morph:
        """Copy a texture (h, w, 3) and a displacement (h, w, 2) px into one morph.

        Raises `BadInput` if their shapes do not fit.
        """
        return cls(_joined(texture, displacement), _shape_of(texture), reference_id)

    @property
    def texture(self) -> Image:
        """The colours (h, w, 3) on the mean face, a view."""
        return self.vector[texture_columns(self.shape)].reshape(*self.shape, 3)

    @property
    def displacement(self) -> Displacement:
        """The displacement (h, w, 2) px of each point of the mean face to its place in the frame, a view."""
        return self.vector[displacement_columns(self.shape)].reshape(*self.shape, 2)

    def __sub__(self, other: Morph) -> MorphOffset:
        if not isinstance(other, Morph):
            return NotImplemented
        _check_same_reference(self, other)
        return MorphOffset(self.vector - other.vector, self.shape, self.reference_id)

    def __add__(self, offset: MorphOffset) -> Morph:
        if not isinstance(offset, MorphOffset):
            return NotImplemented
        _check_same_reference(self, offset)
        return Morph(self.vector + offset.vector, self.shape, self.reference_id)

    def render(self) -> Image:
        """Draw the face as a picture (h, w, 3): the texture, warped forward by exact rasterisation."""
        return warp.render(self.texture, self.displacement)


def texture_columns(shape: tuple[int, int]) -> slice:
    """Return the part of a morph vector (5 h w,) that holds colours; `shape` is (h, w).

    Examples
    --------
    >>> texture_columns((72, 60))
    slice(0, 12960, None)
    """
    return slice(0, 3 * shape[0] * shape[1])


def displacement_columns(shape: tuple[int, int]) -> slice:
    """Return the part of a morph vector (5 h w,) that holds displacements; `shape` is (h, w).

    Examples
    --------
    >>> displacement_columns((72, 60))
    slice(12960, 21600, None)
    """
    return slice(3 * shape[0] * shape[1], CHANNELS * shape[0] * shape[1])


def inner_product(mask: Mask, warp_weight: float) -> AnyArray:
    """Compute the weights (5 h w,) of the inner product: mask for texture, s^2 mask for displacement.

    Parameters
    ----------
    mask : array (h, w)
    warp_weight : float
        s, colour per px.

    References
    ----------
    The mask and s are ours; Nagle et al. (section 2) add texture and warp in their own units.

    Examples
    --------
    >>> import numpy as np
    >>> inner_product(np.ones((1, 2), np.float32), 0.5).tolist()
    [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.25, 0.25, 0.25, 0.25]
    """
    height, width = mask.shape
    column = mask[..., None]
    texture = np.broadcast_to(column, (height, width, 3))
    displacement = np.broadcast_to(column * np.float32(warp_weight**2), (height, width, 2))
    return MorphOffset.of(texture, displacement, "").vector


def _checked(vector: AnyArray, shape: tuple[int, int]) -> AnyArray:
    """Return a read-only view of a vector. Raises `BadInput` if its length is not 5 h w."""
    height, width = shape
    if vector.shape != (CHANNELS * height * width,):
        raise BadInput(
            f"a morph vector has shape {vector.shape}; expected ({CHANNELS * height * width},) for {width}x{height} px"
        )
    return read_only(np.asarray(vector, np.float32))


def _joined(texture: Image, displacement: Displacement) -> AnyArray:
    """Copy texture and displacement into one vector. Raises `BadInput` if their shapes do not fit."""
    if texture.shape[2:] != (3,) or displacement.shape != (*texture.shape[:2], 2):
        raise BadInput(
            f"texture and displacement have shapes {texture.shape} and {displacement.shape}; expected (h, w, 3) and "
            "(h, w, 2)"
        )
    return np.concatenate([texture.reshape(-1), displacement.reshape(-1)], dtype=np.float32)


def _shape_of(texture: Image) -> tuple[int, int]:
    return texture.shape[0], texture.shape[1]


def _check_same_reference(one: Morph | MorphOffset, other: Morph | MorphOffset) -> None:
    """Check that two faces lie on the same mean face. Raises `ReferenceMismatch` otherwise."""
    if one.reference_id != other.reference_id:
        raise ReferenceMismatch(
            f"the faces lie on the mean faces {one.reference_id} and {other.reference_id}; expected one mean face. "
            "Encode both with the same model"
        )


def morph_of(image: Image, displacement: Displacement, reference_id: str) -> Morph:
    """Vectorise an aligned picture (h, w, 3): T(p) = I(p + u(p)), by cubic B-spline.

    References
    ----------
    Nagle et al., section 2.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.tile(np.linspace(0, 1, 5, dtype=np.float32)[:, None], (4, 1, 3))
    >>> right = np.full((4, 5, 2), [1.0, 0.0], np.float32)
    >>> morph_of(picture, right, "reference").texture[1, :, 0].round(2).tolist()
    [0.25, 0.5, 0.75, 1.0, 1.0]
    """
    return Morph.of(warp.sample(image, displacement), displacement, reference_id)


def shown_share(displacement: Displacement, registration: Affine) -> Mask:
    """Return where a frame shows the points of a morph: 1 inside its picture, 0 from `FADE_PX` outside, (h, w, 1).

    Parameters
    ----------
    displacement : array (h, w, 2) px
        From the mean face to the aligned frame.
    registration : array (2, 3)
        From the aligned frame to the frame, both of the morph's size.

    Examples
    --------
    >>> import numpy as np
    >>> six_right = np.array([[1.0, 0, 6], [0, 1, 0]])
    >>> shown_share(np.zeros((1, 9, 2), np.float32), six_right)[0, :, 0].tolist()
    [1.0, 1.0, 1.0, 0.75, 0.5, 0.25, 0.0, 0.0, 0.0]
    """
    height, width = displacement.shape[:2]
    x, y = warp.positions(displacement)
    outside = _beyond(x, y, width, height)
    in_frame = warp.apply_affine(registration, np.stack([x, y], axis=-1))
    outside = np.maximum(outside, _beyond(in_frame[..., 0], in_frame[..., 1], width, height))
    share: Mask = np.clip(1 - outside / FADE_PX, 0, 1).astype(np.float32)[..., None]
    return share


def _beyond(x: AnyArray, y: AnyArray, width: int, height: int) -> AnyArray:
    """Return how far points lie outside a picture, px; negative inside."""
    return np.maximum.reduce([-x, x - (width - 1), -y, y - (height - 1)])


def invert_mean_shape(mean_field: Displacement) -> Displacement:
    """Invert the mean shape m(x) = x + mean_i F_i(x): return v with p + v(p) = m^-1(p), (h, w, 2) px.

    Raises
    ------
    BadInput
        If the mean flow is not finite, folds in more than `MEAN_FOLDS` of its cells, or m(m^-1(p)) misses p by more
        than `INVERSE_TOL_PX` at the median. The frames then have no mean face.

    References
    ----------
    Nagle et al., section 2 (the mean face); the inverse on triangles is ours.

    Examples
    --------
    >>> import numpy as np
    >>> right = np.full((5, 5, 2), [1.0, 0.0], np.float32)
    >>> invert_mean_shape(right)[2, 2].tolist()
    [-1.0, 0.0]
    """
    if not np.isfinite(mean_field).all():
        raise BadInput(
            "the mean flow is not finite. Choose another flow method, or leave out frames without texture"
        )
    folded = float((warp.determinants(mean_field) <= 0).mean())
    if folded > MEAN_FOLDS:
        raise BadInput(
            f"the mean shape folds in {folded:.1%} of the frame; expected at most {MEAN_FOLDS:.0%}. Choose another "
            "reference, or leave out frames that show something else"
        )
    inverse = warp.invert(mean_field)
    miss = warp.compose(mean_field, inverse)
    worst = float(np.median(np.hypot(miss[..., 0], miss[..., 1])))
    if worst > INVERSE_TOL_PX:
        raise BadInput(
            f"the inverse of the mean shape misses by {worst:.3f} px; expected at most {INVERSE_TOL_PX} px. Choose "
            "another reference, or leave out frames that show something else"
        )
    return inverse


def resource(field: Displacement, mean_inverse: Displacement) -> Displacement:
    """Carry a flow F from the reference to the mean face: u(p) = m^-1(p) + F(m^-1(p)) - p, (h, w, 2) px.

    References
    ----------
    Nagle et al., section 2 ("resourced").

    Examples
    --------
    >>> import numpy as np
    >>> right = np.full((5, 5, 2), [1.0, 0.0], np.float32)
    >>> resource(2 * right, -right)[2, 2].tolist()
    [1.0, 0.0]
    """
    return warp.compose(field, mean_inverse)


def serialise(morph: Morph | MorphOffset) -> AnyArray:
    """Return Nagle's morph vector (5 h w,): column by column, over R, then G, then B, then x, then y.

    References
    ----------
    Nagle et al., section 2.

    Examples
    --------
    >>> import numpy as np
    >>> face = Morph.of(np.zeros((1, 2, 3)) + (1, 2, 3), np.zeros((1, 2, 2)) + (4, 5), "mean of A")
    >>> serialise(face).tolist()
    [1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0, 5.0, 5.0]
    """
    planes = np.concatenate([morph.texture, morph.displacement], axis=-1)
    return np.ascontiguousarray(planes.transpose(2, 1, 0)).reshape(-1)


def deserialise(vector: AnyArray, height: int, width: int, reference_id: str) -> Morph:
    """Invert `serialise` for a face of (height, width) px. Raises `BadInput` if the vector's length is not 5 h w.

    Examples
    --------
    >>> import numpy as np
    >>> face = deserialise(np.arange(10, dtype=np.float32), 1, 2, "mean of A")
    >>> face.texture[0, 1].tolist(), face.displacement[0, 1].tolist()
    ([1.0, 3.0, 5.0], [7.0, 9.0])
    """
    planes = _checked(vector, (height, width)).reshape(CHANNELS, width, height).transpose(2, 1, 0)
    return Morph.of(planes[..., :3], planes[..., 3:], reference_id)
