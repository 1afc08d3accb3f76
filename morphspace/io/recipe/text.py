"""Read YAML and CSV as plain data with line numbers, so that a message can name the faulty line of a recipe.

A recipe needs only mappings, lists, texts, numbers, true, false and null, as in the core schema of YAML 1.2. PyYAML
follows YAML 1.1, where `no` is false and `1:30` is ninety; in a list of identities both are texts. Aliases, tags and
repeated keys are refused: nothing is executed, and a small file cannot expand into a large one. Ours.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.limits import RECIPE_BYTES
from morphspace.io.texts import read_table, read_text

DEEPEST = 12  # levels; a recipe has six
INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,14})")  # not 0001, which may name an identity or a frame
NUMBER = re.compile(r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]{1,3})?")
PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}"
    for kind in ("str", "int", "float", "bool", "null", "seq", "map", "timestamp", "merge", "value")
}
WORDS: Mapping[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}

Spot = tuple[str | int, ...]


@dataclass(frozen=True, eq=False)
class Lined:
    """Plain data and the line number of each part.

    Attributes
    ----------
    path : Path
    value : mappings, lists, texts, numbers, booleans or None
    lines : mapping of tuple to int
        The line, from 1, by the path to a part, such as `("stimuli", 0, "gain")`; for an entry of a mapping, that of
        its key.
    """

    path: Path
    value: Any
    lines: Mapping[Spot, int]

    def where(self, *spot: str | int) -> str:
        """Return `FILE line N` of the part, or of the nearest part around it, as the start of a message."""
        while spot and spot not in self.lines:
            spot = spot[:-1]
        return f"{self.path} line {self.lines.get(spot, 1)}"


def read_yaml(path: Path) -> Lined:
    """Read a YAML file.

    Raises
    ------
    UnreadableFile
        If the file is missing or is not YAML.
    BadInput
        If it has aliases, tags, repeated keys or too many levels.
    """
    text = read_text(path, RECIPE_BYTES)
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}" if mark else ""
        problem = " ".join(str(error.problem or error.context).split())
        raise UnreadableFile(
            f"{path}{line} is not YAML: {problem}. Correct this line or the one above"
        ) from error
    except (yaml.YAMLError, RecursionError) as error:
        raise UnreadableFile(f"{path} is not YAML: {' '.join(str(error).split())}. Correct it") from error
    if root is None:
        raise UnreadableFile(f"{path} is empty; expected a recipe. Check the name")
    lines: dict[Spot, int] = {}
    value = _plain(path, root, (), lines, set())
    return Lined(path, value, lines)


def read_rows(path: Path) -> Lined:
    """Read a CSV table as a list of mappings, one per row. All cells are texts; empty cells are left out.

    Raises
    ------
    UnreadableFile
        If the file is missing or is not CSV.
    BadInput
        If rows differ in length, or a column has no name or the name of another.
    """
    table = read_table(path)
    rows = [
        {name: cell.strip() for name, cell in zip(table.headings, cells, strict=True) if cell.strip()}
        for cells in table.rows
    ]
    lines: dict[Spot, int] = {(): 1, **{(row,): line for row, line in enumerate(table.lines)}}
    return Lined(path, rows, lines)


def _plain(path: Path, node: Any, spot: Spot, lines: dict[Spot, int], seen: set[int]) -> Any:
    """Convert a YAML node to plain data, and record the line of each part in `lines`."""

    line = node.start_mark.line + 1
    lines.setdefault(spot, line)
    if id(node) in seen:
        raise BadInput(
            f"{path} line {line} is repeated by an alias (*); expected plain data. Write the text at each place"
        )
    if len(spot) > DEEPEST:
        raise BadInput(
            f"{path} line {line} is nested {len(spot)} levels deep; expected at most {DEEPEST}. Flatten it"
        )
    seen.add(id(node))
    if node.tag not in PLAIN_TAGS:
        raise BadInput(f"{path} line {line} has the tag {node.tag}; expected plain data. Remove the tag")
    if isinstance(node, yaml.MappingNode):
        return _mapping(path, node, spot, lines, seen)
    if isinstance(node, yaml.SequenceNode):
        return [_plain(path, inner, (*spot, i), lines, seen) for i, inner in enumerate(node.value)]
    return _scalar(node.value) if node.style is None else node.value


def _mapping(path: Path, node: Any, spot: Spot, lines: dict[Spot, int], seen: set[int]) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for key_node, inner in node.value:
        line = key_node.start_mark.line + 1
        key = key_node.value
        if not isinstance(key, str):
            raise BadInput(
                f"{path} line {line} has a composite key; expected a word. Put a text that starts with a brace in "
                "quotes"
            )
        if key in plain:
            raise BadInput(
                f"{path} line {line}: {key!r} is repeated, first in line {lines[(*spot, key)]}. Remove one"
            )
        lines[(*spot, key)] = line
        plain[key] = _plain(path, inner, (*spot, key), lines, seen)
    return plain


def _scalar(text: str) -> Any:
    """Read an unquoted scalar by the core schema of YAML 1.2, without octal and hexadecimal numbers."""
    if text in WORDS:
        return WORDS[text]
    if INTEGER.fullmatch(text):
        return int(text)
    return float(text) if NUMBER.fullmatch(text) else text
