"""What our constants do to a model: each figure or limit moves when its constant is ten times as large, or a tenth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.face.faceframe import FaceFrame, identity_affine
from morphspace.face.mesh import POINT_COUNT
from morphspace.io.clips import Clip
from morphspace.io.framing import Framing
from morphspace.io.sidecars import MarkedFaceframe, Sidecar
from morphspace.linear.pca import mean_row
from morphspace.linear.rows import RowArray
from morphspace.model.encode import notes_on_framing
from morphspace.model.from_clip import ClipSettings, _marked_faceframe
from morphspace.model.keypoint_sources import detected_keypoints
from morphspace.model.keypoints import detect_faceframe
from morphspace.model.landmarks import learn_landmarks
from morphspace.model.morph import shown_share, texture_columns
from morphspace.model.warp_weight import trial_weights
from morphspace.steps import result_of

POINTS = np.array([[20.0, 30], [41, 29], [30, 44]])


@pytest.mark.parametrize(("times", "is_much"), [(2.4, False), (2.6, True)])
def test_frames_enlarged_by_two_and_a_half_times_lose_small_motions(times, is_much):
    """ENLARGED_MUCH."""
    framing = Framing((100, 120), None, (round(100 * times), round(120 * times)))
    assert ("small motions are lost" in notes_on_framing(framing, "her")[0]) == is_much


class Seen:
    """A detection of three points."""

    def __init__(self, points):
        self.points = points

    def faceframe(self):
        return FaceFrame.at(self.points)


def still(model, faces):
    """The model with as many training faces, all of them its mean."""
    return replace(
        model,
        training=replace(model.training, values=np.zeros((faces, model.rank)), frame_names=("a",) * faces),
    )


def test_keypoints_are_detected_in_two_hundred_faces(model):
    """FACES, besides the mean."""
    assert next(detect_faceframe(still(model, 250), lambda image: None)).total == 201


@pytest.mark.parametrize(("faces", "are_enough"), [(2, False), (3, True)])
def test_keypoints_need_three_detections(model, faces, are_enough):
    """LEAST_FOUND: the detector misses the mean face."""
    answers = iter([None, *[Seen(POINTS)] * faces])
    steps = detect_faceframe(still(model, faces), lambda image: next(answers))
    if are_enough:
        assert result_of(steps).found == faces
    else:
        with pytest.raises(BadInput, match="half and 3"):
            result_of(steps)


@pytest.mark.parametrize(("share", "is_wide"), [(0.045, False), (0.055, True)])
def test_detections_a_twentieth_of_the_eye_distance_apart_contradict_each_other(model, share, is_wide):
    """WIDE_SPREAD: all detections lie on a circle around the point."""
    radius_px = share * np.hypot(*(POINTS[1] - POINTS[0]))
    turns = iter(2 * np.pi * np.arange(12) / 12)

    def detect(image):
        turn = next(turns)
        return Seen(POINTS + radius_px * np.array([np.cos(turn), np.sin(turn)]))

    notes = result_of(detected_keypoints(still(model, 11), detect)).notes
    assert any("apart" in note for note in notes) == is_wide


def test_the_ridge_of_noisy_landmarks():
    """RIDGES: the ridge that leaves least error in quiet, noisy and hopeless points; 3.0 and so on with ten times."""
    rng = np.random.default_rng(0)
    loadings, weights = rng.standard_normal((40, 3)), rng.standard_normal((3, POINT_COUNT, 2))
    points, noise = np.tensordot(loadings, weights, 1), rng.standard_normal((40, POINT_COUNT, 2))
    found = [
        learn_landmarks(loadings, points + much * noise, np.ones(3), 0 * weights).ridge
        for much in (0.1, 3.0, 100.0)
    ]
    assert found == [0.3, 10.0, 300.0]


def rows_of(frames, motion_px=1.0, colour=0.1):
    """Morph vectors (n, 5 * 256) of 16 x 16 px: noise with a root mean square motion and change of colour."""
    rows = np.random.default_rng(0).standard_normal((frames, 5 * 256)).astype(np.float32)
    rows -= rows.mean(axis=0)
    colours = texture_columns((16, 16))
    rows[:, colours] *= colour / np.sqrt(3)  # of three colours and of two directions
    rows[:, colours.stop :] *= motion_px / np.sqrt(2)
    return RowArray(rows * np.float32(np.sqrt(frames / (frames - 1))))


def trials_of(rows, components=3, weights=()):
    """The trials, and the frames that are held out."""
    read = []

    def load(path):
        read.append(int(path.name))
        return np.zeros((16, 16, 3), np.float32)

    files = [Path(str(n)) for n in range(rows.shape[0])]
    mask = np.ones((16, 16), np.float32)
    return trial_weights(rows, mean_row(rows), mask, components, files, load, weights), read


def test_eight_of_192_frames_are_held_out_for_the_warp_weight():
    """HELD_OUT, TRIED_FRAMES; FACTORS: the balanced weight, twice and four times that."""
    trials, held = trials_of(rows_of(300))
    assert held == [19, 56, 94, 131, 169, 207, 244, 282]
    assert [trial.weight for trial in trials] == pytest.approx([0.1, 0.2, 0.4], rel=0.02)


def test_half_as_many_components_as_frames_are_tried():
    """LARGEST_SHARE: of 24 frames 8 are held out, and 8 components tried."""
    rows = rows_of(24)
    (most,), (fewer,), (enough,) = (trials_of(rows, count, (0.1,))[0] for count in (99, 7, 8))
    assert most.psnr_db == enough.psnr_db != fewer.psnr_db


@pytest.mark.parametrize(
    ("motion_px", "colour", "trials"),
    [(0.8e-4, 0.1, 0), (1.2e-4, 0.1, 3), (1.0, 0.8e-6, 0), (1.0, 1.2e-6, 3)],
)
def test_where_next_to_nothing_changes_no_warp_weight_is_tried(motion_px, colour, trials):
    """STILL_PX2, STILL_COLOUR2."""
    assert len(trials_of(rows_of(12, motion_px, colour))[0]) == trials


@pytest.mark.parametrize(("eyes_px", "is_refused"), [(4.2, False), (3.8, True)])
def test_a_faceframe_is_at_least_four_pixels_wide_and_high(eyes_px, is_refused):
    """LEAST_FACEFRAME_PX."""
    points = np.array([[10.0, 10], [10 + eyes_px, 10], [12, 20]])
    clip = Clip("c", ("a",), (50, 40), Sidecar(faceframe=MarkedFaceframe("a", points)), (Path("a.png"),))
    if is_refused:
        with pytest.raises(BadInput, match="expected at least 4 px"):
            _marked_faceframe(clip, Framing(clip.size, None, clip.size))
    else:
        _marked_faceframe(clip, Framing(clip.size, None, clip.size))


def test_a_warp_weight_is_at_most_a_thousand():
    """MOST_WEIGHT."""
    ClipSettings(warp_weight=1000.0)
    with pytest.raises(BadInput):
        ClipSettings(warp_weight=1001.0)


def test_colours_fade_over_four_pixels_beyond_a_frame():
    """FADE_PX: half of them, 2 px outside."""
    aside = np.zeros((20, 20, 2), np.float32) - (2, 0)
    assert shown_share(aside, identity_affine())[5, 0, 0] == pytest.approx(0.5)
