"""Laws of choosing the warp weight: the figures are those of fitting, projecting and rendering outright."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from morphspace.face.regions import face_mask
from morphspace.linear.pca import fit_basis, gram_matrix, mean_row
from morphspace.linear.quality import psnr_db
from morphspace.linear.rows import RowArray, RowFile
from morphspace.model import warp_weight
from morphspace.model.morph import Morph, inner_product, morph_of
from morphspace.model.warp_weight import (
    FACTORS,
    HELD_OUT,
    TRIED_FRAMES,
    WeightTrial,
    best_trial,
    trial_weights,
)


def rows_and_grams(clip, count=None):
    pictures, fields = clip.pictures[:count], clip.fields[:count]
    morphs = [morph_of(image, field, "drawn") for image, field in zip(pictures, fields, strict=True)]
    rows = np.stack([morph.vector for morph in morphs])
    return rows, *grams_of(rows, pictures[0].shape[:2])


def grams_of(rows, shape):
    mask = face_mask(*shape)
    unit, colours = inner_product(mask, 1.0), 3 * mask.size
    mean = mean_row(RowArray(rows))
    texture = gram_matrix(RowArray(rows), mean, unit, 0, colours)
    return texture, gram_matrix(RowArray(rows), mean, unit, colours, 5 * mask.size), mask


def trials_of(clip, components=50, count=None, held=None):
    """The trials; the indices of the frames that were compared are appended to `held`."""
    rows, _, _, mask = rows_and_grams(clip, count)
    names = [Path(name) for name in clip.names[: len(rows)]]
    return trial_weights(
        RowArray(rows), mean_row(RowArray(rows)), mask, components, names, loader(clip, held)
    )


def loader(clip, held=None):
    """Return the picture of a frame by its name; append its index to `held`."""

    def load(path):
        index = clip.names.index(str(path))
        if held is not None:
            held.append(index)
        return clip.pictures[index]

    return load


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
            scores.append(psnr_db(Morph(back, mask.shape, "here").render(), clip.pictures[index], mask))
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
        mean = mean_row(RowArray(same))
        assert trial_weights(RowArray(same), mean, mask, 5, names, untouched) == ()
        moving = mean_row(RowArray(rows))
        with pytest.raises(AssertionError, match="was read"):
            trial_weights(RowArray(rows), moving, mask, 5, names, untouched)


@pytest.mark.parametrize("tried", [4, 5, 8])
def test_of_many_frames_some_that_are_evenly_spread_take_part(clip, monkeypatch, tried):
    rows, _, _, mask = rows_and_grams(clip)
    assert tried < len(rows) < TRIED_FRAMES
    mean, names = mean_row(RowArray(rows)), [Path(name) for name in clip.names]
    chosen = np.linspace(0, len(rows) - 1, tried).round().astype(int)
    some = [names[index] for index in chosen]
    held, all_held = [], []
    alone = trial_weights(RowArray(rows[chosen]), mean, mask, 3, some, loader(clip, held))
    whole = trial_weights(RowArray(rows), mean, mask, 3, names, loader(clip, all_held))
    monkeypatch.setattr(warp_weight, "TRIED_FRAMES", tried)
    subset_held = []
    found = trial_weights(RowArray(rows), mean, mask, 3, names, loader(clip, subset_held))
    assert found == alone
    assert found != whole
    assert subset_held == held
    assert set(held) <= set(chosen)


def test_frames_that_do_not_take_part_are_never_read(clip, monkeypatch):
    rows, _, _, mask = rows_and_grams(clip)
    mean, names = mean_row(RowArray(rows)), [Path(name) for name in clip.names]
    monkeypatch.setattr(warp_weight, "TRIED_FRAMES", 5)
    found = trial_weights(RowArray(rows), mean, mask, 3, names, loader(clip))
    for index in set(range(len(rows))) - {0, 2, 4, 6, 8}:
        rows[index] = np.nan
    assert trial_weights(RowArray(rows), mean, mask, 3, names, loader(clip)) == found


@pytest.mark.parametrize("tried", [5, TRIED_FRAMES])
def test_rows_in_a_file_give_the_same_trials(clip, monkeypatch, tmp_path, tried):
    rows, _, _, mask = rows_and_grams(clip)
    mean, names = mean_row(RowArray(rows)), [Path(name) for name in clip.names]
    monkeypatch.setattr(warp_weight, "TRIED_FRAMES", tried)
    with RowFile(tmp_path / "some.rows", *rows.shape) as file:
        for index, row in enumerate(rows):
            file.write_row(index, row)
        found = trial_weights(file, mean, mask, 3, names, loader(clip))
    assert found == trial_weights(RowArray(rows), mean, mask, 3, names, loader(clip))


def test_the_best_trial_is_that_of_the_highest_psnr():
    trials = (WeightTrial(0.1, 30.0), WeightTrial(0.2, 31.0), WeightTrial(0.4, 29.0))
    assert best_trial(trials) == 0.2
    assert best_trial(trials[::-1]) == 0.2
    assert best_trial(()) == 1.0
