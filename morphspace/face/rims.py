"""Lips, and what lies between lips and between lids, where a held field is linear between the points (ours).

An opening mouth tears apart what lies between the lips, and a blink presses an eye to a line. A smooth spline through
both rims overshoots beyond them and folds lips and skin. So a spline ends at the outer rim of the lips and at the lids.
Inside, triangles between the points of both rims move with their corners. A closing rim keeps a little of its width, so
that no triangle of an opening turns over; folds of lips are smoothed like those of the spline.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from morphspace.arrays import AnyArray, Displacement, Points
from morphspace.face.mesh import INNER_LIPS, LEFT_LIDS, OUTER_LIPS, RIGHT_LIDS

OPENINGS = (INNER_LIPS, RIGHT_LIDS, LEFT_LIDS)
"""The rims of mouth and eyes, rings of face points from corner to corner and back."""
# Whether the second half of each ring lies below the first: lips begin with the upper one, lids with the lower.
DOWNWARDS = (1, -1, -1)
# Of a gap in the reference, that a closing rim keeps. A cell of less than .05 counts as folded.
LEAST_GAP = 0.06
LEAST_AREA_PX2 = 1e-3  # px^2, twice a triangle's area; smaller ones cover no pixel

Triangle = tuple[int, int, int]


def _between(outer: tuple[int, ...], inner: tuple[int, ...]) -> Iterator[Triangle]:
    """Cut the band between two rings of equally many points into triangles."""
    for here, after in zip(range(len(outer)), [*range(1, len(outer)), 0], strict=True):
        yield outer[here], inner[here], outer[after]
        yield outer[after], inner[here], inner[after]


def _across(ring: tuple[int, ...]) -> Iterator[Triangle]:
    """Cut the inside of a ring into triangles between opposite points."""
    last = len(ring) // 2
    for here in range(last):
        first, opposite, after, opposite_after = here, -here, here + 1, -here - 1
        if here > 0:
            yield ring[first], ring[opposite], ring[after]
        if after < last:
            yield ring[after], ring[opposite], ring[opposite_after]


TRIANGLES: tuple[Triangle, ...] = (
    *_between(OUTER_LIPS, INNER_LIPS),
    *(triangle for ring in OPENINGS for triangle in _across(ring)),
)


@dataclass(frozen=True, eq=False)
class Rims:
    """The pixels of a reference inside `TRIANGLES`.

    Attributes
    ----------
    points : array (478, 2) px
        The face in the reference.
    rows, columns : array (m,)
        The pixels.
    corners : array (m, 3)
        The face points at the corners of each pixel's triangle.
    weights : array (m, 3)
        Barycentric coordinates of the pixel.
    """

    points: Points
    rows: AnyArray
    columns: AnyArray
    corners: AnyArray
    weights: AnyArray

    def filled(self, field: Displacement, points: Points) -> Displacement:
        """Return a field (h, w, 2) that moves these pixels with their corners, to the face `points` (478, 2) px."""
        moves = points - self.points
        out = field.copy()
        out[self.rows, self.columns] = (self.weights[..., None] * moves[self.corners]).sum(axis=1)
        return out

    def parted(self, points: Points) -> Points:
        """Return face points (478, 2) px whose opposite rims are at least `LEAST_GAP` of the reference's gap apart."""
        return _parted(points, self.points, LEAST_GAP)


def _parted(points: Points, reference: Points, share: float) -> Points:
    """Move opposite points of the rims apart to a share of their gap in the reference, and never below 0.

    Gaps are measured down the reference's face, at a right angle to the line through the eyes. Points that are too
    near, or have changed sides, move by equal parts.
    """
    across = reference[LEFT_LIDS[0]] - reference[RIGHT_LIDS[0]]
    down = np.array([-across[1], across[0]]) / max(float(np.hypot(*across)), np.finfo(float).tiny)
    out = np.array(points)
    for ring, sign in zip(OPENINGS, DOWNWARDS, strict=True):
        half = len(ring) // 2
        one, other = list(ring[1:half]), list(ring[:half:-1])
        wanted = share * np.maximum((reference[other] - reference[one]) @ (sign * down), 0)
        short = np.maximum(wanted - (out[other] - out[one]) @ (sign * down), 0)
        step = np.outer(short / 2, sign * down)
        out[one] -= step
        out[other] += step
    return out


def rims_of(points: Points, height: int, width: int) -> Rims:
    """Find the pixels of a picture inside the triangles of the face `points` (478, 2) px.

    Rims that cross, as the points of closed lips may, are first laid on each other.

    Examples
    --------
    >>> import numpy as np
    >>> places = np.zeros((478, 2))
    >>> places[list(RIGHT_LIDS[1:8])] = np.column_stack([np.arange(1, 8), np.full(7, 3.5)])
    >>> places[list(RIGHT_LIDS[:7:-1])] = np.column_stack([np.arange(1, 9), np.full(8, 6.5)])
    >>> sorted({*rims_of(places, 10, 12).rows.tolist()})
    [0, 4, 5, 6]
    """
    points = _parted(points, points, 0)
    owner = np.full((height, width), -1)
    held = np.zeros((height, width, 3))
    for number, triangle in enumerate(TRIANGLES):
        origin, *ends = points[list(triangle)]
        edges = np.column_stack(ends) - origin[:, None]
        if abs(np.linalg.det(edges)) < LEAST_AREA_PX2:
            continue
        low = np.maximum(np.ceil(points[list(triangle)].min(axis=0)), 0).astype(int)
        high = np.minimum(np.floor(points[list(triangle)].max(axis=0)), (width - 1, height - 1)).astype(int)
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        along = np.linalg.solve(edges, np.stack([x.ravel(), y.ravel()]) - origin[:, None])
        shares = np.column_stack([1 - along.sum(axis=0), *along])
        inside = (shares >= -1e-9).all(axis=1) & (owner[y, x].ravel() < 0)
        owner[y.ravel()[inside], x.ravel()[inside]] = number
        held[y.ravel()[inside], x.ravel()[inside]] = shares[inside]
    rows, columns = np.nonzero(owner >= 0)
    return Rims(points, rows, columns, np.array(TRIANGLES)[owner[rows, columns]], held[rows, columns])


def completed(points: Points, reference: Points, known: Collection[int]) -> Points:
    """Return face points (478, 2) px whose unknown points of lips and lids move as the mean of their neighbours.

    `known` are points of the mesh; two neighbours on a rim must not both be unknown. The neighbours are those on the
    same rim; `reference` is where they start.
    """
    moves = points - reference
    out = moves.copy()
    for ring in (OUTER_LIPS, *OPENINGS):
        for here, place in enumerate(ring):
            if place not in known:
                near = [ring[here - 1], ring[(here + 1) % len(ring)]]
                out[place] = moves[near].mean(axis=0)
    return reference + out
