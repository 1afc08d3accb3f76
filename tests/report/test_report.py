"""The report: a page that holds together by itself, tells the truth about a build, and gives advice only where due."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from morphspace.arrays import Image
from morphspace.face.faceframe import mouth_region
from morphspace.grid.warp import determinants
from morphspace.linear.quality import psnr_db
from morphspace.model.morph import Morph
from morphspace.model.passes import Build, BuildSettings, build_steps
from morphspace.report import (
    Advice,
    Case,
    FrameFigures,
    advice_for,
    measure_frames,
    report_page,
    write_report,
)
from morphspace.report.advice import FRAMES_FEW, head_path
from morphspace.report.figures import SHEET_FRAMES
from morphspace.report.markup import element, text
from morphspace.report.pictures import STRIP_WIDTH_PX, confidence_chart, fold_chart, shrunk_morph
from morphspace.report.plots import Mark, Plot, line_plot, round_ticks
from morphspace.report.sections import explained
from morphspace.steps import result_of, spread
from morphspace.storage import digest_of_array
from morphspace.synthetic import Expression, Identity, drawn_actor

SIZE = (64, 80)
HOSTILE = '<script>alert("x")</script>\'&\x00\udcff'
VOID = {"img", "meta", "br"}


class Frames:
    """Frames held in memory, as a source."""

    def __init__(self, images: list[Image], names: list[str] | None = None) -> None:
        self.held = images
        self.names = tuple(names or [f"frame_{i:04d}.png" for i in range(len(images))])
        self.digests = tuple(digest_of_array(image) for image in images)

    def images(self, indices: list[int]) -> Iterator[Image]:
        return (self.held[index] for index in indices)


def talking(count: int) -> list[Image]:
    """An actor who opens the mouth and raises the brows."""
    actor = drawn_actor(Identity.random(np.random.default_rng(4)), SIZE)
    phase = np.linspace(0, 2 * np.pi, count, endpoint=False)
    amounts = [(0.5 - 0.5 * np.cos(p), 0.5 - 0.5 * np.cos(2 * p + 0.5)) for p in phase]
    return [
        actor.draw(Expression(jaw_open=a, brow_inner_raise=b, brow_outer_raise=b)).image for a, b in amounts
    ]


def built(images: list[Image], folder: Path, **changes: object) -> Build:
    provenance = {"identity": "A. Actor", "consent": "drawn", "sources": [{"sha256": "ab" * 32}]}
    settings = replace(BuildSettings(components=8, flow="dis"), **changes)  # type: ignore[arg-type]
    return result_of(build_steps(Frames(images), settings, folder, provenance))


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return built(talking(FRAMES_FEW + 6), tmp_path_factory.mktemp("work"))


@pytest.fixture(scope="module")
def figures(build: Build) -> FrameFigures:
    return result_of(measure_frames(build))


@pytest.fixture(scope="module")
def page(build: Build, figures: FrameFigures) -> str:
    return report_page(build, figures)


@pytest.fixture
def clean(build: Build) -> Case:
    """A build and figures in which nothing is off."""
    n = len(build.model.training.frame_names)
    figures = FrameFigures(
        psnr_db=np.full(n, 42.0),
        fold_fractions=np.zeros(n),
        luminance=np.full(n, 0.5),
        exposure_stops=np.zeros(n),
        mahalanobis=np.full(n, 3.0),
        rigid_motion_px=np.full(n, 0.2),
        mouth_contrast=np.zeros(n),
        sheet=(),
    )
    still = np.tile(np.eye(2, 3), (n, 1, 1))
    sure = np.full(n, 0.9)
    sure[0] = 0.8
    calm = replace(
        build,
        registrations=still,
        fold_fractions=np.zeros(n),
        confidences=sure,
        confidence_map=np.full_like(build.model.mask, 0.9),
        warnings=(),
    )
    return Case(calm, figures)


class Checker(HTMLParser):
    """Follow the tags of a page, and collect what it refers to."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.seen: list[str] = []
        self.references: list[str] = []
        self.ids: list[str] = []
        self.images_without_words = 0
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        assert len(found) == len(attrs), f"<{tag}> has an attribute twice"
        self.seen.append(tag)
        self.references += [
            v or "" for k, v in attrs if k in ("src", "href", "data", "action", "srcset", "poster")
        ]
        self.ids += [v or "" for k, v in attrs if k == "id"]
        assert not any(key.startswith("on") for key in found)
        if tag == "img" and not found.get("alt"):
            self.images_without_words += 1
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert tag not in VOID
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def checked(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    checker.close()
    assert checker.open == []
    return checker


def rules(found: tuple[Advice, ...]) -> set[str]:
    return {advice.rule for advice in found}


# the page


def test_page_is_well_formed(page: str) -> None:
    checker = checked(page)
    assert page.startswith("<!DOCTYPE html>\n<html lang=")
    assert {"h1", "h2", "table", "svg", "figure"} <= set(checker.seen)
    assert len(set(checker.ids)) == len(checker.ids)
    assert checker.images_without_words == 0


def test_page_is_self_contained(page: str) -> None:
    checker = checked(page)
    for reference in checker.references:
        assert reference.startswith(("data:image/jpeg;base64,", "data:image/png;base64,", "#"))
        if reference.startswith("#"):
            assert reference[1:] in checker.ids
    assert not {"script", "link", "iframe", "object", "base"} & set(checker.seen)
    assert not re.search(r"https?:|url\(|@import", page)


def test_page_shows_every_part(page: str, build: Build) -> None:
    words = " ".join(checked(page).words)
    for part in (
        "A. Actor",
        build.choice.name,
        build.model.model_id,
        "Contact sheet",
        "Component 8",
        "median",
        "drawn",
    ):
        assert part in words
    assert f"{len(build.model.training.frame_names)} frames" in words


def test_same_build_gives_the_same_bytes(page: str, build: Build, tmp_path: Path) -> None:
    again = result_of(measure_frames(build))
    write_report(tmp_path / "report.html", build, again)
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


def test_hostile_words_are_escaped(build: Build, figures: FrameFigures, tmp_path: Path) -> None:
    model = build.model
    names = tuple(f"{HOSTILE}{i}" for i in range(len(model.training.frame_names)))
    provenance = {
        "identity": HOSTILE,
        "consent": HOSTILE,
        HOSTILE: {HOSTILE: [HOSTILE, {HOSTILE: HOSTILE}]},
        "many": [HOSTILE] * 20,
    }
    hostile = replace(
        build,
        model=replace(
            model, provenance=provenance, training=replace(model.training, frame_names=names), flow=HOSTILE
        ),
        choice=replace(build.choice, name=HOSTILE, reason=HOSTILE),
        warnings=(HOSTILE,),
    )
    figures = replace(
        figures,
        fold_fractions=np.full(len(names), 0.5),
        psnr_db=np.full(len(names), 9.0),
        exposure_stops=np.arange(26.0),
    )
    write_report(tmp_path / "report.html", hostile, figures)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    checker = checked(page)
    assert "script" not in checker.seen
    assert "\x00" not in page
    assert any('<script>alert("x")</script>' in words for words in checker.words)


def test_constant_clip_gives_a_page(tmp_path: Path) -> None:
    build = built([talking(1)[0]] * 3, tmp_path)
    assert build.model.rank == 0
    figures = result_of(measure_frames(build))
    checked(report_page(build, figures))
    assert "build" in rules(advice_for(Case(build, figures)))
    assert explained(build.model).shape == (0,)


def test_three_frames_give_a_page(tmp_path: Path) -> None:
    build = built(talking(3), tmp_path)
    figures = result_of(measure_frames(build))
    page = report_page(build, figures)
    checked(page)
    assert rules(advice_for(Case(build, figures))) >= {"few_frames", "rank"}
    assert not re.search(r"\b(nan|inf)\b", re.sub(r"base64,[A-Za-z0-9+/=]*", "", page))


# what is measured


def test_figures_are_those_of_the_drawn_frame(build: Build, figures: FrameFigures) -> None:
    index = 7
    model = build.model
    frame, _ = build.frame(index)
    loadings = model.training.values[index]
    assert figures.psnr_db[index] == pytest.approx(psnr_db(model.render(loadings), frame.image, model.mask))
    assert figures.mahalanobis[index] == pytest.approx(np.linalg.norm(loadings / model.sd))
    assert len(figures.psnr_db) == len(model.training.frame_names)


def test_exposure_is_measured_in_stops(tmp_path: Path) -> None:
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


def test_open_mouth_has_more_contrast_than_a_closed_one(build: Build, figures: FrameFigures) -> None:
    n = len(figures.mouth_contrast)
    assert figures.mouth_contrast[n // 2] > figures.mouth_contrast[0] + 0.02


def test_contact_sheet_stays_small(figures: FrameFigures) -> None:
    assert len(figures.sheet) == SHEET_FRAMES
    assert spread(500, SHEET_FRAMES)[0] == 0
    assert spread(500, SHEET_FRAMES)[-1] == 499
    assert spread(3, SHEET_FRAMES) == [0, 1, 2]


def test_mouth_region_follows_the_faceframe(build: Build) -> None:
    from morphspace.face.faceframe import FaceFrame

    region = mouth_region(100, 90, FaceFrame((30, 20), (50, 20), (40, 45)))
    y, x = np.nonzero(region)
    assert x.mean() == pytest.approx(40, abs=0.5)
    assert 45 < y.mean() < 70
    assert mouth_region(100, 90, None).sum() > 0


def test_variance_explained_rises_to_all(build: Build) -> None:
    shares = explained(build.model)
    assert (np.diff(shares) >= 0).all()
    assert 0 < shares[0] < shares[-1] <= 100
    rows = build.model.truncate(3)
    assert explained(rows)[-1] == pytest.approx(shares[2], abs=0.01)  # percent: truncation keeps the total


def test_head_path_undoes_a_known_movement() -> None:
    angle, scale, shift = np.radians(5), 1.1, np.array([3.0, -2.0])
    centre = (np.array(SIZE) - 1) / 2
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = np.column_stack([linear, centre + shift - linear @ centre])
    path = head_path(affine[None], SIZE)
    np.testing.assert_allclose(path.shift_px[0], shift, atol=1e-12)
    assert path.turn_deg[0] == pytest.approx(5)
    assert path.scale[0] == pytest.approx(1.1)


def test_fold_map_marks_what_folds(build: Build) -> None:
    morph = build.model.mean
    assert not _reddish(fold_chart(morph, build.model.mask)).any()
    folded = morph.displacement.copy()
    folded[40, 30, 0] += 5
    broken = replace(morph, displacement=folded)
    marked = _reddish(fold_chart(broken, build.model.mask))
    assert marked.sum() == 4 * (determinants(folded) <= 0).sum()  # each cell is drawn twice as large
    assert marked[70:90, 50:72].sum() == marked.sum()


def _reddish(picture: Image) -> np.ndarray:
    return picture[..., 0] > picture[..., 1] + 0.2


def test_confidence_map_is_tinted_where_the_flow_is_unsure(build: Build) -> None:
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


def test_the_flow_section_tells_confidence_folds_and_starts(clean: Case) -> None:
    build = clean.build
    n = len(clean.names)
    near = np.zeros(n, bool)
    near[[2, 5, 6]] = True
    page = report_page(replace(build, from_neighbour=near), clean.figures)
    words = " ".join(checked(page).words)
    assert f"3 frames of {n} kept it" in words
    assert f"{clean.names[0]}  0.80" in words  # the least sure, in the plot
    assert "Mean confidence" in words
    assert "Folds of the flow" in words
    provenance = {**build.model.provenance, "flow_start": "none"}
    plain = replace(build, model=replace(build.model, provenance=provenance))
    assert "no second start was asked for" in report_page(plain, clean.figures)


def test_a_flow_that_tells_no_confidence_gets_no_map_of_it(build: Build, figures: FrameFigures) -> None:
    assert (build.confidences == 1).all()  # as stock flows have it
    page = report_page(build, figures)
    assert "does not tell how sure it is" in page
    assert "Mean confidence" not in page


def test_shrinking_a_morph_shrinks_its_picture() -> None:
    y, x = np.mgrid[:300, : 2 * STRIP_WIDTH_PX].astype(np.float32)
    waves = (0.5 + 0.3 * np.sin(x / 15) * np.cos(y / 20)).astype(np.float32)
    field = np.stack([6 * np.sin(y / 40), 4 * np.cos(x / 50)], axis=-1).astype(np.float32)
    morph = Morph(field, np.repeat(waves[..., None], 3, axis=2), "mean")
    small = shrunk_morph(morph)
    assert small.texture.shape == (150, STRIP_WIDTH_PX, 3)
    whole = cv2.resize(morph.render(), (STRIP_WIDTH_PX, 150), interpolation=cv2.INTER_AREA)
    error = (small.render() - whole)[10:-10, 10:-10]
    assert np.abs(error).max() < 0.01  # colour; a field that is not scaled misses by 0.1
    assert shrunk_morph(small) is small


# advice


def test_clean_build_gets_no_advice(clean: Case) -> None:
    assert advice_for(clean) == ()
    page = report_page(clean.build, clean.figures)
    assert "Nothing to mend" in page


def test_advice_names_only_the_fault_at_hand(clean: Case) -> None:
    n = len(clean.names)
    wave = np.sin(np.arange(n))
    still = clean.build.registrations
    moved = still.copy()
    moved[:, 0, 2] = 0.06 * SIZE[0] * wave
    turned = still.copy()
    angle = np.radians(7 * wave)
    turned[:, :, :2] = np.moveaxis([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], 2, 0)
    centre = (np.array(SIZE) - 1) / 2
    turned[:, :, 2] = centre - turned[:, :, :2] @ centre
    nearer = still.copy()
    nearer[:, :, :2] *= (1 + 0.07 * wave)[:, None, None]
    nearer[:, :, 2] = centre - nearer[:, :, :2] @ centre
    lost = still.copy()
    lost[5, :, :2] *= 0.5
    opened = np.where(np.arange(n) % 2, 0.1, 0.0)
    opened[clean.build.choice.index] = 0
    one_bad = np.arange(n) == 9
    build, figures, model = clean.build, clean.figures, clean.build.model
    cases = {
        "build": Case(replace(build, warnings=("2 frames are identical to the reference",)), figures),
        "registration": Case(replace(build, registrations=lost), figures),
        "exposure": Case(build, replace(figures, exposure_stops=0.2 * wave)),
        "head_turned": Case(build, replace(figures, rigid_motion_px=np.where(one_bad, 5.0, 0.2))),
        "mouth_closed": Case(build, replace(figures, mouth_contrast=opened)),
        "folds": Case(build, replace(figures, fold_fractions=np.where(one_bad, 0.02, 0.0))),
        "confidence": Case(replace(build, confidences=np.where(one_bad, 0.4, 0.8)), figures),
        "psnr": Case(build, replace(figures, psnr_db=np.where(one_bad, 25.0, 42.0))),
        "mask": Case(replace(build, model=replace(model, mask=np.ones_like(model.mask))), figures),
        "rank": Case(
            replace(build, model=replace(model, provenance={"identity": "", "components_asked": 50})), figures
        ),
        "few_frames": Case(replace(build, model=_of_few_frames(build)), figures),
        "source_size": Case(build, figures, (2 * SIZE[0], 2 * SIZE[1])),
    }
    for rule, case in cases.items():
        assert rules(advice_for(case)) == {rule}, rule
    for registrations in (moved, turned, nearer):
        assert rules(advice_for(Case(replace(build, registrations=registrations), figures))) == {"head_moved"}


def test_small_deviations_stay_unmentioned(clean: Case) -> None:
    n = len(clean.names)
    wave = np.sin(np.arange(n))
    moved = clean.build.registrations.copy()
    moved[:, 0, 2] = 0.03 * SIZE[0] * wave
    figures = replace(
        clean.figures,
        exposure_stops=0.1 * wave,
        fold_fractions=np.full(n, 0.005),
        psnr_db=38 + wave,
        mouth_contrast=0.1 + 0.1 * np.cos(np.arange(n) - clean.build.choice.index - 1.5),
    )
    build = replace(clean.build, registrations=moved, confidences=np.full(n, 0.55))
    assert advice_for(Case(build, figures, SIZE)) == ()


def test_advice_tells_drift_from_flicker(clean: Case) -> None:
    n = len(clean.names)
    drift = replace(clean.figures, exposure_stops=np.linspace(0, 1, n))
    flicker = replace(clean.figures, exposure_stops=np.where(np.arange(n) % 2, 0.5, 0.0))
    assert "drifts" in advice_for(Case(clean.build, drift))[0].text
    assert "up and down" in advice_for(Case(clean.build, flicker))[0].text


def test_advice_proposes_slightly_open_frames(clean: Case) -> None:
    dark = np.full(len(clean.names), 0.1)
    dark[:12] = 0.0
    reference, fitting = clean.build.choice.index, 3
    dark[reference] = 0.0
    if reference == fitting:
        fitting = 4
    dark[fitting] = 0.03
    (advice,) = advice_for(Case(clean.build, replace(clean.figures, mouth_contrast=dark)))
    assert f"Frames to try: {clean.names[fitting]}." in advice.text


def test_many_poor_frames_blame_the_model(clean: Case) -> None:
    (advice,) = advice_for(Case(clean.build, replace(clean.figures, psnr_db=np.full(len(clean.names), 25.0))))
    assert "more components" in advice.text


def test_mask_without_texture_is_told(clean: Case) -> None:
    model = clean.build.model
    flat = replace(model.mean, texture=np.full_like(model.mean.texture, 0.5))
    tiny = np.zeros_like(model.mask)
    tiny[:4, :4] = 1
    for changed, word in ((replace(model, mean=flat), "texture"), (replace(model, mask=tiny), "closer")):
        (advice,) = advice_for(Case(replace(clean.build, model=changed), clean.figures))
        assert advice.rule == "mask"
        assert word in advice.text


def _of_few_frames(build: Build) -> object:
    training = build.model.training
    return replace(
        build.model,
        training=replace(training, values=training.values[:9], frame_names=training.frame_names[:9]),
    )


# the parts


def test_text_cannot_break_out_of_an_attribute() -> None:
    made = element("p", text("<b>"), title='"><script>')
    assert made == '<p title="&quot;&gt;&lt;script&gt;">&lt;b&gt;</p>'


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-3.2, 7.9), (119, 121), (1e-4, 3e-4), (99.5, 100.5)])
def test_ticks_are_round_and_cover(low: float, high: float) -> None:
    ticks = round_ticks(low, high, 5)
    assert ticks[0] <= low + 1e-9
    assert ticks[-1] >= high - 1e-9
    assert 3 <= len(ticks) <= 12
    step = ticks[1] - ticks[0]
    assert f"{step:.0e}"[0] in "125"


