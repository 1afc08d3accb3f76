"""Laws of neutral faces: like means are left alone, unlike ones are led to the frame nearest to the other."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LIPS, POINT_COUNT
from morphspace.model.keypoints import DetectedFaceframe
from morphspace.transfer import neutral
from morphspace.transfer.neutral import FAR_APART, means_apart, neutral_of

FRAME = FaceFrame((20.0, 30.0), (41.0, 29.0), (30.0, 44.0))
EYES_PX = float(np.hypot(21, 1))


def marked(model, down_px=0.0):
    """The model with mesh points whose lips lie on the slit of its mouth, the lower one `down_px` lower."""
    points = np.full((POINT_COUNT, 2), 30.0)
    points[list(LIPS)] = np.column_stack([np.linspace(24, 36, len(LIPS)), np.full(len(LIPS), 49.0)])
    lower = list(LIPS[::2])
    points[lower, 1] = 52.0 + down_px
    found = DetectedFaceframe(FRAME, np.zeros(3), points, 40, 40)
    return model.with_faceframe(found.faceframe, found.origin)


def test_a_mean_is_not_apart_from_itself_and_lips_count_in_eye_distances(model):
    here = marked(model)
    assert means_apart(here, here) == pytest.approx(0, abs=1e-9)
    apart = means_apart(here, marked(model, 4.0))
    assert apart == pytest.approx(
        4.0 / np.sqrt(2) / EYES_PX, rel=0.01
    )  # half of the points, root mean square


def test_a_moved_and_larger_faceframe_changes_nothing(model):
    here = marked(model)
    points = np.asarray(here.provenance["keypoints"]["points"]) * 0.5 + 3
    found = DetectedFaceframe(FaceFrame.at(FRAME.points * 0.5 + 3), np.zeros(3), points, 40, 40)
    small = model.with_faceframe(found.faceframe, found.origin)
    assert means_apart(here, small) == pytest.approx(0, abs=0.001)


def test_without_mesh_points_nothing_is_known(model):
    plain = model.with_faceframe(FRAME)
    assert means_apart(plain, marked(model)) is None and neutral_of(plain, marked(model)).is_means
    assert neutral_of(plain, plain, "frame_001").apart is None


def test_like_means_are_left_alone(model):
    neutral = neutral_of(marked(model), marked(model, 0.3))
    assert neutral.is_means and neutral.means_apart == neutral.apart > 0
    assert neutral.offsets(model, model) == (None, None)


def test_an_open_mean_is_reached_by_the_frame_that_opens_as_far(model):
    """One frame of the source equals the target's mean; it becomes the source's neutral frame."""
    from morphspace.grid import warp

    source = marked(model)
    points = np.asarray(source.provenance["keypoints"]["points"])
    openest = int(
        np.argmax(
            [
                warp.move_points(model.expand(row).displacement, points)[LIPS[0], 1]
                for row in model.training.values
            ]
        )
    )
    target_points = points.copy()
    target_points[list(LIPS)] += (
        2
        * (warp.move_points(model.expand(model.training.values[openest]).displacement, points) - points)[
            list(LIPS)
        ]
    )
    found = DetectedFaceframe(FRAME, np.zeros(3), target_points, 40, 40)
    target = model.with_faceframe(found.faceframe, found.origin)
    assert means_apart(source, target) > FAR_APART
    neutral = neutral_of(source, target)
    assert neutral.source_frame == model.training.frame_names[openest] and neutral.target_frame is None
    assert_array_equal(neutral.source, model.training.values[openest])
    assert_array_equal(neutral.target, 0)
    assert neutral.apart < 0.7 * neutral.means_apart


@pytest.mark.parametrize(("nearer", "taken"), [(0.95, False), (0.70, True)])
def test_a_frame_is_taken_where_it_comes_clearly_nearer_than_the_mean(model, monkeypatch, nearer, taken):
    source, target = marked(model), marked(model, 6.0)
    apart = means_apart(source, target)
    distances = np.full(len(model.training.values), 2 * apart)
    distances[4] = nearer * apart
    monkeypatch.setattr(neutral, "means_apart", lambda *models: apart)
    monkeypatch.setattr(neutral, "_lips_apart", lambda *faces: distances)
    assert neutral_of(source, target).source_frame == (model.training.frame_names[4] if taken else None)


def test_no_frame_much_nearer_leaves_the_means(model):
    still = replace(marked(model), training=replace(model.training, values=0 * model.training.values))
    assert means_apart(still, marked(model, 6.0)) > FAR_APART
    assert neutral_of(still, marked(model, 6.0)).is_means


@pytest.mark.parametrize(("apart_px", "recentred"), [(1.2, False), (2.4, True)])
def test_lips_that_are_apart_by_a_sixteenth_of_the_eye_distance_are_too_far_apart(model, apart_px, recentred):
    """FAR_APART: half of the lips lie `apart_px` lower, 0.04 and 0.081 of the eye distance, root mean square."""
    source, target = marked(model), marked(model, apart_px)
    assert means_apart(source, target) == pytest.approx(apart_px / np.sqrt(2) / EYES_PX, rel=0.02)
    assert neutral_of(source, target).is_means is not recentred


@pytest.mark.parametrize(("nearer", "recentred"), [(0.10, False), (0.20, True)])
def test_a_frame_must_come_nearer_by_fifteen_hundredths(model, nearer, recentred):
    """WORTHWHILE: the nearest frame reduces the means' distance by `nearer`."""
    source, target = marked(model), marked(model, 4.0)

    def with_one_frame(amount):
        """The source with one training frame, which opens its mouth, and what that takes off the distance."""
        values = np.array([[amount, 0.0, 0.0]])
        here = replace(source, training=replace(source.training, values=values, frame_names=("open",)))
        return here, 1 - neutral_of(here, target, "open").apart / means_apart(here, target)

    way = max((-1.0, 1.0), key=lambda sign: with_one_frame(0.1 * sign)[1])
    amount = next(way * step for step in np.linspace(0, 3, 300) if with_one_frame(way * step)[1] > nearer)
    here, taken_off = with_one_frame(amount)
    assert taken_off == pytest.approx(nearer, abs=0.02)
    assert neutral_of(here, target).is_means is not recentred


def test_frames_are_named_with_or_without_suffix(model):
    names = ("a.png", "b.png", "b.jpg", *model.training.frame_names[3:])
    here = replace(marked(model), training=replace(model.training, frame_names=names))
    neutral = neutral_of(here, here, "a,b.jpg")
    assert (neutral.source_frame, neutral.target_frame) == ("a.png", "b.jpg")
    assert_allclose(neutral.source, model.training.values[0])
    assert_allclose(neutral.target, model.training.values[2])
    assert neutral_of(here, here, "b.png").target_frame is None
    with pytest.raises(BadInput, match="2 training frames of drawn are called 'b'"):
        neutral_of(here, here, "b")
    with pytest.raises(BadInput, match=r"no training frame 'c.*a.png to frame_011"):
        neutral_of(here, here, "c")
