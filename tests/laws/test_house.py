"""The house as it is described: CONTRIBUTING shows the layers that import-linter checks."""

import ast
import re
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]


def test_contributing_shows_the_layers_of_the_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (each["layers"] for each in contracts if each["type"] == "layers")
    shown = re.search(r"```\n(cli\b.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.DOTALL)
    assert shown is not None and shown[1].split("\n")[:-1] == layers


def test_every_room_stands_in_a_layer():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = (each["layers"] for each in contracts if each["type"] == "layers")
    named = {room for layer in layers for room in re.split(r" [:|] ", layer)}
    package = ROOT / "morphspace"
    found = {path.stem for path in package.glob("*.py") if not path.stem.startswith("__")}
    found |= {path.parent.name for path in package.glob("*/__init__.py")}
    assert named == found


def test_no_module_imports_itself_by_a_detour():
    """Imports inside functions and those for types count too."""
    graph = grimp.build_graph("morphspace", cache_dir=None)
    imported = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(imported).prepare()  # raises CycleError, with the circle


VERBS = sorted(path for path in (ROOT / "morphspace" / "verbs").glob("*.py") if path.stem != "__init__")
MOST_LINES = 150  # of a verb: its request and its run; more belongs into the rooms that do the work


@pytest.mark.parametrize("path", VERBS, ids=lambda path: path.stem)
def test_a_verb_is_a_request_and_its_run(path):
    tree = ast.parse(path.read_text())
    assert len(path.read_text().splitlines()) <= MOST_LINES
    defined = {node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    assert {"".join(map(str.capitalize, path.stem.split("_"))) + "Request", "run"} <= defined
