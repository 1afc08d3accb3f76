"""Recipes: a stimulus set as a text, in YAML with factors to cross or as a CSV with one stimulus a row.

`data_spec/recipe.md` describes both. A recipe is checked as a whole before anything is opened: every key is known,
every place in braces is filled, and each refusal names the line and what was probably meant. What comes out is a
list of jobs, each a verb with its settings; which settings a verb has is told by who runs them. Ours.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.placeholders import WORD, filled, nearest, pieces_of, places_in
from morphspace.io.recipe_text import Lined, Spot, read_rows, read_yaml

RECIPE_FORMAT = "morphspace-recipe"
RECIPE_VERSION = 1
KEYS = ("format", "version", "description", "sources", "factors", "stimuli")
REQUIRED = ("format", "version", "stimuli")
OWN_KEYS = ("verb", "name")  # of an entry, beside the settings of its verb
FACTOR_COLUMN = "factor:"  # opens the heading of a CSV column that is a condition for the manifest
PLAIN_LEVEL = "value"  # {gain.value} where the levels of gain are named: {low: 0.5, high: 1.5}

SPOKEN = {  # how the command line calls settings, where its words are others
    "op": "operations",
    "ops": "operations",
    "at": "positions",
    "a": "first",
    "b": "last",
    "src": "source",
    "dst": "target",
}

VerbSettings = Mapping[str, Collection[str]]


@dataclass(frozen=True, eq=False)
class Factor:
    """What is varied: `levels` by how they are called (a text or a number), each with the entries it brings.

    A level of a plain list brings nothing: it is its own value.
    """

    name: str
    levels: Mapping[Any, Mapping[str, Any]]

    def known(self, level: Any) -> dict[str, Any]:
        """Give what the places of this factor stand for at one level: `identity`, `identity.loadings`."""
        return {
            self.name: level,
            **{f"{self.name}.{key}": value for key, value in self.levels[level].items()},
        }


@dataclass(frozen=True, eq=False)
class Entry:
    """One entry of a recipe: verb, settings with places unfilled, the name's pattern or None, factors in order.

    `labels` are conditions a table tells of its row; `where` opens a message about the entry; `lines` has the place
    of each setting for the same end.
    """

    verb: str
    settings: Mapping[str, Any]
    name: str | None
    factors: tuple[Factor, ...]
    labels: Mapping[str, Any]
    where: str
    lines: Mapping[str, str]

    @property
    def count(self) -> int:
        """How many jobs it makes."""
        return math.prod(len(factor.levels) for factor in self.factors)


@dataclass(frozen=True, eq=False)
class Job:
    """A verb with its settings, places filled: what one request is made of.

    `levels` says which level of each factor it has, for the manifest; `known` is what the places of its name stand
    for; `name` is the pattern of its names, or None; `where` and `lines` open messages, as in `Entry`.
    """

    verb: str
    settings: Mapping[str, Any]
    name: str | None
    levels: Mapping[str, Any]
    known: Mapping[str, Any]
    where: str
    lines: Mapping[str, str] = field(default_factory=dict)

    @property
    def told(self) -> str:
        """What it is, for a message: the line, the verb and the levels."""
        levels = "".join(f", {name} {level}" for name, level in self.levels.items())
        return f"{self.where} ({self.verb}{levels})"


@dataclass(frozen=True, eq=False)
class Recipe:
    """A recipe as read from `path`: `sources` name files (paths as they are written there), `entries` make stimuli.

    `source_lines` opens a message about a source.
    """

    path: Path
    description: str
    sources: Mapping[str, str]
    entries: tuple[Entry, ...]
    source_lines: Mapping[str, str] = field(default_factory=dict)

    @property
    def job_count(self) -> int:
        """How many jobs its entries make, found without making them."""
        return sum(entry.count for entry in self.entries)

    def jobs(self) -> Iterator[Job]:
        """Make the jobs, entry by entry; the first factor varies slowest."""
        for entry in self.entries:
            for levels in itertools.product(*(factor.levels for factor in entry.factors)):
                known: dict[str, Any] = {}
                for factor, level in zip(entry.factors, levels, strict=True):
                    known.update(factor.known(level))
                named = dict(zip((factor.name for factor in entry.factors), levels, strict=True))
                yield Job(
                    verb=entry.verb,
                    settings={key: filled(value, known) for key, value in entry.settings.items()},
                    name=entry.name,
                    levels={**entry.labels, **named},
                    known={**entry.labels, **known},
                    where=entry.where,
                    lines=entry.lines,
                )


def read_recipe(path: Path | str, verbs: VerbSettings) -> Recipe:
    """Read a recipe, `.yaml`, `.yml` or `.csv`; `verbs` says which settings each verb has.

    Raises `UnreadableFile`, and `BadInput` with the line of what is wrong and the nearest word that would be right.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind in (".yaml", ".yml"):
        return _recipe_of(read_yaml(path), verbs)
    if kind == ".csv":
        return _table_recipe(read_rows(path), verbs)
    raise BadInput(
        f"{path} is no recipe by its name: call it .yaml, or .csv for a table with one stimulus a row"
    )


