"""Read and write video, exact to the frame: all frames are decoded in order; none is skipped or repeated (ours).

Seeking reaches the wrong frame in many files, and the frame count in a header is an estimate. Frames are therefore
decoded from the start and counted. Colour conversion follows the flags of the file (BT.601, BT.709, BT.2020; limited
or full range). A file without a matrix flag is taken as BT.709 from 720 lines on, as BT.601 below.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, Literal

import av
import numpy as np
from av.video.reformatter import Interpolation

from morphspace.arrays import Image
from morphspace.errors import BadInput, SizeMismatch, UnreadableFile, UnwritableFile
from morphspace.io.colour import check_image, codes_of
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
EBML_HEADER, SEGMENT = 0x1A45DFA3, 0x18538067  # Matroska element identifiers (RFC 8794, RFC 9559)
MP4_FIRST_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")
HDR_CURVES = {16: "PQ", 18: "HLG"}
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
    frame_rate_hz : float, the mean rate
    size : (width, height) px, upright
    """

    frame_count: int
    frame_rate_hz: float
    size: tuple[int, int]


def video_info(path: str | Path) -> VideoInfo:
    """Decode a video once and return its size, rate and frame count. Raises `UnreadableFile`."""
    path = Path(path)
    count, rate_hz, size = 0, 0.0, (0, 0)
    for frame, stream_rate_hz in _decoded(path):
        if count == 0:
            rate_hz, size = stream_rate_hz, _upright_size(frame)
        count += 1
    return VideoInfo(count, rate_hz, size)


def read_frames(path: str | Path, indices: Sequence[int] | None = None) -> Iterator[Image]:
    """Yield frames as (h, w, 3) float32, sRGB-coded in [0, 1], one at a time.

    The rotation that phones store is applied. More than 8 bits per channel are kept.

    Parameters
    ----------
    path : str or Path
    indices : sequence of int, from 0, or None for all frames
        The order is kept and repetitions are allowed; where an index decreases, the video is decoded again from its
        start.

    Raises
    ------
    UnreadableFile
        If the file is missing or damaged.
    BadInput
        If an index is beyond the end, or the video is HDR.
    SizeMismatch
        If frames differ in size.
    """
    path = Path(path)
    if indices is None:
        yield from (image for _, image in _images(path, None))
        return
    wanted = [int(index) for index in indices]
    if any(index < 0 for index in wanted):
        raise BadInput(f"{path}: the frame is {min(wanted)}; expected 0 or more. Count frames from 0")
    for run in _rising_runs(wanted):
        yield from _images_of_run(path, run)


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
    """
    path = Path(path)
    suffixes = {"people": PEOPLE_SUFFIXES, "lossless": LOSSLESS_SUFFIXES}.get(encoding)
    if suffixes is None:
        raise BadInput(f"the encoding is '{encoding}'; expected 'people' or 'lossless'. Choose one")
    if path.suffix.lower() not in suffixes:
        raise BadInput(
            f"cannot write {path} as {encoding} video; expected the suffix {', '.join(suffixes)}. Rename it"
        )
    if not 0 < frame_rate_hz <= 1000:
        raise BadInput(f"the frame rate is {frame_rate_hz} Hz; expected above 0 and at most 1000. Change it")
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
        with av.open(str(path), metadata_errors="replace") as container:
            return {key.lower(): text for key, text in container.metadata.items()}
    except (av.FFmpegError, OSError) as error:
        raise UnreadableFile(
            f"{path} is not a video: {error.strerror or 'no reason given'}. Check the name"
        ) from error


def _decoded(path: Path) -> Iterator[tuple[Any, float]]:
    """Yield each decoded frame with the stream's mean rate. Raise `UnreadableFile` for any damage."""
    _check_whole(path)
    count = 0
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise UnreadableFile(
                    f"{path} has no video track; expected one. Use another video or a folder of images"
                )
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            stream.codec_context.options = {"err_detect": "explode"}
            rate = stream.average_rate or stream.guessed_rate or 0
            for frame in container.decode(stream):
                if frame.is_corrupt:
                    raise UnreadableFile(f"{path} is damaged at frame {count}. Copy it again")
                yield frame, float(rate)
                count += 1
    except (av.FFmpegError, OSError) as error:
        reason = error.strerror or "no reason given"
        raise UnreadableFile(
            f"{path} is damaged or not a video: {reason} after {count} frames. Copy it again"
        ) from error
    if count == 0:
        raise UnreadableFile(f"{path} holds no frames; expected at least one. Copy it again")


