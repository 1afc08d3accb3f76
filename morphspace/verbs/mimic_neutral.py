"""What counts as rest in a mimicry: the means of the two models, or faces nearer to each other (methods 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from morphspace.errors import BadInput
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset
from morphspace.transfer.mimicry import offset_of
from morphspace.transfer.neutral import (
    FAR_APART,
    Recentring,
    automatic_recentring,
    means_apart,
    recentring_on,
)

AUTOMATIC, MEAN = "auto", "mean"


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

    def offsets(self, source: MorphModel, target: MorphModel) -> tuple[MorphOffset, MorphOffset] | None:
        """Give the resting faces of source and target relative to their means, None for the means themselves."""
        if self.origin is None:
            return None
        return offset_of(source, self.origin.source), offset_of(target, self.origin.target)

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
