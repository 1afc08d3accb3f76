"""Laws of tables: numbers come back bit for bit, and what is wrong is named by row and column."""

import contextlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.io.recipe.text import read_rows
from morphspace.io.tables import (
    read_loadings_table,
    read_metrics_table,
    write_loadings_table,
    write_metrics_table,
)

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=40, deadline=None)
@given(
    loadings=arrays.arrays(
        np.float64, arrays.array_shapes(min_dims=2, max_dims=2, max_side=5), elements=FINITE
    )
)
def test_loadings_come_back_bit_for_bit(tmp_path_factory, loadings):
    path = tmp_path_factory.mktemp("table") / "motion.csv"
    names = [f"frame {row}" for row in range(len(loadings))]
    write_loadings_table(path, loadings, names, {"model_id": "m"})
    table = read_loadings_table(path)
    assert table.frame_names == tuple(names)
    assert table.loadings_sd.dtype == np.float64
    assert table.loadings_sd.tobytes() == loadings.tobytes()


def test_names_of_a_table_are_composed(tmp_path):
    (tmp_path / "t.csv").write_text("frame,pc001_sd\na\u0301,1\n", encoding="utf-8")
    assert read_loadings_table(tmp_path / "t.csv").frame_names == ("\u00e1",)


@pytest.mark.parametrize("name", ["a,b", 'say "a"', "two\nlines", "ä 笑", "0001", " x "])
def test_any_frame_name_survives(tmp_path, name):
    write_loadings_table(tmp_path / "t.csv", np.ones((1, 2)), [name], {})
    assert read_loadings_table(tmp_path / "t.csv").frame_names == (name,)
    write_metrics_table(tmp_path / "m.csv", {"frame": [name], "distance_px": [1.5]})
    assert read_metrics_table(tmp_path / "m.csv") == {"frame": [name], "distance_px": [1.5]}


def test_the_unit_is_in_the_heading_and_beyond_999_components_too(tmp_path):
    write_loadings_table(tmp_path / "t.csv", np.zeros((1, 1001)), ["a"], {})
    headings = (tmp_path / "t.csv").read_text().splitlines()[0].split(",")
    assert headings[:3] == ["frame", "pc001_sd", "pc002_sd"]
    assert headings[-1] == "pc1001_sd"
    assert read_loadings_table(tmp_path / "t.csv").loadings_sd.shape == (1, 1001)


def test_the_document_is_kept_and_says_what_the_table_is(tmp_path):
    write_loadings_table(tmp_path / "t.csv", np.zeros((2, 3)), ["a", "b"], {"model_id": "m", "more": [1]})
    document = read_loadings_table(tmp_path / "t.csv").document
    assert document["format"] == "morphspace-loadings"
    assert (document["version"], document["unit"]) == (1, "sd")
    assert (document["frame_count"], document["component_count"]) == (2, 3)
    assert (document["model_id"], document["more"]) == ("m", [1])


