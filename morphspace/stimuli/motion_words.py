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
    "smooth": Word("number", "HZ", "take away what is faster, gain 0.71 at so many Hz; without delay"),
    "speed": Word("number", "TIMES", "play so many times as fast, on the same path"),
    "rate": Word("number", "HZ", "show at another frame rate, at the same speed"),
    "part": Word("span", "S", "keep what is between two times, the second left out"),
    "timing": Word("nothing", "", "take on the timing of the guide, by dynamic time warping"),
    "reverse": Word("nothing", "", "play backwards"),
    "loop": Word(
        "number or nothing",
        "S",
        "lead softly from the end back to the start, in so many s, or with no step longer than the median step",
    ),
    "there-and-back": Word("nothing", "", "play forwards, then backwards, as a loop"),
    "splice": Word("number or nothing", "S", "play all tables one after the other, joined as by loop"),
    "average": Word("nothing", "", "the mean trajectory of all tables, aligned in time"),
    "caricature": Word(
        "number",
        "GAIN",
        "exaggerate how each table differs from the mean trajectory of all, or one table from the guide; below 0 an "
        "anti-caricature",
    ),
    "scramble-frames": Word("nothing", "", "put the frames in random order"),
    "scramble-blocks": Word("number", "S", "put blocks of so many s in random order"),
    "scramble-phase": Word(
        "nothing", "", "random phases; amplitudes, and how components go together, stay as they are"
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
