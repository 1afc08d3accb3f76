"""Faces on a straight line between two: where they stand on it, and how far each is from the next.

The line is straight in the model's space: shape and colour go over into each other at one pace, each point of the
face along its own way (Nagle section 2). Equal steps in loadings are then equal steps of the warp too, but not for the
eye, for which no difference of pictures grows evenly. So positions may be spaced until the pictures differ by equal
amounts (ours).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal, TypeAlias, get_args

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, LoadingTable, LoadingVector
from morphspace.errors import BadInput
from morphspace.grid import warp
from morphspace.model.model import MorphModel
from morphspace.stimuli.stepping import Equalised, as_shown, difference, equalised

Spacing: TypeAlias = Literal["loadings", "warp", "ciede2000", "ssim"]
"""In what the steps are equal: loadings (the linear morph), rms displacement px, mean CIEDE2000, or 1 - SSIM."""
SPACINGS: tuple[Spacing, ...] = get_args(Spacing)
# How a step's size grows with its length, while both are small: 1 - SSIM is a square.
POWERS: Mapping[str, float] = {"ciede2000": 1.0, "ssim": 2.0}
MOST_STEPS = 10_000
FURTHEST = 10.0  # times the line's length beyond its ends; further out there are no faces


@dataclass(frozen=True, eq=False)
class Line:
    """The faces between two of a model: `first` at position 0, `last` at 1, loadings (k,) each.

    Raises `BadInput` where the two are the same face.
    """

    model: MorphModel
    first: LoadingVector
    last: LoadingVector

    def __post_init__(self) -> None:
        if self.first.shape != self.last.shape:
            raise BadInput(
                f"the ends have {len(self.first)} and {len(self.last)} loadings: encode both with the same model"
            )
        if np.array_equal(self.first, self.last):
            raise BadInput(
                "the two ends are the same face, and nothing lies between them: give two that differ"
            )

    def loadings(self, positions: AnyArray) -> LoadingTable:
        """Give the loadings (n, k) at positions (n,); those of the ends to the bit."""
        share = np.asarray(positions, np.float64)[:, None]
        return np.asarray((1 - share) * self.first + share * self.last)

    @cached_property
    def _ends(self) -> tuple[tuple[Image, Displacement], tuple[Image, Displacement]]:
        first, last = (self.model.expand(loadings) for loadings in (self.first, self.last))
        return (first.texture, first.displacement), (last.texture, last.displacement)

    def texture(self, position: float) -> Image:
        """Give the texture (h, w, 3) on the mean face at a position."""
        return _mixed(self._ends[0][0], self._ends[1][0], position)

    def displacement(self, position: float) -> Displacement:
        """Give the displacement (h, w, 2) px of the mean face at a position."""
        return _mixed(self._ends[0][1], self._ends[1][1], position)

    def picture(self, position: float) -> Image:
        """Give the picture (h, w, 3) at a position, in the codes a file holds."""
        return as_shown(warp.render(self.texture(position), self.displacement(position)))

    @cached_property
    def _end_pictures(self) -> tuple[Image, Image]:
        return self.picture(0.0), self.picture(1.0)

    def crossfade(self, position: float) -> Image:
        """Give what fading one end's picture out and the other's in shows there, (h, w, 3): two faces, no warp."""
        return as_shown(_mixed(*self._end_pictures, position))


def _mixed(first: AnyArray, last: AnyArray, share: float) -> AnyArray:
    out: AnyArray = np.float32(1 - share) * first + np.float32(share) * last
    return out


def even_positions(steps: int) -> AnyArray:
    """Give the positions (steps + 1,) of a linear morph: 0 to 1 in so many equal steps of loadings."""
    if not 1 <= steps <= MOST_STEPS:
        raise BadInput(f"{steps} steps were asked for: ask for 1 to {MOST_STEPS}")
    return np.arange(steps + 1) / steps


def given_positions(positions: Sequence[float]) -> AnyArray:
    """Give positions (n,) that were asked for: 0 is the first end, 1 the last, beyond them the difference goes on.

    Raises `BadInput` for fewer than 2, and unless each is above the one before and none more than 10 times the line's
    length beyond its ends.
    """
    found = np.asarray(positions, np.float64)
    if found.ndim != 1 or len(found) < 2:
        raise BadInput(f"{found.size} positions make no steps: give at least 2, such as 0,0.5,1")
    if not np.isfinite(found).all() or found.min() < -FURTHEST or found.max() > 1 + FURTHEST:
        raise BadInput(
            f"the positions {', '.join(f'{one:g}' for one in found)} are not all numbers from {-FURTHEST:g} to "
            f"{1 + FURTHEST:g}: 0 is the first end, 1 the last"
        )
    if (np.diff(found) <= 0).any():
        place = int(np.argmax(np.diff(found) <= 0))
        raise BadInput(
            f"position {found[place + 1]:g} comes after {found[place]:g}: give them in rising order, each once"
        )
    return found


def spaced_positions(line: Line, steps: int, spacing: Spacing) -> Equalised:
    """Give positions (steps + 1,) from 0 to 1 whose steps are equal in `spacing`, as the files show the faces.

    Loadings and warp are equal when the positions are even, since both are straight along the line.
    """
    even = even_positions(steps)
    if spacing not in POWERS:
        return Equalised(even, np.full(steps, 1.0 / steps))
    shown: dict[float, Image] = {}

    def sizes(positions: AnyArray) -> AnyArray:
        nonlocal shown
        shown = {at: shown[at] if at in shown else line.picture(at) for at in map(float, positions)}
        pictures = list(shown.values())
        pairs = pairwise(pictures)
        return np.array([difference(one, other, line.model.mask, spacing) for one, other in pairs])

    return equalised(sizes, even, POWERS[spacing])
