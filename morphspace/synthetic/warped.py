"""Photographs warped by known smooth expression-like fields: what a flow estimator is judged by. Ours.

The photograph is the reference. The field is a formula, the sum of bumps where a face moves, and where the mouth opens
two of them, one above the line between the lips and one below it. The frame is made backwards: for each of its pixels
the point of the photograph that is seen there is found by Newton's method on the formula (to `SOLVED_PX`), on the
upper sheet, else on the lower one, else the mouth is seen. The truth is the formula at each reference pixel, so it is
exact, also beside the line; what remains between reference(p) and frame(p + u(p)) is sampling and rounding alone. Both
pictures are sampled from the photograph twice as fine as asked for, averaged, and rounded to 8 bits as a camera's are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
import skimage.data

from morphspace.arrays import AnyArray, Displacement, Image, Points
from morphspace.errors import BadInput
from morphspace.grid import warp
from morphspace.linear.quality import stays_inside

WarpKind = Literal["smooth", "mouth", "lit"]
WARP_KINDS: tuple[WarpKind, ...] = ("smooth", "mouth", "lit")

FINE = 2  # pixels a side that are averaged to one
SOLVED_PX = 1e-5  # far below what float32 positions hold
NEWTON_STEPS = 60  # steps, at most, of the search for a point
LONGEST_STEP_PX = 8.0  # px; a longer step may leave the sheet on which it is true
LEAST_DETERMINANT = 0.3  # of a field that is taken: nowhere pressed to less than this share of its area
MOST_DRAWS = 60  # eight were enough for any picture in use

# Where a face moves: place from the middle between the eyes, right in eye-to-eye distances and down in eye-to-mouth
# distances; width (sd) as a share of the picture; how far it moves against the others.
BUMPS = (
    (-0.75, -0.35, 0.060, 0.8),  # outer and inner brows
    (-0.28, -0.32, 0.050, 0.8),
    (0.28, -0.32, 0.050, 0.8),
    (0.75, -0.35, 0.060, 0.8),
    (-0.50, 0.00, 0.050, 0.4),  # eyes
    (0.50, 0.00, 0.050, 0.4),
    (-0.75, 0.55, 0.080, 1.0),  # cheeks
    (0.75, 0.55, 0.080, 1.0),
    (-0.45, 0.98, 0.055, 1.2),  # corners of the mouth
    (0.45, 0.98, 0.055, 1.2),
    (0.00, 1.50, 0.075, 1.0),  # chin
    (-0.80, 1.30, 0.090, 0.8),  # jaw
    (0.80, 1.30, 0.090, 0.8),
)
LINE_POINTS = 4  # a cubic goes through them
OPENING = 0.6  # the lower lip's drop against the largest bump, before all is scaled to the peak
LIFT = 0.2  # the upper lip's rise against the lower lip's drop
JAW_SD, LIP_SD = 0.20, 0.06  # shares of the picture: how far below and above the line the skin goes along
GAIN_RANGE = (0.9, 1.11)  # times the light of the reference
RAMP = 0.1  # brighter on one side, darker on the other by this share
NOISE_SD = 2.0 / 255.0  # two 8-bit codes: the noise of a camera


@dataclass(frozen=True, eq=False)
class FaceMarks:
    """The position of the face in a photograph, all in its px: the pupils, and the line between the lips.

    `mouth` (m, 2), m >= 4, from the image's left corner of the mouth to the right one; `side_px` is the side of the
    square around the face that becomes the picture. `right_eye` is the subject's, on the image's left. Ours.
    """

    right_eye: tuple[float, float]
    left_eye: tuple[float, float]
    mouth: Points
    side_px: float


@dataclass(frozen=True, eq=False)
class FlowPair:
    """Two pictures and the exact field between them.

    `reference` and `frame` (h, w, 3); `truth` (h, w, 2) px on the reference's grid: the point p of the reference is
    found in the frame at p + u(p); `visible` (h, w) bool, where that place lies inside the frame and nothing covers
    it. Ours.
    """

    name: str
    reference: Image
    frame: Image
    truth: Displacement
    visible: AnyArray


def flow_pair(
    photograph: Image,
    marks: FaceMarks,
    *,
    kind: WarpKind = "smooth",
    peak_px: float = 14.0,
    seed: int = 0,
    size: int = 256,
    name: str = "",
) -> FlowPair:
    """Make a pair of pictures (size, size, 3) from a photograph (H, W, 3), with the exact field between them.

    The longest displacement on the reference's grid is `peak_px` (0 gives the same picture twice). `kind`: "smooth"
    moves the skin; "mouth" parts the lips as well, with teeth and tongue behind them; "lit" moves the skin as "smooth"
    does, and changes the frame's light: a gain in `GAIN_RANGE`, a linear ramp of +-`RAMP` across the picture and noise
    of sd `NOISE_SD`, cut off at black and white. The same arguments give the same bytes. Raises `BadInput` for an
    unknown kind, a negative peak, a mouth of too few points, and a peak for which no field without folds is found.
    Ours.
    """
    if kind not in WARP_KINDS:
        raise BadInput(f"there is no warp of kind {kind!r}: choose one of {', '.join(WARP_KINDS)}")
    if not peak_px >= 0:
        raise BadInput(f"a peak of {peak_px} px is no length: give 0 or more")
    if len(marks.mouth) < LINE_POINTS or np.any(np.diff(marks.mouth[:, 0]) <= 0):
        raise BadInput(f"the line between the lips needs {LINE_POINTS} points or more, from left to right")
    rng = np.random.default_rng([seed, int(kind == "mouth")])
    camera = _Camera.of(photograph, marks, size)
    field, truth = _drawn_field(camera, marks, kind == "mouth", peak_px, rng)
    fine_x, fine_y = _grid(size * FINE)
    fine_x, fine_y = (fine_x + 0.5) / FINE - 0.5, (fine_y + 0.5) / FINE - 0.5
    frame = _frame(camera, field, fine_x, fine_y, rng)
    if kind == "lit":
        frame = _relit(frame, np.random.default_rng([seed, 2]))  # the skin moves as for "smooth"
    truth = truth.astype(np.float32)
    return FlowPair(
        name=name,
        reference=_rounded(_averaged(camera.look(fine_x, fine_y))),
        frame=_rounded(frame),
        truth=truth,
        visible=stays_inside(truth, size, size),
    )


def astronaut_face() -> tuple[Image, FaceMarks]:
    """Return the photograph that comes with scikit-image (Eileen Collins; NASA, public domain), and its marks."""
    mouth = [(203.5, 140.5), (212.0, 144.0), (220.0, 146.0), (228.0, 146.0), (237.0, 144.0), (245.5, 140.5)]
    photograph = skimage.data.astronaut().astype(np.float32) / 255
    return photograph, FaceMarks((202.75, 101.25), (247.5, 102.75), np.array(mouth), side_px=200.0)


EYE_LEVEL = 0.38  # of the picture's height, where the eyes stand


@dataclass(frozen=True, eq=False)
class _Camera:
    """A view of a square of a photograph: picture px to photograph px and back. `scale` (2,) photograph px a px."""

    photograph: Image
    corner: AnyArray
    scale: AnyArray
    size: int

    @staticmethod
    def of(photograph: Image, marks: FaceMarks, size: int) -> _Camera:
        between = (np.array(marks.right_eye) + marks.left_eye) / 2 + 0.5
        corner = between - marks.side_px * np.array([0.5, EYE_LEVEL])
        height, width = photograph.shape[:2]
        shrink = size * FINE / marks.side_px
        ratio = np.ones(2)
        if shrink < 1:  # average now, or fine detail would alias
            smaller = max(1, round(width * shrink)), max(1, round(height * shrink))
            photograph = cv2.resize(photograph, smaller, interpolation=cv2.INTER_AREA)
            ratio = np.array(smaller) / (width, height)
        return _Camera(photograph, corner * ratio, marks.side_px / size * ratio, size)

    def look(self, x: AnyArray, y: AnyArray) -> Image:
        """Return the photograph's colours at points of the picture, (h, w, 3)."""
        there_x = self.corner[0] + (x + 0.5) * self.scale[0] - 0.5
        there_y = self.corner[1] + (y + 0.5) * self.scale[1] - 0.5
        return warp.sample_at(self.photograph, there_x.astype(np.float32), there_y.astype(np.float32))

    def picture_points(self, marks: FaceMarks, points: Sequence[tuple[float, float]] | Points) -> Points:
        """Move points of the photograph as it was given to the picture, (m, 2) px."""
        original = marks.side_px / self.size
        corner = self.corner / self.scale * original
        return (np.asarray(points, np.float64) + 0.5 - corner) / original - 0.5


