"""Peak memory, and times of a first use: measured in fresh processes, so that nothing else counts.

Run as a script it is such a process: it does one thing and prints what it found as JSON.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

NOISE_SD = 0.5 / 255  # colour; makes each repeat of a frame a frame of its own
SEED = 0


def child(task: str, *words: object) -> dict[str, Any]:
    """Do one task in a fresh process and give what it found."""
    command = [sys.executable, str(Path(__file__)), task, *map(str, words)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def peak_bytes() -> int:
    """Give the most memory this process has had resident.

    On Linux from the process's own page tables: `getrusage` there starts with the parent's peak, which a fresh process
    takes over when it is started.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return _kilobytes_of(status, "VmHWM") * 1024
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def resident_bytes() -> int:
    """Give the memory resident now; where the system does not tell, the peak so far."""
    status = Path("/proc/self/status")
    return _kilobytes_of(status, "VmRSS") * 1024 if status.exists() else peak_bytes()


def _kilobytes_of(status: Path, field: str) -> int:
    lines = (line.split() for line in status.read_text().splitlines())
    return next(int(words[1]) for words in lines if words and words[0] == f"{field}:")


def pca_task(count: int, numbers: int, components: int) -> dict[str, Any]:
    """Fit a PCA over drawn rows on the disk."""
    from morphspace.linear.pca import fit_basis
    from morphspace.linear.rows import RowFile

    rng = np.random.default_rng(SEED)
    weight = np.ones(numbers, np.float32)
    with tempfile.TemporaryDirectory() as folder, RowFile(Path(folder) / "rows", count, numbers) as rows:
        for index in range(count):
            row = rng.standard_normal(numbers, np.float32)
            row[: numbers // 2] *= index % 7
            rows.write_row(index, row)
        before = resident_bytes()
        mean, basis, loadings = fit_basis(rows, weight, components)
        output = mean.nbytes + basis.components.nbytes + basis.variances.nbytes + loadings.nbytes
        return {
            "before": before,
            "peak": peak_bytes(),
            "input": count * numbers * 4,
            "output": output,
        }


def open_task(path: str, rounds: int) -> dict[str, Any]:
    """Open a model three ways: file not cached, cached, and again."""
    from morphspace.model.model import load_model

    handle = os.open(path, os.O_RDONLY)
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    os.close(handle)
    times = []
    for _ in range(2):
        start = time.perf_counter()
        load_model(path)
        uncached = time.perf_counter() - start
        times.append(uncached)
        os.utime(path)  # a file of another time is checked again
    start = time.perf_counter()
    Path(path).read_bytes()
    Path(path).read_bytes()
    read = (time.perf_counter() - start) / 2
    again = []
    for _ in range(rounds):
        start = time.perf_counter()
        load_model(path)
        again.append(time.perf_counter() - start)
    return {"uncached_s": times[0], "first_s": times[1], "again_s": float(np.median(again)), "read_s": read}


@dataclass(frozen=True, eq=False)
class NoisyFrames:
    """A clip repeated to any length, each frame with its own faint noise: a `FrameSource`."""

    images_once: list[Any]
    count: int

    @property
    def names(self) -> tuple[str, ...]:
        """The name of each frame."""
        return tuple(f"f{index:05d}" for index in range(self.count))

    @property
    def digests(self) -> tuple[str, ...]:
        """What each frame is made from: enough inside one run."""
        return tuple(f"noisy {index}" for index in range(self.count))

    def images(self, indices: list[int]) -> Iterator[Any]:
        """Give the frames (h, w, 3)."""
        for index in indices:
            image = self.images_once[index % len(self.images_once)]
            noise = np.random.default_rng([SEED, index]).standard_normal(image.shape, np.float32)
            yield image + np.float32(NOISE_SD) * noise


def build_task(data: str, name: str, width: int, height: int, flow: str, count: int) -> dict[str, Any]:
    """Build a model of `count` frames, and its report."""
    from clips import clip_frames

    from morphspace.model.passes import BuildSettings, build_steps
    from morphspace.report.build_page import write_build_page
    from morphspace.report.frames import measure_frames
    from morphspace.steps import result_of

    source = clip_frames(Path(data), name, (width, height))
    once = list(source.images(list(range(len(source.names)))))
    before = resident_bytes()
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        steps = build_steps(
            NoisyFrames(once, count), BuildSettings(flow=flow), Path(folder), {"identity": name}
        )
        build = result_of(steps)
        build.model.save(Path(folder) / "face.morph")
        write_build_page(Path(folder) / "face.html", build, result_of(measure_frames(build)))
        rank = build.model.rank
        return {"before": before, "peak": peak_bytes(), "seconds": time.perf_counter() - start, "rank": rank}


def main(words: list[str]) -> None:
    """Do the task named first."""
    task, *rest = words
    if task == "pca":
        found = pca_task(*map(int, rest))
    elif task == "open":
        found = open_task(rest[0], int(rest[1]))
    else:
        data, name, width, height, flow, count = rest
        found = build_task(data, name, int(width), int(height), flow, int(count))
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1:])
