"""What a drawn actor is and does: identity, expression and capture, each a record of plain numbers.

Lengths are in face units: the two pupils are 0.9 apart, so that one unit is about 70 mm on a living face.
Expression amounts are named after the facial action units (Ekman and Friesen), 0 at rest and 1 at a strong
but possible action. The parameters are ours.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np

from morphspace.errors import BadInput

SKIN_TONES = (
    (0.89, 0.74, 0.66),
    (0.86, 0.69, 0.59),
    (0.79, 0.61, 0.50),
    (0.64, 0.46, 0.36),
    (0.48, 0.33, 0.26),
)
HAIR_COLOURS = (
    (0.09, 0.07, 0.06),
    (0.20, 0.13, 0.08),
    (0.36, 0.23, 0.13),
    (0.60, 0.45, 0.26),
    (0.45, 0.19, 0.09),
)
EYE_COLOURS = (
    (0.30, 0.18, 0.10),
    (0.42, 0.31, 0.17),
    (0.36, 0.46, 0.34),
    (0.36, 0.48, 0.60),
    (0.45, 0.50, 0.53),
)
CLOTH_COLOURS = (
    (0.25, 0.30, 0.40),
    (0.42, 0.40, 0.38),
    (0.35, 0.16, 0.17),
    (0.22, 0.34, 0.28),
    (0.55, 0.52, 0.46),
)
HAIR_STYLES = ("short", "parted", "long", "cropped")

Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Identity:
    """One drawn person; lengths in face units, colours sRGB-coded in [0, 1]. Ours."""

    face_width: float = 0.97  # half the width at the cheekbones
    jaw_width: float = 0.76  # half the width at the corners of the jaw
    chin_drop: float = 1.60  # from the eye line to the chin
    chin_width: float = 0.30  # half the width of the chin's flat part
    eye_spacing: float = 0.45  # from the midline to the middle of an eye
    eye_width: float = 0.225  # half the length of the lid fissure
    eye_opening: float = 0.158
    eye_tilt: float = 0.02  # how much the outer corner stands above the inner one
    nose_length: float = 0.62
    nose_width: float = 0.20
    nose_relief: float = 1.0
    mouth_drop: float = 0.95  # from the eye line to the line between the lips
    mouth_width: float = 0.37  # half the length of that line
    lip_upper: float = 0.095
    lip_lower: float = 0.125
    lips_apart: float = 0.075  # the slightly open mouth of the reference face (Nagle sec. 2)
    brow_height: float = 0.31
    brow_thickness: float = 0.070
    brow_arch: float = 0.05
    brow_darkness: float = 0.75
    hairline: float = 0.92  # from the eye line up to the hair
    hair_style: str = "short"
    skin: Colour = SKIN_TONES[0]
    hair: Colour = HAIR_COLOURS[1]
    eyes: Colour = EYE_COLOURS[0]
    lips: Colour = (0.70, 0.38, 0.35)
    cloth: Colour = CLOTH_COLOURS[0]
    background: Colour = (0.62, 0.64, 0.66)
    freckles: float = 0.2
    stubble: float = 0.0
    age: float = 0.3  # depth of the lines that are there at rest
    light_side: float = -0.5  # -1 lit from the picture's left, 1 from its right
    seed: int = 0  # of every texture on this face

    @staticmethod
    def random(rng: np.random.Generator) -> Identity:
        """Draw a plausible person from the generator; the same state gives the same person. Ours."""

        def near(middle: float, spread: float) -> float:
            return float(middle + spread * np.clip(rng.normal(), -2.0, 2.0))

        def pick(table: tuple[Colour, ...], jitter: float) -> Colour:
            base = np.asarray(table[int(rng.integers(len(table)))]) * (1 + jitter * rng.uniform(-1, 1))
            red, green, blue = (float(c) for c in np.clip(base, 0.03, 0.95))
            return (red, green, blue)

        skin = pick(SKIN_TONES, 0.06)
        pale = float(np.mean(skin))
        dark_hair = pale < 0.6
        beard = float(rng.uniform(0.3, 1.0)) if rng.random() < 0.4 else 0.0
        styles = ("short", "cropped") if beard > 0 else HAIR_STYLES
        red = (0.32 if beard > 0 else 0.50) + 0.32 * rng.random()
        lips = tuple(float(c) for c in np.asarray(skin) * (1 - 0.10 * red, 1 - 0.62 * red, 1 - 0.52 * red))
        return Identity(
            face_width=near(0.95, 0.035),
            jaw_width=near(0.76 if beard > 0 else 0.70, 0.035),
            chin_drop=near(1.60, 0.05),
            chin_width=near(0.34 if beard > 0 else 0.28, 0.03),
            eye_spacing=near(0.45, 0.012),
            eye_width=near(0.236, 0.010),
            eye_opening=near(0.155, 0.012),
            eye_tilt=near(0.018, 0.018),
            nose_length=near(0.63, 0.03),
            nose_width=near(0.205, 0.022),
            nose_relief=near(1.0, 0.12),
            mouth_drop=near(0.96, 0.025),
            mouth_width=near(0.372, 0.022),
            lip_upper=near(0.108, 0.018),
            lip_lower=near(0.142, 0.018),
            lips_apart=near(0.075, 0.006),
            brow_height=near(0.315, 0.02),
            brow_thickness=near(0.080 if beard > 0 else 0.062, 0.010),
            brow_arch=near(0.05, 0.02),
            brow_darkness=near(0.78, 0.08),
            hairline=near(0.93, 0.06),
            hair_style=styles[int(rng.integers(len(styles)))],
            skin=skin,
            hair=pick(HAIR_COLOURS[:2] if dark_hair else HAIR_COLOURS, 0.12),
            eyes=pick(EYE_COLOURS[:2] if dark_hair else EYE_COLOURS, 0.12),
            lips=(lips[0], lips[1], lips[2]),
            cloth=pick(CLOTH_COLOURS, 0.15),
            background=pick(((0.62, 0.64, 0.66), (0.55, 0.57, 0.60), (0.66, 0.64, 0.61)), 0.08),
            freckles=float(rng.uniform(0.0, 1.0) ** 2),
            stubble=beard,
            age=float(rng.uniform(0.1, 0.8)),
            light_side=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.35, 0.75)),
            seed=int(rng.integers(1 << 31)),
        )

    def as_dict(self) -> dict[str, object]:
        """Return the parameters as a JSON-ready record."""
        return asdict(self)


SIGNED_ACTIONS = ("jaw_sideways", "gaze_x", "gaze_y")
"""The actions with a direction, in [-1, 1]; every other action is in [0, 1]."""


@dataclass(frozen=True, eq=False)
class Expression:
    """The amount of each action, 0 for the neutral face; right and left are the subject's. Ours.

    `gaze_x` and `jaw_sideways` are positive to the picture's right, `gaze_y` downwards. Raises `BadInput` for
    an amount outside [0, 1], or [-1, 1] for the actions of `SIGNED_ACTIONS`.
    """

    brow_inner_raise: float = 0.0  # AU 1
    brow_outer_raise: float = 0.0  # AU 2
    brow_lower: float = 0.0  # AU 4
    lid_widen: float = 0.0  # AU 5
    cheek_raise: float = 0.0  # AU 6
    nose_wrinkle: float = 0.0  # AU 9
    upper_lip_raise: float = 0.0  # AU 10
    lip_corner_up: float = 0.0  # AU 12
    lip_corner_down: float = 0.0  # AU 15
    lower_lip_drop: float = 0.0  # AU 16
    chin_raise: float = 0.0  # AU 17
    lip_pucker: float = 0.0  # AU 18
    lip_stretch: float = 0.0  # AU 20
    lip_press: float = 0.0  # AU 24: closes the slightly open mouth
    jaw_open: float = 0.0  # AU 26 and 27
    jaw_sideways: float = 0.0  # AD 30
    lid_close_right: float = 0.0  # AU 45 and 46
    lid_close_left: float = 0.0
    gaze_x: float = 0.0  # AU 61 and 62
    gaze_y: float = 0.0  # AU 63 and 64

    def __post_init__(self) -> None:
        for name, amount in self.as_dict().items():
            lowest = -1.0 if name in SIGNED_ACTIONS else 0.0
            if not lowest <= amount <= 1.0:
                raise BadInput(f"{name} is {amount}, outside [{lowest:g}, 1]: give an amount inside")

    def as_dict(self) -> dict[str, float]:
        """Return the amounts by name, in a fixed order."""
        return {field.name: float(getattr(self, field.name)) for field in fields(self)}


ACTIONS = tuple(field.name for field in fields(Expression))
"""The names of the actions, in the order of `Expression.as_dict`."""


@dataclass(frozen=True, eq=False)
class Capture:
    """The capture of a frame: rigid head motion, light and sensor. Ours.

    The head turns by `roll_deg` (positive: clockwise in the picture) and grows by `zoom` about the bridge of
    the nose, then moves by (`shift_x_px`, `shift_y_px`). `gain` multiplies the sRGB-coded picture, and
    `gradient_x`, `gradient_y` add a linear change of that gain from one border to the other. `noise_sd` is
    the standard deviation of the sensor noise in sRGB-coded units, drawn from `noise_seed`. `crease_gain` 0
    leaves out the creases and shading that come with expression, so that skin keeps its colour exactly.
    """

    shift_x_px: float = 0.0
    shift_y_px: float = 0.0
    roll_deg: float = 0.0
    zoom: float = 1.0
    gain: float = 1.0
    gradient_x: float = 0.0
    gradient_y: float = 0.0
    noise_sd: float = 0.0
    noise_seed: int = 0
    crease_gain: float = 1.0

    def as_dict(self) -> dict[str, float]:
        """Return the settings as a JSON-ready record."""
        return asdict(self)


def mixed(*parts: dict[str, float]) -> Expression:
    """Add several sets of amounts and clip each sum to its range. Ours."""
    total = dict.fromkeys(ACTIONS, 0.0)
    for part in parts:
        for name, amount in part.items():
            total[name] += amount
    return Expression(
        **{n: float(np.clip(a, -1.0 if n in SIGNED_ACTIONS else 0.0, 1.0)) for n, a in total.items()}
    )


def scaled(amounts: dict[str, float], factor: float) -> dict[str, float]:
    """Multiply a set of amounts by one factor."""
    return {name: factor * amount for name, amount in amounts.items()}
