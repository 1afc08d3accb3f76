"""Settings of a request: how they are declared, converted, checked and described (ours).

A setting is a field of a request, annotated with its type, its limits and its help:

    count: Annotated[int, Ge(1), Le(100_000), Option("-n", "--count"), Help("Number of faces.")] = 16

`converted` treats a value from Python, from a recipe or from the command line in the same way, with the same error
messages. This module imports nothing heavy, because `--help` reads these declarations.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import os
import re
import types
import typing
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, Len

from morphspace.errors import BadInput

NUMBER_SEPARATORS, TEXT_SEPARATORS = ",;", ";"  # between the values of a list that is written as one text
NUMBER_PATTERN = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
WHOLE_PATTERN = r"[-+]?[0-9]+(\.0*)?"
ONE_OF = "one of "  # before the permitted texts of a setting
LONGEST_SHOWN = 60  # characters of a refused value in a message

# What a field may be annotated with, besides the limits Ge, Gt and Le of `annotated_types`.


@dataclass(frozen=True)
class Help:
    """The help of the setting, one or two sentences."""

    text: str


@dataclass(frozen=True)
class Argument:
    """A setting that the command line takes without an option; `metavar` is its name in the help."""

    metavar: str


@dataclass(frozen=True, init=False)
class Option:
    """The option of a setting, if it is not `--` and the field's name.

    `metavar` is the name of its value in the help. An option with a fixed value (`gives`) takes no value.
    """

    flags: tuple[str, ...]
    metavar: str | None
    gives: str | None

    def __init__(self, *flags: str, metavar: str | None = None, gives: str | None = None) -> None:
        for name, value in (("flags", flags), ("metavar", metavar), ("gives", gives)):
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class NotAnOption:
    """A setting of Python and recipes that is not on the command line."""


@dataclass(frozen=True)
class NamesFile:
    """A text that names files; a recipe resolves them from its own folder."""


@dataclass(frozen=True)
class OneOf:
    """The permitted texts of a setting if they are declared elsewhere, so a `Literal` would repeat them."""

    values: tuple[str, ...]


@dataclass(frozen=True)
class Pattern:
    """The regular expression that a text matches from start to end; `words` say what such a text is."""

    regex: str
    words: str


@dataclass(frozen=True)
class Called:
    """What the values of a list of fixed length are, such as `[x, y] in px`."""

    words: str


@dataclass(frozen=True)
class Spelled:
    """The word for None in a text, such as auto or all."""

    nothing: str


@dataclass(frozen=True)
class Separated:
    """A list that the command line takes as one text; `by` holds the characters that separate its values."""

    by: str
    example: str


@dataclass(frozen=True)
class Field:
    """One setting of a request: its `name`, its `kind` (the type without marks), the `marks`, and its default."""

    name: str
    kind: Any
    marks: tuple[Any, ...]
    default: Any = dataclasses.MISSING

    @property
    def required(self) -> bool:
        """Return whether the setting has no default."""
        return self.default is dataclasses.MISSING

    @property
    def optional(self) -> bool:
        """Return whether the setting may be None."""
        return type(None) in typing.get_args(self.kind)

    @property
    def help(self) -> str:
        """Return the help, one or two sentences."""
        mark = mark_of(self.marks, Help)
        return "" if mark is None else mark.text

    @property
    def argument(self) -> Argument | None:
        """Return the mark of a setting that is given without an option, or None."""
        return mark_of(self.marks, Argument)

    @property
    def flags(self) -> tuple[str, ...]:
        """Return the options on the command line, the longest last."""
        options = [mark for mark in self.marks if isinstance(mark, Option) and mark.flags]
        return options[-1].flags if options else (f"--{self.name.replace('_', '-')}",)

    @property
    def gives(self) -> str | None:
        """Return the fixed value of an option that takes none, or None."""
        given = [mark.gives for mark in self.marks if isinstance(mark, Option) and mark.gives]
        return given[-1] if given else None

    @property
    def spoken(self) -> str:
        """Return the name on the command line; empty if the setting is not on it."""
        if mark_of(self.marks, NotAnOption) is not None:
            return ""
        return self.flags[-1] if self.argument is None else self.argument.metavar

    @property
    def metavar(self) -> str:
        """Return the name of the value in the help."""
        named = [mark.metavar for mark in self.marks if isinstance(mark, Option) and mark.metavar]
        return named[-1] if named else _metavar(self.kind, self.marks)

    @property
    def words(self) -> str:
        """Describe a value of the setting, such as `a whole number from 1 to 100`."""
        return worded(self.kind, self.marks)

    @property
    def limits(self) -> str:
        """Describe the limits of a number; empty if there are none."""
        values = self.values
        return _limits(self.marks if values is None else kind_and_marks(values[0])[1])

    @property
    def names_files(self) -> bool:
        """Return whether the texts of the setting name files (`NamesFile`)."""
        return _names_files(self.kind, self.marks)

    @property
    def values(self) -> tuple[Any, ...] | None:
        """Return the kinds of a list's values, ending in `...` for any number of them; None if it is no list."""
        members = typing.get_args(self.kind) if is_union(self.kind) else (self.kind,)
        return next((typing.get_args(one) for one in members if typing.get_origin(one) is tuple), None)

    @property
    def word_count(self) -> int | None:
        """Return the number of command line words, None for any number; a list of numbers is one word with commas."""
        values = self.values
        if values is None or mark_of(self.marks, Separated) is not None:
            return 1
        if values[-1] is not Ellipsis:
            return len(values)
        return 1 if _is_number(values[0]) else None

    @property
    def default_words(self) -> str:
        """Return the default as text; empty if there is none or if the help describes it."""
        if self.required or self.default is False or self.default == ():
            return ""
        if self.default is None:
            spelled = mark_of(self.marks, Spelled)
            return "" if spelled is None else spelled.nothing
        if not isinstance(self.default, tuple):
            return _spelled(self.default)
        separated = mark_of(self.marks, Separated)
        usual = "," if typing.get_args(self.kind)[-1] is Ellipsis else " "
        return (separated.by[0] if separated else usual).join(map(_spelled, self.default))


