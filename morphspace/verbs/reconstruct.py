"""reconstruct: encode every frame, render its loadings, and measure the difference from the original."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge

from morphspace.requests import Clip, ClipOptions, Folder, FrameCrop, Model, clip_options, declared_with
from morphspace.settings import Help, Option
from morphspace.verbs.encode import write_loadings

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared_with(ClipOptions)
class ReconstructRequest:
    """Reconstruct every image of CLIP from its loadings, beside the original, with figures."""

    model: Model
    sources: Clip
    output: Folder
    components: Annotated[
        int | None,
        Ge(1),
        Option("-k", "--components"),
        Help("Largest number of components, from the first [default: all]."),
    ] = None
    crop: FrameCrop = None


def run(request: ReconstructRequest) -> Steps[Outcome]:
    """Write aligned/, reconstructed/, placed/, metrics.csv, loadings.csv, sheet.png and index.html."""
    import numpy as np

    from morphspace.model.encode import first_components, framed_for, notes_on_frames
    from morphspace.model.model import load_model
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.report.reconstruction import (
        FOLDERS,
        METRICS_NAME,
        PAGE_NAME,
        SHEET_NAME,
        written_reconstruction,
    )
    from morphspace.sets.outputs import Output
    from morphspace.sets.protect import writing
    from morphspace.storage import digest_of_file

    whole, folder = load_model(request.model), request.output
    model, notes = first_components(whole, request.components)
    source = framed_for(model, request.sources, request.crop, clip_options(request))
    notes += notes_on_frames(source, model.identity)
    names = (*FOLDERS, METRICS_NAME, "loadings.csv", "loadings.json", SHEET_NAME, PAGE_NAME, RECORD_NAME)
    guarded = Output("reconstruct", folder, [folder / name for name in names], inputs=source.clip.paths)
    inputs = dict(zip(source.names, source.file_digests, strict=True))
    with writing(guarded):
        made = yield from written_reconstruction(folder, model, whole, source, notes)
        loadings = write_loadings(
            folder / "loadings.csv",
            made.loadings,
            whole,
            request.model,
            inputs,
            rate_hz=source.clip.sidecar.frame_rate_hz,
            times_s=source.clip.times_s,
        )
        written = (*made.files, *loadings)
        settings = {"components": model.rank, "crop": request.crop, **asdict(clip_options(request))}
        files = {
            "model": digest_of_file(request.model),
            **{f"clip/{name}": digest for name, digest in inputs.items()},
        }
        record = write_record(folder, "reconstruct", settings, files, written)
    median, low = float(np.median(made.psnr_db)), float(np.percentile(made.psnr_db, 10))
    lines = (
        f"{folder}: {len(source.names)} frames from {model.rank} components, {median:.1f} dB (median), {low:.1f} dB "
        "(10th percentile)",
        f"page: {folder / PAGE_NAME}",
    )
    document = {
        "output": str(folder),
        "page": str(folder / PAGE_NAME),
        "frames": len(source.names),
        "components": model.rank,
        "psnr_db_median": median,
        "psnr_db_10th_percentile": low,
    }
    return Outcome(lines, document, made.notes, (*written, record))
