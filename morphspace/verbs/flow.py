"""flow: where each point of one picture is found in another, as a file, in figures and as a picture.

Or, with scenes whose true flow is known, how far estimators are off: the table every paper on flow prints.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from morphspace.arrays import Displacement, Image, Points
from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow import Flow, methods
from morphspace.flow.baselines import LUMA
from morphspace.flow.names import DEFAULT_BACKEND
from morphspace.flow.pairs import checked_pair
from morphspace.flow.starts import WITHOUT_START
from morphspace.grid import warp
from morphspace.io.flow_fields import UNKNOWN_PX, check_field_name, read_flow, write_flows
from morphspace.io.images import read_image, write_image
from morphspace.io.scenes import Scene, find_scenes
from morphspace.io.tables import write_metrics_table
from morphspace.linear.quality import (
    endpoint_error,
    flow_errors,
    forward_backward_px,
    known_flow,
    photometric_rmse,
    stays_inside,
)
from morphspace.outcome import RECORD_NAME, Outcome, write_record
from morphspace.report.flow_picture import flow_picture
from morphspace.sets.protect import check_file
from morphspace.steps import Step, Steps
from morphspace.storage import digest_of_file, make_folder
from morphspace.verbs.flow_pair import Pair, flow_between, flow_from_best, read_pair

WARM_UP_PX = 64  # a side; what a method loads on its first call is not its time
AUTO_START = Path("auto")  # the word for what happens without a field: the best start there is
MEAN = "mean"  # the scene of a preset's last row
FIGURE_COLUMNS = ("aee_px", "aae_deg", "r1_percent", "time_s")


@dataclass(frozen=True)
class FlowRequest:
    """Find the flow from the picture `reference` (A) to `frame` (B) by `preset`, into `output` (.flo or .exr).

    `both` writes the flow from B to A as well, beside it; `picture` is a .png to draw, `start` a field on A's grid to
    start from. `landmarks` are two files with the same points marked in A and in B: the flow is found from their spline
    as well, and the better of the two is kept. `backend` is what our presets run on (`backends.named_backend`).
    """

    reference: Path
    frame: Path
    output: Path
    preset: str = methods.DEFAULT
    both: bool = False
    picture: Path | None = None
    start: Path | None = None
    landmarks: tuple[Path, Path] | None = None
    backend: str = DEFAULT_BACKEND

    @property
    def back_output(self) -> Path:
        """The file of the flow from B to A."""
        return self.output.with_name(f"{self.output.stem}.back{self.output.suffix}")


@dataclass(frozen=True)
class FlowBenchRequest:
    """Measure each of `presets` on the scenes with true flow under `scenes`; `output` (.csv) keeps the table."""

    scenes: Path
    presets: tuple[str, ...] = (methods.DEFAULT,)
    output: Path | None = None
    backend: str = DEFAULT_BACKEND


def run_words(
    pictures: tuple[Path, ...],
    output: Path | None,
    presets: tuple[str, ...],
    both: bool,
    picture: Path | None,
    start: Path | None,
    landmarks: tuple[Path, Path] | None,
    backend: str,
    bench: Path | None,
) -> Steps[Outcome]:
    """Turn the words of the command line into the request they make, and run it. Raises `BadInput` for a mixture."""
    start = None if start == AUTO_START else start
    if bench is not None:
        if pictures or both or picture or start or landmarks:
            raise BadInput(
                "--bench measures scenes: give it no A B, --both, --picture, --start or --landmarks"
            )
        return run_bench(FlowBenchRequest(bench, presets, output, backend))
    if len(pictures) != 2:
        raise BadInput(f"a flow goes from one picture, A, to another, B: {len(pictures)} given, 2 expected")
    if output is None:
        raise BadInput("the flow has nowhere to go: give -o with a name in .flo or .exr")
    if len(presets) != 1:
        raise BadInput(f"{len(presets)} presets were given: one flow has one, several are for --bench")
    return run(FlowRequest(*pictures, output, presets[0], both, picture, start, landmarks, backend))


def run(request: FlowRequest) -> Steps[Outcome]:
    """Find the flow, write it with a record beside it, and draw it. Returns an `Outcome` with its figures."""
    method = methods.named(request.preset, request.backend)
    given = "landmarks" if request.landmarks is not None else "a field" if request.start is not None else None
    if given is not None and request.preset in WITHOUT_START:
        able = [name for name in methods.NAMES if name not in WITHOUT_START]
        raise BadInput(f"{request.preset} cannot start from {given}: choose one of {', '.join(able)}")
    inputs = _inputs(request)
    _check_outputs(request, tuple(inputs.values()))
    pair = read_pair(request.reference, request.frame, request.start, request.landmarks)
    for path in (request.output, request.picture):
        if path is not None:
            make_folder(path.parent)
    wanted = {request.output: pair, **({request.back_output: pair.turned()} if request.both else {})}
    flows: dict[Path, Flow] = {}
    taken: list[str] = []
    for path, each in wanted.items():
        yield Step("flow", len(flows), len(wanted))
        start, flows[path] = flow_from_best(method, each)
        taken.append(start)
    yield Step("flow", len(flows), len(wanted))
    flow = flows[request.output]
    figures = figures_of(pair, flow, flows.get(request.back_output))
    if pair.landmarks is not None:
        figures["started_from"] = taken
        figures["landmarks_missed_mean_px"] = landmarks_missed_px(flow.displacement, *pair.landmarks)
    write_flows({path: (one.displacement, one.confidence) for path, one in flows.items()})
    written = list(flows)
    if request.picture is not None:
        names = (request.reference.name, request.frame.name)
        sheet = flow_picture(pair.reference, pair.frame, flow, names=names, figures=shown(figures))
        write_image(request.picture, sheet)
        written.append(request.picture)
    record = _record(
        request.output,
        _settings(request, taken),
        {name: digest_of_file(path) for name, path in inputs.items()},
        written,
    )
    lines = (
        f"{request.output}: from {request.reference.name} to {request.frame.name} by {request.preset}",
        *(f"{name:<22}{value}" for name, value in shown(figures)),
    )
    document = {"output": str(request.output), "preset": request.preset, **figures}
    return Outcome(lines, document, pair.notes, (*written, record))


def _inputs(request: FlowRequest) -> dict[str, Path]:
    inputs = {"A": request.reference, "B": request.frame}
    if request.start is not None:
        inputs["start"] = request.start
    if request.landmarks is not None:
        inputs["landmarks of A"], inputs["landmarks of B"] = request.landmarks
    return inputs


def _settings(request: FlowRequest, taken: list[str]) -> dict[str, Any]:
    """Give what was asked for; with landmarks also their files' names and which start was `taken`, there and back."""
    settings = {"preset": request.preset, "backend": request.backend, "both": request.both}
    if request.landmarks is None:
        return settings
    return {**settings, "landmarks": [path.name for path in request.landmarks], "started_from": taken}


