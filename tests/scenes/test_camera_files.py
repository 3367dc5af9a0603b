"""HEIC, AVIF and raw photographs: right values, upright once, named where they can't be read."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from camera_photographs import write_dng
from icc_profiles import DISPLAY_P3, of_primaries
from PIL import Image, features
from tolerances import COMPRESSED_COLOUR, CONVERTED_COLOUR, LEVEL_8BIT

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.image_files import camera_files
from dofbench.core.image_files.coding import coding_of_codes
from dofbench.core.images import image_coding, image_size, read_coded, read_image, write_png
from dofbench.scenes.readers.exif_files import exif_of_image
from dofbench.scenes.readers.folders import image_files
from dofbench.scenes.reconstruction.photograph_list import Upright, find_photographs, orientation, upright_size

SIZE = (64, 48)
needs_avif = pytest.mark.skipif(not features.check("avif"), reason="this Pillow reads no AVIF")


def picture():
    """(48, 64, 3) uint8: smooth, another colour in every corner."""
    x, y = np.meshgrid(np.linspace(0, 1, SIZE[0]), np.linspace(0, 1, SIZE[1]))
    return np.rint(np.stack([40 + 160 * x, 60 + 120 * y, 200 - 120 * x * y], axis=2)).astype(np.uint8)


def write_heic(file, levels, **options):
    heif = pytest.importorskip("pillow_heif", reason="needs the extra photographs")
    heif.from_pillow(Image.fromarray(levels)).save(file, quality=-1, chroma=444, **options)


@pytest.mark.parametrize("suffix", [".heic", ".HEIC", ".heif"])
def test_heic_has_the_colours_of_the_picture(tmp_path, suffix):
    write_heic(tmp_path / f"a{suffix}", picture())
    assert image_size(tmp_path / f"a{suffix}") == SIZE
    assert np.abs(read_image(tmp_path / f"a{suffix}") * 255 - picture()).max() <= 255 * COMPRESSED_COLOUR


def test_heic_by_another_name(tmp_path):
    write_heic(tmp_path / "a.heic", picture())
    (tmp_path / "a.heic").rename(tmp_path / "a.jpg")
    with pytest.raises(InputError, match=r"a.jpg.*HEIC or AVIF"):
        read_image(tmp_path / "a.jpg")


def test_heic_of_ten_bits_and_white(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason="needs the extra photographs")
    deep = np.full((48, 64, 3), 65535, np.uint16)
    deep[:, :32] = 32768
    heif.from_bytes("RGB;16", SIZE, deep.tobytes()).save(tmp_path / "a.heic", quality=-1)
    found = read_image(tmp_path / "a.heic")
    assert found.max() == 1 and abs(found[10, 10, 0] - 0.5) <= LEVEL_8BIT


def test_a_phones_wide_colours(tmp_path):
    heif = pytest.importorskip("pillow_heif", reason="needs the extra photographs")
    profile = of_primaries(*DISPLAY_P3, name="Display P3")
    image = Image.fromarray(picture())
    image.info["icc_profile"] = profile
    heif.from_pillow(image).save(tmp_path / "a.heic", quality=-1, chroma=444)
    Image.fromarray(picture()).save(tmp_path / "a.png", icc_profile=profile)
    expected = read_image(tmp_path / "a.png")
    found, coding = read_coded(tmp_path / "a.heic")
    assert coding.name == "Display P3"
    # The mean: a level of a saturated colour's weakest channel becomes several.
    assert np.abs(found - expected).mean() <= COMPRESSED_COLOUR / 3
    assert np.abs(found - picture() / 255).mean() > COMPRESSED_COLOUR


@pytest.mark.parametrize("turn", [1, 3, 6, 8])
def test_heic_and_avif_are_turned_once(tmp_path, turn):
    exif = Image.Exif()
    exif[0x0112] = turn
    exif[0x8769] = {0x829D: 2.8}
    image = Image.fromarray(picture())
    image.save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=exif)
    expected = Upright(tmp_path / "a.jpg")()
    files = []
    if features.check("avif"):
        image.save(tmp_path / "a.avif", quality=100, subsampling="4:4:4", exif=exif)
        files.append(tmp_path / "a.avif")
    try:
        import pillow_heif
    except ImportError:
        pass
    else:
        turned = Image.open(tmp_path / "a.jpg")
        pillow_heif.from_pillow(turned).save(tmp_path / "a.heic", quality=-1, chroma=444, exif=exif.tobytes())
        files.append(tmp_path / "a.heic")
    if not files:
        pytest.skip("needs the extra photographs, or a Pillow with AVIF")
    for file in files:
        found = Upright(file)()
        assert orientation(file) == 1 and upright_size(file) == (found.shape[1], found.shape[0])
        assert found.shape == expected.shape, file
        assert np.abs(found - expected).max() <= 3 * COMPRESSED_COLOUR, file
        assert exif_of_image(file).f_number == 2.8


@needs_avif
def test_avif(tmp_path):
    Image.fromarray(picture()).save(tmp_path / "a.avif", quality=100, subsampling="4:4:4")
    assert image_size(tmp_path / "a.avif") == SIZE
    assert np.abs(read_image(tmp_path / "a.avif") * 255 - picture()).max() <= 255 * COMPRESSED_COLOUR
    content = (tmp_path / "a.avif").read_bytes()
    at = content.index(b"nclx") + 4
    (tmp_path / "hdr.avif").write_bytes(content[:at] + bytes([0, 9, 0, 18]) + content[at + 4 :])
    with pytest.raises(InputError, match=r"hdr.avif.*BT.2020 with HLG"):
        read_image(tmp_path / "hdr.avif")


@pytest.mark.parametrize("turn", [1, 6])
def test_a_raw_file_is_light(tmp_path, turn):
    pytest.importorskip("rawpy", reason="needs the extra photographs")
    light = np.empty((96, 128, 3))
    light[:, :64], light[:, 64:] = (0.5, 0.3, 0.1), (0.2, 0.4, 0.6)
    write_dng(tmp_path / "a.dng", light, turn)
    found, coding = read_coded(tmp_path / "a.dng")
    assert coding.linear and "raw" in coding.name
    assert image_size(tmp_path / "a.dng") == (found.shape[1], found.shape[0]) == ((128, 96) if turn == 1 else (96, 128))
    first, second = (found[48, 20], found[48, 108]) if turn == 1 else (found[20, 48], found[108, 48])
    # The camera's matrix has four digits.
    assert np.abs(first - [0.5, 0.3, 0.1]).max() <= CONVERTED_COLOUR
    assert np.abs(second - [0.2, 0.4, 0.6]).max() <= CONVERTED_COLOUR
    assert np.abs(Upright(tmp_path / "a.dng", True)() - found ** (1 / 2.2)).max() <= CONVERTED_COLOUR


def test_damaged_files_are_named(tmp_path):
    for name in ("a.heic", "a.avif", "a.dng", "a.nef"):
        if camera_files.missing_package(Path(name)):
            continue
        for content in (b"", b"\0\0\0\x18ftypheic" + bytes(64), bytes(4000)):
            (tmp_path / name).write_bytes(content)
            for function in (image_size, read_image):
                with pytest.raises(InputError, match=name) as caught:
                    function(tmp_path / name)
                assert "\n" not in str(caught.value)
            assert exif_of_image(tmp_path / name).f_number is None


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".heic", ".avif", ".dng", ".png", ".exr"])
def test_mutated_files_are_read_or_named(tmp_path, suffix):
    if camera_files.is_camera_file(Path(f"a{suffix}")) and camera_files.missing_package(Path(f"a{suffix}")):
        pytest.skip("needs the extra photographs")
    file = tmp_path / f"a{suffix}"
    if suffix == ".heic":
        write_heic(file, picture())
    elif suffix == ".dng":
        write_dng(file, picture() / 255)
    elif suffix == ".exr":
        spec = oiio.ImageSpec(*SIZE, 3, "half")
        spec.attribute("oiio:ColorSpace", "lin_ap1_scene")
        output = oiio.ImageOutput.create(str(file))
        assert output.open(str(file), spec) and output.write_image(picture() / np.float32(255)) and output.close()
    else:
        Image.fromarray(picture()).save(file, icc_profile=of_primaries(*DISPLAY_P3))
    whole, random = file.read_bytes(), np.random.default_rng(0)
    for _ in range(60):
        content = bytearray(whole)
        for at in random.integers(0, min(len(content), random.choice([80, 600, 10**6])), random.integers(1, 6)):
            content[at] = random.choice([0, 255, content[at] ^ 16])
        file.write_bytes(content[: random.choice([len(content), random.integers(len(content))], p=[0.7, 0.3])])
        for function in (image_size, image_coding, read_image):
            with contextlib.suppress(InputError):
                function(file)
        exif_of_image(file)


def test_photographs_whose_package_is_missing_are_counted(tmp_path, monkeypatch, capsys):
    for index in range(3):
        write_png(tmp_path / "in" / f"IMG_{index}.png", picture())
        (tmp_path / "in" / f"IMG_1{index}.HEIC").write_bytes(b"")
    monkeypatch.setattr(camera_files.importlib.util, "find_spec", lambda name: None)
    assert app.main(["reconstruct", str(tmp_path / "in"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "3 of 6 photographs" in said and "pillow-heif" in said and "dofbench[photographs]" in said
    with pytest.raises(InputError, match=r"IMG_10.HEIC.*pillow-heif"):
        read_image(tmp_path / "in" / "IMG_10.HEIC")


def test_photographs_that_cannot_be_read_are_counted(tmp_path):
    if camera_files.missing_package(Path("a.heic")):
        pytest.skip("needs the extra photographs")
    for index in range(3):
        write_png(tmp_path / f"IMG_{index}.png", picture())
        (tmp_path / f"IMG_1{index}.HEIC").write_bytes(b"\0\0\0\x18ftypheic" + bytes(64))
    with pytest.raises(InputError, match="3 of 6 photographs can't be read"):
        find_photographs(tmp_path, None)


def test_what_lies_beside_photographs_is_said(tmp_path):
    for index in range(3):
        write_png(tmp_path / f"IMG_{index}.png", picture())
        (tmp_path / f"IMG_{index}.MOV").write_bytes(b"\0\0\0\x14ftypqt  ")
    (tmp_path / "IMG_0.DNG").write_bytes(b"raw")
    (tmp_path / "exif.csv").write_text("name\n")
    found = find_photographs(tmp_path, None)
    assert len(found.photographs) == 3 == len(image_files(tmp_path))
    assert any("1 .DNG" in note and "another format" in note for note in found.notes)
    assert any("3 .MOV" in note for note in found.notes)
    assert not any(".csv" in note for note in found.notes)


def test_codes_of_colour():
    assert coding_of_codes(Path("a"), 1, 13).is_usual and coding_of_codes(Path("a"), 2, 2).is_usual
    assert not coding_of_codes(Path("a"), 12, 13).is_usual
    for codes in ((9, 16), (9, 18), (1, 16), (10, 1)):
        with pytest.raises(InputError):
            coding_of_codes(Path("a"), *codes)
