"""Laws of stills: codes are exact, nothing is ignored, damage is noticed, and a file is whole or as it was.

Files of other programs come from Pillow and OpenCV, which judge ours in turn.
"""

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import ExifTags, ImageOps
from PIL import Image as Pillow

from morphspace.errors import BadInput, UnreadableFile, UnwritableFile
from morphspace.io import images
from morphspace.io.colour import linear_of_srgb, srgb_of_linear
from morphspace.io.images import image_size, jpeg_bytes, png_bytes, read_image, read_mask, write_image

RNG = np.random.default_rng(11)
CODES = RNG.integers(0, 256, (30, 22, 3), dtype=np.uint8)
ALPHA = RNG.integers(0, 255, (30, 22), dtype=np.uint8)
SMOOTH = cv2.resize(RNG.random((6, 5, 3)).astype(np.float32), (100, 120), interpolation=cv2.INTER_CUBIC).clip(
    0, 1
)
OIIO_KINDS = {"uint8": "uint8", "float32": "float"}
EVERY_SUFFIX = (".png", ".tif", ".jpg", ".exr")


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def unit(codes):
    return codes.astype(np.float32) / np.float32(np.iinfo(codes.dtype).max)


def write_channels(path, values, names, **attributes):
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], OIIO_KINDS[values.dtype.name])
    spec.channelnames = names
    for name, value in attributes.items():
        spec.attribute(name, value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec) and target.write_image(values) and target.close()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_every_code_round_trips_exactly(tmp_path, suffix, kind):
    top = np.iinfo(kind).max
    codes = np.repeat(np.arange(top + 1, dtype=kind).reshape(-1, 256)[..., None], 3, axis=2)
    assert write_image(tmp_path / f"a{suffix}", unit(codes), bits=8 * kind().itemsize) == 0
    image = read_image(tmp_path / f"a{suffix}")
    assert image.dtype == np.float32
    assert_array_equal(image, unit(codes))
    assert image.max() == 1.0
    assert_array_equal(cv2.imread(str(tmp_path / f"a{suffix}"), cv2.IMREAD_UNCHANGED), codes)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".webp", ".ppm", ".tga"])
def test_another_programs_colours_are_read_exactly_and_in_order(tmp_path, suffix):
    Pillow.fromarray(CODES).save(tmp_path / f"a{suffix}", **({"lossless": True} if suffix == ".webp" else {}))
    assert_array_equal(read_image(tmp_path / f"a{suffix}"), unit(CODES))


def test_jpeg_stays_near_the_source(tmp_path):
    write_image(tmp_path / "a.jpg", SMOOTH)
    assert_allclose(
        read_image(tmp_path / "a.jpg"), SMOOTH, atol=8 / 255
    )  # codes: smooth colour at quality 95
    with Pillow.open(tmp_path / "a.jpg") as theirs:
        assert_allclose(unit(np.asarray(theirs)), SMOOTH, atol=8 / 255)
        assert [layer[1:3] for layer in theirs.layer] == [(1, 1)] * 3  # 4:4:4


def test_exr_keeps_values_outside_the_unit_range(tmp_path):
    image = RNG.uniform(-2, 3, (9, 7, 3)).astype(np.float32)
    assert write_image(tmp_path / "a.exr", image) == 0
    assert_allclose(read_image(tmp_path / "a.exr"), image, atol=2e-6)  # float32 rounding through the curve


def test_exr_holds_linear_light(tmp_path):
    write_image(tmp_path / "a.exr", np.full((2, 2, 3), 0.5, np.float32))
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    assert_allclose(source.read_image("float"), 0.21404114, atol=1e-6)  # sRGB 0.5, IEC 61966-2-1
    source.close()


def test_the_srgb_curve_inverts_rises_and_is_odd():
    values = np.linspace(-3, 3, 6001)
    assert_allclose(
        srgb_of_linear(linear_of_srgb(values)), values, atol=1e-6
    )  # the standard's own rounded knee
    assert (np.diff(linear_of_srgb(values)) > 0).all()
    assert_array_equal(linear_of_srgb(-values), -linear_of_srgb(values))