def _spelled(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def is_union(kind: Any) -> bool:
    return typing.get_origin(kind) in (typing.Union, types.UnionType)


def _is_number(kind: Any) -> bool:
    return kind_and_marks(kind)[0] in (int, float)


def field_of(name: str, annotation: Any, default: Any = dataclasses.MISSING) -> Field:
    """Read the declaration of one setting."""
    return Field(name, *kind_and_marks(annotation), default)


def kind_and_marks(kind: Any, marks: tuple[Any, ...] = ()) -> tuple[Any, tuple[Any, ...]]:
    """Separate a type from its marks; the marks of a union's members apply to the whole unless it has its own."""
    if typing.get_origin(kind) is Annotated:
        inner, *own = typing.get_args(kind)
        return kind_and_marks(inner, (*own, *marks))
    if is_union(kind):
        members = [kind_and_marks(member) for member in typing.get_args(kind)]
        inner_marks = [mark for _, member_marks in members for mark in member_marks]
        return typing.Union[tuple(member for member, _ in members)], (*inner_marks, *marks)  # noqa: UP007
    return kind, marks


def _names_files(kind: Any, marks: tuple[Any, ...] = ()) -> bool:
    kind, marks = kind_and_marks(kind, marks)
    return mark_of(marks, NamesFile) is not None or any(map(_names_files, typing.get_args(kind)))


def mark_of(marks: tuple[Any, ...], kind: type) -> Any:
    """Return the last mark of a kind, which is the most specific, or None."""
    return next((mark for mark in reversed(marks) if isinstance(mark, kind)), None)


# Converting and refusing values.


class WrongSetting(BadInput):
    """A setting has a wrong value. The message is `NAME is VALUE; expected WORDS`."""

    def __init__(self, name: str, rest: str) -> None:
        self.name, self.rest = name, rest
        super().__init__(self.called(name))

    def called(self, name: str) -> str:
        """Return the message with the name by which the user knows the setting."""
        return f"{name} {self.rest}"


class _OtherKind(Exception):
    """A value is not of a kind."""


def converted(field: Field, given: Any, place: Callable[[str], Path] = Path) -> Any:
    """Convert a value from Python, from a recipe or from the command line to the kind of a setting.

    Parameters
    ----------
    field : Field
        The setting.
    given : object
        The value. A text may represent a number, or a list with separators between its values.
    place : callable
        Converts the words of a path into a path.

    Returns
    -------
    object
        The value, of the field's kind.

    Raises
    ------
    WrongSetting
        If the value cannot be converted or lies outside its limits.
    """
    if not _is_text(given):
        named = shown(os.fspath(given) if isinstance(given, os.PathLike) else given)
        raise WrongSetting(field.name, f"is {named}; expected UTF-8. Rename the file")
    try:
        return _converted(given, field.kind, field.marks, place)
    except _OtherKind as error:
        is_many = isinstance(given, list | tuple) and given and field.values is not None
        named = _cut(", ".join(map(shown, given))) if is_many else shown(given)
        raise WrongSetting(field.name, f"is {named}; expected {field.words}") from error


def check_decimal_points(field: Field, given: Any) -> None:
    """Refuse a text with commas for a list of any number of numbers, as in a recipe: 1,5 may be one number or two.

    Raises
    ------
    WrongSetting
        If the text has a comma.
    """
    values = field.values
    if values is None or values[-1] is not Ellipsis or not _is_number(values[0]):
        return
    if isinstance(given, str) and "," in given and mark_of(field.marks, Separated) is None:
        rest = "expected decimal points, and semicolons between numbers. Replace the commas"
        raise WrongSetting(field.name, f"is {shown(given)}; {rest}")


def _converted(given: Any, kind: Any, marks: tuple[Any, ...], place: Callable[[str], Path]) -> Any:
    kind, marks = kind_and_marks(kind, marks)
    origin = typing.get_origin(kind)
    if is_union(kind):
        return _of_union(given, kind, marks, place)
    if origin is tuple:
        return _of_tuple(given, kind, marks, place)
    if origin is Literal:
        for value in typing.get_args(kind):
            if isinstance(given, str) and given in (value, value.removeprefix(".")):  # mp4 means .mp4
                return value
    elif kind is type(None):
        spelled = mark_of(marks, Spelled)
        if given is None or (spelled is not None and given == spelled.nothing):
            return None
    elif kind is bool:
        if isinstance(given, bool) or given in ("true", "false"):
            return given if isinstance(given, bool) else given == "true"
    elif kind in (int, float):
        return _number(given, kind, marks)
    elif kind is Path:
        if isinstance(given, str) and given.strip():
            return place(given)
        if isinstance(given, os.PathLike):
            return Path(given)
    elif kind is str:
        return _text(given, marks, place)
    elif isinstance(given, Mapping) and isinstance(origin, type) and issubclass(origin, Mapping):
        return given
    raise _OtherKind


def _of_union(given: Any, kind: Any, marks: tuple[Any, ...], place: Callable[[str], Path]) -> Any:
    """Try the members of a union, texts last, so that the text of a number becomes a number if one is allowed."""
    for member in sorted(typing.get_args(kind), key=lambda one: (one is str, one is Path)):
        try:
            return _converted(given, member, marks, place)
        except _OtherKind:
            continue
    raise _OtherKind


def _of_tuple(given: Any, kind: Any, marks: tuple[Any, ...], place: Callable[[str], Path]) -> tuple[Any, ...]:
    inner = typing.get_args(kind)
    if isinstance(given, str):
        parts: list[Any] = [part.strip() for part in re.split(_separators(inner, marks), given.strip())]
    else:
        parts = list(given) if isinstance(given, list | tuple) else [given]
    kinds = [inner[0]] * len(parts) if inner[-1] is Ellipsis else list(inner)
    if len(kinds) != len(parts) or (not parts and isinstance(given, list)):
        raise _OtherKind
    return tuple(_converted(part, one, (), place) for part, one in zip(parts, kinds, strict=True))


def _separators(inner: tuple[Any, ...], marks: tuple[Any, ...]) -> str:
    """Return the pattern of the separators in a list that is written as one text."""
    separated = mark_of(marks, Separated)
    usual = NUMBER_SEPARATORS if _is_number(inner[0]) else TEXT_SEPARATORS
    by = usual if separated is None else separated.by + usual
    return f"[{by}]+" if " " in by else f"[{by}]"


def _number(given: Any, kind: Any, marks: tuple[Any, ...]) -> float | int:
    if isinstance(given, str):
        if not given.isascii() or "_" in given:  # Python would accept 1_0 and digits of other scripts
            raise _OtherKind
        try:
            given = float(given)
        except ValueError as error:
            raise _OtherKind from error
    if isinstance(given, bool) or not isinstance(given, numbers.Real) or not math.isfinite(given):
        raise _OtherKind
    number: float | int = kind(given)
    if number != given and kind is int:
        raise _OtherKind
    if not within(number, marks):
        raise _OtherKind
    return number


def within(number: float, marks: tuple[Any, ...]) -> bool:
    """Return whether a number respects the limits among the marks."""
    low, above, high = (mark_of(marks, limit) for limit in (Ge, Gt, Le))
    return not (
        (low is not None and number < low.ge)
        or (above is not None and number <= above.gt)
        or (high is not None and number > high.le)
    )


def _text(given: Any, marks: tuple[Any, ...], place: Callable[[str], Path]) -> str:
    if isinstance(given, numbers.Real) and not isinstance(given, bool) and math.isfinite(given):
        given = repr(given)
    elif isinstance(given, os.PathLike):
        given = os.fspath(given)
    choice = mark_of(marks, OneOf)
    if not isinstance(given, str) or not given.strip() or (choice is not None and given not in choice.values):
        raise _OtherKind
    return str(place(given)) if mark_of(marks, NamesFile) is not None else unicodedata.normalize("NFC", given)


def _is_text(given: Any) -> bool:
    """Return whether all texts in a value are UTF-8: the system gives other bytes of file names as lone surrogates."""
    if isinstance(given, list | tuple):
        return all(map(_is_text, given))
    text = os.fspath(given) if isinstance(given, os.PathLike) else given
    return not isinstance(text, str) or not any("\ud800" <= character <= "\udfff" for character in text)


def shown(given: Any) -> str:
    """Return a refused value for a message, cut if it is long."""
    if isinstance(given, str) and not given.strip():
        return "empty"
    if isinstance(given, str) and re.fullmatch(NUMBER_PATTERN, given):
        return given
    if getattr(given, "shape", ()):
        return f"an array of shape {tuple(given.shape)}"
    return _cut(" ".join(repr(list(given) if isinstance(given, tuple) else given).split()))


def _cut(words: str) -> str:
    return words if len(words) <= LONGEST_SHOWN else f"{words[: LONGEST_SHOWN - 3]}..."


# Saying what a kind is.


def worded(kind: Any, marks: tuple[Any, ...] = (), *, many: bool = False) -> str:
    """Describe a value of an annotated kind, or several (`many`)."""
    kind, marks = kind_and_marks(kind, marks)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if is_union(kind):
        members = list(filter(None, dict.fromkeys(worded(member, marks, many=many) for member in inner)))
        return (", or " if any("," in member for member in members) else " or ").join(members)
    if origin is tuple:
        separated = mark_of(marks, Separated)
        like = "" if separated is None else f", such as {separated.example}"
        values = worded(inner[0], many=True)
        if many:
            return f"pairs of {values}" if len(inner) == 2 else f"lists of {values}"
        if inner[-1] is Ellipsis and values.startswith(ONE_OF):
            return f"one or more of {values.removeprefix(ONE_OF)}{like}"
        return f"{'a list of' if inner[-1] is Ellipsis else len(inner)} {values}{like}"
    if origin is list:
        length, values = mark_of(marks, Len), worded(inner[0], many=True)
        if length is not None and length.min_length == length.max_length:
            called = mark_of(marks, Called)
            counted = f"{length.min_length} {values}" if called is None else called.words
            return (
                (f"pairs of {values}" if length.min_length == 2 else f"lists of {counted}")
                if many
                else counted
            )
        least = "" if length is None or many else f", {length.min_length} or more"
        return f"{'lists' if many else 'a list'} of {values}{least}"
    if origin is dict or typing.is_typeddict(kind):
        return "objects" if many else "an object"
    if kind is type(None):
        spelled = mark_of(marks, Spelled)
        return "" if spelled is None else spelled.nothing
    choice, pattern = mark_of(marks, OneOf), mark_of(marks, Pattern)
    if origin is Literal or choice is not None:
        choices = list(map(str, inner if choice is None else choice.values))
        return ONE_OF + ", ".join(choices) if len(choices) > 1 else choices[0]
    if pattern is not None and not many:
        return str(pattern.words)
    one = {
        int: "a whole number",
        float: "a number",
        str: "a text",
        Path: "a path",
        bool: "true or false",
    }.get(kind, "a mapping")
    words = f"{one.removeprefix('a ')}s" if many else one
    return f"{words} {_limits(marks)}".rstrip() if kind in (int, float) else words


def _limits(marks: tuple[Any, ...]) -> str:
    """Describe the limits of a number."""
    low, above, high = mark_of(marks, Ge), mark_of(marks, Gt), mark_of(marks, Le)
    if low is not None:
        return f"from {_figure(low.ge)} " + ("up" if high is None else f"to {_figure(high.le)}")
    parts = [] if above is None else [f"above {_figure(above.gt)}"]
    return ", ".join([*parts, f"up to {_figure(high.le)}"] if high is not None else parts)


def _figure(limit: Any) -> str:
    return f"{limit:,}" if isinstance(limit, int) else f"{limit:g}"


def _metavar(kind: Any, marks: tuple[Any, ...]) -> str:
    kind, marks = kind_and_marks(kind, marks)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if is_union(kind):
        return "|".join(dict.fromkeys(filter(None, (_metavar(member, marks) for member in inner))))
    if origin is Literal:
        return "|".join(inner)
    if origin is tuple:
        one = _metavar(inner[0], ())
        if inner[-1] is not Ellipsis:
            return " ".join([one] * len(inner))
        return f"{one},..." if _is_number(inner[0]) else one
    if kind is type(None):
        return worded(kind, marks)
    choice = mark_of(marks, OneOf)
    if choice is not None:
        return "|".join(choice.values)
    words: dict[Any, str] = {int: "N", float: "NUMBER", Path: "PATH", bool: ""}
    return words.get(kind, "TEXT")


# The same as JSON Schema.


def json_schemas(kind: Any, marks: tuple[Any, ...] = ()) -> list[dict[str, Any]]:
    """Return JSON Schemas of which a value of an annotated kind, as written in a recipe, fits one.

    Limits apply to numbers that are not written as texts.
    """
    kind, marks = kind_and_marks(kind, marks)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    choice = mark_of(marks, OneOf)
    if is_union(kind):
        return [schema for member in inner for schema in json_schemas(member, marks)]
    if origin is tuple:
        return _list_schemas(inner, marks)
    if origin is Literal:
        return [{"enum": sorted({*inner, *(value.removeprefix(".") for value in inner)})}]
    if kind is type(None):
        spelled = mark_of(marks, Spelled)
        return [{"type": "null"}, *([] if spelled is None else [{"const": spelled.nothing}])]
    if kind is bool:
        return [{"type": "boolean"}, {"enum": ["true", "false"]}]
    if kind in (int, float):
        return [number_schema(kind, marks), {"type": "string", "pattern": f"^\\s*{_pattern(kind)}\\s*$"}]
    if kind is Path:
        return [{"type": "string", "pattern": "\\S"}]
    if kind is str:
        texts: list[dict[str, Any]] = [{"type": "string", "pattern": "\\S"}, {"type": "number"}]
        return texts if choice is None else [{"enum": list(choice.values)}]
    return [{"type": "object"}]


def number_schema(kind: Any, marks: tuple[Any, ...]) -> dict[str, Any]:
    """Return the JSON Schema of a number with its limits."""
    names = {Ge: ("minimum", "ge"), Gt: ("exclusiveMinimum", "gt"), Le: ("maximum", "le")}
    limits = {
        name: getattr(mark_of(marks, limit), attribute)
        for limit, (name, attribute) in names.items()
        if mark_of(marks, limit) is not None
    }
    return {"type": "integer" if kind is int else "number", **limits}


def _list_schemas(inner: tuple[Any, ...], marks: tuple[Any, ...]) -> list[dict[str, Any]]:
    each = [{"anyOf": json_schemas(one)} for one in inner if one is not Ellipsis]
    between, one = _separators(inner, marks), rf"\s*{_pattern(inner[0])}\s*"
    if inner[-1] is Ellipsis:
        between = (
            TEXT_SEPARATORS if between == f"[{NUMBER_SEPARATORS}]" else between
        )  # `check_decimal_points`
        text = f"^{one}({between}{one})*$"
        return [
            *each,
            {"type": "array", "minItems": 1, "items": each[0]},
            {"type": "string", "pattern": text},
        ]
    text = f"^{one}({between}{one}){{{len(each) - 1}}}$"
    whole = {"type": "array", "prefixItems": each, "minItems": len(each), "maxItems": len(each)}
    return [whole, {"type": "string", "pattern": text}]


def _pattern(kind: Any) -> str:
    """Return the pattern of a text for one value of a list."""
    bare = kind_and_marks(kind)[0]
    return {int: WHOLE_PATTERN, float: NUMBER_PATTERN}.get(bare, ".+")
