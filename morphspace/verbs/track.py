"""track: find the points of the face in each frame of a clip, and write them for people to look at and to correct."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import Clip, ClipOptions, clip_options, declared_with, request_document
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.face.detector import Detector
    from morphspace.face.track import FaceTrack
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

NAMED_FRAMES = 5  # in a note


@declared_with(ClipOptions)
class TrackRequest:
    """Find the 478 points of the face in each frame of CLIP; write them so that they can be corrected.

    `build-model --landmarks` and `encode --landmarks` read the corrected points.
    """

    sources: Clip
    output: Annotated[
        Path,
        Option("-o", "--output"),
        Help("A table (.csv) of all points, or a folder of one template for each frame (.tem, WebMorph)."),
    ]
    points: Annotated[
        Path | None,
        Option("--from", metavar="FILE"),
        Help("A table or folder of points: its frames are taken as they are, and only the others searched."),
    ] = None


def run(request: TrackRequest, detector: Detector | None = None) -> Steps[Outcome]:
    """Find the points and write them. `detector` None selects the package's own."""
    from morphspace import cache
    from morphspace.face.crop import check_one_person, several_notes
    from morphspace.face.detector import load_detector
    from morphspace.face.mesh import POINT_COUNT, SCHEME
    from morphspace.face.track import given_points, track_steps, turn_words
    from morphspace.io.clips import open_clip
    from morphspace.io.framing import WholeClip
    from morphspace.io.points_table import template_files, template_text, write_points_table
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.sets.outputs import Output, check_file
    from morphspace.sets.protect import writing
    from morphspace.storage import write_texts

    clip = open_clip(request.sources, clip_options(request))
    given = None if request.points is None else given_points(request.points, clip)
    detector = detector or load_detector(person=clip.person or "largest")
    output, is_table = request.output, bool(request.output.suffix)
    names = clip.frame_names
    templates = {} if is_table else template_files(output, names)
    written: tuple[Path, ...] = (*templates.values(), output / RECORD_NAME)
    if is_table:
        check_file(output, ".csv")
        written = (output, output.with_suffix(".json"))
    inputs = (*clip.paths, *([] if request.points is None else [request.points]))
    identity = clip.sidecar.identity or clip.name
    guarded = Output("track", output, written, inputs=inputs, identity=identity)
    known = None if given is None else given.faces
    with writing(guarded), cache.work_folder(None, output) as work_folder:
        track = yield from track_steps(WholeClip(clip), detector, work_folder, given=known)
        check_one_person(names, track.faces, is_video=clip.video_indices is not None)
        digests = dict(zip(names, clip.digests(), strict=True))
        if is_table:
            about = {
                "scheme": SCHEME,
                "size": list(clip.size),
                "inputs": digests,
                "identity": identity,
                "frame_rate_hz": clip.sidecar.frame_rate_hz,
            }
            write_points_table(output, track.table(), POINT_COUNT, about)
        else:
            texts = {
                templates[name]: template_text(face.points)
                for name, face in zip(names, track.faces, strict=True)
                if face is not None
            }
            write_texts(texts)
            written = (*texts, write_record(output, "track", request_document(request), digests, texts))
    found, turned = track.document(), turn_words(track.document())
    shown = (
        f"{output}: {POINT_COUNT} points of the face in {found['frames_with_face']} of {len(names)} frames"
    )
    lines = (shown + (f", of which {found['frames_given']} were given" if given else ""), turned)
    notes = (*clip.notes, *several_notes(names, track.faces), *_lost_notes(track))
    document = {"output": str(output), "points": POINT_COUNT, **found}
    return Outcome(tuple(filter(None, lines)), document, notes, written)


def _lost_notes(track: FaceTrack) -> tuple[str, ...]:
    """Name the frames without a face."""
    lost = [name for name, is_known in zip(track.names, track.known, strict=True) if not is_known]
    if not lost:
        return ()
    more = f" and {len(lost) - NAMED_FRAMES} more" if len(lost) > NAMED_FRAMES else ""
    return (
        f"no face was found in {len(lost)} of {len(track.names)} frames: {', '.join(lost[:NAMED_FRAMES])}{more}. Mark "
        "all points of such a frame, or leave it without: its flow is not held then",
    )