def _recipe_of(told: Lined, verbs: VerbSettings) -> Recipe:
    document = _mapping(told, (), "a recipe")
    for key in document:
        if key not in KEYS:
            raise BadInput(f"{told.where(key)}: a recipe has no {key!r}: {nearest(key, KEYS)}")
    for key in REQUIRED:
        if key not in document:
            raise BadInput(f"{told.path} has no {key!r}, which every recipe tells: {_missing(key)}")
    if document["format"] != RECIPE_FORMAT:
        raise BadInput(
            f"{told.where('format')}: the format is {document['format']!r}, {RECIPE_FORMAT!r} was expected"
        )
    if document["version"] != RECIPE_VERSION or isinstance(document["version"], bool):
        raise BadInput(
            f"{told.where('version')}: this is version {document['version']!r} of {RECIPE_FORMAT}, this "
            f"program reads {RECIPE_VERSION}: use a matching morphspace"
        )
    description = document.get("description", "")
    if not isinstance(description, str):
        raise BadInput(
            f"{told.where('description')}: the description is {description!r}, a text was expected"
        )
    factors = _factors(told)
    stimuli = document["stimuli"]
    if not isinstance(stimuli, list) or not stimuli:
        raise BadInput(f"{told.where('stimuli')}: stimuli are a list of entries, each opening with `- verb:`")
    entries = tuple(_entry(told, ("stimuli", place), factors, verbs) for place in range(len(stimuli)))
    used = {factor.name for entry in entries for factor in entry.factors}
    for name in factors:
        if name not in used:
            raise BadInput(
                f"{told.where('factors', name)}: no entry uses the factor {name!r}: write {{{name}}} where "
                "its value belongs, or remove it"
            )
    sources = _sources(told)
    lines = {name: told.where("sources", name) for name in sources}
    return Recipe(told.path, description, sources, entries, lines)


def _missing(key: str) -> str:
    example = {
        "format": f"format: {RECIPE_FORMAT}",
        "version": f"version: {RECIPE_VERSION}",
        "stimuli": "stimuli:",
    }
    return f"write `{example[key]}`"


def _sources(told: Lined) -> dict[str, str]:
    sources = _mapping(told, ("sources",), "sources", default={})
    for name, given in sources.items():
        where = told.where("sources", name)
        _check_word(where, "source", name)
        if not isinstance(given, str) or not given:
            raise BadInput(f"{where}: the source {name!r} is {given!r}, the path of a file was expected")
        if "{" in given:
            raise BadInput(f"{where}: the source {name!r} has a place to fill; those stand in stimuli only")
    return sources


def _factors(told: Lined) -> dict[str, Factor]:
    factors = {}
    for name, given in _mapping(told, ("factors",), "factors", default={}).items():
        _check_word(told.where("factors", name), "factor", name)
        levels = _named_levels(told, name, given) if isinstance(given, dict) else _levels(told, name, given)
        brought = [value for entries in levels.values() for value in entries.values()]
        if any(isinstance(value, str) and "{" in value for value in brought):
            raise BadInput(
                f"{told.where('factors', name)}: a level of {name!r} has a place to fill; those stand in stimuli only"
            )
        factors[name] = Factor(name, levels)
    return factors


def _levels(told: Lined, name: str, given: Any) -> dict[Any, dict[str, Any]]:
    where = told.where("factors", name)
    if not isinstance(given, list) or not given:
        raise BadInput(
            f"{where}: the factor {name!r} is {given!r}, a list of levels was expected, such as [0.5, 1, 1.5]"
        )
    levels: dict[Any, dict[str, Any]] = {}
    for place, level in enumerate(given):
        here = told.where("factors", name, place)
        if isinstance(level, bool) or not isinstance(level, int | float | str) or level == "":
            raise BadInput(
                f"{here}: a level of {name!r} is {level!r}, a number or a word was expected: where a level "
                f"brings several things, write `NAME: {{model: ..., loadings: ...}}`; put true, false and "
                "null in quotes to mean the word"
            )
        if isinstance(level, float) and not math.isfinite(level):
            raise BadInput(f"{here}: a level of {name!r} is {level}, a finite number was expected")
        if level in levels:
            raise BadInput(f"{here}: the factor {name!r} has the level {level!r} twice: remove one")
        levels[level] = {}
    return levels


def _named_levels(told: Lined, name: str, given: dict[str, Any]) -> dict[Any, dict[str, Any]]:
    levels: dict[Any, dict[str, Any]] = {}
    if not given:
        raise BadInput(f"{told.where('factors', name)}: the factor {name!r} has no levels: give at least one")
    for level, brought in given.items():
        entries = brought if isinstance(brought, dict) else {PLAIN_LEVEL: brought}
        here = told.where("factors", name, level)
        if not level:
            raise BadInput(f"{here}: a level of {name!r} has no name")
        for key in entries:
            _check_word(told.where("factors", name, level, key), "entry", key)
        first, first_entries = next(iter(levels.items()), (level, entries))
        for one, other, whose, owner in (
            (first_entries, entries, level, first),
            (entries, first_entries, first, level),
        ):
            lacking = [key for key in one if key not in other]
            if lacking:
                raise BadInput(
                    f"{here}: the level {whose!r} of {name!r} has no {lacking[0]!r}, which {owner!r} has: "
                    "all levels of a factor bring the same entries"
                )
        levels[level] = entries
    return levels


