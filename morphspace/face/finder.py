"""A detector with a name, so that what was found with one is never taken for what another would find (ours)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from morphspace.arrays import Image
from morphspace.face.detector.models import ORIGIN
from morphspace.face.mesh import SCHEME, FacePoints

DETECTION_VERSION = 1  # raise it when the detector gives other points from the same networks


@dataclass(frozen=True, eq=False)
class FaceFinder:
    """A detector and its `identity`, a JSON document that differs whenever it may find other points."""

    find: Callable[[Image], FacePoints | None]
    identity: Mapping[str, Any] = field(default_factory=dict)


def own_finder() -> FaceFinder:
    """Give the package's own detector. Raises `MissingModels` with the command that brings its networks."""
    from morphspace.face.detector import load_detector

    networks = {file.name: file.sha256 for file in ORIGIN.files}
    return FaceFinder(load_detector(), {"scheme": SCHEME, "version": DETECTION_VERSION, "networks": networks})
