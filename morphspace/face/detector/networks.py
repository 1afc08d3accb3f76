"""A network of OpenCV's and the names of its outputs (ours)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.face.detector.models import FETCH_COMMAND, MissingModels

# OpenCV fills its table of operators at the first network, without a lock: a thread that reads another one meanwhile
# finds operators missing.
_ONE_AT_A_TIME = Lock()
CLASSIC_ENGINE = 1  # OpenCV 5's other engine returns only the last output of these networks


@dataclass(frozen=True, eq=False)
class Network:
    """One network and the names of its outputs, in the order of `answer`."""

    net: Any
    outputs: tuple[str, ...]

    def answer(self, image: Image) -> tuple[AnyArray, ...]:
        """Run the network on an image (side, side, 3); return its outputs as flat float32 arrays."""
        return self.answer_planes(np.ascontiguousarray(image.transpose(2, 0, 1)))

    def answer_planes(self, planes: AnyArray) -> tuple[AnyArray, ...]:
        """Run the network on planes (c, side, side), as `answer`."""
        self.net.setInput(planes[None])
        return tuple(np.array(output).reshape(-1) for output in self.net.forward(self.outputs))


def read_network(path: Path, outputs: tuple[str, ...]) -> Network:
    """Read a network and name its outputs. Raises `MissingModels` if OpenCV cannot read the file."""
    try:
        with _ONE_AT_A_TIME:
            return Network(cv2.dnn.readNetFromTFLite(str(path), engine=CLASSIC_ENGINE), outputs)
    except cv2.error as error:
        raise MissingModels(
            f"OpenCV {cv2.__version__} cannot read {path}; expected a TFLite network. Run `{FETCH_COMMAND}` again"
        ) from error
