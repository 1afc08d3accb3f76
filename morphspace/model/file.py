"""Read and check `.morph` files before any of their content is used (data_spec/model-file.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.errors import ModelFileError, UnreadableFile
from morphspace.face.faceframe import REGISTRATION_KINDS
from morphspace.face.mesh import LANDMARKS
from morphspace.storage import digest_of_array, digest_of_json, read_container

FORMAT = "morphspace-model"
FORMAT_VERSION = 1
ARRAY_KINDS: Mapping[str, tuple[int, type[np.floating[Any]]]] = {
    "components": (2, np.float32),
    "variances": (1, np.float64),
    "mean_texture": (3, np.float32),
    "mean_displacement": (3, np.float32),
    "mean_inverse": (3, np.float32),
    "mask": (2, np.float32),
    "reference": (3, np.float32),
    "training_loadings": (2, np.float64),
}
OPTIONAL_ARRAY_KINDS: Mapping[str, tuple[int, type[np.floating[Any]]]] = {
    "landmark_mean": (2, np.float64),
    "landmark_weights": (3, np.float64),
    "landmark_error": (1, np.float64),
}  # all three with `landmarks` in the document, or none
NOT_READ_ON_OPENING = "components"  # hundreds of MB; `morphspace info` reads them and checks the digest
MEND = "Copy it again or rebuild it"


def read_model_file(path: Path) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Open a model file: arrays as memory maps and the document, checked against each other.

    Raises
    ------
    ModelFileError
        If the file is no model, of another version, truncated or inconsistent; the message names the part.
    """
    try:
        arrays, document = read_container(path)
    except UnreadableFile as error:
        raise ModelFileError(str(error)) from error
    if document.get("format") != FORMAT:
        raise ModelFileError(
            f"{path} has format {document.get('format')!r}; expected {FORMAT!r}. Give a .morph model"
        )
    version = document.get("version")
    if type(version) is not int or version != FORMAT_VERSION:
        raise ModelFileError(
            f"{path} has format version {version!r}; expected {FORMAT_VERSION}. Install the morphspace that wrote "
            "it"
        )
    _check_document(path, document)
    _check_arrays(path, arrays, len(document["training_frames"]))
    _check_landmarks(path, arrays, document.get("landmarks"))
    return arrays, document


