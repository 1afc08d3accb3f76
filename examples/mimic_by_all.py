"""One driver, all actors: everybody shows the same motion, as one set of videos with matched timing.

    python examples/mimic_by_all.py driver.morph actors/*.morph -o mimicry
    python examples/mimic_by_all.py driver.morph actors/*.morph -o mimicry --frames clips/driver

First each actor's model is driven by the driver's face (`morphspace mimic`; both need keypoints), each in a folder
with a page to look at. Then the loadings that came of it become one stimulus set: a video an actor, frame by frame
at the same moments, with sidecars, a manifest and image statistics. Both steps are recipes that stay beside the
stimuli. Copy the file and change what you like.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import numpy as np

from morphspace.errors import BadInput, MorphspaceError
from morphspace.io.tables import read_metrics_table
from morphspace.steps import result_of
from morphspace.storage import write_text
from morphspace.verbs import batch
from morphspace.verbs.batch import BatchRequest

HEAD = "format: morphspace-recipe\nversion: 1\n"


def mimicry_recipe(actors: dict[str, str], driver: str, frames: str | None, method: str, gain: str) -> str:
    """Give the recipe of the first step: a folder an actor."""
    people = "\n".join(
        f"    {json.dumps(name)}: {json.dumps({'model': path})}" for name, path in actors.items()
    )
    driven = "" if frames is None else f"    frames: {json.dumps(frames)}\n"
    return f"""\
{HEAD}description: one driver, all actors
factors:
  actor:
{people}
stimuli:
  - verb: mimic
    source: {json.dumps(driver)}
    target: "{{actor.model}}"
{driven}    method: {method}
    gain: {gain}
    name: "{{actor}}"
"""


def video_recipe(actors: dict[str, str], loadings: dict[str, str], suffix: str) -> str:
    """Give the recipe of the second step: a video an actor."""
    people = "\n".join(
        f"    {json.dumps(name)}: {json.dumps({'model': path, 'table': loadings[name]})}"
        for name, path in actors.items()
    )
    return f"""\
{HEAD}description: the driver's motion on every actor
factors:
  actor:
{people}
stimuli:
  - verb: render
    model: "{{actor.model}}"
    table: "{{actor.table}}"
    video: {suffix}
    name: "{{actor}}"
"""


def main(words: list[str]) -> int:
    """Write both recipes and make what they say; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("driver", type=Path, help="whose motion: a model (.morph) with keypoints")
    parser.add_argument("actors", nargs="+", type=Path, help="whose faces: models (.morph) with keypoints")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the folder to write into")
    parser.add_argument(
        "--frames", type=Path, help="a clip of the driver (default: the frames of the driver's model)"
    )
    parser.add_argument("--method", default="auto", help="as in morphspace mimic (default auto)")
    parser.add_argument(
        "--gain", default="auto", help="a number, or auto: as far as the driver moves (default)"
    )
    parser.add_argument(
        "--video", default=".mp4", choices=[".mp4", ".mkv"], help=".mkv is lossless (default .mp4)"
    )
    parser.add_argument("--workers", type=int, help="processes (default: one a core)")
    arguments = parser.parse_args(words)
    folder = arguments.output

    def relative(path: Path) -> str:
        return os.path.relpath(path, folder)  # in a recipe, from its own folder

    try:
        actors = {path.stem: relative(path) for path in arguments.actors}
        if len(actors) < len(arguments.actors):
            raise BadInput("two actors have files of one name: copy one under another name")
        frames = None if arguments.frames is None else relative(arguments.frames)
        text = mimicry_recipe(actors, relative(arguments.driver), frames, arguments.method, arguments.gain)
        write_text(folder / "mimicry.yaml", text)
        result_of(batch.run(BatchRequest(folder / "mimicry.yaml", folder / "mimicry", arguments.workers)))
        loadings = {name: f"mimicry/{name}/loadings.csv" for name in actors}
        write_text(folder / "videos.yaml", video_recipe(actors, loadings, arguments.video))
        outcome = result_of(
            batch.run(BatchRequest(folder / "videos.yaml", folder / "videos", arguments.workers))
        )
    except MorphspaceError as error:
        print(f"mimic_by_all.py: {error}", file=sys.stderr)
        return 2
    print(*outcome.lines, *(f"note: {note}" for note in outcome.warnings), sep="\n")
    for name in actors:
        quality = read_metrics_table(folder / "mimicry" / name / "quality.csv")
        kept = np.median(np.array(quality["warp_kept"], float))
        page = folder / "mimicry" / name / "index.html"
        print(f"{name}: {max(kept, 0):.0%} of the driver's motion is kept (median); page: {page}")
    return 0


if __name__ == "__main__":  # batch starts processes, which read this file again
    sys.exit(main(sys.argv[1:]))
