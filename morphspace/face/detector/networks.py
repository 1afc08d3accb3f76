"""The three networks in memory, one set per working thread.

OpenCV stores the layers' results inside a network, so two threads must not share one. Each thread borrows a set of
three and returns it; there are as many sets as threads that ran at the same time (ours).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.face.detector.models import FACE, FETCH_COMMAND, IRIS, MESH, MissingModels

CLASSIC_ENGINE = 1  # OpenCV 5's other engine returns only the last output of these networks


@dataclass(frozen=True, eq=False)
class Network:
    """One network and the names of its outputs, in the order of `answer`."""

    net: Any
    outputs: tuple[str, ...]

    def answer(self, image: Image) -> tuple[AnyArray, ...]:
        """Run the network on an image (side, side, 3); return its outputs as flat float32 arrays."""
        self.net.setInput(np.ascontiguousarray(image.transpose(2, 0, 1))[None])
        return tuple(np.array(output).reshape(-1) for output in self.net.forward(self.outputs))


@dataclass(frozen=True, eq=False)
class NetworkSet:
    """The networks that find a face, its points, and the points of an eye."""

    face: Network
    mesh: Network
    iris: Network


@dataclass(frozen=True, eq=False)
class NetworkPool:
    """Sets of networks read from `folder`, one for each working thread."""

    folder: Path
    _idle: deque[NetworkSet] = field(default_factory=deque)

    @contextmanager
    def borrowed(self) -> Iterator[NetworkSet]:
        """Lend a set for a block; read a new one if all are in use."""
        try:
            networks = self._idle.pop()
        except IndexError:
            networks = self._read()
        try:
            yield networks
        finally:
            self._idle.append(networks)

    def _read(self) -> NetworkSet:
        return NetworkSet(
            _network(self.folder / FACE.name, ("classificators", "regressors")),
            _network(self.folder / MESH.name, ("conv2d_30", "conv2d_20")),
            _network(self.folder / IRIS.name, ("output_eyes_contours_and_brows", "output_iris")),
        )


def _network(path: Path, outputs: tuple[str, ...]) -> Network:
    try:
        return Network(cv2.dnn.readNetFromTFLite(str(path), engine=CLASSIC_ENGINE), outputs)
    except cv2.error as error:
        raise MissingModels(
            f"OpenCV {cv2.__version__} cannot read {path}; expected a TFLite network. Run `{FETCH_COMMAND}` again"
        ) from error
