"""Flow files: what is written is what Middlebury's definition and OpenEXR say, and nothing broken gets through."""

import re
import struct
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.flow import Flow
from morphspace.io.flow_fields import FIELD_SUFFIXES, read_flow, write_flows

HEIGHT, WIDTH = 7, 11
DATA_SPEC = Path(__file__).parents[2] / "data_spec"


def parts(flow):
    return flow.displacement, flow.confidence


def a_flow(height=HEIGHT, width=WIDTH, seed=0):
    rng = np.random.default_rng(seed)
    field = rng.normal(0, 5, (height, width, 2)).astype(np.float32)
    return Flow(field, rng.random((height, width), np.float32))


def write_exr(path, channels, kind="float"):
    """An EXR file by OpenImageIO alone: channels is name -> (h, w)."""
    planes = np.stack(list(channels.values()), axis=-1).astype(np.float32)
    spec = oiio.ImageSpec(planes.shape[1], planes.shape[0], planes.shape[2], kind)
    spec.channelnames = tuple(channels)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(planes) and target.close()


@settings(max_examples=25, deadline=None)
@given(
    field=hnp.arrays(
        np.float32,
        st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(2)),
        elements=st.floats(-(2.0**20), 2.0**20, width=32),
    ),
    suffix=st.sampled_from(FIELD_SUFFIXES),
)
def test_reading_undoes_writing(tmp_path_factory, field, suffix):
    path = tmp_path_factory.mktemp("field") / f"a{suffix}"
    confidence = np.linspace(0, 1, field[..., 0].size, dtype=np.float32).reshape(field.shape[:2])
    write_flows({path: (field, confidence)})
    stored = read_flow(path)
    assert_array_equal(stored.displacement, field)
    assert_array_equal(stored.confidence, confidence if suffix == ".exr" else np.ones_like(confidence))
    assert stored.known.all() and stored.displacement.dtype == np.float32


def test_a_flo_file_is_the_tag_the_size_and_the_rows(tmp_path):
    flow = a_flow()
    write_flows({tmp_path / "a.flo": parts(flow)})
    by_hand = struct.pack("<fii", 202021.25, WIDTH, HEIGHT)
    for row in flow.displacement.tolist():
        for u, v in row:
            by_hand += struct.pack("<ff", u, v)
    content = (tmp_path / "a.flo").read_bytes()
    assert content == by_hand and content[:4] == b"PIEH"


def test_opencv_and_we_read_each_others_flo_files(tmp_path):
    flow = a_flow()
    write_flows({tmp_path / "ours.flo": parts(flow)})
    assert_array_equal(cv2.readOpticalFlow(str(tmp_path / "ours.flo")), flow.displacement)
    assert cv2.writeOpticalFlow(str(tmp_path / "theirs.flo"), flow.displacement)
    assert_array_equal(read_flow(tmp_path / "theirs.flo").displacement, flow.displacement)


