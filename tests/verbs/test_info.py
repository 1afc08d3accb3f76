"""info: the loadings of the training frames as a table."""

from dataclasses import replace

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.io.tables import read_loadings_table
from morphspace.steps import result_of
from morphspace.verbs.info import InfoRequest, run


def test_the_table_of_training_loadings_has_unit_variance_and_names_the_model(model, tmp_path):
    model.save(tmp_path / "a.morph")
    outcome = result_of(run(InfoRequest(tmp_path / "a.morph", tmp_path / "a.csv")))
    table = read_loadings_table(tmp_path / "a.csv")
    assert outcome.written == (tmp_path / "a.csv", tmp_path / "a.json")
    assert table.frame_names == model.training.frame_names
    assert table.document["model_id"] == model.model_id
    np.testing.assert_allclose(table.loadings_sd.std(axis=0, ddof=1), 1, rtol=1e-5)  # float32 loadings
    np.testing.assert_allclose(table.loadings_sd * model.sd, model.training.values, rtol=1e-6, atol=1e-6)


def test_a_table_of_another_origin_stays(model, tmp_path):
    model.save(tmp_path / "a.morph")
    (tmp_path / "a.csv").write_text("mine\n")
    with pytest.raises(BadInput, match="no earlier info wrote"):
        result_of(run(InfoRequest(tmp_path / "a.morph", tmp_path / "a.csv")))
    assert (tmp_path / "a.csv").read_text() == "mine\n"


def test_without_the_option_nothing_is_written(model, tmp_path):
    model.save(tmp_path / "a.morph")
    assert result_of(run(InfoRequest(tmp_path / "a.morph"))).written == ()
    assert [path.name for path in tmp_path.iterdir()] == ["a.morph"]


def test_the_turn_of_the_head_is_told_where_the_build_found_it(model, tmp_path):
    entry = {"yaw_deg": [-12.4, 3.0], "pitch_deg": [-2.0, 9.0], "roll_deg": [0.0, 4.0]}
    entry |= {"frames": 9, "frames_turned": 2}
    replace(model, provenance={**model.provenance, "landmarks": entry}).save(tmp_path / "a.morph")
    lines = result_of(run(InfoRequest(tmp_path / "a.morph"))).lines
    (line,) = [line for line in lines if line.startswith("turn ")]
    assert (
        "yaw -12 to 3, pitch -2 to 9, roll 0 to 4 degrees; 2 of 9 frames are turned by more than 20" in line
    )
    model.save(tmp_path / "b.morph")
    assert not any(
        line.startswith("turn ") for line in result_of(run(InfoRequest(tmp_path / "b.morph"))).lines
    )
