"""Laws of marked points: every program's file gives the same eyes and lip, whichever way its y counts."""

import contextlib
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.points import TEMPLATES, _read_tps, read_marked_points
from morphspace.io.sidecars import MarkedFaceframe, read_sidecar

HEIGHT = 240
SIZE = (200, HEIGHT)
EXCHANGED = "the eyes were exchanged: the subject's right eye is on the left of the image"
POINTS = np.array([[78.25, 101.5], [124.0, 100.0], [100.5, 140.75]])


@pytest.fixture
def file(tmp_path):
    def written(name, text):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return written


def rows(points, between="\t"):
    return "".join(f"{x:g}{between}{y:g}\n" for x, y in points)


def tps(points, tail="IMAGE=a.jpg\nID=0\nSCALE=0.5\n"):
    return f"LM={len(points)}\n{rows(points, ' ')}{tail}"


def up_from_bottom(points):
    return np.column_stack([points[:, 0], HEIGHT - 1 - points[:, 1]])


def templated(count):
    """A template of `count` points in which every point is told apart, eyes and lip where a face has them."""
    template = TEMPLATES[count]
    points = np.column_stack([np.arange(count) * 0.5, np.full(count, 200.0)])
    for places, (x, y) in zip((*template.eyes, template.philtrum, template.upper_lip), FACE, strict=True):
        offsets = np.arange(len(places)) - (len(places) - 1) / 2
        points[list(places)] = np.column_stack([x + offsets, y - offsets])
    return points


FACE = np.array([[78.0, 101], [124, 100], [100, 140], [101, 150]])  # eyes, philtrum, bottom of the upper lip


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "x,y\n" + rows(POINTS, ",")),
        ("a.txt", rows(POINTS, " ")),
        ("a.tem", "3\n" + rows(POINTS) + "1\n0\n3\n0 1 2\n"),
        ("a.tps", tps(POINTS)),
        ("negative.tps", tps(POINTS * (1, -1))),
        ("upwards.tps", tps(up_from_bottom(POINTS))),
        ("A.TPS", tps(POINTS).replace("\n", "\r\n").replace("LM=", "lm = ")),
        ("curved.tps", tps(POINTS, "CURVES=1\nPOINTS=2\n1 2\n3 4\nID=a\n")),
    ],
)
def test_every_program_gives_the_same_points(file, name, text):
    assert_allclose(read_marked_points(file(name, text), SIZE).points, POINTS, atol=1e-9)


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + tps(POINTS).encode(),
        tps(POINTS, "IMAGE=M\xfcller.jpg\n").encode("latin-1"),
        tps(POINTS, "IMAGE=M\xfcller.jpg\n").encode(),
        tps(POINTS).replace("\n", "\r").encode(),
        tps(POINTS).encode() + b"\x1a",
    ],
)
def test_a_file_of_another_system_is_read(tmp_path, content):
    (tmp_path / "a.tps").write_bytes(content)
    assert_allclose(read_marked_points(tmp_path / "a.tps", SIZE).points, POINTS, atol=1e-9)
    name = _read_tps(tmp_path / "a.tps")[0][0]
    assert name == ("M\xfcller.jpg" if b"ller" in content else "a.jpg")


def test_our_own_faceframe_is_read_too(tmp_path):
    named = dict(zip(("right_eye", "left_eye", "philtrum"), POINTS.tolist(), strict=True))
    document = {"format": "morphspace-faceframe", "version": 1, "image": "a.png", **named}
    (tmp_path / "a.json").write_text(json.dumps(document))
    marked = read_marked_points(tmp_path / "a.json", SIZE)
    assert_array_equal(marked.points, POINTS)
    assert marked.lip == "philtrum"


@pytest.mark.parametrize(
    ("name", "said"), [("negative.tps", "negative"), ("upwards.tps", "height of 240 px")]
)
def test_a_turned_y_is_said(file, name, said):
    points = POINTS * (1, -1) if name == "negative.tps" else up_from_bottom(POINTS)
    marked = read_marked_points(file(name, tps(points)), SIZE)
    assert said in marked.notes[0] and name in marked.notes[0]
    assert read_marked_points(file("down.tps", tps(POINTS)), SIZE).notes == ()


