"""The three networks in memory, lent to one thread at a time.

OpenCV keeps the layers' results inside a network, so two threads must not use one. Each borrows a set of three and
gives it back; there are as many sets as threads ever asked at the same time (ours).
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

CLASSIC_ENGINE = 1  # OpenCV 5's other one loses all outputs of these networks but the last


@dataclass(frozen=True, eq=False)
class Network:
    """One network and the names of its outputs, in the order in which `answer` gives them."""

    net: Any
    outputs: tuple[str, ...]

    def answer(self, image: Image) -> tuple[AnyArray, ...]:
        """Run the network on (side, side, 3) and give its outputs, flat float32."""
        self.net.setInput(np.ascontiguousarray(image.transpose(2, 0, 1))[None])
        return tuple(np.array(output).reshape(-1) for output in self.net.forward(self.outputs))


@dataclass(frozen=True, eq=False)
class NetworkSet:
    """The networks that find a face, its points, and an eye's points."""

    face: Network
    mesh: Network
    iris: Network


@dataclass(frozen=True, eq=False)
class NetworkPool:
    """Sets of networks read from `folder`: one for each thread that is at work."""

    folder: Path
    _idle: deque[NetworkSet] = field(default_factory=deque)

    @contextmanager
    def borrowed(self) -> Iterator[NetworkSet]:
        """Lend a set for a block; read another where all are lent."""
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
            f"OpenCV {cv2.__version__} cannot read {path}: run `{FETCH_COMMAND}` again"
        ) from error
