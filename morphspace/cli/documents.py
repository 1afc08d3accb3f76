"""Generate documents from the declarations: the page of all settings, and the schemas of recipes and of JSON files.

`python -m morphspace.cli.documents verbs > docs/verbs.md` writes the page; `... recipe-schema` prints the JSON Schema
of a recipe, with which an editor can check its YAML; `... schemas data_spec` writes those of all JSON files.
"""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path
from typing import Any

from morphspace.cli.options import usage_of
from morphspace.documents import Document
from morphspace.imitation.table import MEASURES
from morphspace.io.points_table import POINTS
from morphspace.io.recipe.grammar import OWN_KEYS, RECIPE_FORMAT, RECIPE_VERSION, REQUIRED
from morphspace.io.sidecars import CLIP, FACEFRAME
from morphspace.io.stimulus_sidecars import STIMULUS
from morphspace.io.tables import LOADINGS
from morphspace.model.file import MODEL
from morphspace.outcome import RECORD
from morphspace.requests import NOTHING, Verb, all_verbs, fields_of, recipe_verbs, settings_of
from morphspace.sets.folders import MARK
from morphspace.sets.manifest import MANIFEST
from morphspace.settings import Field, json_schemas
from morphspace.storage import write_text
from morphspace.transfer.quality_table import MIMICRY

HEAD = """# Verbs

Every verb of morphspace with its settings. In Python they are the fields of a request of `morphspace.verbs.NAME`, whose
`run` executes it. A [recipe](../data_spec/recipe.md) has them as keys of an entry, for the verbs marked with
an asterisk. Python, the command line and recipes accept the same values. `morphspace VERB --help` shows the same
texts. Every verb also takes `--workers`, `--quiet`, `--json` and `--debug`.

This page is generated from the declarations: `python -m morphspace.cli.documents verbs > docs/verbs.md`.
"""
WIDTH = 116  # characters of a line of a schema
DOCUMENTS: tuple[Document[Any], ...] = (
    CLIP,
    FACEFRAME,
    LOADINGS,
    POINTS,
    RECORD,
    STIMULUS,
    MANIFEST,
    MEASURES,
    MIMICRY,
    MARK,
    MODEL,
)
"""All kinds of files that hold a JSON document."""
Schema = dict[str, Any]


def verbs_page() -> str:
    """Return the page of all verbs and their settings, in Markdown."""
    verbs = list(all_verbs())
    starred = recipe_verbs()
    rows = [
        f"| [{verb.name}](#{verb.name.replace(' ', '-')}){'*' if verb.name in starred else ''} | {_first_line(verb)} |"
        for verb in verbs
    ]
    table = "\n".join(["| verb | what it does |", "|---|---|", *rows])
    return "\n".join([HEAD, table, "", *map(_section, verbs)])


def _first_line(verb: Verb) -> str:
    return inspect.cleandoc(verb.help).splitlines()[0]


def _section(verb: Verb) -> str:
    """Return the section of a verb: purpose, usage, and table of settings."""
    text = inspect.cleandoc(verb.help)
    if "\b\n" in text:  # click's mark of a block that keeps its lines
        before, block = text.split("\b\n")
        text = f"{before}```text\n{block}\n```"
    rows = [_row(field) for field in fields_of(verb.request)]
    table = ["| setting | on the command line | value | default | meaning |", "|---|---|---|---|---|", *rows]
    return "\n".join([f"## {verb.name}", "", text, "", f"    {usage_of(verb)}", "", *table, ""])


