"""flow: where each point of one picture is found in another, as a file, in figures and as a picture.

Or, with scenes whose true flow is known, how far estimators are off: the table every paper on flow prints.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morphspace.errors import BadInput
from morphspace.flow import methods
from morphspace.flow.names import DEFAULT_BACKEND
from morphspace.flow.starts import WITHOUT_START
from morphspace.io.flow_fields import check_field_name, write_flows
from morphspace.io.images import write_image
from morphspace.outcome import RECORD_NAME, Outcome, write_record
from morphspace.report.flow_figures import found_flows, read_pair, shown
from morphspace.report.flow_picture import flow_picture
from morphspace.report.flow_scenes import measured_scenes
from morphspace.sets.protect import check_file
from morphspace.steps import Steps
from morphspace.storage import digest_of_file, make_folder

AUTO_START = Path("auto")  # the word for what happens without a field: the best start there is


@dataclass(frozen=True)
class FlowRequest:
    """Find the flow from the picture `reference` (A) to `frame` (B) by `preset`, into `output` (.flo or .exr).

    `both` writes the flow from B to A as well, beside it; `picture` is a .png to draw, `start` a field on A's grid to
    start from. `landmarks` are two files with the same points marked in A and in B: the flow is found from their spline
    as well, and the better of the two is kept. `backend` is what our presets run on (`backends.named_backend`).
    """

    reference: Path
    frame: Path
    output: Path
    preset: str = methods.DEFAULT
    both: bool = False
    picture: Path | None = None
    start: Path | None = None
    landmarks: tuple[Path, Path] | None = None
    backend: str = DEFAULT_BACKEND

    @property
    def back_output(self) -> Path:
        """The file of the flow from B to A."""
        return self.output.with_name(f"{self.output.stem}.back{self.output.suffix}")


def run_words(
    pictures: tuple[Path, ...],
    output: Path | None,
    presets: tuple[str, ...],
    both: bool,
    picture: Path | None,
    start: Path | None,
    landmarks: tuple[Path, Path] | None,
    backend: str,
    bench: Path | None,
) -> Steps[Outcome]:
    """Turn the words of the command line into the request they make, and run it. Raises `BadInput` for a mixture."""
    start = None if start == AUTO_START else start
    if bench is not None:
        if pictures or both or picture or start or landmarks:
            raise BadInput(
                "--bench measures scenes: give it no A B, --both, --picture, --start or --landmarks"
            )
        return measured_scenes(bench, presets, output, backend)
    if len(pictures) != 2:
        raise BadInput(f"a flow goes from one picture, A, to another, B: {len(pictures)} given, 2 expected")
    if output is None:
        raise BadInput("the flow has nowhere to go: give -o with a name in .flo or .exr")
    if len(presets) != 1:
        raise BadInput(f"{len(presets)} presets were given: one flow has one, several are for --bench")
    return run(FlowRequest(*pictures, output, presets[0], both, picture, start, landmarks, backend))


def run(request: FlowRequest) -> Steps[Outcome]:
    """Find the flow, write it with a record beside it, and draw it. Returns an `Outcome` with its figures."""
    method = methods.named(request.preset, request.backend)
    given = "landmarks" if request.landmarks is not None else "a field" if request.start is not None else None
    if given is not None and request.preset in WITHOUT_START:
        able = [name for name in methods.NAMES if name not in WITHOUT_START]
        raise BadInput(f"{request.preset} cannot start from {given}: choose one of {', '.join(able)}")
    inputs = _inputs(request)
    _check_outputs(request, tuple(inputs.values()))
    pair = read_pair(request.reference, request.frame, request.start, request.landmarks)
    for path in (request.output, request.picture):
        if path is not None:
            make_folder(path.parent)
    found = yield from found_flows(method, pair, both=request.both)
    flows = {request.output: found.flow, **({} if found.back is None else {request.back_output: found.back})}
    write_flows({path: (one.displacement, one.confidence) for path, one in flows.items()})
    written, figures = list(flows), found.figures
    if request.picture is not None:
        names = (request.reference.name, request.frame.name)
        sheet = flow_picture(pair.reference, pair.frame, found.flow, names=names, figures=shown(figures))
        write_image(request.picture, sheet)
        written.append(request.picture)
    digests = {name: digest_of_file(path) for name, path in inputs.items()}
    folder, name = request.output.parent, f"{request.output.name}.{RECORD_NAME}"
    beside = [path for path in written if path.parent == folder]  # a picture may lie in another folder
    record = write_record(folder, "flow", _settings(request, found.started_from), digests, beside, name)
    lines = (
        f"{request.output}: from {request.reference.name} to {request.frame.name} by {request.preset}",
        *(f"{name:<22}{value}" for name, value in shown(figures)),
    )
    document = {"output": str(request.output), "preset": request.preset, **figures}
    return Outcome(lines, document, pair.notes, (*written, record))


def _inputs(request: FlowRequest) -> dict[str, Path]:
    inputs = {"A": request.reference, "B": request.frame}
    if request.start is not None:
        inputs["start"] = request.start
    if request.landmarks is not None:
        inputs["landmarks of A"], inputs["landmarks of B"] = request.landmarks
    return inputs


def _settings(request: FlowRequest, taken: list[str]) -> dict[str, Any]:
    """Give what was asked for; with landmarks also their files' names and which start was `taken`, there and back."""
    settings = {"preset": request.preset, "backend": request.backend, "both": request.both}
    if request.landmarks is None:
        return settings
    return {**settings, "landmarks": [path.name for path in request.landmarks], "started_from": taken}


def _check_outputs(request: FlowRequest, kept: tuple[Path, ...]) -> None:
    check_field_name(request.output)
    suffix = request.output.suffix.lower()
    check_file(request.output, suffix, kept)
    if request.both:
        check_file(request.back_output, suffix, kept)
    if request.picture is not None:
        check_file(request.picture, ".png", kept)
