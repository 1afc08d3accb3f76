"""What is measured on each training frame."""

import numpy as np
import pytest

from morphspace.linear.quality import psnr_db
from morphspace.report.frames import SHEET_FRAMES, measure_frames
from morphspace.steps import result_of, spread


def test_figures_are_those_of_the_drawn_frame(build, figures):
    index = 7
    model = build.model
    frame, _ = build.frame(index)
    loadings = model.training.values[index]
    assert figures.psnr_db[index] == pytest.approx(psnr_db(model.render(loadings), frame.image, model.mask))
    assert figures.mahalanobis[index] == pytest.approx(np.linalg.norm(loadings / model.sd))
    assert len(figures.psnr_db) == len(model.training.frame_names)


def test_exposure_is_measured_in_stops(tmp_path, built, talking):
    images = talking(6)
    linear = np.where(images[2] <= 0.04045, images[2] / 12.92, ((images[2] + 0.055) / 1.055) ** 2.4) / 2
    darker = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055).astype(
        np.float32
    )
    build = built([*images[:2], darker, *images[3:]], tmp_path, reference=0)
    figures = result_of(measure_frames(build))
    assert figures.exposure_stops[0] == 0
    assert figures.exposure_stops[2] == pytest.approx(-1, abs=0.1)  # stops; features move under the median
    assert abs(figures.exposure_stops[3]) < 0.1


def test_open_mouth_has_more_contrast_than_a_closed_one(build, figures):
    n = len(figures.mouth_contrast)
    assert figures.mouth_contrast[n // 2] > figures.mouth_contrast[0] + 0.02


def test_contact_sheet_stays_small(figures):
    assert len(figures.sheet) == SHEET_FRAMES
    assert spread(500, SHEET_FRAMES)[0] == 0
    assert spread(500, SHEET_FRAMES)[-1] == 499
    assert spread(3, SHEET_FRAMES) == [0, 1, 2]
