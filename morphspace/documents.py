"""JSON documents: one declaration yields the check of a file that is read, and its JSON Schema (ours).

A document is declared as a `TypedDict`, because a document is read, passed on and written as a plain mapping:

    class Faceframe(TypedDict):
        format: Literal["morphspace-faceframe"]
        image: Annotated[str, Help("Name of the picture.")]
        size: NotRequired[Size]

Entries are annotated like the settings of a request (`morphspace.settings`), and messages describe them by the same
words. Values are exact: neither the text "1" nor true is the number 1, and 1.0 is no whole number. There are no other
entries, unless a document is `Open`.
"""

from __future__ import annotations

import json
import re
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, NotRequired

from annotated_types import Gt, Le, Len

from morphspace.errors import UnreadableFile
from morphspace.requests import RateHz
from morphspace.settings import (
    LONGEST_SHOWN,
    Called,
    Field,
    OneOf,
    Pattern,
    Spelled,
    WrongSetting,
    field_of,
    is_union,
    kind_and_marks,
    mark_of,
    number_schema,
    within,
    worded,
)
from morphspace.storage import parsed_json

Shape = typing.TypeVar("Shape", bound=Mapping[str, Any])
Value = typing.TypeVar("Value")
Schema = dict[str, Any]

# A sidecar has 20 bytes a loading: an hour of 60 frames a second in 100 components
LARGEST_BYTES = 500_000_000
LONGEST_KEY = 40  # characters of a key in a message


@dataclass(frozen=True)
class Open:
    """A mark of an object that may have other entries, which are kept."""


@dataclass(frozen=True)
class Holds:
    """The entries that an object without own declaration always has."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class OneLength:
    """A mark of a list of lists that have all the same length."""


# Kinds of entries that several documents share.


class Meaning(typing.TypedDict):
    """The unit of a column of a table, empty if it has none, and what it means."""

    unit: str
    meaning: str


OrNull = Annotated[Value | None, Spelled("null")]
Digest = Annotated[str, Pattern("[0-9a-f]{64}", "a SHA-256 of 64 hexadecimal digits")]
Digests = dict[str, Digest]
ModelId = Annotated[str, Pattern("[0-9a-f]{16}", "16 hexadecimal digits")]
Line = Annotated[str, Pattern(r"[^\x00-\x1f\x7f]*", "a text on one line")]
FileName = Annotated[str, Pattern("[^/]+", "the name of a file without its folder")]
Versions = Annotated[dict[str, str], Holds(("morphspace", "python"))]
Side = Annotated[int, Gt(0), Le(1_000_000)]
Size = Annotated[list[Side], Len(2, 2), Called("[width, height] in px")]
Point = Annotated[list[float], Len(2, 2), Called("[x, y] in px")]
Columns = Annotated[dict[str, Meaning], Len(1)]
Table = Annotated[list[list[float]], Len(1), OneLength()]
FrameRate = RateHz


@dataclass(frozen=True)
class Document(Generic[Shape]):
    """A kind of file that holds one JSON document.

    Attributes
    ----------
    name : str
        The name of its schema in `data_spec/`.
    title : str
        The title of its schema.
    shape : type
        The `TypedDict` with its entries.
    remedy : str
        What the user can do about a wrong entry.
    instead : str
        What the user can do about a file of another format; `remedy` if it is empty.
    marks : tuple
        `Open()` if other entries are kept.
    """

    name: str
    title: str
    shape: type[Shape]
    remedy: str = "Copy the file again"
    instead: str = ""
    marks: tuple[Any, ...] = ()

    @property
    def format(self) -> str:
        """Return the text by which a file of this kind names its format."""
        return str(typing.get_args(entries_of(self.shape)["format"].kind)[0])

    def schema(self) -> Schema:
        """Return the JSON Schema."""
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": self.title}
        return {**head, **_schema_of(self.shape, self.marks)}

    def checked(self, document: Any, path: Path) -> Shape:
        """Return a document that was read from `path`. Raises `UnreadableFile` if it is not as declared."""
        try:
            _check(document, self.shape, "", self.marks)
        except WrongSetting as error:
            remedies = {
                "": self.instead,
                "format": self.instead,
                "version": "Install the morphspace that wrote it",
            }
            remedy = remedies.get(error.name) or self.remedy
            raise UnreadableFile(f"{path}: {error.called(error.name or 'it')}. {remedy}") from error
        return typing.cast(Shape, document)

    def read(self, path: Path) -> Shape:
        """Read a document. Raises `UnreadableFile` if it cannot be read or is not as declared."""
        return self.checked(read_json(path), path)


def read_json(path: Path) -> Any:
    """Read a file of JSON. Raises `UnreadableFile` if it is missing, too large, or not JSON in UTF-8."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    if len(content) > LARGEST_BYTES:
        raise UnreadableFile(f"{path} is larger than {LARGEST_BYTES:,} bytes; expected less. Check the name")
    try:
        return parsed_json(content)
    except ValueError as error:
        reason = error if content.strip() else "it is empty"
        raise UnreadableFile(f"{path} is not JSON: {reason}. Correct it or write it again") from error


