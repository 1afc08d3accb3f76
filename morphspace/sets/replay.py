"""Draw a stimulus again from its sidecar, and compare sidecar, stimulus and manifest with the result (ours).

Every sidecar entry is compared with the value it would have if written now; both values are reported if they differ.
"""

from __future__ import annotations

import json
import math
import tempfile
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.images import read_image, read_mask
from morphspace.io.stimulus_sidecars import (
    Stimulus,
    essentials,
    essentials_in,
    read_stimulus_sidecar,
    sidecar_text,
)
from morphspace.io.texts import read_table
from morphspace.model.model import MorphModel, load_model
from morphspace.outcome import versions
from morphspace.requests import VIDEO_SUFFIXES
from morphspace.sets.manifest import MANIFEST_NAME
from morphspace.sets.stimulus import Drawn, draw_file, made_from_of, originals_of, quality_of
from morphspace.steps import Step, Steps, single_threads, worker_count
from morphspace.stimuli.drawing import PICTURE_SUFFIXES, Drawing, drawing_of
from morphspace.storage import digest_of_file, digest_of_json, whole_file

FOLDERS_UP = 2  # parent folders searched for a model: a set in a batch in a project
LONGEST_VALUE = 60  # characters of a value in a message
CLOSE = 1e-9  # relative; other versions of packages may change figures by this much
# Checked by replay
ELSEWHERE = (("model", "file"), ("model", "sha256"), ("output", "file"), ("output", "sha256"))


@dataclass(frozen=True, eq=False)
class Replayed:
    """Result of drawing a stimulus again.

    Attributes
    ----------
    name
        File name of the stimulus.
    file
        Path of the stimulus, which is `found` "there", "changed" or "missing".
    sha256, recorded_sha256
        Digests of the new stimulus and of the recorded one.
    edited
        Edited sidecar entries.
    differences
        All differences, including the edited entries.
    others
        Differences in the model file or in versions that left the bytes the same.
    """

    name: str
    file: Path
    found: str
    sha256: str
    recorded_sha256: str | None
    edited: tuple[str, ...]
    differences: tuple[str, ...]
    others: tuple[str, ...]

    @property
    def same_bytes(self) -> bool:
        """Return whether the bytes are the recorded ones."""
        return self.sha256 == self.recorded_sha256

    @property
    def same(self) -> bool:
        """Return whether the bytes and all entries are those of the sidecar."""
        return self.same_bytes and not self.edited


def replayed(
    sidecar: Path, model_path: Path | None = None, clip: tuple[str, ...] = (), output: Path | None = None
) -> Steps[Replayed]:
    """Draw the stimulus of a sidecar again and compare.

    Parameters
    ----------
    model_path
        The model; None to search for it near the sidecar.
    clip
        The frames behind the faces if they were moved.
    output
        Path for the new stimulus; None to discard it.

    Raises
    ------
    BadInput
        If the sidecar cannot be read, or the model or the frames are not found.
    """
    _check_is_sidecar(sidecar)
    document = read_stimulus_sidecar(sidecar)
    path, model_sha256 = _model(sidecar, model_path, document)
    model = load_model(path)
    drawing = drawing_of(document["drawing"], _region(sidecar, document))
    if clip and drawing.placing is not None:
        drawing = replace(drawing, placing=replace(drawing.placing, sources=clip))
    if output is not None and output.suffix.lower() != drawing.suffix:
        raise BadInput(f"the output is {output}; expected a name in {drawing.suffix}, as of the stimulus")
    if output is not None and output.exists():
        raise BadInput(f"{output} exists already. Give another name")
    _check_originals(drawing)
    yield Step("draw", 0, 1)
    head = {**document, "request_sha256": digest_of_json(document["request"])}
    file = sidecar.parent / document["output"]["file"]
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        again = Path(folder) / f"again{drawing.suffix}"
        with single_threads():
            drawn = draw_file(model, drawing, head, again, worker_count())
        sha256 = digest_of_file(again)
        same_bytes = sha256 == document["output"]["sha256"]
        edited = edited_entries(document, sidecar, drawing, drawn, model, again if same_bytes else None)
        differences = (
            []
            if same_bytes
            else _differences(document, model_sha256, drawn.size, again, file, drawing, bool(edited))
        ) + edited
        if output is not None:
            with whole_file(output) as temporary:
                temporary.write_bytes(again.read_bytes())
    yield Step("draw", 1, 1)
    return Replayed(
        name=f"{drawing.name}{drawing.suffix}",
        file=file,
        found=_found(file, document),
        sha256=sha256,
        recorded_sha256=document["output"]["sha256"],
        edited=tuple(edited),
        differences=tuple(differences),
        others=tuple(_others(document, model_sha256)) if same_bytes else (),
    )


