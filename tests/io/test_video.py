"""Laws of video: every frame in its place, colours by the file's own flags, exact codes where they are
promised.
"""

import struct
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from morphspace.errors import BadInput, SizeMismatch, UnreadableFile, UnwritableFile
from morphspace.io import video
from morphspace.io.animation import write_animation
from morphspace.io.video import read_frames, video_info, video_texts, write_video
from morphspace.synthetic.warped import astronaut_face

COUNT, HEIGHT, WIDTH = 40, 47, 61  # odd, and more frames than any encoder holds back


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def noise(count=COUNT, height=HEIGHT, width=WIDTH, seed=5):
    rng = np.random.default_rng(seed)
    return [(rng.integers(0, 256, (height, width, 3)) / 255).astype(np.float32) for _ in range(count)]


def counted(count=COUNT):
    """Frames that each show their own number as six grey bars, black or white."""
    for index in range(count):
        bits = [(index >> place) & 1 for place in range(6)]
        yield np.repeat(np.repeat(np.array(bits, np.float32)[None, :, None], 16, axis=1), 32, axis=0).repeat(
            3, axis=2
        )


def number_shown(image):
    return sum(int(image[16, 16 * place + 8, 1] > 0.5) << place for place in range(6))


@pytest.mark.parametrize("name", ["a.mkv", "a.mp4"])
def test_lossless_round_trip_is_exact(tmp_path, name):
    frames = noise()
    assert write_video(tmp_path / name, iter(frames), encoding="lossless") == 0
    back = list(read_frames(tmp_path / name))
    assert len(back) == COUNT
    for image, frame in zip(back, frames, strict=True):
        assert image.dtype == np.float32
        assert_array_equal(image, frame)


@pytest.mark.parametrize(
    ("name", "encoding"), [("a.mkv", "lossless"), ("a.mp4", "lossless"), ("a.mp4", "people")]
)
def test_frames_are_counted_and_shown_in_their_places(tmp_path, name, encoding):
    path = tmp_path / name
    write_video(path, counted(), encoding=encoding)
    assert video_info(path).frame_count == COUNT
    assert [number_shown(image) for image in read_frames(path)] == list(range(COUNT))
    wanted = [39, 3, 3, 4, 20, 0, 39]
    assert [number_shown(image) for image in read_frames(path, wanted)] == wanted
    assert list(read_frames(path, [])) == []


def test_a_shown_frame_is_near_its_source(tmp_path):
    image = (
        np.random.default_rng(2).random((3, 4, 3)).astype(np.float32).repeat(20, axis=0).repeat(20, axis=1)
    )
    write_video(tmp_path / "a.mp4", [image] * 3)
    for back in read_frames(tmp_path / "a.mp4"):
        inner = np.abs(back - image).reshape(3, 20, 4, 20, 3)[:, 4:-4, :, 4:-4]
        assert inner.max() < 8 / 255  # codes: crf 14 beside hard edges; the edges themselves lose chroma


def test_odd_sizes_are_padded_by_repeating(tmp_path):
    image = np.zeros((47, 61, 3), np.float32)
    image[:, -1] = 1
    write_video(tmp_path / "a.mp4", [image] * 2)
    assert video_info(tmp_path / "a.mp4").size == (62, 48)
    (back,) = read_frames(tmp_path / "a.mp4", [1])
    assert back[:, -2:].min() > 0.9
    assert back[:, :50].max() < 0.1


@pytest.mark.parametrize(
    ("name", "encoding"), [("a.mkv", "lossless"), ("a.mp4", "lossless"), ("a.mp4", "people")]
)
def test_same_frames_give_the_same_bytes(tmp_path, name, encoding):
    for folder in ("one", "two"):
        write_video(tmp_path / folder / name, noise(count=12), encoding=encoding)
    content = (tmp_path / "one" / name).read_bytes()
    assert content == (tmp_path / "two" / name).read_bytes()
    assert str(tmp_path).encode() not in content


@pytest.mark.parametrize("rate_hz", [25.0, 30000 / 1001, 12.5, 60.0])
@pytest.mark.parametrize("name", ["a.mkv", "a.mp4"])
def test_frame_rate_survives(tmp_path, rate_hz, name):
    write_video(tmp_path / name, noise(count=10), frame_rate_hz=rate_hz, encoding="lossless")
    info = video_info(tmp_path / name)
    assert info.frame_rate_hz == pytest.approx(
        rate_hz, rel=1e-3
    )  # Matroska keeps times in whole milliseconds
    assert info.size == (WIDTH, HEIGHT)


