"""Plan a batch, everything that a recipe draws: requests, planned sets and names, and all errors of these (ours).

What a recipe may say is in `io/recipe/grammar.py`.

A job of a recipe is one request. Its drawings are named by the recipe's pattern and hold the level of each factor.
They are stored with the recipe's paths, not those of this machine, so the same recipe gives the same bytes
everywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.io.clips import open_clip
from morphspace.io.recipe.grammar import Job, Recipe
from morphspace.io.recipe.placeholders import filled
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions
from morphspace.requests import ClipOptions, Verb, clip_options, request_document, request_from, verb_named
from morphspace.sets.folders import FolderJob
from morphspace.sets.manifest import FIRST_COLUMNS, LAST_COLUMNS, Column
from morphspace.sets.plan import PlannedSet, check_kept_model, check_names
from morphspace.sets.sources import file_names
from morphspace.settings import WrongSetting
from morphspace.steps import Step, Steps
from morphspace.stimuli.drawing import Drawing, check_name
from morphspace.storage import digest_of_file, digest_of_json

FOLDERS_TABLE = "folders.csv"
ID_DIGITS = 8  # hexadecimal digits of a model's id that distinguish models of one name
NAMING_COLUMNS = ("name", "from", "to")  # columns of a verb's tables that name its stimuli


@dataclass(frozen=True, eq=False)
class Planned:
    """The plan of a recipe: sets of drawings, folders, and all `inputs`, name to SHA-256."""

    sets: tuple[PlannedSet, ...]
    folders: tuple[FolderJob, ...]
    inputs: Mapping[str, str]

    @property
    def drawings(self) -> list[tuple[PlannedSet, Drawing]]:
        """Return every drawing with its set, in order."""
        return [(planned, drawing) for planned in self.sets for drawing in planned.drawings]


@dataclass
class _Book:
    """The state of planning: open models, the job of each name, names of tables, and the number of drawings."""

    models: dict[Path, MorphModel] = field(default_factory=dict)
    names: dict[str, tuple[str, Job]] = field(default_factory=dict)
    tables: set[str] = field(default_factory=set)
    most: int | None = None
    drawings: int = 0

    def model(self, path: Path | None) -> MorphModel | None:
        """Open a model once for all jobs."""
        if path is None:
            return None
        if path not in self.models:
            self.models[path] = load_model(path)
        return self.models[path]

    def take(self, name: str, job: Job, places: Iterable[str]) -> None:
        """Reserve a name for a job. Raises `BadInput` if it is in use; case is ignored."""
        check_name(name)
        if name.casefold() in self.names:
            taken, other = self.names[name.casefold()]
            whose = "this entry" if other is job else other.label
            raise BadInput(
                f"{job.label} makes a stimulus called {name!r}, and {whose} makes {taken!r}: add to the name a "
                f"placeholder that distinguishes them: {', '.join(f'{{{place}}}' for place in places)}"
            )
        self.names[name.casefold()] = (name, job)

    def table(self, name: str) -> str:
        """Return a free name for a table, derived from `name`."""
        stem, suffix = Path(name).stem, Path(name).suffix
        number = 1
        while name.casefold() in self.tables:
            number += 1
            name = f"{stem}_{number}{suffix}"
        self.tables.add(name.casefold())
        return name


def planned_recipe(recipe: Recipe, folder: Path, most: int | None) -> Steps[Planned]:
    """Plan every job of the recipe for the folder without drawing.

    Raises
    ------
    BadInput
        If a verb refuses its request, names collide, or there are more than `most` stimuli. The message names the
        line.
    """
    _check_count(recipe.job_count, most, "jobs")
    _check_sources(recipe)
    book = _Book(most=most)
    sets: list[PlannedSet] = []
    folders: list[FolderJob] = []
    inputs = {f"recipe {recipe.path.name}": digest_of_file(recipe.path)}
    for done, job in enumerate(recipe.jobs(), start=1):
        verb = verb_named(job.verb)
        try:
            if verb.plan is None:
                folders.append(_folder_job(job, verb, recipe, folder, book))
            else:
                sets.append((yield from _set_of(job, verb, recipe, folder, book)))
                _note_inputs(sets[-1], inputs)
        except BadInput as error:
            words = str(error)
            has_line = words.startswith(f"{recipe.path} line ") or job.where in words
            raise type(error)(words if has_line else f"{job.label}: {words}") from error
        _check_count(book.drawings + len(folders), most, "stimuli")
        yield Step("plan", done, recipe.job_count)
    _check_folders(folders, book)
    try:
        check_names([name for name, _ in book.names.values()], (*book.tables, FOLDERS_TABLE))
    except BadInput as error:
        raise BadInput(f"{recipe.path}: {error}") from error
    return Planned(_with_own_models(sets), tuple(folders), inputs)


def _with_own_models(sets: Sequence[PlannedSet]) -> tuple[PlannedSet, ...]:
    """Name the new models of verbs uniquely; models that would share a name get their ids.

    Raises `BadInput` if the folder has another model of that name.
    """
    called: dict[str, set[str]] = {}
    for one in sets:
        if one.new_model:
            called.setdefault(one.model_path.name.casefold(), set()).add(one.model.model_id)
    named = []
    for one in sets:
        path = one.model_path
        if one.new_model and len(called[path.name.casefold()]) > 1:
            path = path.with_name(f"{path.stem}_{one.model.model_id[:ID_DIGITS]}{path.suffix}")
        if one.new_model:
            check_kept_model(one.model, path)
        named.append(dataclasses.replace(one, model_path=path))
    return tuple(named)


def _check_count(count: int, most: int | None, what: str) -> None:
    if most is not None and count > most:
        found = f"{count:,}" if what == "jobs" else f"more than {most:,}"
        raise BadInput(
            f"the recipe makes {found} {what}; expected at most {most:,}. Give --yes to make them, "
            "or cross fewer levels"
        )


def _check_sources(recipe: Recipe) -> None:
    for name, words in recipe.sources.items():
        if not _is_pattern(words) and not (recipe.path.parent / words).exists():
            raise BadInput(
                f"{recipe.source_lines[name]}: the source {name!r} is {words}, which does not exist. Paths "
                "are relative to the recipe's folder"
            )


def _is_pattern(words: str) -> bool:
    return any(mark in words for mark in "*?[")


def _requests(job: Job, verb: Verb, recipe: Recipe, output: Path) -> tuple[Any, dict[str, Any]]:
    """Return the request with full paths, and its JSON with the recipe's own paths."""

    def opening(words: str) -> Path:
        named, frame = _named(words, recipe)
        path = recipe.path.parent / named
        if not _is_pattern(named) and not path.exists():
            raise BadInput(f"{job.label}: {named} does not exist. Paths are relative to the recipe's folder")
        return path.with_name(path.name + frame)

    def telling(words: str) -> Path:
        return Path("".join(_named(words, recipe)))

    try:
        request = request_from(verb.request, job.settings, opening, output=output)
        portable = request_from(verb.request, job.settings, telling, output=output)
    except WrongSetting as error:
        where = job.lines.get(error.name, job.label)
        raise BadInput(f"{where}: {error.called(f'{error.name} of {job.verb}')}") from error
    return request, request_document(portable)


