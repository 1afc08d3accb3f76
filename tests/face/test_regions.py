"""Laws of the masks of a face: ellipses by algebra, parts by where their names say they are."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import FACE_OUTLINE, LANDMARKS, LEFT_BROW, POINT_COUNT, RIGHT_BROW, RIGHT_LIDS
from morphspace.face.regions import (
    REGIONS,
    _disc,
    _polygon,
    face_mask,
    inside_outline,
    lips_region,
    mouth_surroundings,
    region_mask,
    rigid_region,
    skin_share,
    widened,
)
from morphspace.grid import warp

HEIGHT, WIDTH = 120, 96
SIZE = 72, 60
FRAME = FaceFrame((20.0, 28.0), (40.0, 29.0), (30.0, 44.0))


# ellipses


def test_masks_are_soft_ellipses_in_zero_to_one():
    for make in (face_mask, rigid_region):
        mask = make(HEIGHT, WIDTH)
        assert mask.shape == (HEIGHT, WIDTH)
        assert mask.dtype == np.float32
        assert mask.min() == 0
        assert mask.max() == 1
        assert ((mask > 0) & (mask < 1)).any()
    assert (rigid_region(HEIGHT, WIDTH) <= face_mask(HEIGHT, WIDTH)).all()


def test_the_ellipse_has_the_area_of_its_half_axes():
    mask = face_mask(240, 200)
    # half axes 0.37 w and 0.42 h; the soft edge gains as much as it loses, but for (0.15)^2 / 12
    assert mask.sum() == pytest.approx(np.pi * 0.37 * 200 * 0.42 * 240 * (1 + 0.15**2 / 12), rel=0.005)


def test_a_faceframe_carries_its_ellipse_along():
    faceframe = FaceFrame((35.0, 50.0), (61.0, 50.0), (48.0, 76.0))
    moved = FaceFrame((40.0, 43.0), (66.0, 43.0), (53.0, 69.0))
    for make in (face_mask, rigid_region):
        here, there = make(HEIGHT, WIDTH, faceframe), make(HEIGHT, WIDTH, moved)
        assert_allclose(there[: HEIGHT - 7, 5:], here[7:, : WIDTH - 5], atol=1e-6)


def similarity(degrees, scale, shift):
    """A similarity about the middle of the picture."""
    angle = np.deg2rad(degrees)
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    return np.column_stack([linear, middle - linear @ middle + shift])


def test_a_tilted_faceframe_tilts_its_ellipse():
    upright = FaceFrame((35.0, 50.0), (61.0, 50.0), (48.0, 76.0))
    turn = similarity(20.0, 1.0, (0.0, 0.0))
    tilted = FaceFrame.at(warp.apply_affine(turn, upright.points))
    back = warp.sample_field(
        rigid_region(HEIGHT, WIDTH, tilted)[..., None], warp.affine_displacement(turn, HEIGHT, WIDTH)
    )
    # the linear look-up cuts the corner where the ramp of 0.34 a px begins
    assert_allclose(np.squeeze(back), rigid_region(HEIGHT, WIDTH, upright), atol=0.09)


def test_the_surroundings_of_the_mouth_follow_the_faceframe():
    region = mouth_surroundings(100, 90, FaceFrame((30, 20), (50, 20), (40, 45)))
    y, x = np.nonzero(region)
    assert x.mean() == pytest.approx(40, abs=0.5)
    assert 45 < y.mean() < 70
    assert mouth_surroundings(100, 90, None).sum() > 0


# parts


def part(name, landmarks=None):
    return region_mask(name, *SIZE, FRAME, landmarks)


def test_the_halves_of_a_face_add_up_to_one_and_parts_join():
    masks = {name: part(name) for name in REGIONS}
    assert_allclose(masks["upper"] + masks["lower"], 1, atol=1e-6)
    assert_array_equal(part("eyes+mouth"), np.maximum(masks["eyes"], masks["mouth"]))
    for name, mask in masks.items():
        assert mask.shape == SIZE and mask.min() >= 0 and mask.max() <= 1 + 1e-6, name


def test_parts_lie_where_their_names_say():
    def at(name, point):
        x, y = (round(value) for value in point)
        return part(name)[y, x]

    below = (30, 53)  # the mouth: as far below the philtrum as usual
    assert at("eyes", FRAME.right_eye) > 0.99 and at("eyes", FRAME.left_eye) > 0.99
    assert at("mouth", below) > 0.99 and at("mouth", FRAME.right_eye) < 0.01
    assert at("eyes", below) < 0.01 and at("nose", (30, 38)) > 0.99
    assert at("brows", (20, 20)) > 0.99 and at("brows", below) < 0.01
    assert at("upper", FRAME.right_eye) > 0.9 > 0.1 > at("upper", below)


def test_known_landmarks_decide_where_the_eyes_are():
    """A lid ring of 8 px moved 12 px up the picture takes its part along, .12 of 20 px beyond its hull."""
    landmarks = np.full((len(LANDMARKS), 2), (40.0, 29.0))
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    landmarks[[LANDMARKS.index(place) for place in RIGHT_LIDS]] = np.column_stack(
        [20 + 4 * np.cos(turn), 16 + 4 * np.sin(turn)]
    )
    eyes = part("eyes", landmarks)
    assert eyes[16, 20] == eyes[16, 25] == 1  # the centre, and 1 px beyond the ring
    assert eyes[28, 20] < 0.01 < 0.99 < part("eyes")[28, 20]


def test_a_part_that_is_not_known_is_refused():
    with pytest.raises(BadInput, match="morphspace keypoints"):
        region_mask("eyes", *SIZE, None)
    with pytest.raises(BadInput, match="'ears'"):
        part("eyes+ears")
    assert region_mask("whole", *SIZE, None).all()


# masks of an avatar


def mesh_points():
    """Mesh points (478, 2) px in 80 x 96 px: the outline on an ellipse, the brows on a line, the rest in the middle."""
    points = np.tile([40.0, 48.0], (POINT_COUNT, 1))
    turn = 2 * np.pi * np.arange(len(FACE_OUTLINE)) / len(FACE_OUTLINE)
    points[list(FACE_OUTLINE)] = np.column_stack([40 + 30 * np.sin(turn), 48 - 36 * np.cos(turn)])
    for brow, left in ((RIGHT_BROW, 18.0), (LEFT_BROW, 46.0)):
        points[list(brow)] = np.column_stack(
            [np.linspace(left, left + 16, len(brow)), np.full(len(brow), 34.0)]
        )
    return points


def test_an_outline_is_filled_to_a_fraction_of_a_pixel():
    square = np.array([[10.0, 10], [30, 10], [30, 20.5], [10, 20.5]])
    inside = _polygon(square, 40, 50)
    assert inside[15, 20] == 1 and inside[5, 5] == 0 and inside.max() == 1
    assert inside.sum() == pytest.approx(22 * 12, rel=0.02)  # half a pixel of smooth edge on each side
    assert [_disc(radius).shape[0] for radius in (0.0, 1.0, 2.4, 2.6)] == [3, 3, 5, 7]


def test_the_blend_ends_inside_the_outline():
    """INSIDE_OUTLINE and OUTLINE_EDGE: half of the mask is left 0.04 of the width inside the outline."""
    line = inside_outline(mesh_points(), 96, 80)[48]
    assert line[40] == pytest.approx(1, abs=1e-3)
    half = np.interp(0.5, line[5:40], np.arange(5, 40))
    assert half == pytest.approx(10 + 0.04 * 80, abs=1.0)
    assert np.interp(0.84, line[5:40], np.arange(5, 40)) - half == pytest.approx(0.03 * 80, abs=0.4)  # an SD


def test_hair_is_what_is_dark_above_the_brows_against_the_persons_own_skin():
    """HAIR and SKIN: 0.65 and 0.85 of the median luma; between them a pixel is half hair."""
    mask = face_mask(96, 80)
    for shade, share in ((0.55, 0.0), (0.75, 0.5), (0.95, 1.0)):
        texture = np.full((96, 80, 3), 0.6, np.float32)
        texture[:20] = texture[70:75] = 0.6 * shade  # a forehead and a mouth
        found = skin_share(mesh_points(), texture, mask)
        assert_allclose(found[:15], share, atol=0.02)
        assert_allclose(found[38:], 1, atol=1e-3)
    assert (skin_share(mesh_points(), 0 * texture, mask) == 1).all()
    assert (skin_share(mesh_points(), texture, 0 * mask) == 1).all()


def test_the_region_of_the_lips_is_their_hull_widened():
    """AROUND_LIPS and LIPS_EDGE: 3 % of the width beyond the lips, with an edge of 1.5 %."""
    corners = np.array([[80.0, 60], [120, 60], [120, 80], [80, 80]])
    line = lips_region(corners, 160, 200)[70]
    assert line[100] == pytest.approx(1, abs=1e-3)
    assert np.interp(0.5, line[:100], np.arange(100)) == pytest.approx(80 - 0.03 * 200, abs=1.0)
    assert line[60] < 1e-3


def test_the_surroundings_of_a_mask_are_one_inside_and_fade_outside():
    """NEXT_TO_MASK: widened by 5 % of the width, and blurred by half of that."""
    mask = np.zeros((100, 100), np.float32)
    mask[40:60, 40:60] = 1
    wide = widened(mask)
    assert_allclose(wide[40:60, 40:60], 1, atol=1e-6)
    assert (wide >= mask).all()
    # The widened edge lies between 64 and 65, 0.2 SD before.
    assert wide[50, 65] == pytest.approx(0.42, abs=0.02)
    assert wide[50, 62] > 0.8 and wide[50, 75] < 0.01 and wide[10, 10] == 0
