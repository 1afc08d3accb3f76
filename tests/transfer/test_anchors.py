"""What our constants do to mimicry between two drawn people: each figure moves when its constant is ten times as large.

Both models are made from the exact truth, so that the figures hold what mimicry does and nothing else. A comment gives
what a figure becomes with a tenth and with ten times the constant. Tolerances are far above what rounding changes.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.face.mesh import LANDMARKS, landmark_places
from morphspace.grid import warp
from morphspace.model.morph import MorphOffset
from morphspace.transfer.colours import MixedColours
from morphspace.transfer.mimicry import auto_gain, mimic
from morphspace.transfer.quality import reach_of

CLOSED = ("lid_close_right", "lid_close_left")
RAISED = ("brow_outer_raise", "brow_inner_raise")
EXPRESSIONS = (
    {"jaw_open": 0.6, **dict.fromkeys(CLOSED, 0.7)},
    {"lip_corner_up": 0.7, **dict.fromkeys(RAISED, 0.8)},
    {"jaw_open": 0.3, "lip_corner_up": 0.8, **dict.fromkeys(CLOSED, 0.3)},
    {"jaw_open": 0.1, **dict.fromkeys(RAISED, 0.3), **dict.fromkeys(CLOSED, 0.5)},
)


@pytest.fixture(scope="module")
def figures(drawn_anna, drawn_ben):
    """Compute a method's mean figures: Ben drives Anna with expressions outside both models."""
    source, target = drawn_ben.model, drawn_anna.model
    offsets = [drawn_ben.face(**actions) - source.mean for actions in EXPRESSIONS]
    eyes_px = float(np.hypot(*np.subtract(target.faceframe.left_eye, target.faceframe.right_eye)))
    points = np.asarray(target.provenance["keypoints"]["points"])[list(LANDMARKS)]
    lids = landmark_places("lids")
    known = {}

    def figures_of(method, gain=1.0):
        if (method, gain) in known:
            return known[method, gain]
        made = [mimic(source, target, method, gain=gain)(offset) for offset in offsets]
        reach = reach_of(source, target, gain)
        reaches = [
            reach(offset, one.morph, one.loadings, source.basis.project(offset.vector))
            for offset, one in zip(offsets, made, strict=True)
        ]
        off = [
            warp.move_points(one.morph.displacement, points)
            - warp.move_points(drawn_anna.face(**actions).displacement, points)
            for one, actions in zip(made, EXPRESSIONS, strict=True)
        ]
        residual = [(one.morph - (target.mean + target.offset(one.loadings))).displacement for one in made]
        shown = {
            "length": [one.quality.length_sd for one in made],
            "texture kept": [one.quality.texture_kept for one in made],
            "missing": [one.missing_motion for one in reaches],
            "agreement": [one.colour_agreement for one in reaches],
            "residual": [np.abs(field[target.mask > 0.5]).max() / eyes_px for field in residual],
            "lids off": [np.hypot(*one[lids].T).mean() / eyes_px for one in off],
        }
        known[method, gain] = {name: float(np.mean(values)) for name, values in shown.items()}
        return known[method, gain]

    return figures_of


@pytest.mark.parametrize(
    ("method", "gain", "name", "expected"),
    [
        ("map", 1.0, "length", 1.466),  # MISMATCH: 1.585, 0.936
        ("map", 1.0, "missing", 0.01716),  # NEAR: 0.0179, 0.0179 eye distances
        ("paper", 1.0, "missing", 0.01575),  # KNEE: 0.095, 0.0122
        ("transfer", 1.0, "missing", 0.0227),  # FEATURE_WEIGHT: 0.0196, 0.0245; FEATURE_REACH: 0.0149, 0.0162
        ("transfer", 1.0, "texture kept", 0.350),  # LOCALITY: 0.402, 0.179; OPENING: 0.394, 0.287
        ("transfer", 1.0, "agreement", 0.600),  # UPPER_FROM: 0.615; LOWER_FROM: 0.078
        ("guided", 1.0, "missing", 0.0180),  # GUIDE_TRUST x 10: 0.0189; LEAST_ERROR_PX: 0.0228, 0.0196
        ("guided", 1.0, "texture kept", 0.3475),  # GUIDE_TRUST / 10: 0.360
        (
            "guided",
            3.0,
            "residual",
            0.0922,
        ),  # RESIDUAL_LIMIT: 0.0603, 0.1077; RESIDUAL_SHARE: 0.0593 eye distances
        ("guided", 1.0, "lids off", 0.00245),  # RESIDUAL_SHARE: 0.0035, 0.0096 eye distances
    ],
)
def test_mimicry_of_a_drawn_person(figures, method, gain, name, expected):
    assert figures(method, gain)[name] == pytest.approx(expected, rel=0.015)


