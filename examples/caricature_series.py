"""A caricature series for a set of actors: the same gains for everybody, one manifest, one page.

    python examples/caricature_series.py models/*.morph -o series --gains=-1,0.5,1,1.5 --faces 5

Of each person's own frames the most different ones are taken (or all rows of NAME.csv, where --tables names a
folder of loadings tables). The script writes a recipe and runs it, so that the set can be made again, or changed,
without the script: `morphspace batch series/recipe.yaml -o series/stimuli`. Copy the file and change what you like.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

import numpy as np

from morphspace.errors import BadInput, MorphspaceError
from morphspace.io.tables import write_loadings_table
from morphspace.model.model import MorphModel, load_model
from morphspace.steps import result_of
from morphspace.storage import write_text
from morphspace.verbs import batch
from morphspace.verbs.batch import BatchRequest


def most_different(loadings_sd: np.ndarray, count: int) -> list[int]:
    """Give the rows of (n, k) furthest from the mean face and each other, each the furthest from those before."""
    distance = np.linalg.norm(loadings_sd, axis=1)
    chosen: list[int] = []
    while len(chosen) < min(count, len(loadings_sd)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(loadings_sd - loadings_sd[chosen[-1]], axis=1))
    return sorted(chosen)


def write_faces(model: MorphModel, count: int, path: Path) -> None:
    """Write the loadings of so many of a model's own frames as a table."""
    loadings_sd = model.training.in_sd(model).values
    rows = most_different(loadings_sd, count)
    names = [model.training.frame_names[row] for row in rows]
    document = {
        "model_id": model.model_id,
        "identity": model.identity,
        "frame_rate_hz": model.provenance.get("frame_rate_hz"),
    }
    write_loadings_table(
        path, loadings_sd[rows], names, {key: value for key, value in document.items() if value is not None}
    )


def recipe_text(levels: dict[str, dict[str, str]], gains: list[float]) -> str:
    """Give the recipe: people crossed with gains. JSON texts are YAML texts too, so names may hold anything."""
    people = "\n".join(f"    {json.dumps(name)}: {json.dumps(brought)}" for name, brought in levels.items())
    return f"""\
format: morphspace-recipe
version: 1
description: a caricature series
factors:
  person:
{people}
  gain: {json.dumps(gains)}
stimuli:
  - verb: caricature
    model: "{{person.model}}"
    loadings: "{{person.loadings}}"
    gains: "{{gain}}"
    name: "{{person}}/{{frame}}_g{{gain}}"
"""


def main(words: list[str]) -> int:
    """Write the recipe and make its stimuli; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", nargs="+", type=Path, help="one model (.morph) an actor")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the folder to write into")
    parser.add_argument(
        "--gains", default="-1,0.5,1,1.5", help="of all stimuli, with commas (write --gains=-1,1)"
    )
    parser.add_argument("--faces", type=int, default=5, help="of each actor (default 5)")
    parser.add_argument("--tables", type=Path, help="a folder with a table NAME.csv for each NAME.morph")
    parser.add_argument("--workers", type=int, help="processes that draw (default: one a core)")
    arguments = parser.parse_args(words)
    folder = arguments.output
    try:
        gains = [float(word) for word in arguments.gains.split(",")]
        levels: dict[str, dict[str, str]] = {}
        for path in arguments.models:
            if path.stem in levels:
                raise BadInput(f"two models are called {path.stem}: copy one under another name")
            table = (arguments.tables or folder / "tables") / f"{path.stem}.csv"
            if arguments.tables is None:
                write_faces(load_model(path), arguments.faces, table)
            places = {"model": path, "loadings": table}  # in a recipe, from its own folder
            levels[path.stem] = {key: os.path.relpath(place, folder) for key, place in places.items()}
        write_text(folder / "recipe.yaml", recipe_text(levels, gains))
        outcome = result_of(
            batch.run(BatchRequest(folder / "recipe.yaml", folder / "stimuli", arguments.workers))
        )
    except (MorphspaceError, ValueError) as error:
        print(f"caricature_series.py: {error}", file=sys.stderr)
        return 2
    print(*outcome.lines, *(f"note: {note}" for note in outcome.warnings), sep="\n")
    return 0


if __name__ == "__main__":  # batch starts processes, which read this file again
    sys.exit(main(sys.argv[1:]))
