"""Read and write video, exact to the frame: all frames are decoded in order; none is skipped or repeated (ours).

Seeking reaches the wrong frame in many files, and the frame count in a header is an estimate. Frames are therefore
decoded from the start and counted. Colour conversion follows the flags of the file (BT.601, BT.709, BT.2020; limited
or full range). A file without a matrix flag is taken as BT.709 from 720 lines on, as BT.601 below. The display matrix
and the pixel aspect of the file are applied. `docs/inputs.md` lists what is read and what is refused.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
from av.video.reformatter import Interpolation

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput, SizeMismatch, UnreadableFile, UnwritableFile
from morphspace.io.colour import check_image, codes_of
from morphspace.io.damage import check_whole, is_whole_ffv1
from morphspace.io.profiles import from_primaries, from_profile
from morphspace.requests import check_rate
from morphspace.storage import whole_file

Encoding = Literal["people", "lossless"]

PEOPLE_SUFFIXES = (".mp4", ".mov", ".mkv")
LOSSLESS_SUFFIXES = (".mkv", ".mp4")
PEOPLE_CRF = 14  # x264's rate factor, 0 to 51; visually lossless
ENCODER_THREADS = 4  # fixed, because the bytes depend on the number of threads
RATE_DENOMINATOR = 1001  # represents 30000/1001 and other NTSC rates exactly
HD_HEIGHT = 720  # px; players take unflagged video of this height or more as BT.709
BT601, BT709, BT2020, MPEG_RANGE = 5, 1, 9, 1  # code points of ITU-T H.273 in libav
MATRICES = {1: BT709, 4: 4, 5: BT601, 6: BT601, 7: 7, 9: BT2020, 10: BT2020}  # flag -> matrix of swscale
HDR_CURVES = {16: "PQ", 18: "HLG"}
SQUARE_TOL = 0.005  # relative; a face squeezed by less is not seen, and its pixels stay exact
MOST_ASPECT = 4  # width of a pixel over its height, or the inverse; broadcast and anamorphic film need 2
QUARTER_TURNS = ((1, 0, 0, 1), (0, -1, 1, 0), (-1, 0, 0, -1), (0, 1, -1, 0))  # counter-clockwise
AXIS_TOL = 0.01  # relative; rounding of a quarter turn in a display matrix
HEADER_TOL = 0.75  # frames; whole ticks are off by up to one tick, a lost frame by a whole one
FITTED_TOL = 0.25  # frames; likewise, but a mean rate hides half of a lost frame
NOMINAL_TOL = 0.02  # relative; the usual step of a recording with lost frames is that of its header
BWDIF = "mode=send_frame:deint=interlaced"  # one frame out for each frame in; whole frames stay as they are
STORED = {
    (False, False): "rgb24",
    (False, True): "rgb48le",
    (True, False): "rgba",
    (True, True): "rgba64le",
}  # by alpha and by more than 8 bits
ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}  # libav's own decoders drop the alpha of WebM
PNG_CODECS = ("png", "apng")
ICC_CHUNK = b"iCCP"  # its name lies in a frame's side data, which PyAV frees twice: the process would crash
PRECISE = (
    Interpolation.BICUBIC
    | Interpolation.ACCURATE_RND
    | Interpolation.FULL_CHR_H_INT
    | Interpolation.FULL_CHR_H_INP
    | Interpolation.BITEXACT
)


@dataclass(frozen=True, eq=False)
class VideoInfo:
    """The frames of a video.

    Attributes
    ----------
    frame_count : int, counted by decoding
    frame_rate_hz : float or None
        The rate of the header if the frames' times agree with it, else that of the times; None for a lone frame.
    size : (width, height) px, upright and with square pixels
    times_s : tuple of floats, or None
        The time of each frame from the first, s; None if the file has none, or they do not rise.
    interlaced : int
        The number of frames that hold two fields.
    notes : tuple of str
        Changes that reading makes to the frames.
    """

    frame_count: int
    frame_rate_hz: float | None
    size: tuple[int, int]
    times_s: tuple[float, ...] | None = None
    interlaced: int = 0
    notes: tuple[str, ...] = ()


def video_info(path: str | Path) -> VideoInfo:
    """Decode a video once and return its size, times, rate and frame count. Raises `UnreadableFile`.

    Examples
    --------
    >>> import numpy as np
    >>> faces = [np.zeros((16, 16, 3)), np.ones((16, 16, 3))]
    >>> _ = write_video("two.mkv", faces, frame_rate_hz=10.0, encoding="lossless")
    >>> info = video_info("two.mkv")
    >>> info.size, info.frame_rate_hz
    ((16, 16), 10.0)
    """
    path = Path(path)
    ticks: list[int | None] = []
    interlaced, track = 0, _Track(None, Fraction(1), Fraction(1))
    size = coded = (0, 0)
    for frame, track in _decoded(path):
        if not ticks:
            coded = (frame.width, frame.height)
            size = _upright_size(path, frame, track.aspect)
        ticks.append(frame.pts)
        interlaced += frame.interlaced_frame
    rate, times_s = _clock(ticks, track.tick_s, track.rate)
    notes: tuple[str, ...] = ()
    if _square_size(coded, track.aspect) != coded:
        notes = (
            f"{path.name} has pixels of aspect {track.aspect.numerator}:{track.aspect.denominator}: its frames of "
            f"{coded[0]}x{coded[1]} are resampled to square pixels, {size[0]}x{size[1]} upright",
        )
    return VideoInfo(len(ticks), None if rate is None else float(rate), size, times_s, interlaced, notes)


def read_frames(
    path: str | Path, indices: Sequence[int] | None = None, *, deinterlace: bool = False
) -> Iterator[Image]:
    """Yield frames as (h, w, 3) float32, sRGB-coded in [0, 1], one at a time.

    The turns and flips that phones store are applied, and pixels become square. More than 8 bits per channel are kept.

    Parameters
    ----------
    path : str or Path
    indices : sequence of int, from 0, or None for all frames
        The order is kept and repetitions are allowed; where an index decreases, the video is decoded again from its
        start.
    deinterlace : bool
        Whether FFmpeg's `bwdif` makes one whole frame of the two fields of each interlaced frame.

    Raises
    ------
    UnreadableFile
        If the file is missing or damaged.
    BadInput
        If an index is beyond the end, the video is HDR, or a pixel is transparent.
    SizeMismatch
        If frames differ in size.

    Examples
    --------
    >>> import numpy as np
    >>> _ = write_video("two.mkv", [np.zeros((16, 16, 3)), np.ones((16, 16, 3))], encoding="lossless")
    >>> [frame.mean().item() for frame in read_frames("two.mkv")]
    [0.0, 1.0]
    """
    path = Path(path)
    if indices is None:
        yield from (image for _, image in _images(path, None, deinterlace))
        return
    wanted = [int(index) for index in indices]
    if any(index < 0 for index in wanted):
        raise BadInput(f"{path}: the frame is {min(wanted)}; expected 0 or more. Count frames from 0")
    for run in _rising_runs(wanted):
        yield from _images_of_run(path, run, deinterlace)


def write_video(
    path: str | Path,
    frames: Iterable[Image],
    *,
    frame_rate_hz: float = 25.0,
    encoding: Encoding = "people",
    metadata: Mapping[str, str] | None = None,
) -> int:
    """Write images as a video, completely or not at all, and return the number of values that were clipped to [0, 1].

    Parameters
    ----------
    path : str or Path
    frames : iterable of arrays (h, w, 3), sRGB-coded, of one size
    frame_rate_hz : float
    encoding : "people" or "lossless"
        "people" is visually lossless H.264 (crf 14, yuv420p, BT.709) for all players; the last column or row is
        repeated if the width or height is odd. "lossless" keeps the 8-bit codes: FFV1 for `.mkv`, H.264 RGB with crf
        0 for `.mp4`.
    metadata : mapping of key to text, or None
        Keys are those of the container, such as `comment` and `copyright`.

    Returns
    -------
    int
        As `codes_of` counts. Equal images give equal bytes.

    Raises
    ------
    BadInput
        If there are no frames, one is no image, or the suffix or rate is not possible.
    SizeMismatch
        If frames differ in size.
    UnwritableFile
        If the folder or disk refuses the file.

    Examples
    --------
    >>> import numpy as np
    >>> write_video("two.mkv", [np.zeros((16, 16, 3)), np.ones((16, 16, 3))], encoding="lossless")
    0
    """
    path = Path(path)
    suffixes = {"people": PEOPLE_SUFFIXES, "lossless": LOSSLESS_SUFFIXES}.get(encoding)
    if suffixes is None:
        raise BadInput(f"the encoding is '{encoding}'; expected 'people' or 'lossless'. Choose one")
    if path.suffix.lower() not in suffixes:
        raise BadInput(
            f"cannot write {path} as {encoding} video; expected the suffix {', '.join(suffixes)}. Rename it"
        )
    check_rate(frame_rate_hz, f"the frame rate of {path}")
    pending = iter(frames)
    first = next(pending, None)
    if first is None:
        raise BadInput(f"cannot write {path}: there are no frames; expected at least one. Select frames")
    clipped = 0
    try:
        with whole_file(path) as temporary:
            every = itertools.chain([first], pending)
            clipped = _encode(path, temporary, every, first, frame_rate_hz, encoding, metadata or {})
    except av.FFmpegError as error:
        raise UnwritableFile(
            f"cannot write {path}: {error.strerror}. Check the space on the disk; nothing was changed"
        ) from error
    return clipped


def video_texts(path: str | Path) -> dict[str, str]:
    """Return the metadata of a video; keys in lower case. Raises `UnreadableFile`."""
    path = Path(path)
    try:
        with av.open(str(path.absolute()), metadata_errors="replace") as container:
            return {key.lower(): text for key, text in container.metadata.items()}
    except (av.FFmpegError, OSError) as error:
        raise UnreadableFile(
            f"{path} is not a video: {error.strerror or 'no reason given'}. Check the name"
        ) from error


@dataclass(frozen=True)
class _Track:
    """What the file says of a video track: its rate, the aspect of its pixels, and the tick of its clock, s."""

    rate: Fraction | None
    aspect: Fraction
    tick_s: Fraction


def _decoded(path: Path, deinterlace: bool = False) -> Iterator[tuple[Any, _Track]]:
    """Yield each decoded frame with its track. Raise `UnreadableFile` for any damage."""
    check_whole(path)
    count = 0
    try:
        with av.open(str(path.absolute())) as container:
            if not container.streams.video:
                raise UnreadableFile(
                    f"{path} has no video track; expected one. Use another video or a folder of images"
                )
            stream = container.streams.video[0]
            check_codec(path, stream)
            track = _Track(
                stream.average_rate or stream.guessed_rate,
                stream.sample_aspect_ratio or Fraction(1),
                Fraction(stream.time_base or 1),
            )
            frames = _frames_of(path, container, stream)
            for frame in _deinterlaced(frames, stream) if deinterlace else frames:
                if frame.is_corrupt:
                    raise UnreadableFile(f"{path} is damaged at frame {count}. Copy it again")
                yield frame, track
                count += 1
    except (av.FFmpegError, OSError) as error:
        reason = error.strerror or "no reason given"
        raise UnreadableFile(
            f"{path} is damaged or not a video: {reason} after {count} frames. Copy it again"
        ) from error
    if count == 0:
        raise UnreadableFile(f"{path} holds no frames; expected at least one. Copy it again")


def check_codec(path: Path, stream: Any) -> None:
    """Check that libav can decode a stream. Raises `UnreadableFile`."""
    if stream.codec_context is None:
        raise UnreadableFile(
            f"{path} is in a codec that libav does not know; expected one such as H.264. Convert it, or copy it again"
        )


def _frames_of(path: Path, container: Any, stream: Any) -> Iterator[Any]:
    """Decode the packets of a stream; libav checks the checksums of HEVC and PNG, and this function those of FFV1."""
    context = stream.codec_context
    with_alpha = ALPHA_DECODERS.get(context.name) if stream.metadata.get("alpha_mode") == "1" else None
    if with_alpha is not None:
        context = av.CodecContext.create(with_alpha, "r")
    context.thread_type = "AUTO"
    context.options = {"err_detect": "crccheck+explode"}
    header = bytes(stream.codec_context.extradata or b"")
    has_checksums = stream.codec_context.name == "ffv1" and bool(header)
    for count, packet in enumerate(container.demux(stream)):
        if packet.is_corrupt or (packet.size and has_checksums and not is_whole_ffv1(bytes(packet))):
            raise UnreadableFile(f"{path} is damaged at frame {count}. Copy it again")
        if context.name in PNG_CODECS and ICC_CHUNK in (header + bytes(packet)).partition(b"IDAT")[0]:
            raise BadInput(
                f"{path} has a colour profile in its PNG frames, which PyAV cannot read; expected sRGB without a "
                "profile. Convert it"
            )
        if packet.size:  # an empty packet is a lost frame of an AVI
            yield from context.decode(packet)
    yield from context.decode(None)


def _deinterlaced(frames: Iterator[Any], stream: Any) -> Iterator[Any]:
    """Pass frames through FFmpeg's `bwdif`, which makes a whole frame of the first field and its neighbours."""
    graph = av.filter.Graph()
    graph.link_nodes(
        graph.add_buffer(template=stream), graph.add("bwdif", BWDIF), graph.add("buffersink")
    ).configure()
    for frame in itertools.chain(frames, [None]):
        graph.push(frame)
        while True:
            try:
                yield graph.pull()
            except (av.BlockingIOError, av.EOFError):
                break


