"""The settings of a blend, and one blended expression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.avatar.source_frames import Clip, opened_clips
from morphspace.errors import BadInput, SizeMismatch
from morphspace.face.detector import Detector, detector_for
from morphspace.model.keypoints import lip_of, required_faceframe
from morphspace.model.model import MorphModel
from morphspace.outcome import versions
from morphspace.requests import check_no_options, clip_options, settings_in
from morphspace.transfer.mimicry import METHODS, Method

AUTO = "auto"
MEAN, SOURCE = "mean", "source"
FLAT = "flat"
EXPRESSION, REST = "expression", "rest"
NO_FINDER = (
    "blended without face detection: the keypoints are the sources', and no landmarks were learned; run `morphspace "
    "models fetch` once to enable it, or give --landmarks none to hide this note"
)
MOST_SHARPEN = 3.0  # with more, edges ring


@dataclass(frozen=True, eq=False)
class AvatarSettings:
    """How to blend.

    Attributes
    ----------
    weights : sequence of k float, or None
        One a model; None for equal weights.
    faceframe : str
        The faceframe of every version: "mean", the weighted mean of all; "source", that of the identity whose
        expression it is; or the name of an identity.
    reference : str or None
        The identity whose mean face is the common grid; None for the one nearest to the others.
    expressions : int or None
        The most expressions of each identity; None for all.
    method : str
        A method of mimicry, or "auto".
    max_sd : float
        The bound of each loading, SD of its component.
    sharpen : float or None
        The amount of the unsharp mask; None for the sharpness of the sources.
    surround : str or None
        The identity whose hair, neck and background stay; "flat" for grey; None for the reference identity.
    correspondence : str
        "rest": of the neutral mean faces only; "expression": at the mouth also in each expression.
    flow : str
        The flow between people, and of the final build.
    components : int
        The most components of the result.
    detector : Detector or None
        Finds faces in the blended pictures for the final build.
    clips : sequence of Clip, or None
        The clips that the models were built from, whose frames replace the models' reconstructions.
    provenance : mapping
        Joined to the provenance of the result.
    """

    weights: Sequence[float] | None
    faceframe: str
    reference: str | None
    expressions: int | None
    method: str
    max_sd: float
    sharpen: float | None
    surround: str | None
    correspondence: str
    flow: str
    components: int
    detector: Detector | None = None
    clips: Sequence[Clip] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Expression:
    """One blended expression.

    Attributes
    ----------
    source : int
        The identity whose expression it is.
    frame : str
        Its training frame.
    name : str
        The training frame's name in the avatar's model.
    weights : array (k,), sum 1
        Of each version's motion and colour; 0 for an implausible version, whose identity enters with its mean face.
    plausibility : array (k,), 0 to 1
        1 for the source's own version, 0 for an identity without a part.
    """

    source: int
    frame: str
    name: str
    weights: AnyArray
    plausibility: AnyArray


def check_models(models: Sequence[MorphModel]) -> None:
    """Raise `BadInput` if the models are fewer than two, differ in size, or lack keypoints or components."""
    if len(models) < 2:
        raise BadInput(
            f"the number of models is {len(models)}; expected at least 2 to blend. Give more models"
        )
    first = models[0]
    for model in models:
        required_faceframe(model)
        if model.rank < 1 or len(model.training.values) == 0:
            raise BadInput(
                f"the model of {model.identity} has {model.rank} components and {len(model.training.values)} training "
                "frames; expected at least 1 of each. Build it from more frames"
            )
        if not _finite(model):
            raise BadInput(
                f"the model of {model.identity} has numbers that are not finite in its {model.rank} components or its "
                "mean face; expected finite numbers. Build it again"
            )
        if model.size != first.size:
            raise SizeMismatch(
                f"{first.identity} has frames of {first.size[0]}x{first.size[1]}, {model.identity} of "
                f"{model.size[0]}x{model.size[1]}; expected one size. Build them with one --size"
            )
        if lip_of(model) != lip_of(first):
            raise BadInput(
                f"the third keypoint of {first.identity} marks the {lip_of(first)}, that of {model.identity} the "
                f"{lip_of(model)}; expected the same point. Set both with `morphspace keypoints`"
            )


def _finite(model: MorphModel) -> bool:
    parts = (
        model.mean.texture,
        model.mean.displacement,
        model.mask,
        model.training.values,
        model.basis.variances,
    )
    rows = model.basis.components  # one at a time: they are large
    return all(bool(np.isfinite(part).all()) for part in (*parts, *rows))


def shares_of(asked: Sequence[float] | None, count: int) -> AnyArray:
    """Return the weights (count,), sum 1; equal for None. Raises `BadInput` for weights that cannot be used."""
    weights = np.ones(count) if asked is None else np.array(asked, np.float64)
    if weights.shape != (count,):
        raise BadInput(
            f"{weights.size} weights do not fit {count} models; expected {count}, in their order. Change them"
        )
    if not np.isfinite(weights).all() or (weights < 0).any():
        raise BadInput(
            f"the weights are {_listed(weights)}; expected finite numbers of at least 0. Correct them"
        )
    with np.errstate(over="ignore"):
        total = float(weights.sum())
    if not np.isfinite(total):
        raise BadInput(
            f"the weights {_listed(weights)} sum to more than a number can hold. Give smaller ones"
        )
    if total <= 0:
        raise BadInput(f"the weights {_listed(weights)} sum to 0; expected more. Give one a weight above 0")
    shares: AnyArray = weights / total
    return shares


def _listed(weights: AnyArray) -> str:
    return ",".join(f"{weight:g}" for weight in weights)


def identity_at(name: str, labels: Sequence[str], role: str, others: Sequence[str] = ()) -> int:
    """Return the place of an identity by its label. Raises `BadInput`, naming the labels and `others` that exist."""
    if name not in labels:
        raise BadInput(f"{role} is {name!r}; expected one of {', '.join((*others, *labels))}. Choose one")
    return list(labels).index(name)


def method_of(asked: str, models: Sequence[MorphModel]) -> Method:
    """Return the method of mimicry; for "auto", guided where all models know their landmarks, else transfer."""
    for method in METHODS:
        if method == asked:
            return method
    return "guided" if all(model.landmarks is not None for model in models) else "transfer"


def blend_settings(request: Any, models: Sequence[MorphModel]) -> tuple[AvatarSettings, tuple[str, ...]]:
    """Open the detector and the clips of a request of `blend-avatar`; return its settings, and notes."""
    detector, missing = detector_for(request.landmarks)
    options = clip_options(request)
    if request.clips is None:
        check_no_options(options, "no clips are given (--clips)")
    settings = settings_in(
        request,
        AvatarSettings,
        detector=detector,
        clips=None if request.clips is None else opened_clips(request.clips, models, options),
        provenance={"identity": request.identity, "versions": versions()},
    )
    return settings, (NO_FINDER,) if missing else ()
