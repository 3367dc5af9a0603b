"""`dofbench refocus`: what is in focus stays, the blur is what lens and depth say, and half-known inputs are named."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from onnx_networks import write_network

from dofbench.cli.app import main
from dofbench.core.blur import Blur
from dofbench.core.images import read_exr, read_image, write_exr, write_png
from dofbench.core.lens import PhysicalLens
from dofbench.optics.defocus import defocus_numpy, scatter_of
from dofbench.optics.layered import layered_blur
from dofbench.optics.tone import decode

WIDTH, HEIGHT = 96, 72
NEAR, FAR = 1.0, 4.0  # left and right half


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, np.ndarray]:
    """image.png and depth.exr in the current folder: fine stripes, near on the left, far on the right."""
    monkeypatch.chdir(tmp_path)
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    image = np.repeat((0.5 + 0.4 * np.sin(1.3 * columns + 0.9 * rows))[..., None], 3, axis=2).astype(np.float32)
    depth = np.where(columns < WIDTH // 2, NEAR, FAR).astype(np.float32)
    write_png(tmp_path / "image.png", image)
    write_exr(tmp_path / "depth.exr", depth)
    return read_image(tmp_path / "image.png"), depth


def contrast(image: np.ndarray, half: slice) -> float:
    return float(image[20:52, half].std())


LEFT, RIGHT = slice(8, 36), slice(60, 88)


@pytest.mark.parametrize(("at", "sharp", "soft"), [("0.2,0.5", LEFT, RIGHT), ("0.8,0.5", RIGHT, LEFT)])
def test_the_point_chosen_stays_sharp(scene, at: str, sharp: slice, soft: slice) -> None:
    image, _ = scene
    assert main(["refocus", "image.png", "--depth", "depth.exr", "--at", at, "--aperture", "2"]) == 0
    found = read_image(Path("image-refocused.png"))
    # Two levels: of rounding the image that was read, and the one that was written.
    assert np.abs(found[20:52, sharp] - image[20:52, sharp]).max() < 2 / 255
    assert contrast(found, soft) < 0.3 * contrast(image, soft)


def test_a_plane_is_blurred_evenly(scene) -> None:
    write_exr(Path("plane.exr"), np.full((HEIGHT, WIDTH), 2.0, np.float32))
    assert main("refocus image.png --depth plane.exr --focus 1.5 --aperture 2 --out plane.png".split()) == 0
    found = read_image(Path("plane.png"))
    assert contrast(found, LEFT) < 0.6 * contrast(scene[0], LEFT)
    assert contrast(found, LEFT) == pytest.approx(contrast(found, RIGHT), rel=0.2)


def test_an_aperture_of_zero_changes_nothing(scene) -> None:
    assert main("refocus image.png --depth depth.exr --aperture 0 --out same.png".split()) == 0
    assert np.array_equal(read_image(Path("same.png")), scene[0])


def test_an_f_number_blurs_as_a_thin_lens(scene) -> None:
    """f = 50 mm on 36 x 24 mm at f/1.4, focused at 1 m: the blur of 4 m by the lens equation."""
    words = "--depth-unit 1 --at 0.2,0.5 --f-number 1.4 --focal-length-35mm 50 --out a.png"
    assert main(["refocus", "image.png", "--depth", "depth.exr", *words.split()]) == 0
    pixels_per_mm = math.hypot(WIDTH, HEIGHT) / math.hypot(36, 24)
    radius = (50 / 1.4 / 2) * (50 * pixels_per_mm) / 1000 * abs(1 / FAR - 1 / NEAR)
    image, depth = scene
    lens = PhysicalLens(radius / abs(1 / FAR - 1 / NEAR), 1 / NEAR, WIDTH)
    expected = defocus_numpy(image, depth, lens, Blur(renderer="layered"))[0]
    found = read_image(Path("a.png"))
    assert 1 < radius < 3
    away = np.abs(np.arange(WIDTH) - WIDTH // 2) > 2 * radius + 2  # what is hidden at the edge is made up by both
    assert np.abs(found - np.clip(expected, 0, 1))[:, away].max() < 2 / 255
    # There, too, it is no farther off than an eighth of the stripes' contrast.
    assert np.abs(found - np.clip(expected, 0, 1)).max() < 0.8 / 8


def test_linear_light_and_the_disparity_used_are_written(scene) -> None:
    words = "--depth depth.exr --aperture 0 --out a.exr --save-depth d.exr"
    assert main(["refocus", "image.png", *words.split()]) == 0
    assert np.abs(read_exr(Path("a.exr")) - decode(scene[0])).max() < 1e-3, "half floats, and the toe near black"
    normalised = read_exr(Path("d.exr"))
    assert normalised[:, :40].min() == pytest.approx(1) and normalised[:, 56:].max() == pytest.approx(0)


def test_a_network_gives_the_depth(scene, tmp_path: Path) -> None:
    """The mean of the channels as disparity: a bright half is near."""
    image = np.where(np.arange(WIDTH)[None, :, None] < WIDTH // 2, 0.8, 0.2) * np.ones((HEIGHT, 1, 3))
    write_png(tmp_path / "halves.png", image)
    network = write_network(tmp_path / "net.onnx", side='longest = 48\noutput = "disparity"\n')
    assert main(["refocus", "halves.png", "--depth", f"onnx:{network}", "--save-depth", "d.exr"]) == 0
    normalised = read_exr(Path("d.exr"))
    assert normalised.shape == (HEIGHT, WIDTH)
    # The guided filter pulls each half towards the other a little: a twentieth of their difference at most.
    assert np.abs(normalised[:, :40] - 1).max() < 0.05 and np.abs(normalised[:, 56:]).max() < 0.05


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("--depth depth.exr --f-number 2", "depth without a scale"),
        ("--depth depth.exr --depth-unit 1 --f-number 2", "no focal length"),
        ("--depth onnx:depthnet --f-number 2", "depth without a scale"),
        ("--depth onnx:depthnet --depth-unit 1", "--depth-unit"),
        ("--depth onnx:missing.onnx", "missing.onnx"),
        ("--depth missing.exr", "missing.exr"),
        ("--depth wide.exr", "aspect ratio"),
        ("--depth depth.exr --at 0.5", "--at"),
        ("--depth depth.exr --at 0.5,0.5,0.5", "--at"),
        ("--depth depth.exr --f-number 2 --aperture 0.5", "--aperture"),
        ("--depth depth.exr --out a.gif", "--out"),
    ],
)
def test_half_known_inputs_are_named(scene, words: str, found: str, capsys: pytest.CaptureFixture[str]) -> None:
    write_exr(Path("wide.exr"), np.ones((10, 40), np.float32))
    assert main(["refocus", "image.png", *words.split()]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert found in line and not list(Path().glob("*refocused*"))


def test_coarse_layers_are_close_to_those_at_full_size() -> None:
    random = np.random.default_rng(3)
    rows, columns = np.mgrid[:240, :320]
    image = np.clip(0.4 + 0.3 * np.sin(columns / 9.0) * np.cos(rows / 7.0), 0, 1)[..., None].repeat(3, axis=2)
    disparity = 0.1 + 0.5 * rows / 240
    for _ in range(5):
        inside = (columns - random.uniform(0, 320)) ** 2 + (rows - random.uniform(0, 240)) ** 2 < 45**2
        disparity[inside] = random.uniform(0.3, 1)
        image[inside] *= random.uniform(0.3, 1, 3)
    light = torch.from_numpy(image.astype(np.float32))
    radius = torch.from_numpy((45 * (disparity - 0.3)).astype(np.float32))
    scatter = scatter_of(Blur())
    full, coarse, plain = (
        layered_blur(light, radius, scatter),
        layered_blur(light, radius, scatter, coarse=True),
        scatter(light, radius),
    )
    rms = float(((coarse - full) ** 2).mean().sqrt())
    assert rms < 0.3 * float(((plain - full) ** 2).mean().sqrt()), "far closer than the scatter without occlusion"
