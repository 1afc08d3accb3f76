"""The words of `morphspace flow` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from morphspace.cli.words import PATH
from morphspace.flow.names import BACKENDS, DEFAULT, DEFAULT_BACKEND, NAMES, STOCK

OPTIONS = (
    click.argument("pictures", nargs=-1, type=PATH, metavar="A B"),
    click.option(
        "-o",
        "--output",
        type=PATH,
        help="The field: .flo (Middlebury), or .exr with its confidence. With --bench: the table (.csv), optional.",
    ),
    click.option(
        "--preset",
        "presets",
        type=click.Choice(NAMES),
        multiple=True,
        default=(DEFAULT,),
        show_default=True,
        help=f"The estimator; {', '.join(STOCK)} are stock ones, for comparison. With --bench: give several.",
    ),
    click.option(
        "--both", is_flag=True, help="Find B to A as well (OUTPUT.back.flo), and the error there and back."
    ),
    click.option(
        "--picture",
        type=PATH,
        help="Draw it: colours, warped grid, B warped back (.png).",
    ),
    click.option(
        "--start",
        type=PATH,
        help="A field on A's grid to start from (.flo, .exr). Without one, or with the word auto: coarse to fine, and "
        "the landmarks' spline where there is one.",
    ),
    click.option(
        "--landmarks",
        type=PATH,
        nargs=2,
        metavar="A.tem B.tem",
        help="The same points marked in A and in B (.tem; .csv or .txt with x,y per line): their spline is tried as a "
        "start, and the better flow kept.",
    ),
    click.option(
        "--backend",
        type=click.Choice(BACKENDS),
        default=DEFAULT_BACKEND,
        show_default=True,
        help="What fast, balanced and accurate run on; torch takes a GPU where there is one.",
    ),
    click.option(
        "--bench",
        type=PATH,
        help="Instead of A B: a folder of scenes with true flow, in Middlebury's layout; prints errors and times.",
    ),
)
"""In the order of the help."""


def flow_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command the words of `morphspace flow`; their names are those of `verbs.flow.run_words`."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command
