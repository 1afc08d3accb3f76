"""The tables of a blend's page: identities, sharpness, versions left out, variance by component. Ours."""

from __future__ import annotations

import numpy as np

from morphspace.report import sections
from morphspace.report.avatar_distances import MeanDistances
from morphspace.report.avatar_shown import (
    FULL_PART,
    AvatarShown,
    parts_taken,
    sharp_shares,
    source_sharpness,
    told_apart,
)
from morphspace.report.markup import DASH, NOTHING, TIMES, Html, section, sentence, table, text

SOURCES_SHOWN = 60  # rows of the table of expressions with versions left out; most left out first
COMPONENTS_LISTED = 12


def identities_section(shown: AvatarShown) -> Html:
    """Show whose expressions were blended, how much of each is in the blends, and how far mean faces are apart."""
    names = shown.identities
    sources = np.asarray(shown.sources)
    taken = parts_taken(shown.used, shown.asked)
    mean_used = shown.used.mean(axis=0)
    rows = []
    for place, name in enumerate(names):
        others = sources != place
        left = taken[others, place] == 0
        less = ~left & (taken[others, place] < FULL_PART)
        rows.append(
            (
                text(name),
                text(f"{100 * shown.asked[place]:.1f}"),
                text(f"{100 * mean_used[place]:.1f}"),
                text(f"{(~others).sum()}"),
                text(f"{left.sum()} of {others.sum()}"),
                text(f"{less.sum()}"),
            )
        )
    head = (
        "Identity",
        "weight asked, %",
        "share of expressions, %",
        "expressions given",
        "left out",
        "less weight",
    )
    caption = (
        "Each identity enters with the weight asked for, always; its share of expressions is how much its versions of "
        "them counted, on average. Left out, and given less weight (below "
        f"{FULL_PART:.0%} of its part): versions of the others' expressions that were not plausible."
    )
    parts = [table(caption, head, rows)]
    if shown.distances is None:
        parts.append(sentence("How far the mean faces lie from each other is not known."))
    else:
        parts += _distances(shown, shown.distances)
    return section("identities", "Identities", *parts)


def _distances(shown: AvatarShown, distances: MeanDistances) -> list[Html]:
    names = [*shown.identities, shown.model.identity]
    parts = [
        sentence(
            "A blend should be nearer to every source than that source is, on average, to the others, and still be "
            "none of them. The tables compare mean faces; whether people take the blend for somebody is a question "
            "for a face recogniser or for people."
        )
    ]
    if distances.shape_percent is None:
        parts.append(sentence("Shapes are not compared: a model does not know its landmarks."))
    shape = "Shape of the mean faces: rms distance of landmarks, in % of the distance between the eyes, size and tilt"
    colour = "Colour of the mean faces: rms difference where all have face and nobody has hair, in % of white"
    tables = (
        (f"{shape} taken out.", distances.shape_percent),
        (f"{colour}, laid on the blend's faceframe.", distances.colour_percent),
    )
    for caption, values in tables:
        if values is None:
            continue
        count = len(shown.identities)
        rows = [
            (text(name), *(text(f"{value:.1f}") for value in values[row]))
            for row, name in enumerate(names[:count])
        ]
        to_others = values[:count, :count].sum(axis=1) / max(count - 1, 1)
        rows = [
            (
                *cells,
                text(f"{to_others[row]:.1f}"),
                text("yes" if values[row, count] < to_others[row] else "no"),
            )
            for row, cells in enumerate(rows)
        ]
        head = ("Identity", *names, "mean of the others", "blend is nearer")
        parts.append(table(caption, head, rows))
    return parts