def _clock(
    ticks: Sequence[int | None], tick_s: Fraction, header: Fraction | None
) -> tuple[Fraction | None, tuple[float, ...] | None]:
    """Return the frame rate, Hz, and the time of each frame from the first, s, or None if times are missing.

    Times that agree with an even rate within the tick of their clock are those of that rate: Matroska rounds to
    milliseconds. A header may be a guess: 1000 Hz for a browser's recording, 60,000 Hz for a raw DV stream.
    """
    known = [tick for tick in ticks if tick is not None]
    if len(known) < max(len(ticks), 2) or any(late <= early for early, late in itertools.pairwise(known)):
        return header, None
    times = [(tick - known[0]) * tick_s for tick in known]
    mean = (len(times) - 1) / times[-1]
    for rate, tolerance in ((header, HEADER_TOL), (mean, FITTED_TOL)):
        if rate:
            even = [index / rate for index in range(len(times))]
            allowed = min(tick_s, Fraction(tolerance) / rate)
            if max(abs(time - wanted) for time, wanted in zip(times, even, strict=True)) <= allowed:
                return rate, tuple(map(float, even))
    usual = statistics.median(late - early for early, late in itertools.pairwise(times))
    is_nominal = header is not None and abs(header * usual - 1) <= NOMINAL_TOL
    return header if is_nominal else mean, tuple(map(float, times))


