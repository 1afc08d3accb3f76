"""Laws of mimicry: a face drives itself unchanged, offsets turn with the affine, and no loading runs away."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LANDMARKS, LIPS, POINT_COUNT, landmark_places
from morphspace.grid import warp
from morphspace.model.keypoints import DetectedFaceframe, landmarks_of
from morphspace.model.landmarks import LandmarkRegression
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset
from morphspace.transfer.guided import GUIDES, landmark_guide
from morphspace.transfer.mimicry import GAIN_RANGE, METHODS, auto_gain, mimic
from morphspace.transfer.neutral import Neutral
from morphspace.transfer.probable import bounded, feature_weights, posterior_of
from morphspace.transfer.projection import Projection

FRAME = FaceFrame((20.0, 30.0), (41.0, 29.0), (30.0, 44.0))


def knowing(model, seed=7, error_px=1.0):
    """The model with a regression to landmarks, drawn at random: some px per SD of each component."""
    per_sd = np.random.default_rng(seed).standard_normal((model.rank, len(LANDMARKS), 2))
    weights = per_sd / model.sd[:, None, None]
    mean, errors = np.full((len(LANDMARKS), 2), 30.0), np.full(len(LANDMARKS), error_px)
    return model.with_landmarks(LandmarkRegression(mean, weights, errors, 12, 1.0, False))


@pytest.fixture
def person(model):
    return knowing(model.with_faceframe(FRAME))


def turned(model, degrees, scale=1.0):
    """The model with its faceframe rotated and scaled about the eyes."""
    angle = np.radians(degrees)
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = (FRAME.points - FRAME.points.mean(0)) @ linear.T + FRAME.points.mean(0)
    return model.with_faceframe(FaceFrame.at(points)), linear


def faces(model):
    return model.training.values


@pytest.mark.parametrize("method", METHODS)
def test_a_face_drives_itself_unchanged(person, method):
    to_target = mimic(person, person, method, max_sd=1e3)
    for loadings in faces(person):
        made = to_target(person.offset(loadings))
        assert_allclose(made.loadings, loadings, atol=0.02 * np.abs(faces(person)).max())
        apart = np.abs(made.morph.render() - person.render(loadings))
        assert np.quantile(apart, 0.99) < 0.02  # this face folds at the lips, and `transfer` draws no folds
        assert made.quality.bounded == 0
        assert made.quality.warp_kept > 0.99 and made.quality.texture_kept > 0.99


@pytest.mark.parametrize("method", METHODS)
def test_no_difference_and_no_gain_are_the_mean_face(person, method):
    rest = mimic(person, person, method)(person.offset(np.zeros(person.rank)))
    still = mimic(person, person, method, gain=0.0)(person.offset(faces(person)[3]))
    for made in (rest, still):
        assert_allclose(made.loadings, 0, atol=1e-6)
        assert_allclose(made.morph.render(), person.render(np.zeros(person.rank)), atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_gain_scales_the_loadings(person, method):
    offset = person.offset(faces(person)[2])
    one, half = (mimic(person, person, method, gain=gain, max_sd=1e3)(offset).loadings for gain in (1.0, 0.5))
    assert_allclose(half, 0.5 * one, rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rests", [False, True])
def test_known_loadings_do_not_change_the_face(person, method, rests):
    """Known loadings save a projection and change nothing else."""
    person = replace(
        person, basis=replace(person.basis, discarded_variance=1e-3)
    )  # or landmarks hardly count
    loadings = 0.9 * faces(person)[2]
    offset = person.offset(loadings)
    neutral = resting(person, faces(person)[3], faces(person)[5]) if rests else None
    to_target = mimic(person, person, method, neutral=neutral)
    read, known = to_target(offset), to_target(offset, loadings)
    assert_allclose(known.loadings / person.sd, read.loadings / person.sd, atol=2e-4)
    assert_allclose(known.morph.render(), read.morph.render(), atol=2e-4)
    if method == "guided":  # they are believed
        asked = to_target(offset, loadings + person.sd).loadings / person.sd
        assert np.abs(asked - read.loadings / person.sd).max() > 0.01


def test_equal_models_may_change_places(person):
    other = replace(person, provenance={**person.provenance, "identity": "twin"})
    offset = person.offset(faces(person)[1])
    there, back = mimic(person, other, "map")(offset), mimic(other, person, "map")(offset)
    assert_array_equal(there.loadings, back.loadings)


def test_the_paper_takes_inner_products(person):
    target, _ = turned(person, 0.0)
    offset = person.offset(faces(person)[4])
    expected = (person.basis.weight * offset.vector) @ np.asarray(person.basis.components, np.float64).T
    assert_allclose(
        mimic(person, target, "paper", max_sd=1e3)(offset).loadings, expected, rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize(("degrees", "scale"), [(0.0, 1.0), (20.0, 1.2)])
def test_the_papers_equation_is_the_mimicry_by_paper(person, degrees, scale):
    target, _ = turned(person, degrees, scale)
    face = person.expand(1.5 * faces(person)[4])
    made = mimic(person, target, "paper", max_sd=1e9)(face - person.mean).morph
    assert_allclose(Projection(person, target).mimicry(face).vector, made.vector, atol=1e-6)


@pytest.mark.parametrize(("degrees", "scale"), [(0.0, 1.0), (20.0, 1.0), (0.0, 1.2), (-15.0, 0.8)])
def test_displacements_turn_and_scale_with_the_face(person, wavy_field, degrees, scale):
    """Corresponding points move alike: u_B(G p) = L u_A(p)."""
    target, linear = turned(person, degrees, scale)
    height, width = person.mask.shape
    field = wavy_field(height, width, 3.0, seed=4, sd_px=10.0)
    texture = np.zeros((height, width, 3), np.float32)
    projection = Projection(person, target)
    carried = projection.carried(MorphOffset.of(texture, field, person.mean.reference_id))
    points = np.stack(np.meshgrid(np.arange(22, 38), np.arange(28, 44)), -1).reshape(-1, 2).astype(float)
    there = warp.apply_affine(projection.affine, points)
    found = warp.move_points(carried.displacement, there) - there
    expected = field[points[:, 1].astype(int), points[:, 0].astype(int)] @ linear.T
    assert_allclose(found, expected, atol=0.02 * 3.0)


def test_beyond_the_source_nothing_is_known_to_differ(person):
    target, _ = turned(person, 0.0, 0.5)
    height, width = person.mask.shape
    ones = MorphOffset.of(
        np.ones((height, width, 3), np.float32), np.ones((height, width, 2), np.float32), "r"
    )
    projection = Projection(person, target)
    carried = projection.carried(ones)
    assert carried.texture[0, 0].max() == 0 and carried.displacement[-1, -1].max() == 0
    assert projection.source_mask[0, 0] == 0 and projection.source_mask.max() > 0.9
    assert carried.reference_id == target.mean.reference_id


def test_another_person_is_expected_to_differ_by_far_more_than_a_model_leaves_out(person):
    """Anchored figures: 5000 times what the target leaves out, and all of what both masks show."""
    noisy = replace(person, basis=replace(person.basis, discarded_variance=1e-3))
    posterior = posterior_of(Projection(noisy, noisy))
    assert posterior.noise == pytest.approx(5.0)
    assert 0.3 < posterior.visible_share.min() <= posterior.visible_share.max() <= 1.0


def test_the_bound_keeps_order_and_small_loadings():
    values = np.linspace(-40, 40, 401)
    drawn = bounded(values, 3.0)
    assert np.abs(drawn).max() < 3.0
    assert (np.diff(drawn) > 0).all()
    assert_allclose(drawn, -drawn[::-1])
    small = np.abs(values) <= 1
    assert_allclose(drawn[small], values[small], rtol=0.004)


@pytest.mark.parametrize("method", METHODS)
def test_no_component_exceeds_the_bound_and_the_quality_counts_them(person, method):
    wild = person.offset(30 * person.sd)
    made = mimic(person, person, method, max_sd=2.0)(wild)
    assert np.abs(made.loadings / person.sd).max() <= 2.0
    assert made.quality.bounded == person.rank
    assert made.quality.largest_sd > 20
    assert made.quality.folds == 0 or method != "transfer"


def test_the_automatic_gain_undoes_a_muted_target(person):
    muted = person.truncate(1)
    assert GAIN_RANGE[0] <= auto_gain(person, person, "paper") < 1.01
    assert auto_gain(person, muted, "paper") > 1.01


def test_models_and_settings_that_cannot_mimic_are_refused(model, person):
    with pytest.raises(BadInput, match="morphspace keypoints"):
        mimic(model, person)
    with pytest.raises(BadInput, match="expected one of paper, map, transfer, guided"):
        mimic(person, person, "magic")
    for bad in ({"max_sd": 0.0}, {"max_sd": np.nan}, {"gain": np.inf}):
        with pytest.raises(BadInput, match=r"max_sd is .* and gain .*; expected"):
            mimic(person, person, **bad)
    empty: MorphModel = person.truncate(0)
    with pytest.raises(BadInput, match="no component"):
        mimic(person, empty)


def test_lids_brows_and_lips_weigh_more_where_they_are_known(person):
    assert_array_equal(feature_weights(person), 1)
    points = np.full((POINT_COUNT, 2), -1000.0)
    points[list(LIPS)] = (30.0, 50.0)
    found = DetectedFaceframe(FRAME, np.zeros(3), points, 40, 40)
    marked = person.with_faceframe(found.faceframe, found.origin)
    assert_allclose(landmarks_of(marked), points)
    weights = feature_weights(marked)
    assert weights[50, 30] == pytest.approx(31, rel=1e-3)  # an anchored figure
    assert weights[10, 30] == pytest.approx(1, abs=1e-3)
    assert landmarks_of(person.with_faceframe(FRAME, {"source": "set"})) is None


# landmarks


def test_landmarks_turn_and_scale_with_the_face(person):
    target, linear = turned(person, 20.0, 1.2)
    guide = landmark_guide(Projection(person, target))
    loadings = faces(person)[2]
    places = [place for group in GUIDES for place in range(*landmark_places(group).indices(len(LANDMARKS)))]
    expected = person.landmarks.moved(loadings)[places] @ linear.T
    assert_allclose(guide.moved(loadings).reshape(-1, 2), expected, atol=1e-9)


def test_landmarks_that_err_more_count_less(person):
    sure, unsure = (
        landmark_guide(Projection(person, knowing(person, error_px=error))) for error in (1.0, 4.0)
    )
    assert_allclose(unsure.observations.precision, sure.observations.precision * 2 / 17)


def test_what_only_the_landmarks_tell_reaches_the_target(person):
    """The source's warp lacks a motion of the target; its landmarks request it."""
    told = replace(
        person, basis=replace(person.basis, discarded_variance=1e-3)
    )  # another person's face differs
    weights = np.zeros_like(told.landmarks.weights)
    weights[2] = told.landmarks.weights[0]  # the source's third component closes what the target's first does
    source = told.with_landmarks(replace(told.landmarks, weights=weights))
    target_weights = np.zeros_like(weights)
    target_weights[0] = told.landmarks.weights[0]
    target = told.with_landmarks(replace(told.landmarks, weights=target_weights))
    asked = source.offset(np.array([0.0, 0.0, 1.0]) * source.sd)
    plain, guided = (mimic(source, target, method)(asked).loadings for method in ("transfer", "guided"))
    assert abs(plain[0]) < 0.1 * target.sd[0] < 0.3 * target.sd[0] < guided[0]


