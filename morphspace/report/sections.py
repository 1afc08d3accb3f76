"""The sections of the report that show pictures and curves, one function each, in the order of the page."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.face.faceframe import mouth_region, rigid_region
from morphspace.model.model import MorphModel
from morphspace.model.passes import Build
from morphspace.report import pictures
from morphspace.report.advice import Advice, head_path
from morphspace.report.figures import FrameFigures
from morphspace.report.markup import (
    DASH,
    MINUS,
    NOTHING,
    TIMES,
    Html,
    element,
    figure,
    joined,
    section,
    sentence,
    table,
    text,
)
from morphspace.report.plots import SMALL_SIZE, Mark, Plot, line_plot, share_plot
from morphspace.report.provenance import mask_origin

COMPONENTS_SHOWN = 8
WORST_NAMED = 3  # in the plot
WORST_LISTED = 8  # in the table
REACHED_PERCENT = (90, 95, 99)
LEAST_RANGE_DB = 4.0  # of an axis, so that noise does not fill it
LEAST_RANGE_PX = 2.0
LEAST_RANGE_DEG = 1.0
LEAST_RANGE_PERCENT = 1.0
LEAST_RANGE_STOPS = 0.1


def explained(model: MorphModel) -> AnyArray:
    """Give the share of variance (k,) in percent that the first 1, 2, ... components explain together."""
    basis = model.basis
    dimensions = max(1, int((basis.weight > 0).sum()) - basis.rank)
    total = float(basis.variances.sum()) + basis.discarded_variance * dimensions
    return np.cumsum(basis.variances) / max(total, np.finfo(float).tiny) * 100


def key_figures(build: Build, figures: FrameFigures) -> Html:
    """Give the line of figures that sums up a build."""
    model = build.model
    shares = explained(model)
    worst_fold = 100 * float(figures.fold_fractions.max())
    entries = [
        (f"{len(model.training.frame_names)}", "frames"),
        (f"{model.size[0]} {TIMES} {model.size[1]}", f"px, width {TIMES} height"),
        (f"{model.rank}", "components"),
        (f"{percent(shares[-1])} %" if model.rank else DASH, "of variance explained"),
        (f"{np.median(figures.psnr_db):.1f} dB", "PSNR, median frame"),
        (f"{np.percentile(figures.psnr_db, 10):.1f} dB", "PSNR, 10th percentile"),
        (f"{100 * figures.fold_fractions.mean():.2f} %", f"of the face folds; at worst {worst_fold:.2f} %"),
    ]
    cells = [element("div", element("dt", text(what)), element("dd", text(value))) for value, what in entries]
    return element("dl", *cells, class_="figures")


def percent(share: float) -> str:
    """Give a percentage with enough decimals that what is missing to 100 shows."""
    return f"{min(share, 99.99):.2f}" if 99 <= share < 99.995 else f"{share:.1f}"


def advice_box(found: tuple[Advice, ...]) -> Html:
    """Give the advice, or the good news that there is none."""
    mend = [element("li", text(advice.text)) for advice in found if advice.level == "mend"]
    consider = [
        element("li", text(advice.text), class_="consider") for advice in found if advice.level == "consider"
    ]
    if mend:
        heading = "One thing to mend" if len(mend) == 1 else f"{len(mend)} things to mend"
    else:
        heading = "Nothing to mend"
    notes = NOTHING
    if consider:
        notes = element("p", text("To consider:" if mend else "You may still consider:"), class_="consider")
    parts = [element("ul", *mend)] if mend else []
    parts += [notes, element("ul", *consider)] if consider else []
    if not parts:
        parts = [sentence("Head, light, mouth, folds, mask and reconstruction are all as they should be.")]
    kind = "advice" if mend else "advice fine"
    return element("section", element("h2", text(heading)), *parts, class_=kind, id="advice")


def faces_section(build: Build) -> Html:
    """Show the reference, the mean face, and on it the mask and the parts of the face that were measured."""
    model = build.model
    height, width = model.mask.shape
    mean = model.mean.render()
    rigid = rigid_region(height, width, model.faceframe)
    mouth = mouth_region(height, width, model.faceframe)
    lines = pictures.outlines(model.mask, "halo") + pictures.outlines(model.mask, "mask")
    lines += pictures.outlines(rigid, "rigid") + pictures.outlines(mouth, "mouth")
    if model.faceframe is not None:
        lines += [
            element("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r="2.2")
            for x, y in model.faceframe.points.tolist()
        ]
    marked = pictures.drawn_over(
        pictures.photograph(mean, "Mean face with the outlines of mask, rigid part and mouth"), mean, lines
    )
    points = ", dots: faceframe" if model.faceframe is not None else ""
    reason = build.choice.reason
    panels = [
        figure(
            pictures.photograph(model.reference, "Reference frame"),
            element("strong", text("Reference.")),
            text(f" {build.choice.name}: {reason}."),
        ),
        figure(
            pictures.photograph(mean, "Mean face"),
            element("strong", text("Mean face.")),
            text(" The mean texture on the mean shape; all loadings 0."),
        ),
        figure(
            marked,
            element("strong", text("Mask.")),
            text(
                f" White: where the mask passes one half, {100 * model.mask.mean():.0f} % of the frame; it is "
                f"{mask_origin(model)}. Dashed: "
                f"the rigid part. Dotted: where the mouth is looked for{points}."
            ),
        ),
    ]
    return section("faces", "Reference, mean and mask", element("div", *panels, class_="faces"))


def sheet_section(build: Build, figures: FrameFigures) -> Html:
    """Show some frames evenly spread over the clip: aligned above, drawn from the loadings beneath."""
    names = build.model.training.frame_names
    shown = []
    for item in figures.sheet:
        name = names[item.index]
        picture = pictures.photograph(
            pictures.stacked(item.original, item.rebuilt), f"{name}: aligned frame above, rebuilt beneath"
        )
        role = ", reference" if item.index == build.choice.index else ""
        shown.append(
            figure(
                picture, text(f"{name}{role}"), Html("<br>"), text(f"{figures.psnr_db[item.index]:.1f} dB")
            )
        )
    note = sentence(
        f"{len(shown)} of {len(names)} frames, evenly spread. Above: the frame aligned to the reference. Beneath: the "
        f"same drawn from its {build.model.rank} loadings, with its PSNR inside the mask."
    )
    return section("sheet", "Contact sheet", note, element("div", *shown, class_="sheet"))


def components_section(model: MorphModel) -> Html:
    """Show the first components from -2 to +2 SD, and where on the face each acts."""
    heading = "Components"
    if model.rank == 0:
        return section(
            "components", heading, sentence("The frames do not differ, so there are no components.")
        )
    shares = np.diff(explained(model), prepend=0)
    strips = list(pictures.component_strips(model, COMPONENTS_SHOWN))
    full = max(float(strip.change.max()) for strip in strips)
    rows = []
    for number, strip in enumerate(strips):
        label = f"Component {number + 1}"
        cells = [
            figure(
                pictures.photograph(picture, f"{label} at {_signed(amount)} SD"),
                text(f"{_signed(amount)} SD"),
            )
            for amount, picture in zip(pictures.STRIP_AMOUNTS_SD, strip.pictures, strict=True)
        ]
        chart = pictures.change_chart(strip.change, full)
        cells.append(
            figure(pictures.chart(chart, f"Where {label.lower()} changes the picture"), text("change"))
        )
        words = [
            element("h3", text(label)),
            sentence(f"{shares[number]:.1f} % of variance"),
            sentence(
                f"1 SD = {model.sd[number]:.3g} units: moves {strip.motion_px:.2f} px and colours "
                f"{100 * strip.colour:.2f} % (rms)"
            ),
        ]
        rows.append(
            element("div", element("div", *words), element("div", *cells, class_="strip"), class_="component")
        )
    note = sentence(
        f"The first {len(rows)} of {model.rank}. Loadings are in units of the model's inner product (colour 0 to 1, "
        f"warp weighted by {model.warp_weight:.3g} per px, summed over the mask). The last column shows where "
        f"{MINUS}2 and +2 SD differ: white not at all, dark by {100 * full:.0f} % of luma, the same scale for all."
    )
    return section("components", heading, note, *rows)


def variance_section(model: MorphModel) -> Html:
    """Plot the share of variance that the first components explain together."""
    heading = "Variance explained"
    if model.rank == 0:
        return section("variance", heading, sentence("There is no variance to explain."))
    shares = explained(model)
    reached: list[Mark] = []
    for wanted in REACHED_PERCENT:
        enough = np.flatnonzero(shares >= wanted)
        if enough.size and (not reached or reached[-1].index != enough[0] + 1):
            reached.append(Mark(int(enough[0]) + 1, f"{wanted} % with {enough[0] + 1}"))
    words = "; ".join(mark.label for mark in reached) or f"{shares[-1]:.1f} % with all {model.rank}"
    plot = Plot(f"Cumulative share of variance: {words}", "components", "variance, %", 0.0)
    caption = text(
        f"Cumulative share of the variance of the training frames, in the model's inner product; all {model.rank} "
        f"components together {percent(shares[-1])} %."
    )
    return section("variance", heading, figure(share_plot(plot, shares.tolist(), reached), caption))


def reconstruction_section(build: Build, figures: FrameFigures) -> Html:
    """Plot each frame's PSNR and list the worst frames with all their figures."""
    names = build.model.training.frame_names
    order = np.argsort(figures.psnr_db, kind="stable")
    median = float(np.median(figures.psnr_db))
    below = [int(i) for i in order[:WORST_NAMED] if figures.psnr_db[i] < median]
    worst = [Mark(i, f"{names[i]}  {figures.psnr_db[i]:.1f} dB") for i in below]
    plot = Plot(
        f"PSNR of each frame; median {median:.1f} dB; lowest: {', '.join(mark.label for mark in worst) or 'all alike'}",
        "frame",
        "PSNR, dB",
        LEAST_RANGE_DB,
    )
    drawn = line_plot(
        plot,
        figures.psnr_db.tolist(),
        level=Mark(0, f"median {median:.1f} dB"),
        level_value=median,
        worst=worst,
        dot=Mark(build.choice.index, f"reference {build.choice.name}"),
    )
    caption = text(
        "PSNR (dB, peak 1) inside the mask of each aligned frame drawn from all its loadings; 120 dB means equal. The "
        "dot is the reference. These are training frames: new images come back less well."
    )
    rows = [
        [
            text(names[i]),
            text(f"{figures.psnr_db[i]:.1f}"),
            text(f"{100 * figures.fold_fractions[i]:.2f}"),
            text(f"{build.motion_px[i]:.1f}"),
            text(f"{build.confidences[i]:.2f}"),
            text(f"{figures.exposure_stops[i]:+.2f}".replace("-", MINUS)),
            text(f"{figures.luminance[i]:.3f}"),
            text(f"{figures.mahalanobis[i]:.1f}"),
        ]
        for i in order[:WORST_LISTED]
    ]
    columns = [
        "Frame",
        "PSNR, dB",
        "Folds, %",
        "Motion, px rms",
        "Flow confidence",
        "Exposure, stops",
        "Luma, 0 to 1",
        "Length, SD",
    ]
    listed = table("The frames that come back least well, and what else was measured on them.", columns, rows)
    return section("frames", "Reconstruction of each frame", figure(drawn, caption), listed)


