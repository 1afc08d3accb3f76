"""Flow and registration held to the points of the face (ours; methods 5.7 of the design).

Dense flow alone may find an opening mouth by painting dark where there were lips, and another clip's flow by moving the
lips: then one model says in colour what the other says in warp, and neither can drive the other. So the thin-plate
spline through the points of the face is taken out of the frame first, and the flow finds the rest. Lips stay on lips,
lids on lids, in every model alike. Registration likewise may start from where the points say the skull went.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, load_detector
from morphspace.face.mesh import (
    FACE_OUTLINE,
    LEFT_BROW,
    LEFT_LIDS,
    LIPS,
    PHILTRUM,
    RIGHT_BROW,
    RIGHT_LIDS,
    RIGID_POINTS,
    FacePoints,
)
from morphspace.face.registration import fitted_similarity
from morphspace.flow import Flow, FlowFunction
from morphspace.flow.folds import unfolded
from morphspace.grid import warp

# Between the rings, so that the spline has something to hold there.
CHEEKS_AND_CHIN = (50, 280, 205, 425, 199, 200)
# Lids, brows, lips, rim and nose: what moves, and what must not. The mesh between them only follows its neighbours.
HELD = tuple(
    sorted(
        {*RIGHT_LIDS, *LEFT_LIDS, *RIGHT_BROW, *LEFT_BROW, *LIPS, *FACE_OUTLINE, *RIGID_POINTS, PHILTRUM}
        | set(CHEEKS_AND_CHIN)
    )
)
# Between the points where the spline is evaluated, with cubics between them: to a few hundredths of a px.
STEP_PX, STEP_SHARE = (
    2.0,
    1 / 120,
)  # px, or this share of the longer side where that is more: faces grow with pictures
MARGIN = 4  # such points beyond each edge, where the interpolation's end effects die away
ONE_PLACE_PX = 1.0  # points nearer than this in the reference are one: closed lips lie on each other


@dataclass(frozen=True, eq=False)
class FaceAnchor:
    """What holds frames to the face of the reference: the `detector`, and the `face` it found there."""

    detector: Detector
    face: FacePoints

    def movement(self, image: Image, found: FacePoints | None = None) -> Affine | None:
        """Give where the registration of an image may start, (2, 3); None where no face is found in it.

        `found` is what `detector` found in it, looked for where None.
        """
        found = found or self.detector(image)
        return None if found is None else rigid_movement(self.face, found)

    def anchored(self, find: FlowFunction, height: int, width: int) -> FlowFunction:
        """Give the flow function that takes the spline out of a frame first, and lets `find` do the rest.

        A frame in which no face is found, and one that comes with a start of its own, go to `find` as they are.
        """
        through = spline_from(self.face.points[list(HELD)], height, width)

        def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
            found = self.detector(frame) if start is None else None
            if found is None:
                return find(frame, start)
            spline = unfolded(through(found.points[list(HELD)]))  # a turned head's points may change sides
            rest = find(warp.sample(frame, spline), None)
            return Flow(unfolded(warp.compose(spline, rest.displacement)), rest.confidence)

        return to_frame

    @cached_property
    def identity(self) -> list[Any]:
        """What the anchor's results depend on, as JSON."""
        return [dict(self.detector.identity), [[float(x), float(y)] for x, y in self.face.points]]


def rigid_movement(reference: FacePoints, frame: FacePoints) -> Affine:
    """Give the similarity (2, 3) that takes the skull's points of the reference to the frame's, robustly."""
    rigid = list(RIGID_POINTS)
    return fitted_similarity(reference.points[rigid], frame.points[rigid])


def anchor_on(reference: Image, detector: Detector) -> FaceAnchor | None:
    """Give the anchor of a reference (h, w, 3); None where no face is found in it."""
    face = detector(reference)
    return None if face is None else FaceAnchor(detector, face)


def anchor_of_build(reference: Image, provenance: Mapping[str, Any]) -> FaceAnchor | None:
    """Find again the face that a model's build found in its reference (h, w, 3).

    It starts the registration of every frame, and holds the flow where `was_anchored`.

    Returns
    -------
    The face and the detector; None for a model that was built without them.

    Raises
    ------
    MissingModels
        The build found a face, and the detector's networks are missing.
    BadInput
        The detector finds no face where the build found one.
    """
    told = provenance.get("landmarks")
    if not (isinstance(told, Mapping) and told.get("reference_has_face")):
        return None
    anchor = anchor_on(np.array(reference), load_detector())
    if anchor is None:
        raise BadInput(
            "the detector finds no face in the reference, where the build found one: build the model again with this "
            "morphspace"
        )
    return anchor


def was_anchored(provenance: Mapping[str, Any]) -> bool:
    """Tell whether a model's build held its frames to the points of the face."""
    told = provenance.get("landmarks")
    return isinstance(told, Mapping) and bool(told.get("anchored"))


def spline_from(places: Points, height: int, width: int) -> Callable[[Points], Displacement]:
    """Prepare the thin-plate splines from places (m, 2) px of a picture, and give the function from (m, 2) to a field.

    What depends on the places alone, the kernel's solution at every grid point, is computed once; a field (h, w, 2) px
    is then one product of matrices. Places at one point go to the mean of theirs. Bookstein, IEEE PAMI 11 (1989).
    """
    cells = np.round(places / ONE_PLACE_PX)
    _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    together = np.zeros((len(count), len(places)))
    together[cell.ravel(), np.arange(len(places))] = 1 / count[cell.ravel()]
    knots = together @ places
    centre, unit = knots.mean(axis=0), max(float(np.abs(knots - knots.mean(axis=0)).max()), 1.0)
    knots = (knots - centre) / unit
    step = max(STEP_PX, STEP_SHARE * max(width, height))
    columns, rows = (ceil(size / step) + 1 + 2 * MARGIN for size in (width, height))
    x, y = np.meshgrid(*(step * (np.arange(number) - MARGIN) for number in (columns, rows)))
    nodes = (np.column_stack([x.ravel(), y.ravel()]) - centre) / unit
    flat = np.column_stack([np.ones(len(knots)), knots])
    system = np.block([[_bending(knots, knots), flat], [flat.T, np.zeros((3, 3))]])
    # A pseudo-inverse: knots on one line leave the affine part across it open, and the smallest is meant.
    solution = np.linalg.pinv(system, rcond=1e-12, hermitian=True)[:, : len(knots)] @ together
    at_nodes = np.column_stack([_bending(nodes, knots), np.ones(len(nodes)), nodes]) @ solution
    operator = at_nodes.astype(np.float32)
    at_x, at_y = np.meshgrid(*(np.arange(size, dtype=np.float32) / step + MARGIN for size in (width, height)))

    def field_to(found: Points) -> Displacement:
        moves = (found - places).astype(np.float32)
        coarse = (operator @ moves).reshape(rows, columns, 2)
        return warp.sample_at(coarse, at_x, at_y)

    return field_to


def _bending(points: AnyArray, knots: AnyArray) -> AnyArray:
    """Give r^2 log r between points (n, 2) and knots (m, 2): (n, m)."""
    square = ((points[:, None] - knots) ** 2).sum(axis=2)
    out: AnyArray = 0.5 * square * np.log(np.where(square > 0, square, 1.0))
    return out
