"""What our constants do to the flow between drawn faces: each figure moves when its constant is ten times as large.

The truth of a drawn face is exact. A comment gives what a figure becomes with a tenth and with ten times the constant.
Tolerances are far above what rounding changes. Three constants have no figure: `INVERSE_STEPS` and `WARPS_BACK` move
the confidence by less than 0.2 %, and sizes of strips and bands change no bit.
"""

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.face.mesh import LANDMARKS
from morphspace.face.regions import face_mask
from morphspace.flow import baselines, methods, starts
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
    found["inverse"] = np.abs(starts.approximate_inverse(truth)).mean()
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
