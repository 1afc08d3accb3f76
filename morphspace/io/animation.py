"""Animations for slides and pages: GIF with one palette for all frames, and lossless WebP (ours).

They loop for ever. They are no stimuli: a GIF has 256 colours and whole hundredths of a second, and browsers time both
loosely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from morphspace.arrays import AnyArray, Image
from morphspace.errors import BadInput, UnwritableFile
from morphspace.io.colour import check_image, codes_of
from morphspace.storage import whole_file

ANIMATION_SUFFIXES = (".gif", ".webp")
TICKS_HZ = 100  # Hz; a GIF stores durations in hundredths of a second
FASTEST_GIF_HZ = 50.0  # Hz; browsers show shorter durations as a tenth of a second
FASTEST_WEBP_HZ = 1000.0  # Hz; WebP stores milliseconds


def shown_rate_hz(suffix: str, frame_rate_hz: float) -> float:
    """Return the rate at which an animation is shown: of a GIF the nearest with whole hundredths of a second.

    Raises
    ------
    BadInput
        If the rate is not above 0, or above what the format holds.

    Examples
    --------
    >>> shown_rate_hz(".gif", 25), round(shown_rate_hz(".gif", 30), 2), shown_rate_hz(".webp", 30)
    (25.0, 33.33, 30.0)
    """
    fastest = FASTEST_GIF_HZ if suffix == ".gif" else FASTEST_WEBP_HZ
    if not 0 < frame_rate_hz <= fastest:
        raise BadInput(
            f"the frame rate is {frame_rate_hz:g} Hz; expected above 0 and at most {fastest:g} of a {suffix}. Give "
            "--frame-rate, or choose .mp4"
        )
    if suffix != ".gif":
        return float(frame_rate_hz)
    return TICKS_HZ / max(1, round(TICKS_HZ / frame_rate_hz))


def write_animation(path: Path, frames: Callable[[], Iterable[Image]], *, frame_rate_hz: float) -> int:
    """Write images as an animation, completely or not at all.

    Parameters
    ----------
    path : Path
        Ends in one of `ANIMATION_SUFFIXES`.
    frames : function
        Returns the images (h, w, 3), sRGB-coded, of one size. A GIF calls it twice, once for the palette.
    frame_rate_hz : float

    Returns
    -------
    int
        The number of values that were clipped to [0, 1]. Equal images give equal bytes.

    Raises
    ------
    BadInput
        If the suffix, the rate or an image is not possible.
    UnwritableFile
        If the folder or disk refuses the file.

    Examples
    --------
    >>> import numpy as np
    >>> faces = [np.zeros((8, 8, 3), np.float32), np.ones((8, 8, 3), np.float32)]
    >>> write_animation(Path("two.gif"), lambda: faces, frame_rate_hz=10.0)
    0
    """
    suffix = path.suffix.lower()
    if suffix not in ANIMATION_SUFFIXES:
        raise BadInput(
            f"cannot write {path}; expected a name in {' or '.join(ANIMATION_SUFFIXES)}. Rename it"
        )
    rate = Fraction(shown_rate_hz(suffix, frame_rate_hz)).limit_denominator(TICKS_HZ)
    clipped = 0

    def coded() -> Iterator[AnyArray]:
        nonlocal clipped
        clipped = 0
        for image in frames():
            check_image(image, str(path))
            codes, count = codes_of(image, 8)
            clipped += count
            yield codes

    pictures = _gif(coded, rate) if suffix == ".gif" else _webp(coded(), rate)
    codec, options = ("gif", {}) if suffix == ".gif" else ("libwebp_anim", {"lossless": "1"})
    try:
        with (
            whole_file(path) as temporary,
            av.open(str(temporary.absolute()), "w", format=suffix[1:], options={"loop": "0"}) as container,
        ):
            stream: Any = None
            for picture in pictures:
                if stream is None:
                    stream = container.add_stream(codec, rate=rate, options=options)
                    stream.width, stream.height, stream.pix_fmt = (
                        picture.width,
                        picture.height,
                        picture.format.name,
                    )
                container.mux(stream.encode(picture))
            if stream is None:
                raise BadInput(
                    f"cannot write {path}: there are no frames; expected at least one. Select frames"
                )
            container.mux(stream.encode(None))
    except av.FFmpegError as error:
        raise UnwritableFile(
            f"cannot write {path}: {error.strerror}. Check the space on the disk; nothing was changed"
        ) from error
    return clipped


def _pictures(coded: Iterable[AnyArray], rate: Fraction) -> Iterator[av.VideoFrame]:
    for index, codes in enumerate(coded):
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(codes), format="rgb24")
        picture.pts, picture.time_base = index, 1 / rate
        yield picture


def _webp(coded: Iterable[AnyArray], rate: Fraction) -> Iterator[av.VideoFrame]:
    for picture in _pictures(coded, rate):
        changed = picture.reformat(format="bgra")
        changed.pts, changed.time_base = picture.pts, picture.time_base
        yield changed


def _gif(coded: Callable[[], Iterable[AnyArray]], rate: Fraction) -> Iterator[av.VideoFrame]:
    """Yield the frames in one palette of 256 colours, which is computed from all frames first."""
    palettes = list(_filtered(_pictures(coded(), rate), "palettegen", "stats_mode=full"))
    if palettes:
        yield from _filtered(_pictures(coded(), rate), "paletteuse", "dither=sierra2_4a", palettes[-1])


def _filtered(
    pictures: Iterator[av.VideoFrame], name: str, options: str, palette: av.VideoFrame | None = None
) -> Iterator[av.VideoFrame]:
    """Pass pictures through one of libav's filters, which may need a palette; memory holds one picture."""
    graph: Any = None
    for picture in pictures:
        if graph is None:
            graph = av.filter.Graph()
            source, through, sink = (
                graph.add_buffer(template=None, **_kind(picture)),
                graph.add(name, options),
                graph.add("buffersink"),
            )
            source.link_to(through, 0, 0)
            if palette is not None:
                colours = graph.add_buffer(template=None, **_kind(palette))
                colours.link_to(through, 0, 1)
            through.link_to(sink)
            graph.configure()
            if palette is not None:
                colours.push(palette)
                colours.push(None)
        source.push(picture)
        yield from _pulled(sink)
    if graph is not None:
        source.push(None)
        yield from _pulled(sink)


def _kind(picture: av.VideoFrame) -> dict[str, Any]:
    return {
        "width": picture.width,
        "height": picture.height,
        "format": picture.format,
        "time_base": picture.time_base or Fraction(1, TICKS_HZ),
    }


def _pulled(sink: Any) -> Iterator[av.VideoFrame]:
    while True:
        try:
            picture = sink.pull()
        except (av.BlockingIOError, av.EOFError):
            return
        picture.pict_type = 0
        yield picture
