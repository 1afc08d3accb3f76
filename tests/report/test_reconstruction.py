"""The folder of a reconstruction: pictures, sheet and page agree with the table of figures."""

import csv

import numpy as np
import pytest

from morphspace.io.images import read_image, write_image
from morphspace.linear.quality import psnr_db
from morphspace.report.reconstruction import SHEET_COLUMNS, SHEET_FRAMES
from morphspace.steps import result_of
from morphspace.verbs.reconstruct import ReconstructRequest, run

FRAMES = 12


@pytest.fixture(scope="module")
def made(model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reconstruction")
    model.save(folder / "a.morph")
    (folder / "clip").mkdir()
    for name, loadings in zip(model.training.frame_names, model.training.values, strict=True):
        write_image(folder / "clip" / f"{name}.png", model.render(loadings))
    outcome = result_of(
        run(ReconstructRequest(folder / "a.morph", (str(folder / "clip"),), folder / "out", components=1))
    )
    return folder, outcome


def test_the_table_holds_the_psnr_of_the_pictures(made, model):
    folder, outcome = made
    with (folder / "out" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == FRAMES
    for row in rows:
        aligned, drawn = (
            read_image(folder / "out" / kind / f"{row['frame']}.png") for kind in ("aligned", "reconstructed")
        )
        # both pictures are rounded to 8 bits, an error at 59 dB; one component leaves far larger ones
        assert float(row["psnr_db"]) == pytest.approx(psnr_db(drawn, aligned, model.mask), abs=0.3)
    median = np.median([float(row["psnr_db"]) for row in rows])
    assert outcome.document["psnr_db_median"] == pytest.approx(median)
    assert f"{median:.1f} dB" in (folder / "out" / "index.html").read_text()


def test_the_sheet_shows_each_frame_above_its_drawing(made, model):
    folder, _ = made
    sheet = read_image(folder / "out" / "sheet.png")
    width, height = model.size
    gap = sheet.shape[0] // 2 - 2 * height
    assert sheet.shape[:2] == (2 * (2 * height + gap), SHEET_COLUMNS * width) and FRAMES < SHEET_FRAMES
    names = sorted(model.training.frame_names)
    first = read_image(folder / "out" / "aligned" / f"{names[0]}.png")
    np.testing.assert_array_equal(sheet[:height, :width], first)
    second_row = read_image(folder / "out" / "reconstructed" / f"{names[SHEET_COLUMNS]}.png")
    np.testing.assert_array_equal(sheet[-height:, :width], second_row)


def test_the_page_names_every_shown_frame_and_loads_nothing(made, model):
    page = (made[0] / "out" / "index.html").read_text()
    assert all(name in page for name in model.training.frame_names)
    assert "http:" not in page.replace("http://www.w3.org/2000/svg", "") and "<script" not in page
