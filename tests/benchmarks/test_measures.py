"""Laws of the judge's measures: they see the expression, not the head's place; perfect mimicry has r and slope 1."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "judges" / "measures.py"


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


judge = loaded(SCRIPT)
NAMES = list(judge.MEASURES)


def ring(x, y, half_width, half_height, angles):
    angles = np.deg2rad(angles)
    return np.column_stack([x + half_width * np.cos(angles), y - half_height * np.sin(angles)])


def face(opening=0.1, width=1.0, lips=0.3, brow=0.45, aperture=0.2, jaw=1.9):
    """A drawn face (68, 2) whose eyes are 1 apart, with these measures by construction."""
    points = np.zeros((68, 2))
    angles = np.deg2rad(np.linspace(180, 360, 17))
    points[:17] = np.column_stack([0.5 + 1.2 * np.cos(angles), 0.3 - 0.9 * np.sin(angles)])
    points[7:10, 1] = jaw
    for eye, first, brows in ((0.0, 36, 17), (1.0, 42, 22)):
        points[brows : brows + 5] = np.column_stack([eye + np.linspace(-0.3, 0.3, 5), np.full(5, -brow)])
        points[first : first + 6] = ring(eye, 0, 0.25, 0, [180, 120, 60, 0, -60, -120])
        points[first + 1 : first + 3, 1] = -aperture / 2
        points[first + 4 : first + 6, 1] = aperture / 2
    points[27:36] = np.column_stack([np.full(9, 0.5), np.linspace(0, 0.8, 9)])
    x, y = 0.5, 1.2
    points[[48, 60]] = [x - width / 2, y]
    points[[54, 64]] = [x + width / 2, y]
    for places, height in (((49, 50, 51, 52, 53), -lips / 2), ((59, 58, 57, 56, 55), lips / 2)):
        points[list(places)] = np.column_stack([x + np.linspace(-0.2, 0.2, 5), np.full(5, y + height)])
    for places, height in (((61, 62, 63), -opening / 2), ((67, 66, 65), opening / 2)):
        points[list(places)] = np.column_stack([x + np.linspace(-0.1, 0.1, 3), np.full(3, y + height)])
    return points


def performance(count=20, seed=0):
    """Measures (n, 6) that move by themselves."""
    rng = np.random.default_rng(seed)
    return np.array([0.1, 1.0, 0.3, 0.45, 0.2, 1.9]) + rng.normal(0, 0.05, (count, 6))


def readings(path, names, landmarks, embeddings):
    found = np.isfinite(landmarks).all(axis=(1, 2))
    np.savez(path, names=np.array(names), found=found, landmarks=landmarks, embeddings=embeddings)
    return path


# expression


def test_each_measure_is_what_was_drawn():
    wanted = {"opening": 0.25, "width": 1.1, "lips": 0.5, "brow": 0.4, "aperture": 0.15, "jaw": 2.1}
    assert_allclose(judge.expression(face(**wanted)[None])[0], list(wanted.values()), atol=1e-12)


@pytest.mark.parametrize("index", range(6))
def test_a_measure_sees_its_own_movement_and_no_other(index):
    name = ("opening", "width", "lips", "brow", "aperture", "jaw")[index]
    change = judge.expression(face(**{name: 0.7})[None])[0] - judge.expression(face()[None])[0]
    assert abs(change[index]) > 0.1
    assert_allclose(np.delete(change, index), 0, atol=1e-12)


@settings(deadline=None, derandomize=True)
@given(st.floats(20, 300), st.floats(-60, 60), st.floats(-500, 500), st.floats(-500, 500))
def test_place_size_and_tilt_of_the_head_do_not_count(scale, turn_deg, right, down):
    cosine, sine = scale * np.cos(np.deg2rad(turn_deg)), scale * np.sin(np.deg2rad(turn_deg))
    moved = face(opening=0.3) @ np.array([[cosine, -sine], [sine, cosine]]).T + (right, down)
    assert_allclose(judge.expression(moved[None]), judge.expression(face(opening=0.3)[None]), atol=1e-9)


def test_a_mirrored_face_has_the_same_measures():
    swapped = [
        *range(16, -1, -1),
        *range(26, 16, -1),
        *range(27, 31),
        *range(35, 30, -1),
        *(45, 44, 43, 42, 47, 46, 39, 38, 37, 36, 41, 40),
        *(54, 53, 52, 51, 50, 49, 48, 59, 58, 57, 56, 55),
        *(64, 63, 62, 61, 60, 67, 66, 65),
    ]
    one = face(opening=0.3) + np.random.default_rng(1).normal(0, 0.02, (68, 2))
    other = (one * (-1, 1))[swapped]
    assert_allclose(judge.expression(other[None]), judge.expression(one[None]), atol=1e-12)


def test_a_closed_mouth_whose_lips_cross_reads_below_zero():
    assert judge.expression(face(opening=-0.05)[None])[0, 0] == pytest.approx(-0.05)


def test_a_frame_without_a_face_stays_without():
    values = judge.expression(np.stack([face(), np.full((68, 2), np.nan)]))
    assert np.isfinite(values[0]).all() and np.isnan(values[1]).all()


# mimicry


def test_perfect_mimicry_is_one_and_a_share_of_it_is_its_slope():
    source = performance()
    assert_allclose(judge.mimicry(source, source), 1.0)
    found = judge.mimicry(source, 0.4 * source + 7)
    assert_allclose(found[:, 0], 1.0)
    assert_allclose(found[:, 1], 0.4)
    assert_allclose(judge.mimicry(source, -source), -1.0)


def test_r_and_slope_are_those_of_least_squares():
    source, made = performance(seed=1), performance(seed=1) * 0.7 + performance(seed=2)
    found = judge.mimicry(source, made)
    for index in range(6):
        x, y = source[:, index], made[:, index]
        assert found[index, 0] == pytest.approx(np.corrcoef(x, y)[0, 1])
        assert found[index, 1] == pytest.approx(np.polyfit(x, y, 1)[0])


def test_what_does_not_move_in_the_source_is_not_judged_and_what_is_not_followed_has_r_0():
    source, made = performance(), performance()
    source[:, 2] = 0.3
    made[:, 4] = 0.2
    found = judge.mimicry(source, made)
    assert np.isnan(found[2]).all()
    assert_allclose(found[4], 0, atol=1e-12)
    assert_allclose(found[[0, 1, 3, 5]], 1.0)


def test_frames_without_a_face_in_either_are_left_out():
    source, made = performance(), performance()
    source[3], made[7] = np.nan, np.nan
    assert_allclose(judge.mimicry(source, made), 1.0)
    with pytest.raises(judge.Refusal, match="found in 2 frames"):
        judge.mimicry(source[:4], made[:4] * [[1], [np.nan], [1], [1]])


# identity


def test_the_identity_distance_is_that_to_the_mean_and_leaves_out_missing_faces():
    person = np.zeros((4, 128))
    person[:, 0] = [1, -1, 1, -1]
    made = np.zeros((3, 128))
    made[:2, 1], made[2] = [0.3, 0.5], np.nan
    assert judge.identity_distance(made, person) == pytest.approx(0.4)
    assert judge.identity_distance(person, person) == pytest.approx(1.0)
    assert np.isnan(judge.identity_distance(made[2:], person))


def test_pairs_of_one_set_leave_out_each_with_itself():
    person = np.zeros((3, 128))
    person[:, 0] = [0, 1, 2]
    assert judge.pair_distance(person, person) == pytest.approx((1 + 1 + 2) / 3)
    assert judge.pair_distance(person, person.copy()) == pytest.approx(2 * (1 + 1 + 2) / 9)


# files and the command


def test_frames_are_paired_by_name_whatever_their_suffix_and_order(tmp_path, capsys):
    faces = np.stack([face(*row) for row in performance()])
    names = [f"frame_{i:03d}.jpg" for i in range(len(faces))]
    other = [name.replace(".jpg", ".png") for name in names]
    zeros = np.zeros((len(faces), 128))
    source = readings(tmp_path / "source.npz", names, faces, zeros)
    made = readings(tmp_path / "made.npz", other[::-1][:15], faces[::-1][:15] * 2, zeros[:15] + 0.1)
    assert judge.main(["mimicry", str(source), str(made), "--target", str(source)]) == 0
    told = capsys.readouterr().out
    assert "15 frames in both" in told and "mean of 6          1.000   1.000" in told
    assert f"identity to target: {0.1 * np.sqrt(128):.3f}" in told


def test_the_table_holds_each_frame(tmp_path):
    faces = np.stack([face(opening=0.3), np.full((68, 2), np.nan)])
    path = readings(tmp_path / "a.npz", ["a.png", "b.png"], faces, np.zeros((2, 128)))
    assert judge.main(["table", str(path), "-o", str(tmp_path / "a.csv")]) == 0
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0].split(",") == ["file", "found", *NAMES]
    assert lines[1].startswith("a,1,0.30000,1.00000") and lines[2] == "b,0,,,,,,"


@pytest.mark.parametrize("kind", ["missing", "text", "shape", "names"])
def test_what_cannot_be_read_is_one_line_and_exit_2(tmp_path, capsys, kind):
    good = readings(tmp_path / "good.npz", ["a", "b", "c"], np.stack([face()] * 3), np.zeros((3, 128)))
    bad = tmp_path / "bad.npz"
    if kind == "text":
        bad.write_text("nothing")
    elif kind == "shape":
        readings(bad, ["a"], face()[None], np.zeros((1, 64)))
    elif kind == "names":
        readings(bad, ["x", "y", "z"], np.stack([face()] * 3), np.zeros((3, 128)))
    assert judge.main(["mimicry", str(good), str(bad)]) == 2
    told = capsys.readouterr().err
    assert told.startswith("measures: ") and len(told.splitlines()) == 1


def test_the_package_does_not_know_the_judge():
    package = Path(__file__).parents[2] / "morphspace"
    for path in package.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "dlib" not in text and "benchmarks.judges" not in text, path


def test_the_points_of_a_mesh_at_the_same_places_give_the_same_measures():
    landmarks = np.stack([face(opening=0.3), face(brow=0.2)])
    mesh = np.full((2, 478, 2), np.nan)
    for name in judge.Template.__dataclass_fields__:
        here, there = (np.ravel(getattr(template, name)) for template in (judge.IBUG, judge.MESH))
        mesh[:, there] = landmarks[:, here]
    assert_allclose(judge.expression(mesh, judge.MESH), judge.expression(landmarks), atol=1e-12)


def test_readings_come_back_as_they_were(tmp_path):
    path = readings(tmp_path / "a.npz", ["a.png"], face()[None], np.ones((1, 128)))
    back = judge.read_readings(path)
    assert back.names == ("a",) and back.found.tolist() == [True]
    assert_array_equal(back.landmarks[0], face())
