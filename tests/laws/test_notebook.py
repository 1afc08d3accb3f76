"""The functions for a notebook: docs/notebook.md runs, and what they return agrees with the models' own methods."""

import dataclasses
import importlib
import inspect
import re
import runpy
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import morphspace as ms
from morphspace import notebook
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.face.faceframe import FaceFrame
from morphspace.linear import morph_pca
from morphspace.settings import WrongSetting
from morphspace.synthetic import make_actors
from morphspace.transfer.mimicry import mimic
from morphspace.transfer.neutral import neutral_of

DOCUMENT = Path(__file__).parents[2] / "docs" / "notebook.md"


def test_the_document_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in make_actors(Path("actors"), identities=2, frames=12, size=(100, 120), seed=1):
        pass
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) > 5
    Path("document.py").write_text("\n".join(blocks), encoding="utf-8")
    runpy.run_path("document.py")


def test_a_caricature_of_gain_1_is_the_face(model):
    faces = model.training[:2]
    drawn = ms.caricature(model, faces, gains=(1.0,))
    for face, image in zip(range(2), drawn, strict=True):
        assert_allclose(image, np.clip(model.render(faces[face]), 0, 1), atol=1e-6)
    assert drawn.names == ("frame_000_g1", "frame_001_g1")


def test_gains_of_warp_and_texture_apart_give_each_pair_once(model):
    faces = model.training[0]
    assert ms.caricature(model, faces, gains=(1.0, 2.0), warp_gains=0.5).names == (
        "frame_000_w0.5_t1",
        "frame_000_w0.5_t2",
    )
    assert len(ms.caricature(model, faces, gains=(1.0, 2.0), warp_gains=0.5, texture_gains=0.0)) == 1


def test_a_region_that_is_none_is_refused_at_once(model):
    with pytest.raises(BadInput, match="ears"):
        ms.caricature(model, model.training[0], region="ears")


def test_a_gain_of_0_is_the_mean_face(model):
    (drawn,) = ms.caricature(model, model.training[0], gains=(0.0,))
    assert_allclose(drawn, np.clip(model.mean.render(), 0, 1), atol=1e-6)


def test_a_trajectory_that_goes_back_twice_is_itself(model):
    (back,) = ms.trajectory(model, model.training, operations=["reverse", "reverse"])
    assert_allclose(back.in_raw(model).values, model.training.values, atol=1e-9)


def test_a_linear_continuum_goes_from_the_first_face_to_the_last(model):
    first, last = model.training[0], model.training[5]
    drawn = ms.continuum(first, last, model, steps=2, spacing="loadings")
    values = drawn.loadings.in_raw(model).values
    assert_allclose(
        values, [first.values[0], (first.values[0] + last.values[0]) / 2, last.values[0]], atol=1e-9
    )


def test_faces_are_a_sequence(model, tmp_path):
    drawn = ms.caricature(model, model.training[:3], gains=(1.0,))
    assert len(drawn) == 3 and len(drawn[1:]) == 2
    assert_array_equal(drawn[-1], drawn[2])
    with pytest.raises(IndexError):
        drawn[3]
    files = drawn.save(tmp_path / "new")
    assert [file.name for file in files] == ["frame_000_g1.png", "frame_001_g1.png", "frame_002_g1.png"]
    assert all(file.exists() for file in files)


def test_what_a_notebook_shows_is_escaped_and_whole(model):
    script = "\"<script>'x'</script>"
    entries = dict.fromkeys(("identity", "consent", "licence"), script)
    names = (script, *model.training.frame_names[1:])
    frames = dataclasses.replace(model.training, frame_names=names)
    bad = dataclasses.replace(model, provenance={**model.provenance, **entries}, training=frames)
    faces = dataclasses.replace(ms.caricature(model, model.training[:2], gains=1.0), names=(script, "two"))
    for shown, times in ((bad, 3), (frames, 1), (faces, 2)):
        page = shown._repr_html_()
        assert "<script" not in page and page.count("&#34;&lt;script&gt;&#39;x&#39;&lt;/script&gt;") == times
        assert "model id" in page and "\n" not in repr(shown)
    assert bad._repr_html_().count("<img") == 1 + 2 * min(3, model.rank)
    assert (
        "<tr><th style='text-align:left'>licence</th><td style='text-align:left'>CC0<" in model._repr_html_()
    )


def test_a_table_has_a_row_a_frame_and_a_column_a_component(model):
    table = model.training.in_sd(model).to_pandas()
    assert list(table.columns) == ["pc001", "pc002", "pc003"] and list(table.index) == list(
        model.training.frame_names
    )
    assert_allclose(table.std(ddof=1), 1.0, atol=1e-6)