@pytest.mark.parametrize("names", [("B", "G", "R"), ("G", "R", "B"), ("b", "r", "g"), ("A", "B", "G", "R")])
def test_channels_are_found_by_name(tmp_path, names):
    linear = {"R": 0.1, "G": 0.2, "B": 0.3, "A": 1.0}
    values = np.ones((3, 4, 1), np.float32) * np.array([linear[name.upper()] for name in names], np.float32)
    write_channels(tmp_path / "a.exr", values, names)
    expected = srgb_of_linear(np.array([0.1, 0.2, 0.3], np.float32))
    assert_array_equal(read_image(tmp_path / "a.exr"), np.broadcast_to(expected, (3, 4, 3)))


def test_the_order_of_names_decides_even_where_the_library_sorts_nothing(tmp_path, monkeypatch):
    # OpenImageIO sorts R G B itself today; a spec that says otherwise has to be believed
    write_image(tmp_path / "a.png", unit(CODES))
    real = images._check_header

    def as_if_stored_backwards(path, spec, kind):
        spec.channelnames = ("B", "G", "R")
        return real(path, spec, kind)

    monkeypatch.setattr(images, "_check_header", as_if_stored_backwards)
    assert_array_equal(read_image(tmp_path / "a.png"), unit(CODES[..., ::-1]))


