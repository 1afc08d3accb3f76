"""Every example in a docstring runs and returns its result, in a folder with two models and a clip."""

import doctest
import importlib
import inspect
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import morphspace as ms

PACKAGE = Path(__file__).parents[2] / "morphspace"
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


PUBLIC = [name for name in ms.__all__ if inspect.isfunction(getattr(ms, name))]


@pytest.fixture(scope="module")
def people(model, tmp_path_factory):
    """A folder with anna.morph, ben.morph and the clip anna."""
    folder = tmp_path_factory.mktemp("people")
    framing = {"source_size": [60, 72], "crop": None, "size": [60, 72]}
    for name, x in (("anna", 20.0), ("ben", 18.0)):
        person = replace(model, provenance={**model.provenance, "identity": name, "framing": framing})
        person.with_faceframe(ms.FaceFrame((x, 30.0), (44.0, 30.0), (32.0, 50.0))).save(
            folder / f"{name}.morph"
        )
    for name, row in zip(model.training.frame_names, model.training.values, strict=True):
        ms.write_image(folder / "anna" / f"{name}.png", model.render(row))
    return folder


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_module_run(name, people, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(people, tmp_path / "people"))
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.attempted > 0 and result.failed == 0


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_function_has_an_example(name):
    assert ">>> " in getattr(ms, name).__doc__
