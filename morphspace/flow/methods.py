"""The flow methods by name, as `--flow` and a model's file call them."""

from __future__ import annotations

import cv2
import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.errors import BadInput
from morphspace.flow import Flow, FlowFunction, FlowMethod, baselines, multiscale, paper, presets
from morphspace.flow.backends import Backend, OpenCVBackend
from morphspace.flow.folds import unfolded
from morphspace.flow.names import DEFAULT, DEFAULT_BACKEND, NAMES

SMOOTHING = 0.015  # SD as a share of the image's width; from held-out faces (results/defaults.md)
LEAST_WEIGHT = 0.3  # of no confidence; with less, open mouths follow their rims (flow-ablation.md)

METHODS: dict[str, FlowMethod] = {
    **{name: multiscale.method(preset) for name, preset in presets.PRESETS.items()},
    "paper": paper.method,
    "deepflow": baselines.stock(baselines.deepflow),
    "dis": baselines.stock(baselines.dis),
    "tvl1": baselines.stock(baselines.tvl1),
}

__all__ = ["DEFAULT", "METHODS", "NAMES", "for_morphs", "named"]


def named(name: str, backend: str = DEFAULT_BACKEND) -> FlowMethod:
    """Return the flow method of a name.

    Parameters
    ----------
    name : str
        One of `METHODS`.
    backend : str
        Where it runs; see `_named_backend`. Only the presets of `multiscale` have a choice.

    Raises
    ------
    BadInput
        If the name or the backend does not exist, or the method does not run on the backend.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[:48, :48]
    >>> reference = np.repeat(np.exp(-((x - 24) ** 2 + (y - 24) ** 2) / 100)[..., None], 3, axis=2).astype(np.float32)
    >>> flow = named("fast")(reference)(np.roll(reference, 2, axis=1))
    >>> flow.displacement[24, 24].round().tolist()
    [2.0, 0.0]
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
            f"the flow is {name}; expected one of {', '.join(presets.PRESETS)} with the backend {backend}. "
            "Choose one of these or leave out the backend"
        )
    return multiscale.method(presets.PRESETS[name], _named_backend(backend))


def _named_backend(name: str) -> Backend:
    """Return the backend of a name.

    Parameters
    ----------
    name : {"opencv", "torch", "torch:cpu", "torch:cuda"}
        "torch" uses a GPU if there is one.

    Raises
    ------
    BadInput
        If the name is another, torch is not installed or the device does not exist.
    """
    if name == "opencv":
        return OpenCVBackend()
    library, _, device = name.partition(":")
    if library != "torch":
        raise BadInput(
            f"the backend is {name!r}; expected opencv, torch, torch:cpu or torch:cuda. Choose one of these"
        )
    from morphspace.flow import torch_backend  # an optional dependency, and slow to import

    return torch_backend.TorchBackend(device or torch_backend.best_device())


def for_morphs(name: str) -> FlowMethod:
    """Return the flow method of a name with its flows `smoothed`, as building and encoding use it (ours).

    Noise in a field enters a morph twice, in the warp and in the texture that compensates for it. A flow that is
    wanted for itself is not smoothed.

    Examples
    --------
    >>> import numpy as np
    >>> flow = for_morphs("dis")(np.zeros((48, 40, 3), np.float32))(np.zeros((48, 40, 3), np.float32), None)
    >>> flow.displacement.shape, float(np.abs(flow.displacement).max())
    ((48, 40, 2), 0.0)
    """
    method = named(name)

    def for_reference(reference: Image) -> FlowFunction:
        find = method(reference)

        def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
            return smoothed(find(frame, start))

        return to_frame

    return for_reference


def smoothed(flow: Flow) -> Flow:
    """Average a flow by a Gaussian of `SMOOTHING` times its width, weighted by confidence, and remove its folds.

    Parameters
    ----------
    flow : Flow
        Displacement (h, w, 2) px and confidence (h, w).

    Returns
    -------
    Flow
        The smoothed displacement with the same confidence.
    """
    sd_px = SMOOTHING * flow.displacement.shape[1]
    weight = flow.confidence + np.float32(LEAST_WEIGHT)
    stack = np.concatenate([flow.displacement * weight[..., None], weight[..., None]], axis=2)
    blurred = cv2.GaussianBlur(stack, (0, 0), sd_px, borderType=cv2.BORDER_REFLECT_101)
    return Flow(unfolded(blurred[..., :2] / blurred[..., 2:]), flow.confidence)
