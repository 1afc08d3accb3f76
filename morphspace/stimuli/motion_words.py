"""The words for what can be done to recorded motions; light, so that the command line's help is instant."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

HELP_WIDTH = 96  # characters, of a help page of 100


@dataclass(frozen=True)
class Word:
    """How an operation is written: what numbers it `takes`, their `unit`, and what it does, `told` in words."""

    takes: Literal["nothing", "number", "number or nothing", "span"]
    unit: str
    told: str

    def form(self, word: str) -> str:
        """Give how it is written, such as `smooth=HZ`."""
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
    """Write one line for each operation, or more where it is long: its form, and what it does."""
    forms = {word.form(name): word.told for name, word in WORDS.items()}
    width = max(map(len, forms)) + 2
    return "\n".join(
        textwrap.fill(told, HELP_WIDTH, initial_indent=form.ljust(width), subsequent_indent=" " * width)
        for form, told in forms.items()
    )
