"""The page of a mimicry: each driving frame above its mimicry, the loadings over time, and each frame's quality."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.report import pictures
from morphspace.report.page import Panel, render
from morphspace.report.plots import SMALL_SIZE, Plot, line_plot
from morphspace.transfer.quality_table import BEYOND, FLAGS, FOLDS, NO_FACE, TURNED

PAIRS_SHOWN = 24  # pairs on the contact sheet
TRACES_SHOWN = 8  # components plotted; the table has all
ROWS_SHOWN = 200  # rows of the quality table, flagged frames first; quality.csv has all
LEAST_RANGE_SD = 1.0  # SD; range of a trace's axis, so that a still component looks still
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
"""Columns of quality.csv in the page's table: heading, decimals, and the factor from the file's unit."""
LEFT_OUT = ("texture_kept",)  # column of quality.csv; below 0 between any two people, and easily misread
SHARES = ("warp_kept",)  # negative in the file if other motion was drawn; the page shows 0


@dataclass(frozen=True, eq=False)
class MimicryResult:
    """A mimicry with the contents of its page.

    Attributes
    ----------
    names
        Names of source, target and driver.
    pairs
        Frame name, source and mimicry (h, w, 3), small.
    loadings_sd
        (n, k) of the target, SD.
    max_sd
        Bound of the loadings, SD.
    columns
        Columns of quality.csv.
    notes
        Notes to read first.
    video
        File name of the video.
    settings
        Name to value.
    """

    names: tuple[str, str, str]
    pairs: Sequence[tuple[str, Image, Image]]
    loadings_sd: LoadingTable
    max_sd: float
    columns: Mapping[str, Sequence[Any]]
    notes: Sequence[str]
    video: str
    settings: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class MimicPage:
    """The contents of `mimicry.html` for the mimicry `made`: medians, pairs of pictures, traces, table of quality."""

    title: str
    made: MimicryResult
    frames: int
    motion_kept: float
    missing_motion: float
    colour_agreement: float
    length_sd: float
    bounded_frames: int
    worst_fold: float
    flagged_frames: int
    pairs: Sequence[Panel]
    traces: Sequence[Panel]
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    flagged_rows: Mapping[int, str]


def mimic_page(made: MimicryResult) -> str:
    """Return the page as HTML. Ours; mimicry is that of Nagle section 3."""
    source, target, _ = made.names
    columns, flags = made.columns, made.columns["flags"]
    names = [name for name in HEADINGS if any(value is not None for value in columns.get(name, ()))]
    order = sorted(range(len(flags)), key=lambda place: (not flags[place], place))[:ROWS_SHOWN]
    page = MimicPage(
        title=f"{target} mimics {source}",
        made=made,
        frames=len(made.loadings_sd),
        motion_kept=max(float(np.median(columns["warp_kept"])), 0),
        missing_motion=float(np.median(columns["missing_motion"])),
        colour_agreement=float(np.median(columns["colour_agreement"])),
        length_sd=float(np.median(columns["length_sd"])),
        bounded_frames=sum(count > 0 for count in columns["bounded"]),
        worst_fold=float(np.max(columns["folds"])),
        flagged_frames=sum(bool(words) for words in flags),
        pairs=_pairs(made),
        traces=_traces(made.loadings_sd),
        headings=["Frame", *(HEADINGS[name][0] for name in names), "Flags"],
        rows=[
            [
                columns["frame"][place],
                *(_cell(name, columns[name][place]) for name in names),
                flags[place].replace(" ", ", "),
            ]
            for place in order
        ],
        flagged_rows={row: "flagged" for row, place in enumerate(order) if flags[place]},
    )
    return render("mimicry.html", page)


def _pairs(made: MimicryResult) -> list[Panel]:
    flags = dict(zip(made.columns["frame"], made.columns["flags"], strict=True))
    panels = []
    for name, upper, lower in made.pairs:
        words = flags.get(name, "").replace(" ", ", ")
        picture = pictures.photograph(
            pictures.stacked(upper, lower), f"{name}: source above, mimicry beneath"
        )
        panels.append(Panel(picture, name, f": {words}" if words else "", "alarm" if words else ""))
    return panels


def _traces(loadings_sd: LoadingTable) -> list[Panel]:
    panels = []
    for place, values in enumerate(loadings_sd.T[:TRACES_SHOWN]):
        heading = f"pc{place + 1:03d}: {values.min():+.1f} to {values.max():+.1f} SD"
        plot = Plot(f"Loading on {heading}", "frame", "SD", LEAST_RANGE_SD, SMALL_SIZE)
        panels.append(Panel(line_plot(plot, values.tolist()), heading))
    return panels


def _cell(name: str, value: Any) -> str:
    if value is None:
        return ""
    _, decimals, factor = HEADINGS[name]
    return f"{(max(value, 0) if name in SHARES else value) * factor + 0.0:.{decimals}f}"


def mimic_lines(
    folder: Path, names: tuple[str, str], columns: Mapping[str, list[Any]], settings: Mapping[str, Any]
) -> tuple[str, str]:
    """Report a mimicry of `names` (source, target), from the columns of quality.csv."""
    flags = columns["flags"]
    kept, flagged = max(float(np.median(columns["warp_kept"])), 0), sum(map(bool, flags))
    return (
        f"{folder}: {names[1]} shows {len(flags)} frames of {names[0]} by {settings['method']}, gain "
        f"{settings['gain']:.3g}; of the motion {kept:.0%} is kept (median), {flagged} frames are flagged",
        f"page: {folder / 'index.html'}",
    )


def mimic_document(
    folder: Path, model_id: str, columns: Mapping[str, list[Any]], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the outcome of a mimicry as JSON, from the columns of quality.csv."""
    flags = columns["flags"]
    counts = {flag: sum(flag in words.split() for words in flags) for flag in FLAGS}
    return {
        "output": str(folder),
        "page": str(folder / "index.html"),
        "frames": len(flags),
        "flagged": sum(map(bool, flags)),
        "no_face": counts[NO_FACE],
        "out_of_range": counts[BEYOND],
        "turned": counts[TURNED],
        "folds": counts[FOLDS],
        **{name: settings[name] for name in ("method", "gain", "max_sd", "neutral")},
        "warp_kept_median": float(np.median(columns["warp_kept"])),
        "missing_motion_median": float(np.median(columns["missing_motion"])),
        "colour_agreement_median": float(np.median(columns["colour_agreement"])),
        "model_id": model_id,
    }
