"""What a build costs: the stages against the flow, and memory against the number of frames."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from clips import SIZE, clip_frames, replaced, replaced_flow
from memory import child
from tables import at_most, print_table, tell

from morphspace import cache, steps
from morphspace.face.registration import Registration
from morphspace.flow import FlowMethod, methods
from morphspace.model import work_frames
from morphspace.verbs import build_model
from morphspace.verbs.build_model import BuildModelRequest

BUILD_CLIP = "lp_d18"
COUNTS = (100, 400, 1600)
MEMORY_SIZE = (100, 120)  # (w, h) px; small, so that 1600 frames take minutes
MEMORY_FLOW = "fast"
STAGES = ("reference", "flow", "starts", "morphs", "components", "report", "end")


class Stopwatch:
    """Counts the seconds spent in functions, over all threads."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._lock = threading.Lock()

    def watched(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Give the same function, its time counted."""

        def counted(*arguments: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments)
            took = time.perf_counter() - begin
            with self._lock:
                self.seconds += took
            return result

        return counted


def watched_method(watch: Stopwatch, method: FlowMethod) -> FlowMethod:
    """Give the same method, the time of preparing the reference and of each frame counted."""
    prepare = watch.watched(method)
    return lambda reference: watch.watched(prepare(reference))


@dataclass(frozen=True, eq=False)
class Timed:
    """A build's time (s): wall of each stage, and of the costly functions, over the threads they share."""

    walls: dict[str, float]
    flow: float
    registration: float
    writing: float

    @property
    def all(self) -> float:
        """The whole build."""
        return sum(self.walls.values())

    @property
    def rest_of_flow(self) -> float:
        """Everything but the flow, as a share of the flow."""
        return (self.all - self.flow) / self.flow


def stages(data: Path, rounds: int) -> None:
    """Print where the time of a build goes, and how much of it is not the flow."""
    source = clip_frames(data, BUILD_CLIP)
    print(f"{BUILD_CLIP}, {len(source.names)} frames, {SIZE[0]} x {SIZE[1]}, flow {methods.DEFAULT}.\n")
    print(
        f"Median of {rounds} runs of the verb build-model, from the files to the model and its report, the two ways "
        "in turn. A stage's time runs from the last step of the stage before to its own last; the flow stage also "
        "decodes, registers and writes the frames. Flow alone, registration alone and writing alone: seconds inside "
        "these functions over all threads, divided by the threads. The end saves the model, writes the page and "
        "removes the work folder.\n"
    )
    ways = (steps.worker_count(), 1)
    found: dict[int, list[Timed]] = {workers: [] for workers in ways}
    for number in range(rounds):
        for workers in ways:
            tell(f"build {number + 1} of {rounds} with {workers} threads")
            found[workers].append(_timed_build(data, workers))
    rows = []
    for workers, timed in found.items():
        share = float(np.median([one.rest_of_flow for one in timed]))
        rows.append(
            [
                workers,
                *(f"{np.median([one.walls[stage] for one in timed]):.2f}" for stage in STAGES),
                f"{np.median([one.all for one in timed]):.2f}",
                *(
                    f"{np.median([getattr(one, what) for one in timed]):.2f}"
                    for what in ("flow", "registration", "writing")
                ),
                f"{share:.2f}",
                f"<= 0.5 {at_most(share, 0.5)}; goal 0.3 {at_most(share, 0.3)}",
            ]
        )
    heads = [
        "threads",
        "reference s",
        "flow stage s",
        "second starts s",
        "morphs s",
        "components s",
        "report s",
        "end s",
        "all s",
    ]
    heads += ["flow alone s", "registration alone s", "writing alone s", "(all - flow) / flow", "target"]
    print_table(heads, rows)


def _timed_build(data: Path, workers: int) -> Timed:
    """Build once, with so many threads."""
    walls = dict.fromkeys(STAGES, 0.0)
    flow, registration, writing = Stopwatch(), Stopwatch(), Stopwatch()
    with (
        tempfile.TemporaryDirectory() as folder,
        replaced_flow(methods.DEFAULT, watched_method(flow, methods.METHODS[methods.DEFAULT])),
        replaced(Registration, "of", registration.watched(Registration.of)),
        replaced(work_frames, "write_result", writing.watched(cache.write_result)),
        steps.using_workers(workers),
    ):
        sources = (str(data / "sequences" / BUILD_CLIP),)
        last = time.perf_counter()
        for step in build_model.run(BuildModelRequest(sources, Path(folder) / "face.morph", size=SIZE)):
            now = time.perf_counter()
            walls[step.stage] += now - last
            last = now
        walls["end"] += time.perf_counter() - last
    shared = (one.seconds / workers for one in (flow, registration, writing))
    return Timed(walls, *shared)


def memory(data: Path) -> None:
    """Print the peak memory of builds of 100, 400 and 1600 frames."""
    width, height = MEMORY_SIZE
    print(f"Pictures of {width} x {height} px, flow {MEMORY_FLOW}.\n")
    print(
        f"{BUILD_CLIP} repeated with faint noise, so that no two frames are the same; build, model file and report, a "
        "fresh process each. Peak: the most resident memory of the whole process, interpreter and libraries included. "
        "Gram: one n x n float64.\n"
    )
    rows: list[list[object]] = []
    least = first = 0.0
    for count in COUNTS:
        tell(f"build of {count} frames")
        found = child("build", data, BUILD_CLIP, width, height, MEMORY_FLOW, count)
        gram = 8 * count * count / 1e6
        peak, before = found["peak"] / 1e6, found["before"] / 1e6
        least = least or peak - gram
        first = first or peak
        growth = (peak - gram) / least
        sizes = [f"{before:.0f}", f"{peak:.0f}", f"{gram:.1f}", f"{peak - gram:.0f}"]
        verdict = f"<= 1.2 {at_most(growth, 1.2)}"
        rows.append(
            [
                count,
                f"{found['seconds']:.0f}",
                *sizes,
                f"{growth:.2f}",
                verdict,
                f"{(peak - first) / gram:.1f}",
            ]
        )
    heads = [
        "frames",
        "s",
        "before MB",
        "peak MB",
        "Gram MB",
        "peak - Gram MB",
        "of the first",
        "target",
        "growth in Grams",
    ]
    print_table(heads, rows)
