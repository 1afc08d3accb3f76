"""Registration of two pictures with large displacements by multiscale gradient flow, for the morphs (ours).

From the coarsest scale to the finest, the frame is sampled at the present field. Every derivative channel then gives
the remaining displacement in px (`constraints`). The field takes the step that fits all channels and its neighbours
best: robust least squares by a few rounds of the alternating direction method of multipliers. Each round solves a 2 x
2 system at each pixel and smooths the whole field along edges. Between the warps a pixel may take over the motion of
a start, and with some presets that of a nearby pixel, if the pictures match better there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import cv2
import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.flow import Flow, FlowFunction, FlowMethod
from morphspace.flow.backends import Backend, OpenCVBackend, Planes
from morphspace.flow.constraints import (
    Appearance,
    Channels,
    Derivatives,
    Tensor,
    appearance,
    half_derivatives,
    mismatch,
    of_order,
    outside,
    tensor,
)
from morphspace.flow.filters import bell
from morphspace.flow.folds import suspects_when_enlarged, unfolded
from morphspace.flow.pairs import checked_frame, checked_picture, checked_start, unknown_flow
from morphspace.flow.presets import Preset
from morphspace.flow.pyramid import colour_planes, is_flat, pyramid, shift_between
from morphspace.steps import check_awaited

COARSE_PX = 160  # px, longer side up to which raw values lead: lips are a few px there
START_PX = 140  # px, longer side up to which a start is tried; at the coarsest scale it always is
SURROUNDINGS_PX = 1.5  # px, SD of the neighbourhood in which a rival is judged
RIVAL_RATIO = 0.9  # a rival's misfit must be below this share of the field's, and
RIVAL_GAIN_PX = 0.05  # px below that: equal rivals would add noise
INVERSE_STEPS = 4  # fixed-point steps to the first estimate of the backward flow, which is then refined
WARPS_BACK = 1  # warps that refine this estimate, at least 1; ten change a confidence by a tenth
LEAST_CONTRAST = 0.02  # sum of a pixel's channels, of their weights, at which confidence is a half
MISSED_PX = 4.0  # px of forward-backward error at which confidence is a half
UNLIKE_PX = 0.7  # px, RMS misfit of the channels likewise; unrelated textures have a pixel and more


@dataclass(frozen=True, eq=False)
class ReferenceLevel:
    """One scale of the reference, computed once for all frames."""

    planes: Planes
    derivatives: Derivatives
    appearance: Callable[[], Appearance]
    smooth: Callable[[Planes], Planes]
    x: Planes
    y: Planes


def method(preset: Preset, backend: Backend | None = None) -> FlowMethod:
    """Return the estimator as a flow method; on OpenCV by default.

    References
    ----------
    Johnston, McOwan and Benton, Proc. R. Soc. B 266, 1999 (the constraints); the solver is ours (docs/methods.md,
    section 4).
    """
    return lambda reference: _matcher(reference, preset, backend or OpenCVBackend())


def _matcher(reference: Image, preset: Preset, backend: Backend) -> FlowFunction:
    """Prepare a reference for the flow to any number of frames.

    Parameters
    ----------
    reference : array (h, w, 3)
    preset : Preset
    backend : Backend

    Returns
    -------
    FlowFunction
        The flow from the reference to a frame.

    Raises
    ------
    BadInput
        If the reference cannot be used (`pairs.checked_picture`).

    References
    ----------
    Ours. The channels are those of the Multi-channel Gradient Model (Johnston, McOwan and Benton, 1999); see
    `constraints`.
    """
    reference = checked_picture(reference, "the reference")
    height, width = reference.shape[:2]
    planes = colour_planes(reference, preset)
    empty = is_flat(planes)
    scales, centre = pyramid(planes, preset)
    levels = [
        _reference_level(
            backend.planes(scaled),
            preset,
            backend,
            _smoother(backend.planes(scaled + centre), preset, backend),
        )
        for scaled in scales
    ]

    def to_frame(frame: Image, start: Displacement | None = None) -> Flow:
        frame = checked_frame(reference, frame)
        planes = colour_planes(frame, preset)
        if empty or is_flat(planes):
            return unknown_flow(height, width)
        found_scales, _ = pyramid(planes, preset)
        target = [backend.planes(scaled) for scaled in found_scales]
        given, first = None, None
        if start is not None:
            given = backend.planes(checked_start(start, height, width).transpose(2, 0, 1))
        else:
            shift = shift_between(scales[-1], found_scales[-1])
            first = None if shift is None else backend.planes(shift)
        field, confidence = _matched(levels, target, preset, backend, given, first)
        found = backend.numpy(field)
        if found.shape[1:] == (height, width):
            displacement = unfolded(cv2.merge(tuple(found)))
        else:
            suspects = suspects_when_enlarged(found, height, width)
            displacement = cv2.merge(tuple(backend.numpy(_resized_field(field, height, width, backend))))
            displacement = unfolded(displacement, suspects) if suspects else displacement
        confidence = backend.resized_linearly(confidence[None].clip(0, 1), height, width)
        return Flow(displacement, backend.numpy(confidence)[0])

    return to_frame


def _smoother(guide: Planes, preset: Preset, backend: Backend) -> Callable[[Planes], Planes]:
    """Return the smoother of a scale: at small scales the recursive one, which prepares less."""
    small = max(guide.shape[1:]) <= preset.recursive_px
    make = backend.recursive_smoother if small else backend.smoother
    return make(guide, preset.strength, preset.edge_codes)


def _reference_level(
    planes: Planes, preset: Preset, backend: Backend, smooth: Callable[[Planes], Planes]
) -> ReferenceLevel:
    height, width = planes.shape[1:]
    derivatives = half_derivatives(backend, planes, preset.channels)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return ReferenceLevel(
        planes=planes,
        derivatives=derivatives,
        appearance=cache(
            partial(appearance, backend, derivatives, preset.channels)
        ),  # computed only if rivals are tried
        smooth=smooth,
        x=backend.planes(x),
        y=backend.planes(y),
    )


def _matched(
    levels: Sequence[ReferenceLevel],
    target: Sequence[Planes],
    preset: Preset,
    backend: Backend,
    start: Planes | None,
    first: Planes | None,
) -> tuple[Planes, Planes]:
    """Compute the field at the finest level and its confidence (h, w): likeness times agreement with the backward flow.

    `start` is a field of any size that pixels may take over; `first` is the initial field of the coarsest level.
    """
    sizes = [max(level.planes.shape[1:]) for level in levels]
    coarsest = len(levels) - (1 if preset.checked_px else 0)  # no level of a long strip may be small enough
    checked = next((n for n, size in enumerate(sizes) if size <= preset.checked_px), coarsest)
    field: Any = first
    trust: Any = None
    alike: Any = None
    if checked < len(levels):
        field, alike = _descend(levels, target, len(levels), checked, field, start, preset, backend)
        trust = _trust(levels[checked], target[checked], field, sizes[0] / sizes[checked], preset, backend)
    if checked > 0:
        field, alike = _descend(levels, target, min(checked, len(levels)), 0, field, start, preset, backend)
    confidence = alike()
    if trust is not None:
        height, width = field.shape[1:]
        confidence = confidence * backend.resized_linearly(trust[None], height, width)[0]
    return field, confidence


def _trust(
    level: ReferenceLevel, target: Planes, field: Planes, px: float, preset: Preset, backend: Backend
) -> Planes:
    """Compute how well the backward flow cancels the field at each pixel, (h, w), 1 for full agreement.

    The backward flow starts from the field's inverse and is refined without smoothing. `px` is the size of a pixel of
    this level in pixels of the finest level.
    """
    back_level = _reference_level(target, preset, backend, lambda planes: planes)
    back = -field
    for _ in range(INVERSE_STEPS):
        back = -backend.looked_up(field, level.x + back[0], level.y + back[1])
    back, _ = _refined(back_level, level.planes, back, None, WARPS_BACK, preset.rounds[-1], preset, backend)
    missed = px * (field + backend.looked_up(back, level.x + field[0], level.y + field[1]))
    return 1 / (1 + ((missed * missed).sum(0) / MISSED_PX**2) ** 2)


def _descend(
    levels: Sequence[ReferenceLevel],
    target: Sequence[Planes],
    above: int,
    last: int,
    field: Planes | None,
    start: Planes | None,
    preset: Preset,
    backend: Backend,
) -> tuple[Planes, Callable[[], Planes]]:
    """Refine a field through the levels below number `above`, coarsest first, down to `last`.

    Returns the field and the function that computes the likeness of the pictures (`_likeness`).
    """
    alike: Any = None
    for number in reversed(range(last, above)):
        level = levels[number]
        height, width = level.planes.shape[1:]
        if field is not None:
            field = _resized_field(field, height, width, backend)
        rival = None if start is None else _resized_field(start, height, width, backend)
        coarsest = number == len(levels) - 1
        between = max(0, len(preset.warps) - 2)
        warps = preset.warps[-1] if coarsest else preset.warps[min(number, between)]
        rounds = preset.rounds[min(number, len(preset.rounds) - 1)]
        if not coarsest and max(height, width) > START_PX:
            rival = None
        field, alike = _refined(level, target[number], field, rival, warps, rounds, preset, backend)
    return field, alike


def _resized_field(field: Planes, height: int, width: int, backend: Backend) -> Planes:
    old_height, old_width = field.shape[1:]
    if (old_height, old_width) == (height, width):
        return field
    longer = backend.planes(np.array([[[width / old_width]], [[height / old_height]]]))
    return backend.resized_linearly(field * longer, height, width)


def _refined(
    level: ReferenceLevel,
    target: Planes,
    field: Planes | None,
    start: Planes | None,
    warps: int,
    rounds: int,
    preset: Preset,
    backend: Backend,
) -> tuple[Planes, Callable[[], Planes]]:
    """Refine a field (None for zero) at one scale; return it and the function of its likeness."""
    xp = backend.xp
    read = backend.sampler(target)
    dual = None
    is_zero = field is None  # the frame needs no sampling
    height, width = target.shape[1:]
    if field is None:
        field = backend.zeros(2, height, width)
    channels = preset.coarse_channels if max(height, width) <= COARSE_PX else preset.channels
    rivalled = start is not None or max(height, width) <= preset.rivals_px
    warps = max(warps, 1 if start is None else 2)  # a rival is compared with a field refined at this scale
    for number in range(warps):
        check_awaited()
        if number == min(1, warps - 1) and rivalled:
            slopes = half_derivatives(backend, target, preset.slope_channels)[of_order(1)]
            field = _with_rivals(level, slopes, field, start, preset, backend)
            is_zero = False
        x, y = level.x + field[0], level.y + field[1]
        warped = half_derivatives(backend, target if is_zero else read(x, y), preset.channels)
        constraint = tensor(backend, level.derivatives, warped, channels, tuple(target.shape))
        seen = xp.where(outside(x, y, height, width), 0.0, xp.ones_like(x))
        moved, dual = _step(level, constraint, seen, field, dual, rounds, preset, backend)
        change, field = moved - field, backend.median(moved)
        is_zero = False
    return field, partial(_likeness, constraint, change, seen, channels, backend)


def _step(
    level: ReferenceLevel,
    constraint: Tensor,
    seen: Planes,
    field: Planes,
    dual: Planes | None,
    rounds: int,
    preset: Preset,
    backend: Backend,
) -> tuple[Planes, Planes]:
    """Move the field to the optimum of the robust constraints and the smoothness.

    Without a dual the field comes from a coarser scale and is already smooth: the first round does not smooth it.
    """
    moved = field
    blur = bell(preset.integration_px) if preset.integration_px else None
    for number in range(rounds):
        check_awaited()
        weighted = _robust(constraint, seen, moved - field if number > 0 else None, preset, backend)
        if blur is not None:
            weighted = backend.filtered(weighted, blur, blur)
        if dual is None:
            smooth = dual = backend.zeros(*field.shape)
        else:
            leant = moved + dual
            smooth = _smoothed(level, leant, preset)
            dual = leant - smooth
            smooth -= dual
            smooth -= field
        moved = field + _solved(weighted, smooth, preset.coupling, backend)
    return moved, dual


def _robust(
    constraint: Tensor, seen: Planes, change: Planes | None, preset: Preset, backend: Backend
) -> Planes:
    """Weight the first five sums, (5, h, w), by the channels' fit at a change (2, h, w) of the field; None is 0."""
    xp = backend.xp
    out = xp.empty_like(constraint.sums[:5])
    for rows in backend.strips(*seen.shape):
        part = Tensor(constraint.sums[:, rows])
        off = part.sums[5] if change is None else part.residual(*change[:, rows])
        trust = abs(off)  # rounding can make it slightly negative
        trust += preset.robust_px**2
        trust = seen[rows] / xp.sqrt(trust)
        xp.multiply(trust, part.sums[:5], out=out[:, rows])
    return out


