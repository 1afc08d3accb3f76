"""The flow methods by name: what `--flow` and a model's file call them."""

from __future__ import annotations

from morphspace.errors import BadInput
from morphspace.flow import FlowMethod, baselines, multiscale, paper, presets, smooth
from morphspace.flow.backends import named_backend
from morphspace.flow.names import DEFAULT, DEFAULT_BACKEND, NAMES

METHODS: dict[str, FlowMethod] = {
    **{name: multiscale.method(preset) for name, preset in presets.PRESETS.items()},
    "paper": paper.method,
    "deepflow": baselines.stock(baselines.deepflow),
    "dis": baselines.stock(baselines.dis),
    "tvl1": baselines.stock(baselines.tvl1),
}

__all__ = ["DEFAULT", "METHODS", "NAMES", "for_morphs", "named"]


def named(name: str, backend: str = DEFAULT_BACKEND) -> FlowMethod:
    """Give the method of this name, on the machine that `backends.named_backend` calls `backend`.

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


def for_morphs(name: str) -> FlowMethod:
    """Give the method of this name as building and encoding use it: smoothed (`smooth`)."""
    return smooth.for_morphs(named(name))
