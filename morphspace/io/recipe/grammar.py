"""What a recipe may say: its keys, its sources and factors, and the entries of its stimuli (ours).

A recipe is YAML with crossed factors, or a CSV table with one stimulus a row; `data_spec/recipe.md` describes both.
`KEYS` are the keys of a recipe and `OWN_KEYS` those of every entry. The other keys of an entry are the settings of its
verb, as the verb's own file in `verbs/` declares them: `requests.recipe_verbs()` gives them to `read_recipe`.

A recipe is checked completely before any file is opened: all keys are known, and all placeholders have values. Each
message names the line and the nearest correct word. The result is a list of jobs, a verb and its settings each.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.recipe.placeholders import WORD, filled, nearest, pieces_of, places_in
from morphspace.io.recipe.text import Lined, Spot, read_rows, read_yaml

RECIPE_FORMAT = "morphspace-recipe"
RECIPE_VERSION = 1
KEYS = ("format", "version", "description", "sources", "factors", "stimuli")
REQUIRED = ("format", "version", "stimuli")
OWN_KEYS = ("verb", "name")  # keys of an entry that are no settings of its verb
FACTOR_COLUMN = "factor:"  # starts the heading of a CSV column with conditions for the manifest
PLAIN_LEVEL = "value"  # {gain.value} is 0.5 or 1.5 if the levels are {low: 0.5, high: 1.5}

OPTION_NAMES = {  # options of the command line whose settings have other names
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
    """A factor of the design.

    Attributes
    ----------
    name : str
    levels : mapping of level (text or number) to its entries
        A level of a plain list has no entries: its value is the level itself.
    """

    name: str
    levels: Mapping[Any, Mapping[str, Any]]

    def known(self, level: Any) -> dict[str, Any]:
        """Return the values of this factor's placeholders at one level: `identity`, `identity.loadings`."""
        return {
            self.name: level,
            **{f"{self.name}.{key}": value for key, value in self.levels[level].items()},
        }


@dataclass(frozen=True, eq=False)
class Entry:
    """One entry of a recipe.

    Attributes
    ----------
    verb : str
    settings : mapping
        The settings of the verb; placeholders are not yet filled.
    name : str or None
        The pattern of the stimulus' name.
    factors : tuple of Factor, in order
    labels : mapping
        Conditions from the row of a table, for the manifest.
    where : str
        The start of a message about the entry.
    lines : mapping of setting to str
        The start of a message about each setting.
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
        """The number of jobs of the entry."""
        return math.prod(len(factor.levels) for factor in self.factors)


@dataclass(frozen=True, eq=False)
class Job:
    """A verb and its settings with placeholders filled: the content of one request.

    Attributes
    ----------
    verb : str
    settings : mapping
    name : str or None
        The pattern of the stimulus' name.
    levels : mapping of factor to level, for the manifest
    known : mapping of placeholder to value, for the name
    where, lines
        As in `Entry`.
    """

    verb: str
    settings: Mapping[str, Any]
    name: str | None
    levels: Mapping[str, Any]
    known: Mapping[str, Any]
    where: str
    lines: Mapping[str, str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The line, verb and levels of the job, for a message."""
        levels = "".join(f", {name} {level}" for name, level in self.levels.items())
        return f"{self.where} ({self.verb}{levels})"


