"""Match the mouths of people in each expression, by flow between their versions (Nagle section 4, step 8).

Mean faces correspond when neutral (`common_grid`), and the warps carry this correspondence along. It fails at the
mouth: one model shows an opening by its warp and another by colour, and teeth correspond to nothing in a neutral
face. So the flow between the pictures of the versions is computed there. It starts from the neutral correspondence,
moved by a spline until the landmarks of the versions meet, and may leave this start by a share of the width only.
Landmarks come from each model's regression. All versions are matched to that of the person whose expression it is.
The reference identity's version, as published, is torn where that person cannot show the expression. (Ours.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points
from morphspace.avatar.common_grid import Laid, placed, shortened
from morphspace.avatar.versions import Version, believed
from morphspace.face.anchor import CHEEKS_AND_CHIN, spline_from
from morphspace.face.mesh import LANDMARKS, LIPS, PHILTRUM, POINT_COUNT, RIGID_POINTS
from morphspace.face.regions import lips_region
from morphspace.flow import methods
from morphspace.flow.folds import unfolded
from morphspace.grid import warp
from morphspace.model.keypoints import landmarks_of
from morphspace.model.model import MorphModel

DOUBT = 2.5  # how much more a regression errs on an expression carried over than on those it was learned from
MOST_BEYOND_START = 0.04  # of the width: how far the flow may leave where it starts
HOLDING = tuple(sorted({*LIPS, PHILTRUM, *RIGID_POINTS, *CHEEKS_AND_CHIN}))
"""Places in the mesh of what holds the mouth: its lips, and what stands around them."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Landmarks of a version: `points` (m, 2) px in its aligned picture, and their errors, `error_px` (m,).

    A point that the warp carries, without a regression, has the error 0.
    """

    points: Points
    error_px: AnyArray


@dataclass(frozen=True, eq=False)
class Matcher:
    """Matches the versions of an expression to the version of the person whose expression it is.

    Attributes
    ----------
    models, keys : of the identities
    places : sequence of affines (2, 3)
        From their pictures to the aligned picture.
    flow : str
        The flow between the pictures.
    """

    models: Sequence[MorphModel]
    keys: Sequence[str]
    places: Sequence[Affine]
    flow: str
    holding: ClassVar[tuple[int, ...]] = HOLDING

    def matched(self, versions: Sequence[Version], laid: Mapping[int, Laid]) -> dict[int, Laid]:
        """Match versions at the mouth, from morphs on the common grid in neutral correspondence.

        Versions without landmarks, and implausible ones, stay as they are.
        """
        out = dict(laid)
        home = self.home(versions)
        points = self.landmarks(home, versions[home])
        others = [i for i in laid if believed(versions[i]) > 0 and self.keys[i] != self.keys[home]]
        if not others or points is None:
            return out
        there = laid[home].displacement
        height, width = there.shape[:2]
        back = warp.invert(there)
        held = spline_from(points.points, height, width)
        find = methods.for_morphs(self.flow)(self._picture(home, versions[home])[0])
        region = self.region(points, height, width)[..., None]
        for i in others:
            found = self.landmarks(i, versions[i])
            if found is None:
                continue
            at_rest = warp.compose(laid[i].displacement, back)
            off = _sure(found.points - warp.move_points(at_rest, points.points), points, found)
            start = unfolded(at_rest + held(points.points + off))
            picture, inverse = self._picture(i, versions[i])
            beyond = find(warp.sample(picture, start), None).displacement
            field = warp.compose(start, shortened(beyond, MOST_BEYOND_START * width))
            field = unfolded(at_rest + region * (field - at_rest))
            displacement = warp.compose(field, there)
            texture = warp.sample(np.array(versions[i].morph.texture), warp.compose(inverse, displacement))
            out[i] = Laid(texture, displacement)
        return out

    def home(self, versions: Sequence[Version]) -> int:
        """Return the place of the version to which the others are matched."""
        return next(i for i, version in enumerate(versions) if version.is_own)

    def landmarks(self, i: int, version: Version) -> Landmarks | None:
        """Return the landmarks that hold the mouth of a version; None where its model does not know its landmarks.

        Points without a regression go where the warp takes them.
        """
        mesh, learned = landmarks_of(self.models[i]), self.models[i].landmarks
        if mesh is None or learned is None:
            return None
        points, error_px = warp.move_points(version.morph.displacement, mesh), np.zeros(POINT_COUNT)
        points[list(LANDMARKS)], error_px[list(LANDMARKS)] = learned.at(version.loadings), learned.error_px
        held = list(self.holding)
        return Landmarks(warp.apply_affine(self.places[i], points[held]), error_px[held])

    def region(self, points: Landmarks, height: int, width: int) -> Mask:
        """Return the soft region (h, w) that is matched in each expression: the lips and what lies between them."""
        return lips_region(points.points[[self.holding.index(place) for place in LIPS]], height, width)

    def _picture(self, i: int, version: Version) -> tuple[Image, Displacement]:
        """Draw a version's aligned picture (h, w, 3), and return the origin of each of its pixels as (h, w, 2) px."""
        inverse = warp.invert(placed(version.morph.displacement, self.places[i]))
        return warp.sample(np.array(version.morph.texture), inverse), inverse


def holds_a_mouth(model: MorphModel) -> bool:
    """Return whether a model knows its mesh points and its landmarks, which hold a mouth."""
    return landmarks_of(model) is not None and model.landmarks is not None


def _sure(off: Points, one: Landmarks, other: Landmarks) -> Points:
    """Return how far points (m, 2) px certainly differ: the regressions' own errors are taken off."""
    square = (off**2).sum(axis=1)
    doubt = DOUBT**2 * (one.error_px**2 + other.error_px**2)
    return off * (square / np.maximum(square + doubt, np.finfo(float).tiny))[:, None]
