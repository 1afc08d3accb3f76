"""Mix the colours of a face from the model's training faces (ours).

A loading scales warp and colour together. Driven by another person, a model receives loadings far from those of its
own frames. The warp tolerates that: a face pulled further is still a face. Colours do not: teeth turn to stripes,
lips to skin. The puppets of Suwajanakorn, Seitz and Kemelmacher-Shlizerman (ICCV 2015) use only photographs of the
person. Here the colours are a convex mixture of training faces on the mean face, where features lie on each other.
The mixture prefers faces whose lips, or lids and brows, have the requested shape. The parts above and below the nose
are mixed separately, since brows and mouths combine freely. Colours are linear in the loadings, so a mixture of
training faces is the face of the mixed loadings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import AnyArray, Image, LoadingTable, LoadingVector, Mask
from morphspace.face.expression import ring_gaps
from morphspace.face.mesh import LANDMARKS, landmark_places
from morphspace.face.regions import lower_share
from morphspace.linear.simplex import nearest_mixture
from morphspace.model.keypoints import landmarks_of, moved_by_components, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset

# Weight of each training face's own distance against the distance of the mixture. At 1 fewer faces are mixed: colours
# are a little sharper and follow a little worse.
LOCALITY = 0.3
# SD, root mean square; nearer to the mean a face fades into the mean, which no frame shows
NEAR_MEAN_SD = 0.1
NEAREST = 100  # training faces in a mixture at most
# Weight of a gap between lips or lids against a landmark's position: gaps decide what is visible
OPENING = 2.0


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the picture with its own mixture.

    Attributes
    ----------
    shape : array (k, m)
        Features by which faces are compared in this part, per unit of each loading, in eye distances.
    training_shapes : array (f, m)
        The features of the f training faces.
    places : array (n,)
        Indices of the part's pixels.
    colours : array (k, 3 n)
        The components' colours there, times the pixel's membership in the part.
    """

    shape: AnyArray
    training_shapes: AnyArray
    places: AnyArray
    colours: AnyArray


@dataclass(frozen=True, eq=False)
class MixedColours:
    """Colours of faces of `model`, mixed from its training faces. Raises `BadInput` if it has no faceframe."""

    model: MorphModel

    def offset(self, loadings: LoadingVector) -> MorphOffset:
        """Compute the offset of the face of raw loadings (k,): mixed colours, and the warp of the loadings."""
        model = self.model
        return MorphOffset.of(
            self.change(loadings), model.displacement_offset(loadings), model.mean.reference_id
        )

    def change(self, loadings: LoadingVector) -> Image:
        """Mix the texture (h, w, 3) of the face of raw loadings (k,), relative to the mean's.

        A training face keeps its own texture, and so does the mean.
        """
        stacked = np.empty((sum(len(part.places) for part in self.parts), 3), np.float32)
        start = 0
        for part in self.parts:
            end = start + len(part.places)
            mixture = np.asarray(self.mixed(part, loadings), np.float32)
            np.dot(mixture, part.colours, out=stacked[start:end].reshape(-1))
            start = end
        first, further = self.layers
        out = np.take(stacked, first, axis=0)
        for places, rows in further:
            out[places] = np.take(out, places, axis=0) + np.take(stacked, rows, axis=0)
        return out.reshape(*self.model.mask.shape, 3)

    def mixed(self, part: Part, loadings: LoadingVector) -> LoadingVector:
        """Return the loadings (k,) of the mixture of training faces that comes closest to a face in one part."""
        apart = part.training_shapes - np.asarray(loadings, np.float64) @ part.shape
        costs = LOCALITY * (apart * apart).sum(axis=1)
        near: AnyArray | slice = slice(None)
        if len(costs) > NEAREST:
            near = np.sort(np.argsort(costs, kind="stable")[:NEAREST])
        distance = min(float(np.sqrt(np.mean((loadings / self.model.sd) ** 2))) / NEAR_MEAN_SD, 1.0)
        return (
            distance
            * distance
            * (3 - 2 * distance)
            * (nearest_mixture(apart[near], costs[near]) @ self.faces[near])
        )

    @cached_property
    def faces(self) -> LoadingTable:
        """The raw loadings (f, k) of the training faces; the mean alone if the model holds none."""
        values = np.asarray(self.model.training.values, np.float64)
        return values if len(values) else np.zeros((1, self.model.rank))

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The face above the nose, the face below it, and the surroundings."""
        inside = self.model.mask
        height, width = inside.shape
        lower = lower_share(height, width, required_faceframe(self.model))
        shares = {"upper": inside * (1 - lower), "lower": inside * lower, "around": 1 - inside}
        shapes = _shapes(self.model, shares)
        return tuple(self._part(shapes[name], share) for name, share in shares.items())

    @cached_property
    def layers(self) -> tuple[AnyArray, tuple[tuple[AnyArray, AnyArray], ...]]:
        """How the pixels of all parts, in one stack, add up to the picture.

        The first array (h w,) is the row of each pixel in the first part that contains it. The pairs list, for each
        further part, the pixels that an earlier part contains too, and their rows.
        """
        first = np.full(self.model.mask.size, -1)
        further, start = [], 0
        for part in self.parts:
            rows = start + np.arange(len(part.places))
            again = first[part.places] >= 0
            further.append((part.places[again], rows[again]))
            first[part.places[~again]] = rows[~again]
            start += len(rows)
        return first, tuple(further[1:])

    def _part(self, shape: AnyArray, share: Mask) -> Part:
        """Copy the components at the part's pixels; most pixels belong to one part and are read once."""
        places = np.flatnonzero(share)
        textures = self.model.component_textures.reshape(self.model.rank, -1, 3)
        colours = np.take(textures, places, axis=1)  # a copy
        colours *= share.reshape(-1)[places, None]
        return Part(shape, self.faces @ shape, places, colours.reshape(self.model.rank, -1))


