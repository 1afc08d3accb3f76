"""HTML as values of a type of its own, so that text from outside cannot reach the page without being escaped.

`Html` is what is safe to put on a page. The only ways to get one are `text`, which escapes, and `element`, which takes
nothing but `Html` inside and escapes its attributes; a type checker refuses the rest.
"""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import NewType

Html = NewType("Html", str)

VOID_ELEMENTS = ("img", "meta")  # the ones used here that have no end tag
NOTHING = Html("")
TIMES, MINUS, DASH = "\N{MULTIPLICATION SIGN}", "\N{MINUS SIGN}", "\N{EN DASH}"


def text(value: object) -> Html:
    """Give any value as text of a page: escaped; control characters and broken UTF-8 become spaces."""
    words = str(value)
    if not words.isprintable():  # of a whole picture in base64 this is quick to ask
        words = "".join(character if character.isprintable() else " " for character in words)
    return Html(html.escape(words, quote=True))


def element(name: str, /, *parts: Html, **attributes: object) -> Html:
    """Give `<name attributes>parts</name>`. `class_` stands for class, and an underscore in a name for a hyphen."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(value)}"' for key, value in attributes.items()
    )
    if name in VOID_ELEMENTS:
        return Html(f"<{name}{written}>")
    return Html(f"<{name}{written}>{''.join(parts)}</{name}>")


def joined(parts: Iterable[Html], between: str = "\n") -> Html:
    """Give the parts one after the other."""
    return Html(text(between).join(parts))


def sentence(words: object, **attributes: object) -> Html:
    """Give a paragraph of plain words."""
    return element("p", text(words), **attributes)


def figure(picture: Html, *caption: Html, **attributes: object) -> Html:
    """Give a picture with its caption beneath."""
    return element("figure", picture, element("figcaption", *caption), **attributes)


def section(name: str, heading: str, *parts: Html) -> Html:
    """Give a section of the page under its heading; `name` is where a link leads."""
    return element("section", element("h2", text(heading)), *parts, id=name)


def table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[Html]], **attributes: object) -> Html:
    """Give a table: the caption tells what and in which units, the first cell of each row is its header."""
    head = element("tr", *(element("th", text(column), scope="col") for column in columns))
    body = [
        element("tr", element("th", row[0], scope="row"), *(element("td", cell) for cell in row[1:]))
        for row in rows
    ]
    content = element(
        "table",
        element("caption", text(caption)),
        element("thead", head),
        element("tbody", *body),
        **attributes,
    )
    return element("div", content, class_="wide")