@dataclass(frozen=True, eq=False)
class _Field:
    """The formula of a field: bumps (m,), and a mouth that opens by `opening` px.

    The line between the lips is a cubic in `across`, which is -1 and 1 at its corners.
    """

    centres: Points
    sds: AnyArray
    amounts: AnyArray  # (m, 2) px
    line: AnyArray
    middle: float
    half_width: float
    opening: float
    size: int

    def scaled(self, factor: float) -> _Field:
        return replace(self, amounts=self.amounts * factor, opening=self.opening * factor)

    @cached_property
    def slope(self) -> AnyArray:
        return np.polyder(self.line)

    def across(self, x: AnyArray) -> AnyArray:
        return (x - self.middle) / self.half_width

    def below(self, x: AnyArray, y: AnyArray) -> AnyArray:
        """How far points lie below the line, px."""
        return y - np.polyval(self.line, np.clip(self.across(x), -1, 1))

    def is_lower(self, x: AnyArray, y: AnyArray) -> AnyArray:
        """Which points belong to the lower sheet; beside the mouth the two are one."""
        return (self.below(x, y) > 0) & (np.abs(self.across(x)) < 1)

    def at(self, x: AnyArray, y: AnyArray, sheet: Literal["upper", "lower"]) -> tuple[AnyArray, AnyArray]:
        """Return u (2, ...) and its derivatives (2, 2, ...), [component, axis], on one sheet and beyond it."""
        u = np.zeros((2, *x.shape))
        slope = np.zeros((2, 2, *x.shape))
        for (cx, cy), sd, amount in zip(self.centres, self.sds, self.amounts, strict=True):
            away = (x - cx) / sd, (y - cy) / sd
            height = np.exp(-0.5 * (away[0] ** 2 + away[1] ** 2))
            for i in (0, 1):
                u[i] += amount[i] * height
                for j in (0, 1):
                    slope[i, j] -= amount[i] / sd * away[j] * height
        if self.opening:
            t = np.clip(self.across(x), -1, 1)
            part, part_slope = (1 - t * t) ** 2, -4 * t * (1 - t * t) / self.half_width
            far = self.below(x, y)
            on_skin = far if sheet == "lower" else -far
            sd = (JAW_SD if sheet == "lower" else LIP_SD) * self.size
            reach = np.clip(on_skin, 0, None)
            going_along = np.exp(-0.5 * (reach / sd) ** 2)
            amount = self.opening if sheet == "lower" else -LIFT * self.opening
            by_far = -reach / sd**2 * going_along * (1 if sheet == "lower" else -1)
            far_by_x = -np.polyval(self.slope, t) / self.half_width * (np.abs(t) < 1)
            u[1] += amount * part * going_along
            slope[1, 0] += amount * (part_slope * going_along + part * by_far * far_by_x)
            slope[1, 1] += amount * part * by_far
        return u, slope

    def on_grid(self) -> tuple[AnyArray, float]:
        """Return u (h, w, 2) on the picture's grid, and the least determinant of both sheets with continuations."""
        x, y = _grid(self.size)
        upper, upper_slope = self.at(x, y, "upper")
        lower, lower_slope = self.at(x, y, "lower")
        least = min(float(_determinant(slope).min()) for slope in (upper_slope, lower_slope))
        return np.moveaxis(np.where(self.is_lower(x, y), lower, upper), 0, -1), least

    def source(self, x: AnyArray, y: AnyArray, sheet: Literal["upper", "lower"]) -> tuple[AnyArray, AnyArray]:
        """Find the points p of the sheet with p + u(p) = (x, y), by Newton's method with bounded steps."""
        px, py = x.copy(), y.copy()
        for _ in range(NEWTON_STEPS):
            u, slope = self.at(px, py, sheet)
            miss_x, miss_y = px + u[0] - x, py + u[1] - y
            if np.hypot(miss_x, miss_y).max(initial=0) < SOLVED_PX:
                return px, py
            a, b, c, d = 1 + slope[0, 0], slope[0, 1], slope[1, 0], 1 + slope[1, 1]
            area = np.maximum(a * d - b * c, 0.1)
            step_x, step_y = (d * miss_x - b * miss_y) / area, (a * miss_y - c * miss_x) / area
            short = np.minimum(1, LONGEST_STEP_PX / np.maximum(np.hypot(step_x, step_y), 1e-12))
            px -= step_x * short
            py -= step_y * short
        raise BadInput("this field could not be inverted: ask for a smaller peak or another seed")


