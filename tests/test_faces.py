"""Laws of framing, registration and the ellipses: truth from drawn movements and from pictures of coordinates."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from morphspace import faces, warp
from morphspace.errors import BadInput
from morphspace.faces import (
    FaceFrame,
    Framing,
    aligned,
    face_mask,
    identity_affine,
    register,
    rigid_region,
)
from morphspace.flow.baselines import dis_medium, grey_codes

HEIGHT, WIDTH = 120, 96


# framing


def coordinates(width, height):
    """A picture whose red is x and whose green is y."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


@pytest.mark.parametrize(
    ("source_size", "crop", "size"),
    [
        ((64, 80), None, (64, 80)),
        ((100, 90), (11, 7, 64, 80), (64, 80)),
        ((200, 160), None, (40, 48)),  # shrinks, cut left and right
        ((160, 300), (20, 30, 120, 200), (60, 50)),  # shrinks, cut above and below
        ((50, 61), None, (75, 90)),  # grows
        ((150, 150), (30, 10, 99, 101), (48, 49)),  # factors that are no whole numbers
    ],
)
def test_a_framed_point_shows_the_source_point_it_is_mapped_to(source_size, crop, size):
    framing = Framing(source_size, crop, size)
    framed = framing.apply(coordinates(*source_size))
    assert framed.shape == (size[1], size[0], 3)
    y, x = np.mgrid[: size[1], : size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    expected = warp.apply_affine(framing.to_source, points).reshape(size[1], size[0], 2)
    inside = np.s_[3:-3, 3:-3]  # enlarging repeats the edge
    # a shrunk pixel averages whole source pixels: up to 0.25 px; OpenCV's cubic bends a ramp by 0.1 px
    assert_allclose(framed[..., :2][inside], expected[inside], atol=0.25)
    assert np.abs((framed[..., :2] - expected)[inside].mean(axis=(0, 1))).max() < 0.05


def test_framing_without_crop_or_change_of_size_changes_nothing(picture):
    image = picture(50, 40)
    framing = Framing((40, 50), None, (40, 50))
    assert_array_equal(framing.apply(image), image)
    assert_allclose(framing.to_source, identity_affine(), atol=1e-12)


def test_a_crop_of_the_model_size_is_cut_out_and_nothing_else(picture):
    image = picture(90, 100)
    framing = Framing((100, 90), (11, 7, 40, 50), (40, 50))
    assert_array_equal(framing.apply(image), image[7:57, 11:51])
    assert_allclose(framing.to_source, [[1, 0, 11], [0, 1, 7]], atol=1e-12)


@pytest.mark.parametrize("size", [(40, 48), (48, 40), (64, 33), (33, 64)])
def test_the_scaled_crop_covers_the_frame_with_the_least_cut_off(size):
    framing = Framing((210, 170), (5, 6, 150, 120), size)
    assert min(framing.cut_off) == 0
    assert framing.scaled_size[0] >= size[0]
    assert framing.scaled_size[1] >= size[1]
    aspect = framing.scaled_size[0] / framing.scaled_size[1]
    assert aspect == pytest.approx(150 / 120, rel=0.5 / min(framing.scaled_size) * 2)


def test_what_is_cut_off_is_taken_from_both_sides():
    framing = Framing((200, 100), None, (50, 50))
    left, right = warp.apply_affine(framing.to_source, np.array([[-0.5, 0.0], [49.5, 0.0]]))[:, 0]
    assert left == pytest.approx(49.5)
    assert right == pytest.approx(149.5)


@pytest.mark.parametrize(
    "crop",
    [(-1, 0, 50, 50), (0, -1, 50, 50), (51, 0, 50, 50), (0, 51, 50, 50), (0, 0, 0, 50), (0, 0, 50, -5)],
)
def test_a_crop_that_leaves_the_image_is_refused(crop):
    with pytest.raises(BadInput, match=r"leaves the image of 100x100"):
        Framing((100, 100), crop, (40, 40))


def test_frames_too_small_for_a_face_are_refused():
    with pytest.raises(BadInput, match="too small"):
        Framing((100, 100), None, (31, 200))


# registration


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

    monkeypatch.setattr(faces, "dis_of_codes", flow)
    image = picture(HEIGHT, WIDTH)
    found = register(image, image, "similarity", rigid_region(HEIGHT, WIDTH))
    # reference(p) = aligned(second p) = image(first second p)
    assert_allclose(found, warp.chain_affine(*steps), atol=1e-4)
    assert_allclose(seen[1], grey_codes(aligned(image, "", steps[0]).image).astype(int), atol=1)  # of 255


def test_flow_of_codes_is_the_flow_of_their_pictures(picture):
    one, other = picture(HEIGHT, WIDTH, seed=1), picture(HEIGHT, WIDTH, seed=2)
    assert np.array_equal(faces.dis_of_codes(grey_codes(one), grey_codes(other)), dis_medium(one, other))


@pytest.mark.parametrize(
    ("off_px", "hopeless", "flows"), [(0.2, np.inf, 2), (2.0, np.inf, 3), (60.0, faces.HOPELESS, 2)]
)
def test_a_start_that_leads_nowhere_else_costs_no_second_search(
    picture, monkeypatch, off_px, hopeless, flows
):
    """Near the place that was found it is that place; from farther one pass leads there; far off it is hopeless."""
    movement = similarity(3.0, 1.02, (2.0, -1.0))
    reference, image = moved_picture(picture, movement)
    region = rigid_region(HEIGHT, WIDTH)
    alone = register(reference, image, "similarity", region)
    calls, find = [], faces.dis_of_codes
    monkeypatch.setattr(faces, "HOPELESS", hopeless)
    monkeypatch.setattr(faces, "dis_of_codes", lambda *codes: calls.append(1) or find(*codes))
    start = alone + np.array([[0, 0, off_px], [0, 0, 0]])
    assert np.array_equal(register(reference, image, "similarity", region, start), alone)
    assert len(calls) == flows


def test_a_movement_that_is_no_number_is_refused(picture, monkeypatch):
    monkeypatch.setattr(faces, "dis_of_codes", lambda one, other: np.full((HEIGHT, WIDTH, 2), np.nan))
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


def test_an_aligned_frame_shows_at_p_what_the_image_has_at_a_p(picture):
    image, movement = picture(HEIGHT, WIDTH, sd_px=3.0), np.array([[1.0, 0.0, 4.0], [0.0, 1.0, -3.0]])
    frame = aligned(image, "some", movement)
    assert frame.name == "some"
    assert_array_equal(frame.registration, movement)
    assert_allclose(frame.image[3:, :-4], image[:-3, 4:], atol=1e-5)
    assert aligned(image, "some", identity_affine()).image is image


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


def test_a_tilted_faceframe_tilts_its_ellipse():
    upright = FaceFrame((35.0, 50.0), (61.0, 50.0), (48.0, 76.0))
    turn = similarity(20.0, 1.0, (0.0, 0.0))
    tilted = upright.moved(warp.apply_affine(turn, upright.points))
    back = warp.sample_field(
        rigid_region(HEIGHT, WIDTH, tilted)[..., None], warp.affine_displacement(turn, HEIGHT, WIDTH)
    )
    # the linear look-up cuts the corner where the ramp of 0.34 a px begins
    assert_allclose(np.squeeze(back), rigid_region(HEIGHT, WIDTH, upright), atol=0.09)


def test_the_points_of_a_faceframe_come_in_order():
    faceframe = FaceFrame((1.0, 2.0), (3.0, 4.0), (5.0, 6.0))
    assert_array_equal(faceframe.points, [[1, 2], [3, 4], [5, 6]])
    moved = faceframe.moved(faceframe.points + 1)
    assert (moved.right_eye, moved.left_eye, moved.philtrum) == ((2, 3), (4, 5), (6, 7))
