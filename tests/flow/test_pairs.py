"""What an estimator asks of a pair of pictures: size, kind, and something to follow."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from morphspace.errors import BadInput, SizeMismatch
from morphspace.flow.pairs import checked_pair, checked_picture, is_featureless
from morphspace.flow.starts import flow_between


def test_a_pair_of_one_channel_is_repeated_and_stays_what_it_is(picture):
    colour = picture(20, 24)
    for grey in (colour[..., 0], colour[..., :1]):
        one, other = checked_pair(grey, colour.astype(np.float64))
        assert one.shape == other.shape == (20, 24, 3) and one.dtype == other.dtype == np.float32
        assert_array_equal(one, np.repeat(colour[..., :1], 3, axis=2))
        assert_array_equal(other, colour)


@pytest.mark.parametrize(
    ("image", "mentioned"),
    [
        (np.zeros((20, 20, 4), np.float32), r"\(20, 20, 4\)"),
        (np.zeros(20, np.float32), r"\(20,\)"),
        (np.zeros((20, 20, 3), np.uint8), "uint8"),
        (np.zeros((15, 20, 3), np.float32), "20x15"),
        (np.zeros((20, 0, 3), np.float32), "0x20"),
        (np.full((20, 20, 3), np.nan, np.float32), "1200 values"),
        (np.full((20, 20, 3), -np.inf, np.float32), "1200 values"),
        (np.full((20, 20, 3), -1e6, np.float32), "1e"),
    ],
)
def test_what_is_no_picture_is_refused_by_its_name(image, mentioned):
    with pytest.raises(BadInput, match=f"the frame .*{mentioned}"):
        checked_picture(image, "the frame")


def test_sizes_that_differ_are_a_size_mismatch(picture):
    with pytest.raises(SizeMismatch, match=r"the frame has 21x20 px; expected 20x20 px"):
        checked_pair(picture(20, 20), picture(20, 21))


def test_half_a_code_is_nothing_and_one_code_is_something():
    image = np.full((20, 20, 3), 0.5, np.float32)
    image[4, 4, 1] += 0.4 / 255
    assert is_featureless(image)
    image[4, 4, 1] = 0.5 + 1 / 255
    assert not is_featureless(image)


def test_a_pair_without_features_never_reaches_a_method():
    def never(reference):
        raise AssertionError("the method was asked")

    flat = np.zeros((48, 64, 3), np.float32)
    flow = flow_between(never, flat, flat)
    assert not flow.displacement.any() and not flow.confidence.any()
