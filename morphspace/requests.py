"""How records tell a request: every field, and paths without where on somebody's disk they lie."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def request_document(request: Any) -> dict[str, Any]:
    """Give a frozen request as JSON: every field but `output`, paths as they were given (`told_path`)."""
    return {
        entry.name: _told(getattr(request, entry.name))
        for entry in dataclasses.fields(request)
        if entry.name != "output"
    }


def _told(value: Any) -> Any:
    if isinstance(value, Path):
        return told_path(value)
    if isinstance(value, str) and Path(value).is_absolute():
        return told_path(Path(value))
    if isinstance(value, tuple | list):
        return [_told(one) for one in value]
    if isinstance(value, Mapping):
        return {str(key): _told(one) for key, one in value.items()}
    return value


def told_path(path: Path) -> str:
    """Give a path as records tell it: as it was given, or where that was absolute from the working folder, or its name.

    Where a person keeps files is nobody's business who gets a stimulus.
    """
    if not path.is_absolute():
        return path.as_posix()
    folder = Path.cwd()
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else path.name
