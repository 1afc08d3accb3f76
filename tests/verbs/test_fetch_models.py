"""Laws of fetching the networks: only what is expected, whole or not at all, and nothing twice."""

import hashlib
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from morphspace import storage
from morphspace.cli.main import main
from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.face.detector import fetch
from morphspace.face.detector.models import (
    FILES,
    ORIGINS,
    ModelFile,
    Origin,
    models_folder,
    models_present,
    state_of,
)
from morphspace.steps import result_of
from morphspace.verbs import models_list
from morphspace.verbs.models_fetch import ModelsFetchRequest, run
from morphspace.verbs.models_list import ModelsListRequest

CONTENTS = {"a.tflite": b"first network" * 50, "b.tflite": b"second network" * 70}


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def make_wheel(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def origin_of(wheel, contents=CONTENTS):
    files = tuple(
        ModelFile(name, f"pack/data/{name}", len(content), sha256(content), "a test")
        for name, content in contents.items()
    )
    return Origin("made-up==1.0", wheel.name, sha256(wheel.read_bytes()), files, "free")


@pytest.fixture
def wheel(tmp_path):
    members = {f"pack/data/{name}": content for name, content in CONTENTS.items()}
    members["../outside.txt"] = b"must not be unpacked"
    members["pack/__init__.py"] = b"raise SystemExit('must not be run')"
    (tmp_path / "source").mkdir()
    return make_wheel(tmp_path / "source" / "made_up-1.0-py3-none-any.whl", members)


@pytest.fixture
def origin(wheel):
    return origin_of(wheel)


def no_download(origin, folder):
    raise AssertionError("nothing may be downloaded here")


def fetched(source, folder, origin, download=no_download):
    return result_of(run(ModelsFetchRequest(source, folder), origins=(origin,), download=download))


def inside(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_wheel_gives_its_networks_and_nothing_else(wheel, origin, tmp_path):
    outcome = fetched(wheel, tmp_path / "to", origin)
    assert inside(tmp_path / "to") == CONTENTS
    assert not (tmp_path / "outside.txt").exists()
    assert sorted(path.name for path in outcome.written) == sorted(CONTENTS)
    assert models_present(tmp_path / "to", origin.files)


def test_a_folder_may_hold_the_wheel_or_the_files(wheel, origin, tmp_path):
    fetched(wheel.parent, tmp_path / "one", origin)
    fetched(tmp_path / "one", tmp_path / "two", origin)
    assert inside(tmp_path / "two") == CONTENTS


def test_a_download_is_what_is_used_without_a_source(wheel, origin, tmp_path):
    places = []

    def download(asked, folder):
        places.append(folder)
        return Path(folder / wheel.name).absolute().write_bytes(wheel.read_bytes()) and folder / asked.name

    fetched(None, tmp_path / "to", origin, download)
    assert inside(tmp_path / "to") == CONTENTS
    assert not places[0].exists()  # the temporary folder went again


def test_a_second_fetch_does_nothing_and_says_so(wheel, origin, tmp_path):
    fetched(wheel, tmp_path / "to", origin)
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "to").iterdir()}
    outcome = fetched(None, tmp_path / "to", origin)
    assert outcome.written == ()
    assert "nothing was fetched" in outcome.lines[0]
    assert times == {path: path.stat().st_mtime_ns for path in (tmp_path / "to").iterdir()}


def test_a_source_is_checked_even_where_all_is_there(wheel, origin, tmp_path):
    fetched(wheel, tmp_path / "to", origin)
    outcome = fetched(wheel, tmp_path / "to", origin)
    assert outcome.written == ()
    assert f"identical to {wheel}; nothing was written" in outcome.lines[0]
    other = make_wheel(tmp_path / "other.whl", {"pack/data/a.tflite": b"another"})
    for source, words in (
        (other, "sha256"),
        (tmp_path / "none.whl", "does not exist"),
        (tmp_path, "holds neither"),
    ):
        with pytest.raises(UnreadableFile, match=words):
            fetched(source, tmp_path / "to", origin)
    assert inside(tmp_path / "to") == CONTENTS


def test_a_write_that_fails_leaves_whole_files_and_the_next_fetch_brings_the_rest(
    wheel, origin, tmp_path, monkeypatch
):
    write = Path.write_bytes

    def full(self, content):
        if content == CONTENTS["b.tflite"]:
            write(self, content[:10])
            raise OSError(28, "No space left on device")
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(UnwritableFile, match=r"b\.tflite: No space left on device"):
        fetched(wheel, tmp_path / "to", origin)
    assert inside(tmp_path / "to") == {"a.tflite": CONTENTS["a.tflite"]}
    monkeypatch.undo()
    outcome = fetched(wheel, tmp_path / "to", origin)
    assert [path.name for path in outcome.written] == ["b.tflite"]


