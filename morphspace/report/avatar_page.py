"""The page of a blend: each version beside its blend, the sharpness, and the versions that were left out.

The pixel average of the same pictures (Galton, Journal of the Anthropological Institute 8, 1878) stands beside the
blend: it is a blend without correspondence. The blend is that of Nagle section 4; the measures are ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.avatar import Avatar, AvatarSettings
from morphspace.avatar.distances import MeanDistances, mean_face_distances
from morphspace.avatar.settings import AUTO, EXPRESSION
from morphspace.model.landmarks import LEAST_FACES
from morphspace.model.model import MorphModel
from morphspace.report import pictures
from morphspace.report.components import Components, components_of, explained
from morphspace.report.frames import small
from morphspace.report.page import DASH, Panel, fixed, percent, render
from morphspace.steps import Step, Steps, spread

SHEET_ROWS = 24  # largest number of rows; the work folder has all expressions
LEAST_SHARE_OF_SHEET = 0.25  # of the rows; reserved for expressions with most versions left out
FULL_PART = 0.75  # of its nominal weight; below it a version is listed as having less weight
LARGE_FACES = 3  # pairs of blend and pixel average at full size
SOURCES_SHOWN = 60  # largest number of rows of the table of expressions with versions left out
COMPONENTS_LISTED = 12  # components, at most, in the table
PICTURES_MADE = {
    "unsharpened": "blend before the unsharp mask",
    "pictures": "blended pictures, sharpened",
    "blend": "blend",
    "pixel average": "pixel average",
}


@dataclass(frozen=True, eq=False)
class ExpressionRow:
    """One row of the contact sheet: pictures (h, w, 3) of one expression.

    Attributes
    ----------
    index
        Number of the expression.
    versions
        The blended versions, aligned, one for each identity.
    blend
        The blend of the versions.
    pixel_average
        Average of the same versions with the same weights, without any warp.
    """

    index: int
    versions: Sequence[Image]
    blend: Image
    pixel_average: Image


@dataclass(frozen=True, eq=False)
class AvatarResult:
    """A blend of k identities and n expressions, with the figures of its page.

    Attributes
    ----------
    model
        The avatar.
    identities
        k names.
    asked
        (k,) requested weights, sum 1.
    sources
        (n,) index of the identity of each expression.
    frames
        (n,) name of its training frame, in the order of the model's training rows.
    used
        (n, k) weights of the versions, 0 for a version left out.
    plausibility
        (n, k), 0 to 1.
    rows
        Rows of the contact sheet.
    sharpness
        Variance of the Laplacian inside the mask, of "sources" (k,), "blend", "pixel average" and, if known,
        "pictures"
        and "unsharpened".
    sharpen
        Amount of the unsharp mask.
    surround
        Identity of hair, neck and background.
    distances
        Distances between the mean faces; None if unknown.
    notes
        Notes to read first.
    settings
        Name to value.
    """

    model: MorphModel
    identities: tuple[str, ...]
    asked: AnyArray
    sources: Sequence[int]
    frames: Sequence[str]
    used: AnyArray
    plausibility: AnyArray
    rows: Sequence[ExpressionRow]
    sharpness: Mapping[str, Any]
    sharpen: float
    surround: str
    distances: MeanDistances | None
    notes: Sequence[str]
    settings: Mapping[str, str]

    def label(self, index: int) -> str:
        """Name an expression by its identity and its frame."""
        return f"{self.identities[self.sources[index]]}, {self.frames[index]}"


def avatar_result(
    avatar: Avatar, models: Sequence[MorphModel], settings: AvatarSettings
) -> Steps[AvatarResult]:
    """Collect the contents of the page of a blend."""
    used = np.array([one.weights for one in avatar.expressions])
    picked = rows_shown(used, avatar.weights)
    rows = []
    for index in picked:
        rows.append(
            ExpressionRow(index, avatar.versions(index), avatar.blend(index), avatar.pixel_average(index))
        )
        yield Step("report", len(rows), len(picked))
    return AvatarResult(
        model=avatar.model,
        identities=avatar.identities,
        asked=avatar.weights,
        sources=[one.source for one in avatar.expressions],
        frames=[one.frame for one in avatar.expressions],
        used=used,
        plausibility=np.array([one.plausibility for one in avatar.expressions]),
        rows=rows,
        sharpness=avatar.sharpness,
        sharpen=avatar.sharpen,
        surround=_surround(avatar),
        distances=mean_face_distances(models, avatar.model, avatar.judged),
        notes=avatar.notes,
        settings=_settings_words(avatar, settings),
    )


def landmark_words(avatar: Avatar, has_detector: bool, path: Path) -> tuple[str, ...]:
    """Return advice if the avatar, written to a path, has no landmarks."""
    if avatar.model.landmarks is not None:
        return ()
    lacks = f"{avatar.model.identity} has no landmarks, which `mimic --method guided` needs"
    count = len(avatar.expressions)
    if has_detector or count < LEAST_FACES:
        return (
            f"{lacks}: they are learned from at least {LEAST_FACES} pictures with a detected face, but {count} "
            "expressions were blended; give more --expressions",
        )
    return (f"{lacks}: run `morphspace keypoints {path} --auto`",)


def _surround(avatar: Avatar) -> str:
    return "flat field" if avatar.surround is None else avatar.identities[avatar.surround]


def _settings_words(avatar: Avatar, settings: AvatarSettings) -> dict[str, str]:
    count = "all" if settings.expressions is None else f"{settings.expressions}"
    blend = avatar.model.provenance["blend"]
    return {
        "method": blend["method"] + (" (auto)" if settings.method == AUTO else ""),
        "bound of each loading": f"{settings.max_sd:g} SD",
        "expressions": f"{len(avatar.expressions)}; of each identity {count}"
        + ("" if settings.expressions is None else ", by farthest-point sampling"),
        "frames": "rendered by the models" if settings.clips is None else "of the clips",
        "correspondence": "mean faces"
        + (", mouths in each expression" if settings.correspondence == EXPRESSION else ""),
        "reference identity": avatar.identities[avatar.reference_identity],
        "reference expression": avatar.expressions[avatar.reference].name,
        "faceframe": settings.faceframe,
        "surround": _surround(avatar),
        "flow": settings.flow,
        "sharpening": f"{avatar.sharpen:.2f}" + (" (auto)" if settings.sharpen is None else ""),
        "components": f"{avatar.model.rank}",
    }


@dataclass(frozen=True)
class SheetRow:
    """A row of the contact sheet with its captions."""

    versions: Sequence[Panel]
    blend: Panel
    pixel_average: Panel


@dataclass(frozen=True, eq=False)
class AvatarPage:
    """The contents of `avatar.html` for the blend `made`: shares of the versions, pictures, tables and components."""

    title: str
    made: AvatarResult
    shares: Mapping[str, float]
    left_out: int
    less_weight: int
    sheet: Sequence[SheetRow]
    large: Sequence[Panel]
    identity_rows: Sequence[Sequence[str]]
    distances: Mapping[str, Sequence[Sequence[str]]]
    sharpness_rows: Sequence[Sequence[str]]
    affected: Sequence[Sequence[str]]
    components: Components
    sd_headings: Sequence[str]
    component_rows: Sequence[Sequence[str]]
    full_part: float = FULL_PART
    listed: int = SOURCES_SHOWN


def avatar_page(made: AvatarResult) -> str:
    """Return the page as HTML; the same values give the same bytes. Blend: Nagle section 4; page: ours."""
    taken = parts_taken(made.used, made.asked)
    shares = sharp_shares(made)
    page = AvatarPage(
        title=f"{made.model.identity}: a blend of {', '.join(made.identities)}",
        made=made,
        shares=shares,
        left_out=int((taken == 0).sum()),
        less_weight=int(((taken > 0) & (taken < FULL_PART)).sum()),
        sheet=[_sheet_row(made, row, taken[row.index]) for row in made.rows],
        large=_large(made),
        identity_rows=_identity_rows(made, taken),
        distances={} if made.distances is None else _distances(made, made.distances),
        sharpness_rows=_sharpness_rows(made, shares),
        affected=_affected(made, taken),
        components=components_of(made.model),
        sd_headings=[f"SD in {name}" for name in made.identities],
        component_rows=_component_rows(made),
    )
    return render("avatar.html", page)


def rows_shown(used: AnyArray, asked: AnyArray, at_most: int = SHEET_ROWS) -> list[int]:
    """Select the expressions of the contact sheet, in order: evenly spread ones, and those with most left out.

    `used` (n, k) and `asked` (k,) are weights, as in `AvatarResult`. Ours.
    """
    count = len(used)
    if count <= at_most:
        return list(range(count))
    missing = (1 - parts_taken(used, asked)).sum(axis=1)
    kept = max(1, round(at_most * LEAST_SHARE_OF_SHEET))
    worst = [int(index) for index in np.argsort(-missing, kind="stable")[:kept] if missing[index] > 0]
    others = [index for index in range(count) if index not in worst]
    evenly = [others[place] for place in spread(len(others), at_most - len(worst))]
    return sorted({*worst, *evenly})


def parts_taken(used: AnyArray, asked: AnyArray) -> AnyArray:
    """Return the part of its weight that each version kept, (n, k), from 0 (left out) to 1; a weight of 0 gives 1.

    Weights sum to one, so the others grow if a version is left out. The version that kept most counts as 1.
    """
    takes_part = asked > 0
    kept = np.where(takes_part, used / np.where(takes_part, asked, 1), 0.0)
    most = np.maximum(kept.max(axis=1, keepdims=True), np.finfo(float).tiny)
    return np.where(takes_part, kept / most, 1.0)


def source_sharpness(made: AvatarResult) -> float:
    """Return the mean sharpness of the sources, weighted by the requested weights."""
    return float(np.asarray(made.sharpness["sources"], np.float64) @ np.asarray(made.asked, np.float64))


def sharp_shares(made: AvatarResult) -> dict[str, float]:
    """Return the sharpness of each picture relative to the sources' weighted mean; NaN if that is 0."""
    mean = source_sharpness(made)
    return {
        name: float(value) / mean if mean > 0 else float("nan")
        for name, value in made.sharpness.items()
        if name != "sources" and value is not None
    }


