"""The page of a build: what the model has learnt, where it is inaccurate, its settings and its provenance (ours)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from morphspace.arrays import AnyArray
from morphspace.face.mesh import APERTURES, FEATURES
from morphspace.face.regions import mouth_surroundings, rigid_region
from morphspace.face.track import turn_words
from morphspace.model.carried import FRAMES
from morphspace.model.model import MorphModel
from morphspace.model.passes import Build
from morphspace.report import pictures
from morphspace.report.advice.build import Case, advice_for, head_path
from morphspace.report.components import Components, components_of
from morphspace.report.frames import FrameFigures
from morphspace.report.page import TIMES, Panel, fixed, markup, percent, render, signed
from morphspace.report.plots import SMALL_SIZE, Mark, Plot, line_plot
from morphspace.storage import write_text

FOLD_MAPS = 4  # frames; the ones that fold most are drawn
LIST_SHOWN = 6  # entries; longer lists are collapsed
WORST_NAMED = 3  # frames named in a plot
WORST_LISTED = 8  # frames in the table
# least ranges of the axes, so that noise does not fill them
LEAST_RANGE_CONFIDENCE = 0.1
LEAST_RANGE_DB = 4.0
LEAST_RANGE_DEG = 1.0
LEAST_RANGE_FOLDS_PERCENT = 0.5
LEAST_RANGE_PX = 2.0
LEAST_RANGE_SIZE_PERCENT = 1.0
LEAST_RANGE_STOPS = 0.1
FIRST_KEYS = ("identity", "consent", "licence")  # provenance that is listed first
SHOWN_ABOVE = ("reference", "flow_start", "components_asked", "warp_weight_trials", "mask_from", "landmarks")
NOT_RECORDED = "not recorded"
MASK_ORIGINS = {
    "given": "drawn by the user",
    "found face": "an ellipse placed by the face detected in the reference",
    "ellipse": "a central ellipse, for cropped faces",
    "faceframe": "an ellipse placed by the marked faceframe",
}


@dataclass(frozen=True, eq=False)
class BuildPage:
    """The contents of `build.html` for the build `build`, in the order of the page."""

    title: str
    build: Build
    key_figures: Sequence[tuple[str, str]]
    mend: Sequence[str]
    consider: Sequence[str]
    reference: Markup
    mean: Markup
    marked: Markup
    mask_origin: str
    sheet: Sequence[Panel]
    components: Components
    psnr_plot: Markup
    worst_frames: Sequence[Sequence[str]]
    confidence_plot: Markup | None
    confidence_map: Markup | None
    confidence_range: str
    flow_plots: Sequence[Panel]
    carried: Sequence[tuple[str, ...]]
    carried_frames: int
    folded_frames: int
    fold_maps: Sequence[Panel]
    movement_plots: Sequence[Panel]
    trials: Sequence[Sequence[str]]
    chosen_trial: Mapping[int, str]
    settings: Sequence[tuple[str, Any]]
    provenance: Sequence[tuple[str, Any]]
    list_shown: int = LIST_SHOWN


def write_build_page(
    path: Path, build: Build, figures: FrameFigures, *, source_size: tuple[int, int] | None = None
) -> None:
    """Write the page to `path`; parameters as for `build_page`. Raises `UnwritableFile` if that fails."""
    write_text(Path(path), build_page(build, figures, source_size=source_size))


def build_page(build: Build, figures: FrameFigures, *, source_size: tuple[int, int] | None = None) -> str:
    """Return the page of a build as HTML. Ours.

    Parameters
    ----------
    build : Build
        The build, while its work folder exists.
    figures : FrameFigures
        The figures of its frames (`measure_frames`).
    source_size : (int, int), optional
        Width and height (px) of the original pictures after cropping; None if unknown.
    """
    model = build.model
    found = advice_for(Case(build, figures, source_size))
    mean = model.mean.render()
    components = components_of(model)
    has_confidence = bool((build.confidences < 1).any())
    inside = build.confidence_map[model.mask > 0.5]
    low, high = (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)
    confidence_range = f"{low:.2f} to {high:.2f}"
    page = BuildPage(
        title=f"{model.identity}: build report",
        build=build,
        key_figures=_key_figures(build, figures, components.explained),
        mend=[advice.text for advice in found if advice.level == "mend"],
        consider=[advice.text for advice in found if advice.level == "consider"],
        reference=pictures.photograph(model.reference, "Reference frame"),
        mean=pictures.photograph(mean, "Mean face"),
        marked=_marked(model, mean),
        mask_origin=_mask_origin(model),
        sheet=_sheet(build, figures),
        components=components,
        psnr_plot=_plot_of_worst(build, figures.psnr_db, "PSNR", "PSNR, dB", LEAST_RANGE_DB, "{:.1f} dB"),
        worst_frames=_worst_frames(build, figures),
        confidence_plot=_plot_of_worst(
            build,
            build.confidences,
            "Flow confidence",
            "confidence, 0 to 1",
            LEAST_RANGE_CONFIDENCE,
            "{:.2f}",
        )
        if has_confidence
        else None,
        confidence_map=pictures.chart(
            pictures.confidence_chart(mean, build.confidence_map, model.mask),
            f"Mean confidence of the flow on the mean face, {confidence_range}",
        )
        if has_confidence
        else None,
        confidence_range=confidence_range,
        flow_plots=[
            _curve(
                build,
                "Folds of the flow",
                "% of the face",
                100 * build.fold_fractions,
                LEAST_RANGE_FOLDS_PERCENT,
                0.0,
            ),
            _curve(build, "Motion", "px rms", build.motion_px, LEAST_RANGE_PX, 0.0),
        ],
        carried=_carried(build),
        carried_frames=FRAMES,
        folded_frames=int((figures.fold_fractions > 0).sum()),
        fold_maps=_fold_maps(model, figures.fold_fractions),
        movement_plots=_movement_plots(build, figures),
        trials=[
            (
                f"{trial.weight:.4g}",
                f"{trial.psnr_db:.2f}",
                "chosen" if trial.weight == model.warp_weight else "",
            )
            for trial in build.trials
        ],
        chosen_trial={
            row: "chosen" for row, trial in enumerate(build.trials) if trial.weight == model.warp_weight
        },
        settings=_settings(build),
        provenance=_provenance(model),
    )
    return render("build.html", page)


def _key_figures(build: Build, figures: FrameFigures, explained: str) -> list[tuple[str, str]]:
    model, psnr, folds = build.model, figures.psnr_db, figures.fold_fractions
    held_out = build.held_out_db
    first = [(f"{held_out:.1f} dB", "PSNR of frames left out of the components")] if held_out else []
    return [
        *first,
        (f"{len(model.training.frame_names)}", "frames"),
        (f"{model.size[0]} {TIMES} {model.size[1]}", f"px, width {TIMES} height"),
        (f"{model.rank}", "components"),
        (explained, "of variance explained"),
        (f"{np.median(psnr):.1f} dB", "PSNR, median training frame"),
        (f"{np.percentile(psnr, 10):.1f} dB", "PSNR, 10th percentile"),
        (percent(folds.mean(), 2), f"of the face folds; {percent(folds.max(), 2)} in the worst frame"),
    ]


def _marked(model: MorphModel, mean: AnyArray) -> Markup:
    """Draw the mask and the measured parts of the face on the mean face."""
    height, width = model.mask.shape
    lines = pictures.outlines(model.mask, "halo") + pictures.outlines(model.mask, "mask")
    lines += pictures.outlines(rigid_region(height, width, model.faceframe), "rigid")
    lines += pictures.outlines(mouth_surroundings(height, width, model.faceframe), "mouth")
    if model.faceframe is not None:
        for x, y in model.faceframe.points.tolist():
            lines += markup('<circle cx="{x}" cy="{y}" r="2.2"/>', x=f"{x:.1f}", y=f"{y:.1f}")
    photograph = pictures.photograph(mean, "Mean face with the outlines of mask, rigid part and mouth")
    return pictures.drawn_over(photograph, mean, lines)


def _carried(build: Build) -> list[tuple[str, ...]]:
    """Return a row for each feature: left over, slope by the warp alone, and motion; an opening has a slope only."""
    if build.carried is None:
        return []
    figures = (build.carried.left_over, build.carried.slopes, build.carried.motion)
    features = [
        (name, *(f"{value:.2f}" for value in row)) for name, *row in zip(FEATURES, *figures, strict=True)
    ]
    openings = zip(APERTURES, build.carried.openings, strict=True)
    return [*features, *((name, "", f"{slope:.2f}", "") for name, slope in openings)]


def _sheet(build: Build, figures: FrameFigures) -> list[Panel]:
    panels = []
    for item in figures.sheet:
        name = build.model.training.frame_names[item.index]
        picture = pictures.photograph(
            pictures.stacked(item.original, item.rebuilt), f"{name}: aligned frame above, rebuilt beneath"
        )
        role = ", reference" if item.index == build.choice.index else ""
        panels.append(Panel(picture, f"{name}{role}", f"{figures.psnr_db[item.index]:.1f} dB"))
    return panels


def _plot_of_worst(
    build: Build, values: AnyArray, name: str, y_title: str, least: float, form: str
) -> Markup:
    """Plot a value of each frame with its median, the reference and the names of the lowest."""
    names = build.model.training.frame_names
    median = float(np.median(values))
    lowest = (int(i) for i in np.argsort(values, kind="stable")[:WORST_NAMED])
    worst = [Mark(i, f"{names[i]}  {form.format(values[i])}") for i in lowest if values[i] < median]
    level = f"median {form.format(median)}"
    listed = ", ".join(mark.label for mark in worst) or "all alike"
    plot = Plot(f"{name} of each frame; {level}; lowest: {listed}", "frame", y_title, least)
    return line_plot(plot, values.tolist(), level=(median, level), worst=worst, dot=_reference_dot(build))


def _curve(
    build: Build, name: str, unit: str, values: AnyArray, least: float, lowest: float = -np.inf
) -> Panel:
    words = f"{name} of each frame: {values.min():.2f} to {values.max():.2f} {unit}"
    plot = Plot(words, "frame", unit, least, SMALL_SIZE, lowest=lowest)
    return Panel(line_plot(plot, values.tolist(), dot=_reference_dot(build)), name, f", {unit}")


def _reference_dot(build: Build) -> Mark:
    return Mark(build.choice.index, f"reference {build.choice.name}")


def _worst_frames(build: Build, figures: FrameFigures) -> list[Sequence[str]]:
    names = build.model.training.frame_names
    return [
        (
            names[i],
            f"{figures.psnr_db[i]:.1f}",
            f"{100 * figures.fold_fractions[i]:.2f}",
            f"{build.motion_px[i]:.1f}",
            f"{build.confidences[i]:.2f}",
            signed(figures.exposure_stops[i], 2),
            f"{figures.luminance[i]:.3f}",
            f"{figures.mahalanobis[i]:.1f}",
        )
        for i in np.argsort(figures.psnr_db, kind="stable")[:WORST_LISTED]
    ]


def _fold_maps(model: MorphModel, folds: AnyArray) -> list[Panel]:
    """Draw the fold maps of the worst frames."""
    maps = []
    for i in np.argsort(-folds, kind="stable")[:FOLD_MAPS]:
        if folds[i] > 0:
            name = model.training.frame_names[i]
            chart = pictures.fold_chart(model.expand(model.training.values[i]), model.mask)
            note = f" folds {percent(folds[i], 2)} of the face."
            maps.append(Panel(pictures.chart(chart, f"Fold map of {name}"), name, note))
    return maps


def _movement_plots(build: Build, figures: FrameFigures) -> list[Panel]:
    path = head_path(build.registrations, build.model.size)
    light, moved = figures.exposure_stops, figures.rigid_motion_px
    return [
        _curve(build, "Shift to the right", "px", path.shift_px[:, 0], LEAST_RANGE_PX),
        _curve(build, "Shift down", "px", path.shift_px[:, 1], LEAST_RANGE_PX),
        _curve(build, "Tilt, clockwise", "degrees", path.turn_deg, LEAST_RANGE_DEG),
        _curve(build, "Size", "% of the reference", 100 * path.scale, LEAST_RANGE_SIZE_PERCENT),
        _curve(build, "Light on brow and nose", "stops against the reference", light, LEAST_RANGE_STOPS),
        _curve(build, "Movement left in brow and nose", "px rms", moved, LEAST_RANGE_PX),
    ]


def _settings(build: Build) -> list[tuple[str, Any]]:
    model, provenance = build.model, build.model.provenance
    asked = provenance.get("components_asked", NOT_RECORDED)
    return [
        ("Model", model.model_id),
        ("Size, px", f"{model.size[0]} {TIMES} {model.size[1]}"),
        ("Frames", len(model.training.frame_names)),
        ("Reference", build.choice.name),
        ("Reference picture, SHA-256", provenance.get("reference", {}).get("sha256", NOT_RECORDED)),
        ("Crop", _crop(model)),
        ("Face points", _face_points(build)),
        ("Turn of the head", turn_words(build.model.provenance.get("landmarks")) or NOT_RECORDED),
        ("Registration", model.registration),
        ("Flow", model.flow),
        ("Second start for hard frames", provenance.get("flow_start", NOT_RECORDED)),
        ("Components asked for, found", f"{asked}, {model.rank}"),
        ("Warp weight, colour per px", f"{model.warp_weight:.6g}"),
        ("Variance left out, per dimension", f"{model.basis.discarded_variance:.4g}"),
        ("Mask", f"{_mask_origin(model)}, {percent(float(model.mask.mean()), 1)} of the frame"),
        ("Faceframe on the mean face (x, y), px", _faceframe(model)),
    ]


def _provenance(model: MorphModel) -> list[tuple[str, Any]]:
    document = {key: model.provenance.get(key) or NOT_RECORDED for key in FIRST_KEYS}
    document |= {key: value for key, value in model.provenance.items() if key not in FIRST_KEYS + SHOWN_ABOVE}
    return list(flattened(document))


def flattened(document: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield the entries of a nested document, each with its path of keys."""
    for key, value in document.items():
        keys = (*above, str(key).replace("_", " "))
        if isinstance(value, Mapping) and value:
            yield from flattened(value, keys)
        else:
            yield " / ".join(keys), value


