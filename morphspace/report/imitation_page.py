"""The page of a measured imitation: the measures, both motions on one axis, and the chance level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from morphspace.arrays import AnyArray, Image, LoadingTable
from morphspace.imitation import Comparison
from morphspace.report import pictures
from morphspace.report.page import Panel, fixed, p_value, render
from morphspace.report.plots import PLOT_SIZE, SMALL_SIZE, Mark, Plot, line_plot, trace_plot

TRACES_SHOWN = 12  # components plotted; the table has all
LEAST_RANGE_SD = 1.0  # SD; range of a trace's axis, so that a still component looks still
LEAST_RANGE_FRAMES = 4.0  # frames; likewise of the alignment
COLUMNS = (
    ("correlation", "r", 2),
    ("correlation_p", "p of r", 3),
    ("correlation_p_familywise", "p of r, all tested", 3),
    ("cosine", "cosine", 2),
    ("gain", "gain", 2),
    ("distance_sd", "distance, SD", 2),
    ("mutual_information_nats", "mutual information, nats", 2),
    ("mutual_information_nats_p", "p of information", 3),
    ("entropy_stimulus_nats", "entropy of stimulus, nats", 2),
    ("entropy_imitation_nats", "entropy of imitation, nats", 2),
    ("lag_frames", "lag, frames", 0),
    ("correlation_at_lag", "r at best lag", 2),
    ("correlation_at_lag_p", "p of r at best lag", 3),
    ("correlation_aligned", "r aligned", 2),
    ("correlation_aligned_p", "p of r aligned", 3),
)


@dataclass(frozen=True, eq=False)
class MeasuredImitation:
    """A measured imitation with the figures of its page.

    Attributes
    ----------
    comparison
        The comparison of both sequences.
    stimulus_sd, imitation_sd
        (n, k) and (m, k), SD.
    rate_hz
        Frame rate of both, or None.
    names
        Names of stimulus, imitation and model.
    pairs
        A few frames: label and the two pictures.
    notes
        Notes to read first.
    still
        Lines on sequences without motion.
    read_in
        Name of the model with which the imitation was encoded if it is not the stimulus' model.
    video
        File name of the video.
    panels
        Panels of the video from left to right.
    settings
        Name to value.
    rows
        Rows of the table by name; the last is for all components together.
    reasons
        For each row, why cells are empty.
    """

    comparison: Comparison
    stimulus_sd: LoadingTable
    imitation_sd: LoadingTable
    rate_hz: float | None
    names: tuple[str, str, str]
    pairs: Sequence[tuple[str, Image, Image]]
    notes: Sequence[str]
    still: Sequence[str]
    read_in: str | None
    video: str
    panels: Sequence[str]
    settings: Mapping[str, str]
    rows: Sequence[str]
    reasons: Sequence[str]


@dataclass(frozen=True)
class Trace:
    """A component's two motions, their correlation and its p among all components."""

    picture: Markup
    label: str
    r: float
    p: float


@dataclass(frozen=True, eq=False)
class ImitationPage:
    """The contents of `imitation.html` for the imitation `measured`: measures, traces, timing and table."""

    title: str
    measured: MeasuredImitation
    together: Mapping[str, float]
    pairs: Sequence[Panel]
    traces: Sequence[Trace]
    lag_plot: Markup | None
    r_at_lag: float
    delay_plot: Markup
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    undefined: Mapping[str, Sequence[str]]


def imitation_page(measured: MeasuredImitation) -> str:
    """Return the page as HTML. Ours; the measures are those of Nagle section 5.1."""
    stimulus, imitation, _ = measured.names
    comparison = measured.comparison
    together = {name: float(values[-1]) for name, values in comparison.measures.items()}
    lag_plot, r_at_lag = _lag_plot(comparison, together)
    undefined: dict[str, list[str]] = {}
    for name, reason in zip(measured.rows, measured.reasons, strict=True):
        if reason:
            undefined.setdefault(reason, []).append(name)
    page = ImitationPage(
        title=f"{imitation} imitates {stimulus}",
        measured=measured,
        together=together,
        pairs=[_pair(*pair) for pair in measured.pairs],
        traces=_traces(measured),
        lag_plot=lag_plot,
        r_at_lag=r_at_lag,
        delay_plot=_delay_plot(comparison),
        headings=["Component", *(heading for _, heading, _ in COLUMNS)],
        rows=[_row(measured, place) for place in (-1, *range(len(measured.rows) - 1))],
        undefined=undefined,
    )
    return render("imitation.html", page)


def _pair(label: str, upper: Image, lower: Image) -> Panel:
    stacked = pictures.stacked(upper, lower)
    return Panel(pictures.photograph(stacked, f"{label}: stimulus above, imitation beneath"), label)


def _traces(measured: MeasuredImitation) -> list[Trace]:
    measures = measured.comparison.measures
    step, unit = (1 / measured.rate_hz, "s") if measured.rate_hz else (1.0, "frame")
    traces = []
    for place in range(min(TRACES_SHOWN, measured.stimulus_sd.shape[1])):
        name, r = measured.rows[place], float(measures["correlation"][place])
        p = float(measures["correlation_p_familywise"][place])
        words = f"{name}: r {fixed(r)}, {p_value(p)} among all components"
        plot = Plot(words, unit, "SD", LEAST_RANGE_SD, SMALL_SIZE)
        a, b = measured.stimulus_sd[:, place].tolist(), measured.imitation_sd[:, place].tolist()
        traces.append(Trace(trace_plot(plot, a, b, step), name, r, p))
    return traces


def _lag_plot(comparison: Comparison, together: Mapping[str, float]) -> tuple[Markup | None, float]:
    """Plot the correlation at each lag; return the plot and the highest correlation, no plot if no lag is defined."""
    if not np.isfinite(together["lag_frames"]):
        return None, float("nan")
    lag = int(together["lag_frames"])
    curve = np.nan_to_num(comparison.curve)
    place = int(np.flatnonzero(comparison.lags == lag)[0])
    plot = Plot(
        "Correlation of all components together at each lag",
        "lag, frames: the imitation is later to the right",
        "r",
        0.5,
        PLOT_SIZE,
        int(comparison.lags[0]),
    )
    r = together["correlation"]
    level = (float(np.nan_to_num(r)), f"without lag {fixed(r)}")
    dot = Mark(place, f"lag {lag}, r {curve[place]:.2f}")
    return line_plot(plot, curve.tolist(), dot=dot, level=level), float(curve[place])


def _delay_plot(comparison: Comparison) -> Markup:
    delays = _delay_of_each(comparison.alignment.path, comparison.alignment.straight)
    words = "How much later than at an even pace the imitation reaches each frame of the stimulus"
    plot = Plot(words, "frame of the stimulus", "later by, frames", LEAST_RANGE_FRAMES)
    return line_plot(plot, delays.tolist())


def _delay_of_each(path: AnyArray, straight: AnyArray) -> AnyArray:
    frames = int(path[-1, 0]) + 1
    count = np.bincount(path[:, 0], minlength=frames)
    return np.asarray(np.bincount(path[:, 0], path[:, 1] - straight, minlength=frames) / count)


def _row(measured: MeasuredImitation, place: int) -> list[str]:
    measures = measured.comparison.measures
    return [
        measured.rows[place],
        *(fixed(float(measures[name][place]), decimals) for name, _, decimals in COLUMNS),
    ]