def _images(path: Path, wanted: frozenset[int] | None, deinterlace: bool) -> Iterator[tuple[int, Image]]:
    size = None
    for index, (frame, track) in enumerate(_decoded(path, deinterlace)):
        size = size or (frame.width, frame.height)
        if (frame.width, frame.height) != size:
            raise SizeMismatch(
                f"{path}: frame {index} has {frame.width} x {frame.height} px; expected {size[0]} x {size[1]} as in "
                "frame 0. Convert the video to one size"
            )
        if wanted is None or index in wanted:
            yield index, _image_of(path, frame, track.aspect)


def _images_of_run(path: Path, run: Sequence[int], deinterlace: bool) -> Iterator[Image]:
    """Yield the frames of a run of non-decreasing indices in one pass."""
    place = 0
    for index, image in _images(path, frozenset(run), deinterlace):
        while place < len(run) and run[place] == index:
            yield image
            place += 1
        if place == len(run):
            return
    raise BadInput(
        f"{path}: the frame is {run[place]}; expected one before the end of the video. Count frames from 0"
    )


def _rising_runs(indices: Sequence[int]) -> Iterator[list[int]]:
    run: list[int] = []
    for index in indices:
        if run and index < run[-1]:
            yield run
            run = []
        run.append(index)
    if run:
        yield run


