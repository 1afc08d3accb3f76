"""The report as one page: everything about a build that a reader of its stimuli may ask for, in one file.

The page needs no script, no network and no other file. The same build gives the same bytes.
"""

from __future__ import annotations

from pathlib import Path

from morphspace.model.passes import Build
from morphspace.report import flow_section, sections
from morphspace.report.advice import Case, advice_for
from morphspace.report.figures import FrameFigures
from morphspace.report.markup import Html, element, joined, text
from morphspace.report.provenance import settings_section
from morphspace.report.style import STYLE
from morphspace.storage import write_text

# The browser itself is told that the page may load nothing and run nothing.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
LINKS = (
    ("faces", "Reference and mean"),
    ("sheet", "Contact sheet"),
    ("components", "Components"),
    ("variance", "Variance"),
    ("frames", "Reconstruction"),
    ("flow", "Flow"),
    ("folds", "Folds"),
    ("movement", "Movement and light"),
    ("weight", "Warp weight"),
    ("settings", "Settings"),
)


def report_page(build: Build, figures: FrameFigures, *, source_size: tuple[int, int] | None = None) -> str:
    """Give the report of a build as HTML.

    Parameters: build, with its work folder still in place; figures from `measure_frames`; source_size (w, h) px of what
    the frames were made from, after cropping, where it is known. Ours.
    """
    model = build.model
    title = f"{model.identity}: build report"
    links = [element("a", text(words), href=f"#{name}") for name, words in LINKS]
    parts = [
        element("h1", text(model.identity)),
        element("p", text(f"Build report of morph model {model.model_id}"), class_="kicker"),
        sections.key_figures(build, figures),
        element("nav", *links, aria_label="Sections"),
        sections.advice_box(advice_for(Case(build, figures, source_size))),
        sections.faces_section(build),
        sections.sheet_section(build, figures),
        sections.components_section(model),
        sections.variance_section(model),
        sections.reconstruction_section(build, figures),
        flow_section.flow_section(build),
        flow_section.folds_section(build, figures),
        sections.movement_section(build, figures),
        sections.trials_section(build),
        settings_section(build),
        element("footer", text("Written by morphspace. This page is complete in itself: it loads nothing.")),
    ]
    head = [
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", text(title)),
        element("style", Html(STYLE)),
    ]
    body = element("body", element("main", joined(parts)))
    page = element("html", Html("\n"), element("head", joined(head)), Html("\n"), body, lang="en")
    return f"<!DOCTYPE html>\n{page}\n"


def write_report(
    path: Path, build: Build, figures: FrameFigures, *, source_size: tuple[int, int] | None = None
) -> None:
    """Write the report to `path`, whole or not at all; parameters as `report_page`. Raises `UnwritableFile`."""
    write_text(Path(path), report_page(build, figures, source_size=source_size))
