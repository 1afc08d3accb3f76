"""Measure what morphspace promises, and write one Markdown file for each section.

    python benchmarks/run.py SECTION... --data DIR [--mesh-judge PYTHON] [--face-judge PYTHON] [--work DIR]

DIR holds sequences/NAME/frames/*.jpg (or set MORPHSPACE_DATA); the sections of the flow also read flow/SCENE, laid
out as Middlebury does, and stills_london. PYTHON is the interpreter of a judge: judges/mesh.py and judges/face.py say
how to make it. Each result names its command, versions, commit and cores and is written to benchmarks/results. Text
there under "## Remarks" is written by hand and kept. Times stand beside a peer of the same run: the ratios carry over
to another machine, the times do not. Models and flow are kept in the work folder: share it between runs with --work,
and empty it when the code changes.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import io
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import avatar
import avatar_drawn
import batch
import build
import carried
import detection
import flow
import flow_confidence
import flow_time
import heldout
import landmarks
import mimicry
import mimicry_drawn
import mimicry_speed
import motion
import speed
import stimuli
import video
from clips import CLIPS

from morphspace.errors import BadInput
from morphspace.storage import whole_file

HERE = Path(__file__).parent
PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "scikit-image", "scikit-learn", "OpenImageIO")
REMARKS = "## Remarks"
MOST_BUILDS, MOST_FITS = 3, 7  # rounds; a build takes minutes, a fit of scikit-learn five seconds


@dataclass(frozen=True)
class Run:
    """What a section is given: the data, the work folder, the interpreters of the judges, clips and rounds."""

    data: Path
    work: Path
    mesh_judge: str
    face_judge: str
    clips: tuple[str, ...]
    rounds: int


@dataclass(frozen=True)
class Section:
    """One table or a few: `title` of its file, `measure` prints it, `needs` names the options it cannot do without."""

    title: str
    measure: Callable[[Run], object]
    needs: tuple[str, ...] = ()


DATA, MESH, FACE = "--data", "--mesh-judge", "--face-judge"
SECTIONS: dict[str, Section] = {
    "heldout": Section(
        "Held-out reconstruction", lambda run: heldout.held_out(run.data, run.clips, run.work), (DATA,)
    ),
    "heldout-landmarks": Section(
        "Held-out reconstruction, without and with landmarks",
        lambda run: heldout.with_landmarks(run.data, run.clips, run.work),
        (DATA,),
    ),
    "roundtrip": Section(
        "Round trip without truncation",
        lambda run: heldout.round_trip(run.data, run.clips, run.work),
        (DATA,),
    ),
    "landmarks": Section(
        "Landmarks of the reconstruction",
        lambda run: landmarks.landmarks(run.data, run.clips, run.work, run.mesh_judge),
        (DATA, MESH),
    ),
    "carried": Section(
        "What the warp carries", lambda run: carried.carried(run.data, run.work, run.face_judge), (DATA, FACE)
    ),
    "carried-drawn": Section(
        "What the warp carries: drawn actors", lambda run: carried.carried_drawn(run.work)
    ),
    "detection": Section(
        "Face points, against MediaPipe's own",
        lambda run: detection.detection(run.data, run.work, run.mesh_judge),
        (DATA, MESH),
    ),
    "mimicry": Section(
        "Mimicry", lambda run: mimicry.mimicry(run.data, run.work, run.face_judge), (DATA, FACE)
    ),
    "mimicry-report": Section(
        "Mimicry of people on whom nothing was chosen",
        lambda run: mimicry.mimicry_report(run.data, run.work, run.face_judge, run.mesh_judge),
        (DATA, FACE, MESH),
    ),
    "mimicry-drawn": Section("Mimicry of drawn actors", lambda run: mimicry_drawn.mimicry_drawn(run.work)),
    "mimicry-speed": Section(
        "Speed of mimicry",
        lambda run: mimicry_speed.mimicry_speed(run.data, run.work, run.rounds),
        (DATA,),
    ),
    "avatar": Section("Avatar", lambda run: avatar.avatar(run.data, run.work, run.face_judge), (DATA, FACE)),
    "avatar-laws": Section("Laws of the avatar", lambda run: avatar.avatar_laws(run.data, run.work), (DATA,)),
    "avatar-cost": Section("Cost of the avatar", lambda run: avatar.avatar_cost(run.data, run.work), (DATA,)),
    "avatar-drawn": Section("Avatar of drawn actors", lambda run: avatar_drawn.avatar_drawn(run.work)),
    "stimuli": Section(
        "Gains, statistics and speed of stimulus sets",
        lambda run: stimuli.stimuli(run.data, run.work, run.rounds),
        (DATA,),
    ),
    "motion": Section("Continua and motion", lambda run: motion.motion(run.data, run.work), (DATA,)),
    "batch": Section("Batches", lambda run: batch.batch_figures(run.data, run.work, run.rounds), (DATA,)),
    "flow": Section("Flow: errors", lambda run: flow.flow(run.data), (DATA,)),
    "flow-time": Section("Flow: times", lambda run: flow_time.flow_time(run.data, run.rounds), (DATA,)),
    "flow-confidence": Section(
        "Flow: confidence", lambda run: flow_confidence.flow_confidence(run.data), (DATA,)
    ),
    "video": Section("Flow: video form", lambda run: video.video_form()),
    "build": Section(
        "Stages of a build", lambda run: build.stages(run.data, min(run.rounds, MOST_BUILDS)), (DATA,)
    ),
    "memory": Section("Memory of a build", lambda run: build.memory(run.data), (DATA,)),
    "pca": Section("PCA", lambda run: (speed.pca(min(run.rounds, MOST_FITS)), speed.pca_memory())),
    "render": Section("Rendering", lambda run: speed.render(run.rounds, run.work)),
    "warp": Section("Inverting a warp", lambda run: speed.inversion(run.rounds)),
    "open": Section("Opening a model", lambda run: speed.open_model(run.rounds, run.work)),
    "help": Section("Help", lambda run: speed.help_time(run.rounds)),
}


def head(name: str, options: Sequence[str]) -> str:
    """Return the head of a result file: title, command, versions, commit and cores."""
    versions = {"Python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    command = " ".join(["python benchmarks/run.py", name, *options])
    return (
        f"# {SECTIONS[name].title}\n\n"
        f"`{command}`\n\n"
        f"Commit {commit()}. {', '.join(f'{what} {version}' for what, version in versions.items())}. "
        f"{platform.system()} {platform.machine()}, {cores} cores, load {os.getloadavg()[0]:.1f} when it ended.\n\n"
    )


def commit() -> str:
    """Return the short name of the commit that is measured, with a plus sign where the package has local changes."""
    try:
        name, changes = (
            subprocess.run(
                ["git", "-C", str(HERE.parent), *words], capture_output=True, text=True, check=True
            ).stdout.strip()
            for words in (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "morphspace"])
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return name + ("+" if changes else "")


def remarks(path: Path) -> str:
    """Return what a result file holds from the line `REMARKS` on; an empty string where there is none."""
    if not path.exists():
        return ""
    text = path.read_text(encoding="utf-8")
    place = text.find(f"\n{REMARKS}\n")
    return "" if place < 0 else text[place + 1 :]


def write_result(name: str, options: Sequence[str], body: str, folder: Path) -> Path:
    """Write the result file of a section, whole or not at all; remarks of an earlier file are kept."""
    path = folder / f"{name}.md"
    text = head(name, options) + body.strip("\n") + "\n"
    if kept := remarks(path):
        text += "\n" + kept
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
    return path


def measured(name: str, run: Run) -> str:
    """Return what a section prints; it is printed as well, as it comes."""
    found = io.StringIO()

    class Both(io.TextIOBase):
        def write(self, text: str) -> int:
            sys.__stdout__.write(text)
            sys.__stdout__.flush()
            return found.write(text)

    with contextlib.redirect_stdout(Both()):
        SECTIONS[name].measure(run)
    return found.getvalue()


def positive(text: str) -> int:
    """Return a whole number of one or more, for argparse."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"the number is {number}; expected 1 or more")
    return number


