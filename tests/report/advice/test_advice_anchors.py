"""Where advice begins: each limit lies between a value that gets none and one that does."""

from dataclasses import replace

import numpy as np
import pytest

from morphspace.imitation.alignment import Alignment
from morphspace.imitation.chance import Baseline
from morphspace.imitation.comparison import Comparison
from morphspace.model.morph import Morph
from morphspace.report.advice.build import Case, advice_for
from morphspace.report.advice.imitation import chance_words
from morphspace.report.advice.mimicry import _centre_words
from morphspace.transfer.neutral import Neutral


@pytest.mark.parametrize(("mean_sd", "is_off"), [(1.9, False), (-1.9, False), (2.1, True), (-2.1, True)])
def test_a_clip_is_off_centre_beyond_two_sd(drawn_anna, mean_sd, is_off):
    """OFF_CENTRE_SD, of the component that is driven farthest."""
    model = drawn_anna.model
    loadings_sd = np.zeros((4, model.rank))
    loadings_sd[:, 1] = mean_sd + np.array([-3.0, -1.0, 1.0, 3.0])
    neutral = Neutral("mean", np.zeros(model.rank), np.zeros(model.rank))
    words = _centre_words(model, model, loadings_sd, neutral)
    assert bool(words) == is_off
    assert not is_off or f"{mean_sd:+.1f} SD of pc002" in words[0]


@pytest.mark.parametrize(("correlation", "is_noted"), [(0.9985, True), (0.9995, False)])
def test_the_longest_lag_is_noted_unless_nothing_is_left_to_find(correlation, is_noted):
    """SAME: a correlation of 1 but for a thousandth."""
    shifts = np.arange(1, 200)
    measures = {"lag_frames": np.array([7.0]), "correlation": np.array([correlation])}
    alignment = Alignment(np.zeros((1, 2), int), 0.0)
    baseline = Baseline(shifts, shifts, True, 199, 199, 0)
    found = chance_words(Comparison(measures, np.arange(-7, 8), np.zeros(15), alignment, baseline))
    assert [("is the longest" in words) for words in found] == [True] * is_noted


def masked(case, share=0.5, contrast_sd=0.1):
    """The case with a mask over this share of the frame, on a chequered face of this contrast."""
    model = case.build.model
    height, width = model.mask.shape
    mask = np.zeros(height * width, np.float32)
    mask[: round(share * mask.size)] = 1
    chequered = np.indices((height, width, 3))[:2].sum(axis=0) % 2 - 0.5
    texture = (0.5 + 2 * contrast_sd * chequered).astype(np.float32)
    mean = Morph.of(texture, model.mean.displacement, model.mean.reference_id)
    changed = replace(model, mask=mask.reshape(height, width), mean=mean)
    return Case(replace(case.build, model=changed), case.figures)


def shortened(case, frames):
    """The case with so many training frames."""
    training = case.build.model.training
    few = replace(training, values=training.values[:frames], frame_names=training.frame_names[:frames])
    return Case(replace(case.build, model=replace(case.build.model, training=few)), case.figures)


def enlarged(case, ratio):
    """The case of sources that were so many times as large."""
    width, height = case.build.model.size
    return Case(case.build, case.figures, (round(ratio * width), round(ratio * height)))


@pytest.mark.parametrize(
    ("rule", "word", "changed", "nothing", "enough"),
    [
        ("mask", "only", masked, 0.055, 0.045),  # MASK_LEAST_SHARE
        ("mask", "background", masked, 0.94, 0.96),  # MASK_MOST_SHARE
        ("mask", "texture", lambda case, sd: masked(case, contrast_sd=sd), 0.011, 0.009),  # MASK_FLAT_SD
        ("few_frames", "19 frames", shortened, 20, 19),  # FRAMES_FEW
        ("source_size", "reduced", enlarged, 1.45, 1.55),  # SOURCE_LARGER
    ],
)
def test_advice_on_a_build_begins_at_its_limit(clean, rule, word, changed, nothing, enough):
    assert advice_for(changed(clean, nothing)) == ()
    (advice,) = advice_for(changed(clean, enough))
    assert advice.rule == rule and word in advice.text


def test_a_sentence_names_five_frames_at_most(clean):
    """NAMES_AT_MOST."""
    assert clean.named(range(5)) == ", ".join(clean.names[:5])
    assert clean.named(range(7)) == ", ".join(clean.names[:5]) + " and 2 more"
