"""The page of a measured imitation: the figures, both motions over each other, and what chance would give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Image, LoadingTable
from morphspace.imitation import Comparison
from morphspace.report import pictures
from morphspace.report.blocks import key_figures, notes_section, page_beside_a_video, settings_section
from morphspace.report.markup import DASH, Html, element, figure, section, sentence, table, text
from morphspace.report.plots import PLOT_SIZE, SMALL_SIZE, Mark, Plot, line_plot
from morphspace.report.style import STYLE
from morphspace.report.traces import TRACE_STYLE, trace_plot

# The video lies beside the page, as a file; nothing else may be loaded.
TRACES_SHOWN = 12  # components; the table has all
LEAST_RANGE_SD = 1.0  # of a trace's axis, so that a still component looks still
LEAST_RANGE_FRAMES = 4.0
VIDEO_STYLE = """
video{display:block;max-width:100%;max-height:480px;border-radius:4px}
section>figure+figure,section>.sheet+figure{margin-top:22px}
"""


@dataclass(frozen=True, eq=False)
class MeasuredImitation:
    """What the page shows.

    `comparison` | `stimulus_sd` (n, k), `imitation_sd` (m, k) | `rate_hz` of both or None | `names` of stimulus,
    imitation and model | `pairs` a few frames, label and the two pictures | `notes` to read first | `still` says that
    one does not move, or nothing | `read_in` whose model the imitation was read in, where it is another's than the
    stimulus' | `video` its file name, `panels` what it shows from left to right | `settings` name to value | `rows` of
    the table by name, `reasons` why cells of each are empty.
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


def imitation_page(shown: MeasuredImitation) -> str:
    """Give the page as HTML. Ours; the measures are those of Nagle section 5.1."""
    stimulus, imitation, model = shown.names
    where = f"Measured in the expression space of {model}"
    if shown.read_in:
        where += f"; the imitation was read in the model of {shown.read_in} and carried over by mimicry"
    title = f"{imitation} imitates {stimulus}"
    parts = [
        element("h1", text(title)),
        element("p", text(where), class_="kicker"),
        _figures(shown),
        notes_section(shown.notes),
        _faces(shown),
        _traces(shown),
        _timing(shown),
        _table(shown),
        _reading(shown),
        settings_section(shown.settings),
    ]
    return page_beside_a_video(title, STYLE + TRACE_STYLE + VIDEO_STYLE, parts)


def _last(shown: MeasuredImitation, name: str) -> float:
    return float(shown.comparison.measures[name][-1])


def number(value: float, decimals: int = 2) -> str:
    """Give a number for reading, a dash where it is undefined."""
    return f"{value + 0.0:.{decimals}f}" if np.isfinite(value) else DASH


def chance_words(p: float) -> str:
    """Give a p for reading."""
    return f"p {number(p, 3)}" if np.isfinite(p) else "p undefined"


def _figures(shown: MeasuredImitation) -> Html:
    alignment = shown.comparison.alignment
    lag = _last(shown, "lag_frames")
    in_s = f" ({lag / shown.rate_hz:+.2f} s)" if shown.rate_hz and np.isfinite(lag) else ""
    entries = [
        (
            number(_last(shown, "correlation")),
            f"correlation frame by frame, {chance_words(_last(shown, 'correlation_p'))}",
        ),
        (
            number(_last(shown, "correlation_at_lag")),
            f"correlation at the best lag, {chance_words(_last(shown, 'correlation_at_lag_p'))} with chance free to "
            "choose its lag",
        ),
        (f"{number(lag, 0)}", f"frames of lag{in_s}; above 0 the imitation is later"),
        (
            number(_last(shown, "correlation_aligned")),
            f"correlation after alignment, {chance_words(_last(shown, 'correlation_aligned_p'))} with chance aligned "
            "likewise",
        ),
        (number(alignment.timing_rms_frames, 1), "frames moved by alignment, rms"),
        (number(_last(shown, "gain")), "gain: size of the imitation's motion along the stimulus'"),
        (number(_last(shown, "distance_sd")), "SD of distance, root mean square over frames"),
    ]
    return key_figures(entries[-1:] if shown.still else entries)


def _faces(shown: MeasuredImitation) -> Html:
    pairs = [
        figure(
            pictures.photograph(
                pictures.stacked(upper, lower), f"{label}: stimulus above, imitation beneath"
            ),
            text(label),
        )
        for label, upper, lower in shown.pairs
    ]
    video = element("video", src=shown.video, controls="controls", loop="loop", muted="muted", playsinline="")
    return section(
        "faces",
        "Side by side",
        sentence("The stimulus above and the imitation beneath, both as the model draws their loadings."),
        element("div", *pairs, class_="sheet"),
        figure(video, text(f"From left to right: {', '.join(shown.panels)}.")),
    )


def _traces(shown: MeasuredImitation) -> Html:
    measures = shown.comparison.measures
    step, unit = (1 / shown.rate_hz, "s") if shown.rate_hz else (1.0, "frame")
    drawn = []
    for place in range(min(TRACES_SHOWN, shown.stimulus_sd.shape[1])):
        r, p = measures["correlation"][place], measures["correlation_p_familywise"][place]
        heading = f"{shown.rows[place]}: r {number(r)}, {chance_words(p)} among all components"
        plot = Plot(heading, unit, "SD", LEAST_RANGE_SD, SMALL_SIZE)
        picture = trace_plot(
            plot, shown.stimulus_sd[:, place].tolist(), shown.imitation_sd[:, place].tolist(), step
        )
        drawn.append(figure(picture, text(heading)))
    total = shown.stimulus_sd.shape[1]
    more = f" The first {TRACES_SHOWN} of {total} components." if total > TRACES_SHOWN else ""
    words = f"Loadings frame by frame, in SD of each component, as they were measured: not moved, not aligned.{more}"
    return section("traces", "Traces", sentence(words), element("div", *drawn, class_="pair"))