def test_a_table_without_a_document_reads(tmp_path):
    (tmp_path / "t.csv").write_text("\ufeffframe,pc001_sd\r\na,1\r\n\r\n")
    table = read_loadings_table(tmp_path / "t.csv")
    assert table.document is None
    assert table.loadings_sd.tolist() == [[1.0]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,pc001_sd\na,1\n", "first column is 'name'"),
        ("frame\na\n", "no component column"),
        ("frame,pc001_sd,pc003_sd\na,1,2\n", "pc003_sd; expected pc002_sd"),
        ("frame,pc002_sd\na,1\n", "pc002_sd; expected pc001_sd"),
        ("frame,pc001_sd,pc001_sd\na,1,2\n", "line 1: column 'pc001_sd' is repeated"),
        ("frame,pc001\na,1\n", "'pc001' is not a loading in SD"),
        ("frame,pc001_sd,mood\na,1,2\n", "'mood' is not a loading in SD"),
        ("frame,pc001_sd\na,1\nb,x\n", "line 3, column pc001_sd is 'x'"),
        ("frame,pc001_sd\na,1\n\n,\nb,x\n", "line 5, column pc001_sd is 'x'"),
        ("frame,pc001_sd\na,\n", "line 2, column pc001_sd is ''"),
        ("frame,pc001_sd\na,nan\n", "line 2, column pc001_sd is 'nan'"),
        ('frame,pc001_sd\na,"1,5"\n', "line 2, column pc001_sd is '1,5'; .* decimal point"),
        ("frame,pc001_sd\na,01. Mai\n", "line 2, column pc001_sd is '01. Mai'; .* made a date of it"),
        ("frame,pc001_sd\na,2026-05-01 00:00:00\n", "made a date of it"),
        ("frame,pc001_sd\na,1,2\n", "line 2 has 3 cells; expected 2"),
        ("frame,pc001_sd,pc002_sd\na,1\n", "line 2 has 2 cells; expected 3"),
        ("frame,pc001_sd,\na,1,2\n", "line 1: column 3 has no name"),
        ("frame,pc001_sd\na,1\na,2\n", "frame 'a' is repeated"),
        ("frame,pc001_sd\na\u0301,1\n\u00e1,2\n", "frame '\u00e1' is repeated"),
        ("frame;pc001_sd\r\na;0,5\r\n", "line 1 has semicolons between the columns; expected commas"),
        ("\ufeffframe;pc001_sd\r\na;0,5\r\n", "line 1 has semicolons"),
        ("frame\tpc001_sd\na\t1\n", "line 1 has tabs between the columns"),
        ("\ufeffsep=,\r\nframe,pc001_sd\r\na,1\r\n", "line 1 is 'sep=,'.* Delete this line"),
        ("sep=;\nframe;pc001_sd\na;1\n", "line 1 is 'sep=;'"),
    ],
)
def test_what_is_wrong_in_a_table_is_named(tmp_path, text, words):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(BadInput, match=words) as caught:
        read_loadings_table(tmp_path / "t.csv")
    assert "t.csv" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b'frame,"pc'])
def test_what_is_no_table_is_refused(tmp_path, content):
    (tmp_path / "t.csv").write_bytes(content)
    for read in (read_loadings_table, read_metrics_table):
        with pytest.raises(UnreadableFile, match=r"t\.csv"):
            read(tmp_path / "t.csv")
        with pytest.raises(UnreadableFile, match="No such file"):
            read(tmp_path / "gone.csv")


@pytest.mark.parametrize(
    "text",
    [
        "frame,pc001_sd,pc002_sd\na,0.5,-1.25\nb,1.5,0\n",
        "\ufeffframe,pc001_sd,pc002_sd\r\na,0.5,-1.25\r\nb,1.5,0\r\n",
        "frame,pc001_sd,pc002_sd\ra,0.5,-1.25\rb,1.5,0\r",
        "frame,pc001_sd,pc002_sd\na,0.5,-1.25\n,,\n\n , ,\nb,1.5,0\n,,\n,,",
        "frame,pc001_sd,pc002_sd,,\na,0.5,-1.25,,\nb,1.5,0,,\n,,,,\n",
        "frame,,pc001_sd,pc002_sd\na,,0.5,-1.25\nb,,1.5,0\n",
        "frame,pc001_sd,pc002_sd\na,0.5,-1.25,,\nb,1.5,0\n",
        " frame ,pc001_sd, pc002_sd\na, 0.5,-1.25 \nb,1.5,0\n",
        '"frame","pc001_sd","pc002_sd"\n"a","0.5","-1.25"\n"b","1.5","0"\n',
    ],
)
def test_a_table_that_a_spreadsheet_saved_is_the_same_table(tmp_path, text):
    (tmp_path / "t.csv").write_bytes(text.encode())
    table = read_loadings_table(tmp_path / "t.csv")
    assert table.frame_names == ("a", "b")
    assert table.loadings_sd.tolist() == [[0.5, -1.25], [1.5, 0.0]]
    measures = read_metrics_table(tmp_path / "t.csv")
    assert measures == {"frame": ["a", "b"], "pc001_sd": [0.5, 1.5], "pc002_sd": [-1.25, 0.0]}


@pytest.mark.parametrize("changed", ['"0,5"', "01. Mai", "Mai 05", "2026-05-01"])
def test_a_number_that_a_spreadsheet_changed_does_not_make_its_column_texts(tmp_path, changed):
    (tmp_path / "m.csv").write_text(f"frame,distance_px\na,1.5\nb,{changed}\n")
    with pytest.raises(BadInput, match=r"m\.csv line 3, column distance_px is .* expected a number"):
        read_metrics_table(tmp_path / "m.csv")


