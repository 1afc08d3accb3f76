"""Face points in every frame of a clip, detected once and kept in the work folder (ours).

A detector locates the face without the reference. So it separates a large head movement from a change of the face,
which dense flow cannot. `face.anchor` describes their use in a build.
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

POINTS_FORMAT = "morphspace-frame-points-2"


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
    """Detect the face in each frame, or read it from the work folder; a generator of steps.

    Parameters
    ----------
    source : FrameSource
        n frames.
    detector : Detector
    work_folder : Path
    also, look
        Frames at the places `also` are passed to `look` too, in several threads, and so are decoded once.

    Returns
    -------
    tuple of n FacePoints or None
        None in frames without a face.
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
    arrays = (
        {}
        if found is None
        else {
            "points": np.asarray(found.points, np.float64),
            "others": np.asarray(found.others, np.float64),
        }
    )
    if found is not None and found.depth is not None:
        arrays["depth"] = np.asarray(found.depth, np.float64)
    score = None if found is None else found.score
    write_result(file, arrays, {"found": found is not None, "score": score})


def _read(file: Path) -> FacePoints | None:
    arrays, document = read_result(file)
    if not document["found"]:
        return None
    depth = np.array(arrays["depth"]) if "depth" in arrays else None
    return FacePoints(
        np.array(arrays["points"]), float(document["score"]), depth=depth, others=np.array(arrays["others"])
    )
