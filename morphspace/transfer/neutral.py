"""The neutral face of each of two models in a mimicry (ours; Nagle section 3 asks for means of like expressions).

A face is carried over as its difference from the source's mean. Where one mean smiles and the other does not, the
target smiles whenever the source is neutral. So the means are compared by their lips, which identity changes less than
brows and lids. Where they are far apart, the training frame of the source that looks most like the target's mean takes
the place of the source's mean. Or a person names a neutral frame of each.
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

# Of the eye distance. Five people's means with lips half open: .03 to .05; against the mean of a smile: .07 to .11.
FAR_APART = 0.06
WORTHWHILE = 0.85  # a frame must come at least so much nearer than the mean
AUTOMATIC, MEAN = "auto", "mean"  # values of --neutral that are no frame


@dataclass(frozen=True, eq=False)
class Neutral:
    """The faces of source and target that count as neutral.

    Mimicry carries over how far a face of the source is from the source's neutral face, and adds it to the target's.

    Parameters
    ----------
    asked : str
        What was asked for: `auto`, `mean`, or names of training frames.
    source, target : (k_A,), (k_B,)
        Loadings of the neutral faces; zeros are the means.
    source_frame, target_frame : str, optional
        The training frames they come from; None for the mean.
    means_apart, apart : float, optional
        Distance of the lips of the two mean faces, and of the two neutral faces, after the affine, in eye distances of
        the target. None where the points of the lips are not known.
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
        """Give the neutral faces of source and target relative to their means; None for a mean.

        Raises `BadInput` where the loadings are those of other models.
        """
        for model, loadings in ((source, self.source), (target, self.target)):
            if loadings.shape != (model.rank,):
                raise BadInput(
                    f"the neutral face of {model.identity} has {len(loadings)} loadings, its model has {model.rank} "
                    "components: make it from the same models"
                )
        return (
            source.offset(self.source) if self.source.any() else None,
            target.offset(self.target) if self.target.any() else None,
        )

    @property
    def settings(self) -> dict[str, Any]:
        """What records and finished frames say of it."""
        return {
            "asked": self.asked,
            "source_frame": self.source_frame,
            "target_frame": self.target_frame,
            "means_apart": self.means_apart,
            "apart": self.apart,
        }

    def notes(self, source: MorphModel, target: MorphModel) -> tuple[str, ...]:
        """Say in one line which frames are neutral and why, or that the means are far apart and still are neutral."""
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
        left = "" if self.apart is None else f", these faces by {self.apart:.1%}"
        choose = "; --neutral chooses other frames" if self.asked == AUTOMATIC else ""
        return (f"{' and '.join(moved)}{why}{left}{choose}",)

    def _apart_notes(self, source: MorphModel, target: MorphModel) -> tuple[str, ...]:
        if self.means_apart is None or self.means_apart <= FAR_APART:
            return ()
        why = f", and no frame of {source.identity} comes much nearer" if self.asked == AUTOMATIC else ""
        return (
            f"the lips of the two mean faces lie {self.means_apart:.1%} of the eye distance apart{why}: what is "
            f"neutral for {source.identity} is not for {target.identity}, and every face is off by the difference. "
            "Name a neutral frame of each with --neutral A_FRAME,B_FRAME, or build both models from frames of like "
            "expressions",
        )


def neutral_of(source: MorphModel, target: MorphModel, asked: str = AUTOMATIC) -> Neutral:
    """Give the neutral faces of two models.

    Parameters
    ----------
    source, target : MorphModel
    asked : str
        `mean`: the means. A_FRAME or A_FRAME,B_FRAME: training frames by name, with or without suffix, or `mean`; the
        target's is the mean where it is not named. `auto`: the means, unless their lips lie further apart than
        `FAR_APART` and a training frame of the source comes much nearer to the target's mean; then that frame.

    Raises
    ------
    BadInput
        For a name that is none, or more than one, of the training frames, and where the models cannot be linked.
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
    """Give the means, or the source's frame nearest to the target's mean where they are far apart."""
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
    """Give how far the lips of the source's mean face lie from the target's, after the affine, in eye distances.

    Root mean square over the mesh points of the lips. None where one of them has no mesh points (`keypoints --auto`).
    Raises `BadInput` where the models cannot be linked.
    """
    return _apart(source, target, np.zeros(source.rank), np.zeros(target.rank))


def neutral_names(asked: str) -> tuple[str | None, str | None]:
    """Read A_FRAME[,B_FRAME]; None stands for the mean. Raises `BadInput` for anything else."""
    words = [word.strip() for word in asked.split(",")]
    if len(words) > 2 or not all(words) or (AUTOMATIC in words and len(words) > 1):
        raise BadInput(
            f"--neutral {asked!r} cannot be read: give auto, mean, or A_FRAME or A_FRAME,B_FRAME, names of frames the "
            "models were built from"
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
            f"the model of {model.identity} has no training frame {name!r}: its frames are {names[0]} to {names[-1]}"
        )
    if len(places) > 1:
        raise BadInput(
            f"{len(places)} training frames of {model.identity} are called {name!r}: give the suffix too"
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
    """Give how far the lips of faces (n, k_A) of the source lie from those of one of the target (k_B,): (n,).

    Root mean square over the lips after the affine, in the target's eye distances.
    """
    affine = affine_between_models(source, target)
    here, there = _lips(source, from_source), _lips(target, from_target[None])
    if here is None or there is None:
        return None
    right, left, _ = required_faceframe(target).points
    carried = here @ affine[:, :2].T + affine[:, 2]
    return np.sqrt(((carried - there) ** 2).sum(axis=-1).mean(axis=-1)) / np.hypot(*(left - right))


def _lips(model: MorphModel, loadings: LoadingTable) -> AnyArray | None:
    """Give the mesh points of the lips in faces (n, k) of the model, (n, 40, 2) px: the mean's, moved by the warp."""
    points = landmarks_of(model)
    if points is None:
        return None
    lips = points[list(LIPS)]
    if not loadings.any():
        return np.broadcast_to(lips, (len(loadings), *lips.shape))
    return lips + np.tensordot(loadings, moved_by_components(model, lips), 1)
