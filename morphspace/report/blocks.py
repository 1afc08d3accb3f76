"""What the pages of mimicry, imitation and blends share: the page itself, notes, the top figures, the settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from morphspace.report.markup import Html, element, joined, section, table, text

ALONE = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
POLICY = "default-src 'none'; img-src data:; media-src 'self' file:; style-src 'unsafe-inline'"


def notes_section(notes: Sequence[str]) -> Html:
    """Give the box of notes, or nothing where there are none."""
    if not notes:
        return Html("")
    items = [element("li", text(note)) for note in notes]
    return element(
        "section",
        element("h2", text("Before you read on")),
        element("ul", *items),
        class_="advice",
        id="notes",
    )


def key_figures(entries: Sequence[tuple[str, str]]) -> Html:
    """Give the row of figures, each a value and what it is."""
    cells = [element("div", element("dt", text(what)), element("dd", text(value))) for value, what in entries]
    return element("dl", *cells, class_="figures")


def settings_section(settings: Mapping[str, str]) -> Html:
    """Give the table of what was asked for, name to value."""
    return section(
        "settings",
        "Settings",
        table(
            "What was asked for, and what was used.",
            ("Entry", "Value"),
            [(text(name), text(value)) for name, value in settings.items()],
            class_="pairs",
        ),
    )


def page_beside_a_video(title: str, style: str, parts: Sequence[Html]) -> str:
    """Give the whole page as HTML; it may load nothing but media files of its own folder."""
    return _page(title, style, parts, POLICY, "The page loads nothing but the video beside it.")


def page_by_itself(title: str, style: str, parts: Sequence[Html]) -> str:
    """Give the whole page as HTML; it may load nothing."""
    return _page(title, style, parts, ALONE, "This page is complete in itself: it loads nothing.")


def _page(title: str, style: str, parts: Sequence[Html], policy: str, loads: str) -> str:
    footer = element("footer", text(f"Written by morphspace. {loads}"))
    head = [
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", text(title)),
        element("style", Html(style)),
    ]
    body = element("body", element("main", joined([*parts, footer])))
    page = element("html", Html("\n"), element("head", joined(head)), Html("\n"), body, lang="en")
    return f"<!DOCTYPE html>\n{page}\n"
