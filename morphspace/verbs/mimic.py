"""mimic: drive one person's model with another person's face (Nagle section 3).

Every driving frame yields a picture and a row of loadings. A video and a page then show the pictures beside the
driving frames.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from annotated_types import Ge, Le

from morphspace.requests import (
    ClipOptions,
    ClipText,
    Folder,
    MaxSd,
    MimicryMethod,
    clip_options,
    declared_with,
)
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.face.detector import Detector
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

FACES_MISSING = 3  # exit code: done, but some driving frames show no face


@declared_with(ClipOptions)
class MimicRequest:
    """Drive B's face with the expressions of A's face (Nagle section 3).

    Options of clips, such as --frame-rate, apply to every clip that is given; clip.json sets those of one clip. The
    exit code is 3 if all was done but some driving frames show no face; quality.csv marks them.
    """

    source: Annotated[
        ClipText,
        Option("--src", metavar="A"),
        Help("The person whose motion is used: a model (.morph), or a clip to build one from."),
    ]
    target: Annotated[
        ClipText,
        Option("--dst", metavar="B"),
        Help("The person whose face is drawn: a model (.morph), or a clip to build one from."),
    ]
    output: Folder
    frames: Annotated[
        ClipText | None,
        Option(metavar="CLIP"),
        Help("A folder, a quoted glob or a video of A's person that drives [default: A's training frames]."),
    ] = None
    method: Annotated[
        MimicryMethod,
        Help(
            "paper: inner products, as published. map: B's most probable face. transfer: motion, with B's own skin. "
            "guided: transfer with landmarks of both. auto: guided if both models have landmarks, else transfer."
        ),
    ] = "auto"
    gain: Annotated[
        float | Literal["auto"] | None,
        Ge(-1000),
        Le(1000),
        Option(metavar="G|auto"),
        Help(
            "Factor on all loadings; above 1 caricatures; auto: B moves as far as A [default: auto with guided and "
            "transfer, 1 with paper and map]."
        ),
    ] = None
    max_sd: MaxSd = 3.0
    components: Annotated[
        int | None,
        Ge(1),
        Option("-k", "--components"),
        Help("Largest number of B's components, from the first [default: all]."),
    ] = None
    neutral: Annotated[
        str,
        Option(metavar="auto|mean|A_FRAME[,B_FRAME]"),
        Help(
            "The neutral faces: both means, the named training frames, or auto: if the means differ, the "
            "frame of A nearest to B's mean."
        ),
    ] = "auto"


def run(request: MimicRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Write frames/, side-by-side.mp4, loadings.csv, quality.csv and index.html.

    The outcome's `no_face` is the number of driving frames in which no face was found. `detector` None selects the
    package's own if its networks are installed.
    """
    from morphspace.face.detector import own_detector
    from morphspace.io.clips import Clip
    from morphspace.outcome import Outcome
    from morphspace.report.mimic_page import mimic_document, mimic_lines
    from morphspace.sets.mimicry import opened_pair, output_of, written_mimicry
    from morphspace.sets.models import MODELS_FOLDER, naming_what_stays, ready_model
    from morphspace.sets.protect import writing
    from morphspace.transfer.driver import clip_driver, training_driver

    folder, detect = request.output, detector or own_detector()
    opened, settings = opened_pair(request, detect)
    inputs = [path for given in opened if isinstance(given, Clip) for path in given.paths]
    with naming_what_stays(folder), writing(output_of(folder, inputs)):
        models = []
        for given in opened:
            models.append((yield from ready_model(given, folder / MODELS_FOLDER, request.components, detect)))
        source, target = models
        given_frames, options = request.frames, clip_options(request)
        driver = (
            training_driver(source) if given_frames is None else clip_driver(source, given_frames, options)
        )
        made = yield from written_mimicry(folder, source, target, driver, settings, detect, inputs, options)
    identities = source.model.identity, target.model.identity
    lines = mimic_lines(folder, identities, made.columns, made.settings)
    document = mimic_document(folder, target.model.model_id, made.columns, made.settings)
    missed = FACES_MISSING if document["no_face"] else 0
    return Outcome(lines, document, made.notes, made.files, exit_code=missed)


def check(request: MimicRequest) -> None:
    """Check before a batch starts what can be checked without computing. Raises `BadInput`."""
    from morphspace.face.detector import own_detector
    from morphspace.io.clips import open_clip
    from morphspace.sets.mimicry import opened_pair

    opened_pair(request, own_detector())
    if request.frames is not None:
        open_clip([request.frames], clip_options(request))
