"""How well the video form of the motion model finds drifting, turning and growing patterns whose motion is known.

Every pattern is a sum of cosines, evaluated at the positions its points came from: the truth is exact, nothing is
interpolated. Errors are over all points more than `MARGIN_PX` from the edge, of the one frame that has a full window.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial

import cv2
import numpy as np
from tables import at_most, print_table, tell

from morphspace.arrays import AnyArray, Displacement
from morphspace.flow.motion import TAPS, motion

SIDE, MARGIN_PX = 112, 12
AT = 12  # the frame of a clip of 23 that has a full window
WAVES = 80
SEEDS = (0, 1, 2)
CONTRASTS = (0.05, 0.15, 0.5)
NOISE = 0.01  # of the range of the clip, about 2.5 grey levels
PEER_CONTRAST = 0.25  # low enough that no point of a texture leaves the range
RATE = 0.02  # radians, or e-folds, a frame
GRATING_GOAL, PATTERN_GOAL = (0.5, 1.0), (3.0, 1.0)  # per cent of speed, degrees
TEXTURE_GOAL = (3.0, 3.0)
CONTRAST_GOAL = 1.0  # per cent of speed over a 10 x range

Moved = Callable[[AnyArray, AnyArray, float], tuple[AnyArray, AnyArray]]
Find = Callable[[AnyArray], Displacement]
Waves = tuple[AnyArray, AnyArray, AnyArray, AnyArray]  # k_x, k_y, phase, amplitude

y_px, x_px = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2


def video_form() -> None:
    """Print all tables of the video form."""
    print(
        f"`morphspace.flow.motion.motion` with its defaults, clips of {TAPS} frames, {SIDE} x {SIDE} px, errors at all "
        f"points {MARGIN_PX} px or more from the edge: median and largest. First form: the model of 1999 as published, "
        "without the outer form and without averaging. A goal is met when the largest error meets it.\n"
    )
    for section in (gratings, plaids, textures, fields, contrasts, harder, peers, cost):
        tell(f"video form: {section.__name__}")
        section()


def gratings() -> None:
    """Print speed and direction of drifting gratings, over speed, direction and wavelength."""
    print("## Drifting gratings, 16 directions each\n")
    table = []
    for wavelength_px in (8.0, 12.0, 24.0):
        for speed in (0.02, 0.1, 0.5, 1.0, 2.0):
            found = []
            for degrees in np.arange(16) * 22.5 + 3:
                velocity = along(speed, degrees)
                clip = painted(waves_of([(degrees, wavelength_px, 1.0)]), drift(*velocity))
                found.append(errors(full(clip), np.broadcast_to(velocity, (SIDE, SIDE, 2))))
            table.append([f"{wavelength_px:g}", f"{speed:g}", *judged(found, GRATING_GOAL)])
    print_table(["wavelength px", "speed px/frame", *JUDGED], table)


def plaids() -> None:
    """Print what becomes of two gratings that drift as one pattern, over the angle between them and their contrasts."""
    print("## Drifting plaids of 12 px, velocity (0.6, 0.4) and (-0.1, 0.9) px/frame\n")
    table = []
    for angle, ratio in ((90, 1.0), (60, 1.0), (30, 1.0), (20, 1.0), (10, 1.0), (70, 0.3), (70, 0.1)):
        for name, find in (("full", full), ("first", first_form)):
            found = []
            for velocity in ((0.6, 0.4), (-0.1, 0.9)):
                waves = waves_of([(15, 12.0, 1.0), (15 + angle, 12.0, ratio)])
                found.append(errors(find(painted(waves, drift(*velocity))), everywhere(velocity)))
            table.append([angle, f"1 : {ratio:g}", name, *judged(found, PATTERN_GOAL)])
    print_table(["angle between", "contrasts", "form", *JUDGED], table)


def textures() -> None:
    """Print what becomes of drifting broadband textures."""
    print(f"## Drifting broadband textures ({WAVES} waves), seeds {SEEDS}\n")
    table = []
    for low_px, high_px in ((6, 40), (4, 16)):
        for velocity in ((0.03, -0.04), (0.5, 0.3), (-1.5, 0.5), (3.0, 0.0)):
            for name, find in (("full", full), ("first", first_form)):
                clips = (painted(broadband(seed, low_px, high_px), drift(*velocity)) for seed in SEEDS)
                found = [errors(find(clip), everywhere(velocity)) for clip in clips]
                table.append([f"{low_px}-{high_px}", str(velocity), name, *judged(found, TEXTURE_GOAL)])
    print_table(["waves px", "velocity px/frame", "form", *JUDGED], table)


def fields() -> None:
    """Print what becomes of textures that turn and grow: no goal is set, the model knows one velocity a point."""
    print(f"## Turning and growing textures, {RATE:g} a frame, seeds {SEEDS}\n")
    table = []
    for name, back, truth in (
        ("turning", turn(RATE), np.stack([-RATE * y_px, RATE * x_px], axis=-1)),
        ("growing", growth(RATE), np.stack([RATE * x_px, RATE * y_px], axis=-1)),
    ):
        for form, find in (("full", full), ("full, zone_sd_px 0", unaveraged), ("first", first_form)):
            missed, rates = [], []
            for seed in SEEDS:
                found = inner(find(painted(broadband(seed), back)))
                missed.append(np.linalg.norm(found - inner(truth), axis=-1))
                rates.append((found * inner(truth)).sum() / (inner(truth) ** 2).sum())
            miss = np.concatenate([each.ravel() for each in missed])
            table.append(
                [
                    name,
                    form,
                    f"{np.linalg.norm(inner(truth), axis=-1).mean():.2f}",
                    f"{miss.mean():.4f}",
                    f"{np.percentile(miss, 95):.4f}",
                    f"{miss.mean() / RATE:.1f}",
                    f"{100 * (np.mean(rates) - 1):+.1f}",
                ]
            )
    heads = [
        "texture",
        "form",
        "mean speed",
        "mean error px/frame",
        "95 %",
        "as px of the field",
        "fitted rate, % off",
    ]
    print_table(heads, table)


def contrasts() -> None:
    """Print how far velocity changes over contrast, gain and offset."""
    print("## Contrast, gain and offset: largest change of velocity, per cent of speed\n")
    table = []
    for name, waves, velocity in (
        ("grating", waves_of([(20, 12.0, 1.0)]), along(0.5, 20)),
        ("plaid, 60 degrees", waves_of([(15, 12.0, 1.0), (75, 12.0, 1.0)]), (0.6, 0.4)),
        ("texture", broadband(0), (0.5, 0.3)),
    ):
        clips = [painted(waves, drift(*velocity), contrast) for contrast in CONTRASTS]
        plain = inner(full(clips[-1]))
        changes = [
            100 * np.linalg.norm(inner(full(other)) - plain, axis=-1).max() / np.hypot(*velocity)
            for other in (*clips[:-1], 255 * clips[-1], clips[-1] + np.float32(0.5), 1 - clips[-1])
        ]
        table.append([name, *(f"{change:.3f}" for change in changes), at_most(max(changes), CONTRAST_GOAL)])
    heads = ["pattern", *(f"contrast {c:g} for {CONTRASTS[-1]:g}" for c in CONTRASTS[:-1])]
    print_table([*heads, "x 255", "+ 0.5", "negative", f"<= {CONTRAST_GOAL:g}"], table)


def harder() -> None:
    """Print what 8-bit files and noise do, and what the settings change then."""
    print(f"## 8-bit codes, and noise of {NOISE:g} of the range: median error\n")
    rng = np.random.default_rng(0)
    grating, plain = waves_of([(20, 12.0, 1.0)]), broadband(0)
    table = []
    for name, waves, velocity, contrast in (
        ("grating, contrast 0.4", grating, along(0.5, 20), 0.4),
        ("grating, contrast 0.1", grating, along(0.5, 20), 0.1),
        ("texture, contrast 0.2", plain, (0.5, 0.3), 0.2),
    ):
        clip = painted(waves, drift(*velocity), contrast)
        for what, seen in (
            ("8 bit", np.round(clip * 255) / np.float32(255)),
            ("noise", clip + np.float32(NOISE) * rng.standard_normal(clip.shape, np.float32)),
        ):
            cells = []
            for find in (full, unaveraged, partial(frame_of, time_scale=1.0), first_form):
                speed, angle = errors(find(seen), everywhere(velocity))
                cells.append(f"{np.median(speed):.2f} %, {np.median(angle):.2f} deg")
            table.append([name, what, *cells])
    print_table(["pattern", "seen as", "full", "zone_sd_px 0", "time_scale 1", "first"], table)


def peers() -> None:
    """Print the mean error beside two estimators that see two frames, as 8-bit codes."""
    print("## Beside two-frame estimators: mean error, px/frame (all see 8-bit codes)\n")
    table = []
    for name, waves, back, truth in (
        (
            "grating, speed 0.5",
            waves_of([(20, 12.0, 1.0)]),
            drift(*along(0.5, 20)),
            everywhere(along(0.5, 20)),
        ),
        (
            "plaid, 60 degrees",
            waves_of([(15, 12.0, 1.0), (75, 12.0, 1.0)]),
            drift(0.6, 0.4),
            everywhere((0.6, 0.4)),
        ),
        ("texture, slow", broadband(0), drift(0.05, 0.05), everywhere((0.05, 0.05))),
        ("texture", broadband(0), drift(0.5, 0.3), everywhere((0.5, 0.3))),
        ("texture, fast", broadband(0), drift(-1.5, 0.5), everywhere((-1.5, 0.5))),
        ("turning", broadband(0), turn(RATE), np.stack([-RATE * y_px, RATE * x_px], axis=-1)),
    ):
        codes = np.round(painted(waves, back, PEER_CONTRAST) * 255).astype(np.uint8)
        seen = codes / np.float32(255)
        found = (full(seen), frame_of(seen, time_scale=1.0), dis(codes), farneback(codes))
        misses = (np.linalg.norm(inner(each) - inner(truth), axis=-1).mean() for each in found)
        table.append([name, *(f"{miss:.4f}" for miss in misses)])
    print_table(
        ["pattern", "video form, 23 frames", "the same, time_scale 1", "DIS medium", "Farneback"], table
    )


def cost() -> None:
    """Print what a clip costs."""
    clip = np.random.default_rng(0).random((26, 256, 256), np.float32)
    start, used = time.perf_counter(), time.process_time()
    motion(clip)
    frames = len(clip) - TAPS + 1
    wall, cpu = time.perf_counter() - start, time.process_time() - used
    print(
        f"A frame of 256 x 256: {1e3 * cpu / frames:.0f} ms of processor time, {1e3 * wall / frames:.0f} ms.\n"
    )


JUDGED = ("speed %, median", "largest", "goal", "direction deg, median", "largest", "goal")


def judged(found: Iterable[tuple[AnyArray, AnyArray]], goal: tuple[float, float]) -> list[str]:
    """Give the cells of `JUDGED` for errors of speed (per cent) and direction (degrees)."""
    cells = []
    for each, most in zip(zip(*found, strict=True), goal, strict=True):
        error = np.concatenate(each)
        verdict = at_most(float(error.max()), most)
        cells += [f"{np.median(error):.3f}", f"{error.max():.3f}", f"<= {most:g} {verdict}"]
    return cells


def errors(velocity: Displacement, truth: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Give the error of speed in per cent and of direction in degrees at each inner point."""
    found, right = inner(velocity) @ np.array([1, 1j]), inner(truth) @ np.array([1, 1j])
    share = found.ravel() / right.ravel()
    return np.abs(np.abs(share) - 1) * 100, np.degrees(np.abs(np.angle(share)))


