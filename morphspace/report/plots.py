"""Plots as inline SVG, written by hand: lines with round numbers on their axes, in the page's own type.

One unit of a drawing is one pixel at the page's full width. Numbers are written with two decimals, so that the same
figures give the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from morphspace.report.markup import Html, element, text

PLOT_SIZE = (1040, 300)
SMALL_SIZE = (510, 190)
LEFT, RIGHT, TOP, BOTTOM = 52, 14, 28, 34  # px kept free around the drawing for the axes' words
LABEL_ROW_PX = 17  # height of one named point's row under the lowest point
LABEL_CHARACTERS = 40  # a longer name is cut in a plot; the table below gives it whole
POINTS_AT_MOST = 160  # with more, dots run together and the line alone is clearer


@dataclass(frozen=True)
class Mark:
    """A point of a plot to be named: its place along the axis and what to write."""

    index: int
    label: str


@dataclass(frozen=True)
class Plot:
    """What a plot shows: what it tells in words, the axis titles, and the least range of its values.

    `lowest` is what the quantity cannot go below: the axis does not either.
    """

    description: str
    x_title: str
    y_title: str
    least_range: float
    size: tuple[int, int] = PLOT_SIZE
    first: int = 0
    lowest: float = -math.inf


def round_ticks(low: float, high: float, about: int) -> list[float]:
    """Give about so many round numbers (1, 2 or 5 times a power of ten apart) that reach from low to high or beyond."""
    raw = (high - low) / max(about, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= raw * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(number * step, 10) + 0.0 for number in range(first, last + 1)]


def line_plot(
    plot: Plot,
    values: Sequence[float],
    *,
    level: Mark | None = None,
    level_value: float = 0.0,
    worst: Sequence[Mark] = (),
    dot: Mark | None = None,
) -> Html:
    """Draw values over their index as a line.

    `level` is a dashed line at `level_value` with its words; `worst` are points named in rows beneath the line, each
    in a row of its own so that neighbours do not cover each other; `dot` is one point set off, such as the reference.
    """
    width, height = plot.size
    low, high = min(values), max(values)
    spare = max(plot.least_range - (high - low), 0.0) / 2
    bottom = max(low - spare, plot.lowest)
    top = max(high + spare, bottom + plot.least_range)
    ticks = round_ticks(bottom, top, 5 if height > 200 else 4)
    floor_y = height - BOTTOM - LABEL_ROW_PX * len(worst)
    count = len(values)

    def place(index: float, value: float) -> tuple[float, float]:
        share = (value - ticks[0]) / (ticks[-1] - ticks[0])
        across = (index + 0.5) / count
        return LEFT + across * (width - LEFT - RIGHT), floor_y + share * (TOP - floor_y)

    points = [place(index, value) for index, value in enumerate(values)]
    parts = [_grid_line(place(0, tick)[1], _number(tick, ticks), width) for tick in ticks]
    parts += _index_words(plot, count, lambda index: place(index, ticks[0])[0])
    if level is not None:
        y = place(0, level_value)[1]
        parts.append(_line(LEFT, y, width - RIGHT, y, "level"))
    parts.append(element("path", d=_path(points), class_="series"))
    if count <= POINTS_AT_MOST:
        parts += [_circle(x, y, 1.8, "point") for x, y in points]
    if level is not None:
        parts.append(_words(width - RIGHT, place(0, level_value)[1] - 5, level.label, "level-words", "end"))
    parts += _named(worst, points, floor_y, width)
    if dot is not None:
        x, y = points[dot.index]
        parts.append(
            element("circle", element("title", text(dot.label)), cx=_n(x), cy=_n(y), r="4", class_="dot")
        )
    return _drawing(plot, parts)


def _named(
    worst: Sequence[Mark], points: Sequence[tuple[float, float]], floor_y: float, width: int
) -> list[Html]:
    """Name points in rows beneath the line: names grow towards the middle, the innermost point's in the top row."""
    lines, names = [], []
    for row, mark in enumerate(sorted(worst, key=lambda mark: abs(points[mark.index][0] - width / 2))):
        x, y = points[mark.index]
        base = floor_y + LABEL_ROW_PX * (row + 1) - 4
        lines += [_line(x, y + 4, x, base, "leader"), _circle(x, y, 3.5, "worst")]
        shift, anchor = (5, "start") if x < width / 2 else (-5, "end")
        names.append(_words(x + shift, base, _short(mark.label), "name", anchor))
    return lines + names


