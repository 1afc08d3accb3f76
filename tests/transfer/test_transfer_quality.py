"""What a mouth is asked to open beyond what it ever showed: counted in eye distances, from the landmark regressions."""

import numpy as np
import pytest

from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import LANDMARKS, landmark_places
from morphspace.model.landmarks import LandmarkRegression
from morphspace.transfer.mimicry import mimic
from morphspace.transfer.neutral import Neutral, neutral_of
from morphspace.transfer.quality import Quality, Reach, _openings_of, reach_of
from morphspace.transfer.quality_table import BEYOND, FOLDS, FrameMade, rounded

FRAME = FaceFrame((20.0, 30.0), (40.0, 30.0), (30.0, 44.0))
EYES_PX = 20.0
PER_SD_PX = 4.0  # the lower lip goes down by as much for an SD of the first component


@pytest.fixture
def talker(model):
    """The drawn model; its first component opens the mouth."""
    weights = np.zeros((model.rank, len(LANDMARKS), 2))
    places = landmark_places("inner lips")
    weights[0, places.start + 11 : places.stop, 1] = PER_SD_PX / model.sd[0]
    mean, errors = np.full((len(LANDMARKS), 2), 30.0), np.ones(len(LANDMARKS))
    return model.with_faceframe(FRAME).with_landmarks(
        LandmarkRegression(mean, weights, errors, 12, 1.0, False)
    )


def opening(model, sd):
    return model.offset(np.array([sd * model.sd[0]]))


def beyond(source, target, sd, gain=1.0, neutral=None):
    offset = opening(source, sd)
    made = mimic(source, target, "map", gain=gain)(offset)
    loadings = np.pad([sd * source.sd[0]], (0, source.rank - 1))
    return reach_of(source, target, gain, neutral)(offset, made.morph, made.loadings, loadings).opening_beyond


def test_opening_beyond_is_the_requested_opening_minus_the_widest(talker):
    most = (talker.training.values[:, 0] / talker.sd[0]).max()
    for sd in (-1.0, 0.5, most, most + 2):
        assert beyond(talker, talker, sd) == pytest.approx((sd - most) * PER_SD_PX / EYES_PX, abs=1e-4)
    assert beyond(talker, talker, 1.0, gain=3.0) == pytest.approx(beyond(talker, talker, 3.0), abs=1e-4)


def test_no_training_face_is_beyond_its_own_range(talker):
    openings = _openings_of(talker, talker, neutral_of(talker, talker, "mean"))
    for row in talker.training.values:
        assert openings.beyond(row, 1.0) < 1e-4


def test_one_neutral_frame_for_both_changes_nothing(talker):
    loadings = np.pad([0.7 * talker.sd[0]], (0, talker.rank - 1))
    neutral = Neutral("a,a", loadings, loadings, "a", "a")
    assert beyond(talker, talker, 2.5, neutral=neutral) == pytest.approx(
        beyond(talker, talker, 2.5), abs=1e-4
    )


def test_a_larger_face_asks_for_as_much_in_its_own_eye_distances(talker):
    points = (FRAME.points - FRAME.points.mean(0)) * 0.5 + FRAME.points.mean(0)
    small = talker.with_faceframe(FaceFrame.at(points))
    most = beyond(talker, talker, 0.0) / beyond(talker, small, 0.0)
    assert most == pytest.approx(
        0.5, abs=1e-4
    )  # the same pixels are twice the eye distance of the small face
    asked = beyond(talker, small, 1.0) - beyond(talker, small, 0.0)
    assert asked == pytest.approx(PER_SD_PX / EYES_PX, abs=1e-4)


def test_without_landmarks_it_is_not_known(talker):
    for source, target in ((talker.with_landmarks(None), talker), (talker, talker.with_landmarks(None))):
        assert beyond(source, target, 1.0) is None


@pytest.mark.parametrize(
    ("missing", "wider", "folds", "flags"),
    [
        (0.10004, 0.03004, 0.0050004, ()),  # as the table rounds them, they are at their limits
        (0.1001, None, 0.0, (BEYOND,)),
        (0.0, 0.0301, 0.0, (BEYOND,)),
        (0.0, None, 0.005001, (FOLDS,)),
        (0.2, -1.0, 0.1, (BEYOND, FOLDS)),
    ],
)
def test_a_frame_is_flagged_beyond_its_limits(missing, wider, folds, flags):
    """OUT_OF_RANGE and WIDER, eye distances; FOLDED, of the cells; DECIMALS."""
    quality = Quality(1.0, 1.0, 1.0, 1.0, 0, folds)
    frame = FrameMade((0.0,), quality, Reach(missing, 1.0, wider), None, None, 0, "")
    assert frame.flags == flags


def test_the_table_keeps_as_many_decimals_as_another_machine_agrees_on():
    shares = ("texture_kept", "warp_kept", "missing_motion", "opening_beyond")
    assert [rounded(name, 0.123456) for name in (*shares, "colour_agreement")] == [0.1235] * 5
    assert [rounded(name, 1.23456) for name in ("length_sd", "largest_sd", "outside_source")] == [1.235] * 3
    assert [rounded(name, 1.26) for name in ("yaw_deg", "pitch_deg")] == [1.3] * 2
    assert rounded("folds", 0.01234567) == 0.012346
