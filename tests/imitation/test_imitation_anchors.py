"""What our constants do to measures of a drawn person's motion: each figure moves when its constant does.

A comment gives what a figure becomes with a tenth and with ten times the constant.
"""

import numpy as np
import pytest

from morphspace.face.regions import region_mask
from morphspace.imitation import align, compare, masked_basis
from morphspace.imitation.chance import in_pieces, p_values
from morphspace.imitation.information import mutual_information
from morphspace.imitation.motions import Motion
from morphspace.imitation.shape import lag_curves, varies
from morphspace.steps import result_of
from morphspace.stimuli.timing import at_positions

EYES = {"lid_close_left": 0.6, "lid_close_right": 0.6, "brow_inner_raise": 0.5, "jaw_open": 0.4}


@pytest.fixture(scope="module")
def figures(drawn_anna, drawn_ben):
    """Measure a motion of 40 frames against a late and noisy copy of 37, and the loadings that the eyes tell."""
    model = drawn_anna.model
    faces = model.training.values / model.sd
    motion = at_positions(faces, np.linspace(0, 15, 40))
    noise = 0.1 * np.random.default_rng(3).standard_normal((37, 6))
    imitation = 0.8 * at_positions(faces, np.linspace(-1.2, 13, 37)) + noise
    found = result_of(compare(motion, imitation, model.sd, permutations=9, seed=1))
    pieces = np.concatenate(list(in_pieces(np.arange(40.0)[:, None], 50, 1)))[..., 0]
    mask = region_mask("eyes", *model.mask.shape, model.faceframe).reshape(-1)
    part = masked_basis(model.basis, np.concatenate([np.repeat(mask, 3), np.repeat(mask, 2)]))
    told = {
        name: np.linalg.norm(part.mean((one.face(**EYES) - one.model.mean).vector) / model.sd)
        for name, one in (("her eyes", drawn_anna), ("his eyes", drawn_ben))
    }
    late = at_positions(motion, np.maximum(np.arange(40) - 15.0, 0))
    return {
        **told,
        "lags": len(found.lags),
        "best lag": found.measures["lag_frames"][0],
        "joints": (np.abs(np.diff(pieces, axis=1)) != 1).sum(axis=1).mean(),
        "late": align(motion, late).cost,
        "shared": mutual_information(motion[:37, 0], motion[:37, 0] + 3 * noise[:, 0]),
    }


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("her eyes", 3.719),  # SD; part_of_face.ONE_IN: 4.014, 2.574
        ("his eyes", 3.162),  # SD; part_of_face.ONE_IN: 3.388, 2.171
        ("lags", 40),  # shape.LEAST_FRAMES x 10: 18; LEAST_OVERLAP / 10
        ("best lag", 3),  # frames; shape.LEAST_OVERLAP / 10: 34
        ("joints", 4.2),  # chance.PIECES: 0.94, 17.6
        ("late", 100.7),  # SD; alignment.BAND
        ("shared", 1.087),  # nats; information.NEIGHBOURS
    ],
)
def test_the_imitation_of_a_drawn_person(figures, name, expected):
    assert figures[name] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("less", "p"), [(1e-9, 1.0), (1e-8, 0.5)])
def test_scores_are_equal_to_rounding(less, p):
    """TIE_TOL, a billionth of 1 + 0.5."""
    assert p_values(np.array([0.5]), np.array([[0.5 - less]]))[0] == p


@pytest.mark.parametrize(("by", "is_moving"), [(5e-13, False), (2e-12, True)])
def test_a_column_is_constant_to_rounding(by, is_moving):
    """CONSTANT_TOL, of the largest value."""
    assert varies(np.array([[1.0], [1.0 + by]]))[0] == is_moving


@pytest.mark.parametrize(("amount", "is_known"), [(1.6e-6, False), (5e-6, True)])
def test_what_rounding_leaves_of_a_window_is_no_motion(amount, is_known):
    """WINDOW_TOL, of the sum of squares: one frame moves by 1, the others by 4.8e-11 or 4.8e-10 of its square."""
    motion = amount * (-1.0) ** np.arange(20)[:, None]
    motion[0] = 1.0
    lags, curves = lag_curves(motion, np.random.default_rng(0).standard_normal((1, 20, 1)))
    assert np.isfinite(curves[0, list(lags).index(-1), 0]) == is_known


@pytest.mark.parametrize(("frames", "is_known"), [(7, False), (8, True)])
def test_information_needs_eight_frames(frames, is_known):
    values = np.random.default_rng(0).standard_normal((2, frames))
    assert np.isfinite(mutual_information(*values)) == is_known


@pytest.mark.parametrize(("outside", "is_strange"), [(0.95, False), (1.05, True)])
def test_frames_as_far_outside_as_the_training_varies_are_strange(outside, is_strange):
    """STRANGE."""
    motion = Motion("a", (), np.zeros((0, 1)), None, None, 1, np.zeros(0, int), {}, outside=outside)
    assert motion.is_strange == is_strange
