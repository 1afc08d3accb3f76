"""The figures of each training frame: it is drawn from its loadings and compared with the original (ours).

One frame per thread is in memory; only numbers, and small pictures of a few frames, are stored.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image, Mask
from morphspace.face.regions import mouth_surroundings, rigid_region
from morphspace.flow.baselines import LUMA
from morphspace.grid import warp
from morphspace.io.colour import linear_of_srgb
from morphspace.linear.quality import psnr_db, rms_px
from morphspace.model.passes import Build
from morphspace.steps import Step, Steps, in_order, spread

SHEET_FRAMES = 24  # frames of the contact sheet; enough to show the range of a clip
SHEET_WIDTH_PX = 160  # px; about the displayed width on a sheet of eight columns
BLACK_LIGHT = 0.002  # added to linear light, so that sensor noise near black does not count as exposure


@dataclass(frozen=True, eq=False)
class SheetFrame:
    """One frame of the contact sheet: its index, and aligned and rebuilt picture (h, w, 3), both small."""

    index: int
    original: Image
    rebuilt: Image


@dataclass(frozen=True, eq=False)
class FrameFigures:
    """Figures of n training frames; arrays (n,) in the order of the frames.

    Attributes
    ----------
    psnr_db
        PSNR of the frame drawn from all its loadings, inside the mask, dB.
    fold_fractions
        Folded share of the same warp.
    luminance
        Mean luma inside the mask, 0 to 1.
    exposure_stops
        Light of the rigid part of the face relative to the reference, log2.
    mahalanobis
        Length of the loadings, SD.
    rigid_motion_px
        RMS warp that remains in the rigid part after registration, px.
    mouth_contrast
        SD of luma in the mouth region over the skin's luma.
    sheet
        Small pictures of a few frames.
    """

    psnr_db: AnyArray
    fold_fractions: AnyArray
    luminance: AnyArray
    exposure_stops: AnyArray
    mahalanobis: AnyArray
    rigid_motion_px: AnyArray
    mouth_contrast: AnyArray
    sheet: tuple[SheetFrame, ...]


def measure_frames(build: Build) -> Steps[FrameFigures]:
    """Draw each training frame from its loadings and measure it. Ours.

    Memory does not grow with the frames, except for a few numbers each; there are at most `SHEET_FRAMES` small
    pictures.
    """
    model = build.model
    count = len(model.training.frame_names)
    sheet_indices = set(spread(count, SHEET_FRAMES))
    regions = _Regions(build)
    loadings = model.training.values
    lengths = np.sqrt(((loadings / np.maximum(model.sd, np.finfo(float).tiny)) ** 2).sum(axis=1))

    def measure(index: int) -> tuple[tuple[float, ...], SheetFrame | None]:
        frame, _ = build.frame(index)
        morph = model.expand(loadings[index])
        rebuilt = morph.render()
        figures = (
            regions.psnr_db(rebuilt, frame.image),
            warp.fold_fraction(morph.displacement, model.mask),
            *regions.light(frame.image),
            regions.rigid_motion_px(morph.displacement),
        )
        if index not in sheet_indices:
            return figures, None
        return figures, SheetFrame(index, small(frame.image), small(rebuilt))

    table: list[tuple[float, ...]] = []
    sheet: list[SheetFrame] = []
    for figures, pictures in in_order(measure, range(count)):
        table.append(figures)
        if pictures is not None:
            sheet.append(pictures)
        yield Step("report", len(table), count)
    psnr, folds, luminance, stops, contrast, rigid = np.array(table, np.float64).T
    return FrameFigures(psnr, folds, luminance, stops, lengths, rigid, contrast, tuple(sheet))


def small(image: Image) -> Image:
    """Reduce a picture (h, w, 3) to at most `SHEET_WIDTH_PX` wide by area averaging."""
    height, width = image.shape[:2]
    if width <= SHEET_WIDTH_PX:
        return image
    size = SHEET_WIDTH_PX, max(1, round(height * SHEET_WIDTH_PX / width))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


class _Regions:
    """The measured parts of the face, prepared once: rigid part and mouth on the reference and the mean."""

    def __init__(self, build: Build) -> None:
        model = build.model
        height, width = model.mask.shape
        self.inside = model.mask
        self.total = max(float(model.mask.sum()), 1e-12)
        rigid = rigid_region(height, width, model.reference_faceframe)
        self.face_box = _box_of(model.mask)
        rigid_on_mean = rigid_region(height, width, model.faceframe)
        self.rigid_box = _box_of(rigid_on_mean)
        self.rigid_on_mean = rigid_on_mean[self.rigid_box]
        self.rigid = np.flatnonzero((rigid > 0.5).reshape(-1))
        self.mouth = np.flatnonzero(
            mouth_surroundings(height, width, model.reference_faceframe).reshape(-1) > 0.5
        )
        self.reference_light = self._rigid_light(model.reference)

    def psnr_db(self, image: Image, truth: Image) -> float:
        """Compute the PSNR inside the mask, dB; pixels outside the mask's box are ignored."""
        box = self.face_box
        return psnr_db(image[box], truth[box], self.inside[box])

    def rigid_motion_px(self, displacement: Displacement) -> float:
        """Compute the RMS length of a displacement, px, on the mean face's rigid part."""
        return rms_px(displacement[self.rigid_box], self.rigid_on_mean)

    def light(self, image: Image) -> tuple[float, float, float]:
        """Compute luminance, exposure and mouth contrast of an aligned frame (h, w, 3)."""
        luma = image @ LUMA
        mean = float((luma * self.inside).sum(dtype=np.float64) / self.total)
        if not self.rigid.size:
            return mean, 0.0, 0.0
        ratio = self._rigid_light(image) / self.reference_light
        # The median does not follow a blink or a raised brow, as the mean would.
        stops = float(np.log2(np.median(ratio)))
        skin = float(np.median(luma.reshape(-1)[self.rigid]))
        mouth = luma.reshape(-1)[self.mouth]
        contrast = float(mouth.std()) / max(skin, BLACK_LIGHT) if mouth.size else 0.0
        return mean, stops, contrast

    def _rigid_light(self, image: Image) -> AnyArray:
        colours = np.clip(image.reshape(-1, 3)[self.rigid], 0, 1)
        light: AnyArray = linear_of_srgb(colours) @ LUMA + np.float32(BLACK_LIGHT)
        return light


def _box_of(mask: Mask) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not rows.size:
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
