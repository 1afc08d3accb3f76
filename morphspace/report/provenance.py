"""Settings and provenance as tables: what a methods section needs, and what a file can be traced by."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from morphspace.model.model import MorphModel
from morphspace.model.passes import Build
from morphspace.report.markup import TIMES, Html, element, section, table, text

DIGEST = re.compile(r"[0-9a-f]{17,}")
DIGEST_SHOWN = 12  # characters; the whole stands in the title, shown on hovering
LIST_SHOWN = 6  # entries; a longer list is folded away
FIRST_KEYS = ("identity", "consent", "licence")  # what a reader must see first
TOLD_ABOVE = (
    "reference",
    "flow_start",
    "components_asked",
    "warp_weight_trials",
    "mask_from",
    "landmarks",
)  # shown elsewhere on the page
NOT_RECORDED = "not recorded"


def settings_section(build: Build) -> Html:
    """Give the settings and the provenance of a build."""
    model = build.model
    reference = model.provenance.get("reference", {})
    faceframe = model.faceframe
    points = "not marked"
    if faceframe is not None:
        names = ("right eye", "left eye", "philtrum")
        points = "; ".join(
            f"{name} {x:.1f}, {y:.1f}" for name, (x, y) in zip(names, faceframe.points, strict=True)
        )
    settings = [
        ("Model", model.model_id),
        ("Size, px", f"{model.size[0]} {TIMES} {model.size[1]}"),
        ("Frames", len(model.training.frame_names)),
        ("Reference", build.choice.name),
        ("Reference picture, SHA-256", reference.get("sha256", NOT_RECORDED)),
        ("Crop", crop_origin(model)),
        ("Face points", face_points(build)),
        ("Registration", model.registration),
        ("Flow", model.flow),
        ("Second start for hard frames", model.provenance.get("flow_start", NOT_RECORDED)),
        (
            "Components asked for, found",
            f"{model.provenance.get('components_asked', NOT_RECORDED)}, {model.rank}",
        ),
        ("Warp weight, colour per px", f"{model.warp_weight:.6g}"),
        ("Variance left out, per dimension", f"{model.basis.discarded_variance:.4g}"),
        ("Mask", f"{mask_origin(model)}, {100 * model.mask.mean():.1f} % of the frame"),
        ("Faceframe on the mean face (x, y), px", f"{points}{faceframe_origin(model)}"),
    ]
    rows = [(text(name), value_of(value)) for name, value in settings]
    told = {key: model.provenance.get(key) or NOT_RECORDED for key in FIRST_KEYS}
    told |= {key: value for key, value in model.provenance.items() if key not in (*FIRST_KEYS, *TOLD_ABOVE)}
    origin = [(name_of(keys), value_of(value)) for keys, value in flattened(told)]
    columns = ("Entry", "Value")
    return section(
        "settings",
        "Settings and provenance",
        table("Settings of the build.", columns, rows, class_="pairs"),
        table("Where the frames came from, as it was recorded with them.", columns, origin, class_="pairs"),
    )


MASK_ORIGINS = {
    "given": "drawn and given",
    "found face": "an ellipse placed by the face found in the reference",
    "ellipse": "an ellipse where a cropped face stands",
    "faceframe": "an ellipse placed by the marked faceframe",
}


def mask_origin(model: MorphModel) -> str:
    """Say where the mask came from."""
    return MASK_ORIGINS.get(str(model.provenance.get("mask_from")), NOT_RECORDED)


def crop_origin(model: MorphModel) -> str:
    """Say which part of the pictures was used, and how it was found."""
    framing = model.provenance.get("framing", {})
    crop = framing.get("crop")
    if crop is None:
        return "none, whole pictures"
    box = "x {}, y {}, {} {} {} px".format(*crop[:3], TIMES, crop[3])
    found = framing.get("crop_found")
    if found is None:
        return f"{box}, as given"
    return f"{box}, around the head as found in {found['found']} of {found['frames']} frames"


def face_points(build: Build) -> str:
    """Say in how many frames the face was found."""
    if build.faces_found is None:
        return "not looked for"
    found, count = int(build.faces_found.sum()), len(build.faces_found)
    without = "" if found == count else "; the others went without"
    return f"found in {found} of {count} frames{without}"


def faceframe_origin(model: MorphModel) -> str:
    """Say where the faceframe came from, to stand behind it."""
    if model.faceframe is None:
        return ""
    origin = model.provenance.get("keypoints")
    if isinstance(origin, Mapping) and origin.get("source") == "auto":
        return f"; detected in {origin['found']} of {origin['faces']} faces of the model"
    return "; as marked"


def flattened(
    document: Mapping[str, Any], above: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Give the entries of a nested document one by one, each with the keys that lead to it."""
    for key, value in document.items():
        keys = (*above, str(key))
        if isinstance(value, Mapping) and value:
            yield from flattened(value, keys)
        else:
            yield keys, value


def name_of(keys: tuple[str, ...]) -> Html:
    """Give the way to an entry as its name."""
    return text(" / ".join(key.replace("_", " ") for key in keys))


def value_of(value: Any) -> Html:
    """Give a value of a document for a table: digests shortened, long lists folded away."""
    if value is None or value == "":
        return text("none")
    if isinstance(value, bool):
        return text("yes" if value else "no")
    if isinstance(value, float):
        return text(f"{value:.6g}")
    if isinstance(value, str) and DIGEST.fullmatch(value):
        return element("code", text(f"{value[:DIGEST_SHOWN]}…"), title=value)
    if isinstance(value, Mapping):
        parts = [Html(name_of((str(key),)) + ": " + value_of(entry)) for key, entry in value.items()]
        return Html(", ".join(parts) or text("none"))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return _listed(value)
    return text(value)


def _listed(values: Sequence[Any]) -> Html:
    parts = [value_of(entry) for entry in values]
    if len(parts) <= LIST_SHOWN:
        return Html(
            ("; " if any(isinstance(v, Mapping) for v in values) else ", ").join(parts) or text("none")
        )
    items = [element("li", part) for part in parts]
    return element("details", element("summary", text(f"{len(parts)} entries")), element("ul", *items))
