"""The portrait actor: a photograph of a real face, moved by the same fields as a drawn one.

The photograph that comes with scikit-image shows Eileen Collins (NASA, public domain). Its landmarks were
marked by hand. Lids and lips part along those marks; in its label map all that is not behind a slit counts as
skin; what the photograph hides (the rest of the iris, gums, lower teeth, tongue) is painted. Its neutral face
is the photograph itself, a smile: expressions add to it. Ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import skimage.data

from morphspace.arrays import AnyArray, Image
from morphspace.synthetic.actor import (
    NEUTRAL,
    PLAIN,
    Actor,
    ActorFrame,
    check_size,
    picture_labels,
    slit_distances,
)
from morphspace.synthetic.creases import CREASE_NAMES, crease_maps
from morphspace.synthetic.drawn import DEFAULT_SIZE, MARGIN_SHARE
from morphspace.synthetic.fields import BASIS_NAMES, SEAM, basis_fields, smooth
from morphspace.synthetic.geometry import EYE_LEVEL, UNITS_IN_HEIGHT, Aperture, FaceGeometry
from morphspace.synthetic.interior import (
    Interior,
    layered,
    paint_cavity,
    paint_iris,
    paint_sclera,
    paint_teeth,
    paint_tongue,
)
from morphspace.synthetic.painting import FINE, LABELS
from morphspace.synthetic.parameters import Capture, Colour, Expression
from morphspace.synthetic.texture import blurred


@dataclass(frozen=True, eq=False)
class PortraitMarks:
    """The position of the face in a photograph: the pupils in photograph px, all else in face units. Ours."""

    right_pupil: tuple[float, float]
    left_pupil: tuple[float, float]
    geometry: FaceGeometry  # its place on the canvas is filled in by `portrait_actor`
    iris: Colour
    reach: Mapping[str, float]  # how much of a field's usual size this face has room for, where not all of it
    creases: Mapping[str, float]  # the same for the depth of creases
    teeth: tuple[float, float]  # x where the upper row of teeth ends on each side


ASTRONAUT = PortraitMarks(
    right_pupil=(202.75, 101.25),
    left_pupil=(247.5, 102.75),
    geometry=FaceGeometry(
        unit_px=1.0,
        origin_px=(0.0, 0.0),
        right_eye=Aperture((-0.655, 0.000), (-0.255, 0.030), 0.090, 0.042, 0.0, 0.10, -0.10),
        left_eye=Aperture((0.225, 0.045), (0.660, 0.005), 0.098, 0.040, 0.0, -0.05, 0.10),
        mouth=Aperture((-0.435, 0.765), (0.400, 0.765), 0.050, 0.065, 0.120, 0.0, -0.12),
        right_brow=np.array(
            [
                (-0.265, -0.195),
                (-0.36, -0.215),
                (-0.45, -0.232),
                (-0.55, -0.25),
                (-0.64, -0.235),
                (-0.71, -0.21),
            ]
        ),
        left_brow=np.array(
            [(0.255, -0.195), (0.35, -0.207), (0.45, -0.215), (0.55, -0.22), (0.64, -0.205), (0.73, -0.165)]
        ),
        nose_tip=(-0.015, 0.50),
        nose_base=0.625,
        nose_width=0.20,
        chin=1.51,
        face_width=0.90,
        jaw_width=0.70,
        lip_upper=0.085,
        lip_lower=0.085,
        iris_radius=0.080,
        right_iris=(-0.447, -0.010),
        left_iris=(0.432, -0.004),
    ),
    iris=(0.27, 0.17, 0.07),
    reach={
        "lip_corner_up": 0.40,
        "lip_corner_down": 1.35,
        "brow_lower": 0.80,
        "upper_lip_raise": 0.75,
        "lip_stretch": 0.7,
    },
    creases={
        "nasolabial": 0.45,
        "cheek_ball": 0.35,
        "forehead": 0.55,
        "glabella": 0.6,
        "nose": 0.6,
        "chin_dimples": 0.5,
        "corner_pit": 0.3,
        "lid_fold_right": 0.0,
        "lid_fold_left": 0.0,
        "pucker": 0.5,
    },
    teeth=(-0.335, 0.235),
)


@lru_cache(maxsize=2)
def portrait_actor(size: tuple[int, int] = DEFAULT_SIZE) -> Actor:
    """Prepare the actor made of scikit-image's `astronaut`, for pictures of `size` (width, height). Ours."""
    photograph = skimage.data.astronaut().astype(np.float32) / np.float32(255)
    return actor_of_photograph(photograph, ASTRONAUT, size=size)


def draw_portrait_frame(
    expression: Expression = NEUTRAL, *, size: tuple[int, int] = DEFAULT_SIZE, capture: Capture = PLAIN
) -> ActorFrame:
    """Draw one frame of the portrait actor, with its truth. `size` (width, height) px. Ours."""
    return portrait_actor(size).draw(expression, capture)


def actor_of_photograph(
    photograph: Image, marks: PortraitMarks, *, size: tuple[int, int] = DEFAULT_SIZE
) -> Actor:
    """Make an actor of any frontal photograph (h, w, 3) with marked landmarks.

    The face is turned upright and scaled to the same place as a drawn one. Raises `BadInput` for a size too
    small. Ours.
    """
    check_size(size)
    margin = round(MARGIN_SHARE * size[1])
    width, height = size[0] + 2 * margin, size[1] + 2 * margin
    face = replace(
        marks.geometry,
        unit_px=min(size[1] / UNITS_IN_HEIGHT, size[0] / 2.75),
        origin_px=(margin + (size[0] - 1) / 2, margin + EYE_LEVEL * size[1]),
    )
    x, y = face.grid(width, height, FINE)
    picture = _brought_upright(photograph, marks, x, y)
    above, below = slit_distances(face, width, height)
    seam = face.origin_px[1] + face.unit_px * sum(SEAM) / 2
    labels = np.full(x.shape, LABELS.index("skin"), np.uint8)
    return Actor(
        size=size,
        margin=margin,
        geometry=face,
        skin=_closed_over(picture, face, x, y),
        above=above,
        below=below,
        creases=_shares(CREASE_NAMES, marks.creases)[:, None, None] * crease_maps(face, x, y),
        basis=_shares(BASIS_NAMES, marks.reach)[:, None, None, None] * basis_fields(face, width, height),
        interior=_interior(picture, marks, face, x, y),
        labels=picture_labels(labels, size, margin, above, below, seam),
        identity=None,
    )


