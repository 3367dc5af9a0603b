"""The built-in scene: files as listed, poses, depth, images and points that agree, and a render that repeats."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tolerances import (
    BUILT_IN_REGISTRATION_PX,
    BUILT_IN_RENDER_PSNR,
    BUILT_IN_SILHOUETTE,
    POSE_ROUND_TRIP,
)

from dofbench.core.cameras import Camera
from dofbench.core.content import content_folder
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr, read_image, to_8bit
from dofbench.optics.tone import encode
from dofbench.scenes import load_scene
from dofbench.scenes.named import named_datasets
from dofbench.scenes.procedural import ink
from dofbench.scenes.procedural.recipes import recipe
from dofbench.scenes.procedural.stage import cameras
from dofbench.scenes.procedural.tracer import Tracer
from dofbench.scenes.procedural.variant import choose_variant
from dofbench.scenes.scene import Scene

DATASET = named_datasets()["tabletop"]
(ENTRY,) = DATASET.scenes
ROOT = content_folder("datasets") / ENTRY.folders[0]
MADE = json.loads((ROOT / "scene.json").read_text())


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(ROOT)


def sampled(values: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Bilinear samples of values (H, W[, C]) at image coordinates (P, 2), pixel centres at half-integers."""
    x, y = xy.T - 0.5
    x0, y0 = (np.clip(np.floor(v).astype(int), 0, size - 2) for v, size in ((x, values.shape[1]), (y, values.shape[0])))
    shape = (-1, *(1,) * (values.ndim - 2))
    fx, fy = (x - x0).reshape(shape), (y - y0).reshape(shape)
    top = values[y0, x0] * (1 - fx) + values[y0, x0 + 1] * fx
    return top * (1 - fy) + (values[y0 + 1, x0] * (1 - fx) + values[y0 + 1, x0 + 1] * fx) * fy


