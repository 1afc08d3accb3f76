"""The page of a build: it holds together by itself and shows every part."""

import re
from dataclasses import replace

import numpy as np

from morphspace.report.advice.build import Case, advice_for
from morphspace.report.build_page import build_page, write_build_page
from morphspace.report.components import explained
from morphspace.report.frames import measure_frames
from morphspace.steps import result_of


def rules(found):
    return {advice.rule for advice in found}


def test_page_is_well_formed(page, checked):
    checker = checked(page)
    assert page.startswith("<!DOCTYPE html>\n<html lang=")
    assert {"h1", "h2", "table", "svg", "figure"} <= set(checker.seen)
    assert len(set(checker.ids)) == len(checker.ids)
    assert checker.images_without_words == 0


def test_page_is_self_contained(page, checked):
    checker = checked(page)
    for reference in checker.references:
        assert reference.startswith(("data:image/jpeg;base64,", "data:image/png;base64,", "#"))
        if reference.startswith("#"):
            assert reference[1:] in checker.ids
    assert not {"script", "link", "iframe", "object", "base"} & set(checker.seen)
    assert not re.search(r"https?:|url\(|@import", page)


def test_page_shows_every_part(page, build, checked):
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


def test_same_build_gives_the_same_bytes(page, build, tmp_path):
    again = result_of(measure_frames(build))
    write_build_page(tmp_path / "report.html", build, again)
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


def test_constant_clip_gives_a_page(tmp_path, checked, built, talking):
    build = built([talking(1)[0]] * 3, tmp_path)
    assert build.model.rank == 0
    figures = result_of(measure_frames(build))
    checked(build_page(build, figures))
    assert "build" in rules(advice_for(Case(build, figures)))
    assert explained(build.model).shape == (0,)


def test_three_frames_give_a_page(tmp_path, checked, built, talking):
    build = built(talking(3), tmp_path)
    figures = result_of(measure_frames(build))
    page = build_page(build, figures)
    checked(page)
    assert rules(advice_for(Case(build, figures))) >= {"few_frames", "rank"}
    assert not re.search(r"\b(nan|inf)\b", re.sub(r"base64,[A-Za-z0-9+/=]*", "", page))


def test_the_flow_section_tells_confidence_folds_and_starts(clean, checked):
    build = clean.build
    n = len(clean.names)
    near = np.zeros(n, bool)
    near[[2, 5, 6]] = True
    page = build_page(replace(build, from_neighbour=near), clean.figures)
    words = " ".join(checked(page).words)
    assert f"3 frames of {n} kept that flow" in words
    assert f"{clean.names[0]}  0.80" in words  # the least sure, in the plot
    assert "Mean confidence" in words
    assert "Folds of the flow" in words
    provenance = {**build.model.provenance, "flow_start": "none"}
    plain = replace(build, model=replace(build.model, provenance=provenance))
    assert "no second start was asked for" in build_page(plain, clean.figures)


def test_a_flow_that_tells_no_confidence_gets_no_map_of_it(build, figures):
    assert (build.confidences == 1).all()  # as stock flows have it
    page = build_page(build, figures)
    assert "reports no confidence" in page
    assert "Mean confidence" not in page