def inner(field: AnyArray) -> AnyArray:
    """Cut the margin off a field (h, w, ...)."""
    return field[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]


def frame_of(clip: AnyArray, **settings: float) -> Displacement:
    """Give the velocity (h, w, 2) of the one full frame."""
    return motion(clip, **settings).velocity[AT]


full = frame_of
unaveraged: Find = partial(frame_of, zone_sd_px=0.0)
first_form: Find = partial(frame_of, zone_sd_px=0.0, plane=np.inf)


def dis(codes: AnyArray) -> Displacement:
    """Find the flow from the full frame to the next by OpenCV's DIS, preset medium."""
    return cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(codes[AT], codes[AT + 1], None)


def farneback(codes: AnyArray) -> Displacement:
    """Find the same by OpenCV's Farneback, settings of its documentation."""
    return cv2.calcOpticalFlowFarneback(codes[AT], codes[AT + 1], None, 0.5, 3, 15, 3, 5, 1.2, 0)


def painted(waves: Waves, back: Moved, contrast: float = 0.4) -> AnyArray:
    """Draw the clip (23, h, w) float32 about 0.5; `contrast` is that of a grating of the same energy."""
    kx, ky, phase, amplitude = waves
    share = 0.5 * contrast * amplitude / np.sqrt((amplitude**2).sum())
    clip = np.full((TAPS, SIDE, SIDE), 0.5)
    for number, frame in enumerate(clip):
        x, y = back(x_px, y_px, float(number - AT))
        for a, b, shift, size in zip(kx, ky, phase, share, strict=True):
            frame += size * np.cos(a * x + b * y + shift)
    return clip.astype(np.float32)