COLOURS = np.array(
    [[[255, 0, 0], [0, 255, 0], [0, 0, 255], [200, 120, 90]], [[255] * 3, [0] * 3, [90] * 3, [30, 200, 180]]],
    np.uint8,
)
FLAT = COLOURS.repeat(16, axis=0).repeat(16, axis=1)
KR_KB = {1: (0.2126, 0.0722), 5: (0.299, 0.114), 6: (0.299, 0.114), 9: (0.2627, 0.0593), 0: (0.299, 0.114)}


def write_yuv(path, matrix, range_flag, bits=8, curve=None):
    """Write 4:4:4 planes computed here from ITU-R BT.601, BT.709 or BT.2020, flagged as told."""
    kr, kb = KR_KB[matrix]
    red, green, blue = np.moveaxis(FLAT / 255.0, 2, 0)
    luma = kr * red + (1 - kr - kb) * green + kb * blue
    chroma = (blue - luma) / (2 * (1 - kb)), (red - luma) / (2 * (1 - kr))
    step = 2 ** (bits - 8)
    if range_flag == 2:
        top = 256 * step - 1
        planes = [luma * top, *(each * top + 128 * step for each in chroma)]
    else:
        planes = [(16 + 219 * luma) * step, *((128 + 224 * each) * step for each in chroma)]
    kind = np.uint8 if bits == 8 else np.uint16
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width = FLAT.shape[:2]
        stream.pix_fmt = "yuv444p" if bits == 8 else "yuv444p10le"
        context = stream.codec_context
        frame = av.VideoFrame(stream.width, stream.height, stream.pix_fmt)
        for plane, values in zip(frame.planes, planes, strict=True):
            rows = np.zeros((stream.height, plane.line_size // kind().itemsize), kind)
            rows[:, : stream.width] = np.rint(np.clip(values, 0, 256 * step - 1))
            plane.update(rows.tobytes())
        if matrix:
            context.colorspace = frame.colorspace = matrix
        if range_flag:
            context.color_range = frame.color_range = range_flag
        if curve:
            context.color_trc = frame.color_trc = curve
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.mark.parametrize("matrix", KR_KB)
@pytest.mark.parametrize("range_flag", [0, 1, 2])
@pytest.mark.parametrize("bits", [8, 10])
def test_colour_follows_the_flags(tmp_path, matrix, range_flag, bits):
    write_yuv(tmp_path / "a.mkv", matrix, range_flag, bits)
    (image,) = read_frames(tmp_path / "a.mkv")
    assert_allclose(image * 255, FLAT, atol=1.5)  # codes: rounding to 8-bit planes and back


@pytest.mark.parametrize(("curve", "name"), [(16, "PQ"), (18, "HLG")])
def test_hdr_is_refused(tmp_path, curve, name):
    write_yuv(tmp_path / "a.mkv", 9, 1, 10, curve)
    with pytest.raises(BadInput, match=rf"a\.mkv is HDR video \({name}\)"):
        list(read_frames(tmp_path / "a.mkv"))


def write_matrix(path, a, b, c, d):
    """Write the display matrix into the track header of an MP4 (ISO/IEC 14496-12, 8.3.2)."""
    content = bytearray(path.read_bytes())
    box = content.find(b"tkhd") + 4
    place = box + 4 + (32 if content[box] else 20) + 16
    fixed = [int(value * 65536) for value in (a, b, 0, c, d, 0, 0, 0)]
    content[place : place + 36] = struct.pack(">9i", *fixed, 1 << 30)
    path.write_bytes(content)


@pytest.mark.parametrize("matrix", [(1, 0, 0, 1), (-1, 0, 0, 1), (1, 0, 0, -1), (-1, 0, 0, -1)])
@pytest.mark.parametrize("is_turned", [False, True])
def test_the_display_matrix_is_applied_turns_and_flips_and_both(tmp_path, matrix, is_turned):
    path = tmp_path / "a.mp4"
    write_video(path, [FLAT / np.float32(255)], encoding="lossless")
    a, b, c, d = (0, matrix[0], matrix[3], 0) if is_turned else matrix
    write_matrix(path, a, b, c, d)
    (image,) = read_frames(path)
    # A pixel (x, y) is shown at (a x + c y, b x + d y), up to the shift that makes both begin at 0.
    y, x = np.mgrid[: FLAT.shape[0], : FLAT.shape[1]]
    shown = np.stack([a * x + c * y, b * x + d * y])
    shown -= shown.min(axis=(1, 2), keepdims=True)
    upright = np.zeros((shown[1].max() + 1, shown[0].max() + 1, 3))
    upright[shown[1], shown[0]] = FLAT
    assert_array_equal(np.rint(image * 255), upright)
    assert video_info(path).size == (upright.shape[1], upright.shape[0])


@pytest.mark.parametrize("turns", range(4))
def test_a_turn_is_applied_where_pyav_cannot_read_the_display_matrix(turns):
    class Frame:
        rotation = 90 * turns - 360 * (turns > 2)

        @property
        def side_data(self):
            raise ValueError("34 is not a valid Type")

    image = np.arange(24.0).reshape(2, 4, 3)
    assert_array_equal(video._upright("a.mp4", image, Frame()), np.rot90(image, turns))


def test_an_oblique_display_matrix_is_refused(tmp_path):
    write_video(tmp_path / "a.mp4", [FLAT / np.float32(255)], encoding="lossless")
    write_matrix(tmp_path / "a.mp4", 0.8, 0.6, -0.6, 0.8)
    with pytest.raises(BadInput, match=r"a\.mp4 is turned by 36\.9 degrees; expected quarter turns"):
        video_info(tmp_path / "a.mp4")


def encoded(
    path, frames, codec, pixels, times=None, options=None, tick=Fraction(1, 25), aspect=None, rate=25
):
    """Write 8-bit frames with libav; a time is a whole number of ticks."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=options or {})
        stream.pix_fmt = pixels
        stream.height, stream.width = frames[0].shape[:2]
        if aspect is not None:
            stream.codec_context.sample_aspect_ratio = aspect
        if times is not None:
            stream.codec_context.time_base = tick
        for index, codes in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(codes, format="rgba" if codes.shape[2] == 4 else "rgb24")
            picture.pts, picture.time_base = (index if times is None else times[index]), tick
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("aspect", "size"), [((4, 3), (171, 96)), ((1, 2), (128, 192)), ((64, 65), (128, 98))]
)
def test_pixels_become_square_and_it_is_said(tmp_path, aspect, size):
    ramp = np.linspace(0, 255, 128)[None, :, None] + np.zeros((96, 128, 3))
    path = encoded(
        tmp_path / "a.mp4",
        [ramp.astype(np.uint8)] * 2,
        "libx264rgb",
        "rgb24",
        options={"crf": "0"},
        aspect=Fraction(*aspect),
    )
    info = video_info(path)
    assert info.size == size
    assert f"pixels of aspect {aspect[0]}:{aspect[1]}" in info.notes[0]
    image = next(read_frames(path))
    assert image.shape == (size[1], size[0], 3)
    wanted = (np.arange(size[0]) + 0.5) * 128 / size[0] - 0.5  # pixel centres of the stored frame
    inner = slice(4, -4)  # px; at the ends the cubic kernel repeats the border
    assert_allclose(
        image[40, inner, 1] * 255, ramp[0, :, 1].take(0) + wanted[inner] * 255 / 127, atol=1.5
    )  # codes


def test_nearly_square_pixels_are_left_alone_and_absurd_ones_refused(tmp_path):
    frames = [np.full((400, 64, 3), 90, np.uint8)] * 2
    info = video_info(
        encoded(
            tmp_path / "a.mp4", frames, "libx264rgb", "rgb24", options={"crf": "0"}, aspect=Fraction(300, 301)
        )
    )
    assert (info.size, info.notes) == ((64, 400), ())
    with pytest.raises(BadInput, match="pixels of aspect 9:1; expected 1:4 to 4:1"):
        video_info(
            encoded(
                tmp_path / "b.mp4", frames, "libx264rgb", "rgb24", options={"crf": "0"}, aspect=Fraction(9, 1)
            )
        )


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [
        ("a.mov", "qtrle", "argb"),
        ("a.mkv", "ffv1", "bgra"),
        ("a.webm", "libvpx-vp9", "yuva420p"),
        ("a.webm", "libvpx", "yuva420p"),
    ],
)
def test_alpha_is_refused_unless_opaque_as_in_a_png(tmp_path, name, codec, pixels):
    options = {"auto-alt-ref": "0", "crf": "4", "b": "4M"} if "vpx" in codec else {}
    colour = np.full((64, 64, 3), (200, 120, 90), np.uint8)
    frames = [np.dstack([colour, np.full((64, 64), 255, np.uint8)]) for _ in range(3)]
    encoded(tmp_path / name, frames, codec, pixels, options=options)
    assert len(list(read_frames(tmp_path / name))) == 3
    frames[2][20:40, 20:40, 3] = 60
    encoded(tmp_path / name, frames, codec, pixels, options=options)
    with pytest.raises(BadInput, match=r"has an alpha channel that is not opaque \(minimum 0\.2"):
        list(read_frames(tmp_path / name))


def test_opaque_alpha_of_more_than_8_bits_is_opaque(tmp_path):
    """ProRes 4444, as editing programs export it: its largest alpha, 1023 or 4095, is not 65535 once it has 16 bits."""
    for alpha in (1023, 1000):
        picture = av.VideoFrame(64, 64, "yuva444p10le")
        for plane, code in zip(picture.planes, (600, 512, 512, alpha), strict=True):
            plane.update(np.full(plane.buffer_size // 2, code, "<u2").tobytes())
        with av.open(str(tmp_path / f"{alpha}.mov"), "w") as container:
            stream = container.add_stream("prores_ks", rate=25, options={"profile": "4444"})
            stream.pix_fmt, stream.height, stream.width = "yuva444p10le", 64, 64
            picture.pts, picture.time_base = 0, Fraction(1, 25)
            container.mux(stream.encode(picture))
            container.mux(stream.encode(None))
    assert len(list(read_frames(tmp_path / "1023.mov"))) == 1
    with pytest.raises(BadInput, match=r"has an alpha channel that is not opaque \(minimum 0\.97"):
        list(read_frames(tmp_path / "1000.mov"))


@pytest.mark.parametrize("seed", range(40))
def test_a_flipped_bit_in_a_lossless_video_is_noticed_though_libav_reads_on(flipped, tmp_path, seed):
    content, packets = flipped
    rng = np.random.default_rng(seed)
    packet = packets[rng.integers(len(packets))]
    place = content.index(packet) + int(rng.integers(len(packet)))
    damaged = bytearray(content)
    damaged[place] ^= 1 << rng.integers(8)
    (tmp_path / "a.mkv").write_bytes(damaged)
    with pytest.raises(UnreadableFile, match=r"a\.mkv is damaged"):
        video_info(tmp_path / "a.mkv")


@pytest.fixture(scope="module")
def flipped(tmp_path_factory):
    """The bytes of a lossless video, and its packets."""
    path = tmp_path_factory.mktemp("flipped") / "a.mkv"
    write_video(path, noise(6), encoding="lossless")
    with av.open(str(path)) as container:
        packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    return path.read_bytes(), packets


@pytest.mark.parametrize(
    "options",
    [
        {"level": "1"},
        {"level": "3", "slices": "4", "slicecrc": "0"},
        {"level": "3", "slices": "9", "slicecrc": "1", "coder": "range_def"},
        {"level": "3", "slices": "4", "slicecrc": "1", "g": "3"},
    ],
)
def test_ffv1_of_other_encoders_is_read_with_and_without_checksums(tmp_path, options):
    frames = [np.rint(frame * 255).astype(np.uint8) for frame in noise(7)]
    path = encoded(tmp_path / "a.mkv", frames, "ffv1", "bgr0", options=options)
    for image, codes in zip(read_frames(path), frames, strict=True):
        assert_array_equal(np.rint(image * 255), codes)


@pytest.mark.parametrize("seed", range(6))
def test_a_flipped_bit_in_hevc_with_digests_is_noticed(tmp_path, seed):
    frames = [np.rint(frame * 255).astype(np.uint8) for frame in noise(6, 64, 64)]
    options = {"x265-params": "hash=1:log-level=none", "crf": "20"}
    path = encoded(tmp_path / "a.mkv", frames, "libx265", "yuv420p", options=options)
    content = bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    rng = np.random.default_rng(seed)
    packet = packets[rng.integers(1, len(packets))]
    content[content.index(packet) + len(packet) // 2 + seed] ^= 4
    path.write_bytes(content)
    with pytest.raises(UnreadableFile, match=r"a\.mkv is damaged"):
        video_info(path)


GREY = [np.full((64, 64, 3), 40 + 10 * index, np.uint8) for index in range(12)]


@pytest.mark.parametrize(
    ("name", "codec", "tick", "times", "rate_hz"),
    [
        ("even.mp4", "libx264", (1, 12800), [512 * index for index in range(12)], 25.0),
        ("ntsc.mkv", "ffv1", (1, 1000), [round(1001 * index / 30) for index in range(12)], 30000 / 1001),
        ("lost.avi", "mjpeg", (1, 25), [0, 1, 2, 3, 4, 7, 8, 9, 10, 11, 12, 13], 25.0),
        ("phone.mp4", "libx264", (1, 600), [0, 20, 40, 61, 85, 101, 120, 139, 160, 181, 200, 260], 25.0),
    ],
)
def test_times_of_frames_are_those_of_the_file(tmp_path, name, codec, tick, times, rate_hz):
    pixels = {"ffv1": "bgr0", "mjpeg": "yuvj420p"}.get(codec, "yuv420p")
    rate = Fraction(30000, 1001) if name == "ntsc.mkv" else 25
    path = encoded(tmp_path / name, GREY, codec, pixels, times, tick=Fraction(*tick), rate=rate)
    info = video_info(path)
    assert info.frame_count == len(GREY)
    assert_allclose(
        info.times_s, np.array(times) * tick[0] / tick[1], atol=0.0011
    )  # s; Matroska's milliseconds
    if name == "phone.mp4":  # no header holds: the mean rate
        rate_hz = 11 / (260 / 600)
    assert info.frame_rate_hz == pytest.approx(rate_hz, rel=1e-9)
    is_even = bool(np.ptp(np.diff(info.times_s)) < 1e-9)  # s; rounding of times that are exactly even
    assert is_even == (name in ("even.mp4", "ntsc.mkv"))


@pytest.mark.parametrize(
    ("ticks", "tick_s", "header_hz", "rate_hz", "is_even"),
    [
        (
            [round(index / 0.6) for index in range(60)],
            (1, 1000),
            600,
            600,
            True,
        ),  # milliseconds are 0.6 frames
        ([round(index / 0.03) for index in range(60)], (1, 1000), None, 59 / 1.967, True),
        ([*range(10), *range(11, 21)], (1, 25), 25, 25, False),  # one lost frame
        ([*range(10), *range(11, 21)], (1, 25), None, 19 * 25 / 20, False),
        (
            [401 * index for index in [*range(9), *range(12, 30)]],
            (1, 10_000),
            25,
            25,
            False,
        ),  # a slow clock: nominal
        ([450 * index for index in [*range(9), *range(12, 30)]], (1, 10_000), 25, 26 / 29 / 0.045, False),
    ],
)
def test_a_lost_frame_is_told_from_the_rounding_of_a_clock(ticks, tick_s, header_hz, rate_hz, is_even):
    header = None if header_hz is None else Fraction(header_hz)
    rate, times_s = video._clock(ticks, Fraction(*tick_s), header)
    assert float(rate) == pytest.approx(rate_hz)
    wanted = np.arange(len(ticks)) / rate_hz if is_even else np.array(ticks) * tick_s[0] / tick_s[1]
    assert_allclose(times_s, wanted, atol=1e-12)  # s; rounding of floats


def vint(number):
    width = next(width for width in range(1, 9) if number < (1 << 7 * width) - 1)
    return (number | (1 << 7 * width)).to_bytes(width, "big")


def element(name, content):
    return bytes.fromhex(name) + vint(len(content)) + content


def whole(number):
    return number.to_bytes(max(1, (number.bit_length() + 7) // 8), "big")


def recorder_webm(path, frames, times_ms):
    """Write a WebM as a browser's MediaRecorder does: times in milliseconds, neither a rate nor a length (RFC 9559)."""
    options = {"b": "2M", "auto-alt-ref": "0", "lag-in-frames": "0"}
    encoded(path, frames, "libvpx", "yuv420p", options=options)
    with av.open(str(path)) as container:
        packets = [(bytes(one), one.is_keyframe) for one in container.demux(video=0) if one.size]
    height, width = frames[0].shape[:2]
    head = element(
        "1A45DFA3", element("4282", b"webm") + element("4287", whole(4)) + element("4285", whole(2))
    )
    size = element("E0", element("B0", whole(width)) + element("BA", whole(height)))
    track = (
        element("D7", whole(1))
        + element("73C5", whole(1))
        + element("83", whole(1))
        + element("86", b"V_VP8")
    )
    content = head + bytes.fromhex("18538067") + b"\x01" + b"\xff" * 7
    content += element("1549A966", element("2AD7B1", whole(1_000_000)))
    content += element("1654AE6B", element("AE", track + size))
    content += bytes.fromhex("1F43B675") + b"\x01" + b"\xff" * 7 + element("E7", whole(0))
    for (data, is_key), time_ms in zip(packets, times_ms, strict=True):
        content += element("A3", b"\x81" + struct.pack(">h", time_ms) + bytes([0x80 * is_key]) + data)
    path.write_bytes(content)


def test_a_recording_without_a_rate_has_that_of_its_times(tmp_path):
    times_ms = [0, 37, 84, 120, 155, 204, 240, 282, 317, 360, 403, 440]
    recorder_webm(tmp_path / "a.webm", GREY, times_ms)
    info = video_info(tmp_path / "a.webm")
    assert info.frame_rate_hz == pytest.approx(11 / 0.44)
    assert_allclose(info.times_s, np.array(times_ms) / 1000)


def test_a_raw_dv_stream_has_the_rate_of_its_times_and_not_60000_hz(tmp_path):
    frames = [np.full((576, 720, 3), 40 + 10 * index, np.uint8) for index in range(4)]
    encoded(tmp_path / "a.avi", frames, "dvvideo", "yuv420p")
    with av.open(str(tmp_path / "a.avi")) as container:
        (tmp_path / "a.dv").write_bytes(b"".join(bytes(packet) for packet in container.demux(video=0)))
    with av.open(str(tmp_path / "a.dv")) as container:
        assert container.streams.video[0].average_rate == 60000
    info = video_info(tmp_path / "a.dv")
    assert (info.frame_rate_hz, info.frame_count, info.interlaced) == (25.0, 4, 4)
    assert info.size == (768, 576)  # px; 720 pixels of 16:15


def test_times_that_do_not_rise_are_unknown_and_the_header_counts(tmp_path):
    path = encoded(tmp_path / "a.avi", GREY, "libx264", "yuv420p", rate=50, tick=Fraction(1, 50))
    info = video_info(path)  # AVI keeps the order of decoding only
    assert (info.frame_rate_hz, info.times_s) == (50.0, None)


@pytest.mark.parametrize("rate_hz", [0.01, 10_000.0])
@pytest.mark.parametrize("name", ["a.mkv", "a.mp4"])
def test_rates_are_written_from_time_lapse_to_high_speed(tmp_path, rate_hz, name):
    write_video(tmp_path / name, noise(3), frame_rate_hz=rate_hz, encoding="lossless")
    assert video_info(tmp_path / name).frame_rate_hz == pytest.approx(rate_hz, rel=1e-6)


def test_fields_become_whole_frames(tmp_path):
    fields = [np.full((64, 64, 3), 60, np.uint8) for _ in range(16)]
    for index, field in enumerate(fields):
        field[:, 8 + 2 * index : 24 + 2 * index] = 220  # a bar that moves in every field
    woven = [
        np.where(np.arange(64)[:, None, None] % 2, early, late)
        for early, late in zip(fields[::2], fields[1::2], strict=True)
    ]
    options = {
        "crf": "1",
        "flags": "+ildct+ilme",
        "x264-params": "bff=1",
    }  # the lower rows are the first field
    path = encoded(
        tmp_path / "a.mp4", [frame.astype(np.uint8) for frame in woven], "libx264", "yuv420p", options=options
    )
    assert video_info(path).interlaced == 8
    plain = list(read_frames(path))
    smooth = list(read_frames(path, deinterlace=True))
    assert len(smooth) == len(plain) == 8

    def comb(images):
        return float(np.mean([np.abs(np.diff(image[..., 1], axis=0)).mean() for image in images[1:-1]]))

    assert comb(plain) > 5 * comb(smooth)
    for image, early in zip(smooth[1:-1], fields[2:-2:2], strict=True):  # the time of the first field
        assert np.abs(image - early / np.float32(255)).mean() < 2 / 255  # codes; H.264 beside hard edges


@pytest.mark.parametrize(
    ("name", "encoding"),
    [("a.mkv", "lossless"), ("a.mp4", "lossless"), ("a.mp4", "people"), ("a.mov", "people")],
)
@pytest.mark.parametrize("share", [0, 0.05, 0.5, 0.9, 0.99])
def test_truncated_video_is_named(tmp_path, name, encoding, share):
    path = tmp_path / name
    write_video(path, noise(count=6), encoding=encoding)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(UnreadableFile) as caught:
        video_info(path)
    assert str(path) in str(caught.value)
    with pytest.raises(UnreadableFile):
        list(read_frames(path))


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("a.mp4", "libx264", {"movflags": "faststart"}),
        ("a.avi", "mpeg4", {}),
        ("a.mkv", "libx264", {}),
        ("a.webm", "libvpx-vp9", {}),
    ],
)
def test_a_cut_between_two_frames_is_noticed_though_libav_notices_none(tmp_path, name, codec, options):
    path = tmp_path / name
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 32, "yuv420p"
        for image in noise(count=12, height=32, width=64):
            codes = np.rint(255 * image).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes, format="rgb24")))
        container.mux(stream.encode(None))
    with av.open(str(path)) as container:
        ends = [packet.pos + packet.size for packet in container.demux(video=0) if packet.size]
    path.write_bytes(path.read_bytes()[: ends[5]])
    with av.open(str(path)) as container:
        assert 1 <= sum(1 for _ in container.decode(video=0)) < 12  # and no error
    with pytest.raises(UnreadableFile, match="cut short"):
        video_info(path)


