"""Recipes and manifests are what their pages in `data_spec/` say, and the schema takes what the code takes."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import click
import jsonschema
import pytest

from morphspace.cli.main import main
from morphspace.errors import BadInput
from morphspace.io.recipe_text import read_yaml
from morphspace.io.recipes import KEYS, read_recipe
from morphspace.requests import recipe_verbs
from morphspace.sets.manifest import FIRST_COLUMNS, LAST_COLUMNS, TOLD_COLUMNS
from morphspace.sets.recipe_settings import WrongKind, converted, kinds_of, required_of, worded
from morphspace.steps import result_of
from morphspace.verbs import sample
from morphspace.verbs.sample import SampleRequest

VERBS = recipe_verbs()
SETTINGS = {name: verb.settings for name, verb in VERBS.items()}
DATA_SPEC = Path(__file__).parents[2] / "data_spec"


@cache
def schema_of(kind):
    schema = json.loads((DATA_SPEC / f"{kind}.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return schema


def fits(kind, document):
    return jsonschema.Draft202012Validator(schema_of(kind)).is_valid(document)


def page_of(kind):
    return (DATA_SPEC / f"{kind}.md").read_text(encoding="utf-8")


def example(kind, language):
    (found,) = re.findall(rf"```{language}\n(.*?)```", page_of(kind), re.DOTALL)
    return found


@pytest.mark.parametrize("verb", VERBS)
def test_the_schema_knows_the_settings_that_the_request_has(verb):
    entry = schema_of("recipe")["$defs"][f"entry_{verb}"]
    assert list(entry["properties"]) == ["verb", "name", *SETTINGS[verb]]
    assert entry["required"] == ["verb", *required_of(VERBS[verb].request)]


def test_schema_page_and_code_have_the_same_verbs_and_entries():
    schema = schema_of("recipe")
    assert tuple(schema["properties"]) == KEYS
    assert schema["properties"]["stimuli"]["items"]["properties"]["verb"]["enum"] == list(VERBS)
    for word in (*KEYS, *VERBS):
        assert f"`{word}`" in page_of("recipe")


def settings_on_the_command_line(verb):
    """Give for each setting of a verb how the command line calls it, None where it does not ask for it."""
    asked = {one.name: one for one in main.get_command(click.Context(main), verb).params}
    words = dict.fromkeys(SETTINGS[verb])
    for name in words.keys() & asked.keys():
        one = asked[name]
        option = isinstance(one, click.Option)
        words[name] = max(one.opts, key=len) if option else (one.metavar or one.name.upper()).rstrip(".")
    return words


def settings_table():
    rows = ["| verb | setting | on the command line | value |", "|---|---|---|---|"]
    for verb, entry in VERBS.items():
        for name, words in settings_on_the_command_line(verb).items():
            needed = " (required)" if name in required_of(entry.request) else ""
            spoken = f"`{words}`" if words else ""
            rows.append(f"| {verb} | `{name}`{needed} | {spoken} | {worded(kinds_of(entry.request)[name])} |")
    return "\n".join(rows)


def test_the_page_has_every_setting_of_every_verb():
    assert settings_table() in page_of("recipe"), settings_table()


def test_the_words_of_the_command_line_lead_to_the_settings(tmp_path):
    for verb in VERBS:
        for name, words in settings_on_the_command_line(verb).items():
            word = (words or name).lstrip("-").lower().replace("-", "_")
            if word in SETTINGS[verb]:
                continue
            text = f"format: morphspace-recipe\nversion: 1\nstimuli:\n  - {{verb: {verb}, {word}: 1}}\n"
            (tmp_path / "a.yaml").write_text(text)
            with pytest.raises(BadInput, match=f"(did you mean|the nearest is) '{name}'"):
                read_recipe(tmp_path / "a.yaml", SETTINGS)


SAMPLES = [
    0.5,
    3,
    "x",
    "0.5",
    "3",
    "1,2",
    "0.5;1",
    [1, 2],
    [0.5, 1.5],
    ["a", "b"],
    [[1], 2],
    True,
    None,
    [],
    "",
    {"a": 1},
    [True],
]


@pytest.mark.parametrize("verb", VERBS)
def test_schema_and_code_take_and_refuse_the_same_values(verb):
    kinds, entry = kinds_of(VERBS[verb].request), schema_of("recipe")["$defs"][f"entry_{verb}"]
    for setting in SETTINGS[verb]:
        told = {"$defs": schema_of("recipe")["$defs"], **entry["properties"][setting]}
        for value in SAMPLES:
            try:
                converted(value, kinds[setting], Path)
                taken = True
            except WrongKind:
                taken = False
            assert jsonschema.Draft202012Validator(told).is_valid(value) == taken, (setting, value)


def test_the_examples_on_the_page_are_recipes(tmp_path):
    text = example("recipe", "yaml")
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    recipe = read_recipe(tmp_path / "a.yaml", SETTINGS)
    assert recipe.job_count == 2 * 3 + 2
    assert fits("recipe", read_yaml(tmp_path / "a.yaml").value)
    (tmp_path / "a.csv").write_text(example("recipe", "csv"), encoding="utf-8")
    assert [job.levels for job in read_recipe(tmp_path / "a.csv", SETTINGS).jobs()] == [
        {"mood": "glad"},
        {"mood": "sad"},
    ]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("version: 1", "version: 2"),
        ("morphspace-recipe", "recipe"),
        ("description: smiles", "descripton: smiles"),
        ("verb: sample", "verb: simple"),
        ("count:", "cuont:"),
        ("count: 20", "count: 2.5"),
        ("[0.5, 1, 1.5]", "[]"),
        ("[0.5, 1, 1.5]", "0.5"),
        ("[0.5, 1, 1.5]", "[0.5, [1]]"),
        ("ann: models/ann.morph", "ann: 3"),
        ("ann: models/ann.morph", "a-n: x"),
        ("verb: sample", "seed: 3"),
        ('model: "{identity}"\n    count', "count"),
    ],
)
def test_schema_and_reader_refuse_the_same_broken_recipes(old, new, tmp_path):
    from morphspace.sets.recipe_plan import planned_recipe

    text = example("recipe", "yaml")
    assert old in text
    path = tmp_path / "a.yaml"
    path.write_text(
        text.replace(old, new, 1) if "model" not in old else text.replace(old, new), encoding="utf-8"
    )
    for name in ("ann", "bob"):
        (tmp_path / "models").mkdir(exist_ok=True)
        (tmp_path / "models" / f"{name}.morph").write_bytes(b"")
    try:
        document = read_yaml(path).value
    except BadInput:
        return  # twice the same key: the text is no recipe at all
    assert not fits("recipe", document)
    with pytest.raises(BadInput, match=r"a\.yaml"):
        result_of(planned_recipe(read_recipe(path, SETTINGS), tmp_path / "out", None))


# the manifest


@pytest.fixture(scope="module")
def set_folder(model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("set")
    model.save(folder / "a.morph")
    result_of(sample.run(SampleRequest(folder / "a.morph", folder / "out", count=3, max_sd=4.0)))
    return folder / "out"


def test_a_manifest_fits_its_schema_and_describes_every_column(set_folder):
    document = json.loads((set_folder / "manifest.json").read_text(encoding="utf-8"))
    assert fits("manifest", document)
    headings = (set_folder / "manifest.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert [one["name"] for one in document["variableMeasured"]] == headings
    assert set(schema_of("manifest")["required"]) == set(document)


def test_every_column_is_on_the_page_with_its_meaning_and_unit():
    page = page_of("manifest")
    for name, column in {**FIRST_COLUMNS, **TOLD_COLUMNS, **LAST_COLUMNS}.items():
        if name.startswith(("linear_", "code_")):
            assert f"`{name}`" in page
        else:
            assert f"| `{name}` | {column.unit or ''} | {column.description} |" in page
    for entry in schema_of("manifest")["properties"]:
        assert f"`{entry}`" in page


def test_the_example_manifest_fits_and_broken_ones_do_not():
    document = json.loads(example("manifest", "json"))
    assert fits("manifest", document)
    for entry, value in (
        ("version", 2),
        ("stimulus_count", 0),
        ("variableMeasured", []),
        ("date", "today"),
        ("@type", "Thing"),
    ):
        assert not fits("manifest", {**document, entry: value})
