"""Detect the points of the main face in an image: its box, an upright crop, the mesh (twice), then the eyes.

This is MediaPipe's chain (Kartynnik et al. 2019; Ablavatski et al. 2020; Grishchenko et al. 2020) on OpenCV alone. The
second crop follows the points of the first, so that the result does not depend on the position of the coarse box.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from morphspace.arrays import AnyArray, Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import attention, boxes
from morphspace.face.detector.attention import AttentionMesh
from morphspace.face.detector.boxes import FaceBox, Person
from morphspace.face.detector.crops import Crop, along, whole_image
from morphspace.face.detector.models import (
    FACE,
    FAR_FACE,
    FILES,
    IRIS,
    MESH,
    check_models,
    damaged_models,
    models_folder,
    models_present,
)
from morphspace.face.detector.networks import Network, read_network
from morphspace.face.mesh import (
    LEFT_IRIS,
    LEFT_LIDS,
    MESH_COUNT,
    OPPOSITE,
    POINT_COUNT,
    RIGHT_IRIS,
    RIGHT_LIDS,
    SCHEME,
    FacePoints,
    confidence_of,
)

Landmarks = Literal["auto", "none"]
"""`auto`: if the networks are installed, the face of every frame holds the flow. `none`: no detection."""
WITHOUT_POINTS = (
    "built without face points: the flow is not held to them, rigid part and mask are those of a cropped face, and the "
    "model has no keypoints. Run "
    "`morphspace models fetch` once, or give --landmarks none to build without"
)
DETECTION_VERSION = 2  # increase it when the detector returns other points from the same networks
LEAST_SCORE = 0.7  # score of the box; below it hands, collars and shadows pass for faces
LEAST_PRESENCE = 0.5  # probability that the crop shows a face
# Times the image's longer side. The box network was trained on faces with a margin: a face that fills the frame is
# found at a smaller scale.
MARGINS = (1.0, 1.25, 1.5, 2.0)
SMALL_SHARE = 0.15  # of the longer side; smaller faces are searched again by the network for far faces
BOX_OUTPUTS = ("classificators", "regressors")
ENLARGED = 1.5  # extent of the crop in sides of the box, or of the points' bounding box
OUTER_CORNERS = (RIGHT_LIDS[0], LEFT_LIDS[0])
SMALLEST_EXTENT_PX = 4.0  # px, of a crop; less is a false detection
IRIS_SIDE = 64  # px, of the iris network's square input
# Extent of the crop in eye widths. MediaPipe uses 2.3; with 2.5 the lid opening follows MediaPipe's own better (r rose
# from .69-.94 to .87-.95 on the clips where neither was near 1).
EYE_ENLARGED = 2.5
MESH_SHARE = 0.4  # weight of the mesh for a lid point's position along the eye
# Order of its first 16 points: lower lid from the outer to the inner corner, then the upper lid likewise.
LID_ORDER = (0, 1, 2, 3, 4, 5, 6, 7, 8, 15, 14, 13, 12, 11, 10, 9)


@dataclass(frozen=True, eq=False)
class NetworkSet:
    """The networks that find a face, its points, and the points of an eye."""

    face: Network
    far_face: Network
    mesh: AttentionMesh
    iris: Network


@dataclass(frozen=True, eq=False)
class NetworkPool:
    """Sets of networks read from `folder`, one for each working thread."""

    folder: Path
    _idle: deque[NetworkSet] = field(default_factory=deque)

    @contextmanager
    def borrowed(self) -> Iterator[NetworkSet]:
        """Lend a set for a block; read a new one if all are in use: OpenCV keeps results inside a network."""
        try:
            networks = self._idle.pop()
        except IndexError:
            networks = self._read()
        try:
            yield networks
        finally:
            self._idle.append(networks)

    def _read(self) -> NetworkSet:
        return NetworkSet(
            read_network(self.folder / FACE.name, BOX_OUTPUTS),
            read_network(self.folder / FAR_FACE.name, BOX_OUTPUTS),
            AttentionMesh.read(self.folder / MESH.name),
            read_network(self.folder / IRIS.name, ("output_eyes_contours_and_brows", "output_iris")),
        )


@dataclass(frozen=True, eq=False)
class Detector:
    """A function that finds the main face in an image, with an identity (ours).

    Attributes
    ----------
    find : function
        Takes an image (h, w, 3) in [0, 1]; returns the points of its main face, or None without a face. It may be
        called from several threads at once.
    identity : mapping
        A JSON document that differs whenever `find` may return other points. Stored results carry it, so that results
        of different detectors are never mixed.

    Raises
    ------
    BadInput
        If the identity is empty.
    """

    find: Callable[[Image], FacePoints | None]
    identity: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not self.identity:
            raise BadInput(
                "the identity of a face detector is empty; expected all that its results depend on"
            )

    def __call__(self, image: Image) -> FacePoints | None:
        """Return the points of the main face of an image (h, w, 3), or None without a face."""
        return self.find(image)

    def is_same(self, other: Detector) -> bool:
        """Return whether the other detector has the same identity."""
        return dict(self.identity) == dict(other.identity)


def load_detector(folder: Path | None = None, person: Person = "largest") -> Detector:
    """Load the package's own detector.

    Parameters
    ----------
    folder : Path, optional
        Of the networks; None for `models_folder()`.
    person : Person
        Which face is found if an image shows several.

    Raises
    ------
    MissingModels
        If a network is missing or damaged.
    """
    folder = models_folder() if folder is None else folder
    check_models(folder)
    networks = {file.name: file.sha256 for file in FILES}
    identity = {"scheme": SCHEME, "version": DETECTION_VERSION, "networks": networks}
    chosen = {} if person == "largest" else {"person": person if isinstance(person, str) else list(person)}
    return Detector(partial(_find_face, NetworkPool(folder), person), {**identity, **chosen})


def own_detector() -> Detector | None:
    """Load the package's own detector, or return None if its networks are not installed."""
    return load_detector() if models_present() else None