def share_plot(plot: Plot, shares: Sequence[float], reached: Sequence[Mark]) -> Html:
    """Draw cumulative shares (percent, after 1, 2, ... components) as a curve from 0, with named points on it."""
    width, height = plot.size
    count = len(shares)

    def place(components: float, share: float) -> tuple[float, float]:
        x = LEFT + components / count * (width - LEFT - RIGHT)
        return x, height - BOTTOM + share / 100 * (TOP - height + BOTTOM)

    points = [place(0, 0), *(place(number + 1, share) for number, share in enumerate(shares))]
    parts = [_grid_line(place(0, tick)[1], f"{tick}", width) for tick in (0, 20, 40, 60, 80, 100)]
    ticks = [tick for tick in round_ticks(0, max(count, 2), 10) if tick == int(tick) and tick <= count]
    parts += [
        _words(place(tick, 0)[0], height - BOTTOM + 15, f"{tick:.0f}", "tick", "middle") for tick in ticks
    ]
    parts.append(_words(width - RIGHT, height - 4, plot.x_title, "axis", "end"))
    parts.append(_words(0, 12, plot.y_title, "axis", "start"))
    area = [*points, (points[-1][0], points[0][1])]
    parts.append(element("path", d=_path(area) + "Z", class_="area"))
    parts.append(element("path", d=_path(points), class_="series"))
    names = []
    for row, mark in enumerate(reached):
        x, y = points[mark.index]
        parts += [_line(x, y, x, height - BOTTOM, "leader"), _circle(x, y, 3.5, "dot")]
        shift, anchor = (7, "start") if x < width * 0.7 else (-7, "end")
        names.append(
            _words(x + shift, height - BOTTOM - LABEL_ROW_PX * (row + 1), mark.label, "name", anchor)
        )
    parts += names
    return _drawing(plot, parts)


def _index_words(plot: Plot, count: int, x_of: Callable[[int], float]) -> list[Html]:
    width, height = plot.size
    first = plot.first
    about = 10 if width > 600 else 5
    ticks = [
        tick for tick in round_ticks(first, max(first + count - 1, first + 2), about) if tick == int(tick)
    ]
    words = [
        _words(x_of(round(tick) - first), height - BOTTOM + 15, f"{tick:.0f}", "tick", "middle")
        for tick in ticks
        if first <= tick < first + count
    ]
    words.append(_words(width - RIGHT, height - 4, plot.x_title, "axis", "end"))
    words.append(_words(0, 12, plot.y_title, "axis", "start"))
    return words


def _drawing(plot: Plot, parts: Iterable[Html]) -> Html:
    width, height = plot.size
    drawn = element(
        "svg",
        element("title", text(plot.description)),
        *parts,
        viewBox=f"0 0 {width} {height}",
        role="img",
        aria_label=plot.description,
    )
    return element("div", drawn, class_="plot" if width > 600 else "plot narrow")


def _grid_line(y: float, label: str, width: int) -> Html:
    line = _line(LEFT, y, width - RIGHT, y, "grid")
    return Html(line + _words(LEFT - 8, y + 4, label, "tick", "end"))


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> Html:
    return element("path", d=_path([(x1, y1), (x2, y2)]), class_=kind)


def _circle(x: float, y: float, radius: float, kind: str) -> Html:
    return element("circle", cx=_n(x), cy=_n(y), r=f"{radius:g}", class_=kind)


def _words(x: float, y: float, words: str, kind: str, anchor: str) -> Html:
    return element("text", text(words), x=_n(x), y=_n(y), class_=kind, text_anchor=anchor)


def _path(points: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{_n(x)} {_n(y)}" for x, y in points)


def _n(number: float) -> str:
    return f"{number:.2f}".rstrip("0").rstrip(".")


def _number(tick: float, ticks: Sequence[float]) -> str:
    step = ticks[1] - ticks[0]
    return f"{tick:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}"


def _short(name: str) -> str:
    return name if len(name) <= LABEL_CHARACTERS else name[: LABEL_CHARACTERS - 1] + "…"