def test_the_lines_of_python_on_the_page_read_a_flo_file(tmp_path, monkeypatch):
    flow = a_flow()
    write_flows({tmp_path / "name.flo": parts(flow)})
    (lines,) = re.findall(r"```python\n(.*?)```", (DATA_SPEC / "flow-file.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    found = {"np": np}
    exec(lines, found)  # noqa: S102  (our own page)
    assert_array_equal(found["field"], flow.displacement)


def test_the_channels_of_an_exr_go_by_their_names(tmp_path):
    flow = a_flow()
    write_flows({tmp_path / "a.exr": parts(flow)})
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    names, planes = list(source.spec().channelnames), source.read_image("float")
    source.close()
    assert sorted(names) == ["confidence", "u", "v"]
    for name, plane in (
        ("u", flow.displacement[..., 0]),
        ("v", flow.displacement[..., 1]),
        ("confidence", flow.confidence),
    ):
        assert_array_equal(planes[..., names.index(name)], plane)


@pytest.mark.parametrize(
    "order", [("u", "v", "confidence"), ("v", "confidence", "u"), ("confidence", "v", "u")]
)
def test_an_exr_reads_the_same_in_whatever_order_it_was_written(tmp_path, order):
    flow = a_flow()
    planes = {"u": flow.displacement[..., 0], "v": flow.displacement[..., 1], "confidence": flow.confidence}
    write_exr(tmp_path / "a.exr", {name: planes[name] for name in order})
    stored = read_flow(tmp_path / "a.exr")
    assert_array_equal(stored.displacement, flow.displacement)
    assert_array_equal(stored.confidence, flow.confidence)


def test_an_exr_without_confidence_is_trusted_everywhere(tmp_path):
    write_exr(tmp_path / "a.exr", {"v": np.full((3, 4), 2.0), "u": np.full((3, 4), 1.0)})
    stored = read_flow(tmp_path / "a.exr")
    assert_array_equal(stored.displacement, np.broadcast_to([1.0, 2.0], (3, 4, 2)))
    assert (stored.confidence == 1).all()


def test_unknown_flow_of_an_exr_is_known_nowhere_else(tmp_path):
    flow, known = a_flow(), np.ones((HEIGHT, WIDTH), bool)
    known[2:4, 5:] = False
    field = np.where(known[..., None], flow.displacement, 1e10)
    planes = {"u": field[..., 0], "v": field[..., 1], "confidence": flow.confidence}
    write_exr(tmp_path / "a.exr", planes)
    stored = read_flow(tmp_path / "a.exr")
    assert_array_equal(stored.known, known)
    assert_array_equal(stored.displacement, np.where(known[..., None], flow.displacement, 0))
    assert_array_equal(stored.confidence, np.where(known, flow.confidence, 0))


def test_either_component_beyond_1e9_makes_a_point_unknown(tmp_path):
    field = np.zeros((2, 2, 2), np.float32)
    field[0, 0, 0], field[0, 1, 1], field[1, 0] = 1.666666752e9, -2e9, 9e8
    (tmp_path / "a.flo").write_bytes(struct.pack("<4sii", b"PIEH", 2, 2) + field.tobytes())
    assert_array_equal(read_flow(tmp_path / "a.flo").known, [[False, False], [True, True]])


@pytest.mark.parametrize("suffix", FIELD_SUFFIXES)
def test_the_same_flow_gives_the_same_bytes(tmp_path, suffix):
    for name in ("a", "b"):
        write_flows({tmp_path / f"{name}{suffix}": parts(a_flow())})
    content = (tmp_path / f"a{suffix}").read_bytes()
    assert content == (tmp_path / f"b{suffix}").read_bytes()
    date = re.search(rb"20\d\d:\d\d:\d\d", content[:2000])  # the next second would change it
    assert date is None


def header(width, height, tag=b"PIEH", order="<"):
    return tag + struct.pack(f"{order}ii", width, height)


BROKEN_FLO = {
    "empty": (b"", "empty"),
    "tag": (header(2, 1, b"PIEX") + bytes(16), "PIEX"),
    "text": (b"not a flow at all", "not "),
    "short tag": (b"PI", "cut short"),
    "short header": (header(2, 1)[:9], "cut short"),
    "short": (header(2, 1) + bytes(15), "cut short: it has 27 bytes; expected 28 for 2x1 px"),
    "long": (header(2, 1) + bytes(17), "too long"),
    "no width": (header(0, 1), "0x1"),
    "negative": (header(2, -1) + bytes(16), "2x-1"),
    "absurd": (header(100_000, 2) + bytes(16), "100000x2"),
    "large and short": (header(99_999, 99_999) + bytes(16), "cut short"),
    "big-endian": (header(2, 1, order=">") + bytes(16), "big-endian"),
}


@pytest.mark.parametrize("fault", BROKEN_FLO)
def test_a_broken_flo_file_is_refused(tmp_path, fault):
    content, mentioned = BROKEN_FLO[fault]
    (tmp_path / "a.flo").write_bytes(content)
    with pytest.raises(UnreadableFile, match=re.escape(mentioned)) as told:
        read_flow(tmp_path / "a.flo")
    assert "a.flo" in str(told.value) and "\n" not in str(told.value)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.1, 0.5, 0.9, 0.999])
def test_a_cut_exr_is_refused(tmp_path, share):
    write_flows({tmp_path / "a.exr": parts(a_flow(40, 50))})
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(content[: int(share * len(content))])
    with pytest.raises(UnreadableFile, match=r"b\.exr"):
        read_flow(tmp_path / "b.exr")


def test_a_damaged_exr_header_is_refused_or_read_but_never_crashes(tmp_path):
    write_flows({tmp_path / "a.exr": parts(a_flow(40, 50))})
    content = (tmp_path / "a.exr").read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(60):
        damaged = bytearray(content)
        for place in rng.integers(0, 330, 3):  # the header, which holds all names and sizes
            damaged[place] = rng.integers(256)
        (tmp_path / "b.exr").write_bytes(damaged)
        try:
            assert np.isfinite(read_flow(tmp_path / "b.exr").displacement).all()
        except BadInput as error:
            refused += 1
            assert "b.exr" in str(error)
    assert refused > 30


