"""What our constants do to measures of drawn faces: each figure moves when its constant is ten times as large.

The truth of a drawn face is exact. A comment gives what a figure becomes with a tenth and with ten times the constant.
`registration.ANCHORS` and `STILL_PX` have no figure: they save time, and move no eye by 1 % of its error.
"""

import numpy as np
import pytest

from morphspace.face import regions
from morphspace.face.anchor import HELD, spline_from
from morphspace.face.crop import _head_crop
from morphspace.face.expression import distance_from_neutral, lid_opening
from morphspace.face.mesh import LANDMARKS, LEFT_LIDS, RIGHT_LIDS
from morphspace.face.registration import Registration, fitted_similarity
from morphspace.grid import warp

CLOSED = ("lid_close_right", "lid_close_left")
RAISED = ("brow_outer_raise", "brow_inner_raise")
SMILE = {"jaw_open": 0.5, "lip_corner_up": 0.8, **dict.fromkeys(RAISED, 0.7)}
MOVED = np.array([[1.02, -0.05, 2.6], [0.05, 1.02, -1.4]])  # turned by 3 degrees, enlarged, and shifted
HEIGHT, WIDTH = 96, 80


def off_px(movement, points):
    return np.hypot(*(warp.apply_affine(movement, points) - warp.apply_affine(MOVED, points)).T).mean()


def expressions(anna):
    """Distances from neutral in steps, and the opening of lids in px."""
    faces = [anna.points(jaw_open=0.1 * n, lip_corner_up=0.05 * n) for n in range(5)]
    faces += [anna.points(**dict.fromkeys(CLOSED, 0.6)), anna.points(**SMILE)]
    far = distance_from_neutral(faces)
    lids = [lid_opening(faces[0].points[list(ring)]) for ring in (RIGHT_LIDS, LEFT_LIDS)]
    yield from zip(("closed mouth", "closed lids", "smile"), far[[0, 5, 6]], strict=True)
    yield "lids", np.mean(lids)


def splines(anna):
    """How far the held points are missed, and how jagged the field is at its edge, px / 1000."""
    rest, smiling = (anna.points(**actions).points[list(HELD)] for actions in ({}, SMILE))
    field = spline_from(rest, HEIGHT, WIDTH)(smiling)
    yield "spline misses", 1000 * np.hypot(*(warp.move_points(field, rest) - smiling).T).mean()
    yield "spline at the edge", 1000 * np.abs(np.diff(field[0], 2, axis=0)).mean()


def registrations(anna):
    """Errors of a smiling head's movement at the eyes, px."""
    back = warp.affine_displacement(warp.inverse_affine(MOVED), HEIGHT, WIDTH)
    image = warp.sample(anna.picture(**SMILE), back)
    registration = Registration(anna.picture(), "similarity", regions.rigid_region(HEIGHT, WIDTH))
    eyes = anna.points().faceframe().points[:2]
    for name, start in (
        ("registered", None),
        ("from a start", np.add(MOVED, [[0, 0, 1.0], [0, 0, -1.0]])),
        ("from a wrong start", np.add(MOVED, [[0, 0, 9.0], [0, 0, -9.0]])),
    ):
        yield name, off_px(registration.of(image, start), eyes)
    rest, smiling = (anna.points(**actions).points[list(HELD)] for actions in ({}, SMILE))
    yield "by held points", off_px(fitted_similarity(rest, warp.apply_affine(MOVED, smiling)), eyes)


def masks(anna):
    """Areas and soft edges as shares of the picture, and middles in px down."""
    frame = anna.model.faceframe
    points = np.asarray(anna.model.provenance["keypoints"]["points"])[list(LANDMARKS)]
    drawn = {}
    for name, made in (
        ("face", regions.face_mask),
        ("rigid", regions.rigid_region),
        ("mouth", regions.mouth_surroundings),
    ):
        drawn[name], drawn[f"placed {name}"] = made(HEIGHT, WIDTH), made(HEIGHT, WIDTH, frame)
    for name in regions.REGIONS[1:]:
        drawn[f"part {name}"] = regions.region_mask(name, HEIGHT, WIDTH, frame)
        drawn[f"marked {name}"] = regions.region_mask(name, HEIGHT, WIDTH, frame, points)
    down = np.arange(HEIGHT)[:, None]
    for name, mask in drawn.items():
        yield name, 100 * mask.mean()
        yield f"{name}, middle", (mask * down).sum() / mask.sum()
        yield f"{name}, edge", 100 * (mask * (1 - mask)).mean()


