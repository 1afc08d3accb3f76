"""YAML and CSV as plain data that know their lines, so that what is wrong in a recipe can be pointed at.

Of YAML we take what a recipe needs: mappings, lists, texts, numbers, true, false and null, read by the core schema
of YAML 1.2. Under the older rules of the library we use, `no` would be false and `1:30` ninety, which no list of
identities means. Aliases, tags and repeated keys are refused: nothing is executed, and a small file cannot become a
large one. Ours.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from morphspace.errors import BadInput, UnreadableFile

LARGEST_BYTES = 20_000_000  # a table of 100,000 rows is a fifth of it; more is not a recipe
DEEPEST = 12  # levels; a recipe has six
INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,14})")  # 0001 stays a text: identities and frames are called so
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
    """Plain data (`value`: mappings, lists, texts, numbers, booleans, None) and the line each part stands on.

    `lines` holds, by the way to a part such as `("stimuli", 0, "gain")`, the line counted from 1; for an entry of a
    mapping that of its key.
    """

    path: Path
    value: Any
    lines: Mapping[Spot, int]

    def where(self, *spot: str | int) -> str:
        """Give `FILE line N` of the part, or of the nearest part around it, to open a message with."""
        while spot and spot not in self.lines:
            spot = spot[:-1]
        return f"{self.path} line {self.lines.get(spot, 1)}"


def read_yaml(path: Path) -> Lined:
    """Read a YAML file. Raises `UnreadableFile` (missing, not YAML) and `BadInput` (what a recipe does not use)."""
    text = _text_of(path)
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}" if mark else ""
        said = " ".join(str(error.problem or error.context).split())
        raise UnreadableFile(f"{path}{line} is not YAML: {said}; mend it there or just above") from error
    except (yaml.YAMLError, RecursionError) as error:
        raise UnreadableFile(f"{path} is not YAML: {' '.join(str(error).split())}") from error
    if root is None:
        raise UnreadableFile(f"{path} is empty: a recipe was expected")
    lines: dict[Spot, int] = {}
    value = _plain(path, root, (), lines, set())
    return Lined(path, value, lines)


def read_rows(path: Path) -> Lined:
    """Read a CSV table as a list of mappings, one a row, all cells as texts, empty cells left out.

    Raises `UnreadableFile` (missing, not CSV) and `BadInput` (rows of different length, columns without or of one
    name).
    """
    text = _text_of(path)
    rows: list[dict[str, str]] = []
    lines: dict[Spot, int] = {(): 1}
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        headings = [cell.strip() for cell in next(reader, [])]
        _check_headings(path, headings)
        start = reader.line_num + 1
        for cells in reader:
            line, start = start, reader.line_num + 1
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(headings):
                raise BadInput(
                    f"{path} line {line} has {len(cells)} cells, the first row names {len(headings)} "
                    "columns: put a cell that holds a comma in double quotes"
                )
            lines[(len(rows),)] = line
            rows.append(
                {name: cell.strip() for name, cell in zip(headings, cells, strict=True) if cell.strip()}
            )
    except csv.Error as error:
        raise UnreadableFile(f"{path} line {reader.line_num} is not CSV: {error}; export it again") from error
    return Lined(path, rows, lines)


def _check_headings(path: Path, headings: list[str]) -> None:
    if not any(headings):
        raise UnreadableFile(f"{path} is empty: a first row of column names was expected")
    if len(headings) == 1 and ";" in headings[0]:
        raise BadInput(
            f"{path} line 1: the columns are separated by semicolons, commas were expected: export it so"
        )
    for place, name in enumerate(headings):
        if not name:
            raise BadInput(f"{path} line 1: column {place + 1} has no name: name it, or remove it")
        if name in headings[:place]:
            raise BadInput(f"{path} line 1: column {name!r} appears twice")


def _text_of(path: Path) -> str:
    try:
        size = path.stat().st_size
        if size > LARGEST_BYTES:
            raise BadInput(f"{path} is {size} bytes long, a recipe has at most {LARGEST_BYTES}: split it")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    except UnicodeDecodeError as error:
        raise UnreadableFile(f"{path} is not a text in UTF-8: {error.reason}; save it as UTF-8") from error
    if "\0" in text:
        raise UnreadableFile(f"{path} is not a text: it holds zero bytes; save it as UTF-8")
    return text


def _plain(path: Path, node: Any, spot: Spot, lines: dict[Spot, int], seen: set[int]) -> Any:
    line = node.start_mark.line + 1
    lines.setdefault(spot, line)
    if id(node) in seen:
        raise BadInput(
            f"{path} line {line}: what stands here is used again by an alias (*): write it out there"
        )
    if len(spot) > DEEPEST:
        raise BadInput(
            f"{path} line {line} is nested {len(spot)} deep, a recipe at most {DEEPEST}: flatten it"
        )
    seen.add(id(node))
    if node.tag not in PLAIN_TAGS:
        raise BadInput(f"{path} line {line}: the tag {node.tag} is not for a recipe: write plain data")
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
                f"{path} line {line}: a key is a single word: where a text starts with a brace, put it in quotes"
            )
        if key in plain:
            raise BadInput(
                f"{path} line {line}: {key!r} stands there twice, first in line {lines[(*spot, key)]}"
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
