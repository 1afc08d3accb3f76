"""The points of the face in every frame of a clip: found once a frame, and kept in the work folder (ours).

A detector sees where a face stands without knowing the reference, so it tells a head that moved far from one that
changed, which dense flow cannot. What a build takes from the points is in `face.anchor`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

import cv2
import numpy as np

from morphspace.arrays import Image
from morphspace.cache import is_finished, read_result, result_file, write_result
from morphspace.face.detector import Detector
from morphspace.face.mesh import FacePoints
from morphspace.io.framing import FrameSource, same_size
from morphspace.steps import Step, Steps, in_order

POINTS_FORMAT = "morphspace-frame-points-1"


def _nothing(index: int, image: Image) -> None:
    del index, image


def points_steps(
    source: FrameSource,
    detector: Detector,
    work_folder: Path,
    *,
    also: Collection[int] = (),
    look: Callable[[int, Image], None] = _nothing,
) -> Steps[tuple[FacePoints | None, ...]]:
    """Find the face in each frame, or take it from the work folder; None where there is none. A generator of steps.

    Frames at the places `also` are given to `look` too, in several threads, so that they need not be decoded again.
    """
    common = [POINTS_FORMAT, cv2.__version__, dict(detector.identity)]
    files = [result_file(work_folder, *common, digest) for digest in source.digests]
    missing = {index for index, file in enumerate(files) if not is_finished(file)}
    wanted = set(also)

    def see(item: tuple[int, Image]) -> bool:
        index, image = item
        if index in missing:
            _write(files[index], detector(image))
        if index in wanted:
            look(index, image)
        return index in missing

    finished = len(files) - len(missing)
    for is_new in in_order(see, same_size(source, sorted(missing | wanted))):
        if is_new:
            finished += 1
            yield Step("faces", finished, len(files))
    return tuple(_read(file) for file in files)


def _write(file: Path, found: FacePoints | None) -> None:
    arrays = {} if found is None else {"points": np.asarray(found.points, np.float64)}
    if found is not None and found.depth is not None:
        arrays["depth"] = np.asarray(found.depth, np.float64)
    score = None if found is None else found.score
    write_result(file, arrays, {"found": found is not None, "score": score})


def _read(file: Path) -> FacePoints | None:
    arrays, document = read_result(file)
    if not document["found"]:
        return None
    depth = np.array(arrays["depth"]) if "depth" in arrays else None
    return FacePoints(np.array(arrays["points"]), float(document["score"]), depth=depth)
