"""reconstruct: encode every frame, render its loadings, and measure the difference from the original."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge

from morphspace.requests import Clip, Folder, FrameCrop, Model, declared
from morphspace.settings import Help, Option
from morphspace.verbs.encode import write_loadings

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


@declared
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
    """Write aligned/, reconstructed/, placed/, metrics.csv and loadings.csv."""
    import numpy as np

    from morphspace.grid import warp
    from morphspace.io.images import picture_names, write_image
    from morphspace.io.tables import write_metrics_table
    from morphspace.linear.quality import psnr_db, rms_px, ssim
    from morphspace.model.encode import (
        encoded_frames,
        first_components,
        framed_for,
        joined,
        notes_on_enlarging,
    )
    from morphspace.model.model import load_model
    from morphspace.outcome import RECORD_NAME, Outcome, write_record
    from morphspace.sets.protect import Output, writing
    from morphspace.steps import Step
    from morphspace.storage import digest_of_file

    whole = load_model(request.model)
    model, notes = first_components(whole, request.components)
    source = framed_for(model, request.sources, request.crop)
    folders = {name: request.output / name for name in ("aligned", "reconstructed", "placed")}
    table: dict[str, list[object]] = {
        name: [] for name in ("frame", "psnr_db", "ssim", "warp_error_px", "fold_fraction")
    }
    files_of = dict(zip(source.names, picture_names(source.names), strict=True))
    parts, written = [], []
    originals = source.clip.images()
    inputs = dict(zip(source.names, source.file_digests, strict=True))
    own = [request.output / name for name in ("metrics.csv", "loadings.csv", "loadings.json", RECORD_NAME)]
    guarded = Output("reconstruct", request.output, (*folders.values(), *own), inputs=source.clip.paths)
    with writing(guarded):
        for encoded, original in zip(encoded_frames(model, source), originals, strict=True):
            name = encoded.frame.name
            morph = model.expand(encoded.loadings.values[0])
            image = morph.render()
            to_original = warp.chain_affine(source.to_source, encoded.frame.registration)
            pictures = {
                "aligned": encoded.frame.image,
                "reconstructed": image,
                "placed": model.placed(image, original, to_original),
            }
            for kind, picture in pictures.items():
                path = folders[kind] / files_of[name]
                write_image(path, picture)
                written.append(path)
            table["frame"].append(name)
            table["psnr_db"].append(psnr_db(image, encoded.frame.image, model.mask))
            table["ssim"].append(ssim(image, encoded.frame.image, model.mask))
            table["warp_error_px"].append(rms_px(morph.displacement - encoded.morph.displacement, model.mask))
            table["fold_fraction"].append(warp.fold_fraction(morph.displacement, model.mask))
            parts.append(encoded.loadings)
            yield Step("reconstruct", len(parts), len(source.names))
        metrics = own[0]
        write_metrics_table(metrics, table)
        loadings = write_loadings(
            request.output / "loadings.csv", joined(whole, parts), whole, request.model, inputs
        )
        written += [metrics, *loadings]
        settings = {"components": model.rank, "crop": request.crop}
        files = {
            "model": digest_of_file(request.model),
            **{f"clip/{name}": digest for name, digest in inputs.items()},
        }
        record = write_record(request.output, "reconstruct", settings, files, written)
    psnr = np.array(table["psnr_db"], np.float64)
    lines = (
        f"{request.output}: {len(parts)} frames from {model.rank} components, {np.median(psnr):.1f} dB (median), "
        f"{np.percentile(psnr, 10):.1f} dB (10th percentile)",
    )
    document = {
        "output": str(request.output),
        "frames": len(parts),
        "components": model.rank,
        "psnr_db_median": float(np.median(psnr)),
        "psnr_db_10th_percentile": float(np.percentile(psnr, 10)),
    }
    notes += notes_on_enlarging(source.framing, model.identity)
    return Outcome(lines, document, notes, (*written, record))
