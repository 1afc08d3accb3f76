"""The words of `morphspace blend-avatar` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import (
    BUILD_REPORT,
    COMPONENTS,
    PATH,
    NumberList,
    WeightOrAuto,
    flow_option,
    work_option,
)

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps


class CountOrAll(click.ParamType):  # type: ignore[type-arg]
    """A whole number, or the word all (0)."""

    name = "all|N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        if value == "all":
            return 0
        if not value.isdigit() or int(value) < 1:
            self.fail(f"{value!r} is neither all nor a whole number above 0")
        return int(value)


OPTIONS = (
    click.argument("models", nargs=-1, required=True, metavar="A.morph B.morph ..."),
    click.option("-o", "--output", type=PATH, required=True, help="The model to write (.morph)."),
    click.option(
        "--weights",
        type=NumberList("W,W,...", "one a model, such as 1,1,2"),
        help="How much of each identity, in the order of the models [default: the same of all].",
    ),
    click.option(
        "--faceframe",
        default="mean",
        show_default=True,
        metavar="mean|source|NAME",
        help="Onto which keypoints all are aligned: the weighted mean, those of whose expression it is, or of an "
        "identity.",
    ),
    click.option(
        "--reference",
        metavar="NAME",
        help="The identity on whose mean face the others are laid [default: the one nearest to all others].",
    ),
    click.option(
        "--expressions",
        type=CountOrAll(),
        default=40,
        show_default=True,
        help="How many of each identity, so that three give three times so many; spread out over what each can show. "
        "all: every training frame.",
    ),
    click.option(
        "--method",
        default="auto",
        show_default=True,
        metavar="auto|paper|map|transfer|guided",
        help="How expressions are carried over, as in `morphspace mimic`.",
    ),
    click.option(
        "--max-sd",
        type=float,
        default=3.0,
        show_default=True,
        help="Draw each loading smoothly inside so many SD.",
    ),
    click.option(
        "--sharpen",
        type=WeightOrAuto(),
        default="auto",
        show_default=True,
        help="Amount of the unsharp mask, 0 to 3; auto: as sharp as the sources are.",
    ),
    click.option(
        "--surround",
        metavar="NAME|flat",
        help="Whose hair, ears, neck and background stay, or flat grey [default: the reference identity's].",
    ),
    click.option(
        "--correspondence",
        type=click.Choice(["expression", "rest"]),
        default="expression",
        show_default=True,
        help="How people are matched. rest: as their mean faces are; expression: at the mouth also anew in each "
        "expression, by landmarks (`keypoints --auto`) and flow.",
    ),
    flow_option("The flow estimator, between the people and of the final model."),
    COMPONENTS,
    click.option(
        "--clips",
        "clips",
        multiple=True,
        metavar="CLIP",
        help="The clip a model was built from, once for each model in their order: its frames are used as they are, "
        "not as the model draws them.",
    ),
    click.option(
        "--landmarks",
        type=click.Choice(["auto", "none"]),
        default="auto",
        show_default=True,
        help="Whether the face is looked for in the blended pictures.",
    ),
    click.option("--identity", default="avatar", show_default=True, help="What the avatar is called."),
    work_option("blends"),
    BUILD_REPORT,
)
"""In the order of the help."""


def add_avatar(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add `blend-avatar` to the group; `verb` gives a command the options all verbs share and runs its steps."""

    def blend_avatar(expressions: int, clips: tuple[str, ...], **options: Any) -> Steps[Outcome]:
        """Blend the identities of several models with keypoints into one face that belongs to nobody."""
        from morphspace.verbs import blend_avatar as verb_module

        request = verb_module.BlendAvatarRequest(
            expressions=expressions or None, clips=clips or None, **options
        )
        return verb_module.run(request)

    command: Callable[..., Any] = verb(blend_avatar)
    for option in reversed(OPTIONS):
        command = option(command)
    group.command("blend-avatar")(command)
