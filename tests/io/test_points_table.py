"""Laws of tables and templates of face points: what is written is read, and what does not fit is named."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.clips import open_clip
from morphspace.io.images import write_image
from morphspace.io.points_table import (
    FramePoints,
    read_points,
    template_files,
    template_text,
    write_points_table,
)

COUNT, SCHEME, SIZE = 3, "three", (60, 72)
ROWS = "frame,point,x_px,y_px\na,0,10,20\na,1,30,20.5\na,2,20,40\n"


@pytest.fixture
def clip(tmp_path, picture):
    for place, name in enumerate(("a", "b", "é 1")):
        write_image(tmp_path / "clip" / f"{name}.png", picture(SIZE[1], SIZE[0], place))
    return open_clip([tmp_path / "clip"])


def frame(seed, **more):
    return FramePoints(np.random.default_rng(seed).uniform(5, 55, (COUNT, 2)), **more)


def about(clip):
    return {
        "scheme": SCHEME,
        "size": list(clip.size),
        "inputs": dict(zip(clip.frame_names, clip.digests(), strict=True)),
    }


def read(path, clip):
    return read_points(path, clip, SCHEME, COUNT)[0]


def test_points_come_back_to_a_thousandth_of_a_px_and_frames_without_a_face_do_not(clip, tmp_path):
    depth, confidence = np.array([-3.25, 0.5, 8.0]), np.array([1.0, 0.25, 0.0])
    first = frame(1, depth=depth, confidence=confidence, pose_deg=(1.26, -7.0, 3.0))
    frames = {"a": first, "b": None, "é 1": frame(2)}
    write_points_table(tmp_path / "p.csv", frames, COUNT, about(clip))
    found = read(tmp_path / "p.csv", clip)
    assert list(found) == ["a", "é 1"]
    for name, one in found.items():
        assert_allclose(one.points, frames[name].points, atol=0.0005)
    assert_array_equal(found["a"].depth, depth)
    assert_array_equal(found["a"].confidence, confidence)
    assert found["é 1"].depth is None and found["é 1"].confidence is None
    lines = (tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 3 * COUNT and lines[1].endswith(",-3.25,1.0,1.3,-7.0,3.0")
    assert lines[4] == "b,0,,,,,,,"


def test_templates_come_back_and_count_like_the_table(clip, tmp_path):
    files = template_files(tmp_path / "marked", clip.frame_names)
    (tmp_path / "marked").mkdir()
    frames = {name: frame(place) for place, name in enumerate(clip.frame_names) if name != "b"}
    for name, one in frames.items():
        files[name].write_text(template_text(one.points))
    (tmp_path / "marked" / "._a.tem").write_text("a file manager's")
    found = read(tmp_path / "marked", clip)
    assert list(found) == list(frames)
    for name, one in found.items():
        assert_allclose(one.points, frames[name].points, atol=0.0005)
    for one, lines in ((frames["a"], (tmp_path / "marked" / "a.tem").read_text().splitlines()),):
        assert lines[0] == str(COUNT) and lines[-1] == "0" and len(lines) == COUNT + 2
        assert_allclose(list(map(float, lines[1].split("\t"))), one.points[0], atol=0.0005)


def test_the_digest_follows_the_content(clip, tmp_path):
    digests = set()
    for rows in (ROWS, ROWS.replace("20.5", "20.4")):
        (tmp_path / "p.csv").write_text(rows)
        digests.add(read_points(tmp_path / "p.csv", clip, SCHEME, COUNT)[1])
        (tmp_path / "t").mkdir(exist_ok=True)
        (tmp_path / "t" / "a.tem").write_text("3\n1 2\n3 4\n5 6\n0\n".replace("5 6", f"5 {len(digests)}"))
        digests.add(read_points(tmp_path / "t", clip, SCHEME, COUNT)[1])
    assert len(digests) == 4


def test_a_table_of_a_spreadsheet_is_read_in_any_order_with_columns_of_remarks(clip, tmp_path):
    shuffled = "﻿point,remark,frame,y_px,x_px\r\n2,,a,40,20\r\n0,moved,a,20,10\r\n1,,a,20.5,30\r\n0,,b,,\r\n"
    (tmp_path / "p.csv").write_text(shuffled, encoding="utf-8")
    assert read(tmp_path / "p.csv", clip)["a"].points.tolist() == [[10, 20], [30, 20.5], [20, 40]]


def test_a_face_that_the_picture_cuts_off_is_read(clip, tmp_path):
    """MOST_OUTSIDE: by a quarter of the longer side, 18 px."""
    (tmp_path / "p.csv").write_text(ROWS.replace("a,2,20,40", "a,2,20,88.9"))
    assert read(tmp_path / "p.csv", clip)["a"].points[2, 1] == 88.9
    (tmp_path / "p.csv").write_text(ROWS.replace("a,2,20,40", "a,2,20,89.1"))
    with pytest.raises(BadInput, match=r"point 2 of frame a is at 20,89\.1"):
        read(tmp_path / "p.csv", clip)


@pytest.mark.parametrize(
    ("old", "new", "mentioned"),
    [
        ("a,2,20,40", "c,2,20,40", "line 4 is of frame 'c'; expected one of clip, a to é 1"),
        ("a,2,20,40", "a,1,20,40", "line 4: point 1 of frame a is also in line 3"),
        ("a,2,20,40", "a,3,20,40", "line 4: point is '3'; expected 0 to 2"),
        ("a,2,20,40", "a,-1,20,40", "line 4: point is '-1'"),
        ("a,2,20,40", "a,1.0,20,40", "line 4: point is '1.0'"),
        ("a,2,20,40", "a,2,nan,40", "line 4, column x_px is 'nan'"),
        ("a,2,20,40", "a,2,20,inf", "line 4, column y_px is 'inf'"),
        ("a,2,20,40", 'a,2,20,"40,5"', "line 4, column y_px is '40,5'.* Write a decimal point"),
        ("a,2,20,40", "a,2,20,01. May", "column y_px is '01. May'.* spreadsheet made a date"),
        ("a,2,20,40\n", "", r"frame a has 2 points; expected 3, or none.* Point 2 is missing \(no row\)"),
        ("a,2,20,40", "a,2,,", r"frame a has 2 points.* Point 2 is missing \(line 4\)"),
        ("a,2,20,40", "a,2,20,", r"frame a has 2 points.* Point 2 is missing \(line 4\)"),
        ("a,1,30,20.5", "a,1,0,0", "line 3: point 1 of frame a is at 0,0; expected a place in its picture"),
        ("a,1,30,20.5", "a,1,-1,-1", "line 3: point 1 of frame a is at -1,-1"),
        ("a,1,30,20.5", "a,1,-999,-999", "line 3: point 1 of frame a is at -999,-999.* 60x72 px"),
        ("x_px", "x", "no column x_px"),
        ("point", "landmark", "no column point"),
        ("x_px", "y_px", "column 'y_px' is repeated"),
        (",", ";", "semicolons"),
        ("10,20\na,1,30,20.5\na,2,20,40", ",\na,1,,\na,2,,", "holds no points"),
    ],
)
def test_what_does_not_fit_is_named_with_its_row(clip, tmp_path, old, new, mentioned):
    (tmp_path / "p.csv").write_text(ROWS.replace(old, new))
    with pytest.raises(BadInput, match=mentioned) as error:
        read(tmp_path / "p.csv", clip)
    assert "p.csv" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("cell", ["1.2", "-0.1", "sure"])
def test_a_confidence_outside_its_range_is_refused(clip, tmp_path, cell):
    rows = [f"{line},{cell if place == 2 else 0.5}" for place, line in enumerate(ROWS.splitlines()[1:])]
    (tmp_path / "p.csv").write_text("\n".join(["frame,point,x_px,y_px,confidence", *rows]))
    with pytest.raises(BadInput, match=rf"line 4.* confidence is '?{cell}"):
        read(tmp_path / "p.csv", clip)


def test_another_encoding_is_refused_with_its_line(clip, tmp_path):
    (tmp_path / "p.csv").write_bytes(ROWS.replace("a,1", "é,1").encode("latin-1"))
    with pytest.raises(UnreadableFile, match="line 3 has the byte 0xe9"):
        read(tmp_path / "p.csv", clip)


@pytest.mark.parametrize(
    ("name", "content", "mentioned"),
    [
        ("c.tem", "3\n1 2\n3 4\n5 6\n0\n", "c.tem is of frame 'c'"),
        ("a.tem", "2\n1 2\n3 4\n0\n", "a.tem has 2 points; expected 3"),
        ("a.tem", "3\n1 2\n0 0\n5 6\n0\n", "a.tem, line 3: landmark 2 is '0 0'.* or remove the file"),
        ("a.tem", "3\n1 2\n3 4\n5 600\n0\n", "a.tem: point 2 is at 5,600"),
        ("a.txt", "", "holds no .tem file"),
    ],
)
def test_templates_that_do_not_fit_are_named(clip, tmp_path, name, content, mentioned):
    (tmp_path / "marked").mkdir()
    (tmp_path / "marked" / name).write_text(content)
    with pytest.raises(BadInput, match=mentioned):
        read(tmp_path / "marked", clip)


@pytest.mark.parametrize("name", ["p.tsv", "p.tem", "nowhere"])
def test_a_file_of_another_kind_is_refused(clip, tmp_path, name):
    with pytest.raises(BadInput, match=r"expected \.csv, or a folder"):
        read(tmp_path / name, clip)


@pytest.mark.parametrize(
    ("entry", "value", "mentioned"),
    [
        ("scheme", "other-468", "p.csv are other-468; expected three"),
        ("size", [60, 70], "pictures of 60x70 px; expected 60x72, the size of clip"),
        ("inputs", {"a": "0" * 64}, "frame a of p.csv was another picture; expected that of clip"),
    ],
)
def test_a_table_of_other_points_or_of_another_clip_is_refused(clip, tmp_path, entry, value, mentioned):
    write_points_table(tmp_path / "p.csv", {"a": frame(1), "b": None}, COUNT, about(clip))
    assert list(read(tmp_path / "p.csv", clip)) == ["a"]
    document = json.loads((tmp_path / "p.json").read_text())
    (tmp_path / "p.json").write_text(json.dumps({**document, entry: value}))
    with pytest.raises(BadInput, match=mentioned):
        read(tmp_path / "p.csv", clip)
    (tmp_path / "p.json").unlink()
    assert list(read(tmp_path / "p.csv", clip)) == ["a"]  # nothing speaks against it then


def test_pictures_of_frames_without_points_may_change(clip, tmp_path, picture):
    write_points_table(tmp_path / "p.csv", {"a": frame(1), "b": None}, COUNT, about(clip))
    write_image(tmp_path / "clip" / "b.png", picture(SIZE[1], SIZE[0], 9))
    assert list(read(tmp_path / "p.csv", open_clip([tmp_path / "clip"]))) == ["a"]
