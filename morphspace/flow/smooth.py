"""Fields for morphs: smoothed by a share of the face, most where they are least certain (ours).

What flow does not tell, noise does. A morph pays for noise twice, in the warp and in the texture that makes up for it,
and components that spend themselves on it are missing elsewhere. A field for its own sake is left as it was found.
"""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.flow import Flow, FlowFunction, FlowMethod
from morphspace.flow.folds import unfolded

SMOOTHING = 0.015  # sd, of the image's width; held-out faces, benchmarks/results/defaults.md
LEAST_WEIGHT = (
    0.3  # of a point of no confidence; with less, wide open mouths follow their rims (flow-ablation.md)
)


def smoothed(flow: Flow) -> Flow:
    """Give the flow averaged by a Gaussian of `SMOOTHING` times its width, more of the confident points."""
    sd_px = SMOOTHING * flow.displacement.shape[1]
    weight = flow.confidence + np.float32(LEAST_WEIGHT)
    stack = np.concatenate([flow.displacement * weight[..., None], weight[..., None]], axis=2)
    blurred = cv2.GaussianBlur(stack, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)
    return Flow(unfolded(blurred[..., :2] / blurred[..., 2:]), flow.confidence)


def for_morphs(method: FlowMethod) -> FlowMethod:
    """Give a method whose flows are smoothed."""

    def for_reference(reference: Image) -> FlowFunction:
        find = method(reference)

        def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
            return smoothed(find(frame, start))

        return to_frame

    return for_reference
