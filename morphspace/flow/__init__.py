"""Dense flow: where each point of the reference lies in a frame, and how reliable that is.

Every estimator has one type, `FlowMethod`, so that a build does not depend on the choice. A method takes the
reference and returns a function from frames to flows: what depends on the reference alone is computed once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:  # the command line imports `flow.names` through here, before numpy
    from morphspace.arrays import Displacement, Image, Mask


@dataclass(frozen=True, eq=False)
class Flow:
    """A displacement field and its confidence.

    Attributes
    ----------
    displacement : array (h, w, 2) float32
        u in px, with reference(p) ~ frame(p + u(p)).
    confidence : array (h, w) float32
        In [0, 1]: low where the frame does not match the reference (occluded or changed skin), 0 without texture and
        outside the frame.
    """

    displacement: Displacement
    confidence: Mask


FlowFunction: TypeAlias = "Callable[[Image, Displacement | None], Flow]"
"""(frame (h, w, 3), start (h, w, 2) px or None) -> the flow from the method's reference."""

FlowMethod: TypeAlias = "Callable[[Image], FlowFunction]"
"""reference (h, w, 3) -> the function that computes its flow to a frame."""
