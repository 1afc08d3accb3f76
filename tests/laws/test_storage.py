"""Laws of the container and of writing: contents are read bit for bit, and a file is written whole or not at all."""

import json
import os
import stat
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from morphspace.errors import UnreadableFile, UnwritableFile
from morphspace.storage import (
    digest_of_array,
    digest_of_bytes,
    digest_of_file,
    digest_of_json,
    json_text,
    read_container,
    whole_file,
    write_container,
    write_text,
)


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def arrays_of_every_kind():
    rng = np.random.default_rng(3)
    return {
        "mean": rng.standard_normal((4, 5, 2)).astype(np.float32),
        "variances": rng.standard_normal(7),
        "half": rng.standard_normal((2, 3)).astype(np.float16),
        "counts": np.arange(6, dtype=np.int64).reshape(2, 3),
        "small": np.arange(4, dtype=np.int32),
        "mask": np.arange(9, dtype=np.uint8).reshape(3, 3),
        "empty": np.zeros((0, 5), np.float32),
        "scalar": np.array(2.5),
        "striped": rng.standard_normal((6, 8))[:, ::2],
    }


DOCUMENT = {"format": "morphspace-test", "identity": "Zoë", "list": [1, 2.5, None]}


@pytest.fixture
def container(tmp_path):
    path = tmp_path / "some.morph"
    write_container(path, arrays_of_every_kind(), DOCUMENT)
    return path


def test_container_round_trip_is_bit_equal(container):
    arrays, document = read_container(container)
    assert document == DOCUMENT
    assert list(arrays) == list(arrays_of_every_kind())
    for name, array in arrays_of_every_kind().items():
        assert arrays[name].dtype == array.dtype
        assert arrays[name].shape == array.shape
        assert arrays[name].tobytes() == array.tobytes()


def test_the_safetensors_library_reads_the_same_arrays(container):
    theirs = safetensors.numpy.load_file(container)
    assert set(theirs) == set(arrays_of_every_kind())
    for name, array in arrays_of_every_kind().items():
        assert theirs[name].dtype == array.dtype
        assert theirs[name].tobytes() == array.tobytes()


def test_arrays_larger_than_a_block_survive(tmp_path):
    large = np.arange(400_000, dtype=np.float64).reshape(400, 1000)
    write_container(tmp_path / "large.morph", {"large": large}, {})
    arrays, _ = read_container(tmp_path / "large.morph")
    np.testing.assert_array_equal(arrays["large"], large)


def test_same_content_has_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_container(tmp_path / name, arrays_of_every_kind(), DOCUMENT)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_arrays_read_from_a_file_cannot_be_changed(container):
    arrays, _ = read_container(container)
    with pytest.raises(ValueError, match="read-only"):
        arrays["mean"][0] = 1


def test_data_start_on_a_cache_line(container):
    (length,) = struct.unpack("<Q", container.read_bytes()[:8])
    assert (8 + length) % 64 == 0


@pytest.mark.parametrize("share", [0, 0.001, 0.01, 0.1, 0.5, 0.9, 0.999])
def test_cut_short_is_noticed(container, share):
    content = container.read_bytes()
    container.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(UnreadableFile, match=r"some.morph"):
        read_container(container)


def test_one_byte_too_few_or_too_many_is_noticed(container):
    content = container.read_bytes()
    container.write_bytes(content[:-1])
    with pytest.raises(UnreadableFile, match=f"has {len(content) - 1} bytes; expected {len(content)}"):
        read_container(container)
    container.write_bytes(content + b"\0")
    with pytest.raises(UnreadableFile, match=f"has {len(content) + 1} bytes; expected {len(content)}"):
        read_container(container)


@settings(max_examples=60, deadline=None)
@given(content=st.binary(max_size=200))
def test_random_bytes_are_refused(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("random") / "random.morph"
    path.write_bytes(content)
    with pytest.raises(UnreadableFile):
        read_container(path)


def write_raw(path: Path, header: object, data: bytes = b"") -> None:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)


META = {"__metadata__": {"morphspace": "{}"}}


