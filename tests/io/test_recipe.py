"""Recipes: what they cross, how places are filled, mistakes told with their line and the nearest word."""

from __future__ import annotations

import contextlib
import csv
import itertools
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.recipe.grammar import read_recipe
from morphspace.io.recipe.placeholders import filled, pieces_of, places_in
from morphspace.io.recipe.text import read_rows, read_yaml

VERBS = {"caricature": ("model", "loadings", "gain", "components"), "grid": ("model", "steps")}
HEAD = "format: morphspace-recipe\nversion: 1\n"
WHOLE = (
    HEAD
    + """\
sources:
  smile: tables/smile.csv
factors:
  identity:
    ann: {model: ann.morph, loadings: ann.csv}
    bob: {model: bob.morph, loadings: bob.csv}
  gain: [0.5, 1, -1.5]
stimuli:
  - verb: caricature
    model: "{identity.model}"
    loadings: "{identity.loadings}"
    gain: "{gain}"
    name: "{identity}_g{gain}_{frame}"
  - verb: grid
    model: "models/{identity}.morph"
    steps: 5
"""
)


def recipe(folder, text, name="recipe.yaml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_recipe(path, VERBS)


def refused(folder, text, *mentioned, name="recipe.yaml"):
    with pytest.raises(BadInput) as caught:
        recipe(folder, text, name)
    words = str(caught.value)
    assert "\n" not in words
    for word in mentioned:
        assert word in words, words


def test_factors_are_crossed_by_the_entries_that_use_them(tmp_path):
    read = recipe(tmp_path, WHOLE)
    jobs = list(read.jobs())
    assert read.job_count == len(jobs) == 2 * 3 + 2
    levels = [(job.levels["identity"], job.levels["gain"]) for job in jobs[:6]]
    assert levels == list(itertools.product(("ann", "bob"), (0.5, 1, -1.5)))
    assert [job.levels for job in jobs[6:]] == [{"identity": "ann"}, {"identity": "bob"}]


def test_a_place_alone_keeps_its_kind_and_a_place_inside_a_text_becomes_text(tmp_path):
    jobs = list(recipe(tmp_path, WHOLE).jobs())
    assert jobs[4].settings == {"model": "bob.morph", "loadings": "bob.csv", "gain": 1}
    assert isinstance(jobs[4].settings["gain"], int)
    assert jobs[7].settings == {"model": "models/bob.morph", "steps": 5}
    assert filled(jobs[5].name, {**jobs[5].known, "frame": "f_7"}) == "bob_g-1.5_f_7"


def test_counting_jobs_does_not_make_them(tmp_path):
    many = ", ".join(map(str, range(1000)))
    factors = f"factors: {{identity: [{many}], gain: [{many}]}}\n"
    entry = 'stimuli: [{verb: caricature, model: "{identity}", gain: "{gain}"}]\n'
    assert recipe(tmp_path, HEAD + factors + entry).job_count == 1_000_000


def test_named_levels_of_plain_values_are_reached_as_value(tmp_path):
    text = (
        HEAD + 'factors: {gain: {low: 0.5, high: 2}}\nstimuli: [{verb: caricature, gain: "{gain.value}"}]\n'
    )
    jobs = list(recipe(tmp_path, text).jobs())
    assert [(job.levels, job.settings) for job in jobs] == [
        ({"gain": "low"}, {"gain": 0.5}),
        ({"gain": "high"}, {"gain": 2}),
    ]


@given(st.lists(st.sampled_from("abc"), min_size=1, max_size=3, unique=True), st.data())
def test_jobs_are_the_product_of_the_levels(names, data):
    import tempfile
    from pathlib import Path

    counts = {name: data.draw(st.integers(1, 4)) for name in names}
    factors = "".join(f"  {name}: {list(range(count))}\n" for name, count in counts.items())
    used = "-".join(f"{{{name}}}" for name in names)
    with tempfile.TemporaryDirectory() as folder:
        text = f'{HEAD}factors:\n{factors}stimuli:\n  - verb: grid\n    name: "{used}"\n'
        jobs = list(recipe(Path(folder), text).jobs())
    expected = list(itertools.product(*(range(count) for count in counts.values())))
    assert [tuple(job.levels.values()) for job in jobs] == expected
    assert len({filled(job.name, job.known) for job in jobs}) == len(expected)


# yaml


def test_scalars_are_read_by_the_core_schema(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("[no, on, 1:30, 0001, 2026-11-22, 1e3, 5, -0.5, true, null, '5', .5, 0x10, 1_000, +3]")
    read = read_yaml(path).value
    assert read == [
        "no",
        "on",
        "1:30",
        "0001",
        "2026-11-22",
        1000.0,
        5,
        -0.5,
        True,
        None,
        "5",
        0.5,
        "0x10",
        "1_000",
        3,
    ]
    assert [type(one) for one in read[5:8]] == [float, int, float]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: !!python/object/apply:os.system [echo]", ("line 1", "python")),
        ("a: !thing 3", ("line 1", "!thing")),
        ("a: &x [1]\nb: *x", ("line 1", "alias")),
        ("a: 1\nb: 2\na: 3", ("line 3", "'a'", "first in line 1")),
        ("? [1, 2]\n: 3", ("line 1", "key")),
        ("a:\n  - b\n - c", ("line 3", "YAML")),
        ("a: {b}: c", ("line 1", "YAML")),
        ("", ("empty",)),
        ("a: 1\n---\nb: 2", ("line 2", "YAML")),
        ("a: " + 200 * "[" + 200 * "]", ("nested",)),
    ],
)
def test_yaml_that_a_recipe_does_not_use_is_refused_with_its_line(text, words, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        read_yaml(path)
    assert all(word in str(caught.value) for word in words), caught.value


def test_a_small_file_cannot_become_a_large_one(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(
        "a0: &a0 [1, 1]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 60))
    )
    with pytest.raises(BadInput, match="alias"):
        read_yaml(path)


def test_a_recipe_beyond_the_limit_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "a.yaml"
    path.write_text("".join(f"k{number}: 1\n" for number in range(250_000)))
    monkeypatch.setattr(Path, "read_bytes", None)
    with pytest.raises(
        BadInput, match=r"a\.yaml has \d+ bytes; expected at most 2000000\. .*LARGEST_RECIPE_BYTES="
    ):
        read_yaml(path)


def test_files_that_are_no_texts_are_refused(tmp_path):
    for name, data in (("a.yaml", b"\xff\xfe\x00"), ("b.csv", b"a,b\n\x00,1\n"), ("c.yaml", b"a: \x07")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(UnreadableFile, match=name):
            read_recipe(tmp_path / name, VERBS)
    with pytest.raises(UnreadableFile, match=r"gone\.yaml"):
        read_recipe(tmp_path / "gone.yaml", VERBS)
    with pytest.raises(BadInput, match=r"recipe\.txt"):
        read_recipe(tmp_path / "recipe.txt", VERBS)


# mistakes in a recipe


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("    gain:", "    gian:", ("line 14", "'gian'", "'gain'", "caricature")),
        ("factors:", "factor:", ("line 5", "'factor'", "'factors'")),
        ("verb: grid", "verb: gird", ("line 16", "'gird'", "'grid'")),
        ('"{gain}"', '"{gian}"', ("line 14", "{gian}", "'gain'")),
        (
            "{identity.loadings}",
            "{identity.loading}",
            ("line 13", "{identity.loading}", "'identity.loadings'"),
        ),
        ("{identity}_g", "{identity.x}_g", ("line 15", "{identity.x}")),
        ("{identity}_g", "{identity_g", ("line 15", "brace")),
        ("{identity}_g", "{identity.__class__}_g", ("line 15", "__class__")),
        ("{identity}_g", "{identity[0]}_g", ("line 15", "placeholder")),
        ("version: 1", "version: 2", ("line 2", "version 2")),
        ("version: 1", "version: true", ("line 2", "True")),
        ("morphspace-recipe", "recipe", ("line 1", "'recipe'")),
        ("[0.5, 1, -1.5]", "[]", ("line 9", "'gain'", "list of levels")),
        ("[0.5, 1, -1.5]", "0.5", ("line 9", "'gain'", "0.5")),
        ("[0.5, 1, -1.5]", "[0.5, 1, 1.0]", ("line 9", "twice")),
        ("[0.5, 1, -1.5]", "[0.5, [1], 2]", ("line 9", "'gain'")),
        ("[0.5, 1, -1.5]", "[0.5, 1e999]", ("line 9", "finite")),
        ("loadings: bob.csv", "loading: bob.csv", ("line 8", "'bob'", "'loadings'", "'ann'")),
        ("  gain: [", "  gain-x: [", ("line 9", "'gain-x'")),
        ("tables/smile.csv", "[1]", ("line 4", "'smile'")),
        ("tables/smile.csv", '"{gain}.csv"', ("line 4", "placeholder")),
        ("  gain: [0.5, 1, -1.5]", "  gain: [1]\n  sex: [f, m]", ("line 10", "'sex'", "{sex}")),
        ("  - verb: grid\n", "  - name: x\n", ("line 16", "verb")),
        ("steps: 5", "steps: 5\n  - 7", ("line 19", "7")),
        ('name: "{identity}_g{gain}_{frame}"', "name: []", ("line 15", "name")),
    ],
)
def test_a_mistake_is_told_with_its_line_and_the_nearest_word(old, new, words, tmp_path):
    assert WHOLE.count(old) == 1 or old in ("{identity}_g", '"{gain}"', "morphspace-recipe")
    refused(tmp_path, WHOLE.replace(old, new), "recipe.yaml", *words)


@pytest.mark.parametrize(
    "text", ["[1, 2]", "format: morphspace-recipe\nversion: 1", HEAD + "stimuli: {}", HEAD + "stimuli: []"]
)
def test_a_recipe_without_stimuli_is_refused(text, tmp_path):
    refused(tmp_path, text, "recipe.yaml")


# tables


def test_a_table_has_a_job_a_row_and_conditions_for_the_manifest(tmp_path):
    rows = [
        ("verb", "model", "gain", "name", "factor:sex"),
        ("caricature", "a.morph", "1.5", "one, two", "f"),
        ("", "", "", "", ""),
        ("caricature", "b.morph", "", "{frame}", "m"),
    ]
    with (tmp_path / "set.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    jobs = list(read_recipe(tmp_path / "set.csv", VERBS).jobs())
    assert [job.settings for job in jobs] == [{"model": "a.morph", "gain": "1.5"}, {"model": "b.morph"}]
    assert [(job.name, job.levels) for job in jobs] == [("one, two", {"sex": "f"}), ("{frame}", {"sex": "m"})]
    assert [job.where[-6:] for job in jobs] == ["line 2", "line 4"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("verb,model,gian\ncaricature,a,1\n", ("line 2", "'gian'", "'gain'", "factor:gian")),
        ("verb,model\ngird,a\n", ("line 2", "'gird'", "'grid'")),
        ("model\na\n", ("line 2", "verb")),
        ("verb,model\ncaricature,a,b\n", ("line 2", "3 cells", "2 columns")),
        ("verb,verb\ncaricature,a\n", ("line 1", "'verb'")),
        ("verb,\ncaricature,a\n", ("line 1", "column 2")),
        ("verb;model\ncaricature;a\n", ("line 1", "semicolons")),
        ("sep=,\nverb,model\ncaricature,a\n", ("line 1", "'sep=,'", "Delete")),
        ("verb,model\n", ("no rows",)),
        ("verb,model\ncaricature,{x}.morph\n", ("line 2", "model")),
        ('verb,model\ncaricature,"a\n', ("CSV",)),
        ("", ("empty",)),
    ],
)
def test_a_mistake_in_a_table_is_told_with_its_line(text, words, tmp_path):
    refused(tmp_path, text, "set.csv", *words, name="set.csv")


def test_rows_count_their_lines_over_cells_with_line_ends(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text('\ufeffa,b\n"x\ny",1\n,\nz,2\n')
    read = read_rows(path)
    assert read.value == [{"a": "x\ny", "b": "1"}, {"a": "z", "b": "2"}]
    assert [read.where(row)[-6:] for row in (0, 1)] == ["line 2", "line 5"]


# places


def test_numbers_are_written_as_they_stand_or_as_the_form_says():
    known = {"a": 0.5, "b": 3, "c": "x", "d": True, "e": 2.0}
    assert filled("{a}_{b}_{c}", known) == "0.5_3_x"
    assert filled("{b:03d}_{a:.2f}_{e:d}", known) == "003_0.50_2"
    assert filled("{e}_{e:.1f}", known) == "2_2.0"
    assert filled("{b}", known) == 3 and filled("{b:d}", known) == "3"
    assert filled({"k": ["{a}", {"m": "<{b}>"}]}, known) == {"k": [0.5, {"m": "<3>"}]}
    for text in ("{c:d}", "{a:d}", "x{d}", "{a:.2d}"):
        with pytest.raises(BadInput):
            filled(text, known)


@given(st.text(max_size=30))
def test_any_text_is_taken_apart_or_refused(text):
    try:
        pieces = pieces_of(text)
    except BadInput:
        return
    words = {place.key: "<>" for place in places_in(text)}
    assert "{" not in str(filled(text, words)) or not pieces


@settings(max_examples=300, deadline=None)
@given(
    suffix=st.sampled_from([".yaml", ".csv"]),
    content=st.binary(max_size=60)
    | st.lists(
        st.sampled_from(
            [
                "format: morphspace-recipe",
                "version: 1",
                "stimuli:",
                "  - verb: caricature",
                "    gain: 1e999",
                "a: &x [*x]",
                "? {a: b}",
                "factors: {g: [1, .nan]}",
                "- !!python/object:os.system x",
                "\t:",
                "verb,name",
                "grid,{x",
                "'",
            ]
        )
    ).map(lambda lines: "\n".join(lines).encode()),
)
def test_any_bytes_are_a_recipe_or_refused(tmp_path_factory, suffix, content):
    path = tmp_path_factory.mktemp("any") / f"a{suffix}"
    path.write_bytes(content)
    with contextlib.suppress(BadInput):
        list(read_recipe(path, VERBS).jobs())
