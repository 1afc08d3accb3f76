"""Laws of the points found in frames: once a frame, kept, never needed; and what a build takes from them."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.face import regions
from morphspace.face.detector import Detector
from morphspace.face.faceframe import FaceFrame
from morphspace.face.mesh import FACE_OUTLINE, LEFT_LIDS, PHILTRUM, POINT_COUNT, RIGHT_LIDS, FacePoints
from morphspace.face.regions import face_mask
from morphspace.face.registration import Registration
from morphspace.face.track import LEAST_WEIGHT, FaceTrack, GivenPoints, track_steps
from morphspace.grid import warp
from morphspace.model.passes import BuildSettings, build_steps
from morphspace.steps import result_of
from morphspace.storage import digest_of_array

SETTINGS = BuildSettings(components=6, flow="dis", reference=0, warp_weight=0.05)
PROVENANCE = {"identity": "drawn", "framing": {"source_size": [60, 72], "crop": None, "size": [60, 72]}}
HEIGHT, WIDTH = 72, 60


def neutral_points():
    """Points of a face at the usual position in a cropped frame of 60 x 72 px."""
    points = np.random.default_rng(6).uniform((12, 20), (48, 60), (POINT_COUNT, 2))
    for lids, x in ((RIGHT_LIDS, 21.0), (LEFT_LIDS, 39.0)):
        points[list(lids)] += np.array([x, 30.0]) - points[list(lids)].mean(axis=0)
    turns = np.linspace(0, 2 * np.pi, len(FACE_OUTLINE), endpoint=False)
    points[list(FACE_OUTLINE)] = np.array([30.0, 38.0]) + np.column_stack(
        [22 * np.sin(turns), -28 * np.cos(turns)]
    )
    points[PHILTRUM] = (30.0, 45.0)
    return points


class Looking:
    """A detector that finds the same points in every picture except the missed ones, and counts its calls."""

    def __init__(self, miss=()):
        self.miss, self.calls = [digest_of_array(picture) for picture in miss], 0

    def __call__(self, image):
        self.calls += 1
        if digest_of_array(image) in self.miss:
            return None
        return FacePoints(neutral_points(), 0.9, depth=np.zeros(POINT_COUNT))


def test_points_come_back_as_they_were_found_and_are_found_once(clip, tmp_path):
    look = Looking(miss=[clip.pictures[4]])
    detector = Detector(look, {"version": 1})
    first = result_of(track_steps(clip, detector, tmp_path))
    calls = look.calls
    second = result_of(track_steps(clip, detector, tmp_path))
    assert look.calls == calls > 0
    for index, (one, other) in enumerate(zip(first.faces, second.faces, strict=True)):
        if index == 4:
            assert one is None and other is None
            continue
        assert_array_equal(one.points, neutral_points())
        assert_array_equal(other.points, one.points)
        assert_array_equal(other.depth, one.depth)
        assert other.score == one.score == 0.9


def test_another_detector_looks_again_and_a_damaged_file_is_made_anew(clip, tmp_path):
    result_of(track_steps(clip, Detector(Looking(), {"version": 1}), tmp_path))
    files = sorted(tmp_path.glob("*.kept"))
    other = Looking()
    result_of(track_steps(clip, Detector(other, {"version": 2}), tmp_path))
    assert other.calls == len(files)
    files[0].write_bytes(files[0].read_bytes()[:-7])
    again = Looking()
    result_of(track_steps(clip, Detector(again, {"version": 1}), tmp_path))
    assert again.calls == 1


def built(clip, folder, settings=SETTINGS, **detector):
    folder.mkdir(exist_ok=True)
    wanted = replace(settings, detector=Detector(Looking(**detector), {"version": 1}))
    return result_of(build_steps(clip, wanted, folder, PROVENANCE))


def test_a_build_takes_mask_rigid_part_and_keypoints_from_the_face(clip, tmp_path, monkeypatch):
    monkeypatch.setattr(regions, "OVERLAP", 1.0)  # as if the usual ellipse lay beside the face
    build = built(clip, tmp_path / "with")
    model = build.model
    face = FacePoints(neutral_points(), 0.9)
    assert_allclose(model.reference_faceframe.points, face.faceframe().points)
    to_mean = warp.invert(model.mean_inverse)
    placed = FaceFrame.at(warp.move_points(to_mean, face.faceframe().points))
    assert_allclose(model.mask, face_mask(HEIGHT, WIDTH, placed), atol=0.02)  # the inverse of an inverse
    assert model.faceframe is not None and model.provenance["keypoints"]["source"] == "auto"
    assert model.provenance["mask_from"] == "found face"
    told = model.provenance["landmarks"]
    assert told["detector"] == {"version": 1} and told["frames_with_face"] == told["frames"] == len(
        clip.names
    )
    assert build.track.known.all() and not build.warnings


def test_the_usual_mask_stays_where_it_lies_on_the_face():
    face = FacePoints(neutral_points(), 0.9)
    assert regions.place_of_mask(face, HEIGHT, WIDTH) is None
    beside = FacePoints(neutral_points() / 3, 0.9)  # small, in a corner
    found = regions.place_of_mask(beside, HEIGHT, WIDTH)
    assert found is not None and found.points.tolist() == beside.faceframe().points.tolist()
    assert regions.place_of_mask(None, HEIGHT, WIDTH) is None


def test_a_frame_without_a_face_goes_without_and_is_counted(clip, tmp_path):
    build = built(clip, tmp_path / "with", miss=[clip.pictures[5]])
    assert build.track.known.sum() == len(clip.names) - 1 and not build.track.known[5]
    assert build.model.provenance["landmarks"]["frames_with_face"] == len(clip.names) - 1
    assert len(build.model.training.values) == len(clip.names)


def test_a_clip_in_which_no_face_is_found_is_built_as_without(clip, tmp_path):
    build = built(clip, tmp_path / "with", miss=clip.pictures)
    plain = result_of(build_steps(clip, SETTINGS, tmp_path / "plain", PROVENANCE))
    assert_array_equal(build.model.mask, plain.model.mask)
    assert_array_equal(build.model.basis.components, plain.model.basis.components)
    assert_array_equal(build.model.mask, face_mask(HEIGHT, WIDTH))
    assert not build.track.known.any() and plain.track is None


def test_a_build_looks_once_at_each_frame_and_the_points_move_with_the_aligned_picture(clip, tmp_path):
    look = Looking(miss=[clip.pictures[2]])
    faceframe = FacePoints(neutral_points(), 0.9).faceframe()  # given: keypoints need not be detected
    settings = replace(SETTINGS, faceframe=faceframe, detector=Detector(look, {"version": 1}))
    build = result_of(build_steps(clip, settings, tmp_path, PROVENANCE))
    assert look.calls == len(clip.names)
    for index in range(len(clip.names)):
        frame, _ = build.frame(index)
        if index == 2:
            assert frame.points.shape == (0, 2)
        else:
            assert_allclose(warp.apply_affine(frame.registration, frame.points), neutral_points(), atol=1e-9)


def test_a_given_mask_overrides_that_of_the_detected_face(clip, tmp_path):
    mask = np.zeros((HEIGHT, WIDTH), np.float32)
    mask[20:60, 15:45] = 1
    model = built(clip, tmp_path / "with", replace(SETTINGS, mask=mask)).model
    assert model.provenance["mask_from"] == "given"
    assert_allclose(model.mask, warp.sample_field(mask, model.mean_inverse), atol=1e-6)


def test_the_same_frames_and_detector_give_the_same_bytes(clip, tmp_path):
    for name in ("one", "two"):
        built(clip, tmp_path / name, miss=[clip.pictures[3]]).model.save(tmp_path / f"{name}.morph")
    assert (tmp_path / "one.morph").read_bytes() == (tmp_path / "two.morph").read_bytes()


def test_registration_starts_from_the_points_of_the_face(clip, tmp_path, monkeypatch):
    starts = []

    def registering(registration, image, start=None):
        starts.append(start)
        return np.eye(2, 3)

    monkeypatch.setattr(Registration, "of", registering)
    built(clip, tmp_path / "with", miss=[clip.pictures[2]])
    # Every frame but the reference is registered once; the one without a face starts from nothing.
    assert sum(start is None for start in starts) == 1
    for start in starts:
        if start is not None:
            assert_allclose(start, np.eye(2, 3), atol=1e-9)  # the same points in both


def track_of(faces, given=()):
    names = tuple(f"frame_{place}" for place in range(len(faces)))
    return FaceTrack(names, tuple(faces), np.array([name in given for name in names], bool))


def test_the_pose_of_each_frame_is_that_of_its_face_and_unknown_without_face_or_depth(turned_face):
    face = turned_face(yaw_deg=12.0)
    pose = track_of([face, None, replace(face, depth=None), turned_face(pitch_deg=-7.0)]).pose_deg
    assert_allclose(pose[0, 0], 12.0, atol=1e-6)  # degrees; rounding
    assert_allclose(pose[3, :2], (0.0, -7.0), atol=1e-6)
    assert np.isnan(pose[1]).all() and np.isnan(pose[2, :2]).all()
    assert pose[2, 2] == pose[0, 2] == face.roll_degrees


def test_a_frame_weighs_less_the_further_it_turns_from_the_usual_pose_and_not_for_a_tilt(turned_face):
    """LITTLE_TURN_DEG, FAR_TURN_DEG: 1 up to 10 degrees, a half at 17.5, the least at 25 from the median."""
    usual = [turned_face(pitch_deg=18.0)] * 7
    turns = {18 - 9.9: 1.0, 18 + 17.5: 0.5, 18 - 17.5: 0.5, 18 + 25.5: LEAST_WEIGHT}
    weights = track_of([*usual, *(turned_face(pitch_deg=pitch) for pitch in turns)]).weights
    assert_allclose(weights, [*np.ones(7), *turns.values()], atol=1e-6)
    tilted = track_of([turned_face(), turned_face(), turned_face(roll_deg=60.0)]).weights
    assert_allclose(tilted, 1.0)
    shaken = track_of([turned_face(), turned_face(), turned_face(yaw_deg=60.0)]).weights
    assert shaken.tolist() == [1, 1, LEAST_WEIGHT]


def test_a_frame_whose_turn_is_unknown_weighs_as_the_others(turned_face):
    flat = replace(turned_face(yaw_deg=60.0), depth=None)
    faces = [turned_face(), turned_face(), None, flat, turned_face(yaw_deg=80.0)]
    assert_allclose(track_of(faces).weights, [1, 1, 1, 1, LEAST_WEIGHT])
    assert_allclose(track_of([None, flat]).weights, 1.0)


def test_turned_frames_are_listed_the_most_turned_first(turned_face):
    faces = [turned_face(yaw_deg=21), None, turned_face(pitch_deg=-28), turned_face(roll_deg=50)]
    assert track_of(faces).turned().tolist() == [2, 0]
    assert track_of(faces).turned(25.0).tolist() == [2]
    assert track_of(faces, {"frame_0"}).document() | {"roll_deg": 0} == {
        "frames": 4,
        "frames_with_face": 3,
        "frames_given": 1,
        "frames_turned": 2,
        "yaw_deg": [-0.0, 21.0],
        "pitch_deg": [-28.0, 0.0],
        "roll_deg": 0,
    }


def test_given_points_are_used_as_they_are_and_the_other_frames_are_searched(clip, tmp_path):
    look = Looking()
    given = {clip.names[3]: FacePoints(neutral_points() + 1.25, 1.0)}
    track = result_of(track_steps(clip, Detector(look, {"version": 1}), tmp_path, given=given))
    assert look.calls == len(clip.names) - 1
    assert track.faces[3] is given[clip.names[3]]
    assert track.given.tolist() == [place == 3 for place in range(len(clip.names))]
    plain = result_of(track_steps(clip, Detector(look, {"version": 1}), tmp_path))
    assert not plain.given.any() and look.calls == len(clip.names)  # only the frame that had been given


def test_a_build_holds_a_frame_to_given_points_and_says_so(clip, tmp_path):
    moved = neutral_points() + np.array([2.0, 0.0])
    given = GivenPoints({clip.names[4]: FacePoints(moved, 1.0)}, {"file": "points.csv", "sha256": "0" * 64})
    plain = built(clip, tmp_path / "work", replace(SETTINGS, registration="none"))
    # The same work folder: the frame that was held to other points is not reused.
    build = built(clip, tmp_path / "work", replace(SETTINGS, registration="none", given=given))
    assert_allclose(build.frame(4)[0].points, moved)
    centre = (slice(34, 46), slice(24, 36))
    shift = build.frame(4)[1].displacement[centre] - plain.frame(4)[1].displacement[centre]
    assert np.median(shift[..., 0]) > 1.0 > np.abs(np.median(shift[..., 1]))  # px, of 2; the flow pulls back
    assert_array_equal(build.frame(3)[1].displacement, plain.frame(3)[1].displacement)
    told = build.model.provenance["landmarks"]
    assert told["given"] == {"file": "points.csv", "sha256": "0" * 64} and told["frames_given"] == 1
    assert "reference_points" not in told and "given" not in plain.model.provenance["landmarks"]


def test_given_points_of_the_reference_are_kept_with_the_model(clip, tmp_path):
    given = GivenPoints(
        {clip.names[0]: FacePoints(neutral_points(), 1.0)}, {"file": "a.csv", "sha256": "1" * 64}
    )
    told = built(clip, tmp_path / "given", replace(SETTINGS, given=given)).model.provenance["landmarks"]
    assert_allclose(told["reference_points"], neutral_points())
