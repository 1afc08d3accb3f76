"""From an image to the points of its main face: find the face, turn it upright, find its points, twice, then its eyes.

MediaPipe's chain (Kartynnik et al. 2019; Ablavatski et al. 2020) on OpenCV alone. The points decide the second crop, so
that they no longer depend on how the coarse box happened to fall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morphspace.arrays import AnyArray, Image, Points
from morphspace.errors import BadInput
from morphspace.face.detector import boxes, eyes
from morphspace.face.detector.boxes import FaceBox
from morphspace.face.detector.crops import Crop, along, whole_image
from morphspace.face.detector.mirror import OPPOSITE
from morphspace.face.detector.models import check_models, models_folder, models_present
from morphspace.face.detector.networks import NetworkPool, NetworkSet
from morphspace.face.mesh import LEFT_LIDS, MESH_COUNT, POINT_COUNT, RIGHT_LIDS, FacePoints

Detector = Callable[[Image], FacePoints | None]
"""From an image (h, w, 3) in [0, 1] to the points of its main face, or None where no face is found."""

LEAST_SCORE = 0.7  # of the box; below it hands, collars and shadows pass for faces
LEAST_PRESENCE = 0.5  # of the mesh: whether the crop shows a face at all
# The box network was taught with faces that leave room around them: one that fills the frame is tried again, smaller.
MARGINS = (1.0, 1.25, 1.5, 2.0)
MESH_SIDE = 192  # px of the mesh network's square input
ENLARGED = 1.5  # the crop's extent in sides of the box, or of the points' bounding box
OUTER_CORNERS = (RIGHT_LIDS[0], LEFT_LIDS[0])
SMALLEST_EXTENT_PX = 4.0  # of a crop; less is a network's nonsense


def load_detector(folder: Path | None = None) -> Detector:
    """Give the detector that runs the networks in the folder (`models_folder()` where None is given).

    It may be called from several threads at once and gives the same points for the same image. Raises `MissingModels`
    where a network is missing or damaged.
    """
    folder = models_folder() if folder is None else folder
    check_models(folder)
    return FaceDetector(NetworkPool(folder)).find


def own_detector() -> Detector | None:
    """Give the detector of faces where its files have been fetched, else None."""
    return load_detector() if models_present() else None


@dataclass(frozen=True, eq=False)
class FaceDetector:
    """The chain of networks; `find` is the `Detector`."""

    pool: NetworkPool

    def find(self, image: Image) -> FacePoints | None:
        """Give the 478 points of the main face of an image (h, w, 3), px of that image, or None without a face.

        Raises `BadInput` for an array that is no colour image or holds numbers that are not finite.
        """
        if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
            raise BadInput(f"faces are found in images of shape (h, w, 3), this one has {image.shape}")
        if not np.isfinite(image).all():
            raise BadInput("the image holds numbers that are not finite: mend them, or leave this frame out")
        image = np.clip(image, 0, 1, dtype=np.float32)
        with self.pool.borrowed() as networks:
            face = _find_box(networks, image)
            if face is None:
                return None
            first = _crop_of_box(face)
            meshed = _find_mesh(networks, image, first)
            if meshed is None:
                return None
            points, depth = eyes.refined(networks.iris, image, *meshed)
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
