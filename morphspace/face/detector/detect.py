"""From an image to the points of its main face: find the face, turn it upright, find its points, twice, then its eyes.

MediaPipe's chain (Kartynnik et al. 2019; Ablavatski et al. 2020) on OpenCV alone. The points decide the second crop, so
that they no longer depend on how the coarse box happened to fall.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from morphspace.arrays import AnyArray, Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import boxes
from morphspace.face.detector.boxes import FaceBox
from morphspace.face.detector.crops import Crop, along, whole_image
from morphspace.face.detector.models import ORIGIN, check_models, models_folder, models_present
from morphspace.face.detector.networks import Network, NetworkPool, NetworkSet
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
)

Landmarks = Literal["auto", "anchor", "none"]
"""`auto`: the face is found in every frame where the detector's files are; `anchor`: it must be, and the flow is held
to its points; `none`: it is not looked for."""
WITHOUT_POINTS = (
    "built without face points: rigid part and mask are where a cropped face usually has them, and the model has no "
    "keypoints; run `morphspace models fetch` once for better, or give --landmarks none to say that this is meant"
)
DETECTION_VERSION = 1  # raise it when the detector gives other points from the same networks
LEAST_SCORE = 0.7  # of the box; below it hands, collars and shadows pass for faces
LEAST_PRESENCE = 0.5  # of the mesh: whether the crop shows a face at all
# The box network was taught with faces that leave room around them: one that fills the frame is tried again, smaller.
MARGINS = (1.0, 1.25, 1.5, 2.0)
MESH_SIDE = 192  # px of the mesh network's square input
ENLARGED = 1.5  # the crop's extent in sides of the box, or of the points' bounding box
OUTER_CORNERS = (RIGHT_LIDS[0], LEFT_LIDS[0])
SMALLEST_EXTENT_PX = 4.0  # of a crop; less is a network's nonsense
IRIS_SIDE = 64  # px of the iris network's square input
# The crop's extent in widths of the eye. MediaPipe takes 2.3; with 2.5 the opening of the lids follows its own better
# (r .69-.94 became .87-.95 on the clips where it was not near 1 with either).
EYE_ENLARGED = 2.5
MESH_SHARE = 0.4  # of the mesh in where a lid's points stand along the eye
# Order of its first 16 points: lower lid from the outer to the inner corner, then the upper lid likewise.
LID_ORDER = (0, 1, 2, 3, 4, 5, 6, 7, 8, 15, 14, 13, 12, 11, 10, 9)


@dataclass(frozen=True, eq=False)
class Detector:
    """What finds the main face in an image, with a name for it (ours).

    Parameters
    ----------
    find
        Takes an image (h, w, 3) in [0, 1]; returns the points of its main face, or None where there is no face. It may
        be called from several threads at once.
    identity
        A JSON document that differs whenever `find` may return other points. Kept results carry it, so that those of
        one detector are never taken for another's.

    Raises
    ------
    BadInput
        `identity` is empty.
    """

    find: Callable[[Image], FacePoints | None]
    identity: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not self.identity:
            raise BadInput("the identity of a face detector is empty; give what its results depend on")

    def __call__(self, image: Image) -> FacePoints | None:
        """Return the points of the main face of an image (h, w, 3), or None where there is no face."""
        return self.find(image)

    def is_same(self, other: Detector) -> bool:
        """Tell whether the other detector finds the same points in the same image."""
        return dict(self.identity) == dict(other.identity)


def load_detector(folder: Path | None = None) -> Detector:
    """Load the package's own detector.

    Parameters
    ----------
    folder
        Where the networks lie; `models_folder()` where None.

    Raises
    ------
    MissingModels
        A network is missing or damaged.
    """
    folder = models_folder() if folder is None else folder
    check_models(folder)
    networks = {file.name: file.sha256 for file in ORIGIN.files}
    identity = {"scheme": SCHEME, "version": DETECTION_VERSION, "networks": networks}
    return Detector(partial(_find_face, NetworkPool(folder)), identity)


def own_detector() -> Detector | None:
    """Load the package's own detector where its networks have been fetched; None elsewhere."""
    return load_detector() if models_present() else None


def detector_for(landmarks: str) -> tuple[Detector | None, tuple[str, ...]]:
    """Load the detector where a build with these `landmarks` uses one.

    Returns
    -------
    The detector, or None; and a note on how to get it where it is wanted and its networks are missing.

    Raises
    ------
    BadInput
        `landmarks` is none of `Landmarks`.
    MissingModels
        It is "anchor" and a network is missing.
    """
    if landmarks not in get_args(Landmarks):
        raise BadInput(
            f"there is no way of using landmarks called {landmarks!r}: choose one of {', '.join(get_args(Landmarks))}"
        )
    if landmarks == "none":
        return None, ()
    detector = load_detector() if landmarks == "anchor" else own_detector()
    return detector, () if detector is not None else (WITHOUT_POINTS,)


