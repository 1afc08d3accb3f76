"""What a request is: one declaration gives the Python constructor, the command line, recipes and their JSON Schema.

A verb is a file of `morphspace.verbs`. It declares a frozen dataclass, named after the file, whose fields are settings
(`morphspace.settings`), and a `run` that does what an instance asks for. The list of verbs is the list of these files.
"""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from morphspace.errors import BadInput
from morphspace.settings import (
    Argument,
    Field,
    Help,
    NamesFile,
    Option,
    Separated,
    WrongSetting,
    converted,
    field_of,
)

Request = typing.TypeVar("Request")

VERBS_PACKAGE = "morphspace.verbs"
GROUPS = {"models": "The networks that find faces: fetched once, then used offline."}
"""The first words of the names of several verbs, and what these are about."""
OUTPUT = "output"  # the field that says where results go, which a recipe never sets
NOTHING = "none"  # how a text of a recipe says null

# Kinds of settings that several verbs share.

ClipText = Annotated[str, NamesFile()]
"""A folder, a quoted glob, a picture, a video, a model or a row of a table, as a text."""

Model = Annotated[Path, Argument("MODEL"), Help("The face model (.morph).")]
Clip = Annotated[
    tuple[ClipText, ...],
    Argument("CLIP..."),
    Help("Image files, a folder, a quoted glob, or a video."),
]
Folder = Annotated[Path, Option("-o", "--output"), Help("The folder to write into.")]
Crop = Annotated[tuple[int, int, int, int], Separated(",", "10,20,200,240"), Option(metavar="X,Y,W,H")]
Size = Annotated[tuple[int, int], Separated("xX", "200x240"), Option(metavar="WxH")]
FrameCrop = Annotated[Crop | None, Help("Cut this box out of every frame first, px.")]
FrameRate = Annotated[
    float | None,
    Ge(1),
    Le(1000),
    Option("--frame-rate", metavar="HZ"),
    Help("Frames a second of a video."),
]
Frames = Annotated[
    tuple[str, ...],
    Option("--frame", metavar="NAME"),
    Help("Only this frame; may be given again [default: all]."),
]
Seed = Annotated[int, Ge(0), Help("The same seed gives the same result.")]
MimicryMethod = Literal["auto", "paper", "map", "transfer", "guided"]
VideoSuffix = Literal[".mp4", ".mkv"]
VideoOrPictures = Annotated[
    VideoSuffix | None,
    Help(
        "Draw the frames as one motion: .mp4 for people, .mkv lossless; the point may be left out "
        "[default: a picture a frame]."
    ),
]
VIDEO_SUFFIXES: tuple[VideoSuffix, ...] = typing.get_args(VideoSuffix)


@cache
def fields_of(request: type) -> tuple[Field, ...]:
    """Read the declaration of a request.

    Parameters
    ----------
    request : type
        A frozen dataclass with annotated fields.

    Returns
    -------
    tuple of Field
        Its settings, in their order.
    """
    hints = typing.get_type_hints(request, include_extras=True)
    fields: Any = dataclasses.fields(request)
    return tuple(field_of(one.name, hints[one.name], one.default) for one in fields)


def field_named(request: type, name: str) -> Field:
    """Give one setting of a request by its name."""
    return next(field for field in fields_of(request) if field.name == name)


@typing.dataclass_transform(frozen_default=True)
def declared(request: type[Request]) -> type[Request]:
    """Make a class with annotated fields a request: a frozen dataclass whose constructor converts and checks them.

    The constructor raises `WrongSetting` where a value cannot be converted or lies outside its limits. A class may
    compare its settings with each other in a method `check`, which then follows.
    """
    setattr(request, "__post_init__", _convert)  # noqa: B010  # mypy knows no such attribute
    return dataclass(frozen=True)(request)


def _convert(request: Any) -> None:
    kind: type = type(request)
    for field in fields_of(kind):
        value = converted(field, getattr(request, field.name))
        object.__setattr__(request, field.name, value)
    if hasattr(request, "check"):
        request.check()


