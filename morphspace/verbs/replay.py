"""replay: draw a stimulus again from its sidecar and compare the bytes, or say what differs."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.errors import BadInput, UnreadableFile
from morphspace.io.images import read_image, read_mask
from morphspace.io.stimulus_sidecars import read_stimulus_sidecar
from morphspace.model.model import load_model
from morphspace.outcome import Outcome
from morphspace.sets.draw import draw_file, made_from_of, originals_of
from morphspace.sets.sidecar_checks import edited_entries, other_versions
from morphspace.steps import WORKERS, Step, Steps, single_threads
from morphspace.stimuli.drawing import PICTURE_SUFFIXES, VIDEO_SUFFIXES, Drawing, drawing_of
from morphspace.storage import digest_of_file, digest_of_json, whole_file

FOLDERS_UP = 2  # from the sidecar, where a model may lie: a set inside a batch inside a project


@dataclass(frozen=True)
class ReplayRequest:
    """Make the stimulus of `sidecar` again with `model`, found near it where None.

    `clip` opens the frames faces were put back into, where they moved; `output` keeps the new stimulus.
    """

    sidecar: Path
    model: Path | None = None
    clip: tuple[str, ...] = ()
    output: Path | None = None


def run(request: ReplayRequest) -> Steps[Outcome]:
    """Draw, compare, say. `document["same"]` tells whether the bytes and all entries are those of the sidecar.

    Returns an `Outcome`.
    """
    _check_is_sidecar(request.sidecar)
    document = read_stimulus_sidecar(request.sidecar)
    path, model_sha256 = _model(request, document)
    model = load_model(path)
    drawing = drawing_of(document["drawing"], _region(request.sidecar, document))
    if request.clip and drawing.placing is not None:
        drawing = replace(drawing, placing=replace(drawing.placing, sources=request.clip))
    if request.output is not None and request.output.suffix.lower() != drawing.suffix:
        raise BadInput(f"the output {request.output} should end in {drawing.suffix}, as the stimulus does")
    if request.output is not None and request.output.exists():
        raise BadInput(f"{request.output} is there already: give another name, so that nothing is lost")
    _check_originals(drawing)
    yield Step("draw", 0, 1)
    try:
        head = {**document, "request_sha256": digest_of_json(document["request"])}
        made_from_of(document)
    except ValueError as error:
        raise BadInput(f"{request.sidecar} cannot be told as JSON again: {error}; copy it again") from error
    file = request.sidecar.parent / str(document["output"].get("file", ""))
    with tempfile.TemporaryDirectory(prefix="morphspace-") as folder:
        again = Path(folder) / f"again{drawing.suffix}"
        with single_threads():
            drawn = draw_file(model, drawing, head, again, WORKERS)
        sha256 = digest_of_file(again)
        same_bytes = sha256 == document["output"].get("sha256")
        found = _found(file, document)
        edited = edited_entries(
            document, request.sidecar, drawing, drawn, model, again if same_bytes else None
        )
        differences = (
            []
            if same_bytes
            else _differences(document, model_sha256, drawn.size, again, file, drawing, bool(edited))
        ) + edited
        if request.output is not None:
            with whole_file(request.output) as temporary:
                temporary.write_bytes(again.read_bytes())
    yield Step("draw", 1, 1)
    same, name = same_bytes and not edited, f"{drawing.name}{drawing.suffix}"
    if same:
        lines = [f"{name}: the same, byte for byte"]
    elif same_bytes:
        lines = [f"{name}: the same, byte for byte, but its sidecar says something else"]
    else:
        lines = [f"{name}: not the same"]
    lines += [f"  {words}" for words in differences]
    others = _others(document, model_sha256) if same_bytes else []
    lines += [f"  {words}" for words in others]
    told = {
        "same": same,
        "file": found,
        "sha256": sha256,
        "recorded_sha256": document["output"].get("sha256"),
        "differences": differences,
        "others": others,
    }
    notes = {
        "missing": (f"{file} is not there: what was drawn is compared with its sidecar alone",),
        "changed": (f"{file} is not the file its sidecar describes: it was changed after it was written",),
    }
    written = () if request.output is None else (request.output,)
    return Outcome(tuple(lines), told, notes.get(found, ()), written)


def _check_is_sidecar(path: Path) -> None:
    """Raise `BadInput` for a folder or a stimulus itself, saying where its sidecar is."""
    if path.is_dir():
        raise BadInput(f"{path} is a folder: give the .json beside a stimulus in it")
    if path.suffix.lower() in (*PICTURE_SUFFIXES, *VIDEO_SUFFIXES) and path.is_file():
        places = (path.with_suffix(".json"), path.with_name(f"{path.name}.json"))
        beside = next((place for place in places if place.is_file()), None)
        where = (
            f"{beside}" if beside is not None else "which is not there; copy it from where the set was made"
        )
        raise BadInput(f"{path} is a stimulus itself: give the .json beside it, {where}")


def _check_originals(drawing: Drawing) -> None:
    """Raise `BadInput` where the frames the faces were put back into are not there, saying how to name them."""
    try:
        originals_of(drawing)
    except BadInput as error:
        raise BadInput(f"{error}; say where the original frames are with --clip") from error


def _found(file: Path, document: Mapping[str, Any]) -> str:
    """Say whether the stimulus itself is `there`, `changed` or `missing`."""
    if not file.is_file():
        return "missing"
    return "there" if digest_of_file(file) == document["output"].get("sha256") else "changed"


def _model(request: ReplayRequest, document: Mapping[str, Any]) -> tuple[Path, str]:
    """Give the model to draw with and its digest: the one named, else one of the recorded digest, else of its name."""
    if request.model is not None:
        return request.model, digest_of_file(request.model)
    name, wanted = str(document["model"].get("file")), document["model"].get("sha256")
    recorded = document["request"].get("model")
    places = [Path(recorded)] if isinstance(recorded, str) else []
    folders = _near(request.sidecar)
    places += [folder / name for folder in folders]
    places += [path for folder in folders for path in sorted(folder.glob("*.morph"))]
    other: tuple[Path, str] | None = None
    for place in dict.fromkeys(places):
        if place.is_file():
            sha256 = digest_of_file(place)
            if sha256 == wanted:
                return place, sha256
            if other is None and place.name == name:
                other = place, sha256
    if other is None:
        raise BadInput(
            f"the model {name} of {request.sidecar} is not in the working folder nor near the sidecar: say where it is "
            "with --model"
        )
    return other


def _near(sidecar: Path) -> list[Path]:
    """Give the folders where what a sidecar names may lie: the working folder, and those the sidecar is in."""
    folder = sidecar.resolve().parent
    return list(dict.fromkeys([Path(), folder, *list(folder.parents)[:FOLDERS_UP]]))


def _region(sidecar: Path, document: Mapping[str, Any]) -> Mask | None:
    """Give the mask that was painted, where the region of the stimulus is one."""
    wanted, name = document["inputs"].get("region"), document["drawing"].get("region")
    if wanted is None or name is None:
        return None
    recorded = document["request"].get("region")
    places = [Path(recorded)] if isinstance(recorded, str) else []
    for place in [*places, *(folder / Path(str(name)).name for folder in _near(sidecar))]:
        if place.is_file() and digest_of_file(place) == wanted:
            return read_mask(place)
    raise BadInput(
        f"the region {name} of {sidecar} is not in the working folder nor near the sidecar, or is another picture than "
        "it was: put it beside the sidecar"
    )


def _others(document: Mapping[str, Any], model_sha256: str) -> list[str]:
    """Say what the stimulus was drawn with before, where that was something else: the model's file, versions."""
    recorded = document["model"].get("sha256")
    told = []
    if model_sha256 != recorded:
        told.append(f"the model is another file: {model_sha256[:16]}, recorded is {str(recorded)[:16]}")
    return told + other_versions(document)


