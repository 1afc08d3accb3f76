"""The functions for a notebook: docs/notebook.md runs, and what they return agrees with the models' own methods."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import morphspace as ms
from morphspace.errors import BadInput, ReferenceMismatch
from morphspace.synthetic import make_actors

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
    assert ms.caricature(model, faces, gains=(1.0, 2.0), warp_gain=0.5).names == (
        "frame_000_w0.5_t1",
        "frame_000_w0.5_t2",
    )
    assert len(ms.caricature(model, faces, gains=(1.0, 2.0), warp_gain=0.5, texture_gain=0.0)) == 1


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
    import dataclasses

    bad = dataclasses.replace(model, provenance={**model.provenance, "identity": "<script>x</script>"})
    page = bad._repr_html_()
    assert "<script>" not in page and "&lt;script&gt;" in page
    assert page.count("<img") == 1 + 2 * min(3, model.rank)
    assert "CC0" in page
    for shown in (model.training, ms.caricature(model, model.training[:2])):
        assert "model id" in shown._repr_html_() and "\n" not in repr(shown)


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
