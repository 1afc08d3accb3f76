"""Laws of names: what a table, a page or a terminal would take for something else is refused where it enters."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.names import check_frame_name, check_link, check_name


@pytest.mark.parametrize(
    "name", ["a.png", "ä 笑 (1), [x].png", "-3.png", "-.5sd.png", "a=b@c+d.png", ".a", "+2sd.png"]
)
def test_ordinary_names_are_taken(name):
    check_frame_name(Path("folder") / name)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (os.fsdecode(b"M\xfcller.png"), r"M\\xfcller\.png is not UTF-8.* Rename it"),
        ("two\nlines.png", r"'two\\nlines\.png' has a control character"),
        ("tab\t.png", "control character"),
        ("\x1b[31mred.png", r"\\x1b\[31mred"),
        ("\u2028.png", "control character"),
    ],
)
def test_names_that_break_a_line_or_a_text_are_refused(name, words):
    for check in (check_name, check_frame_name):
        with pytest.raises(BadInput, match=words) as caught:
            check(Path(name))
        str(caught.value).encode()  # the message itself is printable


@pytest.mark.parametrize("name", ["=1+1.png", "@sum.png", "+cmd.png", "-cmd.png"])
def test_a_name_that_a_spreadsheet_computes_names_no_frame(name):
    with pytest.raises(BadInput, match=r"begins with '[=@+-]'; expected a letter or digit"):
        check_frame_name(Path("folder") / name)
    check_name(Path("folder") / name)


def test_a_link_to_nothing_says_what_it_is(tmp_path):
    (tmp_path / "here.png").write_text("")
    for name, target in (
        ("annex.png", "../.git/annex/objects/aa/bb/SHA256E-s3--0.png/SHA256E-s3--0.png"),
        ("lost.png", "gone.png"),
        ("good.png", "here.png"),
    ):
        (tmp_path / name).symlink_to(target)
    check_link(tmp_path / "good.png")
    check_link(tmp_path / "here.png")
    with pytest.raises(UnreadableFile, match=r"annex\.png is a link of git-annex.* Run `git annex get`"):
        check_link(tmp_path / "annex.png")
    with pytest.raises(UnreadableFile, match=r"lost\.png is a link to gone\.png, which does not exist"):
        check_link(tmp_path / "lost.png")


def test_a_locale_without_utf_8_is_named_rather_than_the_file(tmp_path):
    (tmp_path / "\u017cab\u0119.png").write_bytes(b"")
    code = (
        "import pathlib, sys\nfrom morphspace.errors import BadInput\nfrom morphspace.io.names import check_name\n"
        "try:\n    check_name(next(pathlib.Path(sys.argv[1]).iterdir()))\n"
        "except BadInput as error:\n    print(str(error).encode('ascii', 'replace').decode())\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "because the locale is ascii" in ended.stdout and "Set LC_ALL to C.UTF-8" in ended.stdout