def lifted(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """World points (H * W, 3) behind the pixel centres."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)
    local = (rays * depth[..., None]).reshape(-1, 3)
    return local @ camera.camera_to_world[:3, :3].T + camera.centre


def registration(colours: np.ndarray, image: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """The offset (dx, dy), pixels, at which samples of `image` around `xy` (P, 2) look most like `colours` (P, 3): the
    least of a parabola along each axis, of the mean squared difference at -1, 0 and 1."""
    found = []
    for axis in np.eye(2):
        before, here, after = (np.square(sampled(image, xy + step * axis) - colours).mean() for step in (-1, 0, 1))
        found.append(0.5 * (before - after) / (before - 2 * here + after))
    return np.array(found)


def test_every_file_is_as_listed() -> None:
    assert sha256_file(ROOT / "SHA256SUMS") == ENTRY.sha256["SHA256SUMS"]
    listed = dict(reversed(line.split("  ", 1)) for line in (ROOT / "SHA256SUMS").read_text().splitlines())
    data = {path for part in ("images", "depth", "sparse") for path in (ROOT / part).rglob("*") if path.is_file()}
    data |= {ROOT / "transforms.json", ROOT / "scene.json"}
    assert {path.relative_to(ROOT).as_posix() for path in data} == set(listed)
    assert {name: sha256_file(ROOT / name) for name in listed} == listed
    assert sum(path.stat().st_size for path in data) < 6e6


def test_the_entry_says_what_is_there(scene: Scene) -> None:
    assert len(scene.views) == ENTRY.views == MADE["views"]["views"]
    assert {(view.camera.width, view.camera.height) for view in scene.views} == {ENTRY.size}
    assert [view.split for view in scene.views] == [
        "test" if index % DATASET.hold == 0 else "train" for index in range(ENTRY.views)
    ]
    assert scene.points is not None and len(scene.points) == MADE["sparse"]["points"] >= 1000
    assert DATASET.licence == MADE["licence"]


def test_content_is_spread_over_the_disparity_range(scene: Scene) -> None:
    """Every band of normalised disparity has pixels, and pixels with contrast; nearly none are black or clipped."""
    disparity = np.stack([1 / view.depth() for view in scene.views])
    images = np.stack([view.image() for view in scene.views])
    low, high = np.percentile(disparity, [1, 99])
    assert 4 < high / low < 5.5
    normalised = (disparity - low) / (high - low)
    grey = images.mean(axis=-1)
    for focus in (0.2, 0.5, 0.8):
        band = np.abs(normalised - focus) < 0.12
        assert band.mean() > 0.05
        assert grey[band].std() > 0.1
    assert ((images.max(axis=-1) > 0.999).mean()) < 0.03
    assert 0.35 < images.mean() < 0.6


@pytest.mark.parametrize(("first", "second"), [(0, 1), (3, 11), (16, 19)])
def test_depth_poses_and_images_agree(scene: Scene, first: int, second: int) -> None:
    """A view carried to another by its depth lands on the other's depth, and on its colours."""
    here, there = scene.views[first], scene.views[second]
    xy, z = there.camera.project(lifted(here.camera, here.depth()))
    inside = ((xy > 1) & (xy < (there.camera.width - 1, there.camera.height - 1))).all(axis=1)
    # Bilinear depth is exact on a plane in disparity; where it isn't, an edge or an occlusion is near.
    other = 1 / sampled(1 / there.depth(), xy[inside])
    error = np.abs(z[inside] / other - 1)
    seen = error < 0.01
    assert inside.mean() > 0.6 and seen.mean() > 0.75
    # Both maps are rounded to the step, by at most half of it.
    assert np.median(np.abs(z[inside] - other)[seen]) < MADE["depth"]["step"]
    colours = here.image().reshape(-1, 3)[inside][seen]
    offset = registration(colours, there.image(), xy[inside][seen])
    assert np.abs(offset).max() < BUILT_IN_REGISTRATION_PX
    # The same one pixel off is found to be one pixel off: the measurement sees a shifted camera.
    moved = registration(colours, there.image(), xy[inside][seen] + (0.5, 0.0))
    assert np.abs(moved - offset + (0.5, 0.0)).max() < BUILT_IN_REGISTRATION_PX


def depth_uncertainty(scene: Scene) -> np.ndarray:
    """(P,) relative error of a triangulated point's depth, times the focal length: the point's own reprojection error,
    pixels, over the sine of the widest angle between the rays that see it."""
    assert scene.points is not None and scene.points.views is not None
    centres = np.array([view.camera.centre for view in scene.views])
    found = []
    for place, error, track in zip(scene.points.xyz, scene.points.error, scene.points.views, strict=True):
        rays = place - centres[track]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        found.append(error / np.sqrt(1 - np.clip((rays @ rays.T).min(), -1, 1) ** 2))
    return np.array(found)


def test_points_lie_on_the_depth_maps(scene: Scene) -> None:
    points = scene.points
    assert points is not None and points.views is not None
    errors, expected = [], []
    uncertain = depth_uncertainty(scene)
    for index, view in enumerate(scene.views):
        own = np.array([index in track for track in points.views])
        xy, z = view.camera.project(points.xyz[own])
        inside = ((xy > 1) & (xy < (view.camera.width - 1, view.camera.height - 1))).all(axis=1)
        errors.append(np.abs(z[inside] * sampled(1 / view.depth(), xy[inside]) - 1))
        expected.append(uncertain[own][inside] / view.camera.fx)
    assert np.median(np.concatenate(errors)) < np.median(np.concatenate(expected))
    assert min(len(track) for track in points.views) >= 2


def test_colmap_model_has_the_same_cameras(scene: Scene) -> None:
    again = load_scene(ROOT, layout="colmap")
    for one, other in zip(scene.views, again.views, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(one.camera.world_to_camera, other.camera.world_to_camera, atol=POSE_ROUND_TRIP)
        np.testing.assert_allclose(one.camera.intrinsics, other.camera.intrinsics)


# ---- the recipe that makes it ----


def test_camera_path_is_the_one_that_was_rendered(scene: Scene) -> None:
    made = cameras(recipe(MADE["recipe"]).VIEWPOINTS, MADE["path"], ENTRY.views, *ENTRY.size, MADE["seed"])
    for view, camera in zip(scene.views, made, strict=True):
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=POSE_ROUND_TRIP)
        np.testing.assert_allclose(view.camera.intrinsics, camera.intrinsics)


def test_text_fills_its_box() -> None:
    sheet = np.ones((80, 300, 3))
    ink.text(sheet, "BOKEH", (20, 10, 240, 60), (0.0, 0.0, 0.0))
    rows, columns = np.nonzero(sheet.min(axis=2) < 0.5)
    assert abs(rows.min() - 10) <= 1 and abs(rows.max() - 69) <= 1
    assert abs(columns.min() - 20) <= 1 and abs(columns.max() - 259) <= 1


def test_drawing_outside_the_image_is_left_out() -> None:
    sheet = np.ones((20, 30, 3))
    ink.disc(sheet, (-50, 5), 8, (0.0, 0.0, 0.0))
    ink.stroke(sheet, (100, 100), (120, 90), 3, (0.0, 0.0, 0.0))
    ink.ring(sheet, (15, 300), 5, 2, (0.0, 0.0, 0.0))
    assert (sheet == 1).all()


@pytest.mark.slow
def test_a_render_repeats_depth_and_image(scene: Scene) -> None:
    """One view rendered again, with a tenth of the samples: the same depth, the same image but for noise."""
    pytest.importorskip("mitsuba", reason="mitsuba is not installed (extra: render)")
    choose_variant()
    tracer = Tracer(recipe(MADE["recipe"]).stage(MADE["seed"]))
    view = scene.views[5]
    shipped = read_exr(ROOT / "depth" / f"{view.name}.exr")
    error = np.abs(tracer.depth(view.camera) - shipped)
    # Another ray tracer may decide otherwise where a ray grazes an edge; elsewhere only the step of the files is lost.
    assert (error > 0.51 * MADE["depth"]["step"]).mean() < BUILT_IN_SILHOUETTE
    again = to_8bit(encode(tracer.photograph(view.camera, 96, "again").linear))
    difference = again / 255.0 - read_image(ROOT / "images" / f"{view.name}.png")
    assert -10 * np.log10(np.mean(difference**2)) > BUILT_IN_RENDER_PSNR
