"""Laws of colour spaces: a declared space is converted as littlecms does, sRGB stays bit for bit, the rest is refused.

The ICC profiles are written here from published primaries (SMPTE EG 432-1, Adobe RGB 1998) and curves.
"""

import io
import os
import struct
import subprocess
import sys
import zlib
from fractions import Fraction

import av
import numpy as np
import OpenImageIO as oiio
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image as Pillow
from PIL import ImageCms

from morphspace.errors import BadInput
from morphspace.io.colour import srgb_of_linear
from morphspace.io.images import read_image, read_mask
from morphspace.io.video import read_frames

CODES = np.random.default_rng(3).integers(0, 256, (40, 30, 3), dtype=np.uint8)
PLAIN = CODES.astype(np.float32) / np.float32(255)
ROUNDING = 0.65 / 255  # littlecms answers in 8 bits: half a code, and a little for its tables


def s15(value):
    return struct.pack(">i", round(value * 65536))


def gamma(value):
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(value * 256)) + b"\0\0"


SRGB_CURVE = b"para\0\0\0\0\0\3\0\0" + b"".join(map(s15, (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))


def profile(name, primaries, curve, space=b"RGB "):
    """An ICC profile of primaries (XYZ, adapted to D50) and one curve."""
    text = name.encode() + b"\0"
    tags = {
        b"desc": b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(78),
        b"cprt": b"text\0\0\0\0none\0",
        b"wtpt": b"XYZ \0\0\0\0" + s15(0.9642) + s15(1) + s15(0.8249),
    }
    for channel, place in zip((b"r", b"g", b"b"), primaries, strict=True) if primaries else ():
        tags[channel + b"XYZ"] = b"XYZ \0\0\0\0" + b"".join(map(s15, place))
        tags[channel + b"TRC"] = curve
    if not primaries:
        tags[b"kTRC"] = curve
    table, data, start = b"", b"", 132 + 12 * len(tags)
    for key, value in tags.items():
        table += key + struct.pack(">II", start + len(data), len(value))
        data += value + bytes(-len(value) % 4)
    version = 0x02400000 if curve[:4] == b"curv" else 0x04300000
    head = (
        struct.pack(">I", start + len(data))
        + b"lcms"
        + struct.pack(">I", version)
        + b"mntr"
        + space
        + b"XYZ "
    )
    head += bytes(12) + b"acsp" + bytes(28) + s15(0.9642) + s15(1) + s15(0.8249) + bytes(48)
    return head + struct.pack(">I", len(tags)) + table + data


P3 = profile(
    "Display P3",
    [(0.51512, 0.2412, -0.00105), (0.29198, 0.69225, 0.04189), (0.1571, 0.06657, 0.78407)],
    SRGB_CURVE,
)
ADOBE = profile(
    "Adobe RGB (1998)",
    [(0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457)],
    gamma(2.19921875),
)
GREY = profile("Grey, gamma 1.8", None, gamma(1.8), b"GRAY")
SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def littlecms(icc, picture, mode="RGB"):
    source = ImageCms.ImageCmsProfile(io.BytesIO(icc))
    colorimetric = ImageCms.Intent.RELATIVE_COLORIMETRIC
    transform = ImageCms.buildTransform(
        source, ImageCms.createProfile("sRGB"), mode, "RGB", renderingIntent=colorimetric
    )
    return np.asarray(ImageCms.applyTransform(picture, transform), np.float32) / 255


@pytest.mark.parametrize("icc", [P3, ADOBE], ids=["Display P3", "Adobe RGB"])
@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.jpg", "a.webp", "a.avif"])
def test_a_picture_of_another_space_is_converted_as_littlecms_does(tmp_path, icc, name):
    options = {
        ".webp": {"lossless": True},
        ".jpg": {"quality": 95},
        ".avif": {"quality": 95, "subsampling": "4:4:4"},
    }
    smooth = Pillow.fromarray(CODES[:5, :4]).resize((40, 30), Pillow.Resampling.BICUBIC)
    smooth.save(tmp_path / f"plain_{name}", **options.get(name[1:], {}))
    smooth.save(tmp_path / name, icc_profile=icc, **options.get(name[1:], {}))
    stored = Pillow.fromarray(np.rint(read_image(tmp_path / f"plain_{name}") * 255).astype(np.uint8))
    image = read_image(tmp_path / name)
    assert_allclose(image, littlecms(icc, stored), atol=ROUNDING)
    assert np.abs(image - np.asarray(stored) / 255).max() > 20 / 255


def test_a_profile_keeps_the_depth_of_the_file(tmp_path):
    deep = np.full((4, 4, 3), 30_001, np.uint16)
    spec = oiio.ImageSpec(4, 4, 3, "uint16")
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(P3)}]"), np.frombuffer(P3, np.uint8))
    target = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    assert target.open(str(tmp_path / "a.tif"), spec) and target.write_image(deep) and target.close()
    image = read_image(tmp_path / "a.tif")
    assert_allclose(image, 30_001 / 65535, atol=2e-5)  # grey is grey in both; the primaries have five digits