def _check_outputs(request: FlowRequest, kept: tuple[Path, ...]) -> None:
    check_field_name(request.output)
    suffix = request.output.suffix.lower()
    check_file(request.output, suffix, kept)
    if request.both:
        check_file(request.back_output, suffix, kept)
    if request.picture is not None:
        check_file(request.picture, ".png", kept)


def figures_of(pair: Pair, flow: Flow, back: Flow | None) -> dict[str, Any]:
    """Give the figures of a flow, units in their names; differences are in grey levels (0 to 255) over all pixels.

    With the flow `back` also how far points land from themselves, over those that stay inside the second picture.
    """
    field = flow.displacement
    height, width = field.shape[:2]
    everywhere = np.ones((height, width), np.float32)
    length_px = endpoint_error(field, np.zeros_like(field))
    grey_reference, grey_frame = pair.reference @ LUMA, pair.frame @ LUMA
    figures: dict[str, Any] = {
        "size": [width, height],
        "displacement_mean_px": float(length_px.mean()),
        "displacement_largest_px": float(length_px.max()),
        "folds_percent": 100 * warp.fold_fraction(field, everywhere),
        "confidence_mean": float(flow.confidence.mean(dtype=np.float64)),
        "rmse_before": photometric_rmse(grey_frame, grey_reference, everywhere),
        "rmse_after": photometric_rmse(warp.sample(grey_frame, field), grey_reference, everywhere),
    }
    if back is not None:
        inside = stays_inside(field, height, width)
        error_px = forward_backward_px(field, back.displacement)[inside]
        figures["forward_backward_mean_px"] = float(error_px.mean()) if error_px.size else None
        figures["forward_backward_p95_px"] = float(np.quantile(error_px, 0.95)) if error_px.size else None
    return figures


