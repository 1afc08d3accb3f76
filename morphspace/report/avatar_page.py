"""The page of a blend: every version beside what was made of them, how sharp it is, and whose part was left out.

The page is complete in itself. The pixel average of the same pictures (Galton, Journal of the Anthropological Institute
8, 1878) stands beside the blend, since it is what a blend without correspondence gives. The blend is that of Nagle
section 4; the figures are ours.
"""

from __future__ import annotations

from morphspace.report import avatar_tables, pictures, sections
from morphspace.report.avatar_shown import (
    FULL_PART,
    AvatarShown,
    ExpressionRow,
    parts_taken,
    rows_shown,
    sharp_shares,
)
from morphspace.report.avatar_tables import percent_of
from morphspace.report.blocks import key_figures, notes_section, page_by_itself, settings_section
from morphspace.report.figures import small
from morphspace.report.markup import DASH, NOTHING, Html, element, figure, joined, section, sentence, text
from morphspace.report.style import STYLE
from morphspace.steps import spread

__all__ = ["AvatarShown", "ExpressionRow", "avatar_page", "rows_shown"]

LARGE_FACES = 3  # blend and pixel average beside each other, at full size
AVATAR_STYLE = """
.rows{overflow-x:auto}
.row{display:grid;gap:6px;margin-top:8px;break-inside:avoid}
.row figcaption{font-size:.72rem;margin-top:.2rem;line-height:1.3}
.row .own img{outline:2px solid var(--accent)}
.row .out img{opacity:.35}
.row .out figcaption{color:var(--alarm)}
.row .less figcaption{color:var(--amber)}
.large{display:grid;grid-template-columns:1fr 1fr;gap:10px 14px;max-width:760px;margin-top:1rem}
td.nearest{font-weight:600}
"""


def avatar_page(shown: AvatarShown) -> str:
    """Give the page as HTML; the same values give the same bytes. Blend: Nagle section 4; page: ours."""
    title = f"{shown.model.identity}: a blend of {', '.join(shown.identities)}"
    count = len(shown.frames)
    kicker = (
        f"{len(shown.identities)} identities, {count} expression{'' if count == 1 else 's'}; hair, neck and "
    )
    kicker += f"background: {shown.surround}"
    parts = [
        element("h1", text(title)),
        element("p", text(kicker), class_="kicker"),
        _figures(shown),
        notes_section(shown.notes),
        _whose(shown),
        _sheet(shown),
        _large(shown),
        avatar_tables.identities_section(shown),
        avatar_tables.sharpness_section(shown),
        avatar_tables.left_out_section(shown),
        sections.variance_section(shown.model),
        avatar_tables.components_section(shown),
        sections.components_section(shown.model),
        settings_section(shown.settings),
    ]
    return page_by_itself(title, STYLE + AVATAR_STYLE, parts)


def _figures(shown: AvatarShown) -> Html:
    taken = parts_taken(shown.used, shown.asked)
    out, less = int((taken == 0).sum()), int(((taken > 0) & (taken < FULL_PART)).sum())
    sharp = sharp_shares(shown)
    share = sections.explained(shown.model)
    variance = f"{sections.percent(share[-1])} %" if shown.model.rank else DASH
    versions = taken.size
    entries = [
        (f"{len(shown.frames)}", "expressions blended"),
        (percent_of(sharp["blend"]), "as sharp as the sources, on average"),
        (percent_of(sharp["pixel average"]), "as sharp is the pixel average of the same pictures"),
        (f"{shown.sharpen:.2f}", "amount of the unsharp mask"),
        (f"{out}", f"of {versions} versions left out; {less} more given less weight"),
        (variance, f"of variance explained by {shown.model.rank} components"),
    ]
    return key_figures(entries)


def _whose(shown: AvatarShown) -> Html:
    """Say what of the pictures is one person's alone."""
    inside = "Glasses and beard inside the face are those of the sources who have them, fainter the less their weight."
    if shown.surround in shown.identities:
        words = (
            f"{shown.surround}'s alone, at any weight. People know a person by hair, ears and the outline of the head "
            f"too, so that to the eye the blend is nearer to {shown.surround} than the weights say. --surround flat "
            f"puts grey there, --surround NAME another person's. {inside}"
        )
    else:
        words = f"Nobody's: what surrounds the face is flat grey. {inside}"
    return section("surround", "Hair, ears, neck and background", sentence(words))


def _sheet(shown: AvatarShown) -> Html:
    taken = parts_taken(shown.used, shown.asked)
    columns = f"grid-template-columns:repeat({len(shown.identities) + 2},minmax(84px,1fr))"
    drawn = []
    for row in shown.rows:
        source, frame = shown.identities[shown.sources[row.index]], shown.frames[row.index]
        cells = [
            _version(shown, row, place, float(taken[row.index, place]))
            for place in range(len(shown.identities))
        ]
        label = f"{source}, {frame}"
        cells.append(
            figure(pictures.photograph(small(row.blend), f"{label}: blend"), element("strong", text("blend")))
        )
        cells.append(
            figure(
                pictures.photograph(small(row.pixel_average), f"{label}: pixel average"),
                text("pixel average"),
            )
        )
        drawn.append(element("div", *cells, class_="row", style=columns))
    total = len(shown.frames)
    some = (
        f" {len(drawn)} of {total} expressions: evenly spread, and those where most was left out."
        if len(drawn) < total
        else ""
    )
    words = (
        "Each row is one expression: the version of each identity, the one whose expression it is outlined; then the "
        "blend, and last the pixel average of the same versions. Under each version its weight; a faded one was left "
        f"out.{some}"
    )
    return section("sheet", "Contact sheet", sentence(words), element("div", joined(drawn), class_="rows"))


def _version(shown: AvatarShown, row: ExpressionRow, place: int, part: float) -> Html:
    name = shown.identities[place]
    own = place == shown.sources[row.index]
    weight = float(shown.used[row.index, place])
    words = f"{name}: {100 * weight:.0f} %"
    if shown.asked[place] > 0 and part == 0:
        words = f"{name}: left out"
    label = f"{name} shows {shown.frames[row.index]} of {shown.identities[shown.sources[row.index]]}"
    kinds = [
        kind for kind, holds in (("own", own), ("out", weight == 0), ("less", 0 < part < FULL_PART)) if holds
    ]
    caption = [text(words)]
    if own:
        caption.append(text(f" (its own, {shown.frames[row.index]})"))
    return figure(
        pictures.photograph(small(row.versions[place]), label),
        *caption,
        **({"class_": " ".join(kinds)} if kinds else {}),
    )


def _large(shown: AvatarShown) -> Html:
    chosen = [shown.rows[place] for place in spread(len(shown.rows), LARGE_FACES)]
    if not chosen:
        return NOTHING
    cells = []
    for row in chosen:
        label = f"{shown.identities[shown.sources[row.index]]}, {shown.frames[row.index]}"
        cells.append(figure(pictures.photograph(row.blend, f"Blend of {label}"), text(f"{label}: blend")))
        cells.append(
            figure(
                pictures.photograph(row.pixel_average, f"Pixel average of {label}"),
                text("the pixel average of the same versions"),
            )
        )
    shares = sharp_shares(shown)
    words = (
        "Both are made of the same versions with the same weights; the blend averages where each point lies before it "
        "averages colours. Look for double edges at brows, lids and lips: an average of pixels has them everywhere. "
        f"The blend is {percent_of(shares['blend'])} as sharp as the sources, the pixel average "
        f"{percent_of(shares['pixel average'])}."
    )
    return section(
        "average", "Beside the pixel average", sentence(words), element("div", *cells, class_="large")
    )