def variance_between(loadings: AnyArray, sources: Sequence[int]) -> AnyArray:
    """Return the share of each component's variance (k,) between the sources: the correlation ratio, 0 to 1.

    `loadings` (n, k); `sources` (n,) are the identities of the rows. The ratio is the between-groups sum of squares
    over the total (Pearson's eta squared). Near 0 a component is pure expression, near 1 it separates the identities.
    """
    owners = np.asarray(sources)
    centred = loadings - loadings.mean(axis=0)
    total = (centred**2).sum(axis=0)
    between = np.zeros(loadings.shape[1])
    for source in np.unique(owners):
        rows = centred[owners == source]
        between += len(rows) * rows.mean(axis=0) ** 2
    return np.where(total > 0, between / np.maximum(total, np.finfo(float).tiny), 0.0)


def _sheet_row(made: AvatarResult, row: ExpressionRow, taken: AnyArray) -> SheetRow:
    label = made.label(row.index)
    return SheetRow(
        [_version(made, row, place, float(taken[place])) for place in range(len(made.identities))],
        Panel(pictures.photograph(small(row.blend), f"{label}: blend"), "blend"),
        Panel(pictures.photograph(small(row.pixel_average), f"{label}: pixel average"), "pixel average"),
    )


def _version(made: AvatarResult, row: ExpressionRow, place: int, part: float) -> Panel:
    name, frame, source = made.identities[place], made.frames[row.index], made.sources[row.index]
    weight = float(made.used[row.index, place])
    words = f"{name}: {percent(weight)}"
    if made.asked[place] > 0 and part == 0:
        words = f"{name}: left out"
    kinds = {"own": place == source, "out": weight == 0, "less": 0 < part < FULL_PART}
    return Panel(
        pictures.photograph(small(row.versions[place]), f"{name} shows {frame} of {made.identities[source]}"),
        words,
        f" (its own, {frame})" if place == source else "",
        " ".join(kind for kind, holds in kinds.items() if holds),
    )


