"""flow: where each point of one picture is found in another, as a file, in figures and as a picture.

Or, with scenes whose true flow is known, how far estimators are off: the table every paper on flow prints.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from morphspace.errors import BadInput
from morphspace.flow.names import BACKENDS, DEFAULT, DEFAULT_BACKEND, NAMES, STOCK
from morphspace.requests import declared
from morphspace.settings import Argument, Help, OneOf, Option, Spelled

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared
class FlowRequest:
    """Find where each point of picture A is found in picture B, in px on A's grid."""

    pictures: Annotated[tuple[Path, ...], Argument("A B"), Help("The two pictures.")] = ()
    output: Annotated[
        Path | None,
        Option("-o", "--output"),
        Help(
            "The field: .flo (Middlebury), or .exr with its confidence. With --bench: the table (.csv), optional."
        ),
    ] = None
    presets: Annotated[
        tuple[Annotated[str, OneOf(NAMES)], ...],
        Option("--preset"),
        Help(
            f"The estimator; {', '.join(STOCK)} are stock ones, for comparison. With --bench: give several."
        ),
    ] = (DEFAULT,)
    both: Annotated[bool, Help("Find B to A as well (OUTPUT.back.flo), and the error there and back.")] = (
        False
    )
    picture: Annotated[Path | None, Help("Draw it: colours, warped grid, B warped back (.png).")] = None
    start: Annotated[
        Path | None,
        Spelled("auto"),
        Help(
            "A field on A's grid to start from (.flo, .exr); auto: coarse to fine, and the landmarks' spline where "
            "there is one."
        ),
    ] = None
    landmarks: Annotated[
        tuple[Path, Path] | None,
        Option(metavar="A.tem B.tem"),
        Help(
            "The same points marked in A and in B (.tem; .csv or .txt with x,y per line): their spline is tried as a "
            "start, and the better flow kept."
        ),
    ] = None
    backend: Annotated[
        str,
        OneOf(BACKENDS),
        Help("What fast, balanced and accurate run on; torch takes a GPU where there is one."),
    ] = DEFAULT_BACKEND
    bench: Annotated[
        Path | None,
        Help(
            "Instead of A B: a folder of scenes with true flow, in Middlebury's layout; prints errors and times."
        ),
    ] = None

    def check(self) -> None:
        """Raise `BadInput` for settings that do not go together."""
        if self.bench is not None:
            if self.pictures or self.both or self.picture or self.start or self.landmarks:
                raise BadInput(
                    "--bench measures scenes: give it no A B, --both, --picture, --start or --landmarks"
                )
            return
        if len(self.pictures) != 2:
            raise BadInput(
                f"a flow goes from one picture, A, to another, B: {len(self.pictures)} given, 2 expected"
            )
        if self.output is None:
            raise BadInput("the flow has nowhere to go: give -o with a name in .flo or .exr")
        if len(self.presets) != 1:
            raise BadInput(
                f"{len(self.presets)} presets were given: one flow has one, several are for --bench"
            )


def run(request: FlowRequest) -> Steps[Outcome]:
    """Find the flow, write it with a record beside it, and draw it. Returns an `Outcome` with its figures."""
    from morphspace.flow import methods
    from morphspace.flow.starts import WITHOUT_START
    from morphspace.io.flow_fields import write_flows
    from morphspace.io.images import write_image
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.report.flow_figures import found_flows, read_pair, shown
    from morphspace.report.flow_picture import flow_picture
    from morphspace.report.flow_scenes import measured_scenes
    from morphspace.storage import digest_of_file, make_folder

    if request.bench is not None:
        return (yield from measured_scenes(request.bench, request.presets, request.output, request.backend))
    assert request.output is not None  # `check` sees to it
    (reference, frame), (preset,), output = request.pictures, request.presets, request.output
    back = output.with_name(f"{output.stem}.back{output.suffix}")
    method = methods.named(preset, request.backend)
    given = "landmarks" if request.landmarks is not None else "a field" if request.start is not None else None
    if given is not None and preset in WITHOUT_START:
        able = [name for name in methods.NAMES if name not in WITHOUT_START]
        raise BadInput(f"{preset} cannot start from {given}: choose one of {', '.join(able)}")
    inputs = _inputs(request)
    _check_outputs(output, back if request.both else None, request.picture, tuple(inputs.values()))
    pair = read_pair(reference, frame, request.start, request.landmarks)
    for path in (output, request.picture):
        if path is not None:
            make_folder(path.parent)
    found = yield from found_flows(method, pair, both=request.both)
    flows = {output: found.flow, **({} if found.back is None else {back: found.back})}
    write_flows({path: (one.displacement, one.confidence) for path, one in flows.items()})
    written, figures = list(flows), found.figures
    if request.picture is not None:
        names = (reference.name, frame.name)
        sheet = flow_picture(pair.reference, pair.frame, found.flow, names=names, figures=shown(figures))
        write_image(request.picture, sheet)
        written.append(request.picture)
    digests = {name: digest_of_file(path) for name, path in inputs.items()}
    folder, name = output.parent, f"{output.name}.{RECORD_NAME}"
    beside = [path for path in written if path.parent == folder]  # a picture may lie in another folder
    record = write_record(folder, "flow", _settings(request, found.started_from), digests, beside, name)
    lines = (
        f"{output}: from {reference.name} to {frame.name} by {preset}",
        *(f"{name:<22}{value}" for name, value in shown(figures)),
    )
    document = {"output": str(output), "preset": preset, **figures}
    return Outcome(lines, document, pair.notes, (*written, record))


def _inputs(request: FlowRequest) -> dict[str, Path]:
    inputs = dict(zip("AB", request.pictures, strict=True))
    if request.start is not None:
        inputs["start"] = request.start
    if request.landmarks is not None:
        inputs["landmarks of A"], inputs["landmarks of B"] = request.landmarks
    return inputs


def _settings(request: FlowRequest, taken: list[str]) -> dict[str, Any]:
    """Give what was asked for; with landmarks also their files' names and which start was `taken`, there and back."""
    settings = {"preset": request.presets[0], "backend": request.backend, "both": request.both}
    if request.landmarks is None:
        return settings
    return {**settings, "landmarks": [path.name for path in request.landmarks], "started_from": taken}


def _check_outputs(output: Path, back: Path | None, picture: Path | None, kept: tuple[Path, ...]) -> None:
    from morphspace.io.flow_fields import check_field_name
    from morphspace.sets.protect import check_file

    check_field_name(output)
    suffix = output.suffix.lower()
    check_file(output, suffix, kept)
    if back is not None:
        check_file(back, suffix, kept)
    if picture is not None:
        check_file(picture, ".png", kept)
