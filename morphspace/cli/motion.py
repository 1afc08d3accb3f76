"""The words of `morphspace trajectory` and `continuum` on the command line; nothing heavy is imported."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import CROP, MODEL, OUTPUT_FOLDER, PATH, NumberList
from morphspace.stimuli.motion_words import WORDS

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

HELP_WIDTH = 96  # of a help page of 100
SPACINGS = ("loadings", "warp", "ciede2000", "ssim")  # those of `stimuli.continuum`, which is slow to import

TRAJECTORY_OPTIONS = (
    MODEL,
    click.argument("tables", nargs=-1, required=True, type=PATH, metavar="TABLE..."),
    click.option(
        "-o",
        "--output",
        type=PATH,
        required=True,
        metavar="DIR|NEW.csv",
        help="A folder for the videos, or a new table of loadings, to go on with.",
    ),
    click.option(
        "--op", "operations", multiple=True, metavar="WORD[=NUMBER]", help="An operation, see above."
    ),
    click.option(
        "--guide",
        type=PATH,
        metavar="TABLE",
        help="Loadings on MODEL too: whose timing `timing` takes on; or the mean trajectory for `caricature` of one "
        "table.",
    ),
    click.option(
        "--frame-rate",
        "frame_rate_hz",
        type=click.FloatRange(0, 1000, min_open=True),
        metavar="HZ",
        help="Frame rate of the tables, Hz [default: what they tell, else 25].",
    ),
    click.option(
        "--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed scrambles alike."
    ),
    click.option(
        "--video",
        type=click.Choice([".mp4", ".mkv"]),
        default=".mp4",
        show_default=True,
        help=".mkv is lossless, .mp4 for people.",
    ),
)
CONTINUUM_OPTIONS = (
    click.argument("first", metavar="A"),
    click.argument("last", metavar="B"),
    OUTPUT_FOLDER,
    click.option(
        "--model",
        type=PATH,
        help="The model that A and B, pictures or rows TABLE.csv:FRAME, are shown with.",
    ),
    click.option(
        "--steps",
        type=click.IntRange(1, 10_000),
        default=10,
        show_default=True,
        help="How many steps; the faces are one more: 10 steps are 0 %, 10 %, ... 100 %.",
    ),
    click.option(
        "--spacing",
        type=click.Choice(SPACINGS),
        default="ciede2000",
        show_default=True,
        help="In what the steps are equal: loadings (the linear morph), warp (rms px), or as the files show it, mean "
        "CIEDE2000 or 1 - SSIM inside the mask.",
    ),
    click.option(
        "--at",
        "positions",
        type=NumberList("P,P,...", "positions, such as 0,0.25,0.5,1"),
        help="Positions instead of equal steps: 0 is A, 1 is B, beyond them the difference goes on.",
    ),
    click.option(
        "--control",
        type=click.Choice(["linear", "none"]),
        default="linear",
        show_default=True,
        help="The linear morph in as many steps, as linear_*, beside.",
    ),
    click.option("--crop", type=CROP, help="Cut this box out of the pictures first, px."),
)


def add_motion(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add `trajectory` and `continuum` to the group; `verb` gives a command the options all verbs share."""

    def trajectory(**options: Any) -> Steps[Outcome]:
        """Change the motion of each TABLE of loadings on MODEL, and draw it.

        Operations are done in the order given:
        """
        from morphspace.verbs import trajectory as verb_module

        return verb_module.run(verb_module.TrajectoryRequest(**options))

    def continuum(**options: Any) -> Steps[Outcome]:
        """Draw the faces between A and B, in steps of equal size.

        A and B are two models (.morph, with keypoints: their mean faces), or with --model two pictures or two rows of
        tables (TABLE.csv:FRAME). steps.csv says what each step changes, shape and colour apart, and what a plain
        cross-fade of the two ends would.
        """
        from morphspace.verbs import continuum as verb_module

        return verb_module.run(verb_module.ContinuumRequest(**options))

    trajectory.__doc__ = f"{inspect.getdoc(trajectory)}\n\n\b\n{_operations()}"
    for function, options in ((trajectory, TRAJECTORY_OPTIONS), (continuum, CONTINUUM_OPTIONS)):
        command: Callable[..., Any] = verb(function)
        for option in reversed(options):
            command = option(command)
        group.command(function.__name__)(command)


def _operations() -> str:
    """Give the operations as help shows them."""
    forms = {word.form(name): word.told for name, word in WORDS.items()}
    width = max(map(len, forms)) + 2
    return "\n".join(
        textwrap.fill(told, HELP_WIDTH, initial_indent=form.ljust(width), subsequent_indent=" " * width)
        for form, told in forms.items()
    )