def _shares(names: tuple[str, ...], given: Mapping[str, float]) -> AnyArray:
    return np.array([given.get(name, 1.0) for name in names], np.float32)


def _brought_upright(photograph: Image, marks: PortraitMarks, x: AnyArray, y: AnyArray) -> AnyArray:
    right, left = np.asarray(marks.right_pupil), np.asarray(marks.left_pupil)
    middle, across = (right + left) / 2, (left - right) / 0.9
    photo_x = middle[0] + across[0] * x - across[1] * y
    photo_y = middle[1] + across[1] * x + across[0] * y
    picture = cv2.remap(
        photograph,
        photo_x.astype(np.float32),
        photo_y.astype(np.float32),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REFLECT,
    )
    return np.asarray(np.clip(picture, 0, 1), np.float32)


def _closed_over(picture: AnyArray, face: FaceGeometry, x: AnyArray, y: AnyArray) -> AnyArray:
    """Carry the skin's colour at the margins over the slits, so that no tooth shines through skin."""
    skin = picture.copy()
    fine = float(x[0, 1] - x[0, 0])
    px = (x - float(x[0, 0])) / fine
    for slit in (face.right_eye, face.left_eye, face.mouth):
        upper, lower = slit.upper(x) - 1.2 * fine, slit.lower(x) + 1.2 * fine
        hole = (np.abs(slit.along(x)) < 1) & (y > upper) & (y < lower)
        near_y = np.where(y - upper < lower - y, upper, lower)
        py = (near_y - float(y[0, 0])) / fine
        carried = cv2.remap(picture, px.astype(np.float32), py.astype(np.float32), cv2.INTER_LINEAR)
        skin[hole] = carried[hole]
    return skin


def _interior(
    picture: AnyArray, marks: PortraitMarks, face: FaceGeometry, x: AnyArray, y: AnyArray
) -> Interior:
    rng = np.random.default_rng(1)
    fine = float(x[0, 1] - x[0, 0])
    sclera = np.zeros_like(picture)
    irises = []
    for eye, at in ((face.right_eye, face.right_iris), (face.left_eye, face.left_iris)):
        shown = _shown(eye, x, y, fine)
        r = np.hypot(x - at[0], y - at[1]) / face.iris_radius
        near = (np.abs(x - eye.centre[0]) < 2 * eye.half_width) & (np.abs(y - eye.centre[1]) < 0.4)
        white = 0.88 * paint_sclera(eye, x, y, rng)
        photo_share = (shown * smooth((r - 1.08) / 0.12))[..., None]
        sclera = np.where(near[..., None], white + (picture - white) * photo_share, sclera)
        painted = paint_iris(at, face.iris_radius, marks.iris, -1.0, x, y, fine, rng)
        cover = painted[..., 3]
        plain = painted[..., :3] / np.maximum(cover, 1e-3)[..., None]
        irises.append(layered(plain + (picture - plain) * shown[..., None], cover))
    mouth = face.mouth
    shown = _shown(mouth, x, y, fine)
    edge = mouth.lower(x) - 0.004
    row = smooth((x - marks.teeth[0]) / 0.03) * smooth((marks.teeth[1] - x) / 0.03)
    cover = np.clip((edge - y) / (1.5 * fine) + 0.5, 0, 1) * row
    first_y = np.maximum(y, mouth.upper(x) + 0.030)
    carried = cv2.remap(
        picture,
        ((x - float(x[0, 0])) / fine).astype(np.float32),
        ((first_y - float(y[0, 0])) / fine).astype(np.float32),
        cv2.INTER_LINEAR,
    )
    gum = smooth((mouth.upper(x) - 0.015 - y) / 0.02)[..., None]
    hidden = carried + (np.array([0.70, 0.42, 0.40]) - carried) * gum
    teeth = hidden + (picture - hidden) * shown[..., None]
    dark = 1.5 * paint_cavity(face, x, y)
    outside_teeth = (shown * (1 - smooth(blurred(row.astype(np.float32), 1.0))))[..., None]
    return Interior(
        sclera=sclera.astype(np.float32),
        right_iris=irises[0],
        left_iris=irises[1],
        cavity=(dark + (picture - dark) * outside_teeth).astype(np.float32),
        upper_teeth=layered(teeth, cover),
        lower_teeth=paint_teeth(face, x, y, fine, rng, "lower")
        * np.array([1.18, 1.12, 1.06, 1.0], np.float32),
        tongue=paint_tongue(face, x, y, rng),
        lid_shadow=0.0,
        lip_shadow=0.0,
    )


def _shown(slit: Aperture, x: AnyArray, y: AnyArray, fine: float) -> AnyArray:
    """Compute how much the photograph shows what is behind a slit: 1 well inside it."""
    depth = np.minimum(y - slit.upper(x), slit.lower(x) - y) * (np.abs(slit.along(x)) < 1)
    return np.asarray(np.clip(depth / (1.5 * fine), 0.0, 1.0))
