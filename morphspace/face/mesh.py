"""The 478 points of MediaPipe's face mesh by name, and measures of them.

They determine the faceframe (Nagle et al., sections 3 and 4, step 4). An eye centre is the mean of its ring of lid
points, which a blink does not move as a gaze moves the iris; the philtrum is one mesh point (ours). "Right" is the
subject's right, the image's left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from morphspace.arrays import AnyArray, Points
from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame

SCHEME = "mediapipe-attention-478"
POINT_COUNT = 478
GIVEN_SCORE = 1.0  # of a face whose points were given
MESH_COUNT = 468  # points; the others are the two irises

# Lid rings run from the outer corner along the lower lid to the inner corner, and back along the upper lid.
RIGHT_LIDS = (33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246)
LEFT_LIDS = (263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466)
RIGHT_IRIS = (468, 469, 470, 471, 472)  # centre, then the rim
LEFT_IRIS = (473, 474, 475, 476, 477)
RIGHT_BROW = (70, 63, 105, 66, 107, 55, 65, 52, 53, 46)  # upper edge inwards, lower edge outwards
LEFT_BROW = (300, 293, 334, 296, 336, 285, 295, 282, 283, 276)
# Lip rings run from the subject's right corner along the upper lip, and back along the lower lip.
OUTER_LIPS = (61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146)
INNER_LIPS = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
LIPS = OUTER_LIPS + INNER_LIPS
MOUTH_CORNERS = (61, 291)
UPPER_LIP_BOTTOM, LOWER_LIP_TOP = 13, 14
# The outline runs from the top of the forehead down the image's right side to the chin, and back up.
FACE_OUTLINE = (
    *(10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152),
    *(148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109),
)
GROUPS: Mapping[str, tuple[int, ...]] = {
    "lids": RIGHT_LIDS + LEFT_LIDS,
    "brows": RIGHT_BROW + LEFT_BROW,
    "outer lips": OUTER_LIPS,
    "inner lips": INNER_LIPS,
    "outline": FACE_OUTLINE,
}
"""The landmarks by group: mesh points of the features that move with expression, and of the face's outline."""
FEATURES = ("outer lips", "inner lips", "brows", "lids")
"""The groups that move with expression."""
APERTURES: Mapping[str, str] = {"mouth opening": "inner lips", "eye opening": "lids"}
"""Distances between both rims of a feature."""
LANDMARKS: tuple[int, ...] = tuple(place for places in GROUPS.values() for place in places)
"""All landmarks, in the order of the groups."""
# Points that move with the skull: corners of the eyes, root, ridge and base of the nose.
RIGID_POINTS = (33, 133, 362, 263, 168, 6, 197, 195, 5, 4, 1, 2, 98, 327)
PHILTRUM = 164

# Symmetric pairs, the subject's right first, and a line down the face; expressions move these points little.
MIRRORED_PAIRS = ((33, 263), (133, 362), (127, 356), (234, 454), (162, 389), (98, 327))
DOWN_FROM, DOWN_TO = (33, 133, 362, 263), (98, 2, 327)  # the corners of the eyes, the base of the nose
# Degrees by which a frontal face's nose base is in front of its eyes; median of eight clips
RESTING_PITCH_DEG = 25.4
# Eye distances between two readings at which the confidence is one half. On four `tune` people points behind a drawn
# hand have .032 to .052 (means), all others .018 to .028.
APART_SHARE = 0.04
MAX_TURN_DEG = 20.0  # degrees; above it a driving face is flagged, since its far side is hidden


# fmt: off
MIDDLE = (0, 1, 2, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 15,
          16, 17, 18, 19, 94, 151, 152, 164, 168, 175, 195, 197, 199, 200)
# fmt: on


def _opposite() -> tuple[int, ...]:
    """Pair the points of both sides, which are numbered in the same order.

    The pairs were found by detection in frames and their mirror images (ours).
    """
    order = np.arange(MESH_COUNT)
    aside = np.setdiff1d(order, MIDDLE)
    one, other = aside.reshape(2, -1)
    order[one], order[other] = other, one
    return tuple(order.tolist())


OPPOSITE = _opposite()
"""The mirror point of each of the 468 mesh points; a point of the middle line is its own."""