def test_figures_have_an_axis_a_face_and_name_the_unit(model):
    assert len(ms.plot(model, components=2).axes) == 2 * 5
    assert "SD" in ms.plot(model.training.in_sd(model)).axes[0].get_ylabel()
    with pytest.raises(BadInput, match="components is 0"):
        model.plot_components(0)


def test_loadings_of_another_model_are_refused(model):
    with pytest.raises(ReferenceMismatch, match="belong to model"):
        ms.caricature(model.truncate(2), model.training[:1])


@pytest.mark.parametrize(
    ("ends", "line"),
    [
        (lambda model: (model, model.training[0]), "expected two models"),
        (lambda model: (model.training[0], model.training[:2], model), "1 and 2 rows"),
    ],
)
def test_ends_that_make_no_line_are_refused(model, ends, line):
    with pytest.raises(BadInput, match=line):
        ms.continuum(*ends(model))


def pair_of(model):
    points = FaceFrame((20.0, 30.0), (44.0, 30.0), (32.0, 50.0))
    moved = FaceFrame((18.0, 30.0), (44.0, 31.0), (32.0, 52.0))
    return model.with_faceframe(points), model.with_faceframe(moved)


def settings_in(function):
    """Give the names of a function's keywords that a request declares."""
    own = ("workers", "progress", "faces", "guide", "model")
    return [
        one.name
        for one in inspect.signature(function).parameters.values()
        if one.kind is one.KEYWORD_ONLY and one.name not in own
    ]


CALLS = {
    "build": lambda model, **given: ms.build("nowhere", **given),
    "encode": lambda model, **given: ms.encode(model, "nowhere", **given),
    "mimic": lambda model, **given: ms.mimic(model, model, **given),
    "blend": lambda model, **given: ms.blend(model, model, **given),
    "caricature": lambda model, **given: ms.caricature(model, model.training, **given),
    "trajectory": lambda model, **given: ms.trajectory(model, model.training, **given),
    "continuum": lambda model, **given: ms.continuum(model.training[0], model.training[1], model, **given),
}


