"""The words of the stimulus verbs on the command line; nothing heavy is imported, so that help is instant."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from morphspace.cli.words import CROP, FRAME_RATE, MODEL, OUTPUT_FOLDER, PATH, NumberList

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Steps

DIFFERS = 3  # exit code of replay: it was drawn again, and is not the same
GAINS = NumberList("G,G,...", "them with commas, such as 0.5,1,1.5,-1")
LOADINGS = click.option(
    "--loadings", type=PATH, metavar="TABLE.csv", help="The faces: rows of a table of loadings."
)
CLIP = click.option(
    "--clip",
    multiple=True,
    metavar="CLIP",
    help="The faces: a folder, a quoted glob, images (give --clip for each) or a video of the person.",
)
FRAMES = click.option(
    "--frame",
    "frames",
    multiple=True,
    metavar="NAME",
    help="Only this frame; may be given again [default: all].",
)
VIDEO = click.option(
    "--video",
    type=click.Choice(["mp4", "mkv"]),
    help="Draw the frames as one motion: mp4 for people, mkv lossless [default: a picture a frame].",
)
CROPPED = click.option("--crop", type=CROP, help="Cut this box out of every frame of the clip first, px.")

Option = Callable[[Any], Any]

VERBS: dict[str, tuple[str, Sequence[Option]]] = {
    "render": (
        "Draw the faces of a TABLE of loadings with MODEL.",
        (
            MODEL,
            click.argument("table", type=PATH),
            click.option(
                "-o",
                "--output",
                type=PATH,
                required=True,
                help="A folder of images, or a video: .mkv lossless, .mp4 for people.",
            ),
            click.option(
                "--gain", default=1.0, show_default=True, help="Multiply all loadings: above 1 caricatures."
            ),
            FRAME_RATE,
        ),
    ),
    "caricature": (
        "Draw faces of MODEL's person further from the mean face, nearer to it, and on its other side.\n\n"
        "A gain of 1 is veridical, above 1 a caricature, between 0 and 1 an anti-caricature, below 0 an anti-face.",
        (
            MODEL,
            OUTPUT_FOLDER,
            LOADINGS,
            CLIP,
            click.option(
                "--gain",
                "gains",
                type=GAINS,
                default="0.5,1,1.5,-1",
                show_default=True,
                help="Gains, one set each.",
            ),
            click.option(
                "--warp-gain", "warp_gains", type=GAINS, help="Gains of the warp alone [default: --gain]."
            ),
            click.option(
                "--texture-gain",
                "texture_gains",
                type=GAINS,
                help="Gains of the texture alone [default: --gain].",
            ),
            click.option(
                "--components",
                metavar="1-5,8",
                help="Only these components, from 1; the others stay [default: all].",
            ),
            click.option(
                "--region",
                metavar="NAME|FILE",
                help="Only this part of the face: eyes, brows, mouth, nose, upper, lower, several joined by +, or a "
                "grey picture of the model's size, white where the face changes.",
            ),
            FRAMES,
            VIDEO,
            FRAME_RATE,
            CROPPED,
        ),
    ),
    "sample": (
        "Draw faces at random from MODEL.",
        (
            MODEL,
            OUTPUT_FOLDER,
            click.option(
                "-n",
                "--count",
                type=click.IntRange(1, 100_000),
                default=16,
                show_default=True,
                help="How many faces.",
            ),
            click.option(
                "--seed",
                type=click.IntRange(0),
                default=0,
                show_default=True,
                help="The same seed gives the same faces.",
            ),
            click.option(
                "--spread",
                type=click.FloatRange(0, 100),
                default=1.0,
                show_default=True,
                help="Scale of the distribution; 1 is the model's own.",
            ),
            click.option(
                "--max-sd",
                type=click.FloatRange(0, 1000, min_open=True),
                help="Draw again what lies further than so many SD along a component [default: keep all].",
            ),
        ),
    ),
    "sweep": (
        "Show what each component of MODEL does, as pictures and videos.",
        (
            MODEL,
            OUTPUT_FOLDER,
            click.option(
                "-k",
                "--components",
                type=click.IntRange(1, 10_000),
                default=10,
                show_default=True,
                help="How many components.",
            ),
            click.option(
                "-n",
                "--amount-sd",
                type=click.FloatRange(0, 100, min_open=True),
                default=3.0,
                show_default=True,
                help="From minus to plus so many SD.",
            ),
            click.option(
                "--steps",
                type=click.IntRange(2, 1000),
                default=7,
                show_default=True,
                help="Pictures a component.",
            ),
        ),
    ),
    "grid": (
        "Draw faces of MODEL over two components, crossed.",
        (
            MODEL,
            OUTPUT_FOLDER,
            click.option(
                "--components",
                nargs=2,
                type=click.IntRange(1, 10_000),
                default=(1, 2),
                show_default=True,
                help="The two components, from 1.",
            ),
            click.option(
                "-n",
                "--amount-sd",
                nargs=2,
                type=click.FloatRange(0, 100, min_open=True),
                default=(3.0, 3.0),
                show_default=True,
                help="How far either way along each, SD.",
            ),
            click.option(
                "--steps",
                nargs=2,
                type=click.IntRange(2, 1000),
                default=(5, 5),
                show_default=True,
                help="Faces along each.",
            ),
        ),
    ),
    "place": (
        "Put faces of MODEL back into the frames of CLIP: hair, background and size of the picture stay.",
        (
            MODEL,
            click.argument("clip", nargs=-1, required=True),
            OUTPUT_FOLDER,
            click.option(
                "--loadings",
                type=PATH,
                metavar="TABLE.csv",
                help="Faces to put there, rows named after the frames [default: the frames' own].",
            ),
            click.option("--gain", default=1.0, show_default=True, help="Multiply all loadings."),
            FRAMES,
            VIDEO,
            FRAME_RATE,
            CROPPED,
        ),
    ),
}
"""Help and options of each verb; its module is `morphspace.verbs.NAME`, its request NAMERequest."""


def add_stimuli(group: click.Group, verb: Callable[[Callable[..., Any]], Callable[..., None]]) -> None:
    """Add the stimulus verbs to the group; `verb` gives a command the options all verbs share and runs its steps."""
    for name, (told, options) in VERBS.items():
        group.command(name, help=told)(_with(options, verb(_command(name))))
    group.command("replay")(_with(REPLAY, _replay(verb)))


def _with(options: Sequence[Option], command: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(options):
        command = option(command)
    return command


def _command(name: str) -> Callable[..., Steps[Outcome]]:
    def command(video: str | None = None, **options: Any) -> Steps[Outcome]:
        module = importlib.import_module(f"morphspace.verbs.{name}")
        if video is not None:
            options["video"] = f".{video}"
        if "clip" in options:
            options["clip"] = tuple(options["clip"])
        return module.run(getattr(module, f"{name.capitalize()}Request")(**options))

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
