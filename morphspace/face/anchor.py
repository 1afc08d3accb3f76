"""Hold flow and registration to the points of the face (ours).

Where the frame shows what the reference cannot show, teeth or a closed lid, the best match of colours is not the right
match of points: the flow paints an opening mouth as a change of colour. A start does not help, since the flow leaves
it. So the thin-plate spline through the face points is taken out of the frame first; lips and openings are linear
between them (`face.rims`). The flow estimates the remainder, up to `MOST_BEYOND`, and not at all at lips and lids. Lips
then match lips, and lids match lids, in every model. Registration starts from the movement of the points on the skull.

References
----------
Bookstein, Principal warps: thin-plate splines and the decomposition of deformations, IEEE PAMI 11 (1989).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import Detector, Person, load_detector, person_of
from morphspace.face.faceframe import Frame
from morphspace.face.mesh import (
    FACE_OUTLINE,
    GIVEN_SCORE,
    INNER_LIPS,
    LEFT_BROW,
    LEFT_LIDS,
    LIPS,
    OUTER_LIPS,
    PHILTRUM,
    RIGHT_BROW,
    RIGHT_LIDS,
    RIGID_POINTS,
    FacePoints,
)
from morphspace.face.registration import fitted_similarity
from morphspace.face.rims import completed, rims_of
from morphspace.flow import Flow, FlowFunction
from morphspace.flow.folds import unfolded
from morphspace.grid import warp
from morphspace.steps import single_threads

# Mesh points between the rings of lids, lips and outline.
CHEEKS_AND_CHIN = (50, 280, 205, 425, 199, 200)
# Mesh points that hold the flow: lids, brows, lips, outline and nose. The mesh between them follows its neighbours.
# The spline goes through all but the inner lips, from which the field is linear (`face.rims`).
HELD = tuple(
    sorted(
        {*RIGHT_LIDS, *LEFT_LIDS, *RIGHT_BROW, *LEFT_BROW, *LIPS, *FACE_OUTLINE, *RIGID_POINTS, PHILTRUM}
        | set(CHEEKS_AND_CHIN)
    )
)
# Spacing of the points at which the spline is evaluated, px, or as a share of the longer side; the larger counts.
# Cubics between them are exact to a few hundredths of a px.
STEP_PX, STEP_SHARE = 2.0, 1 / 120
MARGIN = 4  # such points beyond each edge, for the end effects of the interpolation
# Chosen on six `tune` people by the slope of lips, brows and lids under a judge's landmarks, and by held-out frames.
# Within the face, the flow leaves the spline by less than this, eye distances. Outside it may leave it by so much more
# as a pixel is far from the face: hair and shoulders have movements of their own.
MOST_BEYOND = 0.1
HELD_AROUND = 0.08  # eye distances from lips and lids, over which the flow fades in
# Eye distances outside the face, over which the spline fades out. Without fading, clothes and background of drawn
# actors are off by .3 to 1.2 px, with 2 by .1 to .4. With 1, frames of a moving head come back .1 dB worse than with 2.
AROUND_FACE = 2.0
TINY = 1e-6  # no movement, against a division by zero
ONE_PLACE_PX = 1.0  # px; nearer points are merged, such as those of closed lips


@dataclass(frozen=True, eq=False)
class FaceAnchor:
    """The face to which frames are held: the `detector`, and the `face` that it found in the reference."""

    detector: Detector
    face: FacePoints

    def held(
        self, find: FlowFunction, height: int, width: int, holding: Collection[int] = HELD
    ) -> Callable[[Frame], Flow]:
        """Return a function that estimates the flow to an aligned frame, held to the face points of the frame.

        `find` estimates the remainder; it gets a frame without a face unchanged. The `holding` points of the mesh
        hold the flow. The face is searched in a frame whose points are None.
        """
        known = frozenset(holding)
        places = sorted(known.difference(INNER_LIPS))
        through = spline_from(self.face.points[places], height, width)
        rims = rims_of(self.face.points, height, width)
        eyes_px = self.face.interocular_px
        lips_and_lids = (OUTER_LIPS, RIGHT_LIDS, LEFT_LIDS)
        free = np.minimum(_distance_px(self.face, lips_and_lids, height, width) / (HELD_AROUND * eyes_px), 1)
        outside_px = _distance_px(self.face, (FACE_OUTLINE,), height, width)
        most_px = MOST_BEYOND * eyes_px + outside_px
        near = np.maximum(1 - outside_px / (AROUND_FACE * eyes_px), 0)[..., None].astype(np.float32)

        def to_frame(frame: Frame) -> Flow:
            points = points_of(self.detector(frame.image)) if frame.points is None else frame.points
            if not len(points):
                return find(frame.image, None)
            points = rims.parted(completed(points, self.face.points, known))
            # Points of a turned head may change sides.
            spline = unfolded(rims.filled(near * through(points[places]), points))
            rest = find(warp.sample(frame.image, spline), None)
            length = np.maximum(np.hypot(*cv2.split(rest.displacement)) / most_px, TINY)
            beyond = rest.displacement * (free * np.tanh(length) / length)[..., None].astype(np.float32)
            return Flow(unfolded(warp.compose(spline, beyond)), rest.confidence)

        return to_frame

    @cached_property
    def identity(self) -> list[Any]:
        """All that the held flow depends on, as JSON."""
        return [dict(self.detector.identity), [[float(x), float(y)] for x, y in self.face.points]]


def _distance_px(face: FacePoints, rings: Iterable[tuple[int, ...]], height: int, width: int) -> AnyArray:
    """Return the distance (h, w) px of each pixel from the areas within rings of face points, 0 inside."""
    outside = np.ones((height, width), np.uint8)
    for ring in rings:
        cv2.fillPoly(outside, [np.round(face.points[list(ring)]).astype(np.int32)], 0)
    # OpenCV's exact transform differs in the last bits from call to call.
    return np.asarray(ndimage.distance_transform_edt(outside), np.float32)


def points_of(found: FacePoints | None) -> Points:
    """Return the points (478, 2) px of a detected face, (0, 2) without a face, as a `Frame` holds them."""
    return np.zeros((0, 2)) if found is None else found.points


def rigid_movement(reference: FacePoints, frame: FacePoints) -> Affine:
    """Fit the similarity (2, 3) from the skull's points in the reference to those in the frame, robustly."""
    rigid = list(RIGID_POINTS)
    return fitted_similarity(reference.points[rigid], frame.points[rigid])


