"""Laws of the video form: drifting patterns with algebraic motion, drawn as sums of cosines.

A pattern is evaluated at the earlier positions of its points, so that the truth is exact and no interpolation enters.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.flow.motion import SPACE_TERMS, TAPS, Motion, motion, taylor_weights, temporal_kernels

SIDE = 56
AT = 12  # the one frame of a clip of 23 that has a full window
INSIDE = slice(12, -12)  # 7 px of filters, and the reach of the average over products
Y, X = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
GRATING_PX = 11.0  # wavelength


def clip_of(waves, back, frames=TAPS, contrast=0.2, mean=0.5):
    """Draw the pattern (waves: k_x, k_y, phase, amplitude) at `back`: positions at time t -> earlier ones."""
    kx, ky, phase, amplitude = (np.asarray(each, float)[:, None, None] for each in waves)
    amplitude = amplitude / np.sqrt((amplitude**2).sum() / 2)

    def frame(t):
        x, y = back(X, Y, t - AT)
        return mean * (1 + contrast * (amplitude * np.cos(kx * x + ky * y + phase)).sum(axis=0))

    return np.stack([frame(t) for t in range(frames)]).astype(np.float32)


def drift(right, down):
    return lambda x, y, t: (x - right * t, y - down * t)


def rotation(rate):
    return lambda x, y, t: (
        np.cos(rate * t) * x + np.sin(rate * t) * y,
        np.cos(rate * t) * y - np.sin(rate * t) * x,
    )


def expansion(rate):
    return lambda x, y, t: (x * np.exp(-rate * t), y * np.exp(-rate * t))


def wave(degrees, wavelength_px=GRATING_PX):
    k, angle = 2 * np.pi / wavelength_px, np.radians(degrees)
    return k * np.cos(angle), k * np.sin(angle)


def grating(speed, degrees, **drawing):
    kx, ky = wave(degrees)
    return clip_of(([kx], [ky], [0.3], [1.0]), drift(*velocity_of(speed, degrees)), **drawing)


def plaid(velocity, one_degrees, other_degrees, **drawing):
    (kx, lx), (ky, ly) = zip(wave(one_degrees), wave(other_degrees), strict=True)
    return clip_of(([kx, lx], [ky, ly], [0.3, 1.1], [1.0, 1.0]), drift(*velocity), **drawing)


def texture(back, seed=0, **drawing):
    """Draw a broadband pattern: 60 waves of 6 to 40 px in all directions, with an amplitude proportional to length."""
    rng = np.random.default_rng(seed)
    k, angle = (
        np.exp(rng.uniform(np.log(2 * np.pi / 40), np.log(2 * np.pi / 6), 60)),
        rng.uniform(0, 2 * np.pi, 60),
    )
    return clip_of(
        (k * np.cos(angle), k * np.sin(angle), rng.uniform(0, 2 * np.pi, 60), 1 / k), back, **drawing
    )


def velocity_of(speed, degrees):
    return speed * np.cos(np.radians(degrees)), speed * np.sin(np.radians(degrees))


def inside(found: Motion):
    return found.velocity[AT, INSIDE, INSIDE]


def worst(velocity, truth):
    """Return the largest error in speed, as a share, and in direction, in degrees."""
    found, right = velocity[..., 0] + 1j * velocity[..., 1], truth[0] + 1j * truth[1]
    return np.abs(np.abs(found / right) - 1).max(), np.degrees(np.abs(np.angle(found / right))).max()


# ---------------------------------------------------------------------------------------------- kernels


def test_temporal_kernels_are_derivatives_of_a_log_gaussian():
    def closed(t):
        return np.exp(-((np.log(t / 10) / 0.2) ** 2)) / (np.sqrt(np.pi) * 10 * 0.2 * np.exp(0.01))

    t, step = np.arange(1.0, TAPS), 1e-3
    k0, k1, k2 = temporal_kernels()[:, 1:]
    assert_allclose(k0, closed(t), atol=1e-6)  # the sums are made exact by a few 1e-7
    assert_allclose(k1, (closed(t + step) - closed(t - step)) / (2 * step), atol=1e-6)
    assert_allclose(k2, (closed(t + step) - 2 * closed(t) + closed(t - step)) / step**2, atol=1e-5)
    assert_array_equal(temporal_kernels()[:, 0], 0)


def test_temporal_kernels_have_no_response_to_a_static_clip():
    assert_allclose(temporal_kernels().sum(axis=1), [1, 0, 0], atol=1e-15)
    assert temporal_kernels()[0].argmax() == 10


@pytest.mark.parametrize(
    ("alpha", "tau"), [(10.0, 0.0), (0.0, 0.2), (20.0, 0.2), (10.0, 0.02), (np.nan, 0.2)]
)
def test_kernels_that_do_not_fit_are_refused(alpha, tau):
    with pytest.raises(BadInput, match="log-Gaussian"):
        temporal_kernels(alpha, tau)


def test_taylor_weights_are_energies_over_the_zone():
    weights = dict(zip(SPACE_TERMS, taylor_weights(), strict=True))
    assert len(weights) == 9
    assert weights[0, 0] == pytest.approx(1)  # the gradient itself
    scale = 0.5 * np.tan(np.pi / 24)  # 1 / m1^2 is 4 of it; the mean of p^2 over -5..5 is 10
    assert weights[1, 0] == pytest.approx(10 * 4 * scale)
    assert weights[0, 1] == pytest.approx(10 / (4 * scale))
    assert weights[2, 1] == pytest.approx(
        178.0 * (4 * scale) ** 2 / 4 * 10 / (4 * scale)
    )  # mean of p^4 is 178


# ---------------------------------------------------------------------------------------------- drifting patterns


@pytest.mark.parametrize("degrees", [0, 7.5, 40, 90, 137, 200, 271])
@pytest.mark.parametrize("speed", [0.05, 0.5, 2.0])
def test_a_drifting_grating_moves_along_its_normal(speed, degrees):
    found = motion(grating(speed, degrees))
    speed_error, direction_error = worst(inside(found), velocity_of(speed, degrees))
    assert speed_error < 0.002  # goal 0.005
    assert direction_error < 0.02  # degrees; goal 1
    assert found.confidence[AT, INSIDE, INSIDE].min() > 0.99


@pytest.mark.parametrize("degrees", [(0, 90), (20, 75), (130, 160)])
@pytest.mark.parametrize("velocity", [(0.6, 0.4), (-0.1, 0.9), (1.5, -1.0)])
def test_a_drifting_plaid_moves_as_one_pattern(velocity, degrees):
    speed_error, direction_error = worst(inside(motion(plaid(velocity, *degrees))), velocity)
    assert speed_error < 0.005  # goal 0.03
    assert direction_error < 0.5  # degrees; goal 1; the blend errs slightly where one wave is weak


@pytest.mark.parametrize("velocity", [(0.5, 0.3), (-1.5, 0.5), (0.03, -0.04), (0.0, 2.5)])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_drifting_texture_moves_at_every_point(velocity, seed):
    found = motion(texture(drift(*velocity), seed))
    speed_error, direction_error = worst(inside(found), velocity)
    assert speed_error < 0.005  # goal 0.03
    assert direction_error < 0.5  # degrees; goal 3
    assert found.confidence[AT, INSIDE, INSIDE].min() > 0.99


def test_the_first_form_is_exact_on_gratings_and_wrong_on_plaids():
    first = motion(grating(0.5, 40), plane=np.inf)
    assert worst(inside(first), velocity_of(0.5, 40))[0] < 0.002
    error = worst(inside(motion(plaid((0.6, 0.4), 0, 90), plane=np.inf)), (0.6, 0.4))
    assert 0.02 < error[0] < 0.3  # share; the outer form corrects it
    assert 5 < error[1] < 40  # degrees


@pytest.mark.parametrize(
    "setting", [{"sd_px": 3**0.5}, {"time_scale": 1.0}, {"zone_sd_px": 0.0}, {"alpha_frames": 9.0}]
)
def test_settings_do_not_change_what_is_exact(setting):
    velocity = (0.5, 0.3)
    found = motion(texture(drift(*velocity), frames=24), **setting)
    frames = np.flatnonzero(found.confidence.any(axis=(1, 2)))
    assert frames.size == 2
    for frame in frames:
        assert worst(found.velocity[frame, 11:-11, 11:-11], velocity)[0] < 0.005


@pytest.mark.parametrize("back", [rotation(0.02), expansion(0.02)], ids=["rotation", "expansion"])
def test_turning_and_growing_textures_have_their_velocity_field(back):
    x, y = X[INSIDE, INSIDE], Y[INSIDE, INSIDE]
    before, after = back(x, y, -0.5), back(x, y, 0.5)
    truth = np.stack([before[0] - after[0], before[1] - after[1]], axis=-1)
    for seed in (2, 3):
        found = inside(motion(texture(back, seed)))
        # one velocity for all derivatives of a point errs by the field's change over some 2 px
        assert np.linalg.norm(found - truth, axis=-1).mean() < 3 * 0.02
        rate = (found * truth).sum() / (truth * truth).sum()
        assert rate == pytest.approx(1, abs=0.15), seed  # of the true turn or growth


# ---------------------------------------------------------------------------------------------- invariances


def test_contrast_does_not_change_velocity():
    for draw in (lambda c: grating(0.5, 40, contrast=c), lambda c: texture(drift(0.5, 0.3), contrast=c)):
        strong, weak = inside(motion(draw(0.3))), inside(motion(draw(0.03)))
        assert np.linalg.norm(weak - strong, axis=-1).max() < 0.01 * 0.5  # 1 % of the speed


def test_gain_and_offset_do_not_change_velocity():
    clip = texture(drift(0.5, 0.3))
    plain = inside(motion(clip))
    for other in (4 * clip, 255 * clip, clip + 0.25, 1 - clip, 255 * clip + 100):
        assert np.linalg.norm(inside(motion(other)) - plain, axis=-1).max() < 0.001 * 0.58


def test_turning_the_clip_by_a_right_angle_turns_the_velocity():
    clip = np.random.default_rng(0).random((TAPS, SIDE, SIDE)).astype(np.float32)  # no coherent pattern
    found = motion(clip).velocity[AT]
    turned = motion(np.rot90(clip, axes=(1, 2))).velocity[AT]
    straight = np.rot90(turned, -1)
    assert_allclose(np.stack([-straight[..., 1], straight[..., 0]], -1), found, atol=2e-3)


def test_a_static_texture_has_zero_velocity_with_confidence():
    found = motion(texture(drift(0, 0)))
    assert np.abs(found.velocity).max() < 1e-4  # px per frame; rounding
    assert found.confidence[AT, INSIDE, INSIDE].min() > 0.99


@pytest.mark.parametrize("level", [0.0, 0.7, 255.0])
def test_a_constant_clip_has_neither_velocity_nor_confidence(level):
    found = motion(np.full((TAPS, 20, 18), level, np.float32))
    assert_array_equal(found.velocity, 0)
    assert found.confidence.max() < 1e-3


def test_flicker_without_pattern_has_no_velocity():
    levels = np.random.default_rng(0).random(TAPS).astype(np.float32)
    found = motion(np.broadcast_to(levels[:, None, None], (TAPS, 20, 18)))
    assert_allclose(found.velocity, 0, atol=1e-6)
    assert found.confidence.max() < 1e-3


def test_noise_has_less_confidence_than_a_pattern():
    clip = np.random.default_rng(0).random((TAPS, SIDE, SIDE)).astype(np.float32)
    assert np.median(motion(clip).confidence[AT, INSIDE, INSIDE]) < 0.5
    assert np.isfinite(motion(clip).velocity).all()


# ---------------------------------------------------------------------------------------------- frames and shapes


def test_frames_without_a_full_window_have_no_confidence():
    found = motion(texture(drift(0.5, 0.3), frames=26))
    assert found.velocity.shape == (26, SIDE, SIDE, 2)
    assert found.confidence.shape == (26, SIDE, SIDE)
    assert found.velocity.dtype == found.confidence.dtype == np.float32
    assert_array_equal(np.flatnonzero(found.confidence.any(axis=(1, 2))), [12, 13, 14, 15])
    assert_array_equal(np.flatnonzero(found.velocity.any(axis=(1, 2, 3))), [12, 13, 14, 15])


def test_a_velocity_depends_on_its_window_only():
    clip = texture(rotation(0.02), frames=26)
    whole, part = motion(clip), motion(clip[2:25])
    assert_array_equal(whole.velocity[14], part.velocity[12])
    assert_array_equal(whole.confidence[14], part.confidence[12])


def test_a_velocity_belongs_to_its_frame():
    rate = 0.02  # px per frame each frame
    clip = texture(lambda x, y, t: (x - 0.5 * rate * t**2 - 0.6 * t, y), frames=30)
    found = motion(clip).velocity[12:20, INSIDE, INSIDE, 0].mean(axis=(1, 2))
    frames = (found - 0.6) / rate - np.arange(8)
    assert_allclose(frames, -0.3, atol=0.3)  # frames; the kernel has its peak 10 frames back, its centre 10.3


def test_confidence_falls_to_zero_at_the_edge():
    found = motion(grating(0.5, 90)).confidence[AT]
    assert_array_equal(found[[0, -1]], 0)
    assert_array_equal(found[:, [0, -1]], 0)
    assert (np.diff(found[:7, SIDE // 2]) >= 0).all()
    assert found[8:-8, 8:-8].min() > 0.9


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((22, 20, 20), "22 frames; expected at least 23"),
        ((23, 15, 20), "20 x 15 px; expected at least 16"),
        ((23, 20, 15), "15 x 20 px; expected at least 16"),
        ((23, 20), r"clip is an array \(23, 20\)"),
        ((23, 20, 20, 3), r"clip is an array \(23, 20, 20, 3\)"),
    ],
)
def test_a_clip_of_the_wrong_size_is_refused(shape, message):
    with pytest.raises(BadInput, match=message) as caught:
        motion(np.zeros(shape, np.float32))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_clip_that_is_not_finite_is_refused(bad):
    clip = np.zeros((23, 20, 20), np.float32)
    clip[7, 3, 3] = bad
    with pytest.raises(BadInput, match="frame 7 of the clip has values that are not finite"):
        motion(clip)


@pytest.mark.parametrize(
    "setting",
    [{"zone_sd_px": -1.0}, {"plane": 0.0}, {"least_gradient": 0.0}, {"time_scale": np.inf}, {"sd_px": 0.0}],
)
def test_impossible_settings_are_refused(setting):
    with pytest.raises(BadInput):
        motion(np.zeros((23, 20, 20), np.float32), **setting)


def test_integer_clips_have_the_velocity_of_float_clips():
    clip = np.round(texture(drift(0.5, 0.3)) * 255).astype(np.uint8)
    assert_array_equal(motion(clip).velocity, motion(clip.astype(np.float32)).velocity)


def test_slow_motion_in_8_bit_codes_is_found_with_the_weights_for_cameras():
    clip = np.round(texture(drift(0.05, 0.05), contrast=0.4) * 255) / np.float32(255)
    found = motion(clip, time_scale=1.0)
    assert np.median(np.linalg.norm(inside(found) - 0.05, axis=-1)) < 0.01  # px per frame
    assert np.median(found.confidence[AT, INSIDE, INSIDE]) > 0.8