@pytest.mark.parametrize(
    "names", [("X", "Y", "Z"), ("left.R", "left.G", "left.B"), ("R", "G", "B", "Z"), ("Z",)]
)
def test_unusual_channels_are_refused(tmp_path, names):
    write_channels(tmp_path / "a.exr", np.zeros((3, 4, len(names)), np.float32), names)
    with pytest.raises(BadInput, match=rf"a\.exr has the channels .*{names[-1]}"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(tmp_path, bad):
    values = np.zeros((5, 6, 3), np.float32)
    values[3, 2, 1] = bad
    write_channels(tmp_path / "a.exr", values, ("R", "G", "B"))
    with pytest.raises(BadInput, match=r"a\.exr holds 1 values that are not finite, the first at x 2, y 3"):
        read_image(tmp_path / "a.exr")
    for suffix in EVERY_SUFFIX:
        with pytest.raises(BadInput, match="1 of its values are not finite"):
            write_image(tmp_path / f"new{suffix}", values)
    assert names_in(tmp_path) == ["a.exr"]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
def test_grey_is_repeated(tmp_path, suffix):
    Pillow.fromarray(CODES[..., 0]).save(tmp_path / f"a{suffix}")
    image = read_image(tmp_path / f"a{suffix}")
    assert image.shape == (30, 22, 3)
    assert_array_equal(image[..., 0], image[..., 2])
    if suffix != ".jpg":
        assert_array_equal(image[..., 1], unit(CODES[..., 0]))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("channels", [2, 4])
def test_transparency_is_refused_or_composited_never_ignored(tmp_path, suffix, channels):
    path = tmp_path / f"a{suffix}"
    Pillow.fromarray(np.dstack([CODES[..., : channels - 1], ALPHA])).save(path)
    with pytest.raises(BadInput, match=r"alpha channel that is not opaque.*background"):
        read_image(path)
    colour = unit(CODES[..., : channels - 1])
    alpha = unit(ALPHA)[..., None]
    over = colour * alpha + (1 - alpha) * np.array([1, 0.5, 0.25])
    assert_allclose(read_image(path, background=(1, 0.5, 0.25)), over, atol=1e-6)  # float32 rounding


def test_opaque_alpha_is_dropped(tmp_path):
    Pillow.fromarray(np.dstack([CODES, np.full_like(ALPHA, 255)])).save(tmp_path / "a.png")
    assert_array_equal(read_image(tmp_path / "a.png"), unit(CODES))


def test_premultiplied_exr_is_composited_in_linear_light(tmp_path):
    values = np.tile(np.array([0.2, 0.1, 0.0, 0.5], np.float32), (3, 4, 1))
    write_channels(tmp_path / "a.exr", values, ("R", "G", "B", "A"))
    linear = np.array([0.2, 0.1, 0]) + 0.5 * linear_of_srgb(np.array([0.5, 0.5, 1.0]))
    image = read_image(tmp_path / "a.exr", background=(0.5, 0.5, 1))
    assert_allclose(image[1, 1], srgb_of_linear(linear), atol=1e-6)  # float32 rounding


@pytest.mark.parametrize("background", [(1, 2, 0), (0, 0), (0, 0, float("nan"))])
def test_a_background_that_is_no_colour_is_refused(tmp_path, background):
    write_image(tmp_path / "a.png", SMOOTH)
    with pytest.raises(BadInput, match="background"):
        read_image(tmp_path / "a.png", background=background)


@pytest.mark.parametrize(("mode", "suffix"), [("CMYK", ".jpg"), ("CMYK", ".tif"), ("LAB", ".tif")])
def test_ink_and_lab_are_refused(tmp_path, mode, suffix):
    Pillow.fromarray(CODES).convert(mode).save(tmp_path / f"a{suffix}")
    with pytest.raises(BadInput, match=r"stored as (CMYK|CIELAB); expected RGB"):
        read_image(tmp_path / f"a{suffix}")


def test_a_palette_gives_its_colours(tmp_path):
    picture = Pillow.fromarray(CODES).convert("P")
    picture.save(tmp_path / "a.png")
    assert_array_equal(read_image(tmp_path / "a.png"), unit(np.asarray(picture.convert("RGB"))))


def test_several_pictures_in_a_file_are_refused(tmp_path):
    Pillow.fromarray(CODES).save(tmp_path / "a.tif", save_all=True, append_images=[Pillow.fromarray(CODES)])
    with pytest.raises(BadInput, match="several pictures"):
        read_image(tmp_path / "a.tif")


def test_whole_numbers_of_32_bits_are_refused(tmp_path):
    Pillow.fromarray(CODES[..., 0].astype(np.int32)).save(tmp_path / "a.tif")
    with pytest.raises(BadInput, match="int32"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("orientation", [*range(10), 90])  # 1 to 8 are defined; others mean nothing
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_orientation_is_applied(tmp_path, orientation, suffix):
    path = tmp_path / f"a{suffix}"
    exif = Pillow.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Pillow.fromarray(CODES).save(path, exif=exif)
    with Pillow.open(path) as picture:
        upright = np.asarray(ImageOps.exif_transpose(picture))
    assert_array_equal(read_image(path), unit(upright))
    assert image_size(path) == (upright.shape[1], upright.shape[0])


@pytest.mark.parametrize("suffix", EVERY_SUFFIX)
def test_size_is_width_then_height(tmp_path, suffix):
    write_image(tmp_path / f"a{suffix}", SMOOTH)
    assert image_size(tmp_path / f"a{suffix}") == (100, 120)


def test_an_exr_of_part_of_a_picture_is_refused(tmp_path):
    spec = oiio.ImageSpec(4, 4, 3, "float")
    spec.full_width, spec.full_height = 8, 8
    target = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    target.open(str(tmp_path / "a.exr"), spec)
    target.write_image(np.zeros((4, 4, 3), np.float32))
    target.close()
    with pytest.raises(BadInput, match=r"data window of 4 x 4 px; .* 8 x 8"):
        read_image(tmp_path / "a.exr")


@pytest.mark.parametrize("suffix", [*EVERY_SUFFIX, ".bmp", ".webp", ".ppm", ".tga"])
@pytest.mark.parametrize("share", [0, 0.02, 0.3, 0.6, 0.9, 0.99, 0.999])
def test_truncated_files_are_named(tmp_path, suffix, share, capfd):
    path = tmp_path / f"cut{suffix}"
    if suffix in EVERY_SUFFIX:
        write_image(path, SMOOTH)
    else:
        Pillow.fromarray((SMOOTH * 255).astype(np.uint8)).save(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(UnreadableFile) as caught:
        read_image(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # no decoder talks to the terminal behind our back


@pytest.mark.parametrize("compression", ["none", "lzw", "zip"])
@pytest.mark.parametrize("share", [0.3, 0.9, 0.999])
def test_truncated_tiff_of_every_compression_is_named(tmp_path, compression, share):
    write_channels(
        tmp_path / "cut.tif", (SMOOTH * 255).astype(np.uint8), ("R", "G", "B"), compression=compression
    )
    content = (tmp_path / "cut.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(content[: int(len(content) * share)])
    with pytest.raises(UnreadableFile, match=r"cut\.tif"):
        read_image(tmp_path / "cut.tif")


def test_progressive_jpeg_cut_short_is_named(tmp_path):
    Pillow.fromarray((SMOOTH * 255).astype(np.uint8)).save(tmp_path / "cut.jpg", progressive=True)
    content = (tmp_path / "cut.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(content[: len(content) // 2])
    with pytest.raises(UnreadableFile, match=r"cut\.jpg is damaged or cut short"):
        read_image(tmp_path / "cut.jpg")


def test_a_flipped_byte_in_a_png_is_noticed(tmp_path, capfd):
    write_image(tmp_path / "a.png", SMOOTH)
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(UnreadableFile, match=r"a\.png is damaged"):
        read_image(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "suffix", [".png", ".tif", ".jpg", ".webp", ".bmp", ".exr", ".jxl", ".avif", ".ppm", ".tga"]
)
def test_only_our_errors_leave_a_damaged_picture(tmp_path, suffix, monkeypatch):
    """Bytes are replaced, more often in the header, and files are cut."""
    monkeypatch.setenv("MORPHSPACE_LARGEST_PICTURE_PX", "1000000")
    path = tmp_path / f"a{suffix}"
    if suffix in (".exr", ".jxl"):
        write_channels(path, unit(CODES) if suffix == ".exr" else CODES, ("R", "G", "B"))
    else:
        Pillow.fromarray(CODES).save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    for trial in range(60):
        damaged = bytearray(whole)
        for _ in range(rng.choice([1, 3, 10])):
            damaged[rng.integers(len(whole) if trial % 2 else min(len(whole), 200))] = rng.integers(256)
        path.write_bytes(damaged[: rng.integers(len(whole)) if trial % 3 == 0 else None])
        for read in (read_image, image_size, read_mask):
            try:
                read(path)
            except BadInput as error:
                assert str(error).count("\n") == 0


def test_what_is_not_an_image_is_named(tmp_path):
    (tmp_path / "text.png").write_text("this is no picture")
    Pillow.fromarray(CODES).save(tmp_path / "a.gif")
    for name, words in (
        ("text.png", "not a readable image"),
        ("a.gif", "gif file; expected"),
        ("gone.png", "No such file"),
        ("", "folder"),
    ):
        for read in (read_image, image_size, read_mask):
            with pytest.raises(UnreadableFile, match=words):
                read(tmp_path / name)


@pytest.mark.parametrize(
    ("suffix", "low", "high"),
    [
        *((suffix, 0.0, high) for suffix in (".tif", ".exr") for high in (100.0, 255.0, 65535.0, 1e30)),
        (".tif", -1.0, 1.0),
        (".exr", -100.0, 1.0),
    ],
)
def test_floats_far_outside_the_unit_range_are_refused_with_their_range(tmp_path, suffix, low, high):
    values = np.linspace(low, high, 300, dtype=np.float32).reshape(10, 10, 3)
    write_channels(tmp_path / f"a{suffix}", values, ("R", "G", "B"))
    coded = srgb_of_linear(values) if suffix == ".exr" else values
    found = f"from {coded.min():.4g} to {coded.max():.4g}".replace("+", r"\+")
    with pytest.raises(
        BadInput, match=rf"a{suffix} holds values {found}, .*; expected 0 for black to 1 for white"
    ):
        read_image(tmp_path / f"a{suffix}")


def test_floats_a_little_outside_the_unit_range_are_kept(tmp_path):
    values = np.linspace(-0.5, 3.5, 300, dtype=np.float32).reshape(10, 10, 3)
    write_channels(tmp_path / "a.tif", values, ("R", "G", "B"))
    assert_array_equal(read_image(tmp_path / "a.tif"), values)


def huge_png(path, side):
    """A PNG whose header declares a picture that its few bytes do not hold."""
    head = struct.pack(">II5B", side, side, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", bytes(1_200_000)), (b"IEND", b""))
    parts = [struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def test_a_picture_beyond_the_limit_is_refused_from_its_header(tmp_path, monkeypatch):
    huge_png(tmp_path / "a.png", 20_000)
    Pillow.fromarray(CODES).save(tmp_path / "b.avif")
    monkeypatch.setattr(images, "_colour_chunks", None)
    for read in (read_image, image_size, read_mask):
        with pytest.raises(
            BadInput, match=r"a\.png, 20000 x 20000 px, has 400000000 px; expected at most 120000000"
        ):
            read(tmp_path / "a.png")
    monkeypatch.setenv("MORPHSPACE_LARGEST_PICTURE_PX", "100")
    with pytest.raises(BadInput, match=r"b\.avif, 22 x 30 px, .* or set MORPHSPACE_LARGEST_PICTURE_PX=660"):
        image_size(tmp_path / "b.avif")
    monkeypatch.setenv("MORPHSPACE_LARGEST_PICTURE_PX", "400000000")
    assert image_size(tmp_path / "a.png") == (20_000, 20_000)


def test_avif_and_jpeg_xl_are_read(tmp_path):
    smooth = Pillow.fromarray(np.rint(SMOOTH * 255).astype(np.uint8))
    smooth.save(tmp_path / "a.avif", quality=95, subsampling="4:4:4")
    assert image_size(tmp_path / "a.avif") == smooth.size
    stored = np.asarray(Pillow.open(tmp_path / "a.avif").convert("RGB"), np.float32) / 255
    assert_allclose(read_image(tmp_path / "a.avif"), stored, atol=2 / 255)  # two decoders' rounding
    write_channels(tmp_path / "a.jxl", CODES, ("R", "G", "B"))
    assert image_size(tmp_path / "a.jxl") == (22, 30)
    assert_array_equal(read_image(tmp_path / "a.jxl"), unit(CODES))


def test_an_avif_that_is_turned_is_read_upright(tmp_path):
    exif = Pillow.Exif()
    exif[ExifTags.Base.Orientation] = 6
    turned = np.rint(SMOOTH * 255).astype(np.uint8)
    Pillow.fromarray(turned).save(tmp_path / "a.avif", quality=95, subsampling="4:4:4", exif=exif)
    assert image_size(tmp_path / "a.avif") == (120, 100)
    assert_allclose(read_image(tmp_path / "a.avif"), np.rot90(SMOOTH, -1), atol=10 / 255)  # quality 95


def test_an_avif_of_several_parts_is_refused(tmp_path):
    rgba = Pillow.fromarray(np.dstack([CODES, ALPHA]))
    rgba.save(tmp_path / "clear.avif")
    with pytest.raises(BadInput, match=r"clear\.avif holds 2 parts, such as tiles or transparency"):
        read_image(tmp_path / "clear.avif")
    (tmp_path / "cut.avif").write_bytes((tmp_path / "clear.avif").read_bytes()[:200])
    with pytest.raises(BadInput, match=r"cut\.avif"):
        read_image(tmp_path / "cut.avif")


def test_a_heic_is_refused_by_name(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(100))
    for read in (read_image, image_size):
        with pytest.raises(BadInput, match=r"a\.jpg is a HEIC picture; .* Convert it"):
            read(tmp_path / "a.jpg")


def test_a_still_of_an_animated_png_is_its_default_image(tmp_path):
    """PNG, third edition, 4.9: the static image is what a decoder without animation shows."""
    first, second = (Pillow.fromarray(np.full((8, 9, 3), value, np.uint8)) for value in (10, 200))
    for name, apart in (("inside.png", False), ("apart.png", True)):
        first.save(tmp_path / name, save_all=True, append_images=[second, first], default_image=apart)
        assert_array_equal(read_image(tmp_path / name), np.float32(10) / np.float32(255))
    assert images.animation_frames(tmp_path / "inside.png") == 3
    assert images.animation_frames(tmp_path / "apart.png") == 2
    first.save(tmp_path / "still.png")
    assert images.animation_frames(tmp_path / "still.png") == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"/annex/objects/SHA256E-s42--0.png\n", "git annex get"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 42\n", "git lfs pull"),
    ],
)
def test_a_pointer_to_a_file_says_how_to_get_it(tmp_path, content, words):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(UnreadableFile, match=rf"a\.png is a pointer .* Run `{words}`"):
        read_image(tmp_path / "a.png")


def test_a_wrong_suffix_does_not_matter(tmp_path):
    Pillow.fromarray(CODES).save(tmp_path / "a.png")
    (tmp_path / "a.png").rename(tmp_path / "a.jpg")
    assert_array_equal(read_image(tmp_path / "a.jpg"), unit(CODES))


def test_masks_are_weights(tmp_path):
    Pillow.fromarray(CODES[..., 0]).save(tmp_path / "grey.png")
    Pillow.fromarray(np.repeat(CODES[..., :1], 3, axis=2)).save(tmp_path / "rgb.png")
    for name in ("grey.png", "rgb.png"):
        mask = read_mask(tmp_path / name)
        assert mask.dtype == np.float32
        assert_array_equal(mask, unit(CODES[..., 0]))
    write_channels(tmp_path / "half.exr", np.full((3, 4, 1), 0.5, np.float32), ("Y",))
    assert_array_equal(read_mask(tmp_path / "half.exr"), np.full((3, 4), 0.5, np.float32))


def test_what_is_no_mask_is_refused(tmp_path):
    Pillow.fromarray(CODES).save(tmp_path / "colour.png")
    Pillow.fromarray(np.dstack([CODES[..., 0], ALPHA])).save(tmp_path / "clear.png")
    write_channels(tmp_path / "far.exr", np.full((3, 4, 1), 1.5, np.float32), ("Y",))
    for name, words in (("colour.png", "coloured"), ("clear.png", "transparency"), ("far.exr", "1.5 to 1.5")):
        with pytest.raises(BadInput, match=words):
            read_mask(tmp_path / name)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_clipped_values_are_counted(tmp_path, suffix):
    image = np.full((10, 10, 3), 0.5, np.float32)
    image[0, 0] = (1.2, -0.3, 1 + 1e-4)  # the last one rounds to white by itself
    assert write_image(tmp_path / f"a{suffix}", image) == 2
    assert read_image(tmp_path / f"a{suffix}").max() <= 1


def test_codes_are_rounded_to_the_nearest(tmp_path):
    levels = (np.arange(255) + np.array([[0.49], [0.51]])) / 255
    write_image(tmp_path / "a.png", np.repeat(levels[..., None], 3, axis=2).astype(np.float32))
    codes = cv2.imread(str(tmp_path / "a.png"))
    assert_array_equal(codes[0, :, 0], np.arange(255))
    assert_array_equal(codes[1, :, 0], np.arange(1, 256))


@pytest.mark.parametrize("suffix", EVERY_SUFFIX)
def test_bytes_do_not_depend_on_the_hour(tmp_path, suffix):
    write_image(tmp_path / f"a{suffix}", SMOOTH)
    script = (
        "import sys, numpy; from morphspace.io.images import write_image;"
        "write_image(sys.argv[2], numpy.load(sys.argv[1]))"
    )
    np.save(tmp_path / "smooth.npy", SMOOTH)
    shifted = {**os.environ, "TZ": "Asia/Tokyo"}  # another process, another clock on the wall
    again = tmp_path / f"b{suffix}"
    subprocess.run([sys.executable, "-c", script, tmp_path / "smooth.npy", again], check=True, env=shifted)
    content = again.read_bytes()
    assert content == (tmp_path / f"a{suffix}").read_bytes()
    for word in (b"Date", b"20" + b"26:", b"Software", str(tmp_path).encode()):
        assert word not in content


def test_png_says_that_it_is_srgb(tmp_path):
    write_image(tmp_path / "a.png", SMOOTH)
    with Pillow.open(tmp_path / "a.png") as picture:
        assert "srgb" in picture.info


@pytest.mark.parametrize(
    ("name", "bits"), [("a.gif", 8), ("a", 8), ("a.jpg", 16), ("a.png", 12), ("a.exr", 32)]
)
def test_what_a_format_cannot_hold_is_refused(tmp_path, name, bits):
    with pytest.raises(BadInput, match="cannot write"):
        write_image(tmp_path / name, SMOOTH, bits=bits)
    assert names_in(tmp_path) == []


def test_shapes_that_are_no_image_are_refused(tmp_path):
    for shape in ((4, 5), (4, 5, 4), (0, 5, 3)):
        with pytest.raises(BadInput, match="height, width, 3"):
            write_image(tmp_path / "a.png", np.zeros(shape, np.float32))


FULL_DISK = """
import resource, sys
import numpy as np
from morphspace.errors import UnwritableFile
from morphspace.io.images import write_image
image = np.random.default_rng(1).random((120, 100, 3)).astype(np.float32)
write_image(sys.argv[2], 1 - image)
with open(sys.argv[2], "rb") as file:
    size = len(file.read())
write_image(sys.argv[1], image)
with open(sys.argv[1], "rb") as file:
    old = file.read()
for limit in (0, 100, 5000, size // 2, size - 100, size - 1):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        write_image(sys.argv[1], 1 - image)
        print("written in spite of the limit", limit)
    except UnwritableFile as error:
        print("refused", error)
    with open(sys.argv[1], "rb") as file:
        assert file.read() == old, limit
"""


@pytest.mark.parametrize("suffix", EVERY_SUFFIX)
def test_full_disk_leaves_the_old_file_intact(tmp_path, suffix):
    path = tmp_path / f"kept{suffix}"
    new = tmp_path / f"new{suffix}"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, path, new], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert sum(line.startswith(f"refused cannot write {path}") for line in lines) == len(lines) == 6, (
        done.stdout
    )
    assert names_in(tmp_path) == sorted([path.name, new.name])


def test_a_file_in_place_of_the_folder_is_named(tmp_path):
    Path(tmp_path / "file").write_text("")
    for suffix in EVERY_SUFFIX:
        with pytest.raises(UnwritableFile, match=r"cannot write .*file/a"):
            write_image(tmp_path / "file" / f"a{suffix}", SMOOTH)


def test_pictures_of_frames_have_names_that_every_system_allows():
    names = ["a/b", "c\\d", 'x<y>:"|?*', "two\nlines", "plain"]
    wanted = ("a_b.png", "c_d.png", "x_y______.png", "two_lines.png", "plain.png")
    assert images.picture_names(names) == wanted
    with pytest.raises(BadInput, match="2 frames would be written as a_b"):
        images.picture_names(["a/b", "a|b"])


def test_bytes_in_memory_are_readable_pictures():
    codes = cv2.imdecode(np.frombuffer(png_bytes(unit(CODES)), np.uint8), cv2.IMREAD_UNCHANGED)
    assert_array_equal(codes[..., ::-1], CODES)
    fine, coarse = jpeg_bytes(SMOOTH, 95), jpeg_bytes(SMOOTH, 30)
    assert len(coarse) < len(fine)
    codes = cv2.imdecode(np.frombuffer(fine, np.uint8), cv2.IMREAD_UNCHANGED)
    assert_allclose(unit(codes[..., ::-1]), SMOOTH, atol=8 / 255)  # codes: smooth colour at quality 95
    with pytest.raises(BadInput, match="quality is 0"):
        jpeg_bytes(SMOOTH, 0)
