"""The PsychoPy loader against PsychoPy's convention for arrays, without PsychoPy.

A window of ours draws textures as PsychoPy's shader and corners do: a cycle of the texture fills the stimulus, its row
0 at the bottom, and a value v shows as (v + 1) / 2.
"""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from morphspace.errors import BadInput
from morphspace.io.images import read_image, write_image
from morphspace.io.video import read_frames
from morphspace.model.loadings import Loadings
from morphspace.steps import result_of
from morphspace.verbs import caricature
from morphspace.verbs.caricature import CaricatureRequest
from morphspace.verbs.encode import write_loadings

SCRIPT = Path(__file__).parents[2] / "examples" / "psychopy_demo.py"


@pytest.fixture(scope="module")
def demo():
    spec = importlib.util.spec_from_file_location("psychopy_demo", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["psychopy_demo"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["psychopy_demo"]


@pytest.fixture(scope="module")
def sets(model, tmp_path_factory):
    """A set of pictures and a set of one lossless video, of a drawn model."""
    folder = tmp_path_factory.mktemp("shown")
    model.save(folder / "a.morph")
    rows = Loadings(model.training.values[:3], model.training.frame_names[:3], model.model_id)
    write_loadings(folder / "t.csv", rows, model, folder / "a.morph", {})
    for name, video in (("pictures", None), ("video", ".mkv")):
        request = CaricatureRequest(
            folder / "a.morph",
            folder / name,
            folder / "t.csv",
            gains=(1.0, 1.5),
            video=video,
            frame_rate_hz=20.0,
        )
        result_of(caricature.run(request))
    return folder


class Window:
    """Draws as PsychoPy does, into `seen`: one picture (h, w, 3), 0 to 1, row 0 at the top, a flip."""

    def __init__(self):
        self.canvas, self.seen, self.made = None, [], 0

    def flip(self):
        self.seen.append(self.canvas)
        self.canvas = None


def grating(window, tex, mask, units, size, sf, phase):
    side = tex.shape[0]
    assert tex.dtype == np.float32 and tex.flags.c_contiguous and tex.shape == (side, side, 3)
    assert np.abs(tex).max() <= 1 and side & (side - 1) == 0
    assert (units, size, mask, phase) == ("pix", (side, side), None, 0) and sf * side == 1
    window.made += 1
    kept = tex.copy()

    def draw():
        window.canvas = (kept[::-1] + 1) / 2

    return SimpleNamespace(draw=draw)


VISUAL = SimpleNamespace(GratingStim=grating)


def middle(shown, height, width):
    top, left = (shown.shape[0] - height) // 2, (shown.shape[1] - width) // 2
    return shown[top : top + height, left : left + width]


def test_a_picture_is_seen_as_it_is_in_the_file_the_right_way_up(demo, sets):
    stimuli = demo.load_set(sets / "pictures")
    assert len(stimuli) == 6
    for stimulus in stimuli:
        window = Window()
        demo.play(window, demo.textures(VISUAL, window, stimulus), stimulus, 60.0, 0.1)
        file = read_image(sets / "pictures" / stimulus.row["file"])
        assert len(window.seen) == 7 and window.seen[-1] is None  # six refreshes, then the grey
        np.testing.assert_allclose(middle(window.seen[0], *file.shape[:2]), file, atol=1e-6)
        assert np.abs(middle(window.seen[0], *file.shape[:2])[::-1] - file).max() > 0.1  # it has an upside


def test_the_border_is_the_grey_of_the_background(demo):
    square = demo.texture(np.ones((5, 3, 3), np.float32))
    assert square.shape == (8, 8, 3) and square.sum() == 5 * 3 * 3
    assert demo.texture(np.ones((8, 8, 3), np.float32)).shape == (8, 8, 3)


def test_frames_are_float32_from_minus_one_to_one(demo, sets):
    for stimulus in demo.load_set(sets / "pictures") + demo.load_set(sets / "video"):
        assert stimulus.frames.dtype == np.float32 and stimulus.frames.flags.c_contiguous
        assert -1 <= stimulus.frames.min() < 0 < stimulus.frames.max() <= 1
    black_and_white = demo.psychopy_frame(np.array([[[0.0] * 3], [[1.0] * 3]], np.float32))
    np.testing.assert_array_equal(black_and_white[:, 0, 0], [1, -1])


def test_every_frame_of_a_motion_is_seen_in_order_for_its_time(demo, sets):
    stimulus = demo.load_set(sets / "video", {"gain": "1.5"})[0]
    frames = list(read_frames(sets / "video" / stimulus.row["file"]))
    window = Window()
    drawn = demo.textures(VISUAL, window, stimulus)
    assert window.made == len(frames) == 3  # all on the card before the first is drawn
    demo.play(window, drawn, stimulus, 60.0, 9.0)
    shown = [middle(picture, *frames[0].shape[:2]) for picture in window.seen[:-1]]
    assert len(shown) == 9  # 20 Hz on 60 Hz: three refreshes each
    for place, picture in enumerate(shown):
        np.testing.assert_allclose(picture, frames[place // 3], atol=1e-6)


@pytest.mark.parametrize(
    ("rate_hz", "refresh_hz"), [(25.0, 60.0), (30000 / 1001, 59.94), (24.0, 144.0), (60.0, 60.0)]
)
def test_no_frame_comes_early_and_none_a_refresh_late(demo, rate_hz, refresh_hz):
    stimulus = demo.Stimulus({}, np.zeros((200, 1, 1, 3), np.float32), rate_hz)
    flips = np.arange(int(200 / rate_hz * refresh_hz))
    seen = np.array([demo.frame_at(stimulus, flip / refresh_hz) for flip in flips])
    first = np.array([flips[seen == frame][0] / refresh_hz for frame in range(seen.max() + 1)])
    due = np.arange(len(first)) / rate_hz
    assert (first - due > -1e-6).all() and (first - due < 1 / refresh_hz).all()


def test_a_changed_file_is_refused(demo, sets, tmp_path):
    for path in (sets / "pictures").iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    name = demo.read_manifest(tmp_path)[0]["file"]
    write_image(tmp_path / name, read_image(tmp_path / name) * np.float32(0.9))
    with pytest.raises(BadInput, match=f"{name} was changed"):
        demo.load_set(tmp_path)


def test_columns_choose_and_bad_words_get_one_line(demo, sets, capsys):
    folder = str(sets / "pictures")
    assert demo.main([folder, "--check", "--select", "gain=1"]) == 0
    assert capsys.readouterr().out.startswith("3 stimuli, 3 frames")
    for words in ([folder, "--check", "--select", "mood=glad"], [folder, "--select", "gain=7"], [str(sets)]):
        assert demo.main(words) == 2
        captured = capsys.readouterr()
        assert captured.err.count("\n") == 1 and captured.out == ""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (",", ";", "line 1 has semicolons"),
        ("name,", "sep=,\nname,", "'sep=,'"),
        ("frame_rate_hz", "rate", "no column 'frame_rate_hz'"),
        (",20.0,", ",20. Jan,", "line 2: frame_rate_hz is '20. Jan': A spreadsheet made a date of it"),
    ],
)
def test_a_manifest_that_a_spreadsheet_saved_gets_one_line(demo, sets, tmp_path, capsys, old, new, said):
    text = (sets / "video" / "manifest.csv").read_text()
    assert old in text
    saved = text.replace(old, new).replace("\n", "\r\n")
    (tmp_path / "manifest.csv").write_bytes(saved.encode("utf-8-sig"))
    assert demo.main([str(tmp_path), "--check"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and said in error


def test_line_ends_and_empty_rows_of_a_spreadsheet_do_not_matter(demo, sets, tmp_path):
    text = (sets / "video" / "manifest.csv").read_text()
    saved = text.replace("\n", "\r\n") + "," * text.split("\n")[0].count(",") + "\r\n"
    (tmp_path / "manifest.csv").write_bytes(saved.encode("utf-8-sig"))
    assert demo.read_manifest(tmp_path) == demo.read_manifest(sets / "video")


def test_without_psychopy_it_says_so(demo, sets, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "psychopy", None)
    assert demo.main([str(sets / "video")]) == 2
    assert "install PsychoPy" in capsys.readouterr().err
