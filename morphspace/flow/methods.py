"""The flow methods by name: what `--flow` and a model's file call them."""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.errors import BadInput
from morphspace.flow import Flow, FlowFunction, FlowMethod, baselines, multiscale, paper, presets
from morphspace.flow.backends import Backend, OpenCVBackend
from morphspace.flow.folds import unfolded
from morphspace.flow.names import DEFAULT, DEFAULT_BACKEND, NAMES

SMOOTHING = 0.015  # sd, of the image's width; held-out faces, benchmarks/results/defaults.md
LEAST_WEIGHT = (
    0.3  # of a point of no confidence; with less, wide open mouths follow their rims (flow-ablation.md)
)

METHODS: dict[str, FlowMethod] = {
    **{name: multiscale.method(preset) for name, preset in presets.PRESETS.items()},
    "paper": paper.method,
    "deepflow": baselines.stock(baselines.deepflow),
    "dis": baselines.stock(baselines.dis),
    "tvl1": baselines.stock(baselines.tvl1),
}

__all__ = ["DEFAULT", "METHODS", "NAMES", "for_morphs", "named", "named_backend"]


def named(name: str, backend: str = DEFAULT_BACKEND) -> FlowMethod:
    """Give the method of this name, on the machine that `named_backend` calls `backend`.

    Raises `BadInput` for a name that is not in `METHODS`, for a backend that is not there, and for another than the
    usual with a method that has no choice of it.
    """
    if name not in METHODS:
        raise BadInput(
            f"the flow is {name!r}; expected one of {', '.join(METHODS)}. Choose one of these; a model that was built "
            "with another flow must be built again"
        )
    if backend == DEFAULT_BACKEND:
        return METHODS[name]
    if name not in presets.PRESETS:
        raise BadInput(
            f"{name} does not run on {backend}, only {', '.join(presets.PRESETS)} do: choose one of them, or leave out "
            "the backend"
        )
    return multiscale.method(presets.PRESETS[name], named_backend(backend))


def named_backend(name: str) -> Backend:
    """Give the primitives by name: "opencv", "torch" (a GPU where there is one), "torch:cpu" or "torch:cuda".

    Raises `BadInput` for another name, where torch is not installed and where there is no such device.
    """
    if name == "opencv":
        return OpenCVBackend()
    library, _, device = name.partition(":")
    if library != "torch":
        raise BadInput(f"the flow does not run on {name!r}: choose opencv, torch, torch:cpu or torch:cuda")
    from morphspace.flow import torch_backend  # an optional dependency, and slow to import

    return torch_backend.TorchBackend(device or torch_backend.best_device())


def for_morphs(name: str) -> FlowMethod:
    """Return the method of this name as building and encoding use it: its flows are smoothed by a share of the face.

    What flow does not tell, noise does. A morph pays for noise twice, in the warp and in the texture that makes up for
    it. A field for its own sake is left as it was found. Ours.
    """
    method = named(name)

    def for_reference(reference: Image) -> FlowFunction:
        find = method(reference)

        def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
            return smoothed(find(frame, start))

        return to_frame

    return for_reference


def smoothed(flow: Flow) -> Flow:
    """Give the flow averaged by a Gaussian of `SMOOTHING` times its width, more of the confident points."""
    sd_px = SMOOTHING * flow.displacement.shape[1]
    weight = flow.confidence + np.float32(LEAST_WEIGHT)
    stack = np.concatenate([flow.displacement * weight[..., None], weight[..., None]], axis=2)
    blurred = cv2.GaussianBlur(stack, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)
    return Flow(unfolded(blurred[..., :2] / blurred[..., 2:]), flow.confidence)
