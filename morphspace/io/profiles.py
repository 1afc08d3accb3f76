"""Colour spaces of pictures and videos, converted to sRGB by OpenColorIO (ours).

Phones write pictures in Display P3, cameras in Adobe RGB. Read as sRGB, a P3 picture of skin is too pale by several
codes. OpenColorIO, which OpenImageIO brings, reads ICC profiles of RGB primaries and curves and computes in floats. A
profile of sRGB itself changes nothing. Whatever cannot be converted is refused.
"""

from __future__ import annotations

import os
import struct
import tempfile
import zlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio

from morphspace.arrays import AnyArray
from morphspace.errors import BadInput

BUILT_IN = "ocio://default"  # OpenColorIO's own colour spaces
XYZ, SRGB = "CIE XYZ-D65 - Display-referred", "sRGB - Display"
SAME = 1 / 255  # one 8-bit code; profiles of sRGB with tabulated curves differ from the formula by less
PROBES = 9  # levels per channel at which a profile is compared with sRGB
TAKEN_AS_SRGB = (
    "",
    "Rec709",  # of every PNM
    "srgb_rec709_scene",
    "srgb_rec709_display",
    "g22_rec709_scene",  # a PNG that declares gamma 1/2.2; programs mean sRGB by it
)
CONVERTED = {
    "lin_rec709_scene": "Linear Rec.709 (sRGB)",
    "g18_rec709_scene": "Gamma 1.8 Encoded Rec.709",
    "g24_rec709_scene": "Gamma 2.4 Encoded Rec.709",
    "srgb_p3d65_scene": "sRGB Encoded P3-D65",
    "srgb_p3d65_display": "sRGB Encoded P3-D65",
    "g22_adobergb_scene": "Gamma 2.2 Encoded AdobeRGB",
}
SRGB_SCENE = "sRGB Encoded Rec.709 (sRGB)"
ADVICE = "Convert it to sRGB in the program that wrote it"
COLOUR_CHUNKS = (b"iCCP", b"cICP", b"sRGB")
SRGB_POINTS = bytes([1, 13, 0, 1])  # code points of ISO 23091-2: primaries, curve, matrix, full range
CURVES = ((1,), (2,), (4,), (6,), (13,), (14,), (15,))  # those that programs take as that of sRGB
LARGEST_PROFILE = 16_000_000  # bytes; profiles of printers have 4 million
ADOBE_RGB = "g22_adobergb_scene"
SPACES = {
    0: "",
    1: "",
    2: "",
    4: "",
    5: "",
    6: "",
    7: "",
    12: "srgb_p3d65_scene",
}  # by primaries (ISO 23091-2)
UNCALIBRATED = 65535  # of Exif's ColorSpace
EXIF_BYTES = 65_536  # a JPEG's Exif block is at most so long
ADOBE_MARK = b"R03\0"  # the interoperability index by which a camera says Adobe RGB (DCF 2.0)
SRGB_D50 = {  # primaries of sRGB adapted to D50 (IEC 61966-2-1 and the ICC specification)
    b"rXYZ": (0.4360747, 0.2225045, 0.0139322),
    b"gXYZ": (0.3850649, 0.7168786, 0.0971045),
    b"bXYZ": (0.1430804, 0.0606169, 0.7141733),
}


def declare(spec: Any, chunks: dict[bytes, bytes]) -> None:
    """Add to a header what libpng leaves out: ICC profiles in which it finds a fault, and unusual code points."""
    if b"iCCP" in chunks and b"sRGB" not in chunks and spec.getattribute("ICCProfile") is None:
        profile = _unpacked(chunks[b"iCCP"].partition(b"\0")[2][1:])
        spec.attribute(
            "ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, np.uint8)
        )
    points = tuple(chunks.get(b"cICP", SRGB_POINTS))
    is_srgb = points[:1] == (1,) and points[1:2] in CURVES
    is_taken = spec.get_string_attribute("oiio:ColorSpace") in TAKEN_AS_SRGB
    if points[2:] != (0, 1) or (is_taken and not is_srgb):
        spec.attribute("oiio:ColorSpace", f"of the code points {', '.join(map(str, points))}")


def _unpacked(packed: bytes) -> bytes:
    """Return the profile of an iCCP chunk; what cannot be unpacked is returned as it is, and refused as no profile."""
    try:
        return zlib.decompressobj().decompress(packed, LARGEST_PROFILE) or b"\0"
    except zlib.error:
        return packed or b"\0"


def in_srgb(path: Path, colour: AnyArray, spec: Any) -> AnyArray:
    """Return colours (h, w, 3) as sRGB, by the profile or the colour space that the header of the file declares.

    Colours that sRGB cannot show are clipped to [0, 1]. Raises `BadInput` if they cannot be converted.
    """
    profile = spec.getattribute("ICCProfile")
    if profile is not None:
        return from_profile(path, colour, np.asarray(profile, np.uint8).tobytes())
    name = spec.get_string_attribute("oiio:ColorSpace")
    if spec.get_int_attribute("Exif:ColorSpace", 1) == UNCALIBRATED and _declares_adobe_rgb(path):
        name = ADOBE_RGB
    return from_space(path, colour, name)


