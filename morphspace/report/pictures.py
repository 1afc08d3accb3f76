"""The report's pictures, embedded in the page as data addresses: photographs as JPEG, maps as PNG (ours)."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from markupsafe import Markup

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.face.faceframe import FaceFrame
from morphspace.flow.baselines import LUMA
from morphspace.grid import warp
from morphspace.io.images import jpeg_bytes, png_bytes
from morphspace.linear.quality import rms_px
from morphspace.model.model import MorphModel
from morphspace.model.morph import Morph, MorphOffset
from morphspace.report.page import markup
from morphspace.steps import in_order

Face = TypeVar("Face", Morph, MorphOffset)

JPEG_QUALITY = 88  # errors are invisible on faces of this size, and pages stay below a few megabytes
STRIP_WIDTH_PX = 160  # px; width of a component's pictures, which are drawn at this size
STRIP_AMOUNTS_SD = (-2, -1, 0, 1, 2)  # SD of the component
PANEL_GAP_PX = 4  # px between the panels of a video
GAP_PX = 3  # px between the two pictures of a contact sheet
FOLD_SIDE_PX = 300  # px; smaller fold maps are drawn at twice the size, so that single cells are visible
FINER = 4  # factor of enlargement for the outline of a mask, which avoids steps
FOLD_PALE = 0.55  # share of white mixed into the face of a fold map, so that marks are visible
FOLD_RED = np.array([0.80, 0.05, 0.05], np.float32)
FOLD_OUTSIDE = np.array([0.95, 0.62, 0.20], np.float32)  # folded, but outside the mask
CHANGE_INK = np.array([0.10, 0.30, 0.42], np.float32)
UNSURE_INK = np.array([0.45, 0.10, 0.55], np.float32)  # unlike any skin, and unlike the folds' red
PICTURE_SIDE_PX = 480  # px; the mean face is enlarged by an integer up to this size
MARKS = (("R", (215, 40, 40)), ("L", (30, 90, 230)), ("P", (20, 130, 60)))  # letter and colour
WHITE = (255, 255, 255)


@dataclass(frozen=True, eq=False)
class ComponentStrip:
    """A component's pictures at `STRIP_AMOUNTS_SD`, and the effect of one SD on shape and colour.

    Attributes
    ----------
    pictures
        Five pictures (h, w, 3).
    motion_px
        RMS inside the mask, px at the model's size.
    colour
        RMS inside the mask, 0 to 1.
    change
        (h, w) mean absolute change of luma from one end to the other.
    """

    pictures: tuple[Image, ...]
    motion_px: float
    colour: float
    change: AnyArray


def photograph(image: Image, alt: str) -> Markup:
    """Embed an image (h, w, 3) as a JPEG."""
    return _picture("jpeg", jpeg_bytes(image, JPEG_QUALITY), image, alt)


def chart(image: Image, alt: str) -> Markup:
    """Embed a map (h, w, 3) as a PNG, so that its marks stay sharp."""
    return _picture("png", png_bytes(image), image, alt)


def _picture(kind: str, content: bytes, image: Image, alt: str) -> Markup:
    return markup(
        '<img src="data:image/{kind};base64,{data}" alt="{alt}" width="{width}" height="{height}">',
        kind=kind,
        data=Markup(base64.b64encode(content).decode("ascii")),
        alt=alt,
        width=image.shape[1],
        height=image.shape[0],
    )


def stacked(upper: Image, lower: Image) -> Image:
    """Stack two pictures of the same width with a white gap."""
    gap = np.ones((GAP_PX, upper.shape[1], 3), np.float32)
    return np.concatenate([upper, gap, lower])


def component_strips(model: MorphModel, count: int) -> Iterator[ComponentStrip]:
    """Draw the first `count` components, one after the other, at a width of at most `STRIP_WIDTH_PX`."""
    small_mean = shrunk_morph(model.mean)
    mean_picture = small_mean.render()
    small_mask = _resized(model.mask, small_mean)
    weight = max(float(model.mask.sum()), 1e-12)

    def draw(number: int) -> ComponentStrip:
        component = MorphOffset(model.basis.components[number], model.mean.shape, model.mean.reference_id)
        moved = component * float(model.sd[number])
        texture = moved.texture
        motion = rms_px(moved.displacement, model.mask)
        square = (texture * texture).mean(axis=2)
        colour = float(np.sqrt((square * model.mask).sum(dtype=np.float64) / weight))
        offset = shrunk_morph(moved)
        pictures = []
        for amount in STRIP_AMOUNTS_SD:
            if amount == 0:
                pictures.append(mean_picture)
                continue
            pictures.append((small_mean + offset * amount).render())
        change = np.abs((pictures[-1] - pictures[0]) @ LUMA) * small_mask
        return ComponentStrip(tuple(pictures), motion, colour, change)

    return in_order(draw, range(min(count, model.rank)))


def shrunk_morph(morph: Face) -> Face:
    """Reduce a morph or an offset to at most `STRIP_WIDTH_PX` wide; its displacement is in px of the small picture."""
    height, width = morph.texture.shape[:2]
    if width <= STRIP_WIDTH_PX:
        return morph
    size = STRIP_WIDTH_PX, max(1, round(height * STRIP_WIDTH_PX / width))
    scale = np.array([size[0] / width, size[1] / height], np.float32)
    displacement = cv2.resize(morph.displacement, size, interpolation=cv2.INTER_AREA) * scale
    texture = cv2.resize(morph.texture, size, interpolation=cv2.INTER_AREA)
    return type(morph).of(texture, displacement, morph.reference_id)


def _resized(mask: Mask, morph: Morph) -> Mask:
    height, width = morph.texture.shape[:2]
    if mask.shape == (height, width):
        return mask
    return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA))


def change_chart(change: AnyArray, full: float) -> Image:
    """Draw a map (h, w) of change: white is none, dark blue is `full` or more."""
    share = np.clip(change / max(full, 1e-6), 0, 1)[..., None].astype(np.float32)
    return (1 - share + share * CHANGE_INK).astype(np.float32)


def confidence_chart(face: Image, confidence: Mask, mask: Mask) -> Image:
    """Tint a pale grey face (h, w, 3) where the confidence (h, w) is low: full ink at 0, none outside the mask."""
    luma = np.clip(face, 0, 1) @ LUMA
    pale = (luma + FOLD_PALE * (1 - luma))[..., None]
    share = ((1 - np.clip(confidence, 0, 1)) * mask)[..., None]
    tinted = ((1 - share) * pale + share * UNSURE_INK).astype(np.float32)
    return _zoomed(tinted, 2) if face.shape[1] < FOLD_SIDE_PX else tinted


def fold_chart(morph: Morph, mask: Mask) -> Image:
    """Mark on a frame's texture the cells that its warp folds: red inside the mask, orange outside."""
    folded = warp.determinants(morph.displacement) <= 0
    face = np.clip(morph.texture, 0, 1) @ LUMA
    face = face + FOLD_PALE * (1 - face)
    zoom = 2 if face.shape[1] < FOLD_SIDE_PX else 1
    picture = np.repeat(_zoomed(face, zoom)[..., None], 3, axis=2).astype(np.float32)
    inside = mask[:-1, :-1] > 0.5
    start = zoom // 2  # a cell lies between the centres of its corner pixels
    for cells, colour in ((folded & ~inside, FOLD_OUTSIDE), (folded & inside, FOLD_RED)):
        marked = _zoomed(cells, zoom)
        part = picture[start : start + marked.shape[0], start : start + marked.shape[1]]
        part[marked] = colour
    return picture


