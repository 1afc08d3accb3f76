"""Laws of choosing the warp weight: the figures are those of fitting, projecting and rendering outright."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace import warp
from morphspace.basis import fit_basis, gram_matrix, mean_row
from morphspace.faces import face_mask
from morphspace.measure import psnr_db
from morphspace.model import inner_product
from morphspace.morph import morph_of, parts_of, vector_of
from morphspace.rows import RowArray
from morphspace.warpweight import FACTORS, HELD_OUT, WeightTrial, best_trial, trial_weights


def rows_and_grams(clip, count=None):
    pictures, fields = clip.pictures[:count], clip.fields[:count]
    morphs = [morph_of(image, field, "drawn") for image, field in zip(pictures, fields, strict=True)]
    rows = np.stack([vector_of(morph.texture, morph.displacement) for morph in morphs])
    return rows, *grams_of(rows, pictures[0].shape[:2])


def grams_of(rows, shape):
    mask = face_mask(*shape)
    unit, colours = inner_product(mask, 1.0), 3 * mask.size
    mean = mean_row(RowArray(rows))
    texture = gram_matrix(RowArray(rows), mean, unit, 0, colours)
    return texture, gram_matrix(RowArray(rows), mean, unit, colours, 5 * mask.size), mask


def trials_of(clip, components=50, count=None, held=None):
    """The trials; the indices of the frames that were compared are appended to `held`."""
    rows, texture, motion, mask = rows_and_grams(clip, count)
    names = [Path(name) for name in clip.names[: len(rows)]]

    def load(path):
        index = names.index(path)
        if held is not None:
            held.append(index)
        return clip.pictures[index]

    return trial_weights(RowArray(rows), texture, motion, mask, components, names, load)


@pytest.mark.parametrize("components", [1, 2, 50])
def test_a_trial_is_fitting_the_kept_frames_and_rendering_the_others(clip, components):
    rows, texture, motion, mask = rows_and_grams(clip)
    held = []
    trials = trials_of(clip, components, held=held)
    kept = np.setdiff1d(np.arange(len(rows)), held)
    assert 0 < len(held) <= HELD_OUT
    assert len(held) < len(kept)
    balanced = np.sqrt(np.trace(texture) / np.trace(motion))
    for factor, trial in zip(FACTORS, trials, strict=True):
        assert trial.weight == pytest.approx(factor * balanced)
        k = max(1, min(components, len(kept) // 2))
        mean, basis, _ = fit_basis(RowArray(rows[kept]), inner_product(mask, trial.weight), k)
        scores = []
        for index in held:
            back = mean + basis.expand(basis.project(rows[index] - mean))
            scores.append(psnr_db(warp.render(*parts_of(back, *mask.shape)), clip.pictures[index], mask))
        assert trial.psnr_db == pytest.approx(np.mean(scores), abs=0.01)  # dB


def test_equal_weight_gives_texture_and_warp_equal_variance(clip):
    rows, texture, _, mask = rows_and_grams(clip)
    weight = inner_product(mask, trials_of(clip)[0].weight / FACTORS[0]).astype(np.float64)
    variance = rows.astype(np.float64).var(axis=0, ddof=1) * weight
    assert variance[: 3 * mask.size].sum() == pytest.approx(variance[3 * mask.size :].sum(), rel=1e-4)
    assert_allclose(np.trace(texture) / (len(rows) - 1), variance[: 3 * mask.size].sum(), rtol=1e-4)


def test_too_few_frames_are_not_split(clip):
    assert trials_of(clip, count=3) == ()
    assert len(trials_of(clip, count=4)) == len(FACTORS)


def test_where_nothing_moves_or_nothing_changes_colour_there_is_nothing_to_try(clip):
    rows, _, _, mask = rows_and_grams(clip)
    names = [Path(name) for name in clip.names]

    def untouched(path):
        raise AssertionError(f"{path} was read")

    colours = 3 * mask.size
    for frozen in (np.s_[colours:], np.s_[:colours]):
        same = rows.copy()
        same[:, frozen] = same[0, frozen]
        texture, motion, _ = grams_of(same, mask.shape)
        if frozen.start is None:
            texture = np.zeros_like(texture)  # exactly; the mean of equal colours may round
        assert trial_weights(RowArray(same), texture, motion, mask, 5, names, untouched) == ()


def test_the_best_trial_is_that_of_the_highest_psnr():
    trials = (WeightTrial(0.1, 30.0), WeightTrial(0.2, 31.0), WeightTrial(0.4, 29.0))
    assert best_trial(trials) == 0.2
    assert best_trial(trials[::-1]) == 0.2
    assert best_trial(()) == 1.0