def _image_of(path: Path, frame: Any, aspect: Fraction) -> Image:
    """Convert one decoded frame by its own matrix and range flags, to square pixels, upright."""
    if frame.color_trc in HDR_CURVES:
        raise BadInput(
            f"{path} is HDR video ({HDR_CURVES[frame.color_trc]}); expected standard dynamic range. "
            "Export it as Rec. 709"
        )
    has_alpha = any(component.is_alpha for component in frame.format.components)
    is_deep = max(component.bits for component in frame.format.components) > 8
    matrix = MATRICES.get(frame.colorspace, BT709 if frame.height >= HD_HEIGHT else BT601)
    width, height = _square_size((frame.width, frame.height), aspect)
    codes = frame.to_ndarray(
        width=width,
        height=height,
        format=STORED[has_alpha, is_deep],
        src_colorspace=None if frame.format.is_rgb else matrix,
        src_color_range=frame.color_range or None,
        interpolation=PRECISE,
        threads=1,
    )
    white = 65535 if is_deep else 255
    if has_alpha:
        least = int(codes[..., 3].min())
        if least < _largest_alpha(frame.format, white):
            raise BadInput(
                f"{path} has an alpha channel that is not opaque (minimum {least / white:.3g}; expected 1). "
                "Export it without transparency"
            )
        codes = codes[..., :3]
    return _upright(path, _in_srgb(path, codes.astype(np.float32) / np.float32(white), frame), frame)


