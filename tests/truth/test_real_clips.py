"""Truths about real clips, where they are at hand: MORPHSPACE_DATA names the folder that holds `sequences/`.

The bounds are the project's goals for the interim flow; docs/benchmarks.md has the full figures and the commands.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from morphspace.grid import warp
from morphspace.io.clips import open_clip
from morphspace.io.framing import FramedClip, Framing
from morphspace.linear.quality import psnr_db
from morphspace.model.model import load_model
from morphspace.model.morph import resource
from morphspace.model.passes import BuildSettings, build_steps
from morphspace.steps import result_of

SEQUENCES = Path(os.environ.get("MORPHSPACE_DATA", "no-such-folder")) / "sequences"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not SEQUENCES.is_dir(), reason="MORPHSPACE_DATA does not name a folder with real clips"
    ),
]
SIZE = (200, 240)


def build_of(name: str, work: Path, indices: list[int] | None = None):
    clip = open_clip([SEQUENCES / name])
    clip = clip if indices is None else clip.subset(indices)
    source = FramedClip(clip, Framing(clip.size, None, SIZE))
    provenance = {
        "identity": name,
        "framing": {"source_size": list(clip.size), "crop": None, "size": list(SIZE)},
        "versions": {},
    }
    return result_of(build_steps(source, BuildSettings(components=40), work, provenance))


@pytest.mark.parametrize("name", ["lp_d18", "grid_pwij3p"])
def test_a_real_frame_survives_being_taken_apart(name: str, tmp_path: Path):
    build = build_of(name, tmp_path)
    scores = []
    for index in range(0, len(build.frame_files), 2):
        frame, flow = build.frame(index)
        displacement = resource(flow.displacement, build.model.mean_inverse)
        back = warp.render(warp.sample(frame.image, displacement), displacement)
        scores.append(psnr_db(back, frame.image, build.model.mask))
    assert np.median(scores) >= 46  # dB
    assert np.percentile(scores, 10) >= 32  # dB


def test_held_out_real_frames_come_back_better_than_from_pixel_pca(tmp_path: Path):
    clip = open_clip([SEQUENCES / "lp_d18"])
    held = list(range(2, len(clip), 4))
    kept = [index for index in range(len(clip)) if index not in held]
    build = build_of("lp_d18", tmp_path, kept)
    model = build.model
    k = 20
    trained = np.stack([build.frame(index)[0].image.ravel() for index in range(len(kept))]).astype(np.float64)
    root = np.sqrt(np.repeat(model.mask.ravel(), 3).astype(np.float64))
    mean = trained.mean(axis=0)
    _, _, axes = np.linalg.svd((trained - mean) * root, full_matrices=False)
    small, framing = model.truncate(k), Framing(clip.size, None, SIZE)
    gains = []
    for index in held:
        frame = model.align(framing.apply(clip.load(index)))
        offset = (frame.image.ravel() - mean) * root
        pixels = mean + (offset @ axes[:k].T) @ axes[:k] / np.maximum(root, 1e-3)
        ours = small.render(small.encode_aligned(frame).values[0])
        by_pixels = psnr_db(pixels.reshape(frame.image.shape).astype(np.float32), frame.image, model.mask)
        gains.append(psnr_db(ours, frame.image, model.mask) - by_pixels)
    assert np.mean(gains) >= 1.5  # dB


def test_a_saved_real_model_is_the_same_model(tmp_path: Path):
    model = build_of("grid_pwij3p", tmp_path / "work").model
    model.save(tmp_path / "a.morph")
    again = load_model(tmp_path / "a.morph")
    loadings = model.training.values[7]
    np.testing.assert_array_equal(again.render(loadings), model.render(loadings))
