"""The colours of a face that a model is asked for: mixed from faces it has shown, never beyond them (ours).

A loading scales warp and colour together. Driven by another person a model is asked for loadings that none of its own
frames came near; the warp bears that, since a face pulled further is a face, but colours do not: teeth turn to stripes,
lips to skin. Suwajanakorn's puppets never leave the photographs of the person. So here the colours are a convex mixture
of the model's training faces, which lie on the mean face feature by feature: those whose lips, or lids and brows, have
the shape that was asked for. The part above the nose and the part below it are mixed by themselves, as brows and mouths
combine freely. As colours are linear in the loadings, a mixture of training faces is the face of the mixed loadings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import AnyArray, Image, LoadingTable, LoadingVector, Mask
from morphspace.face.expression import ring_gaps
from morphspace.face.mesh import LANDMARKS, landmark_places
from morphspace.linear.simplex import nearest_mixture
from morphspace.model.keypoints import landmarks_of, moved_by_components, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset

UPPER_FROM, LOWER_FROM = (
    0.35,
    0.70,
)  # of the way from the eyes to the philtrum: between them one part becomes the other
# What a training face costs for being unlike what is asked for, beside what its mixture misses. At 1 fewer faces are
# mixed, which is a little sharper and follows a little worse.
LOCALITY = 0.3
NEAR_MEAN_SD = (
    0.1  # root mean square length; nearer than this a face turns into the mean, which no frame shows
)
NEAREST = 100  # training faces that are mixed at most; the others are farther from what is asked for
OPENING = (
    2.0  # of how far two lips or two lids are apart, beside where a landmark is: it decides what can be seen
)


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the picture, which is mixed by itself.

    `shape` (k, m) is what tells faces apart there, per unit of each loading, in eye distances | `seen` (f, m), the same
    of each training face | `places` of its n pixels | `colours` (k, 3 n), the components there, each times how far the
    pixel belongs to the part.
    """

    shape: AnyArray
    seen: AnyArray
    places: AnyArray
    colours: AnyArray


@dataclass(frozen=True, eq=False)
class MixedColours:
    """The colours of faces of `model`, mixed from its training faces. Raises `BadInput` where it has no faceframe."""

    model: MorphModel

    def offset(self, loadings: LoadingVector) -> MorphOffset:
        """Give the difference from the mean of a face: its colours mixed, its warp that of the loadings (k,)."""
        model = self.model
        return MorphOffset.of(
            self.change(loadings), model.displacement_offset(loadings), model.mean.reference_id
        )

    def change(self, loadings: LoadingVector) -> Image:
        """Give the texture (h, w, 3) of the face of loadings (k,), relative to the mean's.

        A training face keeps its own, and so does the mean.
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
        """Give the mixture of training faces (k,) that shows what the face of these loadings shows in a part."""
        apart = part.seen - np.asarray(loadings, np.float64) @ part.shape
        costs = LOCALITY * (apart * apart).sum(axis=1)
        near: AnyArray | slice = slice(None)
        if len(costs) > NEAREST:
            near = np.sort(np.argsort(costs, kind="stable")[:NEAREST])
        away = min(float(np.sqrt(np.mean((loadings / self.model.sd) ** 2))) / NEAR_MEAN_SD, 1.0)
        return away * away * (3 - 2 * away) * (nearest_mixture(apart[near], costs[near]) @ self.faces[near])

    @cached_property
    def faces(self) -> LoadingTable:
        """The training faces (n, k); the mean alone where the model holds none."""
        values = np.asarray(self.model.training.values, np.float64)
        return values if len(values) else np.zeros((1, self.model.rank))

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The face above the nose, the face below it, and what lies around it."""
        inside, lower = self.model.mask, _lower(self.model)
        shares = {"upper": inside * (1 - lower), "lower": inside * lower, "around": 1 - inside}
        shapes = _shapes(self.model, shares)
        return tuple(self._part(shapes[name], share) for name, share in shares.items())

    @cached_property
    def layers(self) -> tuple[AnyArray, tuple[tuple[AnyArray, AnyArray], ...]]:
        """Where each of the h w pixels stands among those of all parts, one part after the other: in the first part
        that has it; and of further parts the pixels that an earlier one has too, with where they stand.
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
        """Copy the components where the part is: most pixels belong to one part, and are read once."""
        places = np.flatnonzero(share)
        textures = self.model.component_textures.reshape(self.model.rank, -1, 3)
        colours = np.take(textures, places, axis=1)  # a copy
        colours *= share.reshape(-1)[places, None]
        return Part(shape, self.faces @ shape, places, colours.reshape(self.model.rank, -1))


def _lower(model: MorphModel) -> Mask:
    """Give how far each point of the mean face belongs to its lower part, (h, w) in [0, 1]."""
    right, left, lip = required_faceframe(model).points
    eyes = (right + left) / 2
    down = (lip - eyes) / float((lip - eyes) @ (lip - eyes))
    height, width = model.mask.shape
    y, x = np.mgrid[:height, :width]
    along = (x - eyes[0]) * down[0] + (y - eyes[1]) * down[1]
    ramp = np.clip((along - UPPER_FROM) / (LOWER_FROM - UPPER_FROM), 0, 1)
    return (ramp * ramp * (3 - 2 * ramp)).astype(np.float32)


def _shapes(model: MorphModel, shares: Mapping[str, Mask]) -> dict[str, AnyArray]:
    """Give what tells faces apart in each part, (k, m), in eye distances per loading.

    Landmarks, root mean square, inside the face where the model knows any, else the warp of every point.
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
        # What the colours alone have moved must agree too, or a brow that the warp raises is raised again in colour.
        # Lips are left out: with them teeth slid over the lip more often than they stayed behind it.
        by_colour = moved - by_warp
        upper += [by_colour[:, landmark_places(name)] for name in ("lids", "brows")]
    lower = [_about_middle(np.concatenate([outer, inner], axis=1)), _gaps(inner)]
    return {**shapes, "upper": _together(upper), "lower": _together(lower)}


def _about_middle(moved: AnyArray) -> AnyArray:
    """Leave out where the whole of it goes: colours tell how a mouth is shaped, the warp where it is."""
    return moved - moved.mean(axis=1, keepdims=True)


def _gaps(ring: AnyArray) -> AnyArray:
    return OPENING * ring_gaps(ring)


def _together(shapes: list[AnyArray]) -> AnyArray:
    """Lay shapes (k, m_i, 2) side by side, each a mean over its points: (k, m)."""
    return np.concatenate(
        [shape.reshape(len(shape), -1) / np.sqrt(shape.shape[1]) for shape in shapes], axis=1
    )


def _fields_shape(model: MorphModel, share: Mask) -> AnyArray:
    """Give a matrix (k, k) px whose rows are as far apart as the components' warps, root mean square in a part."""
    weight = share.reshape(-1)
    fields = model.component_displacements.reshape(model.rank, -1, 2)
    gram = np.zeros((model.rank, model.rank))
    for axis in (0, 1):
        plane = np.asarray(fields[..., axis], np.float64)
        gram += (plane * weight) @ plane.T
    values, vectors = np.linalg.eigh(gram / max(float(weight.sum()), 1.0))
    return vectors * np.sqrt(np.maximum(values, 0))
