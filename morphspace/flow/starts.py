"""Which starting field served a flow best: the choice among candidates by photometric error under a fold limit (ours).

A coarse-to-fine search loses a mouth that opens by more than the coarsest level bridges. In a clip the frame before or
after often shows the same movement half done, and its field is a better start. It is not always better (a head that
turns carries the errors along), so each frame is judged by itself: the field from the neighbour is kept only where it
explains the picture clearly better and does not buy that by folding.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from morphspace import warp
from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.errors import BadInput
from morphspace.flow import Flow

StartKind = Literal["auto", "none"]
"""`auto`: hard frames are tried again from a neighbour's field; `none`: coarse to fine alone."""

WITHOUT_START = ("deepflow", "tvl1")  # stock estimators that have no use for a start: nothing to try again
FOLD_LIMIT = (
    0.003  # of the cells inside the mask; what a flow between real expressions may fold (goals, flow.md C)
)
CLEARLY = 0.98  # times the error of the standing field; a smaller gain is noise, and folding could buy it
HARD = 1.25  # times the clip's median error; trying all frames took 3 times the flows for 0.5 % less error


def check_start(start: str) -> None:
    """Raise `BadInput` for a start that is not a `StartKind`."""
    if start not in get_args(StartKind):
        raise BadInput(f"there is no start called {start!r}: choose one of {', '.join(get_args(StartKind))}")


def photometric_error(reference: Image, frame: Image, field: Displacement, mask: Mask) -> float:
    """Give how far the frame (h, w, 3), brought to the reference by the field (h, w, 2), misses it.

    The root mean square over the colours, 0 to 1, inside the mask (h, w) on the reference.
    """
    difference = warp.sample(frame, field) - reference
    square = (difference * difference).mean(axis=2)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1.0)))


def better(reference: Image, frame: Image, candidates: Sequence[Flow], mask: Mask) -> Flow:
    """Give the candidate with the least photometric error under the fold limit; the first is the one that stands.

    Another takes its place only where it folds within `FOLD_LIMIT` inside the mask, or no more than the first where
    that folds more, and its error is below `CLEARLY` times the first's. Where the first folds beyond the limit and the
    other keeps it, an error no larger is enough.
    """
    first = candidates[0]
    standing = photometric_error(reference, frame, first.displacement, mask)
    folds = warp.fold_fraction(first.displacement, mask)
    chosen, least = first, np.inf
    for other in candidates[1:]:
        other_folds = warp.fold_fraction(other.displacement, mask)
        if other_folds > max(FOLD_LIMIT, folds):
            continue
        error = photometric_error(reference, frame, other.displacement, mask)
        mends = other_folds <= FOLD_LIMIT < folds
        if error <= (1.0 if mends else CLEARLY) * standing and error < least:
            chosen, least = other, error
    return chosen


def hard_frames(errors: AnyArray, folds: AnyArray) -> AnyArray:
    """Give the indices of the frames worth another try: errors (n,) far above the median, or folds beyond the limit."""
    return np.flatnonzero((errors > HARD * np.median(errors)) | (folds > FOLD_LIMIT))


def easier_neighbour(errors: AnyArray, index: int) -> int:
    """Give the neighbour in time of frame `index`, of errors (n,) with n >= 2, that has the smaller error."""
    near = [other for other in (index - 1, index + 1) if 0 <= other < len(errors)]
    return min(near, key=lambda other: float(errors[other]))
