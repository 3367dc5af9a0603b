"""Images on disk and in memory: exactness, formats, damage, encoding, resizing."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE, LEVEL_8BIT

from dofbench.core.errors import InputError
from dofbench.core.images import (
    from_8bit,
    image_size,
    read_exr,
    read_image,
    resize,
    to_8bit,
    write_exr,
    write_png,
)


def noise(height: int = 9, width: int = 13, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, channels)).astype(np.float32)


def test_png_round_trip_is_exact_in_8_bits(tmp_path):
    levels = np.random.default_rng(0).integers(0, 256, (9, 13, 3)).astype(np.uint8)
    write_png(tmp_path / "a.png", levels)
    assert np.array_equal(cv2.imread(str(tmp_path / "a.png"))[..., ::-1], levels), "another reader sees the same"
    assert np.array_equal(to_8bit(read_image(tmp_path / "a.png")), levels)
    write_png(tmp_path / "b.png", from_8bit(levels))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert image_size(tmp_path / "a.png") == (13, 9)


@given(st.lists(st.floats(-1, 2, width=32), min_size=1, max_size=20))
def test_8_bits_round_to_nearest_and_saturate(values):
    values = np.array(values, np.float32)
    back = from_8bit(to_8bit(values))
    assert np.abs(back - np.clip(values, 0, 1)).max() <= 0.5 * LEVEL_8BIT * (1 + FLOAT32_VALUE)
    assert np.array_equal(to_8bit(back), to_8bit(values))


def test_grey_alpha_and_16_bit(tmp_path):
    levels = np.random.default_rng(0).integers(0, 256, (9, 13, 4)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "grey.png"), levels[..., 0])
    grey = read_image(tmp_path / "grey.png")
    assert grey.shape == (9, 13, 3) and np.array_equal(to_8bit(grey), np.repeat(levels[..., :1], 3, axis=2))
    cv2.imwrite(str(tmp_path / "alpha.png"), levels)
    over_black = levels[..., 2::-1] / 255 * levels[..., 3:] / 255
    assert np.abs(read_image(tmp_path / "alpha.png") - over_black).max() <= 0.5 * LEVEL_8BIT + FLOAT32_VALUE
    deep = np.random.default_rng(1).integers(0, 65536, (9, 13, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    assert np.array_equal(np.rint(read_image(tmp_path / "deep.png") * 65535), deep[..., ::-1])


def test_jpeg(tmp_path):
    smooth = np.tile(np.linspace(0.1, 0.9, 64, dtype=np.float32)[None, :, None], (48, 1, 3))
    cv2.imwrite(str(tmp_path / "a.jpg"), to_8bit(smooth), [cv2.IMWRITE_JPEG_QUALITY, 98])
    assert np.abs(read_image(tmp_path / "a.jpg") - smooth).max() < 3 * LEVEL_8BIT


def test_exr_keeps_every_float(tmp_path):
    depth = np.array([[0.0, 1e-20, 3.25], [1e20, -2.0, np.inf]], np.float32)
    write_exr(tmp_path / "depth.exr", depth)
    assert np.array_equal(read_exr(tmp_path / "depth.exr"), depth)
    colour = noise() * 30
    write_exr(tmp_path / "colour.exr", colour)
    assert np.array_equal(read_exr(tmp_path / "colour.exr"), colour)
    assert np.array_equal(read_image(tmp_path / "colour.exr"), colour), "floats aren't scaled"
    write_exr(tmp_path / "half.exr", colour, half=True)
    assert np.array_equal(read_exr(tmp_path / "half.exr"), colour.astype(np.float16).astype(np.float32))


def test_the_same_pixels_give_the_same_bytes(tmp_path):
    for suffix, write in ((".png", write_png), (".exr", write_exr)):
        write(tmp_path / f"a{suffix}", noise())
        write(tmp_path / f"b{suffix}", noise())
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.jpg"])
@pytest.mark.parametrize("keep", [0.0, 0.6])
def test_damage_is_one_line_that_names_the_file(tmp_path, name, keep):
    file = tmp_path / name
    big = noise(64, 64)
    if name.endswith("png"):
        write_png(file, big)
    elif name.endswith("exr"):
        write_exr(file, big)
    else:
        cv2.imwrite(str(file), to_8bit(big))
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * keep)])
    with pytest.raises(InputError) as caught:
        read_exr(file) if name.endswith("exr") else read_image(file)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


def test_a_jpeg_with_a_thumbnail_is_cut_short_all_the_same(tmp_path):
    file = tmp_path / "a.jpg"
    cv2.imwrite(str(file), to_8bit(noise(64, 64)))
    content = file.read_bytes()
    thumbnail = b"\xff\xd8 small \xff\xd9"
    segment = b"\xff\xe3" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    whole = content[:2] + segment + b"\xff" + content[2:]  # and a fill byte, which JPEG allows
    file.write_bytes(whole)
    assert read_image(file).shape == (64, 64, 3)
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="cut short"):
        read_image(file)


@pytest.mark.parametrize("function", [image_size, read_image, read_exr])
def test_what_is_no_image(tmp_path, function):
    for name, content in (("text.png", b"no image"), ("empty.exr", b""), ("text.jpg", b"no image")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            function(tmp_path / name)
    with pytest.raises(InputError, match="absent.png"):
        function(tmp_path / "absent.png")


def test_more_than_four_channels(tmp_path):
    import OpenImageIO as oiio

    output = oiio.ImageOutput.create(str(tmp_path / "five.exr"))
    output.open(str(tmp_path / "five.exr"), oiio.ImageSpec(13, 9, 5, "float"))
    output.write_image(noise(channels=5))
    output.close()
    # An EXR names its channels: R, G, B are the picture, whatever else there is.
    assert np.array_equal(read_image(tmp_path / "five.exr"), noise(channels=5)[..., :3])
    assert read_exr(tmp_path / "five.exr").shape == (9, 13, 5)
    output = oiio.ImageOutput.create(str(tmp_path / "five.tif"))
    output.open(str(tmp_path / "five.tif"), oiio.ImageSpec(13, 9, 5, "uint8"))
    output.write_image(noise(channels=5))
    output.close()
    with pytest.raises(InputError, match=r"five.tif: found 5 channels"):
        read_image(tmp_path / "five.tif")


@given(st.integers(1, 5), st.integers(1, 5))
def test_shrinking_averages(down, across):
    image = noise(6 * down, 7 * across)
    expected = image.reshape(6, down, 7, across, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resize(image, 7, 6), expected, atol=FLOAT32_VALUE)


def test_resizing_to_the_same_size_and_of_planes():
    image = noise()
    assert resize(image, 13, 9) is image
    assert resize(image[..., 0], 26, 18).shape == (18, 26)
    flat = np.full((9, 13, 3), 0.3, np.float32)
    np.testing.assert_allclose(resize(flat, 30, 20), 0.3, atol=FLOAT32_VALUE)


@given(
    st.tuples(st.integers(1, 60), st.integers(1, 60)),
    st.tuples(st.integers(1, 90), st.integers(1, 90)),
    st.sampled_from([(0.0, 1.0), (1.0, 1.0), (0.25, 900.0)]),
    st.sampled_from(["noise", "blocks"]),
    st.sampled_from([(), (1,), (3,)]),
    st.integers(0, 2**32 - 1),
)
def test_resizing_never_leaves_the_range_of_the_image(size, goal, ends, kind, channels, seed):
    """An encoded image stays in [0, 1], blown-out white is no more than white, and light keeps its own range."""
    unit = np.random.default_rng(seed).random((*size, *channels)).astype(np.float32)
    image = np.float32(ends[0]) + np.float32(ends[1] - ends[0]) * (np.rint(unit) if kind == "blocks" else unit)
    # The compared number is what `make-dataset` compares: no tolerance.
    resized = resize(image, *goal)
    assert resized.shape == (goal[1], goal[0], *channels) and resized.dtype == np.float32
    assert image.min() <= resized.min() and resized.max() <= image.max()


def test_blown_out_white_stays_white_when_a_photograph_is_shrunk():
    white = np.ones((658, 1000, 3), np.float32)
    for width, height in ((504, 332), (999, 657), (337, 222), (1500, 987)):
        assert np.array_equal(np.unique(resize(white, width, height)), [1.0]), (width, height)


def test_light_above_white_is_kept_when_resized():
    light = noise(40, 60) * 30
    assert resize(light, 31, 17).max() > 10 and resize(light, 90, 70).max() > 25


def test_nan_spreads_no_further_than_its_samples_when_resized():
    image = noise(20, 20)
    image[3, 4] = np.nan
    resized = resize(image, 10, 10)
    assert np.isnan(resized[1, 2]).all() and np.isnan(resized).sum() == 3