def _timing(shown: MeasuredImitation) -> Html:
    comparison = shown.comparison
    if shown.still:
        return section("timing", "Timing", *map(sentence, shown.still))
    parts = []
    lag = _last(shown, "lag_frames")
    if np.isfinite(lag):
        curve = np.nan_to_num(comparison.curve)
        place = int(np.flatnonzero(comparison.lags == int(lag))[0])
        plot = Plot(
            "Correlation of all components together at each lag",
            "lag, frames: the imitation is later to the right",
            "r",
            0.5,
            PLOT_SIZE,
            int(comparison.lags[0]),
        )
        dot = Mark(place, f"lag {int(lag)}, r {curve[place]:.2f}")
        level = Mark(0, f"without lag {number(_last(shown, 'correlation'))}")
        value = float(np.nan_to_num(_last(shown, "correlation")))
        parts.append(
            figure(
                line_plot(plot, curve.tolist(), dot=dot, level=level, level_value=value),
                text(
                    f"Lag: highest at {int(lag)} frames (dot), where r is {curve[place]:.2f}. Of a correlation so "
                    f"high at any lag {chance_words(_last(shown, 'correlation_at_lag_p'))}; it does not say how sure "
                    "the lag itself is."
                ),
            )
        )
    alignment = comparison.alignment
    delays = _delay_of_each(alignment.path, alignment.straight)
    plot = Plot(
        "How much later than evenly the imitation reaches each frame of the stimulus",
        "frame of the stimulus",
        "later by, frames",
        LEAST_RANGE_FRAMES,
    )
    parts.append(
        figure(
            line_plot(plot, delays.tolist()),
            text(
                f"Alignment (dynamic time warping): {len(alignment.path)} steps; frames are moved by "
                f"{alignment.timing_rms_frames:.1f} (rms), {alignment.delay_frames:+.1f} on average. What is left "
                f"after it is {number(_last(shown, 'alignment_cost'))} a step, where 0 is the same shape and "
                f"two unrelated motions are near 1.4 before it; {chance_words(_last(shown, 'alignment_cost_p'))}."
            ),
        )
    )
    return section("timing", "Timing", *parts)


def _delay_of_each(path: AnyArray, straight: AnyArray) -> AnyArray:
    frames = int(path[-1, 0]) + 1
    count = np.bincount(path[:, 0], minlength=frames)
    return np.asarray(np.bincount(path[:, 0], path[:, 1] - straight, minlength=frames) / count)


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


def _table(shown: MeasuredImitation) -> Html:
    measures = shown.comparison.measures
    order = [len(shown.rows) - 1, *range(len(shown.rows) - 1)]
    rows = [
        (
            text(shown.rows[place]),
            *(text(number(float(measures[name][place]), decimals)) for name, _, decimals in COLUMNS),
        )
        for place in order
    ]
    undefined: dict[str, list[str]] = {}
    for name, reason in zip(shown.rows, shown.reasons, strict=True):
        if reason:
            undefined.setdefault(reason, []).append(name)
    items = [element("li", text(f"{reason}: {', '.join(names)}")) for reason, names in undefined.items()]
    return section(
        "measures",
        "Measures",
        table(
            "All components together, and each. measures.csv has them in full.",
            ("Component", *(heading for _, heading, _ in COLUMNS)),
            rows,
        ),
        *([sentence("Undefined, shown as a dash:"), element("ul", *items)] if items else []),
    )


def _reading(shown: MeasuredImitation) -> Html:
    baseline = shown.comparison.baseline
    count, costly = len(baseline.shifts), len(baseline.costly)
    some = "all there are" if baseline.is_exhaustive else "a sample by the seed"
    least = {name: f"{value:.2g}" for name, value in baseline.least.items()}
    return section(
        "reading",
        "How to read the figures",
        sentence(
            f"Chance is the imitation turned in time, its end put before its beginning: {count} circular shifts "
            f"({some}), {costly} of them for mutual information. A turned motion is as smooth as the "
            "true one, so the smoothness which makes any two motions correlate is allowed for. Each p is one-sided "
            f"and can be no smaller than {least['frame_by_frame']} ({least['information']} for information). 'p of r, "
            "all tested' tests all components at once. A motion that repeats itself comes close at other shifts too, "
            "and its p stays large."
        ),
        sentence(
            "At the best lag and after alignment chance is something else, since a search undoes a shift: "
            f"{baseline.copies} copies of the imitation with the same spectrum and random phases, and as many cut in "
            f"pieces that are put together in another order; {baseline.costly_copies} of each for alignment. Every "
            "copy looks for its own best lag, or is aligned, as the true imitation was. The larger p of the two kinds "
            f"counts, and it can be no smaller than {least['lag']} ({least['alignment']} after alignment)."
        ),
        sentence(
            "So the p of r asks whether the imitation does the same at the same time, the p of r at best lag whether "
            "it does the same at some time. An imitation that is merely late has a small p of r at best lag, while its "
            "p of r may be large. Where a clip holds no more than one event, such as one smile, any other clip with "
            "one like it does the same at some time: look at the lag too, and take longer clips."
        ),
        sentence(
            "All components together are weighed by how much of the face they move and colour. Information and entropy "
            "are sums over components, which is right only as far as components are independent; both take frames for "
            "independent draws, so compare them with chance and between clips of like length, not with theory."
        ),
    )
