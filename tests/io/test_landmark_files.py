"""Laws of landmark files: what a file says is what is read, and what it does not say is named with its line."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.points import read_landmark_pair, read_landmarks

POINTS = [[170.0, 253.5], [276.5, 249.5], [-2.0, 1e3]]
TEM = "3\n170.00\t253.50\n276.50\t249.50\n-2\t1e3\n2\n0\n2\n0 1\n0\n3\n0 1 2\n"


@pytest.fixture
def file(tmp_path):
    def written(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return written


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.tem", TEM),
        ("a.TEM", TEM),
        ("windows.tem", TEM.replace("\n", "\r\n")),
        ("marked.tem", "\ufeff" + TEM),
        ("old.tem", TEM.replace("\n", "\r")),
        ("remark.txt", "# \xc4ugen\n170 253.5\n276.5 249.5\n-2 1000".encode("latin-1")),
        ("bare.tem", TEM[: TEM.index("\n2\n0\n")]),
        ("a.csv", "170,253.5\n276.5,249.5\n-2,1000\n"),
        ("headed.csv", "x,y\n170,253.5\n276.5,249.5\n-2,1000"),
        ("units.csv", '"x_px", "y_px"\n170, 253.5\n276.5, 249.5\n-2, 1000\n'),
        ("semicolons.csv", "X;Y\n170;253.5\n276.5;249.5\n-2;1000\n"),
        ("spreadsheet.csv", "\ufeffx,y,,\r\n170,253.5,,\r\n\r\n276.5,249.5,,\r\n-2,1000,,\r\n,,,\r\n"),
        ("first.csv", ";;\n;170;253.5;\n;276.5;249.5;\n;-2;1000;\n;;;\n"),
        ("a.txt", "# eyes, chin\n\n170 253.5\n276.5\t249.5\n  -2   1000  \n\n"),
    ],
)
def test_every_form_gives_the_same_points(file, name, content):
    points = read_landmarks(file(name, content))
    assert points.dtype == np.float64
    assert_array_equal(points, POINTS)


@pytest.mark.parametrize(
    ("name", "content", "mentioned"),
    [
        ("short.tem", "5\n1\t2\n3\t4\n", "holds 2 landmarks; expected 5"),
        (
            "long.tem",
            "2\n1\t2\n3\t4\n5\t6\n1\n0\n2\n0 1\n",
            r"line 4 is '5\\t6'; expected .* after the 2 landmarks",
        ),
        ("none.tem", "0\n0\n", "no landmark"),
        ("headless.tem", "170.0\t253.5\n", "line 1 is .* number of landmarks"),
        ("minus.tem", "-1\n1\t2\n", "line 1 is .* number of landmarks"),
        ("eaten.tem", "3\n1\t2\n3\t4\n1\n0\n2\n0 1\n", "line 4 has 1 numbers; expected 2"),
        ("word.csv", "x,y\n1,2\n\n3,four\n", "line 4 is '3,four'"),
        ("head.csv", "left,top\n1,2\n", "line 1 is 'left,top'"),
        ("swapped.csv", "y,x\n1,2\n", "line 1 is 'y,x'"),
        ("bare.csv", "x,y\n", "no landmark"),
        ("three.csv", "1,2\n1,2,3\n", "line 2 has 3 numbers; expected 2"),
        ("decimal.csv", "1,5;2,5\n", "line 1 has 4 numbers; expected 2"),
        ("gap.csv", "1,\n", "line 1 has 1 numbers; expected 2"),
        ("hole.csv", "1,,2\n", "line 1 is '1,,2'"),
        ("sep.csv", "sep=,\nx,y\n1,2\n", "line 1 is 'sep=,'.* Delete this line"),
        ("underscored.csv", "1,2\n1_0,2\n", "line 2 is '1_0,2'"),
        ("hexadecimal.csv", "0x10,2\n", "line 1 is '0x10,2'"),
        ("arabic.txt", "\u0661 \u0662\n", "line 1 is "),
        ("huge.tem", "999999999\n1\t2\n", "holds 1 landmarks; expected 999999999"),
        ("endless.tem", "9" * 5000 + "\n1\t2\n", r"line 1 is '9{40}\.\.\.'; expected the number"),
        ("contours.tem", "2\n1\t2\n3\t4\nlips\n", "line 4 is 'lips'; expected .* after the 2 landmarks"),
        ("nan.txt", "1 2\nnan 2\n", "line 2: landmark 2 is 'nan 2', which marks it as missing"),
        ("infinite.tem", "1\n1\t1e999\n", "line 2: landmark 1 is .* missing"),
        ("endless.txt", "1" * 10_000 + " x", r"line 1 is '1{40}\.\.\.'"),
        ("a.json", "[]", r"\.tem, \.csv, \.txt"),
        ("a", "1 2", r"\.tem, \.csv, \.txt"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(file, name, content, mentioned):
    with pytest.raises(BadInput, match=mentioned) as error:
        read_landmarks(file(name, content))
    assert name in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "content", "mentioned"),
    [
        ("empty.tem", "", "empty"),
        ("blank.csv", "\n  \n# nothing\n", "empty"),
        ("picture.tem", b"\x89PNG\xff\xfe", "UTF-8"),
        ("wide.tem", "3\n1\t2\n".encode("utf-16-le"), "UTF-8"),
        ("half.tem", "3\n1\t2\n".encode("utf-16")[:-1], "line 2 .* not UTF-16"),
        ("zeros.csv", b"\0" * 100, "UTF-8"),
    ],
)
def test_what_is_no_text_is_unreadable(file, name, content, mentioned):
    with pytest.raises(UnreadableFile, match=mentioned):
        read_landmarks(file(name, content))


def test_a_missing_file_and_a_folder_are_unreadable(tmp_path):
    (tmp_path / "folder.tem").mkdir()
    for name in ("nowhere.tem", "folder.tem"):
        with pytest.raises(UnreadableFile, match=name):
            read_landmarks(tmp_path / name)


def test_a_pair_has_as_many_points_in_both_whatever_their_form(file):
    tem, csv, other = file("a.tem", TEM), file("b.csv", "5,6\n7,8\n9,9\n"), file("c.txt", "1 2\n3 4\n")
    one, two = read_landmark_pair(tem, csv)
    assert_array_equal(one, POINTS)
    assert_array_equal(two, [[5, 6], [7, 8], [9, 9]])
    with pytest.raises(BadInput, match=r"a\.tem has 3 landmarks, .*c\.txt has 2"):
        read_landmark_pair(tem, other)


@pytest.mark.parametrize(
    ("content", "line"), [("x,y\n1,2\n,\n3,4\n,\n", 3), ("1;2\n;\n3;4\n", 2), ("x,y\n,\n1,2\n", 2)]
)
def test_a_row_of_empty_cells_between_landmarks_is_a_missing_one(file, content, line):
    """Passed over, it would shift all landmarks after it by one."""
    place = line - content.startswith("x")
    with pytest.raises(
        BadInput, match=rf"a\.csv, line {line}: landmark {place} is '', which marks it as missing"
    ):
        read_landmarks(file("a.csv", content))
