"""Text with places to fill, as recipes use it: `{identity}_g{gain}`, `{identity.loadings}`, `{step:03d}`.

Python's own formatting would follow attributes and indices of whatever it is given. What is filled in here is a
name, or a name and one entry of it, with a width and precision for numbers, and nothing else. Ours.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from morphspace.errors import BadInput

WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
PLACE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\.([A-Za-z][A-Za-z0-9_]*))?(?::(0?[0-9]?(?:\.[0-9])?[dfg]))?")
CLOSENESS = 0.6  # of two words, 1 for the same: what a slip of the finger leaves
LISTED = 16  # words a message tells all of
EXAMPLE = "{gain}, {identity.loadings} or {step:03d}"


@dataclass(frozen=True)
class Place:
    """A place to fill: the `word` of it, one `entry` of what it stands for or "", how a number is written or ""."""

    word: str
    entry: str
    form: str

    @property
    def key(self) -> str:
        """What is looked up: `word`, or `word.entry`."""
        return f"{self.word}.{self.entry}" if self.entry else self.word


def pieces_of(text: str) -> tuple[str | Place, ...]:
    """Take a text apart into what stays and what is filled. Raises `BadInput` for braces that do not pair or a place
    that is not a name.
    """
    pieces: list[str | Place] = []
    for number, part in enumerate(re.split(r"\{([^{}]*)\}", text)):
        if number % 2 == 0:
            if "{" in part or "}" in part:
                raise BadInput(f"{text!r} has a brace without its other: places to fill look like {EXAMPLE}")
            if part:
                pieces.append(part)
            continue
        found = PLACE.fullmatch(part)
        if found is None:
            raise BadInput(f"{{{part}}} in {text!r} is not a place to fill: write it like {EXAMPLE}")
        pieces.append(Place(*(group or "" for group in found.groups())))
    return tuple(pieces)


def places_in(value: Any) -> tuple[Place, ...]:
    """Give the places of a text, or of every text in lists and mappings."""
    if isinstance(value, str):
        return tuple(piece for piece in pieces_of(value) if isinstance(piece, Place))
    if isinstance(value, Mapping):
        return tuple(place for inner in value.values() for place in places_in(inner))
    if isinstance(value, list | tuple):
        return tuple(place for inner in value for place in places_in(inner))
    return ()


def filled(value: Any, known: Mapping[str, Any]) -> Any:
    """Fill the places of a text, or of every text in lists and mappings, with what is `known` by `Place.key`.

    A text that is one place alone, `{gain}`, becomes the value itself and keeps its kind. Raises `BadInput` for a place
    that is not known, naming the nearest that is, and for a value that is no single word or number inside a text.
    """
    if isinstance(value, Mapping):
        return {key: filled(inner, known) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [filled(inner, known) for inner in value]
    if not isinstance(value, str):
        return value
    pieces = pieces_of(value)
    if len(pieces) == 1 and isinstance(pieces[0], Place) and not pieces[0].form:
        return _known(pieces[0], known)
    return "".join(piece if isinstance(piece, str) else _worded(piece, known) for piece in pieces)


def nearest(word: str, known: Iterable[str]) -> str:
    """Say which of the known words is near, and which there are where they are few."""
    words = list(dict.fromkeys(known))
    close = [one for one in words if one.lower() == word.lower()] or get_close_matches(
        word, words, 1, CLOSENESS
    )
    told = [f"the nearest is {close[0]!r}"] if close else []
    if not close or len(words) <= LISTED:
        told.append(f"there are {', '.join(words)}" if words else "there are none")
    return "; ".join(told)


def _known(place: Place, known: Mapping[str, Any]) -> Any:
    if place.key not in known:
        raise BadInput(f"nothing is called {{{place.key}}}: {nearest(place.key, known)}")
    return known[place.key]


def _worded(place: Place, known: Mapping[str, Any]) -> str:
    """Write what stands in a place as text."""
    value = _known(place, known)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise BadInput(f"{{{place.key}}} is {value!r}, which is neither a text nor a number: give it a name")
    if not place.form:
        return value if isinstance(value, str) else repr(value).removesuffix(".0")
    if isinstance(value, str):
        raise BadInput(
            f"{{{place.key}:{place.form}}} writes a number, {place.key} is {value!r}: leave out :{place.form}"
        )
    if place.form.endswith("d"):
        if value != int(value):
            raise BadInput(
                f"{{{place.key}:{place.form}}} writes a whole number, {place.key} is {value!r}: write it as "
                f"{{{place.key}}}"
            )
        value = int(value)
    try:
        return format(value, place.form)
    except ValueError as error:
        raise BadInput(
            f"{{{place.key}:{place.form}}} is no form of a number: {error}; write it like {EXAMPLE}"
        ) from error
