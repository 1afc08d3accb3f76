"""Laws of mixed colours: a face that was shown keeps its own, and no colour lies beyond those that were shown."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.face.expression import ring_gaps
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LANDMARKS, landmark_places
from morphspace.model.keypoints import moved_by_components
from morphspace.model.landmarks import LandmarkRegression
from morphspace.transfer import colours
from morphspace.transfer.colours import MixedColours

FRAME = FaceFrame((20.0, 30.0), (41.0, 29.0), (30.0, 44.0))


@pytest.fixture(params=["by the warp", "by landmarks"])
def person(model, request):
    keyed = model.with_faceframe(FRAME)
    if request.param == "by the warp":
        return keyed
    per_sd = np.random.default_rng(7).standard_normal((model.rank, len(LANDMARKS), 2))
    mean, errors = np.full((len(LANDMARKS), 2), 30.0), np.ones(len(LANDMARKS))
    weights = per_sd / model.sd[:, None, None]
    return keyed.with_landmarks(LandmarkRegression(mean, weights, errors, 12, 1.0, False))


def own(model, loadings):
    """The texture offset of loadings by the components alone."""
    return model.offset(loadings).texture


def test_a_training_face_keeps_its_own_colours(person):
    texturing = MixedColours(person)
    for row in person.training.values:
        assert_allclose(texturing.change(row), own(person, row), atol=1e-5)


def test_the_mean_face_keeps_its_own_colours(person):
    assert_allclose(MixedColours(person).change(np.zeros(person.rank)), 0, atol=1e-7)


def test_colours_stay_within_those_of_the_training_faces(person):
    texturing = MixedColours(person)
    shown = np.stack([np.zeros_like(person.mean.texture), *(own(person, row) for row in texturing.faces)])
    least, most = shown.min(axis=0) - 1e-5, shown.max(axis=0) + 1e-5
    rng = np.random.default_rng(3)
    for loadings in rng.standard_normal((20, person.rank)) * 5 * person.sd:
        changed = texturing.change(loadings)
        assert (changed >= least).all() and (changed <= most).all()
    far = own(person, 5 * person.sd)
    assert (far < least).any() or (far > most).any()  # the components themselves go beyond


def test_colours_follow_the_loadings_without_a_jump(person):
    """Steps of a quarter length change the colours by a quarter; a jump would not shrink."""
    texturing = MixedColours(person)
    one, other = 1.7 * person.training.values[2], 1.7 * person.training.values[7]

    def largest(count):
        steps = [texturing.change((1 - t) * one + t * other) for t in np.linspace(0, 1, count)]
        return max(np.abs(after - before).max() for before, after in pairwise(steps))

    assert largest(1601) < 0.3 * largest(401)


def test_the_warp_stays_that_of_the_loadings(person):
    loadings = 4 * person.sd
    moved = MixedColours(person).offset(loadings).displacement
    assert_allclose(moved, person.offset(loadings).displacement, atol=1e-4)


def test_parts_share_every_pixel_between_them(person):
    """The parts of each component add up to that component."""
    total = np.zeros((person.rank, person.mask.size, 3))
    for part in MixedColours(person).parts:
        total[:, part.places] += part.colours.reshape(person.rank, -1, 3)
    assert_allclose(total, person.component_textures.reshape(total.shape), atol=1e-6)


def test_brows_belong_to_the_upper_part_and_the_mouth_to_the_lower(person):
    right, left, lip = FRAME.points
    upper, lower, _ = MixedColours(person).parts
    width = person.mask.shape[1]
    for point, part, other in ((right, upper, lower), (left, upper, lower), (lip, lower, upper)):
        place = int(point[1]) * width + int(point[0])
        assert place in part.places and place not in other.places


def test_a_mixture_is_of_the_hundred_nearest_training_faces(person, monkeypatch):
    """NEAREST."""
    values = np.random.default_rng(4).standard_normal((150, person.rank)) * person.sd
    names = tuple(f"f{place}" for place in range(150))
    crowd = replace(person, training=replace(person.training, values=values, frame_names=names))
    texturing, mixed = MixedColours(crowd), []
    monkeypatch.setattr(
        colours,
        "nearest_mixture",
        lambda apart, costs: mixed.append(costs) or np.ones(len(costs)) / len(costs),
    )
    part, loadings = texturing.parts[0], 1.5 * person.sd
    texturing.mixed(part, loadings)
    every = 0.3 * ((part.training_shapes - loadings @ part.shape) ** 2).sum(axis=1)  # LOCALITY
    assert_allclose(np.sort(mixed[0]), np.sort(every)[:100])


def test_the_picture_is_the_sum_of_its_parts(person):
    texturing, loadings = MixedColours(person), 1.5 * person.training.values[3]
    total = np.zeros((person.mask.size, 3))
    for part in texturing.parts:
        total[part.places] += (texturing.mixed(part, loadings) @ part.colours).reshape(-1, 3)
    assert_allclose(texturing.change(loadings).reshape(-1, 3), total, atol=1e-5)
    places = np.concatenate([part.places for part in texturing.parts])
    assert len(np.unique(places)) < len(places)  # some pixels belong to two


@pytest.mark.parametrize("person", ["by landmarks"], indirect=True)
def test_the_mouth_is_chosen_by_lips_and_the_eyes_by_lids(person):
    """Two loadings: one moves the lips, the other the lids. Each part compares its own features."""
    weights = np.zeros_like(person.landmarks.weights)
    for component, groups in ((0, ("outer lips", "inner lips")), (1, ("lids", "brows"))):
        for group in groups:
            weights[component, landmark_places(group)] = person.landmarks.weights[
                component, landmark_places(group)
            ]
    told = person.with_landmarks(replace(person.landmarks, weights=weights))
    texturing = MixedColours(told)
    upper, lower, _ = texturing.parts
    assert not upper.shape[0].any() and upper.shape[1].any()
    assert not lower.shape[1].any() and lower.shape[0].any()


def about_middle(moved):
    return moved - moved.mean(axis=0)


def length(*features):
    """The length of features (m, 2), each root mean square."""
    return np.sqrt(sum((one**2).sum() / len(one) for one in features))


def lids_brows_and_lips(moved):
    """The features of both parts from moved landmarks (m, 2): about their middles, and gaps twice (OPENING)."""
    lids, brows, outer, inner = (
        moved[landmark_places(name)] for name in ("lids", "brows", "outer lips", "inner lips")
    )
    eyes = lids[:16], lids[16:]
    upper = [
        *map(about_middle, eyes),
        *(2 * ring_gaps(eye[None])[0] for eye in eyes),
        brows - lids.mean(axis=0),
    ]
    return upper, [about_middle(np.concatenate([outer, inner])), 2 * ring_gaps(inner[None])[0]]


@pytest.mark.parametrize("person", ["by landmarks"], indirect=True)
def test_faces_are_compared_by_the_shape_of_lids_brows_and_lips(person):
    """In eye distances: of a face and its loadings, what its landmarks move."""
    right, left, _ = FRAME.points
    eyes_px = np.hypot(*(np.array(left) - right))
    loadings = 1.3 * person.sd * (1, -1, 1)
    moved = np.tensordot(loadings, person.landmarks.weights, 1) / eyes_px
    for part, features in zip(MixedColours(person).parts, lids_brows_and_lips(moved), strict=False):
        assert np.linalg.norm(loadings @ part.shape) == pytest.approx(length(*features))


def test_movement_in_colour_alone_counts_for_lids_and_brows(drawn_anna):
    model = drawn_anna.model
    right, left, _ = model.faceframe.points
    points = np.asarray(model.provenance["keypoints"]["points"])[list(LANDMARKS)]
    eyes_px, loadings = np.hypot(*(left - right)), model.sd * (1, -1, 1, -1, 1, 1)
    moved, by_warp = (
        np.tensordot(loadings, each, 1) / eyes_px
        for each in (model.landmarks.weights, moved_by_components(model, points))
    )
    upper, lower = lids_brows_and_lips(moved)
    upper += [(moved - by_warp)[landmark_places(name)] for name in ("lids", "brows")]
    for part, features in zip(MixedColours(model).parts, (upper, lower), strict=False):
        assert np.linalg.norm(loadings @ part.shape) == pytest.approx(length(*features))


def test_where_landmarks_are_unknown_faces_are_compared_by_their_warp(model):
    """Root mean square over the part, in eye distances; the surroundings always are."""
    person = model.with_faceframe(FRAME)
    right, left, _ = (np.array(point) for point in FRAME.points)
    loadings = 1.3 * person.sd * (1, -1, 1)
    square = (person.displacement_offset(loadings) ** 2).sum(axis=2).reshape(-1)
    texturing = MixedColours(person)
    inside = person.mask.reshape(-1)
    around = texturing.parts[2]
    expected = np.sqrt((square * (1 - inside)).sum() / (1 - inside).sum()) / np.hypot(*(left - right))
    assert np.linalg.norm(loadings @ around.shape) == pytest.approx(expected, rel=1e-4)
    both = [np.linalg.norm(loadings @ part.shape) for part in texturing.parts[:2]]
    whole = np.sqrt((square * inside).sum() / inside.sum()) / np.hypot(*(left - right))
    assert min(both) < whole < max(both)


def test_a_model_without_training_faces_has_the_colours_of_its_mean(model):
    person = model.with_faceframe(FRAME)
    empty = replace(
        person, training=replace(person.training, values=person.training.values[:0], frame_names=())
    )
    assert_allclose(MixedColours(empty).change(2 * person.sd), 0, atol=1e-7)


def test_gaps_are_between_points_that_face_each_other():
    angles = 2 * np.pi * np.arange(20) / 20
    ring = np.column_stack([-np.cos(angles), -np.sin(angles)])[
        None
    ]  # corner, over the top, corner, back below
    gaps = ring_gaps(ring)[0]
    assert gaps.shape == (9, 2)
    assert_allclose(gaps[:, 0], 0, atol=1e-12)
    assert_allclose(gaps[:, 1], 2 * np.sin(angles[1:10]), atol=1e-12)
