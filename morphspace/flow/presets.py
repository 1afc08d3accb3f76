"""How much work the registration form spends, and on what: the presets `fast`, `balanced` and `accurate`.

What each choice is worth was measured on photographs warped by known fields, on Middlebury scenes and on real
expressions; the photographs and clips are not those of the reported figures
(benchmarks/results/flow-ablation.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from morphspace.flow.constraints import Channels


@dataclass(frozen=True, eq=False)
class Preset:
    """Everything that can be chosen about the estimator.

    `colours`: the planes that are compared. `finest`: the last scale, as a share of the full size (of a small picture
    more: `multiscale.FINEST_PX`), and `factor` between scales. `warps` a scale, finest first: the last number for the
    coarsest, the one before it for all between. `channels`: the derivatives, and `coarse_light`, the weight of order 0
    at coarse scales. `robust_px`: residuals above it count less and less. `integration_px`: sd over which constraints
    are pooled. `coupling` of the pixelwise solution to the smooth field, `strength` and `edge_codes` of the smoother
    (`Backend.smoother`), `smoothings` 1 (slope costs) or 2 (bending costs), and `recursive_px`, the longer side up to
    which it is `Backend.recursive_smoother`. `rounds` a warp of robust weights, solution
    and smoothing, by scale, finest first, the last number for all coarser ones. `rivals_px`: the longer side up to
    which the motions of pixels near by are tried, `rival_step_px` how far off. `checked_px`: the longer side at which
    the way back is compared (0: not at all).
    """

    colours: Literal["grey", "rgb"]
    finest: float
    factor: float
    warps: tuple[int, ...]
    channels: Channels
    coarse_light: float = 6.0
    robust_px: float = 0.05
    integration_px: float = 1.0
    coupling: float = 0.4
    strength: float = 30.0
    edge_codes: float = 10.0
    smoothings: Literal[1, 2] = 2
    recursive_px: int = 130
    rounds: tuple[int, ...] = (3,)
    rivals_px: int = 140
    rival_step_px: int = 3
    checked_px: int = 0

    @cached_property
    def coarse_channels(self) -> Channels:
        """The channels at coarse scales: order 0 weighs `coarse_light`."""
        return replace(self.channels, weights=(self.coarse_light, *self.channels.weights[1:]))

    @cached_property
    def slope_channels(self) -> Channels:
        """The channels that first derivatives alone need."""
        return replace(self.channels, weights=(1.0,))


ACCURATE = Preset(
    colours="rgb",
    finest=1.0,
    factor=0.7,
    warps=(2, 3, 4, 4),
    channels=Channels(weights=(0.15, 1.0, 1.0), sd_px=0.7, noise_codes=2.0, light_codes=1.5),
    checked_px=140,
)
BALANCED = replace(
    ACCURATE,
    factor=0.5,
    warps=(1, 1, 2, 6),
    channels=replace(ACCURATE.channels, weights=(1.0, 1.0, 1.0)),
    coupling=0.2,
    smoothings=1,
    strength=20.0,
    recursive_px=260,
    rounds=(2,),
    rivals_px=0,
    checked_px=0,
)
FAST = replace(
    ACCURATE,
    colours="grey",
    finest=0.42,
    factor=0.5,
    warps=(1, 1, 3),
    channels=replace(ACCURATE.channels, weights=(0.0, 1.0, 1.0)),
    coarse_light=10.0,
    integration_px=0.5,
    coupling=0.3,
    smoothings=1,
    strength=30.0,
    rounds=(3, 2, 1),
    rivals_px=0,
    checked_px=0,
)
PRESETS = {"fast": FAST, "balanced": BALANCED, "accurate": ACCURATE}
"""By name, the quickest first."""