def _solved(weighted: Planes, smooth: Planes, coupling: float, backend: Backend) -> Planes:
    """Solve for the change (2, h, w) from the weighted constraints and the coupling to a smooth change."""
    out = backend.xp.empty_like(smooth)
    for rows in backend.strips(*smooth.shape[1:]):
        a, b, c, right, down = weighted[:, rows]
        a += coupling
        b += coupling
        wanted = coupling * smooth[:, rows]
        right, down = wanted[0] - right, wanted[1] - down
        out[0, rows] = b * right - c * down
        out[1, rows] = a * down - c * right
        out[:, rows] /= a * b - c * c
    return out


def _likeness(
    constraint: Tensor, change: Planes, seen: Planes, channels: Channels, backend: Backend
) -> Planes:
    """Compute how well the channels fit, (h, w), from 0 to 1.

    It is 0 for a large misfit, without contrast and outside the frame.
    """
    blur = bell(SURROUNDINGS_PX)
    xp = backend.xp
    strength = constraint.sums[0] + constraint.sums[1]
    off = constraint.residual(change[0], change[1]) / channels.total_weight
    contrast, off = backend.filtered(xp.stack([strength, off]), blur, blur)
    return seen * contrast / (contrast + LEAST_CONTRAST) / (1 + (off / UNLIKE_PX**2) ** 2)