@pytest.mark.parametrize("content", [b"", CONTENTS["a.tflite"] + b"x", b"X" + CONTENTS["a.tflite"][1:]])
def test_a_damaged_network_is_said_and_replaced_alone(wheel, origin, tmp_path, content):
    fetched(wheel, tmp_path / "to", origin)
    (tmp_path / "to" / "a.tflite").write_bytes(content)
    assert state_of(origin.files[0], tmp_path / "to") == "damaged"
    listed = result_of(models_list.run(ModelsListRequest(tmp_path / "to"), origins=(origin,)))
    assert listed.document["models"] == {"a.tflite": "damaged", "b.tflite": "present"}
    assert "models fetch" in listed.warnings[0]
    outcome = fetched(wheel, tmp_path / "to", origin)
    assert [path.name for path in outcome.written] == ["a.tflite"]
    assert "a.tflite was damaged and was replaced" in outcome.lines
    assert inside(tmp_path / "to") == CONTENTS


def test_a_corrupted_wheel_is_refused_and_leaves_nothing(wheel, origin, tmp_path):
    content = bytearray(wheel.read_bytes())
    content[40] ^= 1
    wheel.write_bytes(content)
    with pytest.raises(UnreadableFile, match=f"sha256.*{origin.sha256}"):
        fetched(wheel, tmp_path / "to", origin)
    assert not (tmp_path / "to").exists()


def test_what_is_no_archive_is_refused_even_with_the_right_digest(tmp_path):
    for name, content in (("text.whl", b"no archive"), ("cut.whl", b"PK\x03\x04" + bytes(60))):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(UnreadableFile, match="cannot be unpacked"):
            fetch.read_from(path, (origin_of(path),))


def test_a_member_of_another_content_or_length_is_refused_and_nothing_is_written(tmp_path):
    for name, content in (("other.whl", b"Second network" * 70), ("long.whl", b"second network" * 9000)):
        members = {"pack/data/a.tflite": CONTENTS["a.tflite"], "pack/data/b.tflite": content}
        path = make_wheel(tmp_path / name, members)
        with pytest.raises(UnreadableFile, match=r"b\.tflite is another file"):
            fetched(path, tmp_path / "to", origin_of(path))
    assert not (tmp_path / "to").exists()


def test_a_missing_member_file_or_source_is_named(wheel, origin, tmp_path):
    path = make_wheel(tmp_path / "less.whl", {"pack/data/a.tflite": CONTENTS["a.tflite"]})
    with pytest.raises(UnreadableFile, match=r"pack/data/b\.tflite"):
        fetch.read_from(path, (origin_of(path),))
    with pytest.raises(UnreadableFile, match=r"holds neither a\.tflite nor made_up"):
        fetch.read_from(tmp_path, (origin,))
    with pytest.raises(UnreadableFile, match="does not exist"):
        fetch.read_from(tmp_path / "nowhere.whl", (origin,))


def test_a_folder_that_cannot_be_written_is_said_before_anything_is_fetched(origin, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UnwritableFile, match="is a file; expected a folder"):
        fetched(None, tmp_path / "file" / "to", origin)


def test_a_read_only_folder_is_said(wheel, origin, tmp_path, monkeypatch):
    def refuse(*args, **options):
        raise PermissionError(13, "Permission denied")

    (tmp_path / "to").mkdir()
    monkeypatch.setattr(
        storage.tempfile, "NamedTemporaryFile", refuse
    )  # root may write anywhere, so the mode alone proves nothing
    with pytest.raises(UnwritableFile, match="Permission denied"):
        fetched(wheel, tmp_path / "to", origin)


def pip_that(monkeypatch, returncode, stderr="", makes=()):
    def pretend(command, **options):
        assert command[:4] == [sys.executable, "-m", "pip", "download"]
        assert "--no-deps" in command
        assert command[-1] == "made-up==1.0"
        folder = Path(command[command.index("--dest") + 1])
        for name, content in makes:
            (folder / name).write_bytes(content)
        return subprocess.CompletedProcess(command, returncode, "", stderr)

    monkeypatch.setattr(fetch.subprocess, "run", pretend)


def test_pip_brings_the_pinned_wheel(wheel, origin, tmp_path, monkeypatch):
    pip_that(monkeypatch, 0, makes=[(wheel.name, wheel.read_bytes())])
    fetched(None, tmp_path / "to", origin, fetch.download_with_pip)
    assert inside(tmp_path / "to") == CONTENTS


