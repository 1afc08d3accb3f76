"""Still images, read and written with exact 8- and 16-bit codes (ours).

OpenImageIO returns a partly filled buffer for some damaged files and converts CMYK to RGB silently. Each file is
therefore checked here: size, complete, one image, known channels, finite values. EXR holds linear light by convention
and is converted to sRGB coding on reading and back on writing. Any other format is taken as sRGB-coded, unless it
declares another colour space (`profiles`). AVIF, which OpenImageIO does not read, is read by libav. HEIC is refused:
libav neither joins the tiles of a phone's picture nor cuts off the edge that pads it.
"""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO as oiio

from morphspace.arrays import AnyArray, Image, Mask
from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.io.colour import check_image, codes_of, linear_of_srgb, srgb_of_linear
from morphspace.io.limits import PICTURE_PX, check_limit
from morphspace.io.names import UNFIT, check_link, check_name
from morphspace.io.profiles import COLOUR_CHUNKS, declare, in_srgb
from morphspace.storage import whole_file

oiio.attribute("threads", 1)  # callers distribute files over processes
oiio.attribute("exr_threads", 1)

# Truncated files of these formats are detected
READ_FORMATS = ("png", "tiff", "jpeg", "openexr", "bmp", "webp", "pnm", "targa", "jpegxl")
WRITE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr")
COLOUR_CHANNELS = (("r", "g", "b"), ("r", "g", "b", "a"), ("y",), ("y", "a"))
# Photometric interpretations: grey, RGB, palette and YCbCr; the others are CMYK or Lab
TIFF_MODELS = (0, 1, 2, 3, 6)
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_QUALITY = 95  # of 100; at 4:4:4 errors stay near one 8-bit code
TRANSPOSED = (5, 6, 7, 8)  # EXIF orientations that exchange width and height
LONGEST_NAME = 200  # bytes; file systems allow 255, including the suffix of a temporary file
RANGES = {  # sRGB-coded; what is beyond was saved with another white, or as -1 to 1
    True: (-3.0, 7.0),  # EXR: renderings keep colours far out, and 7 is 95 times white in linear light
    False: (-0.75, 4.0),  # Display P3 reaches -0.5 in sRGB
}
PRIMARIES = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # xy of Rec. 709 and white, in EXR
PRIMARIES_TOLERANCE = 0.002  # files give three or four digits
BOX = b"ftyp"  # bytes 4 to 8 of AVIF, HEIC and MP4 (ISO 14496-12)
LONGEST_BOX = 256  # bytes; the box lists a few brands of four
AVIF_BRANDS = (b"avif", b"avis")
VIDEO_BRANDS = (b"isom", b"iso2", b"iso5", b"iso6", b"mp41", b"mp42", b"qt  ", b"M4V ", b"avc1", b"dash")
POINTERS = {b"/annex/objects/": "git annex get", b"version https://git-lfs": "git lfs pull"}
GREY_TOLERANCE = 1.5 / 255  # JPEG rounding makes the channels of a grey mask differ by one code


def image_size(path: str | Path) -> tuple[int, int]:
    """Return (width, height) px of the upright image, from the header alone; of AVIF from the picture.

    Raises `UnreadableFile`, and `BadInput` if the image is larger than the limit (`limits.PICTURE_PX`).
    """
    path = Path(path)
    with _legible(path):
        if _is_avif(path):
            return _opened_avif(path)[1]
        source = _open(path)
        spec = source.spec()
        source.close()
        size = (int(spec.width), int(spec.height))
        return (size[1], size[0]) if spec.get_int_attribute("Orientation", 1) in TRANSPOSED else size


