"""Laws of a build from a clip: what its sidecar says is used, and what was mended of it is said."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from morphspace.io.clips import Clip, open_clip
from morphspace.io.framing import Framing
from morphspace.io.images import write_image
from morphspace.io.sidecars import Sidecar
from morphspace.model.from_clip import ClipSettings, _marked_faceframe, _size_notes, default_size


def test_a_build_says_that_it_exchanged_the_eyes_of_a_sidecar(tmp_path):
    write_image(tmp_path / "frame_3.png", np.zeros((40, 50, 3), np.float32))
    faceframe = {"frame": "frame_3", "left_eye": [14, 14.5], "right_eye": [30, 14], "philtrum": [22, 29]}
    (tmp_path / "clip.json").write_text(json.dumps({"faceframe": faceframe}))
    clip = open_clip([tmp_path])
    framing = Framing(clip.size, None, clip.size)
    faceframe, _, notes = _marked_faceframe(clip, framing)
    assert_array_equal(faceframe.points, [[14, 14.5], [30, 14], [22, 29]])
    assert "eyes were exchanged" in notes[0]


def clip_of(size, is_video=False):
    return Clip("c", ("a",), size, Sidecar(), (Path("a.png"),), (0,) if is_video else None)


@pytest.mark.parametrize(
    ("size", "is_video", "crop", "expected"),
    [
        ((450, 540), False, None, (450, 540)),
        ((450, 540), True, None, (200, 240)),
        ((400, 300), True, None, (400, 300)),
        ((1000, 1000), False, None, (1000, 1000)),
        ((1000, 1001), False, None, (200, 240)),
        ((1920, 1080), True, (0, 0, 160, 192), (160, 192)),
    ],
)
def test_stills_keep_their_size_and_large_videos_are_scaled(size, is_video, crop, expected):
    assert default_size(clip_of(size, is_video), crop) == expected


def test_what_is_done_to_the_size_is_said_with_what_it_costs():
    def notes(size, asked=None):
        asked = ClipSettings(size=asked)
        framing = Framing(size, None, asked.size or default_size(clip_of(size), None))
        return "".join(_size_notes(framing, asked))

    # 50 components of 5 float32 a pixel: 1000 bytes
    assert notes((450, 540)).startswith("the frames keep their 450x540 px: 50 components have 243 MB")
    assert "scaled to 320x240 and cropped to the middle 200x240" in notes((1600, 1200))
    assert "50 components of 1600x1200 px have 1920 MB, these have 48 MB" in notes((1600, 1200))
    assert notes((200, 240)) == notes((400, 480), (200, 240)) == ""
