"""The words of `morphspace mimic` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import OUTPUT_FOLDER

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

FACES_MISSING = 3  # exit code: all was done, but some driving frames show no face


def gain_of(_context: click.Context, _option: click.Parameter, word: str | None) -> float | str | None:
    """Read the word of --gain: a number, or auto."""
    if word is None or word == "auto":
        return word
    try:
        return float(word)
    except ValueError as error:
        raise click.BadParameter(f"{word!r} is neither a number nor auto") from error


OPTIONS = (
    click.option(
        "--src",
        "source",
        required=True,
        metavar="A",
        help="Whose motion: a model (.morph), or a clip to build one of.",
    ),
    click.option(
        "--dst",
        "target",
        required=True,
        metavar="B",
        help="Whose face: a model (.morph), or a clip to build one of.",
    ),
    OUTPUT_FOLDER,
    click.option(
        "--frames",
        metavar="CLIP",
        help="A folder, a quoted glob or a video of A's person that drives [default: A's training frames].",
    ),
    click.option(
        "--method",
        default="auto",
        show_default=True,
        metavar="auto|paper|map|transfer|guided",
        help="paper: inner products, as published. map: B's most probable face. transfer: motion first, B's own skin. "
        "guided: transfer, and landmarks of both. auto: guided where both models know landmarks, else transfer.",
    ),
    click.option(
        "--gain",
        callback=gain_of,
        metavar="G|auto",
        help="Multiply all loadings: above 1 caricatures; auto: as far as A moves [default: auto with guided and "
        "transfer, 1 with paper and map].",
    ),
    click.option(
        "--max-sd",
        type=float,
        default=3.0,
        show_default=True,
        help="Draw each loading smoothly inside so many SD, so that the picture stays a face.",
    ),
    click.option(
        "--neutral",
        default="auto",
        show_default=True,
        metavar="auto|mean|A_FRAME[,B_FRAME]",
        help="What counts as rest: both means, the training frames named, or auto: where the means differ, the "
        "frame of A nearest to B's mean.",
    ),
    click.option(
        "-k",
        "--components",
        type=int,
        metavar="N",
        help="At most so many of B's components, the first [default: all].",
    ),
)
"""In the order of the help."""


def add_mimic(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add `mimic` to the group; `verb` gives a command the options all verbs share and runs its steps."""

    def mimic(**options: Any) -> Steps[Outcome]:
        """Let B's face show what A's face does (Nagle section 3).

        Exits 3 where all was done but some driving frames show no face; quality.csv marks them.
        """
        from morphspace.verbs import mimic as verb_module

        outcome = yield from verb_module.run(verb_module.MimicRequest(**options))
        click.get_current_context().meta[__name__] = FACES_MISSING if outcome.document["no_face"] else 0
        return outcome

    driven = verb(mimic)

    @wraps(driven)
    def command(**options: Any) -> int:
        driven(**options)
        return int(click.get_current_context().meta.get(__name__, 0))  # the group exits with it

    shown: Callable[..., Any] = command
    for option in reversed(OPTIONS):
        shown = option(shown)
    group.command("mimic")(shown)