def _check_is_sidecar(path: Path) -> None:
    """Check that the path is a sidecar. For a folder or a stimulus, raise `BadInput` with the sidecar's path."""
    if path.is_dir():
        raise BadInput(f"{path} is a folder. Give the .json beside a stimulus in it")
    if path.suffix.lower() in (*PICTURE_SUFFIXES, *VIDEO_SUFFIXES) and path.is_file():
        places = (path.with_suffix(".json"), path.with_name(f"{path.name}.json"))
        beside = next((place for place in places if place.is_file()), None)
        where = f"{beside}" if beside is not None else "which is missing; copy it from the original set"
        raise BadInput(f"{path} is a stimulus. Give the .json beside it, {where}")


def _check_originals(drawing: Drawing) -> None:
    """Check that the original frames behind the faces exist. Raises `BadInput` with the remedy."""
    try:
        originals_of(drawing)
    except BadInput as error:
        raise BadInput(f"{error}. Give the original frames with --clip") from error


def _is_file(path: Path) -> bool:
    """Return whether a path of a sidecar is a file; one that is too long for the system is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def _found(file: Path, document: Stimulus) -> str:
    """Return whether the stimulus itself is `there`, `changed` or `missing`."""
    if not _is_file(file):
        return "missing"
    return "there" if digest_of_file(file) == document["output"]["sha256"] else "changed"


def _model(sidecar: Path, named: Path | None, document: Stimulus) -> tuple[Path, str]:
    """Return the model and its digest: the given one, else one with the recorded digest, else one with its name."""
    if named is not None:
        return named, digest_of_file(named)
    name, wanted = document["model"]["file"], document["model"]["sha256"]
    recorded = document["request"].get("model")
    places = [Path(recorded)] if isinstance(recorded, str) else []
    folders = _near(sidecar)
    places += [folder / name for folder in folders]
    places += [path for folder in folders for path in sorted(folder.glob("*.morph"))]
    other: tuple[Path, str] | None = None
    for place in dict.fromkeys(places):
        if _is_file(place):
            sha256 = digest_of_file(place)
            if sha256 == wanted:
                return place, sha256
            if other is None and place.name == name:
                other = place, sha256
    if other is None:
        raise BadInput(
            f"the model {name} of {sidecar} is neither in the working folder nor near the sidecar. Give it "
            "with --model"
        )
    return other


def _near(sidecar: Path) -> list[Path]:
    """Return the folders to search for files of a sidecar: the working folder and the sidecar's parents."""
    folder = sidecar.resolve().parent
    return list(dict.fromkeys([Path(), folder, *list(folder.parents)[:FOLDERS_UP]]))


def _region(sidecar: Path, document: Stimulus) -> Mask | None:
    """Read the painted mask of the stimulus; None if its region is not a painted one."""
    wanted, name = document["inputs"].get("region"), document["drawing"]["region"]
    if wanted is None or name is None:
        return None
    recorded = document["request"].get("region")
    places = [Path(recorded)] if isinstance(recorded, str) else []
    for place in [*places, *(folder / Path(name).name for folder in _near(sidecar))]:
        if _is_file(place) and digest_of_file(place) == wanted:
            return read_mask(place)
    raise BadInput(
        f"the region {name} of {sidecar} is neither in the working folder nor near the sidecar, or has "
        "changed. Put it beside the sidecar"
    )


def _others(document: Stimulus, model_sha256: str) -> list[str]:
    """List changes of the model file and of versions since the stimulus was drawn."""
    recorded = document["model"]["sha256"]
    changes = []
    if model_sha256 != recorded:
        changes.append(f"the model's digest is {model_sha256[:16]}; recorded is {recorded[:16]}")
    return changes + other_versions(document)


def _differences(
    document: Stimulus,
    model_sha256: str,
    size: tuple[int, int],
    again: Path,
    file: Path,
    drawing: Drawing,
    explained: bool,
) -> list[str]:
    """List the differences of model, versions, size and pixels; `explained` if other differences are known."""
    differences = _others(document, model_sha256)
    if list(size) != document["output"]["size"]:
        differences.append(
            f"the size is {size[0]}x{size[1]} px; recorded is {document['output'].get('size')}"
        )
    differences.append(_pixels(again, file, drawing))
    if len(differences) == 1 and not explained:
        differences.append(
            "model and versions are the recorded ones: the sidecar or the file was edited, or the processor differs"
        )
    return differences


