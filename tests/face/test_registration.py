"""Laws of registration: drawn movements are found, from any start that a detector might give."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from morphspace.errors import BadInput
from morphspace.face import registration
from morphspace.face.faceframe import aligned, identity_affine
from morphspace.face.regions import rigid_region
from morphspace.face.registration import Registration, register
from morphspace.flow.baselines import dis_medium, grey_codes
from morphspace.grid import warp

HEIGHT, WIDTH = 120, 96


def similarity(degrees, scale, shift):
    """A similarity about the middle of the picture."""
    angle = np.deg2rad(degrees)
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    return np.column_stack([linear, middle - linear @ middle + shift])


def on_large_canvas(picture, seed=3):
    """A texture that reaches beyond the frame, as a function of points (..., 2) px of the frame."""
    margin = 40
    canvas = picture(HEIGHT + 2 * margin, WIDTH + 2 * margin, seed=seed, sd_px=2.5).astype(np.float64)
    planes = [ndimage.spline_filter(canvas[..., c], order=3) for c in range(3)]

    def look(points):
        at = points[..., 1] + margin, points[..., 0] + margin
        return np.stack(
            [ndimage.map_coordinates(plane, at, order=3, prefilter=False) for plane in planes], axis=-1
        ).astype(np.float32)

    return look


def frame_points():
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return np.stack([x, y], axis=-1)


def rigid_miss_px(found, truth):
    """The largest distance between the two movements over the rigid part of the face."""
    y, x = np.nonzero(rigid_region(HEIGHT, WIDTH) > 0.5)
    points = np.column_stack([x, y]).astype(np.float64)
    return np.hypot(*(warp.apply_affine(found, points) - warp.apply_affine(truth, points)).T).max()


MOVEMENTS = [
    similarity(0, 1.0, (3.0, -2.0)),
    similarity(4.0, 1.0, (0.0, 0.0)),
    similarity(-3.0, 1.05, (-2.0, 1.5)),
    similarity(-8.0, 0.92, (6.0, 5.0)),  # one pass alone misses it by 0.1 px
]


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_registration_finds_a_known_similarity(picture, movement):
    look = on_large_canvas(picture)
    reference = look(frame_points())
    image = look(warp.apply_affine(warp.inverse_affine(movement), frame_points()))
    found = register(reference, image, "similarity", rigid_region(HEIGHT, WIDTH))
    assert rigid_miss_px(found, movement) < 0.05  # px
    assert found[0, 0] == pytest.approx(found[1, 1])
    assert found[0, 1] == pytest.approx(-found[1, 0])


@pytest.mark.parametrize("movement", MOVEMENTS)
def test_registration_follows_the_skull_when_the_mouth_moves_otherwise(picture, movement):
    look = on_large_canvas(picture)
    points = frame_points()
    reference = look(points)
    still = warp.apply_affine(warp.inverse_affine(movement), points)
    jaw = 6.0 * np.clip((points[..., 1] - 0.62 * HEIGHT) / (0.15 * HEIGHT), 0, 1)  # px down, below the nose
    image = look(still - jaw[..., None] * (0.0, 1.0))
    found = register(reference, image, "similarity", rigid_region(HEIGHT, WIDTH))
    assert rigid_miss_px(found, movement) < 0.1  # px


def test_a_later_pass_is_done_on_the_frame_as_the_earlier_ones_left_it(picture, monkeypatch):
    steps = [similarity(20.0, 1.2, (4.0, 0.0)), similarity(0.0, 1.0, (0.0, 9.0))]  # these do not commute
    left, seen = list(steps), []

    def flow(reference, frame):
        seen.append(frame)
        return warp.affine_displacement(left.pop(0), HEIGHT, WIDTH)

    monkeypatch.setattr(registration, "_dis_of_codes", flow)
    image = picture(HEIGHT, WIDTH)
    found = register(image, image, "similarity", rigid_region(HEIGHT, WIDTH))
    # reference(p) = aligned(second p) = image(first second p)
    assert_allclose(found, warp.chain_affine(*steps), atol=1e-4)
    assert_allclose(seen[1], grey_codes(aligned(image, "", steps[0]).image).astype(int), atol=1)  # of 255


def test_flow_of_codes_is_the_flow_of_their_pictures(picture):
    one, other = picture(HEIGHT, WIDTH, seed=1), picture(HEIGHT, WIDTH, seed=2)
    assert np.array_equal(
        registration._dis_of_codes(grey_codes(one), grey_codes(other)), dis_medium(one, other)
    )


def test_a_start_that_flow_confirms_is_all_that_is_looked_at(picture, monkeypatch):
    movement = similarity(3.0, 1.02, (2.0, -1.0))
    reference, image = moved_picture(picture, movement)
    region, seen, find = rigid_region(HEIGHT, WIDTH), [], registration._dis_of_codes
    monkeypatch.setattr(
        registration, "_dis_of_codes", lambda *codes: seen.append(codes[0].size) or find(*codes)
    )
    start = warp.chain_affine(movement, similarity(0.5, 1.0, (0.8, -0.6)))
    assert rigid_miss_px(register(reference, image, "similarity", region, start), movement) < 0.05  # px
    assert len(seen) == 2 and max(seen) < region.size


@pytest.mark.parametrize("off_px", [8.0, 60.0])
def test_a_start_that_flow_does_not_confirm_leaves_the_plain_way(picture, off_px):
    movement = similarity(3.0, 1.02, (2.0, -1.0))
    reference, image = moved_picture(picture, movement)
    region = rigid_region(HEIGHT, WIDTH)
    start = movement + np.array([[0, 0, off_px], [0, 0, 0]])
    assert_array_equal(
        register(reference, image, "similarity", region, start),
        register(reference, image, "similarity", region),
    )


def test_one_registration_serves_many_images(picture):
    images = [moved_picture(picture, movement)[1] for movement in MOVEMENTS[:2]]
    reference = moved_picture(picture, MOVEMENTS[0])[0]
    region = rigid_region(HEIGHT, WIDTH)
    kept = Registration(reference, "similarity", region)
    for image in images:
        assert_array_equal(kept.of(image), register(reference, image, "similarity", region))


def test_a_movement_that_is_no_number_is_refused(picture, monkeypatch):
    monkeypatch.setattr(registration, "_dis_of_codes", lambda one, other: np.full((HEIGHT, WIDTH, 2), np.nan))
    image = picture(HEIGHT, WIDTH)
    with pytest.raises(BadInput, match="not finite"), np.errstate(invalid="ignore"):
        register(image, image, "similarity", rigid_region(HEIGHT, WIDTH))


def test_affine_registration_finds_a_known_affine(picture):
    look = on_large_canvas(picture)
    linear = np.array([[1.04, 0.03], [-0.01, 0.97]])
    middle = np.array([WIDTH / 2, HEIGHT / 2])
    movement = np.column_stack([linear, middle - linear @ middle + (1.5, -1.0)])
    image = look(warp.apply_affine(warp.inverse_affine(movement), frame_points()))
    found = register(look(frame_points()), image, "affine", rigid_region(HEIGHT, WIDTH))
    assert rigid_miss_px(found, movement) < 0.1  # px


FAR = similarity(12.0, 1.1, (17.0, -12.0))  # more than flow bridges by itself in such a small picture


def moved_picture(picture, movement):
    look = on_large_canvas(picture)
    return look(frame_points()), look(warp.apply_affine(warp.inverse_affine(movement), frame_points()))


def test_a_start_that_is_nearly_right_finds_a_head_that_flow_alone_loses(picture):
    reference, image = moved_picture(picture, FAR)
    region = rigid_region(HEIGHT, WIDTH)
    assert rigid_miss_px(register(reference, image, "similarity", region), FAR) > 5  # px: lost
    start = warp.chain_affine(FAR, similarity(1.0, 1.01, (0.8, -0.6)))  # as exact as landmarks are
    assert rigid_miss_px(register(reference, image, "similarity", region, start), FAR) < 0.1  # px


def test_a_start_that_is_wrong_changes_nothing(picture):
    reference, image = moved_picture(picture, MOVEMENTS[0])
    region = rigid_region(HEIGHT, WIDTH)
    plain = register(reference, image, "similarity", region)
    assert_array_equal(register(reference, image, "similarity", region, FAR), plain)
    assert_array_equal(register(reference, image, "none", region, FAR), identity_affine())


def test_registration_none_moves_nothing(picture):
    one, other = picture(HEIGHT, WIDTH, 1), picture(HEIGHT, WIDTH, 2)
    assert_array_equal(register(one, other, "none", rigid_region(HEIGHT, WIDTH)), identity_affine())


@pytest.mark.parametrize("kind", ["similarity", "affine"])
def test_a_picture_registered_to_itself_does_not_move(picture, kind):
    image = picture(HEIGHT, WIDTH)
    assert_allclose(register(image, image, kind, rigid_region(HEIGHT, WIDTH)), identity_affine(), atol=1e-9)


def test_nothing_to_hold_on_to_moves_nothing(picture):
    flat = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    image = picture(HEIGHT, WIDTH)
    region = rigid_region(HEIGHT, WIDTH)
    assert_array_equal(register(flat, image, "similarity", region), identity_affine())
    assert_array_equal(
        register(image, image, "similarity", np.zeros((HEIGHT, WIDTH), np.float32)), identity_affine()
    )
