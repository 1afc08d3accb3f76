"""Laws of image statistics: plain surfaces, gratings and noise whose figures are known from algebra."""

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.io.colour import linear_of_srgb
from morphspace.stimuli.image_statistics import FIGURES, SPACES, image_statistics, spectral_slope


def plain(red, green, blue, height=48, width=64):
    return np.broadcast_to(np.array([red, green, blue], np.uint8), (height, width, 3)).copy()


def noise_of_slope(slope, height, width, seed):
    """Noise whose amplitude falls with frequency to the power `slope`, made in the frequency domain."""
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None])
    frequency[0, 0] = 1
    white = np.fft.fft2(np.random.default_rng(seed).standard_normal((height, width)))
    return np.fft.ifft2(white * frequency**slope).real.astype(np.float32)


@pytest.mark.parametrize("codes", [(200, 100, 50), (5, 10, 255)])
def test_a_plain_surface_has_its_own_colour_no_contrast_and_no_slope(codes):
    told = image_statistics([plain(*codes)])
    coded = np.array(codes) / 255
    linear = linear_of_srgb(coded)
    for space, values in (("code", coded), ("linear", linear)):
        assert [told[space][name] for name in ("red", "green", "blue")] == pytest.approx(values, rel=1e-5)
        assert told[space]["luminance"] == pytest.approx(values @ (0.2126, 0.7152, 0.0722), rel=1e-5)
        assert told[space]["rms_contrast"] == pytest.approx(0, abs=1e-6)
        assert told[space]["spectral_slope"] is None


def test_black_has_no_contrast_to_speak_of():
    told = image_statistics([plain(0, 0, 0)])
    assert [told[space]["rms_contrast"] for space in SPACES] == [None, None]
    assert told["linear"]["luminance"] == 0


def test_contrast_of_two_halves_is_the_difference_over_the_sum():
    codes = plain(40, 40, 40)
    codes[:, ::2] = 200
    told = image_statistics([codes])
    assert told["code"]["rms_contrast"] == pytest.approx(160 / 240, rel=1e-5)
    dark, light = linear_of_srgb(np.array([40, 200]) / 255)
    assert told["linear"]["rms_contrast"] == pytest.approx((light - dark) / (light + dark), rel=1e-5)


@pytest.mark.parametrize("slope", [-0.5, -1.0, -1.5])
def test_the_slope_of_noise_is_the_one_it_was_made_with(slope):
    found = [spectral_slope(noise_of_slope(slope, 240, 200, seed)) for seed in range(8)]
    # Each estimate rests on some hundred frequencies in the lowest bands; the window leaks a little of steep spectra.
    assert np.mean(found) == pytest.approx(slope, abs=0.05)


def test_light_and_size_of_contrast_do_not_change_the_slope():
    noise = noise_of_slope(-1, 120, 100, 3)
    assert spectral_slope(5 + 0.1 * noise) == pytest.approx(spectral_slope(noise), abs=1e-3)


def test_statistics_of_a_video_are_the_mean_of_its_frames():
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 256, (60, 50, 3), dtype=np.uint8) for _ in range(3)]
    alone = [image_statistics([frame]) for frame in frames]
    together = image_statistics(iter(frames))
    for space in SPACES:
        for name in FIGURES:
            expected = np.mean([one[space][name] for one in alone])
            assert together[space][name] == pytest.approx(expected, rel=1e-5)


def test_a_mirrored_picture_has_the_same_statistics():
    codes = np.random.default_rng(2).integers(0, 256, (60, 50, 3), dtype=np.uint8)
    one, other = image_statistics([codes]), image_statistics([np.ascontiguousarray(codes[:, ::-1])])
    for space in SPACES:
        assert one[space] == pytest.approx(other[space], rel=1e-4, abs=1e-4), space


def test_a_picture_too_small_for_a_spectrum_says_so():
    assert (
        image_statistics([np.random.default_rng(0).integers(0, 256, (4, 4, 3), dtype=np.uint8)])["code"][
            "spectral_slope"
        ]
        is None
    )


@pytest.mark.parametrize("codes", [np.zeros((4, 4, 3), np.float32), np.zeros((4, 4), np.uint8)])
def test_what_is_no_picture_of_codes_is_refused(codes):
    with pytest.raises(BadInput, match="8-bit codes"):
        image_statistics([codes])
    with pytest.raises(BadInput, match="no frames"):
        image_statistics([])
