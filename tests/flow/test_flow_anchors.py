"""What our constants do to the flow between drawn faces: each figure moves when its constant is ten times as large.

The truth of a drawn face is exact. A comment gives what a figure becomes with a tenth and with ten times the constant.
Tolerances are far above what rounding changes. Sizes of strips and bands have no figure: they change no bit.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import RBFInterpolator

from morphspace.errors import BadInput
from morphspace.face.mesh import LANDMARKS
from morphspace.face.regions import face_mask
from morphspace.flow import baselines, folds, methods, paper, starts
from morphspace.flow.filters import gaussian_derivative
from morphspace.flow.folds import unfolded
from morphspace.flow.motion import motion, temporal_kernels
from morphspace.flow.pairs import checked_picture, is_featureless
from morphspace.flow.pyramid import is_flat
from morphspace.grid import warp
from morphspace.synthetic import Expression

OPEN = Expression(jaw_open=0.7, brow_inner_raise=0.8, lip_corner_up=0.6)


def measured(anna, ben):
    """Compute the mean error (px) and confidence of flows in the face, and how far fields are smoothed and mended."""
    still, shot = anna.actor.draw(Expression()), anna.actor.draw(OPEN)
    stranger = ben.actor.draw(Expression()).image
    truth = shot.displacement
    height, width = truth.shape[:2]
    inside = face_mask(height, width) > 0.5
    away = np.roll(shot.image, 24, axis=1)
    plain = [np.where(inside[..., None], image, np.float32(0.5)) for image in (still.image, shot.image)]
    flows = {
        name: methods.named(name)(still.image)(shot.image)
        for name in ("fast", "balanced", "accurate", "paper")
    }
    flows["started"] = methods.named("balanced")(still.image)(shot.image, 0.9 * truth)
    flows["away"] = methods.named("balanced")(still.image)(away)
    flows["away"] = type(flows["away"])(
        flows["away"].displacement - np.float32((24, 0)), flows["away"].confidence
    )
    found = {}
    for name, flow in flows.items():
        found[name] = np.hypot(*np.moveaxis(flow.displacement - truth, -1, 0))[inside].mean()
        found[f"{name}, confidence"] = flow.confidence[inside].mean()
    between = methods.named("accurate")(still.image)(stranger)
    found["between people, confidence"] = between.confidence.mean()
    found["between people, smoothed"] = np.abs(
        methods.smoothed(between).displacement - between.displacement
    ).mean()
    found["lost, confidence"] = methods.named("accurate")(still.image)(away).confidence.mean()
    beside = methods.named("paper")(*plain[:1])(plain[1])
    found["beside the face"] = np.abs(beside.displacement[~inside]).mean()
    found["beside the face, confidence"] = beside.confidence[~inside].mean()
    found["smoothed"] = baselines.smoothed(truth)[inside].std()
    torn = np.ascontiguousarray(2.5 * truth[::-1, ::-1])
    found["mended"] = np.abs(unfolded(torn) - torn).mean()
    found["least area"] = warp.determinants(unfolded(torn)).min()
    points = np.asarray(anna.model.provenance["keypoints"]["points"])[list(LANDMARKS)]
    spline = starts.landmark_spline(points, warp.move_points(truth, points), height, width)
    found["spline at the edge"] = 1000 * np.abs(np.diff(spline[:, 0], 2, axis=0)).mean()
    found["inverse"] = np.abs(starts._approximate_inverse(truth)).mean()
    clip = [anna.actor.draw(Expression(jaw_open=0.02 * n)).image[40:, :, 1] for n in range(23)]
    video = motion(np.stack(clip))
    found["opening"] = video.velocity[12, 10:-10, 20:-20, 1].mean()
    found["opening, confidence"] = video.confidence[12].mean()
    return {name: float(value) for name, value in found.items()}


@pytest.fixture(scope="module")
def figures(drawn_anna, drawn_ben):
    return measured(drawn_anna, drawn_ben)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (
            "fast",
            0.2951,
        ),  # px; pyramid.FINEST_PX: 0.409, 0.263; LEAST_BLUR_PX x 10: 1.01; LEAST_SIDE_PX: 0.325, 0.539
        ("balanced", 0.2690),  # px; backends.MEDIAN_PX 1: 0.385; EDGE_PX: 0.254; pyramid.CODES: 0.317, 0.224
        (
            "accurate",
            0.1813,
        ),  # px; multiscale.COARSE_PX / 10: 0.135; RIVAL_RATIO, constraints.MOST_MISMATCH_PX: 2 %
        ("fast, confidence", 0.8712),  # multiscale.SURROUNDINGS_PX: 0.922, 0.464; UNLIKE_PX: 0.376, 0.985
        ("accurate, confidence", 0.8572),  # multiscale.LEAST_CONTRAST x 10: 0.827
        (
            "started",
            0.1934,
        ),  # px; multiscale.START_PX / 10: 0.268; RIVAL_RATIO: 0.220, 0.151; RIVAL_GAIN_PX: 4 %
        (
            "away",
            0.3588,
        ),  # px; pyramid.SHIFT_MISFIT x 10, SHIFT_GAIN / 10: 21.5; constraints.LIGHT_CELL_PX: 0.389, 0.378
        (
            "between people, confidence",
            0.5099,
        ),  # multiscale.MISSED_PX / 10: 0.469; LEAST_CONTRAST / 10: 0.574
        (
            "lost, confidence",
            0.2181,
        ),  # multiscale.INVERSE_STEPS / 10: 0.2045; WARPS_BACK x 10: 0.199; checked_px / 10: 0.243
        ("between people, smoothed", 0.0315),  # px; methods.SMOOTHING: 0, 0.391; LEAST_WEIGHT: 0.0340, 0.0310
        (
            "paper",
            0.8248,
        ),  # px; paper.SCALES, SINGLE_SCALE, PASSES, LONGEST_STEP_PX, DERIVATIVE_SD_PX, BLUR_SD_PX
        ("paper, confidence", 0.7476),  # paper.ERROR_SD_PX: 0.212, 0.840
        ("beside the face", 0.3778),  # px; paper.LEAST_LAPLACIAN: 0.382, 0.373
        ("beside the face, confidence", 0.5627),  # paper.LEAST_ERROR: 0.591, 0.518
        ("smoothed", 1.7436),  # px; baselines.SMOOTHING: 1.785, 0.953
        (
            "mended",
            0.2434,
        ),  # px; folds.GROWTH: 0.018, 0.830; REACH_SD: 0.153, 0.523; FIRST_SD_PX: 0.136, 0.626
        ("least area", 0.1028),  # folds.LEAST_DETERMINANT: 0.009, 0.535; ROUNDS / 10: -4.6
        ("spline at the edge", 1.637),  # px / 1000; starts.SPLINE_STEP_PX, ONE_LANDMARK_PX x 10: 1.2, 1.6
        ("inverse", 0.5317),  # px; starts.INVERSION_STEPS / 10: 0.575
        ("opening", 0.1018),  # px a frame; motion.RESIDUAL_WEIGHT: 0.0917, 0.0988; ZONE_RADIUS / 10: 0.0868
        ("opening, confidence", 0.3485),  # motion.EDGE_SD: 0.464, 0.025
    ],
)
def test_the_flow_between_drawn_faces(figures, name, expected):
    assert figures[name] == pytest.approx(expected, rel=0.008)


def test_a_narrow_kernel_is_corrected_over_a_window_of_its_own():
    """Middle taps of the second derivative. CORRECTION_SD_PX: -1.750 and -2.678."""
    assert gaussian_derivative(2, 0.5).min() == pytest.approx(-2.0003, abs=1e-3)


def waves(second=0.0, velocity=(0.6, 0.4), contrast=0.2):
    """Two waves of 11 px, across and, `second` times as strong, down, that move by `velocity` px a frame."""
    (y, x), t = np.mgrid[:32, :32], np.arange(23)[:, None, None]
    across, down = (2 * np.pi / 11 * (at - t * px) for at, px in zip((x, y), velocity, strict=True))
    return contrast * (np.cos(across + 0.3) + second * np.cos(down + 1.1))


SLOW = {"plane": 1.0, "least_gradient": 0.02, "time_scale": 0.0}  # slower than counts as motion


@pytest.mark.parametrize(
    ("clip", "settings", "figure", "expected", "within"),
    [
        (waves(contrast=1e-5), {}, 2, 0.9711, 0.008),  # confidence; LEAST_GRADIENT: 0.9967, 0.2247
        (waves(1e-3), {"plane": 1e-9}, 1, 0.0714, 0.2),  # px a frame down; RANK_TOL: 0.311, 0.002
        (waves(0.025, (0.01, 0.01)), SLOW, 0, 0.0, 0.0),  # px a frame; LEAST_DETERMINANT / 10: 2417
        (waves(0.035, (0.01, 0.01)), SLOW, 2, 0.136, 0.2),  # confidence; LEAST_DETERMINANT x 10: 0.979
    ],
)
def test_faint_waves_have_motion_or_none(clip, settings, figure, expected, within):
    """Near a limit, rounding decides at single pixels."""
    found, middle = motion(clip, **settings), np.s_[12, 10:-10, 10:-10]
    shown = (*found.velocity[middle].mean(axis=(0, 1)), found.confidence[middle].mean())
    assert shown[figure] == pytest.approx(expected, rel=within)


def test_beside_a_strong_texture_a_faint_one_has_no_motion():
    """Mean step of a texture that moves by 0.6 px, px. LEAST_ENERGY: 0.63, 0."""
    y, x = np.mgrid[:48, :96]
    strong = np.where(x < 16, 0.4 * (x % 8 < 4), 0)
    still, moved = (
        0.5 + strong + 3e-4 * np.cos(2 * np.pi / 8 * (x - px)) * np.cos(2 * np.pi / 9 * y) for px in (0, 0.6)
    )
    still, moved = (np.repeat(grey[..., None], 3, axis=2).astype(np.float32) for grey in (still, moved))
    field = paper.method(still)(moved).displacement
    assert field[10:-10, 60:-12, 0].mean() == pytest.approx(1.519, rel=0.05)


def test_a_spline_through_landmarks_is_that_of_scipy():
    """Errors near landmarks and at the edge, px.

    The largest; SPLINE_NEAR_PX: 0.13, 5e-7. The mean at the edge; SPLINE_MARGIN 0 and 1: 0.02 and 0.005.
    """
    places = np.array([[30.0, 30], [50, 30], [40, 45], [34, 58], [46, 58], [40, 52]])
    moves = np.array([[0.0, 0], [0, 0], [0, 1], [2, 0], [-2, 0], [0, 6]])
    y, x = np.mgrid[:96, :80]
    spline = RBFInterpolator(places, moves, kernel="thin_plate_spline", degree=1)
    truth = spline(np.column_stack([x.ravel(), y.ravel()]).astype(float)).reshape(96, 80, 2)
    error = np.linalg.norm(starts.landmark_spline(places, places + moves, 96, 80) - truth, axis=-1)
    assert error.max() == pytest.approx(0.00456, rel=0.02)
    assert np.concatenate([error[[0, -1]].ravel(), error[:, [0, -1]].ravel()]).mean() < 2e-5


def test_a_fold_is_smoothed_as_if_all_of_the_field_was(monkeypatch):
    """BLURS_SD / 10: 1e-4 px apart."""
    y, x = np.mgrid[:120, :120]
    field = np.stack([3 * np.sin(x / 7), 3 * np.sin(y / 9)], axis=-1).astype(np.float32)
    field[60, 50], field[55:65, 70] = (4, -5), -6
    part = unfolded(field)
    monkeypatch.setattr(folds, "_box", lambda cells, margin: folds.Box(0, 120, 0, 120))
    assert_allclose(part, unfolded(field), rtol=0, atol=1e-6)  # px; rounding


def picture(side=20, contrast=1.0, peak=1.0):
    """A horizontal ramp (side, side, 3) of this contrast with one value at `peak`."""
    ramp = np.repeat(np.linspace(0, contrast, side, dtype=np.float32)[None], side, axis=0)
    ramp[0, 0] = peak
    return np.repeat(ramp[..., None], 3, axis=2)


def line(off_px):
    """Landmarks (4, 2) px whose rms distance from one line is `off_px`."""
    return np.array([[10.0, 20 + off_px], [20, 20 - off_px], [30, 20 - off_px], [40, 20 + off_px]])


@pytest.mark.parametrize(
    ("work", "most", "beyond"),
    [
        (lambda side: checked_picture(picture(side), "it"), 16, 15),
        (lambda peak: checked_picture(picture(peak=peak), "it"), 1000.0, 1001.0),
        (lambda side: checked_picture(np.zeros((16, side, 1), np.float32), "it"), 32766, 32767),
        (lambda side: baselines.dis(picture(side), picture(side)), 17, 16),
        (lambda off_px: starts.check_spread(line(off_px), "it"), 1.01, 0.99),
        (lambda frames: motion(np.zeros((frames, 16, 16))), 23, 22),
        (lambda side: motion(np.zeros((23, side, 16))), 16, 15),
        (lambda grey: motion(np.full((23, 16, 16), grey)), 1e6, 1.01e6),
        (lambda sd_px: motion(np.zeros((23, 16, 16)), sd_px=1.5, zone_sd_px=sd_px), 99.9, 100.0),
        (lambda alpha: temporal_kernels(alpha), 10.0, 23.0),
    ],
)
def test_pictures_landmarks_and_clips_are_used_up_to_their_limits(work, most, beyond):
    work(most)
    with pytest.raises(BadInput):
        work(beyond)


@pytest.mark.parametrize(("codes", "is_nothing"), [(0.45, True), (0.55, False)])
def test_half_a_code_is_the_least_contrast(codes, is_nothing):
    flat = picture(contrast=codes / 255, peak=0.0)
    assert is_featureless(flat) == is_nothing
    assert is_flat(255 * flat.transpose(2, 0, 1)) == is_nothing
