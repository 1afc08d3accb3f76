"""From the words of a recipe to the requests of verbs: one request type serves the command line, Python and batches.

What a setting may be is read from the request's own annotations, so that a verb that gains a setting gains it in
recipes too.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal

from morphspace.errors import BadInput
from morphspace.io.recipes import Job

LIST_SEPARATOR = ";"  # between several values in one text: what a cell of a table has
NUMBER_LISTS = ",;"  # numbers may also be written as on the command line
NOTHING = "none"  # how a text, which a table's cells are, says null
NOT_SETTINGS = ("output",)  # where things go is the batch's to say

Place = Callable[[str], Path]


class WrongKind(Exception):
    """A value is not of a kind; the message says which one was expected."""


def settings_of(request: type) -> tuple[str, ...]:
    """Give the names of a request's settings, in their order."""
    return tuple(field.name for field in dataclasses.fields(request) if field.name not in NOT_SETTINGS)


def required_of(request: type) -> tuple[str, ...]:
    """Give the names of the settings that have no default."""
    return tuple(
        field.name
        for field in dataclasses.fields(request)
        if field.name not in NOT_SETTINGS
        and field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    )


@cache
def kinds_of(request: type) -> Mapping[str, Any]:
    """Give the annotation of each setting, resolved."""
    return typing.get_type_hints(request)


def request_of(job: Job, kind: type, output: Path, place: Place, files: tuple[str, ...]) -> Any:
    """Make the request of a job.

    `place` turns the words of a path into a path; settings named in `files` are texts that are paths too. Raises
    `BadInput` with the line of a setting that is missing or of another kind than the request's.
    """
    for name in required_of(kind):
        if name not in job.settings:
            raise BadInput(f"{job.told}: {job.verb} needs {name}, which is not told")
    values = {}
    for name, given in job.settings.items():
        try:
            values[name] = converted(given, kinds_of(kind)[name], place, name in files)
        except WrongKind as error:
            where = job.lines.get(name, job.where)
            raise BadInput(
                f"{where}: {name} of {job.verb} is {_shown(given)}, {error} was expected"
            ) from error
    return kind(output=output, **values)


def converted(given: Any, kind: Any, place: Place, is_file: bool = False) -> Any:
    """Give a value of the annotated `kind` for what a recipe says. Raises `WrongKind` with the words for the kind."""
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        return _of_union(given, kind, place, is_file)
    if origin is Literal:
        if given in typing.get_args(kind) and not isinstance(given, bool):
            return given
    elif origin is tuple:
        return _of_tuple(given, kind, place, is_file)
    elif kind is type(None):
        if given is None or given == NOTHING:
            return None
    elif kind is bool:
        if isinstance(given, bool) or given in ("true", "false"):
            return given if isinstance(given, bool) else given == "true"
    elif kind in (int, float):
        number = _number(given)
        if number is not None and (kind is float or number == int(number)):
            return kind(number)
    elif kind is Path:
        if isinstance(given, str) and given:
            return place(given)
    elif kind is str:
        return _text(given, place, is_file)
    elif kind is Any or (isinstance(given, dict) and origin is not None and issubclass(origin, Mapping)):
        return given
    raise WrongKind(worded(kind))


def _of_union(given: Any, kind: Any, place: Place, is_file: bool) -> Any:
    """Try the members, texts last: a number in a text is a number where one may stand."""
    members = sorted(typing.get_args(kind), key=lambda member: (member is str, member is Path))
    for member in members:
        try:
            return converted(given, member, place, is_file)
        except WrongKind:
            continue
    raise WrongKind(worded(kind))


def _of_tuple(given: Any, kind: Any, place: Place, is_file: bool) -> tuple[Any, ...]:
    inner = typing.get_args(kind)
    if isinstance(given, str):
        separators = NUMBER_LISTS if set(inner) <= {int, float, Ellipsis} else LIST_SEPARATOR
        for separator in separators:
            given = given.replace(separator, LIST_SEPARATOR)
        parts: list[Any] = [part.strip() for part in given.split(LIST_SEPARATOR)]
    else:
        parts = given if isinstance(given, list) else [given]
    kinds = [inner[0]] * len(parts) if inner[-1] is Ellipsis else list(inner)
    if not parts or len(kinds) != len(parts):
        raise WrongKind(worded(kind))
    return tuple(converted(part, one, place, is_file) for part, one in zip(parts, kinds, strict=True))


def _number(given: Any) -> float | int | None:
    if isinstance(given, bool):
        return None
    if isinstance(given, str):
        if (
            not given.isascii() or "_" in given
        ):  # Python takes 1_0 and digits of other scripts, which no recipe means
            return None
        try:
            given = float(given)
        except ValueError:
            return None
    return given if isinstance(given, int | float) and math.isfinite(given) else None


def _text(given: Any, place: Place, is_file: bool) -> str:
    if isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given):
        given = repr(given)
    if not isinstance(given, str) or not given:
        raise WrongKind(worded(str))
    return str(place(given)) if is_file else given


def worded(kind: Any) -> str:
    """Say in words what a value of an annotated kind is."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        members = dict.fromkeys(worded(member) for member in inner)
        return (", or " if any("," in one for one in members) else " or ").join(members)
    if origin is Literal:
        return "one of " + ", ".join(map(str, inner)) if len(inner) > 1 else str(inner[0])
    if origin is tuple:
        if inner[-1] is Ellipsis:
            return f"a list, each {worded(inner[0])}"
        if len(set(inner)) == 1:
            return f"a list of {len(inner)}, each {worded(inner[0])}"
        return f"a list of {len(inner)}, " + ", ".join(map(worded, inner))
    words = {
        int: "a whole number",
        float: "a finite number",
        str: "a text",
        Path: "the path of a file",
        bool: "true or false",
    }
    return words.get(kind, "null" if kind is type(None) else "a mapping")


def _shown(given: Any) -> str:
    shown = repr(given)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
