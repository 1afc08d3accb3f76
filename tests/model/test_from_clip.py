"""Laws of a build from a clip: what its sidecar says is used, and what was mended of it is said."""

import json

import numpy as np
from numpy.testing import assert_array_equal

from morphspace.io.clips import open_clip
from morphspace.io.framing import Framing
from morphspace.io.images import write_image
from morphspace.model.from_clip import marked_faceframe


def test_a_build_says_that_it_exchanged_the_eyes_of_a_sidecar(tmp_path):
    write_image(tmp_path / "frame_3.png", np.zeros((40, 50, 3), np.float32))
    faceframe = {"frame": "frame_3", "left_eye": [14, 14.5], "right_eye": [30, 14], "philtrum": [22, 29]}
    (tmp_path / "clip.json").write_text(json.dumps({"faceframe": faceframe}))
    clip = open_clip([tmp_path])
    framing = Framing(clip.size, None, clip.size)
    faceframe, _, notes = marked_faceframe(clip, framing)
    assert_array_equal(faceframe.points, [[14, 14.5], [30, 14], [22, 29]])
    assert "eyes were exchanged" in notes[0]
