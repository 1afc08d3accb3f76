"""Notes on a blend: identities without a part, gaze that differs, and the sharpness of the result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morphspace.arrays import Points
from morphspace.avatar.mouth import holds_a_mouth
from morphspace.avatar.settings import MOST_SHARPEN, REST, SOURCE, Expression
from morphspace.avatar.studio import Studio
from morphspace.face.mesh import LEFT_IRIS, LEFT_LIDS, RIGHT_IRIS, RIGHT_LIDS
from morphspace.model.keypoints import landmarks_of

SHARP_ENOUGH = (0.85, 1.20)  # of the sources' sharpness: outside, a blend looks soft or drawn
LOOKING_APART = 0.10  # of an eye's width, between the irises of two mean faces: some 15 degrees of gaze
CORNERS = ((RIGHT_IRIS[0], RIGHT_LIDS[0], RIGHT_LIDS[8]), (LEFT_IRIS[0], LEFT_LIDS[8], LEFT_LIDS[0]))
"""Centre of the iris, and the corners of its eye from the image's left to its right."""


def notes_on(studio: Studio, expressions: Sequence[Expression], sharp_share: float) -> tuple[str, ...]:
    """Write one line for each note; `sharp_share` is the model's sharpness over the wanted one."""
    return (
        *_takes_part(studio),
        *_left_out(studio, expressions),
        *_without_landmarks(studio),
        *_gaze(studio),
        *_sharpness(sharp_share, studio.settings.sharpen),
    )


def _takes_part(studio: Studio) -> list[str]:
    notes = []
    idle = [studio.labels[i] for i in range(len(studio.models)) if i not in studio.part]
    if idle:
        notes.append(f"the weight of {', '.join(idle)} is 0: neither face nor expressions are used")
    names = [model.identity for model in studio.models]
    for name in dict.fromkeys(name for name in names if names.count(name) > 1):
        notes.append(
            f"{names.count(name)} of the models are of {name}, which therefore counts {names.count(name)} times. Leave "
            "out repeated models"
        )
    own = studio.settings.provenance.get("identity")
    if own in names:
        notes.append(
            f"the avatar is named {own}, like one of its sources. Give it another name with --identity"
        )
    if studio.settings.faceframe != SOURCE and len(studio.part) == 1:
        notes.append("only one identity has a weight above 0: the avatar is that person")
    return notes


def _left_out(studio: Studio, expressions: Sequence[Expression]) -> list[str]:
    notes = []
    for given in studio.part:
        out = [one for one in expressions if one.weights[given] == 0]
        if out:
            shown = ", ".join(one.name for one in out[:3])
            notes.append(
                f"{studio.labels[given]} is left out of {len(out)} of {len(expressions)} expressions that it cannot "
                f"show ({shown}{', ...' if len(out) > 3 else ''}): there only its mean face is used"
            )
    return notes


def _without_landmarks(studio: Studio) -> list[str]:
    without = [studio.labels[given] for given in studio.part if not holds_a_mouth(studio.models[given])]
    if studio.settings.correspondence == REST or len(studio.part) < 2 or not without:
        return []
    return [
        f"{', '.join(without)} {'lack' if len(without) > 1 else 'lacks'} mesh points or landmarks, so their mouths "
        "are matched by the mean faces alone. Run `morphspace keypoints MODEL --auto`, or give --correspondence rest"
    ]


def _gaze(studio: Studio) -> list[str]:
    known = {}
    for given in studio.part:
        points = landmarks_of(studio.models[given])
        if points is not None:
            known[studio.labels[given]] = gaze(points)
    if len(known) < 2:
        return []
    least, most = (pick(known, key=known.__getitem__) for pick in (min, max))
    apart = known[most] - known[least]
    if apart <= LOOKING_APART:
        return []
    return [
        f"the mean faces of {least} and {most} look in different directions: their irises are {apart:.2f} of an eye's "
        "width apart. Check the eyes of the blend"
    ]


def gaze(points: Points) -> float:
    """Compute the position of the irises between the corners, positive to the image's right, in widths of the eye.

    The mean of both eyes; 0 is midway. `points` (478, 2) px are those of the face mesh.
    """
    found = []
    for iris, left, right in CORNERS:
        across = points[right] - points[left]
        found.append(
            (points[iris] - (points[left] + points[right]) / 2) @ across / max(across @ across, 1e-12)
        )
    return float(np.mean(found))


def _sharpness(share: float, asked: float | None) -> list[str]:
    low, high = SHARP_ENOUGH
    if low <= share <= high:
        return []
    figure = f"the avatar is {share:.0%} as sharp as its sources; expected {low:.0%} to {high:.0%}"
    if asked is not None:
        return [f"{figure}. --sharpen auto chooses the amount for that"]
    if share < low:
        return [f"{figure}. A stronger mask than {MOST_SHARPEN:g} would draw rings around edges"]
    return [f"{figure}. It was sharpened no more than necessary. Check the pictures on the page"]