def _find_face(pool: NetworkPool, image: Image) -> FacePoints | None:
    """Find the 478 points of the main face of an image (h, w, 3), px; None without a face."""
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise BadInput(f"the image has the shape {image.shape}; a face is found in one of (h, w, 3)")
    if not np.isfinite(image).all():
        raise BadInput("the image holds numbers that are not finite; mend them, or leave this frame out")
    image = np.clip(image, 0, 1, dtype=np.float32)
    with pool.borrowed() as networks:
        face = _find_box(networks, image)
        if face is None:
            return None
        meshed = _find_mesh(networks, image, _crop_of_box(face))
        if meshed is None:
            return None
        points, depth = _with_irises(networks.iris, image, *meshed)
    if not (np.isfinite(points).all() and np.isfinite(depth).all()):
        return None
    return FacePoints(points, face.score, depth=depth)


def _find_box(networks: NetworkSet, image: Image) -> FaceBox | None:
    height, width = image.shape[:2]
    for margin in MARGINS:
        crop = whole_image(width, height, boxes.SIDE, margin)
        scores, regressors = networks.face.answer(crop.cut(image) * 2 - 1)
        faces = boxes.suppress(boxes.decode(scores, regressors))
        face = boxes.main_face(faces, LEAST_SCORE)
        if face is not None:
            return FaceBox(crop.in_image(face.corners), crop.in_image(face.marks), face.score)
    return None


def _crop_of_box(face: FaceBox) -> Crop:
    """Give the first crop: around the box, turned to the line through the eyes."""
    step = face.marks[boxes.LEFT_EYE] - face.marks[boxes.RIGHT_EYE]
    x, y = face.corners.mean(axis=0)
    extent = float((face.corners[1] - face.corners[0]).max())
    return Crop((float(x), float(y)), ENLARGED * extent, float(np.arctan2(step[1], step[0])), MESH_SIDE)


def _find_mesh(networks: NetworkSet, image: Image, crop: Crop) -> tuple[Points, AnyArray] | None:
    """Give points (478, 2) and depth (478,), of which the mesh fills the first 468, or None where it sees no face.

    The first crop, `crop`, only places the second. That one is read as it is and mirrored, and the mean is taken:
    against small shifts and noise the eyes, the philtrum and the lips are steadier by a third than from one reading,
    and a mirrored face gives mirrored points.
    """
    first = _read_mesh(networks, crop.cut(image))
    if first is None:
        return None
    around = crop.in_image(first[:, :2])
    right, left = around[list(OUTER_CORNERS)]
    crop = along(around, right, left, ENLARGED, MESH_SIDE)
    if crop.extent_px < SMALLEST_EXTENT_PX:
        return None
    shown = crop.cut(image)
    straight, mirrored = _read_mesh(networks, shown), _read_mesh(networks, shown[:, ::-1])
    if straight is None or mirrored is None:
        return None
    mirrored = mirrored[list(OPPOSITE)]
    mirrored[:, 0] = MESH_SIDE - 1 - mirrored[:, 0]
    mesh = (straight + mirrored) / 2
    points, depth = np.zeros((POINT_COUNT, 2)), np.zeros(POINT_COUNT)
    points[:MESH_COUNT] = crop.in_image(mesh[:, :2])
    depth[:MESH_COUNT] = crop.scale * mesh[:, 2]
    return points, depth


def _read_mesh(networks: NetworkSet, shown: Image) -> Points | None:
    """Give the mesh (468, 3) in a crop, x, y, depth in px of the crop, or None where the network sees no face.

    The network's numbers are pixel indices: read so, mirrored crops give mirrored points, to a third of a pixel.
    """
    presence, flat = networks.mesh.answer(shown)
    mesh = flat.astype(np.float64).reshape(MESH_COUNT, 3)
    # The raw presence, whose logistic function is the share, is compared with the raw share.
    sure = presence[0] >= np.log(LEAST_PRESENCE / (1 - LEAST_PRESENCE))
    return mesh if sure and np.isfinite(mesh).all() else None


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
        found = along(np.array([outer, inner]), first, last, EYE_ENLARGED, IRIS_SIDE)
        return Crop(found.centre, found.extent_px, found.turn_rad, IRIS_SIDE, self.mirrored)


# The rim of an iris runs from the image's right upwards in both eyes, so the mirrored one has its sides exchanged.
_LEFT_IRIS_MIRRORED = tuple(LEFT_IRIS[place] for place in (0, 3, 2, 1, 4))
EYES = (Eye(RIGHT_LIDS, RIGHT_IRIS, mirrored=False), Eye(LEFT_LIDS, _LEFT_IRIS_MIRRORED, mirrored=True))


def _with_irises(network: Network, image: Image, points: Points, depth: AnyArray) -> tuple[Points, AnyArray]:
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