@dataclass(frozen=True, eq=False)
class Recipe:
    """A recipe as read from `path`.

    Attributes
    ----------
    path : Path
    description : str
    sources : mapping of name to file, as written
    entries : tuple of Entry
    source_lines : mapping of name to str
        The start of a message about each source.
    """

    path: Path
    description: str
    sources: Mapping[str, str]
    entries: tuple[Entry, ...]
    source_lines: Mapping[str, str] = field(default_factory=dict)

    @property
    def job_count(self) -> int:
        """The number of jobs of all entries."""
        return sum(entry.count for entry in self.entries)

    def jobs(self) -> Iterator[Job]:
        """Yield the jobs, entry by entry; the first factor varies slowest."""
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
    """Read a recipe, `.yaml`, `.yml` or `.csv`.

    Parameters
    ----------
    path : Path or str
    verbs : mapping of verb to the names of its settings

    Returns
    -------
    Recipe

    Raises
    ------
    UnreadableFile
        If the file is missing, or is not YAML or CSV.
    BadInput
        If an entry is wrong; the message names its line and the nearest correct word.

    Examples
    --------
    >>> lines = ["format: morphspace-recipe", "version: 1", "factors: {n: [5, 10]}"]
    >>> lines += ["stimuli: [{verb: sample, count: '{n}'}]"]
    >>> _ = Path("recipe.yaml").write_text("\\n".join(lines))
    >>> [job.settings for job in read_recipe("recipe.yaml", {"sample": ("model", "count")}).jobs()]
    [{'count': 5}, {'count': 10}]
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind in (".yaml", ".yml"):
        return _recipe_of(read_yaml(path), verbs)
    if kind == ".csv":
        return _table_recipe(read_rows(path), verbs)
    raise BadInput(
        f"{path} is not a recipe by its name; expected .yaml, or .csv for a table of stimuli. Rename it"
    )


def _recipe_of(lined: Lined, verbs: VerbSettings) -> Recipe:
    document = _mapping(lined, (), "a recipe")
    for key in document:
        if key not in KEYS:
            raise BadInput(f"{lined.where(key)}: {key!r} is not a key of a recipe: {nearest(key, KEYS)}")
    for key in REQUIRED:
        if key not in document:
            raise BadInput(f"{lined.path} has no {key!r}; expected one. {_missing(key)}")
    if document["format"] != RECIPE_FORMAT:
        raise BadInput(
            f"{lined.where('format')}: the format is {document['format']!r}; expected {RECIPE_FORMAT!r}. Correct it"
        )
    if document["version"] != RECIPE_VERSION or isinstance(document["version"], bool):
        raise BadInput(
            f"{lined.where('version')}: this is version {document['version']!r} of {RECIPE_FORMAT}; "
            f"expected {RECIPE_VERSION}. Use a matching morphspace"
        )
    description = document.get("description", "")
    if not isinstance(description, str):
        raise BadInput(
            f"{lined.where('description')}: the description is {description!r}; expected a text. Put it in quotes"
        )
    factors = _factors(lined)
    stimuli = document["stimuli"]
    if not isinstance(stimuli, list) or not stimuli:
        raise BadInput(
            f"{lined.where('stimuli')}: stimuli has no entries; expected a list. Start each entry with `- verb:`"
        )
    entries = tuple(_entry(lined, ("stimuli", place), factors, verbs) for place in range(len(stimuli)))
    used = {factor.name for entry in entries for factor in entry.factors}
    for name in factors:
        if name not in used:
            raise BadInput(
                f"{lined.where('factors', name)}: no entry uses the factor {name!r}. Write {{{name}}} in an "
                "entry, or remove the factor"
            )
    sources = _sources(lined)
    lines = {name: lined.where("sources", name) for name in sources}
    return Recipe(lined.path, description, sources, entries, lines)


def _missing(key: str) -> str:
    example = {
        "format": f"format: {RECIPE_FORMAT}",
        "version": f"version: {RECIPE_VERSION}",
        "stimuli": "stimuli:",
    }
    return f"Add `{example[key]}`"


def _sources(lined: Lined) -> dict[str, str]:
    sources = _mapping(lined, ("sources",), "sources", default={})
    for name, given in sources.items():
        where = lined.where("sources", name)
        _check_word(where, "source", name)
        if not isinstance(given, str) or not given:
            raise BadInput(
                f"{where}: the source {name!r} is {given!r}; expected the path of a file. Correct it"
            )
        if "{" in given:
            raise BadInput(
                f"{where}: the source {name!r} has a placeholder; expected them in stimuli only. Remove it"
            )
    return sources


def _factors(lined: Lined) -> dict[str, Factor]:
    factors = {}
    for name, given in _mapping(lined, ("factors",), "factors", default={}).items():
        _check_word(lined.where("factors", name), "factor", name)
        levels = _named_levels(lined, name, given) if isinstance(given, dict) else _levels(lined, name, given)
        brought = [value for entries in levels.values() for value in entries.values()]
        if any(isinstance(value, str) and "{" in value for value in brought):
            raise BadInput(
                f"{lined.where('factors', name)}: a level of {name!r} has a placeholder; expected them in stimuli "
                "only. Remove it"
            )
        factors[name] = Factor(name, levels)
    return factors


def _levels(lined: Lined, name: str, given: Any) -> dict[Any, dict[str, Any]]:
    where = lined.where("factors", name)
    if not isinstance(given, list) or not given:
        raise BadInput(
            f"{where}: the factor {name!r} is {given!r}; expected a list of levels. Write, for example, [0.5, 1, 1.5]"
        )
    levels: dict[Any, dict[str, Any]] = {}
    for place, level in enumerate(given):
        here = lined.where("factors", name, place)
        if isinstance(level, bool) or not isinstance(level, int | float | str) or level == "":
            raise BadInput(
                f"{here}: a level of {name!r} is {level!r}; expected a number or a word. Write a level of several "
                "entries as `NAME: {model: ..., loadings: ...}`, and the words true, false and null in quotes"
            )
        if isinstance(level, float) and not math.isfinite(level):
            raise BadInput(f"{here}: a level of {name!r} is {level}; expected a finite number. Correct it")
        if level in levels:
            raise BadInput(
                f"{here}: the factor {name!r} has the level {level!r} twice; expected unique levels. Remove one"
            )
        levels[level] = {}
    return levels


def _named_levels(lined: Lined, name: str, given: dict[str, Any]) -> dict[Any, dict[str, Any]]:
    levels: dict[Any, dict[str, Any]] = {}
    if not given:
        raise BadInput(
            f"{lined.where('factors', name)}: the factor {name!r} has no levels; expected at least one. Add one"
        )
    for level, brought in given.items():
        entries = brought if isinstance(brought, dict) else {PLAIN_LEVEL: brought}
        here = lined.where("factors", name, level)
        if not level:
            raise BadInput(f"{here}: a level of {name!r} has no name; expected one. Name it")
        for key in entries:
            _check_word(lined.where("factors", name, level, key), "entry", key)
        first, first_entries = next(iter(levels.items()), (level, entries))
        for one, other, whose, owner in (
            (first_entries, entries, level, first),
            (entries, first_entries, first, level),
        ):
            lacking = [key for key in one if key not in other]
            if lacking:
                raise BadInput(
                    f"{here}: the level {whose!r} of {name!r} has no {lacking[0]!r}; expected the entries of "
                    f"{owner!r}. Add it to all levels of the factor"
                )
        levels[level] = entries
    return levels


def _entry(lined: Lined, spot: Spot, factors: Mapping[str, Factor], verbs: VerbSettings) -> Entry:
    given = _mapping(lined, spot, "an entry of stimuli")
    verb = _verb(lined.where(*spot), given.get("verb"), lined.where(*spot, "verb"), verbs)
    settings: dict[str, Any] = {}
    used: dict[str, None] = {}
    known = {
        key: None for factor in factors.values() for level in factor.levels for key in factor.known(level)
    }
    for key, value in given.items():
        where = lined.where(*spot, key)
        if key not in OWN_KEYS:
            _check_setting(where, verb, key, verbs)
            settings[key] = value
        try:
            places = places_in(value)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from error
        for place in places:
            if place.key not in known and (key != "name" or place.entry or place.word in factors):
                raise BadInput(f"{where}: {{{place.key}}} is not in the factors: {nearest(place.key, known)}")
            if place.word in factors:
                used[place.word] = None
    return Entry(
        verb=verb,
        settings=settings,
        name=_name(lined.where(*spot, "name"), given.get("name")),
        factors=tuple(factor for name, factor in factors.items() if name in used),
        labels={},
        where=lined.where(*spot),
        lines={key: lined.where(*spot, key) for key in settings},
    )


def _table_recipe(lined: Lined, verbs: VerbSettings) -> Recipe:
    if not lined.value:
        raise BadInput(
            f"{lined.path} has no rows below its column names; expected at least one. Add a stimulus"
        )
    entries = []
    for row, cells in enumerate(lined.value):
        where = lined.where(row)
        verb = _verb(where, cells.get("verb"), where, verbs)
        settings, labels = {}, {}
        for key, cell in cells.items():
            if key.startswith(FACTOR_COLUMN):
                name = key.removeprefix(FACTOR_COLUMN).strip()
                _check_word(f"{lined.path} line 1", "factor", name)
                labels[name] = cell
            elif key not in OWN_KEYS:
                hint = f". Call a column of conditions for the manifest {FACTOR_COLUMN}{key}"
                _check_setting(where, verb, key, verbs, "column", hint)
                settings[key] = cell
        for key, cell in settings.items():
            if "{" in cell:
                raise BadInput(
                    f"{where}: {key} is {cell!r}; expected placeholders in the name only. Write the value"
                )
        name = _name(where, cells.get("name"))
        entries.append(Entry(verb, settings, name, (), labels, where, dict.fromkeys(settings, where)))
    return Recipe(lined.path, "", {}, tuple(entries))


def _verb(where: str, verb: Any, verb_where: str, verbs: VerbSettings) -> str:
    if verb is None:
        raise BadInput(f"{where}: the verb is missing; expected one of {', '.join(verbs)}. Add `verb:`")
    if not isinstance(verb, str) or verb not in verbs:
        raise BadInput(f"{verb_where}: {verb!r} is not a verb for recipes: {nearest(str(verb), verbs)}")
    return verb


def _check_setting(
    where: str, verb: str, key: str, verbs: VerbSettings, what: str = "setting", hint: str = ""
) -> None:
    if key not in verbs[verb]:
        meant = OPTION_NAMES.get(key.lower(), f"{key}s")
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
            f'{where}: the name is {name!r}; expected a text. Write, for example, "{{identity}}_g{{gain}}"'
        )
    try:
        pieces_of(name)
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
    return name


def _mapping(lined: Lined, spot: Spot, what: str, default: dict[str, Any] | None = None) -> dict[str, Any]:
    value = lined.value
    for step in spot:
        value = value.get(step) if isinstance(value, dict) else value[step]
    if value is None and default is not None:
        return default
    if not isinstance(value, dict):
        raise BadInput(
            f"{lined.where(*spot)}: {what} is {_kind(value)}; expected `key: value` lines. Correct it"
        )
    return value


def _kind(value: Any) -> str:
    if isinstance(value, list):
        return "a list"
    return "nothing" if value is None else f"{value!r}"


def _check_word(where: str, what: str, name: Any) -> None:
    if not isinstance(name, str) or not WORD.fullmatch(name):
        raise BadInput(
            f"{where}: the {what} is called {name!r}; expected a letter, then letters, digits and underscores. "
            "Rename it"
        )
