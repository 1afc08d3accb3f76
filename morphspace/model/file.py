"""Read and check `.morph` files before any of their content is used (data_spec/model-file.md)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, TypedDict

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from morphspace.arrays import AnyArray
from morphspace.documents import (
    Digest,
    Digests,
    Document,
    FrameRate,
    Holds,
    ModelId,
    Open,
    OrNull,
    Point,
    Size,
)
from morphspace.errors import ModelFileError, UnreadableFile
from morphspace.face.faceframe import RegistrationKind
from morphspace.face.mesh import APERTURES, FEATURES, GROUPS, LANDMARKS
from morphspace.settings import Called
from morphspace.storage import digest_of_array, digest_of_json, read_container

Weight = Annotated[float, Gt(0)]
Count = Annotated[int, Ge(0)]
MEND = "Copy it again or rebuild it"


class FaceframePoints(TypedDict):
    """Three points, px."""

    right_eye: Point
    left_eye: Point
    philtrum: Point


class FramingEntry(TypedDict):
    """How the source pictures became the frames of the model, px."""

    source_size: Size
    crop: OrNull[Annotated[list[int], Len(4, 4), Called("[x, y, width, height] in px")]]
    size: Size
    crop_found: NotRequired[dict[str, Any]]


class ReferenceEntry(TypedDict):
    """The reference frame, and why it was chosen."""

    frame: str
    reason: str
    sha256: Digest


class GivenEntry(TypedDict):
    """The file from which face points were taken: its name and digest."""

    file: str
    sha256: Digest


Range = Annotated[list[float], Len(2, 2), Called("[smallest, largest] in degrees")]


Figures = Annotated[dict[str, float], Holds(FEATURES)]


class CarriedEntry(TypedDict):
    """How much of the expressions the warp carries, by feature, estimated from so many frames."""

    frames: Annotated[int, Ge(1)]
    left_over: Figures
    slope: Figures
    motion: Figures
    opening_slope: Annotated[dict[str, float], Holds(tuple(APERTURES))]


class SearchEntry(TypedDict, total=False):
    """The face points of a build: `reference_points` in px if they were given, the frames' pose if it is known."""

    detector: dict[str, Any]
    held: bool
    frames: Count
    frames_with_face: Count
    frames_given: Count
    frames_turned: Count
    reference_has_face: bool
    reference_points: list[Point]
    given: GivenEntry
    yaw_deg: Range
    pitch_deg: Range
    roll_deg: Range
    carried: CarriedEntry


class KeypointsEntry(TypedDict, total=False):
    """The origin of the faceframe; `points` are those of the face mesh `scheme` on the mean face, px."""

    source: str
    lip: Literal["philtrum", "upper-lip"]
    scheme: str
    points: OrNull[list[Point]]


class BlendEntry(TypedDict):
    """How an avatar was blended (data_spec/avatar.md)."""

    identities: list[str]
    model_ids: list[ModelId]
    weights: list[float]
    reference: str
    surround: OrNull[str]
    faceframe: str
    method: str
    max_sd: float
    correspondence: Literal["expression", "rest"]
    expressions: OrNull[Count]
    frames_of: Literal["models", "clips"]
    sharpen: float


class Provenance(TypedDict):
    """The origin of a model; a build writes all entries but `blend` and `pair`, and readers need four of them."""

    identity: str
    consent: NotRequired[OrNull[str]]
    licence: NotRequired[OrNull[str]]
    frame_rate_hz: NotRequired[OrNull[FrameRate]]
    times_s: NotRequired[list[float]]
    framing: Annotated[FramingEntry, Open()]
    mask_sha256: NotRequired[OrNull[Digest]]
    inputs: NotRequired[Digests]
    reference: Annotated[ReferenceEntry, Open()]
    flow_start: NotRequired[Literal["auto", "none"]]
    mask_from: NotRequired[Literal["given", "found face", "faceframe", "ellipse"]]
    landmarks: NotRequired[Annotated[OrNull[SearchEntry], Open()]]
    components_asked: NotRequired[Annotated[int, Ge(1)]]
    warp_weight_trials: NotRequired[list[Annotated[list[float], Len(2, 2)]]]
    keypoints: NotRequired[Annotated[OrNull[KeypointsEntry], Open()]]
    blend: NotRequired[Annotated[BlendEntry, Open()]]
    pair: NotRequired[dict[str, Any]]
    versions: dict[str, str]


class LandmarksEntry(TypedDict):
    """The landmark regression, whose arrays are beside the document."""

    scheme: Literal["mediapipe-attention-478", "mediapipe-478"]
    places: Annotated[list[Annotated[int, Ge(0), Le(477)]], Len(1)]
    faces: Annotated[int, Ge(8)]
    ridge: Weight
    toward: Literal["warp", "mean"]
    error_px: Annotated[dict[str, Annotated[float, Ge(0)]], Holds(("all", *GROUPS))]


