"""The names of the operations on recorded motion, in a module of few imports for the command line's help."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

HELP_WIDTH = 96  # characters, of a help page of 100


@dataclass(frozen=True)
class Word:
    """The notation of an operation.

    Attributes
    ----------
    takes : str
        The numbers that the operation needs.
    unit : str
        Their unit.
    effect : str
        The description for the help.
    """

    takes: Literal["nothing", "number", "number or nothing", "span"]
    unit: str
    effect: str

    def form(self, word: str) -> str:
        """Return the notation, such as `smooth=HZ`."""
        return {
            "nothing": word,
            "number": f"{word}={self.unit}",
            "number or nothing": f"{word}[={self.unit}]",
            "span": f"{word}={self.unit}:{self.unit}",
        }[self.takes]


WORDS: Mapping[str, Word] = {
    "smooth": Word("number", "HZ", "low-pass filter with gain 0.71 at HZ; without delay"),
    "speed": Word("number", "TIMES", "play TIMES as fast, on the same path"),
    "rate": Word("number", "HZ", "resample to another frame rate, at the same speed"),
    "part": Word("span", "S", "keep the frames between two times, without the second"),
    "timing": Word("nothing", "", "align to the timing of the guide by dynamic time warping"),
    "reverse": Word("nothing", "", "play backwards"),
    "loop": Word(
        "number or nothing",
        "S",
        "return smoothly from the end to the start in S seconds, or with steps no longer than the median step",
    ),
    "there-and-back": Word("nothing", "", "play forwards, then backwards, as a loop"),
    "splice": Word("number or nothing", "S", "play all tables one after the other, joined as by loop"),
    "average": Word("nothing", "", "the mean trajectory of all tables, aligned in time"),
    "caricature": Word(
        "number",
        "GAIN",
        "exaggerate the difference of each table from the mean trajectory, or of one table from the guide; below 0 an "
        "anti-caricature",
    ),
    "scramble-frames": Word("nothing", "", "put the frames in random order"),
    "scramble-blocks": Word("number", "S", "put blocks of S seconds in random order"),
    "scramble-phase": Word(
        "nothing", "", "randomise phases; keep amplitudes and the covariance of components"
    ),
}
"""In the order of the help."""

GUIDED = ("timing", "caricature")
"""The operations that take a guide."""


def operations_help() -> str:
    """Return the help: the notation and the effect of each operation."""
    forms = {word.form(name): word.effect for name, word in WORDS.items()}
    width = max(map(len, forms)) + 2
    return "\n".join(
        textwrap.fill(effect, HELP_WIDTH, initial_indent=form.ljust(width), subsequent_indent=" " * width)
        for form, effect in forms.items()
    )
