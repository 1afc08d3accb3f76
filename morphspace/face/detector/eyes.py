"""Lids and irises from MediaPipe's iris network, put in the place of the coarser ones of the face mesh.

The network knows the eye on the image's left (the subject's right); the other is shown to it mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Image, Points
from morphspace.face.detector.crops import Crop, along
from morphspace.face.detector.networks import Network
from morphspace.face.mesh import LEFT_IRIS, LEFT_LIDS, RIGHT_IRIS, RIGHT_LIDS

SIDE = 64  # px of the network's square input
# The crop's extent in widths of the eye. MediaPipe takes 2.3; with 2.5 the opening of the lids follows its own better
# (r .69-.94 became .87-.95 on the clips where it was not near 1 with either).
ENLARGED = 2.5
MESH_SHARE = 0.4  # of the mesh in where a lid's points stand along the eye
# Order of the network's first 16 points: lower lid from the outer to the inner corner, then the upper lid likewise.
LID_ORDER = (0, 1, 2, 3, 4, 5, 6, 7, 8, 15, 14, 13, 12, 11, 10, 9)


@dataclass(frozen=True, eq=False)
class Eye:
    """Where an eye's points stand among the 478: `lids` (16) from the outer corner, `iris` (5); mirrored or not."""

    lids: tuple[int, ...]
    iris: tuple[int, ...]
    mirrored: bool

    def crop(self, points: Points) -> Crop:
        """Give the square of the image that shows this eye, along the line through its corners (index 0 and 8)."""
        outer, inner = points[self.lids[0]], points[self.lids[8]]
        first, last = (inner, outer) if self.mirrored else (outer, inner)
        found = along(np.array([outer, inner]), first, last, ENLARGED, SIDE)
        return Crop(found.centre, found.extent_px, found.turn_rad, SIDE, self.mirrored)


# The rim of an iris runs from the image's right upwards in both eyes, so the mirrored one has its sides exchanged.
_LEFT_IRIS_MIRRORED = tuple(LEFT_IRIS[place] for place in (0, 3, 2, 1, 4))
EYES = (Eye(RIGHT_LIDS, RIGHT_IRIS, mirrored=False), Eye(LEFT_LIDS, _LEFT_IRIS_MIRRORED, mirrored=True))


def refined(network: Network, image: Image, points: Points, depth: AnyArray) -> tuple[Points, AnyArray]:
    """Give points (478, 2) px and depth (478,) with the lids and irises of the iris network.

    `points` and `depth` hold the 468 of the mesh, then anything. How far the lids stand open is the iris network's
    alone: the mesh hardly sees a blink. Along the eye the two are weighed together, for the one sees the corners too
    far in and the other too far out. The iris takes the mean depth of its lids, as in MediaPipe; the lids keep the
    mesh's.
    """
    points, depth = points.copy(), depth.copy()
    for eye in EYES:
        crop = eye.crop(points)
        contour, iris = network.answer(crop.cut(image))
        meshed = points[list(eye.lids)]
        seen = crop.in_image(contour.reshape(-1, 3)[list(LID_ORDER), :2].astype(np.float64))
        line = np.array([np.cos(crop.turn_rad), np.sin(crop.turn_rad)])
        points[list(eye.lids)] = seen + MESH_SHARE * np.outer((meshed - seen) @ line, line)
        points[list(eye.iris)] = crop.in_image(iris.reshape(-1, 3)[:, :2].astype(np.float64))
        depth[list(eye.iris)] = depth[list(eye.lids)].mean()
    return points, depth