def _row(field: Field) -> str:
    default = "required" if field.required else f"`{field.default_words}`" if field.default_words else ""
    spoken = f"`{', '.join(field.flags) if field.argument is None else field.spoken}`" if field.spoken else ""
    cells = [f"`{field.name}`", spoken, field.words, default, field.help]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def recipe_schema() -> Schema:
    """Return the JSON Schema of a recipe, from the requests of the verbs that recipes may use.

    The schema checks limits of numbers and lengths of lists only for values that are not written as text.
    """
    verbs = recipe_verbs()
    entries = {f"entry_{name}": _entry(verb) for name, verb in verbs.items()}
    chosen = [
        {
            "if": {"properties": {"verb": {"const": name}}},
            "then": {"$ref": f"#/$defs/entry_{name}"},
        }
        for name in verbs
    ]
    level = {"anyOf": [{"type": "number"}, {"type": "string", "minLength": 1}]}
    brought = [
        {"type": ["number", "string", "boolean", "null", "array"]},
        {"type": "object", "propertyNames": {"$ref": "#/$defs/word"}},
    ]
    factor = [
        {"type": "array", "minItems": 1, "items": level},
        {"type": "object", "minProperties": 1, "additionalProperties": {"anyOf": brought}},
    ]
    words = {"type": ["object", "null"], "propertyNames": {"$ref": "#/$defs/word"}}
    path = {"type": "string", "minLength": 1, "pattern": "^[^{]*$"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"morphspace recipe, version {RECIPE_VERSION} (as YAML)",
        "type": "object",
        "required": list(REQUIRED),
        "additionalProperties": False,
        "properties": {
            "format": {"const": RECIPE_FORMAT},
            "version": {"const": RECIPE_VERSION},
            "description": {"type": "string"},
            "sources": {**words, "additionalProperties": path},
            "factors": {**words, "additionalProperties": {"anyOf": factor}},
            "stimuli": {
                "type": "array",
                "minItems": 1,
                "items": {
                    "type": "object",
                    "required": ["verb"],
                    "properties": {"verb": {"enum": list(verbs)}},
                    "allOf": chosen,
                },
            },
        },
        "$defs": {
            "filled": {
                "type": "string",
                "pattern": "\\{[^{}]+\\}",
                "description": "with a placeholder; a placeholder alone is replaced by the level itself, of any kind",
            },
            "word": {"type": "string", "pattern": "^[A-Za-z][A-Za-z0-9_]*$"},
            "pattern": {
                "anyOf": [{"type": "string", "pattern": "\\S"}, {"type": "number"}],
                "description": "names of stimuli: text, / between folders, placeholders in braces",
            },
            **entries,
        },
    }


def _entry(verb: Verb) -> Schema:
    settings = settings_of(verb.request)
    own = {"verb": {"const": verb.name}, "name": {"$ref": "#/$defs/pattern"}}
    assert tuple(own) == OWN_KEYS
    return {
        "type": "object",
        "required": ["verb", *(field.name for field in settings if field.required)],
        "additionalProperties": False,
        "properties": {**own, **{field.name: setting_schema(field) for field in settings}},
    }


def setting_schema(field: Field) -> Schema:
    """Return the JSON Schema of one setting of an entry: its values, texts for them, and placeholders."""
    nothing = [{"const": NOTHING}] if field.optional else []
    values = json_schemas(field.kind, field.marks)
    return {"description": field.help, "anyOf": [{"$ref": "#/$defs/filled"}, *nothing, *values]}


def schema_text(document: Document[Any]) -> str:
    """Return the JSON Schema of a kind of file as text, in which what fits on a line stands on one."""
    return _wrapped(document.schema(), "") + "\n"


def _wrapped(value: Any, indent: str) -> str:
    line, inner = json.dumps(value), indent + "  "
    if not isinstance(value, dict | list) or len(indent + line) <= WIDTH:
        return line
    keys = [f"{json.dumps(key)}: " for key in value] if isinstance(value, dict) else [""] * len(value)
    values = value.values() if isinstance(value, dict) else value
    first, last = line[0], line[-1]
    parts = [f"{inner}{key}{_wrapped(one, inner)}" for key, one in zip(keys, values, strict=True)]
    return f"{first}\n" + ",\n".join(parts) + f"\n{indent}{last}"


def main() -> None:
    """Print the requested document, or write the schemas into a folder."""
    wanted, *folder = sys.argv[1:]
    if wanted == "schemas":
        for document in DOCUMENTS:
            write_text(Path(*folder) / f"{document.name}.schema.json", schema_text(document))
        return
    print(verbs_page().rstrip() if wanted == "verbs" else json.dumps(recipe_schema(), indent=2))


if __name__ == "__main__":
    main()