@pytest.mark.parametrize("points", [POINTS * (1, -1), up_from_bottom(POINTS)])
def test_other_files_are_turned_only_when_asked(file, points):
    path = file("a.csv", rows(points, ","))
    assert_array_equal(read_marked_points(path, SIZE).points, points)
    assert_allclose(read_marked_points(path, SIZE, y_axis="up").points, POINTS, atol=1e-9)


@pytest.mark.parametrize("count", sorted(TEMPLATES))
@pytest.mark.parametrize("suffix", [".tem", ".csv", ".tps"])
def test_a_template_gives_its_eyes_and_the_lip_that_was_asked_for(file, count, suffix):
    points = templated(count)
    head = {".tem": f"{count}\n", ".csv": "", ".tps": f"LM={count}\n"}[suffix]
    path = file(f"a{suffix}", head + rows(points, " "))
    for lip, place in ((None, 2), ("philtrum", 2), ("upper-lip", 3)):
        marked = read_marked_points(path, SIZE, lip=lip)
        assert_allclose(marked.points, FACE[[0, 1, place]], atol=1e-9)
        assert marked.lip == (lip or "philtrum") and str(count) in marked.scheme


def test_three_points_of_a_tem_are_webmorphs_unless_said_otherwise(file):
    path = file("a.tem", "3\n" + rows(POINTS))
    marked = read_marked_points(path, SIZE)
    assert marked.lip == "upper-lip" and "--lip philtrum" in marked.notes[0]
    marked = read_marked_points(path, SIZE, lip="philtrum")
    assert marked.lip == "philtrum" and marked.notes == ()
    assert read_marked_points(file("a.csv", rows(POINTS, ",")), SIZE).lip == "philtrum"


def test_of_more_points_in_a_list_the_first_three_are_taken_and_that_is_said(file):
    path = file("a.csv", rows(POINTS, ",") + "1,2\n3,4\n")
    marked = read_marked_points(path, SIZE)
    assert_array_equal(marked.points, POINTS)
    assert "5 points" in marked.notes[0]


def test_specimens_are_told_apart_by_their_picture(file):
    path = file("two.tps", tps(POINTS) + tps(POINTS * 2, "ID=b\n") + tps(POINTS[:2], ""))
    specimens = _read_tps(path)
    assert [name for name, _ in specimens] == ["a.jpg", "b", "3"]
    assert_array_equal(specimens[1][1], POINTS * 2)
    with pytest.raises(BadInput, match="3 specimens"):
        read_marked_points(path, SIZE)


@pytest.mark.parametrize(
    ("name", "text", "mentioned"),
    [
        ("a.tem", "178\n" + "1 2\n" * 178, "178 points; expected a template of 3, 68, 189"),
        ("a.tps", "LM=5\n" + "1 2\n" * 5, "5 points"),
        ("two.csv", "1,2\n3,4\n", "2 points"),
        ("short.tps", "LM=3\n1 2\n3 4\nID=a\n", "line 1 declares 3 landmarks"),
        ("cut.tps", "LM=3\n1 2\n3 4\n", "line 1 declares 3 landmarks"),
        ("long.tps", "LM=3\n1 2\n3 4\n5 6\n7 8\n", "line 5 is '7 8'; expected no more"),
        (
            "curve.tps",
            tps(POINTS, "CURVES=1\nPOINTS=4\n1 2\n3 4\nID=a\n"),
            "line 6 declares 4 points of a curve",
        ),
        (
            "swallow.tps",
            tps(POINTS, "CURVES=1\nPOINTS=999999999\n1 2\n") + tps(POINTS),
            "line 6 declares 999999999",
        ),
        ("wordy.tps", tps(POINTS, "CURVES=1\nPOINTS=1\nleft lip\n"), "line 7 is 'left lip'"),
        ("minus.tps", "LM=-3\n1 2\n3 4\n5 6\n", "line 1 is 'LM=-3'; expected LM= and a number"),
        ("huge.tps", "LM=999999999\n1 2\n", "line 1 declares 999999999 landmarks"),
        (
            "endless.tps",
            "LM=" + "9" * 5000 + "\n1 2\n",
            r"line 1 is 'LM=9{37}\.\.\.'; expected LM= and a number",
        ),
        ("half.tps", "LM=2.5\n1 2\n3 4\n", "line 1 is 'LM=2.5'"),
        ("none.tps", "LM=0\nID=a\n", "0 points; expected a template of 3"),
        ("solid3.tps", "LM=3\n1 2 3\n1 2 3\n1 2 3\n", "line 2 has 3 numbers; expected 2"),
        (
            "comma.tps",
            "LM=3\n1,5 2,5\n3 4\n5 6\n",
            "line 2 has 4 numbers; expected 2, .* decimals with a point",
        ),
        ("solid.tps", "LM3=3\n1 2 3\n1 2 3\n1 2 3\n", "LM3=3"),
        ("headless.tps", "1 2\n3 4\n", "line 1 is '1 2'; expected LM= and a number"),
        ("word.tps", "LM=3\n1 2\n3 four\n5 6\n", "line 3 is '3 four'"),
        ("nan.tps", "LM=3\n1 2\n3 nan\n5 6\n", "line 3: landmark 2 is '3 nan', which marks it as missing"),
        ("a.png", "", "not a points file by its name"),
    ],
)
def test_what_cannot_be_used_is_named(file, name, text, mentioned):
    with pytest.raises(BadInput, match=mentioned) as error:
        read_marked_points(file(name, text), SIZE)
    assert name in str(error.value) and "\n" not in str(error.value)