def read_image(path: str | Path, *, background: Sequence[float] | None = None) -> Image:
    """Read a still image as (h, w, 3) float32, sRGB-coded; the largest integer code becomes 1.0.

    Grey is repeated to three channels and the camera's orientation tag is applied. Values of float files a
    little outside [0, 1] are kept. Colours in another space, such as Display P3, are converted to sRGB.

    Parameters
    ----------
    path : str or Path
    background : three sRGB-coded values in [0, 1], or None
        The colour behind transparent pixels. An alpha channel that is 1 everywhere is ignored.

    Raises
    ------
    UnreadableFile
        If the file is missing, empty, truncated or not an image.
    BadInput
        If it has transparency and there is no background; if it has CMYK or unknown channels, several images, a
        colour space that cannot be converted, too many pixels, or values that are not finite or far outside [0, 1].

    References
    ----------
    The transfer function of sRGB, for linear `.exr`: IEC 61966-2-1.

    Examples
    --------
    >>> read_image("anna/frame_000.png").shape
    (72, 60, 3)
    """
    path = Path(path)
    if background is not None and not (len(background) == 3 and all(0 <= value <= 1 for value in background)):
        raise BadInput(
            f"the background is {tuple(background)}; expected three values in [0, 1]. Try 0.5 0.5 0.5"
        )
    with _legible(path):
        if _is_avif(path):
            return _read_avif(path)
        values, names, spec = _read_channels(path)
        is_linear = _format_of(spec) == "openexr"
        colour = values[..., :3] if len(names) >= 3 else np.repeat(values[..., :1], 3, axis=2)
        if not is_linear:
            colour = in_srgb(path, colour, spec)
    if names[-1] == "a" and (values[..., -1] < 1).any():
        if background is None:
            raise BadInput(
                f"{path} has an alpha channel that is not opaque (minimum {values[..., -1].min():.3g}; expected 1). "
                "Save it without transparency, or read it in Python with background=(r, g, b)"
            )
        alpha = values[..., -1:]
        behind = np.asarray(background, np.float32)
        if is_linear:
            behind = linear_of_srgb(behind)
        is_straight = spec.get_int_attribute("oiio:UnassociatedAlpha", 0) == 1
        colour = (colour * alpha if is_straight else colour) + (1 - alpha) * behind
    if is_linear:
        colour = srgb_of_linear(colour)
    _check_range(path, colour, RANGES[is_linear])
    return np.ascontiguousarray(colour, dtype=np.float32)


def read_mask(path: str | Path) -> Mask:
    """Read a mask as (h, w) float32 weights in [0, 1]; white is 1. Values of an EXR file are not converted.

    Raises
    ------
    UnreadableFile
        As `read_image` raises it.
    BadInput
        If the image is coloured, has transparency or values outside [0, 1].
    """
    path = Path(path)
    with _legible(path):
        values, names, _ = _read_channels(path)
    if names[-1] == "a":
        if (values[..., -1] < 1).any():
            raise BadInput(
                f"{path} has transparency; expected a grey mask. Save it as plain grey, white for face"
            )
        values = values[..., :-1]
    if np.ptp(values, axis=2).max() > GREY_TOLERANCE:
        raise BadInput(f"{path} is coloured; expected a grey mask. Save it as plain grey, white for face")
    low, high = float(values.min()), float(values.max())
    if low < 0 or high > 1:
        raise BadInput(
            f"{path} holds values from {low:.4g} to {high:.4g}; expected a mask in [0, 1]. Rescale it"
        )
    return np.ascontiguousarray(values[..., 0])


