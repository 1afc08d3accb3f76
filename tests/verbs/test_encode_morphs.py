"""Laws of morphs in files: texture and warp of each frame give it back, and nobody's file is replaced."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.errors import BadInput
from morphspace.grid import warp
from morphspace.io.flow_fields import read_flow
from morphspace.io.images import read_image, write_image
from morphspace.linear.quality import psnr_db
from morphspace.steps import result_of
from morphspace.verbs import encode
from morphspace.verbs.encode import EncodeRequest


@pytest.fixture
def asked(model, clip, tmp_path, monkeypatch):
    """A request that writes the morphs of three frames of 80 x 100 px, named with a space and an accent."""
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path / "none"))
    model.save(tmp_path / "drawn.morph")
    for name, picture in zip(("a", "b 2", "é"), clip.pictures, strict=False):
        write_image(tmp_path / "clip" / f"{name}.png", picture)
    return EncodeRequest(
        tmp_path / "drawn.morph", (str(tmp_path / "clip"),), tmp_path / "t.csv", morphs=tmp_path / "morphs"
    )


def test_texture_and_warp_of_a_frame_give_it_back(asked, model, tmp_path):
    outcome = result_of(encode.run(asked))
    folder = tmp_path / "morphs"
    names = ["a.exr", "a.flo", "b 2.exr", "b 2.flo", "record.json", "é.exr", "é.flo"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert {folder / name for name in names if name != "record.json"} < set(outcome.written)
    for name in ("a", "b 2", "é"):
        texture, field = read_image(folder / f"{name}.exr"), read_flow(folder / f"{name}.flo").displacement
        frame = read_image(tmp_path / "clip" / f"{name}.png")
        morph = model.morph_of(model.align(frame))
        assert_allclose(texture, morph.texture, atol=1e-5)
        assert (field == morph.displacement).all()
        assert psnr_db(warp.render(texture, field), np.asarray(frame), model.mask) > 35


def test_a_second_run_writes_the_same_bytes_and_a_file_of_anybody_else_stays(asked, tmp_path):
    result_of(encode.run(asked))
    before = {path.name: path.read_bytes() for path in (tmp_path / "morphs").iterdir()}
    result_of(encode.run(asked))
    assert {path.name: path.read_bytes() for path in (tmp_path / "morphs").iterdir()} == before
    (tmp_path / "morphs" / "a.flo").write_bytes(b"mine")
    with pytest.raises(BadInput, match=r"a\.flo"):
        result_of(encode.run(asked))
    assert (tmp_path / "morphs" / "a.flo").read_bytes() == b"mine"


def test_frames_that_would_share_a_file_are_refused_before_any_work(asked, clip, tmp_path):
    write_image(tmp_path / "more" / "a.png", clip.pictures[0])
    both = EncodeRequest(
        asked.model, (*asked.sources, str(tmp_path / "more" / "a.png")), asked.output, morphs=asked.morphs
    )
    with pytest.raises(BadInput):
        result_of(encode.run(both))
    assert not asked.output.exists() and not asked.morphs.exists()
