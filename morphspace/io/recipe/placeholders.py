"""Placeholders in the texts of a recipe: `{identity}_g{gain}`, `{identity.loadings}`, `{step:03d}`.

Python's own formatting follows the attributes and indices of any object. A placeholder here is only a name, or a name
and one entry of it, with an optional width and precision for numbers. Ours.
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
CLOSENESS = 0.6  # difflib's ratio, 1 for equal words; the ratio of a word with one or two typing errors
LISTED = 16  # words; a message lists all if there are no more
EXAMPLE = "{gain}, {identity.loadings} or {step:03d}"


@dataclass(frozen=True)
class Place:
    """A placeholder.

    Attributes
    ----------
    word : str
    entry : str
        One entry of the value of `word`, or "".
    form : str
        The number format, such as "03d", or "".
    """

    word: str
    entry: str
    form: str

    @property
    def key(self) -> str:
        """The key of its value: `word`, or `word.entry`."""
        return f"{self.word}.{self.entry}" if self.entry else self.word


def pieces_of(text: str) -> tuple[str | Place, ...]:
    """Split a text into plain pieces and placeholders. Raises `BadInput` for a malformed placeholder.

    Examples
    --------
    >>> pieces_of("face_{step:03d}")
    ('face_', Place(word='step', entry='', form='03d'))
    """
    pieces: list[str | Place] = []
    for number, part in enumerate(re.split(r"\{([^{}]*)\}", text)):
        if number % 2 == 0:
            if "{" in part or "}" in part:
                raise BadInput(
                    f"{text!r} has an unpaired brace; expected placeholders such as {EXAMPLE}. Correct it"
                )
            if part:
                pieces.append(part)
            continue
        found = PLACE.fullmatch(part)
        if found is None:
            raise BadInput(
                f"{{{part}}} in {text!r} is not a placeholder; expected one such as {EXAMPLE}. Correct it"
            )
        pieces.append(Place(*(group or "" for group in found.groups())))
    return tuple(pieces)


def places_in(value: Any) -> tuple[Place, ...]:
    """Return the placeholders of a text, or of every text in lists and mappings."""
    if isinstance(value, str):
        return tuple(piece for piece in pieces_of(value) if isinstance(piece, Place))
    if isinstance(value, Mapping):
        return tuple(place for inner in value.values() for place in places_in(inner))
    if isinstance(value, list | tuple):
        return tuple(place for inner in value for place in places_in(inner))
    return ()


def filled(value: Any, known: Mapping[str, Any]) -> Any:
    """Replace the placeholders of a text, or of every text in lists and mappings, by their values.

    Parameters
    ----------
    value : any
        Values other than texts, lists and mappings are returned as they are.
    known : mapping of `Place.key` to value

    Returns
    -------
    any
        A text that is one placeholder alone, `{gain}`, becomes the value itself and keeps its type.

    Raises
    ------
    BadInput
        If a placeholder is unknown (the message suggests the nearest name), or its value in a text is no text or
        number.

    Examples
    --------
    >>> filled("face_g{gain}", {"gain": 1.5}), filled("{gain}", {"gain": 1.5})
    ('face_g1.5', 1.5)
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
    """Return the end of a message: the known word nearest to `word`, and all known words if they are few."""
    words = list(dict.fromkeys(known))
    close = [one for one in words if one.lower() == word.lower()] or get_close_matches(
        word, words, 1, CLOSENESS
    )
    hints = [f"the nearest is {close[0]!r}"] if close else []
    if not close or len(words) <= LISTED:
        hints.append(f"expected one of {', '.join(words)}" if words else "there are none")
    return "; ".join(hints)


def _known(place: Place, known: Mapping[str, Any]) -> Any:
    if place.key not in known:
        raise BadInput(f"{{{place.key}}} is unknown: {nearest(place.key, known)}")
    return known[place.key]


def _worded(place: Place, known: Mapping[str, Any]) -> str:
    """Write the value of a placeholder as text."""
    value = _known(place, known)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise BadInput(f"{{{place.key}}} is {value!r}; expected a text or a number. Name this level")
    if not place.form:
        return value if isinstance(value, str) else repr(value).removesuffix(".0")
    if isinstance(value, str):
        raise BadInput(f"{{{place.key}:{place.form}}} is {value!r}; expected a number. Remove :{place.form}")
    if place.form.endswith("d"):
        if value != int(value):
            raise BadInput(
                f"{{{place.key}:{place.form}}} is {value!r}; expected a whole number. Write {{{place.key}}}"
            )
        value = int(value)
    try:
        return format(value, place.form)
    except ValueError as error:
        raise BadInput(
            f"{{{place.key}:{place.form}}} is no number format ({error}); expected one such as {EXAMPLE}. Correct it"
        ) from error
