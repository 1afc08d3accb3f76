"""Stills in and out: sRGB-coded colour, exact 8- and 16-bit codes, nothing ignored and nothing guessed
(ours).

OpenImageIO hands back a partly filled buffer for some damaged files and turns CMYK into RGB on its own, so
each file is checked here: whole, one picture, known channels, finite values. EXR is linear light by
convention and is coded to sRGB on reading and back on writing; every other format is taken as sRGB-coded as
it stands.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO as oiio

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.io.colour import check_image, codes_of, linear_of_srgb, srgb_of_linear
from morphspace.storage import whole_file

oiio.attribute("threads", 1)  # callers spread files over processes; a pool in each would only contend
oiio.attribute("exr_threads", 1)

READ_FORMATS = (
    "png",
    "tiff",
    "jpeg",
    "openexr",
    "bmp",
    "webp",
    "pnm",
    "targa",
)  # a cut file of each is noticed
WRITE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr")
COLOUR_CHANNELS = (("r", "g", "b"), ("r", "g", "b", "a"), ("y",), ("y", "a"))
TIFF_MODELS = (
    0,
    1,
    2,
    3,
    6,
)  # the grey, RGB, palette and YCbCr photometric interpretations; the rest is ink or Lab
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_QUALITY = 95  # 4:4:4; differences to the source stay near one 8-bit code
FOLDER_MARKS = re.compile(r"[/\\]")
LONGEST_NAME = 200  # bytes; file systems allow 255, and a temporary name is longer
GREY_TOLERANCE = 1.5 / 255  # a grey mask saved as colour JPEG may differ by one code between channels


def image_size(path: str | Path) -> tuple[int, int]:
    """Give (width, height) px as `read_image` shows it, from the header alone. Raises `UnreadableFile`."""
    source = _open(Path(path))
    spec = source.spec()
    source.close()
    size = (int(spec.width), int(spec.height))
    return (size[1], size[0]) if spec.get_int_attribute("Orientation", 1) >= 5 else size


def read_image(path: str | Path, *, background: Sequence[float] | None = None) -> Image:
    """Read a still as (h, w, 3) float32, sRGB-coded, the largest integer code at 1.0.

    Grey is repeated to three channels and the camera's orientation tag is applied. An alpha channel that is
    opaque everywhere is dropped; another is composited over `background`, three sRGB-coded values in [0, 1],
    or refused where none is given. Values of float files outside [0, 1] survive. Colour profiles inside the
    file are not applied.

    Raises `UnreadableFile` (missing, empty, cut short, not an image) and `BadInput` (alpha without a
    background, CMYK or unknown channels, several pictures in a file, values that are not finite). Source:
    ours.
    """
    path = Path(path)
    if background is not None and not (len(background) == 3 and all(0 <= value <= 1 for value in background)):
        raise BadInput(f"background {tuple(background)} is not three values in [0, 1], such as 0.5 0.5 0.5")
    values, names, spec = _read_channels(path)
    is_linear = _format_of(spec) == "openexr"
    colour = values[..., :3] if len(names) >= 3 else np.repeat(values[..., :1], 3, axis=2)
    if names[-1] == "a" and (values[..., -1] < 1).any():
        if background is None:
            raise BadInput(
                f"{path} has an alpha channel that is not opaque (down to {values[..., -1].min():.3g}): "
                "save it without transparency, or read it in Python with background=(r, g, b)"
            )
        alpha = values[..., -1:]
        behind = np.asarray(background, np.float32)
        if is_linear:
            behind = linear_of_srgb(behind)
        is_straight = spec.get_int_attribute("oiio:UnassociatedAlpha", 0) == 1
        colour = (colour * alpha if is_straight else colour) + (1 - alpha) * behind
    if is_linear:
        colour = srgb_of_linear(colour)
    return np.ascontiguousarray(colour, dtype=np.float32)


def read_mask(path: str | Path) -> Mask:
    """Read a mask as (h, w) float32 weights in [0, 1], white at 1; the values are weights, so EXR is not
    coded.

    Raises `UnreadableFile` as `read_image` does, and `BadInput` where the picture is coloured, has
    transparency, or holds values outside [0, 1].
    """
    path = Path(path)
    values, names, _ = _read_channels(path)
    if names[-1] == "a":
        if (values[..., -1] < 1).any():
            raise BadInput(
                f"{path} is used as a mask but has transparency: save it as plain grey, white for face"
            )
        values = values[..., :-1]
    if np.ptp(values, axis=2).max() > GREY_TOLERANCE:
        raise BadInput(f"{path} is used as a mask but is coloured: save it as plain grey, white for face")
    low, high = float(values.min()), float(values.max())
    if low < 0 or high > 1:
        raise BadInput(
            f"{path} is used as a mask but holds values from {low:.4g} to {high:.4g}: keep them in [0, 1]"
        )
    return np.ascontiguousarray(values[..., 0])


def write_image(path: str | Path, image: Image, *, bits: int = 8) -> int:
    """Write a still, whole or not at all, and give the number of values that had to be clipped to [0, 1].

    The suffix chooses the format: `.png` and `.tif` hold 8 or 16 `bits`, `.jpg` 8 (quality 95, 4:4:4), `.exr`
    always 32-bit float in linear light, never clipped. A value counts as clipped where clipping moves it by
    more than half a code, so rounding noise at white and black does not count. The same image always gives
    the same bytes.

    Raises `BadInput` for an image that is not (h, w, 3) or not finite, another suffix or bit depth, and
    `UnwritableFile` where the folder or the disk refuses.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WRITE_SUFFIXES:
        raise BadInput(
            f"cannot write {path}: the suffix '{path.suffix}' is not one of {', '.join(WRITE_SUFFIXES)}"
        )
    if bits not in (8, 16) or (bits == 16 and suffix in (".jpg", ".jpeg")):
        raise BadInput(
            f"cannot write {path} with {bits} bits: PNG and TIFF hold 8 or 16, JPEG 8, EXR is always float"
        )
    check_image(image, str(path))
    if suffix == ".exr":
        _write_with_oiio(path, linear_of_srgb(np.ascontiguousarray(image, dtype=np.float32)), "float")
        return 0
    codes, clipped = codes_of(image, bits)
    if suffix in (".jpg", ".jpeg"):
        # OpenImageIO's JPEG writer ends the whole process when the disk is full, so the
        # bytes are made in memory.
        content = _encoded(".jpg", codes, _jpeg_options(JPEG_QUALITY))
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
    else:
        _write_with_oiio(path, codes, codes.dtype.name)
    return clipped


