"""morphspace: morph-space PCA models of faces, for psychophysics.

The names below are the public ones; each is imported when it is first used, so that `import morphspace` is instant.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "BadInput": "errors",
    "blend": "notebook",
    "build": "notebook",
    "caricature": "notebook",
    "continuum": "notebook",
    "deserialise": "model.morph",
    "encode": "notebook",
    "FaceFrame": "face.faceframe",
    "Faces": "stimuli.faces",
    "Framing": "io.framing",
    "load": "notebook",
    "Loadings": "model.loadings",
    "mimic": "notebook",
    "Morph": "model.morph",
    "MorphModel": "model.model",
    "MorphOffset": "model.morph",
    "MorphPCA": "linear.morph_pca",
    "MorphspaceError": "errors",
    "open_clip": "io.clips",
    "plot": "notebook",
    "read_image": "io.images",
    "serialise": "model.morph",
    "trajectory": "notebook",
    "write_image": "io.images",
}
__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'morphspace' has no attribute {name!r}")
    return getattr(importlib.import_module(f"morphspace.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
