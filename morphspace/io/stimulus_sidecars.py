"""The JSON file beside each stimulus: its content, its origin and its image statistics (`data_spec/stimulus.md`).

It contains the drawing: the stimulus can be drawn again from this file and the model alone. The most important
entries are also embedded in the image or video itself.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from annotated_types import Ge, Le, Len

from morphspace import __version__
from morphspace.documents import (
    Digest,
    Digests,
    Document,
    FileName,
    FrameRate,
    OrNull,
    Size,
    Table,
    Versions,
)
from morphspace.errors import UnreadableFile
from morphspace.io.png import png_texts
from morphspace.settings import Pattern
from morphspace.storage import parsed_json

KEYWORD = "morphspace"  # keyword of the text embedded in a PNG
COMMENT = "comment"  # metadata entry of a video with the same text
ORIGINAL_IDENTITY = "original_identity"  # the person in the images into which the face was placed
UNITS = {
    "loadings_sd": "SD of each component over the model's training faces",
    "colour_sd": "SD, of the texture where it has loadings of its own",
    "outside_sd": "SD, of the face outside the region",
    "registrations": "px, (x, y) of the rendered picture to (x, y) of the original: a00 a01 a02 a10 a11 a12",
    "frame_rate_hz": "frames a second",
    "luminance": "ITU-R BT.709 luminance, mean over the picture, 0 to 1",
    "rms_contrast": "standard deviation of luminance over its mean",
    "spectral_slope": "of log amplitude on log spatial frequency",
    "red, green, blue": "mean over the picture, 0 to 1",
    "clipped_percent": "of the colour values, clipped to the range of the file",
    "folded_percent": "of the cells of the face's grid that the warp turns over, in the worst frame",
    "largest_sd": "SD, the loading furthest from the mean",
    "rms_sd": "SD, root mean square of the loadings, in the frame furthest from the mean",
}
Percent = Annotated[float, Ge(0), Le(100)]
NotNegative = Annotated[float, Ge(0)]
Component = Annotated[int, Ge(1)]
Registration = Annotated[list[float], Len(6, 6)]


class StimulusModel(TypedDict):
    """The model of a stimulus."""

    file: FileName
    identity: str
    model_id: str
    sha256: Digest


class PlacingDocument(TypedDict):
    """The original frames into which the faces were put back."""

    names: list[str]
    digests: list[Digest]
    registrations: list[Registration]
    sources: list[str]
    deinterlace: bool
    frame_rate_hz: OrNull[FrameRate]


class DrawingDocument(TypedDict):
    """The numbers from which a stimulus is drawn."""

    name: Annotated[str, Pattern("[^/].*", "a name")]
    suffix: Literal[".png", ".mp4", ".mkv"]
    frame_rate_hz: OrNull[FrameRate]
    loadings_sd: Table
    colour_sd: OrNull[Table]
    region: OrNull[str]
    outside_sd: OrNull[Table]
    placing: OrNull[PlacingDocument]
    variables: dict[str, OrNull[str | float | bool]]


class Figures(TypedDict):
    """Image statistics; null without meaning."""

    luminance: OrNull[float]
    rms_contrast: OrNull[float]
    spectral_slope: OrNull[float]
    red: OrNull[float]
    green: OrNull[float]
    blue: OrNull[float]


class Statistics(TypedDict):
    """Image statistics, in linear light and in code values."""

    linear: Figures
    code: Figures


class Quality(TypedDict):
    """Clipped values, folds, and the distance from the mean face."""

    clipped_values: Annotated[int, Ge(0)]
    clipped_percent: Percent
    folded_percent: Percent
    largest_sd: NotNegative
    largest_component: Component
    rms_sd: NotNegative
    beyond: list[Component]


class Output(TypedDict):
    """The file of a stimulus."""

    file: FileName
    sha256: Digest
    bytes: Annotated[int, Ge(1)]
    frames: Annotated[int, Ge(1)]
    frame_rate_hz: OrNull[FrameRate]
    size: Size


class Stimulus(TypedDict):
    """The entries of a stimulus sidecar (data_spec/stimulus.md)."""

    format: Literal["morphspace-stimulus"]
    version: Literal[1]
    verb: Annotated[str, Pattern(r"\S.*", "the name of a verb")]
    request: dict[str, Any]
    model: StimulusModel
    inputs: Digests
    drawing: DrawingDocument
    units: dict[str, str]
    statistics: Statistics
    quality: Quality
    consent: OrNull[str]
    licence: OrNull[str]
    output: Output
    made_from_sha256: Digest
    versions: Versions


STIMULUS = Document("stimulus", "morphspace stimulus sidecar, version 1", Stimulus)


def essentials(head: Mapping[str, Any], described: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries embedded in a stimulus file: model, verb, digest of the request, consent, licence and version.

    Parameters
    ----------
    head : mapping
        The entries that all stimuli of a set share.
    described : mapping
        The drawing's own description; a second person in the image is taken from it.
    """
    also = {key: described[key] for key in (ORIGINAL_IDENTITY,) if key in described}
    return {
        **also,
        "model_id": head["model"]["model_id"],
        "identity": head["model"]["identity"],
        "verb": head["verb"],
        "request_sha256": head["request_sha256"],
        "consent": head["consent"],
        "licence": head["licence"],
        "software": f"morphspace {__version__}",
    }


def file_texts(head: Mapping[str, Any], described: Mapping[str, Any], suffix: str) -> dict[str, str]:
    """Return the texts to embed in a PNG (keywords) or a video (metadata entries), by the `suffix` of the file."""
    words = json.dumps(essentials(head, described), sort_keys=True, ensure_ascii=False)
    licence = head["licence"]
    rights = (
        {} if not isinstance(licence, str) else {"Copyright" if suffix == ".png" else "copyright": licence}
    )
    if suffix == ".png":
        return {"Software": f"morphspace {__version__}", **rights, KEYWORD: words}
    return {COMMENT: words, **rights}


def essentials_in(path: Path) -> dict[str, Any] | None:
    """Return the entries that `essentials` embedded in a stimulus file, or None if it has none."""
    try:
        if path.suffix.lower() == ".png":
            embedded = png_texts(path).get(KEYWORD)
        else:
            from morphspace.io.video import video_texts  # loads libav, which stills do not need

            embedded = video_texts(path).get(COMMENT)
        found = parsed_json(embedded) if embedded else None
    except (UnreadableFile, ValueError):
        return None
    return found if isinstance(found, dict) and "request_sha256" in found else None


def sidecar_text(document: Mapping[str, Any]) -> str:
    """Write a sidecar as JSON text: sorted keys, one line per row of numbers. Equal documents give equal texts.

    Examples
    --------
    >>> print(sidecar_text({"rows": [[1, 2], [3, 4]], "name": "a"}), end="")
    {
      "name": "a",
      "rows": [
        [1, 2],
        [3, 4]
      ]
    }
    """
    return _text(document, "") + "\n"


def _text(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, Mapping) and value:
        parts = [
            f"{inner}{json.dumps(key, ensure_ascii=False)}: {_text(value[key], inner)}"
            for key in sorted(value)
        ]
        return "{\n" + ",\n".join(parts) + f"\n{indent}}}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + ",\n".join(inner + _text(row, inner) for row in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False, sort_keys=True)


def read_stimulus_sidecar(path: Path) -> Stimulus:
    """Read the JSON file beside a stimulus. Raises `UnreadableFile` if it cannot be read or an entry is wrong."""
    return STIMULUS.read(Path(path))
