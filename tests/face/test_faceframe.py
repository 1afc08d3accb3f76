"""Laws of framing, registration and the ellipses: truth from drawn movements and from pictures of coordinates."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame, aligned, identity_affine
from morphspace.grid import warp
from morphspace.io.framing import Framing

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
    with pytest.raises(BadInput, match="inside the image of 100x100"):
        Framing((100, 100), crop, (40, 40))


def test_frames_too_small_for_a_face_are_refused():
    with pytest.raises(BadInput, match="at least 32x32 for a face"):
        Framing((100, 100), None, (31, 200))


# alignment


def test_an_aligned_frame_shows_at_p_what_the_image_has_at_a_p(picture):
    image, movement = picture(HEIGHT, WIDTH, sd_px=3.0), np.array([[1.0, 0.0, 4.0], [0.0, 1.0, -3.0]])
    frame = aligned(image, "some", movement)
    assert frame.name == "some"
    assert_array_equal(frame.registration, movement)
    assert_allclose(frame.image[3:, :-4], image[:-3, 4:], atol=1e-5)
    assert aligned(image, "some", identity_affine()).image is image


def test_the_points_of_a_faceframe_come_in_order():
    faceframe = FaceFrame((1.0, 2.0), (3.0, 4.0), (5.0, 6.0))
    assert_array_equal(faceframe.points, [[1, 2], [3, 4], [5, 6]])
    moved = FaceFrame.at(faceframe.points + 1)
    assert (moved.right_eye, moved.left_eye, moved.philtrum) == ((2, 3), (4, 5), (6, 7))


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ([[20, 30], [np.nan, 30], [30, 44]], "expected three points"),
        ([[20, 30], [np.inf, 30], [30, 44]], "expected three points"),
        ([[20, 30], [20, 30], [30, 44]], "both eyes at 20,30"),
    ],
)
def test_a_faceframe_of_no_face_is_refused_by_its_constructor(points, said):
    with pytest.raises(BadInput, match=said):
        FaceFrame.at(np.array(points, np.float64))
