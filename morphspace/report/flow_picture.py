"""A flow on one sheet: the two pictures, the second warped back, the field in colour and as a grid, and its figures.

In a good flow the warped picture equals the first, the grid is stretched but not torn, and the colours are confined
to the face. The sheet is drawn with OpenCV alone and its built-in typeface, so it looks the same everywhere.

Hue is the direction and saturation the length of a displacement. The colour wheel is that of the Middlebury benchmark
(Baker et al., IJCV 92, 2011): six stretches between red, yellow, green, cyan, blue and magenta, wide where the eye
distinguishes many shades and narrow where it distinguishes few. Right is red, down yellow, left cyan, up violet.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from morphspace.arrays import AnyArray, Displacement, Image
from morphspace.flow import Flow
from morphspace.flow.baselines import LUMA
from morphspace.grid import warp
from morphspace.report.pictures import change_chart

PANEL_PX = 440  # px; the longer side of a picture on the sheet
LEAST_CELL_PX = 230  # px; room for a title
MARGIN_PX, GAP_PX, TITLE_PX = 32, 26, 30
WHEEL_PX = 190  # px, side of the colour wheel
LEGEND_PX = 260  # px, width of the legend
LINE_PX = 25  # px between lines of figures
TITLE_SIZE, TEXT_SIZE, SMALL_SIZE = 17, 15, 13
REGULAR, BOLD = 400, 600
PAPER, INK, SOFT, RULE = (252, 252, 251), (34, 38, 43), (93, 102, 112), (205, 211, 217)
GRID_INK, FOLD_INK = (20, 94, 132), (204, 13, 13)
PALE = 0.5  # share of white mixed into the picture under the grid
LEAST_SPREAD = 0.005  # a confidence with a smaller spread is not drawn
FULL_DIFFERENCE = 0.2  # difference of luma in full colour
GRID_LINES = 22  # lines along the longer side
LONGEST_TEXT = 120  # characters; the longest line that fits
UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f]+")
SUBPIXEL_BITS = 4  # lines are placed to 1/16 px
STRETCHES = (15, 6, 4, 11, 13, 6)  # hues from red to yellow, to green, to cyan, to blue, to magenta, to red
CORNERS = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1], [1, 0, 1], [1, 0, 0]], np.float64)
BEYOND = 0.75  # brightness of displacements beyond the rim
RIM_QUANTILE = 0.998  # ignores a few outliers, which would make all else pale
NICE = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)  # lengths of the rim, times a power of ten
LEAST_RIM_PX = 0.1  # px; noise of a field without motion stays white

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture of the sheet with its title; `note` follows the title in small letters."""

    title: str
    note: str
    picture: AnyArray


def flow_picture(
    reference: Image,
    frame: Image,
    flow: Flow,
    *,
    names: tuple[str, str] = ("A", "B"),
    figures: Sequence[tuple[str, str]] = (),
) -> Image:
    """Draw the sheet of a flow from `reference` to `frame`, (H, W, 3) in [0, 1], about 1600 px wide. Ours.

    Parameters
    ----------
    reference, frame
        (h, w, 3), colours 0 to 1.
    flow
        The flow on the reference's grid.
    names
        Names of the two pictures.
    figures
        Pairs of name and value, printed under the wheel.
    """
    field = flow.displacement
    height, width = field.shape[:2]
    zoom = PANEL_PX / max(height, width)
    size = max(1, round(width * zoom)), max(1, round(height * zoom))
    rim_px = rim_of(field)
    back = warp.sample(frame, field)
    name_a, name_b = map(_printable, names)
    figures = [(_printable(name), _printable(value)) for name, value in figures]
    panels = (
        Panel("A", name_a, _shown(reference, size)),
        Panel("B", name_b, _shown(frame, size)),
        Panel("B warped back", "should be A", _shown(back, size)),
        Panel(
            "Flow",
            f"from A to B, rim of the wheel {rim_px:g} px",
            _codes(colours_of(_scaled(field, size), rim_px)),
        ),
        Panel("Grid of A on B", "red where it folds", _grid_on(frame, field, size)),
        _last_panel(flow, reference, back, size),
    )
    cell_width = max(size[0], LEAST_CELL_PX)
    row_height = TITLE_PX + size[1] + GAP_PX
    legend_height = TITLE_PX + WHEEL_PX + 3 * GAP_PX + LINE_PX * (1 + len(figures))
    sheet_height = 2 * MARGIN_PX - GAP_PX + max(2 * row_height, legend_height)
    sheet_width = 2 * MARGIN_PX + 3 * (cell_width + GAP_PX) + LEGEND_PX
    sheet = np.full((sheet_height, sheet_width, 3), PAPER, np.uint8)
    for place, panel in enumerate(panels):
        row, column = divmod(place, 3)
        _put_panel(
            sheet, panel, MARGIN_PX + column * (cell_width + GAP_PX), MARGIN_PX + row * row_height, cell_width
        )
    _put_legend(sheet, MARGIN_PX + 3 * (cell_width + GAP_PX), rim_px, figures)
    return sheet.astype(np.float32) / np.float32(255)