def sharpness_section(shown: AvatarShown) -> Html:
    """Show how sharp sources, blend and pixel average are."""
    sources = np.asarray(shown.sharpness["sources"], np.float64)
    shares = sharp_shares(shown)
    mean = source_sharpness(shown)
    rows = [
        (
            text(name),
            text(_scientific(float(value))),
            text(percent_of(value / mean if mean > 0 else float("nan"))),
        )
        for name, value in zip(shown.identities, sources, strict=True)
    ]
    rows.append((text("mean of the sources, by weight"), text(_scientific(mean)), text(percent_of(1.0))))
    made = (
        ("unsharpened", "blend before the unsharp mask"),
        ("pictures", "blended pictures, sharpened"),
        ("blend", "blend"),
        ("pixel average", "pixel average"),
    )
    rows += [
        (text(words), text(_scientific(float(shown.sharpness[name]))), text(percent_of(shares[name])))
        for name, words in made
        if name in shares
    ]
    caption = (
        "Variance of the Laplacian of luma where all have face and nobody has hair, mean over expressions, and as a "
        "share of the sources' mean by weight. The blend is measured as its model draws it, after an unsharp mask of "
        f"the amount {shown.sharpen:.2f} on its pictures."
    )
    return section(
        "sharpness", "Sharpness", table(caption, ("Picture", "variance", "share"), rows, class_="few")
    )


def left_out_section(shown: AvatarShown) -> Html:
    """List the expressions for which versions were left out or given less weight, most first."""
    heading = "Versions left out or given less weight"
    taken = parts_taken(shown.used, shown.asked)
    missing = (1 - taken).sum(axis=1)
    affected = [
        int(index) for index in np.argsort(-missing, kind="stable") if (taken[index] < FULL_PART).any()
    ]
    if not affected:
        return section(
            "left-out", heading, sentence("None: every identity has its full part in every expression.")
        )
    rows = []
    for index in affected[:SOURCES_SHOWN]:
        out = [place for place in range(len(shown.identities)) if taken[index, place] == 0]
        less = [place for place in range(len(shown.identities)) if 0 < taken[index, place] < FULL_PART]
        rows.append(
            (
                text(shown.frames[index]),
                text(shown.identities[shown.sources[index]]),
                text(", ".join(f"{shown.identities[p]} ({shown.plausibility[index, p]:.2f})" for p in out)),
                text(
                    ", ".join(
                        f"{shown.identities[p]} ({100 * shown.used[index, p]:.0f} %, "
                        f"{shown.plausibility[index, p]:.2f})"
                        for p in less
                    )
                ),
            )
        )
    caption = (
        f"{len(affected)} of {len(shown.frames)} expressions, those that leave most out first. In brackets how "
        "plausible the version is, from 0 to 1; the identity of a version left out enters through its mean."
    )
    if len(affected) > SOURCES_SHOWN:
        caption += f" The first {SOURCES_SHOWN}."
    head = ("Expression", "whose", "left out (plausibility)", "less weight (weight used, plausibility)")
    return section("left-out", heading, table(caption, head, rows))


def components_section(shown: AvatarShown) -> Html:
    """List each component's variance, and how much of it tells whose expression it was."""
    model = shown.model
    if model.rank == 0:
        return NOTHING
    loadings = model.training.values
    together = sections.explained(model)
    shares = np.diff(together, prepend=0)
    between = told_apart(loadings, shown.sources)
    sources = np.asarray(shown.sources)
    rows = []
    for number in range(min(COMPONENTS_LISTED, model.rank)):
        spreads = [
            text(f"{loadings[sources == place, number].std() / model.sd[number]:.2f}")
            if (sources == place).any()
            else text(DASH)
            for place in range(len(shown.identities))
        ]
        rows.append(
            (
                text(f"pc{number + 1:03d}"),
                text(f"{shares[number]:.1f}"),
                text(f"{together[number]:.1f}"),
                text(f"{100 * between[number]:.0f}"),
                *spreads,
            )
        )
    caption = (
        f"Variance in %, alone and together; how much of it lies between the sources, in %: a component near 100 tells "
        f"whose expression it was, one near 0 does not; and the SD within each source's expressions, {TIMES} the "
        f"component's. The first {len(rows)} of {model.rank}."
    )
    head = (
        "Component",
        "variance",
        "together",
        "between sources",
        *(f"SD in {name}" for name in shown.identities),
    )
    return section("by-component", "Variance by component", table(caption, head, rows))


def percent_of(share: float) -> str:
    """Give a share in whole percent, a dash where it is undefined."""
    return f"{100 * share:.0f} %" if np.isfinite(share) else DASH


def _scientific(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else DASH
