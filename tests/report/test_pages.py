"""Every page: words from outside are escaped, nothing is loaded, and the same values give the same bytes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import Markup

from morphspace.imitation import compare
from morphspace.report.avatar_page import AvatarResult, ExpressionRow, avatar_page
from morphspace.report.build_page import build_page
from morphspace.report.imitation_page import MeasuredImitation, imitation_page
from morphspace.report.mimic_page import HEADINGS, MimicryResult, mimic_page
from morphspace.report.page import markup
from morphspace.report.set_page import StimulusSet, set_page
from morphspace.steps import result_of
from morphspace.stimuli.image_statistics import FIGURES, SPACES

ALONE = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
WITH_VIDEO = "default-src 'none'; img-src data:; media-src 'self' file:; style-src 'unsafe-inline'"
SHOWN = "<script>'\"&{{p}}{%r%}"  # short, so that no plot cuts it
HOSTILE = SHOWN + "\x00\udcff"
FRAMES = 12


def picture():
    return np.full((20, 16, 3), 0.5, np.float32)


def page_of_a_build(words, build, figures, model):
    names = tuple(f"{words}{i}" for i in range(len(build.model.training.frame_names)))
    provenance = {
        "identity": words,
        "consent": words,
        words: {words: [words, {words: words}]},
        "many": [words] * 20,
        "crop": {"right": [1.5, None, True], "digest": "ab" * 32},
    }
    training = replace(build.model.training, frame_names=names)
    build = replace(
        build,
        model=replace(build.model, provenance=provenance, training=training, flow=words, registration=words),
        choice=replace(build.choice, name=words, reason=words),
        warnings=(words,),
    )
    figures = replace(
        figures,
        fold_fractions=np.full(len(names), 0.5),
        psnr_db=np.linspace(9, 12, len(names)),
        exposure_stops=np.arange(float(len(names))),
    )
    return build_page(build, figures)


def page_of_a_blend(words, build, figures, model):
    names = (f"{words}a", f"{words}b")
    count = len(model.training.frame_names)
    row = ExpressionRow(1, [picture(), picture()], picture(), picture())
    used = np.tile([0.6, 0.4], (count, 1))
    used[1], used[2] = [1, 0], [0.8, 0.2]
    made = AvatarResult(
        model=replace(model, provenance={"identity": words}),
        identities=names,
        asked=np.array([0.6, 0.4]),
        sources=[0, 1] * (count // 2) + [0] * (count % 2),
        frames=[f"{words}{index}" for index in range(count)],
        used=used,
        plausibility=np.full((count, 2), 0.2),
        rows=[row],
        sharpness={"sources": np.array([2e-3, 1e-3]), "blend": 1e-3, "pixel average": 5e-4},
        sharpen=0.7,
        surround=names[0],
        distances=None,
        notes=(words,),
        settings={words: words},
    )
    return avatar_page(made)


def page_of_a_mimicry(words, build, figures, model):
    names = [f"{words}{index}" for index in range(FRAMES)]
    columns = {name: [0.5] * FRAMES for name in HEADINGS}
    columns |= {"frame": names, "flags": [words, *[""] * (FRAMES - 1)]}
    made = MimicryResult(
        names=(words, words, f"{words}driver"),
        pairs=[(name, picture(), picture()) for name in names[:2]],
        loadings_sd=np.random.default_rng(0).normal(size=(FRAMES, 3)),
        max_sd=3,
        columns=columns,
        notes=(words,),
        video=f"{words}.mp4",
        settings={words: words},
    )
    return mimic_page(made)


def page_of_an_imitation(words, build, figures, model):
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, FRAMES, 2))
    made = MeasuredImitation(
        comparison=result_of(compare(a, b, np.ones(2), permutations=9, seed=0)),
        stimulus_sd=a,
        imitation_sd=b,
        rate_hz=25.0,
        names=(words, words, words),
        pairs=[(words, picture(), picture())],
        notes=(words,),
        still=(),
        read_in=words,
        video=f"{words}.mp4",
        panels=(words, words),
        settings={words: words},
        rows=(f"{words}1", f"{words}2", words),
        reasons=(words, "", words),
    )
    return imitation_page(made)


def page_of_a_set(words, build, figures, model):
    values = {f"{space}_{figure}": 0.3 for space in SPACES for figure in FIGURES}
    rows = [
        {
            "name": f"{words}{place}",
            "identity": words,
            "frames": 1,
            "clipped_percent": 1.0,
            "folded_percent": 1.0,
            "beyond": words,
            "outlier_in": f"linear_luminance {words}",
            "largest_sd": 2.0,
            "kind": words,
            "gain": 1.5,
            **values,
        }
        for place in range(3)
    ]
    thumbnails = {place: picture() for place in range(3)}
    return set_page(StimulusSet(words, rows, thumbnails, (words,), {words: words}, ("kind", "gain")))


PAGES = {
    page_of_a_build: ALONE,
    page_of_a_blend: ALONE,
    page_of_a_mimicry: WITH_VIDEO,
    page_of_an_imitation: WITH_VIDEO,
    page_of_a_set: ALONE,
}


@pytest.fixture(params=PAGES, ids=lambda page: page.__name__)
def page_of(request, build, figures, model):
    """Return the page that says so and so, and its policy."""
    return lambda words: (request.param(words, build, figures, model), PAGES[request.param])


def test_words_from_outside_are_escaped_on_every_page(page_of, checked):
    page, _ = page_of(HOSTILE)
    read = checked(page)
    plain = checked(page_of("Anna")[0])
    assert "script" not in read.seen and read.seen == plain.seen
    assert "\x00" not in page
    page.encode("utf-8")  # broken UTF-8 in a file's name does not keep the page from being written
    shown = "".join(read.words)
    assert shown.count(SHOWN) == "".join(plain.words).count("Anna") > 5


def test_every_page_has_its_policy_and_loads_nothing_else(page_of, checked):
    page, policy = page_of("Anna")
    assert f'<meta http-equiv="Content-Security-Policy" content="{policy}">' in page
    read = checked(page)
    local = [reference for reference in read.references if not reference.startswith(("data:image/", "#"))]
    assert local == (["Anna.mp4"] if "media-src" in policy else [])
    assert all(reference[1:] in read.ids for reference in read.references if reference.startswith("#"))
    assert len(set(read.ids)) == len(read.ids) and read.images_without_words == 0
    assert not {"script", "link", "iframe", "object", "base", "form"} & set(read.seen)
    assert not re.search(r"https?:|url\(|@import", page)


def test_the_same_values_give_the_same_page(page_of):
    assert page_of("Anna") == page_of("Anna")


def test_no_page_shows_an_undefined_number_as_nan(page_of, checked):
    assert not re.search(r"\b(nan|inf|None)\b", " ".join(checked(page_of("Anna")[0]).words))


def test_markup_escapes_what_is_filled_in():
    made = markup('<p title="{title}">{words}</p>', words="<b>", title='"><script>')
    assert made == '<p title="&#34;&gt;&lt;script&gt;">&lt;b&gt;</p>'
    assert markup("<p>{inner}</p>", inner=Markup("<b>1</b>")) == "<p><b>1</b></p>"
