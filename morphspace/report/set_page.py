"""The page of a stimulus set: a contact sheet, image statistics, and outlying stimuli (ours).

The sheet of a large set has evenly selected stimuli and says so; the statistics cover all stimuli.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from morphspace.arrays import AnyArray, Image
from morphspace.report import pictures
from morphspace.report.page import DASH, Panel, render
from morphspace.report.plots import SMALL_SIZE, Mark, Plot, line_plot
from morphspace.stimuli.image_statistics import FIGURES, SPACES

SHOWN_AT_MOST = 96  # pictures of a sheet, about 10 kB each
CLIPPED_PERCENT = 0.1  # of the colour values; less is overshoot at sharp edges
FOLDED_PERCENT = 0.2  # of the face; no training face of five recordings folds, and 0.4 was a visible crease
SHEET_COLUMNS, MOST_COLUMNS = 8, 12  # columns of the sheet: usual and largest number
NAMED_AT_MOST = 3  # stimuli named in one plot
LISTED_AT_MOST = 200  # flagged stimuli in the table
PLOTTED = {"luminance": 0.02, "rms_contrast": 0.02, "spectral_slope": 0.1}  # least range of each axis
WORDS = {
    "luminance": "mean luminance",
    "rms_contrast": "RMS contrast",
    "spectral_slope": "spectral slope",
    "red": "mean red",
    "green": "mean green",
    "blue": "mean blue",
}
SPACE_WORDS = {"linear": "linear light", "code": "code values"}

Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class StimulusSet:
    """A set with the contents of its page.

    Attributes
    ----------
    rows
        Rows of the manifest.
    thumbnails
        Small pictures (h, w, 3) by the row's index.
    notes
        Notes to read first.
    settings
        Name to value.
    columns
        Manifest columns that distinguish the stimuli, the outermost first.
    """

    title: str
    rows: Sequence[Row]
    thumbnails: Mapping[int, Image]
    notes: Sequence[str]
    settings: Mapping[str, str]
    columns: Sequence[str]


@dataclass(frozen=True, eq=False)
class SetPage:
    """The contents of `set.html` for the set `made`: counts, contact sheet, plots, statistics, flagged stimuli."""

    title: str
    made: StimulusSet
    identities: Sequence[str]
    frames: int
    clipped: int
    beyond: int
    outliers: int
    furthest_sd: float
    folded_percent: float
    sheet: Sequence[Panel]
    columns: int
    plots: Sequence[Markup]
    statistics: Sequence[Sequence[str]]
    flagged: Sequence[tuple[str, str]]
    clipped_limit: float = CLIPPED_PERCENT / 100
    listed: int = LISTED_AT_MOST


def places_shown(rows: Sequence[Row], columns: Sequence[str]) -> tuple[int, ...]:
    """Select evenly spread stimuli for the sheet; of a set in groups (all gains of a face) whole groups."""
    size = _group_size(rows, columns)
    groups = len(rows) // size
    shown = np.linspace(0, groups - 1, min(groups, max(1, SHOWN_AT_MOST // size))).round()
    return tuple(int(group) * size + place for group in np.unique(shown) for place in range(size))


def set_page(made: StimulusSet) -> str:
    """Return the page as HTML; the same values give the same bytes."""
    rows = made.rows
    flags = [", ".join(_flags(row)) for row in rows]
    page = SetPage(
        title=made.title,
        made=made,
        identities=list(dict.fromkeys(str(row["identity"]) for row in rows)),
        frames=sum(int(row["frames"]) for row in rows),
        clipped=sum(float(row["clipped_percent"]) > CLIPPED_PERCENT for row in rows),
        beyond=sum(bool(row["beyond"]) for row in rows),
        outliers=sum(bool(row["outlier_in"]) for row in rows),
        furthest_sd=max(float(row["largest_sd"]) for row in rows),
        folded_percent=max(float(row["folded_percent"]) for row in rows),
        sheet=[
            _panel(rows[place], image, made.columns, flags[place])
            for place, image in sorted(made.thumbnails.items())
        ],
        columns=sheet_columns(rows, made.columns),
        plots=[plot for name in PLOTTED for space in SPACES for plot in _plot(rows, space, name)],
        statistics=[_statistics(rows, space, name) for space in SPACES for name in FIGURES],
        flagged=[(str(row["name"]), why) for row, why in zip(rows, flags, strict=True) if why],
    )
    return render("set.html", page)


def sheet_columns(rows: Sequence[Row], columns: Sequence[str]) -> int:
    """Return the number of pictures in a row of the sheet, so that related stimuli are in one row.

    A row holds one group, or several whole ones.
    """
    size = _group_size(rows, columns)
    return size * max(1, SHEET_COLUMNS // size) if size > 1 else SHEET_COLUMNS


def _group_size(rows: Sequence[Row], columns: Sequence[str]) -> int:
    """Return the number of successive stimuli with one value in the first column, such as all gains of a face.

    It is 1 if the groups differ in size, are longer than `MOST_COLUMNS`, or there is one only.
    """
    runs: list[int] = []
    last = object()
    for row in rows if columns else ():
        value = row.get(columns[0])
        if value != last:
            runs.append(0)
        runs[-1] += 1
        last = value
    is_grouped = len(runs) > 1 and len(set(runs)) == 1 and runs[0] <= MOST_COLUMNS
    return runs[0] if is_grouped else 1


def _panel(row: Row, image: Image, columns: Sequence[str], flags: str) -> Panel:
    name = str(row["name"])
    known = {key: row[key] for key in columns if row.get(key) not in (None, "", name)}
    values = ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in known.items()
    )
    note = f" {values}" if values else ""
    note += f"; {flags}" if flags else ""
    return Panel(pictures.photograph(image, name), name, note, "flagged" if flags else "")


def _flags(row: Row) -> list[str]:
    flags = []
    if row["beyond"]:
        flags.append(f"beyond in {row['beyond']}")
    if row["outlier_in"]:
        flags.append(f"stands out in {row['outlier_in']}")
    if row["folded_percent"] > FOLDED_PERCENT:
        flags.append(f"{row['folded_percent']:.2g} % folded")
    if row["clipped_percent"] > CLIPPED_PERCENT:
        flags.append(f"{row['clipped_percent']:.2g} % clipped")
    return flags


def _statistics(rows: Sequence[Row], space: str, name: str) -> list[str]:
    values: AnyArray = np.array(
        [row[f"{space}_{name}"] for row in rows if row.get(f"{space}_{name}") is not None], np.float64
    )
    measures = (np.min, np.median, np.max, np.std)
    cells = [f"{measure(values):.4g}" for measure in measures] if values.size else [DASH] * len(measures)
    return [f"{WORDS[name]}, {SPACE_WORDS[space]}", *cells]


def _plot(rows: Sequence[Row], space: str, name: str) -> Iterable[Markup]:
    """Plot a statistic over the stimuli that have it, and name the outliers; no plot if none has it."""
    column = f"{space}_{name}"
    known = [row for row in rows if row.get(column) is not None]
    if not known:
        return
    values = [float(row[column]) for row in known]
    centre = float(np.median(values))
    out = [at for at, row in enumerate(known) if column in str(row["outlier_in"]).split()]
    worst = sorted(out, key=lambda at: -abs(values[at] - centre))[:NAMED_AT_MOST]
    marks = [Mark(at, str(known[at]["name"])) for at in worst]
    title = f"{WORDS[name]}, {SPACE_WORDS[space]}"
    words = f"{title} of each stimulus"
    plot = Plot(words, "stimulus, in the manifest's order", title, PLOTTED[name], SMALL_SIZE)
    yield line_plot(plot, values, level=(centre, f"median {centre:.3g}"), worst=marks)