class ModelDocument(TypedDict):
    """The document of a model file (data_spec/model-file.md)."""

    format: Literal["morphspace-model"]
    version: Literal[1]
    content_sha256: Digest
    model_id: ModelId
    reference_id: ModelId
    warp_weight: Weight
    discarded_variance: Annotated[float, Ge(0)]
    faceframe: OrNull[FaceframePoints]
    reference_faceframe: OrNull[FaceframePoints]
    training_frames: Annotated[list[str], Len(2)]
    registration: RegistrationKind
    flow: str
    landmarks: NotRequired[LandmarksEntry]
    provenance: Annotated[Provenance, Open()]


MODEL = Document(
    "model-file",
    "The JSON document in the header of a .morph file, version 1",
    ModelDocument,
    MEND,
    "Give a .morph model",
)
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
FILES_REMEMBERED = 1024  # files whose digest is not computed again while they stay unchanged


def read_model_file(path: Path) -> tuple[dict[str, AnyArray], ModelDocument]:
    """Open a model file: arrays as memory maps and the document, checked against each other and their digest.

    The digest is computed once per process while the file stays unchanged, at about a gigabyte a second.

    Raises
    ------
    ModelFileError
        If the file is no model, of another version, truncated, inconsistent or changed after it was written; the
        message names the part.

    Examples
    --------
    >>> arrays, document = read_model_file(Path("anna.morph"))
    >>> arrays["mask"].shape, document["provenance"]["identity"]
    ((72, 60), 'anna')
    """
    try:
        arrays, found = read_container(path)
        document = MODEL.checked(found, path)
    except UnreadableFile as error:
        raise ModelFileError(str(error)) from error
    _check_arrays(path, arrays, len(document["training_frames"]))
    _check_landmarks(path, arrays, document.get("landmarks"))
    status = path.stat()
    _check_content(path.resolve(), status.st_size, status.st_mtime_ns, status.st_ino)
    return arrays, document


def content_digest(arrays: Mapping[str, AnyArray], document: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of a model file's content: all arrays by name, and the document without this digest."""
    rest = {key: value for key, value in document.items() if key != "content_sha256"}
    return digest_of_json([rest, {name: digest_of_array(array) for name, array in arrays.items()}])


@lru_cache(maxsize=FILES_REMEMBERED)
def _check_content(path: Path, _size: int, _modified_ns: int, _node: int) -> None:
    """Compare the digest of a file with the recorded one, and check that its components are finite.

    All arguments but the path tell whether the file is the one that was checked before.
    """
    arrays, document = read_container(path)
    # A sum of squares is finite if its terms are, and takes a fifth of the time of a look at each.
    with np.errstate(over="ignore", invalid="ignore"):
        is_finite = all(np.isfinite(np.dot(component, component)) for component in arrays["components"])
    if not is_finite:
        raise ModelFileError(f"{path}: components holds values that are not finite. {MEND}")
    found, recorded = content_digest(arrays, document), document["content_sha256"]
    if found != recorded:
        raise ModelFileError(
            f"{path} was changed after it was written: its digest is {found[:16]}; expected {recorded[:16]}. {MEND}"
        )


def _check_kinds(
    path: Path, arrays: Mapping[str, AnyArray], kinds: Mapping[str, tuple[int, type[np.floating[Any]]]]
) -> None:
    for name, (dimensions, kind) in kinds.items():
        if name not in arrays or arrays[name].ndim != dimensions or arrays[name].dtype != kind:
            found = f"{arrays[name].dtype} {arrays[name].shape}" if name in arrays else "nothing"
            raise ModelFileError(
                f"{path}: {name} is {found}; expected {np.dtype(kind)} with {dimensions} axes. {MEND}"
            )


def _check_landmarks(path: Path, arrays: Mapping[str, AnyArray], entry: LandmarksEntry | None) -> None:
    """Check the landmark regression if the file has one."""
    if entry is None and not set(OPTIONAL_ARRAY_KINDS) & set(arrays):
        return
    _check_kinds(path, arrays, OPTIONAL_ARRAY_KINDS)
    if entry is None or entry["places"] != list(LANDMARKS):
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
        if name != "components" and not np.isfinite(array).all():
            raise ModelFileError(f"{path}: {name} holds values that are not finite. {MEND}")
    if (arrays["variances"] < 0).any():
        raise ModelFileError(f"{path}: a variance is negative; expected at least 0. {MEND}")