def colours_of(displacement: Displacement, rim_px: float) -> Image:
    """Convert a field (h, w, 2) to colours (h, w, 3): white for no motion, full colour at `rim_px`, darker beyond."""
    u, v = displacement[..., 0].astype(np.float64), displacement[..., 1].astype(np.float64)
    places = np.cumsum((0, *STRETCHES))
    turn = np.mod(np.arctan2(v, u) / (2 * np.pi), 1.0) * places[-1]
    hue = np.stack([np.interp(turn, places, channel) for channel in CORNERS.T], axis=-1)
    share = (np.hypot(u, v) / rim_px)[..., None]
    colours: AnyArray = np.where(share <= 1, 1 - share * (1 - hue), BEYOND * hue)
    return colours.astype(np.float32)


def rim_of(displacement: Displacement) -> float:
    """Return a round length, px, that nearly all displacements stay below: the rim of the wheel for this field."""
    length = float(np.quantile(np.hypot(displacement[..., 0], displacement[..., 1]), RIM_QUANTILE))
    length = max(length, LEAST_RIM_PX)
    power = 10.0 ** math.floor(math.log10(length))
    return next(power * nice for nice in NICE if power * nice >= length * (1 - 1e-6))


def wheel(diameter: int) -> tuple[Image, AnyArray]:
    """Return the wheel as a picture (d, d, 3), and the share of each pixel inside it, (d, d)."""
    radius = diameter / 2
    step = np.arange(diameter) + 0.5 - radius
    field = np.stack(np.meshgrid(step, step), axis=-1).astype(np.float32)
    length = np.hypot(field[..., 0], field[..., 1])
    field *= np.minimum(1, radius / np.maximum(length, 1e-6))[..., None]
    return colours_of(field, radius * (1 + 1e-6)), np.clip(radius - length + 0.5, 0, 1)


def warped_grid(displacement: Displacement, spacing_px: float) -> list[AnyArray]:
    """Return the lines of a regular grid moved by the field: arrays (m, 2) px, rows of points first, then columns.

    The lines are `spacing_px` apart on the field's grid, centred, and have one point per pixel.
    """
    x, y = warp.positions(displacement)
    height, width = x.shape
    rows = [np.stack([x[row], y[row]], axis=-1) for row in _evenly(height, spacing_px)]
    columns = [np.stack([x[:, column], y[:, column]], axis=-1) for column in _evenly(width, spacing_px)]
    return rows + columns


def _evenly(size: int, spacing_px: float) -> list[int]:
    count = int((size - 1) / spacing_px)
    first = (size - 1 - count * spacing_px) / 2
    return [round(first + step * spacing_px) for step in range(count + 1)]


def _grid_on(frame: Image, displacement: Displacement, size: tuple[int, int]) -> AnyArray:
    """Draw A's grid, moved by the field, over a pale B; folded cells are red."""
    shown = _shown(frame, size).astype(np.float32)
    canvas = np.rint(shown + PALE * (255 - shown)).astype(np.uint8)
    height, width = displacement.shape[:2]
    scale = np.array([size[0] / width, size[1] / height])
    spacing_px = max(2.0, max(height, width) / GRID_LINES)
    for line in warped_grid(displacement, spacing_px):
        cv2.polylines(canvas, [_fixed_point(line, scale)], False, GRID_INK, 1, cv2.LINE_AA, SUBPIXEL_BITS)
    folded = np.argwhere(warp.determinants(displacement) <= 0)
    if len(folded):
        x, y = warp.positions(displacement)
        corners = np.stack([x, y], axis=-1)
        marks = np.zeros(canvas.shape[:2], np.uint8)
        points = (corners[folded[:, 0], folded[:, 1]] + 0.5) * scale
        inside = ((points >= 0) & (points < size)).all(axis=1)
        column, row = points[inside].astype(np.int64).T
        marks[row, column] = 1
        side = max(2, round(float(scale.max())))
        canvas[cv2.dilate(marks, np.ones((side, side), np.uint8)) > 0] = FOLD_INK
    return canvas


def _fixed_point(points: AnyArray, scale: AnyArray) -> AnyArray:
    """Convert points (m, 2) px of the field to OpenCV's fixed-point coordinates on the panel."""
    placed = (points.astype(np.float64) + 0.5) * scale - 0.5
    limit = 2.0**26  # far outside any panel, inside 32 bits
    return np.rint(np.clip(placed * 2**SUBPIXEL_BITS, -limit, limit)).astype(np.int32)


def _last_panel(flow: Flow, reference: Image, back: Image, size: tuple[int, int]) -> Panel:
    """Draw the confidence, or the residual of the warp if the confidence is uniform (standard estimators)."""
    low, high = float(flow.confidence.min()), float(flow.confidence.max())
    if high - low >= LEAST_SPREAD:
        grey = np.repeat(_scaled(flow.confidence, size)[..., None], 3, axis=2)
        return Panel("Confidence", "0 black, 1 white", _codes(grey))
    left = _scaled(np.abs((np.clip(back, 0, 1) - np.clip(reference, 0, 1)) @ LUMA), size)
    note = f"A against B warped, full blue {255 * FULL_DIFFERENCE:.0f} of 255"
    return Panel("What is left", note, _codes(change_chart(left, FULL_DIFFERENCE)))


