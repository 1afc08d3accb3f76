"""The demo's pictures and page: faces of a model encoded, reconstructed, exaggerated, swept, and drawn at random."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.io.clips import open_clip
from morphspace.io.images import write_image
from morphspace.io.video import write_video
from morphspace.model.model import MorphModel
from morphspace.report.page import render
from morphspace.steps import Step, Steps, in_order
from morphspace.stimuli.sampling import along
from morphspace.storage import make_folder, write_text

SEED = 1  # of the random faces
SHOWN_FRAMES = 8  # frames in a strip
SWEPT = 4  # components swept
SWEPT_SD = (-2.0, -1.0, 0.0, 1.0, 2.0)  # SD of the component
RANDOM_FACES = 8  # faces
CARICATURE_GAIN = 1.6  # times the distance from the mean; plain to see on a drawn face


def demo_pictures(model: MorphModel, clip_folder: Path, folder: Path) -> Steps[None]:
    """Write the strips and the videos of one model."""

    def rendered(rows: LoadingTable) -> Iterator[Image]:
        return in_order(model.render, rows)

    make_folder(folder)
    loadings = model.training.values
    shown = [int(i) for i in np.linspace(0, len(loadings) - 1, SHOWN_FRAMES).round()]
    clip = open_clip([clip_folder])
    strips = {
        "frames": list(clip.images(shown)),
        "reconstructed": list(rendered(loadings[shown])),
        "caricature": list(rendered(CARICATURE_GAIN * loadings[shown])),
        "random": list(rendered(model.sample(np.random.default_rng(SEED), RANDOM_FACES).values)),
    }
    for component in range(min(SWEPT, model.rank)):
        strips[f"pc{component + 1}"] = list(rendered(along(model, component, np.array(SWEPT_SD)) * model.sd))
    total = len(strips) + 2
    for count, (name, faces) in enumerate(strips.items(), 1):
        write_image(folder / f"{name}.png", np.concatenate(faces, axis=1))
        yield Step("pictures", count, total)
    rate = float(model.provenance.get("frame_rate_hz") or 25.0)
    for count, (name, gain) in enumerate(
        (("veridical", 1.0), ("caricature", CARICATURE_GAIN)), len(strips) + 1
    ):
        write_video(folder / f"{name}.mp4", rendered(gain * loadings), frame_rate_hz=rate, encoding="people")
        yield Step("pictures", count, total)


@dataclass(frozen=True, eq=False)
class DemoPage:
    """The page: the document of `build-model` for each model, by name."""

    models: Mapping[str, Mapping[str, Any]]
    title: str = "morphspace: what a model of a face can do"
    gain: float = CARICATURE_GAIN
    swept_sd: tuple[float, ...] = SWEPT_SD

    def swept(self, figures: Mapping[str, Any]) -> int:
        """Return the number of components of a model that are swept."""
        return min(SWEPT, int(figures["components"]))


def write_demo_page(path: Path, models: Mapping[str, Mapping[str, Any]]) -> None:
    """Write the page of all models, from the documents that `build-model` returns."""
    write_text(path, render("demo.html", DemoPage(models)))