def detector_for(landmarks: str, person: Person = "largest") -> tuple[Detector | None, tuple[str, ...]]:
    """Load the detector for a build with this setting of `landmarks`, for this of several persons.

    Returns
    -------
    detector : Detector or None
    notes : tuple of str
        How to install the networks if the setting needs them.

    Raises
    ------
    BadInput
        If `landmarks` is none of `Landmarks`.
    """
    if landmarks not in get_args(Landmarks):
        raise BadInput(f"landmarks is {landmarks!r}; expected one of {', '.join(get_args(Landmarks))}")
    if landmarks == "none":
        return None, ()
    detector = load_detector(person=person) if models_present() else None
    if detector is not None:
        return detector, ()
    damaged = damaged_models()
    return None, (f"{' and '.join(damaged)} is damaged: {WITHOUT_POINTS}" if damaged else WITHOUT_POINTS,)


def _find_face(pool: NetworkPool, person: Person, image: Image) -> FacePoints | None:
    """Find the 478 points of the wanted face of an image (h, w, 3), px; None without a face."""
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise BadInput(f"the image has shape {image.shape}; expected (h, w, 3)")
    if not np.isfinite(image).all():
        raise BadInput("the image holds values that are not finite. Leave this frame out")
    image = np.clip(image, 0, 1, dtype=np.float32)
    with pool.borrowed() as networks:
        faces = boxes.in_order_of(person, _find_boxes(networks, image))
        if not faces:
            return None
        face, *others = faces
        meshed = _find_mesh(networks.mesh, image, _crop_of_box(face))
        if meshed is None:
            return None
        found = _with_irises(networks.iris, image, meshed)
    if not np.isfinite(found).all():
        return None
    middles = np.array([other.middle for other in others]).reshape(-1, 2)
    points = FacePoints(found[:, :2].copy(), face.score, depth=found[:, 2].copy(), others=middles)
    return replace(points, confidence=confidence_of(found[:, 3], points.interocular_px))


def _find_boxes(networks: NetworkSet, image: Image) -> list[FaceBox]:
    """Find the boxes of all faces of an image, at the first margin at which there is one.

    Without any, or with small faces alone, the network for far faces looks too.
    """
    found: list[FaceBox] = []
    for margin in MARGINS:
        found = found or _boxes_at(margin, networks.face, image, boxes.SIDE)
    if all(np.ptp(face.corners, axis=0).max() < SMALL_SHARE * max(image.shape) for face in found):
        found = _boxes_at(1.0, networks.far_face, image, boxes.FAR_SIDE) or found
    return found


def _boxes_at(margin: float, network: Network, image: Image, side: int) -> list[FaceBox]:
    """Find the boxes of all faces of an image, seen with a margin by a network of `side` px."""
    crop = whole_image(image.shape[1], image.shape[0], side, margin)
    scores, regressors = network.answer(crop.cut(image) * 2 - 1)
    faces = boxes.suppress(boxes.decode(scores, regressors, side))
    return [
        FaceBox(crop.in_image(face.corners), crop.in_image(face.marks), face.score)
        for face in faces
        if face.score >= LEAST_SCORE
    ]