def _mask_origin(model: MorphModel) -> str:
    return MASK_ORIGINS.get(str(model.provenance.get("mask_from")), NOT_RECORDED)


def _crop(model: MorphModel) -> str:
    """Describe the used part of the pictures and how it was found."""
    framing = model.provenance.get("framing", {})
    crop = framing.get("crop")
    if crop is None:
        return "none, whole pictures"
    box = "x {}, y {}, {} {} {} px".format(*crop[:3], TIMES, crop[3])
    found = framing.get("crop_found")
    if found is None:
        return f"{box}, as given"
    return f"{box}, around the head as found in {found['found']} of {found['frames']} frames"


def _face_points(build: Build) -> str:
    """Describe in how many frames the face was found."""
    if build.track is None:
        return "not searched"
    without = "" if build.track.known.all() else "; the flow of the others is not held"
    return build.track.words + without


def _faceframe(model: MorphModel) -> str:
    """Describe the faceframe's points and their origin."""
    if model.faceframe is None:
        return "not marked"
    names = ("right eye", "left eye", "philtrum")
    points = "; ".join(
        f"{name} {fixed(x, 1)}, {fixed(y, 1)}"
        for name, (x, y) in zip(names, model.faceframe.points.tolist(), strict=True)
    )
    origin = model.provenance.get("keypoints")
    if isinstance(origin, Mapping) and origin.get("source") == "auto":
        return f"{points}; detected in {origin['found']} of {origin['faces']} faces of the model"
    return f"{points}; as marked"