def _differences(
    document: Mapping[str, Any],
    model_sha256: str,
    size: tuple[int, int],
    again: Path,
    file: Path,
    drawing: Drawing,
    explained: bool,
) -> list[str]:
    """Say what differs: the model, versions, the size, and by how much the pixels; whether more is `explained`."""
    told = _others(document, model_sha256)
    if list(size) != document["output"].get("size"):
        told.append(f"the size is {size[0]}x{size[1]} px, recorded is {document['output'].get('size')}")
    told.append(_pixels(again, file, drawing))
    if len(told) == 1 and not explained:
        told.append(
            "model and versions are the recorded ones: the sidecar or the file was edited, or the processor differs"
        )
    return told


def _pixels(again: Path, file: Path, drawing: Drawing) -> str:
    """Say how far the pixels of two stimuli lie apart, in 8-bit codes."""
    if not file.is_file():
        return "the stimulus itself is not there, so its pixels cannot be compared"
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
        return "every pixel is the same: what differs is what the file says of itself"
    return f"the largest pixel difference is {largest:.0f} of 255, {100 * changed / total:.2g} % of the values differ"


def _frames(path: Path, drawing: Drawing) -> Iterator[Image]:
    if drawing.frame_rate_hz is None:
        yield read_image(path)
        return
    from morphspace.io.video import read_frames  # loads libav, which stills do not need

    yield from read_frames(path)