def waves_of(parts: Iterable[tuple[float, float, float]]) -> Waves:
    """Give the waves of (direction in degrees, wavelength in px, amplitude)."""
    degrees, length_px, amplitude = np.array(list(parts), float).T
    k, angle = 2 * np.pi / length_px, np.radians(degrees)
    return k * np.cos(angle), k * np.sin(angle), 0.3 + 0.8 * np.arange(len(k)), amplitude


def broadband(seed: int, low_px: float = 6, high_px: float = 40) -> Waves:
    """Draw waves of all directions and of these lengths, amplitude as the length."""
    rng = np.random.default_rng(seed)
    k = np.exp(rng.uniform(np.log(2 * np.pi / high_px), np.log(2 * np.pi / low_px), WAVES))
    angle = rng.uniform(0, 2 * np.pi, WAVES)
    return k * np.cos(angle), k * np.sin(angle), rng.uniform(0, 2 * np.pi, WAVES), 1 / k


def along(speed: float, degrees: float) -> tuple[float, float]:
    """Give the velocity of this speed and direction."""
    return speed * float(np.cos(np.radians(degrees))), speed * float(np.sin(np.radians(degrees)))


def everywhere(velocity: tuple[float, float]) -> AnyArray:
    """Give the field (h, w, 2) of one velocity."""
    return np.broadcast_to(velocity, (SIDE, SIDE, 2))


def drift(right: float, down: float) -> Moved:
    """Give where points of a drifting pattern came from."""
    return lambda x, y, t: (x - right * t, y - down * t)


def turn(rate: float) -> Moved:
    """Give where points of a turning pattern came from."""
    return lambda x, y, t: (
        np.cos(rate * t) * x + np.sin(rate * t) * y,
        np.cos(rate * t) * y - np.sin(rate * t) * x,
    )


def growth(rate: float) -> Moved:
    """Give where points of a growing pattern came from."""
    return lambda x, y, t: (x * np.exp(-rate * t), y * np.exp(-rate * t))


if __name__ == "__main__":
    video_form()
