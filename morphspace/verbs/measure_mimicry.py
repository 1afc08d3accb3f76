"""measure-mimicry: measure how closely a real imitation follows its stimulus, in the stimulus' expression space.

Nagle section 5.1: both sequences are loadings on one model, compared by distances, correlation, mutual information
and entropy. A clip is encoded with the model; a table of loadings, such as `mimic` writes, is used as it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Le

from morphspace.errors import BadInput
from morphspace.requests import ClipOptions, ClipText, clip_options, declared_with, settings_in
from morphspace.settings import Argument, Help, Option

if TYPE_CHECKING:
    from morphspace.face.detector import Detector
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

FACES_MISSING = 3  # exit code: done, but some frames show no face


@declared_with(ClipOptions)
class MeasureMimicryRequest:
    """Measure how closely IMITATION follows STIMULUS, in the expression space of the stimulus' model.

    Options of clips, such as --frame-rate, apply to both; clip.json sets those of one clip. The exit code is 3 if all
    was done but some frames show no face; measures.json names them.
    """

    stimulus: Annotated[ClipText, Argument("STIMULUS"), Help("A clip, or a table of loadings (.csv).")]
    imitation: Annotated[ClipText, Argument("IMITATION"), Help("A clip, or a table of loadings (.csv).")]
    model: Annotated[Path, Help("The stimulus' model (.morph); both are measured in its space.")]
    output: Annotated[
        Path | None,
        Option("-o", "--output"),
        Help("The output folder [default: the imitation's name and -mimicry]."),
    ] = None
    components: Annotated[
        int | None,
        Ge(1),
        Option("-k", "--components"),
        Help("Largest number of components, from the first [default: all]."),
    ] = None
    permutations: Annotated[
        int,
        Ge(0),
        Le(1_000_000),
        Help(
            "Largest number of circular shifts of the imitation for the chance level; at the best lag and aligned, "
            "number of surrogate copies."
        ),
    ] = 1000
    seed: Annotated[int, Ge(0), Help("Seed of the shifts and copies.")] = 0
    mask: Annotated[
        Path | None,
        Help("Measure a part of the face: a grey picture on the mean face, white on the measured part."),
    ] = None
    region: Annotated[
        str,
        Option(metavar="NAME"),
        Help(
            "The measured part of the face: eyes, brows, mouth, nose, upper, lower, several joined by +, or whole."
        ),
    ] = "whole"
    imitator: Annotated[
        Path | None,
        Option(metavar="B"),
        Help(
            "The model (.morph) of the imitator if that is another person: IMITATION is encoded with it and "
            "transferred by mimicry. Both models need keypoints."
        ),
    ] = None


def run(request: MeasureMimicryRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Write measures.csv, the loadings of both, a side-by-side video and index.html.

    The outcome's `no_face` is the number of frames in which no face was found. `detector` None selects the package's
    own if its networks are installed. Raises `BadInput` if the two motions, the model and the output do not fit.
    """
    from morphspace.face.detector import own_detector
    from morphspace.model.model import load_model
    from morphspace.outcome import Outcome
    from morphspace.sets.imitation import (
        VERB,
        WRITTEN,
        MeasureSettings,
        last_measures,
        measure_lines,
        written_imitation,
    )
    from morphspace.sets.outputs import Output, check_file
    from morphspace.sets.protect import writing

    model = load_model(request.model)
    _check_request(request, model)
    folder = request.output or Path(f"{Path(request.imitation).stem or 'clip'}-mimicry")
    kept = [Path(given) for given in (request.stimulus, request.imitation)]
    for name in WRITTEN:
        check_file(folder / name, Path(name).suffix)
    for path in kept:
        if path.is_dir() and folder.resolve() == path.resolve():
            raise BadInput(
                f"the output folder {folder} is one of the two clips. Choose another output folder"
            )
    settings = settings_in(request, MeasureSettings, options=clip_options(request))
    guarded = Output(VERB, folder, [folder / name for name in WRITTEN], inputs=kept)
    with writing(guarded):
        made = yield from written_imitation(
            folder,
            request.model,
            model,
            request.stimulus,
            request.imitation,
            settings,
            detector or own_detector(),
        )
    document = {"output": str(folder), **made.entries, **last_measures(made.comparison)}
    missed = FACES_MISSING if made.entries["no_face"] else 0
    return Outcome(measure_lines(folder, made), document, made.notes, made.files, missed)


def _check_request(request: MeasureMimicryRequest, model: MorphModel) -> None:
    from morphspace.face.regions import WHOLE

    if model.rank == 0:
        raise BadInput(f"{request.model} has 0 components; expected at least one. Build it from more frames")
    if request.mask is not None and request.region != WHOLE:
        raise BadInput(f"both the mask {request.mask} and the region {request.region} were given. Give one")
