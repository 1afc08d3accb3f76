"""Names of files: which can be used, and how they are compared (ours).

Frames are named after their files, and the names go into tables, pages and further files. A name that a file system, a
spreadsheet or a terminal would take for something else is refused where it enters.
"""

from __future__ import annotations

import os
import re
import sys
import unicodedata
from pathlib import Path

from morphspace.errors import BadInput, UnreadableFile

CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # line ends and escape characters
UNFIT = re.compile(r'[\x00-\x1f\x7f\\:*?"<>|]')  # characters that Linux, macOS or Windows forbid in names
FORMULA = re.compile(r"[=@\t\r]|[+-](?![\d.]|$)")  # a spreadsheet computes a cell that begins so
ANNEX = ".git/annex/objects"


def composed(name: str) -> str:
    """Return a name in NFC: macOS writes an accent as a character of its own.

    Examples
    --------
    >>> composed("e\\u0301") == "\\u00e9"
    True
    """
    return unicodedata.normalize("NFC", name)


def check_name(path: Path) -> None:
    """Raise `BadInput` if a path is not UTF-8, or has a line end or another control character."""
    text = str(path)
    shown = os.fsencode(text).decode("utf-8", "backslashreplace") if _is_other(text) else text
    encoding = sys.getfilesystemencoding()
    if shown != text and encoding != "utf-8":
        raise BadInput(
            f"the file name {shown} cannot be used, because the locale is {encoding}; expected UTF-8. Set LC_ALL to "
            "C.UTF-8, or PYTHONUTF8 to 1"
        )
    if shown != text:
        raise BadInput(f"the file name {shown} is not UTF-8; expected UTF-8. Rename it")
    if CONTROL.search(text):
        raise BadInput(f"the file name {text!r} has a control character; expected none. Rename it")


def check_frame_name(path: Path) -> None:
    """Raise `BadInput` if a file name cannot name a frame: as `check_name`, or if it begins as a formula."""
    check_name(path)
    if FORMULA.match(path.name):
        raise BadInput(
            f"the file name {path} begins with {path.name[0]!r}; expected a letter or digit, since spreadsheets "
            "compute such a name in a table. Rename it"
        )


def check_link(path: Path) -> None:
    """Raise `UnreadableFile` if a path is a link to nothing, as git-annex leaves for content that is elsewhere."""
    if not path.is_symlink() or path.exists():
        return
    target = path.readlink().as_posix()
    if ANNEX in target:
        raise UnreadableFile(
            f"{path} is a link of git-annex, whose content is not here. Run `git annex get` for it"
        )
    raise UnreadableFile(f"{path} is a link to {target}, which does not exist. Copy the file itself")


def _is_other(text: str) -> bool:
    return any("\ud800" <= character <= "\udfff" for character in text)
