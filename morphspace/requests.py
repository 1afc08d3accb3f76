"""Requests: one declaration yields the Python constructor, the command line, recipes and their JSON Schema.

A verb is a file of `morphspace.verbs`. It declares a frozen dataclass, named after the file, whose fields are
settings (`morphspace.settings`), and a function `run` that executes a request. The list of verbs is the list of these
files.
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
    check_decimal_points,
    converted,
    field_of,
)

Request = typing.TypeVar("Request")
Part = typing.TypeVar("Part")

VERBS_PACKAGE = "morphspace.verbs"
GROUPS = {"models": "The networks that find faces: fetched once, then used offline."}
"""First words of verb names, with the help of their group."""
OUTPUT = "output"  # the field with the output path, which a recipe never sets
NOTHING = "none"  # the text for null in a recipe

# Kinds of settings that several verbs share.

ClipText = Annotated[str, NamesFile()]
"""A folder, a quoted glob, a picture, a video, a model or a row of a table, as a text."""

Model = Annotated[Path, Argument("MODEL"), Help("The face model (.morph).")]
Clip = Annotated[
    tuple[ClipText, ...],
    Argument("CLIP..."),
    Help("Image files, a folder, a quoted glob, or a video."),
]
Folder = Annotated[Path, Option("-o", "--output"), Help("The output folder.")]
Crop = Annotated[tuple[int, int, int, int], Separated(",", "10,20,200,240"), Option(metavar="X,Y,W,H")]
Place = Annotated[tuple[float, float], Separated(",", "320,200"), Option(metavar="X,Y")]
Size = Annotated[tuple[int, int], Separated("xX", "200x240"), Option(metavar="WxH")]
FrameCrop = Annotated[Crop | None, Help("Cut this box out of every frame first, px.")]
LEAST_RATE_HZ = 0.01  # Hz; a picture in 100 s of a time-lapse
MOST_RATE_HZ = 10_000.0  # Hz; high-speed cameras
RateHz = Annotated[float, Ge(LEAST_RATE_HZ), Le(MOST_RATE_HZ)]
"""The limits of every frame rate: of settings, files beside clips and tables, videos and models."""

FrameRate = Annotated[
    RateHz | None,
    Option("--frame-rate", metavar="HZ"),
    Help("Frame rate of a video, Hz."),
]
Frames = Annotated[
    tuple[str, ...],
    Option("--frame", metavar="NAME"),
    Help("Only this frame; may be repeated [default: all]."),
]
MaxSd = Annotated[
    float,
    Ge(0.001),
    Le(1000),
    Help(
        "Bound of each loading, SD; larger loadings are compressed smoothly, so that the picture stays a face."
    ),
]
"""The limits lie far outside the loadings of faces, which are within 3 SD."""
Workers = Annotated[
    int | None,
    Ge(1),
    Le(1024),
    Option(metavar="N"),
    Help("Number of frames or stimuli that are computed at the same time [default: one per core]."),
]
Seed = Annotated[int, Ge(0), Help("Seed of the random numbers; the same seed gives the same result.")]
MimicryMethod = Literal["auto", "paper", "map", "transfer", "guided"]
VideoSuffix = Literal[".mp4", ".mkv"]
VideoOrPictures = Annotated[
    VideoSuffix | None,
    Help(
        "Draw the frames as one video: .mp4 plays everywhere, .mkv is lossless; the point is optional "
        "[default: one picture per frame]."
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
    """Return one setting of a request by name."""
    return next(field for field in fields_of(request) if field.name == name)


@typing.dataclass_transform(frozen_default=True)
def declared(request: type[Request]) -> type[Request]:
    """Turn a class with annotated fields into a request: a frozen dataclass that converts and checks its fields.

    The constructor raises `WrongSetting` if a value cannot be converted or lies outside its limits. It then calls the
    method `check` of the class, if any, which compares settings with each other.
    """
    setattr(request, "__post_init__", _convert)  # noqa: B010  # mypy does not know the attribute
    return dataclass(frozen=True)(request)


@typing.dataclass_transform(frozen_default=True)
def declared_with(group: type) -> Callable[[type[Request]], type[Request]]:
    """Declare a request that also has the settings of a group, after its own; `settings_in` gives the group again."""

    def decorated(request: type[Request]) -> type[Request]:
        for field in dataclasses.fields(group):
            request.__annotations__[field.name] = typing.get_type_hints(group, include_extras=True)[
                field.name
            ]
            setattr(request, field.name, field.default)
        return declared(request)

    return decorated


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
    """Build a request from the settings of a recipe.

    Parameters
    ----------
    kind : type
        The request.
    settings : mapping
        Values by the names of settings; the text `none` means None if the setting allows it.
    place : callable
        Converts the words of a path into a path.
    **more
        Settings that a recipe cannot set, unconverted.

    Raises
    ------
    WrongSetting
        If a setting is missing or has a wrong value, or a text has commas between numbers.
    """
    values = {}
    for field in fields_of(kind):
        if field.name in settings:
            given = settings[field.name]
            check_decimal_points(field, given)
            is_nothing = field.optional and isinstance(given, str) and given == NOTHING
            values[field.name] = None if is_nothing else converted(field, given, place)
        elif field.required and field.name not in more:
            raise WrongSetting(field.name, f"is missing; expected {field.words}")
    return kind(**values, **more)


def settings_in(request: Any, kind: type[Part], **more: Any) -> Part:
    """Build the settings of a room from the fields that a request and the room's dataclass share, and `more`."""
    kind_of_request: type = type(request)
    shared = {field.name for field in fields_of(kind_of_request)} - set(more)
    own: Any = dataclasses.fields(typing.cast(Any, kind))
    return kind(**{one.name: getattr(request, one.name) for one in own if one.name in shared}, **more)


