"""Colour spaces of image files: what they say is converted to sRGB, or named; sRGB stays bit for bit."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from icc_profiles import ADOBE_RGB, DISPLAY_P3, LINEAR_SRGB, PROPHOTO, of_grey, of_primaries, of_table
from PIL import Image, ImageCms
from tolerances import CONVERTED_COLOUR, FLOAT32_VALUE, LEVEL_8BIT

from dofbench.core.errors import InputError
from dofbench.core.image_files.coding import coding_of
from dofbench.core.image_files.primaries import DISPLAY_P3 as P3_CHROMATICITIES
from dofbench.core.image_files.primaries import srgb_decode, srgb_encode
from dofbench.core.images import image_size, read_coded, read_image, read_stored

LEVELS = np.random.default_rng(0).integers(0, 256, (24, 32, 3)).astype(np.uint8)
SRGB_PROFILE = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def by_littlecms(image: Image.Image, profile: bytes) -> np.ndarray:
    """What littleCMS makes of an image and its profile: (H, W, 3) levels of sRGB."""
    source, target = ImageCms.ImageCmsProfile(io.BytesIO(profile)), ImageCms.createProfile("sRGB")
    return np.asarray(ImageCms.profileToProfile(image, source, target, outputMode="RGB"), np.float32)


@pytest.mark.parametrize("suffix", ["png", "tif", "webp", "jpg"])
@pytest.mark.parametrize("primaries", [DISPLAY_P3, ADOBE_RGB, PROPHOTO], ids=["p3", "adobe", "prophoto"])
def test_profiles_of_primaries_are_converted_as_littlecms_does(tmp_path, suffix, primaries):
    file, profile = tmp_path / f"a.{suffix}", of_primaries(*primaries, name="wide")
    options = {"lossless": True} if suffix == "webp" else {"quality": 95} if suffix == "jpg" else {}
    Image.fromarray(LEVELS).save(file, icc_profile=profile, **options)
    expected = by_littlecms(Image.open(file), profile)
    assert np.abs(expected - np.asarray(Image.open(file), np.float32)).max() > 10 * 255 * LEVEL_8BIT
    assert np.abs(read_image(file) * 255 - expected).max() <= 255 * CONVERTED_COLOUR
    assert coding_of(file).name == "wide" and not coding_of(file).linear


@pytest.mark.parametrize("mode", ["RGB", "L"])
def test_srgb_and_no_profile_are_the_same_bits(tmp_path, mode):
    image = Image.fromarray(LEVELS).convert(mode)
    image.save(tmp_path / "plain.png")
    profiles = {"srgb": SRGB_PROFILE, "gamma": None}
    image.save(tmp_path / "srgb.png", icc_profile=profiles["srgb"])
    tagged(tmp_path / "gamma.png", image, (b"gAMA", struct.pack(">I", 45455)))
    tagged(tmp_path / "chunk.png", image, (b"sRGB", b"\0"), (b"gAMA", struct.pack(">I", 60000)))
    for name in ("srgb", "gamma", "chunk"):
        assert np.array_equal(read_image(tmp_path / f"{name}.png"), read_image(tmp_path / "plain.png")), name


def test_sixteen_bits_keep_their_precision(tmp_path):
    ramp = np.linspace(0.2, 0.3, 32 * 24, dtype=np.float32).reshape(24, 32, 1).repeat(3, axis=2)
    oiio_write(tmp_path / "deep.tif", ramp, "uint16", {"ICCProfile": of_primaries(*ADOBE_RGB)})
    light = read_image(tmp_path / "deep.tif")[..., 1]
    expected = srgb_encode(ramp[..., 0].astype(np.float64) ** (563 / 256))
    assert np.abs(light - expected).max() < LEVEL_8BIT / 20


def test_grey_profiles(tmp_path):
    image = Image.fromarray(LEVELS[..., 0])
    image.save(tmp_path / "grey.png", icc_profile=of_grey(1.8))
    expected = by_littlecms(image, of_grey(1.8))
    assert np.abs(read_image(tmp_path / "grey.png") * 255 - expected).max() <= 255 * CONVERTED_COLOUR


def test_profiles_of_tables_and_inks(tmp_path):
    image = Image.fromarray(LEVELS)
    image.save(tmp_path / "table.png", icc_profile=of_table(3))
    assert np.array_equal(np.rint(read_image(tmp_path / "table.png") * 255), by_littlecms(image, of_table(3)))
    inks = Image.merge("CMYK", [Image.fromarray(np.full((24, 32), value, np.uint8)) for value in (30, 60, 90, 20)])
    for name in ("inks.tif", "inks.jpg"):
        inks.save(tmp_path / name, icc_profile=of_table(4), quality=100)
        found = read_image(tmp_path / name) * 255
        assert np.abs(found - by_littlecms(inks, of_table(4))).max() <= 2 * 255 * CONVERTED_COLOUR
        inks.save(tmp_path / name)
        with pytest.raises(InputError, match=r"inks \(CMYK\) without an ICC profile"):
            read_image(tmp_path / name)


def test_alpha_in_another_colour_space(tmp_path):
    alpha = np.full((24, 32, 1), 128, np.uint8)
    Image.fromarray(np.dstack([LEVELS, alpha])).save(tmp_path / "a.png", icc_profile=of_primaries(*DISPLAY_P3))
    expected = by_littlecms(Image.fromarray(LEVELS), of_primaries(*DISPLAY_P3)) * 128 / 255
    assert np.abs(read_image(tmp_path / "a.png") * 255 - expected).max() <= 255 * CONVERTED_COLOUR


def test_chunks_of_png(tmp_path):
    image, wide = Image.fromarray(LEVELS), of_primaries(*DISPLAY_P3)
    expected = by_littlecms(image, wide) / 255
    chromaticities = struct.pack(">8I", 31270, 32900, *(round(value * 1e5) for value in P3_CHROMATICITIES[:6]))
    tagged(tmp_path / "codes.png", image, (b"cICP", bytes([12, 13, 0, 1])))
    tagged(tmp_path / "places.png", image, (b"cHRM", chromaticities), (b"gAMA", struct.pack(">I", 45455)))
    for name in ("codes", "places"):
        assert np.abs(read_image(tmp_path / f"{name}.png") - expected).max() <= CONVERTED_COLOUR, name
    tagged(tmp_path / "gamma.png", image, (b"gAMA", struct.pack(">I", 55556)))
    assert np.abs(read_image(tmp_path / "gamma.png") - srgb_encode((LEVELS / 255) ** 1.8)).max() <= CONVERTED_COLOUR
    tagged(tmp_path / "linear.png", image, (b"gAMA", struct.pack(">I", 100000)))
    values, coding = read_coded(tmp_path / "linear.png")
    assert coding.linear and np.abs(values - LEVELS / 255).max() <= FLOAT32_VALUE
    for codes, name in (((9, 16), "PQ"), ((9, 18), "HLG"), ((22, 13), "primaries 22")):
        tagged(tmp_path / "hdr.png", image, (b"cICP", bytes([*codes, 0, 1])))
        with pytest.raises(InputError, match=name):
            read_image(tmp_path / "hdr.png")


def test_a_cameras_adobe_rgb_without_a_profile(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0xA001: 65535, 0xA005: {1: "R03", 2: b"0100"}})
    Image.fromarray(LEVELS).save(tmp_path / "_a.jpg", exif=exif, quality=95)
    expected = by_littlecms(Image.open(tmp_path / "_a.jpg"), of_primaries(*ADOBE_RGB))
    assert np.abs(read_image(tmp_path / "_a.jpg") * 255 - expected).max() <= 255 * CONVERTED_COLOUR


def test_a_linear_profile_makes_light(tmp_path):
    values = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    oiio_write(tmp_path / "a.tif", values, "uint16", {"ICCProfile": of_primaries(*LINEAR_SRGB)})
    found, coding = read_coded(tmp_path / "a.tif")
    assert coding.linear and np.abs(found - values).max() <= CONVERTED_COLOUR
    oiio_write(tmp_path / "b.tif", 4 * values, "float", {"ICCProfile": of_primaries(*LINEAR_SRGB)})
    found, coding = read_coded(tmp_path / "b.tif")
    assert coding.linear and np.abs(found - 4 * values).max() <= 4 * CONVERTED_COLOUR, "nothing is clipped at 1"


@pytest.mark.parametrize("kind", ["half", "float"])
def test_floats_are_light(tmp_path, kind):
    values = (np.random.default_rng(0).random((24, 32, 3)) * 8).astype(np.float16).astype(np.float32)
    for name in ("a.exr", "a.tif", "a.hdr"):
        oiio_write(tmp_path / name, values, kind)
        found, coding = read_coded(tmp_path / name)
        assert coding.linear and coding.name == "linear light", name
        # Radiance's format has 8 bits for each colour, and an exponent for the largest.
        assert np.abs(found - values).max() <= (8 * LEVEL_8BIT if name == "a.hdr" else FLOAT32_VALUE), name


def test_an_exr_says_that_it_is_encoded_or_in_other_primaries(tmp_path):
    values = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)
    oiio_write(tmp_path / "srgb.exr", values, "float", {"oiio:ColorSpace": "sRGB"})
    found, coding = read_coded(tmp_path / "srgb.exr")
    assert not coding.linear and np.array_equal(found, values)
    wide = (*P3_CHROMATICITIES,)
    oiio_write(tmp_path / "wide.exr", values * 3, "float", {"chromaticities": (oiio.TypeDesc("float[8]"), wide)})
    found, coding = read_coded(tmp_path / "wide.exr")
    oiio_write(tmp_path / "named.exr", values * 3, "float", {"oiio:ColorSpace": "lin_p3d65_scene"})
    named, stated = read_coded(tmp_path / "named.exr")
    assert coding.linear and stated.linear
    assert np.abs(found - named).max() <= 3 * CONVERTED_COLOUR and np.abs(found - values * 3).max() > 0.1
    oiio_write(tmp_path / "pq.exr", values, "float", {"oiio:ColorSpace": "pq_rec2020_display"})
    with pytest.raises(InputError, match="pq_rec2020_display"):
        read_image(tmp_path / "pq.exr")


def test_windows_layers_and_parts_of_an_exr(tmp_path):
    values = np.random.default_rng(0).random((10, 12, 3)).astype(np.float32)
    spec = oiio.ImageSpec(12, 10, 3, "float")
    spec.x, spec.y, spec.full_x, spec.full_y, spec.full_width, spec.full_height = -2, -1, 0, 0, 8, 16
    written(tmp_path / "windows.exr", spec, values)
    assert image_size(tmp_path / "windows.exr") == (8, 16)
    shown = read_image(tmp_path / "windows.exr")
    assert np.array_equal(shown[:9], values[1:, 2:10]) and not shown[9:].any()

    names = ("View.Combined.R", "View.Combined.G", "View.Combined.B", "View.Depth.Z", "View.Glossy.R", "View.Glossy.G")
    spec = oiio.ImageSpec(12, 10, 7, "float")
    spec.channelnames = (*names, "View.Glossy.B")
    layered = np.dstack([values, values[..., :1] * 9, values * 0.1])
    written(tmp_path / "layers.exr", spec, layered)
    assert np.array_equal(read_image(tmp_path / "layers.exr"), values)
    spec.channelnames = ("One.R", "One.G", "One.B", "Z", "Two.R", "Two.G", "Two.B")
    written(tmp_path / "two.exr", spec, layered)
    with pytest.raises(InputError, match=r"several pictures \(One, Two\)"):
        read_image(tmp_path / "two.exr")
    grey = oiio.ImageSpec(12, 10, 2, "float")
    grey.channelnames = ("Y", "Z")
    written(tmp_path / "grey.exr", grey, values[..., :2])
    assert np.array_equal(read_image(tmp_path / "grey.exr"), np.repeat(values[..., :1], 3, axis=2))

    depth, colours = oiio.ImageSpec(12, 10, 1, "float"), oiio.ImageSpec(12, 10, 3, "float")
    depth.channelnames = ("Z",)
    depth.attribute("name", "depth")
    colours.attribute("name", "beauty")
    output = oiio.ImageOutput.create("parts.exr")
    assert output.open(str(tmp_path / "parts.exr"), (depth, colours))
    output.write_image(values[..., :1].copy())
    output.open(str(tmp_path / "parts.exr"), colours, "AppendSubimage")
    output.write_image(values)
    output.close()
    assert np.array_equal(read_image(tmp_path / "parts.exr"), values)


def test_a_jpeg_with_a_gain_map_is_its_base(tmp_path):
    """As of phones; OpenImageIO applies the map by itself, and gives light above 1."""
    y, x = np.mgrid[:64, :96]
    image, gain = Image.fromarray(np.dstack([2 * x, 3 * y, x + y]).astype(np.uint8)), Image.new("L", (96, 64), 200)
    write_gain_mapped(tmp_path / "a.jpg", image, gain)
    assert str(oiio.ImageInput.open(str(tmp_path / "a.jpg")).spec().format) == "half", "OpenImageIO sees the map"
    found, coding = read_coded(tmp_path / "a.jpg")
    expected = np.asarray(Image.open(tmp_path / "a.jpg").convert("RGB"), np.float32) / 255
    assert coding.is_usual and not coding.linear and np.abs(found - expected).max() <= LEVEL_8BIT


def test_what_is_understood_in_part_is_named(tmp_path):
    image = Image.fromarray(LEVELS)
    ImageCms.profileToProfile(
        image, ImageCms.createProfile("sRGB"), ImageCms.createProfile("LAB"), outputMode="LAB"
    ).save(tmp_path / "lab.tif")
    image.save(tmp_path / "pages.tif", save_all=True, append_images=[image, image])
    image.save(tmp_path / "moving.webp", save_all=True, append_images=[Image.fromarray(255 - LEVELS)])
    image.save(tmp_path / "broken.png", icc_profile=of_primaries(*DISPLAY_P3)[:150])
    image.save(tmp_path / "inks.png", icc_profile=of_table(4))
    found = {
        "lab.tif": "CIELAB",
        "pages.tif": "3 pages",
        "moving.webp": "animation",
        "broken.png": "profile",
        "inks.png": "CMYK",
    }
    for name, said in found.items():
        with pytest.raises(InputError, match=said) as caught:
            read_image(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)
    # A smaller copy of a page is none.
    cv2.imwrite(str(tmp_path / "plain.tif"), LEVELS[..., ::-1])
    assert np.array_equal(np.rint(read_image(tmp_path / "plain.tif") * 255), LEVELS)


def test_depth_is_no_colour(tmp_path):
    Image.fromarray(LEVELS[..., 0]).save(tmp_path / "a.png", icc_profile=of_grey(1.8))
    assert np.array_equal(np.rint(read_stored(tmp_path / "a.png")[..., 0] * 255), LEVELS[..., 0])


def test_the_curve_of_srgb_has_an_inverse():
    values = np.linspace(-0.2, 4, 1000)
    assert np.abs(srgb_decode(srgb_encode(values)) - values).max() <= 4 * FLOAT32_VALUE


def tagged(file: Path, image: Image.Image, *chunks: tuple[bytes, bytes]) -> None:
    """Write a PNG with chunks before its pixels."""
    stream = io.BytesIO()
    image.save(stream, "png")
    content = stream.getvalue()
    packed = (
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
    file.write_bytes(content[:33] + b"".join(packed) + content[33:])


def oiio_write(file: Path, values: np.ndarray, kind: str, attributes: dict | None = None) -> None:
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    for name, value in (attributes or {}).items():
        if isinstance(value, bytes):
            kind_of = oiio.TypeDesc(f"uint8[{len(value)}]")
            spec.attribute(name, kind_of, np.frombuffer(value, np.uint8))
        elif isinstance(value, tuple):
            spec.attribute(name, *value)
        else:
            spec.attribute(name, value)
    written(file, spec, values)


def written(file: Path, spec: oiio.ImageSpec, values: np.ndarray) -> None:
    output = oiio.ImageOutput.create(str(file))
    assert output.open(str(file), spec), output.geterror()
    assert output.write_image(np.ascontiguousarray(values, np.float32)) and output.close()


def write_gain_mapped(file: Path, image: Image.Image, gain: Image.Image) -> None:
    """A JPEG with a second one behind it that says by how much to brighten (Ultra HDR, version 1)."""

    def encoded(picture: Image.Image) -> bytes:
        stream = io.BytesIO()
        picture.save(stream, "jpeg", quality=95)
        return stream.getvalue()

    def segment(marker: int, data: bytes) -> bytes:
        return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data

    def described(text: str) -> bytes:
        rdf = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
        packet = f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="{rdf}">{text}</rdf:RDF></x:xmpmeta>'
        return segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + packet.encode())

    names = 'xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0"'
    numbers = {"GainMapMin": 0, "GainMapMax": 2, "Gamma": 1, "OffsetSDR": 0.015625, "OffsetHDR": 0.015625}
    numbers |= {"HDRCapacityMin": 0, "HDRCapacityMax": 2}
    said = " ".join(f'hdrgm:{name}="{value}"' for name, value in numbers.items())
    second = encoded(gain)
    second = second[:2] + described(f'<rdf:Description {names} {said} hdrgm:BaseRenditionIsHDR="False"/>') + second[2:]
    google = "http://ns.google.com/photos/1.0/container/"
    items = "".join(
        f'<rdf:li rdf:parseType="Resource"><Container:Item {item} Item:Mime="image/jpeg"/></rdf:li>'
        for item in ('Item:Semantic="Primary"', f'Item:Semantic="GainMap" Item:Length="{len(second)}"')
    )
    first = encoded(image)
    head = first[:2] + described(
        f'<rdf:Description xmlns:Container="{google}" xmlns:Item="{google}item/" {names}>'
        f"<Container:Directory><rdf:Seq>{items}</rdf:Seq></Container:Directory></rdf:Description>"
    )

    def index(size: int, offset: int) -> bytes:
        # CIPA DC-007, multi-picture format: version, number of pictures, then 16 bytes for each.
        entries = struct.pack(">IIIHH", 0x030000, size, 0, 0, 0) + struct.pack(">IIIHH", 0, len(second), offset, 0, 0)
        directory = struct.pack(">HHHI4s", 3, 0xB000, 7, 4, b"0100") + struct.pack(">HHII", 0xB001, 4, 1, 2)
        directory += struct.pack(">HHII", 0xB002, 7, 32, 50) + bytes(4)
        return segment(0xE2, b"MPF\0MM\0*" + struct.pack(">I", 8) + directory + entries)

    size = len(head) + len(index(0, 0)) + len(first) - 2
    file.write_bytes(head + index(size, size - len(head) - 8) + first[2:] + second)
