"""Laws of the figures: truth from algebra and from scikit-image."""

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from morphspace.measure import psnr_db, rms_px, ssim

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


def test_pictures_are_compared_as_files_show_them():
    white = np.ones((HEIGHT, WIDTH, 3), np.float32)
    assert psnr_db(white * 1.5, white, EVERYWHERE) == pytest.approx(120)
    assert psnr_db(white * -0.5, white * 0, EVERYWHERE) == pytest.approx(120)
    assert ssim(white * 1.5, white, EVERYWHERE) == pytest.approx(1)


def test_what_lies_outside_the_mask_does_not_count(picture):
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
