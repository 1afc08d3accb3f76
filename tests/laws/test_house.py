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


MODULES = sorted((ROOT / "morphspace").rglob("*.py"))
MOST_LINES_OF_A_MODULE = 600
SECTIONS = ("Raises", "raises", "Refuse", "refuse")  # of a docstring, or of that of its class


def public_functions(path):
    """Yield each public function and method of a module, with its own docstring and its class's."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            yield node, ast.get_docstring(node) or ""
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            of_class = ast.get_docstring(node) or ""
            for method in node.body:
                if isinstance(method, ast.FunctionDef):
                    yield method, f"{ast.get_docstring(method) or ''}\n{of_class}"


def raised_in(function):
    """Yield the names that a function raises, without the functions inside it."""
    todo = list(function.body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.FunctionDef):
            continue
        if (
            isinstance(node, ast.Raise)
            and isinstance(node.exc, ast.Call)
            and isinstance(node.exc.func, ast.Name)
        ):
            yield node.exc.func.id
        todo += ast.iter_child_nodes(node)


def test_a_module_has_at_most_600_lines():
    lines = {path.name: len(path.read_text().splitlines()) for path in MODULES}
    assert {name: count for name, count in lines.items() if count > MOST_LINES_OF_A_MODULE} == {}


def test_public_functions_say_what_they_raise():
    silent = [
        f"{path.relative_to(ROOT)}:{function.lineno} {function.name} raises {', '.join(sorted(names))}"
        for path in MODULES
        for function, words in public_functions(path)
        if not function.name.startswith("_")
        and (names := set(raised_in(function)))
        and not any(word in words for word in (*SECTIONS, *names))
    ]
    assert silent == []


def test_the_passes_of_a_build_are_short():
    """Lines of a pass, without its docstring."""
    tree = ast.parse((ROOT / "morphspace" / "model" / "passes.py").read_text())
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    lines = {
        one.name: one.end_lineno - one.body[ast.get_docstring(one) is not None].lineno + 1
        for one in functions
    }
    assert max(lines.values()) < 40, lines
