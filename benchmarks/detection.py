"""How far the points of our face detector lie from MediaPipe's own, how steady they are, and what a frame takes.

MediaPipe runs in the interpreter of the landmark judge (benchmarks/judges/mesh.py); no build uses it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from judges import mesh, reading
from tables import at_most, print_table, tell

from morphspace.arrays import Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, load_detector
from morphspace.face.mesh import PHILTRUM, FacePoints
from morphspace.io.images import read_image

CLIPS = ("lp_d18", "lp_d13", "lp_d6", "lp_d0", "obama_a", "grid_pwij3p")
FRAMES = 5  # of each clip, evenly spread
MOST_EYES, MOST_PHILTRUM = 1.6, 3.8  # % of the distance between the eyes, what a prototype reached
# Whole pixels: nothing is interpolated, the truth is exact
SHIFTS_PX = ((0, 0), (3, 1), (1, 4), (5, 2), (2, 6))


def detection(data: Path, work: Path, judge: str) -> None:
    """Print, for each clip, the differences to MediaPipe, the scatter under shifts, the mirror bias and the time."""
    print(
        f"Difference to {mesh.DETECTOR} ({FRAMES} frames a clip, its points averaged over 9 views), in % of "
        "the distance between the eyes: mean and largest over the frames. Scatter: of the eye centres and the "
        "philtrum when the frame is shifted by whole pixels. Mirror: mean sideways shift of the eye centres against "
        "those of the mirrored frame, halved: what a detector sees too far right. Time: one frame, median.\n"
    )
    rows = []
    detect = load_detector()
    for name in CLIPS:
        paths = _spread(data / "sequences" / name / "frames")
        images = [np.asarray(read_image(path)) for path in paths]
        tell(f"{name}: reading MediaPipe's points")
        theirs = _judged(judge, paths, work / "detection" / f"{name}.csv")
        seconds: list[float] = []
        ours = [_found(detect, image, path, seconds) for image, path in zip(images, paths, strict=True)]
        eyes = np.array([_eye_distance(face, points) for face, points in zip(ours, theirs, strict=True)])
        lips = np.array([_philtrum_distance(face, points) for face, points in zip(ours, theirs, strict=True)])
        scatter = np.mean([_scatter(detect, image) for image in images], axis=0)
        bias = np.mean([_mirror_bias(detect, image) for image in images])
        rows.append(
            [
                name,
                f"{eyes.mean():.2f}",
                f"{eyes.max():.2f}",
                f"{lips.mean():.2f}",
                f"{lips.max():.2f}",
                at_most(float(eyes.mean()), MOST_EYES),
                at_most(float(lips.mean()), MOST_PHILTRUM),
                f"{scatter[0]:.2f}",
                f"{scatter[1]:.2f}",
                f"{bias:+.2f}",
                f"{1e3 * np.median(seconds):.0f}",
            ]
        )
    heads = ["clip", "eyes mean", "eyes max", "philtrum mean", "philtrum max"]
    heads += [f"eyes <= {MOST_EYES}", f"philtrum <= {MOST_PHILTRUM}"]
    print_table([*heads, "scatter eyes", "scatter philtrum", "mirror", "ms"], rows)


def _spread(folder: Path) -> list[Path]:
    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in mesh.IMAGE_SUFFIXES)
    if len(paths) < FRAMES:
        raise BadInput(
            f"{folder} holds {len(paths)} frames, {FRAMES} are needed: give --data the shared clips"
        )
    return [paths[round(place)] for place in np.linspace(0, len(paths) - 1, FRAMES)]


def _judged(judge: str, paths: Sequence[Path], table: Path) -> list[Points]:
    """Return MediaPipe's points (478, 2) px in each file."""
    found = reading.read_mesh(judge, paths, table)
    if lost := [path for path in paths if np.isnan(found[path.stem]).any()]:
        raise BadInput(f"MediaPipe finds no face in {lost[0]}: choose other frames")
    return [found[path.stem] for path in paths]


def _found(
    detect: Detector, image: Image, path: Path | str, seconds: list[float] | None = None
) -> FacePoints:
    start = time.perf_counter()
    face = detect(image)
    if seconds is not None:
        seconds.append(time.perf_counter() - start)
    if face is None:
        raise BadInput(f"no face is found in {path}: choose other frames")
    return face


def _eye_distance(face: FacePoints, theirs: Points) -> float:
    other = face.moved(theirs)
    apart = np.hypot(*(face.faceframe().points - other.faceframe().points)[:2].T)
    return 100 * float(apart.mean()) / other.interocular_px


def _philtrum_distance(face: FacePoints, theirs: Points) -> float:
    apart = float(np.hypot(*(face.points - theirs)[PHILTRUM]))
    return 100 * apart / face.moved(theirs).interocular_px


def _scatter(detect: Detector, image: Image) -> tuple[float, float]:
    """Give the rms distance from their mean of the eye centres and of the philtrum, % of the eye distance."""
    frames = []
    for right, down in SHIFTS_PX:
        padded = np.pad(image, ((down, 8 - down), (right, 8 - right), (0, 0)), mode="edge")
        face = _found(detect, padded, "a shifted frame")
        frames.append(face.faceframe().points - (right, down))
    variance = np.var(frames, axis=0, ddof=1).sum(axis=1)
    apart = 100 / float(np.hypot(*(frames[0][1] - frames[0][0])))
    return apart * float(np.sqrt(variance[:2].mean())), apart * float(np.sqrt(variance[2]))


def _mirror_bias(detect: Detector, image: Image) -> float:
    face = _found(detect, image, "a frame")
    other = _found(detect, np.ascontiguousarray(image[:, ::-1]), "a mirrored frame")
    here = face.faceframe().points[:2, 0].mean()
    there = image.shape[1] - 1 - other.faceframe().points[:2, 0].mean()
    return 100 * float(here - there) / 2 / face.interocular_px
