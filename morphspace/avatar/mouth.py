"""A correspondence for each expression: flow between the people's versions of it (Nagle section 4, step 8).

Mean faces correspond at rest (`common_face`), and the warps carry that along. At the mouth it does not last: one model
shows an opening by its warp and another in colour, and teeth that nobody shows at rest correspond to nothing. So there
flow is asked once more, between the pictures of the versions. It starts where the correspondence at rest leads, moved
by a spline so that the landmarks of the versions meet, and may leave that by a share of the width only. Landmarks
follow from each model's own regression. Everything is matched to the version of the person whose expression it is: the
reference identity's, as published, is torn where that person cannot show it. (Ours.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points
from morphspace.avatar.common_grid import Laid, placed, shortened
from morphspace.avatar.versions import Version, believed
from morphspace.avatar.visible import disc, filled
from morphspace.face.anchor import CHEEKS_AND_CHIN, spline_from
from morphspace.face.mesh import LANDMARKS, LIPS, PHILTRUM, POINT_COUNT, RIGID_POINTS
from morphspace.flow import methods
from morphspace.flow.folds import unfolded
from morphspace.grid import warp
from morphspace.model.keypoints import landmarks_of
from morphspace.model.model import MorphModel

AROUND_LIPS = 0.03  # of the width: how far around the lips an expression has its own correspondence
SOFT = 0.015  # of the width, sd of the edge of that
DOUBT = 2.5  # how much more a regression errs on an expression carried over than on those it was learned from
MOST_BEYOND_START = 0.04  # of the width: how far the flow may leave where it starts
HOLDING = tuple(sorted({*LIPS, PHILTRUM, *RIGID_POINTS, *CHEEKS_AND_CHIN}))
"""Places in the mesh of what holds the mouth: its lips, and what stands around them."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Landmarks of a version: `points` (m, 2) px in its aligned picture, and by how much they err, `error_px` (m,).

    A point that the warp carries, and no regression, counts as without error.
    """

    points: Points
    error_px: AnyArray


@dataclass(frozen=True, eq=False)
class Matcher:
    """Matches the versions of an expression to the one of the person whose expression it is.

    `models`, `keys` and `places` (2, 3) of the identities, the last from their pictures to the aligned picture | `flow`
    between the pictures.
    """

    models: Sequence[MorphModel]
    keys: Sequence[str]
    places: Sequence[Affine]
    flow: str
    holding: ClassVar[tuple[int, ...]] = HOLDING

    def matched(self, versions: Sequence[Version], laid: Mapping[int, Laid]) -> dict[int, Laid]:
        """Give the versions `laid` on the common grid by the correspondence at rest, matched at the mouth.

        Those whose landmarks are not known, and what cannot be believed, stay as they are.
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
        """Give the place of the version to which the others are matched."""
        return next(i for i, version in enumerate(versions) if version.is_own)

    def landmarks(self, i: int, version: Version) -> Landmarks | None:
        """Give what holds the mouth of a version; None where its model does not know its landmarks.

        Points that are not regressed go where the warp takes them.
        """
        mesh, learned = landmarks_of(self.models[i]), self.models[i].landmarks
        if mesh is None or learned is None:
            return None
        points, error_px = warp.move_points(version.morph.displacement, mesh), np.zeros(POINT_COUNT)
        points[list(LANDMARKS)], error_px[list(LANDMARKS)] = learned.at(version.loadings), learned.error_px
        held = list(self.holding)
        return Landmarks(warp.apply_affine(self.places[i], points[held]), error_px[held])

    def region(self, points: Landmarks, height: int, width: int) -> Mask:
        """Give where an expression has a correspondence of its own, (h, w), soft: the lips and what is between them."""
        lips = points.points[[self.holding.index(place) for place in LIPS]].astype(np.float32)
        mouth = filled(cv2.convexHull(lips)[:, 0], height, width)
        wider = cv2.dilate(mouth, disc(AROUND_LIPS * width))
        return cv2.GaussianBlur(wider, (0, 0), SOFT * width, borderType=cv2.BORDER_REPLICATE)

    def _picture(self, i: int, version: Version) -> tuple[Image, Displacement]:
        """Give a version's aligned picture (h, w, 3), and where each of its pixels comes from (h, w, 2) px."""
        inverse = warp.invert(placed(version.morph.displacement, self.places[i]))
        return warp.sample(np.array(version.morph.texture), inverse), inverse


def holds_a_mouth(model: MorphModel) -> bool:
    """Tell whether a model knows what holds a mouth: the mesh points of its mean face, and its landmarks."""
    return landmarks_of(model) is not None and model.landmarks is not None


def _sure(off: Points, one: Landmarks, other: Landmarks) -> Points:
    """Give how far points (m, 2) px are surely off: little of what the regressions err by themselves."""
    square = (off**2).sum(axis=1)
    doubt = DOUBT**2 * (one.error_px**2 + other.error_px**2)
    return off * (square / np.maximum(square + doubt, np.finfo(float).tiny))[:, None]