def test_without_a_regression_the_command_is_named(person):
    bare = person.with_landmarks(None)
    for source, target in ((bare, person), (person, bare)):
        with pytest.raises(BadInput, match=r"drawn .*morphspace keypoints MODEL --auto"):
            mimic(source, target, "guided")


# neutral


def resting(person, source, target):
    return Neutral("a,b", source, target, "a", "b")


@pytest.mark.parametrize("method", METHODS)
def test_the_neutral_source_gives_the_neutral_target(person, method):
    from_source, from_target = faces(person)[3], faces(person)[5]
    neutral = resting(person, from_source, from_target)
    made = mimic(person, person, method, max_sd=1e3, neutral=neutral)(person.offset(from_source))
    assert_allclose(made.loadings, from_target, atol=1e-5)
    apart = np.abs(made.morph.render() - person.render(from_target))
    assert np.quantile(apart, 0.99) < 0.02


@pytest.mark.parametrize("method", METHODS)
def test_one_neutral_frame_for_both_changes_nothing_between_equal_models(person, method):
    rest = faces(person)[3]
    offset = person.offset(faces(person)[1])
    plain = mimic(person, person, method, max_sd=1e3)(offset).loadings
    moved = mimic(person, person, method, max_sd=1e3, neutral=resting(person, rest, rest))(offset).loadings
    assert_allclose(moved, plain, atol=0.05 * np.abs(faces(person)).max())


def test_neutral_faces_of_other_models_are_refused(person):
    neutral = resting(person, np.zeros(5), np.zeros(person.rank))
    with pytest.raises(BadInput, match="neutral face of drawn has 5 loadings; expected 3"):
        mimic(person, person, neutral=neutral)