def _large(made: AvatarResult) -> list[Panel]:
    panels = []
    for row in (made.rows[place] for place in spread(len(made.rows), LARGE_FACES)):
        label = made.label(row.index)
        average = pictures.photograph(row.pixel_average, f"Pixel average of {label}")
        panels.append(Panel(pictures.photograph(row.blend, f"Blend of {label}"), f"{label}: blend"))
        panels.append(Panel(average, "the pixel average of the same versions"))
    return panels


def _identity_rows(made: AvatarResult, taken: AnyArray) -> list[Sequence[str]]:
    sources, mean_used = np.asarray(made.sources), made.used.mean(axis=0)
    rows: list[Sequence[str]] = []
    for place, name in enumerate(made.identities):
        others = sources != place
        left = taken[others, place] == 0
        less = ~left & (taken[others, place] < FULL_PART)
        rows.append(
            (
                name,
                f"{100 * made.asked[place]:.1f}",
                f"{100 * mean_used[place]:.1f}",
                f"{(~others).sum()}",
                f"{left.sum()} of {others.sum()}",
                f"{less.sum()}",
            )
        )
    return rows


def _distances(made: AvatarResult, distances: MeanDistances) -> dict[str, list[Sequence[str]]]:
    """Return the rows of the tables of distances; shape has none if a model lacks landmarks."""
    count = len(made.identities)
    tables: dict[str, list[Sequence[str]]] = {}
    for quantity, values in (("shape", distances.shape_percent), ("colour", distances.colour_percent)):
        if values is None:
            continue
        to_others = values[:count, :count].sum(axis=1) / max(count - 1, 1)
        tables[quantity] = [
            (
                name,
                *(f"{value:.1f}" for value in values[row]),
                f"{to_others[row]:.1f}",
                "yes" if values[row, count] < to_others[row] else "no",
            )
            for row, name in enumerate(made.identities)
        ]
    return tables


