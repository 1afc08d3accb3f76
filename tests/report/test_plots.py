"""Plots: round ticks, places that are finite, and both lines of a trace on one axis."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from morphspace.report.plots import SMALL_SIZE, Mark, Plot, line_plot, round_ticks, trace_plot


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-3.2, 7.9), (119, 121), (1e-4, 3e-4), (99.5, 100.5)])
def test_ticks_are_round_and_cover(low, high):
    ticks = round_ticks(low, high, 5)
    assert ticks[0] <= low + 1e-9
    assert ticks[-1] >= high - 1e-9
    assert 3 <= len(ticks) <= 12
    step = ticks[1] - ticks[0]
    assert f"{step:.0e}"[0] in "125"


@pytest.mark.parametrize("values", [[120.0, 120.0, 120.0], [0.0], [5.0] * 400, [1e-9, -1e-9]])
def test_plots_of_still_values_have_finite_places(values, checked):
    drawn = line_plot(Plot("still", "frame", "px", 1.0), values, worst=[Mark(0, "a")], dot=Mark(0, "b"))
    numbers = [
        float(found) for found in re.findall(r"[-\d.]+(?=[ \"L])", drawn.split("<path", 1)[1]) if found != "-"
    ]
    assert np.isfinite(numbers).all()
    checked(drawn)


@pytest.mark.parametrize("values", [[0.0, 0.0], [0.1, 0.2], [3.0, 0.0]])
def test_an_axis_does_not_go_below_the_lowest_a_quantity_can_be(values):
    plot = Plot("folds", "frame", "%", 1.0)
    ticks = [_ticks(line_plot(replace(plot, lowest=lowest), values)) for lowest in (0.0, -np.inf)]
    assert ticks[0][0] == 0
    assert ticks[0][-1] >= max(1.0, *values)
    assert (ticks[1][0] < 0) == (max(values) < 1)  # centred, where the values alone do not fill the range


def _ticks(drawn):
    return sorted(float(found) for found in re.findall(r'class="tick" text-anchor="end">([-\d.]+)<', drawn))


def test_a_trace_stands_at_its_value():
    plot = Plot("values", "frame", "SD", 1.0, SMALL_SIZE)
    drawn = ElementTree.fromstring(re.search(r"<svg.*</svg>", trace_plot(plot, [0, 2], [2, 0, 1]), re.S)[0])
    lines = {path.get("class"): numbers(path.get("d")) for path in drawn.iter("path")}
    assert lines["stimulus"][0, 1] == pytest.approx(lines["zero"][0, 1])
    assert lines["stimulus"][1, 1] == pytest.approx(lines["imitation"][0, 1])
    assert lines["imitation"][2, 1] == pytest.approx(lines["stimulus"][:, 1].mean(), abs=0.01)
    assert lines["stimulus"][1, 0] == pytest.approx(lines["imitation"][1, 0])


def numbers(path):
    return np.array([list(map(float, point.split())) for point in path[1:].split("L")])