@pytest.mark.parametrize(
    "entry",
    [
        {"dtype": "F32", "shape": [3], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [-2], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [-1, -2], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [2], "data_offsets": [-8, 0]},
        {"dtype": "F32", "shape": [2], "data_offsets": [0, 8, 16]},
        {"dtype": "F32", "shape": [2], "data_offsets": 8},
        {"dtype": "F32", "shape": [2], "data_offsets": [0]},
        {"dtype": "F32", "shape": [2]},
        {"dtype": "C64", "shape": [1], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [2**32, 2**32], "data_offsets": [0, 0]},
        {"dtype": "F32", "shape": [2**70], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [0, 2**70], "data_offsets": [0, 0]},
        {"dtype": "F32", "shape": [1] * 100 + [2], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [1e400], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": None, "data_offsets": [0, 8]},
        "text",
        7,
    ],
)
def test_wrong_entries_in_a_header_are_refused(tmp_path, entry):
    path = tmp_path / "wrong.morph"
    write_raw(path, {**META, "mean": entry}, bytes(8))
    with pytest.raises(UnreadableFile, match=r"wrong\.morph"):
        read_container(path)


@pytest.mark.parametrize(
    "header",
    [
        b"[" * 100_000,
        b"\xff\xfe",
        b"[]",
        b"{}",
        b"null",
        {"__metadata__": {}},
        {"__metadata__": {"morphspace": "[1]"}},
        {"__metadata__": {"morphspace": '{"document": {"a": NaN}, "checksum": 1}'}},
        {"__metadata__": {"morphspace": '{"document": {"a": "\\ud800"}, "checksum": 1}'}},
        {"__metadata__": {"morphspace": '[["a", 1]]'}},
        {"__metadata__": {"morphspace": "{"}},
        {"__metadata__": {"morphspace": 3}},
    ],
)
def test_wrong_headers_are_refused(tmp_path, header):
    path = tmp_path / "wrong.morph"
    write_raw(path, header)
    with pytest.raises(UnreadableFile, match=r"wrong\.morph"):
        read_container(path)


def test_a_missing_file_is_named(tmp_path):
    for read in (read_container, digest_of_file):
        with pytest.raises(UnreadableFile, match=r"cannot read .*gone\.morph: No such file"):
            read(tmp_path / "gone.morph")


def test_a_failure_while_writing_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "kept.txt"
    write_text(path, "old")
    with pytest.raises(KeyboardInterrupt), whole_file(path) as temporary:
        temporary.write_text("half of the new")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert names_in(tmp_path) == ["kept.txt"]


def test_a_file_is_flushed_before_it_is_renamed(tmp_path, monkeypatch):
    """Otherwise a power cut could leave an empty file under the final name."""
    path, lengths = tmp_path / "a.txt", []

    def forced(handle):
        assert not path.exists()
        lengths.append(os.fstat(handle).st_size)

    monkeypatch.setattr(os, "fsync", forced)
    write_text(path, "whole")
    assert lengths == [len("whole")] and path.exists()


FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from morphspace.errors import UnwritableFile
from morphspace.storage import write_container
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    write_container(Path(sys.argv[1]), {"x": np.ones((500, 500))}, {})
except UnwritableFile as error:
    print(error)
    sys.exit(2)
"""


@pytest.mark.parametrize("limit", [0, 100, 1_000_000, 2_000_000])
def test_full_disk_leaves_the_old_file_intact(container, limit):
    old = container.read_bytes()
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(container), str(limit)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert str(container) in done.stdout
    assert done.stdout.count("\n") == 1
    assert container.read_bytes() == old
    assert names_in(container.parent) == [container.name]


def test_a_file_in_place_of_the_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UnwritableFile, match=r"cannot write .*file/out.txt"):
        write_text(tmp_path / "file" / "out.txt", "text")


def test_a_folder_in_place_of_the_file_is_named(tmp_path):
    (tmp_path / "out.txt").mkdir()
    with pytest.raises(UnwritableFile, match=r"cannot write .*out\.txt"):
        write_text(tmp_path / "out.txt", "text")
    assert names_in(tmp_path) == ["out.txt"]


def test_a_name_as_long_as_the_system_allows_can_be_written(tmp_path):
    path = tmp_path / ("n" * 251 + ".txt")
    write_text(path, "text")
    assert path.read_text() == "text"


def test_a_new_file_gets_the_usual_permissions(tmp_path):
    write_text(tmp_path / "ours", "")
    (tmp_path / "plain").write_text("")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_key_order_does_not_change_a_document():
    assert json_text({"a": 1, "b": 2}) == json_text({"b": 2, "a": 1})
    assert digest_of_json({"a": 1, "b": 2}) == digest_of_json({"b": 2, "a": 1})
    with pytest.raises(ValueError, match="JSON"):
        json_text({"a": float("nan")})


def test_digests_tell_content_type_and_shape_apart(tmp_path):
    # the digest of "abc" is the example of FIPS 180-2, appendix B.1
    known = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    (tmp_path / "abc").write_bytes(b"abc")
    assert digest_of_bytes(b"a", b"bc") == digest_of_file(tmp_path / "abc") == known
    array = np.arange(6, dtype=np.float32)
    others = [array.reshape(2, 3), array.view(np.int32), array[::-1]]
    assert len({digest_of_array(each) for each in [array, *others]}) == 4
    assert digest_of_array(array.reshape(2, 3)) == digest_of_array(np.asfortranarray(array.reshape(2, 3)))


def test_a_rewritten_file_keeps_its_permissions(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "first")
    path.chmod(0o600)
    write_text(path, "second")
    assert path.read_text() == "second" and stat.S_IMODE(path.stat().st_mode) == 0o600
