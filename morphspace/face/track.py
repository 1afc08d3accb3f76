"""The face of a clip over time: its points in every frame, given or detected, and the turn of the head (ours).

Points locate the face without the reference. So they separate a large head movement from a change of the face, which
dense flow cannot; `face.anchor` describes their use in a build. They are detected once and kept in the work folder.

Points are not smoothed over time. Their noise is .2 to .5 % of the eye distance, and every smoother that was tried took
more from the motion of the lips than from the noise, and made blinks shallower (benchmarks/results/defaults.md).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Image
from morphspace.cache import is_finished, read_result, result_file, write_result
from morphspace.face.detector import Detector
from morphspace.face.mesh import GIVEN_SCORE, MAX_TURN_DEG, POINT_COUNT, SCHEME, FacePoints
from morphspace.grid import warp
from morphspace.io.clips import Clip
from morphspace.io.framing import FramedClip, FrameSource, same_size
from morphspace.io.points_table import FramePoints, read_points
from morphspace.steps import Step, Steps, in_order

POINTS_FORMAT = "morphspace-frame-points-3"
# Degrees from the clip's median pose at which the weight of a frame begins to fall, and at which it is least. On eight
# `tune` people a similarity leaves 2 % of the eye distance at the nose and the corners of the eyes below 2.5 degrees,
# 5 % at 10, as much as expressions leave at most, and 10 % at 22.
LITTLE_TURN_DEG, FAR_TURN_DEG = 10.0, 25.0
LEAST_WEIGHT = 0.01  # such a frame hardly counts, and its loadings are still those of its face


@dataclass(frozen=True, eq=False)
class FaceTrack:
    """The face in each frame of a clip.

    Attributes
    ----------
    names : tuple of n str
    faces : tuple of n FacePoints or None
        None in frames without a face.
    given : array (n,) bool
        Frames whose points came from a file rather than the detector.
    """

    names: tuple[str, ...]
    faces: tuple[FacePoints | None, ...]
    given: AnyArray

    @property
    def known(self) -> AnyArray:
        """Frames with a face, (n,) bool."""
        return np.array([face is not None for face in self.faces], bool)

    @cached_property
    def pose_deg(self) -> AnyArray:
        """Yaw, pitch and roll of the head, (n, 3) degrees; NaN without a face, yaw and pitch also without depth."""
        poses = np.full((len(self.faces), 3), np.nan)
        for place, face in enumerate(self.faces):
            if face is not None:
                poses[place, 2] = face.roll_degrees
                if face.depth is not None:
                    poses[place, :2] = face.turn_degrees
        return poses

    @property
    def weights(self) -> AnyArray:
        """The weight (n,) of each frame in means and components: how much its view is that of the others.

        A similarity cannot undo a turn of the head out of the picture. The weight is 1 up to `LITTLE_TURN_DEG` from the
        median yaw and pitch, and falls to `LEAST_WEIGHT` at `FAR_TURN_DEG`. It is 1 where the turn is unknown.
        """
        turn = self.pose_deg[:, :2]
        if np.isnan(turn).all():
            return np.ones(len(turn))
        off_deg = np.hypot(*(turn - np.nanmedian(turn, axis=0)).T)
        fallen = np.clip((off_deg - LITTLE_TURN_DEG) / (FAR_TURN_DEG - LITTLE_TURN_DEG), 0, 1)
        return np.maximum(1 - np.nan_to_num(fallen), LEAST_WEIGHT)

    def turned(self, limit_deg: float = MAX_TURN_DEG) -> AnyArray:
        """Return the frames whose yaw or pitch exceeds `limit_deg`, the most turned first, as indices (m,)."""
        turn_deg = np.nan_to_num(np.abs(self.pose_deg[:, :2])).max(axis=1, initial=0)
        order = np.argsort(-turn_deg, kind="stable")
        return order[turn_deg[order] > limit_deg]

    @property
    def words(self) -> str:
        """Describe in how many frames the face was given and found."""
        given, count = int(self.given.sum()), len(self.faces)
        found, rest = int((self.known & ~self.given).sum()), count - given
        if not given:
            return f"found in {found} of {count} frames"
        return f"given in {given} of {count} frames" + (
            f", found in {found} of the other {rest}" if rest else ""
        )

    def table(self) -> dict[str, FramePoints | None]:
        """Return the points of each frame by its name, as `write_points_table` takes them."""
        return {
            name: None
            if face is None
            else FramePoints(face.points, face.depth, face.confidence, tuple(map(float, pose)))  # type: ignore[arg-type]
            for name, face, pose in zip(self.names, self.faces, self.pose_deg, strict=True)
        }

    def document(self) -> dict[str, Any]:
        """Describe the track as JSON: how many frames show a face, how many were given, and the range of the pose."""
        found: dict[str, Any] = {
            "frames": len(self.faces),
            "frames_with_face": int(self.known.sum()),
            "frames_given": int(self.given.sum()),
            "frames_turned": len(self.turned()),
        }
        for name, values in zip(("yaw_deg", "pitch_deg", "roll_deg"), self.pose_deg.T, strict=True):
            if not np.isnan(values).all():
                found[name] = [round(float(np.nanmin(values)), 1), round(float(np.nanmax(values)), 1)]
        return found


def framed_points(path: Path | None, source: FramedClip) -> GivenPoints | None:
    """Read face points as `given_points` does, px of a framed clip; None for no path. Raises as `given_points`."""
    return None if path is None else given_points(path, source.clip).framed(source.to_source)


def turn_words(track: Mapping[str, Any] | None) -> str:
    """Describe the turn of the head from the JSON of a track; empty if it is unknown.

    Examples
    --------
    >>> known = {"frames": 9, "frames_turned": 2, "yaw_deg": [-25, 3], "pitch_deg": [-2, 9], "roll_deg": [-0.3, 4]}
    >>> turn_words(known)
    'yaw -25 to 3, pitch -2 to 9, roll 0 to 4 degrees; 2 of 9 frames are turned by more than 20'
    """
    if not track or "yaw_deg" not in track:
        return ""
    ranges = [(name, *track[f"{name}_deg"]) for name in ("yaw", "pitch", "roll")]
    words = ", ".join(f"{name} {round(low)} to {round(high)}" for name, low, high in ranges)
    far = f"{track['frames_turned']} of {track['frames']} frames are turned by more than {MAX_TURN_DEG:.0f}"
    return f"{words} degrees; {far}"


@dataclass(frozen=True, eq=False)
class GivenPoints:
    """Face points of some frames from a file: `faces` by the names of frames, and the `origin` for the provenance."""

    faces: Mapping[str, FacePoints]
    origin: Mapping[str, Any]

    def framed(self, to_source: Affine) -> GivenPoints:
        """Return the points in frames, from which `to_source` (2, 3), a scaling and a shift, leads to the pictures."""
        to_frame = warp.inverse_affine(to_source)
        scale = float(np.sqrt(np.linalg.det(to_frame[:, :2])))
        faces = {
            name: replace(
                face,
                points=warp.apply_affine(to_frame, face.points),
                depth=None if face.depth is None else scale * face.depth,
            )
            for name, face in self.faces.items()
        }
        return GivenPoints(faces, self.origin)


def given_points(path: Path, clip: Clip) -> GivenPoints:
    """Read face points of some frames of a clip, px of its pictures, from a table or a folder of templates.

    Raises
    ------
    BadInput, UnreadableFile
        As `io.points_table.read_points`.
    """
    frames, digest = read_points(path, clip, SCHEME, POINT_COUNT)
    faces = {
        name: FacePoints(frame.points, GIVEN_SCORE, depth=frame.depth, confidence=frame.confidence)
        for name, frame in frames.items()
    }
    return GivenPoints(faces, {"file": path.name, "sha256": digest})


def _nothing(index: int, image: Image) -> None:
    del index, image


def track_steps(
    source: FrameSource,
    detector: Detector | None,
    work_folder: Path,
    *,
    given: Mapping[str, FacePoints] | None = None,
    also: Collection[int] = (),
    look: Callable[[int, Image], None] = _nothing,
) -> Steps[FaceTrack]:
    """Find the face in each frame, or read it from the work folder; a generator of steps.

    Parameters
    ----------
    source : FrameSource
        n frames.
    detector : Detector or None
        None searches no face.
    work_folder : Path
    given : mapping of names to FacePoints, optional
        Frames whose points are known; they are used as they are.
    also, look
        Frames at the places `also` are passed to `look` too, in several threads, and so are decoded once.

    Returns
    -------
    FaceTrack
    """
    given = given or {}
    identity = None if detector is None else dict(detector.identity)
    common = [POINTS_FORMAT, cv2.__version__, identity]
    is_given = np.array([name in given for name in source.names], bool)
    searched = [] if detector is None else np.flatnonzero(~is_given).tolist()
    files = {place: result_file(work_folder, *common, source.digests[place]) for place in searched}
    missing = {place for place, file in files.items() if not is_finished(file)}
    wanted = set(also)

    def see(item: tuple[int, Image]) -> bool:
        index, image = item
        if detector is not None and index in missing:
            _write(files[index], detector(image))
        if index in wanted:
            look(index, image)
        return index in missing

    finished = len(files) - len(missing)
    for is_new in in_order(see, same_size(source, sorted(missing | wanted))):
        if is_new:
            finished += 1
            yield Step("faces", finished, len(files))
    faces = [
        given.get(name) or (_read(files[place]) if place in files else None)
        for place, name in enumerate(source.names)
    ]
    return FaceTrack(source.names, tuple(faces), is_given)


def _write(file: Path, found: FacePoints | None) -> None:
    arrays: dict[str, AnyArray] = {}
    if found is not None:
        arrays = {"points": found.points, "others": found.others}
        arrays |= {} if found.depth is None else {"depth": found.depth}
        arrays |= {} if found.confidence is None else {"confidence": found.confidence}
    score = None if found is None else found.score
    kept = {name: np.asarray(array, np.float64) for name, array in arrays.items()}
    write_result(file, kept, {"found": found is not None, "score": score})


def _read(file: Path) -> FacePoints | None:
    arrays, document = read_result(file)
    if not document["found"]:
        return None
    depth, confidence = (
        np.array(arrays[name]) if name in arrays else None for name in ("depth", "confidence")
    )
    return FacePoints(
        np.array(arrays["points"]),
        float(document["score"]),
        depth=depth,
        confidence=confidence,
        others=np.array(arrays["others"]),
    )