def request_from(
    kind: type, settings: Mapping[str, Any], place: Callable[[str], Path] = Path, **more: Any
) -> Any:
    """Make a request of what a recipe says.

    Parameters
    ----------
    kind : type
        The request.
    settings : mapping
        Values by the names of settings; the text `none` stands for None where that is a value.
    place : callable
        Turns the words of a path into a path.
    **more
        Settings that the recipe does not have, as they are.

    Raises
    ------
    WrongSetting
        Where a setting is missing, or has a value it cannot have.
    """
    values = {}
    for field in fields_of(kind):
        if field.name in settings:
            given = settings[field.name]
            is_nothing = field.optional and isinstance(given, str) and given == NOTHING
            values[field.name] = None if is_nothing else converted(field, given, place)
        elif field.required and field.name not in more:
            raise WrongSetting(field.name, f"is missing; expected {field.words}")
    return kind(**values, **more)


# Records of requests.


def request_document(request: Any) -> dict[str, Any]:
    """Give a frozen request as JSON: every field but `output`, paths as they were given (`told_path`)."""
    return {field.name: _told(getattr(request, field.name)) for field in settings_of(type(request))}


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
    """Give a path as records name it: as it was given, or from the working folder, or else its last part alone.

    Where a person keeps files is nobody's business who gets a stimulus.
    """
    if not path.is_absolute():
        return path.as_posix()
    folder = Path.cwd()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


# The verbs.


@dataclass(frozen=True)
class Verb:
    """A verb: its `name` on the command line, the `module` that is its file, and the type of its `request`.

    A recipe may use the verbs that have a `plan(request, model)`, where `model` is None if the verb opens its own, or a
    `check(request)`.
    """

    name: str
    module: types.ModuleType
    request: type

    @property
    def run(self) -> Callable[..., Any]:
        """What does it: a generator of steps that gives an `Outcome`."""
        return self.module.run

    @property
    def plan(self) -> Callable[..., Any] | None:
        """What plans its stimuli for a larger set, or None."""
        return getattr(self.module, "plan", None)

    @property
    def check(self) -> Callable[[Any], None] | None:
        """What finds out before it runs whether it can fill a folder of its own, or None."""
        return getattr(self.module, "check", None)

    def asked(self, request: Any) -> int:
        """Count the stimuli that are asked for outright, so that too many are refused before they are planned."""
        return self.module.asked(request) if hasattr(self.module, "asked") else 1

    @property
    def help(self) -> str:
        """What it does: the docstring of its request."""
        return typing.cast(str, self.request.__doc__)

    @property
    def settings(self) -> tuple[str, ...]:
        """Give the names of the fields a recipe may set: all but where the output goes."""
        return tuple(field.name for field in settings_of(self.request))

    @property
    def files(self) -> tuple[str, ...]:
        """Give the names of the settings that are texts and names of files at once (`NamesFile`)."""
        return tuple(field.name for field in settings_of(self.request) if field.names_files)


def settings_of(request: type) -> tuple[Field, ...]:
    """Give the fields of a request that say what is made: all but where the output goes."""
    return tuple(field for field in fields_of(request) if field.name != OUTPUT)


@cache
def _files() -> dict[str, str]:
    """Give the file of each verb, without its suffix, by the name of the verb."""
    package = importlib.import_module(VERBS_PACKAGE)
    files = [module.name for module in pkgutil.iter_modules(package.__path__)]
    return {_name_of(file): file for file in files}


def _name_of(file: str) -> str:
    """Give the name of a verb: words with hyphens, the first apart where it is a group's."""
    group, _, rest = file.partition("_")
    return f"{group} {rest.replace('_', '-')}" if rest and group in GROUPS else file.replace("_", "-")


def verb_names() -> tuple[str, ...]:
    """Give the names of all verbs, as the command line calls them."""
    return tuple(_files())


@cache
def verb_named(name: str) -> Verb:
    """Import the file of a verb and give its `Verb`. Raises `BadInput` for a name that no verb has."""
    if name not in _files():
        raise BadInput(f"the verb is {name!r}; expected one of {', '.join(verb_names())}")
    file = _files()[name]
    module = importlib.import_module(f"{VERBS_PACKAGE}.{file}")
    return Verb(name, module, getattr(module, _request_name(file)))


def _request_name(file: str) -> str:
    return "".join(map(str.capitalize, file.split("_"))) + "Request"


def all_verbs() -> Iterator[Verb]:
    """Import the files of all verbs, and give them."""
    return map(verb_named, verb_names())


@cache
def recipe_verbs() -> Mapping[str, Verb]:
    """Import every verb and give, by name, those that a recipe may use."""
    return {verb.name: verb for verb in all_verbs() if verb.plan or verb.check}
