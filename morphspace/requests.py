"""What a request is, and which verbs there are.

A verb is a file of `morphspace.verbs`: a frozen request, called after the file, and a `run` that does it. The list of
verbs is the list of these files. Ours.
"""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput

VERBS_PACKAGE = "morphspace.verbs"


@dataclass(frozen=True)
class NamesFile:
    """Marks a setting that is a text and the name of a file or clip at once: a recipe opens it from its own folder."""


ClipText = typing.Annotated[str, NamesFile()]
"""A folder, a quoted glob, a picture, a video, a model or a row of a table, as a text."""


@dataclass(frozen=True)
class Verb:
    """A verb: its `name` on the command line, the type of its `request`, and what its file does with one.

    `plan(request, model)` gives the planned set of a verb whose stimuli may join a larger set; `model` is None where
    the verb opens its own. `check(request)` raises what can be found out before a verb fills a folder of its own.
    `asked(request)` counts the stimuli that are asked for outright, so that too many are refused before planning.
    A recipe may use the verbs that have a `plan` or a `check`.
    """

    name: str
    request: type
    run: Callable[..., Any]
    plan: Callable[[Any, Any], Any] | None = None
    check: Callable[[Any], None] | None = None
    asked: Callable[[Any], int] = lambda request: 1

    @property
    def settings(self) -> tuple[str, ...]:
        """Give the names of the fields a recipe may set: all but where the output goes."""
        return tuple(field.name for field in dataclasses.fields(self.request) if field.name != "output")

    @property
    def files(self) -> tuple[str, ...]:
        """Give the names of the settings that are texts and names of files at once (`NamesFile`)."""
        hints = typing.get_type_hints(self.request, include_extras=True)
        return tuple(name for name in self.settings if _names_file(hints[name]))


def _names_file(hint: Any) -> bool:
    if any(isinstance(mark, NamesFile) for mark in getattr(hint, "__metadata__", ())):
        return True
    return any(_names_file(inner) for inner in typing.get_args(hint))


@cache
def verb_names() -> tuple[str, ...]:
    """Give the names of all verbs, as the command line calls them, from the files of `morphspace.verbs`."""
    package = importlib.import_module(VERBS_PACKAGE)
    return tuple(module.name.replace("_", "-") for module in pkgutil.iter_modules(package.__path__))


@cache
def verb_named(name: str) -> Verb:
    """Import the file of a verb and give its `Verb`. Raises `BadInput` for a name that no verb has."""
    if name not in verb_names():
        raise BadInput(f"the verb is {name!r}; expected one of {', '.join(verb_names())}")
    file = name.replace("-", "_")
    module = importlib.import_module(f"{VERBS_PACKAGE}.{file}")
    request = getattr(module, "".join(map(str.capitalize, file.split("_"))) + "Request", None)
    if request is None:
        raise BadInput(f"{file}.py of the verbs declares no request; expected a class named after the file")
    optional = {key: getattr(module, key) for key in ("plan", "check", "asked") if hasattr(module, key)}
    return Verb(name, request, module.run, **optional)


@cache
def recipe_verbs() -> Mapping[str, Verb]:
    """Import every verb and give, by name, those that a recipe may use."""
    verbs = {name: verb_named(name) for name in verb_names() if _declares(name)}
    return {name: verb for name, verb in verbs.items() if verb.plan or verb.check}


def _declares(name: str) -> bool:
    file = name.replace("-", "_")
    module = importlib.import_module(f"{VERBS_PACKAGE}.{file}")
    return hasattr(module, "".join(map(str.capitalize, file.split("_"))) + "Request")


def request_document(request: Any) -> dict[str, Any]:
    """Give a frozen request as JSON: every field but `output`, paths as they were given (`told_path`)."""
    return {
        entry.name: _told(getattr(request, entry.name))
        for entry in dataclasses.fields(request)
        if entry.name != "output"
    }


def _told(value: Any) -> Any:
    if isinstance(value, Path):
        return told_path(value)
    if isinstance(value, str) and Path(value).is_absolute():
        return told_path(Path(value))
    if isinstance(value, tuple | list):
        return [_told(one) for one in value]
    if isinstance(value, Mapping):
        return {str(key): _told(one) for key, one in value.items()}
    return value


def told_path(path: Path) -> str:
    """Give a path as records tell it: as it was given, or where that was absolute from the working folder, or its name.

    Where a person keeps files is nobody's business who gets a stimulus.
    """
    if not path.is_absolute():
        return path.as_posix()
    folder = Path.cwd()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name