def _smoothed(level: ReferenceLevel, field: Planes, preset: Preset) -> Planes:
    """Smooth a field once, or twice with the residual of the first time added back (Tukey's twicing).

    If S is the smoother's response to a wave, that of twicing is 1 - (1 - S)^2. The error of a slow wave is then of
    second order, as if bending were penalised instead of slope.
    """
    once = level.smooth(field)
    if preset.smoothings == 1:
        return once
    return 2 * once - level.smooth(once)


def _with_rivals(
    level: ReferenceLevel,
    slopes: Planes,
    field: Planes,
    start: Planes | None,
    preset: Preset,
    backend: Backend,
) -> Planes:
    """Let each pixel take over the start, or the motion of a nearby pixel, where the pictures match clearly better."""
    blur = bell(SURROUNDINGS_PX)
    xp = backend.xp
    looks = level.appearance()

    def judged(candidate: Planes) -> Planes:
        return mismatch(backend, looks, slopes, level.x + candidate[0], level.y + candidate[1], blur)

    least = judged(field)

    def taken_over(rival: Planes, field: Planes, least: Planes) -> tuple[Planes, Planes]:
        found = judged(rival)
        better = found < RIVAL_RATIO * least - RIVAL_GAIN_PX
        return xp.where(better, rival, field), xp.where(better, found, least)

    if start is not None:
        field, least = taken_over(start, field, least)
    height, width = least.shape
    if max(height, width) > preset.rivals_px:
        return field
    step = preset.rival_step_px
    for right, down in ((0, step), (0, -step), (step, 0), (-step, 0)):
        field, least = taken_over(_moved_over(field, right, down, xp), field, least)
    return field


def _moved_over(field: Planes, right: int, down: int, xp: Any) -> Planes:
    """Shift a field so that each pixel has the value `right` and `down` from it, with the edge repeated."""
    height, width = field.shape[1:]
    rows = np.clip(np.arange(height) + down, 0, height - 1)
    columns = np.clip(np.arange(width) + right, 0, width - 1)
    return field[:, rows][:, :, columns]
