"""Laws of clips: the same frames, however they are named, in the order a person expects."""

import hashlib
import json
import os
import random
import subprocess
import sys
from fractions import Fraction

import av
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image as Pillow

from morphspace.errors import BadInput, SizeMismatch, UnreadableFile
from morphspace.io.clips import natural_key, open_clip
from morphspace.io.images import read_image, write_image
from morphspace.io.sidecars import read_faceframe
from morphspace.io.video import write_video
from morphspace.requests import ClipOptions

RNG = np.random.default_rng(8)
FRAMES = [(RNG.integers(0, 256, (12, 16, 3)) / 255).astype(np.float32) for _ in range(12)]
NAMES = tuple(f"frame_{number}" for number in range(12))  # frame_10 must follow frame_9


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "smile"
    for name, frame in zip(NAMES, FRAMES, strict=True):
        write_image(folder / f"{name}.png", frame)
    return folder


def test_names_are_sorted_as_people_do():
    expected = ["A1", "a2", "a2b", "a10", "a10b1", "a10b02", "a10b2.5", "b", "b1"]
    shuffled = random.Random(1).sample(expected, len(expected))
    assert sorted(shuffled, key=natural_key) == expected
    assert sorted(["1", "x", "01", "x1", ""], key=natural_key) == ["", "01", "1", "x", "x1"]


def test_folder_glob_list_and_video_are_the_same_frames(folder):
    write_video(folder / "take.mkv", FRAMES, encoding="lossless")
    files = [folder / f"{name}.png" for name in NAMES]
    random.Random(2).shuffle(files)
    ways = [[folder], [str(folder)], [f"{folder}/*.png"], [f"{folder}/frame_*"], files, [folder / "take.mkv"]]
    for sources in ways:
        clip = open_clip(sources)
        assert clip.size == (16, 12)
        assert len(clip) == 12
        for image, frame in zip(clip.images(), FRAMES, strict=True):
            assert_array_equal(image, frame)
        assert_array_equal(clip.load(10), FRAMES[10])
        assert_array_equal(clip.load(-1), FRAMES[11])
        for image, index in zip(clip.images([7, 2, 2]), [7, 2, 2], strict=True):
            assert_array_equal(image, FRAMES[index])
        if sources != ways[-1]:
            assert (clip.name, clip.frame_names) == ("smile", NAMES)
    assert (clip.name, clip.frame_names[10]) == ("take", "take_000010")
    assert clip.sidecar.frame_rate_hz == 25.0


def test_hidden_files_and_other_kinds_are_passed_over(folder):
    (folder / ".frame_3.png").write_text("")
    (folder / "notes.txt").write_text("")
    (folder / "deeper.png").mkdir()
    assert open_clip([folder]).frame_names == NAMES
    assert open_clip([f"{folder}/*"]).frame_names == NAMES


