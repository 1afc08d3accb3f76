"""The words of `morphspace keypoints` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import click

from morphspace.cli.words import MODEL, PATH

Pairs = tuple[tuple[float, float], ...]


class ThreePoints(click.ParamType):  # type: ignore[type-arg]
    """Three points written as "x,y x,y x,y", in px."""

    name = '"X,Y X,Y X,Y"'

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Pairs:
        if isinstance(value, tuple):
            return value
        try:
            pairs = tuple(
                tuple(float(part) for part in word.split(",")) for word in re.split(r"[\s;]+", value.strip())
            )
        except ValueError:
            pairs = ()
        if len(pairs) != 3 or not all(len(pair) == 2 and all(map(math.isfinite, pair)) for pair in pairs):
            self.fail(f'{value!r} is not three points: write "x,y x,y x,y", such as "78,101 124,100 101,140"')
        return pairs  # type: ignore[return-value]


OPTIONS = (
    MODEL,
    click.option(
        "--auto",
        "automatic",
        is_flag=True,
        help="Find them: in the mean and in up to 40 training faces, each carried to the mean (median).",
    ),
    click.option(
        "--set",
        "points",
        type=ThreePoints(),
        help="Right eye, left eye, philtrum in px of the mean face; right is the subject's, left in the picture.",
    ),
    click.option(
        "--from",
        "file",
        type=PATH,
        help="A template (.tem, .tps), points (.csv, .txt: x,y per line) or a faceframe (.json).",
    ),
    click.option(
        "--lip",
        type=click.Choice(["philtrum", "upper-lip"]),
        help="What the third point is, or which one to take of a template: the philtrum's centre, or the bottom of the "
        "upper lip (WebMorph) [default: upper-lip for a .tem of three points, else philtrum].",
    ),
    click.option(
        "--negate-y",
        "y_axis",
        flag_value="up",
        default=None,
        help="With --from: y counts up in the file. A .tps is recognised without it.",
    ),
    click.option(
        "--on",
        type=click.Choice(["mean", "reference"]),
        default="mean",
        show_default=True,
        help="What the points were marked on: the mean face, or the reference frame's own picture.",
    ),
    click.option("-o", "--output", type=PATH, help="The new .morph file [default: MODEL itself]."),
)
"""In the order of the help."""


def add_keypoints(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add `keypoints` to the group; `verb` gives a command the options all verbs share and runs its steps."""

    def keypoints(y_axis: str | None, **options: Any) -> Any:
        """Set the three points that place MODEL's face and link it to others; without a source, show them."""
        from morphspace.verbs import keypoints as verb_module

        return verb_module.run(verb_module.KeypointsRequest(y_axis=y_axis or "auto", **options))  # type: ignore[arg-type]

    command: Callable[..., Any] = verb(keypoints)
    for option in reversed(OPTIONS):
        command = option(command)
    group.command("keypoints")(command)