def read_json_object(path: Path) -> dict[str, Any]:
    """Read any JSON object. Raises `UnreadableFile` if the file cannot be read or holds something else."""
    document = read_json(path)
    if not isinstance(document, dict):
        raise UnreadableFile(f"{path}: it is {_shown(document)}; expected an object. Write it again")
    return document


@cache
def entries_of(shape: type) -> dict[str, Field]:
    """Read the declaration of a document: its entries by name; one that may be missing has the default `...`."""
    hints = typing.get_type_hints(shape, include_extras=True)
    default = {} if getattr(shape, "__total__", True) else {"default": ...}
    return {
        name: field_of(name, typing.get_args(hint)[0], ...)
        if typing.get_origin(hint) is NotRequired
        else field_of(name, hint, **default)
        for name, hint in hints.items()
    }


# Checking.


def _check(value: Any, kind: Any, name: str, marks: tuple[Any, ...] = ()) -> None:
    """Raise `WrongSetting` with the path of the first entry that is not of its kind."""
    kind, marks = kind_and_marks(kind, marks)
    if is_union(kind):
        _check_union(value, kind, name, marks)
    elif typing.is_typeddict(kind) and isinstance(value, dict):
        _check_entries(value, kind, name, marks)
    elif typing.get_origin(kind) is dict and isinstance(value, dict):
        _check_mapping(value, kind, name, marks)
    elif typing.get_origin(kind) is list and isinstance(value, list):
        _check_list(value, kind, name, marks)
    elif not _fits(value, kind, marks):
        raise _wrong(value, kind, name, marks)


def _wrong(value: Any, kind: Any, name: str, marks: tuple[Any, ...]) -> WrongSetting:
    return WrongSetting(name, f"is {_shown(value)}; expected {worded(kind, marks)}")


def _shown(value: Any) -> str:
    """Return a value for a message as JSON spells it, cut if it is long."""
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."


def _check_union(value: Any, kind: Any, name: str, marks: tuple[Any, ...]) -> None:
    """Try all members; if none fits, report the one in which the value fits furthest."""
    errors = []
    for member in typing.get_args(kind):
        try:
            return _check(value, member, name, marks)
        except WrongSetting as error:
            errors.append(error)
    deepest = max(errors, key=lambda error: len(error.name))
    raise deepest if deepest.name != name else _wrong(value, kind, name, marks)


def _check_entries(value: Mapping[str, Any], shape: Any, name: str, marks: tuple[Any, ...]) -> None:
    fields = entries_of(shape)
    for key, field in fields.items():
        if key in value:
            _check(value[key], field.kind, _inside(name, key), field.marks)
        elif field.required:
            raise WrongSetting(_inside(name, key), f"is missing; expected {field.words}")
    unknown = [key for key in value if key not in fields]
    if unknown and mark_of(marks, Open) is None:
        raise WrongSetting(_inside(name, unknown[0]), f"is unknown; expected only {', '.join(fields)}")


