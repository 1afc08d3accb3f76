"""Plain texts, and CSV tables as people and spreadsheets save them: the one reader of every table (ours).

A byte order mark, any line ends, empty rows and empty columns are passed over. Whatever would change a number is
refused: semicolons or tabs between the columns, decimal commas, and dates that a spreadsheet made of numbers.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.limits import TABLE_BYTES, Limit, check_limit

SEPARATOR_LINE = re.compile(r"sep=.?", re.IGNORECASE)  # a spreadsheet's own first line
COMMA_NUMBER = re.compile(r"[-+]?[0-9]*,[0-9]+([eE][-+]?[0-9]+)?")
MONTH = r"[^\W\d_]{3,9}\.?"
DATE = re.compile(
    rf"\d{{1,4}}[-/. ]+({MONTH}|\d{{1,2}}[-/. ])([-/. ]*\d{{1,4}})?\.?([ T]\d\d?:\d\d.*)?|{MONTH}[-/. ]\d{{1,4}}"
)
LINE_END = re.compile(r"\r\n|\r|\n")
# At the start of a file, which tell it from all others
MARKS_OF_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
EXPORT = "Export it again as CSV UTF-8 with commas between the columns and decimal points"


@dataclass(frozen=True, eq=False)
class Table:
    """A CSV table as texts.

    Attributes
    ----------
    path : Path
    headings : tuple of k str
        Unique and not empty.
    rows : tuple of n tuples of k str
    lines : tuple of n int
        The line of the file at which each row begins, from 1.
    """

    path: Path
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]


def read_text(path: Path, limit: Limit, *, otherwise: str | None = None) -> str:
    """Read a text in UTF-8, or in UTF-16 with a byte order mark; the mark is left out.

    Parameters
    ----------
    path : Path
    limit : Limit
    otherwise : str, optional
        The encoding of a file that is neither; None to refuse it.

    Raises
    ------
    UnreadableFile
        If the file is missing or not a text; the message names the first byte that is none, and its line.
    BadInput
        If it is larger than the limit.
    """
    try:
        check_limit(str(path), path.stat().st_size, limit, "Split it")
        content = path.read_bytes()
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    encoding, name = ("utf-16", "UTF-16") if content.startswith(MARKS_OF_UTF_16) else ("utf-8-sig", "UTF-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        if otherwise is None or name == "UTF-16":
            line = len(LINE_END.findall(content[: error.start].decode(encoding, "ignore"))) + 1
            raise UnreadableFile(
                f"{path} line {line} has the byte {content[error.start]:#04x}, which is not {name} ({error.reason}). "
                "Save it as UTF-8"
            ) from error
        text = content.decode(otherwise)
    if "\0" in text:
        line = len(LINE_END.findall(text.partition("\0")[0])) + 1
        raise UnreadableFile(
            f"{path} line {line} has a zero byte, which no text in {name} has. Save it as UTF-8"
        )
    return text


def read_table(path: Path, limit: Limit = TABLE_BYTES) -> Table:
    """Read a CSV table whose first row names the columns.

    Rows and columns without any entry are left out, also those that a spreadsheet adds at the end. Headings are
    stripped of blanks; cells are kept as they are.

    Raises
    ------
    UnreadableFile
        If the file is missing, empty or not CSV.
    BadInput
        If the columns are separated by something else, rows differ in length, or a heading is missing or repeated.

    Examples
    --------
    >>> _ = Path("table.csv").write_text("frame,gain\\none,0.5\\n")
    >>> table = read_table(Path("table.csv"))
    >>> table.headings, table.rows
    (('frame', 'gain'), (('one', '0.5'),))
    """
    text = read_text(path, limit)
    _check_separators(path, text)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    found: list[tuple[int, list[str]]] = []
    start = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                found.append((start, cells))
            start = reader.line_num + 1
    except csv.Error as error:
        raise UnreadableFile(f"{path} line {reader.line_num} is not CSV: {error}. Export it again") from error
    if not found:
        raise UnreadableFile(f"{path} is empty; expected a first row of column names. Export it again")
    (first, named), *rest = found
    headings = [cell.strip() for cell in named]
    rows = [_row_of(path, line, cells, headings) for line, cells in rest]
    kept = [place for place, name in enumerate(headings) if name or any(row[place].strip() for row in rows)]
    _check_headings(path, first, headings, kept)
    return Table(
        path,
        tuple(headings[place] for place in kept),
        tuple(tuple(row[place] for place in kept) for row in rows),
        tuple(line for line, _ in rest),
    )


def _check_separators(path: Path, text: str) -> None:
    """Raise `BadInput` if the first line is `sep=,`, or has semicolons or tabs between the columns."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    check_not_separator_line(path, first)
    unquoted = re.sub(r'"[^"]*"', "", first)
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if unquoted.count(mark) > unquoted.count(","):
            raise BadInput(f"{path} line 1 has {name} between the columns; expected commas. {EXPORT}")


def check_not_separator_line(path: Path, first: str) -> None:
    """Raise `BadInput` if the first line of a table is a spreadsheet's `sep=,`."""
    if SEPARATOR_LINE.fullmatch(first.strip().strip('"')):
        raise BadInput(
            f"{path} line 1 is {first.strip()!r}, which only some spreadsheets understand; expected the table. "
            "Delete this line"
        )


def _row_of(path: Path, line: int, cells: Sequence[str], headings: Sequence[str]) -> list[str]:
    """Return one cell per heading. Empty cells beyond the last heading with a name may be more or fewer."""
    needed = max((place + 1 for place, name in enumerate(headings) if name), default=0)
    if len(cells) < needed or any(cell.strip() for cell in cells[len(headings) :]):
        raise BadInput(
            f"{path} line {line} has {len(cells)} cells; expected {len(headings)} columns as in the first row. Put a "
            "cell with a comma in double quotes"
        )
    return [*cells, *[""] * len(headings)][: len(headings)]


def _check_headings(path: Path, line: int, headings: Sequence[str], kept: Sequence[int]) -> None:
    seen: set[str] = set()
    for place in kept:
        name = headings[place]
        if not name:
            raise BadInput(
                f"{path} line {line}: column {place + 1} has no name; expected one. Name or remove the column"
            )
        if name in seen:
            raise BadInput(
                f"{path} line {line}: column {name!r} is repeated; expected unique names. Rename it"
            )
        seen.add(name)


def number_remedy(cell: str) -> str:
    """Say what to do about a cell that is not a number.

    Examples
    --------
    >>> number_remedy("0,5")
    'Write a decimal point'
    >>> number_remedy("01. May")
    'A spreadsheet made a date of it: format the column as text, and enter the number again'
    """
    if COMMA_NUMBER.fullmatch(cell.strip()):
        return "Write a decimal point"
    if DATE.fullmatch(cell.strip()):
        return "A spreadsheet made a date of it: format the column as text, and enter the number again"
    return "Correct it"
