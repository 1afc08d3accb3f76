"""Which points of the face mesh lie opposite each other, so that a face and its mirror image can be read together.

Found by showing the mesh network frames and their mirror images and pairing the points that fell together (ours). The
pairs follow the numbering: the sides are numbered one after the other, in the same order.
"""

from __future__ import annotations

import numpy as np

from morphspace.face.mesh import MESH_COUNT

# fmt: off
MIDDLE = (0, 1, 2, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 15,
          16, 17, 18, 19, 94, 151, 152, 164, 168, 175, 195, 197, 199, 200)
# fmt: on


def _opposite() -> tuple[int, ...]:
    order = np.arange(MESH_COUNT)
    aside = np.setdiff1d(order, MIDDLE)
    one, other = aside.reshape(2, -1)
    order[one], order[other] = other, one
    return tuple(order.tolist())


OPPOSITE = _opposite()
"""For each of the 468 points, the one opposite; a point of the middle line is its own."""
