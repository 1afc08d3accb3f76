"""Laws of stored results: they are read unchanged, damage is noticed, and other files stay."""

import os
import time

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from morphspace import cache
from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.storage import read_container, write_container

ARRAYS = {"image": np.arange(24, dtype=np.float32).reshape(2, 4, 3), "none": np.zeros((0, 3))}
DOCUMENT = {"start": "neighbour", "error": 0.1 + 0.2}


@pytest.fixture
def kept(tmp_path):
    file = cache.result_file(tmp_path, "frame", 1, "digest")
    cache.write_result(file, ARRAYS, DOCUMENT)
    return file


def test_a_result_is_read_bit_for_bit(kept):
    arrays, document = cache.read_result(kept)
    assert document == DOCUMENT and set(arrays) == set(ARRAYS)
    for name, array in arrays.items():
        assert_array_equal(array, ARRAYS[name], strict=True)


def test_another_dependency_has_another_file(tmp_path):
    parts = [("a", 1), ("a", 2), ("a", 1, None), ("a", [1]), (["a", 1],), ("a1",), ("a", "1"), ()]
    files = {cache.result_file(tmp_path, *one) for one in parts}
    assert len(files) == len(parts)
    assert cache.result_file(tmp_path, "a", {"x": 1, "y": 2}) == cache.result_file(
        tmp_path, "a", {"y": 2, "x": 1}
    )


@pytest.mark.parametrize("place", [0.02, 0.3, 0.5, 0.999])
def test_one_wrong_byte_is_noticed(kept, place):
    """Also in the numbers: a file of the right length with other numbers would be used unnoticed."""
    content = bytearray(kept.read_bytes())
    content[int(place * len(content))] ^= 1
    kept.write_bytes(content)
    assert not cache.is_finished(kept)
    with pytest.raises(UnreadableFile):
        cache.read_result(kept)


@pytest.mark.parametrize("change", ["arrays", "document", "name", "shape"])
def test_content_that_differs_from_its_checksum_is_refused(kept, change):
    arrays, head = read_container(kept)
    arrays = {name: np.array(array) for name, array in arrays.items()}
    if change == "arrays":
        arrays["image"][1, 2, 0] += 1
    elif change == "document":
        head["document"]["start"] = "coarse to fine"
    elif change == "name":
        arrays["picture"] = arrays.pop("image")
    else:
        arrays["image"] = arrays["image"].reshape(4, 2, 3)
    write_container(kept, arrays, head)
    with pytest.raises(UnreadableFile, match="differs from its checksum"):
        cache.read_result(kept)


@pytest.mark.parametrize("size", [0, 5, 200])
def test_a_result_cut_short_or_missing_is_not_finished(kept, size):
    assert cache.is_finished(kept)
    kept.write_bytes(kept.read_bytes()[:size])
    assert not cache.is_finished(kept)
    kept.unlink()
    assert not cache.is_finished(kept)


def test_another_container_is_no_result(tmp_path):
    file = cache.result_file(tmp_path, 1)
    write_container(file, ARRAYS, {"format": "morphspace-model"})
    assert not cache.is_finished(file)


def test_forgetting_removes_results_and_no_other_files(kept):
    folder = kept.parent
    for name in (f".{kept.stem}.morphspace-2gaer3l7.kept", ".morphs.morphspace-a_b4c5d6.kept"):
        (folder / name).touch()
    (folder / "notes.txt").write_text("mine")
    (folder / "mine.kept").write_text("mine")
    cache.forget(folder)
    assert {path.name for path in folder.iterdir()} == {"notes.txt", "mine.kept"}
    for path in folder.iterdir():
        path.unlink()
    cache.forget(folder)
    assert not folder.exists()
    cache.forget(folder)  # nothing is there, and nothing is said


def test_a_work_folder_is_removed_on_success_and_stays_to_resume(tmp_path):
    output = tmp_path / "a.morph"
    with pytest.raises(KeyboardInterrupt), cache.work_folder(None, output) as folder:
        assert folder == tmp_path / "a.morph.work"
        cache.write_result(cache.result_file(folder, 1), ARRAYS, DOCUMENT)
        raise KeyboardInterrupt
    assert folder.exists()
    with cache.work_folder(None, output) as again:
        assert cache.is_finished(cache.result_file(again, 1))
    assert not folder.exists()


def test_a_failure_without_results_leaves_no_folder(tmp_path):
    with pytest.raises(KeyboardInterrupt), cache.work_folder(None, tmp_path / "a.morph"):
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_given_folder_stays(tmp_path):
    with cache.work_folder(tmp_path / "mine", tmp_path / "a.morph") as folder:
        file = cache.result_file(folder, 1)
        cache.write_result(file, ARRAYS, DOCUMENT)
    assert cache.is_finished(file) and not (tmp_path / "a.morph.work").exists()


def test_files_of_a_killed_run_are_removed_and_those_of_a_running_one_stay(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    left, written, note = (
        folder / ".0257b168.morphspace-2gaer3l7.kept",
        folder / ".0257b168.morphspace-3gaer3l7.kept",
        folder / ".note",
    )
    for path in (left, written, note):
        path.touch()
    for path in (left, note):
        os.utime(path, (time.time() - 7200,) * 2)
    with cache.work_folder(folder, tmp_path / "a.morph"):
        assert set(folder.iterdir()) == {written, note}


def test_a_work_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "a.morph.work").write_text("mine")
    with (
        pytest.raises(UnwritableFile, match=r"a\.morph\.work"),
        cache.work_folder(None, tmp_path / "a.morph"),
    ):
        pass


def test_a_work_folder_that_is_a_link_is_refused_unless_it_was_given(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    kept = cache.result_file(elsewhere, "of another run")
    cache.write_result(kept, {}, {})
    (tmp_path / "a.morph.work").symlink_to(elsewhere)
    with pytest.raises(BadInput, match="is a link"), cache.work_folder(None, tmp_path / "a.morph"):
        pass
    assert kept.is_file()
    with cache.work_folder(tmp_path / "a.morph.work", tmp_path / "a.morph"):
        pass
    assert kept.is_file()
