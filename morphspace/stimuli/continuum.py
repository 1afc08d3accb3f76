"""Continuum: faces on a straight line between two faces, their positions and the difference between neighbours.

The line is straight in the space of the model: shape and colour change together, and each point of the face moves
along a straight path (Nagle section 2). Equal steps of loadings are equal steps of the warp, but differences between
the images are not equal. Positions can therefore be spaced until the images differ by equal amounts (ours).
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
"""The measure in which steps are equal: loadings (linear morph), rms displacement px, mean CIEDE2000, or 1 - SSIM."""
SPACINGS: tuple[Spacing, ...] = get_args(Spacing)
# The power of its length with which the size of a small step grows; 1 - SSIM is quadratic.
POWERS: Mapping[str, float] = {"ciede2000": 1.0, "ssim": 2.0}
MOST_STEPS = 10_000
FURTHEST = 10.0  # lengths of the line beyond its ends; more extreme faces are implausible


@dataclass(frozen=True, eq=False)
class Line:
    """The faces between two faces of a model.

    Attributes
    ----------
    model : MorphModel
    first, last : array (k,)
        Loadings at positions 0 and 1.

    Raises
    ------
    BadInput
        If the two faces are equal or have different numbers of loadings.
    """

    model: MorphModel
    first: LoadingVector
    last: LoadingVector

    def __post_init__(self) -> None:
        if self.first.shape != self.last.shape:
            raise BadInput(
                f"the ends have {len(self.first)} and {len(self.last)} loadings; expected equal numbers. Encode "
                "both with one model"
            )
        if np.array_equal(self.first, self.last):
            raise BadInput("the two ends are the same face; expected two faces. Choose another")

    def loadings(self, positions: AnyArray) -> LoadingTable:
        """Return the loadings (n, k) at positions (n,); those of the end faces are bit-equal."""
        share = np.asarray(positions, np.float64)[:, None]
        return np.asarray((1 - share) * self.first + share * self.last)

    @cached_property
    def _ends(self) -> tuple[tuple[Image, Displacement], tuple[Image, Displacement]]:
        first, last = (self.model.expand(loadings) for loadings in (self.first, self.last))
        return (first.texture, first.displacement), (last.texture, last.displacement)

    def texture(self, position: float) -> Image:
        """Return the texture (h, w, 3) on the mean face at a position."""
        return _mixed(self._ends[0][0], self._ends[1][0], position)

    def displacement(self, position: float) -> Displacement:
        """Return the displacement (h, w, 2) px of the mean face at a position."""
        return _mixed(self._ends[0][1], self._ends[1][1], position)

    def picture(self, position: float) -> Image:
        """Render the image (h, w, 3) at a position, rounded to 8-bit codes."""
        return as_shown(warp.render(self.texture(position), self.displacement(position)))

    @cached_property
    def _end_pictures(self) -> tuple[Image, Image]:
        return self.picture(0.0), self.picture(1.0)

    def crossfade(self, position: float) -> Image:
        """Blend the images of the two ends without a warp, (h, w, 3), rounded to 8-bit codes."""
        return as_shown(_mixed(*self._end_pictures, position))


def _mixed(first: AnyArray, last: AnyArray, share: float) -> AnyArray:
    out: AnyArray = np.float32(1 - share) * first + np.float32(share) * last
    return out


def even_positions(steps: int) -> AnyArray:
    """Return the positions (steps + 1,) of a linear morph: 0 to 1 in 1 to 10,000 equal steps, else `BadInput`.

    Examples
    --------
    >>> even_positions(4).tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0]
    """
    if not 1 <= steps <= MOST_STEPS:
        raise BadInput(f"the number of steps is {steps}; expected 1 to {MOST_STEPS}. Change it")
    return np.arange(steps + 1) / steps


def given_positions(positions: Sequence[float]) -> AnyArray:
    """Check positions (n,): 0 is the first end, 1 the last; beyond them the difference is extrapolated.

    Raises
    ------
    BadInput
        If there are fewer than 2, they do not rise, or one is more than 10 lengths of the line beyond its ends.

    Examples
    --------
    >>> given_positions([0, 0.5, 1]).tolist()
    [0.0, 0.5, 1.0]
    """
    found = np.asarray(positions, np.float64)
    if found.ndim != 1 or len(found) < 2:
        raise BadInput(
            f"the number of positions is {found.size}; expected at least 2. Enter, for example, 0,0.5,1"
        )
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
    """Return positions (steps + 1,) from 0 to 1 with equal steps in `spacing`, measured on the rendered 8-bit images.

    For "loadings" and "warp" the positions are even, because both are linear along the line.
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