@pytest.fixture(scope="module")
def figures(drawn_anna):
    rooms = (expressions, splines, registrations, masks)
    return {name: float(value) for figures in rooms for name, value in figures(drawn_anna)}


EXPECTED = {
    "closed mouth": 1.8,  # steps; expression.PARTED: 0.969, 35.5; CLOSED_STEP: 17.3, 0.539; SHAPE_STEP: 5.39
    "closed lids": 3.898,  # expression.LID_STEP: 34.4, 1.87; LID_PAIRS: 3.61, 2.82
    "smile": 2.522,  # expression.OPEN_STEP: 21.7, 1.31
    "lids": 3.966,  # px; expression.LID_PAIRS: 4.09, 3.16
    "spline misses": 134.5,  # px / 1000; anchor.STEP_PX, STEP_SHARE x 10, ONE_PLACE_PX
    "spline at the edge": 0.8059,  # px / 1000; anchor.MARGIN 1
    "registered": 0.3049,  # px; registration.PASSES 1: 0.409; ROBUST_PASSES 1: 1.17; SCALE_FLOOR_PX x 10: 0.841
    "from a start": 0.3541,  # px; registration.SURROUNDINGS: 0.289 to 0.412; CONFIRMED, NOT_WORSE / 10: 0.305; CORNERS
    "from a wrong start": 0.3049,  # px; registration.CLEARLY_ALIKE x 10: 9.2
    "by held points": 0.2875,  # px; registration.SCALE_FLOOR_PX
    "face": 48.91,  # %; regions.FACE_ELLIPSE
    "face, middle": 49.92,  # px
    "face, edge": 2.441,  # %; regions.SOFT_EDGE
    "placed face": 44.89,  # regions.FACE_FROM_FACEFRAME
    "placed face, middle": 54.42,
    "rigid": 16.15,  # regions.RIGID_ELLIPSE
    "rigid, middle": 46.08,
    "placed rigid": 13.47,  # regions.RIGID_FROM_FACEFRAME
    "placed rigid, middle": 46.59,
    "mouth": 6.58,  # regions.MOUTH_ELLIPSE
    "mouth, middle": 73.92,
    "placed mouth": 5.393,  # regions.MOUTH_FROM_FACEFRAME
    "placed mouth, middle": 71.09,
    "part eyes": 6.666,  # regions.ELLIPSES; SOFT; FINER
    "part eyes, middle": 43.61,
    "part eyes, edge": 1.024,
    "part brows": 6.653,
    "part brows, middle": 35.1,
    "part mouth": 6.491,
    "part mouth, middle": 71.78,
    "part nose": 4.537,  # regions.NOSE
    "part nose, middle": 53.65,
    "part upper": 55.18,  # regions.HALVES
    "part upper, edge": 1.096,
    "marked eyes": 6.141,  # regions.MARGINS
    "marked brows": 5.602,
    "marked mouth": 7.007,
}


@pytest.mark.parametrize(("name", "expected"), EXPECTED.items())
def test_drawn_faces_measured(figures, name, expected):
    assert figures[name] == pytest.approx(expected, rel=0.01)


def test_the_crop_of_a_drawn_head(drawn_anna):
    """The room above, below and beside the eyes; of a path of 80 px the middle 5 to 95 % count."""
    face = drawn_anna.points()
    eyes_px, (across, down) = face.interocular_px, 1400 + face.faceframe().points[:2].mean(axis=0)
    path = [face.moved(np.add(face.points, (1400 + shift, 1400))) for shift in (0, 20, 40, 60, 80)]
    x, _, w, _ = _head_crop(path, (3000, 3000), 0.1)  # taller than the head needs
    _, y, _, h = _head_crop(path, (3000, 3000), 3.0)  # wider
    assert (x, w) == pytest.approx((across + 4 - 1.75 * eyes_px, 72 + 3.5 * eyes_px), abs=1)
    assert (y, h) == pytest.approx((down - 1.95 * eyes_px, 4.3 * eyes_px), abs=1)


def test_the_usual_mask_is_kept_unless_the_face_lies_aside(drawn_anna):
    """OVERLAP, of both ellipses: 0.5 and 0.7 are reached 15 and 7 px aside."""
    face = drawn_anna.points()
    kept = [
        regions.place_of_mask(face.moved(np.add(face.points, (aside, 0))), HEIGHT, WIDTH)
        for aside in (11, 12)
    ]
    assert kept[0] is None and kept[1] is not None
