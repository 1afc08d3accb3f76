"""Blend the versions of an expression into one face on one grid, with its surround (Nagle section 4, step 8).

Identity and expression are mixed apart (ours). The identity is the weighted mean of all mean faces. The expression is
the weighted mean of what each version adds to its own mean face; implausible versions add less or nothing. If all
versions are plausible, this is the weighted mean of the versions. So the face stays the same person when one identity
cannot follow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morphspace.arrays import Affine, AnyArray, Image, Mask
from morphspace.avatar.bands import Shown, banded, changed, detail_of, strength
from morphspace.avatar.common_grid import CommonFace, Laid, check_finite, version_picture
from morphspace.avatar.sharpness import WELL_INSIDE
from morphspace.avatar.versions import Version, believed
from morphspace.face.regions import widened
from morphspace.flow.folds import unfolded
from morphspace.grid import warp

GREY = 0.5  # of a flat surround
LEAST_SKIN = 1e-3  # share that hair keeps: where all have hair, all count alike

Match = Callable[[Sequence[Version], Mapping[int, Laid]], Mapping[int, Laid]]


@dataclass(frozen=True, eq=False)
class Mixer:
    """Blends versions on one faceframe.

    Attributes
    ----------
    common : CommonFace
        The grid.
    weights : array (n,), sum 1
    places : sequence of affines (2, 3)
        From the pictures of each identity to the aligned picture.
    surround : int or None
        The identity whose hair, neck and background stay; None for flat grey.
    match : callable
        Matches the versions of one expression on the grid.
    """

    common: CommonFace
    weights: AnyArray
    places: Sequence[Affine]
    surround: int | None
    match: Match | None = None

    @cached_property
    def rest(self) -> tuple[Laid, ...]:
        """The mean face of each identity on the grid."""
        models = self.common.models
        return tuple(self.common.laid(i, models[i].mean, place) for i, place in enumerate(self.places))

    @cached_property
    def mean(self) -> Laid:
        """The weighted mean of the mean faces: the avatar's identity."""
        mean = _sum(self.weights, self.rest)
        return Laid(self._without_hair(), mean.displacement)

    def _without_hair(self) -> Image:
        """Return the weighted mean texture, with hair over the forehead left out where another identity shows skin."""
        total = np.zeros_like(self.rest[0].texture)
        weight = np.zeros((*self.common.mask.shape, 1), np.float32)
        for share, skin, one in zip(self.weights, self.common.skin, self.rest, strict=True):
            counts = np.float32(share) * (skin + np.float32(LEAST_SKIN))[..., None]
            total += counts * one.texture
            weight += counts
        total /= weight
        return total

    @cached_property
    def near(self) -> Mask:
        """The region (h, w) around the face that still moves with it."""
        return widened(self.common.mask)

    @cached_property
    def mask_picture(self) -> Mask:
        """The mask (h, w) in the aligned picture of the mean face."""
        return np.clip(warp.render(self.common.mask[..., None], self.mean.displacement)[..., 0], 0, 1)

    @cached_property
    def judged_picture(self) -> Mask:
        """The part (h, w) of that picture in which sharpness is compared: skin of all identities."""
        skin = np.min([self.common.mask, *self.common.skin], axis=0)
        return np.clip(warp.render(skin[..., None], self.mean.displacement)[..., 0], 0, 1)

    def used(self, versions: Sequence[Version]) -> AnyArray:
        """Return the weights (n,), sum 1, of the versions' motion and colour."""
        weights = self.weights * np.array([believed(version) for version in versions])
        out: AnyArray = weights / weights.sum()  # the source's own counts in full, so the sum is above 0
        return out

    def mixed(self, versions: Sequence[Version]) -> Image:
        """Blend the versions of an expression, one an identity, into a picture (h, w, 3)."""
        blend = self.blended(versions)
        return warp.render(blend.texture, blend.displacement)

    def blended(self, versions: Sequence[Version]) -> Laid:
        """Blend the versions into a morph on the common grid, with its surround and without folds."""
        used = self.used(versions)
        laid = {
            i: self.common.laid(i, version.morph, self.places[i])
            for i, version in enumerate(versions)
            if used[i] > 0 or i == self.surround
        }
        matched = laid if self.match is None else self.match(versions, laid)
        offsets = {
            i: Laid(one.texture - self.rest[i].texture, one.displacement - self.rest[i].displacement)
            for i, one in matched.items()
        }
        added = _sum([used[i] for i in offsets], list(offsets.values()))
        outside = self._outside(versions, laid, added)
        inside = self.common.mask[..., None]
        texture = self._face(versions, offsets, added.texture)
        displacement = self.mean.displacement + added.displacement
        texture = outside.texture + inside * (texture - outside.texture)
        displacement = outside.displacement + inside * (displacement - outside.displacement)
        return Laid(texture, unfolded(displacement))

    def _face(self, versions: Sequence[Version], offsets: dict[int, Laid], added: Image) -> Image:
        """Mix the textures by bands; an implausible version takes what the others add, where that is little."""
        another = changed(added)
        shown = []
        for i, (version, rest, skin) in enumerate(zip(versions, self.rest, self.common.skin, strict=True)):
            sure = np.float32(believed(version))
            own = offsets[i].texture - added if sure > 0 else np.float32(0)
            share = (skin + np.float32(LEAST_SKIN)) * (1 - (1 - sure) * another)
            shown.append(Shown(rest.texture + added + sure * own, share, float(self.weights[i])))
        return banded(self.mean.texture + added, shown, self.usual)

    @cached_property
    def usual(self) -> tuple[float, ...]:
        """The usual strength of each identity's finest detail, in its mean face."""
        inside = self.common.mask > WELL_INSIDE
        return tuple(
            float(strength(detail_of(one.texture))[inside].mean()) if inside.any() else 1.0
            for one in self.rest
        )

    def picture(self, identity: int, version: Version) -> Image:
        """Draw one version (h, w, 3) in the alignment of the blend."""
        check_finite(self.common.models[identity], version.morph)
        return version_picture(version.morph, self.places[identity])

    def _outside(self, versions: Sequence[Version], laid: dict[int, Laid], added: Laid) -> Laid:
        """Return the surround: that of its owner's version, as far as the version is plausible.

        The rest stays neutral, and follows the motion of the blend next to the mask only, so that a jaw does not
        tear.
        """
        near = self.near[..., None]
        if self.surround is None:
            grey = np.full_like(self.mean.texture, GREY)
            return Laid(grey, self.mean.displacement + near * added.displacement)
        own, rest = laid[self.surround], self.rest[self.surround]
        share = believed(versions[self.surround])
        texture = rest.texture + share * (own.texture - rest.texture)
        moved = share * (own.displacement - rest.displacement) + (1 - share) * near * added.displacement
        return Laid(texture, rest.displacement + moved)


def _sum(weights: Sequence[float] | AnyArray, laid: Sequence[Laid]) -> Laid:
    """Return the weighted sum of morphs, in the order given, in float32."""
    texture, displacement = np.zeros_like(laid[0].texture), np.zeros_like(laid[0].displacement)
    for weight, one in zip(weights, laid, strict=True):
        texture += np.float32(weight) * one.texture
        displacement += np.float32(weight) * one.displacement
    return Laid(texture, displacement)
