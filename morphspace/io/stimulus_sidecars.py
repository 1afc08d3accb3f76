"""The JSON file beside each stimulus: its content, its origin and its image statistics (`data_spec/stimulus.md`).

It contains the drawing: the stimulus can be drawn again from this file and the model alone. The most important
entries are also embedded in the image or video itself.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morphspace import __version__
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.png import png_texts
from morphspace.io.sidecars import check_format, read_json_object

STIMULUS_FORMAT = "morphspace-stimulus"
STIMULUS_VERSION = 1
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
REQUIRED: Mapping[str, type | tuple[type, ...]] = {
    "verb": str,
    "request": dict,
    "model": dict,
    "inputs": dict,
    "drawing": dict,
    "statistics": dict,
    "quality": dict,
    "output": dict,
    "versions": dict,
    "made_from_sha256": str,
}


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
        found = json.loads(embedded) if embedded else None
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


def read_stimulus_sidecar(path: Path) -> dict[str, Any]:
    """Read the JSON file beside a stimulus. Raises `UnreadableFile`, and `BadInput` for a wrong entry."""
    document = read_json_object(Path(path))
    check_format(Path(path), document, STIMULUS_FORMAT, STIMULUS_VERSION)
    for entry, kind in REQUIRED.items():
        if not isinstance(document.get(entry), kind):
            raise BadInput(
                f"{path}: {entry} is {document.get(entry)!r:.40}; expected another type. Copy the file again"
            )
    return document
