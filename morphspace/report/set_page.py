"""The page of a stimulus set: a contact sheet, what its pictures measure, and which of them stand out.

The page is complete in itself. Where a set has more stimuli than a sheet can show, evenly chosen ones are shown and the
page says so; the statistics are those of all. Ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import Image
from morphspace.report import pictures
from morphspace.report.blocks import key_figures, notes_section, page_by_itself, settings_section
from morphspace.report.markup import DASH, Html, element, figure, section, sentence, table, text
from morphspace.report.plots import SMALL_SIZE, Mark, Plot, line_plot
from morphspace.report.style import STYLE
from morphspace.stimuli.image_statistics import FIGURES, SPACES

SHOWN_AT_MOST = 96  # pictures of a sheet: some 10 kB each
CLIPPED_PERCENT = 0.1  # of the colour values; fewer are the overshoot of a sharp edge
FOLDED_PERCENT = (
    0.2  # of the face: no training face of five recordings folds at all, and .4 has been seen as a crease
)
SHEET_COLUMNS, MOST_COLUMNS = 8, 12  # of the sheet
NAMED_AT_MOST = 3  # stimuli named in one plot
LISTED_AT_MOST = 200  # flagged stimuli in the table
PLOTTED = ("luminance", "rms_contrast", "spectral_slope")
LEAST_RANGE = {
    "luminance": 0.02,
    "rms_contrast": 0.02,
    "spectral_slope": 0.1,
    "red": 0.02,
    "green": 0.02,
    "blue": 0.02,
}
WORDS = {
    "luminance": "mean luminance",
    "rms_contrast": "RMS contrast",
    "spectral_slope": "spectral slope",
    "red": "mean red",
    "green": "mean green",
    "blue": "mean blue",
}
SPACE_WORDS = {"linear": "linear light", "code": "code values"}
SET_STYLE = """
@media (min-width:821px){.sheet{grid-template-columns:repeat(var(--columns,8),1fr)}}
.sheet .flagged img{outline:2px solid var(--amber)}
.sheet .flagged figcaption{color:var(--amber)}
"""


@dataclass(frozen=True, eq=False)
class SetShown:
    """What the page shows: title, the manifest's `rows`, notes, settings, and small pictures by the row's place."""

    title: str
    rows: Sequence[Mapping[str, Any]]
    thumbnails: Mapping[int, Image]
    notes: Sequence[str]
    settings: Mapping[str, str]
    told: Sequence[str]


def places_shown(count: int) -> tuple[int, ...]:
    """Give which of so many stimuli the sheet shows."""
    return tuple(
        int(place) for place in np.unique(np.linspace(0, count - 1, min(count, SHOWN_AT_MOST)).round())
    )


def set_page(shown: SetShown) -> str:
    """Give the page as HTML; the same values give the same bytes."""
    rows = shown.rows
    identities = list(dict.fromkeys(str(row["identity"]) for row in rows))
    kicker = f"{len(rows)} stimul{'us' if len(rows) == 1 else 'i'} of {', '.join(identities[:6])}"
    if len(identities) > 6:
        kicker += f" and {len(identities) - 6} more"
    parts = [
        element("h1", text(shown.title)),
        element("p", text(kicker), class_="kicker"),
        _figures(rows),
        notes_section(shown.notes),
        _sheet(shown),
        _statistics(rows),
        _flagged(rows),
        settings_section(shown.settings),
    ]
    return page_by_itself(shown.title, STYLE + SET_STYLE, parts)


def _figures(rows: Sequence[Mapping[str, Any]]) -> Html:
    counts = [
        (len(rows), "stimuli"),
        (sum(int(row["frames"]) for row in rows), "frames"),
        (sum(float(row["clipped_percent"]) > CLIPPED_PERCENT for row in rows), "clipped in 0.1 % or more"),
        (sum(bool(row["beyond"]) for row in rows), "beyond 3 SD and every training face"),
        (sum(bool(row["outlier_in"]) for row in rows), "stand out in image statistics"),
    ]
    entries = [(str(count), words) for count, words in counts]
    furthest = max(float(row["largest_sd"]) for row in rows)
    folded = max(float(row["folded_percent"]) for row in rows)
    entries += [
        (f"{furthest:.1f} SD", "the loading furthest out"),
        (f"{folded:.2g} %", "folded in the worst stimulus"),
    ]
    return key_figures(entries)


def _sheet(shown: SetShown) -> Html:
    figures = []
    for place, image in sorted(shown.thumbnails.items()):
        row = shown.rows[place]
        flags = _flags(row)
        told = [
            f"{key} {_value(row[key])}" for key in shown.told if row.get(key) not in (None, "", row["name"])
        ]
        caption = [element("strong", text(str(row["name"])))]
        caption += [text(f" {', '.join(told)}")] if told else []
        caption += [text(f"; {', '.join(flags)}")] if flags else []
        picture = pictures.photograph(image, str(row["name"]))
        figures.append(figure(picture, *caption, **({"class_": "flagged"} if flags else {})))
    words = "Each stimulus, of a video its middle frame. Framed in amber: look at it before you use it."
    if len(shown.thumbnails) < len(shown.rows):
        words = f"{len(shown.thumbnails)} of {len(shown.rows)} stimuli, evenly chosen; of a video the middle frame."
    columns = (
        SHEET_COLUMNS if len(shown.thumbnails) < len(shown.rows) else sheet_columns(shown.rows, shown.told)
    )
    sheet = element("div", *figures, class_="sheet", style=f"--columns:{columns}")
    return section("sheet", "Contact sheet", sentence(words), sheet)


def sheet_columns(rows: Sequence[Mapping[str, Any]], told: Sequence[str]) -> int:
    """Give how many pictures a row of the sheet holds, so that what belongs together stands together.

    Where the first told column stays the same for so many stimuli, then for as many more and so on (all gains of a
    frame, all steps of a component), a row holds one such group, or several whole ones.
    """
    runs: list[int] = []
    last = object()
    for row in rows if told else ():
        value = row.get(told[0])
        if value != last:
            runs.append(0)
        runs[-1] += 1
        last = value
    size = runs[0] if len(runs) > 1 and len(set(runs)) == 1 else SHEET_COLUMNS
    if not 1 < size <= MOST_COLUMNS:
        return SHEET_COLUMNS
    return size * max(1, SHEET_COLUMNS // size)


def _flags(row: Mapping[str, Any]) -> list[str]:
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


def _statistics(rows: Sequence[Mapping[str, Any]]) -> Html:
    plots = [plot for name in PLOTTED for space in SPACES if (plot := _plot(rows, space, name)) is not None]
    body = []
    for space in SPACES:
        for name in FIGURES:
            values = _known(rows, f"{space}_{name}")
            cells = (
                [f"{function(values):.4g}" for function in (np.min, np.median, np.max, np.std)]
                if values.size
                else [DASH] * 4
            )
            body.append([text(f"{WORDS[name]}, {SPACE_WORDS[space]}"), *map(text, cells)])
    told = (
        "Over the whole picture, from the 8-bit codes of the file; of a video the mean over its frames. Luminance by "
        "ITU-R BT.709, from 0 to 1; RMS contrast is its standard deviation over its mean; the slope is that of log "
        "amplitude on log spatial frequency."
    )
    return section(
        "statistics",
        "Image statistics",
        sentence(told),
        element("div", *plots, class_="pair"),
        table("Over the set.", ("Figure", "lowest", "median", "highest", "SD"), body),
    )


def _plot(rows: Sequence[Mapping[str, Any]], space: str, name: str) -> Html | None:
    """Draw a figure over the stimuli, those that stand out named; None where no stimulus has it."""
    column = f"{space}_{name}"
    places = [place for place, row in enumerate(rows) if row.get(column) is not None]
    if not places:
        return None
    values = [float(rows[place][column]) for place in places]
    centre = float(np.median(values))
    out = [at for at, place in enumerate(places) if column in str(rows[place]["outlier_in"]).split()]
    worst = sorted(out, key=lambda at: -abs(values[at] - centre))[:NAMED_AT_MOST]
    marks = [Mark(at, str(rows[places[at]]["name"])) for at in worst]
    title = f"{WORDS[name]}, {SPACE_WORDS[space]}"
    plot = Plot(
        f"{title} of each stimulus", "stimulus, in the manifest's order", title, LEAST_RANGE[name], SMALL_SIZE
    )
    drawn = line_plot(plot, values, level=Mark(0, f"median {centre:.3g}"), level_value=centre, worst=marks)
    return drawn


def _known(rows: Sequence[Mapping[str, Any]], column: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([row[column] for row in rows if row.get(column) is not None], np.float64)


def _flagged(rows: Sequence[Mapping[str, Any]]) -> Html:
    flagged = [(row, _flags(row)) for row in rows]
    body = [[text(str(row["name"])), text(", ".join(flags))] for row, flags in flagged if flags]
    if not body:
        return section(
            "flagged",
            "Stimuli to look at",
            sentence("None: nothing is clipped, folded, beyond or stands out."),
        )
    more = f" The first {LISTED_AT_MOST} of {len(body)}." if len(body) > LISTED_AT_MOST else ""
    caption = f"Clipped, folded, further out than any training face, or unlike the rest of the set.{more}"
    return section(
        "flagged", "Stimuli to look at", table(caption, ("Stimulus", "Why"), body[:LISTED_AT_MOST])
    )


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