def test_opening_a_folder_decodes_nothing_and_loads_no_video_library(folder):
    script = (
        "import sys; from morphspace.io import clips, images; images._read_stored = None;"
        "clip = clips.open_clip([sys.argv[1]]); print(len(clip), 'av' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["12", "False"], done.stderr


def test_frames_may_lie_in_a_folder_called_frames(folder):
    (folder.parent / "anna").mkdir()
    folder.rename(folder.parent / "anna" / "frames")
    sidecar = {"identity": "anna", "frame_rate_hz": 50, "camera": 2}
    (folder.parent / "anna" / "clip.json").write_text(json.dumps(sidecar))
    anna = folder.parent / "anna"
    for sources in (
        [anna],
        [anna / "frames"],
        [f"{anna}/frames/*.png"],
        [anna / "frames" / f"{n}.png" for n in NAMES],
    ):
        clip = open_clip(sources)
        assert (clip.name, clip.frame_names) == ("anna", NAMES)
        assert (clip.sidecar.identity, clip.sidecar.frame_rate_hz, clip.sidecar.extra) == (
            "anna",
            50.0,
            {"camera": 2},
        )
    (anna / "frames" / "clip.json").write_text('{"identity": "nearer"}')
    assert open_clip([anna]).sidecar.identity == "nearer"


def test_the_faceframe_of_a_sidecar_is_read(folder):
    faceframe = {"frame": "frame_3", "right_eye": [4, 4.5], "left_eye": [10, 4], "philtrum": [7, 9]}
    (folder / "clip.json").write_text(json.dumps({"faceframe": faceframe}))
    read = open_clip([folder]).sidecar.faceframe
    assert read.image == "frame_3"
    assert_array_equal(read.points, [[4, 4.5], [10, 4], [7, 9]])


def test_a_sidecar_of_a_video_lies_beside_it(tmp_path):
    write_video(tmp_path / "take.mkv", FRAMES, encoding="lossless")
    (tmp_path / "take.clip.json").write_text('{"identity": "anna", "frame_rate_hz": 100}')
    sidecar = open_clip([tmp_path / "take.mkv"]).sidecar
    assert (sidecar.identity, sidecar.frame_rate_hz) == ("anna", 100.0)


def test_a_broken_sidecar_is_named(folder):
    (folder / "clip.json").write_text("{")
    with pytest.raises(UnreadableFile, match=r"clip\.json is not JSON"):
        open_clip([folder])
    (folder / "clip.json").write_text('{"frame_rate_hz": true}')
    with pytest.raises(
        BadInput, match=r"clip\.json: frame_rate_hz is true; expected a number from 0.01 to 10000"
    ):
        open_clip([folder])


def test_names_are_unique_whatever_the_folders(tmp_path):
    for name in (
        "neutral/001.png",
        "smiling/001.png",
        "smiling/002.png",
        "a/x/1.png",
        "b/x/1.png",
        "c/1.png",
        "c/1.tif",
    ):
        write_image(tmp_path / name, FRAMES[0])
    clip = open_clip(
        [tmp_path / "smiling" / "001.png", tmp_path / "neutral" / "001.png", tmp_path / "smiling" / "002.png"]
    )
    assert clip.frame_names == ("neutral_001", "smiling_001", "smiling_002")
    assert clip.name == tmp_path.name
    assert open_clip([f"{tmp_path}/?/x/1.png"]).frame_names == ("a_x_1", "b_x_1")
    assert open_clip([tmp_path / "c"]).frame_names == ("1.png", "1.tif")


def test_a_path_with_brackets_is_itself(tmp_path):
    write_image(tmp_path / "take[1]" / "a.png", FRAMES[0])
    assert open_clip([tmp_path / "take[1]"]).name == "take[1]"


def test_digests_are_of_bytes_and_tell_frames_apart(folder):
    clip = open_clip([folder])
    assert clip.digests()[3] == hashlib.sha256((folder / "frame_3.png").read_bytes()).hexdigest()
    write_video(folder / "take.mkv", [FRAMES[0]] * 3, encoding="lossless")
    video = open_clip([folder / "take.mkv"])
    assert len({*clip.digests(), *video.digests()}) == 15
    known = video.digests()
    (folder / "take.mkv").rename(folder / "other.mkv")
    assert open_clip([folder / "other.mkv"]).digests() == known


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_a_subset_is_the_same_frames(folder, kind):
    if kind == "video":
        write_video(folder / "take.mkv", FRAMES, encoding="lossless")
    clip = open_clip([folder if kind == "folder" else folder / "take.mkv"])
    some = clip.subset([9, 2, -1])
    assert some.frame_names == tuple(clip.frame_names[index] for index in (9, 2, 11))
    assert some.digests() == tuple(clip.digests()[index] for index in (9, 2, 11))
    for image, index in zip(some.images(), (9, 2, 11), strict=True):
        assert_array_equal(image, FRAMES[index])
    assert_array_equal(some.subset([1]).load(0), FRAMES[2])
    for indices in ([], [1, 1], [12], [-13]):
        with pytest.raises(BadInput, match=f"clip {clip.name}"):
            clip.subset(indices)
    with pytest.raises(BadInput, match="the frame is 12; expected 0 to 11"):
        clip.load(12)


def test_sizes_that_differ_are_listed(folder):
    write_image(folder / "large.png", np.zeros((20, 30, 3), np.float32))
    with pytest.raises(SizeMismatch) as caught:
        open_clip([folder])
    message = str(caught.value)
    assert "16 x 12: 12, such as" in message
    assert "30 x 20: 1, such as" in message
    assert "large.png" in message
    assert "\n" not in message


def test_what_is_no_clip_is_named(folder):
    (folder.parent / "empty").mkdir()
    (folder.parent / "notes.txt").write_text("")
    video = folder.parent / "film" / "take.mkv"
    write_video(video, FRAMES, encoding="lossless")
    for sources, words in (
        ([], "no clip is given"),
        ([folder.parent / "gone"], "gone does not exist; expected a folder of images"),
        ([folder.parent / "gone*"], r"no image or video matches .*gone\* \(0 other"),
        ([folder.parent / "empty"], "empty holds no images"),
        ([folder.parent / "film"], r"film holds no images .* 1 video\(s\): enter the name"),
        ([folder.parent / "notes.txt"], "notes.txt is neither an image nor a video"),
        ([folder, folder.parent / "empty"], "one folder or several files"),
        ([folder / "frame_1.png", video], "one video or several images"),
        ([folder / "frame_1.png"] * 2, "frame_1.png is repeated"),
    ):
        with pytest.raises(BadInput, match=words):
            open_clip(sources)


def test_pictures_that_are_not_read_are_counted_by_type(folder):
    for name in ("a.HEIC", "b.HEIC", "c.dng", ".hidden.heic"):
        (folder / name).write_bytes(b"\0\0\0\x18ftypheic")
    (folder / "notes.txt").write_text("")
    wanted = (
        "2 .HEIC pictures were passed over, which cannot be read: convert to PNG or JPEG",
        "1 .dng picture was passed over, which cannot be read: convert to PNG or JPEG",
    )
    for sources in ([folder], [f"{folder}/*"]):
        clip = open_clip(sources)
        assert (clip.frame_names, clip.notes) == (NAMES, wanted)
        assert clip.subset([1, 3]).notes == wanted
    assert open_clip([f"{folder}/*.png"]).notes == ()
    for path in folder.glob("*.png"):
        path.unlink()
    for sources in ([folder], [f"{folder}/*"]):
        with pytest.raises(BadInput, match=r"Convert the 2 \.HEIC, 1 \.dng pictures to PNG or JPEG"):
            open_clip(sources)


def test_names_are_composed_whatever_the_system_wrote(folder):
    for number, name in enumerate(("a\u0301", "z\u0308")):
        (folder / f"frame_{number}.png").rename(folder / f"{name}.png")
    clip = open_clip([folder])
    assert clip.frame_names == (*NAMES[2:], "z\u0308", "\u00e1")
    both = folder.parent / "both"
    both.mkdir()
    for number, name in enumerate(("\u00e1", "a\u0301")):
        write_image(both / f"{name}.png", FRAMES[number])
    assert len(set(open_clip([both]).frame_names)) == len(list(both.iterdir()))


@pytest.mark.parametrize("name", ["a,b", "[1]", "a;b", 'say "a"', "a|b", "<i>", "a'b", "50%", "#1"])
def test_commas_brackets_and_marks_in_names_are_kept(folder, name):
    (folder / "frame_3.png").rename(folder / f"{name}.png")
    clip = open_clip([folder])
    assert sorted(clip.frame_names) == sorted({*NAMES, name} - {"frame_3"})
    assert_array_equal(open_clip([folder / f"{name}.png"]).load(0), FRAMES[3])


@pytest.mark.parametrize("name", [b"M\xfcller.png", b"two\nlines.png", b"\x1b[2J.png", b"=1+1.png"])
def test_a_frame_that_cannot_be_named_is_refused_in_one_line(folder, name):
    os.rename(folder / "frame_3.png", os.path.join(os.fsencode(folder), name))  # noqa: PTH104, PTH118
    for sources in ([folder], [f"{folder}/*"]):
        with pytest.raises(BadInput, match=r"the file name .* Rename it") as caught:
            open_clip(sources)
        assert str(caught.value).isprintable()


def test_links_of_git_annex_are_frames_though_equal_frames_have_one_content(folder):
    store = folder.parent / ".git" / "annex" / "objects"
    write_image(store / "SHA256E-s1--0.png", FRAMES[0])
    for name in ("frame_0", "frame_1"):
        (folder / f"{name}.png").unlink()
        (folder / f"{name}.png").symlink_to(store / "SHA256E-s1--0.png")
    clip = open_clip([folder])
    assert clip.frame_names == NAMES
    assert_array_equal(clip.load(1), FRAMES[0])
    (store / "SHA256E-s1--0.png").unlink()
    for sources in ([folder], [folder / "frame_0.png"]):
        with pytest.raises(UnreadableFile, match=r"frame_0\.png is a link of git-annex"):
            open_clip(sources)


def test_an_animated_png_is_a_still_with_a_note_and_a_clip_by_its_name(folder):
    codes = [np.rint(frame * 255).astype(np.uint8) for frame in FRAMES]
    first, *rest = map(Pillow.fromarray, codes)
    first.save(folder / "frame_0.png", save_all=True, append_images=rest, duration=40)
    clip = open_clip([folder])
    assert clip.frame_names == NAMES
    assert [note[:40] for note in clip.notes] == ["1 of 12 pictures are animations, such as"]
    (folder / "frame_0.png").rename(folder.parent / "take.apng")
    clip = open_clip([folder.parent / "take.apng"])
    assert len(clip) == 12
    for image, frame in zip(clip.images(), FRAMES, strict=True):
        assert_array_equal(image, frame)


def test_one_unreadable_frame_is_named_on_opening(folder):
    (folder / "frame_5.png").write_bytes(b"")
    with pytest.raises(UnreadableFile, match=r"frame_5\.png is empty \(0 bytes\)"):
        open_clip([folder])


def test_one_truncated_frame_is_named_on_reading(folder):
    content = (folder / "frame_5.png").read_bytes()
    (folder / "frame_5.png").write_bytes(content[:-20])
    clip = open_clip([folder])
    frames = clip.images()
    for index in range(5):
        assert_array_equal(next(frames), read_image(folder / f"frame_{index}.png"))
    with pytest.raises(UnreadableFile, match=r"frame_5\.png is cut short"):
        next(frames)


def uneven(path, times_ms, codec="libx264", pixels="yuv420p", rate=25, options=None):
    """Write a video whose frames have these times, ms."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=options or {})
        stream.pix_fmt, stream.height, stream.width = pixels, 64, 64
        stream.codec_context.time_base = Fraction(1, 1000)
        for index, time_ms in enumerate(times_ms):
            picture = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 10 * index, np.uint8), format="rgb24")
            picture.pts, picture.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


TIMES_MS = (0, 40, 80, 120, 200, 240, 310, 350)


def test_a_clip_has_the_times_of_its_frames_which_a_sidecar_stretches_and_a_selection_drops(tmp_path):
    clip = open_clip([uneven(tmp_path / "take.mp4", TIMES_MS)])
    assert clip.sidecar.frame_rate_hz == pytest.approx(7 / 0.35)  # no header holds: the mean
    assert clip.times_s == pytest.approx(np.array(TIMES_MS) / 1000)
    assert clip.subset(range(8)).times_s == clip.times_s
    assert clip.subset([0, 1]).times_s is clip.subset(range(7, -1, -1)).times_s is None
    (tmp_path / "take.clip.json").write_text('{"frame_rate_hz": 1000}')
    fast = open_clip([tmp_path / "take.mp4"])  # a high-speed recording that plays slowly
    assert fast.sidecar.frame_rate_hz == 1000
    assert fast.times_s == pytest.approx(np.array(TIMES_MS) / 1000 * 20 / 1000)


def test_pictures_have_no_times(folder):
    assert open_clip([folder]).times_s is None


def test_a_rate_that_cannot_be_is_refused_and_a_sidecar_gives_the_true_one(tmp_path):
    path = tmp_path / "take.mkv"  # whole milliseconds do not rise here, so that the header alone counts
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=20_000)
        stream.pix_fmt, stream.height, stream.width = "bgr0", 64, 64
        for index in range(8):
            picture = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 20 * index, np.uint8), format="rgb24")
            picture.pts, picture.time_base = index, Fraction(1, 20_000)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    with pytest.raises(
        BadInput,
        match=r"is 20000 Hz; expected 0\.01 to 10000\. Give .*--frame-rate, or .* in take\.clip\.json",
    ):
        open_clip([path])
    assert open_clip([path], ClipOptions(frame_rate_hz=30)).sidecar.frame_rate_hz == 30
    (tmp_path / "take.clip.json").write_text('{"frame_rate_hz": 25}')
    assert open_clip([path]).sidecar.frame_rate_hz == 25


def test_an_interlaced_video_is_refused_unless_its_fields_are_to_be_made_whole(tmp_path):
    options = {"flags": "+ildct+ilme", "x264-params": "bff=1"}
    path = uneven(tmp_path / "take.mp4", range(0, 320, 40), options=options)
    with pytest.raises(BadInput, match=r"is interlaced \(8 of 8 frames\); .*--deinterlace") as refused:
        open_clip([path])
    assert '"deinterlace": true into take.clip.json' in str(refused.value)
    asked = open_clip([path], ClipOptions(deinterlace=True))
    assert asked.is_deinterlaced and len(list(asked.images())) == 8
    assert "deinterlaced with FFmpeg's bwdif" in asked.notes[0]
    (tmp_path / "take.clip.json").write_text('{"deinterlace": true}')
    told = open_clip([path])
    assert told.digests() == asked.digests()
    assert (
        open_clip([uneven(tmp_path / "b.mp4", TIMES_MS)], ClipOptions(deinterlace=True)).is_deinterlaced
        is False
    )


def test_names_in_a_sidecar_are_compared_composed(folder):
    document = {"identity": "Zoe\u0308", "faceframe": {"frame": "frame_1e\u0301", **POINTS}}
    (folder / "clip.json").write_text(json.dumps(document, ensure_ascii=False), encoding="utf-8")
    write_image(folder / "frame_1e\u0301.png", FRAMES[0])
    clip = open_clip([folder])
    assert clip.sidecar.identity == "Zo\u00eb"
    assert clip.sidecar.faceframe.image == "frame_1\u00e9" in clip.frame_names
    (folder / "a.json").write_text(json.dumps({**FACEFRAME, "image": "frame_1e\u0301"}), encoding="utf-8")
    assert read_faceframe(folder / "a.json").image == "frame_1\u00e9"


POINTS = {"right_eye": [4, 4], "left_eye": [10, 4], "philtrum": [7, 9]}
FACEFRAME = {"format": "morphspace-faceframe", "version": 1, **POINTS}


@pytest.mark.parametrize("suffix", [".mts", ".m2ts"])
@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])
@pytest.mark.parametrize("is_interlaced", [False, True])
def test_a_camcorder_stream_is_a_clip(tmp_path, suffix, codec, is_interlaced):
    path = tmp_path / f"00001{suffix}"
    rows = np.linspace(0, 255, 64).astype(np.uint8)
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream(codec, rate=25, options={"crf": "4"} if codec == "libx264" else {})
        stream.pix_fmt, stream.height, stream.width = "yuv420p", 64, 64
        stream.bit_rate = 4_000_000
        if is_interlaced:
            stream.codec_context.flags |= 1 << 18 | 1 << 29  # interlaced transform, and motion
        for index in range(8):
            codes = np.broadcast_to(np.roll(rows, 8 * index)[:, None, None], (64, 64, 3))
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(codes), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    if is_interlaced:
        with pytest.raises(BadInput, match=rf"00001\{suffix} is interlaced \(8 of 8 frames\)"):
            open_clip([path])
    clip = open_clip([path], ClipOptions(deinterlace=is_interlaced))
    assert (len(clip), clip.size, clip.sidecar.frame_rate_hz) == (8, (64, 64), 25)
    np.testing.assert_allclose(clip.times_s, np.arange(8) / 25, atol=1e-9)
    for index, image in enumerate(clip.images()):
        expected = np.roll(rows, 8 * index) / np.float32(255)
        inner = np.abs(np.diff(expected, append=expected[:1])) < 0.1  # codecs blur the step
        inner &= np.roll(inner, 1) & np.roll(inner, -1) & np.roll(inner, 2) & np.roll(inner, -2)
        assert np.abs(image[..., 1].mean(axis=1) - expected)[inner].mean() < 0.03  # of lossy codecs
