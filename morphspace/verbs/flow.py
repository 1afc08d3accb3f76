"""flow: find each point of one picture in another; write the field as a file, as figures and as a picture.

With scenes of known flow it measures the errors of estimators instead: the usual table of papers on optical flow.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.errors import BadInput
from morphspace.flow.names import BACKENDS, DEFAULT, DEFAULT_BACKEND, NAMES, STOCK
from morphspace.requests import declared
from morphspace.settings import Argument, Help, OneOf, Option, Spelled

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared
class FlowRequest:
    """Find each point of picture A in picture B, in px on A's grid."""

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
            f"The estimator; {', '.join(STOCK)} are standard ones, for comparison. With --bench: one or several."
        ),
    ] = (DEFAULT,)
    both: Annotated[
        bool, Help("Also find the flow from B to A (OUTPUT.back.flo) and the error of both in sequence.")
    ] = False
    picture: Annotated[
        Path | None, Help("Picture of the flow: colours, warped grid, B warped back (.png).")
    ] = None
    start: Annotated[
        Path | None,
        Spelled("auto"),
        Help(
            "Initial field on A's grid (.flo, .exr); auto: coarse to fine, and the landmarks' spline if "
            "there is one."
        ),
    ] = None
    landmarks: Annotated[
        tuple[Path, Path] | None,
        Option(metavar="A.tem B.tem"),
        Help(
            "The same points marked in A and in B (.tem; .csv or .txt with x,y per line, px): their spline is tried "
            "as a start, and the better flow is used."
        ),
    ] = None
    backend: Annotated[
        str,
        OneOf(BACKENDS),
        Help("The library that computes fast, balanced and accurate; torch uses a GPU if there is one."),
    ] = DEFAULT_BACKEND
    bench: Annotated[
        Path | None,
        Help(
            "Instead of A B: a folder of scenes with true flow, in Middlebury's layout; reports errors and times."
        ),
    ] = None

    def check(self) -> None:
        """Check that the settings go together. Raises `BadInput` otherwise."""
        if self.bench is not None:
            if self.pictures or self.both or self.picture or self.start or self.landmarks:
                raise BadInput(
                    "--bench measures scenes; expected no A B, --both, --picture, --start or --landmarks. Leave them "
                    "out"
                )
            return
        if len(self.pictures) != 2:
            raise BadInput(f"the number of given pictures is {len(self.pictures)}; expected 2. Give A and B")
        if self.output is None:
            raise BadInput("no output was given. Give -o with a name in .flo or .exr")
        if len(self.presets) != 1:
            raise BadInput(f"{len(self.presets)} presets were given; expected 1. Several are for --bench")


def run(request: FlowRequest) -> Steps[Outcome]:
    """Find the flow, write it with a record, and draw it."""
    from morphspace.flow import methods
    from morphspace.io.flow_fields import write_flows
    from morphspace.io.images import write_image
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.report import flow_figures
    from morphspace.report.flow_picture import flow_picture
    from morphspace.report.flow_scenes import measured_scenes
    from morphspace.sets.outputs import Output
    from morphspace.sets.protect import writing
    from morphspace.storage import digest_of_file

    if request.bench is not None:
        return (yield from measured_scenes(request.bench, request.presets, request.output, request.backend))
    assert request.output is not None  # `check` ensures it
    (reference, frame), (preset,), output = request.pictures, request.presets, request.output
    back = output.parent / f"{output.stem}.back{output.suffix}"
    method = methods.named(preset, request.backend)
    flow_figures.check_start(preset, request)
    inputs = flow_figures.input_files(request)
    record = output.parent / f"{output.name}.{RECORD_NAME}"
    wanted = [output, *([back] if request.both else []), *([request.picture] if request.picture else [])]
    _check_names(wanted, request.picture)
    with writing(Output("flow", output, (*wanted, record), inputs=tuple(inputs.values()))):
        pair = flow_figures.read_pair(reference, frame, request.start, request.landmarks)
        found = yield from flow_figures.found_flows(method, pair, both=request.both)
        flows = {output: found.flow, **({} if found.back is None else {back: found.back})}
        write_flows({path: (one.displacement, one.confidence) for path, one in flows.items()})
        written, figures = list(flows), found.figures
        if request.picture is not None:
            names = (reference.name, frame.name)
            sheet = flow_picture(
                pair.reference,
                pair.frame,
                found.flow,
                names=names,
                figures=flow_figures.figure_words(figures),
            )
            write_image(request.picture, sheet)
            written.append(request.picture)
        digests = {name: digest_of_file(path) for name, path in inputs.items()}
        settings = flow_figures.recorded_settings(request, found.started_from)
        write_record(output.parent, "flow", settings, digests, written, record.name)
    lines = (
        f"{output}: from {reference.name} to {frame.name} by {preset}",
        *(f"{name:<22}{value}" for name, value in flow_figures.figure_words(figures)),
    )
    document = {"output": str(output), "preset": preset, **figures}
    return Outcome(lines, document, pair.notes, (*written, record))


def _check_names(wanted: list[Path], picture: Path | None) -> None:
    from morphspace.io.flow_fields import check_field_name
    from morphspace.sets.outputs import check_file

    for path in wanted:
        if path != picture:
            check_field_name(path)
        check_file(path, ".png" if path == picture else path.suffix.lower())