def test_truncated_avi_is_named(tmp_path):
    path = tmp_path / "a.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 32, "yuvj420p"
        for _ in range(9):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(FLAT, format="rgb24")))
        container.mux(stream.encode(None))
    assert video_info(path).frame_count == 9
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(UnreadableFile, match=f"cut short: .* expected {len(content)}"):
        video_info(path)


def test_what_is_not_a_video_is_named(tmp_path):
    (tmp_path / "text.mp4").write_text("this is no video")
    (tmp_path / "noise.mkv").write_bytes(bytes(range(256)) * 20)
    for name, words in (
        ("text.mp4", "not a video"),
        ("noise.mkv", "not a video"),
        ("gone.mp4", "No such file"),
    ):
        with pytest.raises(UnreadableFile, match=words):
            video_info(tmp_path / name)
        with pytest.raises(UnreadableFile, match=words):
            list(read_frames(tmp_path / name, [0]))
    with pytest.raises(UnreadableFile):
        video_info(tmp_path)


def test_sound_alone_is_refused(tmp_path):
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    with pytest.raises(UnreadableFile, match="no video track"):
        video_info(tmp_path / "a.mkv")


def test_frames_beyond_the_end_are_refused(tmp_path):
    write_video(tmp_path / "a.mkv", noise(count=3), encoding="lossless")
    for indices in ([3], [0, 7, 1], [-1]):
        with pytest.raises(BadInput, match=rf"a\.mkv: the frame is {max(indices, key=abs)}; expected"):
            list(read_frames(tmp_path / "a.mkv", indices))


