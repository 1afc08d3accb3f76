"""Blocks that several pages share: what to know before reading, and the figures at the top."""

from __future__ import annotations

from collections.abc import Sequence

from morphspace.report.markup import Html, element, text


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
