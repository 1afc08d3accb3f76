"""The page of a mimicry: each driving frame over the face it made, the loadings over time, and what to distrust."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.report import pictures
from morphspace.report.blocks import key_figures, notes_section, page_beside_a_video, settings_section
from morphspace.report.markup import Html, element, figure, section, sentence, text
from morphspace.report.plots import SMALL_SIZE, Plot, line_plot
from morphspace.report.style import STYLE

# The video lies beside the page, as a file; nothing else may be loaded.
PAIRS_SHOWN = 24  # on the contact sheet
TRACES_SHOWN = 8  # components; the table has all
ROWS_SHOWN = 200  # of the quality table; flagged frames come first, quality.csv has all
LEAST_RANGE_SD = 1.0  # of a trace's axis, so that a still component looks still
MIMIC_STYLE = """
video{display:block;max-width:100%;max-height:480px;border-radius:4px}
section>.sheet+figure{margin-top:22px}
tr.flagged>*,.sheet .flagged figcaption{color:var(--alarm)}
table.quality td,table.quality thead th:not(:first-child):not(:last-child){text-align:right}
table.quality td:last-child{text-align:left}
table.quality td,table.quality tbody th{white-space:nowrap}
"""
HEADINGS: dict[str, tuple[str, int, float]] = {
    "warp_kept": ("motion kept, %", 0, 100),
    "missing_motion": ("missing at features, %", 1, 100),
    "opening_beyond": ("opens beyond, %", 1, 100),
    "colour_agreement": ("colours agree, r", 2, 1),
    "length_sd": ("length, SD", 2, 1),
    "largest_sd": ("largest asked, SD", 1, 1),
    "bounded": ("components bounded", 0, 1),
    "folds": ("folded, %", 2, 100),
    "outside_source": ("outside source's space", 1, 1),
    "yaw_deg": ("yaw, degrees", 0, 1),
    "pitch_deg": ("pitch, degrees", 0, 1),
}
"""Columns of the table as the page heads them: words, decimals, and the factor for reading."""
LEFT_OUT = ("texture_kept",)  # of quality.csv: below 0 between any two people, and read wrongly
SHARES = ("warp_kept",)  # below 0 in the file where another motion is shown; none is kept then


@dataclass(frozen=True, eq=False)
class MimicryShown:
    """What the page shows.

    `names` of source, target and what drove | `pairs` frame name, source and mimicry (h, w, 3), small | `loadings_sd`
    (n, k) of the target | `max_sd` their bound | `columns` of quality.csv | `notes` to read first | `video` its file
    name | `settings` name to value.
    """

    names: tuple[str, str, str]
    pairs: Sequence[tuple[str, Image, Image]]
    loadings_sd: LoadingTable
    max_sd: float
    rate_hz: float | None
    columns: Mapping[str, Sequence[Any]]
    notes: Sequence[str]
    video: str
    settings: Mapping[str, str]


def mimic_page(shown: MimicryShown) -> str:
    """Give the page as HTML. Ours; mimicry is that of Nagle section 3."""
    source, target, driver = shown.names
    title = f"{target} mimics {source}"
    driven = "" if driver == source else f", driven by {driver}"
    parts = [
        element("h1", text(title)),
        element("p", text(f"{len(shown.loadings_sd)} frames{driven}"), class_="kicker"),
        _figures(shown),
        notes_section(shown.notes),
        _faces(shown),
        _traces(shown),
        _quality(shown),
        settings_section(shown.settings),
    ]
    return page_beside_a_video(title, STYLE + MIMIC_STYLE, parts)


def _figures(shown: MimicryShown) -> Html:
    columns = shown.columns
    flagged = sum(bool(flags) for flags in columns["flags"])
    entries = [
        (
            _share(float(np.median(columns["warp_kept"]))),
            "of the motion's energy is kept, median over frames",
        ),
        (
            f"{np.median(columns['missing_motion']):.1%}",
            "of the eye distance is missing at lids, brows and lips, median over frames",
        ),
        (
            f"{np.median(columns['colour_agreement']):.2f}",
            "correlation of the changes of colour, median; 0 to .4 between people",
        ),
        (f"{np.median(columns['length_sd']):.2f}", "SD long, median: how far faces lie from the mean"),
        (
            f"{sum(count > 0 for count in columns['bounded'])}",
            "frames have loadings that the bound shortened",
        ),
        (f"{np.max(columns['folds']):.2%}", "of the face folds in the worst frame"),
        (f"{flagged}", f"of {len(columns['flags'])} frames are flagged"),
    ]
    return key_figures(entries)


def _faces(shown: MimicryShown) -> Html:
    source, target, _ = shown.names
    words_of = (words.replace(" ", ", ") for words in shown.columns["flags"])
    flags = dict(zip(shown.columns["frame"], words_of, strict=True))
    pairs = [
        figure(
            pictures.photograph(pictures.stacked(upper, lower), f"{name}: source above, mimicry beneath"),
            text(f"{name}: {words}" if (words := flags.get(name)) else name),
            **({"class_": "flagged"} if flags.get(name) else {}),
        )
        for name, upper, lower in shown.pairs
    ]
    total = len(shown.loadings_sd)
    some = f" {len(pairs)} of {total} frames, evenly spread." if len(pairs) < total else ""
    video = element("video", src=shown.video, controls="controls", loop="loop", muted="muted", playsinline="")
    return section(
        "faces",
        "Side by side",
        sentence(f"{source} above, and beneath what {target} makes of it.{some}"),
        element("div", *pairs, class_="sheet"),
        figure(video, text(f"{source} on the left, {target} on the right, every frame.")),
    )


def _traces(shown: MimicryShown) -> Html:
    loadings = shown.loadings_sd
    total = loadings.shape[1]
    drawn = []
    for place in range(min(TRACES_SHOWN, total)):
        values = loadings[:, place]
        heading = f"pc{place + 1:03d}: {values.min():+.1f} to {values.max():+.1f} SD"
        plot = Plot(f"Loading on {heading}", "frame", "SD", LEAST_RANGE_SD, SMALL_SIZE)
        drawn.append(figure(line_plot(plot, values.tolist()), text(heading)))
    words = f"Loadings of {shown.names[1]} frame by frame, in SD of its own components; each is bounded by "
    words += f"{shown.max_sd:g} SD."
    more = f" The first {TRACES_SHOWN} of {total}; loadings.csv has all." if total > TRACES_SHOWN else ""
    return section("loadings", "Loadings", sentence(words + more), element("div", *drawn, class_="pair"))


def _quality(shown: MimicryShown) -> Html:
    columns = shown.columns
    flags = columns["flags"]
    names = [name for name in HEADINGS if any(value is not None for value in columns.get(name, ()))]
    order = sorted(range(len(flags)), key=lambda place: (not flags[place], place))
    cut = order[:ROWS_SHOWN]
    headings = ("Frame", *(HEADINGS[name][0] for name in names), "Flags")
    rows = [
        element(
            "tr",
            element("th", text(columns["frame"][place]), scope="row"),
            *(element("td", text(_cell(name, columns[name][place]))) for name in names),
            element("td", text(flags[place].replace(" ", ", "))),
            **({"class_": "flagged"} if flags[place] else {}),
        )
        for place in cut
    ]
    caption = (
        "Flagged frames first, then all in order. Missing at features: motion at lids, brows and lips that the "
        "loadings do not show, in % of the eye distance. Colours agree: correlation of the change of colour asked for "
        "with the one shown. quality.csv has all columns, and exact numbers below 0 where another motion is shown than "
        "was asked; quality.json says what they mean."
    )
    if len(cut) < len(order):
        caption += f" The first {len(cut)} of {len(order)}."
    content = element(
        "table",
        element("caption", text(caption)),
        element("thead", element("tr", *(element("th", text(name), scope="col") for name in headings))),
        element("tbody", *rows),
        class_="quality",
    )
    return section("quality", "Quality", element("div", content, class_="wide"))


def _share(value: float) -> str:
    """Give a share for reading; what is shown may also be other than what was asked, which is none of it."""
    return f"{max(value, 0):.0%}"


def _cell(name: str, value: Any) -> str:
    if value is None:
        return ""
    _, decimals, factor = HEADINGS[name]
    return f"{(max(value, 0) if name in SHARES else value) * factor + 0.0:.{decimals}f}"