def _zoomed(values: AnyArray, zoom: int) -> AnyArray:
    return np.repeat(np.repeat(values, zoom, axis=0), zoom, axis=1)


def outlines(mask: Mask, kind: str, level: float = 0.5) -> Markup:
    """Return the contours of a mask (h, w) at `level`, as paths to draw over the picture."""
    height, width = mask.shape
    fine = cv2.resize(mask, (width * FINER, height * FINER), interpolation=cv2.INTER_LINEAR)
    inside = (fine > level).astype(np.uint8)
    contours, _ = cv2.findContours(inside, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    paths = []
    for contour in contours:
        points = (cv2.approxPolyDP(contour, 1.0, True).reshape(-1, 2) + 0.5) / FINER - 0.5
        steps = "L".join(f"{x:.2f} {y:.2f}" for x, y in points.tolist())
        paths.append(markup('<path d="M{steps}Z" class="{kind}"/>', steps=steps, kind=kind))
    return Markup("").join(paths)


def drawn_over(picture: Markup, image: Image, drawing: Markup) -> Markup:
    """Place a drawing, in px of the image, over the image's picture on the page; pixel centres are at integers."""
    height, width = image.shape[:2]
    form = (
        '<div class="over">{picture}'
        '<svg viewBox="-0.5 -0.5 {width} {height}" aria-hidden="true">{drawing}</svg></div>'
    )
    return markup(form, picture=picture, width=width, height=height, drawing=drawing)


def marked_face(mean: Image, faceframe: FaceFrame) -> Image:
    """Draw the three points on a mean face (h, w, 3), enlarged by a whole number: R and L the eyes, P the lip."""
    height, width = mean.shape[:2]
    times = max(1, PICTURE_SIDE_PX // max(height, width))
    size = (width * times, height * times)
    larger = cv2.resize(np.clip(mean, 0, 1), size, interpolation=cv2.INTER_CUBIC)
    out = np.rint(255 * np.clip(larger, 0, 1)).astype(np.uint8)
    radius = max(4, min(size) // 80)
    for (letter, colour), point in zip(MARKS, faceframe.points, strict=True):
        x, y = (round(float(value)) for value in (point + 0.5) * times - 0.5)
        place = (x + radius + 3, y - radius)
        for ink, thickness in ((WHITE, 3), (colour, 1)):
            cv2.circle(out, (x, y), radius, ink, thickness, cv2.LINE_AA)
            cv2.putText(out, letter, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, thickness, cv2.LINE_AA)
        cv2.circle(out, (x, y), 1, colour, -1)
    return out.astype(np.float32) / np.float32(255)


def panels_of(images: Sequence[Image], height: int) -> Image:
    """Put pictures (h, w, 3) side by side at one height, px, with white gaps, as a frame of a video."""
    gap = np.ones((height, PANEL_GAP_PX, 3), np.float32)
    return np.concatenate([part for image in images for part in (gap, of_height(image, height))][1:], axis=1)


def of_height(image: Image, height: int) -> Image:
    """Resize a picture (h, w, 3) to this height, px; its proportions stay."""
    return _scaled_to(image, max(1, round(image.shape[1] * height / image.shape[0])), height)


def of_width(image: Image, width: int) -> Image:
    """Resize a picture (h, w, 3) to this width, px; its proportions stay."""
    return _scaled_to(image, width, max(1, round(image.shape[0] * width / image.shape[1])))


def _scaled_to(image: Image, width: int, height: int) -> Image:
    if image.shape[:2] == (height, width):
        return image
    method = cv2.INTER_AREA if height < image.shape[0] else cv2.INTER_CUBIC
    return np.asarray(np.clip(cv2.resize(image, (width, height), interpolation=method), 0, 1), np.float32)
