"""The page of a blend: it says whose versions were left out, escapes names, and loads nothing."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from morphspace.avatar.distances import MeanDistances, mean_face_distances, shape_percent
from morphspace.face.faceframe import FaceFrame
from morphspace.model.morph import Morph
from morphspace.report.avatar_page import (
    AvatarResult,
    ExpressionRow,
    avatar_page,
    parts_taken,
    rows_shown,
    sharp_shares,
    variance_between,
)

K, N = 3, 9
ASKED = np.array([0.5, 0.3, 0.2])


@pytest.fixture
def shown(model):
    rng = np.random.default_rng(3)
    height, width = model.mask.shape
    used = np.tile(ASKED, (N, 1))
    used[4] = [0.625, 0.375, 0.0]
    used[5] = [0.5, 0.3, 0.06] / np.float64(0.86)
    plausibility = np.ones((N, K))
    plausibility[4, 2], plausibility[5, 2] = 0.11, 0.3

    def face():
        return rng.random((height, width, 3)).astype(np.float32)

    rows = [ExpressionRow(index, [face() for _ in range(K)], face(), face()) for index in (0, 4, 5)]
    return AvatarResult(
        model=replace(
            model, training=replace(model.training, values=model.training.values[:N], frame_names=tuple("abcdefghi"))
        ),
        identities=("Ann", "Ben", "Cy"),
        asked=ASKED,
        sources=[0, 0, 0, 1, 1, 1, 2, 2, 2],
        frames=[f"f{index:02d}" for index in range(N)],
        used=used,
        plausibility=plausibility,
        rows=rows,
        sharpness={"sources": np.array([2e-3, 1e-3, 3e-3]), "blend": 1.71e-3, "pixel average": 4.75e-4},
        sharpen=0.7,
        surround="Ann",
        distances=MeanDistances(None, np.full((K + 1, K + 1), 5.0)),
        notes=("Cy does not open the mouth.",),
        settings={"method": "guided"},
    )  # fmt: skip


def row_of(page, section, header):
    part = page[page.index(f'id="{section}"') :]
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", part, re.S)
    (found,) = [row for row in rows if f'<th scope="row">{header}</th>' in row][:1]
    return re.findall(r"<td[^>]*>(.*?)</td>", found)


def test_a_version_left_out_is_named_with_its_expression(shown):
    assert row_of(avatar_page(shown), "left-out", "f04") == ["Ben", "Cy (0.11)", ""]


def test_a_version_with_less_weight_is_named_with_the_weight_used(shown):
    assert row_of(avatar_page(shown), "left-out", "f05") == ["Ben", "", "Cy (7 %, 0.30)"]


def test_expressions_with_all_versions_are_not_listed_as_missing_any(shown):
    listed = avatar_page(shown).split('id="left-out"')[1].split("</section>")[0]
    assert re.findall(r'<th scope="row">(f\d\d)</th>', listed) == ["f04", "f05"]


def test_page_says_so_where_nothing_was_left_out(shown):
    page = avatar_page(replace(shown, used=np.tile(ASKED, (N, 1))))
    assert "every identity has its full part" in page


def test_sheet_has_a_row_for_each_expression_and_a_column_for_each_version_blend_and_average(shown):
    page = avatar_page(shown)
    sheet = page.split('id="sheet"')[1].split("</section>")[0]
    assert sheet.count('class="row"') == 3
    assert sheet.count("<img") == 3 * (K + 2)
    assert sheet.count("(its own, ") == 3
    assert sheet.count("left out<") == 1


def test_an_identity_of_weight_zero_is_not_called_left_out(shown):
    used = np.tile([0.6, 0.4, 0.0], (N, 1))
    page = avatar_page(replace(shown, asked=np.array([0.6, 0.4, 0.0]), used=used))
    assert "Cy: left out" not in page and "every identity has its full part" in page


def test_sharpness_is_told_as_a_share_of_the_sources_mean(shown):
    page = avatar_page(shown)
    assert row_of(page, "sharpness", "blend")[1] == "90 %"
    assert row_of(page, "sharpness", "pixel average")[1] == "25 %"
    assert "before the unsharp mask" not in page
    known = avatar_page(replace(shown, sharpness={**shown.sharpness, "unsharpened": 9.5e-4}))
    assert row_of(known, "sharpness", "blend before the unsharp mask")[1] == "50 %"


def test_sharpness_of_flat_pictures_is_undefined_not_a_failure(shown):
    flat = replace(shown, sharpness={"sources": np.zeros(K), "blend": 0.0, "pixel average": 0.0})
    assert np.isnan(sharp_shares(flat)["blend"])
    assert avatar_page(flat)


def test_page_works_without_components_distances_or_rows(shown):
    bare = shown.model.truncate(0)
    page = avatar_page(replace(shown, model=bare, distances=None, rows=[], notes=()))
    assert "are not known" in page and "no components" in page.lower()


def test_blend_is_called_nearer_only_where_it_is(shown):
    apart = np.full((K + 1, K + 1), 4.0)
    np.fill_diagonal(apart, 0)
    apart[0, K] = apart[K, 0] = 3.9
    apart[1, K] = apart[K, 1] = 4.1
    page = avatar_page(replace(shown, distances=MeanDistances(None, apart)))
    table = page.split("Colour of the mean faces")[1]
    assert row_of('id="x"' + table, "x", "Ann")[-1] == "yes"
    assert row_of('id="x"' + table, "x", "Ben")[-1] == "no"


def test_part_taken_does_not_change_with_the_weights_asked():
    rng = np.random.default_rng(0)
    plausible = rng.random((7, 4))
    plausible[:, 0] = 1
    for asked in (np.full(4, 0.25), np.array([0.4, 0.3, 0.2, 0.1])):
        used = plausible * asked
        used /= used.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(parts_taken(used, asked), plausible, atol=1e-12)


def test_rows_shown_are_in_order_without_repeats_and_have_the_worst():
    used = np.tile(ASKED, (100, 1))
    used[[13, 57]] = [0.625, 0.375, 0]
    rows = rows_shown(used, ASKED, 20)
    assert len(rows) == 20 and rows == sorted(set(rows))
    assert {13, 57} <= set(rows)
    assert rows_shown(used[:5], ASKED, 20) == [0, 1, 2, 3, 4]


def test_a_component_that_is_the_source_itself_is_told_apart_fully_and_one_alike_in_all_not_at_all():
    sources = [0] * 4 + [1] * 4
    pattern = np.array([1.0, -1, 2, -2])
    loadings = np.column_stack([np.repeat([3.0, -3.0], 4), np.tile(pattern, 2), np.zeros(8)])
    np.testing.assert_allclose(variance_between(loadings, sources), [1, 0, 0], atol=1e-12)


def test_shape_distance_ignores_size_place_and_tilt_and_not_shape():
    rng = np.random.default_rng(1)
    points = rng.random((30, 2))
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    assert shape_percent(points, 1.7 * points @ turn + [5, -3]) == pytest.approx(0, abs=1e-9)
    mirrored = points * [-1, 1]
    assert shape_percent(points, mirrored) > 5
    other = points + rng.normal(0, 0.02, points.shape)
    assert shape_percent(points, other) == pytest.approx(shape_percent(other, points), abs=1e-9)
    assert shape_percent(points, other) == pytest.approx(100 * 0.02 * np.sqrt(2), rel=0.25)


def test_mean_face_of_a_model_has_no_distance_to_itself_and_some_to_a_brighter_one(model):
    frame = FaceFrame((16.0, 26.0), (44.0, 26.0), (30.0, 46.0))
    one = model.with_faceframe(frame)
    texture = (one.mean.texture + np.float32(0.05)).astype(np.float32)
    brighter = replace(one, mean=Morph.of(texture, one.mean.displacement, one.mean.reference_id))
    everywhere = np.ones(model.mask.shape, bool)
    found = mean_face_distances([one, brighter], one, everywhere)
    assert found.shape_percent is None
    assert found.colour_percent[0, 2] == pytest.approx(0, abs=0.02)
    assert found.colour_percent[0, 1] == pytest.approx(5, abs=0.2)
    np.testing.assert_array_equal(found.colour_percent, found.colour_percent.T)


def test_colour_is_compared_in_the_shared_face_alone(model):
    one = model.with_faceframe(FaceFrame((16.0, 26.0), (44.0, 26.0), (30.0, 46.0)))
    shared = np.zeros(model.mask.shape, bool)
    shared[20:50, 20:44] = True
    texture = np.array(one.mean.texture)
    texture[:10] = 1 - texture[:10]  # other hair
    found = mean_face_distances(
        [one, replace(one, mean=Morph.of(texture, one.mean.displacement, one.mean.reference_id))], one, shared
    )
    assert found.colour_percent[0, 1] < 0.1


def test_page_says_whose_hair_it_is_and_what_else_can_be_had(shown):
    assert "Ann's alone" in avatar_page(shown) and "--surround flat" in avatar_page(shown)
    assert "flat grey" in avatar_page(replace(shown, surround="flat field"))
