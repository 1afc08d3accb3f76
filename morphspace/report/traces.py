"""Traces of two motions over each other as inline SVG: the stimulus solid, the imitation dashed, on one axis.

The words and the look are those of `plots`; colour is never the only difference between the two lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from morphspace.report.markup import Html, element, text
from morphspace.report.plots import BOTTOM, LEFT, RIGHT, TOP, Plot, round_ticks

TRACE_STYLE = """
svg .stimulus{stroke:var(--accent);fill:none;stroke-width:1.8;stroke-linejoin:round}
svg .imitation{stroke:#b4530a;fill:none;stroke-width:1.8;stroke-linejoin:round;stroke-dasharray:6 3}
svg .zero{stroke:var(--soft);fill:none;stroke-width:.8}
svg .imitation-words{fill:#b4530a}
"""
LEGEND_PX = 62  # from one name of the legend to the next


def trace_plot(plot: Plot, stimulus: Sequence[float], imitation: Sequence[float], step: float = 1.0) -> Html:
    """Draw two sequences of values over time, each with its own number of frames; `step` is the time of one frame."""
    width, height = plot.size
    low, high = min(*stimulus, *imitation, 0.0), max(*stimulus, *imitation, 0.0)
    spare = max(plot.least_range - (high - low), 0.0) / 2
    ticks = round_ticks(low - spare, high + spare, 4)
    longest = max(len(stimulus), len(imitation), 2)

    def place(index: float, value: float) -> tuple[float, float]:
        share = (value - ticks[0]) / (ticks[-1] - ticks[0])
        x = LEFT + index / (longest - 1) * (width - LEFT - RIGHT)
        return x, height - BOTTOM + share * (TOP - height + BOTTOM)

    parts = []
    for tick in ticks:
        y = place(0, tick)[1]
        parts.append(_path([(LEFT, y), (width - RIGHT, y)], "zero" if tick == 0 else "grid"))
        parts.append(_words(LEFT - 8, y + 4, _number(tick, ticks), "tick", "end"))
    times = round_ticks(0, (longest - 1) * step, 5)
    for time in times:
        if time <= (longest - 1) * step * 1.0001:
            x = place(time / step, 0)[0]
            parts.append(_words(x, height - BOTTOM + 15, _number(time, times), "tick", "middle"))
    parts.append(_words(width - RIGHT, height - 4, plot.x_title, "axis", "end"))
    parts.append(_words(0, 12, plot.y_title, "axis", "start"))
    for values, kind in ((stimulus, "stimulus"), (imitation, "imitation")):
        parts.append(_path([place(index, value) for index, value in enumerate(values)], kind))
    parts.append(_words(width - RIGHT - LEGEND_PX, 12, "stimulus", "level-words", "end"))
    parts.append(_words(width - RIGHT, 12, "imitation", "imitation-words", "end"))
    drawn = element(
        "svg",
        element("title", text(plot.description)),
        *parts,
        viewBox=f"0 0 {width} {height}",
        role="img",
        aria_label=plot.description,
    )
    return element("div", drawn, class_="plot" if width > 600 else "plot narrow")


def _path(points: Sequence[tuple[float, float]], kind: str) -> Html:
    return element("path", d="M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in points), class_=kind)


def _words(x: float, y: float, words: str, kind: str, anchor: str) -> Html:
    return element("text", text(words), x=f"{x:.2f}", y=f"{y:.2f}", class_=kind, text_anchor=anchor)


def _number(tick: float, ticks: Sequence[float]) -> str:
    return f"{tick:.{max(0, -math.floor(math.log10(ticks[1] - ticks[0]) + 1e-9))}f}"
