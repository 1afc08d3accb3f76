"""The errors of morphspace, as types.

Every message is one line with the object, the two values that disagree, and what to do. `BadInput` and its children
are faults of the input (the command line exits with 2); a plain `MorphspaceError` is a fault of morphspace (1).
"""

from __future__ import annotations

import importlib
from typing import Any

INTERRUPTED = 130  # exit code; 128 and the number of SIGINT, as shells report it


class MorphspaceError(Exception):
    """A failure that morphspace describes itself; the root of all its errors."""


class BadInput(MorphspaceError):
    """An input cannot be used."""


class UnreadableFile(BadInput):
    """A file is missing, empty, cut short or not of the kind that its name says."""


class UnwritableFile(BadInput):
    """An output cannot be written: no permission, no space, or another file has its name."""


class SizeMismatch(BadInput):
    """Images that must have one size do not."""


class ReferenceMismatch(BadInput):
    """Two objects are registered to different reference or mean faces, so their numbers cannot be compared."""


class ModelFileError(BadInput):
    """A `.morph` file is cut short, of a later version, or not a model."""


def optional(module: str) -> Any:
    """Import a module of a package that only a notebook needs. Raises `BadInput` if it is not installed."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise BadInput(
            f"{module.partition('.')[0]} is not installed; expected it for this function. "
            "Run pip install 'morphspace[notebook]'"
        ) from error