def _shapes(model: MorphModel, shares: Mapping[str, Mask]) -> dict[str, AnyArray]:
    """Compute the features by which faces are compared in each part, (k, m), in eye distances per loading.

    These are the landmarks, root mean square, if the model has any in the part, else the warp of all its points.
    """
    right, left, _ = required_faceframe(model).points
    eyes_px = float(np.hypot(*(left - right)))
    shapes = {name: _fields_shape(model, share) / eyes_px for name, share in shares.items()}
    points = landmarks_of(model)
    by_warp = None if points is None else moved_by_components(model, points[list(LANDMARKS)]) / eyes_px
    moved = by_warp if model.landmarks is None else model.landmarks.weights / eyes_px
    if moved is None:
        return shapes
    lids, brows, outer, inner = (
        moved[:, landmark_places(name)] for name in ("lids", "brows", "outer lips", "inner lips")
    )
    half = lids.shape[1] // 2
    eyes = lids[:, :half], lids[:, half:]
    upper = [*map(_about_middle, eyes), *map(_gaps, eyes), brows - lids.mean(axis=1, keepdims=True)]
    if by_warp is not None and moved is not by_warp:
        # Movement in colour alone must agree too: a brow that the warp raises would else be raised again in colour.
        # Lips are left out, since teeth then slid over the lip more often than they stayed behind it.
        by_colour = moved - by_warp
        upper += [by_colour[:, landmark_places(name)] for name in ("lids", "brows")]
    lower = [_about_middle(np.concatenate([outer, inner], axis=1)), _gaps(inner)]
    return {**shapes, "upper": _together(upper), "lower": _together(lower)}


def _about_middle(moved: AnyArray) -> AnyArray:
    """Subtract the mean movement: colours depend on a mouth's shape, the warp on its position."""
    return moved - moved.mean(axis=1, keepdims=True)


def _gaps(ring: AnyArray) -> AnyArray:
    return OPENING * ring_gaps(ring)


def _together(shapes: list[AnyArray]) -> AnyArray:
    """Concatenate shapes (k, m_i, 2), each divided by the root of its number of points: (k, m)."""
    return np.concatenate(
        [shape.reshape(len(shape), -1) / np.sqrt(shape.shape[1]) for shape in shapes], axis=1
    )


def _fields_shape(model: MorphModel, share: Mask) -> AnyArray:
    """Compute a matrix (k, k) px whose rows differ as the components' warps do, root mean square in a part."""
    weight = share.reshape(-1)
    fields = model.component_displacements.reshape(model.rank, -1, 2)
    gram = np.zeros((model.rank, model.rank))
    for axis in (0, 1):
        plane = np.asarray(fields[..., axis], np.float64)
        gram += (plane * weight) @ plane.T
    values, vectors = np.linalg.eigh(gram / max(float(weight.sum()), 1.0))
    return vectors * np.sqrt(np.maximum(values, 0))