def _sharpness_rows(made: AvatarResult, shares: Mapping[str, float]) -> list[Sequence[str]]:
    mean = source_sharpness(made)

    def row(words: str, value: float, share: float) -> Sequence[str]:
        return words, f"{value:.3g}" if np.isfinite(value) else DASH, percent(share)

    sources = zip(made.identities, map(float, made.sharpness["sources"]), strict=True)
    rows = [row(name, value, value / mean if mean > 0 else float("nan")) for name, value in sources]
    rows.append(row("mean of the sources, by weight", mean, 1.0))
    known = ((name, words) for name, words in PICTURES_MADE.items() if name in shares)
    return rows + [row(words, float(made.sharpness[name]), shares[name]) for name, words in known]


def _affected(made: AvatarResult, taken: AnyArray) -> list[Sequence[str]]:
    """List the expressions with versions left out or given less weight, those with most first."""
    rows: list[Sequence[str]] = []
    for index in np.argsort(-(1 - taken).sum(axis=1), kind="stable"):
        if (taken[index] >= FULL_PART).all():
            continue
        out, less = [], []
        for name, part, weight, plausibility in zip(
            made.identities, taken[index], made.used[index], made.plausibility[index], strict=True
        ):
            if part == 0:
                out.append(f"{name} ({fixed(plausibility)})")
            elif part < FULL_PART:
                less.append(f"{name} ({percent(weight)}, {fixed(plausibility)})")
        source = made.identities[made.sources[index]]
        rows.append((made.frames[index], source, ", ".join(out), ", ".join(less)))
    return rows


def _component_rows(made: AvatarResult) -> list[Sequence[str]]:
    """List each component's variance, its share between the sources, and the SD within each source."""
    model, sources = made.model, np.asarray(made.sources)
    if model.rank == 0:
        return []
    loadings, together = model.training.values, explained(model)
    alone, between = np.diff(together, prepend=0), variance_between(loadings, made.sources)
    return [
        (
            f"pc{number + 1:03d}",
            f"{alone[number]:.1f}",
            f"{together[number]:.1f}",
            f"{100 * between[number]:.0f}",
            *(
                f"{loadings[sources == place, number].std() / model.sd[number]:.2f}"
                if (sources == place).any()
                else DASH
                for place in range(len(made.identities))
            ),
        )
        for number in range(min(COMPONENTS_LISTED, model.rank))
    ]


def blend_lines(avatar: Avatar, output: Path, report: Path) -> tuple[str, ...]:
    """Report a blend in a few lines: its sources, its grid and its sharpness."""
    model, sharpness = avatar.model, avatar.sharpness
    wanted = float(sharpness["sources"] @ avatar.weights)
    shares = ", ".join(
        f"{name} {weight:.2g}" for name, weight in zip(avatar.identities, avatar.weights, strict=True)
    )
    drawn, pictures, plain = (
        f"{sharpness[name] / wanted if wanted > 0 else 1.0:.0%}"
        for name in ("blend", "pictures", "unsharpened")
    )
    return (
        f"{output}: {model.identity}, blended of {shares}; {len(avatar.expressions)} expressions, "
        f"{model.size[0]}x{model.size[1]}, {model.rank} components",
        f"warped to {avatar.identities[avatar.reference_identity]}; hair, ears, neck and background of "
        + ("nobody (flat grey)" if avatar.surround is None else avatar.identities[avatar.surround])
        + f"; in {avatar.figures['expressions_with_one_left_out']} expressions an identity is left out",
        f"sharpness relative to the sources: {drawn} rendered by the model; blended pictures {plain} plain, {pictures} "
        f"sharpened by {avatar.sharpen:.2f}",
        f"report: {report}",
    )
