"""The JSON beside every stimulus: what it shows, from what it was made, what its pixels measure (`stimulus.md`).

A sidecar holds the drawing, so that the stimulus can be made again from it and the model alone. The essentials travel
inside the picture or video too.
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
KEYWORD = "morphspace"  # of the text inside a PNG
COMMENT = "comment"  # the metadata entry of a video that holds the same
ORIGINAL_IDENTITY = (
    "original_identity"  # told of a stimulus, and inside it: who is in the pictures it was put into
)
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


def essentials(head: Mapping[str, Any], told: Mapping[str, Any]) -> dict[str, Any]:
    """Give what is written inside the file: model, verb, digest of the request, consent, licence and version.

    `told` is what the drawing tells, of which a second person shown goes in too.
    """
    also = {key: told[key] for key in (ORIGINAL_IDENTITY,) if key in told}
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


def file_texts(head: Mapping[str, Any], told: Mapping[str, Any], suffix: str) -> dict[str, str]:
    """Give the texts that go into a PNG (keywords) or a video (metadata entries) of this head and drawing."""
    words = json.dumps(essentials(head, told), sort_keys=True, ensure_ascii=False)
    licence = head["licence"]
    rights = (
        {} if not isinstance(licence, str) else {"Copyright" if suffix == ".png" else "copyright": licence}
    )
    if suffix == ".png":
        return {"Software": f"morphspace {__version__}", **rights, KEYWORD: words}
    return {COMMENT: words, **rights}


def essentials_in(path: Path) -> dict[str, Any] | None:
    """Give the essentials inside a stimulus file, or None where it holds none of ours."""
    try:
        if path.suffix.lower() == ".png":
            told = png_texts(path).get(KEYWORD)
        else:
            from morphspace.io.video import video_texts  # loads libav, which stills do not need

            told = video_texts(path).get(COMMENT)
        found = json.loads(told) if told else None
    except (UnreadableFile, ValueError):
        return None
    return found if isinstance(found, dict) and "request_sha256" in found else None


def sidecar_text(document: Mapping[str, Any]) -> str:
    """Give a sidecar as JSON text: keys in order, one line for each row of numbers, the same bytes for the same."""
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
    """Read the JSON beside a stimulus. Raises `UnreadableFile` (missing, not JSON) and `BadInput` (not one of ours)."""
    document = read_json_object(Path(path))
    check_format(Path(path), document, STIMULUS_FORMAT, STIMULUS_VERSION)
    for entry, kind in REQUIRED.items():
        if not isinstance(document.get(entry), kind):
            raise BadInput(f"{path}: {entry} is {document.get(entry)!r:.40}, it is cut short: copy it again")
    return document
