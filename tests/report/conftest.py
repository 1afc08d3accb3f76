"""Shared fixtures of the pages' tests: a build of a drawn actor, its page, and a reader that follows every tag."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from morphspace.arrays import Image
from morphspace.model.passes import Build, BuildSettings, build_steps
from morphspace.report.advice.build import Case
from morphspace.report.build_page import build_page
from morphspace.report.frames import FrameFigures, measure_frames
from morphspace.steps import result_of
from morphspace.storage import digest_of_array
from morphspace.synthetic import Expression, Identity, drawn_actor

SIZE = (64, 80)
VOID = {"img", "meta", "br"}


class Frames:
    """Frames held in memory, as a source."""

    def __init__(self, images: list[Image], names: list[str] | None = None) -> None:
        self.held = images
        self.names = tuple(names or [f"frame_{i:04d}.png" for i in range(len(images))])
        self.digests = tuple(digest_of_array(image) for image in images)

    def images(self, indices: list[int]) -> Iterator[Image]:
        return (self.held[index] for index in indices)


def _talking(count: int) -> list[Image]:
    """An actor who opens the mouth and raises the brows."""
    actor = drawn_actor(Identity.random(np.random.default_rng(4)), SIZE)
    phase = np.linspace(0, 2 * np.pi, count, endpoint=False)
    amounts = [(0.5 - 0.5 * np.cos(p), 0.5 - 0.5 * np.cos(2 * p + 0.5)) for p in phase]
    return [
        actor.draw(Expression(jaw_open=a, brow_inner_raise=b, brow_outer_raise=b)).image for a, b in amounts
    ]


def _built(images: list[Image], folder: Path, **changes: object) -> Build:
    provenance = {"identity": "A. Actor", "consent": "drawn", "sources": [{"sha256": "ab" * 32}]}
    settings = replace(BuildSettings(components=8, flow="dis"), **changes)  # type: ignore[arg-type]
    return result_of(build_steps(Frames(images), settings, folder, provenance))


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return _built(_talking(26), tmp_path_factory.mktemp("work"))


@pytest.fixture(scope="session")
def figures(build: Build) -> FrameFigures:
    return result_of(measure_frames(build))


@pytest.fixture(scope="session")
def page(build: Build, figures: FrameFigures) -> str:
    return build_page(build, figures)


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


def _checked(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    checker.close()
    assert checker.open == []
    return checker


@pytest.fixture(scope="session")
def checked() -> Callable[[str], Checker]:
    """Follow the tags of a page; fails where they are not balanced."""
    return _checked


@pytest.fixture(scope="session")
def built() -> Callable[..., Build]:
    """Build a model of frames."""
    return _built


@pytest.fixture(scope="session")
def talking() -> Callable[[int], list[Image]]:
    """Draw so many frames of an actor who opens the mouth and raises the brows."""
    return _talking
