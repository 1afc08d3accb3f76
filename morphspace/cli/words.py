"""Kinds of words on the command line that click does not know, and options that what builds a model shares."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from morphspace.flow.names import DEFAULT, NAMES


class NamedPath(click.Path):
    """A file or folder by its name; an empty one, which would stand for the current folder, is refused."""

    def __init__(self, **options: Any) -> None:
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("it is empty: name a file or folder, . for the folder you are in")
        return super().convert(value, param, ctx)


PATH = NamedPath()


class Numbers(click.ParamType):  # type: ignore[type-arg]
    """A fixed count of whole numbers written with a separator, such as 200x240 or 10,20,200,240."""

    def __init__(self, name: str, count: int, separator: str) -> None:
        self.name, self.count, self.separator = name, count, separator

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        parts = re.split(f"[{self.separator}]", value)
        if len(parts) != self.count or not all(re.fullmatch(r"\d{1,6}", part) for part in parts):
            self.fail(
                f"{value!r} is not {self.name}: write {self.count} whole numbers, such as {self.example}"
            )
        return tuple(map(int, parts))

    @property
    def example(self) -> str:
        """How such a value looks."""
        return {2: "200x240", 4: "10,20,200,240"}[self.count]


SIZE = Numbers("WxH", 2, "xX")
CROP = Numbers("X,Y,W,H", 4, ",")


class WeightOrAuto(click.ParamType):  # type: ignore[type-arg]
    """A number, or the word auto (None)."""

    name = "auto|NUMBER"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        if value == "auto":
            return None
        try:
            return float(value)
        except ValueError:
            self.fail(f"{value!r} is neither auto nor a number")


class NumberList(click.ParamType):  # type: ignore[type-arg]
    """Numbers with commas between: `name` as help shows them, `meant` what to write instead of what cannot be read."""

    def __init__(self, name: str, meant: str) -> None:
        self.name, self.meant = name, meant

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            return tuple(float(word) for word in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is not a list of numbers: write {self.meant}")


MODEL = click.argument("model", type=PATH)
OUTPUT_FOLDER = click.option("-o", "--output", type=PATH, required=True, help="The folder to write into.")
FRAME_RATE = click.option(
    "--frame-rate", "frame_rate_hz", type=click.FloatRange(1, 1000), help="Frames a second of a video."
)
COMPONENTS = click.option(
    "-k",
    "--components",
    type=click.IntRange(1, 10_000),
    default=50,
    show_default=True,
    help="The most components to keep.",
)
BUILD_REPORT = click.option("--report", type=PATH, help="The HTML report [default: beside the model].")


def flow_option(told: str) -> Callable[[Any], Any]:
    """Give the option that chooses the flow estimator; `told` is its help."""
    return click.option("--flow", type=click.Choice(NAMES), default=DEFAULT, show_default=True, help=told)


def work_option(kept: str) -> Callable[[Any], Any]:
    """Give the option that keeps what is finished: `kept` says what."""
    return click.option("--work-dir", "work_folder", type=PATH, help=f"Keep finished {kept} here.")