def test_an_empty_and_a_missing_tps_are_unreadable(file, tmp_path):
    for path in (file("empty.tps", "\n"), tmp_path / "nowhere.tps"):
        with pytest.raises(UnreadableFile, match=path.name):
            read_marked_points(path, SIZE)


# The subject's right eye is on the picture's left, whatever a file says.


@pytest.mark.parametrize("name", ["a.tem", "a.tps", "a.csv", "a.txt"])
def test_every_landmark_file_with_exchanged_eyes_is_put_in_order_and_says_so(file, name):
    exchanged = POINTS[[1, 0, 2]]
    head = "3\n" if name == "a.tem" else ""
    path = file(name, tps(exchanged) if name == "a.tps" else head + rows(exchanged, " "))
    marked = read_marked_points(path, SIZE, lip="philtrum")
    assert_array_equal(marked.points, POINTS)
    assert marked.notes == (f"{path}: {EXCHANGED}",)


@pytest.mark.parametrize("count", sorted(TEMPLATES))
def test_a_template_with_exchanged_eyes_is_put_in_order_too(file, count):
    points = templated(count) * (-1, 1) + (199, 0)
    marked = read_marked_points(file("a.tem", f"{count}\n" + rows(points, " ")), SIZE)
    assert_allclose(marked.points, (FACE * (-1, 1) + (199, 0))[[1, 0, 2]], atol=1e-9)
    assert EXCHANGED in marked.notes[0]


def test_a_faceframe_file_and_a_clips_sidecar_with_exchanged_eyes_are_put_in_order(file, tmp_path):
    marked = MarkedFaceframe("f.png", POINTS[[1, 0, 2]])
    assert_array_equal(marked.points, POINTS)
    assert marked.notes == (f"the faceframe of f.png: {EXCHANGED}",)
    names = ("left_eye", "right_eye", "philtrum")
    entry = dict(zip(names, POINTS.tolist(), strict=True))
    own = file(
        "a.json", json.dumps({"format": "morphspace-faceframe", "version": 1, "image": "f.png", **entry})
    )
    read = read_marked_points(own, SIZE)
    assert_array_equal(read.points, POINTS)
    assert read.notes == marked.notes
    sidecar = read_sidecar(file("clip.json", json.dumps({"faceframe": {"frame": "f.png", **entry}})))
    assert_array_equal(sidecar.faceframe.points, POINTS)
    assert sidecar.faceframe.notes == marked.notes


def test_a_face_that_lies_on_its_side_is_refused_by_every_reader(file):
    points = [[20, 30], [20, 60], [40, 45]]
    for path in (file("a.csv", rows(points, ",")), file("a.tps", tps(points))):
        with pytest.raises(BadInput, match="both eyes are at x 20, one above the other"):
            read_marked_points(path, SIZE)
    with pytest.raises(BadInput, match="both eyes are at x 20, one above the other"):
        MarkedFaceframe("f.png", np.array(points, float))


def in_every_form(points):
    """The same landmarks as each program writes them, by the suffix of the file."""
    lines = [f"{x} {y}" if x == y == "NA" else f"{float(x):.5f} {float(y):.5f}" for x, y in points]
    return {
        ".tem": "\n".join([str(len(lines)), *lines, "0"]),
        ".tps": "\n".join([f"LM={len(lines)}", *lines, "ID=0"]),
        ".csv": "\n".join(["x,y", *(line.replace(" ", ",") for line in lines)]),
        ".txt": "\n".join(lines),
    }


