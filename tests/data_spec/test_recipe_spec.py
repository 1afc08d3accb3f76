"""Recipes and manifests are what their pages in `data_spec/` say, and the schema takes what the code takes."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import jsonschema
import pytest

from morphspace.cli.documents import recipe_schema, setting_schema, verbs_page
from morphspace.errors import BadInput
from morphspace.io.recipe.grammar import KEYS, read_recipe
from morphspace.io.recipe.text import read_yaml
from morphspace.requests import recipe_verbs, settings_of
from morphspace.sets.manifest import FIRST_COLUMNS, LAST_COLUMNS, VARIABLE_COLUMNS
from morphspace.settings import WrongSetting, check_decimal_points, converted
from morphspace.steps import result_of
from morphspace.verbs import sample
from morphspace.verbs.sample import SampleRequest

VERBS = recipe_verbs()
SETTINGS = {name: verb.settings for name, verb in VERBS.items()}
DATA_SPEC = Path(__file__).parents[2] / "data_spec"


@cache
def schema_of(kind):
    if kind == "recipe":
        return recipe_schema()
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


def test_schema_and_page_have_the_same_entries():
    schema = recipe_schema()
    assert tuple(schema["properties"]) == KEYS
    for word in KEYS:
        assert f"`{word}`" in page_of("recipe")


def test_the_words_of_the_command_line_lead_to_the_settings(tmp_path):
    for name, verb in VERBS.items():
        for field in settings_of(verb.request):
            word = (field.spoken or field.name).strip("-.").lower().replace("-", "_")
            if word in SETTINGS[name]:
                continue
            text = f"format: morphspace-recipe\nversion: 1\nstimuli:\n  - {{verb: {name}, {word}: 1}}\n"
            (tmp_path / "a.yaml").write_text(text)
            with pytest.raises(BadInput, match=f"(did you mean|the nearest is) '{field.name}'"):
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
    for field in settings_of(VERBS[verb].request):
        schema = {"$defs": recipe_schema()["$defs"], **setting_schema(field)}
        for value in SAMPLES:
            try:
                check_decimal_points(field, value)
                converted(field, value)
                taken = True
            except WrongSetting:
                taken = False
            is_valid = jsonschema.Draft202012Validator(schema).is_valid(value)
            outside = is_valid and isinstance(value, str) and field.limits  # a schema cannot read texts
            assert is_valid == taken or outside, (field.name, value)


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
    from morphspace.sets.batch_plan import planned_recipe

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


def test_the_page_of_all_verbs_is_made_from_the_declarations():
    page = (DATA_SPEC.parent / "docs" / "verbs.md").read_text(encoding="utf-8")
    assert page.rstrip() == verbs_page().rstrip(), "make it again: python -m morphspace.cli.documents verbs"


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
    for name, column in {**FIRST_COLUMNS, **VARIABLE_COLUMNS, **LAST_COLUMNS}.items():
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
