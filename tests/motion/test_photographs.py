"""Photographs upright and shrunk, frames of a video, what EXIF says of a camera, and which photographs to compare."""

from __future__ import annotations

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from tolerances import FLOAT32_VALUE

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif
from dofbench.scenes.reconstruction.features import focal_length, group_by_camera
from dofbench.scenes.reconstruction.matching import choose, exhaustive, look_alikes, sequential, signatures
from dofbench.scenes.reconstruction.photograph_list import Photograph, Prepared, Upright, prepare, turned
from dofbench.scenes.reconstruction.video import check_colours, sharpest_frames


@pytest.mark.parametrize("orientation", range(1, 9))
def test_photographs_stand_upright(tmp_path, orientation):
    """As OpenCV turns them, whose reader knows EXIF by itself."""
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:24, :32], pixels[24:, 32:] = (255, 0, 0), (0, 255, 0)
    spec = oiio.ImageSpec(64, 48, 3, "uint8")
    spec.attribute("Orientation", orientation)
    spec.attribute("CompressionQuality", 100)
    path = tmp_path / "a.jpg"
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close()
    expected = cv2.imread(str(path))[..., ::-1]
    found = Upright(path)()
    assert found.shape == expected.shape
    assert np.abs(found * 255 - expected).max() < 6  # two JPEG decoders


@given(arrays.arrays(np.float32, (3, 4, 1), elements=st.floats(0, 1, width=32)))
def test_four_quarter_turns_are_none(image):
    once = turned(image, 6)
    assert once.shape[:2] == (4, 3) and once[0, -1] == image[0, 0]  # a quarter to the right
    np.testing.assert_array_equal(turned(turned(turned(once, 6), 6), 6), image)
    np.testing.assert_array_equal(turned(once, 8), image)


def test_large_photographs_are_shrunk_and_small_ones_left(tmp_path):
    generator = np.random.default_rng(0)
    images = {"large": generator.random((90, 120, 3)), "small": generator.random((30, 40, 3))}
    found = prepare(
        [
            Photograph(name, tmp_path / name, lambda image=image: image.astype(np.float32))
            for name, image in images.items()
        ],
        tmp_path,
        80,
        lambda done: None,
    )
    assert [(one.width, one.height) for one in found] == [(80, 60), (40, 30)]


def write_video(path, frames):
    codec = "mp4v" if path.suffix == ".mp4" else "MJPG"
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 10, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
    writer.release()
    return path


@pytest.fixture(scope="module")
def frames():
    """Twelve frames in four windows; the sharp ones are 1, 3, 8 and 10."""
    generator = np.random.default_rng(0)
    sharp = cv2.resize(
        (generator.random((24, 32, 3)) * 255).astype(np.uint8), (128, 96), interpolation=cv2.INTER_NEAREST
    )
    blurred = cv2.GaussianBlur(sharp, (0, 0), 5)
    return [sharp if index in (1, 3, 8, 10) else blurred for index in range(12)]


@pytest.mark.parametrize("suffix", ["mp4", "avi"])
def test_of_every_window_the_sharpest_frame_is_taken(tmp_path, frames, suffix):
    video, told = write_video(tmp_path / f"a.{suffix}", frames), []
    found = sharpest_frames(video, tmp_path / "frames", 4, told.append)
    assert [one.name for one in found] == ["frame_000001", "frame_000003", "frame_000008", "frame_000010"]
    assert told == list(range(1, 13))
    assert found[0].read().shape == (96, 128, 3)


def test_a_video_cut_short_or_broken(tmp_path, frames, capsys):
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"\0" * 5000)
    assert app.main(["reconstruct", str(broken), "--out", str(tmp_path / "out")]) == 2
    assert "no readable video" in capsys.readouterr().err
    video = write_video(tmp_path / "two.avi", frames[:2])
    with pytest.raises(InputError, match="2 readable frames"):
        sharpest_frames(video, tmp_path / "frames", 4, lambda done: None)


def test_the_35_mm_equivalent_is_of_the_diagonal():
    # 36 x 24 mm itself: the focal length in pixels is to the width as the mm to 36.
    focal, _ = focal_length(Exif(focal_length_35mm=50.0), 3600, 2400, None)
    assert focal == pytest.approx(5000)
    assert focal_length(Exif(focal_length=55.0), 1060, 707, None) is None
    focal, told = focal_length(Exif(focal_length=55.0), 707, 1060, 36.0)
    assert focal == pytest.approx(55 / 36 * 1060) and "--sensor-width" in told


def photograph(name, width=40, exif=None):
    return Prepared(name, f"{name}.png", width, 30, 1.0, exif)