@pytest.mark.parametrize("values", [[120.0, 120.0, 120.0], [0.0], [5.0] * 400, [1e-9, -1e-9]])
def test_plots_of_still_values_have_finite_places(values: list[float]) -> None:
    drawn = line_plot(Plot("still", "frame", "px", 1.0), values, worst=[Mark(0, "a")], dot=Mark(0, "b"))
    numbers = [
        float(found) for found in re.findall(r"[-\d.]+(?=[ \"L])", drawn.split("<path", 1)[1]) if found != "-"
    ]
    assert np.isfinite(numbers).all()
    checked(drawn)


@pytest.mark.parametrize("values", [[0.0, 0.0], [0.1, 0.2], [3.0, 0.0]])
def test_an_axis_does_not_go_below_the_lowest_a_quantity_can_be(values: list[float]) -> None:
    plot = Plot("folds", "frame", "%", 1.0)
    ticks = [_ticks(line_plot(replace(plot, lowest=lowest), values)) for lowest in (0.0, -np.inf)]
    assert ticks[0][0] == 0
    assert ticks[0][-1] >= max(1.0, *values)
    assert (ticks[1][0] < 0) == (max(values) < 1)  # centred, where the values alone do not fill the range


def _ticks(drawn: str) -> list[float]:
    return sorted(float(found) for found in re.findall(r'class="tick" text-anchor="end">([-\d.]+)<', drawn))