@dataclass(frozen=True, eq=False)
class FacePoints:
    """Points of a face in an image.

    Attributes
    ----------
    points : array (n, 2) px
    score : float
        Of the face, in [0, 1].
    scheme : str
        The meaning of each point.
    depth : array (n,) px, or None
        Estimated distance behind the face's centre, smaller nearer to the camera; None if unknown.
    confidence : array (n,), or None
        Of each point, in [0, 1] (`confidence_of`); None if unknown.
    others : array (m, 2) px
        The middles of further faces in the image.

    Raises
    ------
    BadInput
        If the points do not fit the scheme or are not finite.
    """

    points: Points
    score: float
    scheme: str = SCHEME
    depth: AnyArray | None = None
    confidence: AnyArray | None = None
    others: Points = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        expected = (POINT_COUNT, 2) if self.scheme == SCHEME else (len(self.points), 2)
        if self.points.shape != expected:
            raise BadInput(f"points of {self.scheme} have shape {self.points.shape}; expected {expected}")
        for name, values in (("depths", self.depth), ("confidences", self.confidence)):
            if values is not None and values.shape != expected[:1]:
                raise BadInput(
                    f"{name} have shape {values.shape}; expected {expected[:1]}, one for each point"
                )
        if not np.isfinite(self.points).all():
            raise BadInput("a face point is not finite. Leave this frame out")

    def faceframe(self) -> FaceFrame:
        """Compute the faceframe: the means of the lid rings, and the middle of the philtrum."""
        self._need_scheme()
        three = [
            self.points[list(RIGHT_LIDS)].mean(axis=0),
            self.points[list(LEFT_LIDS)].mean(axis=0),
            self.points[PHILTRUM],
        ]
        return FaceFrame.at(np.array(three))

    @property
    def interocular_px(self) -> float:
        """The distance between the eye centres, px."""
        frame = self.faceframe()
        return float(np.hypot(*np.subtract(frame.left_eye, frame.right_eye)))

    @property
    def turn_degrees(self) -> tuple[float, float]:
        """The turn of the head out of the picture, (yaw, pitch) in degrees, from the estimated depth (ours).

        Yaw is positive towards the image's right, pitch upwards. Errors are a few degrees up to about 30 degrees,
        larger for pitch, since noses differ. Raises `BadInput` without depth.
        """
        self._need_scheme()
        if self.depth is None:
            raise BadInput("the face points have no depth; the head's turn needs it. Detect them again")
        solid = np.column_stack([self.points, self.depth])
        right, left = (list(side) for side in zip(*MIRRORED_PAIRS, strict=True))
        across = (solid[left] - solid[right]).sum(axis=0)
        down = solid[list(DOWN_TO)].mean(axis=0) - solid[list(DOWN_FROM)].mean(axis=0)
        yaw = np.degrees(np.arctan2(across[2], np.hypot(across[0], across[1])))
        # The nose points along the face's viewing direction; the part of `down` along the eye line is noise.
        across = across / np.linalg.norm(across)
        down = down - (down @ across) * across
        pitch = np.degrees(np.arctan2(-down[2], np.hypot(down[0], down[1]))) - RESTING_PITCH_DEG
        return float(yaw), float(pitch)

    @property
    def roll_degrees(self) -> float:
        """The turn of the eye line in the picture, degrees; positive clockwise."""
        frame = self.faceframe()
        across, down = np.subtract(frame.left_eye, frame.right_eye)
        return float(np.degrees(np.arctan2(down, across)))

    def is_turned(self, limit_deg: float = MAX_TURN_DEG) -> bool:
        """Return whether yaw or pitch exceeds `limit_deg`."""
        return max(map(abs, self.turn_degrees)) > limit_deg

    def moved(self, points: Points) -> FacePoints:
        """Return the face with other points (n, 2) px and without depth."""
        return FacePoints(np.asarray(points, np.float64), self.score, self.scheme)

    def _need_scheme(self) -> None:
        if self.scheme != SCHEME:
            raise BadInput(f"the face points are {self.scheme}; expected {SCHEME}. Detect them again")


def confidence_of(apart_px: AnyArray, eyes_px: float) -> AnyArray:
    """Compute the confidence of points from the distance of two readings of each.

    Parameters
    ----------
    apart_px : array (n,) px
        Distance of the reading of the mirrored picture from that of the picture.
    eyes_px : float
        The distance between the eyes, px.

    Returns
    -------
    array (n,), in [0, 1]
        1 for equal readings, one half at `APART_SHARE`.

    Examples
    --------
    >>> import numpy as np
    >>> confidence_of(np.array([0.0, 2.0, 4.0]), 50.0).tolist()
    [1.0, 0.5, 0.2]
    """
    out: AnyArray = 1 / (1 + (apart_px / (APART_SHARE * eyes_px)) ** 2)
    return out


def landmark_places(group: str) -> slice:
    """Return the slice of a group in the m landmarks. Raises `BadInput` for a name outside `GROUPS`.

    Examples
    --------
    >>> landmark_places("brows")
    slice(32, 52, None)
    """
    start = 0
    for name, places in GROUPS.items():
        if name == group:
            return slice(start, start + len(places))
        start += len(places)
    raise BadInput(f"the landmark group is {group!r}; expected one of {', '.join(GROUPS)}")