def _crop_of_box(face: FaceBox) -> Crop:
    """Return the first crop: around the box, rotated to the line through the eyes."""
    step = face.marks[boxes.LEFT_EYE] - face.marks[boxes.RIGHT_EYE]
    x, y = face.corners.mean(axis=0)
    extent = float((face.corners[1] - face.corners[0]).max())
    return Crop((float(x), float(y)), ENLARGED * extent, float(np.arctan2(step[1], step[0])), attention.SIDE)


def _find_mesh(network: AttentionMesh, image: Image, crop: Crop) -> AnyArray | None:
    """Return x, y, depth and the distance of two readings, px: (478, 4), with the mesh in the first 468.

    None without a face. The first crop only places the second. The second is read straight and mirrored, and both are
    averaged. That reduces the effect of small shifts and noise on eyes, philtrum and lips by a third, and a mirrored
    face gives mirrored points.
    """
    first = _mesh_of(network.rough(crop.cut(image)))
    if first is None:
        return None
    around = crop.in_image(first[:, :2])
    right, left = around[list(OUTER_CORNERS)]
    crop = along(around, right, left, ENLARGED, attention.SIDE)
    if crop.extent_px < SMALLEST_EXTENT_PX:
        return None
    picture = crop.cut(image)
    straight, mirrored = (_mesh_of(network.points(one)) for one in (picture, picture[:, ::-1]))
    if straight is None or mirrored is None:
        return None
    mirrored = mirrored[list(OPPOSITE)]
    mirrored[:, 0] = attention.SIDE - 1 - mirrored[:, 0]
    mesh = (straight + mirrored) / 2
    found = np.zeros((POINT_COUNT, 4))
    found[:MESH_COUNT, :2] = crop.in_image(mesh[:, :2])
    found[:MESH_COUNT, 2] = crop.scale * mesh[:, 2]
    found[:MESH_COUNT, 3] = crop.scale * np.hypot(*(straight - mirrored)[:, :2].T)
    return found


def _mesh_of(answer: tuple[AnyArray, float]) -> Points | None:
    """Return the mesh (468, 3) of an answer, px and depth in the crop, or None if its logit denies a face."""
    points, presence = answer
    mesh = points[:MESH_COUNT]
    return (
        mesh
        if presence >= np.log(LEAST_PRESENCE / (1 - LEAST_PRESENCE)) and np.isfinite(mesh).all()
        else None
    )


@dataclass(frozen=True, eq=False)
class Eye:
    """Indices of an eye's points among the 478: `lids` (16) from the outer corner, `iris` (5); mirrored or not."""

    lids: tuple[int, ...]
    iris: tuple[int, ...]
    mirrored: bool

    def crop(self, points: Points) -> Crop:
        """Return the square of the image around this eye, along the line through its corners (index 0 and 8)."""
        outer, inner = points[self.lids[0]], points[self.lids[8]]
        first, last = (inner, outer) if self.mirrored else (outer, inner)
        found = along(np.array([outer, inner]), first, last, EYE_ENLARGED, IRIS_SIDE)
        return Crop(found.centre, found.extent_px, found.turn_rad, IRIS_SIDE, self.mirrored)


# The iris points run from the image's right upwards in both eyes; in the mirrored eye the sides are exchanged.
_LEFT_IRIS_MIRRORED = tuple(LEFT_IRIS[place] for place in (0, 3, 2, 1, 4))
EYES = (Eye(RIGHT_LIDS, RIGHT_IRIS, mirrored=False), Eye(LEFT_LIDS, _LEFT_IRIS_MIRRORED, mirrored=True))


def _with_irises(network: Network, image: Image, meshed: AnyArray) -> AnyArray:
    """Replace lids and irises of a mesh (478, 4) by those of the iris network.

    The lid opening comes from the iris network alone, since the mesh hardly follows a blink. Positions along the eye
    are averaged over both networks, since the errors of the corners have opposite signs. The iris takes the mean
    depth of its lids, as in MediaPipe, and the mean distance of their two readings; the lids keep those of the mesh.
    """
    found = meshed.copy()
    for eye in EYES:
        crop = eye.crop(found[:, :2])
        contour, iris = network.answer(crop.cut(image))
        of_mesh = found[list(eye.lids), :2]
        lids = crop.in_image(contour.reshape(-1, 3)[list(LID_ORDER), :2].astype(np.float64))
        line = np.array([np.cos(crop.turn_rad), np.sin(crop.turn_rad)])
        found[list(eye.lids), :2] = lids + MESH_SHARE * np.outer((of_mesh - lids) @ line, line)
        found[list(eye.iris), :2] = crop.in_image(iris.reshape(-1, 3)[:, :2].astype(np.float64))
        found[list(eye.iris), 2:] = found[list(eye.lids), 2:].mean(axis=0)
    return found