def _largest_alpha(pixels: Any, white: int) -> int:
    """Return the code of opaque alpha: swscale shifts that of 9 to 15 bits to 16, so that 1023 becomes 65472."""
    bits = next(component.bits for component in pixels.components if component.is_alpha)
    return white if bits <= 8 else (2**bits - 1) << (16 - bits)


def _in_srgb(path: Path, colour: AnyArray, frame: Any) -> AnyArray:
    """Return colours (h, w, 3) as sRGB, by the ICC profile of a frame, else by the primaries that it declares."""
    try:
        profile = next((bytes(data) for data in frame.side_data if data.type.name == "ICC_PROFILE"), None)
    except ValueError:  # PyAV does not know all kinds of FFmpeg
        profile = None
    if profile is not None:
        return from_profile(path, colour, profile)
    return from_primaries(path, colour, int(frame.color_primaries))


def _square_size(size: tuple[int, int], aspect: Fraction) -> tuple[int, int]:
    """Return the size (width, height) px in square pixels; the short side of a pixel is enlarged, none is reduced."""
    if abs(aspect - 1) <= SQUARE_TOL:
        return size
    width, height = size
    return (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))


def _upright(path: Path, image: Image, frame: Any) -> Image:
    """Apply the display matrix: x' = a x + c y and y' = b x + d y, up to a shift; a and d are 0 for quarter turns."""
    a, b, c, d = _display_signs(path, frame)
    if a == 0:
        image = image.transpose(1, 0, 2)
    if a + c < 0:
        image = image[:, ::-1]
    if b + d < 0:
        image = image[::-1]
    return np.ascontiguousarray(image)


def _display_signs(path: Path, frame: Any) -> tuple[int, int, int, int]:
    """Return the signs of a, b, c and d of the display matrix (ISO 14496-12, 6.2.2; FFmpeg's display.h)."""
    try:
        found = next((data for data in frame.side_data if data.type.name == "DISPLAYMATRIX"), None)
    except ValueError:  # PyAV does not know all kinds of FFmpeg, such as Exif; it still knows the turn
        return QUARTER_TURNS[round(frame.rotation / 90) % 4]
    if found is None:
        return QUARTER_TURNS[0]
    matrix = np.frombuffer(bytes(found), np.int32)[[0, 1, 3, 4]].astype(np.float64)
    signs = (
        np.where(np.abs(matrix) <= AXIS_TOL * np.abs(matrix).max(), 0, np.sign(matrix)).astype(int).tolist()
    )
    a, b, c, d = signs
    if not ((a and d and not b and not c) or (b and c and not a and not d)):
        raise BadInput(
            f"{path} is turned by {np.degrees(np.arctan2(matrix[1], matrix[0])):.3g} degrees; expected quarter turns "
            "and flips. Turn it upright and export it again"
        )
    return a, b, c, d


