"""morphspace: morph-space PCA models of faces, for psychophysics.

The names below are the public ones; each is imported when it is first used, so that `import morphspace` is instant.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "BadInput": "errors",
    "FaceFrame": "face.faceframe",
    "Framing": "io.framing",
    "Loadings": "model.model",
    "Morph": "model.morph",
    "MorphModel": "model.model",
    "MorphOffset": "model.morph",
    "MorphspaceError": "errors",
    "build_model": "model.from_clip",
    "deserialise": "model.morph",
    "load_model": "model.model",
    "open_clip": "io.clips",
    "read_image": "io.images",
    "serialise": "model.morph",
    "write_image": "io.images",
}
__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'morphspace' has no attribute {name!r}")
    return getattr(importlib.import_module(f"morphspace.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