def _named(words: str, recipe: Recipe) -> tuple[str, str]:
    """Return the path for words of a recipe, a source or a path, and a trailing `:FRAME`."""
    if words in recipe.sources or ":" not in words:
        return recipe.sources.get(words, words), ""
    head, _, frame = words.rpartition(":")
    if head in recipe.sources or (recipe.path.parent / head).exists():
        return recipe.sources.get(head, head), f":{frame}"
    return words, ""


def _set_of(job: Job, verb: Verb, recipe: Recipe, folder: Path, book: _Book) -> Steps[PlannedSet]:
    request, portable = _requests(job, verb, recipe, folder)
    _check_count(book.drawings + verb.asked(request), book.most, "stimuli")
    assert verb.plan is not None
    planned: PlannedSet = yield from verb.plan(request, book.model(getattr(request, "model", None)))
    book.drawings += len(planned.drawings)
    columns = dict(planned.columns)
    drawings, names = [], {}
    for index, drawing in enumerate(planned.drawings):
        places = {"name": drawing.name, "index": index, "verb": job.verb, **drawing.variables, **job.known}
        name = _name(job, places)
        book.take(name, job, places)
        names[drawing.name] = name
        added = _level_columns(job.levels, drawing.variables)
        columns |= {key: Column(f"Level of the factor {factor}") for key, factor in added.items()}
        levels = {key: job.levels[factor] for key, factor in added.items()}
        drawings.append(dataclasses.replace(drawing, name=name, variables={**levels, **drawing.variables}))
    return dataclasses.replace(
        planned,
        request=portable,
        drawings=tuple(drawings),
        columns=columns,
        tables=_own_tables(job, planned.tables, names, book),
    )


