"""Dense flow: where each point of the reference is found in a frame, and how far to trust it there.

Every estimator is a method of one type, `FlowMethod`, so that a build does not care which one it was given. A method is
first given the reference, and gives a function from frames to flows: what depends on the reference alone is computed
once for all the frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:  # the command line imports `flow.names` through here, before numpy
    from morphspace.arrays import Displacement, Image, Mask


@dataclass(frozen=True, eq=False)
class Flow:
    """A field and its confidence.

    `displacement` u (h, w, 2) px with reference(p) ~ frame(p + u(p)); `confidence` (h, w) in [0, 1], low where the
    frame does not look like the reference at the point (hidden, changed), 0 without texture and outside the frame.
    """

    displacement: Displacement
    confidence: Mask


FlowFunction: TypeAlias = "Callable[[Image, Displacement | None], Flow]"
"""(frame, start or None) -> the flow from the reference it was made for; frame (h, w, 3)."""

FlowMethod: TypeAlias = "Callable[[Image], FlowFunction]"
"""reference (h, w, 3) -> the function that finds frames from it."""
