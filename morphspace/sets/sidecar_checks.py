"""Whether a sidecar says what drawing its stimulus again says: every entry, with both values where they differ."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from morphspace.io.stimulus_sidecars import essentials, essentials_in, sidecar_text
from morphspace.model.model import MorphModel
from morphspace.outcome import versions
from morphspace.sets.draw import DECIDING, Drawn, made_from_of, quality_of
from morphspace.sets.manifest import MANIFEST_NAME
from morphspace.stimuli.drawing import Drawing
from morphspace.storage import digest_of_json

LONGEST_TOLD = 60  # characters of a value
CLOSE = 1e-9  # relative: what other versions of packages may change in a figure
ELSEWHERE = (
    ("model", "file"),
    ("model", "sha256"),
    ("output", "file"),
    ("output", "sha256"),
)  # checked by replay
KNOWN = (*DECIDING, "drawing", "made_from_sha256", "statistics", "quality", "output")


def edited_entries(
    document: Mapping[str, Any],
    sidecar: Path,
    drawing: Drawing,
    drawn: Drawn,
    model: MorphModel,
    again: Path | None,
) -> list[str]:
    """Say which entries of a sidecar are not what they would be if it were written now, each with both values.

    `again` is what was drawn, None where its bytes are not those recorded: then figures of the pixels differ too and
    are not compared.
    """
    told = [f"{entry} is none of a sidecar's entries" for entry in document if entry not in KNOWN]
    made_from = made_from_of(document)
    if made_from != document["made_from_sha256"]:
        told.append(
            f"made_from_sha256 is {str(document['made_from_sha256'])[:16]}, what the sidecar tells comes to "
            f"{made_from[:16]}: it was edited"
        )
    told += _compared({"model_id": model.model_id, "identity": model.identity}, document["model"], "model")
    told += _beside(document, sidecar, drawing)
    if again is not None:
        figures = {
            "statistics": drawn.statistics,
            "quality": quality_of(model, drawing, drawn),
            "output": {
                "bytes": again.stat().st_size,
                "frames": drawn.frames,
                "frame_rate_hz": drawing.frame_rate_hz,
                "size": list(drawn.size),
            },
        }
        close = versions() != document["versions"]
        for name, found in json.loads(sidecar_text(figures)).items():
            told += _compared(found, document[name], name, close)
    return told


def other_versions(document: Mapping[str, Any]) -> list[str]:
    """Say which packages had another version when the sidecar was written, or are in one list alone."""
    now, then = versions(), document["versions"]
    return [
        f"{name} was {then.get(name, 'not told')}, here it is {now.get(name, 'not installed')}"
        for name in dict.fromkeys((*then, *now))
        if then.get(name) != now.get(name)
    ]


def _compared(found: Any, recorded: Any, name: str, close: bool = False) -> Iterator[str]:
    """Say where `recorded` is not what was `found`; numbers need only be near each other where `close`."""
    if isinstance(found, Mapping) and isinstance(recorded, Mapping):
        for key in dict.fromkeys((*found, *recorded)):
            if key in found or (name, key) not in ELSEWHERE:
                yield from _compared(found.get(key), recorded.get(key), f"{name}.{key}", close)
        return
    numbers = all(isinstance(one, int | float) and not isinstance(one, bool) for one in (found, recorded))
    if found == recorded or (close and numbers and math.isclose(found, recorded, rel_tol=CLOSE)):
        return
    yield f"{name} is {_short(recorded)} in the sidecar, drawn again it is {_short(found)}"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST_TOLD else f"{text[:LONGEST_TOLD]}..."


def _beside(document: Mapping[str, Any], sidecar: Path, drawing: Drawing) -> Iterator[str]:
    """Say where what stands inside the stimulus, or in its row of the manifest, is not what the sidecar tells."""
    picture = sidecar.parent / str(document["output"].get("file", ""))
    inside = essentials_in(picture) if picture.is_file() else None
    if inside is not None:
        head = {**document, "request_sha256": digest_of_json(document["request"])}
        try:
            outside = essentials(head, drawing.told)
        except KeyError as error:
            yield f"{error.args[0]} is not in the sidecar"
            return
        for key in dict.fromkeys((*outside, *inside)):
            if key != "software" and outside.get(key) != inside.get(key):
                yield f"{key} is {_short(outside.get(key))} in the sidecar, {_short(inside.get(key))} in the stimulus"
    row = _row(sidecar, drawing.name)
    for key, value in drawing.told.items():
        if key in row and not _same(value, row[key]):
            yield f"told.{key} is {_short(value)} in the sidecar, {row[key]!r} in the manifest"


def _row(sidecar: Path, name: str) -> dict[str, str]:
    """Give a stimulus' row of the manifest of its set, an empty one where there is none."""
    folder = sidecar.parent
    for _ in range(name.count("/")):
        folder = folder.parent
    path = folder / MANIFEST_NAME
    if folder / f"{name}.json" != sidecar or not path.is_file():
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return next((row for row in csv.DictReader(file) if row.get("name") == name), {})
    except (OSError, ValueError, csv.Error):
        return {}


def _same(value: Any, cell: str | None) -> bool:
    if value is None or cell is None:
        return (value or "") == (cell or "")
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return math.isclose(float(cell), value, rel_tol=CLOSE)
        except ValueError:
            return False
    return str(value).casefold() == cell.casefold()