def check_rate(rate_hz: float, what: str) -> float:
    """Return a frame rate, Hz, within the limits of `RateHz`. Raises `BadInput`, which names it as `what`."""
    if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        raise BadInput(
            f"{what} is {rate_hz:g} Hz; expected {LEAST_RATE_HZ:g} to {MOST_RATE_HZ:g}. Give the true rate"
        )
    return rate_hz


# How clips are read.


@declared
class ClipOptions:
    """How a verb reads its clips: the settings that all verbs with clips share."""

    deinterlace: Annotated[
        bool,
        Help("Make whole frames of interlaced video with FFmpeg's bwdif; without it such video is refused."),
    ] = False
    person: Annotated[
        Literal["largest", "left", "right"] | Place | None,
        Option(metavar="largest|left|right|X,Y"),
        Help(
            "Which face is used if frames show several; X,Y is a place in the frames, px [default: the largest, or "
            "as in the build of the model that reads them]."
        ),
    ] = None
    frame_rate_hz: Annotated[
        RateHz | None,
        Option("--frame-rate", metavar="HZ"),
        Help("Frame rate of a clip or table, Hz; its times are stretched to it [default: its own]."),
    ] = None


AS_IT_IS = ClipOptions()
"""A clip is read without any option."""

CLIP_OPTIONS = tuple(field.name for field in fields_of(ClipOptions))


def clip_options(request: Any) -> ClipOptions:
    """Return the options of clips in a request; the defaults if it has none."""
    return settings_in(request, ClipOptions)


def check_no_options(options: ClipOptions, why: str, *but: str) -> None:
    """Refuse options, except those named in `but`, where no clip is read, which `why` explains. Raises `BadInput`."""
    for field in fields_of(ClipOptions):
        if field.name not in but and getattr(options, field.name) != field.default:
            raise BadInput(f"{field.spoken} applies to clips, but {why}. Leave it out")


# Records of requests.


def request_document(request: Any) -> dict[str, Any]:
    """Return a request as JSON: every field but `output`, with paths as given (`recorded_path`)."""
    return {field.name: _recorded(getattr(request, field.name)) for field in settings_of(type(request))}


