"""keypoints: set the three points on a model's mean face that place it and link it to other models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from morphspace.errors import BadInput
from morphspace.requests import Model, declared
from morphspace.settings import Help, Option, Separated

if TYPE_CHECKING:
    from morphspace.face.detector import Detector
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

Pair = tuple[float, float]


@declared
class KeypointsRequest:
    """Set the three points that place MODEL's face and link it to others; without a source, show them."""

    model: Model
    automatic: Annotated[
        bool,
        Option("--auto"),
        Help("Detect them in the mean and in up to 200 training faces, each warped to the mean (median)."),
    ] = False
    points: Annotated[
        tuple[Pair, Pair, Pair] | None,
        Separated(" ", "78,101 124,100 101,140"),
        Option("--set", metavar='"X,Y X,Y X,Y"'),
        Help(
            "Right eye, left eye, philtrum, px of the mean face; the subject's right eye is on the left of the picture."
        ),
    ] = None
    file: Annotated[
        Path | None,
        Option("--from"),
        Help("A template (.tem, .tps), points (.csv, .txt: x,y per line) or a faceframe (.json)."),
    ] = None
    lip: Annotated[
        Literal["philtrum", "upper-lip"] | None,
        Help(
            "The third point, marked or to be taken from a template: the philtrum's centre, or the bottom of the "
            "upper lip (WebMorph) [default: upper-lip for a .tem of three points, else philtrum]."
        ),
    ] = None
    y_axis: Annotated[
        Literal["auto", "up"],
        Option("--negate-y", gives="up"),
        Help("With --from: y points up in the file. A .tps file does not need it."),
    ] = "auto"
    on: Annotated[
        Literal["mean", "reference"],
        Help("The picture on which the points were marked: the mean face, or the original reference frame."),
    ] = "mean"
    output: Annotated[
        Path | None, Option("-o", "--output"), Help("The new .morph file [default: MODEL itself].")
    ] = None


def run(request: KeypointsRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Set the keypoints, write the model and a picture of them; or show the present ones.

    `detector` None selects the package's own detector if --auto is given.
    """
    import numpy as np

    from morphspace.face.detector import load_detector
    from morphspace.io.images import write_image
    from morphspace.model import keypoint_sources as sources
    from morphspace.model.model import load_model
    from morphspace.outcome import Outcome
    from morphspace.report.pictures import marked_face
    from morphspace.sets.outputs import Output, check_file
    from morphspace.sets.protect import writing

    _check(request)
    model = load_model(request.model)
    if not request.automatic and request.points is None and request.file is None:
        return _shown(request.model, model)
    output = request.output or request.model
    check_file(output, ".morph")
    picture = output.with_name(f"{output.stem}.keypoints.png")
    kept = () if request.file is None else (request.file,)
    if request.automatic:
        found = yield from sources.detected_keypoints(model, detector or load_detector())
    elif request.file is not None:
        found = sources.read_keypoints(model, request.file, request.lip, request.y_axis, request.on)
    else:
        found = sources.given_keypoints(model, np.array(request.points, np.float64), request.lip, request.on)
    changed = model.with_faceframe(found.faceframe, found.origin)
    if request.automatic:
        changed = changed.with_landmarks(found.landmarks)
    marked_mean = marked_face(changed.mean.render(), found.faceframe)
    with writing(Output("keypoints", output, (output, picture), inputs=kept, identity=model.identity)):
        changed.save(output)
        write_image(picture, marked_mean)
    lines = (
        f"{output}: keypoints of {model.identity} set",
        *sources.point_lines(changed, model),
        *found.lines,
        f"picture: {picture}",
    )
    document = {
        **sources.points_document(changed),
        "output": str(output),
        "picture": str(picture),
        "origin": dict(found.origin),
        "landmarks": None if changed.landmarks is None else changed.landmarks.document(),
    }
    notes = found.notes if request.automatic else (*found.notes, *sources.far_notes(changed))
    return Outcome(lines, document, notes, (output, picture))


def _check(request: KeypointsRequest) -> None:
    ways = {
        "--auto": request.automatic,
        "--set": request.points is not None,
        "--from": request.file is not None,
    }
    given = [name for name, is_given in ways.items() if is_given]
    if len(given) > 1:
        raise BadInput(
            f"{' and '.join(given)} were given; expected one source of keypoints. Leave out the other"
        )
    if request.y_axis != "auto" and request.file is None:
        raise BadInput("--negate-y was given without --from. Give --from, or leave it out")
    if request.automatic and (request.lip == "upper-lip" or request.on == "reference"):
        raise BadInput(
            "--auto finds the philtrum on the mean face. Leave out --lip and --on, or mark the points"
        )
    if not given and (request.lip or request.output or request.on != "mean"):
        raise BadInput("no keypoints were given. Give --auto, --set or --from")


def _shown(path: Path, model: MorphModel) -> Outcome:
    from morphspace.model import keypoint_sources as sources
    from morphspace.outcome import Outcome

    if model.faceframe is None:
        lines: tuple[str, ...] = (f"{path}: no keypoints are set. Give --auto, --set or --from",)
    else:
        lines = (f"{path}: keypoints of {model.identity}", *sources.point_lines(model))
    return Outcome(lines, sources.points_document(model))