def anchor_of_build(
    reference: Image, provenance: Mapping[str, Any], person: Person | None = None
) -> FaceAnchor | None:
    """Return the face of a model's reference (h, w, 3): as it was given, or detected again as in the build.

    It starts the registration of every frame, and holds the flow if `was_held`. `person` is the face that is
    searched in frames; None for the choice of the build.

    Returns
    -------
    FaceAnchor or None
        None for a model that was built without face points.

    Raises
    ------
    MissingModels
        If the build found a face, and the detector's networks are not installed.
    BadInput
        If the detector finds no face where the build found one.
    """
    entry = provenance.get("landmarks")
    if not (isinstance(entry, Mapping) and entry.get("reference_has_face")):
        return None
    if entry.get("anchored"):
        raise BadInput("the model was built with --landmarks anchor, which is no more. Build the model again")
    found_by = entry.get("detector")
    chosen = person_of(found_by.get("person") if isinstance(found_by, Mapping) else None)
    detector = load_detector(person=chosen)
    face = face_of_reference(reference, provenance, detector)
    if face is None:
        raise BadInput(
            "the detector finds no face in the reference, where the build found one. Build the model again with this "
            "morphspace"
        )
    return FaceAnchor(detector if person is None else load_detector(person=person), face)


def face_of_reference(
    reference: Image, provenance: Mapping[str, Any], detector: Detector
) -> FacePoints | None:
    """Return the face in a model's reference (h, w, 3): as it was given to the build, or detected; None without one."""
    points = provenance["landmarks"].get("reference_points")
    return FacePoints(np.array(points), GIVEN_SCORE) if points else detector(np.array(reference))


def was_held(provenance: Mapping[str, Any]) -> bool:
    """Return whether a model's build held its flow to the face points."""
    entry = provenance.get("landmarks")
    return isinstance(entry, Mapping) and bool(entry.get("held"))


def spline_from(places: Points, height: int, width: int) -> Callable[[Points], Displacement]:
    """Prepare thin-plate splines from fixed places (m, 2) px of a picture.

    The solution at every grid point depends on the places alone and is computed once. A field is then one product of
    matrices. Places nearer than `ONE_PLACE_PX` are merged into their mean.

    Parameters
    ----------
    places : array (m, 2) px
    height, width : int
        Size of the field, px.

    Returns
    -------
    function
        Maps targets (m, 2) px to the displacement (h, w, 2) px that moves the places to them.

    References
    ----------
    Bookstein, IEEE PAMI 11 (1989).

    Examples
    --------
    >>> import numpy as np
    >>> corners = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 30.0], [30.0, 30.0]])
    >>> field = spline_from(corners, 31, 31)(corners + (2, 1))
    >>> field.shape, (np.abs(field - (2, 1)) < 0.01).all().item()
    ((31, 31, 2), True)
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
    with single_threads():  # else the last bits depend on the number of cores
        # Knots on one line do not determine the affine part across it; the pseudo-inverse chooses the smallest.
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
    """Compute r^2 log r between points (n, 2) and knots (m, 2): (n, m)."""
    square = ((points[:, None] - knots) ** 2).sum(axis=2)
    out: AnyArray = 0.5 * square * np.log(np.where(square > 0, square, 1.0))
    return out