def write_image(path: str | Path, image: Image, *, bits: int = 8) -> int:
    """Write a still image, completely or not at all, and return the number of values that were clipped to [0, 1].

    Parameters
    ----------
    path : str or Path
        The suffix chooses the format: `.png` and `.tif` have 8 or 16 bits, `.jpg` 8 bits (quality 95, 4:4:4), `.exr`
        32-bit
        float in linear light, never clipped. Equal images give equal bytes.
    image : array (h, w, 3), sRGB-coded
    bits : 8 or 16

    Returns
    -------
    int
        As `codes_of` counts; 0 for `.exr`.

    Raises
    ------
    BadInput
        If the image is not (h, w, 3) or not finite, or the format does not have the suffix or bit depth.
    UnwritableFile
        If the folder or disk refuses the file.

    References
    ----------
    The transfer function of sRGB, for linear `.exr`: IEC 61966-2-1.

    Examples
    --------
    >>> import numpy as np
    >>> write_image("grey.png", np.full((2, 3, 3), 0.5, np.float32))
    0
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WRITE_SUFFIXES:
        raise BadInput(
            f"cannot write {path}: the suffix is '{path.suffix}'; expected one of {', '.join(WRITE_SUFFIXES)}. "
            "Rename it"
        )
    if bits not in (8, 16) or (bits == 16 and suffix in (".jpg", ".jpeg")):
        raise BadInput(
            f"cannot write {path} with {bits} bits; expected 8 or 16 for PNG and TIFF, 8 for JPEG. Change the bits"
        )
    check_image(image, str(path))
    if suffix == ".exr":
        _write_with_oiio(path, linear_of_srgb(np.ascontiguousarray(image, dtype=np.float32)), "float")
        return 0
    codes, clipped = codes_of(image, bits)
    if suffix in (".jpg", ".jpeg"):
        # OpenImageIO's JPEG writer ends the process if the disk is full: encode in memory.
        content = _encoded(".jpg", codes, _jpeg_options(JPEG_QUALITY))
        with whole_file(path) as temporary:
            temporary.write_bytes(content)
    else:
        _write_with_oiio(path, codes, codes.dtype.name)
    return clipped


def picture_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the file name of each frame's image, NAME.png, with an underscore for every slash and other mark in
    it that a system does not allow in file names.

    Raises
    ------
    BadInput
        If two frames would share a file, or a name cannot be a file name.

    Examples
    --------
    >>> picture_names(["smile/0001", "neutral"])
    ('smile_0001.png', 'neutral.png')
    """
    files = tuple(f"{UNFIT.sub('_', name.replace('/', '_'))}.png" for name in names)
    for name, file in zip(names, files, strict=True):
        if not name.strip(". ") or len(file.encode()) > LONGEST_NAME or "\0" in name:
            raise BadInput(
                f"the frame {name!r:.60} cannot name an image file; expected at most {LONGEST_NAME} bytes. Rename it"
            )
        if files.count(file) > 1:
            raise BadInput(
                f"{files.count(file)} frames would be written as {file}; expected one. Rename the frames"
            )
    return files


def png_bytes(image: Image) -> bytes:
    """Encode an image (h, w, 3) as 8-bit PNG, for embedding in a page; values are clipped. Raises `BadInput`."""
    check_image(image, "an image as PNG")
    return _encoded(".png", codes_of(image, 8)[0], [])


def jpeg_bytes(image: Image, quality: int = JPEG_QUALITY) -> bytes:
    """Encode an image (h, w, 3) as 4:4:4 JPEG of `quality` 1 to 100; values are clipped. Raises `BadInput`."""
    if not 1 <= quality <= 100:
        raise BadInput(f"the JPEG quality is {quality}; expected 1 to 100. Change it")
    check_image(image, "an image as JPEG")
    return _encoded(".jpg", codes_of(image, 8)[0], _jpeg_options(quality))