def main(words: Sequence[str]) -> int:
    """Run the sections in the order given; return the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="Measure and write Markdown tables.")
    parser.add_argument("sections", nargs="+", choices=SECTIONS, metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument(DATA, type=Path, metavar="DIR", default=os.environ.get("MORPHSPACE_DATA"))
    parser.add_argument(MESH, metavar="PYTHON", help="interpreter of judges/mesh.py")
    parser.add_argument(FACE, metavar="PYTHON", help="interpreter of judges/face.py")
    parser.add_argument("--work", type=Path, metavar="DIR", help="models and flow (default: a temporary one)")
    parser.add_argument("--results", type=Path, metavar="DIR", default=HERE / "results")
    parser.add_argument("--clips", nargs="+", default=CLIPS, metavar="NAME")
    parser.add_argument("--rounds", type=positive, default=21, help="of each timing (default 21)")
    arguments = parser.parse_args(words)
    given = {DATA: arguments.data, MESH: arguments.mesh_judge, FACE: arguments.face_judge}
    for name in arguments.sections:
        if missing := [option for option in SECTIONS[name].needs if given[option] is None]:
            parser.error(f"{name} needs {' and '.join(missing)}")
    changed = [] if arguments.clips == CLIPS else ["--clips", *arguments.clips]
    changed += [] if arguments.rounds == parser.get_default("rounds") else ["--rounds", str(arguments.rounds)]
    placeholders = {DATA: "DIR", MESH: "PYTHON", FACE: "PYTHON"}
    with tempfile.TemporaryDirectory() as temporary:
        work = arguments.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        run = Run(
            arguments.data,
            work,
            arguments.mesh_judge,
            arguments.face_judge,
            tuple(arguments.clips),
            arguments.rounds,
        )
        try:
            for name in arguments.sections:
                body = measured(name, run)
                options = [word for option in SECTIONS[name].needs for word in (option, placeholders[option])]
                write_result(name, [*options, *changed], body, arguments.results)
        except BadInput as error:
            print(f"run.py: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