def _drawn_field(
    camera: _Camera, marks: FaceMarks, opens: bool, peak_px: float, rng: np.random.Generator
) -> tuple[_Field, AnyArray]:
    """Draw fields until one presses nothing together too far; give it and u on the picture's grid."""
    size = camera.size
    eyes = camera.picture_points(marks, [marks.right_eye, marks.left_eye])
    mouth = camera.picture_points(marks, marks.mouth)
    between = eyes.mean(axis=0)
    unit = np.array([eyes[1, 0] - eyes[0, 0], mouth[:, 1].mean() - between[1]])
    table = np.array(BUMPS)
    middle, half_width = (mouth[0, 0] + mouth[-1, 0]) / 2, (mouth[-1, 0] - mouth[0, 0]) / 2
    line = np.polyfit((mouth[:, 0] - middle) / half_width, mouth[:, 1], 3)
    plain = _Field(
        centres=between + table[:, :2] * unit,
        sds=table[:, 2] * size,
        amounts=np.zeros((len(table), 2)),
        line=line,
        middle=middle,
        half_width=half_width,
        opening=0.0,
        size=size,
    )
    for _ in range(MOST_DRAWS):
        amounts = rng.standard_normal((len(table), 2)) * table[:, 3:]
        field = replace(plain, amounts=amounts)
        field = field.scaled(1 / _longest(field.on_grid()[0]))
        if opens:
            field = replace(field, opening=OPENING)
        field = field.scaled(peak_px / _longest(field.on_grid()[0]))
        truth, least = field.on_grid()
        if least >= LEAST_DETERMINANT:
            return field, truth
    raise BadInput(
        f"no field with a peak of {peak_px} px on {size} px stays without folds: ask for a smaller peak"
    )