def test_which_photographs_share_a_camera():
    wide, tele = Exif(focal_length=24.0), Exif(focal_length=70.0)
    all_of_them = [
        photograph("a", exif=wide),
        photograph("b", exif=tele),
        photograph("c", exif=wide),
        photograph("d", 50),
    ]

    def names(cameras):
        return [group.names for group in group_by_camera(all_of_them, cameras, None)]

    assert names("auto") == [("a", "c"), ("b",), ("d",)]
    assert names("shared") == [("a", "b", "c"), ("d",)]
    assert names("each") == [("a",), ("b",), ("c",), ("d",)]


@given(st.integers(3, 200))
def test_pairs_in_order_reach_every_photograph(count):
    pairs = sequential(count)
    assert set(pairs) <= set(exhaustive(count)) and len(set(pairs)) == len(pairs)
    assert {(index, index + 1) for index in range(count - 1)} <= set(pairs)


def test_which_way_is_automatic():
    assert [choose("auto", 80, False), choose("auto", 81, False), choose("auto", 200, True)] == [
        "exhaustive",
        "retrieval",
        "sequential",
    ]
    assert choose("retrieval", 5, True) == "retrieval"


def test_look_alikes_are_found_by_their_own_vocabulary():
    """Three places, five photographs of each that share most of their features: partners are of the same place."""
    generator = np.random.default_rng(0)
    places = [generator.integers(0, 256, (300, 128)) for _ in range(3)]
    descriptors = [
        np.clip(
            places[index % 3][generator.permutation(300)[:200]] + generator.normal(0, 8, (200, 128)), 0, 255
        ).astype(np.uint8)
        for index in range(15)
    ]
    vectors = signatures(descriptors, seed=0)
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(1, abs=FLOAT32_VALUE)
    pairs = look_alikes(vectors, 4)
    assert all(first % 3 == second % 3 for first, second in pairs) and len(pairs) == 30
    np.testing.assert_array_equal(signatures(descriptors, seed=0), vectors)
    empty = np.zeros((0, 128), np.uint8)
    assert not signatures([empty, empty], seed=0).any()
    full = np.random.default_rng(0).integers(0, 256, (50, 128)).astype(np.uint8)
    assert not signatures([full, empty, full], seed=0)[1].any()


def with_colour_box(video, codes):
    """Add a `colr` box to the picture's entry of an MP4 whose `moov` comes last, as the encoder's does."""
    content = bytearray(video.read_bytes())
    box = b"\0\0\0\x13colrnclx" + b"".join(code.to_bytes(2, "big") for code in codes) + b"\0"
    entry = content.rfind(b"mp4v", 0, content.rfind(b"esds")) - 4
    assert content.rfind(b"moov") > content.rfind(b"mdat")
    for kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd"):
        at = content.rfind(kind, 0, entry) - 4
        content[at : at + 4] = (int.from_bytes(content[at : at + 4], "big") + len(box)).to_bytes(4, "big")
    size = int.from_bytes(content[entry : entry + 4], "big")
    content[entry + size : entry + size] = box
    content[entry : entry + 4] = (size + len(box)).to_bytes(4, "big")
    video.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize(
    "codes, said",
    [
        ((1, 1, 1), ""),
        ((6, 6, 6), ""),
        ((9, 18, 9), "BT.2020 with HLG"),
        ((9, 16, 9), "PQ"),
        ((12, 1, 1), "Display P3"),
    ],
)
def test_a_video_says_its_colours(tmp_path, frames, capsys, codes, said):
    video = write_video(tmp_path / "a.mp4", frames)
    check_colours(video)
    with_colour_box(video, codes)
    assert cv2.VideoCapture(str(video)).read()[0], "still a video"
    if not said:
        check_colours(video)
        return
    assert app.main(["reconstruct", str(video), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error and "ffmpeg" in error and error.count("\n") == 1


def test_a_matroska_video_says_its_colours(tmp_path):
    def element(kind, content):
        return kind + (0x4000 | len(content)).to_bytes(2, "big") + content

    def video(primaries, curve):
        colour = element(b"\x55\xb0", element(b"\x55\xbb", bytes([primaries])) + element(b"\x55\xba", bytes([curve])))
        tracks = element(b"\x16\x54\xae\x6b", element(b"\xae", element(b"\xe0", element(b"\xb0", b"\x40") + colour)))
        head = element(b"\x1a\x45\xdf\xa3", element(b"\x42\x82", b"matroska"))
        # A segment of unknown size, as recorders write it that can't go back.
        path = tmp_path / "a.mkv"
        path.write_bytes(head + b"\x18\x53\x80\x67\x01" + b"\xff" * 7 + element(b"\xec", bytes(9)) + tracks)
        return path

    check_colours(video(1, 1))
    for codes in ((9, 18), (9, 1), (1, 16)):
        with pytest.raises(InputError, match="a.mkv"):
            check_colours(video(*codes))
    for damaged in (b"", b"\x1a\x45", bytes(100), b"\xff" * 100):
        (tmp_path / "b.mkv").write_bytes(damaged)
        check_colours(tmp_path / "b.mkv")
        (tmp_path / "b.mp4").write_bytes(damaged)
        check_colours(tmp_path / "b.mp4")
