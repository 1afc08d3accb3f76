"""encode: convert images of a person to a table of loadings on that person's model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from morphspace.requests import Clip, ClipOptions, FrameCrop, Model, clip_options, declared_with
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.model.loadings import Loadings
    from morphspace.model.model import MorphModel
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared_with(ClipOptions)
class EncodeRequest:
    """Encode the images of CLIP as a table of loadings on MODEL, in SD."""

    model: Model
    sources: Clip
    output: Annotated[Path, Option("-o", "--output"), Help("The loadings table (.csv).")]
    crop: FrameCrop = None
    landmarks: Annotated[
        Path | None,
        Option(metavar="FILE"),
        Help(
            "A table of face points, or a folder of templates, for the frames that it names (`morphspace track`)."
        ),
    ] = None
    morphs: Annotated[
        Path | None,
        Option(metavar="DIR"),
        Help(
            "Also write each frame's morph on the mean face's grid: texture (.exr, linear light) and warp (.flo, px)."
        ),
    ] = None


def run(request: EncodeRequest) -> Steps[Outcome]:
    """Encode the images; write the table and its sidecar, and the morphs."""
    import contextlib
    from itertools import chain

    import numpy as np

    from morphspace.face.track import framed_points
    from morphspace.model.encode import (
        drawn_by,
        encoded_frames,
        framed_for,
        joined,
        morph_files,
        notes_on_frames,
        notes_on_lost,
        notes_on_own,
        write_morph,
    )
    from morphspace.model.model import load_model
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.sets.outputs import Output, check_file
    from morphspace.sets.protect import writing
    from morphspace.steps import Step
    from morphspace.storage import digest_of_file

    model = load_model(request.model)
    source = framed_for(model, request.sources, request.crop, clip_options(request))
    check_file(request.output, ".csv")
    sidecar = request.output.with_suffix(".json")
    parts: list[Loadings] = []
    lost: list[str] = []
    own = drawn_by(model, source)
    inputs = dict(zip(source.names, source.file_digests, strict=True))
    files, given = list(source.clip.paths), framed_points(request.landmarks, source)
    if request.landmarks is not None and given is not None:
        files.append(request.landmarks)
        inputs[given.origin["file"]] = given.origin["sha256"]
    table = (request.output, sidecar)
    outputs = [Output("encode", request.output, table, inputs=files, identity=model.identity)]
    pairs: list[tuple[Path, Path]] = []
    if request.morphs is not None:
        pairs = morph_files(request.morphs, source.names)
        made = [*chain(*pairs), request.morphs / RECORD_NAME]
        outputs.append(Output("encode", request.morphs, made, inputs=files))
    with contextlib.ExitStack() as guards:
        for output in outputs:
            guards.enter_context(writing(output))
        for place, encoded in enumerate(encoded_frames(model, source, own, given)):
            parts.append(encoded.loadings)
            lost += encoded.lost
            if pairs:
                write_morph(encoded.morph, *pairs[place])
            yield Step("encode", len(parts), len(source.names))
        if request.morphs is not None:
            digests = {"model": digest_of_file(request.model), **inputs}
            write_record(request.morphs, "encode", {"crop": request.crop}, digests, chain(*pairs))
        loadings = joined(model, parts)
        rate_hz, times_s = source.clip.sidecar.frame_rate_hz, source.clip.times_s
        written = write_loadings(
            request.output, loadings, model, request.model, inputs, rate_hz=rate_hz, times_s=times_s
        )
    furthest = float(np.abs(loadings.in_sd(model).values).max(initial=0))
    lines = (
        f"{request.output}: {len(parts)} frames, {model.rank} components of {model.identity}, in SD; the furthest "
        f"value is {furthest:.1f} SD",
    )
    document = {
        "table": str(request.output),
        "frames": len(parts),
        "components": model.rank,
        "furthest_sd": furthest,
    }
    notes = notes_on_frames(source, model.identity)
    notes += notes_on_own(own) + notes_on_lost(lost, len(parts))
    return Outcome(lines, document, notes, (*written, *chain(*pairs)))


def write_loadings(
    output: Path,
    loadings: Loadings,
    model: MorphModel,
    model_path: Path,
    inputs: dict[str, str],
    *,
    rate_hz: float | None = None,
    times_s: Sequence[float] | None = None,
) -> tuple[Path, Path]:
    """Write loadings as a table in SD, with the times of the frames, and a sidecar that names model, rate and inputs.

    A `rate_hz` of None is replaced by the rate of the model.
    """
    from morphspace.io.tables import write_loadings_table
    from morphspace.outcome import versions
    from morphspace.storage import digest_of_file

    document = {
        "model_id": model.model_id,
        "model_sha256": digest_of_file(model_path),
        "identity": model.identity,
        "consent": model.provenance.get("consent"),
        "licence": model.provenance.get("licence"),
        "frame_rate_hz": rate_hz or model.provenance.get("frame_rate_hz"),
        "inputs": inputs,
        "versions": versions(),
    }
    write_loadings_table(output, loadings.in_sd(model).values, loadings.frame_names, document, times_s)
    return output, output.with_suffix(".json")
