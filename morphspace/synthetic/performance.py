"""A performance for an actor: smooth expression over time that shows every action. Ours."""

from __future__ import annotations

import numpy as np

from morphspace.arrays import AnyArray
from morphspace.synthetic.parameters import ACTIONS, SIGNED_ACTIONS, Capture, Expression

Amounts = dict[str, float]

BLINK: Amounts = {"lid_close_right": 1.0, "lid_close_left": 1.0}
POSES: tuple[tuple[str, Amounts], ...] = (
    ("smile", {"lip_corner_up": 0.9, "cheek_raise": 0.7, "upper_lip_raise": 0.15}),
    ("surprise", {"brow_inner_raise": 1.0, "brow_outer_raise": 0.9, "lid_widen": 0.9, "jaw_open": 0.65}),
    ("anger", {"brow_lower": 1.0, "lid_widen": 0.3, "lip_press": 0.9, "chin_raise": 0.3}),
    ("rest", {}),
    ("open vowel", {"jaw_open": 0.75, "lip_stretch": 0.15}),
    ("round vowel", {"lip_pucker": 0.9, "jaw_open": 0.22}),
    ("wide vowel", {"lip_stretch": 0.9, "jaw_open": 0.18, "lower_lip_drop": 0.4}),
    ("closed lips", {"lip_press": 1.0}),
    ("lip to teeth", {"lip_press": 0.6, "upper_lip_raise": 0.3, "chin_raise": 0.4}),
    ("disgust", {"nose_wrinkle": 0.9, "upper_lip_raise": 0.8, "brow_lower": 0.5, "cheek_raise": 0.3}),
    ("look left", {"gaze_x": 0.9, "brow_outer_raise": 0.2}),
    ("look right and down", {"gaze_x": -0.8, "gaze_y": 0.7, "lip_press": 0.4}),
    ("sadness", {"brow_inner_raise": 0.9, "lip_corner_down": 0.9, "chin_raise": 0.5, "gaze_y": 0.3}),
    ("wink", {"lid_close_left": 1.0, "lip_corner_up": 0.5, "cheek_raise": 0.4}),
    ("chew", {"jaw_sideways": 0.8, "jaw_open": 0.25, "lip_press": 0.3}),
    ("chew back", {"jaw_sideways": -0.8, "jaw_open": 0.12, "lip_corner_down": 0.3}),
    (
        "fear",
        {"brow_inner_raise": 0.8, "brow_lower": 0.4, "lid_widen": 0.8, "lip_stretch": 0.8, "jaw_open": 0.3},
    ),
    (
        "laugh",
        {
            "lip_corner_up": 1.0,
            "cheek_raise": 1.0,
            "jaw_open": 0.55,
            "lid_close_right": 0.25,
            "lid_close_left": 0.25,
        },
    ),
    ("one-eyed doubt", {"lid_close_right": 0.8, "brow_lower": 0.4, "gaze_y": -0.7, "lower_lip_drop": 0.6}),
    ("look up", {"gaze_y": -0.9, "brow_outer_raise": 0.7, "lip_pucker": 0.4}),
)
"""The key poses of a performance, in the order of a performance without a generator's shuffling."""

FRAMES_PER_POSE = 5.0  # at 25 frames/s: an expression takes about a fifth of a second to form
BLINK_FRAMES = 5  # from open to open