def from_space(path: Path, colour: AnyArray, name: str) -> AnyArray:
    """Return colours (h, w, 3) of a space of OpenImageIO as sRGB, clipped to [0, 1] if they are converted.

    Raises `BadInput` if the space is not one that is converted.
    """
    if name in TAKEN_AS_SRGB:
        return colour
    if name not in CONVERTED:
        raise BadInput(f"{path} has the colour space {name}; expected sRGB. {ADVICE}")
    done = oiio.ImageBufAlgo.colorconvert(
        _buffer(colour), CONVERTED[name], SRGB_SCENE, unpremult=False, colorconfig=_config(), nthreads=1
    )
    return _values_of(path, done, name)


def from_primaries(path: Path, colour: AnyArray, primaries: int) -> AnyArray:
    """Return colours (h, w, 3) of the primaries that a video or an AVIF declares as sRGB; raises as `from_space`.

    Those of television are taken as sRGB's: standard definition differs by a few codes in strong colours.
    """
    return from_space(path, colour, SPACES.get(primaries, "of unusual primaries"))


def from_profile(path: Path, colour: AnyArray, profile: bytes) -> AnyArray:
    """Return colours (h, w, 3) of an ICC profile as sRGB; those of an sRGB profile are returned as they are.

    Raises `BadInput` if the profile is neither of RGB nor of grey, or cannot be used.
    """
    kind = profile[16:20]
    if kind == b"GRAY" and (colour[..., :1] == colour).all():
        profile = _rgb_of_grey(path, profile)
    elif kind != b"RGB ":
        raise BadInput(
            f"{path} has a colour profile of {kind.decode('latin-1').strip()!r}; expected RGB or grey. {ADVICE}"
        )
    if _is_srgb(profile):
        return colour
    converted = _converted(path, colour, profile)
    return np.repeat(converted[..., 1:2], 3, axis=2) if kind == b"GRAY" else converted


@lru_cache(maxsize=64)
def _is_srgb(profile: bytes) -> bool:
    """Return whether a profile changes no colour by a code of 8 bits; False if it cannot be used."""
    levels = np.linspace(0, 1, PROBES, dtype=np.float32)
    probes = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(1, -1, 3)
    try:
        return bool(np.abs(_converted(Path(), probes, profile) - probes).max() < SAME)
    except BadInput:
        return False


def _converted(path: Path, colour: AnyArray, profile: bytes) -> AnyArray:
    with tempfile.TemporaryDirectory() as folder:  # OpenColorIO reads profiles from files only
        file = Path(folder) / "profile.icc"
        file.write_bytes(profile)
        seen = oiio.ImageBufAlgo.ociofiletransform(
            _buffer(colour), str(file), unpremult=False, inverse=True, colorconfig=_config(), nthreads=1
        )
    if seen.has_error:
        seen.geterror()
        raise BadInput(
            f"{path} has a colour profile that OpenColorIO cannot use; expected primaries and curves. {ADVICE}"
        )
    done = oiio.ImageBufAlgo.colorconvert(seen, XYZ, SRGB, unpremult=False, colorconfig=_config(), nthreads=1)
    return _values_of(path, done, "of its profile")


def _config() -> str:
    """Return the name of the built-in spaces if $OCIO names others; empty otherwise, as a name is loaded each time."""
    return BUILT_IN if os.environ.get("OCIO") else ""


def _buffer(colour: AnyArray) -> Any:
    return oiio.ImageBuf(np.ascontiguousarray(colour, np.float32))


def _values_of(path: Path, done: Any, name: str) -> AnyArray:
    if done.has_error:
        raise BadInput(
            f"{path} has the colour space {name}, which OpenColorIO cannot convert; expected sRGB. {ADVICE}"
        )
    return np.clip(done.get_pixels(oiio.FLOAT), 0, 1)


def _rgb_of_grey(path: Path, profile: bytes) -> bytes:
    """Return an RGB profile with the curve of a grey one; OpenColorIO reads no grey profile."""
    try:
        (count,) = struct.unpack_from(">I", profile, 128)
        entries = [struct.unpack_from(">4sII", profile, 132 + 12 * place) for place in range(min(count, 100))]
        curve = next(profile[start : start + size] for name, start, size in entries if name == b"kTRC")
    except (struct.error, StopIteration) as error:
        raise BadInput(f"{path} has a grey profile without a curve; expected one. {ADVICE}") from error
    places = {
        name: b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(value * 65536) for value in xyz))
        for name, xyz in SRGB_D50.items()
    }
    tags = {**places, **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve + bytes(-len(curve) % 4))}
    start = 132 + 12 * len(tags)
    table = b""
    for name, data in tags.items():
        table += struct.pack(">4sII", name, start, len(data))
        start += len(data)
    head = struct.pack(">I", start) + profile[4:16] + b"RGB " + profile[20:128]
    return head + struct.pack(">I", len(tags)) + table + b"".join(tags.values())


def _declares_adobe_rgb(path: Path) -> bool:
    with path.open("rb") as file:
        return ADOBE_MARK in file.read(EXIF_BYTES)
