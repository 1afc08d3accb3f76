"""Two drawn people with models, and the commands whose writing is disturbed."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SIZE = "48x60"
FRAMES = 6
FAST = ("--flow", "fast", "--warp-weight", "0.02", "--landmarks", "none")
RECIPE = """\
format: morphspace-recipe
version: 1
factors: {gain: [0.5, 1.5]}
stimuli:
  - {verb: caricature, model: a.morph, loadings: a.csv, gains: "{gain}"}
  - {verb: sample, model: a.morph, count: 2, seed: 7}
"""
POINTS = "17,24 31,24 24,38"  # both eyes and the philtrum of faces of this size, px
COMMANDS = {
    "build-model": ("build-model", "actors/actor_01", "-o", "out/m.morph", *FAST),
    "encode": ("encode", "a.morph", "actors/actor_01", "-o", "out/t.csv"),
    "reconstruct": ("reconstruct", "a.morph", "actors/actor_01", "-o", "out", "-k", "2"),
    "mimic": ("mimic", "--src", "a.morph", "--dst", "b.morph", "-o", "out", "--method", "paper"),
    "blend-avatar": ("blend-avatar", "a.morph", "b.morph", "-o", "out/v.morph", "--expressions", "2"),
    "caricature": ("caricature", "a.morph", "--loadings", "a.csv", "-o", "out", "--gain", "1,2"),
    "render": ("render", "a.morph", "a.csv", "-o", "out/v.mkv"),
    "batch": ("batch", "recipe.yaml", "-o", "out", "--workers", "1"),
    "measure-mimicry": ("measure-mimicry", "a.csv", "a.csv", "--model", "a.morph", "-o", "out"),
    "flow": ("flow", "A.png", "B.png", "-o", "out/f.flo", "--both", "--preset", "fast"),
    "make-actors": ("make-actors", "-o", "out", "--identities", "1", "--frames", "3", "--size", SIZE),
}
# Runs the command line with a disturbance: argv[1] is Python that may wrap functions first.
WRAPPER = """
    import os, pathlib, signal, sys
    exec(sys.argv[1])
    sys.argv = ["morphspace", *sys.argv[2:]]
    from morphspace.__main__ import run
    run()
"""


def environment(networks: Path) -> dict[str, str]:
    return {
        **os.environ,
        "MORPHSPACE_MODELS": str(networks),
        "MORPHSPACE_WORKERS": "1",
        "PYTHONPATH": str(ROOT),
    }


class Lab:
    """A folder with inputs, in which commands run; `out` is what they write."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "out"

    def start(self, *words: str, disturbed: str = "") -> subprocess.Popen:
        return subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(WRAPPER), disturbed, *words],
            cwd=self.folder,
            env=environment(self.folder / "none"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *words: str, disturbed: str = "") -> subprocess.CompletedProcess:
        started = self.start(*words, disturbed=disturbed)
        stdout, stderr = started.communicate()
        return subprocess.CompletedProcess(words, started.returncode, stdout, stderr)

    def files(self) -> dict[str, bytes]:
        """Every file that was written, hidden ones too."""
        return {
            path.relative_to(self.out).as_posix(): path.read_bytes()
            for path in sorted(self.out.rglob("*"))
            if path.is_file()
        }

    def done(self, *words: str) -> str:
        ended = self.run(*words)
        assert ended.returncode in (0, 3), ended.stderr
        return ended.stderr


@pytest.fixture(scope="session")
def inputs(tmp_path_factory) -> Path:
    lab = Lab(tmp_path_factory.mktemp("inputs"))
    lab.done("make-actors", "-o", "actors", "--identities", "2", "--frames", str(FRAMES), "--size", SIZE)
    for name, actor in (("a", "actor_01"), ("b", "actor_02")):
        lab.done("build-model", f"actors/{actor}", "-o", f"{name}.morph", *FAST)
        lab.done("keypoints", f"{name}.morph", "--set", POINTS)
        lab.done("info", f"{name}.morph", "--loadings", f"{name}.csv")
    lab.done("sample", "a.morph", "-o", "stimuli", "--count", "1")
    frames = sorted((lab.folder / "actors" / "actor_01").glob("*.png"))
    for name, frame in zip(("A.png", "B.png"), frames, strict=False):
        (lab.folder / name).write_bytes(frame.read_bytes())
    (lab.folder / "recipe.yaml").write_text(RECIPE)
    return lab.folder


@pytest.fixture
def lab(inputs, tmp_path) -> Lab:
    """A lab of its own; the inputs are linked, since no command may change them."""
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    return Lab(tmp_path)


@pytest.fixture(params=COMMANDS)
def command(request) -> tuple[str, ...]:
    """The words of each command."""
    return COMMANDS[request.param]


@pytest.fixture(scope="session")
def whole(inputs, tmp_path_factory):
    """The files of each command that nobody disturbed, and the number of renames with which it wrote them."""
    made: dict[tuple[str, ...], tuple[dict[str, bytes], int]] = {}

    def of(words: tuple[str, ...]) -> tuple[dict[str, bytes], int]:
        if words not in made:
            folder = tmp_path_factory.mktemp(words[0])
            for path in inputs.iterdir():
                (folder / path.name).symlink_to(path)
            lab = Lab(folder)
            ended = lab.run(*words, disturbed=COUNTED)
            assert ended.returncode in (0, 3), ended.stderr
            made[words] = lab.files(), int(ended.stderr.rsplit("renames ", 1)[1])
        return made[words]

    return of


COUNTED = """
import atexit
count = 0
replace = pathlib.Path.replace
def counted(self, target):
    global count
    count += 1
    return replace(self, target)
pathlib.Path.replace = counted
atexit.register(lambda: print("renames", count, file=sys.stderr))
"""
