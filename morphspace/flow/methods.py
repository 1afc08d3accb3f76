"""The flow methods by name: what `--flow` and a model's file call them."""

from __future__ import annotations

from morphspace.errors import BadInput
from morphspace.flow import FlowMethod, baselines, multiscale, paper, presets
from morphspace.flow.names import DEFAULT, NAMES

METHODS: dict[str, FlowMethod] = {
    **{name: multiscale.method(preset) for name, preset in presets.PRESETS.items()},
    "paper": paper.method,
    "deepflow": baselines.stock(baselines.deepflow),
    "dis": baselines.stock(baselines.dis),
    "dis-medium": baselines.stock(baselines.dis_medium),
    "tvl1": baselines.stock(baselines.tvl1),
}

__all__ = ["DEFAULT", "METHODS", "NAMES", "named"]


def named(name: str) -> FlowMethod:
    """Give the method of this name. Raises `BadInput` for a name that is not in `METHODS`."""
    if name not in METHODS:
        raise BadInput(f"there is no flow called {name!r}: choose one of {', '.join(METHODS)}")
    return METHODS[name]
