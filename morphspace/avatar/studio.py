"""Prepare a blend once: the identities that take part, their grid and their alignment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.avatar.blend import Mixer
from morphspace.avatar.common_grid import CommonFace, common_face, mean_faceframe, places_on, version_picture
from morphspace.avatar.mouth import Matcher
from morphspace.avatar.selection import labels_of, model_key, nearest_to_all, places_in_order, spread_out
from morphspace.avatar.settings import (
    EXPRESSION,
    FLAT,
    MEAN,
    SOURCE,
    AvatarSettings,
    check_models,
    identity_at,
    method_of,
    shares_of,
)
from morphspace.avatar.source_frames import originals_of
from morphspace.avatar.versions import Cast, Show, Version
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.model.keypoints import affine_between, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.steps import single_threads


@dataclass(frozen=True, eq=False)
class Studio:
    """A prepared blend.

    Attributes
    ----------
    models, keys, labels : of the k identities, in the order given
    weights : array (k,), sum 1
    part : sequence of int
        The places of the identities with a weight above 0, in the order of their digests.
    reference, surround : int or None
        Places in `part`; a `surround` of None is flat grey.
    cast : Cast
        The identities that take part, by their place in `part`.
    """

    models: Sequence[MorphModel]
    keys: Sequence[str]
    labels: tuple[str, ...]
    weights: AnyArray
    part: tuple[int, ...]
    reference: int
    surround: int | None
    cast: Cast
    settings: AvatarSettings
    mixers: dict[int, Mixer] = field(default_factory=dict, init=False, repr=False)
    prepared: dict[int, tuple[Show, ...]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def common(self) -> CommonFace:
        """The common grid; the flow between the mean faces is computed here."""
        cast = self.cast
        with single_threads():
            return common_face(cast.models, cast.keys, self.reference, self.settings.flow)

    @cached_property
    def shares(self) -> AnyArray:
        """The weights of the identities that take part, (n,), sum 1."""
        return self.weights[list(self.part)]

    def faceframe(self, source: int) -> FaceFrame:
        """Return the faceframe for the expressions of `source`, a place in `part`."""
        asked, models = self.settings.faceframe, self.cast.models
        if asked == MEAN:
            return mean_faceframe(models, self.shares)
        if asked == SOURCE:
            return required_faceframe(models[source])
        return required_faceframe(
            self.models[identity_at(asked, self.labels, "the faceframe", (MEAN, SOURCE))]
        )

    def mixer(self, source: int) -> Mixer:
        """Return the mixer for the expressions of `source`, a place in `part`."""
        key = source if self.settings.faceframe == SOURCE else 0
        if key not in self.mixers:
            places = places_on(self.cast.models, self.faceframe(source))
            match = None
            if self.settings.correspondence == EXPRESSION:
                match = Matcher(self.cast.models, self.cast.keys, places, self.settings.flow).matched
            self.mixers[key] = Mixer(self.common, self.shares, places, self.surround, match)
        return self.mixers[key]

    def shows(self, source: int) -> tuple[Show, ...]:
        """Prepare how each identity shows the expressions of `source`; only one source is kept."""
        if source not in self.prepared:
            self.prepared.clear()
            with single_threads():
                self.prepared[source] = self.cast.shows_from(source)
        return self.prepared[source]

    def versions(self, source: int, frame: int) -> list[Version]:
        """Compute every identity's version of a training frame of `source`, by place in `part`."""
        return self.cast.versions(source, self.shows(source), frame)

    def pictures(self, source: int, versions: Sequence[Version]) -> list[Image]:
        """Draw every identity (h, w, 3): its version, or its mean face where it has no part."""
        mixer = self.mixer(source)
        place_of = {given: place for place, given in enumerate(self.part)}
        shown = []
        for given, model in enumerate(self.models):
            if given in place_of:
                place = place_of[given]
                shown.append(mixer.picture(place, versions[place]))
            else:
                onto = affine_between(required_faceframe(model), self.faceframe(source))
                shown.append(version_picture(model.mean, onto))
        return shown

    def chosen(self) -> list[tuple[int, int]]:
        """Choose the expressions to blend: (place in `part`, training frame). A repeated model counts once."""
        keys = self.cast.keys
        return [
            (source, frame)
            for source, model in enumerate(self.cast.models)
            if keys[source] not in keys[:source]
            for frame in spread_out(np.asarray(model.training.values), self.settings.expressions)
        ]

    def identity(self) -> list[Any]:
        """What every blended picture depends on, as JSON."""
        cast, settings = self.cast, self.settings
        faceframes = [self.faceframe(source).points.tolist() for source in range(len(cast.models))]
        return [
            list(cast.keys),
            [float(share) for share in self.shares],
            self.reference,
            self.surround,
            settings.faceframe == SOURCE,
            faceframes,
            cast.method,
            cast.max_sd,
            settings.correspondence,
            settings.flow,
            [None if one is None else one.identity for one in cast.originals],
        ]


def studio_of(models: Sequence[MorphModel], settings: AvatarSettings) -> Studio:
    """Check the settings and prepare the blend. Raises `BadInput`."""
    check_models(models)
    weights = shares_of(settings.weights, len(models))
    keys = [model_key(model) for model in models]
    labels = labels_of(models, keys)
    part = tuple(i for i in places_in_order(models, keys) if weights[i] > 0)
    taking = [models[i] for i in part]
    reference = nearest_to_all(taking)
    if settings.reference is not None:
        reference = _place(settings.reference, labels, part, "the reference")
    surround: int | None = reference
    if settings.surround == FLAT:
        surround = None
    elif settings.surround is not None:
        surround = _place(settings.surround, labels, part, "the surround", (FLAT,))
    if settings.faceframe not in (MEAN, SOURCE):
        identity_at(settings.faceframe, labels, "the faceframe", (MEAN, SOURCE))
    originals = originals_of(models, settings.clips)
    method = method_of(settings.method, taking)
    cast = Cast(taking, [keys[i] for i in part], method, settings.max_sd, [originals[i] for i in part])
    return Studio(models, keys, labels, weights, part, reference, surround, cast, settings)


def _place(
    name: str, labels: Sequence[str], part: Sequence[int], role: str, others: Sequence[str] = ()
) -> int:
    """Return the place in `part` of the identity called `name`. Raises `BadInput`."""
    given = identity_at(name, labels, role, others)
    if given not in part:
        raise BadInput(
            f"{role} {name} has the weight 0; expected more. Choose another, or give it a weight above 0"
        )
    return list(part).index(given)