def expression_sequence(frames: int, rng: np.random.Generator) -> list[Expression]:
    """Return a smooth varied performance of `frames` expressions that starts at rest.

    The poses of `POSES` come in an order, size and mixture drawn from `rng`, with blinks and small wandering
    of every action on top. With 25 frames or more every action is shown, to a quarter of its range or more; a
    longer sequence takes about `FRAMES_PER_POSE` frames for each pose and goes through the list again. Ours.
    """
    if frames < 1:
        return []
    table = np.array([[pose.get(name, 0.0) for name in ACTIONS] for _, pose in POSES])
    beats = max(1, round((frames - 1) / FRAMES_PER_POSE), min(frames - 1, len(POSES)))
    order = np.concatenate([rng.permutation(len(POSES)) for _ in range(beats // len(POSES) + 1)])[:beats]
    keys = np.concatenate([np.zeros((1, len(ACTIONS))), table[order] * rng.uniform(0.8, 1.05, (beats, 1))])
    time = np.linspace(0.0, beats, frames)
    amounts = np.stack(
        [np.interp(time, np.arange(beats + 1), keys[:, k]) for k in range(len(ACTIONS))], axis=1
    )
    ease = _eased(time, keys) if frames > 2 * beats else amounts
    amounts = ease + _wander(frames, rng) * np.minimum(time, 1.0)[:, None]
    amounts = _with_blinks(amounts, rng)
    low = np.array([-1.0 if name in SIGNED_ACTIONS else 0.0 for name in ACTIONS])
    amounts = np.clip(amounts, low, 1.0)
    return [Expression(**{n: float(a) for n, a in zip(ACTIONS, row, strict=True)}) for row in amounts]


def _eased(time: AnyArray, keys: AnyArray) -> AnyArray:
    """Go from key to key slowly at both ends and fast in between."""
    k = np.minimum(time.astype(int), len(keys) - 2)
    t = (time - k)[:, None]
    t = t * t * (3 - 2 * t)
    return np.asarray(keys[k] * (1 - t) + keys[k + 1] * t)


def _wander(frames: int, rng: np.random.Generator) -> AnyArray:
    """Return small slow movement of every action: no living face holds still."""
    phase = rng.uniform(0, 2 * np.pi, (2, len(ACTIONS)))
    rate = rng.uniform(0.05, 0.22, (2, len(ACTIONS)))
    time = np.arange(frames)[:, None]
    size = np.array(
        [0.0 if name.startswith("lid_close") or name == "lip_press" else 0.05 for name in ACTIONS]
    )
    return np.asarray(size * (np.sin(rate[0] * time + phase[0]) + np.sin(rate[1] * time + phase[1])))


def _with_blinks(amounts: AnyArray, rng: np.random.Generator) -> AnyArray:
    out = amounts.copy()
    start = int(rng.integers(8, 20))
    while start < len(out) - 1:
        for k in range(BLINK_FRAMES):
            if start + k < len(out):
                close = np.sin(np.pi * (k + 1) / (BLINK_FRAMES + 1)) ** 1.2
                for name in BLINK:
                    column = ACTIONS.index(name)
                    out[start + k, column] = max(out[start + k, column], close)
        start += int(rng.integers(22, 50))
    return out


def capture_sequence(
    frames: int,
    rng: np.random.Generator,
    *,
    head_motion_px: float = 0.0,
    light_change: float = 0.0,
    noise_sd: float = 0.0,
) -> list[Capture]:
    """Return smooth head motion and light over `frames` frames; the first has none of either.

    `head_motion_px` bounds the shift (the head also turns and nears in proportion: 0.5 degree and 0.3 % a
    px), `light_change` the relative change of gain and gradient, `noise_sd` is the sensor noise of every
    frame. Ours.
    """
    time = np.arange(frames)[:, None]
    rate, phase = rng.uniform(0.04, 0.16, (2, 7)), rng.uniform(0, 2 * np.pi, (2, 7))
    waves = np.sin(rate[0] * time + phase[0]) * np.cos(rate[1] * time + phase[1])
    waves = waves - waves[:1]
    waves = waves / max(1.0, float(np.abs(waves).max(initial=1.0)))
    seeds = rng.integers(1 << 31, size=frames)
    return [
        Capture(
            shift_x_px=float(head_motion_px * wave[0]),
            shift_y_px=float(head_motion_px * wave[1]),
            roll_deg=float(0.5 * head_motion_px * wave[2]),
            zoom=float(1 + 0.003 * head_motion_px * wave[3]),
            gain=float(1 + light_change * wave[4]),
            gradient_x=float(light_change * wave[5]),
            gradient_y=float(light_change * wave[6]),
            noise_sd=noise_sd,
            noise_seed=int(seed),
        )
        for wave, seed in zip(waves, seeds, strict=True)
    ]
