"""The words of the stimulus verbs on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import PATH

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

DIFFERS = 3  # exit code of replay: it was drawn again, and is not the same
Option = Callable[[Any], Any]


def add_stimuli(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add the stimulus verbs to the group; `verb` gives a command the options all verbs share and runs its steps."""
    group.command("replay")(_with(REPLAY, _replay(verb)))


def _with(options: Sequence[Option], command: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(options):
        command = option(command)
    return command


REPLAY = (
    click.argument("sidecar", type=PATH),
    click.option(
        "--model",
        type=PATH,
        metavar="MODEL",
        help="The model [default: found by name and digest near the sidecar].",
    ),
    click.option(
        "--clip",
        multiple=True,
        metavar="CLIP",
        help="The clip whose frames faces were put back into, if it moved.",
    ),
    click.option(
        "-o", "--output", type=PATH, help="Keep the new stimulus here [default: compare and drop it]."
    ),
)


def _replay(verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> Callable[..., int]:
    def replay(**options: Any) -> Steps[Outcome]:
        """Draw the stimulus of SIDECAR again and compare the bytes.

        Exits 0 where they are the same, 3 where they differ; then it says what differs.
        """
        from morphspace.verbs import replay as verb_module

        outcome = yield from verb_module.run(
            verb_module.ReplayRequest(**{**options, "clip": tuple(options["clip"])})
        )
        click.get_current_context().meta[__name__] = 0 if outcome.document["same"] else DIFFERS
        return outcome

    driven = verb(replay)

    @wraps(driven)
    def command(**options: Any) -> int:
        driven(**options)
        return int(click.get_current_context().meta.get(__name__, 0))  # the group exits with it

    return command