@pytest.mark.parametrize(
    ("channels", "mentioned"),
    [
        (("R", "G", "B"), "channels R, G, B"),
        (("u",), "channels u"),
        (("u", "v", "w"), "expected u, v, confidence"),
    ],
)
def test_an_exr_with_other_channels_is_refused(tmp_path, channels, mentioned):
    write_exr(tmp_path / "a.exr", {name: np.zeros((3, 4)) for name in channels})
    with pytest.raises(BadInput, match=mentioned):
        read_flow(tmp_path / "a.exr")


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("suffix", FIELD_SUFFIXES)
def test_values_that_are_not_finite_are_refused_both_ways(tmp_path, suffix, value):
    flow = a_flow()
    path = tmp_path / f"a{suffix}"
    field = flow.displacement.copy()
    field[1, 2, 0] = value
    with pytest.raises(BadInput, match="1 of its values"):
        write_flows({path: (field, flow.confidence)})
    assert list(tmp_path.iterdir()) == []
    if suffix == ".flo":
        path.write_bytes(header(WIDTH, HEIGHT) + field.tobytes())
    else:
        write_exr(path, {"u": field[..., 0], "v": field[..., 1]})
    with pytest.raises(BadInput, match="1 values that are not finite"):
        read_flow(path)


@pytest.mark.parametrize("level", [-0.1, 1.1])
def test_a_confidence_outside_0_to_1_is_refused_both_ways(tmp_path, level):
    confidence = np.full((HEIGHT, WIDTH), level, np.float32)
    with pytest.raises(BadInput, match="confidence"):
        write_flows({tmp_path / "a.exr": (a_flow().displacement, confidence)})
    write_exr(tmp_path / "a.exr", {"u": confidence * 0, "v": confidence * 0, "confidence": confidence})
    with pytest.raises(BadInput, match=r"confidence from"):
        read_flow(tmp_path / "a.exr")


def test_shapes_that_disagree_and_fields_beyond_the_mark_are_refused(tmp_path):
    flow = a_flow()
    with pytest.raises(BadInput, match="have the shapes"):
        write_flows({tmp_path / "a.flo": (flow.displacement, flow.confidence[1:])})
    with pytest.raises(BadInput, match=r"beyond 1e\+09 px"):
        write_flows({tmp_path / "a.flo": (flow.displacement * np.float32(1e12), flow.confidence)})


@pytest.mark.parametrize("name", ["a.png", "a", "a.flo.txt"])
def test_another_suffix_is_refused(tmp_path, name):
    for use in (lambda path: write_flows({path: parts(a_flow())}), read_flow):
        with pytest.raises(BadInput, match=r"\.flo or \.exr"):
            use(tmp_path / name)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    (tmp_path / "folder.exr").mkdir()
    for name in ("nowhere.flo", "nowhere.exr", "folder.exr"):
        with pytest.raises(UnreadableFile, match=re.escape(name)):
            read_flow(tmp_path / name)


def test_an_exr_that_is_a_png_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 5, 3), np.uint8))
    (tmp_path / "a.png").rename(tmp_path / "a.exr")
    with pytest.raises(UnreadableFile, match="png"):
        read_flow(tmp_path / "a.exr")


@pytest.mark.parametrize("suffix", FIELD_SUFFIXES)
def test_fields_that_belong_together_are_written_all_or_none(tmp_path, suffix):
    (tmp_path / "file").write_text("in the way")
    first, second = tmp_path / f"a{suffix}", tmp_path / "file" / f"b{suffix}"
    first.write_bytes(b"what stood there")
    with pytest.raises(UnwritableFile, match=f"b{suffix}"):
        write_flows({first: parts(a_flow()), second: parts(a_flow())})
    assert first.read_bytes() == b"what stood there"
    assert sorted(path.name for path in tmp_path.iterdir()) == [first.name, "file"]
    write_flows({first: parts(a_flow()), tmp_path / f"c{suffix}": parts(a_flow(seed=1))})
    assert_array_equal(read_flow(tmp_path / f"c{suffix}").displacement, a_flow(seed=1).displacement)
    assert_array_equal(read_flow(first).displacement, a_flow().displacement)