@pytest.mark.parametrize("suffix", [".tem", ".tps", ".csv", ".txt"])
@pytest.mark.parametrize(
    "mark", [(-1, -1), (0, 0), (np.nan, np.nan), ("NA", "NA"), (np.inf, 3), (50, np.nan)]
)
@pytest.mark.parametrize("place", [1, 41, 68])
def test_a_missing_landmark_is_refused_by_its_number_in_every_form(file, suffix, mark, place):
    points = [tuple(point) for point in templated(68)]
    read_marked_points(file(f"whole{suffix}", in_every_form(points)[suffix]), SIZE)
    points[place - 1] = mark
    path = file(f"a{suffix}", in_every_form(points)[suffix])
    with pytest.raises(
        BadInput, match=rf"line \d+: landmark {place} is .*missing; expected a place in the image"
    ):
        read_marked_points(path, SIZE)


@pytest.mark.parametrize("mark", [(-1, -1), (0, 0)])
def test_a_missing_point_of_a_faceframe_is_refused_by_its_name(tmp_path, mark):
    path = tmp_path / "a.json"
    document = {"format": "morphspace-faceframe", "version": 1, "image": "a.png", "right_eye": [78, 101]}
    path.write_text(json.dumps({**document, "left_eye": mark, "philtrum": [100, 140]}))
    with pytest.raises(BadInput, match=r"the left_eye is .* marks it as missing"):
        read_marked_points(path, SIZE)


@pytest.mark.parametrize("suffix", [".tem", ".tps", ".csv"])
@pytest.mark.parametrize("place", [(-3.0, 101.0), (78.0, -2.0), (250.0, 101.0), (78.0, 260.0)])
def test_a_landmark_of_an_eye_outside_the_picture_is_refused_by_its_number(file, suffix, place):
    points = templated(68)
    points[40] = place
    line = r"landmark 41 of 68 lies outside the image, the first at .*; expected places inside its 200x240 px\. Mark"
    with pytest.raises(BadInput, match=line):
        read_marked_points(file(f"a{suffix}", in_every_form(map(tuple, points))[suffix]), SIZE)


@pytest.mark.parametrize("count", [68, 189, 5])
def test_landmarks_outside_that_no_eye_and_no_lip_needs_are_refused_too(file, count):
    points = templated(68 if count == 5 else count)
    points = np.concatenate([FACE[:3], points])[:5] if count == 5 else points
    points[[3, 4]] = (100, 239.4), (100, 239.6)  # the chin of a cropped face; the last row is 239
    with pytest.raises(
        BadInput, match=rf"landmark 5 of {count} lies outside the image, the first at 100,239\.6"
    ):
        read_marked_points(file("a.csv", in_every_form(map(tuple, points))[".csv"]), SIZE)


@settings(max_examples=300, deadline=None)
@given(
    suffix=st.sampled_from([".tem", ".tps", ".csv", ".txt", ".json"]),
    content=st.binary(max_size=50)
    | st.lists(
        st.sampled_from(
            ["LM=3", "3", "ID=0", "1 2", "5,6", "-1 -1", "NA NA", "x,y", "POINTS=2", "sep=,", ";", "\ufeff"]
        )
    ).map(lambda lines: "\n".join(lines).encode()),
)
def test_any_bytes_are_points_or_refused(tmp_path_factory, suffix, content):
    path = tmp_path_factory.mktemp("any") / f"a{suffix}"
    path.write_bytes(content)
    with contextlib.suppress(BadInput):
        points = read_marked_points(path, SIZE).points
        assert points.shape == (3, 2) and np.isfinite(points).all()


@pytest.mark.parametrize("mark", [(-999, -999), (9999, 9999)])
def test_a_landmark_that_draws_an_eye_out_of_the_picture_is_named_by_its_number(file, mark):
    points = np.column_stack([np.linspace(20, 180, 68), np.full(68, 200.0)])
    for start, x in ((36, 70.0), (42, 130.0)):
        points[start : start + 6] = (x, 100.0)
    points[40] = mark
    text = "x,y\n" + "".join(f"{x},{y}\n" for x, y in points)
    with pytest.raises(BadInput, match=r"landmark 41 of 68 lies outside the image"):
        read_marked_points(file("a.csv", text), SIZE)
