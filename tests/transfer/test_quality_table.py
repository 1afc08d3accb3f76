"""The rows of quality.csv: a finished frame is stored and read back."""

import dataclasses
import json

import pytest

from morphspace.transfer.quality import Quality, Reach
from morphspace.transfer.quality_table import FaceSeen, FrameMade, made_of


@pytest.mark.parametrize("face", [None, FaceSeen(False), FaceSeen(True, True, 31.5, -2 / 3)])
@pytest.mark.parametrize("outside", [None, 1 / 3])
def test_a_finished_frame_reads_back_bit_equal(face, outside):
    quality = Quality(*(1 / (3 + place) for place in range(len(dataclasses.fields(Quality)))))
    document = FrameMade((0.1, -1 / 3), quality, Reach(1 / 7, -1 / 11), face, outside, 3, "ab").document()
    assert made_of(json.loads(json.dumps(document))).document() == document
