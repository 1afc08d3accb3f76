"""Tables of numbers as CSV with the unit in each heading: loadings over time, and measures of them.

The loadings table is the recorded motion of a face; `data_spec/loadings-table.md` describes it. Numbers are
written as the shortest text that reads back to the same 64-bit value.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import LoadingTable
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.sidecars import check_format, read_json_object
from morphspace.storage import json_text, write_text

LOADINGS_FORMAT = "morphspace-loadings"
LOADINGS_VERSION = 1
LOADINGS_UNIT = "sd"
FRAME_COLUMN = "frame"
COMPONENT_COLUMN = re.compile(r"pc([0-9]{3,})_sd")
TEXT_COLUMNS = ("frame", "clip", "identity", "name")  # never read as numbers: a frame may be called 0001


@dataclass(frozen=True, eq=False)
class LoadingsTable:
    """Loadings `loadings_sd` (n, k) in SD of each component, one row a frame of `frame_names`.

    `document` is what the JSON file beside the table tells (model, identity, where it came from), or None
    where there is no such file: then nothing says which model the loadings belong to.
    """

    frame_names: tuple[str, ...]
    loadings_sd: LoadingTable
    document: Mapping[str, Any] | None


def write_loadings_table(
    path: str | Path, loadings_sd: LoadingTable, frame_names: Sequence[str], document: Mapping[str, Any]
) -> None:
    """Write loadings (n, k) in SD as CSV, and `document` as JSON under the same name, each whole or not at
    all.

    The JSON gets `format`, `version`, `unit`, `frame_count` and `component_count` beside what `document`
    holds; a `frame_rate_hz` of None is left out. Raises `BadInput` (another suffix than `.csv`, shapes that
    disagree, repeated names, values that are not finite) and `UnwritableFile`.
    """
    path = _csv_path(path)
    loadings = np.asarray(loadings_sd, np.float64)
    names = [str(name) for name in frame_names]
    if loadings.ndim != 2 or loadings.shape[0] != len(names):
        raise BadInput(
            f"cannot write {path}: loadings of shape {loadings.shape} do not fit {len(names)} frame names"
        )
    _check_names(path, names)
    if not np.isfinite(loadings).all():
        row, column = np.argwhere(~np.isfinite(loadings))[0]
        raise BadInput(
            f"cannot write {path}: {_heading(column)} of frame {names[row]} is {loadings[row, column]}"
        )
    headings = [FRAME_COLUMN, *map(_heading, range(loadings.shape[1]))]
    rows = [[name, *map(repr, row)] for name, row in zip(names, loadings.tolist(), strict=True)]
    ours = {
        "format": LOADINGS_FORMAT,
        "version": LOADINGS_VERSION,
        "unit": LOADINGS_UNIT,
        "frame_count": loadings.shape[0],
        "component_count": loadings.shape[1],
    }
    write_text(path, _csv_text(headings, rows))
    told = {key: value for key, value in document.items() if key != "frame_rate_hz" or value is not None}
    write_text(path.with_suffix(".json"), json_text({**told, **ours}))


def read_loadings_table(path: str | Path) -> LoadingsTable:
    """Read a loadings table; the values are bit-equal to those written.

    The JSON file beside it may be missing (a table typed by hand): `document` is then None. Raises
    `UnreadableFile`, and `BadInput` naming the row and column of what is wrong.
    """
    path = _csv_path(path)
    headings, rows = _read_csv(path)
    components = _check_headings(path, headings)
    names = [row[0] for row in rows]
    _check_names(path, names)
    values = [
        [_number(path, line, heading, cell) for heading, cell in zip(headings[1:], row[1:], strict=True)]
        for line, row in enumerate(rows, start=2)
    ]
    loadings = np.array(values, np.float64).reshape(len(rows), components)
    loadings.setflags(write=False)
    beside = path.with_suffix(".json")
    document = read_json_object(beside) if beside.exists() else None
    if document is not None:
        _check_document(path, beside, document, loadings.shape)
    return LoadingsTable(tuple(names), loadings, document)


def write_metrics_table(path: str | Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write columns of texts or numbers as CSV; the unit belongs in each name, as in `distance_px`.

    None and NaN become empty cells. Raises `BadInput` where columns differ in length, and `UnwritableFile`.
    """
    path = _csv_path(path)
    lengths = {name: len(values) for name, values in columns.items()}
    if not lengths:
        raise BadInput(f"cannot write {path}: there are no columns")
    first, count = next(iter(lengths.items()))
    for name, length in lengths.items():
        if length != count:
            raise BadInput(f"cannot write {path}: column {name} has {length} rows, {first} has {count}")
    cells = [[_cell(value) for value in values] for values in columns.values()]
    write_text(path, _csv_text(list(columns), [list(row) for row in zip(*cells, strict=True)]))