def _check_whole(path: Path) -> None:
    """Raise `UnreadableFile` if a file is empty, or shorter than the sum of the lengths that its parts declare.

    libav reports no error for a truncated Matroska or WebM file, nor for an AVI or an MP4 with leading index
    truncated between two frames. The clip would lose its last expressions. An MPEG stream declares no length.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(12)
            file.seek(0)
            needed = size
            if head[:4] == EBML_HEADER.to_bytes(4, "big"):
                needed = _matroska_end(file)
            elif head[4:8] in MP4_FIRST_BOXES:
                needed = _parts_end(file, size, _box_bytes)
            elif head[:4] == b"RIFF":
                needed = _parts_end(file, size, _riff_bytes)
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes). Copy it again")
    if needed > size:
        raise UnreadableFile(f"{path} is cut short: it has {size} bytes; expected {needed}. Copy it again")


def _parts_end(file: BinaryIO, size: int, bytes_of: Callable[[bytes], int]) -> int:
    """Return where the last part at the top level ends; `bytes_of` reads the length of a part from its first bytes."""
    place = 0
    while place + 8 <= size:
        file.seek(place)
        length = bytes_of(file.read(16))
        if length < 8:  # the part extends to the end of the file, or is padding
            return size
        place += length
    return place


def _box_bytes(head: bytes) -> int:
    length = int.from_bytes(head[:4], "big")
    return int.from_bytes(head[8:16], "big") if length == 1 else length


def _riff_bytes(head: bytes) -> int:
    return 8 + int.from_bytes(head[4:8], "little") if head[:4] == b"RIFF" else 0


def _matroska_end(file: BinaryIO) -> int:
    """Return where the segment ends; 0 for a live recording, whose length is unknown."""
    _read_number(file)
    _, header_length, _ = _read_number(file)
    file.seek(header_length, 1)
    kind, _, _ = _read_number(file)
    _, length, width = _read_number(file)
    is_unknown = length == (1 << 7 * width) - 1
    return 0 if kind != SEGMENT or is_unknown else file.tell() + length


def _read_number(file: BinaryIO) -> tuple[int, int, int]:
    """Read an EBML number: with its width marker (an identifier), without it (a length), and its width in bytes."""
    first = file.read(1)
    if not first or first[0] == 0:
        return 0, 0, 0
    width = 9 - first[0].bit_length()  # the leading zeros of the first byte give the number of bytes
    number = int.from_bytes(first + file.read(width - 1), "big")
    return number, number & ((1 << 7 * width) - 1), width


def _images(path: Path, wanted: frozenset[int] | None) -> Iterator[tuple[int, Image]]:
    size = None
    for index, (frame, _) in enumerate(_decoded(path)):
        size = size or (frame.width, frame.height)
        if (frame.width, frame.height) != size:
            raise SizeMismatch(
                f"{path}: frame {index} has {frame.width} x {frame.height} px; expected {size[0]} x {size[1]} as in "
                "frame 0. Convert the video to one size"
            )
        if wanted is None or index in wanted:
            yield index, _image_of(path, frame)


def _images_of_run(path: Path, run: Sequence[int]) -> Iterator[Image]:
    """Yield the frames of a run of non-decreasing indices in one pass."""
    place = 0
    for index, image in _images(path, frozenset(run)):
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


def _image_of(path: Path, frame: Any) -> Image:
    """Convert one decoded frame by its own matrix and range flags."""
    if frame.color_trc in HDR_CURVES:
        raise BadInput(
            f"{path} is HDR video ({HDR_CURVES[frame.color_trc]}); expected standard dynamic range. "
            "Export it as Rec. 709"
        )
    is_deep = max(component.bits for component in frame.format.components) > 8
    matrix = MATRICES.get(frame.colorspace, BT709 if frame.height >= HD_HEIGHT else BT601)
    codes = frame.to_ndarray(
        format="rgb48le" if is_deep else "rgb24",
        src_colorspace=None if frame.format.is_rgb else matrix,
        src_color_range=frame.color_range or None,
        interpolation=PRECISE,
        threads=1,
    )
    image = codes.astype(np.float32) / np.float32(65535 if is_deep else 255)
    return np.ascontiguousarray(np.rot90(image, _quarter_turns(frame)))


def _quarter_turns(frame: Any) -> int:
    """Return the number of counter-clockwise quarter turns to the upright image, from the display matrix."""
    return int(round(frame.rotation / 90) % 4)


def _upright_size(frame: Any) -> tuple[int, int]:
    size = (int(frame.width), int(frame.height))
    return (size[1], size[0]) if _quarter_turns(frame) % 2 else size


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
    with av.open(str(temporary), "w", options={"fflags": "+bitexact"}) as container:
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
