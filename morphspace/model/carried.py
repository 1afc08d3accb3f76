"""How much of an expression the warp carries, estimated at face points that were left out of the hold (ours).

The held flow follows the face points that hold it by construction. So the field of some frames is estimated again with
two thirds of the points, and the last third judges it. *Left over* is the motion of these points that the field misses,
as a share of their motion: 0 if the field follows them. *Slope* is the regression of the motion by the field on the
motion in the frames: 1 if the warp alone makes the expression. The openings of mouth and eyes have slopes of their own.

The same detector reads the points that hold and the points that judge. An error that it makes in both is not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Displacement
from morphspace.cache import is_finished, read_result, result_file, write_result
from morphspace.face.anchor import HELD
from morphspace.face.mesh import (
    APERTURES,
    FEATURES,
    GROUPS,
    INNER_LIPS,
    LEFT_BROW,
    LEFT_LIDS,
    OUTER_LIPS,
    POINT_COUNT,
    RIGHT_BROW,
    RIGHT_LIDS,
)
from morphspace.flow import methods
from morphspace.grid import warp
from morphspace.model.work_frames import FramePlan, read_points, read_work_frame
from morphspace.steps import Step, Steps, in_order

CARRIED_FORMAT = "morphspace-carried-2"
HARDLY_MOVES = 0.02  # eye distances; of less motion, much is the detector's noise
THIRDS = 3  # every third point of a feature is left out; all are, in turn
FRAMES = 9  # frames that are estimated again, three for each third: 4 % of the time of a build of 72 frames
# The rings of the `FEATURES`.
_RINGS = ((OUTER_LIPS,), (INNER_LIPS,), (RIGHT_BROW, LEFT_BROW), (RIGHT_LIDS, LEFT_LIDS))
# Half rings of points without corners, whose difference opens mouth and eyes.
_RIMS = {
    "mouth opening": ((INNER_LIPS[1:10], INNER_LIPS[11:]),),
    "eye opening": tuple((ring[1:8], ring[9:]) for ring in (RIGHT_LIDS, LEFT_LIDS)),
}
# Eye distances. Below it the motion of a feature is taken for the detector's noise when frames are chosen.
LEAST_MOTION = 0.01


@dataclass(frozen=True, eq=False)
class Carried:
    """The figures of each of the `FEATURES` (4,) and `APERTURES` (2,), estimated from so many frames.

    Attributes
    ----------
    left_over, slopes : array (4,)
    motion : array (4,), eye distances
        The motion of each feature, rms; a left over of 1 of hardly any motion is the detector's noise.
    frames : int
    openings : array (2,)
        Slopes of the `APERTURES`.
    """

    left_over: AnyArray
    slopes: AnyArray
    motion: AnyArray
    frames: int
    openings: AnyArray

    def document(self) -> dict[str, Any]:
        """Return the figures as JSON, rounded to three digits."""
        figures = {"left_over": self.left_over, "slope": self.slopes, "motion": self.motion}
        return {
            "frames": self.frames,
            **{
                name: dict(zip(FEATURES, values.round(3).tolist(), strict=True))
                for name, values in figures.items()
            },
            "opening_slope": dict(zip(APERTURES, self.openings.round(3).tolist(), strict=True)),
        }


def held_words(provenance: Mapping[str, Any]) -> str:
    """Say by the provenance of a model whether its flow is held to face points, and in how many frames.

    Examples
    --------
    >>> held_words({"landmarks": {"held": True, "frames": 24, "frames_with_face": 20}})
    'the flow is held to the face in 20 of 24 frames'
    """
    searched = provenance.get("landmarks") or {}
    if not searched.get("held"):
        return "the flow is not held to a face"
    return f"the flow is held to the face in {searched['frames_with_face']} of {searched['frames']} frames"


def quality_lines(provenance: Mapping[str, Any]) -> tuple[str, ...]:
    """Describe by its provenance how well a model reconstructs frames left out, and how much its warp carries.

    Examples
    --------
    >>> quality_lines({"warp_weight_trials": [[0.02, 38.1], [0.05, 38.24]]})
    ('frames left out of the components are reconstructed at 38.2 dB (mean)',)
    """
    trials = provenance.get("warp_weight_trials")
    best_db = max((psnr for _, psnr in trials), default=None) if trials else None
    lines = (
        ()
        if best_db is None
        else (f"frames left out of the components are reconstructed at {best_db:.1f} dB (mean)",)
    )
    entry = (provenance.get("landmarks") or {}).get("carried")
    if entry is None:
        return lines
    still = {name: " (hardly moves)" for name in FEATURES if entry["motion"][name] < HARDLY_MOVES}
    left, slopes, openings = (
        ", ".join(f"{name} {entry[kind][name]:.2f}{still.get(name, '')}" for name in names)
        for kind, names in (("left_over", FEATURES), ("slope", FEATURES), ("opening_slope", APERTURES))
    )
    return (
        *lines,
        f"left over of the features' motion by the warp: {left} (0 is best)",
        f"slope of their motion by the warp alone: {slopes}, {openings} (1 is best); at points left out of the "
        f"hold, {entry['frames']} frames",
    )


def left_out(third: int) -> tuple[int, ...]:
    """Return the points of the mesh that one of `THIRDS` leaves out: every third of each feature.

    Neighbours on a rim are not left out together. Lips are counted from different starts, so that no point and its
    neighbour on the other rim of the lip are.

    Examples
    --------
    >>> len(left_out(0)), len({*left_out(0), *left_out(1), *left_out(2)})
    (29, 92)
    """
    return tuple(
        place
        for shift, rings in enumerate(_RINGS)
        for ring in rings
        for number, place in enumerate(ring)
        # The first of 3 n + 1 points lies between the last, of its own third, and the second.
        if (number + shift - (number == 0 and len(ring) % THIRDS == 1)) % THIRDS == third
    )


def carried_steps(plan: FramePlan, files: Sequence[Path]) -> Steps[Carried | None]:
    """Estimate the figures of a build with held flow; a generator of steps.

    Parameters
    ----------
    plan : FramePlan
        Of the build.
    files : sequence of n Path
        The frames in the work folder, which keeps what is estimated here too.

    Returns
    -------
    Carried or None
        None without held flow, or with a face in fewer than `FRAMES` frames besides the reference.
    """
    anchor = plan.anchor
    if anchor is None:
        return None
    found = {
        index: points
        for index, points in enumerate(map(read_points, files))
        if points is not None and points.shape == (POINT_COUNT, 2) and index != plan.reference_index
    }
    chosen = _most_different(found, anchor.face.points, LEAST_MOTION * anchor.face.interocular_px)
    if len(chosen) < FRAMES:
        return None
    find = methods.for_morphs(plan.flow)(plan.reference)
    height, width = plan.mask.shape
    through = [
        anchor.held(find, height, width, frozenset(HELD).difference(left_out(third)))
        for third in range(THIRDS)
    ]

    def field(item: tuple[int, int]) -> Displacement:
        number, index = item
        kept = result_file(files[index].parent, CARRIED_FORMAT, files[index].stem, number % THIRDS)
        if not is_finished(kept):
            flow = through[number % THIRDS](read_work_frame(files[index]).frame)
            write_result(kept, {"flow": flow.displacement}, {})
        return np.array(read_result(kept)[0]["flow"])

    true = np.full((FRAMES, POINT_COUNT, 2), np.nan)
    made = true.copy()
    for number, displacement in enumerate(in_order(field, enumerate(chosen))):
        places = list(left_out(number % THIRDS))
        true[number, places] = found[chosen[number]][places]
        made[number, places] = warp.move_points(displacement, anchor.face.points[places])
        yield Step("carried", number + 1, FRAMES)
    return figures(true, made, anchor.face.interocular_px)


def figures(true: AnyArray, made: AnyArray, eyes_px: float) -> Carried:
    """Compute the figures from points in n frames, (n, 478, 2) px: read there, and carried there by the fields.

    Points that do not judge a frame are nan in it. The eyes are `eyes_px` apart. Motions are those of each point about
    its mean over the frames that it judges.

    Examples
    --------
    >>> import numpy as np
    >>> true = np.random.default_rng(0).normal(size=(9, 478, 2))
    >>> half = figures(true, true / 2, eyes_px=50)
    >>> half.slopes.tolist(), half.left_over.tolist()
    ([0.5, 0.5, 0.5, 0.5], [0.5, 0.5, 0.5, 0.5])
    >>> half.openings.tolist()
    [0.5, 0.5]
    """
    left, slopes, motion = np.zeros((3, len(FEATURES)))
    moved, followed = _about_the_mean(true), _about_the_mean(made)
    for row, name in enumerate(FEATURES):
        true_here, made_here = (motions[:, list(GROUPS[name])] for motions in (moved, followed))
        missed = true_here - made_here
        left[row] = np.sqrt(_share(missed, missed, true_here, 0))
        slopes[row] = _share(true_here, made_here, true_here, 1)
        motion[row] = np.sqrt(2 * np.nanmean(true_here**2)) / eyes_px
    openings = []
    for rims in _RIMS.values():
        opened, shown = (
            np.array([np.nanmean(one[:, a], axis=1) - np.nanmean(one[:, b], axis=1) for a, b in rims])
            for one in (moved, followed)
        )
        openings.append(_share(opened, shown, opened, 1))
    return Carried(left, slopes, motion, len(true), np.array(openings))


def _about_the_mean(points: AnyArray) -> AnyArray:
    """Subtract the mean of each point over the frames that it judges."""
    out: AnyArray = points - np.nansum(points, axis=0) / np.maximum(np.isfinite(points).sum(axis=0), 1)
    return out


def _share(one: AnyArray, other: AnyArray, whole: AnyArray, of_nothing: float) -> float:
    """Divide the sum of products of two motions by the sum of squares of a third, or return the value of nothing."""
    total = float(np.nansum(whole**2))
    return float(np.nansum(one * other)) / total if total else of_nothing


def _most_different(faces: dict[int, AnyArray], reference: AnyArray, least_px: float) -> list[int]:
    """Choose up to `FRAMES` frames by their points: each differs most from the reference and those before it.

    Each feature counts by its usual motion, at least `least_px`, so that a blink is as different as an open mouth.
    """
    indices = list(faces)
    parts = []
    for name in FEATURES:
        places = list(GROUPS[name])
        moved = (
            np.array([faces[index][places] for index in indices]).reshape(-1, len(places), 2)
            - reference[places]
        )
        usual_px = np.sqrt((moved**2).sum(axis=-1).mean()) if indices else 0.0
        parts.append(moved.reshape(len(indices), -1) / (max(usual_px, least_px) * np.sqrt(len(places))))
    shapes = np.concatenate(parts, axis=1)
    apart = np.linalg.norm(shapes, axis=1)
    chosen: list[int] = []
    while len(chosen) < min(FRAMES, len(indices)):
        chosen.append(int(apart.argmax()))
        apart = np.minimum(apart, np.linalg.norm(shapes - shapes[chosen[-1]], axis=1))
        apart[chosen] = -1
    return [indices[place] for place in chosen]
