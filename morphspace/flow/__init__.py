"""Dense flow: where each point of the reference is found in a frame.

Every estimator is a function of one type, `FlowFunction`, so that a build does not care which one it was given.
"""

from __future__ import annotations

from collections.abc import Callable

from morphspace.arrays import Displacement, Image

FlowFunction = Callable[[Image, Image, Displacement | None], Displacement]
"""(reference, frame, start or None) -> u with reference(p) ~ frame(p + u(p)); images (h, w, 3), u (h, w, 2) px."""
