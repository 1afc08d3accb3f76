"""Maps and small pictures of a page."""

import cv2
import numpy as np

from morphspace.grid.warp import determinants
from morphspace.model.morph import Morph
from morphspace.report.pictures import (
    PANEL_GAP_PX,
    STRIP_WIDTH_PX,
    confidence_chart,
    fold_chart,
    of_height,
    of_width,
    panels_of,
    shrunk_morph,
)


def test_fold_map_marks_what_folds(build):
    morph = build.model.mean
    assert not _reddish(fold_chart(morph, build.model.mask)).any()
    folded = morph.displacement.copy()
    folded[40, 30, 0] += 5
    broken = Morph.of(morph.texture, folded, morph.reference_id)
    marked = _reddish(fold_chart(broken, build.model.mask))
    assert marked.sum() == 4 * (determinants(folded) <= 0).sum()  # each cell is drawn twice as large
    assert marked[70:90, 50:72].sum() == marked.sum()


def _reddish(picture):
    return picture[..., 0] > picture[..., 1] + 0.2


def test_confidence_map_is_tinted_where_the_flow_is_unsure(build):
    model = build.model
    face, mask = model.mean.render(), model.mask
    sure = confidence_chart(face, np.ones_like(mask), mask)
    height, width = mask.shape
    assert sure.shape == (2 * height, 2 * width, 3)  # small faces are drawn at twice the size
    assert np.ptp(sure, axis=2).max() < 1e-6  # grey all over
    confidence = np.ones_like(mask)
    confidence[: height // 2] = 0.25
    tint = np.ptp(confidence_chart(face, confidence, mask), axis=2)[::2, ::2]
    assert (tint[(mask > 0.99) & (confidence < 1)] > 0.2).all()
    assert (tint[(mask == 0) | (confidence == 1)] < 1e-6).all()
    half = np.ptp(confidence_chart(face, 0.5 * (1 + confidence), mask), axis=2)[::2, ::2]
    assert (half <= tint + 1e-6).all()


def test_shrinking_a_morph_shrinks_its_picture():
    y, x = np.mgrid[:300, : 2 * STRIP_WIDTH_PX].astype(np.float32)
    waves = (0.5 + 0.3 * np.sin(x / 15) * np.cos(y / 20)).astype(np.float32)
    field = np.stack([6 * np.sin(y / 40), 4 * np.cos(x / 50)], axis=-1).astype(np.float32)
    morph = Morph.of(np.repeat(waves[..., None], 3, axis=2), field, "mean")
    small = shrunk_morph(morph)
    assert small.texture.shape == (150, STRIP_WIDTH_PX, 3)
    whole = cv2.resize(morph.render(), (STRIP_WIDTH_PX, 150), interpolation=cv2.INTER_AREA)
    error = (small.render() - whole)[10:-10, 10:-10]
    assert np.abs(error).max() < 0.01  # colour; a field that is not scaled misses by 0.1
    assert shrunk_morph(small) is small


def test_a_resized_picture_keeps_its_proportions():
    picture = np.full((30, 20, 3), 0.5, np.float32)
    assert of_height(picture, 60).shape == (60, 40, 3)
    assert of_height(picture, 10).shape == (10, 7, 3)
    assert of_width(picture, 40).shape == (60, 40, 3)
    assert of_height(picture, 30) is picture and of_width(picture, 20) is picture


def test_panels_have_one_height_and_a_white_gap():
    first, second = np.full((30, 20, 3), 0.25, np.float32), np.full((60, 20, 3), 0.75, np.float32)
    frame = panels_of((first, second), 30)
    assert frame.shape == (30, 20 + PANEL_GAP_PX + 10, 3)
    assert (frame[:, :20] == 0.25).all() and (frame[:, 20 : 20 + PANEL_GAP_PX] == 1).all()
    np.testing.assert_allclose(frame[:, 20 + PANEL_GAP_PX :], 0.75, atol=1e-6)