def content_digest(arrays: Mapping[str, AnyArray], document: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of a model file's content: all arrays by name, and the document without this digest."""
    rest = {key: value for key, value in document.items() if key != "content_sha256"}
    return digest_of_json([rest, {name: digest_of_array(array) for name, array in arrays.items()}])


def check_content(path: Path) -> None:
    """Check that a model file is unchanged since it was written; reads it completely.

    Raises
    ------
    ModelFileError
        If the digest of the content differs from the recorded one.
    """
    arrays, document = read_model_file(path)
    found, recorded = content_digest(arrays, document), document["content_sha256"]
    if found != recorded:
        raise ModelFileError(
            f"{path} was changed after it was written: its digest is {found[:16]}; expected {recorded[:16]}. {MEND}"
        )


def _check_document(path: Path, document: Mapping[str, Any]) -> None:
    names = document.get("training_frames")
    wanted = {
        "content_sha256": isinstance(document.get("content_sha256"), str),
        "model_id": _is_id(document.get("model_id")),
        "reference_id": _is_id(document.get("reference_id")),
        "warp_weight": _is_number(document.get("warp_weight")) and document["warp_weight"] > 0,
        "discarded_variance": _is_number(document.get("discarded_variance"))
        and document["discarded_variance"] >= 0,
        "training_frames": isinstance(names, list) and all(isinstance(name, str) for name in names),
        "registration": document.get("registration") in REGISTRATION_KINDS,
        "flow": isinstance(document.get("flow"), str),
        "faceframe": _is_faceframe(document.get("faceframe", 0)),
        "reference_faceframe": _is_faceframe(document.get("reference_faceframe", 0)),
        "provenance": _is_provenance(document.get("provenance")),
    }
    for key, is_right in wanted.items():
        if not is_right:
            raise ModelFileError(f"{path}: {key} is missing or invalid ({document.get(key)!r:.60}). {MEND}")


def _check_kinds(
    path: Path, arrays: Mapping[str, AnyArray], kinds: Mapping[str, tuple[int, type[np.floating[Any]]]]
) -> None:
    for name, (dimensions, kind) in kinds.items():
        if name not in arrays or arrays[name].ndim != dimensions or arrays[name].dtype != kind:
            found = f"{arrays[name].dtype} {arrays[name].shape}" if name in arrays else "nothing"
            raise ModelFileError(
                f"{path}: {name} is {found}; expected {np.dtype(kind)} with {dimensions} axes. {MEND}"
            )


def _check_landmarks(path: Path, arrays: Mapping[str, AnyArray], entry: Any) -> None:
    """Check the landmark regression if the file has one."""
    if entry is None and not set(OPTIONAL_ARRAY_KINDS) & set(arrays):
        return
    _check_kinds(path, arrays, OPTIONAL_ARRAY_KINDS)
    whole = isinstance(entry, dict) and entry.get("places") == list(LANDMARKS)
    if not (whole and _is_number(entry.get("ridge")) and type(entry.get("faces")) is int):
        raise ModelFileError(
            f"{path}: its landmarks are invalid; expected the {len(LANDMARKS)} of this morphspace. Run `morphspace "
            "keypoints MODEL --auto` again with the morphspace that wrote it, or rebuild it"
        )
    count, k = len(LANDMARKS), len(arrays["variances"])
    expected = {
        "landmark_mean": (count, 2),
        "landmark_weights": (k, count, 2),
        "landmark_error": (count,),
    }
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise ModelFileError(f"{path}: {name} has shape {arrays[name].shape}; expected {shape}. {MEND}")
    if (arrays["landmark_error"] < 0).any():
        raise ModelFileError(f"{path}: a landmark error is negative; expected at least 0. {MEND}")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))


def _is_id(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{16}", value) is not None


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


def _is_faceframe(value: Any) -> bool:
    names = {"right_eye", "left_eye", "philtrum"}
    return value is None or (
        isinstance(value, dict) and set(value) == names and all(map(_is_pair, value.values()))
    )


def _is_provenance(value: Any) -> bool:
    if not isinstance(value, dict) or not isinstance(value.get("identity"), str):
        return False
    framing, reference = value.get("framing"), value.get("reference")
    if not isinstance(framing, dict) or not isinstance(reference, dict):
        return False
    crop = framing.get("crop")
    is_crop = crop is None or (isinstance(crop, list) and len(crop) == 4 and all(map(_is_number, crop)))
    rate = value.get("frame_rate_hz")
    if not (rate is None or (_is_number(rate) and 0 < rate <= 1000)):
        return False
    is_described = isinstance(reference.get("frame"), str) and isinstance(value.get("versions"), dict)
    return is_crop and is_described and _is_pair(framing.get("source_size")) and _is_pair(framing.get("size"))


def _check_arrays(path: Path, arrays: Mapping[str, AnyArray], frames: int) -> None:
    _check_kinds(path, arrays, ARRAY_KINDS)
    height, width = arrays["mask"].shape
    k = len(arrays["variances"])
    expected = {
        "components": (k, 5 * height * width),
        "mean_texture": (height, width, 3),
        "mean_displacement": (height, width, 2),
        "mean_inverse": (height, width, 2),
        "reference": (height, width, 3),
        "training_loadings": (frames, k),
    }
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise ModelFileError(f"{path}: {name} has shape {arrays[name].shape}; expected {shape}. {MEND}")
    for name, array in arrays.items():
        if name != NOT_READ_ON_OPENING and not np.isfinite(array).all():
            raise ModelFileError(f"{path}: {name} holds values that are not finite. {MEND}")
    if (arrays["variances"] < 0).any():
        raise ModelFileError(f"{path}: a variance is negative; expected at least 0. {MEND}")