def movement_section(build: Build, figures: FrameFigures) -> Html:
    """Plot the registration path and the light."""
    path = head_path(build.registrations, build.model.size)
    curves = [
        ("Shift to the right", "px", path.shift_px[:, 0], LEAST_RANGE_PX),
        ("Shift down", "px", path.shift_px[:, 1], LEAST_RANGE_PX),
        ("Tilt, clockwise", "degrees", path.turn_deg, LEAST_RANGE_DEG),
        ("Size", "% of the reference", 100 * path.scale, LEAST_RANGE_PERCENT),
        ("Light on brow and nose", "stops against the reference", figures.exposure_stops, LEAST_RANGE_STOPS),
        ("Movement left in brow and nose", "px rms", figures.rigid_motion_px, LEAST_RANGE_PX),
    ]
    dot = Mark(build.choice.index, f"reference {build.choice.name}")
    drawn = []
    for name, unit, values, least in curves:
        low, high = float(values.min()), float(values.max())
        plot = Plot(f"{name} of each frame: {low:.2f} to {high:.2f} {unit}", "frame", unit, least, SMALL_SIZE)
        drawn.append(
            figure(
                line_plot(plot, values.tolist(), dot=dot), element("strong", text(name)), text(f", {unit}")
            )
        )
    kind = build.model.registration
    how = (
        "No registration was asked for."
        if kind == "none"
        else f"Registration: {kind}, fitted on brow to nose."
    )
    note = sentence(
        f"{how} The curves give where the centre of each frame's face was found against the reference, before it was "
        "brought there. The dot is the reference."
    )
    return section("movement", "Head movement and light", note, element("div", *drawn, class_="pair"))


def trials_section(build: Build) -> Html:
    """List the warp weights that were tried."""
    model = build.model
    if not build.trials:
        words = (
            f"The warp weight {model.warp_weight:.4g} (colour per px) was given, "
            "or nothing moved that could be weighed."
        )
        return section("weight", "Warp weight", sentence(words))
    rows = joined(
        element(
            "tr",
            element("th", text(f"{trial.weight:.4g}"), scope="row"),
            element("td", text(f"{trial.psnr_db:.2f}")),
            element("td", text("chosen" if trial.weight == model.warp_weight else "")),
            class_="chosen" if trial.weight == model.warp_weight else "tried",
        )
        for trial in build.trials
    )
    head = element(
        "tr", *(element("th", text(name), scope="col") for name in ("Weight", "PSNR, dB", "Choice"))
    )
    caption = (
        "How much 1 px of warp counts against colour (0 to 1), and the mean PSNR of held-out frames with it."
    )
    content = element(
        "table",
        element("caption", text(caption)),
        element("thead", head),
        element("tbody", rows),
        class_="few",
    )
    return section("weight", "Warp weight", element("div", content, class_="wide"))


def _signed(amount: int) -> str:
    return f"{amount:+d}".replace("-", MINUS) if amount else "0"