def test_columns_of_texts_may_look_like_dates_or_numbers_with_commas(tmp_path):
    (tmp_path / "m.csv").write_text('frame,day,note\n"1,5",2026-05-01,x\n0001,2026-05-02,"1,5"\n')
    table = read_metrics_table(tmp_path / "m.csv")
    assert table == {"frame": ["1,5", "0001"], "day": ["2026-05-01", "2026-05-02"], "note": ["x", "1,5"]}


@settings(max_examples=200, deadline=None)
@given(content=st.binary(max_size=60) | st.text('frame,;\t"\n\r01.-=\ufeff', max_size=60).map(str.encode))
def test_any_bytes_are_a_table_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("any") / "t.csv"
    path.write_bytes(content)
    for read in (read_loadings_table, read_metrics_table):
        with contextlib.suppress(BadInput):
            read(path)


def test_a_table_beyond_the_limit_is_refused_before_it_is_read(tmp_path, monkeypatch):
    write_loadings_table(tmp_path / "t.csv", np.zeros((9, 9)), list("abcdefghi"), {})
    monkeypatch.setenv("MORPHSPACE_LARGEST_TABLE_BYTES", "100")
    monkeypatch.setattr(Path, "read_bytes", None)
    with pytest.raises(BadInput, match=r"t\.csv has \d+ bytes; expected at most 100.*LARGEST_TABLE_BYTES="):
        read_loadings_table(tmp_path / "t.csv")
    monkeypatch.setenv("MORPHSPACE_LARGEST_TABLE_BYTES", "many")
    with pytest.raises(BadInput, match="MORPHSPACE_LARGEST_TABLE_BYTES is 'many'; expected a whole number"):
        read_loadings_table(tmp_path / "t.csv")


def test_a_document_of_another_table_is_refused(tmp_path):
    write_loadings_table(tmp_path / "t.csv", np.zeros((2, 3)), ["a", "b"], {})
    document = json.loads((tmp_path / "t.json").read_text())
    (tmp_path / "t.json").write_text(json.dumps({**document, "component_count": 2}))
    with pytest.raises(BadInput, match=r"component_count 2; expected the 3"):
        read_loadings_table(tmp_path / "t.csv")


def test_loadings_that_do_not_fit_are_refused(tmp_path):
    for loadings, names, words in (
        (np.zeros((2, 3)), ["a"], r"\(2, 3\); expected \(1, k\)"),
        (np.zeros(3), ["a", "b", "c"], r"\(3,\); expected \(3, k\)"),
        (np.zeros((2, 3)), ["a", "a"], "'a' is repeated"),
        (np.array([[0, np.nan]]), ["a"], "pc002_sd of frame a is nan"),
    ):
        with pytest.raises(BadInput, match=words):
            write_loadings_table(tmp_path / "t.csv", loadings, names, {})
    with pytest.raises(BadInput, match=r"\.csv"):
        write_loadings_table(tmp_path / "t.json", np.zeros((1, 1)), ["a"], {})
    assert list(tmp_path.iterdir()) == []


def test_measures_come_back_by_kind(tmp_path):
    columns = {
        "frame": ["1", "2"],
        "distance_px": np.array([0.1, np.nan]),
        "folds_percent": [np.float32(0.5), 1],
        "method": ["map", "paper"],
        "note": [None, ""],
    }
    write_metrics_table(tmp_path / "m.csv", columns)
    table = read_metrics_table(tmp_path / "m.csv")
    assert table["frame"] == ["1", "2"]
    assert table["distance_px"][0] == 0.1
    assert np.isnan(table["distance_px"][1])
    assert table["folds_percent"] == [0.5, 1.0]
    assert table["method"] == ["map", "paper"]
    assert table["note"] == ["", ""]


@pytest.mark.parametrize("text", ["=1+1", "@sum", "+cmd|' /C calc'!A0", "-cmd", "\tx"])
def test_no_cell_begins_as_a_formula(tmp_path, text):
    write_metrics_table(tmp_path / "m.csv", {"name": ["a"], "consent": [text], "amount_sd": [-2.5]})
    table = read_metrics_table(tmp_path / "m.csv")
    assert table == {"name": ["a"], "consent": [f"'{text}"], "amount_sd": [-2.5]}
    with pytest.raises(BadInput, match=r"t\.csv: frame .* begins with .*Rename it"):
        write_loadings_table(tmp_path / "t.csv", np.zeros((1, 1)), [text], {})


