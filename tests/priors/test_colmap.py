"""A dense workspace in COLMAP's layout, written from exact depth, because COLMAP needs CUDA to make one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from colmap_workspace import back_projected, write_fused, write_map, write_workspace
from tolerances import FLOAT32_SCALAR

from dofbench.core.cameras import Camera
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.scenes import load_scene
from dofbench.scenes.ply import read_ply
from dofbench.training.common.priors import PriorOptions, make_prior
from dofbench.training.common.priors.patch_match import workspace_depth

UNIT = 2.5  # workspace units per scene unit
CROPPED = 10  # pixels that undistortion cut off each side: other sizes and principal points than the scene's


def _cropped(camera: Camera) -> Camera:
    pose = np.array(camera.world_to_camera)
    pose[:3, 3] *= UNIT
    return Camera(
        camera.width - 2 * CROPPED,
        camera.height - 2 * CROPPED,
        camera.fx,
        camera.fy,
        camera.cx - CROPPED,
        camera.cy - CROPPED,
        pose,
    )


@pytest.fixture(scope="module")
def workspace(tmp_path_factory, photographed) -> Path:
    """A workspace with every view's exact depth at full size; its fused points are those in the first view's left
    half."""
    folder = tmp_path_factory.mktemp("dense")
    scene = load_scene(content_folder("datasets") / "tabletop")
    by_name = {view.name: view for view in scene.views}
    chosen = [by_name[view.name] for view in photographed.training_set.views]
    cameras = [_cropped(view.camera) for view in chosen]
    depths = [UNIT * view.depth()[CROPPED:-CROPPED, CROPPED:-CROPPED] for view in chosen]
    kept = depths[0].copy()
    kept[:, cameras[0].width // 2 :] = 0
    write_workspace(folder, [view.name for view in chosen], cameras, depths, back_projected(cameras[0], kept))
    return folder


def _copy(workspace: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(workspace, tmp_path / "dense"))


def test_depth_arrives_in_scene_units_at_the_pixels_it_belongs_to(workspace, photographed):
    maps = workspace_depth(workspace, photographed.training_set)
    full = {view.name: view.depth() for view in load_scene(content_folder("datasets") / "tabletop").views}
    for one, view in zip(maps, photographed.training_set.views, strict=True):
        known = one.depth > 0
        assert known.mean() > 0.2
        # At half the size a pixel's centre is the corner of four equally near pixels: the result must be the depth of
        # one of them, up to the rounding of the scale, and no mean.
        four = [full[view.name][down::2, right::2] for down in (0, 1) for right in (0, 1)]
        exact = [np.isclose(one.depth, depth, rtol=FLOAT32_SCALAR) for depth in four]
        assert np.any(exact, axis=0)[known].all()
        assert ((one.weight > 0) == known).all()


def test_only_what_fusion_kept_counts_and_nothing_behind_it(workspace, photographed):
    maps = workspace_depth(workspace, photographed.training_set)
    width = maps[0].depth.shape[1]
    assert (maps[0].depth[5:-5, 6 : width // 2 - 2] > 0).mean() > 0.99
    assert (maps[0].depth[:, width // 2 + 2 :] > 0).mean() == 0
    # What the first view sees on its left half is seen on other views' left halves, and less of it: parts are hidden.
    assert all((one.depth[:, -width // 4 :] > 0).mean() < 0.05 for one in maps)


def test_a_fused_point_behind_a_surface_is_not_that_surface(workspace, photographed, tmp_path):
    """All points moved away from the cameras by a tenth: each projects near its pixel, but fits no map."""
    folder = _copy(workspace, tmp_path)
    points = read_ply(workspace / "fused.ply").xyz
    centre = UNIT * photographed.training_set.views[0].camera.centre
    write_fused(folder / "fused.ply", centre + 1.1 * (points - centre))
    kept = workspace_depth(folder, photographed.training_set)[0].depth > 0
    assert kept.mean() < 0.02


def test_it_is_a_prior(workspace, photographed):
    options = PriorOptions(depth_prior="colmap", depth_prior_workspace=str(workspace))
    prior = make_prior(photographed.training_set, options, seed=0, steps=1)
    camera = photographed.training_set.views[2].camera
    half = prior.samples(2, camera.resized(camera.width // 2, camera.height // 2))
    assert len(half.depth) > 100 and float(half.depth.min()) >= photographed.truth[2].min()


@pytest.mark.parametrize(
    ("remove", "part"),
    [
        ("fused.ply", "fused.ply"),
        ("sparse", "no model"),
        ("stereo/depth_maps", "geometric.bin"),
        (".", "no such folder"),
    ],
)
def test_missing_parts_are_named(workspace, photographed, tmp_path, remove, part):
    folder = _copy(workspace, tmp_path)
    gone = folder / remove
    shutil.rmtree(gone) if gone.is_dir() else gone.unlink()
    with pytest.raises(InputError, match=part) as caught:
        workspace_depth(folder, photographed.training_set)
    assert "\n" not in str(caught.value)


def test_a_map_cut_short_or_of_another_shape_is_named(workspace, photographed, tmp_path):
    folder = _copy(workspace, tmp_path)
    file = next((folder / "stereo/depth_maps").iterdir())
    content = file.read_bytes()
    file.write_bytes(content[:-5])
    with pytest.raises(InputError, match=file.name):
        workspace_depth(folder, photographed.training_set)
    write_map(file, np.ones((50, 50)))
    with pytest.raises(InputError, match="50x50"):
        workspace_depth(folder, photographed.training_set)


def test_fused_points_that_are_none_are_named(workspace, photographed, tmp_path):
    folder = _copy(workspace, tmp_path)
    write_fused(folder / "fused.ply", np.zeros((0, 3)))
    with pytest.raises(InputError, match="no points"):
        workspace_depth(folder, photographed.training_set)


def test_a_view_that_the_workspace_does_not_have_is_named(workspace, photographed):
    views = photographed.training_set.views
    other = replace(photographed.training_set, views=(replace(views[0], name="elsewhere"), *views[1:]))
    with pytest.raises(InputError, match="elsewhere"):
        workspace_depth(workspace, other)


def test_poses_of_another_reconstruction_are_refused(workspace, photographed):
    views = list(photographed.training_set.views)
    pose = np.array(views[0].camera.world_to_camera)
    pose[0, 3] += 0.2
    views[0] = replace(views[0], camera=replace(views[0].camera, world_to_camera=pose))
    with pytest.raises(InputError, match="distances differ"):
        workspace_depth(workspace, replace(photographed.training_set, views=tuple(views)))


def test_a_workspace_far_from_its_origin_is_refused(workspace, photographed, tmp_path):
    folder = _copy(workspace, tmp_path)
    points = read_ply(workspace / "fused.ply").xyz
    model = pycolmap.Reconstruction(folder / "sparse")
    far = np.array([448262.0, 5411932.0, 135.0])
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), far))
    model.write(folder / "sparse")
    write_fused(folder / "fused.ply", points + far)
    with pytest.raises(InputError, match="far from their origin"):
        workspace_depth(folder, photographed.training_set)