def test_clipped_values_are_counted(tmp_path):
    frames = noise(count=3)
    frames[1][0, 0] = (1.5, -0.5, 1.0001)
    assert write_video(tmp_path / "a.mkv", frames, encoding="lossless") == 2


def test_frames_that_are_no_video_are_refused_and_nothing_is_left(tmp_path):
    good = noise(count=2)
    broken = [good[0], np.full_like(good[0], np.nan)]
    for frames, error, words in (
        ([], BadInput, "no frames"),
        ([good[0], good[1][:-1]], SizeMismatch, "frame 1 is 61 x 46 px; expected 61 x 47"),
        (broken, BadInput, "frame 1: 8601 of its values are not finite"),
        ([good[0][..., 0]], BadInput, "frame 0: its shape"),
    ):
        for name, encoding in (("a.mkv", "lossless"), ("a.mp4", "people")):
            with pytest.raises(error, match=words):
                write_video(tmp_path / name, frames, encoding=encoding)
    for name, arguments in (
        ("a.avi", {}),
        ("a.mov", {"encoding": "lossless"}),
        ("a.mp4", {"encoding": "best"}),
        ("a.mp4", {"frame_rate_hz": 0}),
        ("a.mp4", {"frame_rate_hz": float("nan")}),
    ):
        with pytest.raises(BadInput):
            write_video(tmp_path / name, good, **arguments)
    assert names_in(tmp_path) == []


