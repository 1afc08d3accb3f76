"""Break the code in small ways, and count how many of the breaks the default tests notice.

    python tests/mutants.py --count 60 --seed 1

A mutant is the code with one change: a constant of a module or another number ten times as large, a tenth of it or of
the other sign; a comparison turned round, `and` for `or`, a `not` left out; `+` for `-`. An index and an axis become
the one beside them: ten times as large they only raise, and with the other sign the second of two is the second. A
quarter of the mutants is of each kind, drawn from the rooms below. Docstrings, annotations, f-strings and the words of
errors stay as they are.

Each mutant lives in a copy of the project, never in the working tree. The default tests run once as the code is, which
tells what fails anyway, and which test runs which line. A mutant meets the tests that run its line, those of its own
room first, and then the rest of their files; no other test could notice it. For a constant of a module these are the
tests that run anything of that module. A mutant that passes has survived: a test is missing, or the change makes no
difference that matters. `--reach FILE` keeps what the first run found, for runs after it. A mutant without end counts
as killed: no run may compute for ten times as long as its tests took, and two minutes, however busy the machine is.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import queue
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("transfer", "model/fit.py", "avatar", "stimuli")
NOT_COPIED = shutil.ignore_patterns(
    ".git", "*_cache", ".hypothesis", "__pycache__", "build", "dist", "*.egg-info"
)
FLIPPED = {
    ast.Lt: ">=", ast.GtE: "<", ast.Gt: "<=", ast.LtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
}  # fmt: skip
MOST_NODES = 400  # tests named one by one; the rest come with their files
# Seconds of computing, and times what the tests took: a loop without end
MOST_START_S, MOST_TIMES = 120.0, 10.0
KINDS = ("constant", "number", "comparison", "sign")


@dataclass(frozen=True)
class Mutant:
    """One change: the characters from `start` to `end` of a file become `text`."""

    path: Path
    line: int
    kind: str
    start: int
    end: int
    text: str
    shown: str

    @property
    def where(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}"


class Sites(ast.NodeVisitor):
    """The places of one file that can be changed, each with its possible changes."""

    def __init__(self, path: Path) -> None:
        self.path, self.source = path, path.read_text()
        lengths = [len(line) for line in self.source.splitlines(keepends=True)]
        self.starts = [sum(lengths[:n]) for n in range(len(lengths))]
        self.found: list[list[Mutant]] = []
        self.depth = 0  # in functions
        self.indices: set[ast.AST] = set()
        self.visit(ast.parse(self.source))

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            return
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            self.visit(node.value)
            return
        if isinstance(node, ast.FunctionDef):
            self.depth += 1
            for part in (*node.args.defaults, *filter(None, node.args.kw_defaults), *node.body):
                self.visit(part)
            self.depth -= 1
            return
        if (
            isinstance(node, ast.Subscript)
            and isinstance(node.value, ast.Name)
            and node.value.id == "Literal"
        ):
            return
        if isinstance(node, ast.Subscript):
            self.indices.update(node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice])
        elif isinstance(node, ast.keyword) and node.arg == "axis":
            self.indices.add(node.value)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            self.add(node, "comparison", [f"({self.text(node.operand)})"])
        elif isinstance(node, ast.BoolOp):
            words = (" or ", " and ") if isinstance(node.op, ast.And) else (" and ", " or ")
            self.add(
                node, "comparison", ["(" + words[0].join(f"({self.text(one)})" for one in node.values) + ")"]
            )
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            left, right = self.text(node.left), self.text(node.comparators[0])
            self.add(node, "comparison", [f"(({left}) {FLIPPED[type(node.ops[0])]} ({right}))"])
        elif (
            isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub) and not self.is_text(node)
        ):
            other = "-" if isinstance(node.op, ast.Add) else "+"
            self.add(node, "sign", [f"(({self.text(node.left)}) {other} ({self.text(node.right)}))"])
        elif (
            isinstance(node, ast.AugAssign)
            and isinstance(node.op, ast.Add | ast.Sub)
            and not self.is_text(node)
        ):
            other = "-" if isinstance(node.op, ast.Add) else "+"
            self.add(node, "sign", [f"{self.text(node.target)} {other}= ({self.text(node.value)})"])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            self.add(node, "sign", [f"({self.text(node.operand)})"])
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            kind = "number" if self.depth else "constant"
            is_index = node in self.indices and node.value > 0
            self.add(node, kind, [f"{node.value - 1}"] if is_index else self.other_numbers(node.value))
        self.generic_visit(node)

    @staticmethod
    def other_numbers(value: float) -> list[str]:
        if value == 0:
            return ["1"]
        tenth = value / 10 if isinstance(value, float) or value % 10 else value // 10
        if isinstance(tenth, float) and isinstance(value, int):
            return [f"{value * 10}", f"(-{value})"]
        return [repr(value * 10), repr(tenth), f"(-{value!r})"]

    @staticmethod
    def is_text(node: ast.AST) -> bool:
        texts = (ast.JoinedStr, ast.List, ast.Tuple)
        return any(
            isinstance(one, texts) or (isinstance(one, ast.Constant) and isinstance(one.value, str | bytes))
            for one in ast.walk(node)
        )

    def text(self, node: ast.AST) -> str:
        return ast.get_source_segment(self.source, node) or ""

    def add(self, node: ast.expr | ast.stmt, kind: str, texts: list[str]) -> None:
        start, end = (
            self.starts[line - 1] + len(self.source[self.starts[line - 1] :].encode()[:column].decode())
            for line, column in (
                (node.lineno, node.col_offset),
                (node.end_lineno or 0, node.end_col_offset or 0),
            )
        )
        for text in texts:
            ast.parse(self.source[:start] + text + self.source[end:])
        was = " ".join(self.source[start:end].split())
        self.found.append(
            [
                Mutant(self.path, node.lineno, kind, start, end, text, f"{was} -> {' '.join(text.split())}")
                for text in texts
            ]
        )


def files_of(room: str) -> list[Path]:
    place = ROOT / "morphspace" / room
    return [place] if place.suffix == ".py" else sorted(place.rglob("*.py"))


def candidates(rooms: list[str]) -> list[list[Mutant]]:
    """Give all places that can be changed, each with its changes."""
    return [changes for room in rooms for path in files_of(room) for changes in Sites(path).found]


def drawn_from(sites: list[list[Mutant]], count: int, seed: int, kinds: list[str]) -> list[Mutant]:
    """Draw `count` different mutants, equally many of each kind; all of them where `count` is 0.

    The draw goes by what the places say, so that other changes of the code leave it as it is.
    """
    ranks: dict[str, list[Mutant]] = {}
    for changes in sites:
        words = f"{seed} {changes[0].path.relative_to(ROOT)} {changes[0].shown}"
        same = sum(rank.startswith(words) for rank in ranks)
        ranks[f"{words} {same}"] = changes
    drawn: list[Mutant] = []
    for number, kind in enumerate(kinds):
        those = {rank: changes for rank, changes in ranks.items() if changes[0].kind == kind}
        if count == 0:
            drawn += [change for changes in those.values() for change in changes]
            continue
        share = count // len(kinds) + (number < count % len(kinds))
        for rank in sorted(those, key=digest)[:share]:
            drawn.append(those[rank][digest(rank)[0] % len(those[rank])])
    return sorted(drawn, key=lambda one: (one.where.split(":")[0], one.line, one.start))


def digest(words: str) -> bytes:
    return hashlib.sha256(words.encode()).digest()


class Reach:
    """A pytest plugin that notes which test runs which of the lines that will be changed, and for how long it runs."""

    def __init__(self, wanted: dict[str, list[int]], folder: Path) -> None:
        self.wanted = {str(Path.cwd() / name): (name, frozenset(lines)) for name, lines in wanted.items()}
        self.folder = folder
        self.found: dict[str, dict[str, float]] = {}
        self.lines: set[str] = set()

    def frame(self, frame: FrameType, event: str, _: object) -> Callable[..., object] | None:
        if frame.f_code.co_filename not in self.wanted:
            return None
        self.lines.add(self.wanted[frame.f_code.co_filename][0])
        return self.line

    def line(self, frame: FrameType, event: str, _: object) -> Callable[..., object]:
        name, lines = self.wanted[frame.f_code.co_filename]
        if frame.f_lineno in lines:
            self.lines.add(f"{name}:{frame.f_lineno}")
        return self.line

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.lines = set()
        started = time.process_time()
        threading.settrace(self.frame)
        sys.settrace(self.frame)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
            for place in self.lines:
                self.found.setdefault(place, {})[item.nodeid] = time.process_time() - started

    def pytest_sessionfinish(self) -> None:
        if self.found:
            (self.folder / f"{os.getpid()}.json").write_text(json.dumps(self.found))


def pytest_configure(config: pytest.Config) -> None:
    """Take part in the first run, which names this file as a plugin."""
    wanted = json.loads(Path(os.environ["MUTANTS_LINES"]).read_text())
    config.pluginmanager.register(Reach(wanted, Path(os.environ["MUTANTS_FOUND"])))


@dataclass
class Copy:
    """A copy of the project in which one mutant after the other lives; `failing` tests fail without any mutant."""

    folder: Path
    failing: list[str] = field(default_factory=list)

    def pytest(self, words: list[str], most_s: float, **more: str) -> tuple[str, str]:
        """Run the default tests named by `words`: `passed`, `killed` with all failures, or `timeout`.

        No process may compute for longer than `most_s`, however busy the machine is.
        """
        path = os.pathsep.join([str(self.folder), str(self.folder / "tests")])
        environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", **more}
        words = [*words, *(f"--deselect={one}" for one in self.failing)]
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
        process = subprocess.Popen(
            command,
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (round(most_s), round(most_s))),
        )
        out, _ = process.communicate()
        if process.returncode < 0:
            return "timeout", ""
        if process.returncode in (0, 5):  # 5: no test was collected
            return "passed", ""
        found = re.findall(r"^(?:FAILED|ERROR) (\S+)", out, re.MULTILINE)
        return "killed", " ".join(found) or out.strip().splitlines()[-1]

    def names(self) -> set[str]:
        """Return the names of all default tests."""
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-n",
            "0",
            "-p",
            "no:cacheprovider",
            "--collect-only",
        ]
        path = os.pathsep.join([str(self.folder), str(self.folder / "tests")])
        environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
        found = subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, check=True
        )
        return {line for line in found.stdout.splitlines() if "::" in line}

    def reach(self, sites: list[list[Mutant]], options: argparse.Namespace) -> dict[str, dict[str, float]]:
        """Run the default tests once: give the tests that run each line, and each file, and for how many seconds."""
        lines: dict[str, list[int]] = {}
        for one, *_ in sites:
            lines.setdefault(str(one.path.relative_to(ROOT)), []).append(one.line)
        found: dict[str, dict[str, float]] = {}
        with tempfile.TemporaryDirectory() as notes:
            (wanted := Path(notes) / "wanted").write_text(json.dumps(lines))
            words = ["-p", "mutants", "-n", str(options.workers)]
            more = {"MUTANTS_LINES": str(wanted), "MUTANTS_FOUND": notes}
            _, failing = self.pytest(words, 3600, **more)
            for note in Path(notes).glob("*.json"):
                for place, tests in json.loads(note.read_text()).items():
                    found.setdefault(place, {}).update(tests)
        if not found:
            raise SystemExit(f"the default tests did not run: {failing}")
        return {**found, "failing": dict.fromkeys(failing.split(), 0.0)}

    def verdict(self, mutant: Mutant, reach: dict[str, dict[str, float]]) -> tuple[str, str]:
        name = mutant.path.relative_to(ROOT)
        tests = reach.get(f"{name}:{mutant.line}") or reach.get(str(name), {})
        room = f"tests/{name.parts[1]}/"
        nodes = sorted(
            tests.keys() - set(self.failing), key=lambda one: (not one.startswith(room), tests[one])
        )
        files = list(dict.fromkeys(one.split("::")[0] for one in nodes))
        most_s = MOST_START_S + MOST_TIMES * sum(tests.values())
        place = self.folder / name
        source = place.read_text()
        place.write_text(source[: mutant.start] + mutant.text + source[mutant.end :])
        try:
            for words in (nodes[:MOST_NODES], files):
                verdict = self.pytest(["-x", "-n", "0", *words], most_s) if words else ("passed", "no test")
                if verdict[0] != "passed":
                    break
            return verdict
        finally:
            place.write_text(source)


def judged(
    drawn: list[Mutant], sites: list[list[Mutant]], options: argparse.Namespace
) -> Iterator[tuple[Mutant, str, str]]:
    waiting: queue.Queue[Mutant] = queue.Queue()
    done: queue.Queue[tuple[Mutant, str, str]] = queue.Queue()
    for mutant in drawn:
        waiting.put(mutant)

    def work(copy: Copy) -> None:
        while True:
            try:
                mutant = waiting.get_nowait()
            except queue.Empty:
                return
            done.put((mutant, *copy.verdict(mutant, reach)))

    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copies = [Copy(Path(folder) / str(number)) for number in range(min(options.workers, len(drawn)))]
        for copy in copies:
            shutil.copytree(ROOT, copy.folder, ignore=NOT_COPIED)
        if options.reach and options.reach.exists():
            there = copies[0].names()  # pytest stops at a test that is gone, as at one that fails
            known = json.loads(options.reach.read_text())
            reach = {
                place: {test: tests[test] for test in tests if test in there}
                for place, tests in known.items()
            }
        else:
            reach = copies[0].reach(sites, options)
            if options.reach:
                options.reach.write_text(json.dumps(reach))
        print(
            f"these tests fail without a mutant, and are left out: {' '.join(reach['failing'])}\n", flush=True
        )
        for copy in copies:
            copy.failing = list(reach["failing"])
            threading.Thread(target=work, args=(copy,), daemon=True).start()
        for _ in drawn:
            yield done.get()


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=60, help="mutants; 0 takes all there are")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS), help="folders or files of the package")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--workers", type=int, default=max(1, len(os.sched_getaffinity(0))))
    parser.add_argument("--reach", type=Path, help="file that keeps which test runs which line")
    parser.add_argument("--list", action="store_true", help="list the mutants and stop")
    options = parser.parse_args()
    sites = candidates(options.rooms)
    drawn = drawn_from(sites, options.count, options.seed, options.kinds)
    if options.list:
        print(*(f"{one.where}  {one.shown}" for one in drawn), sep="\n")
        return 0
    started, survivors, rows = time.monotonic(), 0, []
    for mutant, verdict, by in judged(drawn, sites, options):
        survivors += verdict == "passed"
        rows.append(
            f"{'SURVIVED' if verdict == 'passed' else verdict:8}  {mutant.where}  {mutant.shown}  {by}"
        )
        print(rows[-1], flush=True)
    print(
        f"\n{len(drawn) - survivors} of {len(drawn)} killed in {(time.monotonic() - started) / 60:.0f} min\n"
    )
    print(*sorted(row for row in rows if row.startswith("SURVIVED")), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
