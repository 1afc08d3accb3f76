"""Frames drawn from their loadings beside the originals: pictures, figures, contact sheet and page (ours)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from morphspace.arrays import AnyArray, Image
from morphspace.grid import warp
from morphspace.io.framing import FramedClip
from morphspace.io.images import picture_names, write_image
from morphspace.io.tables import write_metrics_table
from morphspace.linear.quality import psnr_db, rms_px, ssim
from morphspace.model.encode import encoded_frames, joined, notes_on_lost
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel
from morphspace.report import pictures
from morphspace.report.frames import small
from morphspace.report.page import Panel, render
from morphspace.report.plots import Mark, Plot, line_plot
from morphspace.steps import Step, Steps, spread
from morphspace.storage import write_text

FOLDERS = ("aligned", "reconstructed", "placed")
PAGE_NAME, SHEET_NAME, METRICS_NAME = "index.html", "sheet.png", "metrics.csv"
SHEET_FRAMES = 16  # frames on the sheet, evenly spread
SHEET_COLUMNS = 8  # frames in a row of the sheet
WORST_NAMED = 3  # frames named in the plot
LEAST_RANGE_DB = 4.0  # dB; range of the axis, so that noise does not fill it
UNDEFINED_DB = 120.0  # dB, the PSNR of equal pictures


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The reconstruction of a clip: `figures` by name with a value a frame, `loadings`, `files` written and `notes`."""

    figures: dict[str, list[object]]
    loadings: Loadings
    files: tuple[Path, ...]
    notes: tuple[str, ...]

    @property
    def psnr_db(self) -> AnyArray:
        """Return the PSNR of each frame, dB."""
        return np.array(self.figures["psnr_db"], np.float64)


@dataclass(frozen=True, eq=False)
class ReconstructionPage:
    """The contents of `reconstruction.html`."""

    title: str
    model: MorphModel
    clip: str
    key_figures: Sequence[tuple[str, str]]
    notes: Sequence[str]
    sheet: Sequence[Panel]
    frames: int
    psnr_plot: Markup


def written_reconstruction(
    folder: Path, model: MorphModel, whole: MorphModel, source: FramedClip, notes: Sequence[str]
) -> Steps[Reconstruction]:
    """Encode each frame, draw it from its loadings, and write pictures, table, sheet and page.

    Parameters
    ----------
    folder : Path
    model : MorphModel
        The model with the components that are used.
    whole : MorphModel
        The model with all components, which owns the loadings.
    source : FramedClip
    notes : sequence of str
        Printed at the top of the page.

    Raises
    ------
    UnwritableFile
        If the folder or disk refuses a file.
    """
    names = ("frame", "psnr_db", "ssim", "warp_error_px", "fold_fraction")
    figures: dict[str, list[object]] = {name: [] for name in names}
    files_of = dict(zip(source.names, picture_names(source.names), strict=True))
    shown = set(spread(len(source.names), SHEET_FRAMES))
    parts: list[Loadings] = []
    lost: list[str] = []
    written: list[Path] = []
    pairs: list[tuple[str, Image]] = []
    for encoded, original in zip(encoded_frames(model, source), source.clip.images(), strict=True):
        name, aligned = encoded.frame.name, encoded.frame.image
        morph = model.expand(encoded.loadings.values[0])
        image = morph.render()
        to_original = warp.chain_affine(source.to_source, encoded.frame.registration)
        for kind, picture in zip(
            FOLDERS, (aligned, image, model.placed(image, original, to_original)), strict=True
        ):
            path = folder / kind / files_of[name]
            write_image(path, picture)
            written.append(path)
        if len(parts) in shown:
            pairs.append((name, pictures.stacked(small(aligned), small(image))))
        row = (
            name,
            psnr_db(image, aligned, model.mask),
            ssim(image, aligned, model.mask),
            rms_px(morph.displacement - encoded.morph.displacement, model.mask),
            warp.fold_fraction(morph.displacement, model.mask),
        )
        for column, value in zip(names, row, strict=True):
            figures[column].append(value)
        parts.append(encoded.loadings)
        lost += encoded.lost
        yield Step("reconstruct", len(parts), len(source.names))
    write_metrics_table(folder / METRICS_NAME, figures)
    write_image(folder / SHEET_NAME, _sheet([picture for _, picture in pairs]))
    notes = (*notes, *notes_on_lost(lost, len(parts)))
    made = Reconstruction(figures, joined(whole, parts), tuple(written), notes)
    write_text(folder / PAGE_NAME, _page(made, model, source.clip.name, pairs, notes))
    files = (*written, *(folder / name for name in (METRICS_NAME, SHEET_NAME, PAGE_NAME)))
    return Reconstruction(figures, made.loadings, files, notes)


def _sheet(pairs: Sequence[Image]) -> Image:
    """Tile pictures of one size in rows of `SHEET_COLUMNS`; empty places are white."""
    blank = np.ones_like(pairs[0])
    columns = min(SHEET_COLUMNS, len(pairs))
    padded = [*pairs, *[blank] * (-len(pairs) % columns)]
    rows = [np.concatenate(padded[at : at + columns], axis=1) for at in range(0, len(padded), columns)]
    return np.concatenate(rows)


def _page(
    made: Reconstruction,
    model: MorphModel,
    clip: str,
    pairs: Sequence[tuple[str, Image]],
    notes: Sequence[str],
) -> str:
    """Return the page as HTML."""
    psnr = np.minimum(made.psnr_db, UNDEFINED_DB)
    names = [str(name) for name in made.figures["frame"]]
    by_name = dict(zip(names, psnr.tolist(), strict=True))
    median = float(np.median(psnr))
    lowest = [int(place) for place in np.argsort(psnr, kind="stable")[:WORST_NAMED] if psnr[place] < median]
    worst = [Mark(place, f"{names[place]}  {psnr[place]:.1f} dB") for place in lowest]
    level = f"median {median:.1f} dB"
    plot = Plot(f"PSNR of each frame; {level}", "frame", "PSNR, dB", LEAST_RANGE_DB)
    error_px, ssims = (np.array(made.figures[key], np.float64) for key in ("warp_error_px", "ssim"))
    page = ReconstructionPage(
        title=f"{clip} drawn by the model of {model.identity}",
        model=model,
        clip=clip,
        key_figures=[
            (f"{median:.1f} dB", "PSNR inside the mask, median frame"),
            (f"{np.percentile(psnr, 10):.1f} dB", "PSNR, 10th percentile"),
            (f"{np.median(ssims):.3f}", "SSIM, median frame"),
            (f"{np.median(error_px):.2f} px", "of warp is missed (rms), median frame"),
            (f"{model.rank}", "components"),
        ],
        notes=notes,
        sheet=[
            Panel(
                pictures.photograph(picture, f"{name}: frame above, drawn beneath"),
                f"{name} ",
                f"{by_name[name]:.1f} dB",
            )
            for name, picture in pairs
        ],
        frames=len(names),
        psnr_plot=line_plot(plot, psnr.tolist(), level=(median, level), worst=worst),
    )
    return render("reconstruction.html", page)