@pytest.mark.parametrize("text", ["-3", "-.5", "+2sd", "-", "a=b", "3-4"])
def test_texts_of_numbers_and_signs_inside_are_written_as_they_are(tmp_path, text):
    write_metrics_table(tmp_path / "m.csv", {"frame": [text]})
    assert read_metrics_table(tmp_path / "m.csv") == {"frame": [text]}


def test_columns_of_different_length_are_refused(tmp_path):
    with pytest.raises(BadInput, match="column b has 1 rows; expected 2 as in a"):
        write_metrics_table(tmp_path / "m.csv", {"a": [1, 2], "b": [1]})
    with pytest.raises(BadInput, match="no columns"):
        write_metrics_table(tmp_path / "m.csv", {})


def written_pair(path, value, identity):
    write_loadings_table(path, np.full((2, 1), value), ["a", "b"], {"identity": identity})


def test_an_edited_table_is_read_with_a_note(tmp_path):
    written_pair(tmp_path / "t.csv", 1.0, "anna")
    assert read_loadings_table(tmp_path / "t.csv").notes == ()
    (tmp_path / "t.csv").write_text("frame,pc001_sd\na,2\n")
    (note,) = read_loadings_table(tmp_path / "t.csv").notes
    assert "t.csv was changed after it was written" in note and "t.json" in note


@pytest.mark.parametrize("mark", [".writing.json", ".t.csv.writing.json"])
def test_a_table_and_a_sidecar_of_two_runs_are_refused(tmp_path, mark):
    written_pair(tmp_path / "t.csv", 1.0, "anna")
    kept = (tmp_path / "t.json").read_bytes()
    written_pair(tmp_path / "t.csv", 2.0, "berta")
    (tmp_path / "t.json").write_bytes(kept)  # a run was killed between the two
    (tmp_path / mark).write_text("{}")
    with pytest.raises(UnreadableFile, match=r"t\.csv is not the table that t\.json describes"):
        read_loadings_table(tmp_path / "t.csv")
    (tmp_path / "t.json").unlink()
    written_pair(tmp_path / "t.csv", 2.0, "berta")
    assert read_loadings_table(tmp_path / "t.csv").document["identity"] == "berta"