@pytest.mark.parametrize("name", CALLS)
def test_every_keyword_is_a_setting_with_its_check_its_help_and_its_default(model, name):
    function = getattr(ms, name)
    assert settings_in(function)
    for keyword in settings_in(function):
        with pytest.raises(WrongSetting, match=f"^{keyword} is .*; expected "):
            CALLS[name](model, **{keyword: object()})
        assert f"\n    {keyword}\n        " in function.__doc__
    with pytest.raises(
        BadInput, match=f"size_px is no setting of {name}; expected one of {settings_in(function)[0]}"
    ):
        CALLS[name](model, size_px=3)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda model: ms.build("nowhere"), "nowhere does not exist"),
        (
            lambda model: ms.build("x", components=2.5),
            "components is 2.5; expected a whole number from 1 to 10,000",
        ),
        (lambda model: ms.build("x", size="axb"), "size is 'axb'; expected 2 whole numbers, such as 200x240"),
        (lambda model: ms.load("nowhere.morph"), "nowhere.morph"),
        (lambda model: ms.load(None), "model is None; expected a path"),
        (lambda model: ms.encode("m.morph", "x"), "model is 'm.morph'; expected a model"),
        (lambda model: ms.mimic(*pair_of(model), workers=0), "workers is 0; expected a whole number from 1"),
        (lambda model: ms.mimic(*pair_of(model), "faces"), "faces is 'faces'; expected loadings"),
        (lambda model: ms.mimic(*pair_of(model), method="guided"), "needs landmarks"),
        (lambda model: ms.blend(model, "ben"), "model 2 is 'ben'; expected a model"),
        (lambda model: ms.caricature(model, model.training[:0]), "caricature has nothing to draw"),
        (lambda model: ms.caricature(model, model.training, gains=(2, 2)), "the gain 2 was given twice"),
        (lambda model: ms.trajectory(model, operations="loop"), "0 motions"),
        (
            lambda model: ms.trajectory(model, model.training[:1], operations="loop"),
            "the number of frames of motion_0 is 1; expected at least 2",
        ),
        (
            lambda model: ms.trajectory(model, model.training, operations="loop", guide=model.training),
            "a guide is given, but no operation takes one",
        ),
        (lambda model: ms.build(np.zeros((4, 5))), "a source is an array of shape (4, 5); expected a folder"),
        (lambda model: ms.build(""), "a source is empty; expected a folder"),
        (lambda model: ms.encode(model, ["x", None]), "a source is None; expected a folder"),
        (lambda model: ms.build("x", identity=5), "identity is 5; expected a text"),
        (lambda model: ms.load(DOCUMENT), "is no .morph file"),
        (lambda model: model.plot_components("x"), "components is 'x'; expected a whole number from 1"),
        (lambda model: model.plot_components(1, "x"), "amount_sd is 'x'; expected a number"),
        (lambda model: model.training.plot(0), "components is 0; expected a whole number from 1"),
        (lambda model: model.training["x"], "the face is 'x'; expected a number below 12"),
        (lambda model: ms.caricature(model, model.training)[1.5], "the face is 1.5; expected a number"),
        (
            lambda model: ms.caricature(model, np.zeros((3, 2))),
            "faces is an array of shape (3, 2); expected load",
        ),
        (lambda model: ms.plot(np.zeros((30, 3))), "an array of shape (30, 3)"),
        (lambda model: ms.plot(3), "expected a model or loadings"),
        (lambda model: ms.plot(model, "x"), "components is 'x'; expected a whole number"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(model, call, line):
    with pytest.raises(BadInput, match=re.escape(line)) as refused:
        call(model)
    assert "\n" not in str(refused.value)


def test_a_list_of_sources_stands_for_its_members(model):
    for sources in (["nowhere.png", Path("x.png")], ("nowhere.png", "x.png")):
        with pytest.raises(BadInput, match=r"nowhere\.png does not exist"):
            ms.build(sources)


def test_faces_are_selected_by_number_name_slice_and_lists_of_these(model):
    drawn, names = ms.caricature(model, model.training[:3], gains=1), model.training.frame_names
    assert_array_equal(drawn[[0, 2]], [drawn[0], drawn[2]])
    assert_array_equal(drawn["frame_001_g1"], drawn[1])
    chosen = model.training[[names[2], -1, np.int64(0)]]
    assert chosen.frame_names == (names[2], names[-1], names[0])
    assert_array_equal(chosen.values, model.training.values[[2, -1, 0]])
    with pytest.raises(IndexError):
        model.training[[0, 99]]


def test_an_array_stands_for_a_list_of_numbers(model):
    assert len(ms.caricature(model, model.training[0], gains=np.array([0.5, 2.0]))) == 2


def test_the_notes_of_a_blend_are_warnings(model):
    marked = model.with_faceframe(FaceFrame((20.0, 30.0), (44.0, 30.0), (32.0, 50.0)))
    with pytest.warns(UserWarning) as told:
        ms.blend(marked, marked)
    assert [one for one in told if "counts 2 times. Leave out repeated models" in str(one.message)]
    assert {one.filename for one in told} == {__file__}


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("pandas", lambda model: model.training.to_pandas()),
        ("matplotlib", lambda model: ms.plot(model)),
        ("matplotlib", lambda model: ms.plot(model.training)),
        ("sklearn", lambda model: importlib.reload(morph_pca)),
    ],
)
def test_a_missing_package_is_named_with_the_command_that_brings_it(model, monkeypatch, package, use):
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(
        BadInput, match=re.escape(f"{package} is not installed; expected it for this function")
    ) as told:
        use(model)
    assert "pip install 'morphspace[notebook]'" in str(told.value)


def test_a_single_value_stands_for_a_list_of_one(model):
    assert ms.caricature(model, model.training[0], gains=2).names == ("frame_000_g2",)
    (back,) = ms.trajectory(model, model.training, operations="reverse")
    assert_allclose(back.in_raw(model).values, model.training.values[::-1])


def test_mimicry_makes_each_face_once_and_alike_for_any_workers(model, monkeypatch):
    source, target = pair_of(model)
    made = []

    def counted(*given, **settings):
        show = mimic(*given, **settings)

        def face(offset, loadings=None):
            made.append(loadings)
            return show(offset, loadings)

        return face

    show = mimic(source, target, "paper", neutral=neutral_of(source, target))
    expected = [show(source.offset(row), row) for row in source.training.values]
    monkeypatch.setattr("morphspace.sets.mimicry.mimic", counted)
    with ThreadPoolExecutor(3) as pool:
        for workers in (1, pool, None):
            made.clear()
            faces = notebook.mimic(source, target, method="paper", workers=workers)
            assert_array_equal(faces.loadings.values, [one.loadings for one in expected])
            for image, one in zip(faces, expected, strict=True):
                assert_array_equal(image, np.clip(one.morph.render(), 0, 1))
            assert len(made) == len(expected) + 1  # one more before the threads start