@contextlib.contextmanager
def _legible(path: Path) -> Iterator[None]:
    """Raise `UnreadableFile` if a library meets a text of the header that is not UTF-8."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise UnreadableFile(
            f"{path} is damaged: a text in its header is not UTF-8. Copy it again"
        ) from error


def animation_frames(path: Path) -> int:
    """Return the number of frames that a PNG declares in its animation (APNG); 0 for any other file."""
    with path.open("rb") as file:
        if file.read(len(PNG_SIGNATURE)) != PNG_SIGNATURE:
            return 0
        while len(head := file.read(8)) == 8 and head[4:] not in (b"IDAT", b"IEND"):
            if head[4:] == b"acTL":
                return int.from_bytes(file.read(4), "big")
            file.seek(int.from_bytes(head[:4], "big") + 4, 1)
    return 0


def _is_avif(path: Path) -> bool:
    """Return whether a file declares itself as AVIF. Raise `BadInput` if it is a HEIC."""
    try:
        with path.open("rb") as file:
            head = file.read(8)
            brands = file.read(max(0, min(int.from_bytes(head[:4], "big"), LONGEST_BOX) - 8))
    except OSError:
        return False  # `_open` says why
    if head[4:] != BOX or brands[:4] in VIDEO_BRANDS:
        return False
    if not any(brand in brands for brand in AVIF_BRANDS):
        raise BadInput(
            f"{path} is a HEIC picture; expected a format whose tiles and edges libav joins and cuts. Convert it to "
            "PNG or JPEG"
        )
    return True


def _opened_avif(path: Path) -> tuple[Any, tuple[int, int]]:
    """Return the one frame of an AVIF, as stored, and the (width, height) px of its upright picture."""
    import av

    from morphspace.io.video import check_codec, video_info

    try:
        with av.open(str(path.absolute())) as container:
            streams = container.streams.video
            if len(streams) != 1:
                raise BadInput(
                    f"{path} holds {len(streams)} parts, such as tiles or transparency; expected one picture, since "
                    "libav does not join them. Convert it to PNG or JPEG"
                )
            check_codec(path, streams[0])
            _check_size(path, streams[0].codec_context.width, streams[0].codec_context.height)
            frame = next(container.decode(streams[0]), None)
    except (av.FFmpegError, OSError) as error:
        reason = error.strerror or "no reason given"
        raise UnreadableFile(f"{path} is damaged or not a picture: {reason}. Copy it again") from error
    info = video_info(path)
    if frame is None or info.frame_count != 1:
        raise BadInput(
            f"{path} holds {info.frame_count} pictures; expected one. Save that one as a separate file"
        )
    return frame, info.size


def _read_avif(path: Path) -> Image:
    """Read an AVIF of one picture as (h, w, 3), sRGB-coded."""
    from morphspace.io.video import read_frames

    frame, _ = _opened_avif(path)
    try:
        list(frame.side_data)
    except ValueError as error:  # PyAV does not know all kinds of FFmpeg, such as Exif
        raise BadInput(
            f"{path} has metadata that PyAV cannot read, and its colour profile with them. Convert it to PNG or JPEG"
        ) from error
    return next(iter(read_frames(path)))


def _check_size(path: Path, width: int, height: int) -> None:
    check_limit(f"{path}, {width} x {height} px,", width * height, PICTURE_PX, "Scale it down")


def _check_range(path: Path, colour: AnyArray, limits: tuple[float, float]) -> None:
    low, high = float(colour.min()), float(colour.max())
    if low < limits[0] or high > limits[1]:
        raise BadInput(
            f"{path} holds values from {low:.4g} to {high:.4g}, sRGB-coded; expected 0 for black to 1 for white. "
            "Divide by the value of white, and save it again"
        )


def _open(path: Path) -> Any:
    """Open a still image for reading. Raise `UnreadableFile` with one line that states the reason."""
    check_name(path)
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise UnreadableFile(f"{path} is a folder; expected an image. Enter the name of a file")
        with path.open("rb") as file:
            head = file.read(32)
    except OSError as error:
        check_link(path)
        raise UnreadableFile(
            f"cannot read {path}: {error.strerror}. Check the name and the permissions"
        ) from error
    for start, command in POINTERS.items():
        if head.startswith(start):
            raise UnreadableFile(f"{path} is a pointer to a file that is not here. Run `{command}` for it")
    if size == 0:
        raise UnreadableFile(f"{path} is empty (0 bytes). Copy it again")
    wish = oiio.ImageSpec()
    wish.attribute("oiio:UnassociatedAlpha", 1)  # keep colour as stored; read_image composites
    source = oiio.ImageInput.open(str(path), wish)
    if source is None:
        raise UnreadableFile(
            f"{path} ({size} bytes) is not a readable image: {first_line(oiio.geterror())}. Convert it"
        )
    kind = source.format_name()
    if kind not in READ_FORMATS:
        source.close()
        raise UnreadableFile(
            f"{path} is a {kind} file; expected one of {', '.join(READ_FORMATS)}. Convert it"
        )
    spec = source.spec()
    try:
        _check_size(path, spec.width, spec.height)
    except BadInput:
        source.close()
        raise
    return source


def _read_channels(path: Path) -> tuple[AnyArray, tuple[str, ...], Any]:
    """Return upright values (h, w, c) float32, the channel names in the order r g b a or y a, and the header."""
    stored, names, spec = _read_stored(path)
    return _upright(_unit_values(path, stored), spec.get_int_attribute("Orientation", 1)), names, spec


def _read_stored(path: Path) -> tuple[AnyArray, tuple[str, ...], Any]:
    """Return the codes or floats as stored, with channels in order, their names and the header."""
    source = _open(path)
    kind = source.format_name()
    try:
        declared = _colour_chunks(path) if kind == "png" else {}
        spec = source.spec()
        declare(spec, declared)
        order = _check_header(path, spec, kind)
        stored = source.read_image(0, 0, 0, spec.nchannels, "unknown")
        if stored is None or source.has_error:
            # A truncated JPEG returns pixels, with grey for the missing rows, and an error.
            raise UnreadableFile(
                f"{path} is damaged or cut short ({path.stat().st_size} bytes): "
                f"{first_line(source.geterror())}. "
                "Copy it again"
            )
    finally:
        source.close()
    spec.attribute("morphspace:format", kind)
    return stored[..., order], tuple(spec.channelnames[place].lower() for place in order), spec


def _format_of(spec: Any) -> str:
    return str(spec.get_string_attribute("morphspace:format"))


def _check_header(path: Path, spec: Any, kind: str) -> list[int]:
    """Check that the file holds one colour or grey image; return the stored index of each channel of r g b a or y a."""
    probe = _open(path)  # a second reader: after a seek to the second image some readers cannot return
    holds_several = probe.seek_subimage(1, 0)
    probe.geterror()
    probe.close()
    if holds_several:
        raise BadInput(f"{path} holds several pictures; expected one. Save that one as a separate file")
    model = spec.get_string_attribute("jpeg:ColorSpace") or spec.get_string_attribute("tiff:ColorSpace")
    photometric = spec.get_int_attribute("tiff:PhotometricInterpretation", 2)
    if model in ("CMYK", "YCCK") or photometric not in TIFF_MODELS:
        raise BadInput(
            f"{path} is stored as {model or 'an unusual colour model'}; expected RGB or grey. Convert it to sRGB"
        )
    if kind == "openexr" and (spec.width, spec.height) != (spec.full_width, spec.full_height):
        raise BadInput(
            f"{path} has a data window of {spec.width} x {spec.height} px; expected that of its display window, "
            f"{spec.full_width} x {spec.full_height}. Save it so"
        )
    declared = spec.getattribute("chromaticities") if kind == "openexr" else None
    if declared is not None and not np.allclose(declared, PRIMARIES, atol=PRIMARIES_TOLERANCE):
        listed = ", ".join(f"{value:g}" for value in declared)
        raise BadInput(
            f"{path} has the primaries and white {listed}; expected those of sRGB (Rec. 709). Convert it to linear sRGB"
        )
    names = [name.lower() for name in spec.channelnames]
    for wanted in COLOUR_CHANNELS:
        if sorted(names) == sorted(wanted):
            return [names.index(name) for name in wanted]
    raise BadInput(
        f"{path} has the channels {', '.join(spec.channelnames)}; expected R G B or Y. Save it as RGB or grey"
    )


def _colour_chunks(path: Path) -> dict[bytes, bytes]:
    """Return the chunks of a PNG that declare its colour space, by kind, and check all chunks.

    The decoder would print its own messages about damage.
    """
    found = {}
    content = memoryview(path.read_bytes())
    place = len(PNG_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        length = int.from_bytes(content[place : place + 4], "big")
        end = place + 12 + length
        if end > len(content) or place + 12 > len(content):
            raise UnreadableFile(
                f"{path} is cut short: it ends after {len(content)} bytes inside a chunk. Copy it again"
            )
        kind = bytes(content[place + 4 : place + 8])
        if zlib.crc32(content[place + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            raise UnreadableFile(
                f"{path} is damaged: the checksum at byte {end - 4} does not match. Copy it again"
            )
        if kind in COLOUR_CHUNKS:
            found[kind] = bytes(content[place + 8 : end - 4])
        place = end
    return found


def _unit_values(path: Path, stored: AnyArray) -> AnyArray:
    """Scale integer codes to [0, 1] exactly and keep floats. Raise `BadInput` if a value is not finite."""
    if stored.dtype in (np.uint8, np.uint16):
        return stored.astype(np.float32) / np.float32(np.iinfo(stored.dtype).max)
    if stored.dtype.kind != "f":
        raise BadInput(
            f"{path} stores {stored.dtype.name} values; expected 8 or 16 bits, or float. Convert it"
        )
    values = stored.astype(np.float32)
    bad = ~np.isfinite(values)
    if bad.any():
        y, x = np.argwhere(bad.any(axis=2))[0]
        raise BadInput(
            f"{path} holds {int(bad.sum())} values that are not finite, the first at x {x}, y {y}; expected none. "
            "Repair it"
        )
    return values


def _upright(values: AnyArray, orientation: int) -> AnyArray:
    """Apply the EXIF orientation tag (1 to 8) to (h, w, c) values."""
    if orientation in TRANSPOSED:
        values = values.transpose(1, 0, 2)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values


def _write_with_oiio(path: Path, values: AnyArray, kind: str) -> None:
    height, width = values.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, kind)
    spec.attribute("DateTime", "")  # otherwise OpenImageIO writes the current time
    spec.attribute("compression", "zip")
    spec.attribute("oiio:ColorSpace", "lin_rec709_scene" if kind == "float" else "srgb_rec709_scene")
    if path.suffix.lower() in (".tif", ".tiff"):
        spec.attribute("Exif:ColorSpace", 1)  # sRGB; without an Exif entry OpenImageIO reports a false error
    with whole_file(path) as temporary:
        write_through(path, temporary, spec, values)
        _check_written(path, temporary, values)


def write_through(path: Path, temporary: Path, spec: oiio.ImageSpec, values: AnyArray) -> None:
    """Write values with OpenImageIO to `temporary`, which becomes `path`. Raises `UnwritableFile` with its reason."""
    target = oiio.ImageOutput.create(str(temporary))
    if target is None:
        raise UnwritableFile(f"cannot write {path}: {first_line(oiio.geterror())}")
    done = target.open(str(temporary), spec)
    if done:
        done = target.write_image(np.ascontiguousarray(values))
        done = target.close() and done
    if not done or target.has_error:
        reason = first_line(target.geterror()).replace(str(temporary), str(path))
        raise UnwritableFile(
            f"cannot write {path}: {reason}. Check the space on the disk; nothing was changed"
        )


def _check_written(path: Path, temporary: Path, values: AnyArray) -> None:
    """Read a new file back: OpenImageIO reports no error if the disk fills up with the last block."""
    try:
        stored, _, _ = _read_stored(temporary)
    except UnreadableFile as error:
        raise UnwritableFile(
            f"cannot write {path}: it cannot be read back. Check the space on the disk; nothing was changed"
        ) from error
    if not np.array_equal(stored, values):
        raise UnwritableFile(
            f"cannot write {path}: its values change when read back. Check the disk; nothing was changed"
        )


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
    """Return the first line of a library's error message."""
    return text.strip().split("\n")[0].strip() or "no reason given"