def test_the_colour_spaces_of_other_programs_do_not_matter(tmp_path):
    """$OCIO names the spaces of a film studio for all programs of a machine; OpenImageIO reads it once."""
    Pillow.fromarray(CODES).save(tmp_path / "a.png", icc_profile=P3)
    read = "import sys; from morphspace.io.images import read_image; print(read_image(sys.argv[1]).tobytes().hex())"
    words = [sys.executable, "-c", read, str(tmp_path / "a.png")]
    (tmp_path / "raw.ocio").write_text(
        "ocio_profile_version: 2\nroles: {default: raw}\ndisplays: {d: [!<View> {name: v, colorspace: raw}]}\n"
        "colorspaces: [!<ColorSpace> {name: raw, isdata: true}]\n"
    )
    for named in (tmp_path / "raw.ocio", "ocio://default"):
        found = subprocess.run(words, env={**os.environ, "OCIO": str(named)}, capture_output=True, text=True)
        assert found.stdout.strip() == read_image(tmp_path / "a.png").tobytes().hex(), found.stderr


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.webp"])
def test_a_profile_of_srgb_changes_no_bit(tmp_path, name):
    options = {"lossless": True} if name == "a.webp" else {}
    tabulated = b"curv\0\0\0\0" + struct.pack(">I", 1024)
    levels = np.linspace(0, 1, 1024)
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    tabulated += np.rint(linear * 65535).astype(">u2").tobytes()
    places = [(0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410)]
    for icc in (SRGB, profile("sRGB IEC61966-2.1", places, tabulated)):
        Pillow.fromarray(CODES).save(tmp_path / name, icc_profile=icc, **options)
        assert_array_equal(read_image(tmp_path / name), PLAIN)


def test_a_grey_profile_is_converted_and_a_mask_keeps_its_weights(tmp_path):
    grey = Pillow.fromarray(CODES[..., 0])
    grey.save(tmp_path / "a.png", icc_profile=GREY)
    image = read_image(tmp_path / "a.png")
    assert (image[..., :1] == image).all()
    wanted = srgb_of_linear(PLAIN[..., 0] ** np.float32(1.8))
    assert_allclose(image[..., 0], wanted, atol=1e-3)  # the profile has 461/256
    assert_allclose(image, littlecms(GREY, grey, "L"), atol=1.5 / 255)  # it rounds lightness to 8 bits
    assert np.abs(image[..., 0] - PLAIN[..., 0]).max() > 5 / 255
    assert_array_equal(read_mask(tmp_path / "a.png"), PLAIN[..., 0])


@pytest.mark.parametrize(
    ("icc", "words"),
    [
        (P3[:300], "OpenColorIO cannot use"),
        (profile("x", None, gamma(2), b"Lab "), "a colour profile of 'Lab'"),
        (profile("x", [(1, 1, 1)] * 3, b"mft2" + bytes(40)), "OpenColorIO cannot use"),
        (GREY.replace(b"kTRC", b"xTRC"), "a colour profile of 'GRAY'; expected RGB or grey|without a curve"),
    ],
)
def test_a_profile_that_cannot_be_used_is_refused(tmp_path, icc, words):
    picture = Pillow.fromarray(CODES[..., 0] if b"GRAY" in icc else CODES)
    picture.save(tmp_path / "a.tif", icc_profile=icc)
    with pytest.raises(BadInput, match=words) as caught:
        read_image(tmp_path / "a.tif")
    assert "a.tif" in str(caught.value) and "\n" not in str(caught.value)


