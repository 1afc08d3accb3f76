"""The sections of the report on the flow: how sure it was, how far it moves the face, and where it folds."""

from __future__ import annotations

import numpy as np

from morphspace.model.passes import Build
from morphspace.report import pictures
from morphspace.report.figures import FrameFigures
from morphspace.report.markup import Html, element, figure, section, sentence, text
from morphspace.report.plots import SMALL_SIZE, Mark, Plot, line_plot

FOLD_MAPS = 4
WORST_NAMED = 3  # in the plot
LEAST_RANGE_CONFIDENCE = 0.1  # of an axis, so that noise does not fill it
LEAST_RANGE_PERCENT = 0.5
LEAST_RANGE_PX = 2.0


def flow_section(build: Build) -> Html:
    """Show the flow's confidence, folds and motion frame by frame, and its mean confidence on the mean face."""
    tells = bool((build.confidences < 1).any())
    parts = [sentence(_search_words(build))]
    if tells:
        parts += [_confidence_plot(build)]
    else:
        parts.append(
            sentence("This flow method does not tell how sure it is: its confidence counts as 1 everywhere.")
        )
    curves = [
        ("Folds of the flow", "% of the face", 100 * build.fold_fractions, LEAST_RANGE_PERCENT),
        ("Motion", "px rms", build.motion_px, LEAST_RANGE_PX),
    ]
    dot = Mark(build.choice.index, f"reference {build.choice.name}")
    drawn = []
    for name, unit, values, least in curves:
        words = f"{name} of each frame: {values.min():.2f} to {values.max():.2f} {unit}"
        plot = Plot(words, "frame", unit, least, SMALL_SIZE, lowest=0.0)
        drawn.append(
            figure(
                line_plot(plot, values.tolist(), dot=dot), element("strong", text(name)), text(f", {unit}")
            )
        )
    parts.append(element("div", *drawn, class_="pair"))
    if tells:
        parts.append(element("div", _confidence_map(build), class_="maps"))
    return section("flow", "Flow", *parts)


def _search_words(build: Build) -> str:
    """Say how the flow was searched, and in how many frames a neighbour's field was the better start."""
    model = build.model
    words = f"Flow from the reference to each frame by {model.flow}"
    if model.provenance.get("flow_start") == "none":
        return f"{words}, each searched coarse to fine; no second start was asked for."
    count = int(build.from_neighbour.sum())
    tried = f"{words}, searched coarse to fine. Hard frames were tried again from the flow of the frame before or after"
    if count == 0:
        return f"{tried}; none came out clearly better by it."
    frames = "1 frame" if count == 1 else f"{count} frames"
    return (
        f"{tried}, and {frames} of {len(build.from_neighbour)} kept it: there it explained the picture clearly better "
        "without folding more."
    )


def _confidence_plot(build: Build) -> Html:
    names, values = build.model.training.frame_names, build.confidences
    median = float(np.median(values))
    order = np.argsort(values, kind="stable")[:WORST_NAMED]
    worst = [Mark(int(i), f"{names[i]}  {values[i]:.2f}") for i in order if values[i] < median]
    listed = ", ".join(mark.label for mark in worst) or "all alike"
    plot = Plot(
        f"Flow confidence of each frame; median {median:.2f}; lowest: {listed}",
        "frame",
        "confidence, 0 to 1",
        LEAST_RANGE_CONFIDENCE,
    )
    drawn = line_plot(
        plot,
        values.tolist(),
        level=Mark(0, f"median {median:.2f}"),
        level_value=median,
        worst=worst,
        dot=Mark(build.choice.index, f"reference {build.choice.name}"),
    )
    return figure(
        drawn,
        text(
            "Mean confidence of each frame's flow inside the mask: 1 where the frame shows where a point went, 0 where "
            "it is hidden or without texture and the flow was filled in from around. The dot is the reference, which "
            "is found in itself."
        ),
    )


def _confidence_map(build: Build) -> Html:
    model = build.model
    chart = pictures.confidence_chart(model.mean.render(), build.confidence_map, model.mask)
    inside = build.confidence_map[model.mask > 0.5]
    low, high = (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)
    return figure(
        pictures.chart(chart, f"Mean confidence of the flow on the mean face, {low:.2f} to {high:.2f}"),
        element("strong", text("Mean confidence.")),
        text(
            f" On the mean face, over all frames, {low:.2f} to {high:.2f} inside the mask. The face alone means 1, "
            "full violet 0; outside the mask nothing is drawn."
        ),
    )


def folds_section(build: Build, figures: FrameFigures) -> Html:
    """Show where the worst frames fold; nothing where none does."""
    folds = figures.fold_fractions
    order = [int(i) for i in np.argsort(-folds, kind="stable")[:FOLD_MAPS] if folds[i] > 0]
    if not order:
        return section("folds", "Folds", sentence("No frame's warp turns any of the face over."))
    model = build.model
    maps = []
    for i in order:
        name = model.training.frame_names[i]
        chart = pictures.fold_chart(model.expand(model.training.values[i]), model.mask)
        maps.append(
            figure(
                pictures.chart(chart, f"Fold map of {name}"),
                element("strong", text(name)),
                text(f" folds {100 * folds[i]:.2f} % of the face."),
            )
        )
    note = sentence(
        f"{int((folds > 0).sum())} of {len(folds)} frames fold somewhere in the mask. The worst are shown "
        "as their texture on the mean face: the warp turns red cells over (determinant 0 or less), and the orange ones "
        "too, but those lie outside the mask."
    )
    return section("folds", "Folds", note, element("div", *maps, class_="maps"))
