"""Measure what morphspace promises, on the clips it was made for, and print it as Markdown tables.

    python benchmarks/bench.py SECTION... --data DIR [--judge PYTHON] [--work DIR] [--clips NAME...] [--rounds N]

DIR holds sequences/NAME/frames/*.jpg (or set MORPHSPACE_DATA), and for the sections whose names begin with flow
also flow/SCENE and stills_london; PYTHON is the interpreter of the landmark judge (see benchmarks/landmark_judge.py).
Sections that need no data: pca, render, open, warp, help, video. Times stand beside a peer in the same run; the ratios
carry over to another machine, the times do not. Run flow-time on a quiet machine. Models and flow are kept in the work
folder, so that a second section, or a second run with the same --work, does not make them again: empty it when the
code changes.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import bench_avatar
import bench_avatar_drawn
import bench_avatar_matching
import bench_batch
import bench_build
import bench_detection
import bench_flow
import bench_flow_ablation
import bench_flow_confidence
import bench_flow_time
import bench_landmarks
import bench_mimicry
import bench_mimicry_drawn
import bench_mimicry_speed
import bench_motion
import bench_quality
import bench_speed
import bench_stimuli
import bench_video
from bench_clips import CLIPS
from bench_tables import print_table

from morphspace.errors import BadInput

PACKAGES = (
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "scikit-image",
    "scikit-learn",
    "OpenImageIO",
)
FLOW_SECTIONS = (
    "flow",
    "flow-time",
    "flow-ablation",
    "flow-confidence",
)  # errors; times; what each part of the estimator is worth; confidence
DATA_SECTIONS = (
    "roundtrip",
    "heldout",
    "heldout-landmarks",
    "landmarks",
    "ceiling",
    "build",
    "memory",
    "detection",
    "mimicry",
    "mimicry-speed",
    "motion",
    "batch",
    "stimuli",
    "avatar",
    "avatar-laws",
    "avatar-cost",
    "avatar-correspondence",
    *FLOW_SECTIONS,
)
OTHER_SECTIONS = ("pca", "render", "open", "warp", "help", "video", "mimicry-drawn", "avatar-drawn")
FACE_JUDGED = {"mimicry", "avatar", "avatar-correspondence"}
BUILD_ROUNDS = 3  # at most; a build takes minutes


def context() -> None:
    """Print what the numbers depend on besides the machine itself."""
    rows = [["Python", platform.python_version()]]
    for package in PACKAGES:
        try:
            rows.append([package, importlib.metadata.version(package)])
        except importlib.metadata.PackageNotFoundError:
            rows.append([package, "not installed"])
    rows.append(["system", f"{platform.system()} {platform.machine()}"])
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    rows.append(["CPU cores", str(cores)])
    print_table(["what", "version"], rows)


def run(section: str, arguments: argparse.Namespace, work: Path) -> None:
    """Run one section."""
    clips = tuple(arguments.clips)
    data: Path = arguments.data
    rounds: int = arguments.rounds
    if section == "roundtrip":
        bench_quality.round_trip(data, clips, work)
    elif section == "heldout":
        bench_quality.held_out(data, clips, work)
    elif section == "heldout-landmarks":
        bench_quality.with_landmarks(data, clips, work)
    elif section == "landmarks":
        bench_landmarks.landmarks(data, clips, work, arguments.judge)
    elif section == "ceiling":
        bench_landmarks.ceiling(data, clips, work, arguments.judge)
    elif section == "build":
        bench_build.stages(data, min(rounds, BUILD_ROUNDS))
    elif section == "memory":
        bench_build.memory(data)
    elif section == "pca":
        bench_speed.pca(min(rounds, 7))
        bench_speed.pca_memory()
    elif section == "render":
        bench_speed.render(rounds, work)
    elif section == "open":
        bench_speed.open_model(rounds, work)
    elif section == "warp":
        bench_speed.inversion(rounds)
    elif section == "flow":
        bench_flow.flow(data)
    elif section == "flow-time":
        bench_flow_time.flow_time(data, rounds)
    elif section == "flow-ablation":
        bench_flow_ablation.flow_ablation(data)
    elif section == "flow-confidence":
        bench_flow_confidence.flow_confidence(data)
    elif section == "detection":
        bench_detection.detection(data, work, arguments.judge)
    elif section == "mimicry":
        bench_mimicry.mimicry(data, work, arguments.face_judge)
    elif section == "mimicry-speed":
        bench_mimicry_speed.mimicry_speed(data, work, rounds)
    elif section == "mimicry-drawn":
        bench_mimicry_drawn.mimicry_drawn(work)
    elif section == "stimuli":
        bench_stimuli.stimuli(data, work, rounds)
    elif section == "batch":
        bench_batch.batch_figures(data, work, rounds)
    elif section == "motion":
        bench_motion.motion(data, work)
    elif section == "avatar":
        bench_avatar.avatar(data, work, arguments.face_judge)
    elif section == "avatar-laws":
        bench_avatar.avatar_laws(data, work)
    elif section == "avatar-cost":
        bench_avatar.avatar_cost(data, work)
    elif section == "avatar-correspondence":
        bench_avatar_matching.avatar_correspondence(data, work, arguments.face_judge)
    elif section == "avatar-drawn":
        bench_avatar_drawn.avatar_drawn(work)
    elif section == "video":
        bench_video.video_form()
    else:
        bench_speed.help_time(rounds)


def positive(text: str) -> int:
    """Give a whole number of one or more, for argparse."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than 1")
    return number


def main(words: Sequence[str]) -> int:
    """Run the sections asked for, in the order given; return the exit status."""
    parser = argparse.ArgumentParser(prog="bench.py", description="Print benchmark tables.")
    parser.add_argument("sections", nargs="+", choices=(*DATA_SECTIONS, *OTHER_SECTIONS), metavar="SECTION")
    parser.add_argument("--data", type=Path, default=os.environ.get("MORPHSPACE_DATA"))
    parser.add_argument("--judge", help="python that holds the landmark detector")
    parser.add_argument(
        "--face-judge", help="python that holds the judge of mimicry and avatar (benchmarks/face_judge.py)"
    )
    parser.add_argument("--work", type=Path, help="folder for models and flow (default: a temporary one)")
    parser.add_argument("--clips", nargs="+", default=CLIPS, metavar="NAME")
    parser.add_argument("--rounds", type=positive, default=21, help="of each timing (default 21)")
    parser.usage = f"bench.py [options] {{{','.join((*DATA_SECTIONS, *OTHER_SECTIONS))}}}..."
    arguments = parser.parse_args(words)
    if arguments.data is None and any(section in DATA_SECTIONS for section in arguments.sections):
        parser.error("these sections need the clips: give --data or set MORPHSPACE_DATA")
    if arguments.face_judge is None and FACE_JUDGED & set(arguments.sections):
        parser.error(
            "mimicry, avatar and avatar-correspondence need --face-judge, the python that holds their judge"
        )
    if arguments.judge is None and {"landmarks", "ceiling", "detection"} & set(arguments.sections):
        parser.error("landmarks need --judge, the python that holds the detector")
    with tempfile.TemporaryDirectory() as temporary:
        work = arguments.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        try:
            context()
            for section in arguments.sections:
                run(section, arguments, work)
        except BadInput as error:
            print(f"bench.py: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
