"""render: from a table of loadings to images or a video. Edit the table, and the face does what it says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.files.images import write_image
from morphspace.files.tables import LoadingsTable, read_loadings_table
from morphspace.files.video import write_video
from morphspace.model import MorphModel, load_model
from morphspace.progress import Step, Steps, in_order
from morphspace.storage import digest_of_file
from morphspace.verbs.outcome import RECORD_NAME, Outcome, check_folder, picture_names, write_record

FRAME_RATE_HZ = 25.0  # where neither the request nor the model tells it
VIDEO_SUFFIXES = (".mp4", ".mkv")
FURTHEST_SD = 1000.0  # beyond it a table holds a mistake, and colours leave what numbers can hold
CLIPPED_SHARE = 0.001  # of the colour values; fewer are the overshoot of a sharp edge


@dataclass(frozen=True)
class RenderRequest:
    """Render the rows of `table` with `model` into `output`: a folder of PNGs, or a video by its suffix.

    .mkv is lossless, .mp4 for people. `gain` multiplies all loadings: 1 veridical, above 1 a caricature.
    """

    model: Path
    table: Path
    output: Path
    gain: float = 1.0
    frame_rate_hz: float | None = None


def run(request: RenderRequest) -> Steps[Outcome]:
    """Render and write. Returns an `Outcome`."""
    model = load_model(request.model)
    table = read_loadings_table(request.table)
    notes = check_table(model, table, request.table)
    if not np.isfinite(request.gain):
        raise BadInput(f"a gain of {request.gain} cannot be used: give a number, 1 for the faces as they are")
    loadings_sd = table.loadings_sd * request.gain
    check_reach(loadings_sd, table.frame_names, request.table)
    loadings = loadings_sd * model.sd[: loadings_sd.shape[1]]
    settings = {"gain": request.gain}
    inputs = {"model": digest_of_file(request.model), "table": digest_of_file(request.table)}
    is_video = request.output.suffix.lower() in VIDEO_SUFFIXES
    total = len(table.frame_names)
    if total == 0:
        raise BadInput(f"{request.table} has no rows: nothing to render")
    if request.output.suffix and not is_video and not request.output.is_dir():
        raise BadInput(
            f"{request.output} ends in {request.output.suffix}: give a folder for images, or a video in "
            f"{' or '.join(VIDEO_SUFFIXES)}"
        )
    if is_video:
        rate = request.frame_rate_hz or model.provenance.get("frame_rate_hz") or FRAME_RATE_HZ
        check_folder(request.output.parent)
        if request.output.is_dir():
            raise BadInput(
                f"{request.output} is a folder: give the name of a video, or a folder without suffix"
            )
        clipped, written = yield from _video(model, loadings, request.output, rate)
        name = f"{request.output.name}.{RECORD_NAME}"
        record = write_record(
            request.output.parent, "render", {**settings, "frame_rate_hz": rate}, inputs, written, name
        )
        written = (*written, record)
        lines = (f"{request.output}: {total} frames at {rate:g} Hz",)
    else:
        check_folder(request.output)
        clipped, written = yield from write_frames(model, loadings, table.frame_names, request.output)
        written = (*written, write_record(request.output, "render", settings, inputs, written))
        lines = (f"{request.output}: {total} images",)
    if clipped > CLIPPED_SHARE * total * model.mask.size * 3:
        notes = (
            *notes,
            f"{clipped} colour values left the range of the file and were clipped: lower the gain",
        )
    document = {"output": str(request.output), "frames": total, "clipped_values": clipped}
    return Outcome(lines, document, notes, written)


def check_reach(loadings_sd: LoadingTable, names: tuple[str, ...], path: Path) -> None:
    """Raise `BadInput` where a loading lies further from the mean than any face can, naming its row and column."""
    with np.errstate(invalid="ignore"):
        beyond = np.argwhere(~(np.abs(loadings_sd) <= FURTHEST_SD))
    if len(beyond):
        row, column = beyond[0]
        raise BadInput(
            f"{path}: pc{column + 1:03d} of {names[row]} comes to {loadings_sd[row, column]:.3g} SD, at most "
            f"{FURTHEST_SD:g} can be drawn: mend the table or lower the gain"
        )


def check_table(model: MorphModel, table: LoadingsTable, path: Path) -> tuple[str, ...]:
    """Raise where a table belongs to another model or has too many components; note where that cannot be told."""
    columns = table.loadings_sd.shape[1]
    if columns > model.rank:
        raise BadInput(
            f"{path} has {columns} components, {model.identity} has {model.rank}: encode with this model"
        )
    if table.document is None:
        return (f"{path} has no sidecar: whether it belongs to this model cannot be checked",)
    named = table.document.get("model_id")
    if named != model.model_id:
        raise ReferenceMismatch(
            f"{path} belongs to model {named}, this is model {model.model_id} ({model.identity}): encode the images "
            "with this model, or render with the other"
        )
    return ()


def rendered(model: MorphModel, loadings: LoadingTable) -> Iterator[Image]:
    """Render each row of loadings (n, k), in order, a few at a time."""
    yield from in_order(model.render, loadings)


def write_frames(
    model: MorphModel, loadings: LoadingTable, names: tuple[str, ...], folder: Path
) -> Steps[tuple[int, tuple[Path, ...]]]:
    """Render rows of loadings (n, k) into `folder/NAME.png`; give how many values were clipped, and the paths."""
    clipped, written = 0, []
    for name, image in zip(picture_names(names), rendered(model, loadings), strict=True):
        path = folder / name
        clipped += write_image(path, image)
        written.append(path)
        yield Step("render", len(written), len(names))
    return clipped, tuple(written)


def _video(
    model: MorphModel, loadings: LoadingTable, output: Path, rate: float
) -> Steps[tuple[int, tuple[Path, ...]]]:
    yield Step("render", 0, len(loadings))
    encoding: Literal["lossless", "people"] = "lossless" if output.suffix.lower() == ".mkv" else "people"
    clipped = write_video(output, rendered(model, loadings), frame_rate_hz=rate, encoding=encoding)
    yield Step("render", len(loadings), len(loadings))
    return clipped, (output,)
