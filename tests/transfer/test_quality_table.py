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


@pytest.mark.parametrize(
    ("figure", "below", "above", "flag"),
    [
        ("missing_motion", 0.09, 0.11, "out-of-range"),  # OUT_OF_RANGE
        ("opening_beyond", 0.028, 0.032, "out-of-range"),  # WIDER
        ("folds", 0.0048, 0.0052, "folds"),  # FOLDED
    ],
)
def test_a_frame_is_flagged_above_its_limit(figure, below, above, flag):
    for value, flags in ((below, ()), (above, (flag,))):
        known = {"missing_motion": 0.0, "opening_beyond": 0.0, "folds": 0.0, figure: value}
        quality = Quality(*(0.0,) * len(dataclasses.fields(Quality)))
        quality = dataclasses.replace(quality, folds=known.pop("folds"))
        assert FrameMade((), quality, Reach(colour_agreement=1.0, **known), None, None, 0, "").flags == flags
