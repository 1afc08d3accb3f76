"""The demo's pictures and page: faces of a model encoded, reconstructed, exaggerated, swept, and drawn at random."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Image, LoadingTable
from morphspace.io.clips import open_clip
from morphspace.io.images import write_image
from morphspace.io.video import write_video
from morphspace.model.model import MorphModel
from morphspace.steps import Step, Steps, in_order
from morphspace.stimuli.sampling import along
from morphspace.storage import make_folder, write_text

SEED = 1
SHOWN_FRAMES = 8  # frames in a strip
SWEPT = 4  # components swept
SWEPT_SD = (-2.0, -1.0, 0.0, 1.0, 2.0)
RANDOM_FACES = 8
CARICATURE_GAIN = 1.6


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


def demo_section(name: str, figures: Mapping[str, Any]) -> str:
    """Return the section of one model, from the figures that `build-model` returns."""
    sweeps = "\n".join(
        f'<figure><img src="{name}/pc{i}.png" alt="component {i} from -2 to +2 SD"><figcaption>Component {i}: '
        f"{SWEPT_SD[0]:+g} to {SWEPT_SD[-1]:+g} SD</figcaption></figure>"
        for i in range(1, 1 + min(SWEPT, int(figures["components"])))
    )
    return SECTION.format(
        name=html.escape(name),
        frames=figures["frames"],
        components=figures["components"],
        share=figures["variance_explained"],
        psnr=figures["psnr_db_median"],
        gain=CARICATURE_GAIN,
        sweeps=sweeps,
    )


SECTION = """<section>
<h2>{name}</h2>
<p>{frames} frames, {components} components, {share:.0%} of the variance; frames are reconstructed at {psnr:.1f} dB.
<a href="{name}.html">The build report</a>, <a href="{name}.morph">the model</a>.</p>
<figure><img src="{name}/frames.png" alt="eight frames of the clip"><figcaption>Frames of the clip</figcaption></figure>
<figure><img src="{name}/reconstructed.png" alt="the same frames, reconstructed"><figcaption>The same frames,
reconstructed from {components} loadings</figcaption></figure>
<figure><img src="{name}/caricature.png" alt="the same frames, exaggerated"><figcaption>Caricature: all loadings times
{gain}</figcaption></figure>
<div class="videos">
<figure><video src="{name}/veridical.mp4" controls autoplay loop muted playsinline></video>
<figcaption>Gain 1</figcaption></figure>
<figure><video src="{name}/caricature.mp4" controls autoplay loop muted playsinline></video>
<figcaption>Gain {gain}</figcaption></figure>
</div>
{sweeps}
<figure><img src="{name}/random.png" alt="eight random faces"><figcaption>Faces drawn at random from the
model</figcaption></figure>
</section>"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>morphspace demo</title>
<style>
body {{ font: 16px/1.5 Georgia, serif; color: #222; background: #faf9f7; max-width: 1100px; margin: 2rem auto;
  padding: 0 1rem; }}
h1, h2 {{ font-weight: normal; }}
h2 {{ margin-top: 3rem; border-top: 1px solid #ccc; padding-top: 1rem; }}
figure {{ margin: 0 0 1rem; }}
figcaption {{ font-size: 14px; color: #555; }}
img {{ width: 100%; display: block; }}
.videos {{ display: flex; gap: 1rem; flex-wrap: wrap; }}
video {{ width: 300px; max-width: 100%; }}
code {{ background: #efece6; padding: 0 .25em; }}
</style>
</head>
<body>
<h1>morphspace: what a model of a face can do</h1>
<p>The actors are drawn; the portrait is scikit-image's public-domain sample.
With your own frames: <code>morphspace build-model clips/*.png</code>.</p>
{sections}
</body>
</html>
"""


def write_demo_page(path: Path, sections: list[str]) -> None:
    """Write the page of all models."""
    write_text(path, PAGE.format(sections="\n".join(sections)))
