"""Animations are read back by an independent library: frames, durations, loop and colours."""

import numpy as np
import pytest
from PIL import Image as pillow

from morphspace.errors import BadInput
from morphspace.io.animation import shown_rate_hz, write_animation


def pictures(count=6, height=30, width=24):
    """A ramp that brightens from frame to frame, (h, w, 3)."""
    ramp = np.linspace(0, 0.5, height * width, dtype=np.float32).reshape(height, width, 1)
    return [np.repeat(ramp + np.float32(step / 20), 3, axis=2) for step in range(count)]


def read(path):
    with pillow.open(path) as opened:
        frames, durations_ms = [], []
        for place in range(opened.n_frames):
            opened.seek(place)
            opened.load()
            durations_ms.append(opened.info["duration"])
            frames.append(np.asarray(opened.convert("RGB"), np.float64) / 255)
        return np.array(frames), durations_ms, opened.info["loop"]


@pytest.mark.parametrize(
    ("suffix", "rate_hz", "total_ms", "tolerance"),
    [(".webp", 25.0, 240, 0.5 / 255 + 1e-9), (".gif", 25.0, 240, 0.02), (".gif", 30.0, 180, 0.02)],
)
def test_frames_durations_and_colours_are_kept(tmp_path, suffix, rate_hz, total_ms, tolerance):
    """WebP is exact up to 8 bits; a GIF has 256 colours for the 720 greys, of which each is then within 2 %."""
    path = tmp_path / f"a{suffix}"
    assert write_animation(path, lambda: iter(pictures()), frame_rate_hz=rate_hz) == 0
    frames, durations_ms, loop = read(path)
    assert loop == 0 and len(frames) == 6 and sum(durations_ms) == total_ms
    np.testing.assert_allclose(frames, np.array(pictures()), atol=tolerance)
    first = path.read_bytes()
    write_animation(path, lambda: iter(pictures()), frame_rate_hz=rate_hz)
    assert path.read_bytes() == first


def test_clipped_values_are_counted_once(tmp_path):
    bright = [np.full((8, 8, 3), 1.5, np.float32)] * 2
    for suffix in (".gif", ".webp"):
        assert (
            write_animation(tmp_path / f"a{suffix}", lambda: iter(bright), frame_rate_hz=10) == 2 * 8 * 8 * 3
        )


@pytest.mark.parametrize(("suffix", "rate_hz"), [(".gif", 60.0), (".gif", 0.0), (".webp", 1001.0)])
def test_rates_that_a_format_lacks_are_refused(tmp_path, suffix, rate_hz):
    with pytest.raises(BadInput, match=r"the frame rate is .*; expected above 0 and at most"):
        shown_rate_hz(suffix, rate_hz)


def test_no_frames_and_other_suffixes_are_refused(tmp_path):
    for suffix in (".gif", ".webp"):
        with pytest.raises(BadInput, match="there are no frames"):
            write_animation(tmp_path / f"a{suffix}", lambda: iter(()), frame_rate_hz=10)
    with pytest.raises(BadInput, match=r"expected a name in \.gif or \.webp"):
        write_animation(tmp_path / "a.mp4", lambda: iter(pictures()), frame_rate_hz=10)
    assert list(tmp_path.iterdir()) == []
