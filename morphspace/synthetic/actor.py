"""Put a face together and photograph it: skin over eyeballs and mouth, with the truth of every frame.

A frame is made backwards: for each of its pixels (twice as fine, then averaged) the place on the neutral
canvas that is seen there is found, on either side of the slits, and the painted skin is looked up. The truth
is forwards: it is the very field that was inverted. Ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from morphspace.arrays import Affine, AnyArray, Displacement, Image, Mask, Points
from morphspace.errors import BadInput
from morphspace.synthetic.creases import crease_boxes, creased
from morphspace.synthetic.fields import SEAM, Box, basis_amounts, basis_boxes, combine
from morphspace.synthetic.geometry import FaceGeometry
from morphspace.synthetic.interior import BACK_TO_FRONT, Interior, layer_shifts
from morphspace.synthetic.inverse import at_points, grid_px, inverse_like, inverse_of, padded, sample_linear
from morphspace.synthetic.painting import FINE, LABELS
from morphspace.synthetic.parameters import Capture, Expression, Identity

FAR = 40.0  # px: the signed distance written where there is no slit
CORNER_PX = 1.0
SAME_PX = 0.75  # two looks at the sheet closer than this show the same skin
NEUTRAL = Expression()
PLAIN = Capture()


@dataclass(frozen=True, eq=False)
class ActorFrame:
    """One frame of an actor, with its truth. Ours.

    `displacement` (h, w, 2) px on the neutral picture's grid, head motion included: the point p of the
    neutral picture is found in the frame at p + u(p). `visibility` (h, w) is 1 where that point is seen in
    the frame, 0 where it is covered or outside. `keypoints` (m, 2) px in the frame, named by
    `keypoint_names`. `faceframe` (3, 2) px in the frame: middle of the right eye, of the left eye, and of the
    philtrum. `head_motion` (2, 3) is the rigid part.
    """

    image: Image
    displacement: Displacement
    visibility: Mask
    keypoints: Points
    keypoint_names: tuple[str, ...]
    faceframe: Points
    head_motion: Affine
    identity: Identity | None
    expression: Expression
    capture: Capture


@dataclass(frozen=True, eq=False)
class Actor:
    """A painted or photographed face that can be moved. Ours.

    Fine layers have `FINE` texture pixels per picture pixel; `margin` px are painted around the picture on
    each side, so that head motion has something to bring in. `above` and `below` (fine) are signed distances
    in px to the upper and the lower margin of the slits, positive on the skin. `labels` (h, w) uint8 of the
    picture.
    """

    size: tuple[int, int]
    margin: int
    geometry: FaceGeometry
    skin: AnyArray
    above: AnyArray
    below: AnyArray
    creases: AnyArray
    basis: AnyArray
    interior: Interior
    labels: AnyArray
    identity: Identity | None

    def draw(self, expression: Expression = NEUTRAL, capture: Capture = PLAIN) -> ActorFrame:
        """Photograph the actor with an expression; the truth is relative to the neutral face. Ours."""
        upper, lower = self.sheets(expression)
        back = inverse_of(upper)
        seen = _Seen(self, back, inverse_like(lower, upper, back))
        motion = head_motion(capture, self._pivot())
        image = _exposed(self._render(expression, capture, seen, motion), capture)
        displacement, visibility = self._truth(expression, upper, lower, seen, motion)
        names, points = self._keypoints(expression, upper, lower, motion)
        return ActorFrame(
            image=image,
            displacement=displacement,
            visibility=visibility,
            keypoints=points,
            keypoint_names=names,
            faceframe=_faceframe(names, points),
            head_motion=motion,
            identity=self.identity,
            expression=expression,
            capture=capture,
        )

    def sheets(self, expression: Expression) -> tuple[Displacement, Displacement]:
        """Return the displacement (px) of the skin above and below the slits, on the whole canvas. Ours."""
        return combine(self.basis, self.basis_boxes, basis_amounts(expression))

    @cached_property
    def basis_boxes(self) -> tuple[Box, ...]:
        """Where each basis field is not zero."""
        return basis_boxes(self.basis)

    @cached_property
    def crease_boxes(self) -> tuple[Box, ...]:
        """Where each crease can be seen."""
        return crease_boxes(self.creases)

    @cached_property
    def sides(self) -> tuple[AnyArray, AnyArray]:
        """Which pixels of the neutral picture are upper and which lower skin, each (h, w) bool."""
        x, y = grid_px(*self.size)
        x, y = x + self.margin, y + self.margin
        return look_up(self.above, x, y) >= 0, look_up(self.below, x, y) >= 0

    def _pivot(self) -> Points:
        return np.asarray(self.geometry.to_px(np.array([[0.0, 0.1]]))[0] - self.margin)

    def _render(self, expression: Expression, capture: Capture, seen: _Seen, motion: Affine) -> Image:
        width, height = self.size
        x, y = grid_px(width * FINE, height * FINE)
        back = cv2.invertAffineTransform(motion)
        x, y = (x + 0.5) / FINE - 0.5, (y + 0.5) / FINE - 0.5
        qx = (back[0, 0] * x + back[0, 1] * y + back[0, 2] + self.margin).astype(np.float32)
        qy = (back[1, 0] * x + back[1, 1] * y + back[1, 2] + self.margin).astype(np.float32)
        skin = creased(self.skin, self.creases, self.crease_boxes, expression, capture.crease_gain)
        upper, above = seen.upper_skin(skin, qx, qy)
        frame = upper
        for box in seen.boxes(motion):
            rows, columns = box
            bx, by = qx[box], qy[box]
            lower, below = seen.lower_skin(skin, bx, by)
            cover = above[box]
            behind = self._behind(expression, bx, by, cover)
            mixed = behind + (lower - behind) * coverage(below)[..., None]
            frame[rows, columns] = mixed + (frame[rows, columns] - mixed) * coverage(cover)[..., None]
        return np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA))

    def _behind(self, expression: Expression, x: AnyArray, y: AnyArray, above: AnyArray) -> AnyArray:
        """Draw what lies behind the skin at canvas points, in the shadow of the upper lid or lip."""
        shifts = layer_shifts(expression, self.geometry.unit_px)
        eyes = y.mean() < self._seam_px()
        colour = look_up(self.interior.sclera if eyes else self.interior.cavity, x, y)
        for name in BACK_TO_FRONT[:2] if eyes else BACK_TO_FRONT[2:]:
            dx, dy = shifts[name]
            layer = look_up(self.interior.layer(name), x - np.float32(dx), y - np.float32(dy))
            colour = colour * (1 - layer[..., 3:]) + layer[..., :3]
        deep = self.interior.lid_shadow if eyes else self.interior.lip_shadow
        reach = self.geometry.unit_px * (0.035 if eyes else 0.045)
        shadow = 1 - deep * np.exp(-np.clip(-above, 0, None) / reach)
        return np.asarray(colour * shadow[..., None])

    def _seam_px(self) -> float:
        return float(self.geometry.origin_px[1] + np.mean(SEAM) * self.geometry.unit_px)

    def _truth(
        self, expression: Expression, upper: Displacement, lower: Displacement, seen: _Seen, motion: Affine
    ) -> tuple[Displacement, Mask]:
        width, height = self.size
        inner = (slice(self.margin, self.margin + height), slice(self.margin, self.margin + width))
        x, y = grid_px(width, height)
        cx, cy = x + self.margin, y + self.margin
        on_upper, on_lower = self.sides
        field = np.where(on_upper[..., None], upper[inner], lower[inner])
        inside = ~on_upper & ~on_lower
        field[inside] = 0.0
        covered = np.zeros(inside.shape, bool)
        for eyes in (True, False):
            slit = inside & (eyes == (cy < self._seam_px()))
            shift, hidden = self._truth_inside(expression, cx[slit], cy[slit], eyes)
            field[slit], covered[slit] = shift, hidden
        fx, fy = cx + field[..., 0], cy + field[..., 1]
        over_x, over_y, over = seen.upper_at(fx, fy)
        shown = np.hypot(over_x - cx, over_y - cy) < SAME_PX
        rest = ~on_upper
        under_x, under_y, under = (part[:, 0] for part in seen.lower_at(fx[rest, None], fy[rest, None]))
        free = over[rest] < 0
        same = np.hypot(under_x - cx[rest], under_y - cy[rest]) < SAME_PX
        shown[rest] = np.where(inside[rest], free & (under < 0) & ~covered[rest], same & (free | shown[rest]))
        px, py = fx - self.margin, fy - self.margin
        out_x = motion[0, 0] * px + motion[0, 1] * py + motion[0, 2]
        out_y = motion[1, 0] * px + motion[1, 1] * py + motion[1, 2]
        shown &= (out_x > -0.5) & (out_x < width - 0.5) & (out_y > -0.5) & (out_y < height - 0.5)
        total = np.stack([out_x - x, out_y - y], axis=2)
        return total.astype(np.float32), shown.astype(np.float32)

    def _truth_inside(
        self, expression: Expression, x: AnyArray, y: AnyArray, eyes: bool
    ) -> tuple[AnyArray, AnyArray]:
        """Compute how far points seen through a slit at rest move, and which of them get covered."""
        shifts = layer_shifts(expression, self.geometry.unit_px)
        names = BACK_TO_FRONT[:2] if eyes else BACK_TO_FRONT[2:]
        shift = np.zeros((x.size, 2), np.float32)
        order = np.full(x.size, -1)
        for k, name in enumerate(names):
            mine = self._layer_covers(name, x, y)
            shift[mine], order[mine] = shifts[name], k
        hidden = np.zeros(x.size, bool)
        for k, name in enumerate(names):
            moved = (
                x + shift[:, 0] - np.float32(shifts[name][0]),
                y + shift[:, 1] - np.float32(shifts[name][1]),
            )
            hidden |= (order < k) & self._layer_covers(name, *moved)
        return shift, hidden

    def _layer_covers(self, name: str, x: AnyArray, y: AnyArray) -> AnyArray:
        if x.size == 0:
            return np.zeros(0, bool)
        return np.asarray(look_up(self.interior.layer(name), x[:, None], y[:, None])[:, 0, 3] > 0.5)

    def _keypoints(
        self, expression: Expression, upper: Displacement, lower: Displacement, motion: Affine
    ) -> tuple[tuple[str, ...], Points]:
        named = self.geometry.keypoints()
        shifts = layer_shifts(expression, self.geometry.unit_px)
        rest = self.geometry.to_px(np.array([place for place, _ in named.values()]))
        shift = {"upper": at_points(upper, rest), "lower": at_points(lower, rest)}
        shift |= {name: np.broadcast_to(shifts[name], rest.shape) for name in BACK_TO_FRONT}
        moved = rest + [shift[layer][k] for k, (_, layer) in enumerate(named.values())]
        moved -= self.margin
        return tuple(named), moved @ motion[:, :2].T + motion[:, 2]


class _Seen:
    """The point of the neutral canvas that is visible at each point of the moved canvas."""

    def __init__(self, actor: Actor, upper: Displacement, lower: Displacement) -> None:
        self.actor = actor
        self.upper = padded(upper)
        self.lower = padded(lower)

    def upper_at(self, x: AnyArray, y: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Return the place on the upper sheet seen at canvas points, and its signed distance to the slit."""
        return _seen_at(self.upper, self.actor.above, x, y)

    def lower_at(self, x: AnyArray, y: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
        """Return the same for the lower sheet."""
        return _seen_at(self.lower, self.actor.below, x, y)

    def upper_skin(self, skin: AnyArray, x: AnyArray, y: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return the colour of the upper sheet at canvas points, and the signed distance to the slit."""
        px, py, distance = self.upper_at(x, y)
        return look_up_sharp(skin, px, py), distance

    def lower_skin(self, skin: AnyArray, x: AnyArray, y: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Return the same for the lower sheet."""
        px, py, distance = self.lower_at(x, y)
        return look_up_sharp(skin, px, py), distance

    def boxes(self, motion: Affine) -> list[tuple[slice, slice]]:
        """Return the parts of the fine frame in which a slit's lower side can be seen."""
        face, (width, height) = self.actor.geometry, self.actor.size
        out = []
        seam = float(np.mean(SEAM))
        for left, top, right, bottom in (
            (face.right_eye.left[0] - 0.08, -0.5, face.right_eye.right[0] + 0.08, seam),
            (face.left_eye.left[0] - 0.08, -0.5, face.left_eye.right[0] + 0.08, seam),
            (face.mouth.left[0] - 0.2, seam, face.mouth.right[0] + 0.2, 9.0),
        ):
            corners = np.array([(left, top), (right, top), (left, bottom), (right, bottom)])
            corners = face.to_px(corners) - self.actor.margin
            corners = (corners @ motion[:, :2].T + motion[:, 2] + 0.5) * FINE
            low = np.clip(np.floor(corners.min(0)).astype(int) - 2, 0, None)
            high = np.ceil(corners.max(0)).astype(int) + 2
            columns = slice(int(low[0]), int(min(high[0], width * FINE)))
            rows = slice(int(low[1]), int(min(high[1], height * FINE)))
            if columns.start < columns.stop and rows.start < rows.stop:
                out.append((rows, columns))
        return out


def _seen_at(
    inverse: AnyArray, signed: AnyArray, x: AnyArray, y: AnyArray
) -> tuple[AnyArray, AnyArray, AnyArray]:
    vx, vy, _ = cv2.split(sample_linear(inverse, x, y))
    px, py = x + vx, y + vy
    return px, py, look_up(signed, px, py)


def look_up(fine: AnyArray, x: AnyArray, y: AnyArray) -> AnyArray:
    """Look a fine layer up at canvas points (px), bilinear."""
    return sample_linear(
        fine, x * FINE + np.float32(0.5 * (FINE - 1)), y * FINE + np.float32(0.5 * (FINE - 1))
    )


def look_up_sharp(fine: AnyArray, x: AnyArray, y: AnyArray) -> AnyArray:
    """Look a fine layer up at canvas points (px), bicubic."""
    shift = np.float32(0.5 * (FINE - 1))
    return np.asarray(
        cv2.remap(fine, x * FINE + shift, y * FINE + shift, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    )


def coverage(signed_px: AnyArray) -> AnyArray:
    """Turn a signed distance (px, positive on the skin) into the skin's coverage, one fine pixel soft."""
    return np.clip(signed_px * FINE + 0.5, 0.0, 1.0)


def slit_distances(face: FaceGeometry, width: int, height: int) -> tuple[AnyArray, AnyArray]:
    """Return the signed distances (px, fine canvas) above the upper and below the lower margins of the slits.

    Both are `FAR` where a sheet meets no slit. Just beyond a slit's corner, where a sheet's pixels still
    neighbour its hidden part, either sheet ends on its own side, and they overlap by `CORNER_PX`. Between the
    eyes' slits and the mouth's, within `SEAM`, both sheets are skin.
    """
    x, y = face.grid(width, height, FINE)
    above = np.full(x.shape, FAR, np.float32)
    below = np.full(x.shape, FAR, np.float32)
    for slit in (face.right_eye, face.left_eye, face.mouth):
        upper, lower = slit.upper(x), slit.lower(x)
        step = float(x[0, 1] - x[0, 0])
        steep_up = np.sqrt(1 + (np.gradient(upper, axis=1) / step) ** 2)
        steep_low = np.sqrt(1 + (np.gradient(lower, axis=1) / step) ** 2)
        t = np.abs(slit.along(x))
        beyond = np.where(t < 1, 0.0, CORNER_PX / face.unit_px)
        near = t < 1 + 2 * CORNER_PX / (slit.half_width * face.unit_px)
        near &= (y > SEAM[1]) if slit is face.mouth else (y < SEAM[0])
        above = np.where(near, (upper + beyond - y) / steep_up * face.unit_px, above)
        below = np.where(near, (y - lower + beyond) / steep_low * face.unit_px, below)
    return np.clip(above, -FAR, FAR).astype(np.float32), np.clip(below, -FAR, FAR).astype(np.float32)


def head_motion(capture: Capture, pivot: Points) -> Affine:
    """Return the similarity (2, 3) px of a capture: turn and grow about the pivot, then move."""
    angle = np.deg2rad(capture.roll_deg)
    cos, sin = capture.zoom * np.cos(angle), capture.zoom * np.sin(angle)
    linear = np.array([[cos, -sin], [sin, cos]])
    shift = pivot - linear @ pivot + (capture.shift_x_px, capture.shift_y_px)
    return np.concatenate([linear, shift[:, None]], axis=1)


def _exposed(image: Image, capture: Capture) -> Image:
    height, width = image.shape[:2]
    across = np.linspace(-0.5, 0.5, width)[None, :, None]
    down = np.linspace(-0.5, 0.5, height)[:, None, None]
    light = capture.gain * (1 + capture.gradient_x * across + capture.gradient_y * down)
    image = (image * light).astype(np.float32)
    if capture.noise_sd > 0:
        noise = np.random.default_rng(capture.noise_seed).standard_normal(image.shape, dtype=np.float32)
        image = image + np.float32(capture.noise_sd) * noise
    return np.clip(image, 0.0, 1.0).astype(np.float32)


def _faceframe(names: tuple[str, ...], points: Points) -> Points:
    def middle(*wanted: str) -> Points:
        return np.asarray(np.mean([points[names.index(name)] for name in wanted], axis=0))

    return np.stack(
        [
            middle("right_eye_inner", "right_eye_outer"),
            middle("left_eye_inner", "left_eye_outer"),
            middle("philtrum"),
        ]
    )


def picture_labels(
    fine_labels: AnyArray, size: tuple[int, int], margin: int, above: AnyArray, below: AnyArray, seam: float
) -> AnyArray:
    """Reduce fine labels to the picture's grid and mark what is seen through the slits, (h, w) uint8."""
    width, height = size
    x, y = grid_px(width, height)
    x, y = x + margin, y + margin
    labels = fine_labels[
        margin * FINE : (margin + height) * FINE : FINE, margin * FINE : (margin + width) * FINE : FINE
    ].copy()
    inside = (look_up(above, x, y) < 0) & (look_up(below, x, y) < 0)
    labels[inside & (y < seam)] = LABELS.index("eye")
    labels[inside & (y >= seam)] = LABELS.index("mouth")
    return labels


def check_size(size: tuple[int, int]) -> None:
    """Raise `BadInput` for a picture too small to hold a face."""
    if min(size) < 48:
        raise BadInput(
            f"a picture of {size[0]} x {size[1]} px is too small for a face: give at least 48 x 48"
        )