def _frame(camera: _Camera, field: _Field, x: AnyArray, y: AnyArray, rng: np.random.Generator) -> Image:
    """Return the frame (size, size, 3): upper skin, else lower skin, else the inside of the mouth."""
    upper_x, upper_y = field.source(x, y, "upper")
    frame = camera.look(upper_x, upper_y)
    if field.opening:
        beyond = field.below(upper_x, upper_y)
        mouth = np.flatnonzero((beyond > -1) & (np.abs(field.across(upper_x)) < 1))
        lower_x, lower_y = (p[0] for p in field.source(x.flat[mouth][None], y.flat[mouth][None], "lower"))
        under = -field.below(lower_x, lower_y)
        inside = _mouth_inside(
            field.across(upper_x.flat[mouth]), beyond.flat[mouth] / field.size, under / field.size, rng
        )
        lower = camera.look(lower_x[None], lower_y[None])[0]
        colour = inside + _cover(-under)[:, None] * (lower - inside)
        flat = frame.reshape(-1, 3)
        flat[mouth] = colour + _cover(-beyond.flat[mouth])[:, None] * (flat[mouth] - colour)
    return _averaged(frame)


def _cover(skin_px: AnyArray) -> AnyArray:
    """Compute how much of a fine pixel the skin covers whose edge is this far, px, positive on the skin."""
    return np.clip(skin_px * FINE + 0.5, 0, 1)


