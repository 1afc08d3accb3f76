"""The page of the demo: each model with its pictures, and names escaped."""

from html.parser import HTMLParser

from morphspace.report.demo_page import SWEPT, write_demo_page

FIGURES = {"frames": 30, "components": 2, "variance_explained": 0.987, "psnr_db_median": 35.25}


def test_every_model_is_shown_with_its_pictures_and_its_name_is_escaped(tmp_path):
    write_demo_page(tmp_path / "index.html", {"anna": FIGURES, "<b>": {**FIGURES, "components": SWEPT + 9}})
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    shown = Shown()
    shown.feed(page)
    strips = ["frames", "reconstructed", "caricature", "random"]
    for name, swept in (("anna", 2), ("<b>", SWEPT)):
        pictures = {*strips, *(f"pc{place}" for place in range(1, swept + 1))}
        assert {file for folder, file in shown.files if folder == name} == {
            *(f"{one}.png" for one in pictures),
            "veridical.mp4",
            "caricature.mp4",
        }
    assert "<b>" not in page and "&lt;b&gt;" in page
    assert "98.7 %" in page or "99 %" in page
    assert "35.2 dB" in page


class Shown(HTMLParser):
    """Collects the folder and the name of each picture and video."""

    def __init__(self):
        super().__init__()
        self.files = []

    def handle_starttag(self, tag, attrs):
        if tag in ("img", "video"):
            self.files.append(tuple(dict(attrs)["src"].rsplit("/", 1)))
