"""The entry of the benchmarks: every section has its result, results name what they need, remarks outlive a rerun."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
PAGE = ROOT / "docs" / "benchmarks.md"
GONE = {"avatar-correspondence", "defaults", "flow-ablation"}  # settled: a result without a script
PROGRAM = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import run
print(json.dumps({name: [section.title, section.needs] for name, section in run.SECTIONS.items()}))
folder = Path(sys.argv[2])
run.write_result("help", ["--rounds", "3"], "first\\n", folder)
path = folder / "help.md"
path.write_text(path.read_text() + "\\n## Remarks\\n\\nby hand\\n")
run.write_result("help", [], "second\\n", folder)
"""


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    """Import all scripts in a fresh process and write one result twice; return its sections and the folder."""
    folder = tmp_path_factory.mktemp("results")
    words = [sys.executable, "-c", PROGRAM, str(BENCHMARKS), str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(done.stdout), folder


def test_every_section_has_a_result_that_names_its_command_and_versions(entry):
    sections, _ = entry
    results = {path.stem for path in (BENCHMARKS / "results").glob("*.md")}
    assert results == set(sections) | GONE
    for name in sections:
        title, blank, command, *rest = (BENCHMARKS / "results" / f"{name}.md").read_text().splitlines()
        assert title.startswith("# ") and not blank
        assert re.fullmatch(
            rf"`python benchmarks/run.py {name}( --[-a-z]+ [A-Z0-9]+)*( --clips .*)?`", command
        )
        assert re.search(r"Python 3\.\d+.*numpy 2.*\d cores", rest[1])
    for name in GONE:
        text = (BENCHMARKS / "results" / f"{name}.md").read_text()
        assert "at commit f958af2" in text or "there is no script" in text


def test_a_rerun_keeps_the_remarks_and_replaces_the_rest(entry):
    _, folder = entry
    text = (folder / "help.md").read_text()
    assert text.startswith("# Help\n\n`python benchmarks/run.py help`\n\nCommit ")
    assert "first" not in text and text.endswith("second\n\n## Remarks\n\nby hand\n")


def test_a_section_without_what_it_needs_is_refused():
    words = [sys.executable, str(BENCHMARKS / "run.py"), "mimicry", "--data", "x"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2 and "mimicry needs --face-judge" in done.stderr


def test_the_page_is_one_page_and_links_every_result():
    text = PAGE.read_text()
    assert len(text.splitlines()) <= 150
    linked = set(re.findall(r"\.\./benchmarks/results/([-a-z]+)\.md", text))
    results = {path.stem for path in (BENCHMARKS / "results").glob("*.md")}
    assert linked <= results
    assert results - linked == set()
