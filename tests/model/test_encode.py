"""Encoding: what of a face lies outside a model's space."""

from dataclasses import replace

import numpy as np
import pytest

from morphspace.face.faceframe import Frame
from morphspace.io.images import write_image
from morphspace.model.encode import (
    EncodedFrame,
    encoded_frames,
    energy_outside,
    framed_for,
    notes_on_lost,
    rows_of_build,
)
from morphspace.model.loadings import Loadings
from morphspace.model.model import MorphModel
from morphspace.model.morph import MorphOffset
from morphspace.storage import digest_of_file


def test_energy_outside_is_what_the_components_leave(model):
    """Half a training face lies inside; what no component holds counts by its energy in the model's variances."""
    offset = model.offset(0.5 * model.training.values[0])
    assert energy_outside(offset, model) < 1e-4
    rng = np.random.default_rng(2)
    values = rng.standard_normal(model.basis.components.shape[1]).astype(np.float32)
    values -= model.basis.expand(model.basis.project(values))
    stranger = offset + MorphOffset(values, offset.shape, offset.reference_id)
    energy = (model.basis.weight * values * values).sum()
    variance = model.basis.variances.sum() + model.basis.discarded_variance
    assert energy_outside(stranger, model) == pytest.approx(energy / variance, rel=1e-4)


def test_a_frame_without_a_face_is_lost_and_one_that_nobody_searched_is_not(model):
    picture = model.render(model.training.values[0])

    def lost(points):
        frame = Frame(picture, "a", np.eye(2, 3), points)
        return EncodedFrame(frame, model.mean, model.training[0]).lost

    assert lost(np.zeros((0, 2))) == ("a",)
    assert lost(None) == lost(np.zeros((478, 2))) == ()
    assert "in 5 of 9 frames (a, b, c, ...)" in notes_on_lost(list("abcde"), 9)[0]
    assert notes_on_lost([], 9) == ()


def test_a_frame_of_the_build_is_refined_from_what_the_build_found(model, tmp_path, monkeypatch):
    """Its flow started from a neighbour's; found anew, a wide open mouth came out 5 SD off."""
    names = model.training.frame_names[:3]
    for name, row in zip(names, model.training.values, strict=False):
        write_image(tmp_path / f"{name}.png", model.render(row))
    inputs = {name: digest_of_file(tmp_path / f"{name}.png") for name in names}
    framing = {"source_size": [60, 72], "crop": None, "size": [60, 72]}
    built = replace(model, provenance={**model.provenance, "inputs": inputs, "framing": framing})
    (tmp_path / "frame_002.png").rename(tmp_path / "renamed.png")
    write_image(tmp_path / "frame_001.png", model.render(model.training.values[5]))
    monkeypatch.setattr(
        MorphModel, "fit", lambda self, frame, start: Loadings(start[None], (frame.name,), self.model_id)
    )
    source = framed_for(built, (str(tmp_path),), None)
    assert source.names == ("frame_000", "frame_001", "renamed")
    assert rows_of_build(built, source) == (0, None, 2)
    starts = [encoded.loadings.values[0] for encoded in encoded_frames(built, source)]
    assert (starts[0] == model.training.values[0]).all() and (starts[2] == model.training.values[2]).all()
    assert (starts[1] != model.training.values[1]).all()
    assert rows_of_build(model, source) == (None,) * 3
    cropped = framed_for(built, (str(tmp_path),), (0, 0, 50, 60))
    assert rows_of_build(built, cropped) == (None,) * 3
