"""The presets `fast`, `balanced` and `accurate` of the registration flow.

Each choice was measured on photographs warped by known fields, on Middlebury scenes and on real expressions. The
photographs and clips are not those of the reported figures (benchmarks/results/flow-ablation.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from morphspace.flow.constraints import Channels


@dataclass(frozen=True, eq=False)
class Preset:
    """All settings of the estimator in `multiscale`.

    Attributes
    ----------
    colours : {"grey", "rgb"}
        The planes that are compared.
    finest : float
        The last scale as a share of the full size; larger for a small picture (`pyramid.FINEST_PX`).
    factor : float
        Ratio of one scale to the next finer one.
    warps : tuple of int
        Warps at each scale, finest first. The last number holds for the coarsest scale, the one before it for all
        between.
    channels : Channels
        The derivatives that are compared.
    coarse_light : float
        Weight of order 0 at coarse scales.
    robust_px : float
        Residual above which a constraint's weight falls.
    integration_px : float
        SD of the Gaussian over which constraints are pooled.
    coupling : float
        Weight of the smooth field in the pixelwise solution.
    strength, edge_codes : float
        Of the smoother (`Backend.smoother`).
    smoothings : {1, 2}
        1 penalises slope, 2 bending.
    recursive_px : int
        Longer side up to which the smoother is `Backend.recursive_smoother`.
    rounds : tuple of int
        Rounds of robust weights, solution and smoothing in a warp, by scale, finest first; the last holds for all
        coarser ones.
    rivals_px : int
        Longer side up to which the motions of nearby pixels are tried.
    rival_step_px : int
        Distance of those pixels.
    checked_px : int
        Longer side at which the field is compared with the backward flow; 0 for no comparison.
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
        """The channels at coarse scales, where order 0 has the weight `coarse_light`."""
        return replace(self.channels, weights=(self.coarse_light, *self.channels.weights[1:]))

    @cached_property
    def slope_channels(self) -> Channels:
        """The channels that compute first derivatives only."""
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
"""By name, the fastest first."""
