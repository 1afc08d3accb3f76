"""The words of `morphspace batch` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import OUTPUT_FOLDER, PATH

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

OPTIONS = (
    click.argument("recipe", type=PATH),
    OUTPUT_FOLDER,
    click.option(
        "--plan",
        "is_plan",
        is_flag=True,
        help="Show what would be made, how long and how large; make nothing.",
    ),
    click.option("--yes", "is_meant", is_flag=True, help="Make more than 100,000 stimuli without asking."),
)
"""In the order of the help."""


def add_batch(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add `batch` to the group; `verb` gives a command the options all verbs share and runs its steps."""

    def batch(recipe: Path, output: Path, is_plan: bool, is_meant: bool) -> Steps[Outcome]:
        """Make the stimulus set of RECIPE: a .yaml that crosses factors, or a .csv with one stimulus a row.

        Everything is checked before anything is drawn. A batch that was stopped goes on with the same command.
        """
        from morphspace.outcome import Outcome
        from morphspace.sets import batch as stimulus_batch

        unasked = stimulus_batch.MOST_PLANNED if is_plan else stimulus_batch.MOST_UNASKED
        most = None if is_meant else unasked
        planned = yield from stimulus_batch.planned_batch(recipe, output, most=most)
        estimate = stimulus_batch.estimated(planned)
        lines = planned.lines(estimate)
        if is_plan:
            return Outcome(lines, {"output": str(output), **planned.document(estimate)})
        asked = click.get_current_context().params
        if not (asked.get("quiet") or asked.get("as_json")):
            for line in lines:
                click.echo(line, err=True)
        return (yield from stimulus_batch.write_batch(planned))

    command: Callable[..., Any] = verb(batch)
    for option in reversed(OPTIONS):
        command = option(command)
    group.command("batch")(command)