def _name(job: Job, places: Mapping[str, Any]) -> str:
    """Return the name of a stimulus: the recipe's filled pattern, or a folder of the levels and the verb's own name."""
    if job.name is None:
        folder = _levels_word(job)
        return "/".join(part for part in (folder, str(places.get("name", ""))) if part)
    words = {
        key: file_names([value])[0] if isinstance(value, str) else value for key, value in places.items()
    }
    return str(filled(job.name, words))


def _levels_word(job: Job) -> str:
    """Return the levels of a job as one word in the manner of Psych-DS: identity-ann_gain-0.5."""
    levels = "_".join(f"{factor}-{level}" for factor, level in job.levels.items())
    return file_names([levels])[0] if levels else ""


def _level_columns(levels: Mapping[str, Any], entries: Mapping[str, Any]) -> dict[str, str]:
    """Return the factor of each added manifest column; a factor that the verb lists with equal values needs none."""
    columns = {}
    for factor, level in levels.items():
        if factor in FIRST_COLUMNS or factor in LAST_COLUMNS or entries.get(factor, level) != level:
            columns[f"factor_{factor}"] = factor
        elif factor not in entries:
            columns[factor] = factor
    return columns


def _own_tables(
    job: Job, tables: Mapping[str, Mapping[str, Sequence[Any]]], names: Mapping[str, str], book: _Book
) -> dict[str, dict[str, Sequence[Any]]]:
    """Rename a job's tables uniquely, and replace the stimuli's names in them by the new ones."""
    own = {}
    for name, table in tables.items():
        word = _levels_word(job)
        path = Path(name)
        key = book.table(f"{path.stem}_{word}{path.suffix}" if word else name)
        own[key] = {
            column: [names.get(one, one) for one in cells] if column in NAMING_COLUMNS else cells
            for column, cells in table.items()
        }
    return own


def _note_inputs(planned: PlannedSet, inputs: dict[str, str]) -> None:
    """Add a set's inputs to those of the whole, each under its role and the recipe's word for it."""
    for role, digest in planned.inputs.items():
        words = planned.request.get(role.partition("/")[0])
        key = f"{role} {words}" if isinstance(words, str) else role
        number, free = 1, key
        while inputs.setdefault(free, digest) != digest:
            number += 1
            free = f"{key} ({number})"


def _folder_job(job: Job, verb: Verb, recipe: Recipe, folder: Path, book: _Book) -> FolderJob:
    places = {"verb": job.verb, **job.known}
    name = _name(job, places) or job.verb
    book.take(name, job, places)
    request, portable = _requests(job, verb, recipe, folder / name)
    if verb.check is not None:
        verb.check(request)
    digests = {
        setting: _digest(getattr(request, setting), clip_options(request))
        for setting in verb.files
        if getattr(request, setting) is not None
    }
    made_from = digest_of_json([job.verb, portable, digests, versions()])
    return FolderJob(name, job.verb, request, portable, job.levels, made_from)


def _digest(given: str, options: ClipOptions) -> Any:
    """Return the digest of a file, or of the frames of a clip."""
    path = Path(given)
    return digest_of_file(path) if path.is_file() else list(open_clip([given], options).digests())


def _check_folders(folders: Sequence[FolderJob], book: _Book) -> None:
    """Check that no stimulus or other folder is inside a folder that a verb fills. Raises `BadInput` otherwise."""
    owners = {job.name.casefold(): job.verb for job in folders}
    for name, (spelled, job) in book.names.items():
        parts = name.split("/")
        for depth in range(1, len(parts)):
            owner = owners.get("/".join(parts[:depth]))
            if owner is not None:
                raise BadInput(
                    f"{job.label} makes {spelled!r} inside a folder that {owner} fills. Give one of them "
                    "another name"
                )
