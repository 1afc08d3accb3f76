"""What counts as rest when two models talk to each other (ours; Nagle section 3 asks for like means).

A face is carried over as its difference from the source's mean. Where one mean smiles and the other does not, the
target smiles whenever the source rests. So the means are compared by their lips, which identity changes less than brows
and lids, and where they are far apart the source's faces are counted from that of its frames which looks most like the
target's mean. Or a person names a neutral frame of each.
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

# Of the eye distance. Five people's means with lips half open: .03 to .05; against the mean of a smile: .07 to .11.
FAR_APART = 0.06
WORTHWHILE = 0.85  # a frame must come at least so much nearer than the mean
AUTOMATIC, MEAN = "auto", "mean"  # values of --neutral that are no frame


@dataclass(frozen=True, eq=False)
class Recentring:
    """What counts as rest: `source` (k_A,) loadings are taken off every face of the source, `target` (k_B,) loadings
    are added to every face of the target.

    `source_frame`, `target_frame` name the training frames they come from, None for the mean. `apart_before` and
    `apart_after` tell how far apart the lips of the resting faces are, as a share of the target's eye distance: of the
    means, and of what replaces them; None where they are not known.
    """

    source: LoadingVector
    target: LoadingVector
    source_frame: str | None
    target_frame: str | None
    apart_before: float | None
    apart_after: float | None


def means_apart(source: MorphModel, target: MorphModel) -> float | None:
    """Give how far the lips of the source's mean face lie from the target's, after the affine, in eye distances.

    Root mean square over the mesh points of the lips. None where one of them has no mesh points (`keypoints --auto`).
    Raises `BadInput` where the models cannot be linked.
    """
    return _apart(source, target, np.zeros(source.rank), np.zeros(target.rank))


def automatic_recentring(source: MorphModel, target: MorphModel) -> Recentring | None:
    """Count the source's faces from its frame nearest to the target's mean, where the means are `FAR_APART`.

    None where they are near enough, where that is not known, and where no frame comes much nearer.
    """
    before = means_apart(source, target)
    if before is None or before <= FAR_APART:
        return None
    rest = np.zeros(target.rank)
    distances = _lips_apart(source, target, source.training.values, rest)
    if distances is None:
        return None
    best = int(distances.argmin())
    if not distances[best] < WORTHWHILE * before:
        return None
    return Recentring(
        np.array(source.training.values[best], np.float64),
        rest,
        source.training.frame_names[best],
        None,
        before,
        float(distances[best]),
    )


def recentring_on(
    source: MorphModel, target: MorphModel, source_frame: str | None, target_frame: str | None = None
) -> Recentring:
    """Count the source's faces from one of its training frames, and lay them on one of the target's.

    Names are those of the training frames, with or without suffix; None stands for the mean. Raises `BadInput` for a
    name that is none, or more than one, of them.
    """
    from_source, source_name = _frame(source, source_frame)
    from_target, target_name = _frame(target, target_frame)
    return Recentring(
        from_source,
        from_target,
        source_name,
        target_name,
        means_apart(source, target),
        _apart(source, target, from_source, from_target),
    )


@dataclass(frozen=True, eq=False)
class Rest:
    """What counts as rest, and how it came to be: `asked` as --neutral was given; `origin` None for the two means.

    `apart` is how far the landmarks of the two means lie from each other after the affine, in eye distances of the
    target; None where that is not known.
    """

    asked: str
    origin: Recentring | None
    apart: float | None

    @property
    def settings(self) -> dict[str, Any]:
        """For records and finished frames."""
        here = self.origin
        return {
            "asked": self.asked,
            "source_frame": None if here is None else here.source_frame,
            "target_frame": None if here is None else here.target_frame,
            "means_apart": self.apart,
            "apart": self.apart if here is None else here.apart_after,
        }

    def notes(self, source: MorphModel, target: MorphModel) -> tuple[str, ...]:
        """Say in one line what was moved and why, or that the means lie apart and nothing was; else nothing."""
        here = self.origin
        if here is None:
            return self._apart_notes(source, target)
        moved = [
            f"the {role} is re-centred on frame {frame} of {model.identity}"
            for role, model, frame in (
                ("source", source, here.source_frame),
                ("target", target, here.target_frame),
            )
            if frame is not None
        ]
        if not moved:
            return ()
        why = "" if self.apart is None else f": the means differ by {self.apart:.1%} of the eye distance"
        left = "" if here.apart_after is None else f", these faces by {here.apart_after:.1%}"
        choose = "; --neutral chooses other frames" if self.asked == AUTOMATIC else ""
        return (f"{' and '.join(moved)}{why}{left}{choose}",)

    def _apart_notes(self, source: MorphModel, target: MorphModel) -> tuple[str, ...]:
        if self.apart is None or self.apart <= FAR_APART:
            return ()
        why = f", and no frame of {source.identity} comes much nearer" if self.asked == AUTOMATIC else ""
        return (
            f"the lips of the two mean faces lie {self.apart:.1%} of the eye distance apart{why}: what is neutral for "
            f"{source.identity} is not for {target.identity}, and every face is off by the difference. Name a resting "
            "frame of each with --neutral A_FRAME,B_FRAME, or build both models from frames of like expressions",
        )


def rest_of(source: MorphModel, target: MorphModel, asked: str) -> Rest:
    """Give what counts as rest: `auto`, `mean`, or A_FRAME[,B_FRAME], each the name of a training frame or `mean`.

    A frame alone is the source's; the target rests on its mean. Raises `BadInput` for a name that is no training frame.
    """
    apart = means_apart(source, target)
    if asked == AUTOMATIC:
        return Rest(asked, automatic_recentring(source, target), apart)
    names = neutral_names(asked)
    if names == (None, None):
        return Rest(asked, None, apart)
    return Rest(asked, recentring_on(source, target, *names), apart)


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
