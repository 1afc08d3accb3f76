"""Errors of estimators on scenes with known flow: the usual table of papers on optical flow.

A scene is a folder with `frame10.png` and `frame11.png`; its truth is `flow10.flo`, either beside them or, as the
benchmark's own archives unpack, in the folder of the same name under `other-gt-flow` (Baker et al., IJCV 92, 2011).
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Displacement, Image
from morphspace.errors import BadInput, SizeMismatch, UnreadableFile
from morphspace.flow import methods
from morphspace.flow.names import DEFAULT_BACKEND
from morphspace.flow.pairs import checked_pair
from morphspace.flow.starts import flow_between
from morphspace.io.flow_fields import UNKNOWN_PX, read_flow
from morphspace.io.images import read_image
from morphspace.io.tables import write_metrics_table
from morphspace.linear.quality import flow_errors, known_flow
from morphspace.outcome import RECORD_NAME, Outcome, write_record
from morphspace.sets.outputs import Output, check_file
from morphspace.sets.protect import check_origins, writing
from morphspace.steps import Step, Steps
from morphspace.storage import digest_of_file

WARM_UP_PX = 64  # px a side; a first call excludes loading from the measured time
MEAN = "mean"  # scene name of a preset's last row
REFERENCE, FRAME, TRUTH = "frame10.png", "frame11.png", "flow10.flo"
PICTURE_FOLDERS = ("other-data", "other-data-gray")  # colour first: a scene that has both is read in colour
TRUTH_FOLDER = "other-gt-flow"
FIGURE_COLUMNS = ("aee_px", "aae_deg", "r1_percent", "time_s")


@dataclass(frozen=True)
class Scene:
    """Two pictures and the file of the true flow from the first to the second."""

    name: str
    reference: Path
    frame: Path
    truth: Path


def find_scenes(folder: str | Path) -> tuple[tuple[Scene, ...], tuple[str, ...]]:
    """Find the scenes under `folder`, by name, and the names of those without a true flow.

    Raises `UnreadableFile` if there is no such folder, `BadInput` if it holds no scene with a true flow.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UnreadableFile(f"{folder} is not a folder. Give a folder of scenes with {REFERENCE}")
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


def measured_scenes(
    folder: Path,
    presets: tuple[str, ...] = (methods.DEFAULT,),
    output: Path | None = None,
    backend: str = DEFAULT_BACKEND,
) -> Steps[Outcome]:
    """Measure presets on the scenes of a folder with known flow; `output` (.csv) stores the table.

    Times are wall-clock times. Raises `BadInput` with the name of a scene that cannot be measured.
    """
    chosen = {preset: methods.named(preset, backend) for preset in presets}
    scenes, bare = find_scenes(folder)
    guarded = None
    if output is not None:
        kept = [path for scene in scenes for path in _files(scene).values()]
        check_file(output, ".csv")
        record = output.with_name(f"{output.name}.{RECORD_NAME}")
        guarded = Output("flow", output, (output, record), inputs=kept)
        check_origins(guarded)
    rows: list[dict[str, Any]] = []
    for scene in scenes:
        reference, frame, truth = read_scene(scene)
        for preset, method in chosen.items():
            yield Step("flow", len(rows), len(scenes) * len(chosen))
            try:
                flow_between(method, reference[:WARM_UP_PX, :WARM_UP_PX], frame[:WARM_UP_PX, :WARM_UP_PX])
                began_s = time.perf_counter()
                flow = flow_between(method, reference, frame)
            except BadInput as error:
                raise BadInput(f"scene {scene.name}, preset {preset}: {error}") from error
            time_s = time.perf_counter() - began_s
            errors = asdict(flow_errors(flow.displacement, truth))
            rows.append({"preset": preset, "scene": scene.name, **errors, "time_s": time_s})
    table = [row for preset in chosen for row in with_mean([row for row in rows if row["preset"] == preset])]
    notes = (f"skipped, without a true flow: {', '.join(bare)}",) if bare else ()
    written: tuple[Path, ...] = ()
    if output is not None and guarded is not None:
        inputs = {name: digest_of_file(path) for scene in scenes for name, path in _files(scene).items()}
        settings = {
            "presets": list(chosen),
            "backend": backend,
            "scenes": [scene.name for scene in scenes],
        }
        with writing(guarded):
            write_metrics_table(output, {name: [row[name] for row in table] for name in table[0]})
            write_record(output.parent, "flow", settings, inputs, [output], record.name)
        written = (output, record)
    return Outcome(table_lines(table), {"table": table}, notes, written)


def read_scene(scene: Scene) -> tuple[Image, Image, Displacement]:
    """Read the pictures of a scene and its true flow; components beyond the format's mark are unknown.

    Raises `BadInput` if the files do not fit each other or no flow is known.
    """
    names = (str(scene.reference), str(scene.frame))
    reference, frame = checked_pair(read_image(scene.reference), read_image(scene.frame), names)
    stored = read_flow(scene.truth)
    truth = np.where(stored.known[..., None], stored.displacement, np.float32(UNKNOWN_PX))
    if truth.shape[:2] != reference.shape[:2]:
        raise SizeMismatch(
            f"{scene.truth} has {truth.shape[1]}x{truth.shape[0]} px, {scene.reference} has "
            f"{reference.shape[1]}x{reference.shape[0]}: they are not of one scene"
        )
    if not known_flow(truth).any():
        raise BadInput(f"{scene.truth} has no pixel with known flow. Leave out this scene")
    return reference, frame, truth


def with_mean(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Append to the rows of one preset their mean over the scenes, each scene with equal weight."""
    mean = {name: float(np.mean([row[name] for row in rows])) for name in FIGURE_COLUMNS}
    return [*rows, {"preset": rows[0]["preset"], "scene": MEAN, **mean}]


def table_lines(table: list[dict[str, Any]]) -> tuple[str, ...]:
    """Format the table as lines of text, columns aligned."""
    presets = max(len("preset"), *(len(row["preset"]) for row in table))
    scenes = max(len("scene"), *(len(row["scene"]) for row in table))
    head = f"{'preset':<{presets}}  {'scene':<{scenes}}   AEE px  AAE deg   R1.0 %   time s"
    rows = [
        f"{row['preset']:<{presets}}  {row['scene']:<{scenes}}  {row['aee_px']:7.3f}  {row['aae_deg']:7.2f}  "
        f"{row['r1_percent']:7.2f}  {row['time_s']:7.2f}"
        for row in table
    ]
    return (head, *rows)


def _files(scene: Scene) -> dict[str, Path]:
    return {f"{scene.name}/{path.name}": path for path in (scene.reference, scene.frame, scene.truth)}
