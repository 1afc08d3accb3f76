"""Laws of performances and of the clip folders written of them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, UnreadableFile
from morphspace.storage import write_container
from morphspace.synthetic import (
    ACTIONS,
    LABELS,
    Expression,
    capture_sequence,
    expression_sequence,
    make_actors,
    read_truth,
)

SMALL = {"identities": 1, "frames": 4, "seed": 3, "size": (96, 116), "portrait": 1}


def folder_bytes(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize("frames", [25, 60, 150])
def test_a_performance_starts_at_rest_is_smooth_and_shows_every_action(frames: int) -> None:
    sequence = expression_sequence(frames, np.random.default_rng(2))
    assert len(sequence) == frames
    assert set(sequence[0].as_dict().values()) == {0.0}
    amounts = np.array([list(expression.as_dict().values()) for expression in sequence])
    shown = np.abs(amounts).max(axis=0)
    assert shown.min() > 0.25, dict(zip(ACTIONS, shown, strict=True))


def test_a_long_performance_never_jumps() -> None:
    sequence = expression_sequence(200, np.random.default_rng(2))
    amounts = np.array([list(expression.as_dict().values()) for expression in sequence])
    assert np.abs(np.diff(amounts, axis=0)).max() < 0.65  # a lid closes within two frames at 25 frames/s


def test_performances_are_repeatable_and_differ_by_seed() -> None:
    one, same, other = (
        [e.as_dict() for e in expression_sequence(30, np.random.default_rng(seed))] for seed in (5, 5, 6)
    )
    assert one == same != other
    assert expression_sequence(0, np.random.default_rng(0)) == []
    assert expression_sequence(1, np.random.default_rng(0))[0].as_dict() == Expression().as_dict()


def test_head_motion_stays_within_its_bound_and_starts_at_none() -> None:
    captures = capture_sequence(
        80, np.random.default_rng(1), head_motion_px=6.0, light_change=0.2, noise_sd=0.01
    )
    shifts = np.array([(c.shift_x_px, c.shift_y_px) for c in captures])
    assert_array_equal(shifts[0], 0.0)
    assert 2.0 < np.abs(shifts).max() <= 6.0
    assert captures[0].gain == captures[0].zoom == 1.0
    assert len({c.noise_seed for c in captures}) == 80


def test_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        pieces = list(
            make_actors(tmp_path / name, **{**SMALL, "seed": seed}, noise_sd=0.01, head_motion_px=2.0)
        )
        assert [piece.index for piece in pieces] == [0, 1, 2, 3] * 2
    a, b, c = (folder_bytes(tmp_path / name) for name in "abc")
    assert a == b
    assert a.keys() == c.keys()
    assert a != c


def test_clip_folders_hold_frames_sidecar_and_truth(tmp_path: Path) -> None:
    pieces = list(make_actors(tmp_path, **SMALL))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["actor_01", "portrait", "truth"]
    for name in ("actor_01", "portrait"):
        frames = sorted(path.name for path in (tmp_path / name).glob("*.png"))
        assert frames == [f"frame_{k:04d}.png" for k in range(4)]
        sidecar = json.loads((tmp_path / name / "clip.json").read_text())
        assert sidecar["format"] == "morphspace-clip"
        assert sidecar["version"] == 1
        assert sidecar["identity"] == name
        truth = read_truth(tmp_path / "truth" / f"{name}.truth")
        assert truth.displacement.shape == (4, 116, 96, 2)
        assert truth.visibility.shape == (4, 116, 96)
        assert truth.visibility.dtype == np.uint8
        assert truth.keypoints.shape == (4, len(truth.document["keypoint_names"]), 2)
        assert_array_equal(truth.displacement[0], 0.0)
        assert tuple(truth.document["labels"]) == LABELS
        assert [entry["name"] for entry in truth.document["frames"]] == frames
        assert list(truth.document["frames"][1]["expression"]) == sorted(ACTIONS)
        assert_allclose(
            sidecar["faceframe"]["right_eye"], truth.document["frames"][0]["faceframe"][0], atol=1e-3
        )
    assert [piece.truth is not None for piece in pieces] == [False, False, False, True] * 2


def test_written_pictures_are_the_drawn_ones(tmp_path: Path) -> None:
    from morphspace.synthetic import Capture, Identity, draw_actor_frame

    pieces = list(make_actors(tmp_path, **{**SMALL, "portrait": 0}))
    document = read_truth(pieces[-1].truth).document
    entry = document["frames"][3]
    stored = {k: tuple(v) if isinstance(v, list) else v for k, v in document["identity"].items()}
    frame = draw_actor_frame(
        Identity(**stored),
        Expression(**entry["expression"]),
        size=(96, 116),
        capture=Capture(**entry["capture"]),
    )
    written = cv2.imread(str(pieces[3].path), cv2.IMREAD_COLOR)[..., ::-1] / 255
    assert_allclose(written, frame.image, atol=0.5 / 255 + 1e-6)


def test_impossible_orders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="expected at least one"):
        next(make_actors(tmp_path, identities=0))
    with pytest.raises(BadInput, match="0 frames"):
        next(make_actors(tmp_path, frames=0))


def test_a_foreign_or_future_truth_file_is_refused(tmp_path: Path) -> None:
    write_container(tmp_path / "x.truth", {"a": np.zeros(3)}, {"format": "something else"})
    with pytest.raises(UnreadableFile, match="something else"):
        read_truth(tmp_path / "x.truth")
    write_container(tmp_path / "y.truth", {"a": np.zeros(3)}, {"format": "morphspace-truth", "version": 99})
    with pytest.raises(UnreadableFile, match="99"):
        read_truth(tmp_path / "y.truth")