def test_a_disk_that_fills_between_table_and_sidecar_changes_neither(tmp_path, monkeypatch):
    written_pair(tmp_path / "t.csv", 1.0, "anna")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    count = 0

    def full(handle):
        nonlocal count
        count += 1
        if count == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UnwritableFile, match="No space left"):
        written_pair(tmp_path / "t.csv", 2.0, "berta")
    assert count == 2 and {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_times_are_a_column_that_comes_back_and_tables_without_them_read(tmp_path):
    loadings = np.random.default_rng(3).normal(size=(3, 2))
    times_s = (0.0, 1 / 30, 0.0812)
    names = ("a", "b", "c")
    write_loadings_table(tmp_path / "t.csv", loadings, names, {"frame_rate_hz": 25.0}, times_s)
    assert (tmp_path / "t.csv").read_text().startswith("frame,time_s,pc001_sd,pc002_sd\na,0.0,")
    back = read_loadings_table(tmp_path / "t.csv")
    assert tuple(back.times_s) == times_s
    assert np.array_equal(back.loadings_sd, loadings)
    assert back.rate_hz == 25.0
    assert back.document["component_count"] == 2
    (tmp_path / "t.json").unlink()
    assert read_loadings_table(tmp_path / "t.csv").rate_hz == 2 / 0.0812
    write_loadings_table(tmp_path / "u.csv", loadings, names, {})
    assert read_loadings_table(tmp_path / "u.csv").times_s is None


def test_times_that_do_not_rise_are_refused(tmp_path):
    loadings = np.zeros((3, 1))
    with pytest.raises(BadInput, match="time_s of frame b is 0; expected more than the 0 before"):
        write_loadings_table(tmp_path / "t.csv", loadings, "abc", {}, (0.0, 0.0, 1.0))
    with pytest.raises(BadInput, match="there are 2 times; expected 3"):
        write_loadings_table(tmp_path / "t.csv", loadings, "abc", {}, (0.0, 1.0))
    (tmp_path / "t.csv").write_text("frame,time_s,pc001_sd\na,0,1\nb,0.2,1\nc,0.1,1\n")
    with pytest.raises(
        BadInput, match=r"t\.csv: time_s of frame c is 0\.1; expected more than the 0\.2 before"
    ):
        read_loadings_table(tmp_path / "t.csv")


@pytest.mark.parametrize(
    ("rate_hz", "is_read"), [(0.01, True), (10_000, True), (0.009, False), (10_001, False)]
)
def test_the_limits_of_a_frame_rate(tmp_path, rate_hz, is_read):
    write_loadings_table(tmp_path / "t.csv", np.zeros((2, 1)), "ab", {"frame_rate_hz": rate_hz})
    if is_read:
        assert read_loadings_table(tmp_path / "t.csv").rate_hz == rate_hz
    else:
        with pytest.raises(BadInput, match=r"frame_rate_hz is .*; expected a number from 0\.01 to 10000"):
            read_loadings_table(tmp_path / "t.csv")


TEXT = "frame,pc001_sd\nä,0.5\n笑,-1\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_read_if_it_says_so_at_its_start(tmp_path, encoding):
    path = tmp_path / "t.csv"
    mark = "\ufeff" if encoding.startswith("utf-16-") else ""
    path.write_bytes((mark + TEXT).encode(encoding))
    table = read_loadings_table(path)
    assert table.frame_names == ("ä", "笑")
    assert table.loadings_sd.tolist() == [[0.5], [-1.0]]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("frame,pc001_sd\na,1\nä,2\n".encode("latin-1"), r"line 3 has the byte 0xe4, which is not UTF-8"),
        ("frame,pc001_sd\r\n“a”,1\r\n".encode("cp1252"), r"line 2 has the byte 0x93, which is not UTF-8"),
        ("frame,pc001_sd\nb,1\n".encode("utf-16-le"), r"line 1 has a zero byte, which no text in UTF-8 has"),
        ("frame,pc001_sd\nb,1\n".encode("utf-16")[:-1], r"line 2 has the byte 0x0a, which is not UTF-16"),
        ("frame,pc001_sd\nb,1\n".encode("utf-32"), r"line 1 has a zero byte, which no text in UTF-16 has"),
    ],
)
def test_another_encoding_is_refused_with_the_first_byte_and_its_line(tmp_path, content, words):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    for read in (read_loadings_table, read_metrics_table, read_rows):
        with pytest.raises(UnreadableFile, match=words + r".*\. Save it as UTF-8$"):
            read(path)


TIMES_S = {"even": np.arange(9) / 25, "lost": np.array([0, 1, 2, 3, 5, 6, 7, 9, 10]) / 25}
TIMES_S["uneven"] = np.array([0, 0.03, 0.06, 0.15, 0.18, 0.21, 0.3, 0.33, 0.36])


@pytest.mark.parametrize(
    ("times", "rates"),
    [("even", (25, 25.4)), ("lost", (25, 20)), ("uneven", (8 / 0.36, 1 / 0.03))],  # median and mean
)
def test_a_rate_that_is_not_that_of_the_times_is_refused_with_both(tmp_path, times, rates):
    path, beside = tmp_path / "t.csv", tmp_path / "t.json"
    names = [f"f{row}" for row in range(9)]
    for rate in (*rates, None):
        write_loadings_table(path, np.ones((9, 1)), names, {"frame_rate_hz": rate}, TIMES_S[times])
        assert read_loadings_table(path).rate_hz == (rate or pytest.approx(8 / TIMES_S[times][-1]))
    for wrong in (50, 12.5, 26, 60_000 / 1001):
        document = {**json.loads(beside.read_text()), "frame_rate_hz": wrong}
        beside.write_text(json.dumps(document))
        mean = f"{8 / TIMES_S[times][-1]:.4g}"
        with pytest.raises(
            BadInput, match=rf"t\.json has frame_rate_hz {wrong:g}; expected {mean}, the rate of"
        ):
            read_loadings_table(path)


def test_a_single_time_has_no_rate_to_contradict(tmp_path):
    write_loadings_table(tmp_path / "t.csv", np.ones((1, 1)), ["a"], {"frame_rate_hz": 50}, [0.0])
    assert read_loadings_table(tmp_path / "t.csv").rate_hz == 50