def test_a_damaged_source_is_not_blamed_on_the_target(tmp_path):
    (tmp_path / "bad.mkv").write_text("no video")
    with pytest.raises(UnreadableFile, match=r"bad\.mkv"):
        write_video(tmp_path / "new.mp4", read_frames(tmp_path / "bad.mkv"))


FULL_DISK = """
import resource, sys
import numpy as np
from morphspace.errors import UnwritableFile
from morphspace.io.video import write_video
path, encoding = sys.argv[1:3]
frames = [np.random.default_rng(seed).random((64, 64, 3)).astype(np.float32) for seed in range(12)]
write_video(path, frames, encoding=encoding)
with open(path, "rb") as file:
    old = file.read()
for limit in (0, 100, len(old) // 2, len(old) - 100, len(old) - 1):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write_video(path, frames, encoding=encoding, frame_rate_hz=24.0)
        print("written in spite of the limit", limit)
    except UnwritableFile as error:
        print("refused", error)
    with open(path, "rb") as file:
        assert file.read() == old, limit
"""


@pytest.mark.parametrize(
    ("name", "encoding"), [("a.mkv", "lossless"), ("a.mp4", "lossless"), ("a.mp4", "people")]
)
def test_full_disk_leaves_the_old_file_intact(tmp_path, name, encoding):
    path = tmp_path / name
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, path, encoding], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    lines = done.stdout.splitlines()
    assert sum(line.startswith(f"refused cannot write {path}") for line in lines) == len(lines) == 5, (
        done.stdout
    )
    assert names_in(tmp_path) == [name]


