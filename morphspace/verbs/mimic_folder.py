"""The output folder of a mimicry: whose it is before anything is written, and that a refusal leaves nothing behind.

`measure-mimicry` guards its own in the same way.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from morphspace.errors import BadInput, MorphspaceError
from morphspace.outcome import RECORD_NAME

FRAMES_FOLDER = "frames"
MODELS_FOLDER = "models"  # models that were built on the way
WORK_FOLDER = "mimic.work"  # finished frames of a run that was stopped
VIDEO_NAME = "side-by-side.mp4"
WRITTEN = (
    FRAMES_FOLDER,
    VIDEO_NAME,
    "loadings.csv",
    "loadings.json",
    "quality.csv",
    "quality.json",
    "index.html",
    RECORD_NAME,
)


UNFINISHED = re.compile(r"\..*\.[a-z0-9_]{8}\.(png|mp4|csv|json|html|morph)")  # names of `whole_file`


def check_ours(folder: Path, verb: str = "mimic", written: Sequence[str] = WRITTEN) -> None:
    """Raise `BadInput` where the folder holds something under a name of ours that no run of the verb left there.

    A folder VERB.work there says that a run was stopped.
    """
    begun = (folder / f"{verb}.work").is_dir()
    if not folder.is_dir() or begun or _is_recorded(folder / RECORD_NAME, verb):
        return
    for name in written:
        path = folder / name
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            lost = "be mixed with the new pictures" if name == FRAMES_FOLDER else "be written over"
            raise BadInput(
                f"{folder} is no folder of an earlier {verb}, and its {name} would {lost}: choose another output "
                f"folder, or move {name} away"
            )


def _is_recorded(record: Path, verb: str) -> bool:
    try:
        document = json.loads(record.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and document.get("verb") == verb


def remove_unfinished(folder: Path) -> None:
    """Take away the files that a killed run was in the middle of writing; the folder must be ours."""
    for place in (folder, *(folder / name for name in (FRAMES_FOLDER, WORK_FOLDER, MODELS_FOLDER))):
        for path in place.glob(".*"):
            if UNFINISHED.fullmatch(path.name) and not path.is_dir():
                path.unlink(missing_ok=True)


@contextmanager
def told_what_stays(folder: Path) -> Iterator[None]:
    """Where the block ends in an error of ours, add to its words which models, begun or built in it, lie here now."""
    before = _models(folder)
    try:
        yield
    except MorphspaceError as error:
        made = [path.name for path in _models(folder) if path not in before]
        if not made:
            raise
        raise type(error)(
            f"{error}; what was made for it stays in {folder / MODELS_FOLDER} ({', '.join(made)}), and the next run "
            "here goes on from it"
        ) from error


def _models(folder: Path) -> list[Path]:
    """Give the models, and the work folders of models that were begun."""
    place = folder / MODELS_FOLDER
    return sorted(path for kind in ("*.morph", "*.morph.work") for path in place.glob(kind))


@contextmanager
def no_empty_folders(
    folder: Path, inner: Sequence[str] = (FRAMES_FOLDER, WORK_FOLDER, MODELS_FOLDER)
) -> Iterator[None]:
    """Take away, however the block ends, what folders it made here that are empty: `inner` ones, this, its parents."""
    places = [folder / name for name in inner]
    made = [path for path in (*places, folder, *folder.parents) if not path.exists()]
    begun = folder / MODELS_FOLDER
    try:
        yield
    finally:
        for path in (*begun.glob("*.morph.work"), *made):
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()