def _pixels(again: Path, file: Path, drawing: Drawing) -> str:
    """Describe the difference of the pixels of two stimuli in 8-bit codes."""
    if not _is_file(file):
        return "the stimulus is missing, so its pixels cannot be compared"
    largest, changed, total = 0.0, 0, 0
    try:
        for one, other in zip(_frames(again, drawing), _frames(file, drawing), strict=True):
            if one.shape != other.shape:
                return f"the pictures differ in size: (h, w) {one.shape[:2]} and {other.shape[:2]}"
            apart: AnyArray = np.abs(one - other) * 255
            largest, changed, total = (
                max(largest, float(apart.max())),
                changed + int((apart > 0.5).sum()),
                total + apart.size,
            )
    except ValueError:
        return "the videos differ in their number of frames"
    except UnreadableFile as error:
        return f"the stimulus cannot be read: {error}"
    if not changed:
        return "every pixel is the same: only the file's metadata differ"
    return f"the largest pixel difference is {largest:.0f} of 255, {100 * changed / total:.2g} % of the values differ"


def _frames(path: Path, drawing: Drawing) -> Iterator[Image]:
    if drawing.frame_rate_hz is None:
        yield read_image(path)
        return
    from morphspace.io.video import read_frames  # loads libav, which stills do not need

    yield from read_frames(path)


def edited_entries(
    document: Stimulus,
    sidecar: Path,
    drawing: Drawing,
    drawn: Drawn,
    model: MorphModel,
    again: Path | None,
) -> list[str]:
    """List the sidecar entries that differ from those written now, each with both values.

    `again` is the new stimulus; None if its bytes differ from the recorded ones, and then figures of pixels are not
    compared.
    """
    edited = []
    made_from = made_from_of(document)
    if made_from != document["made_from_sha256"]:
        edited.append(
            f"made_from_sha256 is {document['made_from_sha256'][:16]}, the digest of the entries is "
            f"{made_from[:16]}: the sidecar was edited"
        )
    edited += _compared({"model_id": model.model_id, "identity": model.identity}, document["model"], "model")
    edited += _beside(document, sidecar, drawing)
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
        close, recorded = versions() != document["versions"], typing.cast(Mapping[str, Any], document)
        for name, found in json.loads(sidecar_text(figures)).items():
            edited += _compared(found, recorded[name], name, close)
    return edited


def other_versions(document: Stimulus) -> list[str]:
    """List the packages whose versions differ from those in the sidecar."""
    now, then = versions(), document["versions"]
    return [
        f"{name} was {then.get(name, 'not recorded')}, here it is {now.get(name, 'not installed')}"
        for name in dict.fromkeys((*then, *now))
        if then.get(name) != now.get(name)
    ]


def _compared(found: Any, recorded: Any, name: str, close: bool = False) -> Iterator[str]:
    """Yield the differences between `found` and `recorded`; with `close`, numbers may differ by rounding."""
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
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def _beside(document: Stimulus, sidecar: Path, drawing: Drawing) -> Iterator[str]:
    """Yield the differences of the sidecar from the entries inside the stimulus and from its manifest row."""
    picture = sidecar.parent / document["output"]["file"]
    inside = essentials_in(picture) if _is_file(picture) else None
    if inside is not None:
        head = {**document, "request_sha256": digest_of_json(document["request"])}
        outside = essentials(head, drawing.variables)
        for key in dict.fromkeys((*outside, *inside)):
            if key != "software" and outside.get(key) != inside.get(key):
                yield f"{key} is {_short(outside.get(key))} in the sidecar, {_short(inside.get(key))} in the stimulus"
    row = _row(sidecar, drawing.name)
    for key, value in drawing.variables.items():
        if key in row and not _same(value, row[key]):
            yield f"variables.{key} is {_short(value)} in the sidecar, {row[key]!r} in the manifest"


def _row(sidecar: Path, name: str) -> dict[str, str]:
    """Return a stimulus's row of its set's manifest; an empty one if there is none."""
    folder = sidecar.parent
    for _ in range(name.count("/")):
        folder = folder.parent
    path = folder / MANIFEST_NAME
    if folder / f"{name}.json" != sidecar or not path.is_file():
        return {}
    try:
        table = read_table(path)
    except BadInput:
        return {}
    rows = (dict(zip(table.headings, row, strict=True)) for row in table.rows)
    return next((row for row in rows if row.get("name") == name), {})


def _same(value: Any, cell: str | None) -> bool:
    if value is None or cell is None:
        return (value or "") == (cell or "")
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return math.isclose(float(cell), value, rel_tol=CLOSE)
        except ValueError:
            return False
    return str(value).casefold() == cell.casefold()