def landmarks_missed_px(field: Displacement, reference_points: Points, frame_points: Points) -> float:
    """Give how far from their fellows the field takes landmarks (m, 2) of the reference, on average.

    Between two people this tells more than the colours, which may differ everywhere.
    """
    off_px = warp.move_points(field, reference_points) - frame_points
    return float(np.hypot(off_px[:, 0], off_px[:, 1]).mean())


def shown(figures: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Give figures as people read them: names and values with their units."""
    width, height = figures["size"]
    rows = [
        ("size", f"{width}x{height} px"),
        ("mean displacement", f"{figures['displacement_mean_px']:.2f} px"),
        ("largest displacement", f"{figures['displacement_largest_px']:.2f} px"),
        ("folds", f"{figures['folds_percent']:.2f} %"),
        ("mean confidence", f"{figures['confidence_mean']:.2f}"),
        ("B against A, RMSE", f"{figures['rmse_before']:.2f} of 255"),
        ("warped B against A", f"{figures['rmse_after']:.2f} of 255"),
    ]
    if "forward_backward_mean_px" in figures:
        mean_px, p95_px = figures["forward_backward_mean_px"], figures["forward_backward_p95_px"]
        told = ("none stays", "none stays") if mean_px is None else (f"{mean_px:.2f} px", f"{p95_px:.2f} px")
        rows += [("there and back, mean", told[0]), ("95 % are within", told[1])]
    if "started_from" in figures:
        rows.append(("start", ", back from ".join(figures["started_from"])))
        rows.append(("landmarks missed by", f"{figures['landmarks_missed_mean_px']:.2f} px"))
    return tuple(rows)


def run_bench(request: FlowBenchRequest) -> Steps[Outcome]:
    """Measure presets on scenes with true flow. Returns an `Outcome` with the table; time is wall-clock time."""
    chosen = {preset: methods.named(preset, request.backend) for preset in request.presets}
    scenes, bare = find_scenes(request.scenes)
    if request.output is not None:
        kept = [path for scene in scenes for path in _files(scene).values()]
        check_file(request.output, ".csv", kept)
        make_folder(request.output.parent)
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
    notes = (f"passed over, without a truth: {', '.join(bare)}",) if bare else ()
    written: tuple[Path, ...] = ()
    if request.output is not None:
        write_metrics_table(request.output, {name: [row[name] for row in table] for name in table[0]})
        inputs = {name: digest_of_file(path) for scene in scenes for name, path in _files(scene).items()}
        settings = {
            "presets": list(chosen),
            "backend": request.backend,
            "scenes": [scene.name for scene in scenes],
        }
        written = (request.output, _record(request.output, settings, inputs, [request.output]))
    return Outcome(table_lines(table), {"table": table}, notes, written)


def read_scene(scene: Scene) -> tuple[Image, Image, Displacement]:
    """Give the pictures of a scene and its true flow, unknown where a component is beyond the mark.

    Raises `BadInput` where they do not belong together or nothing is known.
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
        raise BadInput(f"{scene.truth} knows the flow of no pixel: nothing can be measured on this scene")
    return reference, frame, truth


def with_mean(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Give the rows of one preset and their mean over the scenes, each scene counting the same."""
    mean = {name: float(np.mean([row[name] for row in rows])) for name in FIGURE_COLUMNS}
    return [*rows, {"preset": rows[0]["preset"], "scene": MEAN, **mean}]


def table_lines(table: list[dict[str, Any]]) -> tuple[str, ...]:
    """Give the table as lines of text, columns aligned."""
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


def _record(
    output: Path, settings: Mapping[str, Any], inputs: Mapping[str, str], written: list[Path]
) -> Path:
    """Write the record beside the output; a picture that lies in another folder is not in it."""
    folder = output.parent
    beside = [path for path in written if path.parent == folder]
    return write_record(folder, "flow", settings, inputs, beside, f"{output.name}.{RECORD_NAME}")