def _upright_size(path: Path, frame: Any, aspect: Fraction) -> tuple[int, int]:
    if not 1 / MOST_ASPECT <= aspect <= MOST_ASPECT:
        raise BadInput(
            f"{path} has pixels of aspect {aspect.numerator}:{aspect.denominator}; expected 1:{MOST_ASPECT} to "
            f"{MOST_ASPECT}:1. Convert it to square pixels"
        )
    width, height = _square_size((int(frame.width), int(frame.height)), aspect)
    return (width, height) if _display_signs(path, frame)[0] else (height, width)


def _encode(
    path: Path,
    temporary: Path,
    frames: Iterable[Image],
    first: Image,
    frame_rate_hz: float,
    encoding: Encoding,
    metadata: Mapping[str, str],
) -> int:
    rate = Fraction(frame_rate_hz).limit_denominator(RATE_DENOMINATOR)
    clipped = 0
    with av.open(str(temporary.absolute()), "w", options={"fflags": "+bitexact"}) as container:
        container.metadata.update(metadata)
        stream = _add_stream(container, path.suffix.lower(), rate, encoding)
        for index, image in enumerate(frames):
            check_image(image, f"{path}, frame {index}")
            if image.shape != first.shape:
                raise SizeMismatch(
                    f"cannot write {path}: frame {index} is {image.shape[1]} x {image.shape[0]} px; expected "
                    f"{first.shape[1]} x {first.shape[0]} as frame 0. Bring all to one size"
                )
            codes, outside = codes_of(image, 8)
            clipped += outside
            if encoding == "people":
                codes = np.pad(codes, ((0, codes.shape[0] % 2), (0, codes.shape[1] % 2), (0, 0)), mode="edge")
            if index == 0:
                stream.height, stream.width = codes.shape[:2]
            picture = av.VideoFrame.from_ndarray(codes, format="rgb24")
            if encoding == "people":
                picture = picture.reformat(
                    format="yuv420p",
                    dst_colorspace=BT709,
                    dst_color_range=MPEG_RANGE,
                    interpolation=PRECISE,
                    threads=1,
                )
            elif stream.pix_fmt != "rgb24":
                picture = picture.reformat(format=stream.pix_fmt, threads=1)
            picture.pts, picture.time_base = index, 1 / rate
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return clipped


def _add_stream(container: Any, suffix: str, rate: Fraction, encoding: Encoding) -> Any:
    if encoding == "people":
        stream = container.add_stream("libx264", rate=rate)
        stream.pix_fmt = "yuv420p"
        # Macroblock-tree rate control with AVX-512 gives other bytes from run to run.
        stream.options = {"crf": str(PEOPLE_CRF), "preset": "medium", "mbtree": "0"}
        stream.codec_context.colorspace = BT709
        stream.codec_context.color_primaries = BT709
        stream.codec_context.color_trc = 1
        stream.codec_context.color_range = MPEG_RANGE
    elif suffix == ".mkv":
        stream = container.add_stream("ffv1", rate=rate)
        stream.pix_fmt = "bgr0"
        stream.options = {
            "level": "3",
            "slices": "4",
            "slicecrc": "1",
        }  # a checksum per slice reveals damage on reading
    else:
        stream = container.add_stream("libx264rgb", rate=rate)
        stream.pix_fmt = "rgb24"
        stream.options = {"crf": "0", "preset": "medium"}
    stream.codec_context.flags |= av.codec.context.Flags.bitexact
    stream.codec_context.thread_count = ENCODER_THREADS
    return stream
