"""render: animations for slides."""

import pytest
from PIL import Image as pillow

from morphspace.errors import BadInput
from morphspace.io.tables import write_loadings_table
from morphspace.steps import result_of
from morphspace.verbs.render import RenderRequest, run


@pytest.fixture
def drawn(model, tmp_path):
    model.save(tmp_path / "a.morph")
    values = model.training.in_sd(model).values[:4]
    about = {"model_id": model.model_id, "frame_rate_hz": 30.0}
    write_loadings_table(tmp_path / "t.csv", values, list("abcd"), about)
    return tmp_path


@pytest.mark.parametrize(("suffix", "rate_hz"), [(".gif", 100 / 3), (".webp", 30.0)])
def test_a_table_becomes_an_animation_with_its_record(drawn, model, suffix, rate_hz):
    path = drawn / f"a{suffix}"
    for _ in range(2):  # its own files are replaced
        outcome = result_of(run(RenderRequest(drawn / "a.morph", drawn / "t.csv", path)))
    assert f"4 frames at {rate_hz:.4g} Hz" in outcome.lines[0]
    assert any("whole hundredths" in note for note in outcome.warnings) == (suffix == ".gif")
    with pillow.open(path) as opened:
        assert opened.n_frames == 4 and opened.size == model.size
    assert {one.name for one in drawn.iterdir()} == {
        "a.morph",
        "t.csv",
        "t.json",
        path.name,
        f"{path.name}.record.json",
    }


def test_other_suffixes_are_refused_by_name(drawn):
    with pytest.raises(BadInput, match=r"ends in \.avi.*\.mp4, \.mkv, \.gif, \.webp"):
        result_of(run(RenderRequest(drawn / "a.morph", drawn / "t.csv", drawn / "a.avi")))
    (drawn / "b.gif").write_bytes(b"mine")
    with pytest.raises(BadInput, match="no earlier render wrote"):
        result_of(run(RenderRequest(drawn / "a.morph", drawn / "t.csv", drawn / "b.gif")))
