"""Choose the reference: the frame from which all the others are best reached.

The paper asks for a neutral face, eyes open, mouth slightly open with a little of the teeth and of the dark between
them, so that the flow finds everything it needs to make the other frames (Nagle section 2). That wish can be measured
without knowing what a mouth is: a frame that lacks what the others show leaves a large error when warped to them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from morphspace import warp
from morphspace.arrays import Image, Mask
from morphspace.flow.baselines import dis_medium

CANDIDATES = 20  # spread evenly over the clip; each is tried against each other
SMALL_SIDE_PX = 100  # of the frames compared
WARPED_SHARE = 0.5  # of the score; the rest is how well a frame comes back from its own texture


@dataclass(frozen=True, eq=False)
class ReferenceChoice:
    """Which frame became the reference (`index`, `name`), and why, in one sentence for the report."""

    index: int
    name: str
    reason: str


def candidate_indices(count: int) -> list[int]:
    """Give the frames of a clip of `count` that are tried as the reference: at most `CANDIDATES`, evenly spread."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(count, CANDIDATES)).round())]


def shrunk(image: Image, mask: Mask) -> tuple[Image, Mask]:
    """Give the image and its mask at about `SMALL_SIDE_PX` wide, which is enough to compare frames."""
    height, width = mask.shape
    scale = min(1.0, SMALL_SIDE_PX / width)
    size = max(16, round(width * scale)), max(16, round(height * scale))
    return (
        cv2.resize(image, size, interpolation=cv2.INTER_AREA),
        cv2.resize(mask, size, interpolation=cv2.INTER_AREA),
    )


def score_candidates(images: list[Image], mask: Mask) -> Iterator[float]:
    """Give for each small image its mean error as the reference of the others, in colour units; the least is best.

    The error of a pair is how far the warped reference misses the frame (what the reference does not show), and how
    far the frame misses itself when it is taken apart and rendered again (what the warp destroys).
    """
    for reference in images:
        errors = [_pair_error(reference, frame, mask) for frame in images if frame is not reference]
        yield float(np.mean(errors)) if errors else 0.0


def _pair_error(reference: Image, frame: Image, mask: Mask) -> float:
    field = dis_medium(reference, frame)
    texture = warp.sample(frame, field)
    back = warp.render(texture, field)
    return _rms(back - frame, mask) + WARPED_SHARE * _rms(texture - reference, mask)


def _rms(difference: Image, mask: Mask) -> float:
    square = (difference * difference).mean(axis=2)
    return float(np.sqrt((square * mask).sum() / max(float(mask.sum()), 1.0)))