def _scaled(values: AnyArray, size: tuple[int, int]) -> AnyArray:
    """Resize an array (h, w[, c]) to another size (width, height)."""
    is_smaller = size[0] < values.shape[1]
    out: AnyArray = cv2.resize(values, size, interpolation=cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR)
    return out


def _shown(image: Image, size: tuple[int, int]) -> AnyArray:
    is_smaller = size[0] < image.shape[1]
    kind = cv2.INTER_AREA if is_smaller else cv2.INTER_CUBIC
    return _codes(cv2.resize(np.clip(image, 0, 1), size, interpolation=kind))


def _codes(image: AnyArray) -> AnyArray:
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def _put_panel(sheet: AnyArray, panel: Panel, left: int, top: int, cell_width: int) -> None:
    after = _write(sheet, panel.title, left, top + TITLE_PX - 11, TITLE_SIZE, BOLD, INK, cell_width)
    _write(
        sheet,
        panel.note,
        after + 9,
        top + TITLE_PX - 11,
        SMALL_SIZE,
        REGULAR,
        SOFT,
        left + cell_width - after - 9,
    )
    height, width = panel.picture.shape[:2]
    x, y = left + (cell_width - width) // 2, top + TITLE_PX
    sheet[y : y + height, x : x + width] = panel.picture
    cv2.rectangle(sheet, (x - 1, y - 1), (x + width, y + height), RULE, 1)


def _put_legend(sheet: AnyArray, left: int, rim_px: float, figures: Sequence[tuple[str, str]]) -> None:
    """Draw the wheel with the length of its rim, and the figures under it."""
    top = MARGIN_PX
    _write(sheet, "Direction and length", left, top + TITLE_PX - 11, TITLE_SIZE, BOLD, INK, LEGEND_PX)
    colours, inside = wheel(WHEEL_PX)
    y = top + TITLE_PX
    part = sheet[y : y + WHEEL_PX, left : left + WHEEL_PX]
    part[:] = _codes(inside[..., None] * colours + (1 - inside[..., None]) * (part / 255.0))
    centre = ((2 * left + WHEEL_PX - 1) << (SUBPIXEL_BITS - 1), (2 * y + WHEEL_PX - 1) << (SUBPIXEL_BITS - 1))
    for share in (0.5, 1.0):
        radius = round(share * WHEEL_PX / 2 * 2**SUBPIXEL_BITS)
        cv2.circle(sheet, centre, radius, INK, 1, cv2.LINE_AA, SUBPIXEL_BITS)
    middle = y + WHEEL_PX // 2
    _write(sheet, "0", left + WHEEL_PX // 2 - 4, middle + 5, SMALL_SIZE, REGULAR, INK, 20)
    _write(sheet, f"{rim_px / 2:g}", left + 3 * WHEEL_PX // 4 + 5, middle + 5, SMALL_SIZE, REGULAR, INK, 40)
    _write(
        sheet, f"{rim_px:g} px", left + WHEEL_PX + 7, middle + 5, TEXT_SIZE, BOLD, INK, LEGEND_PX - WHEEL_PX
    )
    y += WHEEL_PX + GAP_PX
    _write(sheet, "the colour at a point of A is its motion", left, y, SMALL_SIZE, REGULAR, SOFT, LEGEND_PX)
    y += 2 * GAP_PX
    for name, value in figures:
        cv2.line(sheet, (left, y - LINE_PX + 8), (left + LEGEND_PX - 1, y - LINE_PX + 8), RULE, 1)
        width = _width(value, TEXT_SIZE, BOLD)
        _write(sheet, name, left, y, TEXT_SIZE, REGULAR, SOFT, LEGEND_PX - width - 8)
        _write(sheet, value, left + LEGEND_PX - width, y, TEXT_SIZE, BOLD, INK, width + 2)
        y += LINE_PX


def _printable(text: str) -> str:
    """Remove from a text what OpenCV cannot write: invalid Unicode, which crashes it, and line breaks."""
    return UNPRINTABLE.sub(" ", text[:LONGEST_TEXT].encode("utf-8", "replace").decode("utf-8"))


def _write(
    sheet: AnyArray, text: str, x: int, y: int, size: int, weight: int, colour: Colour, room_px: int
) -> int:
    """Write text from (x, y) on, truncated to the room; return the x of its end, px."""
    shown = text
    while shown and _width(shown, size, weight) > room_px:
        text = text[:-1]
        shown = f"{text}…" if text else ""
    if not shown:
        return x
    cv2.putText(sheet, shown, (x, y), colour, cv2.FontFace("sans"), size, weight)
    return x + _width(shown, size, weight)


def _width(text: str, size: int, weight: int) -> int:
    # the end position of the pen; the box of getTextSize excludes blanks at both ends
    end, _ = cv2.putText(
        np.zeros((1, 1, 3), np.uint8), text, (0, 0), (0, 0, 0), cv2.FontFace("sans"), size, weight
    )
    return int(end[0])
