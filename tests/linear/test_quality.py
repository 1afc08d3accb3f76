"""Laws of the errors of pictures and flows: truth from algebra and from scikit-image."""

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from morphspace.errors import SizeMismatch
from morphspace.grid import warp
from morphspace.linear.quality import (
    angular_error_deg,
    endpoint_error,
    flow_errors,
    forward_backward_px,
    photometric_rmse,
    psnr_db,
    rms_px,
    ssim,
    stays_inside,
)

HEIGHT, WIDTH = 40, 50
EVERYWHERE = np.ones((HEIGHT, WIDTH), np.float32)


def left_half():
    mask = EVERYWHERE.copy()
    mask[:, WIDTH // 2 :] = 0
    return mask


def test_psnr_of_a_constant_difference_is_its_logarithm(picture):
    image = picture(HEIGHT, WIDTH)  # in [0.1, 0.9]
    assert psnr_db(image + np.float32(0.1), image, EVERYWHERE) == pytest.approx(20, abs=1e-4)
    assert psnr_db(image - np.float32(0.01), image, EVERYWHERE) == pytest.approx(40, abs=1e-3)


def test_psnr_is_that_of_scikit_image(picture):
    one, other = picture(HEIGHT, WIDTH, 1), picture(HEIGHT, WIDTH, 2)
    theirs = peak_signal_noise_ratio(other.astype(np.float64), one.astype(np.float64), data_range=1.0)
    assert psnr_db(one, other, EVERYWHERE) == pytest.approx(theirs, abs=1e-4)


def test_equal_pictures_have_a_finite_psnr(picture):
    image = picture(HEIGHT, WIDTH)
    assert psnr_db(image, image, EVERYWHERE) == pytest.approx(120)


def test_pictures_are_compared_after_clipping():
    white = np.ones((HEIGHT, WIDTH, 3), np.float32)
    assert psnr_db(white * 1.5, white, EVERYWHERE) == pytest.approx(120)
    assert psnr_db(white * -0.5, white * 0, EVERYWHERE) == pytest.approx(120)
    assert ssim(white * 1.5, white, EVERYWHERE) == pytest.approx(1)


def test_pixels_outside_the_mask_do_not_count(picture):
    image = picture(HEIGHT, WIDTH)
    other = image + np.float32(0.05)
    other[:, WIDTH // 2 :] = 0
    assert psnr_db(other, image, left_half()) == pytest.approx(-20 * np.log10(0.05), abs=1e-4)
    field = np.full((HEIGHT, WIDTH, 2), 100.0, np.float32)
    field[:, : WIDTH // 2] = (3.0, 4.0)
    assert rms_px(field, left_half()) == pytest.approx(5)


def test_the_mask_weighs(picture):
    image = picture(HEIGHT, WIDTH)
    other = image.copy()
    other[:, : WIDTH // 2] += 0.1
    mask = np.where(left_half() > 0, np.float32(0.25), np.float32(0.75))
    assert psnr_db(other, image, mask) == pytest.approx(-10 * np.log10(0.25 * 0.01), abs=1e-3)


def test_ssim_is_one_for_equal_pictures_and_symmetric(picture):
    one, other = picture(HEIGHT, WIDTH, 1), picture(HEIGHT, WIDTH, 2)
    assert ssim(one, one, EVERYWHERE) == pytest.approx(1)
    assert ssim(one, other, EVERYWHERE) == pytest.approx(ssim(other, one, EVERYWHERE))
    assert ssim(one, other, EVERYWHERE) < 0.5


def test_ssim_with_a_full_mask_is_the_mean_of_scikit_images_map(picture):
    one = picture(HEIGHT, WIDTH, 1)
    other = one + 0.05 * picture(HEIGHT, WIDTH, 2, 1.0)
    _, local = structural_similarity(
        one,
        other,
        data_range=1.0,
        channel_axis=2,
        gaussian_weights=True,
        use_sample_covariance=False,
        full=True,
    )
    assert ssim(other, one, EVERYWHERE) == pytest.approx(local.mean(), abs=1e-5)
    half = left_half()
    assert ssim(other, one, half) == pytest.approx(local[:, : WIDTH // 2].mean(), abs=1e-5)


def test_an_empty_mask_gives_finite_figures(picture):
    nothing = EVERYWHERE * 0
    one, other = picture(HEIGHT, WIDTH, 1), picture(HEIGHT, WIDTH, 2)
    assert np.isfinite([psnr_db(one, other, nothing), ssim(one, other, nothing)]).all()
    assert rms_px(np.ones((HEIGHT, WIDTH, 2), np.float32), nothing) == 0


# flow


def constant(u, v, height=HEIGHT, width=WIDTH):
    return np.broadcast_to(np.array([u, v], np.float32), (height, width, 2)).copy()


def test_the_end_point_error_of_a_shift_is_its_length(wavy_field):
    truth = wavy_field(HEIGHT, WIDTH, 6.0)
    assert endpoint_error(truth + constant(3, -4), truth) == pytest.approx(5, abs=1e-5)  # px, float32
    assert endpoint_error(truth, truth).max() == 0


def test_the_angular_error_is_the_angle_between_the_vectors_in_space_and_time(wavy_field):
    one, other = wavy_field(HEIGHT, WIDTH, 5.0, 1), wavy_field(HEIGHT, WIDTH, 5.0, 2)
    a, b = (np.dstack([field, np.ones((HEIGHT, WIDTH))]).astype(np.float64) for field in (one, other))
    cosine = (a * b).sum(axis=2) / np.linalg.norm(a, axis=2) / np.linalg.norm(b, axis=2)
    np.testing.assert_allclose(angular_error_deg(one, other), np.degrees(np.arccos(cosine)), atol=1e-4)
    assert angular_error_deg(constant(0, 0), constant(0, 1)) == pytest.approx(45)
    assert angular_error_deg(constant(1, 0), constant(-1, 0)) == pytest.approx(90)


def test_small_angles_are_not_lost():
    tilt = float(np.float32(3e-7))  # px on a zero field: an angle of as many radians
    assert angular_error_deg(constant(tilt, 0), constant(0, 0)) == pytest.approx(np.degrees(tilt), rel=1e-6)


def test_the_forward_backward_error_is_zero_for_inverse_fields_and_the_field_for_a_zero_backward_flow(
    wavy_field,
):
    forward = constant(3, -2)
    assert forward_backward_px(forward, -forward).max() == 0
    ramp = warp.affine_displacement(np.array([[1.1, 0.0, 0.0], [0.0, 1.0, 0.0]]), HEIGHT, WIDTH)  # v = 0.1 x
    expected = 3 + 0.1 * (np.arange(WIDTH - 3) + 3)  # the backward flow is read at p + u(p)
    np.testing.assert_allclose(forward_backward_px(constant(3, 0), ramp)[7, : WIDTH - 3], expected, rtol=1e-5)
    field = wavy_field(HEIGHT, WIDTH, 4.0)
    np.testing.assert_allclose(
        forward_backward_px(field, field * 0), np.hypot(field[..., 0], field[..., 1]), rtol=1e-6
    )
    inside = stays_inside(field, HEIGHT, WIDTH)
    error = forward_backward_px(field, warp.invert(field))[inside]
    assert (
        np.quantile(error, 0.95) < 0.02
    )  # px; the inverse is exact at pixels and read linearly between them


def test_points_moved_off_the_picture_are_outside():
    inside = stays_inside(constant(2.6, 0), HEIGHT, WIDTH)
    assert inside[:, : WIDTH - 3].all() and not inside[:, WIDTH - 3 :].any()
    inside = stays_inside(constant(0, -1.4), HEIGHT, WIDTH)
    assert inside[1:].all() and not inside[0].any()


@pytest.mark.parametrize("mark", [1e9, 1.666666752e9, 1.1e6, -1e10, np.inf, np.nan])
def test_unknown_truth_does_not_count(mark):
    truth = constant(1, 0)
    field = truth + constant(0.5, 0)
    field[0] += 2  # rows of outliers: one known, one not
    field[1] += 2
    truth[1, :, 1] = mark
    figures = flow_errors(field, truth)
    rows = HEIGHT - 1
    assert figures.r1_percent == pytest.approx(100 / rows)
    assert figures.aee_px == pytest.approx((0.5 * (rows - 1) + np.hypot(2.5, 2)) / rows)
    assert np.isfinite(figures.aae_deg)


def test_an_unknown_truth_gives_nan():
    figures = flow_errors(constant(0, 0), constant(1e9, 1e9))
    assert np.isnan([figures.aee_px, figures.aae_deg, figures.r1_percent]).all()


def test_fields_of_other_sizes_are_not_compared():
    for measure in (endpoint_error, angular_error_deg, flow_errors):
        with pytest.raises(SizeMismatch, match=r"50x40 .* 40x50"):
            measure(constant(0, 0), constant(0, 0, 50, 40))


def test_the_photometric_error_of_a_constant_difference_is_that_difference(picture):
    image = picture(HEIGHT, WIDTH)
    step = np.float32(10 / 255)
    assert photometric_rmse(image - step, image, EVERYWHERE) == pytest.approx(10, abs=1e-4)
    assert photometric_rmse(image[..., 0] - step, image[..., 0], EVERYWHERE) == pytest.approx(10, abs=1e-4)
    half = left_half()
    other = np.where(half[..., None] > 0, image - step, image)
    assert photometric_rmse(other, image, half) == pytest.approx(10, abs=1e-4)
    assert photometric_rmse(other, image, 1 - half) == 0
    assert photometric_rmse(image, image * 0, EVERYWHERE * 0) == 0
