"""Tables of numbers as CSV with the unit in each heading: loadings over time, and measures.

The loadings table is the recorded motion of a face; `data_spec/loadings-table.md` describes it. Each number is
written as the shortest text that reads back to the same 64-bit value. Frame names are compared in NFC, since systems
write accents as one character or as two.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import numpy as np
from annotated_types import Ge

from morphspace.arrays import AnyArray, LoadingTable
from morphspace.documents import Digest, Document, FrameRate, Open, OrNull
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.names import FORMULA, composed
from morphspace.io.texts import COMMA_NUMBER, DATE, Table, number_remedy, read_table
from morphspace.storage import (
    digest_of_bytes,
    digest_of_file,
    is_being_written,
    json_text,
    write_text,
    write_texts,
)

FRAME_COLUMN = "frame"
TIME_COLUMN = "time_s"
RATE_TOL = 0.02  # relative; the rate of a header and of the times of a recording differ less (`io.video`)
COMPONENT_COLUMN = re.compile(r"pc([0-9]{3,})_sd")
TEXT_COLUMNS = ("frame", "clip", "identity", "name")  # never read as numbers: 0001 may name a frame


class LoadingsDocument(TypedDict):
    """The entries of the JSON beside a loadings table (data_spec/loadings-table.md)."""

    format: Literal["morphspace-loadings"]
    version: Literal[1]
    unit: Literal["sd"]
    frame_count: NotRequired[Annotated[int, Ge(0)]]
    component_count: NotRequired[Annotated[int, Ge(1)]]
    table_sha256: NotRequired[Digest]
    model_id: NotRequired[OrNull[str]]
    identity: NotRequired[OrNull[str]]
    source_model_id: NotRequired[OrNull[str]]
    source_identity: NotRequired[OrNull[str]]
    frame_rate_hz: NotRequired[OrNull[FrameRate]]


LOADINGS = Document(
    "loadings-table",
    "morphspace loadings, version 1: the JSON beside the CSV",
    LoadingsDocument,
    "Encode the clip again",
    marks=(Open(),),
)


@dataclass(frozen=True, eq=False)
class LoadingsTable:
    """Loadings as read from a table.

    Attributes
    ----------
    frame_names : tuple of n str
    loadings_sd : array (n, k), SD of each component
    document : mapping or None
        The JSON file beside the table (model, identity, origin). Without it the model of the loadings is unknown.
    notes : tuple of str
        That the table was changed after it was written, if it was.
    times_s : array (n,) s, or None
        The time of each frame, rising, if the table has it.
    """

    frame_names: tuple[str, ...]
    loadings_sd: LoadingTable
    document: LoadingsDocument | None
    notes: tuple[str, ...] = ()
    times_s: AnyArray | None = None

    @property
    def rate_hz(self) -> float | None:
        """Return the frames a second in the sidecar, or else those of the times; None if there is neither."""
        rate_hz = self.document and self.document.get("frame_rate_hz")
        if rate_hz:
            return float(rate_hz)
        if self.times_s is None or len(self.times_s) < 2:
            return None
        return float((len(self.times_s) - 1) / (self.times_s[-1] - self.times_s[0]))


def write_loadings_table(
    path: str | Path,
    loadings_sd: LoadingTable,
    frame_names: Sequence[str],
    document: Mapping[str, Any],
    times_s: Sequence[float] | None = None,
) -> None:
    """Write loadings as CSV and their description as JSON beside it, both completely or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in `.csv`.
    loadings_sd : array (n, k), SD
    frame_names : n unique str
    document : mapping
        `format`, `version`, `unit`, `frame_count`, `component_count` and the digest of the table are added; a
        `frame_rate_hz` of None is left out.
    times_s : n floats, s, or None
        The time of each frame, rising; written as a column.

    Raises
    ------
    BadInput
        If the suffix is another, shapes disagree, a name is repeated or begins as a formula, a value is not
        finite, or the times do not rise.
    UnwritableFile
        If the folder or disk refuses a file.

    Examples
    --------
    >>> import numpy as np
    >>> about = {"model_id": "0" * 16, "identity": "anna"}
    >>> write_loadings_table("two.csv", np.array([[0.5], [1.0]]), ["first", "second"], about)
    >>> Path("two.csv").read_text().splitlines()[:2]
    ['frame,pc001_sd', 'first,0.5']
    """
    path = _csv_path(path)
    loadings = np.asarray(loadings_sd, np.float64)
    names = [str(name) for name in frame_names]
    if loadings.ndim != 2 or loadings.shape[0] != len(names):
        raise BadInput(
            f"cannot write {path}: the loadings have the shape {loadings.shape}; expected ({len(names)}, k), one row "
            "per frame name. Supply one name per frame"
        )
    _check_names(path, names)
    for name in filter(FORMULA.match, names):
        raise BadInput(
            f"cannot write {path}: frame {name!r} begins with {name[0]!r}, which spreadsheets compute. Rename it"
        )
    if not np.isfinite(loadings).all():
        row, column = np.argwhere(~np.isfinite(loadings))[0]
        raise BadInput(
            f"cannot write {path}: {_heading(column)} of frame {names[row]} is {loadings[row, column]}; expected a "
            "finite number. Correct it"
        )
    times = () if times_s is None else (TIME_COLUMN,)
    headings = [FRAME_COLUMN, *times, *map(_heading, range(loadings.shape[1]))]
    if times_s is not None:
        _check_times(path, names, times_s)
        loadings = np.column_stack([np.asarray(times_s, np.float64), loadings])
    rows = [[name, *map(repr, row)] for name, row in zip(names, loadings.tolist(), strict=True)]
    text = _csv_text(headings, rows)
    ours: LoadingsDocument = {
        "format": "morphspace-loadings",
        "version": 1,
        "unit": "sd",
        "frame_count": loadings.shape[0],
        "component_count": loadings.shape[1] - len(times),
        "table_sha256": digest_of_bytes(text.encode()),
    }
    given = {key: value for key, value in document.items() if key != "frame_rate_hz" or value is not None}
    write_texts({path: text, path.with_suffix(".json"): json_text({**given, **ours})})


def read_loadings_table(path: str | Path) -> LoadingsTable:
    """Read a loadings table. The values are bit-equal to those written; `document` is None if there is no JSON file.

    Raises
    ------
    UnreadableFile
        If a file cannot be read, or a stopped run may have left the two files of different runs.
    BadInput
        If an entry is wrong; the message names its row and column.

    Examples
    --------
    >>> import numpy as np
    >>> about = {"model_id": "0" * 16, "identity": "anna"}
    >>> write_loadings_table("two.csv", np.array([[0.5], [1.0]]), ["first", "second"], about)
    >>> read_loadings_table("two.csv").loadings_sd.tolist()
    [[0.5], [1.0]]
    """
    path = _csv_path(path)
    table = read_table(path)
    has_times = list(table.headings[1:2]) == [TIME_COLUMN]
    components = _check_headings(path, [table.headings[0], *table.headings[1 + has_times :]])
    names = [composed(row[0]) for row in table.rows]
    _check_names(path, names)
    values = [
        [
            finite_number(path, line, heading, cell)
            for heading, cell in zip(table.headings[1:], row[1:], strict=True)
        ]
        for line, row in zip(table.lines, table.rows, strict=True)
    ]
    numbers = np.array(values, np.float64).reshape(len(names), has_times + components)
    numbers.setflags(write=False)
    loadings, times_s = numbers[:, has_times:], numbers[:, 0] if has_times else None
    if times_s is not None:
        _check_times(path, names, times_s)
    beside = path.with_suffix(".json")
    document = LOADINGS.read(beside) if beside.exists() else None
    if document is not None and document.get("frame_rate_hz") and times_s is not None:
        _check_rate(beside, float(document["frame_rate_hz"] or 0), times_s)
    if document is not None and document.get("component_count", components) < components:
        raise BadInput(
            f"{beside} has component_count {document['component_count']}; expected the {components} of {path}. "
            "Use files that belong together"
        )
    notes = () if document is None else _change_notes(path, beside, document)
    return LoadingsTable(tuple(names), loadings, document, notes, times_s)


def _check_rate(beside: Path, rate_hz: float, times_s: AnyArray) -> None:
    """Check that a rate is that of the times (n,) s, on the whole or of the usual step if frames were lost."""
    steps_s = np.diff(times_s)
    if not len(steps_s):
        return
    of_times = [1 / float(step) for step in (steps_s.mean(), np.median(steps_s))]
    if not any(abs(rate_hz / one - 1) <= RATE_TOL for one in of_times):
        raise BadInput(
            f"{beside} has frame_rate_hz {rate_hz:g}; expected {of_times[0]:.4g}, the rate of the column "
            f"{TIME_COLUMN} of {beside.with_suffix('.csv').name}. Correct the one that is wrong, or remove it"
        )


def _change_notes(path: Path, beside: Path, document: LoadingsDocument) -> tuple[str, ...]:
    """Note that a table is not the one that its JSON file describes; refuse it if a run was stopped between the two."""
    if document.get("table_sha256") in (None, digest_of_file(path)):
        return ()
    if is_being_written(path):
        raise UnreadableFile(
            f"{path} is not the table that {beside.name} describes, and a run that writes them has not ended. Run that "
            "command again"
        )
    return (f"{path} was changed after it was written: check that {beside.name} still describes it",)


def write_metrics_table(path: str | Path, columns: Mapping[str, Sequence[Any]]) -> None:
    """Write columns of texts or numbers as CSV, as `metrics_text` forms them.

    Raises
    ------
    BadInput
        As `metrics_text`.
    UnwritableFile
        If the folder or disk refuses the file.

    Examples
    --------
    >>> write_metrics_table("figures.csv", {"name": ["a", "b"], "error_px": [0.5, None]})
    >>> Path("figures.csv").read_text().splitlines()
    ['name,error_px', 'a,0.5', 'b,']
    """
    path = Path(path)
    write_text(path, metrics_text(path, columns))


def metrics_text(path: str | Path, columns: Mapping[str, Sequence[Any]]) -> str:
    """Return columns of texts or numbers as CSV. None and NaN become empty cells.

    A text that begins as a formula is written after an apostrophe, so that no spreadsheet computes it.

    Parameters
    ----------
    path : str or Path
        The file to be written, which ends in `.csv`.
    columns : mapping of name to n values
        A name includes the unit, as in `distance_px`.

    Raises
    ------
    BadInput
        If there are no columns, or they differ in length.

    Examples
    --------
    >>> metrics_text("figures.csv", {"name": ["a", "b"], "error_px": [0.5, float("nan")]}).splitlines()
    ['name,error_px', 'a,0.5', 'b,']
    """
    path = _csv_path(path)
    lengths = {name: len(values) for name, values in columns.items()}
    if not lengths:
        raise BadInput(f"cannot write {path}: there are no columns; expected at least one. Add one")
    first, count = next(iter(lengths.items()))
    for name, length in lengths.items():
        if length != count:
            raise BadInput(
                f"cannot write {path}: column {name} has {length} rows; expected {count} as in {first}. Correct it"
            )
    cells = [[_cell(value) for value in values] for values in columns.values()]
    return _csv_text(list(columns), [list(row) for row in zip(*cells, strict=True)])


def read_metrics_table(path: str | Path) -> dict[str, list[str] | list[float]]:
    """Read a table of measures as columns by name.

    A column whose cells are all numbers or empty is a list of floats (empty is NaN), any other a list of texts. The
    columns frame, clip, identity and name are always texts. Raises `UnreadableFile` and `BadInput`.

    Examples
    --------
    >>> write_metrics_table("figures.csv", {"name": ["a", "b"], "error_px": [0.5, None]})
    >>> read_metrics_table("figures.csv")
    {'name': ['a', 'b'], 'error_px': [0.5, nan]}
    """
    path = _csv_path(path)
    table = read_table(path)
    return {heading: _column(table, place) for place, heading in enumerate(table.headings)}


def _column(table: Table, place: int) -> list[str] | list[float]:
    """Return a column as numbers if all its cells are, else as texts. Refuse numbers that a spreadsheet changed."""
    cells = [row[place] for row in table.rows]
    numbers = [_float_or_none(cell or "nan") for cell in cells]
    if table.headings[place] in TEXT_COLUMNS or not any(cells):
        return cells
    if None not in numbers:
        return [number for number in numbers if number is not None]
    others = [row for row, number in enumerate(numbers) if number is None]
    is_comma = [COMMA_NUMBER.fullmatch(cells[row].strip()) is not None for row in others]
    is_date = [DATE.fullmatch(cells[row].strip()) is not None for row in others]
    has_numbers = any(cell and number is not None for cell, number in zip(cells, numbers, strict=True))
    if all(map(any, zip(is_comma, is_date, strict=True))) and (any(is_comma) or has_numbers):
        first = others[0]
        finite_number(table.path, table.lines[first], table.headings[place], cells[first])
    return cells


def _heading(component: int) -> str:
    return f"pc{component + 1:03d}_sd"


def _csv_path(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".csv":
        raise BadInput(f"{path} is not a table by its name; expected .csv. Rename it")
    return path


def _csv_text(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(rows)
    return text.getvalue()


def _check_headings(path: Path, headings: Sequence[str]) -> int:
    """Return the number of components. Check that the columns are the frame, then pc001_sd and on without gap."""
    if headings[0] != FRAME_COLUMN:
        raise BadInput(f"{path}: the first column is {headings[0]!r}; expected {FRAME_COLUMN!r}. Rename it")
    if len(headings) == 1:
        raise BadInput(
            f"{path}: there is no component column; expected {_heading(0)} and on. Export it again"
        )
    for place, heading in enumerate(headings[1:]):
        if not COMPONENT_COLUMN.fullmatch(heading):
            raise BadInput(
                f"{path}: column {heading!r} is not a loading in SD; expected {_heading(place)!r}. Rename it"
            )
        if heading != _heading(place):
            raise BadInput(
                f"{path}: column {place + 2} is {heading}; expected {_heading(place)}. Include all components in order"
            )
    return len(headings) - 1


def _check_names(path: Path, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise BadInput(f"{path}: frame {name!r} is repeated; expected unique names. Rename it")
        seen.add(name)


def _check_times(path: Path, names: Sequence[str], times_s: Sequence[float] | AnyArray) -> None:
    """Check that there is a time for each frame, and that times rise."""
    if len(times_s) != len(names):
        raise BadInput(
            f"cannot write {path}: there are {len(times_s)} times; expected {len(names)}. Supply one per frame"
        )
    fixed = np.flatnonzero(np.diff(times_s) <= 0)
    if len(fixed):
        row = int(fixed[0]) + 1
        raise BadInput(
            f"{path}: {TIME_COLUMN} of frame {names[row]} is {times_s[row]:g}; expected more than the "
            f"{times_s[row - 1]:g} before. Order the rows by time, or remove the column if they are no recording"
        )


def finite_number(path: Path, line: int, heading: str, cell: str) -> float:
    """Read a number from a cell. Raises `BadInput`, with its line and column, if it is none or not finite.

    Examples
    --------
    >>> finite_number(Path("a.csv"), 2, "x_px", "1.5")
    1.5
    """
    value = _float_or_none(cell)
    if value is None or not np.isfinite(value):
        raise BadInput(
            f"{path} line {line}, column {heading} is {cell!r}; expected a number. {number_remedy(cell)}"
        )
    return value


def _float_or_none(cell: str) -> float | None:
    if not cell.isascii() or "_" in cell:  # Python also accepts 1_0 and digits of other scripts
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
    text = str(value)
    return f"'{text}" if FORMULA.match(text) else text