def _check_mapping(value: Mapping[str, Any], kind: Any, name: str, marks: tuple[Any, ...]) -> None:
    key_kind, each = typing.get_args(kind)
    holds, length = mark_of(marks, Holds), mark_of(marks, Len)
    for key in () if holds is None else holds.names:
        if key not in value:
            raise WrongSetting(_inside(name, key), f"is missing; expected {worded(each, (Spelled('null'),))}")
    if length is not None and len(value) < length.min_length:
        raise WrongSetting(name, f"is empty; expected {length.min_length} entry or more")
    for key, one in value.items():
        if not _fits(key, *kind_and_marks(key_kind)):
            raise WrongSetting(name, f"has the entry {_shown(key)}; expected {worded(key_kind)}")
        _check(one, each, _inside(name, key))


def _check_list(value: list[Any], kind: Any, name: str, marks: tuple[Any, ...]) -> None:
    (each,) = typing.get_args(kind)
    length = mark_of(marks, Len)
    if length is not None and not length.min_length <= len(value) <= (length.max_length or len(value)):
        raise _wrong(value, kind, name, marks)
    if each is float and {*map(type, value)} <= {float, int}:
        return  # a table has up to millions
    for place, one in enumerate(value):
        _check(one, each, f"{name}[{place}]")
    if mark_of(marks, OneLength) is not None and len({*map(len, value)}) > 1:
        place = next(place for place, row in enumerate(value) if len(row) != len(value[0]))
        raise WrongSetting(
            f"{name}[{place}]",
            f"has {len(value[place])} values; expected {len(value[0])} as in the first row",
        )


def _fits(value: Any, kind: Any, marks: tuple[Any, ...]) -> bool:
    """Return whether a value without parts is exactly of a kind and within its limits."""
    if typing.get_origin(kind) is Literal:
        return any(type(value) is type(one) and value == one for one in typing.get_args(kind))
    if kind in (int, float):
        return type(value) in {int, kind} and within(value, marks)
    if kind is str and isinstance(value, str):
        choice, pattern = mark_of(marks, OneOf), mark_of(marks, Pattern)
        is_chosen = choice is None or value in choice.values
        return is_chosen and (pattern is None or re.fullmatch(pattern.regex, value) is not None)
    return kind is Any or type(value) is kind


def _inside(name: str, key: str) -> str:
    key = key if key.isprintable() and 0 < len(key) <= LONGEST_KEY else _shown(key)
    return f"{name}.{key}" if name else key


# The same as JSON Schema.


def _schema_of(kind: Any, marks: tuple[Any, ...] = ()) -> Schema:
    kind, marks = kind_and_marks(kind, marks)
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    length, pattern, choice = (mark_of(marks, mark) for mark in (Len, Pattern, OneOf))
    if is_union(kind):
        return {"anyOf": [_schema_of(member, marks) for member in inner]}
    if typing.is_typeddict(kind):
        fields = entries_of(kind)
        return {
            "type": "object",
            "required": [key for key, field in fields.items() if field.required],
            "additionalProperties": mark_of(marks, Open) is not None,
            "properties": {
                key: ({"description": field.help} if field.help else {}) | _schema_of(field.kind, field.marks)
                for key, field in fields.items()
            },
        }
    if origin is dict:
        holds, names, each = mark_of(marks, Holds), _schema_of(inner[0]), _schema_of(inner[1])
        return {
            "type": "object",
            **({} if holds is None else {"required": list(holds.names)}),
            **({} if length is None else {"minProperties": length.min_length}),
            **({} if names == {"type": "string"} else {"propertyNames": names}),
            **({"additionalProperties": each} if each else {}),
        }
    if origin is list:
        most = {} if length is None or length.max_length is None else {"maxItems": length.max_length}
        least = {} if length is None else {"minItems": length.min_length}
        return {"type": "array", **least, **most, "items": _schema_of(inner[0])}
    if origin is Literal or choice is not None:
        values = list(inner if choice is None else choice.values)
        return {"const": values[0]} if len(values) == 1 else {"enum": values}
    if kind in (int, float):
        return number_schema(kind, marks)
    if kind is str:
        return {"type": "string", **({} if pattern is None else {"pattern": f"^(?:{pattern.regex})$"})}
    return {} if kind is Any else {"type": "boolean" if kind is bool else "null"}