def _entry(told: Lined, spot: Spot, factors: Mapping[str, Factor], verbs: VerbSettings) -> Entry:
    given = _mapping(told, spot, "an entry of stimuli")
    verb = _verb(told.where(*spot), given.get("verb"), told.where(*spot, "verb"), verbs)
    settings: dict[str, Any] = {}
    used: dict[str, None] = {}
    known = {
        key: None for factor in factors.values() for level in factor.levels for key in factor.known(level)
    }
    for key, value in given.items():
        where = told.where(*spot, key)
        if key not in OWN_KEYS:
            _check_setting(where, verb, key, verbs)
            settings[key] = value
        try:
            places = places_in(value)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from error
        for place in places:
            if place.key not in known and (key != "name" or place.entry or place.word in factors):
                raise BadInput(
                    f"{where}: nothing is called {{{place.key}}} in the factors: {nearest(place.key, known)}"
                )
            if place.word in factors:
                used[place.word] = None
    return Entry(
        verb=verb,
        settings=settings,
        name=_name(told.where(*spot, "name"), given.get("name")),
        factors=tuple(factor for name, factor in factors.items() if name in used),
        labels={},
        where=told.where(*spot),
        lines={key: told.where(*spot, key) for key in settings},
    )


def _table_recipe(told: Lined, verbs: VerbSettings) -> Recipe:
    if not told.value:
        raise BadInput(f"{told.path} has no rows below its column names: nothing to make")
    entries = []
    for row, cells in enumerate(told.value):
        where = told.where(row)
        verb = _verb(where, cells.get("verb"), where, verbs)
        settings, labels = {}, {}
        for key, cell in cells.items():
            if key.startswith(FACTOR_COLUMN):
                name = key.removeprefix(FACTOR_COLUMN).strip()
                _check_word(f"{told.path} line 1", "factor", name)
                labels[name] = cell
            elif key not in OWN_KEYS:
                hint = f"; a condition for the manifest is a column {FACTOR_COLUMN}{key}"
                _check_setting(where, verb, key, verbs, "column", hint)
                settings[key] = cell
        for key, cell in settings.items():
            if "{" in cell:
                raise BadInput(
                    f"{where}: {key} has a place to fill, {cell!r}: in a table only the name has them"
                )
        name = _name(where, cells.get("name"))
        entries.append(Entry(verb, settings, name, (), labels, where, dict.fromkeys(settings, where)))
    return Recipe(told.path, "", {}, tuple(entries))


def _verb(where: str, verb: Any, verb_where: str, verbs: VerbSettings) -> str:
    if verb is None:
        raise BadInput(f"{where}: no verb is told: write `verb:` and one of {', '.join(verbs)}")
    if not isinstance(verb, str) or verb not in verbs:
        raise BadInput(f"{verb_where}: there is no verb {verb!r} for recipes: {nearest(str(verb), verbs)}")
    return verb


def _check_setting(
    where: str, verb: str, key: str, verbs: VerbSettings, what: str = "setting", hint: str = ""
) -> None:
    if key not in verbs[verb]:
        meant = SPOKEN.get(key.lower(), f"{key}s")
        known = [*verbs[verb], *OWN_KEYS]
        near = f"did you mean {meant!r}?" if meant in verbs[verb] else nearest(key, known)
        raise BadInput(f"{where}: {verb} has no {what} {key!r}: {near}{hint}")


def _name(where: str, name: Any) -> str | None:
    if name is None:
        return None
    if isinstance(name, int | float) and not isinstance(name, bool):
        name = str(name)
    if not isinstance(name, str) or not name.strip():
        raise BadInput(
            f'{where}: the name is {name!r}, a text was expected, such as "{{identity}}_g{{gain}}"'
        )
    try:
        pieces_of(name)
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
    return name


def _mapping(told: Lined, spot: Spot, what: str, default: dict[str, Any] | None = None) -> dict[str, Any]:
    value = told.value
    for step in spot:
        value = value.get(step) if isinstance(value, dict) else value[step]
    if value is None and default is not None:
        return default
    if not isinstance(value, dict):
        raise BadInput(
            f"{told.where(*spot)}: {what} should be `key: value` lines, {_kind(value)} stands there"
        )
    return value


def _kind(value: Any) -> str:
    if isinstance(value, list):
        return "a list"
    return "nothing" if value is None else f"{value!r}"


def _check_word(where: str, what: str, name: Any) -> None:
    if not isinstance(name, str) or not WORD.fullmatch(name):
        raise BadInput(
            f"{where}: the {what} {name!r} should be a word of letters, digits and underscores that opens with a letter"
        )