def picture_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the file name of each frame's picture, NAME.png, with an underscore for every slash in the name.

    Raises `BadInput` when two frames would share a file, or a name cannot be that of a file.
    """
    files = tuple(f"{FOLDER_MARKS.sub('_', name)}.png" for name in names)
    for name, file in zip(names, files, strict=True):
        if not name.strip(". ") or len(file.encode()) > LONGEST_NAME or "\0" in name:
            raise BadInput(f"a frame is called {name!r:.60}, which cannot name a picture: rename it")
        if files.count(file) > 1:
            raise BadInput(
                f"{files.count(file)} frames would be written as {file}: give each frame its own name"
            )
    return files


def png_bytes(image: Image) -> bytes:
    """Give the bytes of an 8-bit PNG, for a page that carries its pictures; values are clipped. Raises
    `BadInput`.
    """
    check_image(image, "an image as PNG")
    return _encoded(".png", codes_of(image, 8)[0], [])


def jpeg_bytes(image: Image, quality: int = JPEG_QUALITY) -> bytes:
    """Give the bytes of a 4:4:4 JPEG of `quality` 1 to 100; values are clipped. Raises `BadInput`."""
    if not 1 <= quality <= 100:
        raise BadInput(f"JPEG quality {quality} is not in 1 to 100")
    check_image(image, "an image as JPEG")
    return _encoded(".jpg", codes_of(image, 8)[0], _jpeg_options(quality))


def _open(path: Path) -> Any:
    """Open a still for reading, or say in one line why not."""
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise UnreadableFile(f"{path} is a folder where an image was expected")
        with path.open("rb"):
            pass
    except OSError as error:
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}; check the name and the permissions"
        ) from error
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes): copy it again")
    wish = oiio.ImageSpec()
    wish.attribute("oiio:UnassociatedAlpha", 1)  # keep colour as stored; compositing is ours
    source = oiio.ImageInput.open(str(path), wish)
    if source is None:
        raise UnreadableFile(f"{path} ({size} bytes) is not a readable image: {first_line(oiio.geterror())}")
    kind = source.format_name()
    if kind not in READ_FORMATS:
        source.close()
        raise UnreadableFile(f"{path} is a {kind} file: convert it to one of {', '.join(READ_FORMATS)}")
    return source


def _read_channels(path: Path) -> tuple[AnyArray, tuple[str, ...], Any]:
    """Give (h, w, c) float32 upright values, channel names in the order r g b a or y a, and the header."""
    stored, names, spec = _read_stored(path)
    return _upright(_unit_values(path, stored), spec.get_int_attribute("Orientation", 1)), names, spec


def _read_stored(path: Path) -> tuple[AnyArray, tuple[str, ...], Any]:
    """Give the codes or floats as stored, with their channels in order, their names and the header."""
    source = _open(path)
    kind = source.format_name()
    try:
        if kind == "png":
            _check_png_is_whole(path)
        spec = source.spec()
        order = _check_header(path, spec, kind)
        stored = source.read_image(0, 0, 0, spec.nchannels, "unknown")
        if stored is None or source.has_error:
            # JPEG gives pixels and an error together: the missing rows are grey.
            raise UnreadableFile(
                f"{path} is damaged or cut short ({path.stat().st_size} bytes): "
                f"{first_line(source.geterror())}; "
                "copy it again"
            )
    finally:
        source.close()
    spec.attribute("morphspace:format", kind)
    return stored[..., order], tuple(spec.channelnames[place].lower() for place in order), spec


def _format_of(spec: Any) -> str:
    return str(spec.get_string_attribute("morphspace:format"))


def _check_header(path: Path, spec: Any, kind: str) -> list[int]:
    """Refuse what is not one plain colour or grey picture; give where each channel of r g b a (or y a) is
    stored.
    """
    probe = _open(path)  # one of its own: a reader that was sent to a second picture may not find back
    holds_several = probe.seek_subimage(1, 0)
    probe.geterror()
    probe.close()
    if holds_several:
        raise BadInput(f"{path} holds several pictures: save the one you mean as a file of its own")
    model = spec.get_string_attribute("jpeg:ColorSpace") or spec.get_string_attribute("tiff:ColorSpace")
    photometric = spec.get_int_attribute("tiff:PhotometricInterpretation", 2)
    if model in ("CMYK", "YCCK") or photometric not in TIFF_MODELS:
        raise BadInput(
            f"{path} is stored as {model or 'an unusual colour model'}, not RGB or grey: convert it to sRGB"
        )
    if kind == "openexr" and (spec.width, spec.height) != (spec.full_width, spec.full_height):
        raise BadInput(
            f"{path} stores {spec.width} x {spec.height} pixels of a picture of "
            f"{spec.full_width} x {spec.full_height}: "
            "save it with its data window equal to its display window"
        )
    names = [name.lower() for name in spec.channelnames]
    for wanted in COLOUR_CHANNELS:
        if sorted(names) == sorted(wanted):
            return [names.index(name) for name in wanted]
    raise BadInput(
        f"{path} has the channels {', '.join(spec.channelnames)}, not R G B or Y: save it as RGB or grey"
    )


def _check_png_is_whole(path: Path) -> None:
    """Walk a PNG's chunks before the decoder sees them: it would print about damage by itself."""
    content = memoryview(path.read_bytes())
    place = len(PNG_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        length = int.from_bytes(content[place : place + 4], "big")
        end = place + 12 + length
        if end > len(content) or place + 12 > len(content):
            raise UnreadableFile(
                f"{path} is cut short: it ends after {len(content)} bytes inside a block; copy it again"
            )
        kind = bytes(content[place + 4 : place + 8])
        if zlib.crc32(content[place + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            raise UnreadableFile(
                f"{path} is damaged: the checksum at byte {end - 4} does not agree; copy it again"
            )
        place = end


def _unit_values(path: Path, stored: AnyArray) -> AnyArray:
    """Scale integer codes to [0, 1] exactly, pass floats on; refuse what is not finite."""
    if stored.dtype in (np.uint8, np.uint16):
        return stored.astype(np.float32) / np.float32(np.iinfo(stored.dtype).max)
    if stored.dtype.kind != "f":
        raise BadInput(f"{path} stores {stored.dtype.name} values: save it with 8 or 16 bits, or as float")
    values = stored.astype(np.float32)
    bad = ~np.isfinite(values)
    if bad.any():
        y, x = np.argwhere(bad.any(axis=2))[0]
        raise BadInput(
            f"{path} holds {int(bad.sum())} values that are not finite, the first at x {x}, y {y}: "
            "mend it and save it again"
        )
    return values


def _upright(values: AnyArray, orientation: int) -> AnyArray:
    """Apply the EXIF orientation tag (1 to 8) to (h, w, c) values."""
    if orientation in (5, 6, 7, 8):
        values = values.transpose(1, 0, 2)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values


def _write_with_oiio(path: Path, values: AnyArray, kind: str) -> None:
    height, width = values.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, kind)
    spec.attribute("DateTime", "")  # else the hour of writing enters the file and equal images differ
    spec.attribute("compression", "zip")
    spec.attribute("oiio:ColorSpace", "lin_rec709_scene" if kind == "float" else "srgb_rec709_scene")
    if path.suffix.lower() in (".tif", ".tiff"):
        spec.attribute("Exif:ColorSpace", 1)  # sRGB; without any Exif entry a false error is reported
    with whole_file(path) as temporary:
        write_through(path, temporary, spec, values)
        _check_written(path, temporary, values)


def write_through(path: Path, temporary: Path, spec: oiio.ImageSpec, values: AnyArray) -> None:
    """Write values by OpenImageIO into `temporary`, which is to become `path`.

    Raises `UnwritableFile`, with OpenImageIO's reason.
    """
    target = oiio.ImageOutput.create(str(temporary))
    if target is None:
        raise UnwritableFile(f"cannot write {path}: {first_line(oiio.geterror())}")
    done = target.open(str(temporary), spec)
    if done:
        done = target.write_image(np.ascontiguousarray(values))
        done = target.close() and done
    if not done or target.has_error:
        reason = first_line(target.geterror()).replace(str(temporary), str(path))
        raise UnwritableFile(f"cannot write {path}: {reason}; is the disk full? Nothing was changed")


def _check_written(path: Path, temporary: Path, values: AnyArray) -> None:
    """Read a new file back: a disk that fills up with the very last block gives OpenImageIO no error."""
    try:
        stored, _, _ = _read_stored(temporary)
    except UnreadableFile as error:
        raise UnwritableFile(
            f"cannot write {path}: it does not read back; is the disk full? Nothing was changed"
        ) from error
    if not np.array_equal(stored, values):
        raise UnwritableFile(f"cannot write {path}: it reads back with other values; nothing was changed")


def _encoded(suffix: str, codes: AnyArray, options: list[int]) -> bytes:
    _, content = cv2.imencode(suffix, np.ascontiguousarray(codes[..., ::-1]), options)
    return bytes(content.tobytes())


def _jpeg_options(quality: int) -> list[int]:
    return [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]


def first_line(text: str) -> str:
    """Give the first line of what a library says of a failure."""
    return text.strip().split("\n")[0].strip() or "no reason given"