def _mouth_inside(
    across: AnyArray, from_top: AnyArray, from_bottom: AnyArray, rng: np.random.Generator
) -> AnyArray:
    """Paint the inside of a mouth at points given by their place from the upper and the lower lip, (n, 3).

    `across` is -1 and 1 at the corners, the distances are shares of the picture.
    """
    teeth_reach, tongue_reach = rng.uniform(0.006, 0.028), rng.uniform(0.012, 0.04)
    bulge = np.clip(1 - across**2, 0, 1)
    colour = np.broadcast_to(np.array([0.17, 0.06, 0.06]), (*across.shape, 3)).copy()
    tongue = _edge(tongue_reach * bulge - from_bottom)[:, None]
    shade = (0.75 + 0.25 * np.clip(from_bottom / tongue_reach, 0, 1)) * (0.85 + 0.15 * np.cos(4 * across))
    colour += tongue * (np.array([0.55, 0.24, 0.23]) * shade[:, None] - colour)
    teeth = _edge(teeth_reach * bulge - from_top)[:, None]
    gaps = 1 - 0.35 * np.exp(-((np.mod(across * 4 + 0.5, 1) - 0.5) ** 2) / 0.004)
    colour += teeth * (np.array([0.80, 0.76, 0.68]) * (gaps * (0.6 + 0.4 * bulge))[:, None] - colour)
    shadow = 1 - 0.5 * np.exp(-np.clip(from_top, 0, None) / 0.008)
    return colour * shadow[:, None]


def _edge(inside_share: AnyArray) -> AnyArray:
    return np.clip(inside_share / 0.004 + 0.5, 0, 1)  # 1 px of 256


def _relit(frame: Image, rng: np.random.Generator) -> Image:
    size = frame.shape[0]
    gain = float(np.exp(rng.uniform(*np.log(GAIN_RANGE))))
    angle = rng.uniform(0, 2 * np.pi)
    x, y = _grid(size)
    along = (x / (size - 1) * 2 - 1) * np.cos(angle) + (y / (size - 1) * 2 - 1) * np.sin(angle)
    ramp = 1 + RAMP * along / np.abs(along).max()
    return frame * (gain * ramp)[..., None] + NOISE_SD * rng.standard_normal(frame.shape)


def _longest(field: AnyArray) -> float:
    return float(np.hypot(field[..., 0], field[..., 1]).max())


def _determinant(slope: AnyArray) -> AnyArray:
    return (1 + slope[0, 0]) * (1 + slope[1, 1]) - slope[0, 1] * slope[1, 0]


def _grid(size: int) -> tuple[AnyArray, AnyArray]:
    y, x = np.mgrid[:size, :size].astype(np.float64)
    return x, y


def _averaged(fine: Image) -> Image:
    height, width = fine.shape[0] // FINE, fine.shape[1] // FINE
    return np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA))


def _rounded(image: AnyArray) -> Image:
    """Return the 8-bit codes nearest to an image, as shares of 255, float32."""
    return (np.round(np.clip(image, 0, 1) * 255) / 255).astype(np.float32)