def with_chunk(path, kind, data):
    """Put a chunk into a PNG before its picture."""
    content = path.read_bytes()
    place = content.index(b"IDAT") - 4
    chunk = struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    path.write_bytes(content[:place] + chunk + content[place:])


@pytest.mark.parametrize(
    ("kind", "data", "wanted"),
    [
        (b"gAMA", struct.pack(">I", 45455), PLAIN),
        (b"gAMA", struct.pack(">I", 100_000), srgb_of_linear(PLAIN)),
        (b"gAMA", struct.pack(">I", 55_556), srgb_of_linear(PLAIN**1.8)),
        (b"cICP", bytes([1, 13, 0, 1]), PLAIN),
    ],
)
def test_a_png_may_declare_its_curve(tmp_path, kind, data, wanted):
    Pillow.fromarray(CODES).save(tmp_path / "a.png")
    with_chunk(tmp_path / "a.png", kind, data)
    assert_allclose(read_image(tmp_path / "a.png"), wanted, atol=1e-4)


def test_a_png_that_declares_p3_is_the_picture_of_that_profile(tmp_path):
    for name in ("code.png", "profile.png"):
        Pillow.fromarray(CODES).save(tmp_path / name, icc_profile=P3 if name == "profile.png" else None)
    with_chunk(tmp_path / "code.png", b"cICP", bytes([12, 13, 0, 1]))
    assert_allclose(read_image(tmp_path / "code.png"), read_image(tmp_path / "profile.png"), atol=1e-3)


