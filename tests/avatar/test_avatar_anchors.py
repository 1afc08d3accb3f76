"""What our constants do to an avatar of two drawn people: each figure moves when its constant is ten times as large.

Both models are made from the exact truth. A comment gives how much a figure becomes larger or smaller, with a tenth of
the constant and with ten times as much; tolerances are far above what rounding changes.
"""

import numpy as np
import pytest

from morphspace.avatar import AvatarSettings, blend_steps
from morphspace.avatar.bands import changed, detail_of, strength
from morphspace.avatar.sharpness import curve
from morphspace.avatar.studio import studio_of
from morphspace.avatar.versions import Cast, Version, believed
from morphspace.face.regions import inside_outline, skin_share, widened
from morphspace.model.keypoints import landmarks_of
from morphspace.requests import settings_in
from morphspace.steps import result_of
from morphspace.verbs.blend_avatar import BlendAvatarRequest


def settings_of(**changes):
    """Give the settings of a blend as the verb has them, but for some."""
    return settings_in(BlendAvatarRequest(("a", "b"), "avatar.morph", **changes), AvatarSettings)


@pytest.fixture(scope="module")
def figures(drawn_anna, drawn_ben):
    anna, ben = drawn_anna.model, drawn_ben.model
    studio = studio_of([anna, ben], settings_of(expressions=6, flow="dis", components=4, weights=(3, 1)))
    mixer, versions = studio.mixer(1), studio.versions(1, 4)
    blend = mixer.blended(versions)
    added = blend.texture - mixer.mean.texture
    laid = {i: mixer.common.laid(i, one.morph, mixer.places[i]) for i, one in enumerate(versions)}
    matcher = mixer.match.__self__
    matched = matcher.matched(versions, laid)[0].displacement - laid[0].displacement
    masks = {
        "outline": inside_outline(landmarks_of(anna), *anna.mask.shape),
        "hair": skin_share(landmarks_of(ben), ben.mean.texture, ben.mask),
        "mouth": matcher.region(matcher.landmarks(1, versions[1]), *anna.mask.shape),
        "surround": widened(anna.mask),
    }
    doubted = mixer.blended([Version(versions[0].morph, 0.5, versions[0].loadings), versions[1]])
    sharp = curve(anna.mean.render(), anna.mask)
    found = {
        "curve": sharp.amount_for(1.3 * sharp.plain),
        "correspondence": np.abs(studio.common.fields[1]).mean(),
        "matched": 10 * np.abs(matched).mean(),
        "detail": 1e4 * strength(detail_of(blend.texture))[anna.mask > 0.5].mean(),
        "changed": changed(added).mean(),
        "doubted": 10 * np.abs(doubted.texture - mixer.mean.texture).mean(),
    }
    for name, mask in masks.items():
        found[f"{name} area"], found[f"{name} edge"] = mask.mean(), (mask * (1 - mask)).mean()
    return found


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("outline area", 0.2879),  # regions.INSIDE_OUTLINE: + 17 %, none
        ("outline edge", 0.0310),  # regions.OUTLINE_EDGE: - 85 %, + 425 %
        ("hair area", 0.8854),  # AROUND_HAIR: + 3, - 36 %; ABOVE_BROWS: - 2, + 6 %; HAIR: + 6 %; SKIN: - 27 %
        ("hair edge", 0.0151),  # regions.HAIR_EDGE: - 88 %, + 90 %
        ("surround area", 0.6126),  # regions.NEXT_TO_MASK: - 20 %, + 63 %
        ("mouth area", 0.0404),  # regions.AROUND_LIPS: - 23 %, + 940 %
        ("mouth edge", 0.00617),  # regions.LIPS_EDGE: - 72 %, + 450 %
        ("correspondence", 1.953),  # px; common_grid.MOST_BEYOND_POINTS: 9 %, 2 %
        ("matched", 1.0925),  # px / 10; mouth.DOUBT x 10: 2 %
        ("curve", 0.5325),  # sharpness.RADIUS: none, - 74 %
        ("detail", 6.694),  # bands.FINE: none, + 1760 %; bands.AROUND: 5 %, 26 %
        ("changed", 0.1357),  # bands.CHANGED: + 110 %, - 91 %; bands.AROUND: 9 %, 23 %
        ("doubted", 0.1806),  # blend.LEAST_SKIN x 10: 3 %
    ],
)
def test_the_avatar_of_two_drawn_people(figures, name, expected):
    assert figures[name] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        (1.5, 0.597),  # LENGTH_SD: - 45, + 12 %; MISSING: - 12, + 10 %; MISFIT: - 7 %; BEYOND: - 5, + 37 %
        (2.0, 0.354),
        (3.0, 0.262),
    ],
)
def test_a_face_further_out_is_believed_less(drawn_anna, drawn_ben, times, expected):
    """Three faces of Ben, as many times as far from his mean, as Anna shows them: their mean plausibility."""
    models = (drawn_anna.model, drawn_ben.model)
    show, _ = Cast(models, ["a", "b"], "guided", 3.0, [None, None]).shows_from(1)
    faces = times * models[1].training.values[[7, 4, 9]]
    shown = [show(loadings, models[1].offset(loadings)).plausibility for loadings in faces]
    assert np.mean(shown) == pytest.approx(expected, abs=0.003)


@pytest.mark.parametrize(("plausibility", "counts"), [(0.09, 0.0), (0.11, 0.11)])
def test_less_than_a_tenth_of_belief_is_none(drawn_anna, plausibility, counts):
    assert believed(Version(drawn_anna.model.mean, plausibility)) == counts


def test_a_finished_avatar_is_about_as_sharp_as_its_sources(drawn_anna, drawn_ben, tmp_path, monkeypatch):
    """The amount of sharpening and what it leaves. KEPT / 10: 1.109, 908; DRAWN / 10: 884; PIXEL_AVERAGES: 649."""
    monkeypatch.setenv("MORPHSPACE_MODELS", str(tmp_path))
    settings = settings_of(expressions=4, flow="dis", components=4)
    avatar = result_of(blend_steps([drawn_anna.model, drawn_ben.model], settings, tmp_path / "work"))
    assert avatar.sharpen == pytest.approx(1.0102, abs=0.005)
    figures = avatar.figures["sharpness"]
    assert figures["sources"] == pytest.approx([749.9, 901.5], abs=1)
    assert figures["unsharpened"] == pytest.approx(684.1, abs=2)
    assert figures["pixel average"] == pytest.approx(648.5, abs=2)
    assert figures["blend"] == pytest.approx(876.6, abs=3)
    assert avatar.figures["expressions_with_one_left_out"] == 0