def _recorded(value: Any) -> Any:
    if isinstance(value, Path):
        return recorded_path(value)
    if isinstance(value, str) and Path(value).is_absolute():
        return recorded_path(Path(value))
    if isinstance(value, tuple | list):
        return [_recorded(one) for one in value]
    if isinstance(value, Mapping):
        return {str(key): _recorded(one) for key, one in value.items()}
    return value


def recorded_path(path: Path) -> str:
    """Return a path for records: as given, or relative to the working folder, or else the file name alone.

    Records do not disclose the folders of a user.
    """
    if not path.is_absolute():
        return path.as_posix()
    folder = Path.cwd()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name


# The verbs.


@dataclass(frozen=True)
class Verb:
    """A verb: its `name` on the command line, the `module` of its file, and the type of its `request`.

    A recipe may use a verb that has a `plan(request, model)`, with `model` None if the verb opens its own, or a
    `check(request)`.
    """

    name: str
    module: types.ModuleType
    request: type

    @property
    def run(self) -> Callable[..., Any]:
        """Return the function that executes a request: a generator of steps that returns an `Outcome`."""
        return self.module.run

    @property
    def plan(self) -> Callable[..., Any] | None:
        """Return the function that plans the stimuli for a larger set, or None."""
        return getattr(self.module, "plan", None)

    @property
    def check(self) -> Callable[[Any], None] | None:
        """Return the function that checks a request before a folder is filled, or None."""
        return getattr(self.module, "check", None)

    def asked(self, request: Any) -> int:
        """Return the number of stimuli requested, so that excessive requests are refused before planning."""
        return self.module.asked(request) if hasattr(self.module, "asked") else 1

    @property
    def help(self) -> str:
        """Return the help of the verb: the docstring of its request."""
        return typing.cast(str, self.request.__doc__)

    @property
    def settings(self) -> tuple[str, ...]:
        """Return the names of the fields that a recipe may set: all but the output."""
        return tuple(field.name for field in settings_of(self.request))

    @property
    def files(self) -> tuple[str, ...]:
        """Return the names of the text settings that name files (`NamesFile`)."""
        return tuple(field.name for field in settings_of(self.request) if field.names_files)


def settings_of(request: type) -> tuple[Field, ...]:
    """Return all fields of a request but the output."""
    return tuple(field for field in fields_of(request) if field.name != OUTPUT)


@cache
def _files() -> dict[str, str]:
    """Return the file of each verb, without its suffix, by the name of the verb."""
    package = importlib.import_module(VERBS_PACKAGE)
    files = [module.name for module in pkgutil.iter_modules(package.__path__)]
    return {_name_of(file): file for file in files}


def _name_of(file: str) -> str:
    """Return the name of a verb: words with hyphens, and a space after the name of a group."""
    group, _, rest = file.partition("_")
    return f"{group} {rest.replace('_', '-')}" if rest and group in GROUPS else file.replace("_", "-")


def verb_names() -> tuple[str, ...]:
    """Return the names of all verbs on the command line."""
    return tuple(_files())


@cache
def verb_named(name: str) -> Verb:
    """Import the file of a verb and return its `Verb`. Raises `BadInput` for an unknown name."""
    if name not in _files():
        raise BadInput(f"the verb is {name!r}; expected one of {', '.join(verb_names())}")
    file = _files()[name]
    module = importlib.import_module(f"{VERBS_PACKAGE}.{file}")
    return Verb(name, module, getattr(module, _request_name(file)))


def _request_name(file: str) -> str:
    return "".join(map(str.capitalize, file.split("_"))) + "Request"


def all_verbs() -> Iterator[Verb]:
    """Import and yield all verbs."""
    return map(verb_named, verb_names())


@cache
def recipe_verbs() -> Mapping[str, Verb]:
    """Import all verbs and return, by name, those that a recipe may use."""
    return {verb.name: verb for verb in all_verbs() if verb.plan or verb.check}
