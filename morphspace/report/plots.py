"""Plots as inline SVG: lines over frames, cumulative shares, and two motions on one axis (ours).

One unit of a drawing is one pixel at the page's full width. Numbers have two decimals, so the same values give the
same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from morphspace.report.page import markup

PLOT_SIZE = (1040, 300)  # px of the drawing: the width of a page
SMALL_SIZE = (510, 190)  # px; two stand side by side
LEFT, RIGHT, TOP, BOTTOM = 52, 14, 28, 34  # px; margins for the axes' labels
LABEL_ROW_PX = 17  # px; height of the row of a named point
LABEL_CHARACTERS = 40  # characters; longer names are truncated, the table has them in full
POINTS_AT_MOST = 160  # points; more would overlap, so only the line is drawn
LEGEND_PX = 62  # px between names of the legend

Point = tuple[float, float]


@dataclass(frozen=True)
class Mark:
    """A named point of a plot: its index along the axis and its label."""

    index: int
    label: str


@dataclass(frozen=True)
class Plot:
    """The description of a plot, its axis titles, and the least range of its values.

    `first` is the first index on the axis; `lowest` is the lower limit of the quantity and of the axis.
    """

    description: str
    x_title: str
    y_title: str
    least_range: float
    size: tuple[int, int] = PLOT_SIZE
    first: int = 0
    lowest: float = -math.inf


def round_ticks(low: float, high: float, about: int) -> list[float]:
    """Return about `about` round numbers, 1, 2 or 5 times a power of ten apart, that cover low to high."""
    raw = (high - low) / max(about, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(number * step, 10) + 0.0 for number in range(first, last + 1)]


def line_plot(
    plot: Plot,
    values: Sequence[float],
    *,
    level: tuple[float, str] | None = None,
    worst: Sequence[Mark] = (),
    dot: Mark | None = None,
) -> Markup:
    """Plot values over their index as a line.

    Parameters
    ----------
    plot : Plot
        Description, axes and size.
    values : sequence of float, (n,)
        One value for each index.
    level : (float, str), optional
        Value and words of a dashed horizontal line.
    worst : sequence of Mark
        Points named beneath the line, each in its own row, so that neighbours do not overlap.
    dot : Mark, optional
        One highlighted point, such as the reference.

    Returns
    -------
    Markup
        The drawing, `<div class="plot"><svg>...`.
    """
    width, height = plot.size
    count = len(values)
    ticks = _value_ticks(plot, values, 5 if height > 200 else 4)
    floor_y = height - BOTTOM - LABEL_ROW_PX * len(worst)
    x_of = _scale(-0.5, count - 0.5, LEFT, width - RIGHT)
    y_of = _scale(ticks[0], ticks[-1], floor_y, TOP)
    points = [(x_of(index), y_of(value)) for index, value in enumerate(values)]
    parts = _axes(plot, ticks, y_of)
    whole = round_ticks(plot.first, max(plot.first + count - 1, plot.first + 2), 10 if width > 600 else 5)
    within = (tick for tick in whole if tick == int(tick) and plot.first <= tick < plot.first + count)
    parts += [_tick(plot, x_of(tick - plot.first), f"{tick:.0f}") for tick in within]
    if level is not None:
        parts.append(_line([(LEFT, y_of(level[0])), (width - RIGHT, y_of(level[0]))], "level"))
    parts.append(_line(points, "series"))
    if count <= POINTS_AT_MOST:
        parts += [_circle(x, y, 1.8, "point") for x, y in points]
    if level is not None:
        parts.append(_words(width - RIGHT, y_of(level[0]) - 5, level[1], "level-words", "end"))
    parts += _named(worst, points, floor_y, width)
    if dot is not None:
        x, y = points[dot.index]
        form = '<circle cx="{x}" cy="{y}" r="4" class="dot"><title>{label}</title></circle>'
        parts.append(markup(form, x=_n(x), y=_n(y), label=dot.label))
    return _drawing(plot, parts)


def share_plot(plot: Plot, shares: Sequence[float], reached: Sequence[Mark]) -> Markup:
    """Plot cumulative shares (percent, after 1, 2, ... components) as a curve from 0, with named points."""
    width, height = plot.size
    count = len(shares)
    x_of, y_of = _scale(0, count, LEFT, width - RIGHT), _scale(0, 100, height - BOTTOM, TOP)
    points = [(x_of(number), y_of(share)) for number, share in enumerate((0, *shares))]
    ticks = [tick for tick in round_ticks(0, max(count, 2), 10) if tick == int(tick) and tick <= count]
    parts = _axes(plot, (0, 20, 40, 60, 80, 100), y_of)
    parts += [_tick(plot, x_of(tick), f"{tick:.0f}") for tick in ticks]
    parts += [_line([*points, (points[-1][0], y_of(0)), points[0]], "area"), _line(points, "series")]
    names = []
    for row, mark in enumerate(reached):
        x, y = points[mark.index]
        parts += [_line([(x, y), (x, y_of(0))], "leader"), _circle(x, y, 3.5, "dot")]
        shift, anchor = (7, "start") if x < width * 0.7 else (-7, "end")
        names.append(_words(x + shift, y_of(0) - LABEL_ROW_PX * (row + 1), mark.label, "name", anchor))
    return _drawing(plot, parts + names)


def trace_plot(
    plot: Plot, stimulus: Sequence[float], imitation: Sequence[float], step: float = 1.0
) -> Markup:
    """Plot two motions over time on one axis, the stimulus solid, the imitation dashed; `step` is the time of a frame.

    Each has its own number of frames. The lines differ in more than colour.
    """
    width, height = plot.size
    longest = max(len(stimulus), len(imitation), 2)
    ticks = _value_ticks(plot, [*stimulus, *imitation, 0.0], 4)
    times = round_ticks(0, (longest - 1) * step, 5)
    x_of = _scale(0, longest - 1, LEFT, width - RIGHT)
    y_of = _scale(ticks[0], ticks[-1], height - BOTTOM, TOP)
    parts = _axes(plot, ticks, y_of, zero="zero")
    within = (time for time in times if time <= (longest - 1) * step * 1.0001)
    parts += [_tick(plot, x_of(time / step), _number(time, times)) for time in within]
    for values, kind in ((stimulus, "stimulus"), (imitation, "imitation")):
        parts.append(_line([(x_of(index), y_of(value)) for index, value in enumerate(values)], kind))
    parts.append(_words(width - RIGHT - LEGEND_PX, 12, "stimulus", "level-words", "end"))
    parts.append(_words(width - RIGHT, 12, "imitation", "imitation-words", "end"))
    return _drawing(plot, parts)


def _value_ticks(plot: Plot, values: Sequence[float], about: int) -> list[float]:
    low, high = min(values), max(values)
    spare = max(plot.least_range - (high - low), 0.0) / 2
    bottom = max(low - spare, plot.lowest)
    return round_ticks(bottom, max(high + spare, bottom + plot.least_range), about)


def _scale(low: float, high: float, start: float, end: float) -> Callable[[float], float]:
    return lambda value: start + (value - low) / (high - low) * (end - start)


def _axes(
    plot: Plot, ticks: Sequence[float], y_of: Callable[[float], float], zero: str = "grid"
) -> list[Markup]:
    width, height = plot.size
    parts = [
        _line([(LEFT, y_of(tick)), (width - RIGHT, y_of(tick))], "grid" if tick else zero) for tick in ticks
    ]
    parts += [_words(LEFT - 8, y_of(tick) + 4, _number(tick, ticks), "tick", "end") for tick in ticks]
    parts.append(_words(width - RIGHT, height - 4, plot.x_title, "axis", "end"))
    parts.append(_words(0, 12, plot.y_title, "axis", "start"))
    return parts


def _tick(plot: Plot, x: float, label: str) -> Markup:
    return _words(x, plot.size[1] - BOTTOM + 15, label, "tick", "middle")


def _named(worst: Sequence[Mark], points: Sequence[Point], floor_y: float, width: int) -> list[Markup]:
    """Name points in rows beneath the line, the outermost in the lowest row, so that names do not overlap."""
    lines, names = [], []
    for row, mark in enumerate(sorted(worst, key=lambda mark: abs(points[mark.index][0] - width / 2))):
        x, y = points[mark.index]
        base = floor_y + LABEL_ROW_PX * (row + 1) - 4
        lines += [_line([(x, y + 4), (x, base)], "leader"), _circle(x, y, 3.5, "worst")]
        shift, anchor = (5, "start") if x < width / 2 else (-5, "end")
        label = mark.label
        short = label if len(label) <= LABEL_CHARACTERS else label[: LABEL_CHARACTERS - 1] + "…"
        names.append(_words(x + shift, base, short, "name", anchor))
    return lines + names


def _drawing(plot: Plot, parts: Iterable[Markup]) -> Markup:
    width, height = plot.size
    form = (
        '<div class="{kind}"><svg viewBox="0 0 {width} {height}" role="img" aria-label="{words}">'
        "<title>{words}</title>{parts}</svg></div>"
    )
    kind = "plot" if width > 600 else "plot narrow"
    return markup(
        form, kind=kind, width=width, height=height, words=plot.description, parts=Markup("").join(parts)
    )


def _line(points: Sequence[Point], kind: str) -> Markup:
    return markup(
        '<path d="M{d}" class="{kind}"/>', d="L".join(f"{_n(x)} {_n(y)}" for x, y in points), kind=kind
    )


def _circle(x: float, y: float, radius: float, kind: str) -> Markup:
    form = '<circle cx="{x}" cy="{y}" r="{radius}" class="{kind}"/>'
    return markup(form, x=_n(x), y=_n(y), radius=_n(radius), kind=kind)


def _words(x: float, y: float, words: str, kind: str, anchor: str) -> Markup:
    form = '<text x="{x}" y="{y}" class="{kind}" text-anchor="{anchor}">{words}</text>'
    return markup(form, x=_n(x), y=_n(y), words=words, kind=kind, anchor=anchor)


def _n(number: float) -> str:
    return f"{number:.2f}".rstrip("0").rstrip(".")


def _number(tick: float, ticks: Sequence[float]) -> str:
    return f"{tick:.{max(0, -math.floor(math.log10(ticks[1] - ticks[0]) + 1e-9))}f}"
