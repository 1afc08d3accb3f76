"""Blended identities with matched motion: the same performance on faces between two (or more) people.

    python examples/avatar_motion.py anna.morph ben.morph --driver clara.morph -o avatars --weights 1,3 1,1 3,1

For each set of weights an avatar is blended (`morphspace blend-avatar`; the models need keypoints), then the
driver's motion is carried onto every avatar (`morphspace mimic`), and the loadings that came of it become one set
of videos with matched timing, sidecars, a manifest and image statistics. What differs between the videos is who is
shown, not what they do. An avatar that is there already is kept, so a stopped run goes on. Copy the file and change
what you like.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

from morphspace.errors import BadInput, MorphspaceError
from morphspace.steps import result_of
from morphspace.storage import write_text
from morphspace.verbs import batch, blend_avatar
from morphspace.verbs.batch import BatchRequest
from morphspace.verbs.blend_avatar import BlendAvatarRequest

HEAD = "format: morphspace-recipe\nversion: 1\n"


def avatar_name(models: list[Path], weights: list[float]) -> str:
    """Give what an avatar is called: anna-25_ben-75."""
    shares = [round(100 * weight / sum(weights)) for weight in weights]
    return "_".join(f"{path.stem}-{share}" for path, share in zip(models, shares, strict=True))


def blended(models: list[Path], weights: list[float], folder: Path, settings: dict[str, object]) -> Path:
    """Blend the models into an avatar, unless it is there; give its file."""
    path = folder / f"{avatar_name(models, weights)}.morph"
    if not path.exists():
        request = BlendAvatarRequest(
            tuple(map(str, models)), path, weights=tuple(weights), identity=path.stem, **settings
        )
        result_of(blend_avatar.run(request))
    return path


def levels_text(levels: dict[str, dict[str, str]]) -> str:
    """Give the levels of a factor as YAML. JSON texts are YAML texts too, so names may hold anything."""
    return "\n".join(f"    {json.dumps(name)}: {json.dumps(brought)}" for name, brought in levels.items())


def main(words: list[str]) -> int:
    """Blend, drive, and make the videos; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", nargs="+", type=Path, help="who is blended: models (.morph) with keypoints")
    parser.add_argument(
        "--driver", type=Path, required=True, help="whose motion: a model (.morph) with keypoints"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="the folder to write into")
    parser.add_argument(
        "--weights", nargs="+", default=["1,3", "1,1", "3,1"], help="one list an avatar (default 1,3 1,1 3,1)"
    )
    parser.add_argument("--expressions", type=int, default=40, help="of each identity, to blend (default 40)")
    parser.add_argument("--components", type=int, default=50, help="of each avatar, at most (default 50)")
    parser.add_argument("--flow", default="balanced", help="the flow estimator (default balanced)")
    parser.add_argument(
        "--video", default=".mp4", choices=[".mp4", ".mkv"], help=".mkv is lossless (default .mp4)"
    )
    parser.add_argument("--workers", type=int, help="processes (default: one a core)")
    arguments = parser.parse_args(words)
    folder = arguments.output
    try:
        mixtures = [[float(word) for word in text.split(",")] for text in arguments.weights]
        for weights in mixtures:
            if len(weights) != len(arguments.models):
                raise BadInput(
                    f"the weights {weights} are {len(weights)}, there are {len(arguments.models)} models"
                )
        settings = {name: getattr(arguments, name) for name in ("expressions", "components", "flow")}
        avatars = [blended(arguments.models, weights, folder / "avatars", settings) for weights in mixtures]
        people = {path.stem: {"model": f"avatars/{path.name}"} for path in avatars}
        driver = os.path.relpath(arguments.driver, folder)
        write_text(
            folder / "motion.yaml",
            f"{HEAD}factors:\n  avatar:\n{levels_text(people)}\nstimuli:\n"
            f'  - {{verb: mimic, source: {json.dumps(driver)}, target: "{{avatar.model}}", name: "{{avatar}}"}}\n',
        )
        result_of(batch.run(BatchRequest(folder / "motion.yaml", folder / "motion", arguments.workers)))
        for name, brought in people.items():
            brought["table"] = f"motion/{name}/loadings.csv"
        write_text(
            folder / "videos.yaml",
            f"{HEAD}description: one motion, blended identities\nfactors:\n  avatar:\n{levels_text(people)}\nstimuli:\n"
            f'  - {{verb: render, model: "{{avatar.model}}", table: "{{avatar.table}}", video: {arguments.video}, '
            'name: "{avatar}"}\n',
        )
        outcome = result_of(
            batch.run(BatchRequest(folder / "videos.yaml", folder / "videos", arguments.workers))
        )
    except (MorphspaceError, ValueError) as error:
        print(f"avatar_motion.py: {error}", file=sys.stderr)
        return 2
    print(*outcome.lines, *(f"note: {note}" for note in outcome.warnings), sep="\n")
    return 0


if __name__ == "__main__":  # batch starts processes, which read this file again
    sys.exit(main(sys.argv[1:]))
