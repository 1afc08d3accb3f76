"""The words of `morphspace build-model` on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from morphspace.cli.words import (
    BUILD_REPORT,
    COMPONENTS,
    CROP,
    PATH,
    SIZE,
    WeightOrAuto,
    flow_option,
    work_option,
)


class CropOrAuto(click.ParamType):  # type: ignore[type-arg]
    """A box of whole numbers, or the word auto."""

    name = "auto|X,Y,W,H"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "auto" or isinstance(value, tuple):
            return value
        if not value[:1].isdigit():
            self.fail(f"{value!r} is neither auto nor a box: write 4 whole numbers, such as {CROP.example}")
        return CROP.convert(value, param, ctx)


OPTIONS = (
    click.argument("clip", nargs=-1, required=True),
    click.option("-o", "--output", type=PATH, help="The .morph file [default: the clip's name]."),
    COMPONENTS,
    click.option("--size", type=SIZE, help="Model frame size; scales to cover and crops to the middle."),
    click.option(
        "--crop",
        type=CropOrAuto(),
        help="Cut this box out of every frame first, px; auto finds one around the head (`morphspace models fetch`).",
    ),
    click.option(
        "--landmarks",
        type=click.Choice(["auto", "anchor", "none"]),
        default="auto",
        show_default=True,
        help="Whether the face is found in every frame, for registration, mask and keypoints; auto does where "
        "`morphspace models fetch` has been run; anchor also holds the flow to the landmarks.",
    ),
    click.option(
        "--mask",
        type=PATH,
        help="Grey picture on the reference, white where the face is.",
    ),
    click.option("--reference", metavar="FILE", help="The reference frame [default: chosen, and said why]."),
    click.option(
        "--register",
        "registration",
        type=click.Choice(["none", "similarity", "affine"]),
        default="similarity",
        show_default=True,
        help="How head movement is taken out.",
    ),
    flow_option("The flow estimator, as in `morphspace flow`."),
    click.option(
        "--start",
        type=click.Choice(["auto", "none"]),
        default="auto",
        show_default=True,
        help="Whether hard frames are tried again from a neighbour's flow.",
    ),
    click.option(
        "--warp-weight",
        type=WeightOrAuto(),
        default="auto",
        show_default=True,
        help="Colour per px of warp in the inner product; auto cross-validates.",
    ),
    work_option("frames"),
    click.option("--identity", help="Who it is [default: from clip.json, else the clip's name]."),
    BUILD_REPORT,
)
"""In the order of the help."""


def build_model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command the words of `morphspace build-model`; their names are those of `BuildModelRequest`."""
    for option in reversed(OPTIONS):
        command = option(command)
    return command