def test_a_file_in_place_of_the_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UnwritableFile, match=r"cannot write .*file/a\.mp4"):
        write_video(tmp_path / "file" / "a.mp4", noise(count=1))


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.gif", "a.webp"])
def test_a_folder_with_a_colon_is_no_protocol(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path, frames = Path("a:b") / name, noise(count=2)
    if name in ("a.gif", "a.webp"):
        write_animation(path, lambda: iter(frames), frame_rate_hz=25.0)
        assert path.stat().st_size > 0
    else:
        write_video(path, frames)
        assert len(list(read_frames(path))) == 2 and video_texts(path) is not None


def test_many_frames_of_a_photograph_give_the_same_bytes_every_time(tmp_path):
    """Long enough for the encoder to look ahead; its rate control by blocks gave other bytes nearly every time."""
    photograph = cv2.resize(astronaut_face()[0], (400, 240), interpolation=cv2.INTER_AREA)
    frames = []
    for number in range(72):
        moved = np.float32([[1, 0, 4 * np.sin(number / 5)], [0, 1, 3 * np.cos(number / 7)]])
        frames.append(
            np.clip(cv2.warpAffine(photograph, moved, (400, 240), borderMode=cv2.BORDER_REPLICATE), 0, 1)
        )
    written = set()
    for _ in range(3):
        write_video(tmp_path / "a.mp4", frames)
        written.add((tmp_path / "a.mp4").read_bytes())
    assert len(written) == 1


def test_a_codec_that_is_not_known_is_refused(tmp_path):
    path = tmp_path / "a.mp4"
    write_video(path, [np.zeros((32, 32, 3), np.float32)] * 2, frame_rate_hz=25)
    content = path.read_bytes()
    assert content.count(b"avc1") == 2  # the brand of the file, and the entry of its only track
    at = content.rindex(b"avc1")
    path.write_bytes(content[:at] + b"zzz1" + content[at + 4 :])
    with pytest.raises(UnreadableFile, match="a codec that libav does not know"):
        list(read_frames(path))