def read_metrics_table(path: str | Path) -> dict[str, list[str] | list[float]]:
    """Read a table of measures: a column is of numbers (an empty cell is NaN) where every cell is one, else
    of texts.

    The columns frame, clip, identity and name are always texts. Raises `UnreadableFile` and `BadInput`.
    """
    path = _csv_path(path)
    headings, rows = _read_csv(path)
    if len(set(headings)) < len(headings):
        raise BadInput(f"{path}: a column name appears twice in {', '.join(headings)}")
    table: dict[str, list[str] | list[float]] = {}
    for place, heading in enumerate(headings):
        cells = [row[place] for row in rows]
        numbers = [_float_or_none(cell or "nan") for cell in cells]
        has_numbers = heading not in TEXT_COLUMNS and any(cells) and None not in numbers
        table[heading] = [number for number in numbers if number is not None] if has_numbers else cells
    return table


def _heading(component: int) -> str:
    return f"pc{component + 1:03d}_sd"


def _csv_path(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise BadInput(f"{path} does not end in .csv: a table is a CSV file")
    return path


def _csv_text(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(rows)
    return text.getvalue()


def _read_csv(path: Path) -> tuple[list[str], list[list[str]]]:
    """Give the headings and the rows, every row as long as the headings; a byte order mark is passed over."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = [row for row in csv.reader(file, strict=True) if row]
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UnreadableFile(f"{path} is not a CSV text in UTF-8: {error}; export it again") from error
    if not lines:
        raise UnreadableFile(f"{path} is empty: a first row of column names was expected")
    headings, *rows = lines
    for line, row in enumerate(rows, start=2):
        if len(row) != len(headings):
            raise BadInput(
                f"{path}: row {line} has {len(row)} cells, the first row names {len(headings)} columns"
            )
    return headings, rows


def _check_headings(path: Path, headings: Sequence[str]) -> int:
    """Give the number of components; the columns are the frame, then pc001_sd and on without gap."""
    if headings[0] != FRAME_COLUMN:
        raise BadInput(f"{path}: the first column is {headings[0]!r}, {FRAME_COLUMN!r} was expected")
    if len(headings) == 1:
        raise BadInput(f"{path}: there is no component column, {_heading(0)} and on were expected")
    for place, heading in enumerate(headings[1:]):
        if not COMPONENT_COLUMN.fullmatch(heading):
            raise BadInput(
                f"{path}: column {heading!r} is not a loading in SD, {_heading(place)!r} was expected there"
            )
        if heading in headings[1 : place + 1]:
            raise BadInput(f"{path}: column {heading} appears twice")
        if heading != _heading(place):
            raise BadInput(
                f"{path}: column {heading} stands where {_heading(place)} was expected: "
                "no component may be left out"
            )
    return len(headings) - 1


def _check_names(path: Path, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise BadInput(f"{path}: frame {name!r} appears twice: each row needs a name of its own")
        seen.add(name)


def _check_document(path: Path, beside: Path, document: Mapping[str, Any], shape: tuple[int, ...]) -> None:
    check_format(beside, document, LOADINGS_FORMAT, LOADINGS_VERSION)
    if document.get("unit") != LOADINGS_UNIT:
        raise BadInput(f"{beside}: the unit is {document.get('unit')!r}, {LOADINGS_UNIT!r} was expected")
    if document.get("component_count", shape[1]) < shape[1]:
        raise BadInput(
            f"{beside} says component_count {document['component_count']}, {path} has {shape[1]}: "
            "the two files do not belong together"
        )


def _number(path: Path, line: int, heading: str, cell: str) -> float:
    value = _float_or_none(cell)
    if value is None or not np.isfinite(value):
        raise BadInput(f"{path}: row {line}, column {heading} is {cell!r}, a number was expected")
    return value


def _float_or_none(cell: str) -> float | None:
    if (
        not cell.isascii() or "_" in cell
    ):  # Python takes 1_0 and digits of other scripts, which no table means
        return None
    try:
        return float(cell)
    except ValueError:
        return None


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float | np.floating) and np.isnan(value)):
        return ""
    if isinstance(value, float | np.floating):
        return repr(float(value))
    return str(value)
