"""How fast a driving frame becomes a face, beside peers in the same run, and what a long clip holds in memory.

Run as a script it is the fresh process in which one clip is streamed: it prints what it found as JSON.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import mimicry
import numpy as np
from flow_estimators import one_thread
from memory import peak_bytes, resident_bytes
from tables import at_most, interleaved, milliseconds, print_table, ratio, tell

from morphspace.face.mesh import FacePoints
from morphspace.grid import warp
from morphspace.model.morph import morph_of, resource
from morphspace.steps import in_order, result_of
from morphspace.transfer.driver import UsedModel, clip_driver
from morphspace.transfer.mimicry import METHODS, mimic
from morphspace.transfer.quality import reach_of
from morphspace.verbs import mimic as verb

SOURCE, TARGET = "lp_d18", "lp_d6"
DRIVEN = 40  # which frame of the source's clip is timed: an open mouth
STREAMED = 12  # faces
GOAL_MS = 15.0  # of encoding, beyond the flow; and of projecting and rendering
LENGTHS = (100, 300, 1000)  # frames of the driving clip, the source's own over and over
GROWTH_MB = 30.0  # from the shortest to the longest; a row of numbers and a name a frame are less


def mimicry_speed(data: Path, work: Path, rounds: int) -> None:
    """Print what encoding a driving frame and making a face of it cost, then the memory of clips of some lengths."""
    size, count = mimicry.SIZE, mimicry.COMPONENTS
    print(
        f"{SOURCE} drives {TARGET}, {size[0]} x {size[1]}, k = {count}; processor time, median and quartiles of "
        f"{rounds} interleaved rounds. Look: the detector, for a face. Flow: the source's own method, from its "
        "reference to the frame, its own look at the aligned frame included. Align: the head movement, fitted to a "
        "fast flow of its "
        "own. Take apart: re-sourcing and texture. Loadings: of the source's own components, for landmarks and "
        "quality. Driving frame: align, flow, take apart and loadings, which is what mimicry wants of a frame; align "
        "and driving frame are of a frame in which a face has been looked for already, as `mimic` does, unless alone. "
        "Encode: as `encode` does it, from looking to the loadings fitted to the picture. A method: project and "
        f"render; in a stream: {STREAMED} faces in as many threads as the command takes, time of one by the clock, the "
        "only row that is not processor time. Remap: "
        "cv2.remap of the same picture, cubic. One read: the inner product of the target's components with themselves, "
        "in memory. Judged: how far the face follows, as quality.csv tells it.\n"
    )
    source, target = (mimicry.keyed_model(data, name, work) for name in (SOURCE, TARGET))
    frames = _frames(data)
    driver = clip_driver(UsedModel(source, work / f"{SOURCE}.morph", ""), str(frames / "*.jpg"))
    name = driver.names[DRIVEN]
    picture = next(iter(driver.given([DRIVEN])))
    flow = source.flow_from_reference
    look = (lambda image: None) if source.anchor is None else source.anchor.detector
    found = look(picture)
    aligned = source.align(picture, name, found)
    offset = driver.offset(name, picture, found)
    read = source.basis.inner_products()
    loadings = read.with_offset(offset.vector)

    def driving_frame(seen: FacePoints | None) -> None:
        taken = driver.offset(name, picture, seen)
        read.with_offset(taken.vector)

    field = flow(aligned).displacement
    x, y = warp.positions(field)
    flat = np.array(target.basis.components).reshape(-1)
    works: dict[str, Any] = {
        "look": lambda: look(picture),
        "flow": lambda: flow(aligned),
        "align": lambda: source.align(picture, name, found),
        "align, alone": lambda: source.align(picture, name),
        "take apart": lambda: morph_of(aligned.image, resource(field, source.mean_inverse), ""),
        "loadings": lambda: read.with_offset(offset.vector),
        "driving frame": lambda: driving_frame(found),
        "driving frame, alone": lambda: driving_frame(None),
        "encode": lambda: source.encode(picture),
        "remap": lambda: cv2.remap(aligned.image, x, y, cv2.INTER_CUBIC),
        "one read": lambda: np.dot(flat, flat),
    }
    known = source.landmarks is not None and target.landmarks is not None
    methods = [method for method in METHODS if known or method != "guided"]
    for method in methods:
        make = mimic(source, target, method)
        works[method] = lambda make=make: make(offset, loadings).morph.render()
        works[f"{method}, in a stream"] = lambda make=make: list(
            in_order(lambda one: make(one, loadings).morph.render(), [offset] * STREAMED)
        )
        works[f"{method}, project"] = lambda make=make: make(offset, loadings)
    made = mimic(source, target)(offset)
    reach = reach_of(source, target, 1.0)
    works["render"] = made.morph.render
    works["judged"] = lambda: reach(offset, made.morph, made.loadings, loadings)
    streams = {name: works.pop(name) for name in list(works) if name.endswith("in a stream")}
    with one_thread():
        seconds = interleaved(works, rounds, time.process_time)
        by_clock = interleaved(streams, rounds, time.perf_counter)
    seconds |= {name: taken / STREAMED for name, taken in by_clock.items()}
    rows = []
    for what, found in seconds.items():
        beyond, limit = None, ""
        if what in ("encode", "driving frame", "driving frame, alone"):
            beyond = 1e3 * float(np.median(found - seconds["flow"]))
            limit = f"flow + {GOAL_MS:g} {at_most(beyond, GOAL_MS)}"
        elif what.removesuffix(", in a stream") in methods:
            limit = f"<= {GOAL_MS:g} {at_most(1e3 * float(np.median(found)), GOAL_MS)}"
        shares = [f"{ratio(found, seconds[peer]):.2f}" for peer in ("flow", "remap", "one read")]
        rows.append([what, milliseconds(found), "" if beyond is None else f"{beyond:.1f}", *shares, limit])
    print_table(["what", "ms", "beyond flow, ms", "of flow", "of remap", "of one read", "target, ms"], rows)
    _memory(frames, work)


def _frames(data: Path) -> Path:
    return data / "sequences" / SOURCE / "frames"


def _memory(frames: Path, work: Path) -> None:
    print("## Memory of a stream\n")
    print(
        f"`mimic --frames CLIP`, the {SOURCE} clip over and over, a fresh process each: the peak of the resident set, "
        "beside what it was after the imports. The target is for the longest against the shortest.\n"
    )
    models = [work / "mimicry" / f"{name}.morph" for name in (SOURCE, TARGET)]
    rows: list[list[str]] = []
    peaks: list[float] = []
    for length in LENGTHS:
        tell(f"mimicry-speed: a clip of {length} frames")
        command = [sys.executable, __file__, *map(str, models), str(frames), str(length)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        found = json.loads(done.stdout.splitlines()[-1])
        peaks.append(found["peak"] / 1e6)
        grown = peaks[-1] - peaks[0]
        limit = f"+ {GROWTH_MB:g} {at_most(grown, GROWTH_MB)}" if length == LENGTHS[-1] else ""
        cells = [f"{found['before'] / 1e6:.0f}", f"{peaks[-1]:.0f}", f"{grown:+.0f}", limit]
        rows.append([str(length), *cells, f"{found['seconds'] / length * 1e3:.0f}"])
    print_table(["frames", "before MB", "peak MB", "beyond the shortest MB", "target", "ms a frame"], rows)


def stream(source: str, target: str, frames: str, count: int) -> dict[str, Any]:
    """Let a clip of so many frames drive, as the command does; give the memory it took, in bytes."""
    files = sorted(Path(frames).glob("*.jpg"))
    with tempfile.TemporaryDirectory() as folder:
        clip = Path(folder) / "clip"
        clip.mkdir()
        for index in range(count):
            shutil.copyfile(files[index % len(files)], clip / f"f{index:05d}.jpg")
        before = resident_bytes()
        start = time.perf_counter()
        result_of(verb.run(verb.MimicRequest(source, target, Path(folder) / "out", frames=str(clip))))
        return {"before": before, "peak": peak_bytes(), "seconds": time.perf_counter() - start}


if __name__ == "__main__":
    print(json.dumps(stream(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]))))
