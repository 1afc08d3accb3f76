"""morphspace: morph-space PCA models of faces, for psychophysics.

The names below are the public ones; each is imported when it is first used, so that `import morphspace` is instant.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "BadInput": "errors",
    "FaceFrame": "faces",
    "Framing": "faces",
    "Loadings": "model",
    "Morph": "morph",
    "MorphModel": "model",
    "MorphOffset": "morph",
    "MorphspaceError": "errors",
    "build_model": "verbs.build_model",
    "deserialise": "morph",
    "load_model": "model",
    "open_clip": "files.clips",
    "read_image": "files.images",
    "serialise": "morph",
    "write_image": "files.images",
}
__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'morphspace' has no attribute {name!r}")
    return getattr(importlib.import_module(f"morphspace.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
