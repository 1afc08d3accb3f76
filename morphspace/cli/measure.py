"""The words of `morphspace measure-mimicry` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import PATH

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

FACES_MISSING = 3  # exit code: all was done, but some frames show no face

OPTIONS = (
    click.argument("stimulus"),
    click.argument("imitation"),
    click.option(
        "--model",
        type=PATH,
        required=True,
        help="The stimulus' model (.morph): both are measured in its space.",
    ),
    click.option(
        "--imitator",
        type=PATH,
        metavar="B",
        help="The model (.morph) of who imitates, where that is another person: IMITATION is read in it and carried "
        "over by mimicry. Both models need keypoints.",
    ),
    click.option(
        "-o",
        "--output",
        type=PATH,
        help="The folder to write into [default: the imitation's name and -mimicry].",
    ),
    click.option(
        "-k",
        "--components",
        type=int,
        help="At most so many components, the first [default: all].",
    ),
    click.option(
        "--permutations",
        type=click.IntRange(0, 1_000_000),
        default=1000,
        show_default=True,
        help="At most so many circular shifts of the imitation stand for chance; at the best lag and aligned, so "
        "many of its copies.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(0),
        default=0,
        show_default=True,
        help="Which shifts and copies are drawn.",
    ),
    click.option(
        "--mask",
        type=PATH,
        help="Measure a part of the face: a grey picture on the mean face, white where it counts.",
    ),
    click.option(
        "--region",
        metavar="NAME",
        default="whole",
        show_default=True,
        help="Measure a part of the face: eyes, brows, mouth, nose, upper, lower, several joined by +.",
    ),
)
"""In the order of the help."""


def measure_mimicry_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command the words of `morphspace measure-mimicry`; their names are those of its request."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command


def add_measure(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add `measure-mimicry` to the group; `verb` gives the options all verbs share and runs its steps."""

    def measure_mimicry(**options: Any) -> Steps[Outcome]:
        """Measure how well IMITATION follows STIMULUS, in the expression space of the stimulus' model.

        Exits 3 where all was done but some frames show no face; measures.json names them.
        """
        from morphspace.verbs import measure_mimicry as verb_module

        outcome = yield from verb_module.run(verb_module.MeasureMimicryRequest(**options))
        click.get_current_context().meta[__name__] = FACES_MISSING if outcome.document["no_face"] else 0
        return outcome

    done = verb(measure_mimicry)

    @wraps(done)
    def command(**options: Any) -> int:
        done(**options)
        return int(click.get_current_context().meta.get(__name__, 0))  # the group exits with it

    group.command("measure-mimicry")(measure_mimicry_options(command))
