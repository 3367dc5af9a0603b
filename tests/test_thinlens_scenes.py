"""The shipped scenes with photographs through a real lens: complete, consistent, and similar to the scatter's
result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import maximum_filter
from tolerances import (
    FLOAT64_VALUE,
    LIGHT_OF_A_LENS,
    SHIPPED_NOISE,
    SHIPPED_POINT_DEPTH,
    SHIPPED_SCATTER,
    SHIPPED_SCATTER_IN_FOCUS,
    SHIPPED_SURFACE,
)

from dofbench.core.blur import Blur
from dofbench.core.content import content_folder
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr
from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.tone import encode
from dofbench.scenes import load_scene
from dofbench.scenes.depth.disparity import disparity_of, scene_range
from dofbench.scenes.named import named_datasets

DATASET = named_datasets()["thinlens"]
NAMES = [scene.name for scene in DATASET.scenes]
PHOTOGRAPHS = [(name, index) for name in NAMES for index in range(2)]


def folder(name: str) -> Path:
    """Of one of the scenes."""
    return content_folder("datasets") / "thinlens" / name


def record(name: str) -> dict:
    """Its scene.json."""
    return json.loads((folder(name) / "scene.json").read_text())


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    """Of encoded images, clipped as a file is, in dB."""
    return float(-10 * np.log10(np.mean((np.clip(one, 0, 1) - np.clip(other, 0, 1)) ** 2)))


def photograph(name: str, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, PhysicalLens]:
    """(photograph, sharp image, depth, lens): images encoded, the sharp one not clipped."""
    entry, root = record(name)["lens_images"][index], folder(name)
    depth = read_exr(root / "depth" / f"{entry['view']}.exr")
    lens = PhysicalLens(entry["aperture_scene"], 1 / entry["focus_scene"], depth.shape[1])
    sharp = encode(read_exr(root / "images_linear" / f"{entry['view']}.exr"))
    return encode(read_exr(root / entry["image"])), sharp, depth, lens


@pytest.mark.parametrize("scene", DATASET.scenes, ids=NAMES)
def test_every_file_is_as_listed(scene) -> None:
    root = folder(scene.name)
    assert sha256_file(root / "SHA256SUMS") == scene.sha256["SHA256SUMS"]
    listed = dict(reversed(line.split("  ", 1)) for line in (root / "SHA256SUMS").read_text().splitlines())
    files = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()}
    assert files == {*listed, "SHA256SUMS", "README.md"}
    assert {name: sha256_file(root / name) for name in listed} == listed
    assert sum((root / name).stat().st_size for name in files) < 1.4e6
    views = load_scene(root).views
    assert len(views) == scene.views and {(v.camera.width, v.camera.height) for v in views} == {scene.size}


@pytest.mark.parametrize("name", NAMES)
def test_lenses_and_noise_are_stated(name: str) -> None:
    made = record(name)
    found = scene_range(lambda: (read_exr(path) for path in sorted((folder(name) / "depth").iterdir())))
    assert made["disparity_range"] == pytest.approx([found.q_min, found.q_max], rel=FLOAT64_VALUE)
    assert len(made["lens_images"]) == 2
    for entry in made["lens_images"]:
        lens = Lens(entry["aperture"], entry["focus"]).physical(DisparityRange(*made["disparity_range"]), 192)
        assert (entry["aperture_scene"], entry["focus_scene"]) == pytest.approx((lens.aperture, lens.focus_depth))
        assert entry["samples"] >= 1000 and entry["noise_psnr_db"] > SHIPPED_NOISE
        assert (folder(name) / entry["image"]).is_file()


@pytest.mark.parametrize("name", NAMES)
def test_depth_and_poses_agree(name: str) -> None:
    """A view's pixels, lifted by their depth, land on another view's depth, but where something hides them."""
    here, there = load_scene(folder(name)).views[:2]
    assert here.depth is not None and there.depth is not None
    depth = here.depth()
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns]
    camera = here.camera
    x, y = (columns + 0.5 - camera.cx) / camera.fx * z, (rows + 0.5 - camera.cy) / camera.fy * z
    world = np.column_stack([x, y, z]) @ camera.camera_to_world[:3, :3].T + camera.centre
    xy, expected = there.camera.project(world)
    column, row = np.floor(xy).astype(int).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    other = there.depth()[row[inside], column[inside]]
    error = np.abs(other / expected[inside] - 1)
    assert inside.mean() > 0.6 and np.median(error) < SHIPPED_SURFACE
    # Half a pixel of a wrong camera would be seen at once: turned by a degree, nothing fits.
    turned = there.depth()[row[inside], np.clip(column[inside] + 3, 0, camera.width - 1)]
    assert np.mean(np.abs(turned / expected[inside] - 1)) > 1.2 * np.mean(error)


@pytest.mark.parametrize("name", NAMES)
def test_points_lie_on_the_depth_maps(name: str) -> None:
    scene = load_scene(folder(name))
    assert scene.points is not None and scene.points.views is not None and len(scene.points) >= 5
    errors = []
    for index, view in enumerate(scene.views):
        assert view.depth is not None
        own = np.array([index in track for track in scene.points.views])
        xy, z = view.camera.project(scene.points.xyz[own])
        column, row = np.floor(xy).astype(int).T
        errors.append(np.abs(view.depth()[row, column] / z - 1))
    assert np.median(np.concatenate(errors)) < SHIPPED_POINT_DEPTH


@pytest.mark.parametrize(("name", "index"), PHOTOGRAPHS)
def test_what_is_in_focus_is_sharp_and_the_rest_as_the_scatter_says(name: str, index: int) -> None:
    real, sharp, depth, lens = photograph(name, index)
    scattered, _ = defocus_numpy(sharp, depth, lens)
    radius = np.abs(lens.signed_radius(disparity_of(depth), depth.shape[1]))
    assert radius.max() > 4
    assert psnr(real, scattered) > SHIPPED_SCATTER
    assert psnr(real, scattered) > psnr(real, sharp) + 5
    # Nothing but what is in focus reaches these pixels.
    alone = maximum_filter(radius, size=2 * int(np.ceil(radius.max())) + 3) < 1.0
    if alone.sum() > 100:
        error = np.abs(np.clip(real, 0, 1) - np.clip(scattered, 0, 1))[alone]
        assert np.median(error) < SHIPPED_SCATTER_IN_FOCUS


def test_a_wrong_lens_does_not_fit() -> None:
    """The stated lens is the one: half or twice the aperture, or another focus, fits clearly worse."""
    real, sharp, depth, lens = photograph("foliage", 0)
    fits = psnr(real, defocus_numpy(sharp, depth, lens, Blur(renderer="layered"))[0])
    for aperture, focus in ((0.5, 1.0), (2.0, 1.0), (1.0, 1.6)):
        other = PhysicalLens(lens.aperture * aperture, lens.focus_disparity * focus, lens.width)
        assert psnr(real, defocus_numpy(sharp, depth, other, Blur(renderer="layered"))[0]) < fits - 1


def test_highlights_are_kept() -> None:
    linear = read_exr(folder("night") / "images_linear" / "view_000.exr")
    blurred = read_exr(folder("night") / record("night")["lens_images"][0]["image"])
    assert linear.max() > 20 and blurred.max() > 2
    # A lens moves light and loses little of it over the picture's edges.
    assert blurred.mean() == pytest.approx(linear.mean(), rel=LIGHT_OF_A_LENS)