def test_a_png_of_hdr_is_refused(tmp_path):
    Pillow.fromarray(CODES).save(tmp_path / "a.png")
    with_chunk(tmp_path / "a.png", b"cICP", bytes([9, 16, 0, 1]))
    with pytest.raises(BadInput, match="the colour space pq_rec2020_display; expected sRGB"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("points", [(9, 1, 0, 1), (1, 13, 0, 0), (12,), ()])
def test_code_points_of_a_png_are_never_passed_over(tmp_path, points):
    Pillow.fromarray(CODES).save(tmp_path / "a.png")
    with_chunk(tmp_path / "a.png", b"cICP", bytes(points))
    with pytest.raises(BadInput, match=r"a\.png has the colour space .*; expected sRGB"):
        read_image(tmp_path / "a.png")


def test_a_profile_that_libpng_drops_is_not_passed_over(tmp_path):
    """libpng passes over a damaged profile, and over one of RGB in a grey picture, and reads the codes as they are."""
    for name, icc in (("cut.png", P3[:-60]), ("junk.png", b"junk" * 100)):
        Pillow.fromarray(CODES).save(tmp_path / name, icc_profile=icc)
        with pytest.raises(BadInput, match=rf"{name} has a colour profile"):
            read_image(tmp_path / name)
    grey = Pillow.fromarray(CODES[..., 0])
    for name, icc in (("same.png", SRGB), ("adobe.png", ADOBE)):
        grey.save(tmp_path / name, icc_profile=icc)
    assert_array_equal(read_image(tmp_path / "same.png"), np.repeat(PLAIN[..., :1], 3, axis=2))
    assert_allclose(read_image(tmp_path / "adobe.png"), littlecms(ADOBE, grey.convert("RGB")), atol=ROUNDING)


def test_a_video_of_another_space_is_converted_as_littlecms_does(tmp_path):
    smooth = Pillow.fromarray(CODES[:5, :4]).resize((40, 30), Pillow.Resampling.BICUBIC)
    for name, primaries in (("p3.mkv", 12), ("plain.mkv", 1)):
        write_primaries(tmp_path / name, np.asarray(smooth), primaries)
    assert_allclose(next(read_frames(tmp_path / "p3.mkv")), littlecms(P3, smooth), atol=ROUNDING)
    assert_array_equal(next(read_frames(tmp_path / "plain.mkv")), np.asarray(smooth, np.float32) / 255)


def test_the_profile_of_a_motion_jpeg_is_converted(tmp_path):
    smooth = Pillow.fromarray(CODES[:5, :4]).resize((40, 30), Pillow.Resampling.BICUBIC)
    for name, icc in (("p3", P3), ("plain", None)):
        smooth.save(tmp_path / f"{name}.jpg", quality=95, subsampling="4:4:4", icc_profile=icc)
        with av.open(str(tmp_path / f"{name}.mkv"), "w") as container:
            stream = container.add_stream("mjpeg", rate=25)
            stream.pix_fmt, stream.width, stream.height = "yuvj444p", 40, 30
            packet = av.Packet((tmp_path / f"{name}.jpg").read_bytes())
            packet.stream, packet.pts, packet.dts, packet.time_base = stream, 0, 0, Fraction(1, 25)
            container.mux(packet)
    plain = next(read_frames(tmp_path / "plain.mkv"))
    stored = Pillow.fromarray(np.rint(plain * 255).astype(np.uint8))
    assert_allclose(next(read_frames(tmp_path / "p3.mkv")), littlecms(P3, stored), atol=ROUNDING)


@pytest.mark.parametrize("primaries", [8, 9, 11])
def test_a_video_of_primaries_that_are_not_converted_is_refused(tmp_path, primaries):
    write_primaries(tmp_path / "a.mkv", CODES, primaries)
    with pytest.raises(BadInput, match=r"a\.mkv has the colour space of unusual primaries; expected sRGB"):
        next(read_frames(tmp_path / "a.mkv"))


def test_an_animated_png_with_a_profile_is_refused_and_does_not_crash(tmp_path):
    """PyAV frees the profile's name twice, which ended the process."""
    frames = [Pillow.fromarray(np.roll(CODES, shift, axis=0)) for shift in range(3)]
    for name, icc in (("plain.apng", None), ("p3.apng", P3)):
        frames[0].save(
            tmp_path / name, format="PNG", save_all=True, append_images=frames[1:], icc_profile=icc
        )
    assert len(list(read_frames(tmp_path / "plain.apng"))) == 3
    for _ in range(5):
        with pytest.raises(BadInput, match=r"p3\.apng has a colour profile in its PNG frames"):
            list(read_frames(tmp_path / "p3.apng"))


def write_primaries(path, codes, primaries):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.pix_fmt = "bgr0"
        stream.height, stream.width = codes.shape[:2]
        stream.codec_context.color_primaries = primaries
        picture = av.VideoFrame.from_ndarray(codes, format="rgb24")
        container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def test_adobe_rgb_of_a_camera_without_a_profile_is_converted(tmp_path):
    exif = Pillow.Exif()
    exif[0x8769] = {0xA001: 65535, 0xA005: {1: "R03"}}
    Pillow.fromarray(CODES[:1, :1]).resize((16, 16)).save(tmp_path / "a.jpg", quality=100, exif=exif)
    stored = Pillow.open(tmp_path / "a.jpg").convert("RGB")
    assert_allclose(read_image(tmp_path / "a.jpg"), littlecms(ADOBE, stored), atol=ROUNDING)
    exif[0x8769] = {0xA001: 65535}
    Pillow.fromarray(CODES[:1, :1]).resize((16, 16)).save(tmp_path / "b.jpg", quality=100, exif=exif)
    assert_allclose(read_image(tmp_path / "b.jpg"), np.asarray(stored, np.float32) / 255, atol=1e-6)


def test_an_exr_of_other_primaries_is_refused(tmp_path):
    for name, primaries in (
        ("ours.exr", (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)),
        ("p3.exr", (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)),
    ):
        spec = oiio.ImageSpec(30, 40, 3, "float")
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), primaries)
        target = oiio.ImageOutput.create(str(tmp_path / name))
        assert target.open(str(tmp_path / name), spec) and target.write_image(PLAIN) and target.close()
    assert_allclose(read_image(tmp_path / "ours.exr"), srgb_of_linear(PLAIN), atol=1e-6)
    with pytest.raises(
        BadInput, match=r"p3\.exr has the primaries and white 0\.68, .* expected those of sRGB"
    ):
        read_image(tmp_path / "p3.exr")
