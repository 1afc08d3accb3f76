"""The neutral faces of source and target (ours; Nagle et al., section 3, require means of like expressions).

Mimicry carries over the difference from the source's mean. If one mean smiles and the other does not, the target
smiles whenever the source is neutral. So the means are compared by their lips, which differ less between people than
brows and lids. If they are far apart, the source's training frame that is nearest to the target's mean replaces the
source's mean. Alternatively, a person names a neutral frame of each model.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, LoadingTable, LoadingVector
from morphspace.errors import BadInput
from morphspace.face.mesh import LIPS
from morphspace.model.keypoints import (
    affine_between_models,
    landmarks_of,
    moved_by_components,
    required_faceframe,
)
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset

# Eye distances. Means of five people with half-open lips differ by .03 to .05; from the mean of a smile by .07 to .11.
FAR_APART = 0.06
WORTHWHILE = 0.85  # times the means' distance; a frame that replaces the mean is below it
AUTOMATIC, MEAN = "auto", "mean"  # values of --neutral that name no frame


@dataclass(frozen=True, eq=False)
class Neutral:
    """The neutral faces of a source and a target.

    Mimicry takes the difference from the source's neutral face and adds it to the target's.

    Attributes
    ----------
    asked : str
        The request: `auto`, `mean`, or names of training frames.
    source, target : array (k_A,), (k_B,)
        Raw loadings of the neutral faces; zeros are the means.
    source_frame, target_frame : str or None
        Their training frames; None for the mean.
    means_apart, apart : float or None
        Distance between the lips of the two means, and of the two neutral faces, after the affine, in eye distances
        of the target. None if a model has no mesh points.
    """

    asked: str
    source: LoadingVector
    target: LoadingVector
    source_frame: str | None = None
    target_frame: str | None = None
    means_apart: float | None = None
    apart: float | None = None

    @property
    def is_means(self) -> bool:
        """Whether both neutral faces are the means."""
        return self.source_frame is None and self.target_frame is None

    def offsets(
        self, source: MorphModel, target: MorphModel
    ) -> tuple[MorphOffset | None, MorphOffset | None]:
        """Compute the offsets of both neutral faces from their means; None for a mean.

        Raises
        ------
        BadInput
            If the loadings belong to other models.
        """
        for model, loadings in ((source, self.source), (target, self.target)):
            if loadings.shape != (model.rank,):
                raise BadInput(
                    f"the neutral face of {model.identity} has {len(loadings)} loadings; expected {model.rank}, its "
                    "model's components. Choose it for the same models"
                )
        return (
            source.offset(self.source) if self.source.any() else None,
            target.offset(self.target) if self.target.any() else None,
        )

    @property
    def settings(self) -> dict[str, Any]:
        """The entries for records and finished frames."""
        return {
            "asked": self.asked,
            "source_frame": self.source_frame,
            "target_frame": self.target_frame,
            "means_apart": self.means_apart,
            "apart": self.apart,
        }

    def notes(self, source: MorphModel, target: MorphModel) -> tuple[str, ...]:
        """Report in one line which frames are neutral and why, or warn that the means are far apart."""
        if self.is_means:
            return self._apart_notes(source, target)
        moved = [
            f"the {role} is re-centred on frame {frame} of {model.identity}"
            for role, model, frame in (
                ("source", source, self.source_frame),
                ("target", target, self.target_frame),
            )
            if frame is not None
        ]
        why = (
            ""
            if self.means_apart is None
            else f": the means differ by {self.means_apart:.1%} of the eye distance"
        )
        after = "" if self.apart is None else f", these faces by {self.apart:.1%}"
        choose = "; --neutral chooses other frames" if self.asked == AUTOMATIC else ""
        return (f"{' and '.join(moved)}{why}{after}{choose}",)

    def _apart_notes(self, source: MorphModel, target: MorphModel) -> tuple[str, ...]:
        if self.means_apart is None or self.means_apart <= FAR_APART:
            return ()
        why = f", and no frame of {source.identity} comes much nearer" if self.asked == AUTOMATIC else ""
        return (
            f"the lips of the two mean faces lie {self.means_apart:.1%} of the eye distance apart{why}; "
            f"expected at most {FAR_APART:.1%}. Every face of {target.identity} will contain the difference. Name a "
            "neutral frame of each with --neutral A_FRAME,B_FRAME, or build both models from frames of like "
            "expressions",
        )


def neutral_of(source: MorphModel, target: MorphModel, asked: str = AUTOMATIC) -> Neutral:
    """Choose the neutral faces of two models.

    Parameters
    ----------
    source, target : MorphModel
    asked : str
        `mean` for the means. A_FRAME or A_FRAME,B_FRAME for training frames by name, with or without suffix, or
        `mean`; the
        target's default is the mean. `auto` for the means, unless their lips are further apart than `FAR_APART` and a
        training frame of the source is nearer to the target's mean by `WORTHWHILE`; then for that frame.

    Returns
    -------
    Neutral

    Raises
    ------
    BadInput
        If a name is not that of exactly one training frame, or the models cannot be linked.

    Examples
    --------
    >>> import morphspace as ms
    >>> neutral_of(ms.load("anna.morph"), ms.load("ben.morph"), "mean").source
    array([0., 0., 0.])
    """
    if asked == AUTOMATIC:
        return _automatic(source, target)
    source_frame, target_frame = neutral_names(asked)
    from_source, source_name = _frame(source, source_frame)
    from_target, target_name = _frame(target, target_frame)
    apart = means_apart(source, target)
    if source_name is not None or target_name is not None:
        after = _apart(source, target, from_source, from_target)
        return Neutral(asked, from_source, from_target, source_name, target_name, apart, after)
    return Neutral(asked, from_source, from_target, means_apart=apart, apart=apart)


def _automatic(source: MorphModel, target: MorphModel) -> Neutral:
    """Choose the means, or the source's frame nearest to the target's mean if the means are far apart."""
    before = means_apart(source, target)
    zeros = np.zeros(target.rank)
    means = Neutral(AUTOMATIC, np.zeros(source.rank), zeros, means_apart=before, apart=before)
    if before is None or before <= FAR_APART:
        return means
    distances = _lips_apart(source, target, source.training.values, zeros)
    if distances is None:
        return means
    best = int(distances.argmin())
    if not distances[best] < WORTHWHILE * before:
        return means
    loadings = np.array(source.training.values[best], np.float64)
    frame = source.training.frame_names[best]
    return Neutral(AUTOMATIC, loadings, zeros, frame, None, before, float(distances[best]))


def means_apart(source: MorphModel, target: MorphModel) -> float | None:
    """Measure the distance between the lips of the two mean faces, after the affine, in eye distances of the target.

    Returns
    -------
    float or None
        Root mean square over the mesh points of the lips; None if a model has no mesh points (`keypoints --auto`).

    Raises
    ------
    BadInput
        If the models cannot be linked.
    """
    return _apart(source, target, np.zeros(source.rank), np.zeros(target.rank))


def neutral_names(asked: str) -> tuple[str | None, str | None]:
    """Parse A_FRAME[,B_FRAME]; None stands for the mean. Raises `BadInput` for anything else.

    Examples
    --------
    >>> neutral_names("calm.png")
    ('calm.png', None)
    """
    words = [word.strip() for word in asked.split(",")]
    if len(words) > 2 or not all(words) or (AUTOMATIC in words and len(words) > 1):
        raise BadInput(
            f"--neutral is {asked!r}; expected auto, mean, A_FRAME or A_FRAME,B_FRAME. Name frames from which the "
            "models were built"
        )
    first, second = (None if word == MEAN else word for word in (*words, MEAN)[:2])
    return first, second


def _frame(model: MorphModel, name: str | None) -> tuple[LoadingVector, str | None]:
    if name is None:
        return np.zeros(model.rank), None
    names = model.training.frame_names
    places = [place for place, known in enumerate(names) if known == name]
    if not places:
        places = [place for place, known in enumerate(names) if PurePath(known).stem == name]
    if not places:
        raise BadInput(
            f"the model of {model.identity} has no training frame {name!r}; expected a name from {names[0]} to "
            f"{names[-1]}. Correct it"
        )
    if len(places) > 1:
        raise BadInput(
            f"{len(places)} training frames of {model.identity} are called {name!r}; expected one. Give the suffix too"
        )
    return np.array(model.training.values[places[0]], np.float64), names[places[0]]


def _apart(
    source: MorphModel, target: MorphModel, from_source: LoadingVector, from_target: LoadingVector
) -> float | None:
    distances = _lips_apart(source, target, from_source[None], from_target)
    return None if distances is None else float(distances[0])


def _lips_apart(
    source: MorphModel, target: MorphModel, from_source: LoadingTable, from_target: LoadingVector
) -> AnyArray | None:
    """Measure the distances (n,) between the lips of n faces (n, k_A) of the source and one face (k_B,) of the target.

    Root mean square over the lips after the affine, in eye distances of the target.
    """
    affine = affine_between_models(source, target)
    here, there = _lips(source, from_source), _lips(target, from_target[None])
    if here is None or there is None:
        return None
    right, left, _ = required_faceframe(target).points
    carried = here @ affine[:, :2].T + affine[:, 2]
    return np.sqrt(((carried - there) ** 2).sum(axis=-1).mean(axis=-1)) / np.hypot(*(left - right))


def _lips(model: MorphModel, loadings: LoadingTable) -> AnyArray | None:
    """Return the mesh points (n, 40, 2) px of the lips in n faces (n, k): the mean's, moved by the warp."""
    points = landmarks_of(model)
    if points is None:
        return None
    lips = points[list(LIPS)]
    if not loadings.any():
        return np.broadcast_to(lips, (len(loadings), *lips.shape))
    return lips + np.tensordot(loadings, moved_by_components(model, lips), 1)
