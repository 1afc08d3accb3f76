"""Scenes with true flow on disk, as the Middlebury benchmark lays them out.

A scene is a folder with `frame10.png` and `frame11.png`; its truth is `flow10.flo`, either beside them or, as the
benchmark's own archives unpack, in the folder of the same name under `other-gt-flow` (Baker et al., IJCV 92, 2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from morphspace.errors import BadInput, UnreadableFile

REFERENCE, FRAME, TRUTH = "frame10.png", "frame11.png", "flow10.flo"
PICTURE_FOLDERS = ("other-data", "other-data-gray")  # colour first: a scene that has both is read in colour
TRUTH_FOLDER = "other-gt-flow"


@dataclass(frozen=True)
class Scene:
    """Two pictures and the file of the true flow from the first to the second."""

    name: str
    reference: Path
    frame: Path
    truth: Path


def find_scenes(folder: str | Path) -> tuple[tuple[Scene, ...], tuple[str, ...]]:
    """Give the scenes under `folder` by name, and the names of those that have no truth.

    Raises `UnreadableFile` where there is no such folder, `BadInput` where it holds no scene with a truth.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UnreadableFile(f"{folder} is no folder: give one that holds scenes with {REFERENCE}")
    places = {path.name: (path, path) for path in _folders(folder)}
    for pictures in PICTURE_FOLDERS:
        for path in _folders(folder / pictures):
            places.setdefault(path.name, (path, folder / TRUTH_FOLDER / path.name))
    scenes, bare = [], []
    for name in sorted(places):
        pictures_at, truth_at = places[name]
        scene = Scene(name, pictures_at / REFERENCE, pictures_at / FRAME, truth_at / TRUTH)
        if not (scene.reference.is_file() and scene.frame.is_file()):
            continue
        if scene.truth.is_file():
            scenes.append(scene)
        else:
            bare.append(name)
    if not scenes:
        raise BadInput(
            f"{folder} holds no scene with a truth: SCENE/{REFERENCE}, {FRAME} and {TRUTH} were expected, or "
            f"{PICTURE_FOLDERS[0]}/SCENE and {TRUTH_FOLDER}/SCENE"
        )
    return tuple(scenes), tuple(bare)


def _folders(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.is_dir()] if folder.is_dir() else []