@pytest.mark.parametrize(
    ("stderr", "said"),
    [
        ("/usr/bin/python: No module named pip", "has no pip"),
        ("WARNING: x\nERROR: no connection\n", "no connection"),
        ("", "nothing"),
    ],
)
def test_a_pip_that_fails_is_quoted_and_the_way_round_is_told(origin, tmp_path, monkeypatch, stderr, said):
    pip_that(monkeypatch, 1, stderr)
    with pytest.raises(BadInput, match=f"{said}.*--from FOLDER"):
        fetched(None, tmp_path / "to", origin, fetch.download_with_pip)
    assert inside(tmp_path / "to") == {}


def test_a_pip_that_brings_something_else_is_told(origin, tmp_path, monkeypatch):
    pip_that(monkeypatch, 0, makes=[("made_up-2.0.whl", b"")])
    with pytest.raises(BadInput, match=r"made_up-2\.0\.whl"):
        fetched(None, tmp_path / "to", origin, fetch.download_with_pip)


def test_a_pip_that_hangs_or_cannot_run_is_told(origin, tmp_path, monkeypatch):
    for error in (subprocess.TimeoutExpired("pip", 600), OSError(12, "Cannot allocate memory")):

        def fail(command, error=error, **options):
            raise error

        monkeypatch.setattr(fetch.subprocess, "run", fail)
        with pytest.raises(BadInput, match="--from FOLDER"):
            fetched(None, tmp_path / "to", origin, fetch.download_with_pip)


def test_the_folder_follows_the_environment(tmp_path):
    assert models_folder({"MORPHSPACE_MODELS": str(tmp_path / "m")}) == tmp_path / "m"
    if sys.platform != "win32":
        assert models_folder({"XDG_CACHE_HOME": str(tmp_path)}) == tmp_path / "morphspace" / "models"
        assert models_folder({"XDG_CACHE_HOME": "relative"}) == Path.home() / ".cache/morphspace/models"
    assert models_folder({}).parts[-2:] == ("morphspace", "models")


def test_the_pinned_origins_name_one_version_and_whole_digests():
    assert all("==" in origin.requirement and origin.licence for origin in ORIGINS)
    digests = [*(origin.sha256 for origin in ORIGINS), *(file.sha256 for file in FILES)]
    assert len(set(digests)) == len(ORIGINS) + len(FILES) == 6
    assert all(len(bytes.fromhex(digest)) == 32 for digest in digests)


@pytest.fixture
def two(tmp_path):
    """A folder with two wheels of one network each, and their origins."""
    (tmp_path / "wheels").mkdir()
    origins = []
    for name, content in CONTENTS.items():
        wheel = make_wheel(tmp_path / "wheels" / f"{name[0]}-1.0.whl", {f"pack/data/{name}": content})
        origins.append(origin_of(wheel, {name: content}))
    return tmp_path / "wheels", tuple(origins)


def test_networks_of_two_wheels_come_from_a_folder_or_one_wheel_after_the_other(two, tmp_path):
    folder, origins = two

    def fetch_from(source, to):
        return result_of(
            run(ModelsFetchRequest(source, tmp_path / to), origins=origins, download=no_download)
        )

    fetch_from(folder, "to")
    assert inside(tmp_path / "to") == CONTENTS
    with pytest.raises(BadInput, match=r"a-1\.0\.whl lacks b\.tflite; .*a-1\.0\.whl and b-1\.0\.whl"):
        fetch_from(folder / "a-1.0.whl", "other")
    assert not (tmp_path / "other").exists()
    (tmp_path / "to" / "b.tflite").unlink()
    assert [path.name for path in fetch_from(folder / "b-1.0.whl", "to").written] == ["b.tflite"]


def test_only_the_wheels_of_missing_networks_are_downloaded(two, tmp_path):
    folder, origins = two
    asked = []

    def download(origin, to):
        asked.append(origin.name)
        return folder / origin.name

    request = ModelsFetchRequest(None, tmp_path / "to")
    result_of(run(request, origins=origins, download=download))
    (tmp_path / "to" / "b.tflite").unlink()
    result_of(run(request, origins=origins, download=download))
    assert asked == ["a-1.0.whl", "b-1.0.whl", "b-1.0.whl"]


@pytest.fixture
def command():
    return lambda *words: CliRunner().invoke(main, ["models", *map(str, words)])


def test_the_command_line_lists_and_refuses_in_one_line(command, tmp_path):
    listed = command("list", "--to", tmp_path)
    assert listed.exit_code == 0
    assert listed.output.count("missing") == len(FILES)
    failed = command("fetch", "--from", tmp_path / "nowhere", "--to", tmp_path / "to")
    assert failed.exit_code == 2
    assert failed.output.count("\n") == 1
    assert "nowhere does not exist" in failed.output


def test_a_file_where_the_folder_should_be_names_the_variable(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BadInput, match=r"file is a file; .*MORPHSPACE_MODELS"):
        result_of(run(ModelsFetchRequest(folder=tmp_path / "file"), download=no_download))
    assert (tmp_path / "file").read_text() == "mine"
