"""The components of a model for a page: pictures from -2 to +2 SD, and the variance that they explain (ours)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from morphspace.arrays import AnyArray
from morphspace.model.model import MorphModel
from morphspace.report import pictures
from morphspace.report.page import DASH, Panel, signed
from morphspace.report.plots import Mark, Plot, share_plot

COMPONENTS_SHOWN = 8  # components, at most, drawn as strips
REACHED_PERCENT = (90, 95, 99)  # of the variance; the page says how many components reach it


@dataclass(frozen=True, eq=False)
class ComponentRow:
    """One component: its share of variance (%), 1 SD in units, px and colour (rms), and its pictures."""

    label: str
    share_percent: float
    sd: float
    motion_px: float
    colour: float
    strip: Sequence[Panel]


@dataclass(frozen=True, eq=False)
class Components:
    """The contents of `components.html`: `rank` components, the first of them as `rows`, and the plot of variance.

    `explained` is the share of all components in words; `full_change` the change of luma drawn in full ink, 0 to 1.
    """

    rank: int
    rows: Sequence[ComponentRow]
    warp_weight: float
    full_change: float
    explained: str
    variance: Markup | None


def explained(model: MorphModel) -> AnyArray:
    """Return the share of variance (k,) in percent that the first 1, 2, ... components explain together."""
    basis = model.basis
    kept = np.cumsum(basis.variances)
    return 100 * basis.variance_explained * kept / max(kept[-1:].sum(), np.finfo(float).tiny)


def components_of(model: MorphModel) -> Components:
    """Draw the first components of a model and the curve of their variance."""
    if model.rank == 0:
        return Components(0, (), model.warp_weight, 0.0, DASH, None)
    together = explained(model)
    shares = np.diff(together, prepend=0)
    strips = list(pictures.component_strips(model, COMPONENTS_SHOWN))
    full = max(float(strip.change.max()) for strip in strips)
    rows = [
        ComponentRow(
            f"Component {number + 1}",
            float(shares[number]),
            float(model.sd[number]),
            strip.motion_px,
            strip.colour,
            _strip(f"Component {number + 1}", strip, full),
        )
        for number, strip in enumerate(strips)
    ]
    share = float(together[-1])
    # enough decimals to show the difference from 100
    words = f"{min(share, 99.99):.2f} %" if 99 <= share < 99.995 else f"{share:.1f} %"
    return Components(model.rank, rows, model.warp_weight, full, words, _variance_plot(together))


def _strip(label: str, strip: pictures.ComponentStrip, full: float) -> list[Panel]:
    panels = []
    for amount, picture in zip(pictures.STRIP_AMOUNTS_SD, strip.pictures, strict=True):
        words = f"{signed(amount)} SD"
        panels.append(Panel(pictures.photograph(picture, f"{label} at {words}"), words))
    chart = pictures.change_chart(strip.change, full)
    panels.append(Panel(pictures.chart(chart, f"Where {label.lower()} changes the picture"), "change"))
    return panels


def _variance_plot(shares: AnyArray) -> Markup:
    reached: list[Mark] = []
    for wanted in REACHED_PERCENT:
        enough = np.flatnonzero(shares >= wanted)
        if enough.size and (not reached or reached[-1].index != enough[0] + 1):
            reached.append(Mark(int(enough[0]) + 1, f"{wanted} % with {enough[0] + 1}"))
    words = "; ".join(mark.label for mark in reached) or f"{shares[-1]:.1f} % with all {len(shares)}"
    plot = Plot(f"Cumulative share of variance: {words}", "components", "variance, %", 0.0)
    return share_plot(plot, shares.tolist(), reached)