def test_the_automatic_gain_of_a_drawn_person(drawn_anna, drawn_ben):
    """GAIN_FACES: 1.137 with four faces; GAIN_RANGE: 1.48 without its upper end."""
    assert auto_gain(drawn_anna.model, drawn_ben.model, "transfer") == pytest.approx(1.178, abs=0.002)
    assert auto_gain(drawn_ben.model, drawn_anna.model.truncate(1), "paper") == 1.3


def test_without_other_words_no_component_goes_beyond_three_sd(drawn_anna, drawn_ben):
    source, target = drawn_ben.model, drawn_anna.model
    offset = drawn_ben.face(**EXPRESSIONS[0]) - source.mean
    for method in ("paper", "guided"):
        furthest = np.abs(mimic(source, target, method)(30 * offset).loadings / target.sd).max()
        assert furthest == pytest.approx(3.0, abs=1e-3)


def test_colours_fade_to_the_means_next_to_the_mean(drawn_anna):
    """NEAR_MEAN_SD: half of the mixed change at a length of 0.05 SD; all of it at a tenth, 0.7 % at ten times."""
    model, colours = drawn_anna.model, MixedColours(drawn_anna.model)
    near = 0.05 * model.sd * (1, -1, 1, -1, 1, -1)
    lengths = [np.linalg.norm(colours.mixed(colours.parts[1], scale * near)) for scale in (1.0, 2.0)]
    assert lengths[0] / lengths[1] == pytest.approx(0.5, abs=0.05)  # the two mix almost the same faces


@pytest.mark.parametrize(("least", "most", "agreement"), [(0.3, 0.48, 0.0), (0.52, 0.7, 1.0)])
def test_colours_agree_where_half_of_both_masks_is_the_face(drawn_anna, least, most, agreement):
    """INSIDE: colours that change equally at one pixel, whose masks have this product."""
    model = drawn_anna.model
    product = model.mask**2  # the affine of a person to herself moves no pixel
    row, column = np.argwhere((product > least) & (product < most))[0]
    texture = np.zeros_like(model.mean.texture)
    texture[row, column] = 0.2
    offset = MorphOffset.of(texture, np.zeros_like(model.mean.displacement), model.mean.reference_id)
    nothing = np.zeros(model.rank)
    found = reach_of(model, model, 1.0)(offset, model.mean + offset, nothing, nothing)
    assert found.colour_agreement == pytest.approx(agreement, abs=1e-5)


@pytest.mark.parametrize(("moved", "still"), [("lips", "brows"), ("brows", "lips")])
def test_lips_choose_the_colours_of_the_mouth_and_lids_those_of_the_brows(drawn_anna, moved, still):
    """Two components: one moves lips, the other lids and brows. Each changes the colours of its own part only."""
    model = drawn_anna.model
    weights = np.zeros_like(model.landmarks.weights)
    for component, groups in ((0, ("outer lips", "inner lips")), (1, ("lids", "brows"))):
        for group in groups:
            weights[component, landmark_places(group)] = (
                1 + np.arange(2 * weights[0, landmark_places(group)].shape[0]).reshape(-1, 2) % 5
            )
    known = {**model.provenance, "keypoints": {**model.provenance["keypoints"], "points": None}}
    person = replace(model, provenance=known).with_landmarks(replace(model.landmarks, weights=weights))
    colours = MixedColours(person)
    start = 0.8 * model.sd
    there = start + (1.5 * model.sd if moved == "lips" else 0) * np.eye(model.rank)[0]
    there = there + (1.5 * model.sd if moved == "brows" else 0) * np.eye(model.rank)[1]
    change = np.abs(colours.change(there) - colours.change(start)).max(axis=-1)
    (right_x, right_y), _, (lip_x, lip_y) = np.round(model.faceframe.points).astype(int)
    at = {
        "brows": change[right_y - 8 : right_y + 2, right_x - 4 : right_x + 5],
        "lips": change[lip_y + 2 : lip_y + 12, lip_x - 6 : lip_x + 7],
    }
    assert_allclose(at[still], 0, atol=1e-6)
    assert at[moved].max() > 0.02
